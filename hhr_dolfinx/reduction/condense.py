"""Interpolated condensation, offline: compute S and the free slack at few parameters, and interpolate between them.

Each connected component of a scene is solved separately, at the parameters of its sparse grid.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.certify.accuracy import force_floor
from hhr_dolfinx.certify.compare import Comparison, compare_points
from hhr_dolfinx.certify.trust import OF_CONDENSATION, TrustLimits, check_comparison
from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.contact.problem import ContactProblem, IndexSets
from hhr_dolfinx.errors import BoundError, NotOfferedError, ReductionError, SceneWarning, StabilityWarning
from hhr_dolfinx.models.condensed import CondensedModel
from hhr_dolfinx.models.eliminations.block import BlockElimination
from hhr_dolfinx.models.eliminations.interpolated import Compliances, InterpolatedFields
from hhr_dolfinx.models.eliminations.interpolation import GrownGrid
from hhr_dolfinx.models.eliminations.shaped import ReshapedElimination
from hhr_dolfinx.models.estimates import NOT_ASKED, known_error, warn_unbounded
from hhr_dolfinx.models.full import FullModel, plain_outputs
from hhr_dolfinx.models.starts import KnownStatuses
from hhr_dolfinx.reduction.components import Solver, interpolated_compliances, solvers_of
from hhr_dolfinx.reduction.interpolate import DEFAULT_GRID, GridSettings
from hhr_dolfinx.reduction.interpolate_reduced import interpolated_problem
from hhr_dolfinx.reduction.modes import pod
from hhr_dolfinx.reduction.projection import project
from hhr_dolfinx.reduction.recipe import Pod
from hhr_dolfinx.reduction.shaped import reshaped_functionals
from hhr_dolfinx.reduction.starts import starts_of
from hhr_dolfinx.reduction.varying_bound import between, varying_bound
from hhr_dolfinx.sampling import Sobol
from hhr_dolfinx.snapshots.records import SnapshotSet, check_of_problem
from hhr_dolfinx.timing import Announce, StageLog, unannounced
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    from hhr_dolfinx.models.functionals.functional import Functionals, ShapeFunctionals
    from hhr_dolfinx.models.functionals.shaped import ReshapedFunctionals


STARTS = 256
FEWEST_STARTS = 32
START_BYTES = 0.13e9
"""Points with tabulated statuses: four times as many save a tenth of the iterations on the pellet. Their number is
reduced if the displacements there would take more memory than this."""
FIELD_TOLERANCE = 1e-13
"""Part of the squared sum of displacements that the basis of the fields may leave out."""
FORCE_TOLERANCE = 1e-9
FIELD_NODES = 8
TINY = 1e-300
"""Part of the squared forces that the fields of a shape may leave out, and the number of shapes they are solved at."""
_INTERPOLATED = (
    "S is interpolated between parameters and not resolved here: raise the budget of the grid or narrow the box"
)
ADVICE: Mapping[Status, str] = MappingProxyType({Status.CYCLING: _INTERPOLATED, Status.SINGULAR: _INTERPOLATED})
OF_FRICTION = "the moduli of bodies with friction vary, and how far interpolated forces are off is not bounded there"
ALONG_NODES = (4, 16)
PER_NODE = 8
TOGETHER = 16
"""Nodes of a grid at which fields are solved without snapshots, each a factorisation, at least and at most; fields for
each of them; and the number solved for at once. Of 32 fields those at 3 to 16 nodes were as good."""


FEW = 150_000
"""Numbers of an interpolation up to which it may be finer than requested: they fit into the cache of a processor, so
that answers take hardly longer, and into a page."""


@dataclass(frozen=True)
class CondensedRecord:
    """Record of an interpolated condensation.

    Attributes:
        settings: targets of its grids.
        evaluations: solutions of the parts of the scene, one number for each grid.
        surpluses: surplus of the terms tried last, relative.
        unresolved: error of the formulas of moduli between the nodes of the grids, as far as it was tested, relative.
        comparison: errors against known answers; None without known answers.
        log: seconds of the stages.
        finer: whether answers use the interpolation of the bound instead of these grids.
    """

    settings: GridSettings
    evaluations: list[int]
    surpluses: list[float]
    unresolved: float
    comparison: Comparison | None
    log: StageLog
    finer: bool


@dataclass(frozen=True)
class Condensation:
    """Interpolated condensation as a reduction, see :func:`condense`.

    Attributes:
        settings: targets of the sparse grids; see :func:`condense`.
        bound: whether answers have a bound of their error.
    """

    settings: GridSettings | None = None
    bound: bool = True

    def reduced(self, full: FullModel, snapshots: SnapshotSet, held_out: SnapshotSet | None = None) -> CondensedModel:
        """See :func:`condense`."""
        return condense(full, snapshots, self.settings, held_out, bound=self.bound)


def condense(
    full: FullModel,
    snapshots: SnapshotSet | None,
    settings: GridSettings | None = None,
    held_out: SnapshotSet | None = None,
    *,
    bound: bool = True,
    fields: bool = True,
    along: bool = False,
    finer: bool | None = None,
    solvers: list[Solver] | None = None,
    spare: bool = False,
    announce: Announce = unannounced,
) -> CondensedModel:
    """Build a model that keeps all contact conditions and interpolates their compliance.

    Args:
        full: the full model, on one rank, whose stiffness depends on parameters.
        snapshots: answers whose displacements span the fields; the contact forces do not need them. None computes
            fields of typical forces and loads at some nodes of the grids.
        settings: targets of the sparse grids; None for the defaults.
        held_out: answers the model is compared with.
        bound: whether answers have a bound of their error, or an estimate if none is proved.
        fields: whether answers have displacements; without them there is no bound either.
        along: whether displacements under forces and loads span the fields in addition to snapshots.
        finer: whether answers use the interpolation of the bound if it is small; None: only without ``settings``.
        solvers: of all components, by :func:`solvers_of`, which keep their solutions for another model.
        spare: whether to leave out fields if there can be no bound.
        announce: called with each stage and the share of it that is done; an exception from it stops the build.

    Raises:
        ReductionError: for a scene of constant stiffness, or of bodies with laws.

    Warns:
        StabilityWarning: if a grid spent its budget before it converged.
    """
    finer = settings is None if finer is None else finer
    settings = settings or DEFAULT_GRID
    problem: ContactProblem = full.problem
    _check_given(full, snapshots)
    log = StageLog()
    solvers = solvers_of(full) if solvers is None else solvers
    compliances, grids = _compliances(full, solvers, settings, log, announce)
    with log.stage("starts", announce):
        known, forces = starts_of(compliances, _starts(problem), problem, full.comm, announce)
    fields = fields and not (spare and _unbounded(full, log, solvers, announce))
    with log.stage("fields", announce):
        seen = _spanning(compliances, solvers, known, forces, snapshots, announce, along=along) if fields else []
        made = _fields(full, seen, settings) if fields else _no_fields(full, settings)
    if fields:
        forces = forces.T if snapshots is None else snapshots.forces
        made = _bounded(full, made, forces, log, solvers, announce, wanted=bound)
    answering = _finer(compliances, made.bound) if finer else compliances
    model = CondensedModel(
        full.parameters, answering, known, made, problem.contact_pairs, advice=ADVICE, friction=problem.friction
    )
    log.say(known_error(made))
    comparison = _compared(full, model, snapshots, held_out, log) if fields else None
    model.offline = _record(settings, grids, comparison, log, finer=answering is not compliances)
    return model


def _compared(
    full: FullModel, model: CondensedModel, snapshots: SnapshotSet | None, held_out: SnapshotSet | None, log: StageLog
) -> Comparison | None:
    """Comparison with answers held out; None without any."""
    if held_out is None or snapshots is None:
        return None
    with log.stage("validation"):
        comparison = compare_points(full, model, held_out, force_floor(full.problem, snapshots))
        check_comparison(comparison, TrustLimits(), OF_CONDENSATION)
    return comparison


def _record(
    settings: GridSettings, grids: list[GrownGrid], comparison: Comparison | None, log: StageLog, *, finer: bool
) -> CondensedRecord:
    """Record of the construction of a model."""
    numbers = [grid.evaluations for grid in grids], [grid.surplus for grid in grids]
    unresolved = max((grid.unresolved for grid in grids), default=0.0)
    return CondensedRecord(settings, *numbers, unresolved, comparison, log, finer)


def _starts(problem: ContactProblem) -> np.ndarray:
    """Points with tabulated statuses, a power of two of them, (S, P)."""
    room = int(np.log2(START_BYTES / (8 * problem.free.size)))
    return Sobol(min(STARTS, max(FEWEST_STARTS, 2**room))).points(problem.parameters)


def _warn_of_budget(full: FullModel, grids: list[GrownGrid], settings: GridSettings) -> None:
    """Warn of a grid that spent its budget before it converged."""
    worst = max((grid.surplus for grid in grids), default=0.0)
    if worst > settings.tolerance:
        warn(
            f"interpolated condensation of scene '{full.scene.name}' spent its budget of {settings.budget} solutions, "
            f"and an error of about {worst:.1e} is left where {settings.tolerance:g} was wished: raise the budget, "
            "narrow the box, smooth formulas of moduli that jump or have spikes, or take the hyper-reduced model",
            StabilityWarning,
            stacklevel=5,
        )


def _warn_of_untouched(snapshots: SnapshotSet | None, solvers: list[Solver]) -> None:
    """Warn of loaded bodies without any contact: without snapshots nothing spans their fields."""
    if snapshots is not None:
        return
    problem = solvers[0].problem
    touched = {solver.component.number for solver in solvers}
    loads = csr_matrix(problem.external)
    lifts = csr_matrix(problem.lifts)
    wrong = [
        body
        for number, body in enumerate(problem.bodies)
        # factors that serve all bodies include the response to loads there
        if number not in touched and loads[body].nnz and (lifts[body].nnz or not solvers[0].serves_all)
    ]
    if wrong:
        warn(
            "nothing can touch a body that loads or displacements move: contact forces are right, its displacement is "
            "not. Leave it out of the scene, train and condense, or ask the full model",
            SceneWarning,
            stacklevel=4,
        )


def _outputs(full: FullModel, basis: np.ndarray, settings: GridSettings) -> Functionals | ReshapedFunctionals | None:
    """Outputs for displacements in a basis, (N, ell)."""
    if full.problem.reshaped is None:
        return plain_outputs(full)
    prepared = cast("ShapeFunctionals | None", full.functionals)
    return None if prepared is None else reshaped_functionals(prepared, full.problem, basis, settings)


def _no_fields(full: FullModel, settings: GridSettings) -> InterpolatedFields:
    """Outputs of forces alone, without displacement."""
    problem = full.problem
    basis = np.zeros((problem.free.size, 0))
    functionals = _outputs(full, basis, settings)
    return InterpolatedFields(
        problem.amplitudes, basis, problem.lifts, None, problem.block_size, None, functionals=functionals, full=full
    )


def _fields(full: FullModel, seen: list[np.ndarray], settings: GridSettings) -> InterpolatedFields:
    """Galerkin's method on the span of displacements, (N, k) each, body by body; the list is emptied."""
    problem: ContactProblem = full.problem
    displacements = seen[0] if len(seen) == 1 else np.column_stack(seen)
    seen.clear()  # it may take half of the memory of a model
    basis = Pod(FIELD_TOLERANCE, relative=True, by_body=True).of_columns(problem, displacements, full.comm)
    del displacements
    if problem.reshaped is not None:
        basis = _of_energy(basis, problem)
    every = np.flatnonzero(problem.free)
    conditions = np.arange(len(problem.gaps))
    sets = IndexSets(np.arange(len(problem.cell_nodes)), every, conditions, every, every, np.zeros(0, dtype=np.int64))
    galerkin: Any = None
    if problem.reshaped is None:
        galerkin = BlockElimination(project(problem, basis, sets), problem.amplitudes)
    else:
        interpolated = interpolated_problem(problem, basis, sets, settings)
        galerkin = ReshapedElimination(interpolated, problem.amplitudes, problem.parameters)
    rest = galerkin, problem.block_size, full.stress_of, _outputs(full, basis, settings)
    return InterpolatedFields(problem.amplitudes, basis, problem.lifts, *rest, full=full)


