"""Contact with friction of bodies that flow: full order and hyper-reduced."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from mpi4py import MPI
from needs import needs
from sheared_blocks import FIRST, SECOND, round_block, rubbing
from sheared_paths import BOX, OUTPUTS, paths, resultants

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import FarSlidingWarning, NotOfferedError
from hhr_dolfinx.plugins.inelastic.condense_flow import CorrectionSettings
from hhr_dolfinx.plugins.inelastic.equilibrium import Goal
from hhr_dolfinx.plugins.inelastic.state import flowed

PATH = [
    (0.0, (0.0, 0.0)),
    (1.0, (0.01, 0.0)),
    (2.0, (0.02, 0.02)),
    (3.0, (0.03, 0.06)),
    (4.0, (0.02, 0.0)),
    (5.0, (0.0, -0.02)),
    (6.0, (0.03, 0.03)),
]
"""Pressed, sheared, turned round, opened, and pressed again."""


LIMITS = hhr.FlowLimits.of_histories(warn_plastic=0.3, warn_estimate=0.1)
"""At the edge of contact a few points flow by strains that eight histories tell to 14 to 20 %,
whatever the model.
"""


def bodies(yield_stress: float) -> tuple[hhr.Body, ...]:
    """Of which the upper one flows."""
    return hhr.Body(FIRST, 3.0, 0.3), hhr.Body(SECOND, 5.0, 0.2, hhr.Plasticity(yield_stress, 0.5))


def test_where_nothing_yields_it_is_friction_of_elastic_bodies():
    """Nearly incompressible, so that elastic bodies too take the mean dilatation: S is the same."""
    elastic, plastic = (
        hhr.FullOrderModel(
            rubbing(0.3, bodies=(hhr.Body(FIRST, 3.0, 0.46), hhr.Body(SECOND, 5.0, 0.46, law))),
            MPI.COMM_SELF,
        )
        for law in (None, hhr.Plasticity(1e6, 0.5))
    )
    for found, one in zip(plastic.march(PATH).answers, elastic.march(PATH).answers, strict=True):
        np.testing.assert_allclose(
            found.multipliers, one.multipliers, atol=1e-9 * np.abs(plastic.schur).max()
        )
        pressed = one.slip.pressure > 1e-6 * elastic.problem.contact_areas[elastic.law.normal]
        np.testing.assert_array_equal(found.slip.statuses[pressed], one.slip.statuses[pressed])
        np.testing.assert_allclose(found.slip.work, one.slip.work, atol=1e-12)


def test_all_searches_find_the_same():
    """Newton's method, old tangents and the elastic operator, to the tolerance of steps.

    1e-9 was measured.
    """
    full = hhr.FullOrderModel(rubbing(0.3, bodies=bodies(0.08)), MPI.COMM_SELF)
    tight = {
        "relative_stress": 1e-8,
        "floor_stress": 1e-8,
        "relative_force": 1e-8,
        "iterations": 200,
    }
    found = [
        full.march(PATH, hhr.MarchSettings(search=search, **tight))
        for search in ("tangent", "frozen", "elastic")
    ]
    assert found[0].answers[-1].plastic_strain().max() > 0.01
    assert {1, 2} <= set(
        np.concatenate([answer.slip.statuses for answer in found[0].answers]).tolist()
    )
    for other in found[1:]:
        for one, two in zip(found[0].answers, other.answers, strict=True):
            np.testing.assert_allclose(
                two.multipliers, one.multipliers, atol=1e-7 * np.abs(one.multipliers).max()
            )
            np.testing.assert_array_equal(two.slip.statuses, one.slip.statuses)
            np.testing.assert_allclose(two.slip.path, one.slip.path, atol=1e-8)


def test_friction_of_a_single_parameter_is_that_of_the_point():
    """Parts of a step that is cut have the coefficient of its end, and none is outside what was
    trained.
    """
    box = {"f": (0.0, 0.6)}
    creeping = hhr.Body(FIRST, 3.0, 0.3), hhr.Body(SECOND, 5.0, 0.2, hhr.Norton(0.05, 5.0))
    named, plain = (
        hhr.FullOrderModel(rubbing(law, bodies=creeping, box=own), MPI.COMM_SELF)
        for law, own in (("f", box), (0.3, {}))
    )
    point = (0.02, 0.05)
    one = named.solve((*point, 0.3), duration=1e4)
    other = plain.solve(point, duration=1e4)
    assert one.parts == other.parts > 1
    np.testing.assert_allclose(one.slip.work, other.slip.work, rtol=1e-9, atol=1e-15)
    assert np.isnan(plain.coupling(point))


def test_what_slips_as_a_whole_bears_coulomb_however_it_flows():
    """In one step as in small ones; 4e-4 of forces and 9e-4 of slip were measured."""
    full = hhr.FullOrderModel(rubbing(0.1, bodies=bodies(0.06)), MPI.COMM_SELF)
    pressed = [(0.0, (0.0, 0.0)), (1.0, (0.03, 0.0))]
    coarse, fine = (
        full.march(
            [*pressed, *((1 + k / steps, (0.03, 0.1 * k / steps)) for k in range(1, steps + 1))]
        ).answers[-1]
        for steps in (1, 10)
    )
    for answer in (coarse, fine):
        assert answer.plastic_strain().max() > 0.005 and set(answer.slip.statuses.tolist()) == {2}
        pressure, shear = resultants(full, answer)
        assert shear == pytest.approx(0.1 * pressure, rel=1e-9)
    assert pressure == pytest.approx(resultants(full, coarse)[0], rel=2e-3)
    assert coarse.slip.path.sum() == pytest.approx(fine.slip.path.sum(), rel=4e-3)


@pytest.fixture(scope="module")
def training():
    scene = rubbing(
        "f",
        geometry=round_block,
        box=BOX | {"shear": (-0.05, 0.05)},
        outputs=OUTPUTS,
        bodies=bodies(0.1),
    )
    every = paths(10, 1, scene.parameters)
    return hhr.train(scene, every[:8], held_out=every[8:])


@pytest.fixture(scope="module")
def model(training):
    return training.build(hhr.Recipe.flowing(trust=LIMITS))


@pytest.fixture(scope="module")
def condensed(training):
    return training.condense(CorrectionSettings(trust=LIMITS))


@pytest.mark.parametrize(
    ("kind", "count", "off", "off_in_work"),
    [
        pytest.param("model", 3, 0.02, 0.01, marks=needs("exact_errors")),
        ("condensed", 4, 0.003, 0.005),
    ],
)
def test_unseen_paths(training, kind, count, off, off_in_work, request):
    """Measured: .9 and .4 %, condensed .15 and .24 %.

    Where a contact opens within a step its path is 4 % off.
    """
    full, model = training.full_order, request.getfixturevalue(kind)
    assert flowed(training.snapshots)
    assert len(model.problem.stiffness) < 120 if kind == "model" else model.equilibrium.modes < 40
    for path in paths(count, 33, full.parameters):
        exact, found = full.march(path), model.march(path)
        largest = max(np.linalg.norm(answer.forces()) for answer in exact.answers)
        longest = exact.answers[-1].slip.path.max()
        for one, other in zip(exact.answers, found.answers, strict=True):
            assert np.linalg.norm(other.forces() - one.forces()) < off * largest
            if kind == "condensed":
                assert np.abs(other.slip.path - one.slip.path).max() < 0.06 * longest
        last, ours = exact.answers[-1], found.answers[-1]
        assert np.linalg.norm(ours.slip.work - last.slip.work) < off_in_work * np.linalg.norm(
            last.slip.work
        )
        if kind == "model":
            for name in ("normal", "shear", "slip", "work"):
                assert ours.outputs()[name] == pytest.approx(last.outputs()[name], rel=0.02)
        else:
            assert ours.plastic_strain().max() == pytest.approx(
                last.plastic_strain().max(), rel=0.03, abs=1e-6
            )
        assert ours.estimate().kind == "indicator of the stress"


def test_condensed_flow_of_its_training_is_the_full_order(training, condensed):
    """Of four of eight histories the forces.

    Modes and points are those of all of them. 1e-5 was measured.
    """
    for history in training.snapshots.histories[:4]:
        largest = max(np.linalg.norm(answer.forces()) for answer in history.answers)
        for one, other in zip(history.answers, condensed.march(history.path).answers, strict=True):
            np.testing.assert_allclose(other.forces(), one.forces(), atol=1e-4 * largest)


def test_newtons_slope_is_that_of_the_residual(condensed):
    """Where bodies flow and contacts stick and slip: else steps would take many iterations."""
    equilibrium = condensed.equilibrium
    answers = condensed.march(paths(1, 37, condensed.parameters)[0]).answers
    before, here = next(
        (one, other)
        for one, other in itertools.pairwise(answers)
        if other.slip.statuses.max() == 2
        and other.plastic_strain().max() > one.plastic_strain().max() + 1e-4
    )
    stepper = equilibrium.stepper(hhr.MarchSettings())
    load = stepper.load(before, Goal(before.time + 1.0, here.parameter))
    correction = here.unknown[: equilibrium.modes]
    at = stepper.tried(load, correction, here.active)
    slope = stepper.slope(load, at)
    step = 1e-6 * np.linalg.norm(correction)
    for axis in range(0, equilibrium.modes, 5):
        shift = step * (np.arange(equilibrium.modes) == axis)
        sides = [stepper.tried(load, correction + s * shift, at.found.active) for s in (-1, 1)]
        difference = (sides[1].residual - sides[0].residual) / (2 * step)
        np.testing.assert_allclose(-slope[:, axis], difference, atol=1e-3 * np.abs(slope).max())


SHARP = {
    "relative_stress": 1e-11,
    "floor_stress": 1e-11,
    "relative_force": 1e-11,
    "iterations": 200,
    "outside": "ignore",
}


@pytest.mark.parametrize("kind", ["full", "model", "condensed"])
def test_derivatives_of_histories_that_flow_and_rub(kind, request):
    """Central differences of whole histories in which no status changes, along loads and the
    coefficient.

    Histories are solved to 1e-11, and parameters change by 1e-6: 2e-9 of the largest derivative was
    measured. Contacts slip, stick again and open: what slipped before has a derivative too.
    """
    if kind == "full":
        one = hhr.FullOrderModel(
            rubbing("f", bodies=bodies(0.08), box=BOX, outputs=OUTPUTS), MPI.COMM_SELF
        )
    else:
        one = request.getfixturevalue(kind)
    corners = [
        np.array([push + 0.002, (0.4 if kind == "model" else 0.8) * shear + 0.001, 0.3])
        for _, (push, shear) in PATH
    ]
    parts = 2 if kind == "model" else 1
    times = np.arange((len(corners) - 1) * parts + 1) / parts
    path = [
        (
            time,
            np.array(
                [np.interp(time, range(len(corners)), part) for part in np.transpose(corners)]
            ),
        )
        for time in times
    ]
    how = {"search": "frozen" if kind == "model" else "tangent"} | SHARP
    history = one.march(path, hhr.MarchSettings(gradient=True, **how))
    assert history.cuts == 0
    step = 1e-6
    for axis in range(3):
        shift = step * (np.arange(3) == axis)
        sides = [
            one.march(
                [(time, point + sign * shift) for time, point in path], hhr.MarchSettings(**how)
            ).answers
            for sign in (1, -1)
        ]
        for answer, more, less in zip(history.answers, *sides, strict=True):
            np.testing.assert_array_equal(more.slip.statuses, less.slip.statuses)
            difference = (more.multipliers - less.multipliers) / (2 * step)
            found = answer.gradient.multipliers[:, axis]
            size = max(np.abs(difference).max(), 1e-3 * np.abs(answer.multipliers).max())
            np.testing.assert_allclose(found, difference, rtol=0, atol=1e-5 * size)
            for name in ("normal", "shear"):
                slope = (more.outputs()[name] - less.outputs()[name]) / (2 * step)
                assert answer.outputs().gradient[name][axis] == pytest.approx(
                    slope, rel=1e-5, abs=1e-5 * size + 1e-9
                )
    counts = [answer.slip.statuses for answer in history.answers]
    assert {0, 1, 2} == set(np.concatenate(counts).tolist())
    assert any(((one == 2) & (other == 1)).any() for one, other in itertools.pairwise(counts))


def test_a_file_of_condensed_flow_keeps_it(condensed, tmp_path):
    hhr.save_model(tmp_path / "model.npz", condensed)
    read, path = hhr.load_model(tmp_path / "model.npz"), paths(1, 35, condensed.parameters)[0]
    for one, other in zip(condensed.march(path).answers, read.march(path).answers, strict=True):
        np.testing.assert_allclose(other.forces(), one.forces(), atol=1e-9 * one.forces().max())
        np.testing.assert_allclose(other.slip.work, one.slip.work, atol=1e-12)


def test_what_slides_far_is_told_of():
    full = hhr.FullOrderModel(
        rubbing(0.1, bodies=bodies(1e6), box={"shear": (-0.4, 0.4)}), MPI.COMM_SELF
    )
    with pytest.warns(FarSlidingWarning, match="contact .* has slid by") as caught:
        full.march([(0.0, (0.0, 0.0)), (1.0, (0.01, 0.0)), (2.0, (0.01, 0.2)), (3.0, (0.01, 0.4))])
    assert len([item for item in caught if item.category is FarSlidingWarning]) == 1


@needs("exact_errors", "local_models")
def test_what_is_not_built_in_is_refused_by_name(training, model, condensed):
    path = paths(1, 37, model.parameters)[0]
    for one in (training.full_order, model, condensed):
        with pytest.raises(
            NotOfferedError, match="limit of small increments are not built in where bodies flow"
        ):
            one.march(path, hhr.MarchSettings(gradient=True, limit=True))
    with pytest.raises(NotOfferedError, match="one model of these histories"):
        training.local([np.zeros(24, dtype=int)] * 8)
