"""A model as a function of OpenTURNS, vectorised over samples, with its exact gradient (openturns >= 1.20)."""

from __future__ import annotations

from typing import Any

import numpy as np

from hhr_dolfinx.compat import extra
from hhr_dolfinx.models.model import AnsweringModel
from hhr_dolfinx.plugins.doors.function import OutputFunction

with extra("doors", "a function of OpenTURNS"):
    import openturns


def openturns_function(model: AnsweringModel, outside: str = "refuse") -> Any:
    """The outputs of a scene as an ``openturns.Function`` of its parameters, see :class:`OutputFunction`."""
    function = OutputFunction(model, outside)
    made = openturns.PythonFunction(
        len(function.names),
        len(function.outputs),
        func=lambda point: function(np.array(point))[0].tolist(),
        func_sample=lambda points: function(np.array(points)).tolist(),
        # OpenTURNS expects a row for each parameter
        gradient=lambda point: function.jacobian(np.array(point)).T.tolist(),
    )
    made.setInputDescription(function.names)
    made.setOutputDescription(function.outputs)
    return made
