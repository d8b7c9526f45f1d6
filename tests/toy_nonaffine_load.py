"""A load of a user's own, in one file: a traction that grows with the square of a parameter."""

from dataclasses import dataclass

import numpy as np

import hhr_dolfinx as hhr
from hhr_dolfinx.forms.elasticity import traction
from hhr_dolfinx.loads import Assembler


@dataclass(frozen=True)
class Square:
    """The amplitude ``factor * mu^2`` of one column; ``place`` is that of the parameter mu."""

    place: int
    factor: float
    count = 1

    def __call__(self, point: np.ndarray) -> tuple[list[int], list[float]]:
        """Its column and its value; see :class:`hhr_dolfinx.amplitudes.NonAffine`."""
        return [0], [self.factor * point[self.place] ** 2]


@dataclass(frozen=True)
class WindLoad:
    """Surface force ``factor * speed^2 * direction`` per area on tagged facets.

    ``speed`` names its parameter.
    """

    tag: int
    direction: tuple[float, ...]
    factor: float
    speed: str

    def terms(self, assembler: Assembler) -> list[hhr.Term]:
        """One vector."""
        form = traction(
            assembler.test, self.direction, assembler.hypothesis, assembler.ds(self.tag)
        )
        square = Square(assembler.parameters.names.index(self.speed), self.factor)
        return [hhr.Term(square, assembler.vector(form))]
