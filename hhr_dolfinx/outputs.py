"""Outputs of a scene: numbers by name.

Each has the rule to compute it from forces and displacement.

A user-defined output is one class with a name, a unit and a method ``prepared``, see
:class:`Output`. Forces and areas are those of the whole turn in axisymmetry, and per unit depth in
the plane. If shapes depend on parameters, positions and boxes refer to the mesh in the middle of
the parameter box: an output stays with its nodes and cells.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.declared import KnownArguments
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.models.functionals.functional import Functional
from hhr_dolfinx.models.functionals.kinds import Largest, Linear, Loaded, LoadedShare
from hhr_dolfinx.parameters import Tag, as_tuple, check_pair_index, is_number, is_whole

if TYPE_CHECKING:
    import ufl

    from hhr_dolfinx.contact.problem import ContactProblem
    from hhr_dolfinx.loads import Assembler
    from hhr_dolfinx.models.histories.equilibrium import LawsAtPlaces


@dataclass(frozen=True)
class ModelProbe:
    """Interface of the finite element model to an output; calls are collective."""

    scene: Any  #: the :class:`~hhr_dolfinx.scene.Scene`
    problem: ContactProblem  #: the contact problem
    #: the problem on the mesh in which outputs find points and boxes: that of the middle of the box
    #: if a shape depends on parameters, so that an output keeps its nodes and cells; otherwise
    #: ``problem``
    base: ContactProblem
    contact_rows: csr_matrix  #: B with the columns of imposed dofs, (N_lambda, N)
    assembler: Assembler  #: interface of loads
    nodes: Callable[
        [Tag], np.ndarray
    ]  #: numbers of the nodes of a body, by its cell tag; refuses unknown tags
    discretisation: Any  #: mesh and forms, for outputs that read cells
    laws: LawsAtPlaces | None  #: bodies with laws, or their equilibrium; None for elastic bodies

    @property
    def dimension(self) -> int:
        """Components of a displacement."""
        return self.problem.block_size

    def conditions(self, output: OfContact) -> np.ndarray:
        """Numbers of the conditions of pressures of the contact of an output, (c,).

        Raises:
            SceneError: if the scene has no such contact, or none of its conditions moves.
        """
        contacts = len(self.scene.contacts)
        if output.contact >= contacts:
            raise SceneError(
                f"output '{output.name}' names contact {output.contact}, and the scene has "
                f"{contacts}: name one of {', '.join(map(str, range(contacts))) or 'none'}"
            )
        conditions = self.problem.pressing_of(output.contact)
        if not conditions.size:
            raise SceneError(
                f"output '{output.name}' names contact {output.contact}, of which no condition "
                "moves: name another"
            )
        return conditions

    def loaded(self, output: OfContact) -> tuple[np.ndarray, np.ndarray]:
        """Conditions of a contact with a positive area, and their areas, (c,) each.

        Raises:
            SceneError: if no condition of the contact has an area.
        """
        conditions = self.conditions(output)
        conditions = conditions[self.problem.contact_areas[conditions] > 0]
        if not conditions.size:
            raise SceneError(
                f"output '{output.name}': no condition of contact {output.contact} has an area"
            )
        return conditions, self.problem.contact_areas[conditions]

    def at_place(self, output: Any, points: np.ndarray) -> np.ndarray:
        """Numbers of the points nearest to the place of an output; several if they coincide.

        Args:
            output: output with a ``place``.
            points: points of ``base``, (n, dim).

        Raises:
            SceneError: for a place farther from all of them than the length of a cell.
        """
        if len(output.place) != self.dimension:
            raise SceneError(
                f"output '{output.name}': the place {output.place} must have {self.dimension} "
                "coordinates"
            )
        distances = np.linalg.norm(points - np.array(output.place), axis=1)
        nearest = int(distances.argmin())
        size = self._cell_size(points[nearest])
        if distances[nearest] > size:
            raise SceneError(
                f"output '{output.name}': the place {output.place} is {distances[nearest]:.4g} "
                f"away from the nearest point at {points[nearest].tolist()}, and a cell there is "
                f"{size:.4g} long: move it"
            )
        return np.flatnonzero(distances <= distances[nearest] + 1e-6 * size)

    def _cell_size(self, point: np.ndarray) -> float:
        cells = self.base.cell_nodes
        nodes = self.base.points
        nearest = np.linalg.norm(nodes - point, axis=1).argmin()
        at_node = cells[(cells == nearest).any(axis=1)]
        return float(np.linalg.norm(np.ptp(nodes[at_node], axis=1), axis=1).max(initial=0.0))

    def terms(self, entries: np.ndarray) -> np.ndarray:
        """Terms of θ with entries, (1 + T,)."""
        return np.flatnonzero(entries)

    def on_cells(self, found: Functional, cells: np.ndarray) -> Functional:
        """The functional of an output whose rows are strains of cells, which shapes may move.

        Args:
            found: functional of the output.
            cells: numbers of the cells.
        """
        return found

    def nodal_forces(self, output: OfContact) -> tuple[np.ndarray, np.ndarray, csr_matrix]:
        """Forces of a contact on the nodes of its first surface.

        These are -B^T λ on the body of the slave, including friction. Of a condition that several
        contacts state each has its share.

        Returns:
            Conditions of the contact, (c,), positions of the nodes, (n, dim), and the forces on
            them, sparse (c, n dim).
        """
        self.conditions(output)
        shares = self.problem.shares
        conditions = np.flatnonzero(self.problem.shares_of(output.contact))
        rows = self.contact_rows[conditions]
        rows = rows if shares is None else shares.rows_of(output.contact, conditions, rows)
        surface = self.assembler.surface(self.scene.contacts[output.contact].tags[0])
        dofs = (surface.nodes[:, None] * self.dimension + np.arange(self.dimension)).ravel()
        return conditions, surface.points, csr_matrix(-rows[:, dofs])


class Output(Protocol):
    """Interface of an output."""

    @property
    def name(self) -> str:
        """Name of the output."""

    @property
    def unit(self) -> str:
        """Unit of its value, as text."""

    def prepared(self, probe: ModelProbe) -> Functional:
        """The output as plain data.

        Raises:
            SceneError: if the model lacks a contact, a body or a node of it.
        """


@dataclass(frozen=True)
class NamedOutput(KnownArguments):
    """Base class of outputs; ``vectors`` names the fields with coordinates or components."""

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
                components = as_tuple(f"{name} of output '{self.name}'", value)
                if not components or not all(is_number(component) for component in components):
                    raise SceneError(
                        f"output '{self.name}': {name} = {value!r} must hold finite numbers"
                    )
                object.__setattr__(self, name, tuple(float(component) for component in components))


@dataclass(frozen=True)
class OfContact(NamedOutput):
    """Base class of outputs of a contact."""

    contact: int  #: index of the pair in ``Scene.contacts``

    def __post_init__(self) -> None:
        super().__post_init__()
        check_pair_index(f"output '{self.name}': contact {self.contact!r}", self.contact)


@dataclass(frozen=True)
class LargestPressure(OfContact):
    """Largest contact pressure of a contact: force over tributary area.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> from dataclasses import replace
        >>> peak = hhr.LargestPressure("peak", contact=0, unit="MPa")
        >>> model = hhr.condense(replace(scene, outputs=(peak,)))
        >>> round(model.outputs({"push": 50.0})["peak"], 1)
        56.5
    """

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`Output`."""
        return Largest(self.name, self.unit, *no_rows(), *probe.loaded(self))


