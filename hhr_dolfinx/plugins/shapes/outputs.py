"""Outputs of a full model whose shape depends on parameters: prepared on the mesh of each shape."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.contact.problem import ContactProblem, Reshaping
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.full_order.outputs import prepared_outputs, probe_of
from hhr_dolfinx.models.functionals.functional import Functional, Functionals
from hhr_dolfinx.outputs import ModelProbe, Output
from hhr_dolfinx.plugins.shapes.cells import MovingCells
from hhr_dolfinx.plugins.shapes.functionals import MovingMises, OverShapes
from hhr_dolfinx.plugins.stress.kinds import Mises

if TYPE_CHECKING:
    from hhr_dolfinx.full_order.discrete_space import DiscreteSpace
    from hhr_dolfinx.models.histories.equilibrium import LawsAtPlaces

MakeCells = Callable[[np.ndarray, bool], MovingCells]
KEPT_SHAPES = 8
"""Number of shapes whose outputs a full model keeps."""


class FullShapeFunctionals(OverShapes):
    """Outputs of a full model with variable shape, prepared on the mesh at a point.

    See :class:`~hhr_dolfinx.models.functionals.functional.AllOutputs`. ``moving`` as of
    :class:`MovingProbe`, the problem that of the middle of the box. SceneError for an output that
    the model does not support.
    """

    def __init__(
        self,
        discretisation: DiscreteSpace,
        reshaped: Reshaping,
        moving: MakeCells,
        problem: ContactProblem,
    ):
        self.axes = np.array(reshaped.axes, dtype=np.int64)
        self.parameters = problem.parameters
        self.amplitudes = problem.amplitudes
        self._discretisation = discretisation
        self._reshaped = reshaped
        self._moving = moving
        self._base = problem
        self._prepared = lru_cache(maxsize=KEPT_SHAPES)(self._made)
        self.items = self.at(problem.middle).items

    def at(self, point: np.ndarray) -> Functionals:
        """Outputs for the shape at a point, (P,)."""
        return self._prepared(np.ascontiguousarray(point[self.axes], dtype=float).tobytes())

    def _made(self, key: bytes) -> Functionals:
        """Outputs for values of the parameters of the shape.

        The other parameters do not change their arrays.
        """
        point = self._base.middle
        point[self.axes] = np.frombuffer(key)
        problem = self._reshaped(point)
        with self._reshaped.at(point):
            laws = self._discretisation.laws()
            probes = [
                self._probe(output, problem, laws) for output in self._discretisation.scene.outputs
            ]
            return prepared_outputs(probes)

    def _probe(
        self, output: Output, problem: ContactProblem, laws: LawsAtPlaces | None
    ) -> MovingProbe:
        probe = probe_of(output, self._discretisation, problem, laws, self._base)
        values: dict[str, Any] = {
            attribute.name: getattr(probe, attribute.name) for attribute in fields(probe)
        }
        return MovingProbe(**values, moving=self._moving)


@dataclass(frozen=True)
class MovingProbe(ModelProbe):
    """Interface for an output if shapes are parameters.

    Other terms of θ may act on another shape, and cells move.
    """

    moving: Callable[
        [np.ndarray, bool], MovingCells
    ]  #: makes cells, by their numbers and whether they have the mean dilatation

    def on_cells(self, found: Functional, cells: np.ndarray) -> MovingMises:
        """Von Mises' stress of cells that move.

        Args:
            found: the output on the cells.
            cells: their numbers, (c,).

        Raises:
            SceneError: for another output, and for user-defined elasticity or strain without
                stress.
        """
        discretisation = self.discretisation
        number = int(discretisation.cell_bodies()[cells[0]])
        body = discretisation.scene.bodies[number]
        if type(found) is not Mises or discretisation.scene.states_stress(body):
            raise SceneError(
                f"output '{found.name}': body {body.tag} has a user-defined elasticity, or a "
                "strain that causes no stress, for whose von Mises' stress shapes are not built "
                "in: leave the output out"
            )
        mean = discretisation.mean_dilatation[number]
        return MovingMises(
            **{attribute.name: getattr(found, attribute.name) for attribute in fields(found)},
            cells=self.moving(cells, mean),
        )

    def terms(self, entries: np.ndarray) -> np.ndarray:
        """All terms of θ."""
        return np.arange(entries.size)
