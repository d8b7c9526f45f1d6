"""Outputs of bodies whose shape depends on parameters: computed on few shapes, and interpolated
between them.
"""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.models.functionals.functional import Functional
from hhr_dolfinx.plugins.moduli.interpolate import GridSettings, grown
from hhr_dolfinx.plugins.shapes.functionals import (
    ROWS_ARRAY,
    MovingMises,
    ReshapedFunctionals,
    Zone,
)
from hhr_dolfinx.plugins.stress.kinds import Mises

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.shapes.outputs import FullShapeFunctionals

OUTPUT_TOLERANCE = 3e-7
"""Target error of the arrays of outputs, relative to their size: forces and displacements cancel in
them, as in a gap. A grid this fine has a few shapes more than that of the model.
"""
_OF_ROWS = {item.name for item in fields(Functional)}


def reshaped_functionals(
    prepared: FullShapeFunctionals,
    problem: ContactProblem,
    basis: np.ndarray,
    settings: GridSettings,
) -> ReshapedFunctionals:
    """Outputs of a full model for displacements that are a basis times coordinates, and the lift.

    Strain is not interpolated but computed from cells, see :mod:`hhr_dolfinx.plugins.shapes.cells`.

    Args:
        prepared: outputs of the full model on all shapes.
        problem: the contact problem.
        basis: V, (N, ell).
        settings: targets of the grid.

    Raises:
        SceneError: for an output with other conditions, or arrays of other lengths, on other
            shapes.
    """
    lifted = np.flatnonzero(np.diff(problem.lifts.indptr)).astype(np.int64)
    columns = np.column_stack([basis, problem.lifts[:, lifted].toarray()])
    base = prepared.at(problem.middle).items

    def solved(point: np.ndarray) -> dict[str, np.ndarray]:
        arrays: dict[str, np.ndarray] = {}
        for index, functional in enumerate(prepared.at(point).items):
            _check_alike(base[index], functional)
            smooth = {
                name: np.asarray(value)
                for name, value in _own(functional).items()
                if _smooth(value) and np.size(value)
            }
            arrays |= {f"{index} {name}": array for name, array in smooth.items()}
            if not isinstance(functional, MovingMises) and functional.count:
                arrays[f"{index} {ROWS_ARRAY}"] = functional.matrix(len(columns)) @ columns
        return arrays

    finer = replace(settings, tolerance=min(OUTPUT_TOLERANCE, settings.tolerance))
    grid, modes = grown(solved, problem.parameters, prepared.axes, finer)
    names = [name.split(" ", 1) for name in modes]
    shapes = [mode.shape[:-1] for mode in modes.values()]
    zones = [
        Zone(functional.cells, columns[functional.cells.dofs])
        if isinstance(functional, MovingMises)
        else None
        for functional in base
    ]
    return ReshapedFunctionals(
        items=tuple(_without_rows(functional) for functional in base),
        arrays=tuple(
            (int(index), array_name, shape)
            for (index, array_name), shape in zip(names, shapes, strict=True)
        ),
        interpolant=grid.interpolant,
        zones=tuple(zones),
        lifted=lifted,
        amplitudes=problem.amplitudes,
        parameters=problem.parameters,
    )


def _own(item: Functional) -> dict[str, Any]:
    """Fields of an output other than its rows."""
    return {
        field.name: getattr(item, field.name)
        for field in fields(item)
        if field.name not in _OF_ROWS | {"cells"}
    }


def _smooth(value: object) -> bool:
    """True if a field is interpolated."""
    return isinstance(value, float) or (isinstance(value, np.ndarray) and value.dtype == np.float64)


def _check_alike(base: Functional, item: Functional) -> None:
    """Raise SceneError for outputs of two shapes that differ by more than numbers."""
    if type(base) is type(item) and base.count == item.count:
        pairs = [(value, getattr(item, name)) for name, value in _own(base).items()]
        if all(
            np.shape(a) == np.shape(b) if _smooth(a) else np.array_equal(a, b) for a, b in pairs
        ):
            return
    raise SceneError(
        f"output '{base.name}' is made of other conditions, terms or cells on another shape, and "
        "cannot be interpolated between shapes: narrow the box, or leave it out"
    )


def _without_rows(item: Functional) -> Functional:
    """An output without rows, which come from elsewhere."""
    nowhere = np.zeros(0, dtype=np.int64)
    if isinstance(item, MovingMises):
        values = {field.name: getattr(item, field.name) for field in fields(Mises)}
        item = Mises(**values)
    return replace(item, rows=nowhere, columns=nowhere, entries=np.zeros(0))
