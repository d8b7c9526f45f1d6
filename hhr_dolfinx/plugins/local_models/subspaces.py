"""Distances of spaces of displacements, by principal angles: of bases and of snapshots; theorem 9.

Everything is computed in coordinates of all columns in one orthonormal basis, as many rows as there
are columns. This takes one factorisation of the size of the mesh for any number of pairs. Cosines
do not resolve angles below 1e-8; small angles are computed from sines, which are accurate to
round-off.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import linalg

from hhr_dolfinx.errors import ReductionError

ORTHONORMAL_BASIS = 1e-8
"""Largest entry of V^T V - I of a basis that counts as orthonormal."""
SMALL_ANGLE = 0.01
"""Distance of two bases, in radians, below which it is computed from sines: cosines would leave
1e-16 over it.
"""
PAIR_BLOCK_NUMBERS = 4_000_000
"""Numbers in memory of a block of pairs."""


class ChordalBounds(NamedTuple):
    """Right sides of theorem 9."""

    angles: float  #: (2.129), by all principal angles and the coordinates of the exact answer
    distance: float  #: (2.130), by the chordal distance and the length of these coordinates


def coordinates(columns: np.ndarray) -> np.ndarray:
    """Columns, (N, S), in an orthonormal basis of their span, (r, S), r = min(N, S).

    Lengths and products do not change.

    ReductionError for an invalid table of real numbers.
    """
    columns = _checked("columns", columns)
    rows, count = columns.shape
    return columns if rows <= count else linalg.qr(columns, mode="r", check_finite=False)[0][:count]


def basis_distances(bases: Sequence[np.ndarray]) -> np.ndarray:
    """Dissimilarity of local bases, (4.1): the Grassmann distance of each pair, (4.2).

    It is the root of the sum of squares of the principal angles, (4.3), and of a right angle for
    each dimension that one space has and the other lacks: symmetric with a zero diagonal, (n, n),
    in radians. Give many bases, (N, a_j) each, in common :func:`coordinates`: their products take
    the time. ReductionError for a basis that is not orthonormal, or of another mesh.
    """
    coordinates_of_bases = _together(
        {f"{number} of the bases": basis for number, basis in enumerate(bases)}
    )
    counts = np.array([basis_coordinates.shape[1] for basis_coordinates in coordinates_of_bases])
    padded = np.zeros((len(coordinates_of_bases), counts.max(), len(coordinates_of_bases[0])))
    for rows, basis_coordinates in zip(padded, coordinates_of_bases, strict=True):
        rows[: basis_coordinates.shape[1]] = basis_coordinates.T
    return _distances(padded, counts)


def snapshot_distances(columns: np.ndarray) -> np.ndarray:
    """Dissimilarity of snapshots of any lengths, (4.4): the angle between the lines that they span.

    The printed (4.4) has arccos(S_i^T S_j), which puts a snapshot and its opposite pi apart. (4.2),
    of which it is a case, gives zero, as both span one space. This function uses (4.2): arccos
    |S_i^T S_j|, symmetric with a zero diagonal, (S, S), in radians, at most pi / 2; errors are
    below 1e-12.

    Args:
        columns: snapshots, (N, S).

    Raises:
        ReductionError: for snapshots that are not finite, or zero, which have no direction.
    """
    scaled = coordinates(columns)
    # squares of very small or large displacements would not be finite
    scales = np.abs(scaled).max(axis=0)
    if not scales.all():
        raise ReductionError(
            f"snapshots {np.flatnonzero(scales == 0)[:10].tolist()} are zero, and have no "
            "direction: leave out parameters without load"
        )
    lines = (scaled / scales).T
    lines /= np.linalg.norm(lines, axis=1)[:, None]
    return _distances(lines[:, None], np.ones(len(lines), dtype=np.int64))


def theorem_9(
    exact: np.ndarray, reduced: np.ndarray, weights: np.ndarray, factor: float = 1.0
) -> ChordalBounds:
    """Right sides of theorem 9, by the angles of two spaces.

    They bound the distance of a reduced answer from the exact one.

    The first, |sin(theta) U*^T gamma*|, is the distance of the exact answer to the reduced space.
    If this has more functions than V*, both hold as well; ell is the number of functions of V*.

    Args:
        exact: V*, orthonormal, (N, ell).
        reduced: V of the reduced model, orthonormal, (N, m).
        weights: gamma*, with which V* gamma* is the exact answer, (ell,).
        factor: 1 + M_a / alpha' of theorem 6, in the Euclidean norm, as in the thesis.

    Raises:
        ReductionError: for a basis that is not orthonormal, weights of another size or not finite,
            or a factor that is not positive.
    """
    first, second = _together({"exact": exact, "reduced": reduced})
    weights = np.asarray(weights, dtype=float)
    if weights.shape != first.shape[1:] or not np.isfinite(weights).all():
        raise ReductionError(
            f"gamma* = {weights!r} must be {first.shape[1]} finite numbers, one for each column "
            "of V*"
        )
    if not 0 < factor < np.inf:
        raise ReductionError(
            f"factor = {factor!r} must be a positive number: it is 1 + M_a / alpha'"
        )
    beyond = first - second @ (second.T @ first)
    _, sines, turn = linalg.svd(beyond, full_matrices=False)
    by_angles = np.linalg.norm(sines * (turn @ weights))
    by_distance = np.linalg.norm(sines) * np.sqrt(weights.size) * np.linalg.norm(weights)
    return ChordalBounds(float(factor * by_angles), float(factor * by_distance))


def _distances(padded: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Grassmann distances of bases, (n, n).

    Bases are stored as rows padded with zeros, (n, a, r), ``counts`` of them valid.
    """
    distances = _from_cosines(padded, counts)
    upper = np.triu(np.ones(distances.shape, dtype=bool), 1)
    near = np.nonzero(
        upper & (distances < SMALL_ANGLE)
    )  # bases of different dimensions are a right angle apart
    distances[near] = _from_sines(padded, *near)
    distances = np.where(upper, distances, 0.0)
    return distances + distances.T


