"""Condensed models of bodies with laws that contact alone holds: motions are unknowns beside
corrections and forces.
"""

from dataclasses import replace

import numpy as np
import pytest
from history_bits import flat, marched_elsewhere
from loose_blocks import BOTH, HELD, LAWS, LOOSE, PATH, TIGHT, block_on_a_floor, flowing
from mpi4py import MPI
from needs import needs
from scenes import lying, slope, space

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import UndeterminedWarning
from hhr_dolfinx.geometries import stacked_blocks as blocks
from hhr_dolfinx.plugins.inelastic import condense_flow
from hhr_dolfinx.plugins.inelastic.condense_flow import CorrectionSettings

pytestmark = [
    needs("inelastic"),
    pytest.mark.filterwarnings("ignore:body 2 .* moves along axis 0"),
    pytest.mark.filterwarnings("ignore:parameters .* have no effect"),
]
WHOLE = CorrectionSettings(modes=1e-9, cubature=1e-9, stability=1e-4, attempts=1, trust=None)
"""Settings that leave nothing out, where the compression of training states does not either."""
FINE = hhr.MarchSettings(outside="ignore", relative_force=1e-11)
CYCLE = [*PATH, (4.0, np.array([0.8])), (5.0, np.array([10.0])), (6.0, np.array([0.6]))]
"""Loaded, unloaded until contacts open, loaded by more, and unloaded."""


def scaled(path, share):
    return [(time, share * point) for time, point in path]


@pytest.fixture(autouse=True)
def _all_states(monkeypatch):
    """The compression of training states leaves 1e-4 of their norm out otherwise."""
    monkeypatch.setattr(condense_flow, "ALIKE_MODES", 1e-9)


def condensed(full, histories):
    return hhr.build(full, hhr.SnapshotSet.of_histories(histories), WHOLE)


def far(one, other, name):
    """Largest distance of a field along histories, over its largest value there."""
    pairs = [(getattr(a, name)(), getattr(b, name)()) for a, b in zip(one, other, strict=True)]
    return max(np.abs(a - b).max() for a, b in pairs) / max(np.abs(b).max() for _, b in pairs)


@needs("nodal_loads")
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("which", [HELD, LOOSE, BOTH], ids=["held", "loose", "both"])
def test_histories_of_the_training_are_those_of_the_full_model(law, which, tmp_path):
    """Contacts open and close; forces and their moment balance the loads to round-off, as written
    down here.

    A model that leaves nothing out answers the histories it was trained on to the tolerances of the
    steps. Stress is completed from modes of the inelastic strain, which leave 1e-8 of its squares
    out. A file gives the same bits.
    """
    full = hhr.FullOrderModel(flowing(law, which), MPI.COMM_SELF)
    assert full.problem.kernel.motions.shape[1] == 2
    histories = [full.march(scaled(CYCLE, share), TIGHT) for share in (1.0, 1.1)]
    model = condensed(full, histories)
    hhr.save_model(tmp_path / "model.npz", model)
    again = hhr.load_model(tmp_path / "model.npz")
    places = full.problem.contact_points[:, 0]
    for share, history in zip((1.0, 1.1), histories, strict=True):
        path = scaled(CYCLE, share)
        found = model.march(path, FINE).answers
        for name in ("forces", "displacement"):
            assert far(found, history.answers, name) < 1e-7, name
        assert far(found, history.answers, "stress") < 1e-4
        for (_, point), answer, expected in zip(path[1:], found, history.answers, strict=True):
            assert np.array_equal(answer.active, expected.active) and answer.undetermined is None
            forces = answer.forces()
            assert forces.sum() == pytest.approx(point[0] + 0.2 * (1 - 0.05), rel=1e-10)
            assert places @ forces == pytest.approx(0.5 * point[0], rel=1e-10)
        statuses = np.array([answer.active for answer in found])
        opened, closed = statuses[:-1] & ~statuses[1:], ~statuses[:-1] & statuses[1:]
        assert opened.any() and closed.any()
        for answer, other in zip(found, again.march(path, FINE).answers, strict=True):
            assert answer.unknown.tobytes() == other.unknown.tobytes()
            assert answer.displacement().tobytes() == other.displacement().tobytes()


