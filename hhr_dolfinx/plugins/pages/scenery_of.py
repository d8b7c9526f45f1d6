"""Scenery of a page, from the full model: triangles to draw, points of contact, words."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.geometries.cells import CORNERS, TENSOR_ORDER, outer_faces_of_cells
from hhr_dolfinx.materials.elasticity import von_mises
from hhr_dolfinx.plugins.pages.scenery import (
    SCENERY_FILE,
    Scenery,
    SceneWords,
    Strains,
    WholeMesh,
    compliance_of,
)
from hhr_dolfinx.plugins.stress.mesh import moduli_of, strains_of_cells
from hhr_dolfinx.scene import Scene

TRIANGLES_OF_FACES = {3: ((0, 1, 2),), 4: ((0, 1, 2), (0, 2, 3))}
"""Triangles of a triangle, and of a quadrilateral with corners in circular order."""
STRAINED = 20_000
"""Number of drawn cells up to which their strains are kept: they take 50 MB in space."""
UNDEFORMED_POINTS = 8
"""Random points at which the stress of undeformed bodies is checked."""
DEVIATOR_ROUND_OFF = 1e-9
"""Part of a stress below which its deviator counts as round-off of a pressure."""


def write_scenery(full: FullOrderModel, folder: Path) -> None:
    """Write the scenery of a page next to a model in a folder. Collective.

    Args:
        full: full-order model.
        folder: folder of the model.
    """
    scenery = scenery_of(full)
    if full.comm.rank == 0:
        scenery.write(folder / SCENERY_FILE)


def scenery_of(full: FullOrderModel) -> Scenery:
    """Scenery of the scene of a full model, on each of its ranks. Collective.

    In the plane all cells, in space faces of cells that no other cell shares; for cells of second
    order the corners.

    Args:
        full: full-order model.

    Raises:
        NotOfferedError: for a model of another kind, which has no mesh to draw.
    """
    if not isinstance(full, FullOrderModel):
        raise NotOfferedError(
            f"the drawn mesh is of a full model, hhr.FullOrderModel(scene), and this is a "
            f"{type(full).__name__}"
        )
    discretisation = full.discretisation
    problem = full.problem
    triangles, outer, owners = _drawn(full)
    nodes, corners = np.unique(triangles, return_inverse=True)
    number = np.full(len(discretisation._points()), -1)
    number[nodes] = np.arange(len(nodes))
    drawn = number[outer]
    compliance = problem.contact @ full.pushed_everywhere(np.ones(full.conditions))
    if problem.kernel is not None and full.equilibrium is not None:
        contact_of_motions = problem.kernel.contact_of_motions
        compliance = compliance_of(
            lambda forces: problem.contact @ full.pushed_everywhere(forces), contact_of_motions
        )
    return Scenery(
        np.ascontiguousarray(discretisation._points()[nodes]),
        nodes.astype(np.int64),
        corners.reshape(triangles.shape).astype(np.int64),
        drawn.astype(np.int64),
        np.ascontiguousarray(problem.contact_points),
        problem.contact_areas.copy(),
        problem.contact_pairs.astype(np.int64),
        _shares(problem),
        compliance,
        bool(full.scene.shapes),
        _words(full.scene),
        None if owners is None else strains_of(full, owners),
        mesh=_whole_mesh(full),
    )


def _drawn(full: FullOrderModel) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Triangles, (t, 3), edges of the surface in the plane, (l, 2), cell of each triangle.

    None without cells.
    """
    discretisation = full.discretisation
    if not discretisation.has_mesh:  # of a system without a mesh the surface alone is known
        cells = full.answer_mesh().cells
        return (
            cells[:, [0, 0, 0] if cells.shape[1] == 1 else slice(None)],
            np.zeros((0, 2), dtype=np.int64),
            None,
        )
    kind = discretisation.mesh.topology.cell_name()
    cells = discretisation._cell_nodes()[:, : CORNERS[kind]]
    flat = full.problem.block_size == 2
    cells = (
        cells[:, TENSOR_ORDER[kind]] if kind in TENSOR_ORDER else cells
    )  # corners in circular order
    outer, owners_of_faces = outer_faces_of_cells(kind, cells)
    faces = cells if flat else outer
    owners = np.arange(len(cells)) if flat else owners_of_faces
    corners_of_triangles = TRIANGLES_OF_FACES[faces.shape[1]]
    triangles = np.concatenate([faces[:, list(corners)] for corners in corners_of_triangles])
    return (
        triangles,
        outer if flat else np.zeros((0, 2), dtype=np.int64),
        np.tile(owners, len(corners_of_triangles)),
    )


