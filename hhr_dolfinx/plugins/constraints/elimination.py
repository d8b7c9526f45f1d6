"""Linear constraints on the displacement: dofs that follow others, as in ties, couplings and
equations of decks.

Each equation, sum of c_k u_k = g, determines one dof. With U = T V the displacement of all dofs
follows from that of the others, and the contact problem (1.21) is one of V: T^T K T, B T and T^T F.
The lift has the values g.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Protocol

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, diags, hstack, vstack
from scipy.sparse.linalg import SuperLU, splu

from hhr_dolfinx.amplitudes import Amplitude, bound
from hhr_dolfinx.contact.prolongation import Prolongation
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.formulas import Formula, box_samples, formula_of
from hhr_dolfinx.full_order.eliminated import DependentDofs
from hhr_dolfinx.loads import Assembler, Term, Terms
from hhr_dolfinx.parameters import is_number
from hhr_dolfinx.plugins.constraints.loose_equations import chosen, first_largest
from hhr_dolfinx.plugins.constraints.repeated import without_repeated
from hhr_dolfinx.plugins.constraints.tied_nodes import without_tied
from hhr_dolfinx.scene import Scene

DEPENDENT_PIVOT = 1e-10
"""Pivot of the equations over their largest coefficient below which they are dependent."""
COEFFICIENT_ROUND_OFF = 1e-14
"""Part of the largest coefficient of a follower up to which a coefficient is round-off."""
BROKEN = 1e-9
"""Part of its imposed displacements by which an equation of imposed dofs alone may be off: values
are formulas.
"""
EQUATION_SAMPLES = 16
"""Random points of the box, in addition to its corners, at which such equations are checked."""
COLUMNS_AT_ONCE = 256
"""Columns of the equations that are solved for, and stored dense, at once."""


@dataclass(frozen=True)
class ConstraintEquations:
    """Equations of a constraint.

    Attributes:
        rows: coefficients, (k, N).
        dependent: dof that each equation determines, (k,).
        values: right-hand sides for the amplitude 1, (k,).
        loose: True if each equation may determine another one of its dofs, and those that other
            equations imply are left out; else an equation is refused for this.
        middle: True if contact conditions at the dependent nodes are parts of those at the nodes
            that these follow.
    """

    rows: csr_matrix
    dependent: np.ndarray
    values: np.ndarray
    loose: bool = False
    middle: bool = False

    def take(self, kept: np.ndarray) -> ConstraintEquations:
        """Some of the equations, by a mask, (k,)."""
        return replace(
            self, rows=self.rows[kept], dependent=self.dependent[kept], values=self.values[kept]
        )


class Constraint(Protocol):
    """Interface of a constraint, an item of ``Scene.constraints``."""

    @property
    def amplitude(self) -> Amplitude | Formula | str | float:
        """Amplitude of the right-hand sides, as of a displacement."""

    def equations(self, assembler: Assembler) -> ConstraintEquations:
        """Its equations on a mesh."""


def eliminated(
    scene: Scene,
    assembler: Callable[[object], Assembler],
    cell_nodes: np.ndarray,
    free: np.ndarray,
    imposed: Sequence[Term],
) -> DependentDofs:
    """Dependent dofs of the constraints of a scene, and lifts of their right-hand sides.

    Args:
        scene: the scene.
        assembler: returns the interface of the mesh for a constraint.
        cell_nodes: nodes of each cell, (cells, n).
        free: True for dofs that are not imposed, (N,) bool.
        imposed: lifts of imposed dofs.

    Raises:
        SceneError: for equations that determine the same dof twice, depend on each other, or are
            broken by displacements that are imposed.
    """
    constraints = []
    middle = None
    for constraint in scene.constraints:
        equations = _checked(
            constraint, constraint.equations(assembler(constraint)), scene, free.size
        )
        middle = _shares(equations, free.size) if equations.middle else middle
        remaining, left_out = _without_imposed(equations, free)
        amplitude = bound(_amplitude_of(constraint), scene.parameters)
        alone = equations.take(left_out)
        size = np.abs(equations.values).max(initial=0.0)
        _check_kept(
            scene,
            repr(constraint),
            alone.rows,
            [Term(amplitude, csc_matrix(-alone.values[:, None]))],
            size,
            imposed,
        )
        constraints.append((amplitude, remaining))
    constraints = _decided(scene, constraints, free, imposed)
    rows = csr_matrix(vstack([remaining.rows for _, remaining in constraints]))
    dependent = np.concatenate([remaining.dependent for _, remaining in constraints])
    _check_once(scene, [remaining for _, remaining in constraints], dependent)
    factors = _factored(scene, csc_matrix(rows[:, dependent]))
    is_dependent = np.zeros(free.size, dtype=bool)
    is_dependent[dependent] = True
    follows = _solved(factors, csc_matrix(rows @ diags((~is_dependent).astype(float))), dependent)
    terms = []
    ends = np.cumsum([0, *(remaining.dependent.size for _, remaining in constraints)])
    for (amplitude, remaining), first in zip(constraints, ends, strict=False):
        if amplitude != Amplitude():
            given_there = np.zeros(dependent.size)
            given_there[first : first + remaining.values.size] = remaining.values
            column = factors.solve(given_there), (dependent, np.zeros_like(dependent))
            terms.append(Term(amplitude, csc_matrix(column, shape=(free.size, 1))))
    coupling = csr_matrix(follows + diags((~is_dependent).astype(float)))
    no_lifts = csc_matrix((free.size, 0))
    prolongation = Prolongation(
        free & ~is_dependent, free, no_lifts, coupling, _groups(cell_nodes, follows, is_dependent)
    )
    joined = partial(without_tied, scene, cell_nodes)
    return DependentDofs(prolongation, terms, joined, partial(without_repeated, middle))


def _checked(
    item: Constraint, given: ConstraintEquations, scene: Scene, size: int
) -> ConstraintEquations:
    """Equations of a constraint, which a user may have written, over so many dofs.

    Raises:
        SceneError: for arrays that do not go together, dofs that are none, and numbers that are not
            finite.
    """
    fault = "are no Equations"
    if isinstance(given, ConstraintEquations):
        count, columns = np.shape(given.rows)
        shape = np.shape(given.values)
        dependent = np.asarray(given.dependent)
        faults = {
            f"have rows of {columns} columns, and there are {size} dofs": columns != size,
            f"are {count}, and have the dependent dofs {dependent!r}": dependent.shape != (count,),
            "determine dofs that are no numbers from 0": dependent.dtype.kind not in "iu"
            or not ((dependent >= 0) & (dependent < size)).all(),
            f"are {count}, and have right-hand sides of the shape {shape}": shape != (count,),
            "have coefficients or right-hand sides that are no finite numbers": not all(
                np.isrealobj(values) and np.isfinite(values).all()
                for values in (csr_matrix(given.rows).data, given.values)
            ),
        }
        fault = next((words for words, is_fault in faults.items() if is_fault), "")
    if fault:
        raise SceneError(f"equations of {item!r} of scene '{scene.name}' {fault}: see Equations")
    return (
        given if isinstance(given.rows, csr_matrix) else replace(given, rows=csr_matrix(given.rows))
    )


def _amplitude_of(item: Constraint) -> Amplitude | Formula:
    """Its amplitude, also of a user's constraint that has a number or a text, as displacements
    take.
    """
    amplitude = item.amplitude
    return (
        formula_of(amplitude, f"the amplitude of {item!r}")
        if isinstance(amplitude, str) or is_number(amplitude)
        else amplitude  # type: ignore[return-value]
    )


def _shares(given: ConstraintEquations, size: int) -> csr_matrix:
    """Positive shares of dofs in the middle of faces in others, (N, N), also of dofs that are
    imposed or lead now.
    """
    entries = given.rows.tocoo()
    negative = entries.data < 0
    positions = given.dependent[entries.row[negative]], entries.col[negative]
    return csr_matrix((-entries.data[negative], positions), shape=(size, size))


def _solved(factors: SuperLU, others: csc_matrix, dependent: np.ndarray) -> csr_matrix:
    """Coefficients by which followers follow the ``others``, columns of the equations, (k, N): (N,
    N).
    """
    used = np.flatnonzero(np.diff(others.indptr))
    blocks = [csc_matrix((dependent.size, 0))]
    for first in range(0, used.size, COLUMNS_AT_ONCE):
        solved = -factors.solve(others[:, used[first : first + COLUMNS_AT_ONCE]].toarray())
        solved[np.abs(solved) <= COEFFICIENT_ROUND_OFF * np.abs(solved).max(initial=0.0)] = 0.0
        blocks.append(csc_matrix(solved))
    entries = csc_matrix(hstack(blocks)).tocoo()
    size = others.shape[1]
    return csr_matrix(
        (entries.data, (dependent[entries.row], used[entries.col])), shape=(size, size)
    )


def _decided(
    scene: Scene,
    found: list[tuple[Amplitude, ConstraintEquations]],
    free: np.ndarray,
    imposed: Sequence[Term],
) -> list[tuple[Amplitude, ConstraintEquations]]:
    """Constraints in which loose equations determine different dofs, without equations that others
    imply.
    """
    if not any(equations.loose for _, equations in found):
        return found
    rows = csr_matrix(vstack([equations.rows for _, equations in found]))
    loose = np.concatenate(
        [np.full(equations.dependent.size, equations.loose) for _, equations in found]
    )
    dependent, implied = chosen(
        rows, np.concatenate([equations.dependent for _, equations in found]), loose, free
    )
    ends = np.cumsum([0, *(equations.dependent.size for _, equations in found)])
    spans = [slice(first, last) for first, last in pairwise(ends)]
    sides = [
        Term(amplitude, csc_matrix(-implied[:, span] @ equations.values[:, None]))
        for span, (amplitude, equations) in zip(spans, found, strict=True)
    ]
    size = max((np.abs(equations.values).max(initial=0.0) for _, equations in found), default=0.0)
    names = " and ".join(
        repr(constraint)
        for constraint, (_, equations) in zip(scene.constraints, found, strict=True)
        if equations.loose
    )
    _check_kept(scene, names, implied @ rows, sides, size, imposed)
    return [
        (amplitude, replace(equations, dependent=dependent[span]).take(dependent[span] >= 0))
        for span, (amplitude, equations) in zip(spans, found, strict=True)
    ]


def _check_kept(
    scene: Scene,
    what: str,
    rows: csr_matrix,
    values: Sequence[Term],
    size: float,
    imposed: Sequence[Term],
) -> None:
    """Raise SceneError if equations of imposed dofs alone, with negative right-hand sides, are
    broken by their values.

    ``size`` is that of all right-hand sides of their constraints: a normal has components of
    round-off, and products of rows cancel.
    """
    imposed_sides = [Term(term.amplitude, csc_matrix(rows @ term.columns)) for term in imposed]
    terms = Terms(scene.parameters, sides=[*values, *imposed_sides])
    amplitudes = terms.amplitudes()
    sides = terms.columns("sides", rows.shape[0])
    sizes = [abs(rows) @ abs(term.columns) for term in imposed]
    size = max(size, *(products.max() for products in sizes if products.nnz), 0.0)
    for point in box_samples(scene.parameters, EQUATION_SAMPLES) if rows.shape[0] else ():
        theta = amplitudes(point)
        if np.abs(sides @ theta).max() > BROKEN * size * np.abs(theta.values).max():
            raise SceneError(
                f"{what} of scene '{scene.name}' has equations of imposed displacements alone, "
                f"which break them, as at {scene.parameters.described(point)}: leave out the "
                "equations or the displacements there"
            )


def _without_imposed(
    part: ConstraintEquations, free: np.ndarray
) -> tuple[ConstraintEquations, np.ndarray]:
    """Equations that determine a free dof, with largest coefficients of 1, and a mask of the
    others.
    """
    scale = np.asarray(abs(part.rows).max(axis=1).toarray()).ravel()
    scale = 1 / np.where(scale > 0, scale, 1.0)
    rows = csr_matrix(diags(scale) @ part.rows)
    dependent = part.dependent.copy()
    determined = np.ones(dependent.size, dtype=bool)
    if part.loose:
        dependent[~free[dependent]] = -1
        determined = (
            np.asarray(abs(rows[:, free]).max(axis=1).toarray()).ravel() > COEFFICIENT_ROUND_OFF
        )
        return replace(part, rows=rows, dependent=dependent, values=scale * part.values).take(
            determined
        ), ~determined
    for row in np.flatnonzero(~free[dependent]):
        span = slice(rows.indptr[row], rows.indptr[row + 1])
        columns = rows.indices[span]
        sizes = np.abs(rows.data[span])
        sizes[~free[columns] | (sizes <= COEFFICIENT_ROUND_OFF * sizes.max())] = 0.0
        independent = np.where(np.isin(columns, dependent), 0.0, sizes)
        determined[row] = sizes.max() > 0
        # a dof that another equation determines too is refused
        dependent[row] = (
            columns[first_largest(independent if independent.any() else sizes)]
            if determined[row]
            else -1
        )
    return ConstraintEquations(rows, dependent, scale * part.values).take(determined), ~determined


def _check_once(scene: Scene, found: list[ConstraintEquations], dependent: np.ndarray) -> None:
    """Raise SceneError if two equations determine one dof."""
    values, counts = np.unique(dependent, return_counts=True)
    if (counts > 1).any():
        twice = values[counts > 1][0]
        names = [
            repr(constraint)
            for constraint, equations in zip(scene.constraints, found, strict=True)
            if twice in equations.dependent
        ]
        raise SceneError(
            f"dof {twice} of scene '{scene.name}' follows by several equations, of "
            f"{' and '.join(names)}: leave one of them out, or let it determine another dof by "
            "writing that first"
        )


def _factored(scene: Scene, matrix: csc_matrix) -> SuperLU:
    """Factors of the equations between followers; SceneError if they depend on each other."""
    try:
        factors = splu(matrix)
        if np.abs(factors.U.diagonal()).min(initial=1.0) > DEPENDENT_PIVOT:
            return factors
    except RuntimeError:  # singular in structure
        pass
    raise SceneError(
        f"constraints of scene '{scene.name}' depend on each other: leave out those that others "
        "imply; or a dof that one determines is not in it"
    )


def _groups(cell_nodes: np.ndarray, follows: csr_matrix, own: np.ndarray) -> csr_matrix:
    """Nodes of each cell with followers, and the nodes that these follow, (groups, nodes)."""
    count = int(cell_nodes.max()) + 1
    dim = own.size // count
    following = np.zeros(count, dtype=bool)
    following[np.flatnonzero(own) // dim] = True
    touched = cell_nodes[following[cell_nodes].any(axis=1)]
    starts = np.arange(0, touched.size + 1, cell_nodes.shape[1])
    in_cells = csr_matrix(
        (np.ones(touched.size), touched.ravel(), starts), shape=(len(touched), count)
    )
    entries = follows.tocoo()
    nodes = csr_matrix(
        (np.ones(entries.nnz), (entries.row // dim, entries.col // dim)), shape=(count, count)
    )
    return csr_matrix(in_cells + in_cells @ nodes)
