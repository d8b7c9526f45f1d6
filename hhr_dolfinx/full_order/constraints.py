"""Linear constraints on the displacement: dofs that follow others, as in ties, couplings and equations of decks.

Each equation, sum of c_k u_k = g, determines one dof. With U = T V the displacement of all dofs follows from that of
the others, and the contact problem (1.21) is one of V: T^T K T, B T and T^T F. The lift has the values g.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, diags, vstack
from scipy.sparse.linalg import splu

from hhr_dolfinx.amplitudes import Amplitude, bound
from hhr_dolfinx.contact.followers import Followers
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.loads import Assembler, Term

if TYPE_CHECKING:
    from hhr_dolfinx.full_order.discretisation import Discretisation

SINGULAR = 1e-10
"""Pivot of the equations over their largest coefficient below which they are dependent."""


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


def followers_of(mesh: Discretisation, free: np.ndarray) -> tuple[Followers, list[Term]]:
    """Followers of the constraints of a scene, and lifts of their right-hand sides; ``free`` dofs are not imposed.

    Raises:
        SceneError: for equations that determine the same dof twice, or depend on each other.
    """
    scene = mesh.scene
    found = [(item, _without_imposed(item.equations(mesh.assembler(item)), free)) for item in scene.constraints]
    rows = csc_matrix(vstack([part.rows for _, part in found]))
    dependent = np.concatenate([part.dependent for _, part in found])
    dim = mesh.mesh.geometry.dim
    owner = [repr(item) for item, part in found for _ in part.dependent]
    values, counts = np.unique(dependent, return_counts=True)
    twice = np.flatnonzero(np.isin(dependent, values[counts > 1]))
    if twice.size:
        node, component = divmod(int(dependent[twice[0]]), dim)
        raise SceneError(
            f"{owner[twice[0]]} of scene '{scene.name}' determines component {component} at "
            f"{mesh._points()[node].tolist()}, which follows by another equation too: leave one of them out there, or "
            "let the equation determine another one"
        )
    inner = csc_matrix(rows[:, dependent])
    scale = np.abs(rows).max(axis=1).toarray().ravel()
    try:
        factors = splu(csc_matrix(diags(1 / np.where(scale > 0, scale, 1.0)) @ inner))
        regular = bool(np.abs(factors.U.diagonal()).min(initial=1.0) > SINGULAR)
    except RuntimeError:  # singular in structure
        regular = False
    if not regular:
        raise SceneError(f"constraints of scene '{scene.name}' depend on each other: leave out those that others imply")
    own = np.zeros(mesh.size, dtype=bool)
    own[dependent] = True
    others = csc_matrix(diags(1 / scale) @ rows @ diags((~own).astype(float)))
    used = np.flatnonzero(np.diff(others.indptr))
    solved = -factors.solve(others[:, used].toarray())
    solved[np.abs(solved) < 1e-14 * np.abs(solved).max(initial=0.0)] = 0.0
    entries = csr_matrix(solved).tocoo()
    spread = csr_matrix((entries.data, (dependent[entries.row], used[entries.col])), shape=(mesh.size,) * 2)
    whole = csr_matrix(spread + diags((~own).astype(float)))
    return Followers(whole, own, _groups(mesh, spread, own)), list(_lifts(scene, found, factors, scale, dependent))


def _without_imposed(part: Equations, free: np.ndarray) -> Equations:
    """Equations of free dofs: those of imposed ones alone are left out, others determine a free dof."""
    rows = csr_matrix(part.rows)
    dependent = part.dependent.copy()
    kept = np.ones(dependent.size, dtype=bool)
    for row in np.flatnonzero(~free[dependent]):
        columns = rows.indices[rows.indptr[row] : rows.indptr[row + 1]]
        sizes = np.abs(rows.data[rows.indptr[row] : rows.indptr[row + 1]]) * free[columns]
        sizes[np.isin(columns, dependent)] = 0.0
        kept[row] = sizes.max() > 0
        dependent[row] = columns[sizes.argmax()] if kept[row] else -1
    return Equations(rows[kept], dependent[kept], part.values[kept])


def _lifts(
    scene: Any, found: Sequence[tuple[Constraint, Equations]], factors: Any, scale: np.ndarray, dependent: np.ndarray
) -> Iterator[Term]:
    """Terms of right-hand sides on the followers."""
    first = 0
    for item, part in found:
        count = len(part.dependent)
        amplitude = bound(item.amplitude, scene.parameters)
        if amplitude != Amplitude():
            given = np.zeros(len(dependent))
            given[first : first + count] = part.values / scale[first : first + count]
            column = factors.solve(given)
            shape = part.rows.shape[1], 1
            yield Term(amplitude, csc_matrix((column, (dependent, np.zeros_like(dependent))), shape=shape))
        first += count


def _groups(mesh: Discretisation, spread: csr_matrix, own: np.ndarray) -> csr_matrix:
    """Nodes of each cell with followers, and the nodes that these follow, (groups, nodes)."""
    dim = mesh.mesh.geometry.dim
    count = own.size // dim
    cells = mesh._cell_nodes()
    touched = cells[own.reshape(-1, dim).any(axis=1)[cells].any(axis=1)]
    starts = np.arange(0, touched.size + 1, cells.shape[1])
    inside = csr_matrix((np.ones(touched.size), touched.ravel(), starts), shape=(len(touched), count))
    entries = spread.tocoo()
    follows = csr_matrix((np.ones(entries.nnz), (entries.row // dim, entries.col // dim)), shape=(count, count))
    return csr_matrix(inside + inside @ follows)
