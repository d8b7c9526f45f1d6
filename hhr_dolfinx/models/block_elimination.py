"""Elimination of gamma from a reduced problem whose stiffness is a sum of parts with moduli.

Bodies that only contact joins do not share entries of K~, if each mode moves one of them: K~ falls apart into blocks
that are factored one by one, a quarter of the work for two of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, eigh
from scipy.linalg.lapack import dgetrf, dgetrs
from scipy.sparse.csgraph import connected_components

from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.errors import SingularError
from hhr_dolfinx.models.elimination import CondensedContact, Elimination
from hhr_dolfinx.models.projected import ReducedProblem, ReducedTerms
from hhr_dolfinx.plain import Rebuilt

ROUND_OFF = 1e-12
"""Part of the largest entry of a part of K~ below which an entry couples nothing."""
SYMMETRIC = 1e-10
"""Largest difference of a part and its transpose, relative, of a projection on functions that are tested too."""
DEFINITE = 1e-11
"""Smallest eigenvalue of the sum of the parts, relative to the largest, with which modes keep five digits."""


class Block(NamedTuple):
    """Modes that no other ones share entries of K~ with.

    Attributes:
        modes: their places, (k,).
        parts: numbers of the parts that touch them, (q,).
        entries: entries of these parts transposed, one row each, (q, k * k).
        test: columns of B~1^T on them, (k, m), in Fortran order.
        trial: columns of B~2 on them, (m, k).
    """

    modes: np.ndarray
    parts: np.ndarray
    entries: np.ndarray
    test: np.ndarray
    trial: np.ndarray


class BlockElimination(Elimination):
    """Eliminates gamma at any parameter.

    Args:
        problem: the reduced problem, with its terms.
        amplitudes: θ as a function of the parameters.
    """

    def __init__(self, problem: ReducedProblem, amplitudes: Amplitudes):
        terms = problem.terms
        if terms is None:
            raise ValueError("a problem whose stiffness is constant is eliminated once, by Responses.eliminate")
        self.problem, self.terms, self.amplitudes = problem, terms, amplitudes
        self._forces, self._gaps = np.asfortranarray(terms.forces), np.asfortranarray(problem.gaps)
        # all parts beside each other, so that one product sums their lifts
        self._lifts = terms.lifts if np.any(terms.lifts) else None
        self.blocks = blocks_of(problem)

    def __call__(self, point: np.ndarray) -> ReducedElimination:
        """Eliminate at a point, (P,).

        Raises:
            SingularError: if K~ is singular there.
        """
        weights, loads = self.weights_and_loads(point)
        slack, m = self._gaps @ self.amplitudes(point), len(self.problem.gaps)
        schur, free, factors, pushed = np.zeros((m, m)), np.empty(loads.size), [], []
        for block in self.blocks:
            size = block.modes.size
            matrix = (weights[block.parts] @ block.entries).reshape(size, size).T
            lu, pivots, info = dgetrf(matrix, overwrite_a=1)
            if info:
                raise SingularError(f"K~ of {size} modes is singular at {point.tolist()}")
            solved = dgetrs(lu, pivots, np.column_stack([loads[block.modes], block.test]))[0]
            free[block.modes] = solved[:, 0]
            slack -= block.trial @ solved[:, 0]
            schur += block.trial @ solved[:, 1:]
            factors.append((lu, pivots))
            pushed.append(solved[:, 1:])
        return ReducedElimination(self, point, weights, schur, slack, free, factors, pushed)

    def weights_and_loads(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Weights of the parts of K~, (Q,), and loads on gamma, (ell,), at a point, (P,)."""
        theta = self.amplitudes(point)
        weights = np.array([modulus.value(point) for modulus in self.terms.moduli])
        loads = self._forces @ theta
        if self._lifts is not None:
            loads = loads - weights @ np.stack([lift @ theta for lift in self._lifts])
        return weights, loads


@dataclass(frozen=True)
class DiagonalBlock:
    """Modes in which a block is diagonal at every parameter.

    The sum of two positive semi-definite parts, changes of volume and of shape say, is diagonal in the same modes W
    whatever their weights: with W^T (K_1 / |K_1| + K_2 / |K_2|) W = I and W^T K_q W = diag(d_q),
    K~^-1 = W diag(1 / sum_q w_q d_q) W^T.

    Attributes:
        modes: W, (k, k).
        entries: d_q, (q, k).
    """

    modes: np.ndarray
    entries: np.ndarray

    @classmethod
    def of(cls, block: Block) -> DiagonalBlock | None:
        """Of a block; None where it has more than two parts, or is not symmetric and definite."""
        size = block.modes.size
        parts = block.entries.reshape(-1, size, size)
        largest = np.abs(parts).max(axis=(1, 2), initial=0.0)
        skew = np.abs(parts - parts.transpose(0, 2, 1)).max(axis=(1, 2), initial=0.0)
        if not 0 < len(parts) < 3 or (skew > SYMMETRIC * largest).any():
            return None
        total = np.tensordot(1 / largest, parts, 1)
        try:
            sizes = eigh(total, eigvals_only=True)
            if not sizes[0] > DEFINITE * sizes[-1]:
                return None
            _, modes = eigh(parts[0], total)
        except LinAlgError:
            return None
        return cls(modes, np.array([np.sum(modes * (part @ modes), axis=0) for part in parts]))

    def solved(self, weights: np.ndarray, right: np.ndarray) -> np.ndarray:
        """K~^-1 times a right-hand side, (k,), for weights of the parts, (q,)."""
        return self.modes @ ((right @ self.modes) / (weights @ self.entries))