@needs("nodal_loads")
@pytest.mark.parametrize("law", LAWS)
def test_the_mesh_is_in_balance(law):
    """What the model hands out is put on the mesh, and balances there without any model of it.

    The laws of all Gauss points are updated by the strain of its displacement, step by step, so
    that errors add up; the internal forces of their stress are loads and contact forces to 1e-6 of
    the sum of their sizes.
    """
    full = hhr.FullOrderModel(flowing(law, BOTH), MPI.COMM_SELF)
    model = condensed(full, [full.march(scaled(CYCLE, share), TIGHT) for share in (0.9, 1.1)])
    path = scaled(CYCLE, 0.9)
    equilibrium = full.equilibrium
    state = equilibrium.material.at_rest()
    for (before, _), (time, point), answer in zip(
        path, path[1:], model.march(path, FINE).answers, strict=False
    ):
        field = answer.displacement() - full.problem.lifts @ full.problem.amplitudes(point)
        theta = full.problem.amplitudes(point)
        update = equilibrium.material.at(point).update(
            equilibrium.strain(field, theta), state, time - before, tangent=False
        )
        residual, sizes = equilibrium.residual(field, update, theta)
        left = residual - full.problem.contact.T @ answer.forces()
        assert np.linalg.norm(left) < 1e-6 * np.linalg.norm(sizes)
        state = update.state


@needs("nodal_loads")
@pytest.mark.parametrize("law", LAWS)
def test_a_loose_block_flows_under_a_pressure(law):
    """By hand: the stress is -p across and zero along, and each node of the side on the floor bears
    the pressure.
    """
    full = hhr.FullOrderModel(block_on_a_floor(LAWS[law](), held=False), MPI.COMM_SELF)
    model = condensed(full, [full.march(scaled(PATH, share), TIGHT) for share in (1.0, 1.1)])
    for (_, point), answer in zip(PATH[1:], model.march(PATH, FINE).answers, strict=True):
        assert answer.forces() == pytest.approx(point[0] * full.problem.contact_areas, rel=1e-8)
        stress = answer.stress()[np.abs(answer.stress()).max(axis=1) > 1e-6]
        assert (
            stress[:, 1] == pytest.approx(-point[0], rel=1e-6)
            and np.abs(stress[:, 0]).max() < 1e-6 * point[0]
        )


@needs("nodal_loads")
def test_a_body_without_strain_converges_beside_round_off_of_the_others(monkeypatch):
    """The floor is held at all its nodes: its forces are round-off of those of the block, and
    differ in each iteration where sums of matrices have another order. Noise of that size stands
    for it.
    """
    full = hhr.FullOrderModel(block_on_a_floor(LAWS["creep"](), held=False), MPI.COMM_SELF)
    noise = np.random.default_rng(5)
    exact = full.equilibrium.contact_load

    def noisy(forces):
        load = exact(forces)
        return load + 1e-17 * np.abs(load).max() * noise.standard_normal(load.shape)

    expected = full.march(PATH, TIGHT).answers
    monkeypatch.setattr(type(full.equilibrium), "contact_load", lambda self, forces: noisy(forces))
    assert far(full.march(PATH, TIGHT).answers, expected, "forces") < 1e-10


def rubbing():
    """The loose block pushed aside, which friction bears."""
    made = flowing("plasticity", BOTH)
    surfaces = (blocks.interface(body, 2) for body in (blocks.LOWER_BLOCK, blocks.UPPER_BLOCK))
    pressed = hhr.Traction(blocks.outer_end(blocks.UPPER_BLOCK, 2), (0.15, -1.0), slope("p"))
    pair = hhr.NodeToNode(*surfaces, (0.0, 1.0), friction=0.4)
    return replace(made, contacts=(pair,), loads=(pressed, made.loads[1]))


def soft():
    """Young's modulus of the loose block is a parameter: its motions do not depend on it."""
    made = flowing("plasticity", BOTH, parameters=space(p=(0.5, 12.0), E=(500.0, 2000.0)))
    lower, upper = made.bodies
    return replace(made, bodies=(lower, replace(upper, young="E")))


