"""A model as a pyMOR model, for its algorithms of optimisation, calibration and sampling (pymor >= 2026.1).

``solution`` is the displacement on the whole mesh, ``output`` the outputs of the scene, ``output_d_mu`` their exact
derivatives, ``solution_error_estimate`` the bound of the displacement in the energy norm, and
``output_error_estimate`` the bounds of the outputs.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hhr_dolfinx.compat import extra
from hhr_dolfinx.errors import BoundError
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.model import AnsweringModel
from hhr_dolfinx.plugins.doors.function import OutputFunction

with extra("doors", "a model of pyMOR"):
    from pymor.models.interface import Model, OutputDMuResult
    from pymor.vectorarrays.numpy import NumpyVectorSpace


class PyMORModel(Model):
    """A model with the interface of pyMOR, in which each parameter of the scene has dimension one.

    Args:
        model, outside: see :class:`~hhr_dolfinx.plugins.doors.function.OutputFunction`.
        name: of the model.

    Raises:
        BoundError: if an error estimate is requested and the model has none.
    """

    def __init__(self, model: AnsweringModel, name: str = "contact", outside: str = "refuse"):
        super().__init__(name=name)
        self.model = model
        self.outside = outside  # pyMOR requires all arguments as attributes
        self.function = OutputFunction(model, outside)
        space = model.parameters
        self.parameters_own = dict.fromkeys(self.function.names, 1)
        self.solution_space = NumpyVectorSpace(model.solve(space.middle, outside="ignore").displacement().size)
        self.dim_output = len(self.function.outputs)

    def _compute(self, quantities: set[Any], data: dict[Any, Any], mu: Mapping[str, np.ndarray]) -> None:
        point = np.array([mu[name][0] for name in self.function.names])
        how: dict[str, Any] = {"gradient": "output_d_mu" in quantities, "outside": self.outside}
        answer = self.function.model.solve(point, **how)
        if "solution" in quantities:
            data["solution"] = self.solution_space.from_numpy(answer.displacement()[:, None])
        found = answer.outputs()
        names = self.function.outputs
        if "output" in quantities:
            data["output"] = np.array([[found[name]] for name in names])
        if "output_d_mu" in quantities:
            assert found.gradient is not None
            slopes = np.array([found.gradient[name] for name in names])
            by_name = {(name, 0): slopes[:, [k]] for k, name in enumerate(self.function.names)}
            data["output_d_mu"] = OutputDMuResult(by_name)
        if quantities & {"solution_error_estimate", "output_error_estimate"}:
            self._estimate(answer, data)
        quantities -= {"solution", "output", "output_d_mu", "solution_error_estimate", "output_error_estimate"}
        super()._compute(quantities, data, mu)

    def _estimate(self, answer: Answer, data: dict[Any, Any]) -> None:
        """Compute error estimates; infinite for an output without one."""
        known = answer.estimate()
        if known is None:
            raise BoundError(f"nothing is known of the errors of these answers: {answer.fields.unbounded}")
        data["solution_error_estimate"] = np.array([known.primal])
        data["output_error_estimate"] = np.array([[known.outputs.get(name, np.inf)] for name in self.function.outputs])
