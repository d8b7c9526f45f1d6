"""Elimination of gamma for a stiffness that is a sum of parts with moduli.

Bodies joined by contact alone share no entries of K~ if each mode moves one of them. K~ then falls
apart into blocks that are factored one by one, a quarter of the work for two of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs
from scipy.sparse.csgraph import connected_components

from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.errors import SingularError
from hhr_dolfinx.models.eliminations.elimination import CondensedContact, Elimination
from hhr_dolfinx.models.eliminations.projected import ReducedProblem, ReducedTerms
from hhr_dolfinx.plain import Rebuilt

COUPLING_ROUND_OFF = 1e-12
"""Part of the largest entry of a part of K~ below which an entry couples no modes."""


class ModeBlock(NamedTuple):
    """Modes that share entries of K~ with each other alone."""

    modes: np.ndarray  #: their indices, (k,)
    parts: np.ndarray  #: numbers of the parts that act on them, (q,)
    entries: np.ndarray  #: entries of these parts transposed, one row each, (q, k * k)
    test: np.ndarray  #: columns of B~1^T on them, (k, m), in Fortran order
    trial: np.ndarray  #: columns of B~2 on them, (m, k)


class _Kept(NamedTuple):
    """Arrays shared by all points of one stiffness."""

    weights: np.ndarray  #: of the parts of K~, (Q,)
    schur: np.ndarray  #: S, (m, m)
    factors: list  #: of the blocks of K~
    per_force: list[np.ndarray]  #: K~^-1 B~1^T of each block


@dataclass(frozen=True)
class BlockElimination(Rebuilt, Elimination):
    """Eliminates the unknown of a reduced problem whose stiffness is a sum of parts.

    Plain data, for files.
    """

    problem: ReducedProblem  #: the reduced problem, with the terms of its stiffness
    amplitudes: Amplitudes  #: θ as a function of the parameters

    @cached_property
    def blocks(self) -> list[ModeBlock]:
        """Blocks of modes that share entries of K~."""
        return blocks_of(self.problem)

    def __call__(self, point: np.ndarray, kept: _Kept | None = None) -> CondensedContact:
        """Eliminate at a point, (P,); ``kept`` has S of its stiffness if known.

        SingularError: K~ is singular there.
        """
        weights, loads = self._weights_and_loads(point)
        if kept is None:
            kept = self._kept(weights)
        slack = self._gaps @ self.amplitudes(point)
        free = np.empty(loads.size)
        for block, factor in zip(self.blocks, kept.factors, strict=True):
            free[block.modes] = dgetrs(*factor, loads[block.modes])[0]
            slack -= block.trial @ free[block.modes]
        respond = partial(self._compliance_times, kept.per_force)
        changes = partial(self._changes, point, weights, kept.factors)
        return CondensedContact(kept.schur, slack, free, respond, changes)

    def along_path(self) -> Callable[[np.ndarray], CondensedContact]:
        """Elimination along a path: neighbours of equal stiffness share S."""
        shared: list[_Kept] = []

        def made(point: np.ndarray) -> CondensedContact:
            weights = self._terms.weights(point)
            if not shared or not np.array_equal(shared[0].weights, weights):
                shared[:] = [self._kept(weights)]
            return self(point, shared[0])

        return made

    def _kept(self, weights: np.ndarray) -> _Kept:
        """Arrays shared by points with these weights of the parts of K~, (Q,)."""
        m = len(self.problem.gaps)
        schur = np.zeros((m, m))
        factors = [factored(block, weights[block.parts]) for block in self.blocks]
        per_force = [
            dgetrs(*factor, block.test)[0]
            for block, factor in zip(self.blocks, factors, strict=True)
        ]
        for block, columns in zip(self.blocks, per_force, strict=True):
            schur += block.trial @ columns
        return _Kept(weights, schur, factors, per_force)

    @cached_property
    def _terms(self) -> ReducedTerms:
        if self.problem.terms is None:
            raise ValueError(
                "a problem whose stiffness is constant is eliminated once, by Responses.eliminate"
            )
        return self.problem.terms

    @cached_property
    def _forces(self) -> np.ndarray:
        return np.asfortranarray(self._terms.forces)

    @cached_property
    def _gaps(self) -> np.ndarray:
        return np.asfortranarray(self.problem.gaps)

    @cached_property
    def _lifts(self) -> np.ndarray | None:
        return self._terms.lifts if np.any(self._terms.lifts) else None

    def _weights_and_loads(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Weights of the parts of K~, (Q,), and loads on gamma, (ell,), at a point, (P,)."""
        theta = self.amplitudes(point)
        weights = self._terms.weights(point)
        loads = self._forces @ theta
        if self._lifts is not None:
            loads = loads - weights @ np.stack([lift @ theta for lift in self._lifts])
        return weights, loads

    def _compliance_times(self, per_force: list[np.ndarray], forces: np.ndarray) -> np.ndarray:
        """K~^-1 B~1^T times forces, (m,) or (m, k), from its columns by block."""
        unknown = np.empty((len(self.problem.stiffness), *forces.shape[1:]))
        for block, columns in zip(self.blocks, per_force, strict=True):
            unknown[block.modes] = columns @ forces
        return unknown

    def _changes(
        self,
        point: np.ndarray,
        weights: np.ndarray,
        factors: list,
        forces: np.ndarray,
        unknown: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives from K~ gamma' = f' - K~' gamma, and those of the slack."""
        right, slack = self.problem.changes(self.amplitudes, point, weights, unknown)
        changes = np.empty_like(right)
        for block, factor in zip(self.blocks, factors, strict=True):
            changes[block.modes] = dgetrs(*factor, right[block.modes])[0]
            slack -= block.trial @ changes[block.modes]
        return slack, changes


def factored(block: ModeBlock, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """LU factors of a block of K~.

    Args:
        block: the block.
        weights: weights of its parts, (q,).

    Raises:
        SingularError: if the block is singular.
    """
    size = block.modes.size
    lu, pivots, info = dgetrf((weights @ block.entries).reshape(size, size).T, overwrite_a=1)
    if info:
        raise SingularError(f"K~ of {size} modes is singular")
    return lu, pivots


def blocks_of(problem: ReducedProblem) -> list[ModeBlock]:
    """Blocks of a reduced problem whose stiffness is a sum of parts."""
    terms = problem.terms
    if terms is None:
        return []
    sizes = np.abs(terms.stiffness)
    # orthonormal modes of one body have round-off on the other
    coupled = np.any(sizes > COUPLING_ROUND_OFF * sizes.max(axis=(1, 2), keepdims=True), axis=0)
    _, label = connected_components(coupled, directed=False)
    return [_block(problem, terms, np.flatnonzero(label == k)) for k in range(label.max() + 1)]


def _block(problem: ReducedProblem, terms: ReducedTerms, modes: np.ndarray) -> ModeBlock:
    matrices = terms.stiffness[:, modes][:, :, modes]
    largest = np.abs(terms.stiffness).max(axis=(1, 2))
    touching = np.flatnonzero(np.abs(matrices).max(axis=(1, 2)) > COUPLING_ROUND_OFF * largest)
    entries = np.ascontiguousarray(matrices[touching].transpose(0, 2, 1)).reshape(touching.size, -1)
    test = np.asfortranarray(problem.contact_test[:, modes].T)
    return ModeBlock(
        modes, touching, entries, test, np.ascontiguousarray(problem.contact_trial[:, modes])
    )
