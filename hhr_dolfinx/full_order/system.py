"""System of equations of a scene: K, loads, gaps and contact rows at any point of its parameters.

Subclasses differ in how they obtain K: constant; a multiple of K of each body; a sum of parts that
is factored. The plug-in of shapes and user-defined classes, ``Scene(system=...)``, add others.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Protocol, TypeAlias

import numpy as np

from hhr_dolfinx.contact.active_set import Pairs, active_set
from hhr_dolfinx.contact.problem import ContactProblem, ScaledBodies
from hhr_dolfinx.models.answer import Answer, ModelFields, found_as
from hhr_dolfinx.models.eliminations.elimination import CondensedContact, answer_of

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix, csr_matrix

    from hhr_dolfinx.amplitudes import Theta
    from hhr_dolfinx.contact.stiffness import SparseStiffness, Stiffness
    from hhr_dolfinx.formulas import Modulus
    from hhr_dolfinx.full_order.free_bodies import FreeBody

    Parts: TypeAlias = tuple[tuple[Modulus, ...], tuple[csr_matrix, ...]]
    Middle: TypeAlias = Callable[[], SparseStiffness]
    Made: TypeAlias = Callable[[csr_matrix, ContactProblem], SparseStiffness]


@dataclass(eq=False, slots=True)  # one for each query
class SystemAt:
    """Equations at one point: K u + B^T lambda = loads, B u <= gaps (n own dofs, m conditions)."""

    system: System
    point: np.ndarray  #: the parameter, (P,)
    problem: ContactProblem  #: with the rows, gaps and amplitudes there
    stiffness: Stiffness  #: K
    loads: np.ndarray  #: F - K lift on own free dofs, (n,)
    gaps: np.ndarray  #: D - B lift, (m,)

    def contact(self) -> CondensedContact:
        """The contact problem without the displacement, on all ranks."""
        stiffness = self.stiffness
        problem = self.problem
        free = stiffness.solve(self.loads)
        closed = problem.contact_of_rows @ free
        response = stiffness.response_to_forces
        if not (rows := problem.spread).all_here:  # a microsecond each, of a query of 80
            free = rows.whole(free)
            closed = rows.sum(closed)
            response = self._response
        kernel = None if problem.kernel is None else problem.kernel.condensed(self)
        changes = self._at_fixed_forces
        return CondensedContact(
            stiffness.schur, self.gaps - closed, free, response, changes, True, kernel, stiffness
        )

    def _response(self, forces: np.ndarray) -> np.ndarray:
        return self.problem.spread.whole(self.stiffness.response_to_forces(forces))

    def _at_fixed_forces(
        self, forces: np.ndarray, unknown: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """K U' = -R', with the residual R = K U + B^T lambda - F; and the change of the slack."""
        residual, slack = self.system.explicit(self.point, forces, unknown)
        with self.stiffness.held():
            changes = np.stack([self.stiffness.solve(-column) for column in residual.T], axis=1)
        return slack - self.problem.contact_rows_times(changes), self.problem.spread.whole(changes)


class System(ABC):
    """Makes the equations of any point."""

    anew: bool = True  #: K of another point is factored
    #: moduli of whole bodies, if nothing else of K varies: factors of the middle of the box are
    #: used at all points
    bodies: ScaledBodies | None = None

    def __init__(
        self,
        problem: ContactProblem,
        middle: Middle,
        made: Made,
    ):
        self.problem = problem  # of all points
        self.middle = middle  # returns K in the middle of the box
        # makes K of local rows of a matrix with the same pattern, (n, N), and a problem with rows
        # of B
        self.made = made

    def at(self, point: np.ndarray) -> SystemAt:
        """Equations at a point, (P,); NotSolvableError if K is singular there, or an elastic
        constant inadmissible.
        """
        theta = self.problem.amplitudes(point)  # first, since it refuses inadmissible constants
        problem, stiffness, loads = self.equations(point, theta)
        return SystemAt(self, point, problem, stiffness, loads, problem.gaps @ theta)

    def stiffness(self, point: np.ndarray) -> Stiffness:
        """K at a point, (P,)."""
        return self.at(point).stiffness

    def answer(
        self,
        point: np.ndarray,
        start: np.ndarray | None,
        pairs: Pairs | None,
        fields: ModelFields,
        gradient: bool,
    ) -> Answer:
        """Solve at a point.

        Args:
            point: parameters, (P,).
            start: statuses to start from, (m,) bool; None for those of the free slack.
            pairs: contact pair of each condition; None takes all for one pair.
            fields: fields of the model, for the answer.
            gradient: compute the derivatives along the parameters.
        """
        at = self.at(point)
        with at.stiffness.held() if self.anew else nullcontext():
            return answer_of(at.contact(), point, start, pairs, fields, gradient=gradient)

    @abstractmethod
    def equations(
        self, point: np.ndarray, theta: Theta
    ) -> tuple[ContactProblem, Stiffness, np.ndarray]:
        """Equations at a point, in which systems differ.

        Args:
            point: parameters, (P,).
            theta: θ at the point.

        Returns:
            The problem with rows and gaps, K, and local loads, (n,).
        """

    def parts(self) -> Parts | None:
        """Weights and local rows of matrices whose sum is K, (own, N) each.

        Without weights one constant matrix.

        None if K is not such a sum. Reductors read a system through its parts, and refuse one
        without.
        """
        return None

    def explicit(
        self, point: np.ndarray, forces: np.ndarray, unknown: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives at constant unknowns and forces.

        Args:
            point: parameters, (P,).
            forces: contact forces, (m,).
            unknown: primal unknown, (n,).

        Returns:
            Derivatives of the residual, (n, P), and of the slack, (m, P).
        """
        problem = self.problem
        acting, slopes = problem.amplitudes.slopes_at(point)
        slopes_of_terms = np.zeros((problem.loads.shape[1], slopes.shape[1]))
        slopes_of_terms[acting] = slopes
        residual = -problem.spread.of(problem.loads_at(point, slopes_of_terms))
        theta = problem.amplitudes(point)
        terms = (
            zip(problem.moduli, problem.stiffness_terms, problem.lift_terms, strict=True)
            if problem.moduli
            else ()
        )
        for modulus, stiffness, lift in terms:
            residual += np.outer(
                stiffness @ unknown + lift[problem.rows] @ theta, modulus.derivative(point)
            )
        return residual, problem.gaps[:, acting] @ slopes


