"""Condensation of inelastic models, offline: elastic response, modes of the plastic correction,
cubature, check.

Weights of the cubature are fitted to two kinds of integrals: the stress of the correction at
training states, see :mod:`hhr_dolfinx.plugins.inelastic.condensed_step`, and loosely the energies ∫
(G V)^T C G V of the modes in inelastic regions. With the first alone, modes of small energy were
overestimated by up to 70 % in the tangent, whose sign then changed: steps stalled, or jumped. With
both, none did.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np
from scipy import linalg
from scipy.sparse import csc_matrix

from hhr_dolfinx.certify.compare import Comparison
from hhr_dolfinx.certify.trust import TrustLimits
from hhr_dolfinx.contact.active_set import active_set
from hhr_dolfinx.errors import (
    ConvergenceError,
    HHRError,
    NotSolvableError,
    ReductionError,
    UnstableModelError,
)
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.full import FullModel, plain_outputs
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.parameters import is_number, is_whole
from hhr_dolfinx.plugins.inelastic.completion import GappyField
from hhr_dolfinx.plugins.inelastic.condensed_fields import CondensedFlowFields, PlasticFields
from hhr_dolfinx.plugins.inelastic.condensed_flow import CondensedFlow, CondensedFlowModel
from hhr_dolfinx.plugins.inelastic.cubature import Cubature, compressed, fitted
from hhr_dolfinx.plugins.inelastic.elastic_response import (
    ElasticResponse,
    correction_modes,
    elastic_response,
)
from hhr_dolfinx.plugins.inelastic.full_order import FullOrderEquilibrium, equilibrium_of
from hhr_dolfinx.plugins.inelastic.recipe import PLASTIC_ERROR, STRESS_ERROR, FlowLimits
from hhr_dolfinx.plugins.inelastic.state import deviator, rows_of, state_modes, states_of
from hhr_dolfinx.plugins.inelastic.state import flowed as any_flowed
from hhr_dolfinx.plugins.inelastic.state import state as gauss_of
from hhr_dolfinx.plugins.inelastic.strain import StrainOperator
from hhr_dolfinx.plugins.inelastic.update import Group
from hhr_dolfinx.reduction.reductor import Reductor, Task
from hhr_dolfinx.snapshots.records import SnapshotSet, check_of_problem
from hhr_dolfinx.timing import Announce, StageLog

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.one_call.context import SearchContext
    from hhr_dolfinx.plugins.one_call.proposals import Proposal

MOST_INTEGRALS = 1500
"""Most integrals for the fit of a cubature, before compression."""
CHUNK_POINTS = 2000
"""Gauss points whose contributions are computed at once."""
FLOWED = 1e-4
"""Plastic strain, relative to the largest of any training state, above which a point may have a
weight.
"""
ALIKE_MODES = 1e-4
"""Part of the norm of training states that their compression may leave out."""


def correction_strain(
    full: FullModel,
    elastic: ElasticResponse,
    answer: Answer,
    correction: np.ndarray,
    strain: StrainAt,
) -> np.ndarray:
    """Strain ε_c of the correction of a full answer, (p, c).

    It includes that of the change of contact forces. With a law of interfaces it has no such part:
    forces depend on the path.

    Args:
        full: full model of inelastic bodies.
        elastic: elastic response of the full model.
        answer: answer of the full model.
        correction: its correction u_p, (N,).
        strain: strain at p Gauss points.
    """
    problem = full.problem
    if problem.law.remembers:
        return strain.of(correction)
    equilibrium = equilibrium_of(full).at(answer.parameter)
    theta = problem.amplitudes(answer.parameter)
    scale = elastic.factors.compliances(answer.parameter)[elastic.parts]
    free = scale * (elastic.forced @ theta) + elastic.given @ theta - problem.lifts @ theta
    if problem.held_by_contact:
        statuses = equilibrium.elastic_statuses(theta)
    else:
        slack = problem.gaps @ theta - problem.contact @ free
        statuses = active_set(equilibrium.elastic.equalities, slack, slack < 0, pairs=full.pairs)
    return strain.of(
        correction - scale * (elastic.per_force @ (answer.multipliers - statuses.forces))
    )


@dataclass(frozen=True)
class FlowingDomain:
    """Gauss points with plastic strain in training: the candidates of a cubature."""

    points: np.ndarray  #: their numbers, (p,)
    weights: np.ndarray  #: quadrature weight times 2 μ in the middle of the box, (p,)
    deviators: np.ndarray  #: of the strain of the modes, (p, c, ell)
    stresses: np.ndarray  #: of these strains over 2 μ, (p, c, ell)

    @classmethod
    def of(
        cls, full: FullModel, basis: np.ndarray, answers: Sequence[Answer], sizes: np.ndarray
    ) -> FlowingDomain:
        """Domain of training answers with corrections.

        Args:
            full: full model of inelastic bodies.
            basis: modes of the corrections, (N, ell).
            answers: training answers.
            sizes: energy norm of the correction of each, (S,).
        """
        equilibrium = equilibrium_of(full)
        largest = np.zeros(equilibrium.material.gauss_points)
        for answer, size in zip(answers, sizes, strict=True):
            largest = np.maximum(
                largest, np.abs(gauss_of(answer).state.inelastic).max(axis=1) / size
            )
        points = np.flatnonzero(largest > FLOWED * largest.max())
        strains = np.stack([equilibrium.strain_of(column)[points] for column in basis.T], axis=2)
        elastic = equilibrium.material.moduli_at(full.problem.middle).elastic[points]
        stiff = elastic[:, -1, -1]
        stresses = np.einsum("pij,pjl->pil", elastic / stiff[:, None, None], strains)
        return cls(
            points,
            equilibrium.operator.weights.ravel()[points] * stiff,
            deviator(strains),
            stresses,
        )

    def stressed(
        self,
        full: FullModel,
        elastic: ElasticResponse,
        answers: Sequence[Answer],
        corrections: np.ndarray,
        sizes: np.ndarray,
    ) -> np.ndarray:
        """ε_p - dev ε_c at training states over the energy norms of their corrections, (S, p c).

        Args:
            full: full model of inelastic bodies.
            elastic: elastic response of the full model.
            answers: training answers.
            corrections: corrections of these answers, (N, S).
            sizes: energy norms of the corrections, (S,).
        """
        strain_at = StrainAt(equilibrium_of(full).operator, self.points)
        states = np.empty((len(answers), self.deviators[:, :, 0].size))
        for k, (answer, correction) in enumerate(zip(answers, corrections.T, strict=True)):
            plastic = gauss_of(answer).state.inelastic[self.points]
            strain = correction_strain(full, elastic, answer, correction, strain_at)
            states[k] = (plastic - deviator(strain)).ravel() / sizes[k]
        return states

    def cubature(
        self, stressed: np.ndarray, settings: CorrectionSettings, start: Cubature | None = None
    ) -> Cubature:
        """Points and weights for training states, and loosely for energies of the modes.

        Args:
            stressed: training states, (S, p c), see :meth:`stressed`.
            settings: settings, whose tolerances count.
            start: cubature for fewer modes or a larger tolerance; None for none.
        """
        # few rows with nearly the same products as all, by the method of snapshots
        squares, ways = linalg.eigh(stressed @ stressed.T)
        count = min(
            int((squares > ALIKE_MODES**2 * squares[-1]).sum()),
            MOST_INTEGRALS // self.deviators.shape[2],
        )
        few = ways[:, ::-1][:, :count].T @ stressed
        few = few.reshape(len(few), self.points.size, -1)
        pairs = np.triu_indices(self.deviators.shape[2])

        def needed() -> Iterator[np.ndarray]:
            for span in _chunks(self.points.size):
                tested = self.weights[span, None, None] * self.stresses[span]
                yield np.einsum("pcj,rpc->jrp", tested, few[:, span], optimize=True).reshape(
                    -1, tested.shape[0]
                )

        def energies() -> Iterator[np.ndarray]:
            for span in _chunks(self.points.size):
                tested = self.weights[span, None, None] * self.deviators[span]
                yield np.einsum("pcj,pci->jip", tested, self.deviators[span], optimize=True)[pairs]

        rows = compressed(needed, 0.1 * settings.cubature)
        loose = compressed(energies, 0.1 * settings.stability)
        rows /= np.linalg.norm(rows.sum(axis=1))
        loose *= settings.cubature / settings.stability / np.linalg.norm(loose.sum(axis=1))
        return fitted(np.vstack([rows, loose]), settings.cubature, settings.most_points, start)

    def largest_energy(self, cubature: Cubature) -> float:
        """Largest energy of a mode by the cubature."""
        scale = np.sqrt(cubature.weights * self.weights[cubature.points])
        chosen = self.deviators[cubature.points] * scale[:, None, None]
        return float(np.linalg.norm(chosen.reshape(-1, chosen.shape[2]), 2) ** 2)

    def work(self, strain: StrainAt) -> Callable[[np.ndarray], np.ndarray]:
        """Map fields (N, k) to ∫ (G V)^T C dev G u, (ell, k)."""
        tested = (self.weights[:, None, None] * self.stresses).reshape(-1, self.stresses.shape[2])
        return lambda columns: np.stack(
            [tested.T @ deviator(strain.of(column)).ravel() for column in columns.T], axis=1
        )


def _chunks(count: int) -> Iterator[slice]:
    return (
        slice(start, min(start + CHUNK_POINTS, count)) for start in range(0, count, CHUNK_POINTS)
    )


class StrainAt:
    """Strain at some Gauss points of the operator of a whole mesh, from the cells around them
    alone.
    """

    def __init__(self, operator: StrainOperator, points: np.ndarray):
        per_cell = operator.per_cell
        cells, where = np.unique(points // per_cell, return_inverse=True)
        self._operator, self._dofs = operator.restricted(cells)
        self._places = where * per_cell + points % per_cell

    def of(self, column: np.ndarray) -> np.ndarray:
        """Strain of a field (N,), (n, c)."""
        return self._operator.strain(column[self._dofs])[self._places]

    def __call__(self, columns: np.ndarray) -> np.ndarray:
        """Strain of fields (N, k), by component, (k, c n)."""
        return np.array([self.of(column).T.ravel() for column in columns.T])


FIELDS_LEFT_OUT = {"plastic": 1e-8, "cumulated": 1e-6}
"""Part of the squared training fields that the modes for plastic and cumulated plastic strain leave
out. Stress is the difference of strain and plastic strain, which may be a hundred times as large:
the latter has the smaller tolerance.
"""
WATCHED = 12
"""Points without weight at which laws are evaluated, or a tenth of the others if that is more."""
SYMMETRIC_POINTS = 1e-6
"""Part of the cumulated plastic strain by which symmetric points may differ."""
SPARE = 2
"""Least number of values per mode in a fit, so that the surplus ones measure its quality."""
CORRECTION_ROUND_OFF = 1e-8
"""Energy of a correction, relative to the largest, below which it counts as round-off of the
elastic solution.
"""
LARGEST_ENERGY = 1.2
"""Energy of a mode by the cubature above which tangents may change sign.