class KnownForces:
    """Maps a point, (P,), and contact forces, (m,), to gamma, (ell,): no S, and hardly a factor.

    Args:
        elimination: of the same problem with the forces unknown.
    """

    def __init__(self, elimination: BlockElimination):
        self._elimination = elimination
        self._diagonal = [DiagonalBlock.of(block) for block in elimination.blocks]

    def __call__(self, point: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """The unknown.

        Raises:
            SingularError: if K~ is singular there.
        """
        weights, loads = self._elimination.weights_and_loads(point)
        found = np.empty(loads.size)
        for block, diagonal in zip(self._elimination.blocks, self._diagonal, strict=True):
            right, own = loads[block.modes] - block.test @ forces, weights[block.parts]
            found[block.modes] = _solved(block, own, right) if diagonal is None else diagonal.solved(own, right)
        return found


def _solved(block: Block, weights: np.ndarray, right: np.ndarray) -> np.ndarray:
    """K~^-1 times a right-hand side, (k,), by factors of a block."""
    size = block.modes.size
    lu, pivots, info = dgetrf((weights @ block.entries).reshape(size, size).T, overwrite_a=1)
    if info:
        raise SingularError(f"K~ of {size} modes is singular")
    return dgetrs(lu, pivots, right)[0]


@dataclass(frozen=True)
class BlockReduction(Rebuilt, Elimination):
    """Eliminates the unknown of a reduced problem whose stiffness is a sum of parts; plain data, for files.

    Attributes:
        problem: with its terms.
        amplitudes: θ as a function of the parameters.
    """

    problem: ReducedProblem
    amplitudes: Amplitudes

    @cached_property
    def _eliminated(self) -> BlockElimination:
        return BlockElimination(self.problem, self.amplitudes)

    @cached_property
    def _known_forces(self) -> KnownForces:
        return KnownForces(self._eliminated)

    def __call__(self, point: np.ndarray) -> ReducedElimination:
        """Eliminate at a point, (P,)."""
        return self._eliminated(point)

    def under(self, point: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """gamma, (ell,), at a point under known contact forces, (m,), in a hundredth of the time of an elimination."""
        return self._known_forces(point, forces)


def blocks_of(problem: ReducedProblem) -> list[Block]:
    """What of a reduced problem whose stiffness is a sum of parts shares entries of K~."""
    terms = problem.terms
    if terms is None:
        return []
    sizes = np.abs(terms.stiffness)
    # orthonormal modes of one body have round-off on the other
    coupled = np.any(sizes > ROUND_OFF * sizes.max(axis=(1, 2), keepdims=True), axis=0)
    _, label = connected_components(coupled, directed=False)
    return [_block(problem, terms, np.flatnonzero(label == k)) for k in range(label.max() + 1)]


def _block(problem: ReducedProblem, terms: ReducedTerms, modes: np.ndarray) -> Block:
    parts = terms.stiffness[:, modes][:, :, modes]
    largest = np.abs(terms.stiffness).max(axis=(1, 2))
    touching = np.flatnonzero(np.abs(parts).max(axis=(1, 2)) > ROUND_OFF * largest)
    entries = np.ascontiguousarray(parts[touching].transpose(0, 2, 1)).reshape(touching.size, -1)
    test = np.asfortranarray(problem.contact_test[:, modes].T)
    return Block(modes, touching, entries, test, np.ascontiguousarray(problem.contact_trial[:, modes]))


@dataclass(frozen=True)
class ReducedElimination(CondensedContact):
    """See :class:`hhr_dolfinx.models.elimination.CondensedContact`.

    Attributes:
        owner: what it was made by.
        point: the parameter, (P,).
        weights: of the parts, (Q,).
        schur, free_slack: as there.
        free: gamma without contact forces, (ell,).
        factors: LU of each block.
        per_force: K~^-1 B~1^T of each block, (k, m).
    """

    owner: BlockElimination
    point: np.ndarray
    weights: np.ndarray
    schur: np.ndarray
    free_slack: np.ndarray
    free: np.ndarray
    factors: list
    per_force: list

    def unknown(self, forces: np.ndarray) -> np.ndarray:
        """gamma under contact forces, (ell,)."""
        return self.free - self.pushed(forces)

    def pushed(self, forces: np.ndarray) -> np.ndarray:
        """K~^-1 B~1^T times forces, (m,) or (m, k)."""
        found = np.empty((self.free.size, *forces.shape[1:]))
        for block, columns in zip(self.owner.blocks, self.per_force, strict=True):
            found[block.modes] = columns @ forces
        return found

    def at_fixed_forces(self, forces: np.ndarray, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """K~ gamma' = f' - K~' gamma, and the slack that goes with it."""
        terms, point, amplitudes = self.owner.terms, self.point, self.owner.amplitudes
        theta, (acting, slopes) = amplitudes(point), amplitudes.slopes_at(point)
        changes = np.array([modulus.derivative(point) for modulus in terms.moduli])
        right = terms.forces[:, acting] @ slopes
        for part, lift, weight, change in zip(terms.stiffness, terms.lifts, self.weights, changes, strict=True):
            right -= weight * (lift[:, acting] @ slopes) + np.outer(part @ unknown + lift @ theta, change)
        found = np.empty_like(right)
        slack = self.owner.problem.gaps[:, acting] @ slopes
        for block, factor in zip(self.owner.blocks, self.factors, strict=True):
            found[block.modes] = dgetrs(*factor, right[block.modes])[0]
            slack -= block.trial @ found[block.modes]
        return slack, found