class _OfParts(System):
    """A system whose K is the sum of the parts of its problem.

    The last K is kept, as often only loads change.
    """

    _last: tuple[np.ndarray, Stiffness] | None = None

    def parts(self) -> Parts:
        return self.problem.moduli, self.problem.stiffness_terms

    def _kept(self, scales: np.ndarray, made: Callable[[np.ndarray], Stiffness]) -> Stiffness:
        """K for some scales; several threads may call this."""
        last = self._last
        if last is None or not np.array_equal(last[0], scales):
            self._last = None  # K may be larger than everything else
            self._last = last = scales, made(scales)
        return last[1]


class ConstantSystem(_OfParts):
    """Only loads and gaps depend on parameters."""

    anew = False

    def equations(
        self, point: np.ndarray, theta: Theta
    ) -> tuple[ContactProblem, Stiffness, np.ndarray]:
        """See :class:`System`.

        Args:
            point: parameters, (P,).
            theta: θ at the point.
        """
        return self.problem, self.middle(), self._own_loads @ theta

    def answer(
        self,
        point: np.ndarray,
        start: np.ndarray | None,
        pairs: Pairs | None,
        fields: ModelFields,
        gradient: bool,
    ) -> Answer:
        """See :class:`System`.

        It is written out where possible: values of a point would take long beside a small query.

        Args:
            point: parameters, (P,).
            start: statuses to start from, (m,) bool; None for those of the free slack.
            pairs: contact pair of each condition; None takes all for one pair.
            fields: fields of the model, for the answer.
            gradient: compute the derivatives along the parameters.
        """
        problem = self.problem
        if gradient or problem.kernel is not None or not problem.spread.all_here:
            return super().answer(point, start, pairs, fields, gradient)
        theta = problem.amplitudes(point)
        stiffness = self.middle()
        free = stiffness.solve(self._own_loads @ theta)
        slack = problem.gaps @ theta - problem.contact_of_rows @ free
        outcome = active_set(
            stiffness.equalities, slack, slack < 0 if start is None else start, pairs=pairs
        )
        return found_as(outcome, point, free - stiffness.response_to_forces(outcome.forces), fields)

    @cached_property
    def _own_loads(self) -> csc_matrix:
        return self.problem.loads[self.problem.rows]


