"""A model as a Tesseract (tesseract-core >= 1.0, its runtime), for programs of components that have derivatives.

One array in, the parameters, and one out, the outputs of the scene; its Jacobian is exact.
"""

from __future__ import annotations

from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.compat import extra
from hhr_dolfinx.plugins.doors.function import OutputFunction

if TYPE_CHECKING:
    from hhr_dolfinx.models.model import AnsweringModel


with extra("doors", "a Tesseract"):
    from pydantic import Field, create_model, field_validator
    from tesseract_core.runtime import Array, Differentiable, Float64, ShapeDType

IN = "parameters"
OUT = "outputs"
Arrays = dict[str, Any]


class Endpoints:
    """What a Tesseract of a model answers; see :func:`tesseract_api`."""

    def __init__(self, model: AnsweringModel):
        self.function = OutputFunction(model)
        counts = len(self.function.names), len(self.function.outputs)
        told = ", ".join(self.function.names), ", ".join(self.function.outputs)
        schema: Any = create_model
        checks: list[Any] = [{"checked": field_validator(IN)(self._checked)}, {}]
        self.inputs, self.outputs = (
            schema(
                title, __validators__=check, **{name: (Differentiable[Array[(n,), Float64]], Field(description=said))}
            )
            for title, name, n, said, check in zip(
                ("InputSchema", "OutputSchema"), (IN, OUT), counts, told, checks, strict=True
            )
        )

    def apply(self, inputs: Any) -> Any:
        """Outputs at a point."""
        return self.outputs(**{OUT: self.function(np.asarray(getattr(inputs, IN)))[0]})

    def jacobian(self, inputs: Any, jac_inputs: set[str], jac_outputs: set[str]) -> dict[str, Arrays]:
        """Derivatives of the outputs along the parameters, (K, P)."""
        return {OUT: {IN: self._slopes(inputs)}}

    def jacobian_vector_product(
        self, inputs: Any, jvp_inputs: set[str], jvp_outputs: set[str], tangent_vector: Arrays
    ) -> Arrays:
        """The Jacobian times a direction."""
        return {OUT: self._slopes(inputs) @ np.asarray(tangent_vector[IN])}

    def vector_jacobian_product(
        self, inputs: Any, vjp_inputs: set[str], vjp_outputs: set[str], cotangent_vector: Arrays
    ) -> Arrays:
        """Weights of the outputs times the Jacobian."""
        return {IN: np.asarray(cotangent_vector[OUT]) @ self._slopes(inputs)}

    def abstract_eval(self, abstract_inputs: Any) -> dict[str, Any]:
        """Shape of what comes out."""
        return {OUT: ShapeDType(shape=(len(self.function.outputs),), dtype="float64")}

    def _checked(self, point: Any) -> Any:
        """A point within what was trained; the errors of a schema are the only ones whose text a client gets."""
        if not isinstance(point, ShapeDType):  # of which alone ``abstract_eval`` knows
            self.function.check(np.asarray(point))
        return point

    def _slopes(self, inputs: Any) -> np.ndarray:
        return self.function.jacobian(np.asarray(getattr(inputs, IN)))


def tesseract_api(model: AnsweringModel) -> ModuleType:
    """The API of a model, a module; ``Tesseract.from_tesseract_api`` takes it as it is.

    What ``tesseract build`` asks for is a file ``tesseract_api.py`` of three lines::

        import hhr_dolfinx as hhr
        from hhr_dolfinx.plugins.doors.tesseract import tesseract_api

        globals().update(vars(tesseract_api(hhr.load_model("model.npz"))))

    Args:
        model: see :class:`~hhr_dolfinx.plugins.doors.function.OutputFunction`.
    """
    made = Endpoints(model)
    api = ModuleType("tesseract_api", "Contact problem of a condensed or reduced model.")
    given: dict[str, Any] = {
        "InputSchema": made.inputs,
        "OutputSchema": made.outputs,
        "abstract_eval": made.abstract_eval,
    }
    names = ("apply", "jacobian", "jacobian_vector_product", "vector_jacobian_product")
    vars(api).update(given | {name: getattr(made, name) for name in names})
    return api
