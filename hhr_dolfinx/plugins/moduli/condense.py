"""Interpolated condensation, offline: S and the free slack of each component at few parameters, and
between them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from dataclasses import fields as fields_of
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.certify.compare import Comparison
from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import (
    BoundError,
    ConvergenceError,
    NotOfferedError,
    NotSolvableError,
    ReductionError,
    SceneWarning,
    StabilityWarning,
)
from hhr_dolfinx.formulas import box_samples
from hhr_dolfinx.models.condensed import CondensedModel
from hhr_dolfinx.models.eliminations.block import BlockElimination
from hhr_dolfinx.models.estimates import NOT_ASKED, warn_unbounded
from hhr_dolfinx.models.full import FullModel, plain_outputs
from hhr_dolfinx.models.starts import KnownStatuses, LinearStarts
from hhr_dolfinx.plugins.exact_errors.offline import singular_along
from hhr_dolfinx.plugins.moduli.bounding import between, varying_bound
from hhr_dolfinx.plugins.moduli.components import (
    ComponentSolver,
    interpolated_compliances,
    kept,
    solvers_of,
)
from hhr_dolfinx.plugins.moduli.interpolate import DEFAULT_GRID, GridSettings
from hhr_dolfinx.plugins.moduli.interpolate_reduced import whole_problem
from hhr_dolfinx.plugins.moduli.interpolated import Compliances, InterpolatedFields
from hhr_dolfinx.plugins.moduli.interpolation import GrownGrid
from hhr_dolfinx.plugins.moduli.shaped import ReshapedElimination
from hhr_dolfinx.reduction.modes import pod
from hhr_dolfinx.reduction.recipe import Pod
from hhr_dolfinx.reduction.reductor import Reductor, Task, compared, made
from hhr_dolfinx.reduction.starts import NO_FIELDS, STAGE, linear_starts
from hhr_dolfinx.sampling import Sobol
from hhr_dolfinx.snapshots.records import check_of_problem
from hhr_dolfinx.timing import Announce
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    from hhr_dolfinx.models.eliminations.elimination import Elimination
    from hhr_dolfinx.models.functionals.functional import AllOutputs
    from hhr_dolfinx.plugins.one_call.array_store import ArrayStore
    from hhr_dolfinx.plugins.one_call.context import SearchContext
    from hhr_dolfinx.plugins.one_call.proposals import Proposal
    from hhr_dolfinx.trained import Trained


ALONG = 4
"""Points along each path that samples the forces of a law that remembers."""
MOST_STARTS = 256
FEWEST_STARTS = 32
START_BYTES = 0.13e9
"""Points with tabulated statuses: four times as many save a tenth of the iterations on the pellet.

Their number is reduced if the displacements there would take more memory than this.
"""
FIELD_TOLERANCE = 1e-13
"""Part of the squared sum of displacements that the basis of the fields may leave out."""
FORCE_TOLERANCE = 1e-9
"""Part of the squared forces that the fields of a shape may leave out."""
FIELD_NODES = 8
"""Number of shapes that these fields are solved at."""
LEAST_NORM = 1e-300
"""Least norm that forces are divided by: they may be zero."""
_INTERPOLATED = (
    "S is interpolated between parameters and not resolved here: raise the budget of the grid or "
    "narrow the box"
)
ADVICE: Mapping[Status, str] = MappingProxyType(
    {Status.CYCLING: _INTERPOLATED, Status.SINGULAR: _INTERPOLATED}
)
COMPARED_SHAPES = 8
"""Shapes at which the effect of contact on motions is compared."""
SHAPE_ROUND_OFF = 1e-9
"""Relative difference of these effects that is round-off."""
OF_MEMORY = (
    "moduli vary, and contacts remember their path: how far interpolated forces are off is not "
    "bounded there"
)
ALONG_NODES = (4, 16)
"""Nodes of a grid, at least and at most, at which fields are solved without snapshots, each a
factorisation.

