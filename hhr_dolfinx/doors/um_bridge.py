"""A model as one of UM-Bridge, for programs of uncertainty quantification that ask by HTTP (umbridge >= 1.2).

One input, the parameters, and one output, the outputs of the scene; gradients and products with the Jacobian are exact.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hhr_dolfinx.compat import extra
from hhr_dolfinx.doors.function import OutputFunction

with extra("doors", "a server of UM-Bridge"):
    import umbridge

Vectors = list[list[float]]


class UMBridgeModel(umbridge.Model):
    """A model behind UM-Bridge's interface; ``umbridge.serve_models([UMBridgeModel(model)], 4242)`` serves it.

    Args:
        model: see :class:`~hhr_dolfinx.doors.function.OutputFunction`.
        name: under which it is asked.
    """

    def __init__(self, model: Any, name: str = "forward"):
        super().__init__(name)
        self.function = OutputFunction(model)

    def get_input_sizes(self, config: dict[str, Any]) -> list[int]:
        """Number of parameters."""
        return [len(self.function.names)]

    def get_output_sizes(self, config: dict[str, Any]) -> list[int]:
        """Number of outputs."""
        return [len(self.function.outputs)]

    def __call__(self, parameters: Vectors, config: dict[str, Any]) -> Vectors:
        """Outputs at a point."""
        return [self.function(parameters[0])[0].tolist()]

    def gradient(
        self, out_wrt: int, in_wrt: int, parameters: Vectors, sens: list[float], config: dict[str, Any]
    ) -> list[float]:
        """Weights of the outputs times the Jacobian."""
        return (np.asarray(sens) @ self.function.jacobian(parameters[0])).tolist()

    def apply_jacobian(
        self, out_wrt: int, in_wrt: int, parameters: Vectors, vec: list[float], config: dict[str, Any]
    ) -> list[float]:
        """The Jacobian times a direction."""
        return (self.function.jacobian(parameters[0]) @ np.asarray(vec)).tolist()

    def supports_evaluate(self) -> bool:
        """Yes."""
        return True

    def supports_gradient(self) -> bool:
        """Yes."""
        return True

    def supports_apply_jacobian(self) -> bool:
        """Yes."""
        return True
