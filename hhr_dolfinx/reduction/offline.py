"""Offline stage: from snapshots to a reduced model, a list of named stages.

Stages that a scene does not need are left out and listed with the reason.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hhr_dolfinx.certify.accuracy import force_floor, round_off_force
from hhr_dolfinx.certify.constants import Stability, assess
from hhr_dolfinx.certify.trust import (
    FEW,
    Comparison,
    TrustLimits,
    check_comparison,
    check_growth,
    check_loads_seen,
    check_solvable,
    check_stability,
    check_tolerances,
    compare,
    first_trusted,
    warn_of_gaps_in_training,
    warn_unchecked,
    warn_untouched,
)
from hhr_dolfinx.contact.problem import ContactProblem, FullOrder, IndexSets
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.models.reconstruct import OnlineModel
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.reduction.completion import prepare_reconstruction
from hhr_dolfinx.reduction.deim import deim
from hhr_dolfinx.reduction.enrichment import Enrichment, enrich, record_enrichment
from hhr_dolfinx.reduction.pod import pod
from hhr_dolfinx.reduction.projection import project
from hhr_dolfinx.reduction.rid import contact_nodes, reduced_domain, zone_of_interest
from hhr_dolfinx.snapshots.solutions import SnapshotSet
from hhr_dolfinx.timing import StageLog
from hhr_dolfinx.trained import TrainedRange

MOST_TRAINING_COMPARED = 50
"""Training solutions compared where none were held out, about."""


@dataclass(frozen=True)
class ReductionSettings:
    """How to reduce a scene; the defaults gave the best errors for their time on the pellet-cladding scene.

    Attributes:
        pod_tolerance: epsilon of (1.53) for the basis whose DEIM points make the RID, in (0, 1).
        extended_pod_tolerance: smaller epsilon for the basis of the model itself (POD + FE enrichment,
            section 3.4.2); None keeps the first basis.
        dual_pod_tolerance: epsilon of a POD of the contact forces whose DEIM points extend the RID
            (section 1.4.3); None leaves it out.
        relative: divide each snapshot by its norm before the POD, so that grazing contact counts as
            much as strong contact; the thesis does not.
        layers: layers of cells added around the RID.
        most_layers: layers up to which the RID may grow if the trust check fails.
        zone: maps the problem to nodes added to the RID; None takes one node for each load term, see
            :func:`zone_of_interest`.
        kappa_max: kappa(B~) down to which FE functions are added, Alg. 3.1.
        limits: what the trust check refuses or warns of; None leaves the check out, to measure a model as it is.
    """

    pod_tolerance: float = 1e-11
    extended_pod_tolerance: float | None = None
    dual_pod_tolerance: float | None = 1e-6
    relative: bool = True
    layers: int = 2
    most_layers: int = 4
    zone: Callable[[ContactProblem], np.ndarray] | None = None
    kappa_max: float = 3.0
    limits: TrustLimits | None = TrustLimits()

    def __post_init__(self):
        """Refuse numbers that mean nothing, before anything is computed.

        Raises:
            ReductionError: with the value and what is possible.
        """
        check_tolerances(self, ("pod_tolerance", "extended_pod_tolerance", "dual_pod_tolerance"))
        check_growth(self)

    @classmethod
    def thesis(cls, pod_tolerance: float, **changes) -> ReductionSettings:
        """The recipe of the thesis: plain snapshots, no layers, no growth, kappa_max 10."""
        plain = {"dual_pod_tolerance": None, "relative": False, "layers": 0, "most_layers": 0, "kappa_max": 10.0}
        return cls(pod_tolerance, **(plain | changes))


@dataclass(frozen=True)
class HyperReduction(OnlineModel):
    """A reduced model with all that explains it.

    Attributes:
        basis: V, (N, ell).
        sets: index sets of the RID.
        stability: the constants behind the trust check.
        enrichment: how the basis was enriched.
        comparison: what users get beside solutions that were compared; None if none were.
        log: times of the stages and what was left out.
    """

    basis: np.ndarray
    sets: IndexSets
    stability: Stability
    enrichment: Enrichment
    comparison: Comparison | None
    log: StageLog


def build_reduced_model(
    full_order: FullOrder,
    snapshots: SnapshotSet,
    settings: ReductionSettings = ReductionSettings(),
    held_out: SnapshotSet | None = None,
) -> HyperReduction:
    """Build an HHR model that passes the trust check, thesis sections 1.4.2-1.4.6.

    A model that fails is built again with one more layer of cells, up to ``settings.most_layers``.

    Args:
        full_order: the full model, of which only arrays are used.
        snapshots: training solutions.
        settings: how to reduce.
        held_out: solutions kept out of training, for the trust check; without them training solutions are compared,
            and a warning says so.

    Raises:
        ReductionError: for snapshots or settings no basis can be built from.
        NotSolvableError: if K~ is singular or the contact rows are dependent, (1.67).
        UnstableModelError: if the trust check refuses the model.

    Warns:
        StabilityWarning: if the trust check doubts it, or no training solution has contact.
        UncheckedWarning: if it was not compared with solutions kept out of training.
    """
    _check_given(full_order.problem, snapshots, settings, held_out)
    log = StageLog()
    if settings.limits is None:
        log.skip("validation", "no limits were given: the model is as it is")
    else:
        _warn_of_training(full_order.problem, snapshots, held_out, log)
    selected = _select(full_order.problem, snapshots, settings, log)

    def attempt(layers):
        return _build(full_order, snapshots, selected, replace(settings, layers=layers), held_out, log)

    return first_trusted(attempt, settings.layers, settings.most_layers, log)


def _warn_of_training(problem, snapshots, held_out, log) -> None:
    """Say beforehand what no check of the model can make good: where it is trained, and what it is compared with."""
    warn_of_gaps_in_training(snapshots.points)
    if not _any_contact(problem, snapshots):
        warn_untouched()
    if held_out is None:
        warn_unchecked()
        log.skip("held_out", "no solutions were kept out of training: training solutions were compared")
    elif len(held_out.points) < FEW:
        warn_unchecked(len(held_out.points))


def _check_given(problem, snapshots, settings, held_out) -> None:
    """Refuse what is no recipe, and solutions of another problem.

    Raises:
        ReductionError: with what was given.
    """
    if not isinstance(settings, ReductionSettings):
        raise ReductionError(f"{settings!r} is no recipe: give ReductionSettings")
    if not isinstance(settings.limits, TrustLimits | None):
        raise ReductionError(f"limits = {settings.limits!r} must be TrustLimits, or None for no check")
    rows = {"displacements": problem.free.size, "forces": len(problem.gaps), "active": len(problem.gaps)}
    for name, solutions in (("snapshots", snapshots), ("held_out", held_out)):
        if solutions is None and name == "held_out":
            continue
        if not isinstance(solutions, SnapshotSet):
            raise ReductionError(f"{name} = {solutions!r} must be a SnapshotSet, what compute_snapshots returns")
        points = np.shape(solutions.points)
        if len(points) != 2 or points[0] == 0 or points[1] != len(problem.parameters.names):
            raise ReductionError(
                f"the points of {name} have the shape {points}: one row for each solution, and columns "
                f"{problem.parameters.names}, are needed"
            )
        for field, size in rows.items():
            array = getattr(solutions, field)
            if np.shape(array) != (size, points[0]) or np.iscomplexobj(array) or not np.isfinite(array).all():
                raise ReductionError(
                    f"{field} of {name} have the shape {np.shape(array)}: {size} finite real numbers for each of "
                    f"{points[0]} points are needed; are they of another mesh?"
                )


def _select(problem, snapshots, settings, log) -> tuple[np.ndarray, np.ndarray]:
    """Basis of the model before enrichment, and the nodes that make the RID."""
    weights = _weights(snapshots, settings)
    with log.stage("primal_basis"):
        basis, _ = pod(snapshots.displacements * weights, settings.pod_tolerance)
    with log.stage("rid"):
        nodes = [deim(basis) // problem.block_size, zone_of_interest(problem, settings.zone)]
        nodes.append(_dual_nodes(problem, snapshots, weights, settings, log))
    if settings.extended_pod_tolerance is None:
        log.skip("extended_pod", "the basis that makes the RID is the basis of the model")
    else:
        with log.stage("extended_pod"):
            basis, _ = pod(snapshots.displacements * weights, settings.extended_pod_tolerance)
    return basis, np.concatenate(nodes)


def _build(full_order, snapshots, selected, settings, held_out, log) -> HyperReduction:
    """One attempt with a fixed number of layers."""
    problem, (basis, nodes) = full_order.problem, selected
    with log.stage("rid"):
        sets = reduced_domain(problem, nodes, settings.layers)
        check_loads_seen(problem, sets, snapshots.points)
    with log.stage("enrichment"):
        enrichment = enrich(problem, basis, sets, settings.kappa_max)
    basis = enrichment.basis
    record_enrichment(enrichment, settings.kappa_max, log)
    with log.stage("projection"):
        reduced = project(problem, basis, sets)
    with log.stage("stability"):
        stability = assess(full_order, basis, sets, reduced)
        check_solvable(stability)
        if settings.limits is not None:
            check_stability(stability, settings.limits)
    with log.stage("online_arrays"):
        known = snapshots.known_statuses(sets.A_lambda)
        trained = TrainedRange.of(snapshots.points, problem.parameters)
        model = ReducedModel(reduced, problem.parameters, problem.amplitudes, known, trained=trained)
    with log.stage("reconstruction"):
        reconstruction = prepare_reconstruction(problem, basis, sets, snapshots)
    comparison = None
    if settings.limits is not None:
        with log.stage("validation"):
            answering = OnlineModel(model, reconstruction, problem.block_size)
            comparison = _compared(problem, answering, snapshots, held_out)
            check_comparison(comparison, settings.limits)
    return HyperReduction(
        model, reconstruction, problem.block_size, basis, sets, stability, enrichment, comparison, log
    )


def _compared(problem, answering, snapshots, held_out) -> Comparison:
    """What users get beside the solutions held out, or else beside some training solutions, evenly chosen."""
    floor = force_floor(problem, snapshots)
    if held_out is None:
        every = max(1, len(snapshots.points) // MOST_TRAINING_COMPARED)
        held_out = snapshots.take(np.arange(0, len(snapshots.points), every))
    return compare(problem, answering, held_out, floor)


def _weights(snapshots, settings):
    """Factor of each snapshot before the POD."""
    sizes = np.linalg.norm(snapshots.displacements, axis=0)
    return np.where(sizes > 0, 1 / np.where(sizes > 0, sizes, 1), 1) if settings.relative else np.ones(sizes.size)


def _dual_nodes(problem, snapshots, weights, settings, log):
    """Slave nodes of the contact conditions picked by DEIM on a POD of the forces, section 1.4.3."""
    if settings.dual_pod_tolerance is None:
        log.skip("dual_deim", "not asked for: the DEIM of the primal basis picks contact nodes too")
        return np.zeros(0, dtype=np.int64)
    if not _any_contact(problem, snapshots):
        log.skip("dual_deim", "no training point has contact")
        return problem.contact_slaves[:1]  # a RID needs at least one condition
    return contact_nodes(problem, snapshots.forces * weights, settings.dual_pod_tolerance)


def _any_contact(problem, snapshots) -> bool:
    return bool(np.linalg.norm(snapshots.forces, axis=0).max() > round_off_force(problem, snapshots))
