"""Fields on the whole mesh from a reduced answer, thesis sections 1.4.6 and 6.2.3."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx.amplitudes import Amplitudes, Theta
from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.models.answer import Answer, Completion, InterfaceCompletion, Meshed, ModelFields
from hhr_dolfinx.models.bound import (
    Bound,
    BoundThere,
    OutputBound,
    Response,
    ResponseWithin,
    Thetas,
    driven,
)
from hhr_dolfinx.models.displacement import LinearDisplacement, dense
from hhr_dolfinx.models.estimates import FORCES_INDICATOR, NO_OUTPUTS, Estimate, Estimates
from hhr_dolfinx.models.whole_surface import (
    ByLaw,
    ByS,
    ByTraining,
    ForceCompletion,
    WholeForces,
    gradient_of,
)
from hhr_dolfinx.plain import CODE, OF_THE_MESH, Rebuilt

if TYPE_CHECKING:
    from hhr_dolfinx.models.functionals.functional import Functionals
    from hhr_dolfinx.models.many import ManyAnswers


@dataclass(frozen=True, eq=False)
class _OfAnswer:
    """Quantities of one answer that several methods of a reconstruction share, computed once."""

    fields: Reconstruction
    answer: Answer

    @cached_property
    def theta(self) -> Theta:
        """θ, (1 + T,)."""
        return self.fields.amplitudes(self.answer.parameter)

    @cached_property
    def bound(self) -> BoundThere:
        """The bound at the parameter."""
        assert self.fields.bound is not None
        return self.fields.bound.at(self.answer.parameter[None], self.theta)

    @cached_property
    def whole(self) -> WholeForces:
        """Forces on the whole surface."""
        return self.fields.completion.of(self)


@dataclass(frozen=True)
class Reconstruction(Rebuilt, LinearDisplacement, ModelFields):
    """Fields on the whole mesh and contact forces on the whole contact surface.

    Parts without a comment are those of :class:`~hhr_dolfinx.models.answer.ModelFields`.
    """

    amplitudes: Amplitudes  #: θ as a function of the parameters
    #: columns of the displacement, (N, c): V, whose coordinates are gamma, or C of a `response`
    basis: Annotated[Floats, "N", "columns"]
    lifts: Annotated[csc_matrix, "N", "terms"]  #: imposed displacements, sparse, (N, 1 + T)
    contact_basis: Annotated[Floats, "N_lambda", "columns"]  #: B times these columns, (N_lambda, c)
    gaps: Annotated[Floats, "N_lambda", "terms"]  #: D as terms of θ, (N_lambda, 1 + T)
    A_lambda: Annotated[Integers, "m", "< N_lambda"]  #: contact conditions of the RID
    #: columns of S_lambda whose cone contains all of them, (N_lambda, S'); None if S of the bound
    #: completes forces
    force_snapshots: Annotated[Floats, "N_lambda", "snapshots"] | None
    #: length scale of the gap of each condition, so that (1.70) does not depend on units,
    #: (N_lambda,)
    gap_scale: Annotated[Floats, "N_lambda"]
    dimension: int  #: components of the displacement at a node
    flow: Completion | None = None
    #: stress of a displacement of elastic bodies; None for a model from a file, which has no mesh
    stress_of: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = field(
        default=None, metadata=OF_THE_MESH
    )
    indicator: Callable[[Answer], float] | None = field(default=None, metadata=CODE)
    bound: Bound | None = None
    functionals: Functionals | None = None
    output_bound: OutputBound | None = None
    unbounded: str = ""
    #: coordinates of forces on the whole surface if S and the response to loads are known; None if
    #: they are gamma
    response: Response | None = None
    interface: InterfaceCompletion | None = None
    full: Meshed | None = field(default=None, metadata=OF_THE_MESH)

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Invalid conditions of the RID, and columns without matching coordinates."""
        if np.unique(self.A_lambda).size < self.A_lambda.size:
            yield "contact conditions of the RID are there twice: they are dependent"
        if not (self.gap_scale > 0).all():
            yield f"gap_scale has the entry {self.gap_scale.min()}, not positive"
        if self.force_snapshots is None and self.bound is None and self.interface is None:
            yield "neither training forces nor a bound say what forces outside the RID are"
        if self.response is not None and (self.force_snapshots is not None or self.bound is None):
            yield "its displacement is made of forces everywhere, and nothing completes them"
        if self.interface is not None and not np.array_equal(self.interface.within, self.A_lambda):
            yield "its law of interfaces is that of another RID"
        if self.output_bound is not None and (
            self.bound is None
            or self.functionals is None
            or not self.output_bound.fits(self.functionals)
        ):
            yield "its estimates of outputs are not those of its outputs"

    @property
    def conditions(self) -> int:
        """Number of conditions on the whole contact surface, N_lambda."""
        return len(self.gaps)

    def surface_at(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """``gaps`` and ``contact_basis``, constant if no parameter changes the shape.

        Args:
            point: parameter, (P,).
        """
        return self.gaps, self.contact_basis

    def slack_changes(self, answer: Answer, changes: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """See :class:`~hhr_dolfinx.models.whole_surface.ContactSurface`."""
        gaps, contact_basis = self.surface_at(answer.parameter)
        return gaps[rows] @ changes - contact_basis[rows] @ gradient_of(answer).unknown

    @cached_property
    def completion(self) -> ForceCompletion:
        """How forces are completed on the whole surface: by the parts that the model has."""
        if self.interface is not None:
            return ByLaw(self.interface)
        if self.force_snapshots is not None:
            return ByTraining(self.force_snapshots, self.A_lambda, self.gap_scale, self)
        assert self.bound is not None
        return ByS(self.bound, self.A_lambda)

    def _slack(self, theta: Thetas, unknown: np.ndarray) -> np.ndarray:
        """Slack of fields, (n, N_lambda), of modes, (n, ell), and θ of each."""
        return driven(self.gaps, theta) - unknown @ self.contact_basis.T

    def _coordinates(self, answer: Answer) -> np.ndarray:
        """Coordinates of the columns of the displacement, (c,).

        They are gamma, or a function of all forces.
        """
        if self.response is None or not answer.converged:
            return answer.unknown if self.response is None else np.full(self.basis.shape[1], np.nan)
        of_answer = self._of(answer)
        return self._responding.coordinates(answer, of_answer.bound, of_answer.whole.forces)

    def _of(self, answer: Answer) -> _OfAnswer:
        """Quantities of an answer, those of the last one again."""
        last: _OfAnswer | None = vars(self).get("_last")
        if last is None or last.answer is not answer:
            last = _OfAnswer(self, answer)
            vars(self)["_last"] = last  # as a whole, so that threads do not mix two answers
        return last

    @cached_property
    def _responding(self) -> ResponseWithin:
        """The response in the columns of the displacement."""
        assert self.response is not None
        return self.response.within(self)

    @cached_property
    def _lifted(self) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of the terms with a lift, and their columns.

        Dense, since sparse ones take 5 us.
        """
        lifted = np.flatnonzero(np.diff(self.lifts.tocsc().indptr))
        return lifted, self.lifts[:, lifted].toarray(order="F")

    def displacement(self, answer: Answer) -> np.ndarray:
        """Displacement V gamma + lift, thesis (1.69), (N,).

        With a ``response`` it is a function of loads and forces.
        """
        field = self.basis @ self._coordinates(answer)
        if self.response is not None:
            field += self.response.loaded @ (self.response.loading @ self._of(answer).theta)
        lifted, columns = self._lifted
        if lifted.size:
            field += columns @ self.amplitudes.dense(answer.parameter)[lifted]
        return field

    def forces(self, answer: Answer) -> np.ndarray:
        """Contact forces on all conditions, (N_lambda,): those of the model inside the RID, outside
        by its :attr:`completion`.
        """
        if not answer.converged:
            return np.full(len(self.gaps), np.nan)
        return self._of(answer).whole.forces.copy()  # the caller may change it

    def _all_force_changes(self, answer: Answer, changes: np.ndarray) -> np.ndarray:
        return self._of(answer).whole.changes(changes)

    def _per_coordinate(self, rows: csr_matrix) -> np.ndarray:
        return rows @ self.basis

    def _terms(self, rows: csr_matrix) -> np.ndarray:
        per_term = dense(rows @ self.lifts)
        return (
            per_term
            if self.response is None
            else per_term + (rows @ self.response.loaded) @ self.response.loading
        )

    def _coordinate_changes(self, answer: Answer, changes: np.ndarray) -> np.ndarray:
        assert answer.gradient is not None
        if self.response is None:
            return answer.gradient.unknown
        return self._responding.changes(
            self._of(answer).bound,
            self.forces(answer),
            lambda: self._all_force_changes(answer, changes),
            changes,
        )

    def stress(self, answer: Answer) -> np.ndarray:
        """Stress in Kelvin's notation, (places, components).

        At cell midpoints, or where laws of bodies are evaluated.
        """
        return super().stress(answer) if self.flow is None else self.flow.stress_of(answer)

    def estimate(self, answer: Answer) -> Estimate | None:
        """Estimate by the bound, or by an indicator of the recipe or of laws.

        None without either.
        """
        if not answer.converged:
            return None
        if self.bound is None:
            return self._indicated(answer)
        of_answer = self._of(answer)
        bound_at: Any = of_answer.bound
        forces = of_answer.whole.forces[None]
        if self.force_snapshots is not None:
            forces = np.maximum(forces, 0.0)
        unknown = answer.unknown[None]
        estimate = bound_at.of(unknown, forces, lambda: self._slack(of_answer.theta, unknown))[0]
        if self.output_bound is None:
            return estimate
        exact = bound_at.exact(forces)
        if not exact.found[0]:
            return estimate
        return estimate._replace(
            outputs=self.output_bound.errors(self, answer, forces[0], exact.forces[0])
        )

    def indicating(self, answer: Answer) -> tuple[np.ndarray, np.ndarray, np.ndarray, Memory]:
        """Input of an indicator of forces.

        Returns:
            Forces in the RID, (m,), slack of all conditions, (N_lambda,), scale of gaps,
            (N_lambda,), and memory.
        """
        gaps, contact_basis = self.surface_at(answer.parameter)
        slack = driven(gaps, self._of(answer).theta) - answer.unknown[None] @ contact_basis.T
        return answer.multipliers, slack[0], self.gap_scale, answer.memory

    def estimates(self, many: ManyAnswers) -> Estimates | None:
        """Estimates of many answers at once; None if they are made one by one."""
        bound = self.bound
        if bound is None or bound.together == 1 or not isinstance(self.completion, ByS):
            return None
        outside = self.completion.outside

        def bounded(rows: np.ndarray) -> Estimates:
            theta = self.amplitudes.of_many(many.points[rows])
            bound_at = bound.at(many.points[rows], theta)
            forces = bound_at.completed(many.multipliers[rows], outside)
            unknown = many.unknown[rows]
            return bound_at.of(unknown, forces, partial(self._slack, theta, unknown))

        estimates = Estimates.by_blocks(bound.kind, many.converged, bound.together, bounded)
        if self.output_bound is None:
            return estimates

        def outputs_of(k: int) -> Mapping[str, float]:
            estimate = many[k].estimate()
            return NO_OUTPUTS if estimate is None else estimate.outputs

        return replace(estimates, outputs_of=outputs_of)

    def _indicated(self, answer: Answer) -> Estimate | None:
        """Estimate of an indicator.

        It is user-defined, or that of a law of interfaces or of laws of bodies.
        """
        if self.indicator is not None:
            return Estimate.indicated(self.indicator(answer))
        if self.interface is not None and self.flow is None:
            return Estimate.indicated(
                self.interface.indicated(*self.indicating(answer)), FORCES_INDICATOR
            )
        return None if self.flow is None else self.flow.estimate(answer)