Of 32 fields those at 3 to 16 nodes were as good.
"""
PER_NODE = 8
"""Fields for each of these nodes."""
FIELDS_AT_ONCE = 16
"""Fields that are solved for at once."""
FEW = 150_000
"""Numbers of an interpolation up to which it may be finer than requested: they fit into the cache
of a processor, so that answers take hardly longer, and into a page.
"""
OF_CONDENSATION = {
    "displacement": (
        "it is a combination of training answers, of which forces need none: train on more points"
    ),
    "contact force": (
        "S is interpolated: take GridSettings with a smaller tolerance or a larger budget"
    ),
}
"""Remedies for models with all contact conditions and without a RID, by the error."""
GRID_PART = 1e-3
"""Target error of interpolated S in a search, as a part of its target: errors of forces are ten or
more times larger, just after a contact has closed even more.
"""
GRID_BUDGETS = (200, 800, 800, 800, 800)
"""Solutions for each component in rounds of a search."""


@dataclass(frozen=True, eq=False)
class CondensedFacts:
    """Facts of an interpolated condensation, for the record of its construction."""

    settings: GridSettings  #: targets of its grids
    evaluations: list[int]  #: solutions of the parts of the scene, one number for each grid
    surpluses: list[float]  #: surplus of the terms tried last, relative
    #: error of the formulas of moduli between the nodes of the grids, as far as tested, relative
    unresolved: float
    finer: bool  #: answers use the interpolation of the bound instead of these grids

    @property
    def doubt(self) -> float:
        """Expected error of S of grids that spent their budget before they converged; else 0."""
        worst = max([self.unresolved, *self.surpluses])
        return 0.0 if self.finer or worst <= self.settings.tolerance else worst


class _Prepared(NamedTuple):
    """The task of all attempts, and solvers of all components.

    The solvers keep their solutions for further tasks.
    """

    task: Task
    solvers: list[ComponentSolver]

    @property
    def store(self) -> ArrayStore | None:
        """Store of the solvers, which keeps arrays of stages too."""
        return self.solvers[0].store if self.solvers else None

    def compliances(self, settings: GridSettings) -> tuple[Compliances, list[GrownGrid]]:
        """Compliances of all components, with a warning if a grid spent its budget.

        Args:
            settings: targets of the grids.

        Returns:
            The compliances, and the grid of each component.
        """
        full = self.task.full
        with self.task.log.stage("compliances", self.task.announce):
            interpolated = interpolated_compliances(
                full.problem, self.solvers, settings, announce=self.task.announce
            )
        compliances, grids, _ = interpolated
        worst = max((grid.surplus for grid in grids), default=0.0)
        if worst > settings.tolerance:
            warn(
                f"interpolated condensation of scene '{full.scene.name}' spent its budget of "
                f"{settings.budget} solutions, and an error of about {worst:.1e} is left where "
                f"{settings.tolerance:g} was wished: raise the budget, narrow the box, smooth "
                "formulas of moduli that jump or have spikes, or take the hyper-reduced model",
                StabilityWarning,
            )
        return compliances, grids

    def starts(
        self, compliances: Compliances, settings: GridSettings
    ) -> tuple[KnownStatuses, np.ndarray]:
        """Starts of searches, and typical forces.

        Starts of elastic bodies are stored for an interrupted run.

        Args:
            compliances: compliances of all components.
            settings: targets of the grids, for the name in the store.

        Returns:
            The starts, and contact forces, (S, m).
        """
        full = self.task.full
        announce = self.task.announce
        problem = full.problem
        room = int(np.log2(START_BYTES / (8 * problem.free.size)))
        points = Sobol(min(MOST_STARTS, max(FEWEST_STARTS, 2**room))).points(problem.parameters)
        if problem.law.remembers:
            return _starts_along_paths(
                _with_motions(compliances, problem), points, problem, announce
            )
        if problem.kernel is not None:
            return _starts_beside_motions(_with_motions(compliances, problem), points, problem)

        def starts() -> dict[str, np.ndarray]:
            starts_of_points = linear_starts(
                compliances, points, problem.contact_pairs, group=full.group, announce=announce
            )
            return {
                entry.name: getattr(starts_of_points, entry.name)
                for entry in fields_of(LinearStarts)
            }

        starts_of_points = LinearStarts(
            **kept(self.store, f"starts {settings} {len(points)}", starts)
        )
        return starts_of_points, np.maximum(starts_of_points.margins, 0.0)

    def bounded(
        self, fields: InterpolatedFields, forces: np.ndarray, *, wanted: bool
    ) -> InterpolatedFields:
        """Fields with a bound; unchanged without one, with the reason in the log.

        Args:
            fields: fields without a bound.
            forces: typical contact forces, (m, S).
            wanted: True if the caller requests a bound.
        """
        full = self.task.full
        announce = self.task.announce
        if full.problem.kernel is not None:
            return replace(
                fields, unbounded=NOT_ASKED if not wanted else singular_along(full.problem)
            )
        if not wanted or full.problem.law.remembers:
            return replace(fields, unbounded=NOT_ASKED if not wanted else OF_MEMORY)
        try:
            with self.task.log.stage("bound", announce):
                return replace(
                    fields, bound=varying_bound(full, fields.basis, forces, self.solvers, announce)
                )
        except BoundError as error:
            self.task.log.skip("bound", str(error))
            unbounded = replace(fields, unbounded=str(error))
            warn_unbounded(unbounded)
            return unbounded

    def unbounded(self) -> bool:
        """True if the errors of a model have no bound, whatever its fields."""
        if self.task.full.problem.law.remembers or self.task.full.problem.kernel is not None:
            return True
        try:
            with self.task.log.stage("bound", self.task.announce):
                between(self.task.full, self.solvers, self.task.announce)
        except BoundError as error:
            self.task.log.skip("bound", str(error))
            return True
        return False


@dataclass(frozen=True)
class Condensation(Reductor[_Prepared]):
    """Interpolated condensation: keeps all contact conditions and interpolates their compliance.

    Displacements of snapshots span the fields; the contact forces do not need them. Without
    snapshots, fields of typical forces and loads at some nodes of the grids do.
    """

    settings: GridSettings | None = None  #: targets of the sparse grids; None for the defaults
    bound: bool = True  #: answers have a bound of their error, or an estimate if none is proved
    fields: bool = True  #: answers have displacements; without them there is no bound either
    along: bool = (
        False  # displacements under forces and loads span the fields in addition to snapshots
    )
    finer: bool | None = (
        # answers use the interpolation of the bound if it is small; None: without ``settings``
        None
    )
    spare: bool = False  #: leave out fields if there can be no bound; nothing is compared then
    method: ClassVar[str] = "condensed"
    own_range: ClassVar[bool] = True
    remedy: ClassVar[Mapping[str, str]] = OF_CONDENSATION

    @classmethod
    def usual(cls, settings: GridSettings | None, *, fields: bool | None) -> Condensation:
        """See :meth:`~hhr_dolfinx.reduction.reductor.Reductor.usual`.

        Args:
            settings: targets of the sparse grids; None for the defaults.
            fields: True for displacements and a bound; None for the defaults.
        """
        return cls(settings) if fields is None else cls(settings, bound=fields, fields=fields)

    def check(self, task: Task) -> None:
        """Refuse other scenes than of elastic bodies whose stiffness varies.

        Raises:
            ReductionError: if the stiffness is constant, or bodies have laws.
            NotOfferedError: if a shape changes how contact acts on motions of bodies that it alone
                holds.
            NotSolvableError: if K is singular at a corner of the box.
        """
        full = task.full
        problem: ContactProblem = full.problem
        problem.require_parts("condensation")
        if full.equilibrium is not None or not problem.varies:
            raise ReductionError(
                f"the stiffness of scene '{full.scene.name}' does not depend on parameters, or "
                "its bodies have laws: interpolated condensation is for elastic bodies that vary; "
                "take exact_condensation"
            )
        _check_motions(problem)
        if full.scene.system is not None:
            _check_supports(full)
        if task.snapshots is not None:
            check_of_problem("snapshots", task.snapshots, problem)

    def prepare(self, task: Task, before: _Prepared | None = None) -> _Prepared:
        """Solvers of all components.

        Args:
            task: the full model and its answers.
            before: data of another task of the same full model; None without any.
        """
        task.full.problem.require_whole()
        return _Prepared(task, solvers_of(task.full) if before is None else before.solvers)

    def attempt(self, prepared: _Prepared, level: int) -> tuple[CondensedModel, CondensedFacts]:
        """The condensed model, and the facts of its record.

        Args:
            prepared: solvers of the components.
            level: unused; there is one level.
        """
        task = prepared.task
        full = task.full
        finer = self.settings is None if self.finer is None else self.finer
        settings = self.settings or DEFAULT_GRID
        problem: ContactProblem = full.problem
        compliances, grids = prepared.compliances(settings)
        with task.log.stage("starts", task.announce):
            starts, forces = prepared.starts(compliances, settings)
        fields = self.fields and not (self.spare and prepared.unbounded())
        with task.log.stage("fields", task.announce):
            if fields:
                seen = (
                    []
                    if problem.reshaped is None
                    else _fields_seen(compliances, prepared.solvers, forces)
                )
                if task.snapshots is None:
                    _warn_of_untouched(prepared.solvers)
                if task.snapshots is None or self.along:
                    solved = compliances, prepared.solvers, starts.points, forces, task.announce
                    seen.append(
                        kept(
                            prepared.store,
                            f"fields {settings}",
                            lambda: {"0": _fields_along(*solved)},
                        )["0"]
                    )
                if task.snapshots is not None:
                    seen.append(task.snapshots.displacements)
                completed = _fields(full, seen, settings)
            else:
                basis = np.zeros((problem.free.size, 0))
                options = None, problem.block_size, None, _outputs(full, basis, settings)
                completed = InterpolatedFields(
                    problem.amplitudes, basis, problem.lifts, *options, full=full
                )
        if fields:
            forces = forces.T if task.snapshots is None else task.snapshots.forces
            completed = prepared.bounded(completed, forces, wanted=self.bound)
        answering = _finer(compliances, completed.bound) if finer else compliances
        eliminated = _with_motions(answering, problem)
        scene_arrays = full.parameters, eliminated, starts, completed, problem.contact_pairs
        model = CondensedModel(*scene_arrays, advice=ADVICE, law=problem.law)
        numbers = [grid.evaluations for grid in grids], [grid.surplus for grid in grids]
        unresolved = max((grid.unresolved for grid in grids), default=0.0)
        return model, CondensedFacts(
            settings, *numbers, unresolved, finer=answering is not compliances
        )

    def compare(
        self, task: Task, model: CondensedModel
    ) -> tuple[Comparison | None, Trained | None]:
        """Errors against validation answers; those of training span the fields.

        Args:
            task: the full model and its answers.
            model: the condensed model.

        Returns:
            The comparison, None if nothing was compared, and the training range.
        """
        if task.held_out is None or self.spare or not self.fields:
            return None, model.trained
        return compared(task, model, self.limits, self.remedy)

    def proposals(self, search: SearchContext) -> Iterator[Proposal]:
        """Finer and finer grids while forces are off.

        Displacements of checks improve the fields of later rounds.
        """
        from hhr_dolfinx.plugins.one_call.proposals import Proposal

        before = _Prepared(Task(search.full), solvers_of(search.full, search.store))
        tolerance = GRID_PART * search.target.error
        # without fields nothing bounds an error; without a bound they serve displacements alone
        spare = not search.reads_displacements
        for budget in GRID_BUDGETS:
            settings = GridSettings(tolerance, budget)

            def make(settings: GridSettings = settings) -> CondensedModel:
                task = Task(search.full, search.checked, announce=search.announce, sure=0)
                return made(
                    Condensation(settings, along=True, finer=True, spare=spare), task, before
                )

            def spared(settings: GridSettings = settings) -> CondensedModel:
                # all expensive results exist by now, so the budget need not stop the rest
                task = Task(search.full, announce=search.progress, sure=0)
                return made(Condensation(settings, fields=False), task, before)

            count = len(search.held_out)
            spanned = f", fields of {count} checks too" if count else ""
            setting = f"interpolated to {tolerance:.0e}{spanned}"
            yield Proposal(self.method, setting, make, spared if spare else None)
            if search.forces_off:
                tolerance /= 100


def _check_motions(problem: ContactProblem) -> None:
    """Refuse a shape that changes how contact acts on motions of bodies that it alone holds.

    Or one that changes their loads.
    """
    kernel: Any = problem.kernel
    if kernel is None or problem.reshaped is None:
        return
    for point in Sobol(COMPARED_SHAPES).points(problem.parameters):
        kernel_at_point: Any = problem.at(point).kernel
        pairs = (
            (kernel_at_point.contact_of_motions, kernel.contact_of_motions),
            (kernel_at_point.loads, kernel.loads),
        )
        if any(
            np.abs(changed - reference).max() > SHAPE_ROUND_OFF * np.abs(reference).max()
            for changed, reference in pairs
        ):
            raise NotOfferedError(
                "contact alone holds bodies, and a shape changes the directions in which it does: "
                "the balance of these bodies is exact in every model, and interpolated it would "
                f"not be. Take the full model: {kernel.described}"
            )


def _check_supports(full: Any) -> None:
    """Refuse a user-defined system that leaves motions only at a corner of the box."""
    from hhr_dolfinx.plugins.elasticity.unresisted import unresisted

    problem: ContactProblem = full.problem
    if problem.kernel is not None:
        return
    loose = full.discretisation.free_bodies(problem)
    for point in box_samples(problem.parameters, 1) if loose else ():
        unheld = unresisted(loose, problem, problem.stiffness_of(problem.weights(point)))
        if unheld:
            raise NotSolvableError(
                f"at {problem.parameters.described(point)} nothing but contact holds "
                f"{unheld[0].name} which {unheld[0].described(unheld[0].left)} there: K is "
                "singular at this corner of the box, and S grows without limit towards it, so "
                "that nothing interpolates it. Narrow the box"
            )


def _with_motions(compliances: Compliances, problem: ContactProblem) -> Elimination:
    """The elimination with the motions of bodies that contact alone holds; itself without any."""
    return (
        problem.kernel.beside(compliances)
        if problem.kernel is not None and problem.held_by_contact
        else compliances
    )


def _starts_beside_motions(
    eliminated: Elimination, points: np.ndarray, problem: ContactProblem
) -> tuple[KnownStatuses, np.ndarray]:
    """Starts and typical forces, (S, m), where contact alone holds bodies.

    They are those of answers at points, (S, P).
    """
    nothing = KnownStatuses(problem.middle[None], np.zeros((1, len(problem.gaps)), dtype=bool))
    model = CondensedModel(
        problem.parameters, eliminated, nothing, NO_FIELDS, problem.contact_pairs, law=problem.law
    )
    answers = [model.solve(point, start=None, raise_on_failure=False) for point in points]
    starts = KnownStatuses.of_answers(iter(answers))
    if starts is None:
        raise ReductionError(
            "no point of the box has an answer: loads drive bodies off their contacts in all of it"
        )
    return starts, np.array([answer.multipliers for answer in answers if answer.converged])


def _starts_along_paths(
    eliminated: Elimination, points: np.ndarray, problem: ContactProblem, announce: Announce
) -> tuple[KnownStatuses, np.ndarray]:
    """Starts and typical forces, (S, m), with a law that remembers.

    Increments start from the previous one.

    Forces are those along paths through a few of the points, (S, P), each, which load, unload and
    reverse; parameters that stay along a path are those of its first point.
    """
    nothing = KnownStatuses(problem.middle[None], np.zeros((1, len(problem.gaps)), dtype=bool))
    model = CondensedModel(
        problem.parameters, eliminated, nothing, NO_FIELDS, problem.contact_pairs, law=problem.law
    )
    fixed = problem.law.fixed
    forces = []
    seen = []
    for first in range(0, len(points), ALONG):
        announce(STAGE, first / len(points))
        along = points[first : first + ALONG].copy()
        along[:, fixed] = along[0, fixed]
        at_rest = np.clip(0.0, problem.parameters.lower, problem.parameters.upper)
        at_rest[fixed] = along[0, fixed]
        try:
            history = model.march(
                [(0.0, at_rest), *((1.0 + k, point) for k, point in enumerate(along))]
            )
        except ConvergenceError as stop:
            history = vars(stop)["history"]
        forces += [answer.multipliers for answer in history.answers]
        seen += [answer.parameter for answer in history.answers]
    if not forces:
        raise ReductionError(
            "no path through the box has an answer: contact rows are dependent, or the law of the "
            "contacts admits none"
        )
    return KnownStatuses(np.array(seen), np.array(forces) != 0), np.array(forces)


def _warn_of_untouched(solvers: list[ComponentSolver]) -> None:
    """Warn of loaded bodies without any contact: without snapshots nothing spans their fields."""
    problem = solvers[0].problem
    touched = {solver.component.number for solver in solvers}
    loads = csr_matrix(problem.external)
    lifts = csr_matrix(problem.lifts)
    wrong = [
        body
        for number, body in enumerate(problem.bodies)
        # factors that serve all bodies include the response to loads there
        if number not in touched
        and loads[body].nnz
        and (lifts[body].nnz or not solvers[0].serves_all)
    ]
    if wrong:
        warn(
            "nothing can touch a body that loads or displacements move: contact forces are right, "
            "its displacement is not. Leave it out of the scene, train and condense, or ask the "
            "full model",
            SceneWarning,
        )


def _outputs(full: FullModel, basis: np.ndarray, settings: GridSettings) -> AllOutputs | None:
    """Outputs for displacements in a basis, (N, ell)."""
    reshaped: Any = full.problem.reshaped
    if reshaped is None:
        return plain_outputs(full)
    prepared = full.functionals
    return (
        None
        if prepared is None
        else reshaped.interpolated_outputs(prepared, full.problem, basis, settings)
    )


def _fields(full: FullModel, seen: list[np.ndarray], settings: GridSettings) -> InterpolatedFields:
    """Galerkin's method on the span of displacements, (N, k) each, body by body.

    The list is emptied.
    """
    problem: ContactProblem = full.problem
    displacements = seen[0] if len(seen) == 1 else np.column_stack(seen)
    seen.clear()  # it may take half of the memory of a model
    motions = None
    if (
        problem.kernel is not None
    ):  # motions are separate unknowns, beside displacements orthogonal to them
        motions = problem.kernel.motions
        all_motions = np.hstack([motions, problem.kernel.idle])
        displacements = displacements - all_motions @ (all_motions.T @ displacements)
        problem = replace(problem, kernel=None)
    basis = Pod(FIELD_TOLERANCE, relative=True, by_body=True).of_columns(
        problem, displacements, full.group
    )
    del displacements
    if problem.reshaped is not None:
        # orthonormal in the energy of the middle: soft modes are then as exact as stiff ones
        energies, ways = np.linalg.eigh(basis.T @ (problem.stiffness @ basis))
        significant = energies > 1e-12 * energies[-1]
        basis = basis @ (ways[:, significant] / np.sqrt(energies[significant]))
    projected: Any = whole_problem(problem, basis, settings)
    galerkin: BlockElimination | ReshapedElimination = BlockElimination(
        projected, problem.amplitudes
    )
    if problem.reshaped is not None:
        galerkin = ReshapedElimination(projected, problem.amplitudes, problem.parameters)
    spanned = basis if motions is None else np.hstack([basis, motions])
    options = galerkin, problem.block_size, full.stress_of, _outputs(full, spanned, settings)
    return InterpolatedFields(
        problem.amplitudes, basis, problem.lifts, *options, motions=motions, full=full
    )


def _finer(compliances: Compliances, bound: Any) -> Compliances:
    """Interpolation of the bound if its grids are as fine and small: it then has no other error."""
    if bound is None:
        return compliances
    pairs = list(zip(compliances.parts, bound.compliances.parts, strict=True))
    finer = all(
        len(coarse.interpolant.levels) <= len(fine.interpolant.levels) for coarse, fine in pairs
    )
    numbers = sum(fine.interpolant.modes.size + fine.columns.size for _, fine in pairs)
    return bound.compliances if finer and numbers <= FEW else compliances


def _fields_seen(
    compliances: Compliances, solvers: list[ComponentSolver], forces: np.ndarray
) -> list[np.ndarray]:
    """Displacements at some shapes under typical forces, (N, k) each.

    Few snapshots do not span them. The forces are (S, m).
    """
    forces = forces.T
    forces = pod(forces / np.maximum(np.linalg.norm(forces, axis=0), LEAST_NORM), FORCE_TOLERANCE)[
        0
    ]
    displacements = []
    for component, solver in zip(compliances.parts, solvers, strict=True):
        for node in component.interpolant.nodes[:FIELD_NODES]:
            point = solver.problem.middle
            point[component.interpolant.axes] = node
            displacements.append(solver.fields_at(point, forces))
    return displacements


def _fields_along(
    compliances: Compliances,
    solvers: list[ComponentSolver],
    points: np.ndarray,
    forces: np.ndarray,
    announce: Announce,
) -> np.ndarray:
    """Displacements under loads and forces of solved points, (S, P) and (S, m): (N, k).

    The points are shared out among the nodes of a grid. Displacements by lifts have their own
    columns, as they do not depend on a factor of the stiffness. All components share columns: each
    has displacements on its dofs alone.
    """
    count = len(points)
    least, most = ALONG_NODES
    few = max(least, min(most, count // PER_NODE))
    nodes_of_parts = [component.interpolant.nodes[:few] for component in compliances.parts]
    lifts = sum(
        len(nodes) * component.lifted.size
        for nodes, component in zip(nodes_of_parts, compliances.parts, strict=True)
    )
    # one array, since stacking would copy it
    fields = np.zeros((solvers[0].problem.free.size, count + lifts), order="F")
    column = count
    done = 0
    for component, solver, nodes in zip(compliances.parts, solvers, nodes_of_parts, strict=True):
        for first, node in enumerate(nodes):
            point = solver.problem.middle
            share = slice(first, count, len(nodes))
            point[component.interpolant.axes] = node
            # the first component solves for all if its factors serve all
            solved_points = (
                np.arange(count)[share]
                if solver is solvers[0] or not solver.serves_all
                else np.arange(0)
            )
            for block in (
                np.array_split(solved_points, -(-solved_points.size // FIELDS_AT_ONCE))
                if solved_points.size
                else ()
            ):
                fields[:, block] += solver.fields_under(point, points[block], forces[block])
            fields[:, column : column + component.lifted.size] = solver.fields_of_lifts(point)
            column += component.lifted.size
            done += 1
            announce("fields", done / sum(map(len, nodes_of_parts)))
        solver.release()
    return fields