The exact one is at most 1.
"""


@dataclass(frozen=True)
class CorrectionSettings(Reductor["_Shared"]):
    """Targets of a reduced plastic correction: a model of inelastic bodies that keeps all contact
    conditions.

    It is a reductor, ``build(full, snapshots, CorrectionSettings())``, of a full model on one rank
    and training histories. It refuses scenes whose moduli are no factors of connected components,
    and gives the warnings of :func:`hhr_dolfinx.reduction.build.build`.

    Attributes:
        modes: energy norm that the modes leave out of training corrections, each over the root of
            its norm, relative.
        cubature: relative misfit of the integrals at training states.
        stability: relative misfit of the energies of the modes.
        most_modes, most_points: upper limits; None for none.
        attempts: most attempts; each reduces the tolerances of modes and cubature by a factor of
            three.
        primal, dual, stress, plastic: target errors of displacement, forces, stress and cumulated
            plastic strain along known histories.
        trust: limits at which a model is refused or raises a warning; None leaves out the check.
    """

    modes: float = 4e-3
    cubature: float = 2e-3
    stability: float = 0.02
    most_modes: int | None = None
    most_points: int | None = None
    attempts: int = 4
    primal: float = 2e-3
    dual: float = 0.06
    stress: float = 0.02
    plastic: float = 0.05
    trust: TrustLimits | None = field(
        default_factory=lambda: FlowLimits.of_histories(
            refuse_primal=0.02, refuse_dual=0.2, warn_primal=0.01
        )
    )
    method: ClassVar[str] = "condensed"
    own_range: ClassVar[bool] = True
    level: ClassVar[str] = "attempt"
    remedy: ClassVar[str] = (
        "train on more histories, as more modes and points do not know other ones"
    )
    refusals: ClassVar[tuple[type[HHRError], ...]] = (
        UnstableModelError,
        ConvergenceError,
        NotSolvableError,
    )

    def __post_init__(self) -> None:
        """Refuse invalid values with ReductionError."""
        for name in ("modes", "cubature", "stability"):
            if not (is_number(getattr(self, name)) and 0 < getattr(self, name) < 1):
                raise ReductionError(
                    f"{name} = {getattr(self, name)!r} must be a fraction in (0, 1)"
                )
        for name in ("primal", "dual", "stress", "plastic"):
            value = getattr(self, name)
            if not (value == math.inf or (is_number(value) and value > 0)):
                raise ReductionError(
                    f"{name} = {value!r} must be a positive number: an error that is small; "
                    "math.inf asks for none"
                )
        if not isinstance(self.trust, TrustLimits | None):
            raise ReductionError(f"trust = {self.trust!r} must be TrustLimits(...), or None")
        for name, unbounded in (("most_modes", True), ("most_points", True), ("attempts", False)):
            value = getattr(self, name)
            if not (is_whole(value, 1) or (value is None and unbounded)):
                raise ReductionError(
                    f"{name} = {value!r} must be a whole number from 1" + ", or None" * unbounded
                )

    @classmethod
    def usual(cls, settings: Reductor | None, *, fields: bool | None) -> Reductor:
        """See :meth:`~hhr_dolfinx.reduction.reductor.Reductor.usual`; fields are always there.

        Args:
            settings: None for the usual ones.
            fields: not read: fields are always there.
        """
        return cls() if settings is None else settings

    @property
    def limits(self) -> TrustLimits | None:
        """Limits of ``trust``."""
        return self.trust

    def check(self, task: Task) -> None:
        """Refuse elastic scenes, and other trainings than of histories with plastic strain.

        Raises:
            ReductionError: for these.
        """
        full = task.full
        snapshots = task.snapshots
        if full.equilibrium is None:
            raise ReductionError(
                f"nothing flows in scene '{full.scene.name}': take exact or interpolated "
                "condensation"
            )
        full.problem.require_whole()
        check_of_problem("snapshots", snapshots, full.problem)
        if snapshots is None or not snapshots.histories:
            raise ReductionError(
                "a reduced plastic correction is trained on histories, all steps: "
                "SnapshotSet.of_histories"
            )
        if not any_flowed(snapshots) and not equilibrium_of(full).material.linear:
            # corrections are then round-off, not zero
            raise ReductionError(
                "no body flows in any training history: train at higher loads, or leave the laws "
                "out"
            )

    def prepare(self, task: Task, before: _Shared | None = None) -> _Shared:
        """Elastic response, corrections of training states, and modes of fields.

        Args:
            task: full model, training answers and announcements.
            before: data of an earlier attempt; None for none.
        """
        full = task.full
        snapshots = task.snapshots
        assert snapshots is not None  # checked
        if self.trust is not None:
            task.kind.warn_of_training(snapshots, task.held_out)
        with task.log.stage("elastic", task.announce):
            elastic = elastic_response(full) if before is None else before.elastic
        with task.log.stage("corrections", task.announce):
            answers = [answer for history in snapshots.histories for answer in history.answers]
            corrections = np.stack(
                [elastic.correction(full.problem, answer) for answer in answers], axis=1
            )
        with task.log.stage("reconstruction", task.announce):
            fields = (
                _FieldModes.of(full, snapshots)
                if any_flowed(snapshots)
                else _FieldModes.at_rest(full)
            )
        return _Shared(
            full, snapshots, elastic, answers, corrections, fields, task.log, task.announce
        )

    def levels(self, task: Task) -> Iterable[int]:
        """Powers of three by which the tolerances of modes and cubature are divided."""
        return range(self.attempts)

    def attempt(self, prepared: _Shared, level: int) -> tuple[CondensedFlowModel, CorrectionFacts]:
        """One model; without inelastic strain in training laws are linear, and corrections zero.

        Args:
            prepared: data that all attempts share.
            level: number of the attempt, from 0 on.

        Raises:
            UnstableModelError: if the cubature gives a mode too large an energy.
        """
        settings = replace(self, modes=self.modes / 3**level, cubature=self.cubature / 3**level)
        flows = any_flowed(prepared.snapshots)
        chosen = self._chosen(settings, prepared) if flows else _at_rest(prepared)
        domain = chosen.domain
        cubature = chosen.cubature
        energy = domain.largest_energy(cubature)
        if energy > LARGEST_ENERGY:
            raise UnstableModelError(
                f"the cubature on {cubature.points.size} points gives a mode {energy:.2f} times "
                "its energy, and tangents may turn their sign: allow more points (most_points), "
                "or a smaller stability"
            )
        model = _model(prepared, chosen)
        counts = chosen.basis.shape[1], model.flow.points.size, domain.points.size
        return model, CorrectionFacts(settings, *counts, cubature.misfit, energy)

    def _chosen(self, settings: CorrectionSettings, prepared: _Shared) -> _Chosen:
        """Modes of the corrections of training states, points with inelastic strain there, and
        their cubature.
        """
        full = prepared.full
        problem = full.problem
        log = prepared.log
        elastic = prepared.elastic
        with log.stage("modes", prepared.announce):
            most = settings.most_modes
            basis, sizes = correction_modes(
                problem, prepared.corrections, elastic, settings.modes, most
            )
        with log.stage("cubature", prepared.announce):
            corrected = np.flatnonzero(sizes > CORRECTION_ROUND_OFF * sizes.max(initial=0.0))
            answers = [prepared.answers[k] for k in corrected]
            domain = FlowingDomain.of(full, basis, answers, sizes[corrected])
            stressed = domain.stressed(
                full, elastic, answers, prepared.corrections[:, corrected], sizes[corrected]
            )
            cubature = domain.cubature(
                stressed, settings, prepared.known[-1] if prepared.known else None
            )
            prepared.known[:] = [cubature]
        return _Chosen(basis, domain, cubature, answers)

    def off(self, comparison: Comparison | None) -> float:
        """Largest error over its target."""
        if comparison is None:
            return 0.0
        further = comparison.further
        pairs = [(comparison.primal, self.primal), (comparison.dual, self.dual)]
        pairs += [(further[STRESS_ERROR], self.stress), (further[PLASTIC_ERROR], self.plastic)]
        return float(max(errors.max() / wish for errors, wish in pairs))

    def proposals(self, search: SearchContext) -> Iterator[Proposal]:
        """Of more and more histories, with targets of the search."""
        from hhr_dolfinx.plugins.one_call.proposals import of_more_answers

        tolerance = search.target.error / 2  # a margin for errors that the check does not see
        settings = replace(
            self, primal=min(self.primal, tolerance), dual=min(self.dual, tolerance), attempts=6
        )
        if (
            search.target.elastic
        ):  # else an output may need the stress, which must be refined further
            settings = replace(settings, stress=math.inf, plastic=math.inf)
        return of_more_answers(settings, search)


@dataclass(frozen=True, eq=False)
class CorrectionFacts:
    """Facts of a condensed inelastic model, in its
    :class:`~hhr_dolfinx.reduction.reductor.Record`.
    """

    settings: CorrectionSettings  #: of the chosen attempt
    modes: int  #: number of them
    points: int  #: number of them
    candidates: int  #: Gauss points with plastic strain in training
    misfit: float  #: of the cubature
    energy: float  #: largest energy of a mode by the cubature; the exact one is at most 1


@dataclass(frozen=True)
class _Shared:
    """Data that all attempts share."""

    full: FullModel
    snapshots: SnapshotSet
    elastic: ElasticResponse
    answers: list[Answer]
    corrections: np.ndarray
    fields: _FieldModes
    log: StageLog
    announce: Announce
    known: list[Cubature] = field(default_factory=list)
    """Cubature of the last attempt, if there was one: the next one starts from its points."""


class _Chosen(NamedTuple):
    """Modes, and where laws are evaluated."""

    basis: np.ndarray  #: (N, ell)
    domain: FlowingDomain
    cubature: Cubature
    answers: list[Answer]  #: training states with corrections


def _at_rest(prepared: _Shared) -> _Chosen:
    """A mode and points that do no work, one of each body: laws are evaluated there, and the
    correction stays zero.
    """
    full = prepared.full
    elastic = prepared.elastic
    points = _first_points(equilibrium_of(full).material.groups)
    components = equilibrium_of(full).operator.components
    nothing = np.zeros((points.size, components, 1))
    response = elastic.per_force[:, 0]
    mode = np.where(elastic.parts == elastic.parts[np.abs(response).argmax()], response, 0.0)
    mode /= math.sqrt(mode @ (full.problem.stiffness @ mode))
    domain = FlowingDomain(points, np.zeros(points.size), nothing, nothing)
    cubature = Cubature(np.arange(points.size), np.ones(points.size), 0.0)
    return _Chosen(mode[:, None], domain, cubature, prepared.answers)


def _first_points(groups: Iterable[Group]) -> np.ndarray:
    """The first Gauss point of each body, by their numbers, increasing."""
    return np.sort([group.indices[0] for group in groups]).astype(np.int64)


def _model(prepared: _Shared, chosen: _Chosen) -> CondensedFlowModel:
    """The model of modes and a cubature."""
    full = prepared.full
    problem = full.problem
    elastic = prepared.elastic
    with prepared.log.stage("online_arrays", prepared.announce):
        flow = _online(full, elastic, *chosen)
        fields = CondensedFlowFields(
            problem.amplitudes,
            elastic.factors,
            elastic.parts,
            chosen.basis,
            elastic.per_force,
            elastic.forced,
            elastic.given,
            problem.block_size,
            prepared.fields.on(flow.points, equilibrium_of(full)),
            plain_outputs(full),
            problem.law,
            elastic.loose(problem),
            full,
        )
        model = CondensedFlowModel(flow, full.parameters, fields)
    with prepared.log.stage(
        "compilation", prepared.announce
    ):  # once for an installation, not for each model
        model.march(prepared.snapshots.histories[0].path[:2], MarchSettings(outside="ignore"))
    return model


def _online(
    full: FullModel,
    elastic: ElasticResponse,
    basis: np.ndarray,
    domain: FlowingDomain,
    cubature: Cubature,
    answers: Sequence[Answer],
) -> CondensedFlow:
    """Arrays of a step, on the points of the cubature."""
    equilibrium = equilibrium_of(full)
    problem = full.problem
    points, weights = _watched(domain, cubature, answers)
    groups, order = _by_body(equilibrium.material.groups, points)
    points = points[order]
    weights = weights[order]
    components = equilibrium.operator.components
    strain = StrainAt(equilibrium.operator, points)
    everywhere = StrainAt(equilibrium.operator, domain.points)
    per_mode = strain(basis)
    per_force = strain(elastic.per_force)
    rows = (points * components + np.arange(components)[:, None]).ravel()
    elasticity = equilibrium.material.moduli_at(problem.middle).elastic[points]
    elasticity *= (weights / elasticity[:, -1, -1])[:, None, None]
    shape = len(per_mode), components, -1
    tested = np.einsum("pij,ljp->lip", elasticity, per_mode.reshape(shape)).reshape(per_mode.shape)
    work = domain.work(everywhere)
    coupled = np.zeros((len(per_mode), len(problem.gaps)))
    if not problem.law.remembers:
        coupled = work(elastic.per_force) - tested @ _deviators(per_force, components).T
    schur, pressed, gaps = elastic.condensed(problem)
    return CondensedFlow(
        points=points,
        groups=groups,
        per_cell=equilibrium.operator.per_cell,
        parts=elastic.parts[equilibrium.operator.dofs[points // equilibrium.operator.per_cell, 0]],
        factors=elastic.factors,
        per_mode=per_mode,
        tested=tested,
        per_force=per_force,
        forced=strain(elastic.forced).T,
        given=strain(elastic.given).T - equilibrium.eigenstrains.tocsr()[rows].toarray(),
        moved=problem.contact @ basis,
        modal=np.eye(len(per_mode)) - work(basis) + tested @ _deviators(per_mode, components).T,
        coupled=coupled,
        mode_parts=elastic.parts[
            np.abs(basis).argmax(axis=0)
        ],  # if there are several parts, each mode is on one
        schur=schur,
        pressed=pressed,
        gaps=gaps,
    )


def _watched(
    domain: FlowingDomain, cubature: Cubature, answers: Sequence[Answer]
) -> tuple[np.ndarray, np.ndarray]:
    """Points of a cubature and their weights, and, without weight, those of the largest plastic
    strain in training.

    The few points of a cubature may all lie away from the place of the first plastic strain. A
    history with plastic strain there alone would look elastic, whatever stress it causes.
    """
    flowed = np.array([gauss_of(answer).state.cumulated[domain.points] for answer in answers])
    largest = flowed.max(axis=1, keepdims=True)
    # the first of points that are equal up to round-off
    order = [k for k in np.argsort(largest[:, 0], kind="stable") if largest[k] > 0]
    most = (flowed >= (1 - SYMMETRIC_POINTS) * largest).argmax(axis=1)[order]
    # start with the smallest states, the onset of plastic flow: more points would cost what a
    # cubature saves
    integrated = set(cubature.points.tolist())
    candidates = [point for point in dict.fromkeys(most.tolist()) if point not in integrated]
    watched = np.array(candidates[: max(cubature.points.size // 10, WATCHED)], dtype=np.int64)
    weights = np.append(cubature.weights * domain.weights[cubature.points], np.zeros(watched.size))
    return np.append(domain.points[cubature.points], domain.points[watched]), weights


def _deviators(strains: np.ndarray, components: int) -> np.ndarray:
    """Deviators of strains by component, (k, c n)."""
    return deviator(strains.reshape(len(strains), components, -1)).reshape(strains.shape)


def _by_body(groups: tuple[Group, ...], points: np.ndarray) -> tuple[tuple[Group, ...], np.ndarray]:
    """Groups of some points with consecutive indices, and the order of the points in them."""
    groups_of_points = []
    order = []
    start = 0
    for group in groups:
        members = np.flatnonzero(np.isin(points, group.indices))
        if members.size:
            groups_of_points.append(
                group.some(points[members], np.arange(start, start + members.size))
            )
            order.append(members)
            start += members.size
    return tuple(groups_of_points), np.concatenate(order)


@dataclass(frozen=True)
class _FieldModes:
    """POD modes of plastic and cumulated plastic strain, at the points with plastic strain in
    training.
    """

    flowed: np.ndarray  #: numbers of these points
    plastic: np.ndarray  #: modes, as the next
    cumulated: np.ndarray
    displacements: np.ndarray  #: displacement of each mode of the plastic strain, K^-1 ∫ G^T C Φ
    elastic: np.ndarray  #: C of each body, in the middle of the box
    kinds: np.ndarray  #: body of each Gauss point
    grading: np.ndarray  #: factor of its C, (Gauss points,); empty for 1

    @classmethod
    def of(cls, full: FullModel, snapshots: SnapshotSet) -> _FieldModes:
        """Modes of training histories.

        Args:
            full: full model of inelastic bodies.
            snapshots: training answers.
        """
        states = [gauss.state for gauss in states_of(snapshots)]
        flowed = np.flatnonzero(np.any([state.inelastic.any(axis=1) for state in states], axis=0))
        plastic = state_modes(
            [state.inelastic[flowed].ravel() for state in states], FIELDS_LEFT_OUT["plastic"]
        )
        cumulated = state_modes(
            [state.cumulated[flowed] for state in states], FIELDS_LEFT_OUT["cumulated"]
        )
        return cls._balanced(full, flowed, plastic, cumulated)

    @classmethod
    def at_rest(cls, full: FullModel) -> _FieldModes:
        """A mode each, at a point of each body, of which linear laws take no part."""
        equilibrium = equilibrium_of(full)
        flowed = _first_points(equilibrium.material.groups)
        plastic, cumulated = (
            np.eye(flowed.size * count, 1) for count in (equilibrium.operator.components, 1)
        )
        return cls._balanced(full, flowed, plastic, cumulated)

    @classmethod
    def _balanced(
        cls, full: FullModel, flowed: np.ndarray, plastic: np.ndarray, cumulated: np.ndarray
    ) -> _FieldModes:
        """Modes with the displacement that balances each."""
        problem = full.problem
        equilibrium = equilibrium_of(full)
        material = equilibrium.material.moduli_at(problem.middle)
        bodies = np.array([group.elasticity(material.components)[0] for group in material.groups])
        kinds = np.empty(material.gauss_points, dtype=np.int64)
        for number, group in enumerate(material.groups):
            kinds[group.indices] = number
        grading = material.grading
        elastic = material.elastic
        forces = np.empty((len(problem.free), plastic.shape[1]))
        stress = np.zeros(elastic.shape[:2])
        for column, mode in zip(forces.T, plastic.T, strict=True):
            stress[flowed] = np.einsum("nij,nj->ni", elastic[flowed], mode.reshape(flowed.size, -1))
            column[:] = equilibrium.internal(stress)[0]
        displacements = full.stiffness.columns(csc_matrix(forces))
        return cls(flowed, plastic, cumulated, displacements, bodies, kinds, grading)

    def on(self, points: np.ndarray, equilibrium: FullOrderEquilibrium) -> PlasticFields:
        """Completion of fields from some points.

        Args:
            points: numbers of the points, (n,).
            equilibrium: equilibrium of the full model.
        """
        rows = np.searchsorted(self.flowed, points)
        values = rows_of(rows, equilibrium.operator.components)
        count = max(values.size // SPARE, 1)
        return PlasticFields(
            points,
            self.flowed,
            GappyField.fitted(self.plastic[:, :count], values),
            GappyField.fitted(self.cumulated, rows),
            self.displacements[:, :count],
            equilibrium.operator,
            equilibrium.eigenstrains,
            self.elastic,
            self.kinds,
            self.grading,
        )
