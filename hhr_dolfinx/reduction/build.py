"""Hyper-reduction: from snapshots to a reduced model with a trust check.

One list of stages serves all kinds of bodies.

Stages that a scene does not need are skipped and listed with the reason.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, TypeVar

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.certify.compare import Comparison
from hhr_dolfinx.certify.constants import Stability, assess
from hhr_dolfinx.certify.trust import TrustLimits, check_loads_seen, check_solvable, check_stability
from hhr_dolfinx.contact.problem import ContactProblem, IndexSets
from hhr_dolfinx.errors import NotSolvableError, ReductionError
from hhr_dolfinx.models.eliminations.projected import ReducedProblem
from hhr_dolfinx.models.full import FullModel, plain_outputs
from hhr_dolfinx.models.reconstruct import Reconstruction
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.reduction.completion import ReconstructionData, bound_of
from hhr_dolfinx.reduction.enrichment import Enrichment, enrich, record_enrichment
from hhr_dolfinx.reduction.kinds import OfPoints, kind_of
from hhr_dolfinx.reduction.projection import project, reduced_domain
from hhr_dolfinx.reduction.recipe import Recipe, basis_of, chosen_nodes
from hhr_dolfinx.reduction.reductor import (
    RecipeLike,
    Reductor,
    Task,
    as_reductor,
    compared,
    made,
    outcomes,
)
from hhr_dolfinx.registry import Stage
from hhr_dolfinx.snapshots.records import SnapshotSet
from hhr_dolfinx.timing import Announce, StageLog, terminal_lines
from hhr_dolfinx.trained import Trained
from hhr_dolfinx.warn import repeat

Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class HyperFacts:
    """Facts of a hyper-reduced model, in its :class:`~hhr_dolfinx.reduction.reductor.Record`."""

    recipe: Recipe
    layers: int  #: of cells of the RID, possibly more than in the recipe
    basis: np.ndarray  #: V, (own, ell)
    sets: IndexSets  #: of the RID
    stability: Stability  #: constants of the elastic projection
    enrichment: Enrichment  #: of the basis
    further: Mapping[str, float]  #: what stages of plug-ins found, by name


@dataclass(frozen=True, eq=False)
class Offline:
    """Data that all attempts share."""

    task: Task
    snapshots: SnapshotSet
    recipe: Recipe
    basis: np.ndarray  #: before enrichment, (own, ell)
    nodes: np.ndarray  #: from which the RID is made
    completion: ReconstructionData  #: of answers
    computed: dict[str, Any] = field(
        default_factory=dict
    )  #: what stages compute once for all attempts, by name

    @property
    def full(self) -> FullModel:
        """The full model."""
        return self.task.full

    @property
    def log(self) -> StageLog:
        """Records every stage."""
        return self.task.log

    def once(self, name: str, compute: Callable[[], Result]) -> Result:
        """A result that a stage computes in the first attempt only.

        Args:
            name: name of the result.
            compute: computes it.
        """
        if name not in self.computed:
            self.computed[name] = compute()
        return self.computed[name]


@dataclass(eq=False)
class Draft:
    """A hyper-reduced model under construction: each stage adds a part, see :class:`HyperFacts`."""

    shared: Offline
    layers: int
    sets: IndexSets = field(init=False)
    enrichment: Enrichment = field(init=False)
    reduced: ReducedProblem = field(init=False)  #: the projected arrays
    parts: dict[str, Any] = field(default_factory=dict)  #: further arguments of the model, by name
    stability: Stability = field(init=False)
    fields: Reconstruction = field(init=False)  #: of answers
    model: ReducedModel = field(init=False)
    further: dict[str, float] = field(default_factory=dict)  #: facts of the record, by name

    @property
    def basis(self) -> np.ndarray:
        """The enriched basis, (own, ell)."""
        return self.enrichment.basis

    @property
    def facts(self) -> HyperFacts:
        """Facts of the model."""
        attributes = self.basis, self.sets, self.stability, self.enrichment, self.further
        return HyperFacts(self.shared.recipe, self.layers, *attributes)


def usual_recipe(full: FullModel) -> Recipe:
    """Default recipe of a scene, the first one that is tried."""
    return kind_of(full).recipes()[0]


def build(
    full: FullModel,
    snapshots: SnapshotSet,
    recipe: RecipeLike = None,
    held_out: SnapshotSet | None = None,
    announce: Announce | None = None,
) -> Any:
    """Build an HHR model that passes the trust check, thesis sections 1.4.2-1.4.6 and 6.2.3.

    A :class:`~hhr_dolfinx.reduction.reductor.Reductor` instead of a recipe makes a model of another
    kind, as :class:`~hhr_dolfinx.reduction.exact.ExactCondensation` does.

    A model that fails is built again with one more layer of cells, up to
    ``recipe.domain.most_layers``. For bodies with laws a RID that is too small for its modes makes
    the projected consistent tangent indefinite: steps then fail, or converge to a wrong path with
    very small residuals, and the elastic operator shows no sign of it.

    Args:
        full: the full model, of which only arrays are used. A distributed model is reduced on all
            ranks, each with its local rows; if that is not supported all ranks get all rows, which
            the log records.
        snapshots: training answers at single parameters, or load paths.
        recipe: a recipe or a reductor; None means the default, :class:`Recipe` or that of the laws
            of bodies.
        held_out: validation answers for the trust check; without them training answers are
            compared, and a warning is given.
        announce: called with each stage that begins; an exception from it stops the build. None
            prints lines on a terminal if the build takes longer than two seconds.

    Raises:
        ReductionError: for snapshots or recipes from which no model can be built.
        NotSolvableError: if K~ is singular or the contact rows are dependent, (1.67).
        UnstableModelError: if the trust check still refuses the model at ``most_layers``.

    Warns:
        StabilityWarning: if a check is close to its limit, or no training answer has contact or
        shows laws of bodies. UncheckedWarning: if the model was not compared with validation
        answers.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> full = hhr.FullOrderModel(scene)
        >>> snapshots = hhr.compute_snapshots(full, scene.parameters.grid([65]))
        >>> held_out = hhr.compute_snapshots(full, scene.parameters.random(20, seed=1))
        >>> model = hhr.build(full, snapshots, held_out=held_out)
        >>> round(model.outputs({"push": 50.0})["peak"], 1)
        56.5
    """
    if not isinstance(full, FullModel):
        raise ReductionError(f"{full!r} is no full model: give FullOrderModel(scene)")
    task = Task(full, snapshots, held_out, announce=announce or terminal_lines())
    if isinstance(recipe, HyperReduction):
        recipe = recipe.recipe
    elif (reductor := as_reductor(recipe)) is not None:
        return made(reductor, task)
    recipes = task.kind.recipes() if recipe is None else (recipe,)
    if not recipes:
        raise ReductionError("there is no recipe to try: give one")
    for outcome in outcomes(
        recipes, lambda item: made(HyperReduction(item), task), (NotSolvableError,)
    ):
        if outcome.error is None:
            break
        task.log.say(f"the recipe {outcome.candidate} is refused: {outcome.error}")
    repeat(outcome.warnings)
    if outcome.error is not None:
        raise outcome.error
    return outcome.made


def not_by_rows(
    kind: OfPoints, snapshots: SnapshotSet | None = None, recipe: Recipe | None = None
) -> str:
    """Reason why a distributed problem is not reduced by rows; empty if it is.

    Decomposition, projection, enrichment and bounds use only sums over the ranks.

    Args:
        kind: kind of the answers.
        snapshots: training answers; None to leave them out of account.
        recipe: recipe of the reduction; None to leave it out of account.
    """
    if reason := kind.not_by_rows():
        return reason
    if snapshots is not None and snapshots.histories:
        return "it is trained on histories"
    if recipe is not None and not recipe.by_rows:
        return "a step of the recipe does not say by_rows = True"
    return ""


def check_recipe(recipe: Recipe) -> None:
    """Check a recipe.

    Raises:
        ReductionError: for a class, or a value that is no recipe.
    """
    if isinstance(recipe, type):
        raise ReductionError(
            f"{recipe.__name__} is a class, give a value of it: {recipe.__name__}(...)"
        )
    if not isinstance(recipe, Recipe):
        raise ReductionError(f"{recipe!r} is no recipe: give a Recipe")


@dataclass(frozen=True)
class HyperReduction(Reductor[Offline]):
    """Hyper-reduction by a recipe.

    A model that is refused is built again with one more layer of cells.
    """

    recipe: Any = None  #: None takes the default of the scene, in a search
    method: ClassVar[str] = "hhr"
    own_range: ClassVar[bool] = True
    level: ClassVar[str] = "layers"

    @property
    def limits(self) -> TrustLimits | None:
        """Limits of the recipe."""
        return self.recipe.trust

    def check(self, task: Task) -> None:
        """See :func:`build`."""
        check_recipe(self.recipe)
        task.full.problem.require_parts("hyper-reduction")
        task.check_answers()

    def not_by_rows(self, task: Task) -> str:
        """See :func:`not_by_rows`."""
        return not_by_rows(task.kind, task.snapshots, self.recipe)

    def levels(self, task: Task) -> Iterable[int]:
        """Layers of cells."""
        domain = self.recipe.domain
        return range(domain.layers, max(domain.layers, domain.most_layers) + 1)

    def prepare(self, task: Task, before: Offline | None = None) -> Offline:
        """Basis, nodes of the RID and reconstruction.

        Args:
            task: input of the reduction.
            before: data of another task; not used.
        """
        full, log, snapshots = task.full, task.log, task.snapshots
        problem = full.problem
        recipe: Recipe = self.recipe
        assert snapshots is not None  # checked
        if recipe.trust is None:
            log.skip("validation", "no limits were given: the model is as it is")
        else:
            task.kind.warn_of_training(snapshots, task.held_out)
            if task.held_out is None:
                log.skip(
                    "held_out", "nothing was kept out of training: training answers were compared"
                )
        with log.stage("basis", task.announce):
            basis = basis_of(recipe.basis, problem, snapshots)
        with log.stage("rid", task.announce):
            nodes = chosen_nodes(problem, snapshots, recipe, basis)
        with log.stage("reconstruction", task.announce):
            completion = ReconstructionData.of(problem, snapshots)
        for stage, reason in task.kind.skipped(recipe):
            log.skip(stage, reason)
        return Offline(task, snapshots, recipe, basis, nodes, completion)

    def attempt(self, prepared: Offline, level: int) -> tuple[ReducedModel, HyperFacts]:
        """All stages, with a constant number of layers.

        Args:
            prepared: data that all attempts share.
            level: layers of cells.
        """
        draft = Draft(prepared, level)
        for import_path in stages_of(prepared.full, self.recipe):
            registry.load(import_path)(draft)
        return draft.model, draft.facts

    def compare(self, task: Task, model: ReducedModel) -> tuple[Comparison | None, Trained | None]:
        """Errors against known answers.

        Args:
            task: input of the reduction.
            model: model that was built.
        """
        limits = self.limits
        comparison = compared(task, model, limits, self.remedy)
        if limits is not None:
            task.kind.warn_of_estimates(model.fields)
        return comparison


_HERE = "hhr_dolfinx.reduction.build"


STAGES = (
    Stage(f"{_HERE}:choose_domain"),
    Stage(f"{_HERE}:enrich_basis", f"{_HERE}:choose_domain"),
    Stage(f"{_HERE}:project_problem", f"{_HERE}:enrich_basis"),
    Stage(f"{_HERE}:assess_projection", f"{_HERE}:project_problem"),
    Stage(
        f"{_HERE}:check_constants",
        f"{_HERE}:assess_projection",
        lambda full, recipe: recipe.trust is not None,
    ),
    Stage(f"{_HERE}:reconstruct", f"{_HERE}:assess_projection"),
    Stage(f"{_HERE}:assemble", f"{_HERE}:reconstruct"),
    Stage(
        f"{_HERE}:start_along",
        f"{_HERE}:assemble",
        lambda full, recipe: not full.problem.varies and not full.by_paths,
    ),
)
"""Stages of an attempt; a plug-in adds its own in its manifest."""


def stages_of(full: FullModel, recipe: Recipe) -> list[str]:
    """Import paths of the stages of an attempt, in their order.

    Of those after the same stage the ones of plug-ins first.

    Args:
        full: the full model.
        recipe: the recipe.

    Raises:
        ReductionError: for a stage that comes after one that is not there.
    """
    stages = (
        *(stage for plugin in registry.installed().values() for stage in plugin.stages),
        *STAGES,
    )
    wanted = [stage for stage in stages if registry.wants(stage, full, recipe)]

    def from_here(stage_path: str) -> Iterator[str]:
        for stage in wanted:
            if stage.after == stage_path:
                yield stage.place
                yield from from_here(stage.place)

    order = list(from_here(""))
    if lost := [stage for stage in wanted if stage.place not in order]:
        raise ReductionError(
            f"the stage {lost[0].place} comes after {lost[0].after}, which is no stage here"
        )
    return order


def choose_domain(draft: Draft) -> None:
    """The RID, which all loads of the training reach."""
    shared = draft.shared
    problem = shared.full.problem
    with shared.log.stage("rid", shared.task.announce):
        touching = problem if problem.reshaped is None else problem.reshaped.touching()
        draft.sets = reduced_domain(touching, shared.nodes, draft.layers)
        check_loads_seen(problem, draft.sets, shared.snapshots.points)


def enrich_basis(draft: Draft) -> None:
    """The enriched basis, or the given one without a requested enrichment."""
    shared = draft.shared
    with shared.log.stage("enrichment", shared.task.announce):
        step = shared.recipe.enrichment
        problem = shared.full.problem
        rows = _distinct(problem, draft.sets)
        draft.enrichment = enrich(
            problem, shared.basis, rows, np.inf if step is None else step.kappa_max
        )
        if step is None:
            shared.log.skip("enrichment", "not requested")
        else:
            record_enrichment(draft.enrichment, step.kappa_max, shared.log)


def project_problem(draft: Draft) -> None:
    """The projected arrays."""
    shared = draft.shared
    with shared.log.stage("projection", shared.task.announce):
        draft.reduced = project(shared.full.problem, draft.basis, draft.sets)


def assess_projection(draft: Draft) -> None:
    """Constants of a solvable projection."""
    shared = draft.shared
    problem = shared.full.problem
    with shared.log.stage("stability", shared.task.announce):
        sets, reduced = independent(problem, draft.sets, draft.reduced)
        draft.stability = assess(problem, draft.basis, sets, reduced)
        check_solvable(draft.stability, problem, sets)


def check_constants(draft: Draft) -> None:
    """Check the stability constants against the limits of the recipe."""
    trust = draft.shared.recipe.trust
    assert trust is not None
    check_stability(draft.stability, trust)


def reconstruct(draft: Draft) -> None:
    """Reconstruction of answers, with bounds if they are proved."""
    shared = draft.shared
    full = shared.full
    recipe = shared.recipe
    problem = full.problem
    bounding = bound_of(shared.task, recipe, draft.basis)
    with shared.log.stage("reconstruction", shared.task.announce):
        cone = (recipe.cone or bounding.bound is None) and shared.task.kind.cone
        draft.fields = replace(
            shared.completion.reconstruction(problem, bounding.columns, draft.sets, cone=cone),
            bound=bounding.bound,
            unbounded=bounding.unbounded,
            response=bounding.response,
            stress_of=full.stress_of,
            functionals=plain_outputs(full),
            full=full,
        )
        if recipe.indicator is not None:
            indicator = recipe.indicator.prepared(problem, draft.basis, draft.sets)
            draft.fields = replace(draft.fields, indicator=indicator)


def assemble(draft: Draft) -> None:
    """The model, with the range and the statuses of the training.

    Both are as far as they are known before its check.
    """
    shared = draft.shared
    kind = shared.task.kind
    statuses = kind.starts(shared.snapshots, draft.sets.A_lambda)
    with shared.log.stage("online_arrays", shared.task.announce):
        trained = kind.range_of(shared.snapshots)
        space = shared.full.parameters
        draft.model = ReducedModel(
            draft.reduced, space, draft.fields, trained, known=statuses, **draft.parts
        )


def start_along(draft: Draft) -> None:
    """Statuses start along derivatives, for a model without tabulated answers."""
    model = draft.model
    inner = model.eliminated
    if inner is not None and not (draft.reduced.motions or inner.tabulated):
        from hhr_dolfinx.reduction.starts import linear_starts

        with draft.shared.log.stage("online_arrays", draft.shared.task.announce):
            statuses = linear_starts(
                inner.eliminated, inner.known.points, inner.pairs, inner.known.active
            )
            draft.model = model.changed(known=statuses)


def independent(
    problem: ContactProblem, sets: IndexSets, reduced: ReducedProblem
) -> tuple[IndexSets, ReducedProblem]:
    """A RID and its projection without conditions that others repeat.

    Args:
        problem: the contact problem.
        sets: index sets of the RID.
        reduced: its projected arrays.
    """
    distinct = problem.distinct[sets.A_lambda]
    if not distinct.all():
        per_row = {
            name: getattr(reduced, name)[distinct]
            for name in ("contact_test", "contact_trial", "gaps", "pairs")
        }
        reduced = replace(reduced, **per_row)
    return _distinct(problem, sets), reduced


def _distinct(problem: ContactProblem, sets: IndexSets) -> IndexSets:
    """A RID without conditions that others repeat, whose rows are dependent for any basis."""
    return replace(sets, A_lambda=sets.A_lambda[problem.distinct[sets.A_lambda]])
