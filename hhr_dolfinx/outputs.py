"""Outputs of a scene: numbers by name, each with the rule to compute it from forces and displacement.

A user-defined output is one class with a name, a unit and a method ``prepared``, see :class:`Output`. Forces and areas
are those of the whole turn in axisymmetry, and per unit depth in the plane. If shapes depend on parameters, positions
and boxes refer to the mesh in the middle of the parameter box: an output stays with its nodes and cells.
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
from hhr_dolfinx.parameters import Tag, as_tuple, is_number, is_whole

if TYPE_CHECKING:
    import ufl

    from hhr_dolfinx.contact.problem import ContactProblem
    from hhr_dolfinx.loads import Assembler

_NOWHERE = np.zeros(0, dtype=np.int64)
_NOTHING = np.zeros(0)


class TaggedBody(Protocol):
    """A body of the scene."""

    @property
    def tag(self) -> Tag:
        """Tag of its cells."""


class ProbedScene(Protocol):
    """The scene, as outputs read it."""

    @property
    def hypothesis(self) -> str:
        """``plane_strain``, ``plane_stress``, ``axisymmetric`` or ``solid``."""

    @property
    def bodies(self) -> Sequence[TaggedBody]:
        """Its bodies."""


class ContactOutput(Protocol):
    """An output of a contact: its name, and the index of the pair in ``Scene.contacts``."""

    @property
    def name(self) -> str: ...  # noqa: D102

    @property
    def contact(self) -> int: ...  # noqa: D102


class PlacedOutput(Protocol):
    """An output at a place: its name, and the coordinates of the place."""

    @property
    def name(self) -> str: ...  # noqa: D102

    @property
    def place(self) -> Sequence[float]: ...  # noqa: D102


class ModelProbe(Protocol):
    """Interface of the finite element model to an output: :class:`hhr_dolfinx.full_order.outputs.Probe`."""

    @property
    def scene(self) -> ProbedScene:
        """The scene."""

    @property
    def problem(self) -> ContactProblem:
        """The contact problem."""

    @property
    def base(self) -> ContactProblem:
        """The same on the mesh in which outputs find places and boxes."""

    @property
    def assembler(self) -> Assembler:
        """Assembler of forms, the one of loads."""

    @property
    def dimension(self) -> int:
        """Components of a displacement."""

    @property
    def nodes(self) -> Callable[[Tag], np.ndarray]:
        """Numbers of the nodes of a body, by its cell tag."""

    @property
    def discretisation(self) -> Any:
        """Mesh and forms, :class:`hhr_dolfinx.full_order.discretisation.Discretisation`."""

    @property
    def laws(self) -> Any:
        """Bodies with laws, or their equilibrium; None for elastic bodies."""

    def on_cells(self, found: Functional, cells: np.ndarray) -> Functional:
        """The functional of an output whose rows are strains of cells, which shapes may move."""

    def conditions(self, output: ContactOutput) -> np.ndarray:
        """Conditions of pressures of the contact of an output, (c,)."""

    def loaded(self, output: ContactOutput) -> tuple[np.ndarray, np.ndarray]:
        """Conditions of this contact that have an area, and their areas, (c,) each."""

    def at_place(self, output: PlacedOutput, points: np.ndarray) -> np.ndarray:
        """Numbers of the points, (n, dim), of ``base`` nearest to the place of an output."""

    def terms(self, entries: np.ndarray) -> np.ndarray:
        """Terms of θ that have entries, (1 + T,)."""

    def nodal_forces(self, output: ContactOutput) -> tuple[np.ndarray, np.ndarray, csr_matrix]:
        """Conditions, nodes and nodal forces of a contact: (c,), (n, dim), sparse (c, n dim)."""


class Output(Protocol):
    """Interface of an output.

    Attributes:
        name: name of the output.
        unit: unit of its value, as text.
    """

    name: str
    unit: str

    def prepared(self, probe: object) -> Functional:
        """The output as plain data; SceneError if the model lacks a contact, a body or a node of it."""


@dataclass(frozen=True)
class NamedOutput:
    """Base class of outputs.

    Attributes:
        name: name of the output.
        unit: unit of its value, as text.
        vectors: names of fields with coordinates or components.
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
class OfContact(NamedOutput):
    """Base class of outputs of a contact.

    Attributes:
        contact: index of the pair in ``Scene.contacts``.
    """

    contact: int

    def __post_init__(self) -> None:
        super().__post_init__()
        if not is_whole(self.contact, 0):
            raise SceneError(
                f"output '{self.name}': contact {self.contact!r} must be the place of a pair in Scene.contacts, from 0"
            )


@dataclass(frozen=True)
class LargestPressure(OfContact):
    """Largest contact pressure of a contact: force over tributary area."""

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`Output`."""
        return Largest(self.name, self.unit, *no_rows(), *probe.loaded(self))


@dataclass(frozen=True)
class ContactForce(OfContact):
    """Component of the resultant of a contact on the body of its first surface, the slave.

    Attributes:
        direction: direction of the component, of any length. In axisymmetry the first component sums radial forces
            around the whole turn.
    """

    vectors: ClassVar[tuple[str, ...]] = ("direction",)

    direction: tuple[float, ...]

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`Output`."""
        conditions, points, forces = probe.nodal_forces(self)
        along = np.tile(unit_vector(self, "direction", probe.dimension), len(points))
        return Linear.of(self.name, self.unit, conditions, forces @ along)


