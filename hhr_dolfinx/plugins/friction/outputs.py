"""Outputs of contacts with friction, and the torque that friction can bear.

See :mod:`hhr_dolfinx.outputs`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.models.functionals.functional import Functional
from hhr_dolfinx.models.functionals.kinds import Linear
from hhr_dolfinx.outputs import ModelProbe, OfContact, no_axis, no_rows, place_of, unit_vector
from hhr_dolfinx.parameters import is_number
from hhr_dolfinx.plugins.friction.functionals import Remembered, RememberedShare, StatusArea
from hhr_dolfinx.plugins.friction.laws import Friction


@dataclass(frozen=True)
class Torque(OfContact):
    """Largest torque about an axis that friction can bear, the sum of f λ |(a × r)_t|: all contacts
    slip the way the bodies turn.

    a is the axis, r the arm of a contact, and _t its part in the tangent plane, in which friction
    acts. The force λ is that of the answer, and friction of the pair is not read.

    Attributes:
        friction: coefficient of friction, f.
        origin: a point of the axis; None in axisymmetry, for the axis of the scene.
        axis: direction of the axis in space; None in the plane, for the normal of the plane.
    """

    vectors: ClassVar[tuple[str, ...]] = ("origin", "axis")

    friction: float
    origin: tuple[float, ...] | None = None
    axis: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not is_number(self.friction) or self.friction < 0:
            raise SceneError(
                f"output '{self.name}': the friction {self.friction!r} must be a number, not "
                "negative"
            )

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`Output`.

        Raises:
            SceneError: for an axis that does not fit the scene.
        """
        conditions = probe.conditions(self)
        dim = probe.dimension
        points = probe.problem.contact_points[conditions]
        normals = _normals(self, probe, conditions)
        if probe.scene.hypothesis == "axisymmetric":
            no_axis(self)
            if self.origin is not None:
                raise SceneError(
                    f"output '{self.name}': the axis of an axisymmetric scene is given, leave out "
                    "origin"
                )
            distances = np.abs(points[:, 0])  # friction along the circumference
        else:
            arms = points - place_of(self, "origin", dim)
            if dim == 2:
                no_axis(self)
                distances = np.abs(np.sum(arms * normals, axis=1))
            else:
                ways = np.cross(unit_vector(self, "axis", 3), arms)
                ways -= np.sum(ways * normals, axis=1)[:, None] * normals
                distances = np.linalg.norm(ways, axis=1)
        shares = probe.problem.shares_of(self.contact)[conditions]
        return Linear.of(
            self.name, self.unit, conditions, float(self.friction) * shares * distances
        )


def _normals(output: OfContact, probe: ModelProbe, conditions: np.ndarray) -> np.ndarray:
    """Unit normals of conditions of pressures, (c, dim), of either sign."""
    numbers, points, forces = probe.nodal_forces(output)
    resultants = forces @ np.tile(np.eye(probe.dimension), (len(points), 1))
    normals: np.ndarray = resultants[np.searchsorted(numbers, conditions)]
    return normals / np.linalg.norm(normals, axis=1)[:, None]


@dataclass(frozen=True)
class FrictionForce(OfContact):
    """Component of the resultant of the tangential forces of a contact on the body of its first
    surface, the slave.

    Attributes:
        direction: direction of the component, see :class:`ContactForce`, which is the sum of
            pressures and friction.
    """

    vectors: ClassVar[tuple[str, ...]] = ("direction",)

    direction: tuple[float, ...]

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`Output`."""
        _, friction = _sliding(self, probe)
        conditions, points, forces = probe.nodal_forces(self)
        tangential = np.isin(conditions, friction.tangential)
        along = np.tile(unit_vector(self, "direction", probe.dimension), len(points))
        return Linear.of(self.name, self.unit, conditions[tangential], (forces @ along)[tangential])


@dataclass(frozen=True)
class _Accumulated(OfContact):
    """The largest value, or the sum, of an accumulated quantity of friction in a contact, times a
    constant.
    """

    quantity: ClassVar[str]
    largest: ClassVar[bool] = True

    def prepared(self, probe: ModelProbe) -> Functional:
        contacts, friction = _sliding(self, probe)
        factor = float(getattr(self, "constant", 1.0))
        arguments = self.name, self.unit, *no_rows(), contacts, self.quantity, factor, self.largest
        shares = probe.problem.shares_of(self.contact)[friction.normal[contacts]]
        return (
            Remembered(*arguments)
            if self.largest or (shares == 1.0).all()
            else RememberedShare(*arguments, shares)
        )


@dataclass(frozen=True)
class LargestSlip(_Accumulated):
    """Largest accumulated slip of a node of a contact."""

    quantity: ClassVar[str] = "path"


@dataclass(frozen=True)
class DissipatedWork(_Accumulated):
    """Accumulated energy dissipated by friction of a contact."""

    quantity: ClassVar[str] = "work"
    largest: ClassVar[bool] = False


@dataclass(frozen=True)
class LargestWear(_Accumulated):
    """Largest accumulated wear depth by Archard's law: a constant times the integral of the
    pressure over the slip.

    It is an output only: gaps do not change with it.

    Attributes:
        constant: wear depth per pressure and length.
    """

    quantity: ClassVar[str] = "wear"

    constant: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if not is_number(self.constant) or self.constant < 0:
            raise SceneError(
                f"output '{self.name}': the constant {self.constant!r} must be a number, not "
                "negative"
            )


@dataclass(frozen=True)
class StickArea(OfContact):
    """Area of a contact that touches and sticks, see :class:`ContactWidth`."""

    sticks: ClassVar[bool] = True

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`Output`."""
        contacts, friction = _sliding(self, probe)
        areas = (
            friction.area[contacts]
            * probe.problem.shares_of(self.contact)[friction.normal[contacts]]
        )
        return StatusArea(self.name, self.unit, *no_rows(), contacts, areas, self.sticks)


@dataclass(frozen=True)
class SlipArea(StickArea):
    """Area of a contact that touches and slips."""

    sticks: ClassVar[bool] = False


def _sliding(output: OfContact, probe: ModelProbe) -> tuple[np.ndarray, Friction]:
    """Numbers of the contacts with friction of the pair of an output, and the friction.

    SceneError without any.
    """
    friction = probe.problem.law.of("friction")
    if isinstance(friction, Friction):
        contacts = np.flatnonzero(np.isin(friction.normal, probe.conditions(output)))
        if contacts.size:
            return contacts, friction
    raise SceneError(
        f"output '{output.name}': contact {output.contact} has no friction: give its pair one, "
        "friction=0.3"
    )
