"""Galerkin's fields under known contact forces, for a stiffness that is a sum of parts with moduli:
no S is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import LinAlgError, eigh
from scipy.linalg.lapack import dgetrs

from hhr_dolfinx.formulas import Modulus
from hhr_dolfinx.models.displacement import dense
from hhr_dolfinx.models.eliminations.block import BlockElimination, ModeBlock, factored

SYMMETRIC_PARTS = 1e-10
"""Largest relative difference of a part and its transpose in a Galerkin projection (equal test and
trial functions).
"""
DEFINITE = 1e-11
"""Smallest eigenvalue of the sum of the parts, relative to the largest, for which modes keep five
digits.
"""


@dataclass(frozen=True)
class KnownForces(BlockElimination):
    """The elimination of a reduced problem, with the unknown under known forces.

    Files hold a BlockElimination.
    """

    def under(self, point: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """The unknown, (ell,), under given contact forces, without S.

        Args:
            point: parameters, (P,).
            forces: contact forces, (m,).

        Raises:
            SingularError: if K~ is singular.
        """
        weights, loads = self._weights_and_loads(point)
        unknown = np.empty(loads.size)
        for block, diagonal in zip(self.blocks, self._diagonal, strict=True):
            right = loads[block.modes] - block.test @ forces
            block_weights = weights[block.parts]
            solved = (
                dgetrs(*factored(block, block_weights), right)[0]
                if diagonal is None
                else diagonal.solved(block_weights, right)
            )
            unknown[block.modes] = solved
        return unknown

    def many_under(self, points: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """The unknowns, (n, ell), at many points.

        Args:
            points: parameters, (n, P).
            forces: contact forces at each point, (n, m).
        """
        if None in self._diagonal:
            return np.array([self.under(*query) for query in zip(points, forces, strict=True)])
        theta = dense(self.amplitudes.of_many(points))
        weights = many_weights(self._terms.moduli, points)
        loads = theta @ self._forces.T
        if self._lifts is not None:
            for weight, lift in zip(weights.T, self._lifts, strict=True):
                loads -= weight[:, None] * (theta @ lift.T)
        unknowns = np.empty(loads.shape)
        for block, diagonal in zip(self.blocks, self._diagonal, strict=True):
            assert diagonal is not None
            right = loads[:, block.modes] - forces @ block.test.T
            unknowns[:, block.modes] = diagonal.solved(weights[:, block.parts], right)
        return unknowns

    @cached_property
    def _diagonal(self) -> list[DiagonalBlock | None]:
        return [DiagonalBlock.of(block) for block in self.blocks]


@dataclass(frozen=True)
class DiagonalBlock:
    """Modes in which a block is diagonal at every parameter.

    The sum of two positive semi-definite parts, as changes of volume and of shape, is diagonal in
    the same modes W for all weights: with W^T (K_1 / |K_1| + K_2 / |K_2|) W = I and W^T K_q W =
    diag(d_q), K~^-1 = W diag(1 / sum_q w_q d_q) W^T.
    """

    modes: np.ndarray  #: W, (k, k)
    entries: np.ndarray  #: d_q, (q, k)

    @classmethod
    def of(cls, block: ModeBlock) -> DiagonalBlock | None:
        """Diagonal form of a block.

        None if it has more than two parts, or is not symmetric and definite.
        """
        size = block.modes.size
        matrices = block.entries.reshape(-1, size, size)
        largest = np.abs(matrices).max(axis=(1, 2), initial=0.0)
        skew = np.abs(matrices - matrices.transpose(0, 2, 1)).max(axis=(1, 2), initial=0.0)
        if not 0 < len(matrices) < 3 or (skew > SYMMETRIC_PARTS * largest).any():
            return None
        total = np.tensordot(1 / largest, matrices, 1)
        try:
            sizes = eigh(total, eigvals_only=True)
            if not sizes[0] > DEFINITE * sizes[-1]:
                return None
            _, modes = eigh(matrices[0], total)
        except LinAlgError:
            return None
        return cls(
            modes, np.array([np.sum(modes * (matrix @ modes), axis=0) for matrix in matrices])
        )

    def solved(self, weights: np.ndarray, right: np.ndarray) -> np.ndarray:
        """K~^-1 times right-hand sides, in the shape of these.

        Args:
            weights: weights of the parts, (q,) or (n, q).
            right: right-hand sides, (k,) or (n, k).
        """
        return ((right @ self.modes) / (weights @ self.entries)) @ self.modes.T


def many_weights(moduli: Sequence[Modulus], points: np.ndarray) -> np.ndarray:
    """Weights of the parts of a stiffness, (n, Q).

    Args:
        moduli: modulus of each part, Q of them.
        points: parameters, (n, P).
    """
    return np.stack([modulus.values(points) for modulus in moduli], axis=1)