def _compliances(
    full: FullModel, solvers: list[Solver], settings: GridSettings, log: StageLog, announce: Announce
) -> tuple[Compliances, list[GrownGrid]]:
    """Compliances of all components, with a warning if a grid spent its budget."""
    with log.stage("compliances", announce):
        found, grids = interpolated_compliances(full.problem, solvers, settings, announce=announce)[:2]
    _warn_of_budget(full, grids, settings)
    return found, grids


def _unbounded(full: FullModel, log: StageLog, solvers: list[Solver], announce: Announce) -> bool:
    """True if the errors of a model have no bound, whatever its fields."""
    if full.problem.friction is not None:
        return True
    try:
        with log.stage("bound", announce):
            between(full, solvers, announce)
    except BoundError as error:
        log.skip("bound", str(error))
        return True
    return False


def _bounded(
    full: FullModel,
    fields: InterpolatedFields,
    forces: np.ndarray,
    log: StageLog,
    solvers: list[Solver],
    announce: Announce,
    *,
    wanted: bool,
) -> InterpolatedFields:
    """Fields with a bound; unchanged without one, with the reason in the log."""
    if not wanted or full.problem.friction is not None:
        return replace(fields, unbounded=NOT_ASKED if not wanted else OF_FRICTION)
    try:
        with log.stage("bound", announce):
            return replace(fields, bound=varying_bound(full, fields.basis, forces, solvers, announce))
    except BoundError as error:
        log.skip("bound", str(error))
        found = replace(fields, unbounded=str(error))
        warn_unbounded(found)
        return found


