"""A pairing and a law of a user's own, one new file each, from the scene to the model on disk."""

import dataclasses

import numpy as np
import pytest
from needs import needs
from scenes import block_scene, check_contact_conditions, pressed_block, slope
from toy_law import Bingham
from toy_pairing import RoundPunch

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import relative_error
from hhr_dolfinx.errors import PairingWarning
from hhr_dolfinx.geometries import block

RADIUS, CENTRE = 1.5, {"plane_strain": (0.3, 2.51), "solid": (0.3, 0.3, 2.51)}
"""The lid is at 1, so that the punch hangs 0.01 above it."""


def punched(hypothesis, cells):
    """A block of height 1, held at its bottom, which rises by ``rise`` towards a punch whose radius
    grows by ``swell``.

    The radius enters all gaps alike, hence the opening; the rise changes each of them by its own
    normal.
    """
    dim, centre = len(cells), CENTRE[hypothesis]
    bottom, lid = (block.side(dim - 1, upper) for upper in (False, True))
    rise = hhr.Displacement(bottom, dim - 1, slope("rise"))
    return block_scene(
        "punched",
        {"rise": (0.02, 0.1), "swell": (0.0, 0.04)},
        lower=(0.0,) * dim,
        upper=(2.0,) * (dim - 1) + (1.0,),
        cells=cells,
        young=3.0,
        hypothesis=hypothesis,
        contacts=(RoundPunch(lid, centre, RADIUS),),
        displacements=(*(hhr.Displacement(bottom, axis) for axis in range(dim - 1)), rise),
        openings=(hhr.Opening(0, slope("swell", -1.0)),),
    )


@pytest.fixture(
    scope="module", params=[("plane_strain", (60, 12)), ("solid", (12, 12, 4))], ids=lambda p: p[0]
)
def pressed(request):
    """Full-order model of the block under a disc and under a ball."""
    return hhr.FullOrderModel(punched(*request.param))


def test_nodes_in_contact_lie_on_the_punch(pressed):
    """By distances in the deformed state, without a row or a gap of the pairing.

    With d = |x - c| and u = a n + t, t tangential, |x + u - c|² = (d - a)² + t². So a <= d - R
    keeps every node out of the punch exactly, and equality leaves it R + t² / 2R off the centre at
    most: bounds up to round-off.
    """
    problem, centre = pressed.problem, np.array(CENTRE[pressed.scene.hypothesis])
    ways = centre - problem.contact_points
    normals = ways / np.linalg.norm(ways, axis=1, keepdims=True)
    touching = set()
    for rise, swell in problem.parameters.grid([3, 3]):
        solution = pressed.solve({"rise": rise, "swell": swell})
        check_contact_conditions(problem, solution.displacement(), solution.forces(), [rise, swell])
        moved = solution.displacement().reshape(problem.points.shape)[problem.contact_slaves]
        tangential = moved - np.einsum("md,md->m", moved, normals)[:, None] * normals
        off = np.linalg.norm(ways - moved, axis=1) - RADIUS - swell
        most = np.sum(tangential**2, axis=1) / (2 * (RADIUS + swell))
        assert off.min() >= -1e-13
        assert (off <= most + 1e-13)[solution.active].all() and (solution.forces() > 0)[
            solution.active
        ].all()
        touching.add(int(solution.active.sum()))
    assert len(touching) > 4 and 0 < min(touching) and max(touching) < len(normals) / 2


def test_reduced_model_of_the_punch(pressed, tmp_path):
    """From snapshots to the file: answers at points neither trained on nor held out, and the same
    ones from disk.
    """
    problem = pressed.problem
    sets = (problem.parameters.grid([5, 5]), problem.parameters.random(8, seed=1))
    snapshots, held_out = (hhr.compute_snapshots(pressed, points) for points in sets)
    reduction = hhr.build(pressed, snapshots, held_out=held_out)
    rid = reduction.offline.sets
    assert (
        len(rid.cells) < len(problem.cell_nodes) / 2
        and len(rid.A_lambda) < problem.contact.shape[0] / 2
    )
    hhr.save_model(tmp_path / "punch.npz", reduction)
    stored = hhr.load_model(tmp_path / "punch.npz")
    for point in problem.parameters.random(20, seed=2):
        exact, answer = pressed.solve(point), reduction.solve(point)
        # measured at worst, with the disc: 1.4e-4 and 0.7 %, between training points; round-off at
        # half of the points
        assert relative_error(answer.displacement(), exact.displacement()) < 5e-4
        assert relative_error(answer.multipliers, exact.forces()[rid.A_lambda]) < 0.02
        assert relative_error(answer.forces(), exact.forces()) < 0.02
        read = stored.solve(point)
        # round-off: a file answers by LAPACK, a model that was built by PETSc
        assert np.abs(read.forces() - answer.forces()).max() < 1e-11 * max(
            answer.forces().max(), exact.forces().max()
        )


def test_a_punch_deep_in_the_body_is_named():
    scene = punched("plane_strain", (4, 2))
    deep = dataclasses.replace(scene.contacts[0], radius=2.2)
    with pytest.warns(PairingWarning, match=r"overlap at surface 21 .*\(0\.67.*at \[0\.(5|49)"):
        hhr.FullOrderModel(dataclasses.replace(scene, contacts=(deep,)))


@needs("inelastic")
@pytest.mark.parametrize("hypothesis", ["axisymmetric", "solid"])
def test_stress_relaxes_to_the_threshold(hypothesis):
    """A block pressed on the floor at once and held: uniaxial stress, with contact forces from the
    floor.

    At a held axial strain ε the stress is E (ε - εp), and a step flows by Δp = dt (σ - σ0) / η. So
    it loses E Δp: σ - σ0 is divided by 1 + E dt / η in each step, from E ε - σ0 on. To round-off,
    1e-13 was seen.
    """
    young, threshold, viscosity, push, up = 3.0, 0.05, 2.0, 0.1, 2 if hypothesis == "solid" else 1
    body = hhr.Body(block.SOLID, young, 0.3, Bingham(threshold, viscosity))
    full = hhr.FullOrderModel(
        dataclasses.replace(pressed_block(hypothesis, cells=2), bodies=(body,))
    )
    times = np.array([0.0, 1.0, 2.0, 3.0, 5.0, 9.0, 20.0, 40.0])
    path = [(time, np.array([push if time else 0.0])) for time in times]
    history = full.march(path, hhr.MarchSettings(relative_force=1e-12, floor_stress=1e-13))
    assert history.cuts == 0, "parts of a step would flow otherwise"
    over = (young * (push - 0.01) / 2 - threshold) / np.cumprod(
        1 + young * np.diff(times) / viscosity
    )
    assert over[0] > 0.5 * threshold and over[-1] < 1e-5 * threshold
    area = full.problem.contact_areas.sum()
    for point, excess in zip(history.answers, over, strict=True):
        assert -point.stress()[:, up] == pytest.approx(threshold + excess, abs=1e-12)
        assert point.stress()[:, :up] == pytest.approx(0.0, abs=1e-12)
        assert point.forces().sum() == pytest.approx((threshold + excess) * area, abs=1e-12)
