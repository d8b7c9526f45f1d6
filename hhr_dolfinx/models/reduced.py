"""Hybrid hyper-reduced (HHR) model, (1.61), (5.23).

Small arrays, of elastic bodies and bodies with laws.

It needs neither DOLFINx nor gmsh nor PETSc: a model read from a file runs on any machine with NumPy
and SciPy, and what the plug-in of its laws needs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any, Protocol, Self

import numpy as np

from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.contact.kernel import kernels
from hhr_dolfinx.errors import ReductionError, SingularError
from hhr_dolfinx.linear.dense import Factorise, LapackLU, dense_factors
from hhr_dolfinx.models.answer import Answer, CheckedStart, SeveralAnswers
from hhr_dolfinx.models.condensed import CondensedModel
from hhr_dolfinx.models.eliminations.constant import ConstantElimination
from hhr_dolfinx.models.eliminations.elimination import CondensedContact, Elimination, Responses
from hhr_dolfinx.models.eliminations.projected import ReducedProblem
from hhr_dolfinx.models.histories.equilibrium import Equilibrium
from hhr_dolfinx.models.model import KeptModel
from hhr_dolfinx.models.reconstruct import Reconstruction
from hhr_dolfinx.models.starts import KnownStatuses
from hhr_dolfinx.parameters import ParameterSpace, PointsLike
from hhr_dolfinx.trained import USUAL, Trained, TrainedRange

ADVICE: Mapping[Status, str] = MappingProxyType(
    {
        Status.SINGULAR: "add modes or use fewer contact points in the RID",
        Status.ADRIFT: "solve in full to see which body that is, and hold or push it",
        Status.CYCLING: (
            "the reduced model is not trustworthy here, add RID layers or change the basis"
        ),
    }
)


class ReducedLaws(Protocol):
    """Arrays of bodies with laws on a RID, which a plug-in makes and a file keeps."""

    @property
    def cells(self) -> np.ndarray:
        """Numbers of the cells where laws are evaluated."""

    def equilibrium(
        self,
        problem: ReducedProblem,
        parameters: ParameterSpace,
        fields: Reconstruction,
        trained: Trained | None,
    ) -> Equilibrium:
        """Equilibrium of gamma: answers paths.

        Args:
            problem: the projected arrays.
            parameters: the box of the parameters.
            fields: completes the answers.
            trained: training range; None if it is unknown.
        """

    def faults_of(self, model: ReducedModel) -> Iterator[str]:
        """Faults of arrays that do not fit their model."""


class ReducedModel(KeptModel):
    """HHR model: answers a parameter or a path by the projected equations on the RID.

    In elastic models gamma is eliminated, (5.23), and an answer costs one small contact problem.
    Models of bodies with laws evaluate these on the RID.

    Args:
        problem: the projected arrays.
        parameters: the box of the parameters.
        fields: completes the answers.
        trained: training range: of points, or of paths for bodies with laws.
        known: statuses of the training points on A_lambda; None for bodies with laws.
        flow: laws of bodies on the RID; None in elastic models.
        offline: record of the construction, a ``Record``; None for a model from a file.
        factorise: factors K~ and the active blocks.
        compliances: elimination of gamma that is quicker than factors of K~ at each point; None
            factors K~.

    Attributes:
        eliminated: the model without gamma, which solves elastic problems; None for bodies with
            laws.

    Raises:
        SingularError: if K~ is singular.
    """

    kept = ("problem", "parameters", "fields", "trained", "known", "flow", "compliances")
    handed_on = ("factorise",)
    advice = ADVICE

    def __init__(
        self,
        problem: ReducedProblem,
        parameters: ParameterSpace,
        fields: Reconstruction,
        trained: Trained | None = None,
        *,
        known: KnownStatuses | None = None,
        flow: ReducedLaws | None = None,
        offline: object = None,
        factorise: Factorise = dense_factors,
        compliances: Elimination | None = None,
    ):
        self.compliances = compliances
        self.problem = problem
        self.parameters = parameters
        self.fields = fields
        self.trained = trained
        self.known = known
        self.flow = flow
        self.offline = offline
        self.factorise = factorise
        if fields.interface is not None:
            self.law = fields.interface.inside
        self.eliminated: CondensedModel | None = None
        try:
            if flow is None:
                self.eliminated = self._without_gamma()
            else:
                self.equilibrium = flow.equilibrium(problem, parameters, fields, trained)
        except SingularError as error:
            raise SingularError(
                f"K~ cannot be eliminated, {error}: add RID layers or use fewer modes"
            ) from error

    @property
    def own_conditions(self) -> int:
        """Number of conditions of the RID, whose forces an answer has as multipliers."""
        return len(self.problem.gaps)

    @property
    def sizes(self) -> tuple[int, int]:
        """Numbers of unknowns and of conditions of an answer."""
        return len(self.problem.stiffness), self.own_conditions

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """See :class:`KeptModel`."""
        yield from super().faults(sizes)
        ell = len(self.problem.stiffness)
        conditions = len(self.problem.gaps)
        if not isinstance(self.compliances, Elimination | None):
            yield f"compliances is a {type(self.compliances).__name__}, and must be an Elimination"
        if conditions != self.fields.A_lambda.size or conditions > ell:
            yield (
                f"{conditions} contact conditions on {ell} modes are dependent, or not those of "
                "the RID"
            )
        if self.flow is not None:
            yield from self.flow.faults_of(self)

    @classmethod
    def from_file(cls, **parts: Any) -> Self:
        """Rebuild from a file, with LAPACK's factors: answers are the same on all machines."""
        return cls(**parts, factorise=LapackLU)

    def _answered(
        self, point: np.ndarray, start: CheckedStart, outside: str, gradient: bool
    ) -> Answer:
        assert self.eliminated is not None
        return self.eliminated._answered(point, start, outside, gradient)

    def solve_many(
        self, points: PointsLike, *, raise_on_failure: bool = True, outside: str = USUAL
    ) -> SeveralAnswers:
        """Answer many parameters, (n, P), see :meth:`CondensedModel.solve_many`.

        One by one with laws.

        Args:
            points: parameters, (n, P).
            raise_on_failure: raise at the first point without a solution.
            outside: see :meth:`Model.solve`.
        """
        if self.eliminated is None or self.by_paths:
            return super().solve_many(points, raise_on_failure=raise_on_failure, outside=outside)
        return self.eliminated.solve_many(
            points, raise_on_failure=raise_on_failure, outside=outside
        )

    def contacts(self) -> Callable[[np.ndarray], CondensedContact]:
        """See :class:`AnsweringModel`; the conditions of the RID, without gamma."""
        return super().contacts() if self.eliminated is None else self.eliminated.contacts()

    def _without_gamma(self) -> CondensedModel:
        """The model with gamma eliminated.

        Once, or for each parameter if the stiffness depends on it.
        """
        if self.known is None:
            raise ReductionError(
                "a model of elastic bodies starts from known statuses: give them as known"
            )
        eliminated = self.compliances or _elimination(
            self.problem, self.fields.amplitudes, self.factorise
        )
        trained = self.trained if isinstance(self.trained, TrainedRange) else None
        return CondensedModel(
            self.parameters,
            eliminated,
            self.known,
            self.fields,
            self.problem.pairs,
            trained,
            ADVICE,
            self.law,
        )


def _elimination(
    problem: ReducedProblem, amplitudes: Amplitudes, factorise: Factorise
) -> Elimination:
    """Elimination of gamma: constant, of a sum of parts, or with the kernel of K."""
    if problem.motions:
        return kernels().elimination(problem, amplitudes)
    if problem.terms is not None:
        from hhr_dolfinx.models.eliminations.block import BlockElimination

        return BlockElimination(problem, amplitudes)
    contact = problem.contact_test, problem.contact_trial
    responses = Responses.eliminate(
        factorise(problem.stiffness), problem.loads, problem.gaps, *contact
    )
    return ConstantElimination(responses, amplitudes, factorise)
