"""Reduced histories on paths that were not trained, and what a march refuses at its door."""

import dataclasses
import warnings

import numpy as np
import pellet_cladding_plastic as demo
import pytest
from flow_histories import legs
from flowing import DEMO_MESH as MESH
from scenes import block_scene, slope

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import relative_error
from hhr_dolfinx.errors import (
    OutsideTrainingError,
    OutsideTrainingWarning,
    ParameterError,
    ReductionError,
    StabilityWarning,
    UncheckedWarning,
    UnstableModelError,
)
from hhr_dolfinx.geometries import block
from hhr_dolfinx.models.answer import History
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.plugins.inelastic.law import program_of
from hhr_dolfinx.plugins.inelastic.recipe import FlowDeim, StressDeim
from hhr_dolfinx.plugins.inelastic.trained import Known, Signs, TrainedPaths, Watch
from hhr_dolfinx.plugins.inelastic.update import Group, Material
from hhr_dolfinx.plugins.paths.compared import largest_errors
from hhr_dolfinx.reduction import build as stages
from hhr_dolfinx.reduction.recipe import Deim, ForceDeim, LoadNodes, Pod, Rid, Zone

NODES = (Deim(), ForceDeim(1e-8), StressDeim(1e-9), FlowDeim(1e-6), Zone(demo.pressed_nodes))
RECIPE = hhr.Recipe.flowing(nodes=NODES)
"""As usual where bodies flow, with the pressed line for a zone."""
RAMP = np.arange(21) / 20
of = hhr.SnapshotSet.of_histories


@pytest.fixture(scope="module")
def reduction(demo_pellet):
    full, histories = demo_pellet
    return hhr.build(full, of(histories), RECIPE, of([full.march(demo.path(8.0, 20))]))


def outside_paths():
    """Paths by name that the demo's training does not hold."""
    down = np.concatenate([RAMP, 1 - RAMP[1:17]])
    yield "unloading", demo.history(np.arange(37) / 20, down, 10.0)
    yield (
        "hold of 10 s",
        demo.history(
            np.concatenate([RAMP, 1 + np.arange(1, 11)]), np.append(RAMP, np.ones(10)), 10.0
        ),
    )
    yield (
        "hold of 0.3 s",
        demo.history(np.append(RAMP, [1.1, 1.2, 1.3]), np.append(RAMP, np.ones(3)), 10.0),
    )
    yield "100 times slower", demo.history(100 * RAMP, RAMP, 10.0)
    yield "100 times faster", demo.history(RAMP / 100, RAMP, 10.0)
    yield "twice as slow", demo.history(2 * RAMP, RAMP, 10.0)
    for height in (0.6, 1.3):
        yield f"height {height}", demo.history(RAMP, RAMP, 10.0, height)


@pytest.mark.parametrize("path", [pytest.param(path, id=name) for name, path in outside_paths()])
def test_a_path_that_was_not_trained_is_warned_of(reduction, path):
    with pytest.warns(OutsideTrainingWarning):
        reduction.march(path, hhr.MarchSettings(cuts=2))


def test_a_refusal_keeps_the_history(reduction):
    path = demo.history(np.append(RAMP, 3.0), np.append(RAMP, 1.0), 10.0)
    with pytest.raises(
        OutsideTrainingError, match=r"step 21.*P1 changes by 0 per second \(trained 450"
    ) as caught:
        reduction.march(path, hhr.MarchSettings(outside="refuse"))
    assert len(caught.value.history.answers) == 20


@pytest.mark.parametrize("gap, steps", [(6.0, 20), (10.0, 20), (12.0, 10), (9.0, 60)])
def test_unseen_gaps_are_not_warned_of(demo_pellet, reduction, gap, steps):
    """Trained on the ends of the gap: the errors of the demo hold on a coarse mesh, and in the
    middle less.
    """
    full, training = demo_pellet
    with warnings.catch_warnings(action="error", category=OutsideTrainingWarning):
        found = reduction.march(demo.path(gap, steps))
    exact = full.march(demo.path(gap, steps))
    floor = 1e-3 * np.linalg.norm(training[0].answers[-1].forces())
    displacement, forces = largest_errors(full, found, exact, floor)
    assert displacement < 0.05 and forces < 0.2
    here, there, points = found.answers[-1], exact.answers[-1], reduction.equilibrium.points
    assert relative_error(here.displacement(), there.displacement()) < 0.02
    assert relative_error(here.multipliers, there.forces()[reduction.fields.A_lambda]) < 0.1
    assert relative_error(here.gauss.stress[:, 0], there.stress()[points][:, 0]) < 0.05
    assert relative_error(here.plastic_strain(), there.plastic_strain()) < 0.02
    assert (
        len(reduction.flow.cells) < len(full.problem.cell_nodes)
        and reduction.offline.further["tangent"] > 0
    )