def _finer(compliances: Compliances, bound: Any) -> Compliances:
    """Interpolation of the bound if its grids are as fine and small: it then has no other error."""
    if bound is None:
        return compliances
    pairs = list(zip(compliances.parts, bound.compliances.parts, strict=True))
    finer = all(len(own.interpolant.levels) <= len(other.interpolant.levels) for own, other in pairs)
    numbers = sum(other.interpolant.modes.size + other.columns.size for _, other in pairs)
    return bound.compliances if finer and numbers <= FEW else compliances


def _of_energy(basis: np.ndarray, problem: ContactProblem) -> np.ndarray:
    """Modes of the same span, orthonormal in the energy of the middle of the box.

    K~ is then near the identity at every shape, and the interpolation is as exact for soft modes as for stiff ones.
    """
    energies, ways = np.linalg.eigh(basis.T @ (problem.stiffness @ basis))
    kept = energies > 1e-12 * energies[-1]
    return basis @ (ways[:, kept] / np.sqrt(energies[kept]))


def _spanning(
    compliances: Compliances,
    solvers: list[Solver],
    known: KnownStatuses,
    forces: np.ndarray,
    snapshots: SnapshotSet | None,
    announce: Announce,
    *,
    along: bool,
) -> list[np.ndarray]:
    """Displacements that span the fields, (N, k) each: snapshots, and responses to forces, (S, m), of solved points."""
    _warn_of_untouched(snapshots, solvers)
    seen = [] if solvers[0].problem.reshaped is None else _fields_seen(compliances, solvers, forces)
    if snapshots is None or along:
        seen += _fields_along(compliances, solvers, known.points, forces, announce)
    if snapshots is not None:
        seen.append(snapshots.displacements)
    return seen


