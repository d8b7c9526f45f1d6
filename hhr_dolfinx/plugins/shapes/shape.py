"""Bodies whose shape depends on parameters: a smooth map of a fixed mesh, as formulas of
coordinates and parameters.

The mesh keeps its nodes, cells and tags; only coordinates change. A map is data, so that a reduced
model can map its nodes without a mesh.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.formulas import Formula, coordinate_names, formula_of
from hhr_dolfinx.parameters import ParameterSpace, Tag, as_tuple, check_tag


@dataclass(frozen=True)
class Shape:
    """Map of the mesh of one body: new coordinates as formulas of the old ones and of parameters.

    Attributes:
        tag: cell tag of the body.
        coordinates: one formula for each coordinate, named x, y, z, in axisymmetry r, z: a body
            that is ``t`` times as high is ``("x", "t * y")``.

    Example:
        >>> curved = hhr.Shape("pad", ("x", "y * (1 + c * x**2)"))
        >>> curved.moved(np.array([[0.0, 1.0], [2.0, 1.0]]), ("x", "y"), {"c": 0.1})
        array([[0. , 1. ],
               [2. , 1.4]])
    """

    tag: Tag
    coordinates: tuple[Formula, ...]

    def __post_init__(self) -> None:
        check_tag("shape", self.tag)
        texts = as_tuple(f"coordinates of the shape of body {self.tag}", self.coordinates)
        formulas = tuple(
            formula_of(text, f"a coordinate of the shape of body {self.tag}") for text in texts
        )
        object.__setattr__(self, "coordinates", formulas)

    def check(self, parameters: ParameterSpace, hypothesis: str) -> None:
        """Refuse missing formulas and unknown names.

        Args:
            parameters: the box of the scene.
            hypothesis: hypothesis of the scene, which names the coordinates.

        Raises:
            SceneError: for missing formulas, for names that are neither parameters nor coordinates,
                and for parameters with the names of coordinates.
        """
        names = coordinate_names(hypothesis)
        if len(self.coordinates) != len(names):
            raise SceneError(
                f"the shape of body {self.tag} has {len(self.coordinates)} formulas: one for each "
                f"of {names} is needed"
            )
        clash = set(names) & set(parameters.names)
        if clash:
            raise SceneError(
                f"parameters {sorted(clash)} have the names of coordinates: rename them, shapes "
                "use both"
            )
        unknown = self.variables - set(names) - set(parameters.names)
        if unknown:
            raise SceneError(
                f"the shape of body {self.tag} names {sorted(unknown)}: coordinates are {names}, "
                f"parameters {parameters.names}"
            )

    @property
    def variables(self) -> set[str]:
        """All names in the formulas."""
        return {name for formula in self.coordinates for name in formula.variables}

    def moved(
        self, points: np.ndarray, names: Sequence[str], values: dict[str, float]
    ) -> np.ndarray:
        """New coordinates of points, (n, dim).

        Args:
            points: coordinates as meshed, (n, dim).
            names: names of the coordinates.
            values: parameters by name.
        """
        variables = {**values, **dict(zip(names, points.T, strict=True))}
        with np.errstate(all="ignore"):  # the check of the mesh refuses non-finite coordinates
            columns = [
                np.broadcast_to(formula(variables), len(points)) for formula in self.coordinates
            ]
        return np.stack(columns, axis=1).astype(float)
