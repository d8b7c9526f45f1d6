"""Condensed inelastic models: the elastic response is eliminated exactly.

Unknowns are corrections and contact forces.

If elasticity is constant along a history, the displacement of the full model is

    u = u_F θ - X λ + u_p,      X = K^-1 B^T,      u_p = K^-1 ∫ G^T C ε_p,

and only the last part is unknown. Its training states have few modes V, orthonormal in energy: u_p
= V g with g = ∫ (G V)^T C ε_p, an integral over few Gauss points Z with weights of their cubature.
The unknowns are g and λ; laws see the strain ε = ε_F θ + E_p g - E_X^T λ on Z. Related methods
without contact are transformation field analysis with non-uniform modes (Michel and Suquet 2003)
and empirical cubature (Hernandez, Caicedo and Ferrer 2017).

Needs neither DOLFINx nor PETSc.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from scipy.linalg import LinAlgError

from hhr_dolfinx.amplitudes import Theta
from hhr_dolfinx.contact.active_set import SchurEqualities, Status, Statuses
from hhr_dolfinx.contact.kernel import kernels
from hhr_dolfinx.contact.law import UNILATERAL_STEP, StepContact
from hhr_dolfinx.declared import Floats, Integers, Size
from hhr_dolfinx.errors import ConvergenceError, NotSolvableError
from hhr_dolfinx.linear.dense import LapackLU
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.models.model import KeptModel
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.plugins.inelastic import condensed_step as compiled_step
from hhr_dolfinx.plugins.inelastic.condensed_fields import (
    MODULI_ROUND_OFF,
    CondensedFlowFields,
    PartFactors,
)
from hhr_dolfinx.plugins.inelastic.condensed_step import (
    StepLaws,
    StepLoad,
    StepModel,
    WorkArrays,
    touch,
)
from hhr_dolfinx.plugins.inelastic.correction_step import CorrectionStepper, NewtonStepper
from hhr_dolfinx.plugins.inelastic.equilibrium import (
    Diverged,
    Goal,
    ParameterDirection,
    Stepper,
    texts_of,
    undetermined,
)
from hhr_dolfinx.plugins.inelastic.law import InternalVariables, Update
from hhr_dolfinx.plugins.inelastic.loose import LinearisedKernel
from hhr_dolfinx.plugins.inelastic.march import MarchingEquilibrium
from hhr_dolfinx.plugins.inelastic.outside import LawCode
from hhr_dolfinx.plugins.inelastic.state import GaussState
from hhr_dolfinx.plugins.inelastic.state import state as gauss_of
from hhr_dolfinx.plugins.inelastic.trained import Signs, TrainedPaths
from hhr_dolfinx.plugins.inelastic.update import Group, LastOf, Material

if TYPE_CHECKING:
    from hhr_dolfinx.reduction.reductor import Record


@dataclass(frozen=True)
class CondensedFlow:
    """Arrays in the middle of the box (n points of c components, ell modes, m conditions, Q
    parts).
    """

    #: numbers of the points Z in the full model, body by body; those without weight detect plastic
    #: strain elsewhere
    points: Annotated[Integers, "points", "< gauss points"]
    groups: tuple[
        Group, ...
    ]  #: elasticity and laws of these points by body, with consecutive indices
    per_cell: Annotated[Size, "per cell"]  #: Gauss points of a cell of the full model
    #: part of the stiffness that holds each point, (n,)
    parts: Annotated[Integers, "points", "< Q"]
    factors: PartFactors  #: moduli of the parts
    per_mode: Annotated[
        Floats, "ell", "components * points"
    ]  #: strain of V, component by component, (ell, c n)
    tested: Annotated[
        Floats, "ell", "components * points"
    ]  #: weight of each point times its stress C
    per_force: Annotated[Floats, "m", "components * points"]  #: strain of K^-1 B^T, (m, c n)
    forced: Annotated[Floats, "components * points", "terms"]  #: strain of K^-1 F, (c n, 1 + T)
    #: strain of imposed displacements and of the response to them, minus strains without stress
    given: Annotated[Floats, "components * points", "terms"]
    moved: Annotated[Floats, "m", "ell"]  #: B V, (m, ell)
    modal: Annotated[
        Floats, "ell", "ell"
    ]  #: Q of :mod:`plugins.inelastic.condensed_step`, (ell, ell)
    coupled: Annotated[Floats, "ell", "m"]  #: P there, (ell, m)
    mode_parts: Annotated[
        Integers, "ell", "< Q"
    ]  #: part of the stiffness of each mode, if moduli vary
    schur: Annotated[Floats, "Q", "m", "m"]  #: B K^-1 B^T of each part, (Q, m, m)
    pressed: Annotated[Floats, "Q", "m", "terms"]  #: B K^-1 F of each part, (Q, m, 1 + T)
    gaps: Annotated[Floats, "m", "terms"]  #: gaps minus imposed displacements, (m, 1 + T)

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Faults: repeated points, groups that are not consecutive (compiled loops rely on it), and
        an indefinite S.
        """
        if np.unique(self.points).size < self.points.size:
            yield "flow.points has a number twice"
        indices = np.concatenate(
            [np.zeros(0, dtype=np.int64), *(group.indices for group in self.groups)]
        )
        if not np.array_equal(indices, np.arange(self.points.size)) or not all(
            len(g.indices) for g in self.groups
        ):
            yield (
                f"the groups must hold the points 0 .. {self.points.size - 1} once and one after "
                "another"
            )
        if len(self.schur) != max(len(self.factors.moduli), 1) or self.factors.middle.size != len(
            self.schur
        ):
            yield f"S of {len(self.schur)} parts is not that of {len(self.factors.moduli)} moduli"
        diagonals = np.einsum("qmm->qm", self.schur)
        if not np.array_equal(self.schur, self.schur.transpose(0, 2, 1)):
            yield "schur is not symmetric"
        if (diagonals < 0).any() or not (diagonals.sum(axis=0) > 0).all():
            yield "schur is not positive definite: a condition has no compliance"

    @property
    def components(self) -> int:
        """Components of a strain."""
        return self.per_mode.shape[1] // self.points.size

    @cached_property
    def ends(self) -> np.ndarray:
        """End of each group: its last point and one, (G,)."""
        return np.cumsum([group.indices.size for group in self.groups])


