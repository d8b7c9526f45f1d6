"""Output of scenes whose stiffness was not compared with a solved case."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.models.functionals.functional import Functional
from hhr_dolfinx.models.functionals.kinds import Linear
from hhr_dolfinx.outputs import ModelProbe, NamedOutput


@dataclass(frozen=True)
class UncheckedStiffness(NamedOutput):
    """The number 1 in each answer, also in tables, pages, C and FMI: K was not compared with a
    solved case.
    """

    name: str = "unchecked stiffness"

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`~hhr_dolfinx.outputs.Output`."""
        return Linear.of(
            self.name, self.unit, terms=np.zeros(1, dtype=np.int64), coefficients=np.ones(1)
        )
