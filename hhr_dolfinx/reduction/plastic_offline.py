"""Offline stage of bodies that flow: from training histories to a reduced model, thesis section 6.2.3."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import linalg

from hhr_dolfinx.certify.constants import Stability, assess
from hhr_dolfinx.certify.trust import (
    Comparison,
    TrustLimits,
    check_comparison,
    check_growth,
    check_loads_seen,
    check_solvable,
    check_stability,
    check_tolerances,
    first_trusted,
    warn_no_flow,
    warn_unchecked,
    warn_untouched,
)
from hhr_dolfinx.contact.problem import ContactProblem, IndexSets
from hhr_dolfinx.errors import ReductionError, UnstableModelError
from hhr_dolfinx.models.march import History, Point
from hhr_dolfinx.models.reconstruct import Reconstruction
from hhr_dolfinx.parameters import is_whole
from hhr_dolfinx.reduction.completion import prepare_reconstruction
from hhr_dolfinx.reduction.deim import deim
from hhr_dolfinx.reduction.enrichment import Enrichment, enrich, record_enrichment
from hhr_dolfinx.reduction.plastic import PlasticReduced
from hhr_dolfinx.reduction.plastic_trust import (
    checked_histories,
    compare_histories,
    force_floor_of,
    largest_motion,
)
from hhr_dolfinx.reduction.pod import pod
from hhr_dolfinx.reduction.rid import contact_nodes, reduced_domain, zone_of_interest
from hhr_dolfinx.snapshots.solutions import SnapshotSet
from hhr_dolfinx.timing import StageLog
from hhr_dolfinx.trained import TrainedPaths


@dataclass(frozen=True)
class PlasticSettings:
    """How to reduce a scene that flows; tolerances are epsilon of (1.53).

    Attributes:
        primal, dual, stress, plastic_strain: tolerances of the bases whose DEIM points make the RID (section 6.2.3).
        layers: layers of cells added around, to begin with.
        most_layers: layers up to which the RID grows until the projected tangents are positive.
        zone: maps the problem to nodes added to the RID; None takes one node for each load term.
        kappa_max: kappa(B~1) down to which FE functions are added.
        least_tangent: smallest eigenvalue wanted of the projected tangents, see :func:`tangent_margin`; of
            twenty recipes for the pellet all above 0.1 kept within 5 % of the displacement at every step; all below
            -0.2 left it at some step, by up to 26 %, or failed.
        checked_states: training states of each history at which tangents are checked.
        limits: what the trust check refuses or warns of; None leaves it out, but for the tangents.
    """

    primal: float = 3e-10
    dual: float = 1e-8
    stress: float = 1e-9
    plastic_strain: float = 1e-6
    layers: int = 3
    most_layers: int = 8
    zone: Callable[[ContactProblem], np.ndarray] | None = None
    kappa_max: float = 1.0
    least_tangent: float = 0.1
    checked_states: int = 4
    limits: TrustLimits | None = TrustLimits.of_histories()

    def __post_init__(self):
        """Refuse numbers that mean nothing; see :class:`ReductionSettings`."""
        check_tolerances(self, ("primal", "dual", "stress", "plastic_strain"))
        check_growth(self)
        if not is_whole(self.checked_states, 1):
            raise ReductionError(f"checked_states = {self.checked_states} must be a whole number from 1")
        if not 0 <= self.least_tangent < 1:
            raise ReductionError(f"least_tangent = {self.least_tangent} must lie in [0, 1): 1 is an RID of all cells")


class GappyField(NamedTuple):
    """A field of the Gauss points from its values in the RID (gappy POD, section 6.2.3).

    Attributes:
        modes: POD modes of training states, (values everywhere, modes).
        fit: amplitudes of the modes per value in the RID, (modes, values in the RID).
    """

    modes: np.ndarray
    fit: np.ndarray

    @classmethod
    def fitted(cls, modes: np.ndarray, inside: np.ndarray) -> GappyField:
        """From modes and the values that lie in the RID."""
        return cls(modes, np.linalg.pinv(modes[inside]))

    def everywhere(self, inside: np.ndarray) -> np.ndarray:
        """The field everywhere, fitted to its values in the RID by least squares."""
        return self.modes @ (self.fit @ inside)


@dataclass(frozen=True)
class PlasticReduction:
    """A reduced model of a scene that flows, with what completes it.

    Attributes:
        model: equilibrium of gamma, for :func:`hhr_dolfinx.models.march.march`.
        reconstruction: displacement everywhere, contact forces outside the RID, (1.70)-(1.71).
        stress: how the stress is completed.
        cumulated: how the cumulated plastic strain is completed; None where nothing flowed in training.
        stability: constants of the elastic projection.
        enrichment: how the basis was enriched.
        layers: layers of cells of the RID.
        gauss_points: number of Gauss points of the full model.
        tangent_margin: smallest real part of the eigenvalues of the projected tangents, see :func:`tangent_margin`;
            1 where nothing flowed in training.
        comparison: what users get beside trained and held-out histories; None if the check was left out.
        log: times of the stages, what was left out, attempts that were refused.
    """

    model: PlasticReduced
    reconstruction: Reconstruction
    stress: GappyField
    cumulated: GappyField | None
    stability: Stability
    enrichment: Enrichment
    layers: int
    gauss_points: int
    tangent_margin: float
    comparison: Comparison | None
    log: StageLog

    @property
    def basis(self) -> np.ndarray:
        """V, (N, ell)."""
        return self.model.basis

    @property
    def sets(self) -> IndexSets:
        """Index sets of the RID."""
        return self.model.sets

    def displacement_everywhere(self, point: Point) -> np.ndarray:
        """Displacement on the whole mesh, (N,)."""
        return self.reconstruction.displacement(point.unknown, self.model.amplitudes(point.parameter))

    def forces_everywhere(self, point: Point) -> np.ndarray:
        """Contact forces on the whole surface, (N_lambda,)."""
        return self.reconstruction.forces(point.unknown, point.forces, self.model.amplitudes(point.parameter))

    def plastic_strain_everywhere(self, point: Point) -> np.ndarray:
        """Cumulated plastic strain at all Gauss points, (points,): the model's own in the RID, fitted elsewhere."""
        if self.cumulated is None:
            return np.zeros(self.gauss_points)
        everywhere = np.maximum(self.cumulated.everywhere(point.state.cumulated), 0.0)
        everywhere[self.model.points] = point.state.cumulated
        return everywhere

    def stress_everywhere(self, point: Point) -> np.ndarray:
        """Stress at all Gauss points, (points, components): the model's own in the RID, fitted elsewhere."""
        everywhere = self.stress.everywhere(point.stress.ravel()).reshape(self.gauss_points, -1)
        everywhere[self.model.points] = point.stress
        return everywhere