class CondensedEquilibrium(MarchingEquilibrium):
    """Equilibrium of g and λ, of which the unknown holds g first, and r motions of bodies that
    contact holds last.
    """

    schur: np.ndarray  #: S for the present moduli, (m, m)
    equalities: SchurEqualities  #: on it
    motions: LinearisedKernel | None  #: of bodies that contact alone holds, beside these
    coupled: np.ndarray  #: P for the present moduli, (ell, m)
    scale: np.ndarray  #: factor of the strain of contact forces, (c n,)
    free_strain: np.ndarray  #: without correction and contact forces as terms of θ, (c n, 1 + T)

    def __init__(
        self, flow: CondensedFlow, parameters: ParameterSpace, fields: CondensedFlowFields
    ):
        super().__init__()
        self.flow = flow
        self.amplitudes = fields.amplitudes
        self.parameters = parameters
        self.fields = fields
        self.material = Material(flow.groups, flow.components, parameters.names)
        self.moduli = texts_of(flow.factors.moduli)
        self.points = flow.points
        self.per_cell = flow.per_cell
        self.modes = len(flow.per_mode)
        self.conditions = len(flow.gaps)
        self.law = fields.law
        self.loose = fields.loose
        self.size = self.modes + self.conditions + (0 if self.loose is None else self.loose.count)
        self._set_elasticity(self._weights(parameters.middle), parameters.middle)

    def _weights(self, point: np.ndarray) -> np.ndarray:
        return self.flow.factors.compliances(point)

    def _set_elasticity(self, weights: np.ndarray, point: np.ndarray) -> None:
        """Set the compliance of each part relative to the middle, (Q,)."""
        flow = self.flow
        # the array kept from the middle belongs to its elasticity
        vars(self).pop("step_model", None)
        self.scale = np.tile(weights[flow.parts], flow.components)
        self.coupled = weights[flow.mode_parts][:, None] * flow.coupled
        self.schur = np.tensordot(weights, flow.schur, 1)
        self.equalities = SchurEqualities.symmetric(self.schur)
        self.motions = None
        if self.loose is not None:
            modes = np.eye(self.size, self.loose.count, self.loose.count - self.size)
            self.motions = kernels().linearised(self.equalities, self.loose.taken, modes)
        self._free_slack = np.asfortranarray(flow.gaps - np.tensordot(weights, flow.pressed, 1))
        self.free_strain = np.asfortranarray(self.scale[:, None] * flow.forced + flow.given)

    def strain(self, x: np.ndarray, theta: Theta) -> np.ndarray:
        """See :class:`Equilibrium`; (n, c) on Z.

        Args:
            x: unknown: correction, forces and motions, (n,).
            theta: amplitudes θ at the parameter.
        """
        return self._by_point(self.free_strain @ theta + self._strain_of(x))

    def strain_of(self, change: np.ndarray) -> np.ndarray:
        """See :class:`Equilibrium`."""
        return self._by_point(self._strain_of(change))

    def _by_point(self, values: np.ndarray) -> np.ndarray:
        """Strains by component, (c n,), reordered by point, (n, c)."""
        return np.ascontiguousarray(values.reshape(-1, self.points.size).T)

    def _strain_of(self, x: np.ndarray) -> np.ndarray:
        correction, forces, _ = self.parts_of(x)
        return correction @ self.flow.per_mode - self.scale * (forces @ self.flow.per_force)

    def parts_of(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Corrections, (ell, ...), forces, (m, ...), and motions, (r, ...), of an unknown."""
        correction, forces, motions = np.split(x, [self.modes, self.modes + self.conditions])
        return correction, forces, motions

    def driving(self, theta: Theta) -> np.ndarray:
        """Loads along the motions of bodies that contact alone holds, (r,)."""
        return np.zeros(0) if self.loose is None else self.loose.driving @ theta

    def touched(
        self, contact: StepContact, slack: np.ndarray, driving: np.ndarray, active: np.ndarray
    ) -> tuple[Statuses, np.ndarray]:
        """Forces with their statuses by a law of contacts, and motions, (r,).

        Args:
            contact: law of the contacts in this step.
            slack: slack without contact forces, (m,).
            driving: loads along the motions, (r,).
            active: statuses to start from, (m,) bool.
        """
        if self.motions is None:
            return contact.solved(self.equalities, slack, active, None), np.zeros(0)
        residual = self.motions.modes @ driving
        # corrections and responses to forces have none of the motions
        statuses, motion = self.motions.solved(
            contact, slack, residual, lambda _: np.zeros(self.size), active, None
        )
        return statuses, self.parts_of(motion)[2]

    def force_slopes(self, contact: StepContact, found: Statuses, slack: np.ndarray) -> np.ndarray:
        """Derivatives of the last forces by those of the slack, (m, K), at constant loads.

        Args:
            contact: law of the contacts in this step.
            found: solution of the contact problem.
            slack: derivatives of the slack, (m, K).
        """
        if self.motions is None or contact is not UNILATERAL_STEP:
            # a law holds loose bodies on springs, whose S it has
            return contact.changes(self.equalities, found, slack)
        return self.motions.changed(np.zeros((self.size, slack.shape[1])), slack, found.active)[0]

    def undetermined(self, found: Statuses, x: np.ndarray, theta: Theta) -> np.ndarray | None:
        """Motions of an unknown that forces leave undetermined, (n, d); None without any.

        Args:
            found: forces with their statuses.
            x: the unknown, (n,).
            theta: amplitudes θ at the parameter.
        """
        return undetermined(
            self.motions, found, lambda: self.slack_of(self.gaps(theta), x), self.law
        )

    def slack_of(self, gaps: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Slack of an unknown, gaps + S λ - B V g - B R q, or its change.

        Args:
            gaps: gaps, (m,), or their change.
            x: unknown: correction, forces and motions, (n,).
        """
        correction, forces, motions = self.parts_of(x)
        slack = gaps + self.schur @ forces - self.flow.moved @ correction
        return slack if self.loose is None else slack - self.loose.taken @ motions

    def strain_under(
        self, free: np.ndarray, correction: np.ndarray, forces: np.ndarray
    ) -> np.ndarray:
        """Strain on Z, (n, c), from a free one, (c n,), a correction, (ell,), and forces, (m,)."""
        return self._by_point(free + self._strain_of(np.concatenate([correction, forces])))

    def flowing(self, tangents: np.ndarray) -> np.ndarray:
        """w (G V)^T C dε_p/dε from consistent tangents on Z, (n, c, c): (ell, c n)."""
        shape = (self.modes, self.flow.components, self.points.size)
        elastic = self.material.elastic
        laws = (group.law for group in self.material.groups if group.law is not None)
        # laws that state the elasticity in plane stress have none across
        if any(law.elastic and law.plane_stress for law in laws):
            slopes = np.linalg.pinv(elastic, rcond=MODULI_ROUND_OFF, hermitian=True) @ (
                elastic - tangents
            )
        else:
            slopes = np.linalg.solve(elastic, elastic - tangents)
        return np.einsum("lin,nij->ljn", self.flow.tested.reshape(shape), slopes).reshape(
            self.modes, -1
        )

    def gaps(self, theta: Theta) -> np.ndarray:
        """Slack without correction and contact forces, (m,)."""
        return self._free_slack @ theta

    def residual(
        self, x: np.ndarray, gauss: GaussState | Update, theta: Theta
    ) -> tuple[np.ndarray, np.ndarray]:
        """R for the inelastic strain of ``gauss.state``, :mod:`plugins.inelastic.condensed_step`.

        Size of g, (1,).

        Args:
            x: unknown: correction, forces and motions, (n,).
            gauss: ``state`` with the inelastic strain on Z.
            theta: amplitudes θ at the parameter.

        Returns:
            of :mod:`plugins.inelastic.condensed_step`, and the size of g, (1,).
        """
        correction, forces, _ = self.parts_of(x)
        flow = self.flow
        residual = flow.tested @ gauss.state.inelastic.T.ravel() - flow.modal @ correction
        residual -= self.coupled @ (forces - self.elastic_forces(theta))
        imbalance = None if self.loose is None else self.driving(theta) - forces @ self.loose.taken
        return self._tested(residual, imbalance), np.array([np.linalg.norm(correction)])

    def _tested(self, residual: np.ndarray, balance: np.ndarray | None) -> np.ndarray:
        """A residual, (ell,), with that of the balance of loose bodies, (r,), in the places of
        their motions.
        """
        if self.motions is None:
            return residual
        unknowns: np.ndarray = self.motions.modes @ balance
        unknowns[: self.modes] = residual
        return unknowns

    def elastic_forces(self, theta: Theta) -> np.ndarray:
        """Contact forces λ_e of the elastic bodies, without plastic strain, (m,).

        Raises:
            NotSolvableError: if there are none.
        """
        slack = self.gaps(theta)
        statuses, _ = self.touched(UNILATERAL_STEP, slack, self.driving(theta), slack < 0)
        if statuses.status is not Status.CONVERGED:
            raise NotSolvableError(
                f"the elastic contact problem has no solution: {statuses.status.value}"
            )
        return statuses.forces

    def strain_along(self, x: np.ndarray, way: ParameterDirection) -> np.ndarray:
        """See :class:`Equilibrium`; compliances change too.

        Args:
            x: unknown: correction, forces and motions, (n,).
            way: point and direction of the parameters.
        """
        change = self.free_strain @ way.change
        if self.moduli:
            elastic = self.flow.forced @ way.theta - self.parts_of(x)[1] @ self.flow.per_force
            change = (
                change + np.tile(self._softer(way)[self.flow.parts], self.flow.components) * elastic
            )
        return self._by_point(change)

    def gaps_along(self, x: np.ndarray, way: ParameterDirection) -> np.ndarray:
        """See :class:`Equilibrium`.

        Args:
            x: unknown: correction, forces and motions, (n,).
            way: point and direction of the parameters.
        """
        if not self.moduli:
            return self.gaps(way.change)
        softer = self._softer(way)
        by_forces = np.tensordot(softer, self.flow.schur, 1) @ self.parts_of(x)[1]
        return (
            self.gaps(way.change)
            + by_forces
            - np.tensordot(softer, self.flow.pressed, 1) @ way.theta
        )

    def residual_along(self, x: np.ndarray, change: Update, way: ParameterDirection) -> np.ndarray:
        """See :class:`Equilibrium`; elastic forces change on their active conditions.

        Args:
            x: unknown: correction, forces and motions, (n,).
            change: derivatives of stress and state.
            way: point and direction of the parameters.
        """
        flow = self.flow
        residual: np.ndarray = flow.tested @ change.state.inelastic.T.ravel()
        driving = self.driving(way.change)
        if not self.law.remembers:  # else P is 0: forces of elastic bodies depend on the path
            elastic = self.elastic_forces(way.theta)
            unknown = np.zeros(self.size)
            unknown[self.modes : self.modes + self.conditions] = elastic
            residual = residual + self.coupled @ self._elastic_changes(
                elastic, self.gaps_along(unknown, way), driving
            )
            if self.moduli:
                softer = self._softer(way)[flow.mode_parts][:, None] * flow.coupled
                residual -= softer @ (self.parts_of(x)[1] - elastic)
        return self._tested(residual, driving)

    def _elastic_changes(
        self, forces: np.ndarray, slack: np.ndarray, driving: np.ndarray
    ) -> np.ndarray:
        """Derivatives of forces of elastic bodies by those of slack and loads, (m,)."""
        if self.motions is None:
            return self.equalities(forces > 0, slack)[0]
        changes, _ = self.motions.changed(
            (self.motions.modes @ driving)[:, None], slack[:, None], forces > 0
        )
        return changes[:, 0]

    def _softer(self, way: ParameterDirection) -> np.ndarray:
        """Derivative of the compliance of each part along a way, (Q,)."""
        return self.flow.factors.slopes(way.point) @ way.direction

    def signs(self, answer: Answer) -> Signs:
        """Signs of leaving the training: stress of unfamiliar plastic strain on Z.

        Steps balance on Z for any plastic strain, and all rows are kept.
        """
        misfit, size = self.fields.unexplained(answer)
        return Signs(0.0, 0.0, 0.0, misfit=misfit, stress=size)

    def linearised(self, tangents: np.ndarray) -> _CondensedLinearisation:
        """See :class:`Equilibrium`."""
        return _CondensedLinearisation(self, tangents)

    def stepper(self, settings: MarchSettings) -> Stepper:
        """Solver of the steps of one history: a compiled loop of programs with unilateral contact,
        or Python.
        """
        code = any(isinstance(group.law, LawCode) for group in self.flow.groups)
        python = code or self.law.remembers or self.loose is not None
        return (NewtonStepper if python else CondensedStepper)(self, settings)

    @cached_property
    def step_model(self) -> StepModel:
        """Arrays of the compiled loop; moduli must be numbers."""
        flow = self.flow
        scale = self.scale if (self.scale != 1.0).any() else np.zeros(0)
        arrays = (
            flow.per_mode,
            flow.tested,
            flow.per_force,
            scale,
            self.schur,
            flow.moved,
            flow.modal,
            self.coupled,
        )
        further = (
            flow.ends,
            float(np.linalg.norm(flow.tested)),
            np.array([flow.per_mode, flow.tested], dtype=np.float32),
        )
        fields: list[Any] = [*map(np.ascontiguousarray, arrays), *further]
        return StepModel(*fields)


class _CondensedLinearisation:
    """Linearisation of a converged step with consistent tangents on Z, (n, c, c), for derivatives
    of histories.
    """

    def __init__(self, model: CondensedEquilibrium, tangents: np.ndarray):
        self._model = model
        self._tested = model.flowing(tangents)
        self._plain = model.flow.modal - self._tested @ model.flow.per_mode.T
        self.held = nullcontext

    @cached_property
    def _per_force(self) -> np.ndarray:
        """Corrections by contact forces, (ell, m)."""
        model = self._model
        per_force = (self._tested * model.scale) @ model.flow.per_force.T + model.coupled
        return self._corrected(per_force)

    def _corrected(self, residual: np.ndarray) -> np.ndarray:
        """Corrections under a residual, (ell,) or (ell, K)."""
        try:
            return np.linalg.solve(self._plain, residual)
        except np.linalg.LinAlgError as error:
            raise NotSolvableError(f"the derivative of a step has no solution: {error}") from error

    @cached_property
    def motions(self) -> LinearisedKernel | None:
        """Motions of loose bodies on S, with the corrections that forces cause; None without."""
        model = self._model
        if model.motions is None:
            return None
        equalities = SchurEqualities.of(self.schur(), LapackLU)
        return kernels().linearised(
            equalities, model.motions.contact_of_motions, model.motions.modes
        )

    def schur(self) -> np.ndarray:
        """S with the corrections that forces cause, (m, m)."""
        return self._model.schur + self._model.flow.moved @ self._per_force

    def solve(self, residual: np.ndarray) -> np.ndarray:
        """Correction under a residual, and neither forces nor motions, (ell + m + r,)."""
        model = self._model
        solution = np.zeros(model.size)
        solution[: model.modes] = self._corrected(residual[: model.modes])
        return solution

    def push(self, forces: np.ndarray) -> np.ndarray:
        """Unknown without contact forces less that under forces, (m,)."""
        nothing = np.zeros(self._model.size - self._model.modes - forces.size)
        return np.concatenate([self._per_force @ forces, -forces, nothing])

    def slack_of(self, gaps: np.ndarray, x: np.ndarray) -> np.ndarray:
        """See :meth:`CondensedEquilibrium.slack_of`.

        Args:
            gaps: gaps, (m,), or their change.
            x: unknown: correction, forces and motions, (n,).
        """
        return self._model.slack_of(gaps, x)

    def changed(
        self, residual: np.ndarray, gaps: np.ndarray, active: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Solve the linearised step for small changes.

        Q dg + P dλ = tested dε_p/dε (E_p dg - E_X^T dλ) + residual, B V dg - S dλ = gaps where
        active. Elsewhere dλ = 0.

        Returns:
            (dg, dλ) and dλ.

        Raises:
            NotSolvableError: if the system is singular.
        """
        model = self._model
        if self.motions is not None:
            free = self.solve(residual)
            solution, motion = self.motions.changed(
                residual[:, None], self.slack_of(gaps, free)[:, None], active
            )
            return free - self.push(solution[:, 0]) + motion[:, 0], solution[:, 0]
        on = np.flatnonzero(active)
        per_force = (self._tested * model.scale) @ model.flow.per_force[on].T + model.coupled[:, on]
        size = model.modes
        matrix = np.zeros((size + on.size, size + on.size))
        matrix[:size, :size] = self._plain
        matrix[:size, size:] = per_force
        matrix[size:, :size] = model.flow.moved[on]
        matrix[size:, size:] = -model.schur[np.ix_(on, on)]
        try:
            solution = np.linalg.solve(matrix, np.concatenate([residual, gaps[on]]))
        except np.linalg.LinAlgError as error:
            raise NotSolvableError(f"the derivative of a step has no solution: {error}") from error
        forces = np.zeros(model.conditions)
        forces[on] = solution[size:]
        return np.concatenate([solution[:size], forces]), forces


_WHY = {
    compiled_step.STALLED: "no part of Newton's step down to 1/256 lowers the residual",
    compiled_step.LIMIT: "the iterations allowed are spent",
    compiled_step.NOT_FINITE: "a law found no flow, or one that is impossible",
    compiled_step.CONTACT: "the contact forces were not found",
}
"""Message for each way in which a step may end."""


class CondensedStepper(CorrectionStepper):
    """Solves steps by the compiled loop; has its own work arrays."""

    def __init__(self, model: CondensedEquilibrium, settings: MarchSettings):
        super().__init__(model, settings)
        self._arrays = model.step_model
        flow = model.flow
        memory = flow.components + 1 + model.material.remembered
        sizes = model.modes, model.conditions, flow.points.size, flow.components, memory
        self._work = WorkArrays.of(*sizes)
        self._elastic = WorkArrays.of(*sizes)
        self._last = LastOf()  # laws of the last material, as constants seldom change

    def _grow(self, size: float) -> None:
        numbers = self._work.numbers
        numbers[compiled_step.SIZE] = max(numbers[compiled_step.SIZE], size)

    def _step_from(self, starts: Sequence[np.ndarray], here: Answer, goal: Goal) -> Answer:
        model = self.model
        material = model.material.at(goal.parameter)
        theta = model.amplitudes(goal.parameter)
        before = gauss_of(here).state
        # rows one after another: other orders would be compiled anew, which takes half a minute
        memory = np.ascontiguousarray(
            np.concatenate([before.inelastic.T, before.cumulated[None], before.memory.T])
        )
        further = memory, goal.time - here.time
        laws: StepLaws = self._last.of(material, lambda: laws_of(material))
        # without a correction, so that these are the forces of the elastic bodies
        load = StepLoad(
            model.free_strain @ theta, self._elastic.forces, model.gaps(theta), *further
        )
        if not touch(self._arrays, load, self._elastic):
            raise Diverged("the elastic contact problem has no solution")
        spent = 0
        for start in starts:
            self._work.there[:] = start
            code = self._solve(load, laws)
            spent += int(self._work.numbers[compiled_step.ITERATION])
            if code == compiled_step.CONVERGED:
                return self._answer(goal, load, spent)
        ratio = self._work.numbers[compiled_step.MERIT] / max(
            float(np.linalg.norm(self._work.here)), 1e-300
        )
        reason = self._complaint(load, material) if code == compiled_step.NOT_FINITE else _WHY[code]
        left_over = (
            f", with a residual of {ratio:.2g} of the correction" if np.isfinite(ratio) else ""
        )
        raise Diverged(f"{reason}{left_over} after {spent} iterations")

    def _solve(self, load: StepLoad, laws: StepLaws) -> int:
        """Try once from the correction in the work arrays; returns why it ended."""
        limits = self.settings.relative_force, self.settings.iterations
        try:
            return int(compiled_step.solve(self._arrays, load, self._work, laws, *limits))
        except LinAlgError:
            return compiled_step.STALLED

    def _complaint(self, load: StepLoad, material: Material) -> str:
        """Message on what is wrong with the strain tried last."""
        components = len(self._work.stress)
        strain = self._work.strain.reshape(components, -1).T
        try:
            material.update(strain, _state(load.memory, components), load.dt, tangent=False)
        except ConvergenceError as error:
            return str(error)
        return _WHY[compiled_step.NOT_FINITE]

    def _answer(self, goal: Goal, load: StepLoad, iterations: int) -> Answer:
        """Answer from the work arrays."""
        model = self.model
        work = self._work
        self._grow(float(np.linalg.norm(work.here)))
        components = len(work.stress)
        strain = work.strain.reshape(work.stress.shape).T
        self._strains.check(strain)
        state = _state(work.memory.copy(), components)
        stress = np.einsum("nij,nj->ni", model.material.elastic, strain - state.inelastic)
        gauss = GaussState(stress, state)
        forces = work.forces.copy()
        unknown = np.concatenate([work.here, forces])
        status_of_step = work.active.copy(), iterations, Status.CONVERGED, False, model.fields
        return Answer(
            goal.parameter, unknown, forces, *status_of_step, goal.time, memory=Memory(gauss=gauss)
        )


def _state(memory: np.ndarray, components: int) -> InternalVariables:
    """State from the memory of a step, (c + 1 + k, n)."""
    return InternalVariables(memory[:components].T, memory[components], memory[components + 1 :].T)


def laws_of(material: Material) -> StepLaws:
    """Laws of the groups of a material for the compiled step; their constants must be numbers."""
    laws = [group.law for group in material.groups]
    numbers = np.cumsum([law is not None for law in laws]) - 1
    numbers[[law is None for law in laws]] = -1
    constants = np.zeros(
        (max(len(law_numbers.constants) for law_numbers in material.given), material.gauss_points)
    )
    for group, law_numbers in zip(material.groups, material.given, strict=True):
        constants[: len(law_numbers.constants), group.indices] = law_numbers.constants
    compliance = np.stack([law_numbers.compliance for law_numbers in material.given])
    return StepLaws(material.code, numbers, constants, compliance, material.grading)


class CondensedFlowModel(KeptModel):
    """Condensed model of inelastic bodies; answers paths.

    See :mod:`hhr_dolfinx.plugins.inelastic.condensed_flow`.

    Threads may share a model; it can be copied and pickled.

    Args:
        flow: arrays of the step.
        parameters: the box of the parameters.
        fields: completes the answers.
        trained: training range.
        offline: record of its construction, a ``Record``; None for a model from a file.
    """

    kept = ("flow", "parameters", "fields", "trained")

    def __init__(
        self,
        flow: CondensedFlow,
        parameters: ParameterSpace,
        fields: CondensedFlowFields,
        trained: TrainedPaths | None = None,
        *,
        offline: Record | None = None,
    ):
        self.flow = flow
        self.parameters = parameters
        self.fields = fields
        self.trained = trained
        self.offline = offline
        self.law = fields.law
        self.equilibrium = CondensedEquilibrium(flow, parameters, fields)
        self.equilibrium.trained = trained

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """See :class:`KeptModel`."""
        yield from super().faults(sizes)
        flow = self.flow
        fields = self.fields
        space = self.parameters
        if flow.components != (4 if fields.dimension == 2 else 6):
            yield f"{flow.components} components of a strain in dimension {fields.dimension}"
        if not np.array_equal(flow.points, fields.flow.points):
            yield (
                "the points of the step and those from which fields are completed are not the same"
            )
        same = np.array_equal(fields.factors.middle, flow.factors.middle)
        if fields.factors.moduli != flow.factors.moduli or not same:
            yield "the moduli of the step and those of the fields are not the same"
        if fields.parts.min() < 0 or fields.parts.max() >= len(flow.schur):
            yield "fields.parts has indices outside the parts of the stiffness"
        yield from flow.factors.faults_for(space)
        yield from Material(flow.groups, flow.components, space.names).faults_for(
            space, fields.dimension
        )
        factors = [modulus.factor for modulus in flow.factors.moduli] or ["1"]
        for group in flow.groups:
            modulus_of_group = group.young if isinstance(group.young, str) else "1"
            if {factors[number] for number in np.unique(flow.parts[group.indices])} != {
                modulus_of_group
            }:
                yield f"points with young = {group.young} are not on the part of this modulus"