def test_the_imbalance_alone_tells_of_a_path_inside_the_trained_rates(reduction):
    """Rates widened so that a hold counts as trained: the forces out of balance on A still tell,
    and end a history.
    """
    held = demo.history(
        np.concatenate([RAMP, 1 + np.arange(1, 11)]), np.append(RAMP, np.ones(10)), 10.0
    )
    rates = {"slowest": np.full(3, -1e9), "fastest": np.full(3, 1e9)}
    wide = reduction.changed(trained=dataclasses.replace(reduction.trained, **rates))
    with pytest.warns(OutsideTrainingWarning, match="out of balance"):
        wide.march(held)
    with pytest.raises(OutsideTrainingError, match=r"step (\d+)") as caught:
        wide.march(held, hhr.MarchSettings(outside="refuse"))
    number = int(str(caught.value).split()[1].rstrip(","))
    assert len(caught.value.history.answers) == number - 1


def test_an_imbalance_needs_no_unit_and_no_projection(demo_pellet, reduction):
    """In the full model it is the tolerance of the solver, in the reduced one what the modes leave
    on A.
    """
    full, histories = demo_pellet
    model = full.equilibrium
    sizes = [
        model.residual(step.unknown, step.state(), model.amplitudes(step.parameter))[1]
        for step in histories[0].answers
    ]
    largest = max(np.linalg.norm(size) for size in sizes)
    solved = max(sign.imbalance for sign in histories[0].signs)
    assert solved < 1e-4 * largest
    assert reduction.trained.imbalance > 10 * solved


def test_rates_and_places_in_words():
    space = ParameterSpace(("load", "gap"), (0.0, 0.0), (10.0, 1.0))
    paths = [
        [(0.0, np.array([0.0, gap])), (1.0, np.array([4.0, gap])), (2.0, np.array([10.0, gap]))]
        for gap in (0, 1)
    ]
    trained = TrainedPaths.of(paths, space, Known([[Signs(1.0, 10.0, 0.0)]], [], 1.0))
    here = np.array([4.0, 0.5])
    assert trained.complaint(1.0, here, np.array([9.0, 0.5])) == ""
    assert trained.complaint(0.1, here, np.array([4.4, 0.5])) == ""
    assert "load changes by 0 per second (trained 4 to 6)" in trained.complaint(1.0, here, here)
    assert "load changes by -1" in trained.complaint(1.0, here, np.array([3.0, 0.5]))
    assert "gap changes by 0.5" in trained.complaint(1.0, here, np.array([9.0, 1.0]))
    assert "load = 11" in trained.complaint(1.0, here, np.array([11.0, 0.5]))


def test_laws_without_rates_know_ways_and_no_paces():
    """Loaded at any pace, held, or taken back by a trained way; but no other way."""
    space = ParameterSpace(("load", "gap"), (0.0, 0.0), (10.0, 1.0))
    paths = [[(0.0, np.zeros(2)), (1.0, np.array([10.0, 1.0])), (2.0, np.array([0.0, 0.6]))]]
    trained = TrainedPaths.of(paths, space, Known([[Signs(1.0, 10.0, 0.0)]], [], 1.0), rated=False)
    here = np.array([4.0, 0.5])
    for seconds in (1e-3, 1.0, 1e3):
        assert trained.complaint(seconds, here, here + np.array([2.0, 0.2])) == ""
        assert trained.complaint(seconds, here, here - [2.0, 0.1]) == ""
        assert trained.complaint(seconds, here, here) == ""
        assert (
            "gap changes by -1.1 per whole range of what changes most (trained -0.44 to 1.1)"
            in trained.complaint(seconds, here, here - [0.0, 0.1])
        )
    rated = dataclasses.replace(
        trained, rated=True, slowest=np.array([-10.0, -0.4]), fastest=np.array([10.0, 1.0])
    )
    assert "load changes by 2000 per second" in rated.complaint(
        1e-3, here, here + np.array([2.0, 0.2])
    )


@pytest.mark.parametrize("law, rated", [(hhr.Plasticity(1.0), False), (hhr.Norton(1.0, 2.0), True)])
def test_materials_know_whether_they_have_rates(law, rated):
    assert Material([Group(np.arange(2), 1.0, 0.3, program_of(law, 4))], 4).rated is rated
    assert not Material([Group(np.arange(2), 1.0, 0.3, None)], 4).rated


def test_tangents_that_are_not_positive_refuse_a_model(demo_pellet):
    """Without growth the RID stays too small for its modes: refused, whatever the elastic operator
    looks like.
    """
    full, histories = demo_pellet
    nodes = (Deim(), ForceDeim(1e-2), StressDeim(1e-2), FlowDeim(1e-2), LoadNodes())
    small = hhr.Recipe.flowing(basis=Pod(1e-10), nodes=nodes, domain=Rid(0, 0))
    with pytest.raises(UnstableModelError, match="projected tangent at a training state"):
        hhr.build(full, of(histories), small)


