"""From snapshots to a reduced model with a trust check: one list of stages for all kinds of bodies.

Stages that a scene does not need are skipped and listed with the reason.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from hhr_dolfinx.certify.accuracy import force_floor
from hhr_dolfinx.certify.compare import Comparison, compare_on_s, compare_points
from hhr_dolfinx.certify.constants import FullConstants, Stability, assess
from hhr_dolfinx.certify.trust import (
    check_comparison,
    check_loads_seen,
    check_solvable,
    check_stability,
    check_sticking,
    first_trusted,
    warn_of_training,
)
from hhr_dolfinx.contact.problem import ContactProblem, IndexSets
from hhr_dolfinx.errors import NotOfferedError, NotSolvableError, ReductionError
from hhr_dolfinx.models.bounds.difference import ExactDifference
from hhr_dolfinx.models.eliminations.projected import ReducedProblem
from hhr_dolfinx.models.estimates import known_error, warn_unbounded
from hhr_dolfinx.models.full import FullModel, plain_outputs
from hhr_dolfinx.models.model import AnsweringModel
from hhr_dolfinx.models.reconstruct import Reconstruction
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.ranks import together
from hhr_dolfinx.reduction.calibration import MOST_TRAINING_COMPARED, calibrated
from hhr_dolfinx.reduction.completion import Completion, bound_of
from hhr_dolfinx.reduction.enrichment import Enrichment, enrich, record_enrichment
from hhr_dolfinx.reduction.projection import project, reduced_domain
from hhr_dolfinx.reduction.recipe import Enrich, Recipe, basis_of, chosen_nodes
from hhr_dolfinx.reduction.stages import stages_of
from hhr_dolfinx.snapshots.records import SnapshotSet, check_of_problem
from hhr_dolfinx.timing import Announce, StageLog, unannounced
from hhr_dolfinx.trained import Trained, TrainedRange

if TYPE_CHECKING:
    from hhr_dolfinx.models.reduced import ReducedLaws
    from hhr_dolfinx.models.starts import LinearStarts


FURTHER = Enrich(2.0)
"""Enrichment of the usual recipe with friction if its usual enrichment leaves contact rows dependent: only friction
then holds a body, and forces of sticking contacts need modes without its rigid motions."""


@dataclass(frozen=True)
class OfflineRecord:
    """Offline record of a reduced model: its recipe, its dimensions and the results of the checks.

    Attributes:
        recipe: the recipe.
        layers: layers of cells of the RID, possibly more than in the recipe.
        basis: V, (N, ell), local rows of it if the build is distributed.
        sets: index sets of the RID.
        stability: constants of the elastic projection.
        enrichment: the enrichment of the basis.
        tangent_margin: smallest real part of the eigenvalues of the projected tangents; None if they were not
            computed.
        comparison: errors against known answers; None if the check was skipped.
        log: times of the stages, skipped stages, refused attempts.
    """

    recipe: Recipe
    layers: int
    basis: np.ndarray
    sets: IndexSets
    stability: Stability
    enrichment: Enrichment
    tangent_margin: float | None
    comparison: Comparison | None
    log: StageLog


@dataclass(frozen=True)
class _Offline:
    """Data that all attempts share.

    Attributes:
        full: the full model.
        snapshots, held_out: its answers, for training and for validation.
        recipe: the recipe.
        basis: before enrichment, (own, ell).
        nodes: nodes from which the RID is made.
        constants: of the full model.
        completion: reconstruction of answers.
        states: tangents at training states and their stiffness.
        log: records every stage.
        announce: called with each stage that begins.
    """

    full: FullModel
    snapshots: SnapshotSet
    held_out: SnapshotSet | None
    recipe: Recipe
    basis: np.ndarray
    nodes: np.ndarray
    constants: FullConstants
    completion: Completion
    states: list[tuple[np.ndarray, Any]]
    log: StageLog
    announce: Announce


def usual_recipe(full: FullModel) -> Recipe:
    """The default recipe of a scene."""
    if full.equilibrium is not None:
        return stages_of(full).recipe()
    return Recipe() if full.problem.friction is None else Recipe.with_friction()


@runtime_checkable
class Reductor(Protocol):
    """A user-defined reduction: it makes a model from answers of the full one."""

    def reduced(self, full: FullModel, snapshots: SnapshotSet, held_out: SnapshotSet | None) -> AnsweringModel:
        """A model of the same scene.

        Args:
            full: the full model, with all rows.
            snapshots: training answers at single parameters, or load paths.
            held_out: validation answers, for a check; None without any.
        """


def build(
    full: FullModel,
    snapshots: SnapshotSet,
    recipe: Any = None,
    held_out: SnapshotSet | None = None,
    announce: Announce = unannounced,
) -> Any:
    """Build an HHR model that passes the trust check, thesis sections 1.4.2-1.4.6 and 6.2.3.

    A :class:`Reductor` instead of a recipe makes a model of another kind from the same answers, as
    :class:`~hhr_dolfinx.reduction.condense.Condensation` does.

    A model that fails is built again with one more layer of cells, up to ``recipe.domain.most_layers``. For bodies with
    laws a RID that is too small for its modes makes the projected consistent tangent indefinite: steps then fail, or
    converge to a wrong path with very small residuals, and the elastic operator shows no sign of it.

    Args:
        full: the full model, of which only arrays are used. A distributed model is reduced on all ranks, each with its
            local rows; if that is not supported all ranks get all rows, which the log records.
        snapshots: training answers at single parameters, or load paths.
        recipe: a recipe or a reductor; None means the default, :class:`Recipe` or that of the laws of bodies.
        held_out: validation answers for the trust check; without them training answers are compared, and a
            warning is given.
        announce: called with each stage that begins; an exception from it stops the build.

    Raises:
        ReductionError: for snapshots or recipes from which no model can be built.
        NotSolvableError: if K~ is singular or the contact rows are dependent, (1.67).
        UnstableModelError: if the trust check still refuses the model at ``most_layers``.

    Warns:
        StabilityWarning: if a check is close to its limit, or no training answer has contact or shows laws of bodies.
        UncheckedWarning: if the model was not compared with validation answers.
    """
    given: Any = full
    if not (isinstance(given, AnsweringModel) and given.of_full_order):
        raise ReductionError(f"{full!r} is no full model: give FullOrderModel(scene)")
    if isinstance(recipe, Reductor) and not isinstance(recipe, type):
        full, *sets = everywhere(full, snapshots, held_out)
        return _of_scene(full, recipe, recipe.reduced(full, *sets))
    log = StageLog()
    if recipe is None and full.problem.friction is not None and full.equilibrium is None:
        try:
            return _of_recipe(full, snapshots, usual_recipe(full), held_out, log, announce)
        except NotSolvableError as error:
            log.say(f"the usual recipe is tried again with {FURTHER}: {error}")
            recipe = replace(usual_recipe(full), enrichment=FURTHER)
    chosen = usual_recipe(full) if recipe is None else recipe
    return _of_recipe(full, snapshots, chosen, held_out, log, announce)


def _of_recipe(
    full: FullModel,
    snapshots: SnapshotSet,
    recipe: Recipe,
    held_out: SnapshotSet | None,
    log: StageLog,
    announce: Announce,
) -> Any:
    """See :func:`build`."""
    _check_given(full, snapshots, recipe, held_out)
    comm = full.problem.comm
    if comm is not None and not (why := not_by_rows(full.problem, snapshots, recipe)):
        with together(comm, f"reducing scene '{full.scene.name}'"):
            return _built(full, snapshots, recipe, held_out, log, announce)
    if comm is not None:
        log.skip("rows of ranks", f"each rank has all rows of all matrices and answers: {why}")
        full, snapshots, held_out = everywhere(full, snapshots, held_out)
    return _built(full, snapshots, recipe, held_out, log, announce)


def not_by_rows(problem: ContactProblem, snapshots: SnapshotSet | None = None, recipe: Recipe | None = None) -> str:
    """Reason why a distributed problem is not reduced by rows, with snapshots or a recipe; empty if it is.

    Decomposition, projection, enrichment and bounds use only sums over the ranks.
    """
    if problem.friction is not None:
        return "frictional contact"
    if snapshots is not None and snapshots.histories:
        return "it is trained on histories"
    if recipe is not None and not recipe.by_rows:
        return "a step of the recipe does not say by_rows = True"
    return ""


def everywhere(full: FullModel, *sets: SnapshotSet | None) -> tuple[Any, ...]:
    """Gather a distributed full model and its answers, so that each rank has all rows. Collective."""
    problem = full.problem
    if problem.comm is None:
        return full, *sets
    return full.gathered(), *(None if item is None else item.gathered(problem) for item in sets)


def _built(
    full: FullModel,
    snapshots: SnapshotSet,
    recipe: Recipe,
    held_out: SnapshotSet | None,
    log: StageLog,
    announce: Announce,
) -> Any:
    """See :func:`build`."""
    if recipe.trust is None:
        log.skip("validation", "no limits were given: the model is as it is")
    else:
        warn_of_training(full, snapshots, held_out)
        if held_out is None:
            log.skip("held_out", "nothing was kept out of training: training answers were compared")
    with log.stage("basis", announce):
        basis = basis_of(recipe.basis, full.problem, snapshots)
    with log.stage("rid", announce):
        nodes = chosen_nodes(full.problem, snapshots, recipe, basis)
    with log.stage("full_constants", announce):
        constants = FullConstants.of(full)
    with log.stage("reconstruction", announce):
        laws = None if full.equilibrium is None else stages_of(full).fitted(snapshots)
        completion = Completion.of(full.problem, snapshots, laws)
    states = _tangents(full, snapshots, recipe, log, announce)
    if recipe.indicator is None and (full.problem.friction is None or full.equilibrium is not None):
        log.skip("indicator", "no estimate of the error of each answer was requested")
    shared = _Offline(full, snapshots, held_out, recipe, basis, nodes, constants, completion, states, log, announce)
    return first_trusted(lambda layers: _attempt(shared, layers), recipe.domain.layers, recipe.domain.most_layers, log)


def _tangents(
    full: FullModel, snapshots: SnapshotSet, recipe: Recipe, log: StageLog, announce: Announce
) -> list[tuple[np.ndarray, Any]]:
    """Tangents at training states and their stiffness; empty for elastic bodies, or if they were not requested."""
    if full.equilibrium is None or recipe.tangents is None:
        why = "elastic bodies: the elastic operator is the tangent" if full.equilibrium is None else "not requested"
        log.skip("tangents", why)
        return []
    with log.stage("training_tangents", announce):
        return stages_of(full).tangents(full, snapshots, recipe.tangents)


def sizes(full: FullModel, snapshots: SnapshotSet, recipe: Recipe) -> tuple[int, int]:
    """Numbers of modes and contact conditions of the model of a recipe, before anything is projected.

    Raises:
        ReductionError: see :func:`build`.
    """
    problem = full.problem
    _check_given(full, snapshots, recipe, None)
    basis = basis_of(recipe.basis, problem, snapshots)
    nodes = chosen_nodes(problem, snapshots, recipe, basis)
    sets = reduced_domain(problem, nodes, recipe.domain.layers)
    kappa_max = np.inf if recipe.enrichment is None else recipe.enrichment.kappa_max
    return enrich(problem, basis, sets, kappa_max).basis.shape[1], sets.A_lambda.size


def _of_scene(full: FullModel, reductor: Reductor, made: Any) -> AnsweringModel:
    """The result of a reductor, if it is a model of the scene of the full one.

    Raises:
        ReductionError: if it is not.
    """
    name = type(reductor).__name__
    if not isinstance(made, AnsweringModel):
        raise ReductionError(f"{name}.reduced returned {made!r}: it must return a model")
    found = made.parameters.names, made.conditions
    if found != (full.parameters.names, full.conditions):
        raise ReductionError(
            f"{name}.reduced returned a model of the parameters {found[0]} and {found[1]} contact conditions, and the "
            f"full model has {full.parameters.names} and {full.conditions}: it must return one of the same scene"
        )
    return made


def _check_given(full, snapshots, recipe, held_out) -> None:
    """Raise ReductionError for an invalid recipe, and for solutions of another problem."""
    if isinstance(recipe, type):
        raise ReductionError(f"{recipe.__name__} is a class, give a value of it: {recipe.__name__}(...)")
    if not isinstance(recipe, Recipe):
        raise ReductionError(f"{recipe!r} is no recipe: give a Recipe")
    problem = full.problem
    problem.require_parts("hyper-reduction")
    if problem.reshaped is not None:
        raise NotOfferedError(
            "hyper-reduction is not offered where shapes are parameters: condensation is quicker there, and a million "
            "times as exact. Condense the scene, hhr.condense(scene), or hhr.train(scene, ...).condense()"
        )
    for name, solutions in (("snapshots", snapshots), ("held_out", held_out)):
        if solutions is None and name == "held_out":
            continue
        check_of_problem(name, solutions, problem)
        if full.equilibrium is None:
            if solutions.states:
                raise ReductionError(f"bodies of {name} have laws, and none of the model do: they are of another scene")
            if problem.friction is not None and not solutions.histories:
                raise ReductionError(f"{name} of a scene with friction must be histories: SnapshotSet.of_histories")
            continue
        stages_of(full).check_given(full, name, solutions)


def _attempt(shared: _Offline, layers: int) -> ReducedModel:
    """One attempt with a constant number of layers."""
    full = shared.full
    recipe = shared.recipe
    log = shared.log
    problem = shared.full.problem
    with log.stage("rid", shared.announce):
        sets = reduced_domain(problem, shared.nodes, layers)
        check_loads_seen(problem, sets, shared.snapshots.points)
    with log.stage("enrichment", shared.announce):
        enrichment = _enriched(shared, sets)
    basis = enrichment.basis
    with log.stage("projection", shared.announce):
        reduced = project(problem, basis, sets)
    flow = None if full.equilibrium is None else _laws_on(shared, basis, sets)
    with log.stage("stability", shared.announce):
        stability = _assessed(shared, basis, sets, reduced)
    fields = _fields(shared, basis, sets, flow)
    known = shared.snapshots.known_statuses(sets.A_lambda) if flow is None else None
    with log.stage("online_arrays", shared.announce):
        range_ = TrainedRange.of(shared.snapshots.points, problem.parameters) if flow is None else None
        model = ReducedModel(reduced, full.parameters, fields, range_, known=known, flow=flow)
        if problem.varies and flow is None:
            model = _eliminated_between(model, log)
        elif model.eliminated is not None and not (reduced.motions or model.eliminated.tabulated or model.friction):
            model = model.changed(known=_starts_along(model))
    if problem.friction is not None and flow is None and recipe.trust is not None:
        with log.stage("indicator", shared.announce):
            told_by = [item.histories for item in (shared.held_out, shared.snapshots) if item is not None]
            (model,) = calibrated(model, told_by, log)
    margin = _checked_margin(shared, model, layers)
    with log.stage("validation", shared.announce):
        comparison, trained = _compared(shared, model)
    shared.log.say(known_error(model.fields))
    record = OfflineRecord(recipe, layers, basis, sets, stability, enrichment, margin, comparison, log)
    return model.changed(trained=trained, offline=record)


def _assessed(shared: _Offline, basis: np.ndarray, sets: IndexSets, reduced: ReducedProblem) -> Stability:
    """Constants of an admissible projection."""
    problem = shared.full.problem
    rows = _distinct(problem, sets)
    stability = assess(problem, shared.constants, basis, rows, _rows_of(reduced, problem, sets))
    check_solvable(stability, problem, rows)
    if problem.friction is not None:
        check_sticking(stability)
    if shared.recipe.trust is not None:
        check_stability(stability, shared.recipe.trust)
    return stability


def _fields(shared: _Offline, basis: np.ndarray, sets: IndexSets, flow: ReducedLaws | None) -> Reconstruction:
    """Reconstruction of answers, with bounds if they are proved."""
    full = shared.full
    recipe = shared.recipe
    log = shared.log
    problem = full.problem
    bounding = bound_of(full, recipe, shared.snapshots, basis, log, shared.announce)
    bound = bounding.bound
    response = bounding.response
    with log.stage("reconstruction", shared.announce):
        cone = (recipe.cone or bound is None) and problem.friction is None
        fields = shared.completion.reconstruction(problem, bounding.columns, sets, flow, cone=cone)
        fields = replace(fields, bound=bound, unbounded=bounding.unbounded, stress_of=full.stress_of, full=full)
        fields = replace(fields, functionals=plain_outputs(full), response=response)
        if recipe.indicator is not None:
            fields = replace(fields, indicator=recipe.indicator.prepared(problem, basis, sets))
        if problem.friction is not None:
            from hhr_dolfinx.models.frictional_fields import FrictionalFields

            modes = shared.completion.force_modes
            fields = replace(fields, frictional=FrictionalFields.fitted(problem, sets.A_lambda, modes))
    if isinstance(bound, ExactDifference) and full.functionals is not None and problem.rigid is None:
        from hhr_dolfinx.certify.differences import output_difference

        with log.stage("bound", shared.announce):
            fields = replace(fields, output_bound=output_difference(full, shared.snapshots))
    return fields


def _laws_on(shared: _Offline, basis: np.ndarray, sets: IndexSets) -> ReducedLaws:
    """Laws of bodies on the RID."""
    with shared.log.stage("projection", shared.announce):
        return stages_of(shared.full).projected(shared.full, basis, sets)


def _starts_along(model: ReducedModel) -> LinearStarts:
    """Starts of a model without tabulated answers; the module is loaded only for such a model."""
    from hhr_dolfinx.reduction.starts import linear_starts

    inner: Any = model.eliminated
    return linear_starts(inner.eliminated, inner.known.points, inner.pairs, inner.known.active)


def _eliminated_between(model: ReducedModel, log: StageLog) -> ReducedModel:
    """A model whose K~ depends on parameters, interpolated between few of them; statuses start along derivatives."""
    from hhr_dolfinx.reduction.interpolate_reduced import interpolated_reduction
    from hhr_dolfinx.reduction.starts import linear_starts

    if model.problem.motions:
        log.skip("interpolation", "contact alone holds bodies: K~ is factored for each query")
        return model
    if model.friction is not None:
        log.skip("interpolation", "frictional contact: K~ is factored once for all increments of a path")
        return model
    compliances, _ = interpolated_reduction(model.problem, model.fields.amplitudes, model.parameters)
    if compliances is None:
        log.skip("interpolation", "K~^-1 is no smooth function of the parameters: it is factored for each query")
        return model
    assert model.known is not None  # true for elastic bodies
    known = linear_starts(compliances, model.known.points, model.problem.pairs)
    return model.changed(compliances=compliances, known=known)


def _distinct(problem: ContactProblem, sets: IndexSets) -> IndexSets:
    """A RID without conditions that others repeat, whose rows are dependent for any basis."""
    return replace(sets, A_lambda=sets.A_lambda[problem.distinct[sets.A_lambda]])


def _rows_of(reduced: ReducedProblem, problem: ContactProblem, sets: IndexSets) -> ReducedProblem:
    """A projected problem with the conditions of :func:`_distinct`."""
    if (kept := problem.distinct[sets.A_lambda]).all():
        return reduced
    rows = {name: getattr(reduced, name)[kept] for name in ("contact_test", "contact_trial", "gaps", "pairs")}
    return replace(reduced, **rows)


def _enriched(shared: _Offline, sets: IndexSets) -> Enrichment:
    """The enriched basis, or the given one without a requested enrichment."""
    step = shared.recipe.enrichment
    problem = shared.full.problem
    rows = _distinct(problem, sets)
    enrichment = enrich(problem, shared.basis, rows, np.inf if step is None else step.kappa_max)
    if step is None:
        shared.log.skip("enrichment", "not requested")
    else:
        record_enrichment(enrichment, step.kappa_max, shared.log)
    return enrichment


def _checked_margin(shared: _Offline, model: ReducedModel, layers: int) -> float | None:
    """Smallest tangent margin at training states; 1, that of the elastic operator, if all states are elastic."""
    if model.equilibrium is None or shared.recipe.tangents is None:
        return None
    with shared.log.stage("stability", shared.announce):
        return stages_of(shared.full).margin(model, shared.states, shared.recipe.tangents.least, layers)


def _compared(shared: _Offline, model: ReducedModel) -> tuple[Comparison | None, Trained | None]:
    """Errors against validation answers, or else against training, and the training range.

    The training range of a model of load paths is known only after it has solved the known paths.
    """
    full = shared.full
    snapshots = shared.snapshots
    held_out = shared.held_out
    limits = shared.recipe.trust
    trained = model.trained
    if snapshots.columns is not None:
        shared.log.skip("comparison", "trained on parts of histories: only models of all parts together answer one")
        return None, None
    if model.friction is not None and model.equilibrium is None:
        from hhr_dolfinx.certify.trust import compared_histories

        return compared_histories(full, model, snapshots, held_out, limits)[0], trained
    if model.equilibrium is not None:
        return stages_of(full).checked(full, model, snapshots, held_out, limits)
    if limits is None:
        return None, trained
    if held_out is None:
        every = max(1, len(snapshots.points) // MOST_TRAINING_COMPARED)
        held_out = snapshots.take(np.arange(0, len(snapshots.points), every))
    comparison = compare_points(full, model, held_out, force_floor(full.problem, snapshots))
    check_comparison(comparison, limits)
    if full.problem.rigid is not None and model.fields.bound is not None:
        check_comparison(compare_on_s(model), limits)
    warn_unbounded(model.fields)
    return comparison, trained
