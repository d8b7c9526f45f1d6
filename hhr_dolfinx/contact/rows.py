"""Contact conditions as pairings make them: rows of B with their gaps and places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, issparse, vstack

from hhr_dolfinx.errors import SceneError


@dataclass(frozen=True)
class ContactRows:
    """Contact conditions ``B U <= D`` of thesis (1.27), without imposed displacements."""

    #: B, (N_lambda, N), nodal and unweighted, so that kappa(B) = 1 node to node. A row is n·u at
    #: the slave, less n·u where it touches; n points out of the slave's body, and the force on it
    #: is -n λ
    matrix: csr_matrix
    gap: np.ndarray  #: initial gap, (N_lambda,), in the unit of length
    #: node that carries each condition and its multiplier, (N_lambda,); DEIM and enrichment pick it
    slaves: np.ndarray
    points: np.ndarray  #: position of each condition, (N_lambda, dim), for pictures and messages
    areas: (
        np.ndarray
    )  #: tributary area of each condition, (N_lambda,), which turns forces into pressures

    def __post_init__(self):
        m = np.size(self.gap)
        sizes = {name: len(getattr(self, name)) for name in ("slaves", "points", "areas")}
        if not issparse(self.matrix) or self.matrix.shape[0] != m or set(sizes.values()) != {m}:
            raise SceneError(
                f"contact rows need a sparse matrix with a row for each of {m} gaps, and as many "
                f"{sizes}"
            )
        if not all(
            np.isfinite(values).all() for values in (self.matrix.data, self.gap, self.areas)
        ):
            raise SceneError("contact rows are not finite: check normals and gaps of the pairing")

    def take(self, index: np.ndarray) -> ContactRows:
        """Some of the rows, in the order of ``index``."""
        return ContactRows(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


def normals_of(matrix: csr_matrix, slaves: np.ndarray, dimension: int) -> np.ndarray:
    """Unit normal of each row of B, at its slave, (m, dim); zero without entries there.

    Args:
        matrix: B, (m, N).
        slaves: slave node of each row, (m,).
        dimension: components of the displacement.
    """
    entries = matrix.tocoo()
    node, component = np.divmod(entries.col, dimension)
    at_slave = node == slaves[entries.row]
    normals = np.zeros((matrix.shape[0], dimension))
    normals[entries.row[at_slave], component[at_slave]] = entries.data[at_slave]
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(lengths > 0, lengths, 1.0)


def joined(parts: Sequence[ContactRows]) -> ContactRows:
    """Rows of several pairs, one pair after another."""
    matrix, *further = (
        [getattr(rows, name) for rows in parts] for name in ContactRows.__dataclass_fields__
    )
    return ContactRows(csr_matrix(vstack(matrix)), *(np.concatenate(values) for values in further))