@dataclass(frozen=True)
class ContactForce(OfContact):
    """Component of the resultant of a contact on the body of its first surface, the slave.

    The resultant has all forces of the contact: pressures, and friction if the pair has a law. Per
    unit depth in the plane.

    Attributes:
        direction: direction of the component, of any length. In axisymmetry the first component
            sums radial forces around the whole turn.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> from dataclasses import replace
        >>> lift = hhr.ContactForce("lift", contact=0, direction=(0, 1), unit="N/mm")
        >>> model = hhr.condense(replace(scene, outputs=(lift,)))
        >>> round(model.outputs({"push": 50.0})["lift"], 1)
        68.5
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

    Friction is included.

    Attributes:
        about: reference point of the moment.
        axis: axis of the component in space; None in the plane, for the normal of the plane.
    """

    vectors: ClassVar[tuple[str, ...]] = ("about", "axis")

    about: tuple[float, ...]
    axis: tuple[float, ...] | None = None

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`Output`.

        Raises:
            SceneError: in axisymmetry, or for a point or axis of another dimension.
        """
        if probe.scene.hypothesis == "axisymmetric":
            raise SceneError(
                f"output '{self.name}': the moment of an axisymmetric contact without friction "
                "vanishes. Ask for the Torque that friction can bear"
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
    """Area under load of a contact.

    A width per unit depth in the plane, the area of the whole turn in axisymmetry.

    Nodes with less than a thousandth of the largest pressure of the contact do not count. The area
    changes by steps of a cell; its derivatives are zero except for those of the shape of the cells.
    """

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`Output`."""
        return _area_under_load(self, probe)


