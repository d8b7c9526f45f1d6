"""A load of a user's own, in one file: the weight of a body."""

from dataclasses import dataclass

import ufl

import hhr_dolfinx as hhr
from hhr_dolfinx.forms.elasticity import volume_weight
from hhr_dolfinx.loads import Assembler


@dataclass(frozen=True)
class Weight:
    """Force ``amplitude(mu) * direction`` per volume of a body.

    Attributes:
        body: cell tag.
        direction: of gravity.
        amplitude: density times gravity.
    """

    body: int
    direction: tuple[float, ...]
    amplitude: hhr.Amplitude

    def terms(self, assembler: Assembler) -> list[hhr.Term]:
        """One vector."""
        dx = assembler.dx(self.body)
        weight = volume_weight(dx.ufl_domain(), assembler.hypothesis)
        form = weight * ufl.inner(ufl.as_vector(self.direction), assembler.test) * dx
        return [hhr.Term(self.amplitude, assembler.vector(form))]
