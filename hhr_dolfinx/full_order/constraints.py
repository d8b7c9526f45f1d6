"""Linear constraints on the displacement: dofs that follow others, as in ties, couplings and equations of decks.

Each equation, sum of c_k u_k = g, determines one dof. With U = T V the displacement of all dofs follows from that of
the others, and the contact problem (1.21) is one of V: T^T K T, B T and T^T F. The lift has the values g.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, diags, vstack
from scipy.sparse.linalg import SuperLU, splu

from hhr_dolfinx.amplitudes import Amplitude, bound
from hhr_dolfinx.contact.followers import Followers
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.loads import Assembler, Term
from hhr_dolfinx.scene import Scene

SINGULAR = 1e-10
"""Pivot of the equations over their largest coefficient below which they are dependent."""
ROUND_OFF = 1e-14
"""Part of the largest coefficient of a follower up to which a coefficient is round-off."""


@dataclass(frozen=True)
class Equations:
    """Equations of a constraint.

    Attributes:
        rows: coefficients, (k, N).
        dependent: dof that each equation determines, (k,).
        values: right-hand sides for the amplitude 1, (k,).
    """

    rows: csr_matrix
    dependent: np.ndarray
    values: np.ndarray


class Constraint(Protocol):
    """Interface of a constraint, an item of ``Scene.constraints``."""

    amplitude: Any  # of the right-hand sides, as of a displacement

    def equations(self, assembler: Assembler) -> Equations:
        """Its equations on a mesh."""


def followers_of(
    scene: Scene, assembler: Callable[[object], Assembler], cell_nodes: np.ndarray, free: np.ndarray
) -> tuple[Followers, list[Term]]:
    """Followers of the constraints of a scene, and lifts of their right-hand sides; ``free`` dofs are not imposed.

    Raises:
        SceneError: for equations that determine the same dof twice, or depend on each other.
    """
    found = [_without_imposed(item.equations(assembler(item)), free) for item in scene.constraints]
    rows = csr_matrix(vstack([part.rows for part in found]))
    dependent = np.concatenate([part.dependent for part in found])
    _check_once(scene, found, dependent)
    scale = np.asarray(abs(rows).max(axis=1).toarray()).ravel()
    rows = csc_matrix(diags(1 / np.where(scale > 0, scale, 1.0)) @ rows)
    factors = _factored(scene, csc_matrix(rows[:, dependent]))
    own = np.zeros(free.size, dtype=bool)
    own[dependent] = True
    others = csc_matrix(rows @ diags((~own).astype(float)))
    used = np.flatnonzero(np.diff(others.indptr))
    solved = -factors.solve(others[:, used].toarray())
    solved[np.abs(solved) <= ROUND_OFF * np.abs(solved).max(initial=0.0)] = 0.0
    entries = csr_matrix(solved).tocoo()
    others = csr_matrix((entries.data, (dependent[entries.row], used[entries.col])), shape=(free.size,) * 2)
    whole = csr_matrix(others + diags((~own).astype(float)))
    dim = free.size // len(np.unique(cell_nodes))
    terms = []
    first = 0
    for item, part in zip(scene.constraints, found, strict=True):
        amplitude = bound(item.amplitude, scene.parameters)
        given = np.zeros(dependent.size)
        place = slice(first, first + part.dependent.size)
        given[place] = part.values / scale[place]
        if amplitude != Amplitude():
            column = factors.solve(given), (dependent, np.zeros_like(dependent))
            terms.append(Term(amplitude, csc_matrix(column, shape=(free.size, 1))))
        first = place.stop
    return Followers(own, whole, _groups(cell_nodes, others, own, dim)), terms


def _without_imposed(part: Equations, free: np.ndarray) -> Equations:
    """Equations of free dofs: those of imposed ones alone are left out, others determine a free dof."""
    rows = csr_matrix(part.rows)
    dependent = part.dependent.copy()
    kept = np.ones(dependent.size, dtype=bool)
    for row in np.flatnonzero(~free[dependent]):
        span = slice(rows.indptr[row], rows.indptr[row + 1])
        columns = rows.indices[span]
        sizes = np.abs(rows.data[span])
        sizes[~free[columns] | (sizes <= ROUND_OFF * sizes.max())] = 0.0
        sizes[np.isin(columns, dependent)] = 0.0
        kept[row] = sizes.max() > 0
        dependent[row] = columns[sizes.argmax()] if kept[row] else -1
    return Equations(rows[kept], dependent[kept], part.values[kept])


def _check_once(scene: Scene, found: list[Equations], dependent: np.ndarray) -> None:
    """Raise SceneError if two equations determine one dof."""
    values, counts = np.unique(dependent, return_counts=True)
    if (counts > 1).any():
        twice = values[counts > 1][0]
        which = [repr(item) for item, part in zip(scene.constraints, found, strict=True) if twice in part.dependent]
        raise SceneError(
            f"dof {twice} of scene '{scene.name}' follows by several equations, of {' and '.join(which)}: leave one of "
            "them out, or let it determine another dof by writing that first"
        )


def _factored(scene: Scene, matrix: csc_matrix) -> SuperLU:
    """Factors of the equations between followers; SceneError if they depend on each other."""
    try:
        factors = splu(matrix)
        if np.abs(factors.U.diagonal()).min(initial=1.0) > SINGULAR:
            return factors
    except RuntimeError:  # singular in structure
        pass
    raise SceneError(f"constraints of scene '{scene.name}' depend on each other: leave out those that others imply")


def _groups(cell_nodes: np.ndarray, follows: csr_matrix, own: np.ndarray, dim: int) -> csr_matrix:
    """Nodes of each cell with followers, and the nodes that these follow, (groups, nodes)."""
    count = own.size // dim
    following = np.zeros(count, dtype=bool)
    following[np.flatnonzero(own) // dim] = True
    touched = cell_nodes[following[cell_nodes].any(axis=1)]
    starts = np.arange(0, touched.size + 1, cell_nodes.shape[1])
    inside = csr_matrix((np.ones(touched.size), touched.ravel(), starts), shape=(len(touched), count))
    entries = follows.tocoo()
    nodes = csr_matrix((np.ones(entries.nnz), (entries.row // dim, entries.col // dim)), shape=(count, count))
    return csr_matrix(inside + inside @ nodes)
