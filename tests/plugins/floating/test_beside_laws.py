"""Bodies that contact alone holds, with laws of their own and beside laws, shapes, moduli and laws
of contacts.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from loose_blocks import BOTH, HELD, LAWS, LOOSE, PATH, TIGHT, block_on_a_floor, flowing
from mpi4py import MPI
from needs import needs
from scenes import lying, meshed, slope, slope_errors, space
from toy_system import Parted

import hhr_dolfinx as hhr
from hhr_dolfinx import registry
from hhr_dolfinx.errors import NotSolvableError, SceneError, UndeterminedWarning
from hhr_dolfinx.geometries import stacked_blocks as blocks

pytestmark = [
    needs("inelastic"),
    pytest.mark.filterwarnings("ignore:body 2 .* moves along axis 0"),
    pytest.mark.filterwarnings("ignore:parameters .* have no effect"),
]
ON_SPRINGS = hhr.MarchSettings(
    "tangent", relative_stress=1e-8, relative_force=1e-8, floor_stress=1e-8
)
"""Tolerances that a body on a spring of 1e-6 of its stiffness reaches.

Tighter ones are below its round-off.
"""


def on_springs(made, stiffness):
    """The scene with springs below the side of the loose block, so that displacements hold
    everything.
    """
    springs = tuple(
        hhr.Springs(blocks.interface(blocks.UPPER_BLOCK, 2), component, stiffness, bedding=True)
        for component in (0, 1)
    )
    return replace(made, loads=(*made.loads, *springs))


@needs("nodal_loads")
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("which", [HELD, LOOSE, BOTH], ids=["held", "loose", "both"])
def test_histories_are_the_limit_of_weak_springs(law, which):
    """Forces and their moment balance the loads to 1e-10, and answers are what two springs
    extrapolate to.

    Springs of 1e-5 and 1e-6 of Young's modulus change answers in proportion: their line ends at no
    spring, up to the square of 1e-5 and to round-off over 1e-6. Weaker ones lose the digits of S:
    1e-8 alone is 7e-8 off, 1e-10 4e-6.
    """
    made = flowing(law, which)
    full = hhr.FullOrderModel(made, MPI.COMM_SELF)
    assert full.problem.kernel.motions.shape[1] == 2
    found = full.march(PATH, TIGHT).answers
    places = full.problem.contact_points[:, 0]
    for (_, point), answer in zip(PATH[1:], found, strict=True):
        forces = answer.forces()
        width = 1 - 0.05
        assert forces.min() >= 0 and forces.sum() == pytest.approx(
            point[0] + 0.2 * width, rel=1e-10
        )
        assert places @ forces == pytest.approx(0.5 * point[0], rel=1e-10)
        assert answer.undetermined is None
    assert found[-1].plastic_strain().max() > 1e-4
    (weak, weaker) = (
        hhr.FullOrderModel(on_springs(made, ratio * 1000.0), MPI.COMM_SELF)
        .march(PATH, ON_SPRINGS)
        .answers
        for ratio in (1e-5, 1e-6)
    )
    for answer, one, other in zip(found, weak, weaker, strict=True):
        for read in (lambda a: a.forces(), lambda a: a.stress(), lambda a: a.plastic_strain()):
            limit = read(other) + (read(other) - read(one)) / 9
            assert np.abs(read(answer) - limit).max() < 1e-8 * np.abs(limit).max()


@needs("friction", "nodal_loads")
def test_friction_of_flowing_bodies_is_the_limit_of_weak_springs():
    """Tangential forces hold the third motion.

    The law of the contacts is any that solves for a slack.
    """
    made = flowing("plasticity", BOTH)
    surfaces = (blocks.interface(body, 2) for body in (blocks.LOWER_BLOCK, blocks.UPPER_BLOCK))
    pressed = hhr.Traction(blocks.outer_end(blocks.UPPER_BLOCK, 2), (0.15, -1.0), slope("p"))
    pair = hhr.NodeToNode(*surfaces, (0.0, 1.0), friction=0.4)
    made = replace(made, contacts=(pair,), loads=(pressed, made.loads[1]))
    full = hhr.FullOrderModel(made, MPI.COMM_SELF)
    assert full.problem.kernel.motions.shape[1] == 3
    found, weak, weaker = (
        one.march(PATH[:3], ON_SPRINGS).answers
        for one in (
            full,
            *(hhr.FullOrderModel(on_springs(made, k), MPI.COMM_SELF) for k in (1e-2, 1e-3)),
        )
    )
    for (_, point), answer, one, other in zip(PATH[1:], found, weak, weaker, strict=False):
        pressing = full.law.pressing(answer.forces().size)
        assert np.abs(answer.forces()[~pressing]).sum() > 0.1 * point[0]
        limit = other.forces() + (other.forces() - one.forces()) / 9
        assert np.abs(answer.forces() - limit).max() < 1e-6 * limit.max()


@needs("nodal_loads")
@pytest.mark.parametrize("law", LAWS)
def test_a_loose_block_flows_under_a_pressure_as_one_that_is_held(law):
    """All of it is pressed alike: supports of its side are the floor, and each force is the
    pressure of its node.

    The stress is -p across and zero along, whatever the law.
    """
    loose, held = (
        hhr.FullOrderModel(block_on_a_floor(LAWS[law](), held=one), MPI.COMM_SELF)
        for one in (False, True)
    )
    assert loose.problem.held_by_contact and not held.problem.held_by_contact
    for (_, point), one, other in zip(
        PATH[1:], loose.march(PATH, TIGHT).answers, held.march(PATH, TIGHT).answers, strict=True
    ):
        assert one.forces() == pytest.approx(point[0] * loose.problem.contact_areas, rel=1e-10)
        stress = one.stress()[np.abs(one.stress()).max(axis=1) > 1e-6]
        assert (
            stress[:, 1] == pytest.approx(-point[0], rel=1e-9)
            and np.abs(stress[:, 0]).max() < 1e-8 * point[0]
        )
        assert one.stress() == pytest.approx(other.stress(), abs=1e-8 * point[0])
        assert one.plastic_strain() == pytest.approx(other.plastic_strain(), abs=1e-9)


@pytest.mark.parametrize("law", LAWS)
def test_gradients_of_histories_are_those_of_differences(law):
    """Along a shift of the whole path.

    Statuses are the same on both sides, and both points are off any kink.
    """
    full = hhr.FullOrderModel(flowing(law, BOTH), MPI.COMM_SELF)
    answers = full.march(PATH, replace(TIGHT, gradient=True)).answers
    step = 1e-5
    ends = [
        full.march([(t, p + sign * step) for t, p in PATH], TIGHT).answers[-1]
        for sign in (1.0, -1.0)
    ]
    assert all(np.array_equal(end.active, answers[-1].active) for end in ends)
    gradient = answers[-1].gradient
    for read, change in (("multipliers", gradient.multipliers), ("unknown", gradient.unknown)):
        difference = np.subtract(*(getattr(end, read) for end in ends)) / (2 * step)
        assert np.abs(change[:, 0] - difference).max() < 1e-5 * np.abs(difference).max()


@pytest.mark.parametrize("law", LAWS)
def test_hyper_reduced_histories(law, tmp_path):
    """Forces balance the loads to round-off in a reduced model too, which a file answers alike."""
    made = flowing(law, BOTH)
    paths = [[(t, share * p) for t, p in PATH] for share in (1.0, 1.1, 0.9)]
    training = hhr.train(made, paths, held_out=0, comm=MPI.COMM_SELF)
    model = training.build()
    assert model.problem.motions == 2
    path = [(t, 0.95 * p) for t, p in PATH]
    hhr.save_model(tmp_path / "model.npz", model)
    every = [
        one.march(path).answers
        for one in (model, hhr.load_model(tmp_path / "model.npz"), training.full_order)
    ]
    for (_, point), one, again, exact in zip(path[1:], *every, strict=True):
        assert one.forces().sum() == pytest.approx(point[0] + 0.2 * 0.95, rel=1e-9)
        assert np.array_equal(one.multipliers, again.multipliers)
        assert np.linalg.norm(one.forces() - exact.forces()) < 0.02 * np.linalg.norm(exact.forces())


def test_motions_that_nothing_determines_are_least_and_warned_of():
    """A block on two nodes of a corner may turn: a history says so, as a single answer of elastic
    bodies does.
    """
    made = lying(bulge=0.5, cells=(6, 3))
    one, other = made.bodies
    with pytest.warns(UndeterminedWarning, match="neither loads nor contact determine") as elastic:
        expected = hhr.FullOrderModel(made, MPI.COMM_SELF).solve(1.0)
    assert elastic
    scene = replace(made, bodies=(one, replace(other, law=hhr.Plasticity(1e6, 1.0))))
    with pytest.warns(UndeterminedWarning, match="neither loads nor contact determine"):
        (answer,) = (
            hhr.FullOrderModel(scene, MPI.COMM_SELF)
            .march([(0.0, [1.0]), (1.0, [1.0])], TIGHT)
            .answers
        )
    assert answer.undetermined.shape[1] == expected.undetermined.shape[1]


@needs("nodal_loads", "contact_laws")
def test_a_loose_block_wears_a_floor(monkeypatch):
    """The template of a law that solves for no motions by itself does by its range: depth =
    constant p t, by hand.
    """
    import my_contact_law

    every = {**registry.installed(), "my_contact_law": my_contact_law.PLUGIN}
    monkeypatch.setattr(registry, "installed", lambda: every)
    for name in ("facet", "memories"):
        monkeypatch.setattr(registry, name, cache(getattr(registry, name).__wrapped__))
    made = block_on_a_floor(None, held=False)
    made = replace(made, contacts=(replace(made.contacts[0], law=my_contact_law.Wear(0.001)),))
    full = hhr.FullOrderModel(made, MPI.COMM_SELF)
    condensed = hhr.condense(full, fields=True)
    for model in (full, condensed):
        found = model.march([(0.0, [1.0]), (1.0, [4.0]), (3.0, [4.0]), (7.0, [9.0])]).answers
        for answer, pressure, worn in zip(found, (4.0, 4.0, 9.0), (4.0, 12.0, 48.0), strict=True):
            assert answer.forces() == pytest.approx(pressure * full.problem.contact_areas, rel=1e-9)
            assert answer.memory["worn"] == pytest.approx(0.001 * worn, rel=1e-9)
            # the block sinks by what it wears: its side on the floor is straight
            sunk = full.problem.contact @ answer.displacement()
            assert sunk == pytest.approx(answer.memory["worn"], rel=1e-8)


@needs("moduli", "systems")
def test_a_foundation_that_may_vanish():
    """At k = 0 it holds no body and K is singular: S grows without limit there, and nothing
    interpolates it.
    """
    made = replace(lying(parameters=space(p=(1.0, 10.0), k=(0.0, 0.5))), system=Parted)
    full = hhr.FullOrderModel(made, MPI.COMM_SELF)
    assert full.solve([4.0, 0.1]).converged
    with pytest.raises(
        NotSolvableError,
        match=r"k = 0 nothing but contact holds body 2 .* moves along axis 1.* Narrow the box",
    ):
        hhr.condense(full)
    narrow = replace(made, parameters=space(p=(1.0, 10.0), k=(0.1, 0.5)))
    model = hhr.condense(narrow)
    answer = model.solve([4.0, 0.2])
    expected = hhr.FullOrderModel(narrow, MPI.COMM_SELF).solve([4.0, 0.2]).forces()
    assert answer.forces() == pytest.approx(expected, abs=1e-5 * expected.max())


@needs("moduli")
@pytest.mark.parametrize(
    "moduli", [("E", 0.3), (1000.0, "0.25 + E / 10000")], ids=["young", "poisson"]
)
def test_condensed_moduli(moduli, tmp_path):
    """Forces, displacement and gradients are those of the full model.

    A factor is exact, and the rest interpolated.
    """
    made = lying(cells=(8, 4), tilt=0.2, parameters=space(p=(1.0, 10.0), E=(500.0, 2000.0)))
    lower, upper = made.bodies
    made = replace(made, bodies=(lower, replace(upper, young=moduli[0], poisson=moduli[1])))
    full = hhr.FullOrderModel(made, MPI.COMM_SELF)
    model = hhr.condense(full, fields=True)
    hhr.save_model(tmp_path / "model.npz", model)
    again = hhr.load_model(tmp_path / "model.npz")
    exact = 1e-9 if moduli[0] == "E" else 1e-5
    for point in full.parameters.random(6, seed=2):
        found, expected = model.solve(point), full.solve(point)
        assert np.linalg.norm(found.forces() - expected.forces()) < exact * np.linalg.norm(
            expected.forces()
        )
        moved = expected.displacement()
        assert np.linalg.norm(found.displacement() - moved) < 10 * max(
            exact, 1e-7
        ) * np.linalg.norm(moved)
        assert found.forces().sum() == pytest.approx(point[0] + 0.2 * 0.95, rel=1e-10)
        assert np.array_equal(again.solve(point).multipliers, found.multipliers)
    assert slope_errors(model, [5.0, 900.0], step=1e-4).max() < 1e-5


@needs("shapes", "moduli")
def test_beside_a_shape(tmp_path):
    """On the mesh of a shape the answer is that of a scene with this mesh.

    A body that changes itself is refused.
    """
    crowned = hhr.Shape(blocks.LOWER_BLOCK, ("x", "y * (1 + c * (x - 0.5)**2)"))
    made = lying(
        cells=(6, 3), tilt=0.2, parameters=space(p=(1.0, 10.0), c=(-0.02, 0.02)), shapes=(crowned,)
    )
    full = hhr.FullOrderModel(made, MPI.COMM_SELF)
    model = hhr.condense(full, fields=True)
    for point in ([3.0, 0.015], [8.0, -0.01]):
        expected = hhr.FullOrderModel(meshed(made, point), MPI.COMM_SELF).solve(point)
        for one, tolerance in ((full, 1e-9), (model, 1e-4)):
            found = one.solve(point)
            assert found.forces() == pytest.approx(
                expected.forces(), abs=tolerance * expected.forces().max()
            )
            moved = expected.displacement()
            assert np.abs(found.displacement() - moved).max() < 10 * tolerance * np.abs(moved).max()
            assert found.forces().sum() == pytest.approx(point[0] + 0.2 * 0.95, rel=1e-10)
    assert slope_errors(full, [5.0, 0.01], step=1e-4).max() < 1e-5
    itself = replace(made, shapes=(hhr.Shape(blocks.UPPER_BLOCK, ("x", "y * (1 + 0.1 * c)")),))
    with pytest.raises(
        SceneError, match=r"contacts that alone hold a body .* for bodies that keep their shape"
    ):
        hhr.FullOrderModel(itself, MPI.COMM_SELF)
