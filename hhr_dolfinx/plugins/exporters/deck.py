"""The problem of one parameter as a deck for CalculiX or Abaqus, to check a scene in another code.

Loads are nodal forces and imposed displacements are numbers, so the check covers mesh, materials,
supports and contact. Contact is a surface-to-surface penalty: with nodes that face edges, as on
matching meshes, CalculiX does not converge node to surface. The penalty stiffness can be changed in
the deck.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Protocol

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.compat import topology
from hhr_dolfinx.contact.law import PairLaw
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.files import replacing
from hhr_dolfinx.formulas import Scalar
from hhr_dolfinx.full_order.discretisation import Discretisation
from hhr_dolfinx.geometries.cells import CORNERS, EDGES, FACES, TENSOR_ORDER
from hhr_dolfinx.parameters import Place, PointLike, Tag

PENALTY = 100.0
"""Normal penalty stiffness times the length of a facet, over the largest Young's modulus."""
_ELEMENTS = {"plane_strain": "CPE", "plane_stress": "CPS", "axisymmetric": "CAX", "solid": "C3D"}
"""Names of elements by hypothesis; the number of nodes follows."""


def write_deck(path: Path, discretisation: Discretisation, mu: PointLike) -> None:
    """Write the deck of a scene at a parameter.

    Args:
        path: file of the deck.
        discretisation: discretisation of the scene, on one rank.
        mu: parameters, (P,).

    Raises:
        SceneError: for scenes that a deck cannot describe: with inelastic bodies, shapes, gradings,
            rigid obstacles or added gaps.
    """
    scene = discretisation.scene
    point = scene.parameters.point(mu)
    _check(discretisation, point)
    problem = discretisation.contact_problem(*discretisation.stiffness_terms())
    lines = [
        "*HEADING",
        f"{scene.name} at {scene.parameters.described(point)}",
        *_mesh(discretisation),
    ]
    lines += [*_materials(discretisation, point), *_contacts(discretisation, point)]
    lines += _step(discretisation, problem, point)
    with replacing(path, text=True) as file:
        file.write("\n".join(lines) + "\n")


def _check(discretisation: Discretisation, point: np.ndarray) -> None:
    scene = discretisation.scene
    faults = {
        "cells of second order have nodes in the middle of faces": (
            discretisation.order > 1 and discretisation.mesh.topology.cell_name() in TENSOR_ORDER
        ),
        "bodies flow": bool(scene.reader),
        "K is that of a user's system": scene.system is not None,
        "shapes depend on parameters": bool(scene.shapes),
        "bodies are graded": any(body.grading is not None for body in scene.bodies),
        "bodies have a user-defined stress": any(map(scene.states_stress, scene.bodies)),
        "a surface meets a rigid obstacle": any(
            len(contact.tags) == 1 for contact in scene.contacts
        ),
        "a contact has a law with a limit": any(
            _in_deck(law).limited(law) for law in scene.laws if law is not None
        ),
        "displacements follow others by constraints": bool(scene.constraints),
        "springs hold bodies": any(hasattr(load, "stiffness") for load in scene.loads),
        "gaps are added": any(
            scene.opened(k, point) or scene.overwritten(k) for k in range(len(scene.contacts))
        ),
    }
    for fault, present in faults.items():
        if present:
            raise SceneError(
                f"{fault} in scene '{scene.name}', which a deck cannot say: export it without"
            )


class LawInDeck(Protocol):
    """Facet ``deck`` of a law of interfaces."""

    def limited(self, law: PairLaw) -> bool:
        """True if a deck cannot say all of a pair's law."""

    def lines(
        self, law: PairLaw, number: Callable[[float | str], float], penalty: float
    ) -> Iterator[str]:
        """Lines in the interaction of a pair.

        Args:
            law: law of the pair.
            number: value of a number or formula at the point of the deck.
            penalty: penalty stiffness of the pair, in stress per length.
        """