def _fields_seen(compliances: Compliances, solvers: list[Solver], forces: np.ndarray) -> list[np.ndarray]:
    """Displacements at some shapes under typical forces, (S, m), (N, k) each: few snapshots do not span them."""
    forces = forces.T
    forces = pod(forces / np.maximum(np.linalg.norm(forces, axis=0), TINY), FORCE_TOLERANCE)[0]
    found = []
    for part, solver in zip(compliances.parts, solvers, strict=True):
        for node in part.interpolant.nodes[:FIELD_NODES]:
            point = solver.problem.middle
            point[part.interpolant.axes] = node
            found.append(solver.fields_at(point, forces))
    return found


def _fields_along(
    compliances: Compliances, solvers: list[Solver], points: np.ndarray, forces: np.ndarray, announce: Announce
) -> list[np.ndarray]:
    """Displacements under loads and forces of solved points, (S, P) and (S, m): (N, k) each.

    The points are shared out among the nodes of a grid. Displacements by lifts have their own columns, since they do
    not depend on a factor of the stiffness. All components share columns, as each has displacements on its dofs alone.
    """
    count = len(points)
    least, most = ALONG_NODES
    few = max(least, min(most, count // PER_NODE))
    every = [part.interpolant.nodes[:few] for part in compliances.parts]
    lifts = sum(len(nodes) * part.lifted.size for nodes, part in zip(every, compliances.parts, strict=True))
    # one array, since stacking would copy it
    fields = np.zeros((solvers[0].problem.free.size, count + lifts), order="F")
    place = count
    done = 0
    for part, solver, nodes in zip(compliances.parts, solvers, every, strict=True):
        for first, node in enumerate(nodes):
            point = solver.problem.middle
            share = slice(first, count, len(nodes))
            point[part.interpolant.axes] = node
            # the first component solves for all if its factors serve all
            own = np.arange(count)[share] if solver is solvers[0] or not solver.serves_all else np.arange(0)
            for some in np.array_split(own, -(-own.size // TOGETHER)) if own.size else ():
                fields[:, some] += solver.fields_under(point, points[some], forces[some])
            fields[:, place : place + part.lifted.size] = solver.fields_of_lifts(point)
            place += part.lifted.size
            done += 1
            announce("fields", done / sum(map(len, every)))
        solver.release()
    return [fields]


def _check_given(full: FullModel, snapshots: SnapshotSet | None) -> None:
    """Raise ReductionError for a scene unsuitable for interpolated condensation, and for snapshots of another one."""
    problem: ContactProblem = full.problem
    problem.require_parts("condensation")
    if full.equilibrium is not None or not problem.varies:
        raise ReductionError(
            f"the stiffness of scene '{full.scene.name}' does not depend on parameters, or its bodies have laws: "
            "interpolated condensation is for elastic bodies that vary; take exact_condensation"
        )
    if problem.pins is not None:
        raise NotOfferedError(
            f"contact alone holds bodies of scene '{full.scene.name}', and their elasticity depends on parameters: "
            "interpolated condensation is not built in for these. Take "
            + ("the full model itself" if problem.friction is not None else "a reduced model, training.build()")
        )
    problem.require_whole()
    if snapshots is not None:
        check_of_problem("snapshots", snapshots, problem)
