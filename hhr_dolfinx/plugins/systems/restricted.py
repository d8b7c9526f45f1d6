"""User-defined K of all dofs, to which the core adds springs, and which constraints restrict.

With U = T V + L theta the equations of V are T^T (K + S) T V + (B T)^T lambda = T^T (F - (K + S) L
theta), S the diagonal of springs. A system gives K of all dofs and F - K L theta on those that are
not imposed, as if no dof depended on others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, diags

from hhr_dolfinx.amplitudes import Theta
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.contact.stiffness import Stiffness
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.full_order.system import System
from hhr_dolfinx.plugins.elasticity.parts import with_springs

if TYPE_CHECKING:
    from hhr_dolfinx.full_order.system import Made, Parts


@dataclass(frozen=True, eq=False)
class OfAllDofs:
    """K of all dofs as ``made`` returns it, local rows (own, N), which is not yet restricted."""

    matrix: csr_matrix


def problem_of_all_dofs(
    problem: ContactProblem, stiffness: tuple[csr_matrix, ...]
) -> ContactProblem:
    """The problem as if no dof depended on others.

    Lifts keep their values on dependent dofs, so that F - K L is that of all dofs.

    Args:
        problem: the problem with dependent dofs.
        stiffness: parts of K of its bodies, (own, N) each.
    """
    prolongation = replace(
        problem.prolongation, free=problem.prolongation.movable, map=None, groups=None
    )
    assert problem.whole_contact is not None
    contact = csr_matrix(problem.whole_contact @ diags(prolongation.free.astype(float)))
    contact.eliminate_zeros()
    return replace(
        problem, prolongation=prolongation, stiffness_terms=stiffness, contact=contact, kernel=None
    )


def own_loads(loads: np.ndarray, problem: ContactProblem, name: str) -> np.ndarray:
    """Loads of a system, checked, (own,).

    Args:
        loads: loads of the local rows, (own,).
        problem: the contact problem.
        name: name of the scene.

    Raises:
        SceneError: for another shape.
    """
    count = problem.rows.stop - problem.rows.start
    if np.shape(loads) != (count,):
        raise SceneError(
            f"loads of the system of scene '{name}' have the shape {np.shape(loads)}: those of the "
            f"{count} local rows are needed, problem.spread.of(loads)"
        )
    return loads


class Restricted(System):
    """The equations of V by those of all dofs.

    Attributes:
        given: the user-defined system, of the problem as if no dof depended on others.
        springs: stiffness to ground of local dofs, (own,).
    """

    def __init__(
        self,
        given: System,
        problem: ContactProblem,
        name: str,
        springs: np.ndarray | None,
        made: Made,
    ):
        super().__init__(problem, given.middle, made)
        self.given = given
        self.anew = given.anew
        self._name = name
        self._every = np.zeros(problem.free.size) if springs is None else springs
        self.springs = self._every[problem.rows]
        # S L of local rows
        self._pulled = csc_matrix(diags(self.springs) @ problem.lifts[problem.rows])
        self._last: tuple[OfAllDofs, ContactProblem, Stiffness] | None = None

    def equations(
        self, point: np.ndarray, theta: Theta
    ) -> tuple[ContactProblem, Stiffness, np.ndarray]:
        """See :class:`System`.

        Args:
            point: parameters, (P,).
            theta: θ there.

        Raises:
            SceneError: for a K that is not made by ``made``.
        """
        of_all, of_all_dofs, loads = self.given.equations(point, theta)
        if not isinstance(of_all_dofs, OfAllDofs):
            raise SceneError(
                f"the system of scene '{self._name}' has K = {of_all_dofs!r}: make it by made()"
            )
        problem = self.problem
        if of_all is not self.given.problem:  # rows or gaps of the point
            free = diags(problem.free.astype(float))
            contact = csr_matrix(problem.prolongation.rows(of_all.contact) @ free)
            problem = replace(problem, contact=contact, gaps=of_all.gaps)
        loads = own_loads(loads, problem, self._name) - self._pulled @ theta
        return problem, self._restricted(of_all_dofs, problem), self._on_free(loads)

    def _restricted(self, whole: OfAllDofs, problem: ContactProblem) -> Stiffness:
        """T^T (K + S) T; the last one is kept, as K of a system may be constant."""
        last = self._last  # several threads may call this
        if last is None or last[0] is not whole or last[1] is not problem:
            matrices = with_springs((), self._every, (whole.matrix,), (), problem.rows.start)[0]
            (matrix,) = problem.prolongation.stiffness(matrices, problem.rows, problem.group)
            self._last = last = whole, problem, self.made(matrix, problem)
        return last[2]

    def _on_free(self, forces: np.ndarray) -> np.ndarray:
        """T^T F on free dofs, by local rows, (own, ...). Collective."""
        problem = self.problem
        if problem.on_rows is not None:
            forces = problem.on_rows.restrict @ forces
        return (forces.T * problem.free[problem.rows]).T

    def parts_of_all_dofs(self) -> Parts | None:
        """Weights and local rows of the parts of K + S, before dependent dofs are eliminated."""
        if (stated := self.given.parts()) is None:
            return None
        moduli, matrices = stated
        if not moduli:  # their sum is one constant matrix
            first, *further = matrices
            matrices = (sum(further, start=first),)
        names = self.problem.parameters.names
        both = with_springs(names, self._every, tuple(matrices), tuple(moduli), self.problem.first)
        return both[1], both[0]

    def parts(self) -> Parts | None:
        """See :class:`System`: T^T (K_q + S) T."""
        if (stated := self.parts_of_all_dofs()) is None:
            return None
        problem = self.problem
        return stated[0], problem.prolongation.stiffness(stated[1], problem.rows, problem.group)

    def explicit(
        self, point: np.ndarray, forces: np.ndarray, unknown: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`System`.

        Args:
            point: parameters, (P,).
            forces: contact forces, (m,).
            unknown: displacement, (n,).
        """
        residual, slack = self.given.explicit(point, forces, unknown)
        acting, slopes = self.problem.amplitudes.slopes_at(point)
        return self._on_free(residual + self._pulled[:, acting] @ slopes), slack
