"""Falsified stiffness of our own block: what a foreign K may be beside what it should be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix, triu

import hhr_dolfinx as hhr

Block = hhr.ForeignBlock


def matrix_of(block, matrix=None, nodes=None, directions=None, **others):
    """The K of a block with other arrays."""
    given = block.stiffness
    parts = (
        given.matrix if matrix is None else csr_matrix(matrix),
        given.nodes if nodes is None else nodes,
        given.directions if directions is None else directions,
    )
    return hhr.ForeignMatrix(*parts, "falsified", **others)


def without(block, rows):
    """K without some rows and columns."""
    kept = np.setdiff1d(np.arange(len(block.stiffness.nodes)), rows)
    found = block.stiffness
    return matrix_of(block, found.matrix[kept][:, kept], found.nodes[kept], found.directions[kept])


def transposed_order(block):
    """All x, then all y, then all z, as the table says node by node."""
    count = len(block.stiffness.nodes)
    order = np.arange(count).reshape(-1, 3).T.ravel()
    return matrix_of(block, block.stiffness.matrix[order][:, order])


def swapped_axes(block):
    """Directions x, y and z named z, y and x."""
    directions = np.array([0, 3, 2, 1])[block.stiffness.directions]
    return matrix_of(block, directions=directions)


def other_labels(block):
    """Labels of the nodes in reverse."""
    return matrix_of(block, nodes=block.stiffness.nodes[::-1].copy())


def turned_node(block):
    """Dofs of the loaded node in another system of axes, as *TRANSFORM does."""
    label = next(iter(block.case.forces))
    rows = np.flatnonzero(block.stiffness.nodes == label)
    turn = np.eye(len(block.stiffness.nodes))
    turn[np.ix_(rows, rows)] = [[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]]
    return matrix_of(block, turn @ block.stiffness.matrix.toarray() @ turn.T)


def hidden_support(block):
    """The free node next to the loaded one is held, and left out of K; of equal ones the first."""
    loaded = int(np.flatnonzero(block.nodes.labels == next(iter(block.case.forces)))[0])
    away = np.linalg.norm(block.nodes.points - block.nodes.points[loaded], axis=1)
    held = np.isin(block.nodes.labels, [label for label, _ in block.case.held])
    away[held] = np.inf
    away[loaded] = np.inf
    label = block.nodes.labels[np.flatnonzero(away <= (1 + 1e-9) * away.min())[0]]
    return without(block, np.flatnonzero(block.stiffness.nodes == label))


def damaged_entry(block):
    """A diagonal entry at the loaded node, larger by a twentieth."""
    matrix = block.stiffness.matrix.copy().tolil()
    row = int(np.flatnonzero(block.stiffness.nodes == next(iter(block.case.forces)))[0])
    matrix[row, row] *= 1.05
    return matrix_of(block, matrix)


BY_CASE = {
    "order of rows": transposed_order,
    "axes": swapped_axes,
    "labels": other_labels,
    "local system": turned_node,
    "hidden support": hidden_support,
    "damaged entry": damaged_entry,
    "K in kPa": lambda block: matrix_of(block, 1000 * block.stiffness.matrix),
    "K in N/m": lambda block: matrix_of(block, block.stiffness.matrix / 1000),
    "another modulus": lambda block: matrix_of(block, block.stiffness.matrix / 3),
}
"""Falsified inputs that only a solved case shows."""


def retained(own):
    """Rows of the nodes of the surfaces."""
    used = np.unique(np.concatenate([faces.members for faces in own.nodes.surfaces.values()]))
    return np.flatnonzero(np.isin(own.stiffness.nodes, own.nodes.labels[used]))


def edited(block: Block, row: int, column: int, value: float) -> hhr.ForeignMatrix:
    """K with another entry."""
    matrix = block.stiffness.matrix.copy().tolil()
    matrix[row, column] = value
    return matrix_of(block, matrix)


def renamed(block: Block, row: int, direction: int) -> hhr.ForeignMatrix:
    """K with another direction of a row."""
    directions = block.stiffness.directions.copy()
    directions[row] = direction
    return matrix_of(block, directions=directions)


def of_other_load(block: Block) -> Block:
    """The case of twice the forces."""
    forces = {node: tuple(2 * one for one in value) for node, value in block.case.forces.items()}
    return replace(block, case=replace(block.case, forces=forces))


def uncondensed(block: Block) -> hhr.ForeignMatrix:
    """The block of K of the nodes of surfaces, as a superelement."""
    rows = retained(block)
    found = block.stiffness
    parts = found.matrix[rows][:, rows], found.nodes[rows], found.directions[rows]
    return hhr.ForeignMatrix(*parts, "falsified", superelement=True)


def single(block: Block) -> hhr.ForeignMatrix:
    """K in single precision."""
    return matrix_of(block, block.stiffness.matrix.astype(np.float32).astype(float))


OF_FILES: dict[str, Callable[[Block], hhr.ForeignMatrix]] = {
    "reversed sign": lambda block: matrix_of(block, -block.stiffness.matrix),
    "half stored as whole": lambda block: matrix_of(block, triu(block.stiffness.matrix)),
    "unsymmetric": lambda block: edited(block, 0, 1, 0.01 * block.stiffness.matrix[0, 0]),
    "not finite": lambda block: edited(block, 3, 3, np.nan),
    "Lagrange multiplier": lambda block: edited(block, 5, 5, 0.0),
    "dof named twice": lambda block: renamed(block, 1, 1),
    "direction 11": lambda block: renamed(block, 4, 11),
    "missing row": lambda block: matrix_of(block, nodes=block.stiffness.nodes[:-1]),
    "single precision": single,
    "superelement that is not condensed": uncondensed,
}
"""Falsified inputs that the file itself shows."""
LIES: dict[str, Callable[[Block], Block]] = {
    **{
        name: lambda block, made=made: replace(block, stiffness=made(block))
        for name, made in {**BY_CASE, **OF_FILES}.items()
    },
    "case of another load": of_other_load,
    "dropped support": lambda block: replace(block, case=replace(block.case, held=frozenset())),
    "nodes of another mesh": lambda block: replace(
        block, nodes=hhr.ForeignNodes(block.nodes.labels + 10_000, block.nodes.points)
    ),
}
"""All of them."""
