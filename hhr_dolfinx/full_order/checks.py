"""Checks of a mesh, its tags and its supports, before a scene is assembled on them.

Every check is collective: all ranks get the same result, so that none waits for another that has
failed.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from dolfinx import mesh as dmesh

from hhr_dolfinx import compat, registry
from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.body import laws_of_scenes
from hhr_dolfinx.contact.rows import ContactRows
from hhr_dolfinx.errors import SceneError, SceneWarning, rounded
from hhr_dolfinx.full_order.names import TagNames
from hhr_dolfinx.group import ProcessGroup
from hhr_dolfinx.parameters import Tag
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    from hhr_dolfinx.compat import TaggedMesh

SUPPORTED_CELLS = {"triangle": 3, "quadrilateral": 4, "tetrahedron": 4, "hexahedron": 8}
"""Supported cells, with their number of corners."""
FOLDED = 1e-6
"""Part of the largest Jacobian of a cell up to which an opposite sign is round-off of
coordinates.
"""
NO_VOLUME = 1e-12
"""Volume of a cell over the power of its length up to which it counts as zero: far below cells of
aspect 1e4.
"""


def build_geometry(
    scene: Scene, group: ProcessGroup
) -> tuple[*TaggedMesh, TagNames, Mapping[Tag, np.ndarray]]:
    """Mesh, cell tags, facet tags, their names and sets of nodes.

    Args:
        scene: the scene.
        group: processes that share the mesh.

    Raises:
        SceneError: if they do not fit the scene.
    """
    result: Any = scene.geometry(group.comm)
    groups = getattr(result, "physical_groups", None)
    sets: Mapping[Tag, np.ndarray] = getattr(result, "nodes", {})
    if hasattr(result, "cell_tags") and hasattr(result, "facet_tags"):
        result = (result.mesh, result.cell_tags, result.facet_tags)
    if not isinstance(result, tuple | list) or len(result) != 3:
        raise SceneError(
            f"the geometry of scene '{scene.name}' must return (mesh, cell_tags, facet_tags), not "
            f"{result!r}"
        )
    mesh, *tags = result
    _check_mesh(scene, mesh, group)
    order_of(scene, mesh)
    for kind, tags_of_kind, dim in zip(
        ("cell", "facet"), tags, (mesh.topology.dim, mesh.topology.dim - 1), strict=True
    ):
        if tags_of_kind is None or tags_of_kind.dim != dim:
            returned = "None" if tags_of_kind is None else f"tags of dimension {tags_of_kind.dim}"
            raise SceneError(
                f"the geometry of scene '{scene.name}' returned {returned} for the {kind} tags: "
                "every body and every surface with a load, a displacement or a contact needs one; "
                "in gmsh, a physical group"
            )
    _check_cells(scene, mesh, group)
    if scene.hypothesis == "axisymmetric":
        _check_radius(mesh, group)
    names = TagNames.of(groups, mesh.topology.dim, getattr(result, "summary", None))
    check_tags(scene, mesh, tags, names, group, sets)
    return (*result, names, sets)


def warn_of_idle_parameters(scene: Scene, amplitudes: Amplitudes) -> None:
    """Warn of parameters on which no amplitude, body or law of a scene depends.

    Args:
        scene: the scene.
        amplitudes: amplitudes of its terms.
    """
    laws = [
        laws_of_scenes(body.reader).parameters_of(body.law) for body in scene.bodies if body.reader
    ]
    used = scene.named.union(*laws)
    idle = tuple(name for name in amplitudes.idle(scene.parameters) if name not in used)
    if idle and scene.system is None:  # a user-defined system may use any
        warn(
            f"parameters {idle} of scene '{scene.name}' have no effect: no displacement, load, "
            "opening, extent, body, law or shape names them. Remove them from the ParameterSpace, "
            "or name them in the slopes of an Amplitude",
            SceneWarning,
        )


def _check_mesh(scene: Scene, mesh: dmesh.Mesh, group: ProcessGroup) -> None:
    """Raise SceneError for a mesh of another dimension, with other cells, or on another
    communicator.
    """
    tdim = mesh.topology.dim
    gdim = mesh.geometry.dim
    kind = mesh.topology.cell_name()
    if mesh.comm.size != group.size:
        raise SceneError(
            f"the mesh of scene '{scene.name}' is spread over {mesh.comm.size} ranks and was "
            f"requested on {group.size}: its geometry must build it on the communicator it is "
            "given"
        )
    if tdim < gdim:
        local = np.ptp(mesh.geometry.x[:, 2]) if gdim == 3 and len(mesh.geometry.x) else 0.0
        planar = tdim == 2 and gdim == 3 and group.total(float(local)) == 0.0
        remedy = (
            "all its points lie in one plane: build it with two coordinates, gmsh_to_mesh(model, "
            "comm, gdim=2)"
            if planar
            else "shells, membranes and bars are not supported: mesh the volume of the bodies, and "
            "save it; in gmsh give the volumes a physical group"
        )
        raise SceneError(
            f"the mesh of scene '{scene.name}' has cells of dimension {tdim} in a space of "
            f"dimension {gdim}: {remedy}"
        )
    if kind not in SUPPORTED_CELLS:
        raise SceneError(
            f"cells of kind {kind} of scene '{scene.name}' are not supported, only "
            f"{', '.join(SUPPORTED_CELLS)}"
        )
    wanted = 3 if scene.hypothesis == "solid" else 2
    if gdim != wanted:
        suitable = "solid" if gdim == 3 else "plane_strain, plane_stress or axisymmetric"
        raise SceneError(
            f"hypothesis '{scene.hypothesis}' of scene '{scene.name}' needs a mesh of dimension "
            f"{wanted}, and this one has {gdim}: take {suitable}, or another mesh"
        )


def _check_cells(scene: Scene, mesh: dmesh.Mesh, group: ProcessGroup) -> None:
    """Raise SceneError for cells that are folded or without volume, and for ranks without cells.

    Such cells would not be noticed later: K uses the absolute value of Jacobians. A plug-in with
    the tool ``mending``, a function of the geometry, has the advice for folded cells of second
    order.
    """
    dim = mesh.topology.dim
    count = SUPPORTED_CELLS[mesh.topology.cell_name()]
    nodes = compat.geometry_dofmap(mesh)[: mesh.topology.index_map(dim).size_local]
    without = group.gathered(len(nodes)).count(0)
    if without:
        raise SceneError(
            f"{without} of {group.size} ranks have no cell of the mesh: take fewer ranks, or a "
            "finer mesh"
        )
    degree = compat.degree_of(mesh)
    if degree > 2:
        raise SceneError(
            f"cells of order {degree} are not supported: make the mesh of order 2 or 1, in gmsh "
            "by setOrder(2)"
        )
    corners = mesh.geometry.x[nodes][:, :, :dim]
    finite = np.isfinite(corners).all(axis=(1, 2))
    points = np.where(finite[:, None, None], corners, 0.0)
    jacobians = jacobians_of(mesh, points)
    corners = corners[:, :count]
    mean = jacobians.mean(axis=1)
    largest = np.abs(jacobians).max(axis=1)
    empty = finite & ~(
        np.abs(mean) > NO_VOLUME * np.ptp(corners, axis=1).max(axis=1) ** corners.shape[2]
    )
    folded = (jacobians * np.sign(mean)[:, None]).min(axis=1) < -FOLDED * largest
    mend = "mend the mesh there"
    advice = registry.offered("mending") if degree == 2 else None
    for bad, fault, remedy in (
        (~finite, "have coordinates that are not finite", mend),
        (empty, "have no volume", mend),
        (folded, "are folded or turned inside out", advice(scene.geometry) if advice else mend),
    ):
        text = "{count} cells of the mesh {why}, e.g. around {place}: {remedy}"
        _refuse(group, text, corners[bad].mean(axis=1), why=fault, remedy=remedy)
    _refuse(
        group,
        "{count} pairs of neighbouring cells lie on the same side of their common facet, e.g. at "
        "{place}: one of them is turned inside out. Mend the mesh there",
        _overlapping_neighbours(mesh),
    )


def order_of(scene: Scene, mesh: dmesh.Mesh) -> int:
    """Degree of the displacement, by the scene or else the mesh.

    Args:
        scene: the scene.
        mesh: its mesh.

    Raises:
        SceneError: for a displacement of first order on a mesh of second order.
    """
    geometry = compat.degree_of(mesh)
    order = geometry if scene.order is None else scene.order
    if order < geometry <= 2:
        raise SceneError(
            f"the cells of scene '{scene.name}' are of second order, and order = {order}: leave "
            "it out, or mesh with cells of first order, in gmsh setOrder(1)"
        )
    return order


def _overlapping_neighbours(mesh: dmesh.Mesh) -> np.ndarray:
    """Middles of the facets whose two cells lie on the same side, (q, dim): the only sign of folded
    simplices.
    """
    dim = mesh.topology.dim
    mesh.topology.create_connectivity(dim - 1, dim)
    owned = mesh.topology.index_map(dim - 1).size_local
    both = mesh.topology.connectivity(dim - 1, dim)
    inner = np.flatnonzero(np.diff(both.offsets[: owned + 1]) == 2)
    corners = compat.geometry_dofmap(mesh)[:, : SUPPORTED_CELLS[mesh.topology.cell_name()]]
    nodes = corners[both.array[both.offsets[inner][:, None] + [0, 1]]]
    same = nodes[:, 0, :, None] == nodes[:, 1, None, :]
    # cells with more than one common facet have been found as folded or empty before
    count = dim if nodes.shape[2] == dim + 1 else 2 ** (dim - 1)
    common_facet = same.sum(axis=(1, 2)) == count
    nodes = nodes[common_facet]
    common = same[common_facet].any(axis=2)
    opposite = same[common_facet].any(axis=1)
    points = mesh.geometry.x[:, :dim]
    facet = points[nodes[:, 0][common].reshape(-1, count)]
    far = [
        points[nodes[:, k][~mask].reshape(-1, nodes.shape[2] - count)]
        for k, mask in enumerate((common, opposite))
    ]
    along = np.moveaxis(facet[:, 1:dim] - facet[:, :1], 1, 2)
    # the sign of a determinant is the side of the facet to which a direction points
    sides = [
        np.linalg.det(
            np.concatenate([along, (points.mean(axis=1) - facet.mean(axis=1))[:, :, None]], axis=2)
        )
        for points in far
    ]
    scale = np.abs(sides).max(axis=0)
    bad = (sides[0] * sides[1] > 0) & (np.abs(sides).min(axis=0) > FOLDED * scale)
    return facet[bad].mean(axis=1)


def corner_jacobians(corners: np.ndarray) -> np.ndarray:
    """Determinant of the Jacobian at tensor-ordered corners of cells, (c, k, dim): (c, k), for
    simplices (c, 1).
    """
    dim = corners.shape[2]
    if corners.shape[1] == dim + 1:
        return np.linalg.det(corners[:, 1:] - corners[:, :1])[:, None]
    numbers = np.arange(2**dim)
    edges = [
        corners[:, numbers | (1 << axis)] - corners[:, numbers & ~(1 << axis)]
        for axis in range(dim)
    ]
    return np.linalg.det(np.stack(edges, axis=2))


def jacobians_of(mesh: dmesh.Mesh, points: np.ndarray) -> np.ndarray:
    """Determinant of the Jacobian at the nodes of cells, (c, k).

    Args:
        mesh: mesh with the kind of the cells.
        points: coordinates of the nodes, (c, k, dim).
    """
    if compat.degree_of(mesh) == 1:
        return corner_jacobians(points)
    kind = mesh.topology.cell_name()
    slopes = compat.shape_functions(kind, compat.nodes_of_cell(kind, 2), 2)[1]
    return np.linalg.det(np.einsum("qkd,ckx->cqdx", slopes, points))


def _check_radius(mesh: dmesh.Mesh, group: ProcessGroup) -> None:
    """Raise SceneError for bodies that cross the axis of revolution."""
    owned = mesh.geometry.index_map().size_local
    radius = mesh.geometry.x[:owned, 0]
    size = group.total(float(np.abs(radius).max(initial=0.0)))
    _refuse(
        group,
        "{count} nodes of an axisymmetric mesh have r < 0, e.g. at {place}: the first coordinate "
        "is the radius and the axis is r = 0; mesh one half of the section",
        mesh.geometry.x[:owned][radius < -1e-9 * size, :2],
    )


def check_tags(
    scene: Scene,
    mesh: dmesh.Mesh,
    tags: Sequence[dmesh.MeshTags],
    names: TagNames,
    group: ProcessGroup,
    sets: Container[object] = (),
) -> None:
    """Check that the tags of the scene and of the mesh agree.

    Args:
        scene: the scene.
        mesh: its mesh.
        tags: tags of cells and of facets.
        names: names of these tags.
        group: processes that share the mesh.
        sets: names of sets of nodes in the file of the mesh.

    Raises:
        SceneError: for tags of the scene that the mesh lacks, and for cells that belong to no body.
    """
    held = [named.tag for named in scene.displacements]
    used: list[Tag] = [tag for tag in held if isinstance(tag, int | str) and tag not in sets]
    for named in scene.contacts:
        used += named.tags
    check_present("facet", tags[1], used, names, group)
    bodies = [body.tag for body in scene.bodies]
    owner: dict[int, Tag] = {}
    for tag in bodies:
        for number in names.cell(tag):
            if owner.setdefault(number, tag) != tag:
                raise SceneError(
                    f"bodies {owner[number]!r} and {tag!r} have cells in common: list one of them"
                )
    unused = check_present("cell", tags[0], bodies, names, group) - set(owner)
    if unused:
        raise SceneError(
            f"cells tagged {names.described('cell', unused)} belong to no body of scene "
            f"'{scene.name}': give each a Body, or leave them out of the mesh"
        )
    count = mesh.topology.index_map(mesh.topology.dim).size_local
    untagged = group.total(count - int((tags[0].indices < count).sum()))
    if untagged:
        raise SceneError(
            f"{untagged} cells have no tag: every cell must belong to a body of scene "
            f"'{scene.name}'. Put them into a physical group, and give this a Body"
        )


def check_present(
    kind: str, tags: dmesh.MeshTags, wanted: Iterable[Tag], names: TagNames, group: ProcessGroup
) -> set[int]:
    """All tags of a mesh, on all ranks.

    Args:
        kind: ``cell`` or ``facet``.
        tags: tags of this kind.
        wanted: tags that must be there, by number or name.
        names: names of the tags.
        group: processes that share the mesh.

    Raises:
        SceneError: if a wanted tag is missing.
    """
    present = set().union(*group.gathered(set(tags.values.tolist())))
    numbers = names.cell if kind == "cell" else names.facet
    missing = [tag for tag in wanted if not present & set(numbers(tag))]
    if missing:
        missing = sorted(set(missing), key=str)
        raise SceneError(
            f"{kind} tags {missing} are not in the mesh, which has {names.described(kind, present)}"
            f"{names.of_file(missing)}"
        )
    return present


def tagged(tags: dmesh.MeshTags, numbers: Iterable[int]) -> np.ndarray:
    """Numbers of the entities of this rank with one of some tags, in their order.

    Args:
        tags: tags of cells or facets.
        numbers: the tags to look for.
    """
    return np.sort(np.concatenate([tags.find(number) for number in numbers]))


def check_outer(
    load: str,
    tag: Tag,
    mesh: dmesh.Mesh,
    facet_tags: dmesh.MeshTags,
    names: TagNames,
    group: ProcessGroup,
) -> None:
    """Check that the facets of a load are on the outside of the mesh.

    Args:
        load: name of the load, for the message.
        tag: facet tag of the load.
        mesh: the mesh.
        facet_tags: tags of its facets.
        names: names of the tags.
        group: processes that share the mesh.

    Raises:
        SceneError: for missing facets and for facets inside the mesh, on which surface integrals
            are zero.
    """
    check_present("facet", facet_tags, [tag], names, group)
    fdim = mesh.topology.dim - 1
    mesh.topology.create_connectivity(fdim, fdim + 1)
    outer = dmesh.exterior_facet_indices(mesh.topology)
    owned = mesh.topology.index_map(fdim).size_local
    facets = tagged(facet_tags, names.facet(tag))
    inner = np.setdiff1d(facets[facets < owned], outer)
    _refuse(
        group,
        f"{{count}} facets tagged {tag} under a {load} lie inside the mesh, e.g. at {{place}}: "
        "loads act on outer facets only. Tag the surface, or give the bodies separate nodes",
        dmesh.compute_midpoints(mesh, fdim, inner)[:, : fdim + 1],
    )


def _refuse(group: ProcessGroup, text: str, places: np.ndarray, **words) -> None:
    """Raise SceneError on all ranks if any has points, (q, dim).

    ``text`` uses ``{count}``, ``{place}``, words.
    """
    points = [point for of_rank in group.gathered(places.tolist()) for point in of_rank]
    if points:
        raise SceneError(text.format(count=len(points), place=points[0], **words))


def conditions_with_unknowns(
    scene: Scene, rows: ContactRows, gaps: np.ndarray, amplitudes: Amplitudes, free: np.ndarray
) -> np.ndarray:
    """Contact rows with a free dof; the others do not constrain unknowns and are left out.

    It warns if nodes whose dofs are all imposed penetrate, in the worst case over the parameter
    range.

    Args:
        scene: the scene.
        rows: the contact rows.
        gaps: D - B lift by term, (rows, 1 + T).
        amplitudes: amplitudes of the terms.
        free: True for dofs with an unknown, (N,) bool.

    Returns:
        Indices of the rows, (m,).

    Raises:
        SceneError: if no row has a free dof.
    """
    unknown = abs(rows.matrix) @ free.astype(float) > 0
    if not unknown.any():
        tags = [pair.tags for pair in scene.contacts]
        raise SceneError(
            "the contact pairs are empty: all of their nodes have imposed displacements. Leave "
            f"out displacements of scene '{scene.name}' on nodes of the surfaces {tags}"
        )
    imposed = np.flatnonzero(~unknown)
    least, points = amplitudes.least(gaps[imposed], scene.parameters)
    deep = least < -1e-9 * np.ptp(rows.points, axis=0).max(initial=np.abs(least).max(initial=0.0))
    if deep.any():
        worst = int(least.argmin())
        mu = dict(zip(scene.parameters.names, points[worst].tolist(), strict=True))
        warn(
            f"at {int(deep.sum())} places of contacts of scene '{scene.name}' all nodes have "
            f"imposed displacements and penetrate, most ({-least[worst]:.3g}) at "
            f"{rounded(rows.points[imposed[worst]])} for {mu}: no force acts there. Change these "
            "displacements, the gap or the box of the parameters",
            SceneWarning,
        )
    return np.flatnonzero(unknown)
