"""What interpolated condensation of a full and of a reduced problem share: grids, axes, the cut into arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.formulas import Modulus, Scalar
from hhr_dolfinx.models.interpolated import Compliance, PrimalModes
from hhr_dolfinx.models.interpolation import GrownGrid, Interpolant, grow
from hhr_dolfinx.parameters import ParameterSpace, is_number, is_whole
from hhr_dolfinx.reduction.formula_grids import FormulaGrid


@dataclass(frozen=True)
class GridSettings:
    """How far a sparse grid grows.

    Attributes:
        tolerance: wished error of S and of the free slack, relative to their size.
        budget: most solutions for each part of a scene that hangs together.
        compressed: whether directions are left out that the tolerance does not ask for; what is proved of an
            interpolation needs them.
        least: terms that there are, whatever the error.
    """

    tolerance: float = 1e-5
    budget: int = 200
    compressed: bool = True
    least: int = 0

    def __post_init__(self) -> None:
        if not is_number(self.tolerance) or not 0 < self.tolerance < 1 or not is_whole(self.budget, 1):
            raise ReductionError(
                f"tolerance = {self.tolerance!r} of an interpolation must lie in (0, 1), and its budget = "
                f"{self.budget!r} be a positive integer"
            )
        if not isinstance(self.compressed, bool) or not is_whole(self.least, 0):
            raise ReductionError(
                f"compressed = {self.compressed!r} of an interpolation must be True or False, and least = "
                f"{self.least!r} an integer that is not negative"
            )


DEFAULT_GRID = GridSettings()


@dataclass(frozen=True)
class Part:
    """What of a problem hangs together.

    Attributes:
        conditions: contact conditions that act on it, increasing.
        forced, lifted: terms of θ whose loads or imposed displacements act on it.
        factor: the modulus that all of it shares; None for none.
        axes: parameters on which the rest depends.
        moduli: of the parts of its stiffness, where these depend on parameters.
    """

    conditions: np.ndarray
    forced: np.ndarray
    lifted: np.ndarray
    factor: Scalar | None
    axes: np.ndarray
    moduli: tuple[Modulus, ...] = ()

    def factor_at(self, point: np.ndarray) -> float:
        """The modulus at a point; 1 where there is none."""
        return 1.0 if self.factor is None else self.factor.value(point)


def grown(
    solved: Callable[[np.ndarray], Mapping[str, np.ndarray]],
    space: ParameterSpace,
    axes: np.ndarray,
    settings: GridSettings,
    part: Part | None = None,
) -> tuple[GrownGrid, dict[str, np.ndarray]]:
    """Interpolate arrays by name over some parameters; the others stay in the middle of the box.

    Where they are the compliance of a ``part``, its formulas are held against the grid at thousands of points.

    Returns:
        The grid, and the modes of each array, its own shape with the modes along the last axis.
    """
    lower, upper = np.array([space.lower, space.upper], dtype=float)
    shapes: dict[str, tuple[int, ...]] = {}
    sizes: dict[str, float] = {}

    def joined(values: np.ndarray) -> np.ndarray:
        """All arrays, each relative to its size at the first point: a small one would drown in a large one."""
        point = (lower + upper) / 2
        point[axes] = values
        found = solved(point)
        for name, part in found.items():
            shapes[name] = np.shape(part)
            sizes.setdefault(name, float(np.linalg.norm(part)) or 1.0)
        return np.concatenate([np.ravel(part) / sizes[name] for name, part in found.items()])

    def scale(values: np.ndarray) -> float:
        """The largest of the parts."""
        ends = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes.values())])
        return max((float(np.linalg.norm(values[a:b])) for a, b in pairwise(ends)), default=0.0)

    box, how = (axes, lower[axes], upper[axes]), (settings.tolerance, settings.budget)
    formulas = None if part is None else FormulaGrid(part.moduli, part.factor, axes, space).error
    kept = settings.compressed
    grid = grow(joined, scale, box, *how, compressed=kept, least=settings.least, everywhere=formulas)
    modes, first, parts = grid.interpolant.modes, 0, {}
    for name, shape in shapes.items():
        size = int(np.prod(shape))
        parts[name] = sizes[name] * modes[first : first + size].reshape(*shape, modes.shape[1])
        first += size
    return replace(grid, interpolant=replace(grid.interpolant, modes=_stacked(parts, modes))), parts


def _stacked(parts: Mapping[str, np.ndarray], like: np.ndarray) -> np.ndarray:
    """Modes of all arrays beside each other, in their own sizes."""
    if not parts:
        return like
    return np.asfortranarray(np.concatenate([part.reshape(-1, part.shape[-1]) for part in parts.values()]))


def compliance_of(part: Part, grid: GrownGrid, modes: dict[str, np.ndarray], unknowns: np.ndarray | None) -> Compliance:
    """A part from modes of ``schur`` (m, m), ``columns`` (T, m), and of ``pushed`` (n, m) and ``free`` (T, n)."""
    rank = len(grid.interpolant.weights)
    schur = np.asfortranarray(modes["schur"].reshape(-1, rank))
    interpolant: Interpolant = replace(grid.interpolant, modes=schur)
    primal = None
    if unknowns is not None:
        pushed = np.ascontiguousarray(np.moveaxis(modes["pushed"], 2, 0))
        primal = PrimalModes(unknowns, pushed, np.ascontiguousarray(modes["free"]))
    columns = np.ascontiguousarray(modes["columns"])
    return Compliance(part.conditions, part.forced, part.lifted, part.factor, interpolant, columns, primal)