@dataclass(frozen=True)
class LostContact(OfContact):
    """Fraction of the area of a contact that is not under load, from 0 to 1.

    See :class:`ContactWidth`.
    """

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`Output`."""
        area = _area_under_load(self, probe)
        return replace(area, offset=1.0, factor=-1.0 / float(area.counted.sum()))


@dataclass(frozen=True)
class GapAt(OfContact):
    """Gap of the contact condition nearest to a point; zero in contact.

    The gap is the one of the condition. Of ``Mortar`` it is a mean around a node of the slave,
    measured along the normal of the slave, or along ``normal`` of the pair. On inclined or round
    surfaces it is longer than the shortest distance, by 1 / cos of the angle between the surfaces.
    ``NodeToSurface`` measures to the closest point of the master.

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
        # gaps of a problem have the lifts subtracted, and the row subtracts them again with the
        # displacement
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

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> from dataclasses import replace
        >>> sag = hhr.DisplacementAt("sag", place=(2, 1), component=1, unit="mm")
        >>> model = hhr.condense(replace(scene, outputs=(sag,)))
        >>> round(1e3 * model.outputs({"push": 50.0})["sag"], 2)
        -0.33
    """

    vectors: ClassVar[tuple[str, ...]] = ("place",)

    place: tuple[float, ...]
    component: int
    tag: Tag | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not is_whole(self.component, 0) or self.component > 2:
            raise SceneError(
                f"output '{self.name}': the component {self.component!r} must be 0, 1 or 2"
            )

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`Output`.

        Raises:
            SceneError: for a component that the mesh does not have, or a place far from all nodes
                or near to several ones.
        """
        problem = probe.problem
        dim = probe.dimension
        if self.component >= dim:
            raise SceneError(
                f"output '{self.name}': the mesh has {dim} components, none is {self.component}"
            )
        nodes = probe.discretisation.by_place if self.tag is None else probe.nodes(self.tag)
        points = probe.base.points[nodes]
        nearest = nodes[probe.at_place(self, points)]
        if nearest.size > 1:
            # bodies in contact have nodes at the same point, which may separate
            tags = [
                body.tag
                for body in probe.scene.bodies
                if np.isin(nearest, probe.nodes(body.tag)).any()
            ]
            node = probe.base.points[nearest[0]][:dim]
            near = tuple(
                float(f"{value:.6g}")
                for value in np.where(np.abs(node) > 1e-9 * np.abs(points).max(), node, 0)
            )
            remedy = f"move the place to one of them, such as {near}"
            raise SceneError(
                f"output '{self.name}': {nearest.size} nodes, of bodies {tags}, are equally near "
                f"to the place {self.place}: "
                + (f"name the body, tag=..., or {remedy}" if len(tags) > 1 else remedy)
            )
        dof = dim * nearest[0] + self.component
        return Linear.of(
            self.name,
            self.unit,
            row=csr_matrix(([1.0], ([0], [dof])), shape=(1, problem.free.size)),
        )


@dataclass(frozen=True)
class LinearForm(NamedOutput):
    """A form that is linear in the displacement, such as its mean over a surface.

    Attributes:
        form: function of an :class:`~hhr_dolfinx.loads.Assembler` that returns a UFL form, linear
            in ``test``, which stands for the displacement: ``lambda a: a.test[0] * a.ds(TAG)``. In
            axisymmetry multiply it by the weight
            :func:`hhr_dolfinx.forms.elasticity.volume_weight`.
    """

    form: Callable[[Assembler], ufl.Form]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not callable(self.form):
            raise SceneError(
                f"output '{self.name}': the form {self.form!r} must be a function of an Assembler"
            )

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`Output`."""
        vector = probe.assembler.vector(self.form(probe.assembler))
        return Linear.of(self.name, self.unit, row=csr_matrix(vector[None]))


def place_of(output: NamedOutput, name: str, dim: int) -> np.ndarray:
    """A vector of an output, (dim,).

    Args:
        output: the output.
        name: name of the field.
        dim: dimension of the mesh.

    Raises:
        SceneError: if it does not have ``dim`` components.
    """
    value = getattr(output, name)
    if value is None or len(value) != dim:
        raise SceneError(
            f"output '{output.name}': {name} = {value} must have {dim} components, as the mesh"
        )
    return np.array(value)


def unit_vector(output: NamedOutput, name: str, dim: int) -> np.ndarray:
    """A vector of an output, normalised to length 1, (dim,).

    Args:
        output: the output.
        name: name of the field.
        dim: dimension of the mesh.

    Raises:
        SceneError: if it is zero, or does not have ``dim`` components.
    """
    vector = place_of(output, name, dim)
    length = np.linalg.norm(vector)
    if length == 0:
        raise SceneError(
            f"output '{output.name}': {name} = {getattr(output, name)} must not be zero"
        )
    return vector / length


def no_axis(output: Any) -> None:
    """Refuse an axis in the plane.

    Raises:
        SceneError: if the output has an axis.
    """
    if output.axis is not None:
        raise SceneError(f"output '{output.name}': an axis is for meshes in space, leave it out")


def _area_under_load(output: OfContact, probe: ModelProbe) -> Loaded:
    """Area under load of the contact of an output.

    The contact has a share in conditions that others state too.
    """
    conditions, areas = probe.loaded(output)
    shares = probe.problem.shares_of(output.contact)[conditions]
    arguments = output.name, output.unit, *no_rows(), conditions, areas, 0.0, 1.0
    return Loaded(*arguments) if (shares == 1.0).all() else LoadedShare(*arguments, shares * areas)


def no_rows() -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
    """Rows of an output that reads no displacement."""
    nowhere = np.zeros(0, dtype=np.int64)
    return 0, nowhere, nowhere, np.zeros(0)
