"""Rigid tools of a scene that are driven: ``hhr.drive``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.parameters import as_tuple, is_number, is_whole
from hhr_dolfinx.plugins.constraints.couplings import CoupledForce, MeanMotion, RigidMotion
from hhr_dolfinx.plugins.rigid_tools.mesh import ToolMesh
from hhr_dolfinx.plugins.rigid_tools.pairing import OnTool
from hhr_dolfinx.scene import Body, Scene

MODULUS = 1.0
"""Young's modulus of the cell of a tool, which moves as a rigid body and has no strain."""


class ToolBody(Body):
    """The cell of a tool, whose nodes places such as ``hhr.Nodes`` do not hold."""

    by_place: ClassVar[bool] = False


def drive(
    scene: Scene,
    contacts: int | Sequence[int],
    *,
    at: Sequence[float],
    force: Mapping[int, Any] | None = None,
    motion: Mapping[int, Any] | None = None,
    name: str = "tool",
) -> Scene:
    """The scene with a rigid tool that forces drive: where it goes is a part of the answer.

    The obstacles of some contacts become the tool. It moves as one rigid body, and drags by
    friction what it presses on. Components are those of its reference point, 0 and 1, in space 0
    to 2, then its turns in rad, 2 in the plane, 3 to 5 in space. In axisymmetry it moves along the
    axis, 1. Motions are small, as those of all bodies: places that meet, and normals, are those of
    the tool where it is drawn.

    Args:
        scene: scene with obstacles, such as ``Obstacle`` and ``Sphere``.
        contacts: indices of the contacts of the tool.
        at: its reference point, (dim,), to which forces, moments and turns refer.
        force: force or moment by the component that it drives: a number, an Amplitude, or a formula
            of the parameters as text. 0 leaves the component free.
        motion: motion by its component, likewise. The tool is held along components that are not
            named.
        name: name of its body and of its surface, for ``hhr.ToolMotion`` and for more loads.

    Returns:
        A scene, for models of all kinds.

    Raises:
        SceneError: for a contact that is no rigid obstacle, components that do not exist or are
            named twice, and scenes with a user-defined system.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> from dataclasses import replace
        >>> from hhr_dolfinx.geometries import block
        >>> above = hhr.Obstacle(block.side(1, upper=True), normal=(0, 1), offset=1.0)
        >>> foot = hhr.Displacement.clamp(block.side(1, upper=False), 2)
        >>> pressed = replace(scene, contacts=(above,), displacements=foot, loads=())
        >>> driven = hhr.drive(pressed, 0, at=(0.5, 1.0), force={1: "-push", 2: 0.0})
        >>> float(hhr.condense(driven).solve({"push": 50.0}).forces().sum().round(9))
        50.0
    """
    _check_scene(scene, name)
    numbers = _numbers(contacts)
    for number in numbers:
        _check_obstacle(scene, number)
    point = as_tuple(f"the reference point of tool '{name}'", () if at is None else at)
    if len(point) not in (2, 3) or not all(map(is_number, point)):
        raise SceneError(f"the reference point {at!r} of tool '{name}' must be 2 or 3 coordinates")
    axisymmetric = scene.hypothesis == "axisymmetric"
    components = components_of(scene.hypothesis, len(point))
    forces = _by_component(force)
    motions = _by_component(motion)
    _check_components(name, forces, motions, components)
    held = {component: motions.get(component, 0.0) for component in components}
    constraints = [
        MeanMotion(name, component, amplitude, None if axisymmetric else point)
        for component, amplitude in held.items()
        if component not in forces
    ]
    loads = [
        CoupledForce(name, component, amplitude, None if axisymmetric else point)
        for component, amplitude in forces.items()
        if amplitude != 0
    ]
    return replace(
        scene,
        geometry=ToolMesh(scene.geometry, point, name, axisymmetric),
        bodies=(*scene.bodies, ToolBody(name, MODULUS, 0.0)),
        contacts=tuple(
            OnTool.of(contact, name) if number in numbers else contact
            for number, contact in enumerate(scene.contacts)
        ),
        constraints=(*scene.constraints, RigidMotion(name), *constraints),
        loads=(*scene.loads, *loads),
    )


def components_of(hypothesis: str, dim: int) -> tuple[int, ...]:
    """Components of the motion of a tool.

    Args:
        hypothesis: hypothesis of the scene.
        dim: dimension of the mesh.
    """
    if hypothesis == "axisymmetric":
        return (1,)
    return tuple(range(3 if dim == 2 else 6))


def _check_scene(scene: Scene, name: str) -> None:
    """Raise SceneError for a scene that has no room for a tool of this name."""
    if not isinstance(scene, Scene):
        raise SceneError(f"{type(scene).__name__} is no Scene: hhr.drive takes the scene itself")
    if not isinstance(name, str) or not name:
        raise SceneError(f"name = {name!r} of a tool must be a text")
    if name in [body.tag for body in scene.bodies]:
        raise SceneError(f"scene '{scene.name}' has a body '{name}': give the tool another name")
    if scene.system is not None:
        raise SceneError(
            f"scene '{scene.name}' has a user-defined system, which states K of all dofs, and "
            "not those of a tool: move the obstacle by an Opening"
        )


def _by_component(given: Any) -> dict[int, Any]:
    """Forces or motions of a tool."""
    if given is not None and not isinstance(given, Mapping):
        raise SceneError(f"forces and motions of a tool are by component, {{1: '-F'}}: {given!r}")
    return dict(given or {})


def _numbers(contacts: Any) -> tuple[Any, ...]:
    """Contacts of a tool."""
    numbers = (contacts,) if not isinstance(contacts, Sequence) else tuple(contacts)
    if not numbers:
        raise SceneError("a tool needs a contact or several, by their numbers in the scene")
    return numbers


def _check_obstacle(scene: Scene, number: Any) -> None:
    """Raise SceneError for a contact that is no rigid obstacle."""
    if not is_whole(number, 0) or number >= len(scene.contacts):
        raise SceneError(
            f"contact {number!r} is not among the {len(scene.contacts)} of scene '{scene.name}', "
            "counted from 0"
        )
    contact = scene.contacts[number]
    if isinstance(contact, OnTool):
        raise SceneError(
            f"contact {number} of scene '{scene.name}' is that of tool '{contact.tool}' already: "
            "name its forces and motions together"
        )
    if len(contact.tags) != 1:
        raise SceneError(
            f"contact {number} of scene '{scene.name}' is a {type(contact).__name__} of "
            f"{' and '.join(map(str, contact.tags))}: a tool is a rigid obstacle, such as Obstacle "
            "or Sphere. Bodies of the mesh are driven by loads, and are rigid by RigidMotion"
        )


def _check_components(
    name: str, forces: dict[int, Any], motions: dict[int, Any], known: tuple[int, ...]
) -> None:
    """Raise SceneError for components that do not exist or are named twice, and for none."""
    for component in (*forces, *motions):
        if not is_whole(component, 0) or component not in known:
            raise SceneError(
                f"component {component!r} of tool '{name}' does not exist: name one of {known}"
            )
    if twice := sorted(forces.keys() & motions.keys()):
        raise SceneError(
            f"component {twice[0]} of tool '{name}' has a force and a motion: name one of them"
        )
    if not forces and not motions:
        raise SceneError(
            f"tool '{name}' has no force and no motion: it would be an obstacle at rest"
        )