def _from_cosines(padded: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Distances from cosines, on and above the diagonal, with errors of 1e-16 over the distance."""
    total, width, size = padded.shape
    distances = np.zeros((total, total))
    rows = max(1, PAIR_BLOCK_NUMBERS // (total * width**2))
    for start in range(0, total, rows):
        block = slice(start, min(start + rows, total))
        products = padded[block].reshape(-1, size) @ padded[start:].reshape(-1, size).T
        products = products.reshape(-1, width, total - start, width).transpose(0, 2, 1, 3)
        cosines = (
            np.abs(products[..., 0]) if width == 1 else np.linalg.svd(products, compute_uv=False)
        )
        angles = np.arccos(np.clip(cosines, 0.0, 1.0))
        shared = np.minimum(counts[block, None], counts[start:])
        squares = np.where(np.arange(width) < shared[..., None], angles**2, 0.0).sum(axis=-1)
        surplus = np.abs(counts[block, None] - counts[start:])
        distances[block, start:] = np.sqrt(squares + surplus * np.pi**2 / 4)
    return distances


def _from_sines(padded: np.ndarray, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Distances from sines, for pairs of close bases of one dimension.

    The pairs are given by their numbers, (k,) each.
    """
    _, width, size = padded.shape
    distances = [np.zeros(0)]
    step = max(1, PAIR_BLOCK_NUMBERS // (width * size))
    for start in range(0, one.size, step):
        first = padded[one[start : start + step]]
        second = padded[other[start : start + step]]
        beyond = second - (second @ first.transpose(0, 2, 1)) @ first
        squares = np.linalg.eigvalsh(beyond @ beyond.transpose(0, 2, 1))
        distances.append(np.linalg.norm(np.arcsin(np.sqrt(np.clip(squares, 0.0, 1.0))), axis=-1))
    return np.concatenate(distances)


def _together(bases: dict[str, np.ndarray]) -> list[np.ndarray]:
    """Bases by their names in common coordinates, checked to be orthonormal."""
    if not bases:
        raise ReductionError("no basis is given: distances are those of at least one")
    checked_bases = [_checked(f"basis {name}", basis) for name, basis in bases.items()]
    sizes = {basis.shape[0] for basis in checked_bases}
    if len(sizes) > 1:
        raise ReductionError(f"bases have {sorted(sizes)} rows: give those of one mesh")
    ends = np.cumsum([basis.shape[1] for basis in checked_bases])
    blocks = np.hsplit(coordinates(np.hstack(checked_bases)), ends[:-1])
    for name, block in zip(bases, blocks, strict=True):
        off = np.abs(block.T @ block - np.eye(block.shape[1])).max()
        if off > ORTHONORMAL_BASIS:
            raise ReductionError(
                f"basis {name} is not orthonormal, by {off:.2g} of V^T V - I: orthonormalise it, "
                "by a QR factorisation for instance"
            )
    return blocks


def _checked(name: str, columns: np.ndarray) -> np.ndarray:
    """A table of finite real numbers with at least one column."""
    try:
        table = np.asarray(columns, dtype=float)
    except (TypeError, ValueError):
        raise ReductionError(
            f"{name} must be a table of real numbers, (N, columns), and is {columns!r}"
        ) from None
    if table.ndim != 2 or 0 in table.shape:
        raise ReductionError(
            f"{name} has the shape {table.shape}: a table of at least one column, (N, S), is needed"
        )
    bad = np.flatnonzero(~np.isfinite(table).all(axis=0))
    if bad.size:
        raise ReductionError(f"columns {bad[:10].tolist()} of {name} are not finite")
    return table
