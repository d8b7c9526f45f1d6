"""Scene: geometry, materials, contact pairs, loads and parameter space, the input of a user."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.amplitudes import Amplitude, check_amplitude, check_formula
from hhr_dolfinx.body import Body
from hhr_dolfinx.declared import KnownArguments
from hhr_dolfinx.errors import SceneError, SceneWarning
from hhr_dolfinx.forms import elasticity
from hhr_dolfinx.loads import Load
from hhr_dolfinx.pairings import Pairing
from hhr_dolfinx.parameters import (
    ParameterSpace,
    Place,
    Tag,
    as_tuple,
    check_pair_index,
    check_place,
    check_tag,
    is_whole,
)
from hhr_dolfinx.units import Units
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from mpi4py.MPI import Comm
    from ufl import Mesh
    from ufl.core.expr import Expr

    from hhr_dolfinx.compat import TaggedMesh
    from hhr_dolfinx.contact.law import PairLaw
    from hhr_dolfinx.formulas import Formula
    from hhr_dolfinx.outputs import Output


@dataclass(frozen=True)
class Displacement(KnownArguments):
    """Imposed displacement of one component on facets or nodes: ``u[component] = amplitude(mu)
    field(x)``.

    Attributes:
        tag: tag of facets, the name of a set of nodes in the file of the mesh, or a
            :class:`~hhr_dolfinx.parameters.Place`.
        component: 0, 1 or 2.
        amplitude: a number, an :class:`Amplitude`, or a formula of the parameters as text, ``"lift
            * sin(angle)"``.
        field: formula of the coordinates as text, named x, y, z, in axisymmetry r, z; None for 1.
            Coordinates are those of the given mesh, before any change of shape. A rotation about
            the axis z is ``Displacement(tag, 0, angle, "-y")`` and ``Displacement(tag, 1, angle,
            "x")``.

    Example:
        >>> [support.component for support in hhr.Displacement.clamp("floor", 2)]
        [0, 1]
        >>> turned = hhr.Displacement("end", 0, "angle", field="-y")
        >>> turned.at(np.array([[0.0, 2.0], [0.0, 3.0]]), "plane_strain")
        array([-2., -3.])
    """

    tag: Tag | Place
    component: int
    amplitude: Amplitude | Formula = Amplitude()
    field: Formula | None = None

    def __post_init__(self):
        check_place("displacement", self.tag)
        if not is_whole(self.component, 0):
            raise SceneError(
                f"component {self.component!r} of the displacement on tag {self.tag} must be 0, 1 "
                "or 2: write one Displacement for each component that is imposed"
            )
        check_amplitude(self, f"the displacement on tag {self.tag}", formulas=True)
        if self.field is not None:
            from hhr_dolfinx.formulas import formula_of

            description = f"the field of the displacement on tag {self.tag}"
            object.__setattr__(self, "field", formula_of(self.field, description))

    def at(self, points: np.ndarray, hypothesis: str) -> np.ndarray:
        """Values of the field at points, (n,).

        Args:
            points: the points, (n, dim).
            hypothesis: hypothesis of the scene, which names the coordinates.

        Raises:
            SceneError: for unknown coordinates or values that are not finite.
        """
        assert self.field is not None
        from hhr_dolfinx.formulas import coordinate_names

        names = coordinate_names(hypothesis)
        unknown = set(self.field.variables) - set(names)
        description = f"the field '{self.field.text}' of the displacement on tag {self.tag}"
        if unknown:
            raise SceneError(f"{description} names {sorted(unknown)}: coordinates are {names}")
        with np.errstate(all="ignore"):
            values = np.broadcast_to(
                self.field(dict(zip(names, points.T, strict=True))), len(points)
            ).astype(float)
        if not np.isfinite(values).all():
            point = points[np.flatnonzero(~np.isfinite(values))[0]].tolist()
            raise SceneError(f"{description} is not finite at {point}: change the formula")
        return values

    @classmethod
    def clamp(cls, tag: Tag | Place, dimension: int) -> tuple[Displacement, ...]:
        """Fix all components of the displacement of a tag.

        Args:
            tag: facet tag, set of nodes or place.
            dimension: dimension of the mesh.
        """
        return tuple(cls(tag, component) for component in range(dimension))


@dataclass(frozen=True)
class Opening(KnownArguments):
    """An initial gap that depends on parameters: ``amplitude(mu)`` is added to all gaps of a
    contact pair.

    Attributes:
        contact: index of the pair in ``Scene.contacts``.
        amplitude: added gap.
        overwrites: True if it is the whole gap, whatever the mesh has between the surfaces, as a
            ``*CLEARANCE``.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> from dataclasses import replace
        >>> lowered = hhr.Opening(contact=0, amplitude=hhr.Amplitude(slopes={"push": 1e-5}))
        >>> float(replace(scene, openings=(lowered,)).opened(contact=0, point=np.array([50.0])))
        0.0005
    """

    contact: int
    amplitude: Amplitude
    overwrites: bool = False

    def __post_init__(self):
        check_pair_index(f"contact {self.contact!r} of an opening", self.contact)
        check_amplitude(self, f"the opening of contact {self.contact}")


@dataclass(frozen=True)
class Scene(KnownArguments):
    """Definition of a parametric contact problem.

    Attributes:
        name: name for files and for the prefix of PETSc options, ``hhr_<name>_``.
        geometry: function of a communicator that returns ``(mesh, cell_tags, facet_tags)``.
        hypothesis: ``plane_strain``, ``plane_stress``, ``axisymmetric`` or ``solid``.
        bodies: bodies, one per cell tag.
        contacts: contact pairs, each a :class:`~hhr_dolfinx.pairings.Pairing`.
        displacements: imposed displacements.
        loads: loads, each a :class:`~hhr_dolfinx.loads.Load`, such as a pressure, or user-defined.
        parameters: box of the parameters.
        openings: initial gaps that depend on parameters.
        shapes: bodies whose shape depends on parameters, each a ``Shape``, which a plug-in adds.
        outputs: numbers that every model of the scene returns by name, see
            :mod:`hhr_dolfinx.outputs`.
        units: units of lengths and stresses, for labels and materials by name; None if they are not
            given.
        order: degree of the displacement, 1 or 2; None takes that of the cells of the mesh. With 2
            on a mesh of first order sides stay straight.
        system: makes a user-defined :class:`~hhr_dolfinx.full_order.system.System` of the arguments
            of one, for elastic bodies without shapes; None for the elasticity of the bodies. It
            states K of all dofs, to which constraints and springs are added. Reductions that cannot
            read its K refuse it.
        parameter_units: units of parameters by name, for labels: ``{"push": "MPa"}``; other names
            are ignored.
        constraints: equations between displacements, each an item that the tool ``constraints``
            reads, such as ties, which a plug-in adds.

    Example:
        >>> from hhr_dolfinx.geometries import block
        >>> scene = hhr.Scene(
        ...     name="pad",
        ...     geometry=lambda comm: block.block(comm, lower=(0, 0), upper=(2, 1), cells=(8, 4)),
        ...     hypothesis="plane_strain",
        ...     bodies=(hhr.Body(block.SOLID, young=210e3, poisson=0.3),),
        ...     contacts=(hhr.Obstacle(block.side(1, upper=False), normal=(0, -1), offset=1e-4),),
        ...     parameters=hhr.ParameterSpace(("push",), lower=(0.0,), upper=(100.0,)),
        ...     displacements=hhr.Displacement.clamp(block.side(0, upper=False), 2),
        ...     loads=(hhr.Pressure(block.side(1, upper=True), "push"),),
        ...     outputs=(hhr.LargestPressure("peak", contact=0, unit="MPa"),),
        ...     units=hhr.Units("mm", "MPa"),
        ...     parameter_units={"push": "MPa"},
        ... )
        >>> print(scene)
        Scene 'pad', plane strain, in mm and MPa
          body 1: young 210000.0, poisson 0.3
          contact 0: Obstacle of 20
          displacements: Displacement of 10, Displacement of 10
          loads: Pressure of 21
          parameter push: 0 to 100 MPa
          outputs: peak
    """

    name: str
    geometry: Callable[[Comm], TaggedMesh]
    hypothesis: str
    bodies: tuple[Body, ...]
    contacts: tuple[Pairing, ...]
    parameters: ParameterSpace
    displacements: tuple[Displacement, ...] = ()
    loads: tuple[Load, ...] = ()
    openings: tuple[Opening, ...] = ()
    shapes: tuple[Any, ...] = ()
    outputs: tuple[Output, ...] = ()
    units: Units | None = None
    order: int | None = None
    system: Callable[..., Any] | None = None
    parameter_units: Mapping[str, str] = field(default_factory=dict)
    constraints: tuple[Any, ...] = ()

    def __post_init__(self):
        if self.order is not None and not (is_whole(self.order, 1) and self.order <= 2):
            raise SceneError(
                f"order = {self.order!r} must be 1 or 2, the degree of the displacement, or left "
                "out"
            )
        if self.units is not None and not isinstance(self.units, Units):
            raise SceneError(f"units = {self.units!r} must be Units, such as Units('mm', 'MPa')")
        if self.hypothesis not in elasticity.HYPOTHESES:
            raise SceneError(
                f"unknown hypothesis '{self.hypothesis}', one of "
                f"{', '.join(elasticity.HYPOTHESES)} is needed"
            )
        if not isinstance(self.name, str) or not self.name.isidentifier():
            word = re.sub(r"\W", "_", str(self.name)).lstrip("0123456789") or "my_scene"
            raise SceneError(
                f"scene name {self.name!r} must be an identifier: it prefixes PETSc options. Call "
                f"it '{word}'"
            )
        if not callable(self.geometry):
            path = f"'{self.geometry}'" if isinstance(self.geometry, str | Path) else "path"
            raise SceneError(
                f"geometry = {self.geometry!r} must be a function of a communicator: for a mesh "
                f"file write MeshFile({path}), for your own mesh lambda comm: ..."
            )
        if not isinstance(self.parameters, ParameterSpace):
            raise SceneError(f"parameters = {self.parameters!r} must be a ParameterSpace")
        self._check_parameter_units()
        self._check_items()
        bound = (
            pairing.within(self.parameters) if hasattr(pairing, "within") else pairing
            for pairing in self.contacts
        )
        object.__setattr__(self, "contacts", tuple(bound))
        if not self.bodies:
            raise SceneError(
                f"scene '{self.name}' needs at least one body: bodies=(Body(tag, young, poisson),)"
            )
        for body in self.bodies:
            body.check(self.parameters, self.hypothesis)
        _ = self.reader  # laws of several plug-ins are refused here
        self._check_system()
        self._check_shapes()
        if not self.contacts:
            raise SceneError(
                f"scene '{self.name}': a scene without contact pairs is a linear problem: nothing "
                "to hyper-reduce. Name the surfaces that may touch, "
                "contacts=(NodeToSurface(slave, master),)"
            )
        self._check_places()
        self._check_names()
        self._check_laws_and_units()

    def _check_items(self) -> None:
        """Store sequences of items as tuples; raise SceneError for an item that does not fit."""
        for name, requirement, fits in _PARTS:
            elements = as_tuple(f"Scene.{name}", getattr(self, name))
            object.__setattr__(self, name, elements)
            for index, element in enumerate(elements):
                if not fits(element):
                    # a list of valid items, such as all displacements of a clamp
                    listed = (
                        isinstance(element, tuple | list)
                        and len(element) > 0
                        and all(map(fits, element))
                    )
                    star = ". Put a star before it, *..., to list what it holds" if listed else ""
                    raise SceneError(
                        f"{name}[{index}] of scene '{self.name}' is {element!r}: it must be "
                        f"{requirement}{star}"
                    )

    def _check_laws_and_units(self) -> None:
        for index, law in enumerate(self.laws):
            if law is not None:
                law.check(self, f"contact {index} of scene '{self.name}'")
        for output in self.outputs:
            unit = None if self.units is None else self.units.conflict(getattr(output, "unit", ""))
            if unit is not None:
                warn(
                    f"output '{output.name}' has the unit '{output.unit}', and numbers of scene "
                    f"'{self.name}' are in {unit}: a unit is a label and converts nothing, so "
                    "correct it",
                    SceneWarning,
                )

    def _check_parameter_units(self) -> None:
        units = self.parameter_units
        if not isinstance(units, Mapping) or not all(
            isinstance(unit, str) for unit in units.values()
        ):
            raise SceneError(
                f"parameter_units = {units!r} must be texts by the names of parameters, {{'push': "
                "'MPa'}"
            )
        bare = [name for name in self.parameters.names if name not in units]
        for name in units:  # a copy of a scene with other parameters may have additional units
            near = (
                []
                if name in self.parameters.names
                else difflib.get_close_matches(str(name), bare, n=1)
            )
            if near:
                raise SceneError(
                    f"parameter_units name '{name}', which is no parameter: is '{near[0]}' meant?"
                )

    def __str__(self) -> str:
        """Text of several lines: bodies, contacts, supports, loads, parameters with their ranges,
        outputs.
        """
        units = "" if self.units is None else f", in {self.units.length} and {self.units.stress}"
        lines = [f"Scene '{self.name}', {self.hypothesis.replace('_', ' ')}{units}"]
        for body in self.bodies:
            law = "" if body.law is None else f", {body.law!r}"
            lines.append(f"  body {body.tag}: young {body.young}, poisson {body.poisson}{law}")
        for index, (pair, pair_law) in enumerate(zip(self.contacts, self.laws, strict=True)):
            law = "" if pair_law is None else f", {pair_law.words}"
            lines.append(
                f"  contact {index}: {type(pair).__name__} of {', '.join(map(str, pair.tags))}{law}"
            )
        for kind in ("displacements", "constraints", "loads", "shapes"):
            if elements := getattr(self, kind):
                lines.append(
                    f"  {kind}: {', '.join(_named_in_short(element) for element in elements)}"
                )
        for name, low, high in zip(
            self.parameters.names, self.parameters.lower, self.parameters.upper, strict=True
        ):
            unit = self.parameter_units.get(name, "")
            lines.append(f"  parameter {name}: {low:g} to {high:g} {unit}".rstrip())
        if self.outputs:
            lines.append(f"  outputs: {', '.join(output.name for output in self.outputs)}")
        return "\n".join(lines)

    def plot(self, path: str | Path | None = None) -> Figure:
        """Plot bodies, contact surfaces, supports and loads, as a figure of matplotlib.

        Nothing is solved.

        Args:
            path: file to save the figure to; None for none.

        Raises:
            SceneError: if the mesh cannot be made.
            NotOfferedError: without a plug-in that draws.
            MissingPackageError: without matplotlib.
        """
        return registry.tool("drawing", "a figure of a scene")(self, path)

    def opened(self, contact: int, point: np.ndarray) -> float:
        """Gap that openings add to a contact pair at a point.

        Args:
            contact: index of the pair.
            point: parameters, (P,).
        """
        amplitudes = [opening.amplitude for opening in self.openings if opening.contact == contact]
        return sum(
            amplitude.constant + float(amplitude.row(self.parameters) @ point)
            for amplitude in amplitudes
        )

    def overwritten(self, contact: int) -> bool:
        """True if an opening overwrites the gaps that the mesh has at a contact pair, given by its
        index.
        """
        return any(opening.overwrites for opening in self.openings if opening.contact == contact)

    @cached_property
    def laws(self) -> tuple[PairLaw | None, ...]:
        """Law of each contact pair in addition to unilateral contact; None without one."""
        from hhr_dolfinx.contact.law import pair_law

        owner = f"of scene '{self.name}'"
        return tuple(
            pair_law(pairing, f"contact {index} {owner}")
            for index, pairing in enumerate(self.contacts)
        )

    @property
    def remembers(self) -> bool:
        """True if answers depend on the path that leads to them, by the law of a contact."""
        return any(law is not None for law in self.laws)

    @property
    def by_paths(self) -> bool:
        """True if answers depend on the path that leads to them."""
        return bool(self.remembers or self.reader)

    def states_stress(self, body: Body) -> bool:
        """True for a body with linear elasticity that is not Hooke's.

        Beside inelastic bodies, a linear law is solved at Gauss points, as theirs are.
        """
        return body.stress is not None or (body.law is not None and not self.reader)

    def own_stress(self, body: Body, mesh: Mesh) -> Callable[[Expr], Expr] | None:
        """Linear elasticity of a body that is not Hooke's, under the hypothesis, with its grading.

        Args:
            body: one of the scene.
            mesh: mesh with the coordinates of the grading.

        Returns:
            The stress as a function of the strain, both 3x3, in UFL; None for Hooke's law, and for
            laws that are solved at Gauss points.
        """
        if not self.states_stress(body):
            return None
        stated = body.own_stress
        assert stated is not None  # a law that is not linear has a reader
        stress_of = elasticity.law_in(stated, self.hypothesis)
        return (
            stress_of if body.grading is None else elasticity.graded(stress_of, body.grading, mesh)
        )

    @cached_property
    def reader(self) -> str:
        """Name of the plug-in that solves for laws of bodies, empty if all are elastic.

        Raises:
            SceneError: for laws of several plug-ins.
        """
        readers = sorted({body.reader for body in self.bodies} - {""})
        if len(readers) > 1:
            raise SceneError(
                f"scene '{self.name}' has laws of bodies of several plug-ins, {readers}: not "
                "built in"
            )
        return readers[0] if readers else ""

    def _check_system(self) -> None:
        """Raise SceneError for a system beside what states K too."""
        if self.system is None:
            return
        if not callable(self.system):
            raise SceneError(
                f"system = {self.system!r} must make a System: a subclass, or a function of its "
                "arguments"
            )
        stiffness = "K of all bodies"
        for present, kind, fault in (
            (
                self.reader,
                "laws of bodies",
                f"a law states the stress of its body, and a system {stiffness}",
            ),
            (
                self.shapes,
                "shapes",
                f"K is assembled on the mesh of each point, and a system states {stiffness} on one",
            ),
        ):
            if present:
                raise SceneError(
                    f"scene '{self.name}' has {kind} and a user-defined system: {fault}. Leave one "
                    "of them out"
                )

    def _check_shapes(self) -> None:
        """Raise SceneError for shapes without a body, and two shapes of one body."""
        tags = {body.tag: body for body in self.bodies}
        for index, shape in enumerate(self.shapes):
            shape.check(self.parameters, self.hypothesis)
            if shape.tag not in tags or any(
                shape.tag == before.tag for before in self.shapes[:index]
            ):
                raise SceneError(
                    f"shapes[{index}] of scene '{self.name}' is of body {shape.tag}: give one "
                    f"shape for each of the bodies {sorted(tags)} that changes"
                )

    @property
    def named(self) -> set[str]:
        """Parameters that bodies and laws of contacts name, in addition to those of loads."""
        dependents = list(self.shapes)
        texts = [
            text
            for body in self.bodies
            for text in (body.young, body.poisson)
            if isinstance(text, str)
        ]
        texts += [text for law in self.laws if law is not None for text in law.texts]
        if texts:
            from hhr_dolfinx.formulas import Formula

            dependents += map(Formula, texts)
        return {name for dependent in dependents for name in dependent.variables}

    def _check_places(self) -> None:
        """Raise SceneError for duplicate items, and for openings of missing pairs."""
        tags = [body.tag for body in self.bodies]
        for index, tag in enumerate(tags):
            if (first := tags.index(tag)) != index:
                raise SceneError(
                    f"bodies {first} and {index} have the same cell tag {tag}: their stiffness "
                    "would add up. List each body once, and give each its own tag in the mesh"
                )
        for index, pair in enumerate(self.contacts):
            for tag in pair.tags:
                check_tag(f"surface of contact {index}", tag)
            if len(set(pair.tags)) < len(pair.tags):
                raise SceneError(
                    f"contact {index} pairs surface {pair.tags[0]} with itself: each side needs a "
                    "tag. Name the surface of the other body, or split one that folds onto itself"
                )
            for before, earlier in enumerate(self.contacts[:index]):
                if _same_pair(pair, earlier):
                    raise SceneError(
                        f"contacts {before} and {index} are the same pair of surfaces "
                        f"{tuple(pair.tags)}: its conditions would be dependent. List each pair "
                        "once"
                    )
        names = [output.name for output in self.outputs]
        for name in names:
            if names.count(name) > 1:
                raise SceneError(f"two outputs are called '{name}': give each a different name")
        overwriting: dict[int, int] = {}
        for index, opening in enumerate(self.openings):
            if (
                opening.overwrites
                and (before := overwriting.setdefault(opening.contact, index)) != index
            ):
                raise SceneError(
                    f"openings {before} and {index} both overwrite the gaps of contact "
                    f"{opening.contact}, and each is the whole gap: leave one of them out, or "
                    "give one without overwrites=True, which adds to it"
                )
            if opening.contact >= len(self.contacts):
                pairs = ", ".join(
                    f"{index} of {tuple(pair.tags)}" for index, pair in enumerate(self.contacts)
                )
                raise SceneError(
                    f"an opening names contact {opening.contact}, of {len(self.contacts)} counted "
                    f"from 0: name one of {pairs}"
                )

    def _check_names(self) -> None:
        driven = (
            *self.displacements,
            *self.constraints,
            *self.openings,
            *self.loads,
        )
        for element in driven:
            amplitude: Any = getattr(element, "amplitude", None)
            if isinstance(amplitude, Amplitude):
                try:
                    amplitude.row(self.parameters)
                except SceneError as error:
                    raise SceneError(f"{element!r}: {error}") from None
            elif hasattr(amplitude, "variables"):
                check_formula(amplitude.text, self.parameters, f"the amplitude of {element!r}")
            if hasattr(element, "check"):
                element.check(self.parameters)
            if hasattr(element, "check_scene"):
                element.check_scene(self)


def _named_in_short(item: object) -> str:
    tag = getattr(item, "tag", None)
    return type(item).__name__ if tag is None else f"{type(item).__name__} of {tag}"


def _has(*names: str) -> Callable[[object], bool]:
    return lambda item: not isinstance(item, type) and all(hasattr(item, name) for name in names)


_PARTS = (
    ("bodies", "a Body", lambda item: isinstance(item, Body)),
    (
        "contacts",
        "a contact pair with tags and rows, such as Obstacle or NodeToNode",
        _has("tags", "rows"),
    ),
    ("displacements", "a Displacement", lambda item: isinstance(item, Displacement)),
    ("loads", "a load with terms, such as Pressure", _has("terms")),
    ("constraints", "a constraint with equations, such as Tie", _has("equations", "amplitude")),
    ("openings", "an Opening", lambda item: isinstance(item, Opening)),
    ("shapes", "a Shape", _has("coordinates", "moved")),
    (
        "outputs",
        "an output with name, unit and prepared, such as LargestPressure",
        _has("name", "unit", "prepared"),
    ),
)
"""Fields of a scene with several items, a description of each item, and its test."""


def _same_pair(one: Pairing, other: Pairing) -> bool:
    """True if two contact pairs are redundant: the same surfaces, and no distinct normals."""
    if set(one.tags) != set(other.tags):
        return False
    if (same_as := getattr(one, "same_as", None)) is not None:
        return bool(same_as(other))
    first, second = (_direction(getattr(pair, "normal", None)) for pair in (one, other))
    cosine = math.nan
    if first is not None and second is not None and first.shape == second.shape:
        cosine = float(first @ second)
    if len(one.tags) == 1:
        # a corner between two obstacles is two pairs of one surface
        with suppress(ValueError):  # a pairing with arrays
            if one is other or one == other:
                return True
        return type(one) is type(other) and cosine > 1 - 1e-12
    return math.isnan(cosine) or abs(cosine) > 1 - 1e-12


def _direction(normal: Sequence[float] | None) -> np.ndarray | None:
    """Unit vector of a normal, or None for an invalid one, which the pairing reports."""
    try:
        vector = np.asarray(normal, dtype=float)
    except (TypeError, ValueError):
        return None
    length = np.linalg.norm(vector)
    return vector / length if vector.ndim == 1 and 0 < length < np.inf else None
