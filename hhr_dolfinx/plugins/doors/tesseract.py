"""A model as a Tesseract (tesseract-core >= 1.0, its runtime), for programs made of differentiable components.

The input is one array, the parameters; the output is one array, the outputs of the scene. The Jacobian is exact.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np

from hhr_dolfinx.compat import extra
from hhr_dolfinx.models.model import AnsweringModel
from hhr_dolfinx.plugins.doors.function import OutputFunction

with extra("doors", "a Tesseract"):
    from pydantic import Field, create_model, field_validator
    from tesseract_core.runtime import Array, Differentiable, Float64, ShapeDType

IN = "parameters"
OUT = "outputs"
Arrays = dict[str, Any]


class Endpoints:
    """Endpoints of the Tesseract of a model; see :func:`tesseract_api`."""

    def __init__(self, model: AnsweringModel):
        self.function = OutputFunction(model)
        counts = len(self.function.names), len(self.function.outputs)
        descriptions = ", ".join(self.function.names), ", ".join(self.function.outputs)
        schema: Any = create_model
        inputs, outputs = (
            (Differentiable[Array[(n,), Float64]], Field(description=text))
            for n, text in zip(counts, descriptions, strict=True)
        )
        checks = {"checked": field_validator(IN)(self._checked)}
        self.inputs = schema("InputSchema", __validators__=checks, **{IN: inputs})
        self.outputs = schema("OutputSchema", **{OUT: outputs})

    def apply(self, inputs: object) -> Any:
        """Outputs at a point."""
        return self.outputs(**{OUT: self.function(np.asarray(getattr(inputs, IN)))[0]})

    def jacobian(self, inputs: object, jac_inputs: set[str], jac_outputs: set[str]) -> dict[str, Arrays]:
        """Derivatives of the outputs along the parameters, (K, P)."""
        return {OUT: {IN: self._slopes(inputs)}}

    def jacobian_vector_product(
        self, inputs: object, jvp_inputs: set[str], jvp_outputs: set[str], tangent_vector: Arrays
    ) -> Arrays:
        """The Jacobian times a direction."""
        return {OUT: self._slopes(inputs) @ np.asarray(tangent_vector[IN])}

    def vector_jacobian_product(
        self, inputs: object, vjp_inputs: set[str], vjp_outputs: set[str], cotangent_vector: Arrays
    ) -> Arrays:
        """Weights of the outputs times the Jacobian."""
        return {IN: np.asarray(cotangent_vector[OUT]) @ self._slopes(inputs)}

    def abstract_eval(self, abstract_inputs: object) -> dict[str, Any]:
        """Shape of the outputs."""
        return {OUT: ShapeDType(shape=(len(self.function.outputs),), dtype="float64")}

    def _checked(self, point: object) -> Any:
        """Check that a point is in the training range; a client gets the text of errors of a schema only."""
        if not isinstance(point, ShapeDType):  # ``abstract_eval`` passes a shape without values
            self.function.check(np.asarray(point))
        return point

    def _slopes(self, inputs: object) -> np.ndarray:
        return self.function.jacobian(np.asarray(getattr(inputs, IN)))


def tesseract_api(model: AnsweringModel) -> ModuleType:
    """API of a model, see :class:`OutputFunction`, as a module, for ``Tesseract.from_tesseract_api``.

    ``tesseract build`` requires a file ``tesseract_api.py`` of three lines::

        import hhr_dolfinx as hhr
        from hhr_dolfinx.plugins.doors.tesseract import tesseract_api

        globals().update(vars(tesseract_api(hhr.load_model("model.npz"))))
    """
    made = Endpoints(model)
    api = ModuleType("tesseract_api", "Contact problem of a condensed or reduced model.")
    names = ("apply", "jacobian", "jacobian_vector_product", "vector_jacobian_product", "abstract_eval")
    vars(api).update({name: getattr(made, name) for name in names})
    vars(api).update(InputSchema=made.inputs, OutputSchema=made.outputs)
    return api