def _in_deck(law: PairLaw) -> LawInDeck:
    """The facet ``deck`` of a law; refused if its plug-in has none."""
    facet: LawInDeck = registry.facet(law.plugin, "deck", f"a deck of contacts with {law.words}")
    return facet


def _mesh(discretisation: Discretisation) -> Iterator[str]:
    points = discretisation._points()
    cells = _cells(discretisation)
    kind = f"{_ELEMENTS[discretisation.scene.hypothesis]}{cells.shape[1]}"
    yield "*NODE, NSET=NALL"
    for number, position in enumerate(points, start=1):
        yield ", ".join([str(number), *(_text(x) for x in position)])
    owner = discretisation.cell_bodies()
    for index, body in enumerate(discretisation.scene.bodies):
        yield f"*ELEMENT, TYPE={kind}, ELSET={_word(body.tag)}"
        for number in np.flatnonzero(owner == index).tolist():
            yield ", ".join(str(n) for n in (number + 1, *(cells[number] + 1)))
    scene = discretisation.scene
    dim = points.shape[1]
    tags = [displacement.tag for displacement in scene.displacements] + [
        getattr(load, "tag", None) for load in scene.loads
    ]
    bodies = {body.tag for body in scene.bodies}
    for tag in dict.fromkeys(tag for tag in tags if tag is not None and tag not in bodies):
        nodes = np.unique(discretisation._tagged_dofs(tag, 0) // dim) + 1
        yield f"*NSET, NSET={_word(tag)}"
        yield from (
            ", ".join(map(str, chunk))
            for chunk in np.array_split(nodes, -(-nodes.size // 12))
            if chunk.size
        )


def _cells(discretisation: Discretisation) -> np.ndarray:
    """Nodes of the cells in the order of Abaqus; counterclockwise in the plane."""
    cells = discretisation._cell_nodes()
    kind = discretisation.mesh.topology.cell_name()
    if discretisation.order > 1:
        corners = _oriented(discretisation, cells[:, : CORNERS[kind]].copy())
        return np.hstack([corners, _between(kind, cells, corners)])
    return _oriented(
        discretisation, cells[:, TENSOR_ORDER[kind]] if kind in TENSOR_ORDER else cells.copy()
    )


def _between(kind: str, cells: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Nodes on the edges of second-order cells, (cells, edges), from the order of their corners,
    (cells, corners).
    """
    node_of: dict[tuple[int, ...], int] = {}
    for index, edge in enumerate(topology(kind)[0]):
        ends = np.sort(cells[:, edge], axis=1)
        node_of |= dict(
            zip(map(tuple, ends.tolist()), cells[:, CORNERS[kind] + index].tolist(), strict=True)
        )
    wanted = (np.sort(corners[:, edge], axis=1).tolist() for edge in EDGES[kind])
    return np.array([[node_of[tuple(ends)] for ends in edge] for edge in wanted]).T


def _oriented(discretisation: Discretisation, cells: np.ndarray) -> np.ndarray:
    """Corners of cells, reordered to be counterclockwise in the plane, and positively oriented in
    space.
    """
    points = discretisation._points()[cells]
    if points.shape[2] == 2:
        first = points[:, 1] - points[:, 0]
        last = points[:, -1] - points[:, 0]
        counterclockwise = first[:, 0] * last[:, 1] - first[:, 1] * last[:, 0] > 0
        cells[~counterclockwise] = cells[~counterclockwise][:, ::-1]
        return cells
    edges = (
        points[:, k] - points[:, 0] for k in ((1, 2, 3) if points.shape[1] == 4 else (1, 3, 4))
    )
    outward = np.linalg.det(np.stack(list(edges), axis=1)) > 0
    order = [0, 2, 1, 3] if points.shape[1] == 4 else [0, 3, 2, 1, 4, 7, 6, 5]
    cells[~outward] = cells[~outward][:, order]
    return cells


def _word(tag: Tag | Place) -> str:
    """Tag as a valid name of a deck: one word that begins with a letter."""
    word = "".join(letter if letter.isalnum() else "_" for letter in str(tag))
    return word if word[:1].isalpha() else f"tag_{word}"


def _materials(discretisation: Discretisation, point: np.ndarray) -> Iterator[str]:
    for body in discretisation.scene.bodies:
        name = _word(body.tag)
        young, poisson = (
            _number(value, discretisation, point) for value in (body.young, body.poisson)
        )
        yield from (f"*MATERIAL, NAME=M{name}", "*ELASTIC", f"{_text(young)}, {_text(poisson)}")
        yield f"*SOLID SECTION, ELSET={name}, MATERIAL=M{name}"
        if (
            discretisation.mesh.geometry.dim == 2
            and discretisation.scene.hypothesis != "axisymmetric"
        ):
            yield "1.0"


def _text(value: float) -> str:
    """Number with as many digits as fit into the twenty characters that CalculiX reads."""
    digits = repr(float(value))
    return digits if len(digits) <= 20 else f"{value:.13e}"


def _number(value: float | str, discretisation: Discretisation, point: np.ndarray) -> float:
    return float(Scalar(str(value), discretisation.scene.parameters.names).value(point))


def _contacts(discretisation: Discretisation, point: np.ndarray) -> Iterator[str]:
    cells = _cells(discretisation)
    kind = discretisation.mesh.topology.cell_name()
    corners = np.array(FACES[kind])
    faces = {
        tuple(sorted(face)): (cell + 1, k + 1)
        for cell, nodes in enumerate(cells)
        for k, face in enumerate(nodes[corners].tolist())
    }
    scene = discretisation.scene
    sizes = []
    for tag in dict.fromkeys(tag for contact in scene.contacts for tag in contact.tags):
        surface = discretisation.surface(tag)
        sizes.append(float(surface.sizes.mean()) ** (1 / (len(surface.points[0]) - 1)))
        yield f"*SURFACE, NAME={_word(tag)}, TYPE=ELEMENT"
        facets = surface.facets if surface.quadratic is None else surface.quadratic.corners
        for facet in surface.nodes[facets].tolist():
            number, face = faces[tuple(sorted(facet))]
            yield f"{number}, S{face}"
    stiffest = max(_number(body.young, discretisation, point) for body in scene.bodies)
    penalty = PENALTY * stiffest / min(sizes)
    for index, (contact, law) in enumerate(zip(scene.contacts, scene.laws, strict=True)):
        yield from (
            f"*SURFACE INTERACTION, NAME=CONTACT{index}",
            "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR",
        )
        yield f"{penalty:.6e}, {1e-6 * stiffest:.6e}"
        if law is not None:
            yield from _in_deck(law).lines(
                law, lambda value: _number(value, discretisation, point), penalty
            )
        yield f"*CONTACT PAIR, INTERACTION=CONTACT{index}, TYPE=SURFACE TO SURFACE"
        yield f"{_word(contact.tags[0])}, {_word(contact.tags[1])}"


def _step(
    discretisation: Discretisation, problem: ContactProblem, point: np.ndarray
) -> Iterator[str]:
    theta = problem.amplitudes(point)
    dim = problem.block_size
    yield from ("*STEP, INC=200", "*STATIC", "0.1, 1.0, 1e-6, 0.2", "*BOUNDARY")
    imposed = np.asarray(problem.lifts @ theta)
    for dof in np.flatnonzero(~problem.free):
        yield f"{dof // dim + 1}, {dof % dim + 1}, {dof % dim + 1}, {_text(imposed[dof])}"
    forces = np.asarray(problem.external @ theta)
    if np.any(forces):
        yield "*CLOAD"
        for dof in np.flatnonzero(forces):
            yield f"{dof // dim + 1}, {dof % dim + 1}, {_text(forces[dof])}"
    yield from ("*NODE PRINT, NSET=NALL", "U", "*NODE FILE", "U", "*EL FILE", "S", "*END STEP")
