"""Outputs: numbers that a scene is asked for, by name; each says how it is read from forces and displacement.

An output of a user's own is one class with a name, a unit and a method ``prepared``, see :class:`Output`. Forces and
areas are those of the whole turn in axisymmetry, and per unit depth in the plane. Where shapes depend on parameters,
places and boxes are those of the mesh in the middle of the parameters' box: an output stays with its nodes and cells.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.models.functionals.functional import Functional
from hhr_dolfinx.models.functionals.kinds import Largest, Linear, Loaded
from hhr_dolfinx.parameters import Tag, as_tuple, check_tag, is_number, is_whole

if TYPE_CHECKING:
    import ufl

    from hhr_dolfinx.loads import Assembler

_NOWHERE = np.zeros(0, dtype=np.int64)
_NOTHING = np.zeros(0)


class Output(Protocol):
    """An output; its name, its unit, and what it is made of.

    Attributes:
        name: by which it is read.
        unit: of its value, as text.
    """

    name: str
    unit: str

    def prepared(self, probe: Any) -> Functional:
        """As plain data; SceneError for what the model does not have."""


@dataclass(frozen=True)
class _Output:
    """What outputs have in common.

    Attributes:
        name: by which it is read.
        unit: of its value, as text.
        vectors: names of fields that hold coordinates or components.
    """

    vectors: ClassVar[tuple[str, ...]] = ()

    name: str
    unit: str = field(default="", kw_only=True)

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.strip():
            raise SceneError(f"the name {self.name!r} of an output must be a text")
        if not isinstance(self.unit, str):
            raise SceneError(f"output '{self.name}': the unit {self.unit!r} must be a text")
        for name in self.vectors:
            value = getattr(self, name)
            if value is not None:
                items = as_tuple(f"{name} of output '{self.name}'", value)
                if not items or not all(is_number(item) for item in items):
                    raise SceneError(f"output '{self.name}': {name} = {value!r} must hold finite numbers")
                object.__setattr__(self, name, tuple(float(item) for item in items))


@dataclass(frozen=True)
class _OfContact(_Output):
    """What outputs of a contact have in common.

    Attributes:
        contact: place of the pair in ``Scene.contacts``.
    """

    contact: int

    def __post_init__(self) -> None:
        super().__post_init__()
        if not is_whole(self.contact, 0):
            raise SceneError(
                f"output '{self.name}': contact {self.contact!r} must be the place of a pair in Scene.contacts, from 0"
            )


@dataclass(frozen=True)
class LargestPressure(_OfContact):
    """Largest contact pressure of a contact: force over tributary area."""

    def prepared(self, probe: Any) -> Functional:
        """See :class:`Output`."""
        return Largest(self.name, self.unit, *_no_rows(), *probe.loaded(self))


@dataclass(frozen=True)
class ContactForce(_OfContact):
    """Component of the resultant of a contact on the body of its first surface, the slave.

    Attributes:
        direction: of the component; its length does not matter. In axisymmetry the first component sums radial forces
            around the whole turn.
    """

    vectors: ClassVar[tuple[str, ...]] = ("direction",)

    direction: tuple[float, ...]

    def prepared(self, probe: Any) -> Functional:
        """See :class:`Output`."""
        conditions, points, forces = probe.nodal_forces(self)
        along = np.tile(_unit(self, "direction", probe.dimension), len(points))
        return Linear.of(self.name, self.unit, conditions, forces @ along)


@dataclass(frozen=True)
class ContactMoment(_OfContact):
    """Component of the moment of a contact on the body of its first surface, the slave.

    Attributes:
        about: the point about which it turns.
        axis: of the component in space; None in the plane, where it points out of it.
    """

    vectors: ClassVar[tuple[str, ...]] = ("about", "axis")

    about: tuple[float, ...]
    axis: tuple[float, ...] | None = None

    def prepared(self, probe: Any) -> Functional:
        """See :class:`Output`."""
        if probe.scene.hypothesis == "axisymmetric":
            raise SceneError(
                f"output '{self.name}': the moment of an axisymmetric contact without friction vanishes. Ask for the "
                "Torque that friction can bear"
            )
        conditions, points, forces = probe.nodal_forces(self)
        arms = points - _place(self, "about", probe.dimension)
        if probe.dimension == 2:
            _no_axis(self)
            turned = np.column_stack([-arms[:, 1], arms[:, 0]])
        else:
            turned = np.cross(_unit(self, "axis", 3), arms)
        return Linear.of(self.name, self.unit, conditions, forces @ turned.ravel())


@dataclass(frozen=True)
class Torque(_OfContact):
    """Torque about an axis that friction can bear: friction times the sum of forces times distances to the axis.

    Attributes:
        friction: coefficient of friction.
        origin: a point of the axis; None in axisymmetry, where the axis is that of the scene.
        axis: its direction in space; None in the plane, where it points out of it.
    """

    vectors: ClassVar[tuple[str, ...]] = ("origin", "axis")

    friction: float
    origin: tuple[float, ...] | None = None
    axis: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not is_number(self.friction) or self.friction < 0:
            raise SceneError(f"output '{self.name}': the friction {self.friction!r} must be a number, not negative")

    def prepared(self, probe: Any) -> Functional:
        """See :class:`Output`."""
        conditions = probe.conditions(self)
        dim = probe.dimension
        points = probe.problem.contact_points[conditions]
        if probe.scene.hypothesis == "axisymmetric":
            _no_axis(self)
            if self.origin is not None:
                raise SceneError(f"output '{self.name}': the axis of an axisymmetric scene is given, leave out origin")
            distances = np.abs(points[:, 0])
        else:
            arms = points - _place(self, "origin", dim)
            if dim == 2:
                _no_axis(self)
                distances = np.linalg.norm(arms, axis=1)
            else:
                distances = np.linalg.norm(np.cross(_unit(self, "axis", 3), arms), axis=1)
        return Linear.of(self.name, self.unit, conditions, float(self.friction) * distances)


@dataclass(frozen=True)
class FrictionForce(_OfContact):
    """Component of the resultant of the tangential forces of a contact on the body of its first surface, the slave.

    Attributes:
        direction: of the component, see :class:`ContactForce`, which holds pressures and friction together.
    """

    vectors: ClassVar[tuple[str, ...]] = ("direction",)

    direction: tuple[float, ...]

    def prepared(self, probe: Any) -> Functional:
        """See :class:`Output`."""
        _, friction = probe.sliding(self)
        conditions, points, forces = probe.nodal_forces(self)
        own = np.isin(conditions, friction.tangential)
        along = np.tile(_unit(self, "direction", probe.dimension), len(points))
        return Linear.of(self.name, self.unit, conditions[own], (forces @ along)[own])


@dataclass(frozen=True)
class LargestSlip(_OfContact):
    """Largest length that a node of a contact has slipped up to now, back and forth added up."""

    def prepared(self, probe: Any) -> Functional:
        """See :class:`Output`."""
        return _remembered(self, probe, "path", largest=True)


@dataclass(frozen=True)
class DissipatedWork(_OfContact):
    """Energy that friction of a contact has dissipated up to now."""

    def prepared(self, probe: Any) -> Functional:
        """See :class:`Output`."""
        return _remembered(self, probe, "work", largest=False)


@dataclass(frozen=True)
class LargestWear(_OfContact):
    """Largest depth of wear up to now by Archard's law: a constant times the pressure along the length slipped.

    It is a number beside the answer: gaps do not grow by it.

    Attributes:
        constant: wear depth per pressure and length.
    """

    constant: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if not is_number(self.constant) or self.constant < 0:
            raise SceneError(f"output '{self.name}': the constant {self.constant!r} must be a number, not negative")

    def prepared(self, probe: Any) -> Functional:
        """See :class:`Output`."""
        return _remembered(self, probe, "wear", largest=True, factor=float(self.constant))


@dataclass(frozen=True)
class StickArea(_OfContact):
    """Area of a contact that touches and sticks, see :class:`ContactWidth`."""

    sticks: ClassVar[bool] = True

    def prepared(self, probe: Any) -> Functional:
        """See :class:`Output`."""
        from hhr_dolfinx.models.functionals.friction import StatusArea

        own, friction = probe.sliding(self)
        return StatusArea(self.name, self.unit, *_no_rows(), own, friction.area[own], self.sticks)


@dataclass(frozen=True)
class SlipArea(StickArea):
    """Area of a contact that touches and slips."""

    sticks: ClassVar[bool] = False


def _remembered(output: Any, probe: Any, quantity: str, *, largest: bool, factor: float = 1.0) -> Functional:
    """What friction remembers of the contact of an output."""
    from hhr_dolfinx.models.functionals.friction import Remembered

    own, _ = probe.sliding(output)
    return Remembered(output.name, output.unit, *_no_rows(), own, quantity, factor, largest)


@dataclass(frozen=True)
class ContactWidth(_OfContact):
    """Area under load of a contact: a width per unit depth in the plane, the area of the whole turn in axisymmetry.

    What bears less than a thousandth of the largest pressure of the contact does not count. It changes by steps of a
    cell, and its derivatives are zero but for those of the shape of the cells.
    """

    def prepared(self, probe: Any) -> Functional:
        """See :class:`Output`."""
        conditions, areas = probe.loaded(self)
        return Loaded(self.name, self.unit, *_no_rows(), conditions, areas, 0.0, 1.0)


@dataclass(frozen=True)
class LostContact(_OfContact):
    """Share of the area of a contact that is not under load, from 0 to 1; see :class:`ContactWidth`."""

    def prepared(self, probe: Any) -> Functional:
        """See :class:`Output`."""
        conditions, areas = probe.loaded(self)
        return Loaded(self.name, self.unit, *_no_rows(), conditions, areas, 1.0, -1.0 / float(areas.sum()))


@dataclass(frozen=True)
class GapAt(_OfContact):
    """Gap of the contact condition nearest to a place; zero where it touches.

    Attributes:
        place: coordinates.
    """

    vectors: ClassVar[tuple[str, ...]] = ("place",)

    place: tuple[float, ...]

    def prepared(self, probe: Any) -> Functional:
        """See :class:`Output`."""
        conditions = probe.conditions(self)
        problem = probe.problem
        nearest = conditions[probe.at_place(self, probe.base.contact_points[conditions])[0]]
        row = problem.contact[[nearest]]
        # gaps are those that lifts leave, and the row reads them in the displacement too where bodies are lifted whole
        gaps = problem.gaps[nearest] + (row @ problem.lifts).toarray()[0]
        terms = probe.terms(gaps)
        return Linear.of(self.name, self.unit, row=-row, terms=terms, coefficients=gaps[terms])


@dataclass(frozen=True)
class DisplacementAt(_Output):
    """Component of the displacement of the node nearest to a place.

    Attributes:
        place: coordinates.
        component: 0, 1 or 2.
        tag: cell tag of the body that is meant, where nodes of several lie at the place.
    """

    vectors: ClassVar[tuple[str, ...]] = ("place",)

    place: tuple[float, ...]
    component: int
    tag: Tag | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not is_whole(self.component, 0) or self.component > 2:
            raise SceneError(f"output '{self.name}': the component {self.component!r} must be 0, 1 or 2")

    def prepared(self, probe: Any) -> Functional:
        """See :class:`Output`."""
        problem = probe.problem
        dim = probe.dimension
        if self.component >= dim:
            raise SceneError(f"output '{self.name}': the mesh has {dim} components, none is {self.component}")
        nodes = np.arange(len(problem.points)) if self.tag is None else probe.nodes(self.tag)
        points = probe.base.points[nodes]
        found = nodes[probe.at_place(self, points)]
        if found.size > 1:
            # bodies in contact have nodes at one place, which move apart
            tags = [body.tag for body in probe.scene.bodies if np.isin(found, probe.nodes(body.tag)).any()]
            node = probe.base.points[found[0]][:dim]
            near = tuple(
                float(f"{value:.6g}") for value in np.where(np.abs(node) > 1e-9 * np.abs(points).max(), node, 0)
            )
            remedy = f"move the place to one of them, such as {near}"
            raise SceneError(
                f"output '{self.name}': {found.size} nodes, of bodies {tags}, are equally near to the place "
                f"{self.place}: " + (f"name the body, tag=..., or {remedy}" if len(tags) > 1 else remedy)
            )
        dof = dim * found[0] + self.component
        return Linear.of(self.name, self.unit, row=csr_matrix(([1.0], ([0], [dof])), shape=(1, problem.free.size)))


@dataclass(frozen=True)
class VonMises(_Output):
    """Von Mises' equivalent stress of a body: in the middles of its cells, or at their Gauss points where bodies flow.

    Attributes:
        tag: cell tag of the body.
        kind: ``max``, or ``mean`` over the volume.
        where: two corners of a box; cells whose middle lies inside count. None for the whole body.
    """

    tag: Tag
    kind: str = "max"
    where: tuple[Sequence[float], Sequence[float]] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_tag(f"body of output '{self.name}'", self.tag)
        if self.kind not in ("max", "mean"):
            raise SceneError(f"output '{self.name}': the kind {self.kind!r} must be 'max' or 'mean'")
        if self.where is not None:
            corners = as_tuple(f"where of output '{self.name}'", self.where)
            box = [as_tuple(f"a corner of where of output '{self.name}'", corner) for corner in corners]
            if len(box) != 2 or not all(is_number(value) for corner in box for value in corner):
                raise SceneError(f"output '{self.name}': where = {self.where!r} must be two corners, (lower, upper)")
            object.__setattr__(self, "where", tuple(box))

    def prepared(self, probe: Any) -> Functional:
        """See :class:`Output`."""
        return probe.mises(self)


@dataclass(frozen=True)
class ElasticEnergy(_Output):
    """Elastic energy of all bodies, by the work of all forces; where nothing flows.

    A reduced model has it with the errors of its forces and displacement.
    """

    def prepared(self, probe: Any) -> Functional:
        """See :class:`Output`."""
        return probe.energy(self)


@dataclass(frozen=True)
class LinearForm(_Output):
    """A form that is linear in the displacement, such as its mean over a surface.

    Attributes:
        form: function of an :class:`~hhr_dolfinx.loads.Assembler` that returns a UFL form, linear in its ``test``,
            which stands for the displacement: ``lambda a: a.test[0] * a.ds(TAG)``. In axisymmetry give it the weight
            :func:`hhr_dolfinx.forms.elasticity.volume_weight`.
    """

    form: Callable[[Assembler], ufl.Form]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not callable(self.form):
            raise SceneError(f"output '{self.name}': the form {self.form!r} must be a function of an Assembler")

    def prepared(self, probe: Any) -> Functional:
        """See :class:`Output`."""
        vector = probe.assembler.vector(self.form(probe.assembler))
        return Linear.of(self.name, self.unit, row=csr_matrix(vector[None]))


def _place(output: Any, name: str, dim: int) -> np.ndarray:
    """A vector of an output, (dim,)."""
    value = getattr(output, name)
    if value is None or len(value) != dim:
        raise SceneError(f"output '{output.name}': {name} = {value} must have {dim} components, as the mesh")
    return np.array(value)


def _unit(output: Any, name: str, dim: int) -> np.ndarray:
    """A vector of an output, with the length 1."""
    vector = _place(output, name, dim)
    length = np.linalg.norm(vector)
    if length == 0:
        raise SceneError(f"output '{output.name}': {name} = {getattr(output, name)} must not be zero")
    return vector / length


def _no_axis(output: Any) -> None:
    if output.axis is not None:
        raise SceneError(f"output '{output.name}': an axis is for meshes in space, leave it out")


def _no_rows() -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
    return 0, _NOWHERE, _NOWHERE, _NOTHING