SCENES = {
    "plasticity": lambda: flowing("plasticity", BOTH),
    "creep": lambda: flowing("creep", LOOSE),
    "young": soft,
    "friction": rubbing,
}


@pytest.mark.parametrize(
    "name",
    [pytest.param(one, marks=needs("friction")) if one == "friction" else one for one in SCENES],
)
def test_gradients_are_those_of_differences(name):
    """Of the full and of the condensed model, along shifts of the whole path, on the same statuses
    on both sides.

    Differences over 1e-5 of the parameters are off by the square of that, and by the tolerance of
    the steps over it.
    """
    full = hhr.FullOrderModel(SCENES[name](), MPI.COMM_SELF)
    young = (1200.0,) if name == "young" else ()
    path = [(time, np.array([*point, *young])) for time, point in PATH]
    ways = [np.array([share, *(1.0 for _ in young)]) for share in (1.0, 1.1)]
    model = condensed(full, [full.march([(t, way * p) for t, p in path], TIGHT) for way in ways])
    assert (
        far(model.march(path, FINE).answers, full.march(path, TIGHT).answers, "displacement") < 1e-6
    )
    for one, settings in ((full, TIGHT), (model, FINE)):
        answers = one.march(path, replace(settings, gradient=True)).answers
        for axis, shift in enumerate(1e-5 * np.diag(path[-1][1])):
            ends = [
                one.march([(t, p + sign * shift) for t, p in path], settings).answers
                for sign in (1.0, -1.0)
            ]
            for answer, above, below in zip(answers, *ends, strict=True):
                assert np.array_equal(above.active, below.active)
                for read in ("multipliers", "unknown"):
                    difference = (getattr(above, read) - getattr(below, read)) / (2 * shift[axis])
                    found = getattr(answer.gradient, read)[:, axis]
                    # forces on two nodes are those of balance, whatever the modulus
                    least = 1e-8 * np.abs(getattr(answer, read)).max() / abs(path[-1][1][axis])
                    assert (
                        np.abs(found - difference).max() < 1e-4 * np.abs(difference).max() + least
                    ), (axis, read)


def test_a_file_answers_where_no_mesh_can_be_made(tmp_path):
    """In a process without DOLFINx, where the motions of the file are solved for as here."""
    full = hhr.FullOrderModel(flowing("creep", LOOSE), MPI.COMM_SELF)
    model = condensed(full, [full.march(scaled(PATH, share), TIGHT) for share in (1.0, 1.1)])
    hhr.save_model(tmp_path / "model.npz", model)
    path = scaled(PATH, 1.05)
    assert np.array_equal(
        marched_elsewhere(tmp_path / "model.npz", path, tmp_path), flat(model.march(path))
    )


def test_motions_that_nothing_determines_are_the_least():
    """A block on two nodes of a corner may turn: its least displacement has no part of that turn,
    in both models.

    The turn is free on both sides, so that the least is orthogonal to it.
    """
    made = lying(bulge=0.5, cells=(6, 3), parameters=space(p=(0.5, 12.0)))
    made = replace(
        made, bodies=tuple(replace(body, law=hhr.Norton(300.0, 3.0)) for body in made.bodies)
    )
    full = hhr.FullOrderModel(made, MPI.COMM_SELF)
    path = PATH[:3]
    with pytest.warns(UndeterminedWarning, match="neither loads nor contact determine"):
        histories = [full.march(scaled(path, share), TIGHT) for share in (1.0, 1.1)]
        model = condensed(full, histories)
    with pytest.warns(UndeterminedWarning, match="body 2 turns"):
        found = model.march(path, FINE).answers
    for answer, expected in zip(found, histories[0].answers, strict=True):
        for one in (answer, expected):
            assert one.undetermined.shape[1] == 1
            turned = (
                one._replace(unknown=one.unknown + one.undetermined[:, 0])
            ).displacement() - one.displacement()
            assert abs(turned @ one.displacement()) < 1e-9 * np.linalg.norm(one.displacement())
    assert far(found, histories[0].answers, "displacement") < 1e-6
    assert far(found, histories[0].answers, "forces") < 1e-6
