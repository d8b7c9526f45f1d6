"""Gaskets: closed forms of a uniform block along paths, gradients, contracts, mistakes."""

import dataclasses

import numpy as np
import pytest
from mpi4py import MPI
from needs import needs
from scenes import pressed_block, space

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SceneError

pytestmark = [needs("gaskets")]
BLOCK = 3.0 / (1 - 0.3**2) / 2
"""Pressure of the block of height 2 in plane strain over its shortening."""
LOADING = ((0.0, 0.0), (0.01, 0.02), (0.03, 0.03), (0.05, 0.08))
UNLOADING = ((0.02, 0.006), (0.04, 0.025))
PATH = (0.02, 0.05, 0.035, 0.015, 0.03, 0.09, 0.02, 0.1)
GASKETS = {
    "by sets": hhr.GasketLayer(LOADING, UNLOADING, thickness=0.02),
    "by the first slope": hhr.GasketLayer(LOADING[:3], thickness=0.025, initial_gap=0.005),
}


def loaded(name, c):
    """Pressure on the first way, written down here."""
    points = np.transpose(LOADING if name == "by sets" else LOADING[:3])
    (a, b), (p, q) = points[:, -2:]
    return np.interp(c, *points) if c <= b else q + (q - p) / (b - a) * (c - b)


def set_of(name, m):
    """Closure at which the pressure is gone."""
    if name != "by sets":
        return m - loaded(name, m) * 0.01 / 0.02
    return (
        np.interp(m, (0.01, *np.transpose(UNLOADING)[0]), (0.0, *np.transpose(UNLOADING)[1]))
        if m < 0.04
        else 0.025 + (0.025 - 0.006) / 0.02 * (m - 0.04)
    )


def pressure(name, c, m):
    if c >= m:
        return loaded(name, max(c, 0.0))
    z = set_of(name, m)
    return loaded(name, m) * max(c - z, 0.0) / (m - z)


def gasket_block(law, **changes):
    """The block whose pressure is uniform, on a gasket .02 thick that touches it .01 lower."""
    scene = pressed_block("plane_strain")
    floor = dataclasses.replace(scene.contacts[0], law=law)
    outputs = (
        hhr.LargestPressure("peak", 0),
        hhr.GapAt("gap", 0, (0.5, 0.0)),
        hhr.LargestClosure("closed", 0),
    )
    return dataclasses.replace(scene, contacts=(floor,), outputs=outputs, **changes)


def by_hand(name, path):
    """Pressures and largest closures along pushes: the block shortens by p / BLOCK."""
    m = 0.0
    for push in path:
        low, high = -1.0, 1.0  # of the closure, from .01 - push + p / BLOCK = gap = .02 - c
        for _ in range(200):
            c = 0.5 * (low + high)
            shorter = 0.01 + push - c
            low, high = (low, c) if pressure(name, c, m) > BLOCK * shorter else (c, high)
        m = max(m, c)
        yield pressure(name, c, m), c, m


@pytest.mark.parametrize("name", GASKETS)
def test_a_uniform_block_along_a_path(name, tmp_path):
    """In full order, condensed and from a file: loads, unloads, loads again, to round-off."""
    full = hhr.FullOrderModel(gasket_block(GASKETS[name]), MPI.COMM_SELF)
    model = hhr.condense(full)
    hhr.save_model(tmp_path / "model.npz", model)
    path = [(float(k), (push,)) for k, push in enumerate((0.0, *PATH))]
    for each in (full, model, hhr.load_model(tmp_path / "model.npz")):
        answers = each.march(path).answers
        for answer, expected in zip(answers, by_hand(name, PATH), strict=True):
            p, c, m = expected
            found = answer.outputs()
            assert found["peak"] == pytest.approx(p, rel=1e-10, abs=1e-13)
            assert found["closed"] == pytest.approx(m, rel=1e-10)
            if p > 0:
                assert found["gap"] == pytest.approx(0.02 - c, abs=1e-12)


def test_steps_do_not_matter_while_it_closes():
    """The law has no time: many increments end where one does."""
    model = hhr.condense(gasket_block(GASKETS["by sets"]))
    ends = []
    for steps in (1, 7, 50):
        pushes = [*np.linspace(0.0, 0.09, steps + 1)[1:], 0.04]
        path = [(0.0, (0.0,)), *((k + 1.0, (push,)) for k, push in enumerate(pushes))]
        ends.append(model.march(path).answers[-1].forces())
    np.testing.assert_allclose(ends[1:], [ends[0]] * 2, rtol=1e-11)


