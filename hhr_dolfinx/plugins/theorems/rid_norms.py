"""Norms on a reduced integration domain, on the whole one, and of contact forces, with the
constants of a in them.

Fields are arrays (N,) that vanish on imposed dofs; functions of V^0 on Omega_A, which vanish on its
interface, arrays (|A|,). a(w, v) for such a v needs of w what lies on A and I alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg
from scipy.sparse import csr_matrix

from hhr_dolfinx.contact.problem import IndexSets
from hhr_dolfinx.linear.sparse import FreeCholesky, ordering_of
from hhr_dolfinx.models.full import FullModel
from hhr_dolfinx.plugins.theorems.ellipticity import (
    Ellipticity,
    largest_eigenvalue,
    of_stiffness,
    on_dofs,
)

NEGLIGIBLE_MODE = 1e-12
"""Singular value of modes cut off outside A over the largest, below which they are dependent to
round-off.
"""


@dataclass(frozen=True)
class Directions:
    """A space by vectors, (n, k), orthonormal in a norm.

    ``gram`` multiplies columns by the Gram matrix of the norm.
    """

    vectors: np.ndarray
    gram: Callable[[np.ndarray], np.ndarray]

    @classmethod
    def spanned(cls, columns: np.ndarray, gram: Callable[[np.ndarray], np.ndarray]) -> Directions:
        """The span of columns, which may be dependent.

        Args:
            columns: the columns, (n, m).
            gram: multiplies columns by the matrix of the scalar product.
        """
        directions, sizes, _ = linalg.svd(columns, full_matrices=False)
        directions = directions[:, sizes > NEGLIGIBLE_MODE * sizes.max(initial=0.0)]
        energies, axes = (
            linalg.eigh(directions.T @ gram(directions))
            if directions.size
            else (np.ones(0), np.zeros((0, 0)))
        )
        return cls(directions @ (axes / np.sqrt(energies)), gram)

    def distance(self, field: np.ndarray) -> float:
        """Distance of a vector, (n,), to the space."""
        for _ in range(2):
            field = field - self.vectors @ (self.vectors.T @ self.gram(field))
        return root(field @ self.gram(field))


@dataclass(frozen=True)
class Domain:
    """Omega_A in a full problem.

    It has K, (N, N), free dofs, (N,) bool, sets of the RID, and B[A_lambda], (N_lambda_C, N).

    ``factor`` makes factors of K on the dofs of a mask, (N,) bool.
    """

    stiffness: csr_matrix
    free: np.ndarray
    sets: IndexSets
    contact: csr_matrix
    factor: Callable[[np.ndarray], FreeCholesky]

    @classmethod
    def of(cls, full: FullModel, sets: IndexSets) -> Domain:
        """The RID of a reduced model of a full model on one rank.

        Args:
            full: the full model.
            sets: index sets of the RID.
        """
        from petsc4py import PETSc

        problem = full.problem
        name = full.scene.name
        ordering = ordering_of(
            problem.block_size, "qmd"
        )  # the fastest for one right-hand side after another

        def factor(mask: np.ndarray) -> FreeCholesky:
            rows = slice(0, problem.free.size)
            return FreeCholesky(
                problem.stiffness, mask, rows, name, ordering, PETSc.COMM_SELF.tompi4py()
            )

        return cls(problem.stiffness, problem.free, sets, problem.contact[sets.A_lambda], factor)

    @cached_property
    def rows(self) -> csr_matrix:
        """K[A], (|A|, N)."""
        return self.stiffness[self.sets.A]

    @cached_property
    def inner(self) -> csr_matrix:
        """K[A, A], (|A|, |A|)."""
        return self.rows[:, self.sets.A]

    @cached_property
    def acting(self) -> csr_matrix:
        """B[A_lambda, A]^T: loads on A of contact forces, (|A|, N_lambda_C)."""
        return csr_matrix(self.contact[:, self.sets.A].T)

    @cached_property
    def _mask(self) -> np.ndarray:
        """Dofs of A, (N,) bool."""
        mask = np.zeros(self.free.size, dtype=bool)
        mask[self.sets.A] = True
        return mask

    @cached_property
    def support(self) -> np.ndarray:
        """Free dofs of A and I, (N,) bool."""
        mask = self._mask.copy()
        mask[self.sets.I] = True
        return mask & self.free

    @cached_property
    def solve_inner(self) -> Callable[[np.ndarray], np.ndarray]:
        """K[A, A]^-1 times a vector, (|A|,)."""
        return on_dofs(self.factor(self._mask).solve, self.sets.A, self.free.size)

    @cached_property
    def outside(self) -> FreeCholesky | None:
        """Factors of K on the free dofs outside Omega_A; None without such dofs."""
        mask = self.free & ~self.support
        return self.factor(mask) if mask.any() else None


@dataclass(frozen=True)
class EuclideanNorms:
    """The norms of section 2.6.1: Euclidean ones of nodal values and of nodal forces."""

    domain: Domain

    def inside(self, columns: np.ndarray) -> np.ndarray:
        """Gram matrix on V^0 times columns, (|A|, k)."""
        return columns

    def whole(self, columns: np.ndarray) -> np.ndarray:
        """Gram matrix on the whole domain times columns, (N, k)."""
        return columns

    def on_domain(self, field: np.ndarray) -> float:
        """Norm on Omega_A of a field, (N,)."""
        return float(np.linalg.norm(field[self.domain.support]))

    def of_forces(self, forces: np.ndarray) -> float:
        """Norm of contact forces of the RID."""
        return float(np.linalg.norm(forces))

    def of_residual(self, residual: np.ndarray) -> float:
        """Norm of a functional on V^0, (|A|,)."""
        return float(np.linalg.norm(residual))

    @cached_property
    def inner(self) -> Ellipticity:
        """Constants of a on V^0."""
        return of_stiffness(self.domain.inner, self.domain.solve_inner)

    @cached_property
    def from_interface(self) -> float:
        """Continuity constant of a(w, v) for v in V^0 and w that vanishes but on the interface."""
        interface = self.domain.sets.I
        coupling = self.domain.rows[:, interface[self.domain.free[interface]]]
        return (
            float(np.sqrt(largest_eigenvalue(csr_matrix(coupling.T @ coupling))))
            if coupling.nnz
            else 0.0
        )

    def continuity(self, test: Directions) -> float:
        """Continuity constant of a(w, v) for any w and v in a space of V^0, (2.7)."""
        images = self.domain.rows[:, np.flatnonzero(self.domain.support)].T @ test.vectors
        return float(np.linalg.norm(images, 2))


@dataclass(frozen=True)
class EnergyNorms:
    """Energy of displacements, and the L2 norm of the contact pressure.

    The latter is (sum of force^2 / area)^1/2.

    The energy on Omega_A is the least for the displacements given there: at most that of the whole
    field, and for a function of V^0 equal to it. So M_a = alpha = 1, by Cauchy and Schwarz.
    ``force_gram`` is 1 / area, (N_lambda_C,).
    """

    domain: Domain
    force_gram: np.ndarray
    inner: Ellipticity = Ellipticity(1.0, 1.0)
    from_interface: float = 1.0

    def inside(self, columns: np.ndarray) -> np.ndarray:
        """Gram matrix on V^0 times columns, (|A|, k)."""
        return self.domain.inner @ columns

    def whole(self, columns: np.ndarray) -> np.ndarray:
        """Gram matrix on the whole domain times columns, (N, k)."""
        return self.domain.stiffness @ columns

    def on_domain(self, field: np.ndarray) -> float:
        """Norm on Omega_A of a field, (N,)."""
        extended = np.where(self.domain.support, field, 0.0)
        if self.domain.outside is not None:
            extended -= self.domain.outside.solve(self.domain.stiffness @ extended)
        return root(extended @ (self.domain.stiffness @ extended))

    def of_forces(self, forces: np.ndarray) -> float:
        """Norm of contact forces of the RID."""
        return root(forces @ (self.force_gram * forces))

    def of_residual(self, residual: np.ndarray) -> float:
        """Norm of a functional on V^0, (|A|,)."""
        return root(residual @ self.domain.solve_inner(residual))

    def continuity(self, test: Directions) -> float:
        """Continuity constant of a(w, v) for any w and v in a space of V^0, (2.7)."""
        return 1.0


Norms = EuclideanNorms | EnergyNorms


def root(square: float) -> float:
    """Square root of a number that is not negative but for round-off."""
    return float(np.sqrt(max(float(square), 0.0)))
