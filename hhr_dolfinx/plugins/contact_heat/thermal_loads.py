"""Heat as loads of a scene, whose further parameters are heat flows and levels."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from hhr_dolfinx.amplitudes import Amplitude
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.formulas import box_samples, formula_of
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.loads import Assembler, Term
from hhr_dolfinx.parameters import ParameterSpace, Tag
from hhr_dolfinx.plugins.contact_heat.conduction import HeatSystem, temperature_space
from hhr_dolfinx.plugins.contact_heat.heat import Heat
from hhr_dolfinx.plugins.contact_heat.parts import Conduction

if TYPE_CHECKING:
    from ufl.core.expr import Expr

    from hhr_dolfinx.parameters import PointLike
    from hhr_dolfinx.scene import Scene

CHECKED_POINTS = 16
"""Points of the box at which sizes of heat flows are looked at."""
FLOW = "heat_of_condition_"
LEVEL = "level_of_body_"
"""Beginnings of the names of heat flows and of temperatures of bodies, as parameters of loads."""
ROOM = 10.0
"""Ends of these parameters over heat flows and temperatures that contact without resistance has."""


class ShownTemperature:
    """Temperatures whose strain stresses leave out, those of the answer that is shown.

    Args:
        heat: heat of the scene.
    """

    def __init__(self, heat: Heat):
        self._heat = heat
        self._lock = threading.Lock()
        self._field: fem.Function | None = None

    @contextmanager
    def of(self, field: fem.Function) -> Iterator[None]:
        """Show temperatures in a block of one thread at a time.

        Args:
            field: temperatures on the mesh whose stresses are requested.
        """
        with self._lock:
            self._field = field
            try:
                yield
            finally:
                self._field = None

    def strain(self, tag: Tag) -> tuple[Amplitude, Expr] | None:
        """Amplitude and strain of a body; None for one that does not expand.

        Args:
            tag: the body.

        Raises:
            NotOfferedError: outside a block, where outputs are prepared.
        """
        if tag not in self._heat.expansion:
            return None
        if self._field is None:
            raise NotOfferedError(
                "outputs read stress or energy of a body that expands by heat through contacts: "
                "leave them out, answer.stress() has the stress"
            )
        excess = self._field - self._heat.reference_of(tag)
        return Amplitude(1.0), self._heat.expansion[tag] * excess * ufl.Identity(3)


@dataclass(frozen=True)
class _GivenTerms:
    """Nodal forces with amplitudes, as a load whose strain stresses leave out."""

    given: Sequence[Term]
    shown: ShownTemperature

    def terms(self, assembler: Assembler) -> list[Term]:
        """These terms."""
        return list(self.given)

    def eigenstrain_of(self, tag: Tag, mesh: ufl.Mesh) -> tuple[Amplitude, Expr] | None:
        """Strain by the temperatures that are shown; None for a body that does not expand.

        Args:
            tag: the body.
            mesh: UFL mesh of the scene.
        """
        return self.shown.strain(tag)

    def __repr__(self) -> str:
        return f"the thermal forces of {len(self.given)} heat flows and supplies"


@dataclass(frozen=True)
class _NoForce:
    """A load without force that names parameters."""

    names: tuple[str, ...]

    def terms(self, assembler: Assembler) -> list[Term]:
        """No force."""
        amplitude = Amplitude(slopes=dict.fromkeys(self.names, 1.0))
        return [Term(amplitude, np.zeros(assembler.size))]


class HeatedFullOrder(FullOrderModel):
    """Full order whose further parameters are heat flows and levels; its stresses leave out the
    thermal strain.

    Args:
        scene: the scene of the user.
        augmented: this scene with the further parameters.
        conduction: temperatures of the scene.
        shown: temperatures of the load of the scene.
    """

    def __init__(
        self, scene: Scene, augmented: Scene, conduction: Conduction, shown: ShownTemperature
    ):
        super().__init__(augmented, MPI.COMM_SELF)
        self._count = len(scene.parameters.names)
        self._conduction = conduction
        self._shown = shown
        self._space, self._node = temperature_space(self.discretisation)

    def stress_of(self, displacement: np.ndarray, mu: PointLike | None = None) -> np.ndarray:
        """Stress in the middle of each cell, see
        :meth:`hhr_dolfinx.full_order.full.FullOrderModel.stress_of`.

        Args:
            displacement: the displacement, (N,).
            mu: parameters, with heat flows and levels, (P + m + b,); None for the middle.
        """
        # flows and levels are answers: the box, which scales claims, does not bound them
        point = self.problem.middle if mu is None else np.asarray(mu, dtype=float)
        field = fem.Function(self._space)
        field.x.array[:] = self._conduction.temperature(point, self._count)[self._node]
        with self._shown.of(field):
            return self.discretisation.stress(displacement, point)


def augmented(
    scene: Scene, system: HeatSystem, conduction: Conduction, shown: ShownTemperature
) -> Scene:
    """The scene whose further parameters are heat flows and levels; supplies are loads.

    Args:
        scene: the scene of the user.
        system: its heat.
        conduction: its heat, eliminated.
        shown: temperatures whose strain its stresses leave out.
    """
    flows = [f"{FLOW}{k}" for k in range(conduction.per_heat.shape[1])]
    levels = [f"{LEVEL}{k}" for k in range(conduction.levels.shape[1])]
    space = scene.parameters
    added = [*flows, *levels]
    flow, level = _sizes(space, conduction)
    ends = np.repeat([ROOM * flow, ROOM * level], [len(flows), len(levels)])
    wide = ParameterSpace(
        (*space.names, *added),
        (*space.lower, *(-ends)),
        (*space.upper, *ends),
    )
    expansion = system.expansion
    columns = np.hstack([-conduction.per_heat, conduction.levels])
    terms = [Term(Amplitude(1.0), system.at_rest)]
    terms += [
        Term(formula_of(scalar.text, "an amplitude"), expansion @ field)
        for scalar, field in zip(conduction.amplitudes, conduction.temperatures.T, strict=True)
    ]
    terms += [
        Term(Amplitude(slopes={name: 1.0}), expansion @ column)
        for name, column in zip(added, columns.T, strict=True)
    ]
    named = naming_all(scene)
    return replace(named, parameters=wide, loads=(*named.loads, _GivenTerms(tuple(terms), shown)))


def _sizes(space: ParameterSpace, conduction: Conduction) -> tuple[float, float]:
    """Largest heat flow of a condition and largest temperature where contacts have no resistance,
    at points of the box; 1 where there are none.
    """
    supplies = np.array(
        [conduction.supplies(point) for point in box_samples(space)[:CHECKED_POINTS]]
    )
    temperatures = np.abs(supplies @ conduction.temperatures.T).max(initial=0.0)
    jumps = np.abs(supplies @ (conduction.jumps @ conduction.temperatures).T).max(initial=0.0)
    supplied = np.abs(supplies @ conduction.supplied.T).max(initial=0.0)
    compliance = (conduction.jumps @ conduction.per_heat).diagonal().mean()
    flow = max(float(jumps / compliance) if compliance > 0 else 0.0, float(supplied))
    level = max(float(temperatures), float(supplied * max(compliance, 0.0)))
    return flow or 1.0, level or 1.0


def naming_all(scene: Scene) -> Scene:
    """The scene with a load of no force that names all parameters, as heat may depend on those that
    nothing else does.

    Args:
        scene: the scene.
    """
    return replace(scene, loads=(*scene.loads, _NoForce(scene.parameters.names)))
