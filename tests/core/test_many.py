"""Many parameters at once: the answers of one by one, to round-off, whatever the model."""

import hertz_half_discs as discs
import numpy as np
import pellet_cladding as pellet
import pytest
from scenes import pressed_block

import hhr_dolfinx as hhr
from hhr_dolfinx.contact.active_set import KeptFactors, Status
from hhr_dolfinx.errors import ParameterError
from hhr_dolfinx.linear.dense import LapackLU
from hhr_dolfinx.models import many as several


@pytest.fixture(scope="module", params=["discs", "pellet"])
def training(request):
    if request.param == "discs":
        return hhr.train(discs.scene(arc_segments=28, flat_segments=7), (12,), held_out=4)
    return hhr.train(pellet.scene(**pellet.QUICK_MESH), (8, 6), held_out=4)


def models(training):
    yield training.build()
    for field in (False, True):
        yield hhr.exact_condensation(
            training.full_order, training.snapshots.known_statuses(), field=field
        )


def test_many_are_those_one_by_one(training):
    points = training.full_order.parameters.random(300, seed=5)
    for model in models(training):
        many = model.solve_many(points)
        assert len(many) == 300 and set(many.status) == {Status.CONVERGED}
        for point, answer in zip(points, many, strict=True):
            alone = model.solve(point)
            assert np.array_equal(answer.parameter, point) and np.array_equal(
                answer.active, alone.active
            )
            assert (
                np.abs(answer.multipliers - alone.multipliers).max()
                <= 1e-11 * np.abs(alone.multipliers).max()
            )
            size = np.abs(alone.unknown).max(initial=0.0)
            assert np.abs(answer.unknown - alone.unknown).max(initial=0.0) <= 1e-10 * size
        field, exact = many[7].displacement(), model.solve(points[7]).displacement()
        assert np.linalg.norm(field - exact) <= 1e-10 * np.linalg.norm(exact)


def test_the_edge_of_contact_is_left_to_the_search():
    """Where all gaps close at once forces are round-off, of either sign."""
    full = hhr.FullOrderModel(pressed_block("plane_strain"))
    model = hhr.exact_condensation(
        full, hhr.compute_snapshots(full, np.array([[0.0], [0.1]])).known_statuses()
    )
    points = np.array([0.01, 0.01 + 1e-17, 0.0, 0.05, 0.1])[:, None]
    many = model.solve_many(points)
    assert set(many.status) == {Status.CONVERGED}
    for k, point in enumerate(points):
        assert many.multipliers[k] == pytest.approx(
            model.solve(point).multipliers, rel=1e-10, abs=1e-14
        )


def test_bad_tables_are_refused(training):
    model, space = training.build(), training.full_order.parameters
    inside = np.array([space.lower], dtype=float)
    for table in (
        inside + 1e9,
        np.full_like(inside, np.nan),
        inside[:, :0],
        "points",
        inside[0, 0],
    ):
        with pytest.raises(ParameterError):
            model.solve_many(table)
    assert len(model.solve_many(inside.tolist())) == 1


def test_factors_of_a_table_have_a_bound(training, monkeypatch):
    """Those asked for last stay; a bound for two of them changes no answer."""
    model = next(models(training))
    points = training.full_order.parameters.random(300, seed=5)
    before = model.solve_many(points)
    held, plain = [], KeptFactors.of

    def watched(self, index, key):
        found = plain(self, index, key)
        held.append(self.kept_bytes)
        return found

    monkeypatch.setattr(KeptFactors, "of", watched)
    monkeypatch.setattr(
        KeptFactors, "most_bytes", 2 * LapackLU(np.eye(model.solve(points[0]).active.size)).nbytes
    )
    assert np.array_equal(model.solve_many(points).multipliers, before.multipliers)
    assert held and max(held) <= KeptFactors.most_bytes


def test_kept_factors_forget_what_was_asked_for_longest_ago(monkeypatch):
    sets = [np.array(item) for item in ((0, 1), (2, 3), (4, 5))]
    monkeypatch.setattr(KeptFactors, "most_bytes", 2 * LapackLU(np.eye(2)).nbytes)
    factors = KeptFactors(np.diag(np.arange(1.0, 9.0)))
    first, second = (factors.of(index, index.tobytes()) for index in sets[:2])
    assert factors.of(sets[0], sets[0].tobytes()) is first
    factors.of(sets[2], sets[2].tobytes())
    assert factors.of(sets[0], sets[0].tobytes()) is first
    assert factors.of(sets[1], sets[1].tobytes()) is not second


def test_many_points_start_from_their_neighbours(training, monkeypatch):
    """The same answers, and less of a search: most neighbours share their statuses."""
    model = hhr.exact_condensation(
        training.full_order, training.snapshots.known_statuses(), field=False
    )
    points = model.parameters.random(600, seed=6)
    far = model.solve_many(points)
    monkeypatch.setattr(several, "FEWEST_POINTS", 50)
    near = model.solve_many(points)
    assert np.array_equal(near.active, far.active)
    assert np.abs(near.multipliers - far.multipliers).max() <= 1e-11 * np.abs(far.multipliers).max()
    assert near.iterations.mean() < far.iterations.mean()
    assert model.rows_at_once > training.full_order.rows_at_once