def build_plastic_reduction(
    full,
    histories: list[History],
    settings: PlasticSettings = PlasticSettings(),
    held_out: Sequence[History] = (),
) -> PlasticReduction:
    """Build a reduced model that passes the trust check, or refuse.

    A RID that is too small for its modes makes the projected consistent tangent indefinite under flow; steps then
    fail, or converge to a wrong path with the smallest residuals. The elastic operator shows nothing of it. What users
    get is compared with the trained histories, and with those held out.

    Args:
        full: the full model, a :class:`hhr_dolfinx.full_order.plastic.PlasticFullOrder`.
        histories: its training histories.
        settings: how to reduce.
        held_out: histories kept out of training, for the trust check.

    Raises:
        ReductionError: if there is nothing to train on, histories belong to another model, or a load acts outside
            the RID.
        UnstableModelError: if the trust check still refuses the model at ``most_layers``.
        NotSolvableError: if contact rows are dependent on the basis, (5.24)-(5.25).

    Warns:
        StabilityWarning: if the trust check doubts it.
        UncheckedWarning: if no history was held out.
    """
    histories, held_out = checked_histories(full, histories), checked_histories(full, held_out)
    if not histories:
        raise ReductionError("a reduced model needs at least one training history, with at least one step")
    log = StageLog()
    if settings.limits is not None and not held_out:
        warn_unchecked()
        log.skip("held_out", "no history was kept out of training: trained ones were compared")
    with log.stage("bases"):
        bases = _bases(histories, settings)
        nodes = _rid_nodes(full, bases, settings)
    with log.stage("training_tangents"):
        states = _training_tangents(full, histories, settings.checked_states)
    if full.material.flows and bases.cumulated is None:
        warn_no_flow()
    if settings.limits is not None and not np.any(bases.snapshots.forces):
        warn_untouched()
    known = _Known(histories, list(held_out))

    def attempt(layers):
        return _build(full, (bases, nodes, states), known, replace(settings, layers=layers), log)

    return first_trusted(attempt, settings.layers, settings.most_layers, log)


