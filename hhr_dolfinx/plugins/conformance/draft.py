"""Drafts of small scenes, to which switches of plug-ins add one capability each.

A draft is two blocks on each other. The upper side of the lower block is round, so that some
contacts are open and some closed at each step of the load path, which pushes the upper block down,
draws it aside and unloads it again.

A switch is a function of a draft that returns another one with its capability, registered in
``Plugin.switches``. With an argument ``neutral`` it adds the capability with a value that must
change nothing if ``neutral`` is true: a coefficient of friction of 0, an obstacle far away. A
switch that takes the draft alone has no such value.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from inspect import signature
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from mpi4py import MPI

from hhr_dolfinx import registry
from hhr_dolfinx.amplitudes import Amplitude
from hhr_dolfinx.body import Body
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side, two_blocks
from hhr_dolfinx.loads import Load, Pressure
from hhr_dolfinx.outputs import ContactForce, DisplacementAt, Output
from hhr_dolfinx.pairings import Pairing
from hhr_dolfinx.pairings.node_to_node import NodeToNode
from hhr_dolfinx.parameters import ParameterSpace, Tag
from hhr_dolfinx.scene import Displacement, Opening, Scene

if TYPE_CHECKING:
    from hhr_dolfinx.compat import TaggedMesh
    from hhr_dolfinx.contact.law import PairLaw
    from hhr_dolfinx.full_order.system import System
    from hhr_dolfinx.models.model import AnsweringModel
    from hhr_dolfinx.plugins.constraints.elimination import Constraint
    from hhr_dolfinx.plugins.inelastic.law import Law
    from hhr_dolfinx.plugins.shapes.shape import Shape

Geometry = Callable[[MPI.Comm], "TaggedMesh"]
"""Function of a communicator that makes a mesh with tags."""
Path = list[tuple[float, np.ndarray]]
"""Times and parameters of a load path."""

LEFT_END = 1.0
RIGHT_END = 4.0
MIDDLE = 2.5
"""Ends of the lower block along x, in axisymmetry of the radius, and their mean."""
BESIDE = 3.0
"""Position at which outputs read displacements: in the middle that along x nearly vanishes, 1/400
of the other one.
"""
FAR = 100.0
"""Coordinate of what is too far away to be touched."""
ROUNDNESS = 0.06
"""Depth of the round upper side at a distance of 1 from the middle."""
COURSE = (0.0, 0.3, 1.0, 0.8, 0.5)
ASIDE = (0.0, 0.3, 0.75, 1.0, 0.6)
"""Fractions of the largest push, and of the largest motion aside and load, at the times 0 to 4."""


class Excluded(Exception):
    """Capabilities that exclude each other by what they mean; the text says why."""


class Varied(NamedTuple):
    """A parameter: ends of its range, and its value at each time of the path, or a constant."""

    name: str
    lower: float
    upper: float
    values: tuple[float, ...] | float

    def along(self, scale: float, share: float | None) -> np.ndarray:
        """Values along a path, (T,): scaled ones, or a constant at a share of the range.

        Args:
            scale: factor of values that change along the path.
            share: share of the range for constant parameters, from 0 to 1; None takes their value.
        """
        if not isinstance(self.values, tuple):
            between = self.lower + (share or 0.0) * (self.upper - self.lower)
            return np.full(len(COURSE), self.values if share is None else between)
        return scale * np.array(self.values)


class NodesBetween(NamedTuple):
    """Nodes at one place along the first axis, between two heights."""

    along: float
    lower: float
    upper: float

    def nodes(self, points: np.ndarray) -> np.ndarray:
        """See :class:`~hhr_dolfinx.parameters.Place`."""
        between = (points[:, 1] > self.lower) & (points[:, 1] < self.upper)
        return np.flatnonzero(between & np.isclose(points[:, 0], self.along, atol=1e-6))


class Kind(NamedTuple):
    """Properties that decide how other switches add their capability, such as the dimension."""

    hypothesis: str = "plane_strain"
    element: str = ""
    simplices: bool = False
    matching: bool = True


@dataclass(frozen=True)
class SceneDraft:
    """A small scene of two blocks that is not yet made.

    Attributes:
        kind: hypothesis, elements of second order by their name, and mesh.
        bodies: the lower and the upper block.
        pairing: makes the pairing of (upper surface, lower surface); None for the usual one.
        usual: the usual pairing; None for facing nodes.
        law: friction or another law of this pair, as arguments of the pairing.
        obstacles: further pairings.
        varied: further parameters.
        loads, openings, displacements, constraints, shapes, outputs: further parts of the scene.
        held: True if a displacement presses the upper block down, False if a pressure does.
        system: see :class:`~hhr_dolfinx.scene.Scene`.
        meshed: makes another geometry of that of the two blocks.
        remade: makes another scene of the finished one, such as one with a stiffness of another
            code.
        full, condensed: make the full and the condensed model of the scene; None for the usual.
    """

    kind: Kind = Kind()
    bodies: tuple[Body, Body] = (Body(FIRST, 3.0, 0.3), Body(SECOND, 5.0, 0.3))
    pairing: Callable[..., Pairing] | None = None
    usual: Callable[..., Pairing] | None = None
    law: Mapping[str, float | str | PairLaw] = field(default_factory=dict)
    obstacles: tuple[Pairing, ...] = ()
    varied: tuple[Varied, ...] = ()
    loads: tuple[Load, ...] = ()
    openings: tuple[Opening, ...] = ()
    displacements: tuple[Displacement, ...] = ()
    constraints: tuple[Constraint, ...] = ()
    shapes: tuple[Shape, ...] = ()
    outputs: tuple[Output, ...] = ()
    held: bool = True
    system: Callable[..., System] | None = None
    meshed: Callable[[Geometry], Geometry] | None = None
    remade: Callable[[Scene], Scene] | None = None
    full: Callable[[Scene], AnsweringModel] | None = None
    condensed: Callable[[Scene], AnsweringModel] | None = None

    @property
    def dimension(self) -> int:
        """Dimension of space."""
        return 3 if self.kind.hypothesis == "solid" else 2

    @property
    def flanks(self) -> tuple[float, float]:
        """Places of the flanks of the upper block along the first axis."""
        return (LEFT_END, RIGHT_END) if self.kind.matching else (1.5, 3.5)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates in formulas."""
        if self.kind.hypothesis == "axisymmetric":
            return ("r", "z")
        return ("x", "y", "z")[: self.dimension]

    def at(self, x: float | str, y: float | str) -> tuple[float | str, ...]:
        """Coordinates of a point in the middle of the third axis.

        Args:
            x: first coordinate, a number or a formula.
            y: second coordinate, a number or a formula.
        """
        return (x, y, 0.5)[: self.dimension]

    def vector(self, x: float, y: float) -> tuple[float, ...]:
        """Vector in the plane of the first two axes.

        Args:
            x: first component.
            y: second component.
        """
        return (x, y, 0.0)[: self.dimension]

    def nodes(self, along: float, lower: float, upper: float) -> NodesBetween:
        """Nodes at a position on the first axis, between two heights.

        Args:
            along: first coordinate.
            lower: lower end of the second coordinate.
            upper: upper end of the second coordinate.
        """
        return NodesBetween(along, lower, upper)

    def exclude(self, condition: bool, reason: str) -> None:
        """Raise Excluded with a reason if a condition holds."""
        if condition:
            raise Excluded(reason)

    def of_hypothesis(self, hypothesis: str) -> SceneDraft:
        """The draft of another hypothesis than plane strain."""
        chosen = self.kind.hypothesis
        conflict = chosen not in ("plane_strain", hypothesis)
        self.exclude(conflict, f"a scene is {chosen} or {hypothesis}, not both")
        return replace(self, kind=self.kind._replace(hypothesis=hypothesis))

    def of_element(self, element: str) -> SceneDraft:
        """The draft with an element of second order."""
        chosen = self.kind.element
        self.exclude(chosen not in ("", element), f"elements are {chosen} or {element}, not both")
        return replace(self, kind=self.kind._replace(element=element))

    def of_simplices(self) -> SceneDraft:
        """The draft on triangles or tetrahedra."""
        return replace(self, kind=self.kind._replace(simplices=True))

    def of_other_meshes(self) -> SceneDraft:
        """The draft on blocks of other widths, whose meshes do not match."""
        return replace(self, kind=self.kind._replace(matching=False))

    def with_parameter(
        self,
        name: str,
        lower: float,
        upper: float,
        values: float | Sequence[float],
    ) -> SceneDraft:
        """The draft with a parameter and its values along the path, (T,), or its constant.

        Args:
            name: name of the parameter.
            lower: lower end of its range.
            upper: upper end of its range.
            values: values along the path, (T,), or its constant.
        """
        along = float(values) if isinstance(values, int | float) else tuple(map(float, values))
        return replace(self, varied=(*self.varied, Varied(name, lower, upper, along)))

    def with_load_parameter(self, name: str, largest: float, neutral: bool) -> SceneDraft:
        """The draft with a parameter from 0 to a largest value along the path; 0 if neutral.

        Args:
            name: name of the parameter.
            largest: value at the end of the path.
            neutral: keep the value 0 along the path.
        """
        values = [0.0 if neutral else 0.8 * largest * share for share in ASIDE]
        return self.with_parameter(name, -0.2 * largest, largest, values)

    def with_body(self, tag: Tag, changed: Callable[[Body], Body]) -> SceneDraft:
        """The draft with a body that is changed.

        Args:
            tag: tag of the body.
            changed: makes the changed body of the one in the draft.
        """
        lower, upper = (changed(body) if body.tag == tag else body for body in self.bodies)
        return replace(self, bodies=(lower, upper))

    @property
    def hookean(self) -> Body:
        """The first body that does not state its elasticity by itself."""
        bodies = [
            body
            for body in self.bodies
            if body.stress is None and not getattr(body.law, "elastic", False)
        ]
        self.exclude(not bodies, "each body states its elasticity by itself")
        return bodies[0]

    def with_body_law(self, law: Law) -> SceneDraft:
        """The draft with a law of the first body that has none, and no formulas that the law would
        leave out.
        """
        left_out = getattr(law, "elastic", False)
        without = [
            body.tag for body in self.bodies if body.law is None and not (left_out and body.varies)
        ]
        self.exclude(not without, "both bodies have a law, and a body has one")
        return self.with_body(without[0], lambda body: replace(body, law=law))

    def with_pairing(self, pairing: Callable[..., Pairing]) -> SceneDraft:
        """The draft with another pairing of the blocks, on meshes that do not match."""
        conflict = self.pairing not in (None, pairing)
        self.exclude(conflict, "the surfaces of the blocks are paired in one way")
        return replace(self.of_other_meshes(), pairing=pairing)

    def with_contact_law(self, **law: float | str | PairLaw) -> SceneDraft:
        """The draft with a law of the pair of blocks, as arguments of its pairing: one of its
        pressures, and one of friction.
        """
        twice = bool(self.law.keys() & law.keys())
        self.exclude(twice, "the pair of blocks has such a law, and a pair has one of each")
        return replace(self, law={**self.law, **law})

    def with_obstacle(self, pairing: Pairing) -> SceneDraft:
        """The draft with a further pairing."""
        return replace(self, obstacles=(*self.obstacles, pairing))

    def with_mesh(self, meshed: Callable[[Geometry], Geometry]) -> SceneDraft:
        """The draft on another mesh, made of that of the blocks."""
        self.exclude(self.meshed is not None, "a section is tied or drawn together in one way")
        return replace(self, meshed=meshed)

    def with_loads(self, *loads: Load) -> SceneDraft:
        """The draft with further loads."""
        return replace(self, loads=(*self.loads, *loads))

    def with_constraints(self, *constraints: Constraint) -> SceneDraft:
        """The draft with further constraints."""
        return replace(self, constraints=(*self.constraints, *constraints))

    def scene(self) -> Scene:
        """The scene."""
        space = self._space()
        contacts = (self._pair(), *self.obstacles)
        made = Scene(
            name="composed",
            geometry=self.geometry(),
            hypothesis=self.kind.hypothesis,
            bodies=self.bodies,
            contacts=contacts,
            parameters=ParameterSpace(
                tuple(parameter.name for parameter in space),
                tuple(parameter.lower for parameter in space),
                tuple(parameter.upper for parameter in space),
            ),
            displacements=(*self._imposed(), *self.displacements),
            loads=(*self._loads(), *self.loads),
            openings=self.openings,
            shapes=self.shapes,
            constraints=self.constraints,
            order=2 if self.kind.element else None,
            system=self.system,
            outputs=(*self._outputs(), *self.outputs),
        )
        return made if self.remade is None else self.remade(made)

    def path(self, scale: float = 1.0, share: float | None = None) -> Path:
        """A load path whose values that change are scaled.

        Parameters that are constant on it have their value, or are at a share of their range.

        Args:
            scale: factor of values that change along the path.
            share: share of the range for constant parameters; None takes their values.
        """
        columns = [parameter.along(scale, share) for parameter in self._space()]
        return [(float(k), point) for k, point in enumerate(np.column_stack(columns))]

    def model(self, scene: Scene) -> AnsweringModel:
        """The full model of the scene, on one rank."""
        return FullOrderModel(scene, MPI.COMM_SELF) if self.full is None else self.full(scene)

    def geometry(self) -> Geometry:
        """The mesh of both blocks."""
        matching = self.kind.matching
        dim = self.dimension
        lower = (12, 3) if dim == 2 else (6, 2, 2)
        upper = lower if matching else (7, 3) if dim == 2 else (3, 2, 3)
        left, right = self.flanks
        blocks = partial(
            two_blocks,
            first=((LEFT_END, 0.0, 0.0)[:dim], (RIGHT_END, 1.0, 1.0)[:dim], lower),
            second=((left, 1.0, 0.0)[:dim], (right, 2.0, 1.0)[:dim], upper),
            simplices=self.kind.simplices,
            warp=rounded,
        )
        return blocks if self.meshed is None else self.meshed(blocks)

    def _space(self) -> tuple[Varied, ...]:
        push = Varied("push", -0.004, 0.06, tuple(0.05 * share for share in COURSE))
        if not self.held:
            push = Varied("push", 0.002, 0.1, tuple(0.01 + 0.07 * share for share in COURSE))
        drag = Varied("drag", -0.01, 0.03, tuple(0.024 * share for share in ASIDE))
        load = Varied("load", -0.01, 0.05, tuple(0.03 * share for share in ASIDE))
        return (push, drag, load, *self.varied)

    def _imposed(self) -> tuple[Displacement, ...]:
        bottom = side(FIRST, 1, False)
        top = side(SECOND, 1, True)
        imposed = [*Displacement.clamp(bottom, self.dimension)]
        imposed.append(Displacement(top, 0, Amplitude(slopes={"drag": 1.0})))
        imposed += [Displacement(top, 2)] if self.dimension == 3 else []
        if self.held:
            imposed.append(Displacement(top, 1, Amplitude(slopes={"push": -1.0})))
        return tuple(imposed)

    def _loads(self) -> tuple[Load, ...]:
        flank = side(SECOND, 0, True)
        top = side(SECOND, 1, True)
        aside = Pressure(flank, Amplitude(slopes={"load": 1.0}))
        return (aside,) if self.held else (aside, Pressure(top, Amplitude(slopes={"push": 1.0})))

    def _pair(self) -> Pairing:
        upper = side(SECOND, 1, False)
        lower = side(FIRST, 1, True)
        facing: Callable[..., Pairing] = partial(NodeToNode, normal=self.vector(0.0, -1.0))
        return (self.pairing or self.usual or facing)(upper, lower, **self.law)

    def _outputs(self) -> tuple[Output, ...]:
        point = tuple(map(float, self.at(BESIDE, 1 / 3 if self.dimension == 2 else 0.5)))
        return (
            ContactForce("force", 0, self.vector(0.0, 1.0)),
            DisplacementAt("sunk", point, 1, tag=FIRST),
            DisplacementAt("moved", point, 0, tag=FIRST),
        )


