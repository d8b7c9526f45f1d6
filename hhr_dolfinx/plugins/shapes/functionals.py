"""Outputs of bodies whose shape depends on parameters, for models without a mesh.

At each shape they are ordinary :class:`~hhr_dolfinx.models.functionals.functional.Functionals`.
Their arrays, such as areas of conditions and arms of forces, are interpolated over the shape
parameters. Their rows act on the coordinates of a reduced displacement. Rows of strain are too many
to interpolate; they are computed from cells at their new nodes.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.models.functionals.functional import AllOutputs, Functional, Functionals, State
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.plugins.moduli.interpolation import Interpolant, unstacked
from hhr_dolfinx.plugins.shapes.cells import CellStrain, MovingCells
from hhr_dolfinx.plugins.stress.kinds import Mises

if TYPE_CHECKING:
    pass

ROWS_ARRAY = "rows"
"""Name of the rows of an output among its arrays."""
OUTPUT_STEP = 1e-4
"""Step of the central differences over shapes, as a part of the box: their error is its square."""


@dataclass(frozen=True, eq=False)
class MovingMises(Mises):
    """Von Mises' stress of cells whose shape depends on parameters."""

    cells: MovingCells  #: from which a model computes its rows


class OverShapes(AllOutputs):
    """Outputs that are read on other shapes.

    Fields of their answers have ``coordinates``, (s,), on which rows of the outputs act: the
    displacement, or its components in a basis; and ``coordinate_changes``, derivatives of all
    contact forces and of these.
    """

    parameters: ParameterSpace  #: the box of the parameters

    def read(self, here: Functionals, answer: Any, theta: np.ndarray) -> np.ndarray:
        """Rows of the outputs times the displacement of an answer, (K,).

        Args:
            here: outputs on the shape of the answer.
            answer: the answer.
            theta: θ of its parameter, (1 + T,).
        """
        return here.measured(answer.fields.coordinates(answer, theta))

    def read_changes(
        self, here: Functionals, answer: Any, changes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of all contact forces, (N_lambda, P), and of these products, (K, P).

        Args:
            here: outputs on the shape of the answer.
            answer: the answer.
            changes: derivatives of θ, (1 + T, P).
        """
        forces, coordinates = answer.fields.coordinate_changes(answer, changes)
        return forces, here.measured(coordinates)

    def along_shapes(self, here: Functionals, answer: Any, states: list[State]) -> np.ndarray:
        """Derivatives of all outputs along the shape parameters, by differences, (outputs, P).

        Args:
            here: outputs on the shape of the answer.
            answer: the answer.
            states: state of each output, which stays fixed.
        """
        slopes = np.zeros((len(states), answer.parameter.size))
        moves = here.places and here.places[-1].stop
        coordinates = answer.fields.coordinates(answer, states[0].theta) if moves else np.zeros(0)

        def followed(shifted: np.ndarray) -> np.ndarray:
            shifted_outputs = self.at(shifted)
            measured = shifted_outputs.measured(coordinates) if coordinates.size else np.zeros(0)
            after = [
                state._replace(measured=measured[span])
                for state, span in zip(states, here.places, strict=True)
            ]
            quadruples = zip(here.items, shifted_outputs.items, states, after, strict=True)
            return np.array(
                [
                    functional.followed(state, shifted_functional, new)
                    for functional, shifted_functional, state, new in quadruples
                ]
            )

        if self.axes.size:
            slopes[:, self.axes] = self.parameters.differences(
                followed, answer.parameter, OUTPUT_STEP, self.axes
            )
        return slopes


@dataclass(frozen=True, eq=False)
class Zone:
    """Strain of moving cells as a function of the coordinates of a reduced displacement."""

    cells: MovingCells  #: the cells
    columns: Annotated[
        Floats, "rows", "columns"
    ]  #: displacement of their nodes for each coordinate, (n dim, s)


@dataclass(frozen=True, eq=False)
class ShapedFunctionals(Functionals):
    """All outputs at one shape."""

    #: factors of the rows of each output that has any: the rows (k, s), or the strain of cells and
    #: (n dim, s), which acts on the coordinates first
    blocks: tuple[np.ndarray | tuple[CellStrain, np.ndarray], ...]

    def measured(self, coordinates: np.ndarray) -> np.ndarray:
        """Rows of all outputs times coordinates of the displacement, (s, ...): (K, ...)."""
        nothing = np.zeros((0, *coordinates.shape[1:]))
        products = [
            block[0] @ (block[1] @ coordinates) if isinstance(block, tuple) else block @ coordinates
            for block in self.blocks
        ]
        return np.concatenate([nothing, *products])


@dataclass(frozen=True, eq=False)
class ReshapedFunctionals(OverShapes):
    """All outputs of a scene whose shape depends on parameters.

    The displacement has s coordinates.

    The coordinates are the modes of a basis, followed by the amplitudes of imposed displacements.
    """

    items: tuple[Functional, ...]  #: one for each output, in the middle of the box; without rows
    arrays: tuple[
        tuple[int, str, tuple[int, ...]], ...
    ]  #: output, name and shape of each; that of a number is ()
    interpolant: Interpolant  #: of these arrays, concatenated
    zones: tuple[Zone | None, ...]  #: of the outputs whose rows are strain; None for the others
    lifted: Annotated[Integers, "lifted", "< terms"]  #: terms of θ that impose displacements, (l,)
    amplitudes: Amplitudes  #: θ as a function of the parameters
    parameters: ParameterSpace  #: the box of the parameters

    @property
    def axes(self) -> np.ndarray:
        """Indices of the shape parameters."""
        return self.interpolant.axes

    def check(self, space: ParameterSpace, conditions: int, gauss_points: int) -> None:
        """Refuse invalid outputs.

        Arrays depend on the shape, and one answer tests them.

        Args:
            space: the box.
            conditions: number of contact conditions.
            gauss_points: number of Gauss points.

        Raises:
            SceneError: for an output that is no Functional.
        """
        if not all(isinstance(functional, Functional) for functional in self.items):
            raise SceneError("an output must be a Functional")

    def at(self, point: np.ndarray) -> ShapedFunctionals:
        """Outputs on the shape at a point, (P,)."""
        changed: list[dict[str, np.ndarray | float]] = [{} for _ in self.items]
        blocks: list[np.ndarray | tuple[CellStrain, np.ndarray] | None] = [
            None if zone is None else (zone.cells(point), zone.columns) for zone in self.zones
        ]
        arrays = unstacked(self.interpolant.value(point), [shape for _, _, shape in self.arrays])
        for (index, name, shape), array in zip(self.arrays, arrays, strict=True):
            if name == ROWS_ARRAY:
                blocks[index] = array
            else:
                changed[index][name] = array if shape else float(array)
        functionals = tuple(
            _changed(functional, change)
            for functional, change in zip(self.items, changed, strict=True)
        )
        return ShapedFunctionals(
            functionals, 0, self.amplitudes, tuple(block for block in blocks if block is not None)
        )


def _changed(item: Functional, change: dict[str, np.ndarray | float]) -> Functional:
    """A copy with other arrays that keeps the parsed formulas: parsing takes a millisecond."""
    changed = copy(item)
    vars(changed).update(change)
    return changed
