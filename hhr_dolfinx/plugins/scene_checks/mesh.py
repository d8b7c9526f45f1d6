"""Checks of the mesh of a scene: sizes, shapes of cells, bodies in several pieces, merged, or
inside each other.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from dolfinx import geometry
from mpi4py import MPI
from scipy.spatial import cKDTree

from hhr_dolfinx.amplitudes import Amplitude, bound
from hhr_dolfinx.body import Body
from hhr_dolfinx.errors import rounded
from hhr_dolfinx.full_order.checks import SUPPORTED_CELLS
from hhr_dolfinx.full_order.free_bodies import components_of_nodes
from hhr_dolfinx.geometries.mesh_file import MeshFile
from hhr_dolfinx.pairings.surface import Surface
from hhr_dolfinx.parameters import ParameterSpace, PointLike
from hhr_dolfinx.plugins.scene_checks.findings import SceneCheck

BAD_CELL = 0.1
"""Scaled Jacobian of a cell below which it is reported."""
SMALLEST_EXTENT = 1e-4
"""Extent of a mesh in m below which its unit may be another one than the scene states."""
LARGEST_EXTENT = 50.0
"""Extent of a mesh in m beyond which its unit may be another one than the scene states."""
SOFT_MODULUS = 1e9
"""Modulus in Pa below which its unit may be another one: structural plastics are stiffer."""
STIFF_MODULUS = 1.2e12
"""Modulus in Pa above which its unit may be another one: diamond is the stiffest material."""
MODULI_RATIO = 1e6
"""Ratio of the moduli of two bodies above which one may be in another unit: steel is 1e5 times as
stiff as rubber.
"""
SAME_PLACE = 1e-9
"""Distance of two nodes over the extent of the mesh below which they coincide."""


@dataclass(frozen=True)
class MeshLook:
    """Points, (nodes, dim), and nodes of the cells, (cells, k), of a whole mesh, with the number of
    corners of a cell.

    ``owner`` is the index in the scene of the body of each cell, (cells,).
    """

    points: np.ndarray
    cells: np.ndarray
    owner: np.ndarray
    corners: int

    @classmethod
    def of(cls, check: SceneCheck) -> MeshLook:
        """Nodes and cells of a scene with a mesh."""
        discretisation = check.meshed
        corners = SUPPORTED_CELLS[discretisation.mesh.topology.cell_name()]
        return cls(
            discretisation._points(),
            discretisation._cell_nodes(),
            discretisation.cell_bodies(),
            corners,
        )

    @property
    def extent(self) -> float:
        """Longest side of the box around it."""
        return float(np.ptp(self.points, axis=0).max())

    def nodes_of(self, body: int) -> np.ndarray:
        """True for each node of a body, (nodes,) bool."""
        of_body = np.zeros(len(self.points), dtype=bool)
        of_body[self.cells[self.owner == body]] = True
        return of_body

    def pieces_of(self, body: int) -> np.ndarray:
        """Connected component of a body that each node belongs to, from 0.

        -1 for other nodes, (nodes,).
        """
        labels = components_of_nodes(len(self.points), self.cells[self.owner == body])
        of_body = self.nodes_of(body)
        pieces = np.full(len(labels), -1)
        pieces[of_body] = np.unique(labels[of_body], return_inverse=True)[1]
        return pieces


def look_at_mesh(check: SceneCheck) -> None:
    """Check bodies one by one, and compare their sizes with the units."""
    look = MeshLook.of(check)
    for index, body in enumerate(check.scene.bodies):
        cells = look.points[look.cells[look.owner == index]]
        size = _size(cells.reshape(-1, look.points.shape[1]))
        corners = cells[:, : look.corners]
        kind = f"cell{'s' * (len(cells) > 1)}{' of second order' * (cells.shape != corners.shape)}"
        moduli = f"young = {body.young}, poisson = {body.poisson}"
        text = f"body {body.tag!r}: {len(corners)} {kind}, {size}{check.length}, {moduli}"
        check.say(text)
        worst, where = worst_cell(corners)
        if worst < BAD_CELL:
            check.note(
                f"body {body.tag!r} has bad cells, the worst at {rounded(where)} with a quality of "
                f"{worst:.2g} of 1: stresses are wrong there. Mesh it more evenly"
            )
        _modulus(check, body)
    _stiffness_apart(check)
    _unit_of_length(check, look)
    _large_motions(check, look)


COARSE_MESH = 0.1
"""Estimated part of the stress in energy above which a mesh is reported as coarse."""


def look_at_mesh_error(check: SceneCheck, point: PointLike | None = None) -> None:
    """Solve the full model once, and report the estimated error of the mesh.

    Args:
        check: findings of the scene, which receive the estimate.
        point: parameters, (P,); None takes the middle of the box.
    """
    from hhr_dolfinx.full_order.full import FullOrderModel
    from hhr_dolfinx.plugins.scene_checks.mesh_error import mesh_error

    if check.scene.reader or any(map(check.scene.states_stress, check.scene.bodies)):
        check.note(
            "the error of the mesh is estimated for elastic bodies alone, and some have laws of "
            "their own"
        )
        return
    with check.heard():
        full = FullOrderModel(check.scene, MPI.COMM_SELF)
        answer = full.solve(full.parameters.middle if point is None else point)
        off = mesh_error(full, answer)
        if off[0] > COARSE_MESH:
            remedy = "refine the mesh, or take Scene(order=2) where surfaces of contact are flat"
            check.note(f"{off.in_words()}; more than {COARSE_MESH:.0%} is much: {remedy}")
        else:
            check.say(off.in_words())


def look_at_joints(check: SceneCheck) -> None:
    """Report doubled or shared nodes: bodies that are split or merged by mistake."""
    look = MeshLook.of(check)
    tags = [body.tag for body in check.scene.bodies]
    of_bodies = [look.nodes_of(index) for index in range(len(tags))]
    paired = set()  # bodies in contact, by their indices, the smaller one first
    joins = [
        (check.meshed.assembler(tie), tie)
        for tie in check.scene.constraints
        if hasattr(tie, "slave")
    ]
    tied = [[of.surface(tag) for tag in (tie.slave, tie.master)] for of, tie in joins]
    for surfaces in (*(surfaces for surfaces, _ in check.pairs), *tied):
        sides = [
            [k for k, nodes in enumerate(of_bodies) if nodes[surface.nodes].any()]
            for surface in surfaces
        ]
        paired |= {
            (min(k, m), max(k, m))
            for first, second in combinations(sides, 2)
            for k in first
            for m in second
        }
    twins = cKDTree(look.points).query_pairs(SAME_PLACE * look.extent, output_type="ndarray")
    cuts = [cut for cut in check.scene.constraints if hasattr(cut, "section")]
    cut_nodes = [check.meshed.assembler(cut).surface(cut.section).nodes for cut in cuts]
    twins = twins[
        ~np.isin(twins, np.concatenate(cut_nodes or [np.zeros(0, dtype=int)])).any(axis=1)
    ]
    for index, tag in enumerate(tags):
        pieces = look.pieces_of(index)
        doubled = twins[(pieces[twins] >= 0).all(axis=1)]
        if len(doubled) and (index, index) not in paired:
            check.note(
                f"body {tag!r} falls apart: {len(doubled)} of its nodes are there twice, e.g. at "
                f"{rounded(look.points[doubled[0, 0]])}, and its cells are not connected there. "
                "Merge these nodes, in gmsh by removeDuplicateNodes or by a fragment of its "
                "volumes before they are meshed"
            )
        elif pieces.max() > 0:
            check.say(f"body {tag!r} is made of {pieces.max() + 1} pieces")
    for first, second in combinations(range(len(tags)), 2):
        common = np.flatnonzero(of_bodies[first] & of_bodies[second])
        if common.size:
            check.say(
                f"bodies {tags[first]!r} and {tags[second]!r} share {common.size} nodes: they are "
                "glued there"
            )
        between = (of_bodies[first][twins] & of_bodies[second][twins][:, ::-1]).any(axis=1)
        if between.any() and (first, second) not in paired:
            check.note(
                f"bodies {tags[first]!r} and {tags[second]!r} touch at {int(between.sum())} nodes, "
                f"e.g. at {rounded(look.points[twins[between][0, 0]])}, and no contact pair is "
                "between them: they go through each other. Give their surfaces a contact pair, or "
                "merge these nodes to glue them"
            )


def look_at_common_nodes(check: SceneCheck) -> None:
    """Report nodes that belong to both surfaces of a pair: no contact acts there."""
    for contact, (surfaces, _) in enumerate(check.pairs):
        for first, second in combinations(surfaces, 2):
            common = np.isin(first.nodes, second.nodes)
            if common.any():
                check.note(
                    f"contact {contact}: surfaces {first.tag!r} and {second.tag!r} share "
                    f"{int(common.sum())} nodes, e.g. at {rounded(first.points[common][0])}: they "
                    "are glued there and cannot open. Give each body separate nodes, in gmsh "
                    "without a fragment or removeDuplicateNodes"
                )


def depth_inside(check: SceneCheck, first: Surface, second: Surface) -> tuple[int, float]:
    """Count nodes of a surface inside the body of another one as drawn.

    Depths are those below the nearest facet of the other surface.

    Args:
        check: findings of the scene, with its discretisation.
        first: surface whose nodes are counted.
        second: surface of the other body.

    Returns:
        Number of nodes, and the depth of the deepest in the unit of length.
    """
    look = MeshLook.of(check)
    mesh = check.meshed.mesh
    bodies = [
        body for body in range(len(check.scene.bodies)) if look.nodes_of(body)[second.nodes].all()
    ]
    points = np.zeros((len(first.nodes), 3))
    points[:, : look.points.shape[1]] = first.points
    near = geometry.compute_collisions_points(geometry.bb_tree(mesh, mesh.topology.dim), points)
    hits = geometry.compute_colliding_cells(mesh, near, points)
    _, nearest = cKDTree(second.corners.mean(axis=1)).query(first.points)
    heights = np.einsum(
        "nd,nd->n", second.outward[nearest], first.points - second.corners.mean(axis=1)[nearest]
    )
    depths = []
    for number, node in enumerate(first.nodes):
        cells = hits.links(number)
        # a node of both bodies lies in cells of both
        opposite = cells[
            np.isin(look.owner[cells], bodies) & ~(look.cells[cells] == node).any(axis=1)
        ]
        if opposite.size and heights[number] < 0:
            depths.append(-float(heights[number]))
    return len(depths), max(depths, default=0.0)


def worst_cell(corners: np.ndarray) -> tuple[float, np.ndarray]:
    """Smallest scaled Jacobian of cells, (c, k, dim), and its position: volume at a corner over its
    edges.

    Stretched bricks have 1, a sliver nearly 0.
    """
    count, dim = corners.shape[1:]
    numbers = range(count)
    worst = np.ones(len(corners))
    for at in numbers:
        neighbours = (
            [n for n in numbers if n != at]
            if count == dim + 1
            else [at ^ (1 << axis) for axis in range(dim)]
        )
        edges = corners[:, neighbours] - corners[:, [at]]
        lengths = np.linalg.norm(edges, axis=2).prod(axis=1)
        worst = np.minimum(worst, np.abs(np.linalg.det(edges)) / lengths)
    where = int(worst.argmin())
    return float(worst[where]), corners[where].mean(axis=0)


def _size(points: np.ndarray) -> str:
    return " x ".join(f"{value:.4g}" for value in np.ptp(points, axis=0))


def young_of(body: Body, space: ParameterSpace) -> float:
    """Young's modulus, in the middle of the box if it is a parameter; NaN for another formula.

    Args:
        body: the body.
        space: parameters of the scene.
    """
    if not isinstance(body.young, str):
        return float(body.young)
    index = space.names.index(body.young) if body.young in space.names else None
    return np.nan if index is None else (space.lower[index] + space.upper[index]) / 2


def _modulus(check: SceneCheck, body: Body) -> None:
    units = check.scene.units
    if units is None:
        return
    young = young_of(body, check.scene.parameters)
    pascals = units.pascals(young)
    unit = f"give E in {units.stress}, the unit of stress of the scene"
    if pascals < SOFT_MODULUS:
        text = (
            "is softer than plastics (1 GPa), as rubber and foam are: where a stiffer one is "
            f"meant, {unit}"
        )
        check.note(f"body {body.tag!r}: E = {young:g} {units.stress} {text}")
    elif pascals > STIFF_MODULUS:
        check.note(
            f"body {body.tag!r}: E = {young:g} {units.stress} is stiffer than diamond (1200 GPa): "
            f"{unit}"
        )


def _stiffness_apart(check: SceneCheck) -> None:
    space = check.scene.parameters
    pairs = [(young_of(body, space), repr(body.tag)) for body in check.scene.bodies]
    by_stiffness = sorted(
        (pair for pair in pairs if not np.isnan(pair[0])), key=lambda pair: pair[0]
    )
    if not by_stiffness:
        return
    soft, softest = by_stiffness[0]
    stiff, stiffest = by_stiffness[-1]
    if stiff > MODULI_RATIO * soft:
        check.note(
            f"body {stiffest} with E = {stiff:g} is {stiff / soft:.2g} times as stiff as body "
            f"{softest} with E = {soft:g}: give both in one unit; where that is meant, take the "
            "stiff one as rigid, an Obstacle or imposed displacements"
        )


def _unit_of_length(check: SceneCheck, look: MeshLook) -> None:
    units = check.scene.units
    if units is None or SMALLEST_EXTENT <= units.metres(look.extent) <= LARGEST_EXTENT:
        return
    source = check.scene.geometry
    subject = (
        f"the mesh of file {source.path}"
        if isinstance(source, MeshFile)
        else f"the mesh of scene '{check.scene.name}'"
    )
    check.note(
        f"{subject} is {_size(look.points)} {units.length}: where that is not meant, its "
        "coordinates are in another unit. Say by what they are to be multiplied, "
        "MeshFile(path, scale=...), or give the scene the Units of the mesh"
    )


def _large_motions(check: SceneCheck, look: MeshLook) -> None:
    space = check.scene.parameters
    box = np.array([space.lower, space.upper], dtype=float)
    named = [
        (f"the displacement on {imposed.tag!r}", imposed.amplitude)
        for imposed in check.scene.displacements
    ]
    named += [
        (f"the opening of contact {opening.contact}", opening.amplitude)
        for opening in check.scene.openings
    ]
    for label, amplitude in named:
        amplitude = bound(amplitude, space)
        if isinstance(amplitude, Amplitude):
            reached = np.sort(box * amplitude.row(space), axis=0).sum(axis=1) + amplitude.constant
        else:
            reached = np.array([amplitude.value(point) for point in space.random(64, seed=0)])
        largest = float(np.abs(reached).max())
        if largest > look.extent:
            check.note(
                f"{label} reaches {largest:.4g}{check.length}, and the whole mesh is "
                f"{look.extent:.4g}{check.length} long: bring parameters and mesh to one unit, by "
                "MeshFile(path, scale=...) or by the slopes"
            )