class ScaledSystem(_OfParts):
    """Moduli of whole bodies: a multiple of K of each; nothing is factored."""

    anew = False

    def __init__(self, bodies: ScaledBodies, *given: *tuple[ContactProblem, Middle, Made]):
        super().__init__(*given)
        self.bodies: ScaledBodies = bodies

    def equations(
        self, point: np.ndarray, theta: Theta
    ) -> tuple[ContactProblem, Stiffness, np.ndarray]:
        """See :class:`System`.

        Args:
            point: parameters, (P,).
            theta: θ at the point.
        """
        problem = self.problem
        return problem, self.stiffness(point), problem.spread.of(problem.loads_at(point, theta))

    def stiffness(self, point: np.ndarray) -> Stiffness:
        """K at a point, (P,)."""
        stiffness: Stiffness = self._kept(
            self.bodies.at(point), lambda scales: self.middle().scaled(scales)
        )
        return stiffness


class SummedSystem(_OfParts):
    """A weighted sum of parts, which is factored."""

    def equations(
        self, point: np.ndarray, theta: Theta
    ) -> tuple[ContactProblem, Stiffness, np.ndarray]:
        """See :class:`System`.

        Args:
            point: parameters, (P,).
            theta: θ at the point.
        """
        problem = self.problem
        weights = problem.weights(point)
        stiffness = self._kept(
            weights, lambda weights: self.made(problem.stiffness_of(weights), problem)
        )
        return problem, stiffness, problem.spread.of(problem.loads_at(point, theta))


class StatedSystem(Protocol):
    """System of a scene; a user-defined one the tool ``systems`` makes of the scene, parts of K,
    and springs.

    The parts of K of its bodies are local rows of all dofs without springs, (own, N) each; springs
    are the stiffness to ground of each dof, (N,), or None.
    """

    def left_free(self, bodies: list[FreeBody], problem: ContactProblem) -> list[FreeBody]:
        """Bodies with the motions that K leaves.

        Args:
            bodies: bodies with rigid motions.
            problem: the contact problem.
        """

    def system(self, problem: ContactProblem, middle: Middle, made: Made) -> System:
        """The system of a problem, with its constraints and springs.

        Args:
            problem: the contact problem.
            middle: returns K in the middle of the box.
            made: makes a stiffness of local rows of K and a problem.
        """

    def read(
        self, system: System, problem: ContactProblem
    ) -> tuple[ContactProblem, SparseStiffness]:
        """Contact problem with the parts of the system, and K in the middle of the box.

        The parts are compared with the equations of the system.

        Args:
            system: the system of the problem.
            problem: the contact problem.
        """


def system_of(problem: ContactProblem, *makers: *tuple[Middle, Made]) -> System:
    """The system of a problem, by ``middle`` and ``made``: which data of it depend on
    parameters.
    """
    if not problem.moduli:
        return ConstantSystem(problem, *makers)
    bodies = ScaledBodies.of(problem)
    return (
        SummedSystem(problem, *makers) if bodies is None else ScaledSystem(bodies, problem, *makers)
    )