def test_nothing_to_train_on(demo_pellet):
    for histories in ([], [History(0.0, np.zeros(3))]):
        with pytest.raises(ReductionError, match="at least one"):
            hhr.build(demo_pellet[0], of(histories))


def test_held_out_histories_decide(demo_pellet):
    """A held-out history that the model gets wrong refuses it, or is warned of, by its number."""
    full, histories = demo_pellet
    slower = of([full.march(demo.history(100 * RAMP, RAMP, 10.0))])
    limits = RECIPE.trust.of_histories(refuse_primal=10, refuse_dual=10, refuse_stress=10)
    with pytest.warns(StabilityWarning) as caught:
        hhr.build(full, of(histories), dataclasses.replace(RECIPE, trust=limits), slower)
    told = [str(item.message) for item in caught]
    # and since what it shows there is what other histories are held against
    assert any("held-out history 0" in text for text in told)
    # what the model gets wrong there opens no door: a path like that is warned of
    assert not any("are warned of from" in text for text in told)


def test_nothing_held_out_is_said(demo_pellet):
    with pytest.warns(UncheckedWarning):
        hhr.build(demo_pellet[0], of(demo_pellet[1]), RECIPE)


def test_constants_of_a_flow_model_are_checked(demo_pellet, monkeypatch):
    """They were computed and never looked at: a K~ of condition 1e12 went through."""
    honest = stages.assess
    spoiled = lambda *parts: dataclasses.replace(honest(*parts), cond_K=1e12)  # noqa: E731
    monkeypatch.setattr(stages, "assess", spoiled)
    with pytest.raises(UnstableModelError, match="cond"):
        hhr.build(demo_pellet[0], of(demo_pellet[1]), dataclasses.replace(RECIPE, domain=Rid(3, 3)))


def test_a_load_outside_the_rid_is_refused(demo_pellet):
    """A zone of one's own that leaves the pressed line out."""
    corner = lambda problem: [int(problem.points.sum(axis=1).argmax())]  # noqa: E731
    nodes = (Deim(), ForceDeim(1e-1), StressDeim(0.5), FlowDeim(0.5), Zone(corner))
    tight = hhr.Recipe.flowing(basis=Pod(1e-2), nodes=nodes, domain=Rid(0, 0))
    with pytest.raises(ReductionError, match="does not reach the RID"):
        hhr.build(demo_pellet[0], of(demo_pellet[1]), tight)


def test_where_nothing_flows_in_training_it_is_said():
    scene = demo.scene(**MESH)
    stiff = tuple(dataclasses.replace(body, law=hhr.Plasticity(1e9)) for body in scene.bodies)
    full = hhr.FullOrderModel(dataclasses.replace(scene, bodies=stiff))
    histories = [full.march(demo.path(gap, 4)) for gap in (5.0, 15.0)]
    with pytest.warns(StabilityWarning, match="no body flows in any training history"):
        hhr.build(full, of(histories), RECIPE, of(histories))


def test_histories_of_another_mesh(demo_pellet):
    full, histories = demo_pellet
    other = hhr.FullOrderModel(demo.scene(**{**MESH, "axial_cells": 10}))
    with pytest.raises(ReductionError, match="of another mesh"):
        hhr.build(other, of(histories), RECIPE)
    with pytest.raises(ReductionError, match="of another mesh"):
        hhr.build(full, of(histories), RECIPE, of([other.march(demo.path(10.0, 2))]))


@pytest.mark.parametrize(
    "changes",
    [
        {"iterations": 0},
        {"cuts": -1},
        {"relative_force": -1.0},
        {"relative_stress": np.nan},
        {"floor_stress": 2.0},
        {"search": "newton"},
        {"outside": "maybe"},
        *({"time_tolerance": value} for value in (0.0, -1.0, 1.0, 1e-6, np.nan, True, "fine")),
    ],
)
def test_settings_of_a_march_that_mean_nothing(changes):
    (name,) = changes
    said = (
        "search 'newton' is unknown, one of tangent, frozen, elastic" if name == "search" else name
    )
    with pytest.raises(ParameterError, match=said):
        hhr.MarchSettings(**changes)