class _Known(NamedTuple):
    """Histories of the full model, trained on and held out."""

    trained: list[History]
    held_out: list[History]


def _build(full, selected, known, settings, log) -> PlasticReduction:
    """One attempt with a fixed number of layers."""
    bases, nodes, states = selected
    with log.stage("rid"):
        sets = reduced_domain(full.problem, nodes, settings.layers)
        check_loads_seen(full.problem, sets, bases.snapshots.points)
    with log.stage("enrichment"):
        enrichment = enrich(full.problem, bases.primal, sets, settings.kappa_max)
    with log.stage("projection"):
        model = PlasticReduced(full, enrichment.basis, sets)
    with log.stage("stability"):
        stability = assess(full, model.basis, sets, model.reduced)
        check_solvable(stability)
        if settings.limits is not None:
            check_stability(stability, settings.limits)
        margin = _least_margin(model, states, settings)
    with log.stage("reconstruction"):
        completion = _completed(full, model, bases)
    record_enrichment(enrichment, settings.kappa_max, log)
    if not full.material.flows:
        log.skip("tangents", "no body flows: the elastic operator is the tangent")
    counts = settings.layers, full.operator.gauss_points
    built = PlasticReduction(model, *completion, stability, enrichment, *counts, margin, None, log)
    with log.stage("validation"):
        comparison = _compared(full, built, known, settings.limits)
    return replace(built, comparison=comparison)


def _least_margin(model, states, settings) -> float:
    """Smallest tangent margin at training states; 1, that of the elastic operator, where nothing flowed.

    Raises:
        UnstableModelError: if it is below its limit.
    """
    margin = min((tangent_margin(model, *state) for state in states), default=1.0)
    if not margin > settings.least_tangent:
        raise UnstableModelError(
            f"with {settings.layers} layers a projected tangent at a training state has an eigenvalue of real part "
            f"{margin:.2g}: steps would fail or follow a wrong path. Allow more layers or keep fewer modes"
        )
    return margin


def _compared(full, built, known, limits) -> Comparison | None:
    """Solve trained and held-out histories by the reduced model; tell it what it was trained on.

    Raises:
        UnstableModelError: if a history that it was trained on fails, or errors are beyond their limits.
    """
    floor = force_floor_of(known.trained)
    labels = [f"trained history {number}" for number in range(len(known.trained))]
    labels += [f"held-out history {number}" for number in range(len(known.held_out))]
    comparison, signs = compare_histories(full, built, [*known.trained, *known.held_out], labels, floor)
    if limits is not None:
        check_comparison(comparison, limits)
    if signs:  # without limits all of them may have failed
        paths = [history.path for history in known.trained]
        length = largest_motion(full, known.trained)
        built.model.trained = TrainedPaths.of(paths, full.parameters, signs, length)
    return None if limits is None else comparison


