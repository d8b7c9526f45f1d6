"""Moduli that are parameters: impossible ones are refused by all models.

What the core alone lacks is named.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from impossible_moduli import POINT, RATIO, WHERE, YOUNG, scene
from needs import needs
from scenes import check_like, pressed_pair

import hhr_dolfinx as hhr
from hhr_dolfinx import registry
from hhr_dolfinx.amplitudes import Limits
from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import ModelFileError, NoBoundWarning, NotOfferedError, NotSolvableError
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.models.eliminations.block import BlockElimination


@pytest.fixture(scope="module", params=[(YOUNG, 0.3), (YOUNG, "0.2 + 0.02 * E1"), ("E1", RATIO)],
                ids=["modulus of a whole body", "modulus beside a ratio", "ratio"])  # fmt: skip
def training(request):
    return hhr.train(scene(*request.param), hhr.Sobol(24), held_out=4)


MAKE = {
    "full order": (("elasticity",), lambda training: training.full_order),
    "condensed": (("moduli",), lambda training: training.condense()),
    "HHR": (("moduli",), lambda training: training.build(hhr.Recipe().as_it_is())),
    "fallback": (
        ("moduli", "fallback"),
        lambda training: training.safe_model(0.5, recipe=hhr.Recipe().as_it_is()),
    ),
}


@needs("tables")
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", [pytest.param(kind, marks=needs(*MAKE[kind][0])) for kind in MAKE])
def test_no_model_answers_where_a_constant_is_impossible(training, kind, tmp_path):
    """One by one, in tables, along paths, from a file; beside the point all of them answer."""
    model = MAKE[kind][1](training)
    beside = {**POINT, "E1": WHERE + 1e-3}
    assert model.solve(beside, outside="ignore").converged
    models = [model]
    if kind in ("condensed", "HHR"):
        hhr.save_model(tmp_path / "model.npz", model)
        models.append(hhr.load_model(tmp_path / "model.npz"))
    for one in models:
        for gradient in (False, True):
            with pytest.raises(
                NotSolvableError, match=r"is -?[\d.e+-]+ at .*E1 = 2.7183, and must"
            ):
                one.solve(POINT, outside="ignore", gradient=gradient)
        answer = one.solve(POINT, raise_on_failure=False, outside="ignore")
        assert answer.status is Status.UNDEFINED and np.isnan(answer.multipliers).all()
        table = hhr.answer_points(
            one, np.array([list(beside.values()), list(POINT.values())]), outside="ignore"
        )
        assert table.status[0] == "ok" and "and must" in table.status[1]
        assert np.isfinite(table.forces[0]).all() and np.isnan(table.forces[1]).all()
        with pytest.raises(NotSolvableError, match="and must"):
            one.march([(0.0, list(beside.values())), (1.0, list(POINT.values()))])


@pytest.mark.parametrize("young", [
    "E1 + 1e-30 / (E1 - 2.3456)", "E1 * min(1, 1e6 * abs(E1 - 2.3456))",
    "E1 * (1 + 0 * sqrt(1e6 * abs(E1 - 2.3456) - 0.5))", "E1 * min(1, 1e6 * abs(E1 - 2.3456) - 3)",
])  # fmt: skip
def test_a_modulus_that_is_invalid_at_one_of_many_points(young):
    """Infinite, zero, no number and negative, in a spike that no check of the box sees."""
    limits = Limits("young", young, ("E1",))
    limits.check_many(np.array([[2.0], [2.4]]))
    with pytest.raises(NotSolvableError, match=r"is .* at E1 = 2.3456, and must be positive"):
        limits.check_many(np.array([[2.0], [2.3456], [2.4]]))


@needs("friction", "inelastic")
def test_a_modulus_that_is_impossible_beside_friction_and_flow():
    """Refused in words by marches; a single query without an answer says so, and does not raise
    where that is asked.
    """
    for how in ({"friction": 0.3}, {"law": hhr.Plasticity(0.1)}):
        full = hhr.FullOrderModel(scene(YOUNG, 0.3, **how))
        answer = full.solve(POINT, raise_on_failure=False)
        assert not answer.converged and np.isnan(answer.multipliers).all()
        assert full.solve({**POINT, "E1": WHERE + 1e-3}).converged


def varied():
    return pressed_pair(
        "plane_strain", (("E1", "nu1"), (4.0, 0.3)), {"E1": (1.0, 6.0), "nu1": (0.1, 0.42)}, cells=4
    )


@pytest.fixture(scope="module")
def trained():
    return hhr.train(varied(), hhr.Sobol(32), held_out=8)


@pytest.fixture
def alone(monkeypatch):
    monkeypatch.setattr(registry, "installed", dict)


def test_shapes_are_refused(alone):
    shape = SimpleNamespace(
        tag=two_blocks.SECOND, coordinates=("x * (1 + wide)", "y"), variables={"x", "y", "wide"}
    )
    shape.check, shape.moved = lambda *given: None, lambda points, names, values: points
    varying = pressed_pair(
        "plane_strain", ((3.0, 0.3), (4.0, 0.3)), {"wide": (0.0, 0.05)}, shapes=(shape,)
    )
    with pytest.raises(NotOfferedError, match="whose shapes depend on parameters, needs a plug-in"):
        hhr.FullOrderModel(varying)


@needs("elasticity")
def test_condensation_is_refused(alone, trained):
    with pytest.raises(
        NotOfferedError, match=r"condenses scene .*, whose stiffness or shape depends on"
    ):
        hhr.condense(trained.full_order)
    with pytest.raises(NotOfferedError, match="no installed reductor condenses"):
        trained.condense()


@needs("elasticity")
def test_reduced_models_factor_at_each_point_and_have_no_bound(alone, trained, tmp_path):
    """The same basis and RID as with the plug-in, so that answers are off by what the reduction
    leaves.
    """
    with pytest.warns(NoBoundWarning, match="no installed plug-in knows"):
        model = trained.build()
    assert model.compliances is None and isinstance(model.eliminated.eliminated, BlockElimination)
    assert "no installed plug-in" in model.fields.unbounded
    hhr.save_model(tmp_path / "model.npz", model)
    kept, full = hhr.load_model(tmp_path / "model.npz"), trained.full_order
    for point in full.parameters.random(5, seed=1):
        answer = model.solve(point, gradient=True)
        assert answer.estimate() is None and np.isfinite(answer.gradient.unknown).all()
        check_like(answer, full.solve(point), displacement=0.05)
        assert np.array_equal(kept.solve(point).forces(), answer.forces())


@needs("moduli")
def test_a_file_of_the_plug_in_is_refused_without_it(tmp_path, monkeypatch):
    hhr.save_model(tmp_path / "model.npz", hhr.condense(varied()))
    monkeypatch.setattr(registry, "installed", dict)
    with pytest.raises(
        ModelFileError,
        match=r"holds a .*: it belongs to the plug-in 'moduli', which is not installed",
    ):
        hhr.load_model(tmp_path / "model.npz")
