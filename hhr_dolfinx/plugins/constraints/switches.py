"""Switches of constraints, and of sections through a body."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import mesh as dmesh
from mpi4py import MPI

from hhr_dolfinx import registry
from hhr_dolfinx.amplitudes import Amplitude
from hhr_dolfinx.compat import geometry_dofmap
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side
from hhr_dolfinx.plugins.constraints.couplings import CoupledForce, MeanMotion, RigidMotion
from hhr_dolfinx.plugins.constraints.cut import OTHER_SIDE, CutMesh
from hhr_dolfinx.plugins.constraints.directed import DirectedDisplacement
from hhr_dolfinx.plugins.constraints.equations import Equation, Periodic
from hhr_dolfinx.plugins.constraints.preload import BoltForce, ForcedSection, Preload
from hhr_dolfinx.plugins.constraints.serendipity import Serendipity
from hhr_dolfinx.plugins.constraints.tie import Tie

if TYPE_CHECKING:
    from hhr_dolfinx.compat import TaggedMesh
    from hhr_dolfinx.plugins.conformance.draft import Geometry, SceneDraft

SECTION = "SECTION"
"""Name of the section through the upper block."""


def equation(draft: SceneDraft) -> SceneDraft:
    """Both flanks of the upper block move alike at one height."""
    left, right = (draft.nodes(flank, 1.45, 1.9) for flank in draft.flanks)
    return draft.with_constraints(Equation(((left, 0, 1.0), (right, 0, -1.0))))


def periodic(draft: SceneDraft) -> SceneDraft:
    """The lower block is one of many in a row."""
    draft.exclude(draft.kind.hypothesis == "axisymmetric", "rings do not repeat along the radius")
    leader = side(FIRST, 0, False)
    follower = side(FIRST, 0, True)
    return draft.with_constraints(Periodic(follower, leader, shift=draft.vector(3.0, 0.0)))


def rigid_motion(draft: SceneDraft) -> SceneDraft:
    """The left flank of the lower block moves as a rigid body."""
    return draft.with_constraints(RigidMotion(draft.nodes(1.0, 0.2, 1.1)))


def mean_motion(draft: SceneDraft) -> SceneDraft:
    """The mean motion of the right flank of the lower block is imposed."""
    draft = draft.with_load_parameter("bend", 0.01, False)
    bent = MeanMotion(draft.nodes(4.0, 0.2, 1.1), 0, Amplitude(slopes={"bend": 1.0}))
    return draft.with_constraints(bent)


def coupled_force(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """A force on the reference point of the right flank of the lower block.

    Args:
        draft: the scene to extend.
        neutral: True for values that leave the answer as it is.
    """
    draft = draft.with_load_parameter("tug", 0.01, neutral)
    force = CoupledForce(side(FIRST, 0, True), 1, Amplitude(slopes={"tug": 1.0}))
    return draft.with_loads(force)


def directed(draft: SceneDraft) -> SceneDraft:
    """The component of a displacement along a diagonal is imposed at a flank of the upper block."""
    nodes = draft.nodes(draft.flanks[0], 1.2, 1.55)
    along = draft.vector(1.0, 1.0)
    amplitude = Amplitude(slopes={"drag": 0.5})
    return draft.with_constraints(DirectedDisplacement(nodes, along, amplitude))


def serendipity(draft: SceneDraft) -> SceneDraft:
    """Serendipity elements."""
    draft.exclude(draft.kind.simplices, "serendipity elements are quadrilaterals or hexahedra")
    return draft.of_element("serendipity").with_constraints(Serendipity())


def tie(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """The parts of the upper block beside a section are tied, as if it were not cut.

    Args:
        draft: the scene to extend.
        neutral: True for values that leave the answer as it is; a tie always does.
    """
    return draft.with_mesh(sectioned).with_constraints(Tie(SECTION + OTHER_SIDE, SECTION))


def preload(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """The upper block is shortened at a section.

    Args:
        draft: the scene to extend.
        neutral: True for values that leave the answer as it is.
    """
    draft = draft.with_load_parameter("shortened", 0.005, neutral).with_mesh(sectioned)
    return draft.with_constraints(Preload(SECTION, Amplitude(slopes={"shortened": 1.0})))


def bolt_force(draft: SceneDraft) -> SceneDraft:
    """A force at a section pushes the lower part of the upper block down, which a bedding holds."""
    public = registry.named("public")
    draft.exclude("Springs" not in public, "a part that a force alone moves needs a bedding")
    bedding = registry.load(public["Springs"])(side(SECOND, 0, False), 1, 1.0, bedding=True)
    draft = draft.with_load_parameter("bolt", 0.1, False).with_mesh(sectioned)
    force = BoltForce(SECTION, Amplitude(slopes={"bolt": -1.0}))
    return draft.with_constraints(ForcedSection(SECTION)).with_loads(force, bedding)


def sectioned(geometry: Geometry) -> Geometry:
    """The geometry by way of a file, cut along a horizontal section through the upper block."""

    def made(comm: MPI.Comm) -> TaggedMesh:
        with TemporaryDirectory() as folder:
            path = Path(folder) / "blocks.msh"
            path.write_text(gmsh_text(*geometry(MPI.COMM_SELF)))
            return CutMesh(path, sections=(SECTION,))(comm)

    return made


def gmsh_text(mesh: dmesh.Mesh, cells: dmesh.MeshTags, facets: dmesh.MeshTags) -> str:
    """Text of a file of gmsh, version 2.2, with the section as a separate surface.

    Args:
        mesh: the mesh.
        cells: tags of its cells.
        facets: tags of its facets.
    """
    dim = mesh.geometry.dim
    mesh.topology.create_connectivity(dim - 1, 0)
    middle = 4 / 3 if dim == 2 else 1.5
    section_facets = dmesh.locate_entities(mesh, dim - 1, lambda x: np.isclose(x[1], middle))
    kind = mesh.topology.cell_name()
    number, order = {
        "triangle": (2, [0, 1, 2]),
        "quadrilateral": (3, [0, 1, 3, 2]),
        "tetrahedron": (4, [0, 1, 2, 3]),
        "hexahedron": (5, [0, 1, 3, 2, 4, 5, 7, 6]),
    }[kind]
    of_facets = {"tetrahedron": (2, [0, 1, 2]), "hexahedron": (3, [0, 1, 3, 2])}
    sides, turned = of_facets.get(kind, (1, [0, 1]))
    nodes = geometry_dofmap(mesh)
    values = np.zeros(len(nodes), dtype=int)
    values[cells.indices] = cells.values
    rows = [(number, tag, nodes[cell][order]) for cell, tag in enumerate(values)]
    for indices, tags in (
        (facets.indices, facets.values),
        (section_facets, np.full(section_facets.size, 9999)),
    ):
        corners = dmesh.entities_to_geometry(mesh, dim - 1, np.asarray(indices, dtype=np.int32))
        rows += [
            (sides, tag, cell_nodes[turned]) for tag, cell_nodes in zip(tags, corners, strict=True)
        ]
    points = [f"{k + 1} {x!r} {y!r} {z!r}" for k, (x, y, z) in enumerate(mesh.geometry.x.tolist())]
    numbered = [
        (k, cell, 2, tag, tag, *(cell_nodes + 1))
        for k, (cell, tag, cell_nodes) in enumerate(rows, 1)
    ]
    elements = [" ".join(map(str, row)) for row in numbered]
    text = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", "1"]
    text += [f'{dim - 1} 9999 "{SECTION}"', "$EndPhysicalNames"]
    text += ["$Nodes", str(len(points)), *points, "$EndNodes"]
    text += ["$Elements", str(len(elements)), *elements, "$EndElements"]
    return "\n".join(text) + "\n"
