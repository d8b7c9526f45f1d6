"""Common parts of interpolated condensation of full and reduced problems: grids, axes, division
into arrays.

Formulas of moduli are cheap, so their resolution by a grid is tested at thousands of points. The
compliance of a part whose stiffness is sum w_q(μ) K_q is composed of functions f_κ(μ) = 1 / sum κ_q
w_q(μ), with shares κ >= 0 of energies. This is exact for two parts, see
:mod:`hhr_dolfinx.certify.constants`. The error of the polynomials of a grid for these functions is
the error for the compliance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.formulas import Modulus, Scalar
from hhr_dolfinx.parameters import ParameterSpace, is_number, is_whole
from hhr_dolfinx.plugins.moduli.interpolated import Compliance, PrimalModes
from hhr_dolfinx.plugins.moduli.interpolation import (
    GrownGrid,
    Interpolant,
    grow,
    nodes_of,
    probes_of,
    unstacked,
    values_between,
)
from hhr_dolfinx.plugins.moduli.known_forces import many_weights

CLOSED_GAP = 1e-8
"""Gap over the size of a mesh up to which nothing is interpolated: 1e-16 is round-off, and
tolerances reach 1e-7.
"""


@dataclass(frozen=True)
class GridSettings:
    """Targets of the growth of a sparse grid."""

    tolerance: float = 1e-5  #: target error of S and of the free slack, relative to their size
    budget: int = 200  #: most solutions for each connected component of a scene
    compressed: bool = (
        True  # directions are left out that the tolerance does not need, but proofs do
    )
    least: int = 0  #: number of terms in any case

    def __post_init__(self) -> None:
        if (
            not is_number(self.tolerance)
            or not 0 < self.tolerance < 1
            or not is_whole(self.budget, 1)
        ):
            raise ReductionError(
                f"tolerance = {self.tolerance!r} of an interpolation must lie in (0, 1), and its "
                f"budget = {self.budget!r} be a positive integer"
            )
        if not isinstance(self.compressed, bool) or not is_whole(self.least, 0):
            raise ReductionError(
                f"compressed = {self.compressed!r} of an interpolation must be True or False, and "
                f"least = {self.least!r} an integer that is not negative"
            )


DEFAULT_GRID = GridSettings()


@dataclass(frozen=True)
class ProblemComponent:
    """A connected component of a problem."""

    conditions: np.ndarray  #: contact conditions that act on it, increasing
    forced: np.ndarray  #: terms of θ whose loads act on it; next those of imposed displacements
    lifted: np.ndarray
    factor: Scalar | None  #: the modulus common to all of it; None without one
    axes: np.ndarray  #: parameters on which the remaining dependence is
    #: of the parts of its stiffness, if these depend on parameters
    moduli: tuple[Modulus, ...] = ()

    def factor_at(self, point: np.ndarray) -> float:
        """The modulus at a point; 1 without one."""
        return 1.0 if self.factor is None else self.factor.value(point)

    def weights(self, points: np.ndarray) -> np.ndarray:
        """Weights of the parts of its stiffness without the factor, at points, (n, P): (n, Q)."""
        weights = many_weights(self.moduli, points)
        return weights if self.factor is None else weights / self.factor.values(points)[:, None]


def points_of(space: ParameterSpace, axes: np.ndarray, scaled: np.ndarray) -> np.ndarray:
    """Points of a box, (n, P), from scaled coordinates along some axes.

    The other parameters are in the middle of the box.

    Args:
        space: the box.
        axes: indices of the parameters that change, (d,).
        scaled: coordinates along them in [-1, 1]^d, (n, d).
    """
    lower, upper = np.array([space.lower, space.upper])[:, axes]
    points = np.repeat(space.middle[None], len(scaled), axis=0)
    points[:, axes] = lower + (scaled + 1) / 2 * (upper - lower)
    return points


def grown(
    solved: Callable[[np.ndarray], Mapping[str, np.ndarray]],
    space: ParameterSpace,
    axes: Sequence[int] | np.ndarray,
    settings: GridSettings,
    part: ProblemComponent | None = None,
    round_off: Mapping[str, float] | None = None,
) -> tuple[GrownGrid, dict[str, np.ndarray]]:
    """Interpolate arrays by name over some parameters; the others stay in the middle of the box.

    Args:
        solved: returns the arrays by name at a point, (P,).
        space: the box.
        axes: indices of the parameters of the interpolation.
        settings: targets of the grid.
        part: the component whose compliance the arrays are, if they are one: its formulas are
            compared with the grid at thousands of points.
        round_off: norms of arrays, by name, below which nothing but round-off may be left of them.

    Returns:
        The grid, and the modes of each array, in its shape with the modes along the last axis. The
        grid has no copy of the modes of a part, which may be large.
    """
    axes = np.asarray(axes, dtype=np.int64)
    if not axes.size:
        return _alone(solved, space, part)
    lower, upper = np.array([space.lower, space.upper], dtype=float)
    solved_points = {
        point.tobytes(): solved(point) for point in typical(space, axes)
    }  # the growth evaluates them too
    shapes = {name: np.shape(array) for name, array in next(iter(solved_points.values())).items()}
    sizes = {
        name: size_in_box([arrays[name] for arrays in solved_points.values()]) for name in shapes
    }
    sizes |= {name: max(sizes[name], size) for name, size in (round_off or {}).items()}

    def joined(values: np.ndarray) -> np.ndarray:
        """Concatenate all arrays, relative to their sizes: else a large one would dominate."""
        point = space.middle
        point[axes] = values
        arrays = solved_points.pop(point.tobytes(), None) or solved(point)
        return np.concatenate([np.ravel(array) / sizes[name] for name, array in arrays.items()])

    def scale(values: np.ndarray) -> float:
        """Largest of the parts."""
        return max(
            (float(np.linalg.norm(block)) for block in unstacked(values, shapes.values())),
            default=0.0,
        )

    box = (axes, lower[axes], upper[axes])
    limits = (settings.tolerance, settings.budget)
    formulas = None if part is None else FormulaGrid(part, space).error
    compressed = settings.compressed
    grid = grow(
        joined,
        scale,
        box,
        *limits,
        compressed=compressed,
        least=settings.least,
        everywhere=formulas,
    )
    grid = replace(grid, evaluations=grid.evaluations + len(solved_points))
    modes = grid.interpolant.modes
    modes *= np.repeat(list(sizes.values()), [math.prod(shape) for shape in shapes.values()])[
        :, None
    ]
    mode_arrays = dict(zip(shapes, unstacked(modes, shapes.values()), strict=True))
    if part is not None:
        grid = replace(
            grid, interpolant=replace(grid.interpolant, modes=np.zeros((0, modes.shape[1])))
        )
    return grid, mode_arrays


def round_off_of_gaps(problem: ContactProblem) -> float:
    """Norm of gaps below which they may be round-off of coordinates.

    Gaps of surfaces that stay flush in every shape are.
    """
    return CLOSED_GAP * float(np.ptp(problem.points, axis=0).max()) * math.sqrt(len(problem.gaps))


def typical(space: ParameterSpace, axes: np.ndarray) -> np.ndarray:
    """The middle of a box and random points along some axes of it, (n, P).

    Args:
        space: the box.
        axes: indices of the parameters that change, (d,).
    """
    return points_of(space, axes, np.vstack([np.zeros(axes.size), probes_of(axes.size)]))


def size_in_box(values: Sequence[np.ndarray | float]) -> float:
    """Size of an array in a box from its values at :func:`typical` points; 1 if it is zero.

    In the middle it may vanish to round-off, as gaps of a shape that varies about a fit do. The
    smaller norm of the random points stands for the box: the largest may be that of a corner where
    a body is soft.
    """
    middle, *random_norms = (float(np.linalg.norm(value)) for value in values)
    return max(middle, min(random_norms)) or 1.0


def _alone(
    solved: Callable[[np.ndarray], Mapping[str, np.ndarray]],
    space: ParameterSpace,
    part: ProblemComponent | None,
) -> tuple[GrownGrid, dict[str, np.ndarray]]:
    """Case without parameters: the arrays as they are.

    Those of a part may be large, and are not stacked.
    """
    none = np.zeros(0)
    arrays = {name: values[..., None] for name, values in solved(space.middle).items()}
    levels = np.zeros((1, 0), dtype=np.int64)
    stacked = [values.reshape(-1, 1) for values in arrays.values()] if part is None else []
    modes = np.asfortranarray(np.concatenate([np.zeros((0, 1)), *stacked]))
    interpolant = Interpolant(none.astype(np.int64), none, none, levels, modes, np.ones((1, 1)))
    return GrownGrid(
        interpolant, 0.0, 1, 0.0 if part is None else FormulaGrid(part, space).error(levels)
    ), arrays


def compliance_of(
    part: ProblemComponent,
    grid: GrownGrid,
    modes: dict[str, np.ndarray],
    unknowns: np.ndarray | None,
) -> Compliance:
    """Compliance of a component from its interpolated arrays.

    Args:
        part: conditions, terms and modulus of the component.
        grid: its interpolation.
        modes: modes of ``schur`` (m, m), ``columns`` (T, m) and, with unknowns, ``per_force``
            (n, m) and ``free`` (T, n).
        unknowns: indices of its unknowns, (n,); None if it has no modes of them.
    """
    rank = len(grid.interpolant.weights)
    schur = np.asfortranarray(modes["schur"].reshape(-1, rank))
    interpolant: Interpolant = replace(grid.interpolant, modes=schur)
    primal = None
    if unknowns is not None:
        per_force = np.ascontiguousarray(np.moveaxis(modes["per_force"], 2, 0))
        primal = PrimalModes(unknowns, per_force, np.ascontiguousarray(modes["free"]))
    columns = np.ascontiguousarray(modes["columns"])
    return Compliance(
        part.conditions, part.forced, part.lifted, part.factor, interpolant, columns, primal
    )


MIXED = (0.1, 0.5)
"""Shares of one part, with equal shares of all others."""


@dataclass(frozen=True)
class FormulaGrid:
    """Compares polynomials of a grid over the axes of a connected component with its formulas."""

    part: ProblemComponent  #: the component
    space: ParameterSpace  #: the box

    def error(self, levels: np.ndarray) -> float:
        """Largest error of polynomials, (n, d), relative to the largest f_κ.

        Infinite if one is not finite.
        """
        if not self.part.moduli or not len(self._points_along):
            return 0.0
        at_nodes = self._inverses(points_of(self.space, self.part.axes, nodes_of(levels)))
        exact = self._exact
        if not (np.isfinite(at_nodes).all() and np.isfinite(exact).all()):
            return np.inf
        lower, upper = np.array([self.space.lower, self.space.upper])[:, self.part.axes]
        scaled = 2 * (self._points_along[:, self.part.axes] - lower) / (upper - lower) - 1
        errors = values_between(levels, at_nodes, scaled) - exact
        return float((np.abs(errors).max(axis=0) / np.abs(exact).max(axis=0)).max(initial=0.0))

    @cached_property
    def _points_along(self) -> np.ndarray:
        """Points along all parameters of the formulas that are axes, (n, P)."""
        names = {
            name
            for modulus in self.part.moduli
            for scalar in (modulus.factor_scalar, modulus.rest_scalar)
            for name in scalar.formula.variables
        }
        return self.space.lines(
            [axis for axis in self.part.axes.tolist() if self.space.names[axis] in names]
        )

    @cached_property
    def _exact(self) -> np.ndarray:
        """f_κ at these points, (n, k)."""
        return self._inverses(self._points_along)

    @cached_property
    def _shares(self) -> np.ndarray:
        """κ of a few representative mixtures, (Q, k), scaled to the largest size of the parts.

        A part may be negative, as the change of volume is for auxetic bodies; a negative mixture
        does not occur.
        """
        weights = self.part.weights(self._points_along)
        count = len(self.part.moduli)
        shares = [np.ones(count) / count]
        for mixed in MIXED if count > 1 else ():
            shares += list(mixed / (count - 1) * (1 - np.eye(count)) + (1 - mixed) * np.eye(count))
        scaled = (np.array(shares) / np.abs(weights).max(axis=0)).T
        return scaled[:, ~(weights @ scaled <= 0).any(axis=0)]

    def _inverses(self, points: np.ndarray) -> np.ndarray:
        """f_κ at points, (n, P): (n, k)."""
        return 1 / (self.part.weights(points) @ self._shares)