@pytest.mark.parametrize("last", [0.11, 0.09, 0.05])
def test_gradients_know_the_largest_closure(last):
    """The way back depends on the way there, by a factor that is a parameter, too: differences of
    paths whose points all move.
    """
    law = hhr.GasketLayer(LOADING, UNLOADING, thickness=0.02, scale="1 + .5 * k")
    box = space(push=(-0.01, 0.1), k=(0.5, 2.0))
    model = hhr.condense(gasket_block(law, parameters=box))

    pushes = np.array([0.0, 0.08, 0.8 * last])

    def ends(moved, gradient=False):
        path = [(float(t), (push + moved[0], 1.3 + moved[1])) for t, push in enumerate(pushes)]
        settings = hhr.MarchSettings(gradient=gradient)
        return model.march(path, settings).answers[-1]

    found = ends(np.zeros(2), gradient=True).gradient.multipliers
    for axis, step in enumerate(1e-7 * np.eye(2)):
        expected = (ends(step).multipliers - ends(-step).multipliers) / 2e-7
        assert found[:, axis] == pytest.approx(expected, rel=1e-5, abs=1e-9)


@needs("conformance")
@pytest.mark.parametrize("name", GASKETS)
def test_it_keeps_the_contract_of_contact_laws(name):
    """Full, condensed, files, cuts, hyper-reduced and compiled, on blocks of other sizes."""
    from hhr_dolfinx.testing import check_contact_law

    check_contact_law(GASKETS[name])


@needs("conformance")
def test_the_contract_finds_a_memory_that_gradients_leave_out(monkeypatch):
    from hhr_dolfinx.plugins.gaskets.laws import GasketStep
    from hhr_dolfinx.testing import check_contact_law

    monkeypatch.setattr(GasketStep, "shifted", lambda self, before: 0.5 * before)
    with pytest.raises(AssertionError, match="along the memory"):
        check_contact_law(GASKETS["by sets"])


@needs("soft_contact")
def test_a_gasket_that_does_not_yield_is_soft_contact():
    hard = hhr.GasketLayer([(0, 0), (1, 2.0)])
    soft = hhr.SoftContact(stiffness=2.0)
    path = [(float(k), (push,)) for k, push in enumerate((0.0, *PATH))]
    found, expected = (
        [answer.forces() for answer in hhr.condense(scene).march(path).answers]
        for scene in (gasket_block(hard), dataclasses.replace(gasket_block(soft), outputs=()))
    )
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-14)


def test_gaps_are_those_to_the_gasket_as_it_is_left():
    """Untouched, pressed, and set."""
    full = hhr.FullOrderModel(gasket_block(GASKETS["by sets"]), MPI.COMM_SELF)
    path = [(0.0, (0.0,)), (1.0, (0.06,)), (2.0, (0.0,))]
    pressed, gone = full.march(path).answers
    assert pressed.gaps() == pytest.approx(0.0, abs=1e-12)
    *_, (_, _, largest) = by_hand("by sets", (0.06,))
    # the surfaces are .01 apart, and the gasket of .02 is thinner by its set
    assert gone.gaps() == pytest.approx(0.01 - 0.02 + set_of("by sets", largest), abs=1e-12)
    assert not gone.forces().any()


def test_tables_may_be_arrays_and_laws_are_compared():
    one, other = (hhr.GasketLayer(np.array(LOADING), np.array(UNLOADING)) for _ in range(2))
    assert one == other == hhr.GasketLayer(list(LOADING), list(UNLOADING))
    assert hash(one) == hash(other)


@pytest.mark.parametrize(("given", "said"), [
    ({"loading": [(0, 0)]}, "two points"),
    ({"loading": [(0.1, 0), (0.2, 1)]}, "first must be 0, where the gasket"),
    ({"loading": [(0, 1), (0.2, 2)]}, "first must be 0, where the pressure"),
    ({"loading": [(0, 0), (0.2, 2), (0.3, 1)]}, "falls"),
    ({"loading": [(0, 0), (0.2, 0), (0.3, 1)]}, "where it yields"),
    ({"loading": [(0, 0), (0.2, float("nan"))]}, "finite"),
    ({"loading": [(0, 0), (0.1, 1), (0.2, 5)]}, "stiffens"),
    ({"loading": LOADING, "unloading": [(0.005, 0.0)]}, "from 0.01 on"),
    ({"loading": LOADING, "unloading": [(0.02, 0.02)]}, "stay below"),
    ({"loading": LOADING, "unloading": [(0.02, 0.01), (0.03, 0.005)]}, "must not fall"),
    ({"loading": LOADING, "unloading": [(0.02, "x")]}, "largest closure, set"),
    ({"loading": LOADING[:2], "thickness": -1.0}, "thickness"),
    ({"loading": LOADING[:2], "initial_gap": float("inf")}, "initial_gap"),
    ({"loading": LOADING[:2], "scale": 0.0}, "positive"),
])  # fmt: skip
def test_mistakes_are_named(given, said):
    with pytest.raises(SceneError, match=said):
        hhr.GasketLayer(**given)


def test_an_output_of_a_pair_without_a_gasket():
    scene = dataclasses.replace(
        pressed_block("plane_strain"), outputs=(hhr.LargestClosure("closed", 0),)
    )
    with pytest.raises(SceneError, match="has no gasket"):
        hhr.condense(scene)