def _whole_mesh(full: FullOrderModel) -> WholeMesh:
    mesh = full.answer_mesh()
    problem = full.problem
    contact = problem.contact if problem.whole_contact is None else problem.whole_contact
    rows = csr_matrix(contact)
    return WholeMesh(
        all_points=np.ascontiguousarray(mesh.points),
        all_cells=np.ascontiguousarray(mesh.cells, dtype=np.int64),
        cell_bodies=mesh.bodies.astype(np.int64),
        slaves=mesh.slaves.astype(np.int64),
        pressing=full.problem.pressing.copy(),
        kind=mesh.kind,
        parameters=mesh.parameters,
        contact_rows=rows,
        gap_terms=problem.gaps + (rows @ problem.lifts).toarray(),
    )


def _shares(problem: ContactProblem) -> np.ndarray:
    """Condition, contact and its share, of conditions that several contacts state, (k, 3)."""
    if problem.shares is None:
        return np.zeros((0, 3))
    return np.column_stack(
        [problem.shares.conditions, problem.shares.pairs, problem.shares.shares]
    ).astype(float)


def strains_of(full: FullOrderModel, cells: np.ndarray) -> Strains | None:
    """Strains of the cells of triangles, (t,).

    None if a stress is more than moduli times strain: for bodies that are inelastic or change their
    shape, for anisotropic strains without stress, or with too many cells.

    Args:
        full: full-order model.
        cells: cell of each drawn triangle, (t,).
    """
    scene = full.scene
    drawn, positions = np.unique(cells, return_inverse=True)
    if (
        full.equilibrium is not None
        or scene.shapes
        or len(drawn) > STRAINED
        or _stressed_at_rest(full)
    ):
        return None
    discretisation = full.discretisation
    bodies = discretisation.group.joined(discretisation.cell_bodies())[drawn]
    components = 6 if scene.hypothesis == "solid" else 4
    rows = csr_matrix((len(drawn) * components, full.problem.free.size))
    for number in np.unique(bodies):
        of_body = np.flatnonzero(bodies == number)
        strain, dofs, grading, _ = strains_of_cells(discretisation, drawn[of_body], int(number))
        if scene.hypothesis == "plane_stress":
            strain[:, 2] = 0.0
        numbers = np.broadcast_to(
            (of_body[:, None] * components + np.arange(components))[:, :, None], strain.shape
        )
        columns = np.broadcast_to(dofs[:, None], strain.shape)
        values = (strain * grading[:, None, None]).ravel()
        rows = (
            rows
            + coo_matrix((values, (numbers.ravel(), columns.ravel())), shape=rows.shape).tocsr()
        )
    rows.eliminate_zeros()
    moduli = tuple(moduli_of(body, scene) for body in scene.bodies)
    return Strains(
        positions.astype(np.int64),
        bodies.astype(np.int64),
        rows,
        moduli,
        scene.hypothesis == "plane_stress",
    )


def _stressed_at_rest(full: FullOrderModel) -> bool:
    """True if undeformed bodies have a von Mises' stress, from strains without stress that have a
    deviator.
    """
    if not any(hasattr(load, "eigenstrain_of") for load in full.scene.loads):
        return False
    undeformed = np.zeros(full.problem.free.size)
    box = full.parameters
    # loads may cancel each other at ends and in the middle
    for point in (box.lower, box.upper, *box.random(UNDEFORMED_POINTS, 0)):
        stress = full.stress_of(undeformed, point)
        if von_mises(stress).max() > DEVIATOR_ROUND_OFF * np.abs(stress).max():
            return True
    return False


def _words(scene: Scene) -> SceneWords:
    units = scene.units
    bodies = []
    for body in scene.bodies:
        law = "" if body.law is None else f", {body.law!r}"
        bodies.append(f"{body.tag}: E = {_said(body.young)}, nu = {_said(body.poisson)}{law}")
    return {
        "scene": scene.name,
        "units": dict(scene.parameter_units),
        "hypothesis": scene.hypothesis.replace("_", " "),
        "bodies": bodies,
        "contacts": [" and ".join(map(str, contact.tags)) for contact in scene.contacts],
        "length": "" if units is None else units.length,
        "stress": "" if units is None else units.stress,
        "force": "" if units is None else units.force_in(scene.hypothesis),
        "work": "" if units is None else units.work_in(scene.hypothesis),
    }


def _said(value: float | str) -> str:
    return f"{value:g}" if isinstance(value, float | int) else str(getattr(value, "text", value))
