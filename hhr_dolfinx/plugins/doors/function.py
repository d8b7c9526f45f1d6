"""A model as a function of vectors, from parameters to the outputs of its scene: the base of all interfaces."""

from __future__ import annotations

from typing import Any

import numpy as np

from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.models.model import AnsweringModel
from hhr_dolfinx.parameters import PointLike, named_values


class OutputFunction:
    """The outputs of a scene as a function of its parameters; ``names`` and ``outputs`` have the names of both.

    Args:
        model: of any kind. With friction or inelastic bodies, a point is one step from rest.
        outside: treatment of points outside the training range, see :meth:`hhr_dolfinx.models.answer.Model.solve`.
            Other programs see no warnings of Python, so such a point is refused by default.

    Raises:
        NotOfferedError: for a model of a scene without outputs.
    """

    def __init__(self, model: AnsweringModel, outside: str = "refuse"):
        functionals = model.fields.functionals
        if functionals is None:
            raise NotOfferedError(
                "a door needs numbers to hand out: name outputs in the scene, Scene(..., outputs=(...,)), and build "
                "the model again"
            )
        self.model = model
        self.outside = outside
        self.names = tuple(model.parameters.names)
        self.outputs = tuple(item.name for item in functionals.items)

    def __call__(self, points: Any) -> np.ndarray:
        """Outputs at points, (n, P) or with names, or at one, (P,): (n, K).

        Raises:
            HHRError: if a point is outside the box or the training range, or has no answer.
        """
        space = self.model.parameters
        points = space.table(points if np.ndim(points) != 1 or named_values(points) is not None else [points])
        if len(points) == 1:
            self.check(points[0])  # its error names no row of a table
        found = self.model.solve_many(points, outside=self.outside).outputs()
        return np.column_stack([found[name] for name in self.outputs])

    def check(self, point: Any) -> None:
        """Refuse a point, (P,), outside the box or the training range, with a ParameterError; solves for nothing."""
        self.model.check_range(self.model.parameters.point(point), self.outside)

    def jacobian(self, point: PointLike) -> np.ndarray:
        """Derivatives of the outputs along the parameters at a point, (P,): (K, P)."""
        found = self.model.outputs(self.model.parameters.point(point), gradient=True, outside=self.outside).gradient
        assert found is not None
        return np.array([found[name] for name in self.outputs])