def tangent_margin(model: PlasticReduced, tangents: np.ndarray, stiffness) -> float:
    """Smallest real part of the eigenvalues of V[A]^T K_T V relative to V^T K_T V, 1 where the RID is everything.

    Args:
        model: the reduced model.
        tangents: consistent tangents at all Gauss points of the full model.
        stiffness: K_T of the full model.

    Raises:
        UnstableModelError: if the tangent of the full model is singular or not finite on the basis.
    """
    whole = model.basis.T @ (stiffness @ model.basis)
    try:
        return float(linalg.eigvals(np.linalg.solve(whole, model.tangent(tangents[model.points]))).real.min())
    except (np.linalg.LinAlgError, ValueError) as error:
        raise UnstableModelError(
            f"the tangent at a training state is singular or not finite on the basis ({error}): keep fewer modes"
        ) from error


def _training_tangents(full, histories, count):
    """Tangents and stiffness of the full model at some states of each history, the last one among them."""
    states = []
    for history in histories if full.material.flows else ():
        steps = np.unique(np.linspace(0, len(history.points), count + 1).astype(int)[1:]) - 1
        for step in steps:
            here = history.points[step]
            time, state = history.start, full.material.at_rest()
            if step > 0:
                time, state = history.points[step - 1].time, history.points[step - 1].state
            strain = full.strain(here.unknown, full.amplitudes(here.parameter))
            tangents = full.material.update(strain, state, here.time - time, tangent=True).tangents
            states.append((tangents, full.stiffness(tangents)))
    return states


class _Bases(NamedTuple):
    """POD modes of the training histories, and what they were made of.

    Attributes:
        primal: of the displacements, (N, ell).
        stress: of the stress at all Gauss points, (points * components, modes).
        cumulated: of the cumulated plastic strain, (points, modes), or None where nothing flowed.
        snapshots: displacements, forces and statuses of all steps.
    """

    primal: np.ndarray
    stress: np.ndarray
    cumulated: np.ndarray | None
    snapshots: SnapshotSet


def _bases(histories: list[History], settings: PlasticSettings) -> _Bases:
    """All steps of all histories as columns, and their POD (section 6.2.3)."""
    points = [point for history in histories for point in history.points]
    columns = [np.stack([getattr(point, name) for point in points], axis=-1)
               for name in ("unknown", "forces", "active", "stress")]  # fmt: skip
    snapshots = SnapshotSet(np.stack([point.parameter for point in points]), *columns[:3])
    primal, _ = pod(snapshots.displacements, settings.primal)
    stress, _ = pod(columns[3].reshape(-1, len(points)), settings.stress)
    cumulated = np.stack([point.state.cumulated for point in points], axis=1)
    flowed = pod(cumulated, settings.plastic_strain)[0] if np.any(cumulated) else None
    return _Bases(primal, stress, flowed, snapshots)


def _rid_nodes(full, bases: _Bases, settings: PlasticSettings) -> np.ndarray:
    """Nodes of the DEIM points of all bases, and the zone of interest (section 6.2.3)."""
    problem = full.problem
    nodes = [deim(bases.primal) // problem.block_size, zone_of_interest(problem, settings.zone)]
    if np.any(bases.snapshots.forces):
        nodes.append(contact_nodes(problem, bases.snapshots.forces, settings.dual))
    else:
        nodes.append(problem.contact_slaves[:1])  # a RID needs at least one condition
    points = [deim(bases.stress) // full.material.components]
    if bases.cumulated is not None:
        points.append(deim(bases.cumulated))
    nodes.append(problem.cell_nodes[full.cell_of_point[np.concatenate(points)]].ravel())
    return np.unique(np.concatenate(nodes))


def _completed(full, model, bases: _Bases) -> tuple[Reconstruction, GappyField, GappyField | None]:
    """Reconstruction of contact forces, of the stress and of the cumulated plastic strain."""
    forces = prepare_reconstruction(full.problem, model.basis, model.sets, bases.snapshots)
    components = full.material.components
    values = (model.points[:, None] * components + np.arange(components)).ravel()
    stress = GappyField.fitted(bases.stress, values)
    return forces, stress, None if bases.cumulated is None else GappyField.fitted(bases.cumulated, model.points)