def rounded(points: np.ndarray, tag: int) -> np.ndarray:
    """Coordinates, (n, dim), with a round upper side of the lower block.

    Args:
        points: coordinates of nodes, (n, dim).
        tag: tag of the body that they belong to.
    """
    warped = points.copy()
    if tag == FIRST:
        warped[:, 1] -= ROUNDNESS * points[:, 1] * (points[:, 0] - MIDDLE) ** 2
    return warped


Switch = Callable[..., SceneDraft]


class ChosenSwitch(NamedTuple):
    """A switch by its name, which may add its neutral value."""

    name: str
    switch: Switch
    neutral: bool = False

    def applied(self, draft: SceneDraft) -> SceneDraft:
        """The draft with the capability."""
        return self.switch(draft, self.neutral) if has_neutral(self.switch) else self.switch(draft)


def switches() -> dict[str, Switch]:
    """Switches of all plug-ins by name."""
    return {
        name: registry.load(import_path) for name, import_path in registry.named("switches").items()
    }


def has_neutral(switch: Switch) -> bool:
    """True if a switch has a value that changes nothing: it then takes an argument ``neutral``."""
    return "neutral" in signature(switch).parameters


def composed(chosen: Iterable[ChosenSwitch], start: SceneDraft | None = None) -> SceneDraft:
    """The draft with all capabilities, whatever their order.

    Switches look at the kind of the draft. If one changes it, all are applied again to a draft of
    the new kind.

    Args:
        chosen: switches of the capabilities.
        start: draft to begin with; None takes the blocks alone.

    Raises:
        Excluded: if the capabilities exclude each other by what they mean.
    """
    start = SceneDraft() if start is None else start
    chosen = tuple(chosen)
    while True:
        draft = start
        for switch in chosen:
            draft = switch.applied(draft)
        if draft.kind == start.kind:
            return draft
        start = replace(start, kind=draft.kind)
