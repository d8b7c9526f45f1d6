"""A load case that the other code has solved, compared with the answer by its K: what no file
format can say.

A wrong sign, another order of rows, another unit, a constraint that is not in the files, or a
superelement that was not condensed give other displacements.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from hhr_dolfinx.errors import FileContentError, FileError, NotSolvableError, SceneError
from hhr_dolfinx.geometries.abaqus_blocks import blocks
from hhr_dolfinx.geometries.abaqus_deck import flat_deck
from hhr_dolfinx.plugins.foreign.frd import read_frd
from hhr_dolfinx.plugins.foreign.nodes import ForeignNodes
from hhr_dolfinx.plugins.foreign.placed import Placed

SCALE = 0.2
"""Largest spread of ratios of displacements up to which a difference is one factor: a unit, or a
modulus.
"""

MEAN_STIFFNESS = 1e6
"""Stiffness of a held mean over the largest entry of K: what it leaves is a millionth."""

SINGULAR = 1e-3
"""Part of a known vector that a solution may lose."""

SAME_PLACE = 1e-5
"""Part of the size of a mesh up to which nodes are at one place: decks have six digits or more."""
AT_REST = 1e-6
"""Part of the largest displacement of a case up to which a node is at rest: results have six
digits.
"""
ONE_NODE = 3
"""Dofs of a node, which alone is no body."""

Vector = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class SolvedCase:
    """Forces on nodes, supports, and displacements of some nodes that the other code found.

    Attributes:
        forces: force on each loaded node by its label, (3,) each.
        displacements: displacement of some nodes by their labels, (3,) each; NaN for a component
            that is not known.
        held: dofs that are held at zero in the case, ``(label, direction)`` with directions from 1
            on. Those that the code has left out of K need not be there.
        tolerance: largest difference over the largest displacement. Files of results have five or
            six digits.
        points: coordinates of nodes in the case by their labels, (3,) each, which must lie to each
            other as those beside K do; none if they are not known.
    """

    forces: Mapping[int, Vector]
    displacements: Mapping[int, Vector]
    held: frozenset[tuple[int, int]] = field(default_factory=frozenset)
    tolerance: float = 1e-4
    points: Mapping[int, Vector] = field(default_factory=dict)

    def __post_init__(self) -> None:
        values = [
            value for vectors in (self.forces, self.displacements) for value in vectors.values()
        ]
        if (
            not self.forces
            or not self.displacements
            or any(np.shape(value) != (3,) for value in values)
        ):
            raise SceneError(
                "a solved case needs the force on a node at least, and the displacement of one, "
                "three numbers each"
            )
        object.__setattr__(self, "held", frozenset(self.held))


def read_case(path: str | Path, tolerance: float = 1e-4) -> SolvedCase:
    """A solved case of a file.

    Args:
        path: deck of CalculiX with its ``.frd`` beside it, whose ``*CLOAD`` are the forces and
            whose ``*BOUNDARY`` the supports; or a table with the title
            ``node,fx,fy,fz,ux,uy,uz,held`` (held: digits of directions, ``123``), in which blanks
            are unknown.
        tolerance: see :class:`SolvedCase`.

    Raises:
        FileError: without the file.
        FileContentError: for a damaged one, or a deck with other loads.
    """
    path = Path(path)
    if not path.is_file():
        raise FileError(f"there is no solved case {path}")
    return (
        _of_deck(path, tolerance) if path.suffix.lower() == ".inp" else _of_table(path, tolerance)
    )


def _of_table(path: Path, tolerance: float) -> SolvedCase:
    """Case of a table."""
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    if not lines:
        raise FileContentError(f"{path.name} is empty: node,fx,fy,fz,ux,uy,uz,held is needed")
    names = [word.strip().lower() for word in lines[0].split(",")]
    wanted = ["fx", "fy", "fz", "ux", "uy", "uz"]
    if "node" not in names or not {*names} <= {"node", "held", *wanted}:
        raise FileContentError(
            f"{path.name} begins with {lines[0]!r}: node,fx,fy,fz,ux,uy,uz,held is needed"
        )
    forces: dict[int, Vector] = {}
    displacements: dict[int, Vector] = {}
    held: set[tuple[int, int]] = set()
    for number, line in enumerate(lines[1:], start=2):
        words = dict(zip(names, [word.strip() for word in line.split(",")], strict=False))
        try:
            node = int(words["node"])
            values = [float(words[name]) if words.get(name) else np.nan for name in wanted]
        except ValueError:
            raise FileContentError(
                f"{path.name}:{number} '{line}' is no row of a solved case"
            ) from None
        if np.isfinite(values[:3]).any():
            x, y, z = np.nan_to_num(values[:3]).tolist()
            forces[node] = x, y, z
        if np.isfinite(values[3:]).any():
            displacements[node] = values[3], values[4], values[5]
        held |= {(node, int(digit)) for digit in words.get("held", "")}
    return SolvedCase(forces, displacements, frozenset(held), tolerance)


def _of_deck(path: Path, tolerance: float) -> SolvedCase:
    """Case of the last step of a deck with nodal forces, and displacements of its results."""
    beside = path.with_suffix(".frd")
    if not beside.is_file():
        raise FileContentError(
            f"{path.name} has no {beside.name} beside it: run it, with *NODE FILE and U"
        )
    deck = flat_deck(path)
    forces: dict[int, list[float]] = {}
    held: set[tuple[int, int]] = set()
    for line, keyword, options, rows in blocks(path):
        if keyword in ("DLOAD", "DSLOAD", "TEMPERATURE", "CONTACT PAIR", "NLGEOM") and rows:
            raise FileContentError(
                f"{path.name}:{line} *{keyword}: a solved case has forces on nodes alone "
                "(*CLOAD), as others would be "
                "compared with themselves: write one step with a *CLOAD and no contact"
            )
        if keyword == "STEP" and "NLGEOM" in options:
            raise FileContentError(
                f"{path.name}:{line} *STEP, NLGEOM: a K of small displacements is compared"
            )
        if keyword in ("CLOAD", "BOUNDARY"):
            for row in rows:
                for node in deck.members(row[0].upper()) or (
                    [int(row[0])] if row[0].isdigit() else []
                ):
                    _take(keyword, node, row, forces, held, f"{path.name}:{line}")
    results = read_frd(beside)
    return SolvedCase(
        {node: (value[0], value[1], value[2]) for node, value in forces.items()},
        results.displacements,
        frozenset(held),
        tolerance,
        {label: (place[0], place[1], place[2]) for label, place in deck.nodes.items()},
    )


def _take(
    keyword: str,
    node: int,
    row: list[str],
    forces: dict[int, list[float]],
    held: set[tuple[int, int]],
    where: str,
) -> None:
    """Add the force or the support of a row of a deck at a node."""
    words = [word for word in row if word]
    first = int(words[1])
    if keyword == "CLOAD":
        if first > 3:
            raise FileContentError(f"{where} *CLOAD: a moment; give forces alone")
        forces.setdefault(node, [0.0, 0.0, 0.0])[first - 1] += float(words[2])
        return
    last = int(words[2]) if len(words) > 2 and re.fullmatch(r"\d+", words[2]) else first
    if len(words) > 3 and float(words[3]):
        raise FileContentError(
            f"{where} *BOUNDARY: a value that is not zero; a solved case has forces alone"
        )
    held |= {(node, direction) for direction in range(first, last + 1)}


def compare_case(block: Placed, case: SolvedCase, name: str) -> float:
    """Largest difference of the displacements of a case from those by K, over the largest
    displacement.

    Args:
        block: K on its nodes.
        case: forces, supports, and displacements of the other code.
        name: name of the block, for messages.

    Returns:
        The difference, at most the tolerance of the case.

    Raises:
        SceneError: for a larger one, with the node; for nodes that the block lacks; for forces on
            dofs that K lacks.
        NotSolvableError: if K is singular with the supports of the case.
    """
    forces, free, means = supported(block, case, name)
    stiff = (
        MEAN_STIFFNESS * abs(block.matrix).max() * (means.T @ means)
        if means.shape[0]
        else 0.0 * block.matrix
    )
    solution = _solved(csr_matrix(block.matrix + stiff), free, forces, name)
    return compare_displacements(block, case, name, solution)


def supported(
    block: Placed, case: SolvedCase, name: str
) -> tuple[np.ndarray, np.ndarray, csr_matrix]:
    """Forces and supports of a case on the dofs of a block.

    Args:
        block: K on its nodes.
        case: forces and supports.
        name: name of the block, for messages.

    Returns:
        Forces on all dofs, (3 n,), dofs that are free, (3 n,) bool, and rows of sums of dofs that
        the case holds, (m, 3 n).

    Raises:
        SceneError: for forces on dofs that K lacks, or on held dofs alone.
    """
    forces = _nodal(block, case, name)
    free = block.known.copy()
    dofs, means = _held(block, case)
    free[dofs] = False
    if not np.any(forces[free]):
        raise SceneError(
            f"block '{name}': the forces of its solved case act on dofs that are held or left out "
            "of K"
        )
    return forces, free, means


def compare_displacements(
    block: Placed, case: SolvedCase, name: str, solution: np.ndarray
) -> float:
    """Largest difference of the displacements of a case from others, over the largest displacement.

    Args:
        block: K on its nodes.
        case: displacements of the other code.
        name: name of the block, for messages.
        solution: displacements by K of all dofs, (3 n,).

    Returns:
        The difference, at most the tolerance of the case.

    Raises:
        SceneError: for a larger one, with the node; for nodes that the block lacks.
    """
    index = _indices(block.nodes)
    _check_places(block, case, name, index)
    rows = []
    theirs = []
    labels = []
    for label, value in case.displacements.items():
        if (number := index.get(label)) is not None:
            rows.append(3 * number + np.arange(3))
            theirs.append(value)
            labels.append(label)
    if not rows:
        raise SceneError(
            f"block '{name}': no node of its solved case with a displacement is a node of K"
        )
    ours = solution[np.array(rows)]
    reference = np.array(theirs)
    compared = np.isfinite(reference) & block.known[np.array(rows)]
    loose = compared & ~np.isin(np.array(rows), _held(block, case)[0])
    if not loose.any():
        raise SceneError(
            f"block '{name}': no displacement of its solved case is at a dof of K that is free: "
            "give those of nodes that move"
        )
    _check_reach(block, name, np.array(rows)[loose], reference[loose])
    largest = np.abs(reference[compared]).max() or 1.0
    off = np.where(compared, np.abs(ours - reference), 0.0)
    node, direction = np.unravel_index(off.argmax(), off.shape)
    worst = float(off[node, direction] / largest)
    if not worst <= case.tolerance:
        raise SceneError(
            _said(
                name, worst, labels[node], int(direction), ours, reference, compared, case.tolerance
            )
        )
    return worst


def _check_places(block: Placed, case: SolvedCase, name: str, index: Mapping[int, int]) -> None:
    """Raise SceneError if nodes of a case lie elsewhere than those beside K, up to a shift."""
    original = block.nodes.original is not None  # solids that stand for shells and beams
    labels = [] if original else [label for label in case.points if label in index]
    if len(labels) < 2:
        return
    theirs = np.array([case.points[label] for label in labels])
    ours = block.nodes.points[[index[label] for label in labels]]
    apart = ours - theirs
    off = np.abs(apart - np.median(apart, axis=0)).max(axis=1)
    if off.max() > SAME_PLACE * np.ptp(theirs, axis=0).max():
        worst = int(off.argmax())
        raise SceneError(
            f"block '{name}': node {labels[worst]} lies {off[worst]:.3g} from its place in the "
            "solved case: the mesh beside K is another one"
        )


def _check_reach(block: Placed, name: str, dofs: np.ndarray, values: np.ndarray) -> None:
    """Raise SceneError for a body whose displacements in the case say nothing.

    Args:
        block: K on its nodes.
        name: name of the block.
        dofs: dofs of displacements that are compared, (k,).
        values: these displacements, (k,).
    """
    _, body = connected_components(block.matrix, directed=False)
    placed = np.flatnonzero(block.known[: 3 * len(block.nodes.labels)])
    moving = dofs[np.abs(values) > AT_REST * np.abs(values).max()]
    silent = np.setdiff1d(body[placed], body[moving])
    sizes = np.bincount(body[placed])
    if (silent := silent[sizes[silent] > ONE_NODE]).size:
        node = block.nodes.labels[placed[body[placed] == silent[0]][0] // 3]
        raise SceneError(
            f"block '{name}': its solved case says nothing of the body with node {node}, which is "
            "at rest there or has no displacement: load it in the case too, or make a block of it"
        )


def _said(
    name: str, worst: float, label: int, direction: int, ours: np.ndarray, theirs: np.ndarray,
    known: np.ndarray, tolerance: float,
) -> str:  # fmt: skip
    """Message of a difference: its size and place, and what it looks like."""
    large = known & (np.abs(theirs) > 0.1 * np.abs(theirs[known]).max())
    ratios = ours[large] / theirs[large]
    middle = float(np.median(ratios))
    hint = "an order of rows, a hidden constraint, or the K of another model"
    if np.ptp(ratios) <= SCALE * abs(middle) and not 0.9 < middle < 1.1:
        hint = f"all of them by a factor of {middle:.4g}: a unit, a modulus, or the sign"
    elif np.isfinite(middle) and abs(middle) < 0.9:
        hint = "smaller: a constraint too many, or a superelement that is not condensed"
    return (
        f"block '{name}': displacements of its solved case differ from those by its K by "
        f"{worst:.3g} of the largest, "
        f"most at node {label} in direction {direction + 1} (up to {tolerance:g} is accepted): "
        f"{hint}"
    )


def _indices(nodes: ForeignNodes) -> dict[int, int]:
    """Index of each node by its label."""
    return {int(label): k for k, label in enumerate(nodes.labels)}


def carriers_of(nodes: ForeignNodes, label: int) -> np.ndarray:
    """Nodes that carry the node of the deck with a label, (k,); empty if there is none.

    Args:
        nodes: nodes of a block.
        label: label of the node in the deck.
    """
    return np.flatnonzero((nodes.decks == label) & nodes.carriers)


def _nodal(block: Placed, case: SolvedCase, name: str) -> np.ndarray:
    """Forces of a case on all dofs, (3 n,)."""
    forces = np.zeros(block.matrix.shape[0])
    for label, value in case.forces.items():
        carriers = carriers_of(block.nodes, label)
        if not carriers.size:
            raise SceneError(
                f"block '{name}': its solved case has a force on node {label}, which K does not "
                "have"
            )
        dofs = (3 * carriers[:, None] + np.arange(3)).ravel()
        share = np.tile(value, carriers.size) / carriers.size
        lost = dofs[(share != 0.0) & ~block.known[dofs]]
        if lost.size:
            raise SceneError(
                f"block '{name}': its solved case has a force on node {label} in direction "
                f"{lost[0] % 3 + 1}, which "
                "K does not have: it is held or dependent in the run that wrote K, or not retained"
            )
        forces[dofs] += share
    return forces


def _held(block: Placed, case: SolvedCase) -> tuple[np.ndarray, csr_matrix]:
    """Dofs of K that a case holds, (k,), and rows of sums of dofs that it holds, (m, 3 n).

    A node of a deck that several nodes stand for is held as a whole if rotations across the
    direction are held too, as a shell that is clamped; else its mean is held, as at a hinge.
    """
    nodes = block.nodes
    dofs: list[int] = []
    rows: list[np.ndarray] = []
    for label, direction in sorted(case.held):
        members = np.flatnonzero(nodes.decks == label)
        across = {(label, 3 + axis) for axis in (1, 2, 3) if axis != direction}
        if direction > 3:
            dofs += [
                3 * int(block.turning[k]) + direction - 4 for k in members if block.turning[k] >= 0
            ]
        elif members.size <= 1 or across <= case.held:
            dofs += (3 * members + direction - 1).tolist()
        else:
            rows.append(3 * carriers_of(nodes, label) + direction - 1)
    rows = [row for row in rows if block.known[row].all()]
    entries = [
        np.concatenate(
            [np.repeat(k, row.size) for k, row in enumerate(rows)] or [np.zeros(0, dtype=int)]
        )
    ]
    entries.append(np.concatenate(rows or [np.zeros(0, dtype=int)]))
    means = csr_matrix(
        (np.ones(entries[0].size), tuple(entries)), shape=(len(rows), block.matrix.shape[0])
    )
    return np.array(dofs, dtype=np.int64), means


def _solved(matrix: csr_matrix, free: np.ndarray, forces: np.ndarray, name: str) -> np.ndarray:
    """Displacement of all dofs, (n,), zero where they are not free."""
    solve = factored(matrix, free, name)
    # a known vector loses as many digits as K has lost: all of them if it is singular
    vector = np.random.default_rng(0).standard_normal(free.size) * free
    off = solve(matrix @ vector) - vector
    if not np.linalg.norm(off[free]) <= SINGULAR * np.linalg.norm(vector):
        raise NotSolvableError(
            f"the K of block '{name}' is singular with the supports of its solved case: name what "
            "is held there (held), "
            "or give K of a block that is held"
        )
    return np.where(free, solve(forces), 0.0)


def factored(matrix: csr_matrix, free: np.ndarray, name: str) -> Callable[[np.ndarray], np.ndarray]:
    """Function that solves K x = f on free dofs: by MUMPS or Cholesky of PETSc where it is, else by
    SuperLU.

    Args:
        matrix: K, (n, n).
        free: free dofs, (n,) bool.
        name: for messages and the prefix of PETSc options.

    Raises:
        NotSolvableError: for a singular K.
    """
    try:
        from petsc4py import PETSc  # noqa: F401
    except ImportError:
        return _by_superlu(matrix, free, name)
    from mpi4py import MPI

    from hhr_dolfinx.linear.sparse import FreeCholesky, ordering_of

    all_rows = slice(0, matrix.shape[0])
    ordering = ordering_of(3, "qmd")
    whole = _with_diagonal(matrix)
    try:
        factors = FreeCholesky(whole, free, all_rows, name, ordering, MPI.COMM_SELF)
    except NotSolvableError:  # its reasons are those of meshes
        raise NotSolvableError(
            f"the K of block '{name}' is singular with the supports of its solved case"
        ) from None
    check_definite(factors.negative, f"block '{name}'")
    return factors.solve


def check_definite(negative: int, what: str) -> None:
    """Check that K is that of an energy.

    Args:
        negative: number of negative pivots of its factors.
        what: what it is the K of.

    Raises:
        NotSolvableError: if there is one.
    """
    if negative:
        raise NotSolvableError(
            f"the K of {what} is indefinite, {negative} of its pivots are negative: it is that "
            "of no energy, such as of a body beyond buckling, or less a mass"
        )


def _with_diagonal(matrix: csr_matrix) -> csr_matrix:
    """The matrix with all diagonal entries in its pattern."""
    size = matrix.shape[0]
    entries = matrix.tocoo()
    rows = np.concatenate([entries.row, np.arange(size)])
    columns = np.concatenate([entries.col, np.arange(size)])
    return csr_matrix(
        (np.concatenate([entries.data, np.zeros(size)]), (rows, columns)), shape=matrix.shape
    )


def _by_superlu(
    matrix: csr_matrix, free: np.ndarray, name: str
) -> Callable[[np.ndarray], np.ndarray]:
    from scipy.sparse.linalg import splu

    indices = np.flatnonzero(free)
    try:
        factor = splu(
            matrix[indices][:, indices].tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            options={"SymmetricMode": True},
        )
    except RuntimeError:
        raise NotSolvableError(
            f"the K of block '{name}' is singular with the supports of its solved case"
        ) from None

    if np.array_equal(factor.perm_r, factor.perm_c):
        check_definite(int((factor.U.diagonal() < 0).sum()), f"block '{name}'")

    def solve(forces: np.ndarray) -> np.ndarray:
        solution = np.zeros(free.size)
        solution[indices] = factor.solve(forces[indices])
        return solution

    return solve
