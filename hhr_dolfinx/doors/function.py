"""A model as a function of vectors, from parameters to the outputs of its scene: what all doors are made of."""

from __future__ import annotations

from typing import Any

import numpy as np

from hhr_dolfinx.errors import NotOfferedError


class OutputFunction:
    """The outputs of a scene as a function of its parameters.

    Args:
        model: of any kind, elastic; with friction or bodies that flow a point is one step from rest.
        outside: what happens outside of what was trained, see :meth:`hhr_dolfinx.models.answer.Model.solve`.

    Attributes:
        names: of the parameters, in their order.
        outputs: names of the outputs, in their order.

    Raises:
        NotOfferedError: for a model of a scene without outputs.
    """

    def __init__(self, model: Any, outside: str = "warn"):
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
        """Outputs at points, (n, P): (n, K).

        Raises:
            HHRError: where a point is outside of the box, or has no answer.
        """
        found = self.model.solve_many(np.atleast_2d(points), outside=self.outside).outputs()
        return np.column_stack([found[name] for name in self.outputs])

    def jacobian(self, point: Any) -> np.ndarray:
        """Derivatives of the outputs along the parameters at a point, (P,): (K, P)."""
        found = self.model.outputs(np.asarray(point, dtype=float), gradient=True, outside=self.outside).gradient
        return np.array([found[name] for name in self.outputs])