FIRST, LAST = demo.path(10.0)[0][1], demo.path(10.0)[-1][1]


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ([], "the path is empty"),
        ([(0.0, FIRST), (np.inf, LAST)], "times must be finite"),
        ([(0.0, FIRST), (-1.0, LAST)], "times must increase"),
        ([(0.0, FIRST), (0.0, LAST)], "times must increase"),
        ([(0.0, FIRST), (1.0, LAST * np.nan)], "is not finite"),
        ([(0.0, FIRST), (1.0, 9 * LAST)], "is outside"),
        ([(0.0, FIRST[:2])], "expected 3 parameters"),
        ([(0.0, 1.0, 2.0)], "a list of pairs"),
        ([1.0, 2.0], "a list of pairs"),
        ([("soon", [0.0] * 3)], "a list of pairs"),
    ],
)
def test_paths_that_are_none(demo_pellet, path, words):
    with pytest.raises(ParameterError, match=words):
        demo_pellet[0].march(path)


def test_an_interrupt_keeps_the_steps_before(demo_pellet, monkeypatch):
    full, _ = demo_pellet
    honest, calls = full.equilibrium.signs, []

    def interrupted(*parts):
        calls.append(None)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return honest(*parts)

    monkeypatch.setattr(full.equilibrium, "signs", interrupted)
    with pytest.raises(KeyboardInterrupt) as caught:
        full.march(demo.path(10.0, 20))
    kept = caught.value.history
    assert isinstance(kept, History) and len(kept.answers) == 3


def test_contact_that_training_never_saw_is_said_and_found(cantilever):
    """Lifted first, then pressed: never touching in training, 178 % wrong without a word where it
    touches.
    """
    histories = [
        cantilever.march(legs((0, 0), (0, b), (a, b))) for b, a in ((0.15, 0.12), (0.2, 0.18))
    ]
    assert not any(answer.forces().any() for history in histories for answer in history.answers)
    with pytest.warns(StabilityWarning, match="no training solution has contact"):
        reduction = hhr.build(cantilever, of(histories))
    pressed = legs((0, 0), (0.08, 0))
    assert cantilever.march(pressed).answers[-1].forces().any()
    with pytest.warns(OutsideTrainingWarning):
        answer = reduction.march(pressed)
    # gaps of conditions that the RID does not hold are looked at too
    assert len(reduction.offline.sets.A_lambda) < len(cantilever.problem.gaps)
    deeper = answer.answers[-1]._replace(unknown=50 * answer.answers[-1].unknown)
    depth = (cantilever.problem.contact @ deeper.displacement() - 0.002).max()
    assert depth > 0 and reduction.equilibrium.signs(deeper).depth == pytest.approx(depth)


def test_an_overlap_outside_of_the_reduced_domain_is_said():
    space = ParameterSpace(("load",), (0.0,), (10.0,))
    path, known = (
        [(0.0, np.zeros(1)), (1.0, np.ones(1))],
        Known([[Signs(1.0, 10.0, 1e-4)]], [], 1.0),
    )
    trained = TrainedPaths.of([path], space, known)
    watch = Watch(trained, "warn")
    with warnings.catch_warnings(action="error", category=OutsideTrainingWarning):
        watch.after(
            1, 0.5, Signs(1.0, 10.0, 2e-3)
        )  # a thousandth of the length is round-off, three times it allowed
    with pytest.warns(
        OutsideTrainingWarning, match="overlap by 0.01 where the reduced domain does not look"
    ):
        watch.after(2, 1.0, Signs(1.0, 10.0, 1e-2))


def test_histories_held_out_may_come_from_a_generator(demo_pellet):
    full, histories = demo_pellet
    reduction = hhr.build(
        full, of(iter(histories)), RECIPE, of(history for history in histories[:1])
    )
    assert reduction.offline.comparison.labels == [
        "trained history 0",
        "trained history 1",
        "held-out history 0",
    ]
    with pytest.raises(ReductionError, match="not a single one"):
        of(histories[0])
    with pytest.raises(ReductionError, match="what march returns"):
        of([None])


@pytest.mark.parametrize(
    "law", [hhr.Plasticity(1.0, 5.0), hhr.Plasticity(1.0), hhr.Norton(2.0, 4.0)]
)
def test_a_rigid_motion_is_one_step(law):
    """The boundary moves by 20 times the yield strain: points behind it must not flow on the
    way.
    """
    up, down = block.side(1, True), block.side(1, False)
    moved = (hhr.Displacement(tag, 1, slope("move")) for tag in (down, up))
    scene = block_scene(
        "rigid",
        {"move": (-10.0, 10.0)},
        cells=(6, 6),
        bodies=(hhr.Body(block.SOLID, 200.0, 0.3, law),),
        contacts=(hhr.Obstacle(block.side(0, True), (1, 0), 5.0),),
        displacements=(hhr.Displacement(block.side(0, False), 0), *moved),
    )
    history = hhr.FullOrderModel(scene).march([(0.0, [0.0]), (1.0, [1.0])])
    assert history.cuts == 0 and np.abs(history.answers[-1].stress()).max() < 1e-8