@dataclass(frozen=True)
class ContactMoment(OfContact):
    """Component of the moment of a contact on the body of its first surface, the slave.

    Attributes:
        about: reference point of the moment.
        axis: axis of the component in space; None in the plane, for the normal of the plane.
    """

    vectors: ClassVar[tuple[str, ...]] = ("about", "axis")

    about: tuple[float, ...]
    axis: tuple[float, ...] | None = None

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`Output`."""
        if probe.scene.hypothesis == "axisymmetric":
            raise SceneError(
                f"output '{self.name}': the moment of an axisymmetric contact without friction vanishes. Ask for the "
                "Torque that friction can bear"
            )
        conditions, points, forces = probe.nodal_forces(self)
        arms = points - place_of(self, "about", probe.dimension)
        if probe.dimension == 2:
            no_axis(self)
            turned = np.column_stack([-arms[:, 1], arms[:, 0]])
        else:
            turned = np.cross(unit_vector(self, "axis", 3), arms)
        return Linear.of(self.name, self.unit, conditions, forces @ turned.ravel())


@dataclass(frozen=True)
class ContactWidth(OfContact):
    """Area under load of a contact: a width per unit depth in the plane, the area of the whole turn in axisymmetry.

    Nodes with less than a thousandth of the largest pressure of the contact do not count. The area changes by steps of
    a cell; its derivatives are zero except for those of the shape of the cells.
    """

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`Output`."""
        conditions, areas = probe.loaded(self)
        return Loaded(self.name, self.unit, *no_rows(), conditions, areas, 0.0, 1.0)


@dataclass(frozen=True)
class LostContact(OfContact):
    """Fraction of the area of a contact that is not under load, from 0 to 1; see :class:`ContactWidth`."""

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`Output`."""
        conditions, areas = probe.loaded(self)
        return Loaded(self.name, self.unit, *no_rows(), conditions, areas, 1.0, -1.0 / float(areas.sum()))


@dataclass(frozen=True)
class GapAt(OfContact):
    """Gap of the contact condition nearest to a point; zero in contact.

    Attributes:
        place: coordinates of the point.
    """

    vectors: ClassVar[tuple[str, ...]] = ("place",)

    place: tuple[float, ...]

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`Output`."""
        conditions = probe.conditions(self)
        problem = probe.problem
        nearest = conditions[probe.at_place(self, probe.base.contact_points[conditions])[0]]
        row = problem.contact[[nearest]]
        # gaps of a problem have the lifts subtracted, and the row subtracts them again with the displacement
        gaps = problem.gaps[nearest] + (row @ problem.lifts).toarray()[0]
        terms = probe.terms(gaps)
        return Linear.of(self.name, self.unit, row=-row, terms=terms, coefficients=gaps[terms])


@dataclass(frozen=True)
class DisplacementAt(NamedOutput):
    """Component of the displacement of the node nearest to a point.

    Attributes:
        place: coordinates of the point.
        component: 0, 1 or 2.
        tag: cell tag of the body, if several bodies have nodes at the point.
    """

    vectors: ClassVar[tuple[str, ...]] = ("place",)

    place: tuple[float, ...]
    component: int
    tag: Tag | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not is_whole(self.component, 0) or self.component > 2:
            raise SceneError(f"output '{self.name}': the component {self.component!r} must be 0, 1 or 2")

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`Output`."""
        problem = probe.problem
        dim = probe.dimension
        if self.component >= dim:
            raise SceneError(f"output '{self.name}': the mesh has {dim} components, none is {self.component}")
        nodes = np.arange(len(problem.points)) if self.tag is None else probe.nodes(self.tag)
        points = probe.base.points[nodes]
        found = nodes[probe.at_place(self, points)]
        if found.size > 1:
            # bodies in contact have nodes at the same point, which may separate
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
class LinearForm(NamedOutput):
    """A form that is linear in the displacement, such as its mean over a surface.

    Attributes:
        form: function of an :class:`~hhr_dolfinx.loads.Assembler` that returns a UFL form, linear in ``test``, which
            stands for the displacement: ``lambda a: a.test[0] * a.ds(TAG)``. In axisymmetry multiply it by the weight
            :func:`hhr_dolfinx.forms.elasticity.volume_weight`.
    """

    form: Callable[[Assembler], ufl.Form]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not callable(self.form):
            raise SceneError(f"output '{self.name}': the form {self.form!r} must be a function of an Assembler")

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`Output`."""
        vector = probe.assembler.vector(self.form(probe.assembler))
        return Linear.of(self.name, self.unit, row=csr_matrix(vector[None]))


def place_of(output: NamedOutput, name: str, dim: int) -> np.ndarray:
    """A vector of an output, (dim,)."""
    value = getattr(output, name)
    if value is None or len(value) != dim:
        raise SceneError(f"output '{output.name}': {name} = {value} must have {dim} components, as the mesh")
    return np.array(value)


def unit_vector(output: NamedOutput, name: str, dim: int) -> np.ndarray:
    """A vector of an output, normalised to length 1."""
    vector = place_of(output, name, dim)
    length = np.linalg.norm(vector)
    if length == 0:
        raise SceneError(f"output '{output.name}': {name} = {getattr(output, name)} must not be zero")
    return vector / length


def no_axis(output: Any) -> None:
    """Raise SceneError for an axis in the plane."""
    if output.axis is not None:
        raise SceneError(f"output '{output.name}': an axis is for meshes in space, leave it out")


def no_rows() -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
    """Rows of an output that reads no displacement."""
    return 0, _NOWHERE, _NOWHERE, _NOTHING
