"""Rigid motions that imposed displacements do not prevent: those that contact prevents, and undetermined ones.

K is singular along them. Motions that contact resists are unknowns of the active set, see ``contact.floating``.
Motions without resistance of contact and without loads, such as the rotation of a round body without friction, are set
to zero.

A body whose imposed displacements are those of a rigid motion is lifted as a whole, so that its lift has no strain. The
lift of the thesis is nonzero on the imposed dofs alone (section 2.6), and K lift is a load. If K depends on
parameters so does that load, and it is far larger than any force on the body: interpolated between parameters its
terms cancel, and so do the energies in bounds. If the imposed values are those of a rigid motion, as for a block that
is pressed down by its top, that motion of the whole body has these values too, and K is zero along it for any moduli.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg
from scipy.sparse import csc_matrix, csr_matrix, hstack
from scipy.sparse.csgraph import connected_components

from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import NotSolvableError, SceneWarning
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.warn import warn

UNEVEN = 1e-3
"""Part of the work of its nodal forces, without signs, that a load on a round surface may do on its rotation."""
WEAK = 0.1
"""Part of the effect of other motions up to which that of a rotation may come from the facets of a round surface."""
ALMOST_NONE = 1e-9
"""Part of the largest effect of a motion, or of a load, up to which it is round-off."""


@dataclass(frozen=True)
class FreeBody:
    """Connected components with rigid-body motions.

    Attributes:
        name: of its bodies, for messages.
        nodes: its nodes.
        motions: all of its rigid motions, (k, nodes, dim), see :func:`rigid_motions`.
        left: motions compatible with imposed displacements, orthonormal combinations, (l, k).
    """

    name: str
    nodes: np.ndarray
    motions: np.ndarray
    left: np.ndarray

    def columns(self, count: int) -> np.ndarray:
        """The remaining motions on all nodes, (nodes dim, l)."""
        found = np.zeros((len(self.left), count, self.motions.shape[2]))
        found[:, self.nodes] = np.tensordot(self.left, self.motions, 1)
        return found.reshape(len(self.left), -1).T


def free_bodies(
    scene: Scene, points: np.ndarray, cell_nodes: np.ndarray, bodies: np.ndarray, free: np.ndarray
) -> list[FreeBody]:
    """Bodies with rigid-body motions: rigid motions that vanish on their imposed dofs.

    Args:
        scene: the scene.
        points: coordinates of the nodes, (nodes, dim).
        cell_nodes: nodes of each cell, (cells, n).
        bodies: index in the scene of the body of each cell, (cells,).
        free: dofs that are not imposed, (N,) bool.
    """
    count, dim = points.shape
    part = components_of_nodes(count, cell_nodes)
    imposed = ~free.reshape(count, dim)
    found = []
    for number in np.unique(part[cell_nodes[:, 0]]):
        nodes = np.flatnonzero(part == number)
        motions = rigid_motions(points[nodes], scene.hypothesis)
        held = motions[:, imposed[nodes]].T
        # free motions vanish on imposed dofs
        _, sizes, ways = np.linalg.svd(np.vstack([held, np.zeros((len(motions), len(motions)))]), full_matrices=False)
        left = ways[sizes <= ALMOST_NONE * np.sqrt(max(len(held), 1))]
        if len(left):
            tags = sorted({str(scene.bodies[k].tag) for k in bodies[part[cell_nodes[:, 0]] == number]})
            name = f"body {', '.join(tags)} of scene '{scene.name}', around {points[nodes].mean(axis=0).tolist()},"
            found.append(FreeBody(name, nodes, motions, left))
    return found


def components_of_nodes(count: int, cell_nodes: np.ndarray) -> np.ndarray:
    """Connected component of each of so many nodes, by cells, (cells, n): (nodes,)."""
    starts = np.repeat(cell_nodes[:, :1], cell_nodes.shape[1], axis=1)
    graph = csr_matrix((np.ones(cell_nodes.size), (starts.ravel(), cell_nodes.ravel())), shape=(count, count))
    return connected_components(graph, directed=False)[1]


def rigid_motions(points: np.ndarray, hypothesis: str) -> np.ndarray:
    """Motions without strain: translations, then rotations scaled by the size of the body, (motions, nodes, dim)."""
    count, dim = points.shape
    if hypothesis == "axisymmetric":
        return np.broadcast_to(np.array([[[0.0, 1.0]]]), (1, count, 2))
    motions = [np.broadcast_to(axis, (count, dim)) for axis in np.eye(dim)]
    away = (points - points.mean(axis=0)) / (np.ptp(points, axis=0).max() or 1.0)
    for first, second in ((0, 1),) if dim == 2 else ((1, 2), (2, 0), (0, 1)):
        turn = np.zeros((count, dim))
        turn[:, first] = -away[:, second]
        turn[:, second] = away[:, first]
        motions.append(turn)
    return np.array(motions)


def with_motions(scene: Scene, problem: ContactProblem, bodies: np.ndarray) -> ContactProblem:
    """The problem with the rigid motions that only contact prevents; the problem itself if all bodies are held.

    Args:
        scene: the scene.
        problem: its problem.
        bodies: index in the scene of the body of each cell, (cells,).

    Raises:
        NotSolvableError: for bodies without contact, motions with loads and without resistance of contact, and bodies
            that have laws or a variable shape.

    Warns:
        SceneWarning: of motions without resistance and without loads.
    """
    found = free_bodies(scene, problem.points, problem.cell_nodes, bodies, problem.free)
    if not found:
        return problem
    remedy = "Impose displacements that hold every body without its contacts"
    for body in found:
        touched = np.abs(problem.contact @ _all_dofs(body, problem.block_size, len(problem.free))).max(initial=0.0)
        if touched == 0.0 or scene.shapes or scene.reader:
            why = "" if touched == 0.0 else ". Contact alone may hold a body where none has a law or changes its shape"
            raise NotSolvableError(f"{body.name} can move freely: it {described(body, body.left)}{why}. {remedy}")
    columns = [body.columns(len(problem.points)) for body in found]
    # bodies have no common nodes
    motions = np.hstack([np.linalg.qr(part)[0] for part in columns])
    owner = np.repeat(np.arange(len(columns)), [part.shape[1] for part in columns])
    effect = problem.contact @ motions
    # appended zero rows give one singular value for each motion
    _, sizes, ways = np.linalg.svd(np.vstack([effect, np.zeros((motions.shape[1],) * 2)]), full_matrices=False)
    idle = sizes <= ALMOST_NONE * np.sqrt(len(effect)) * problem.contact_norm
    resting = motions @ ways[idle].T
    _check_resting(found, problem, resting)
    pins = linalg.qr(motions.T * problem.free, mode="r", pivoting=True)[1][: motions.shape[1]]
    rigid = motions @ _by_body(effect, ways[idle], owner)
    round_ = _round_turns(found, problem, rigid)
    if round_.any():
        resting = np.hstack([resting, rigid[:, round_]])
        rigid = rigid[:, ~round_]
    loose = "; ".join(f"{body.name} {described(body, body.left)}" for body in found)
    return replace(problem, rigid=rigid if rigid.shape[1] else None, resting=resting, loose=loose, pins=np.sort(pins))


def _round_turns(found: Sequence[FreeBody], problem: ContactProblem, rigid: np.ndarray) -> np.ndarray:
    """Mask of the motions, of (N, r), that only the facets of round surfaces resist, (r,) bool; it warns of them.

    A large rotation of this kind opens every gap, unlike that of a round body. Without loads these rotations are set to
    zero, and the moment of the facets' normals is distributed over the body.
    """
    effects = np.linalg.norm(problem.contact @ rigid, axis=0)
    driven = _driven(problem, rigid)
    found_round = np.zeros(rigid.shape[1], dtype=bool)
    for body in found:
        fields = rigid.reshape(len(problem.points), problem.block_size, rigid.shape[1])[body.nodes]
        own = np.flatnonzero(np.abs(fields).max(axis=(0, 1)) > ALMOST_NONE)
        for place in own:
            turn = fields[:, :, place]
            turning = np.abs(turn - turn.mean(axis=0)).max() > 0.5 * np.abs(turn).max()
            if not turning or effects[place] >= WEAK * effects[own].max():
                continue
            found_round[place] = not driven[place]
            what = "and no load drives: it is left at rest" if not driven[place] else "though loads drive it"
            warn(
                f"{body.name} turns, which contact resists {effects[place] / effects[own].max():.1g} times as much as "
                f"other motions of it, {what}. If its surfaces are round only their facets do so, and turned far they "
                "open every gap. Hold the turn by a displacement where that is not meant",
                SceneWarning,
                stacklevel=3,
            )
    return found_round


def _driven(problem: ContactProblem, motions: np.ndarray) -> np.ndarray:
    """Mask of the motions, of (N, r), along which loads do work beyond the discretisation error of a round body."""
    work = np.abs(problem.loads.T @ motions)
    sizes = np.asarray(abs(problem.loads).T @ np.abs(motions))
    return (work > UNEVEN * sizes).any(axis=0)


def _by_body(effect: np.ndarray, idle: np.ndarray, body: np.ndarray) -> np.ndarray:
    """Orthonormal combinations, (k, r), of k motions with an effect, (m, k), and those without, (l, k).

    Each is of one of the bodies, (k,), unless idle motions are of several at once: loads of a light body would be
    lost in round-off of those of a heavy one. Combinations of one body have effects as different as possible.
    """
    projector = idle.T @ idle
    _, group = connected_components((np.abs(projector) > ALMOST_NONE) | (body[:, None] == body), directed=False)
    found = []
    for number in np.unique(group):
        own = np.flatnonzero(group == number)
        kept = own.size - round(float(np.trace(projector[np.ix_(own, own)])))
        part = np.zeros((len(body), kept))
        # appended zero rows give one singular value for each motion
        padded = np.vstack([effect[:, own], np.zeros((own.size, own.size))])
        part[own] = np.linalg.svd(padded, full_matrices=False)[2][:kept].T
        found.append(part)
    return np.hstack(found)


def _all_dofs(body: FreeBody, dim: int, count: int) -> np.ndarray:
    """A vector without zeros on the dofs of a body, (N,), and without a preferred direction."""
    vector = np.zeros((count // dim, dim))
    vector[body.nodes] = np.random.default_rng(0).uniform(1.0, 2.0, (len(body.nodes), dim))
    return vector.ravel()


def _check_resting(found: Iterable[FreeBody], problem: ContactProblem, resting: np.ndarray) -> None:
    """Refuse motions, (N, l), without resistance of contact and with loads; warn of those without loads."""
    if not resting.shape[1]:
        return
    # each relative to its magnitude: a small load may have a large amplitude
    loads = np.asarray(abs(problem.loads).sum(axis=0)).ravel()
    for motion in resting.T:
        texts = []
        for body in found:
            own = motion.reshape(len(problem.points), -1)[body.nodes]
            if np.abs(own).max() > ALMOST_NONE * np.abs(motion).max():
                flat = body.motions.reshape(len(body.motions), -1)
                way = np.linalg.lstsq(flat.T, own.ravel(), rcond=None)[0]
                texts.append(f"{body.name} {described(body, way[None] / np.linalg.norm(way))}")
        text = " while ".join(texts)
        if (np.abs(problem.loads.T @ motion) > ALMOST_NONE * loads * np.abs(motion).max()).any():
            raise NotSolvableError(
                f"{text}, which loads drive and no contact resists: there is no equilibrium. Hold it by a "
                "displacement, or add the contact that does"
            )
        warn(
            f"{text}, which no contact resists and no load drives: it is left at rest. Hold it by a displacement where "
            "that is not meant",
            SceneWarning,
            stacklevel=2,
        )


def described(body: FreeBody, ways: np.ndarray) -> str:
    """Description of combinations of motions of a body, (n, k): along axes, along directions, or rotations."""
    dim = body.motions.shape[2]
    if len(body.motions) == 1:
        return "moves along axis 1"
    shifts = dim
    along = [axis for axis in range(shifts) if np.linalg.norm(ways[:, axis]) > 1 - 1e-6]
    parts = [f"moves along axis {axis}" for axis in along]
    if len(ways) > len(along):
        turning = np.linalg.norm(ways[:, shifts:]) > 1e-6 * np.linalg.norm(ways)
        parts.append("turns" if turning else f"moves along {np.round(ways[0, :shifts], 3).tolist()}")
    return ", ".join(parts)


ALIKE = 1e-10
"""Relative difference from imposed values up to which a rigid motion has the same values."""


def rigid_lifts(
    scene: Scene, lifts: csc_matrix, free: np.ndarray, points: np.ndarray, cell_nodes: np.ndarray
) -> csc_matrix:
    """Replace lifts, (N, 1 + T), by rigid motions of whole bodies if these have the imposed values.

    Each term is checked separately: in a body that it moves, the other imposed dofs stay zero. Inelastic bodies and
    bodies with a variable shape keep their lifts.

    Args:
        scene: the scene.
        lifts: nonzero on the imposed dofs alone, (N, 1 + T).
        free: dofs that are not imposed, (N,) bool.
        points: coordinates of the nodes, (nodes, dim).
        cell_nodes: nodes of each cell, (cells, n).
    """
    if scene.shapes or scene.reader:
        return lifts
    part = components_of_nodes(len(points), cell_nodes)
    found = [lifts[:, [term]] for term in range(lifts.shape[1])]
    imposed = ~free.reshape(points.shape)
    for term in np.flatnonzero(np.diff(lifts.indptr)):
        values = found[term].toarray().reshape(points.shape)
        moving = values.copy()
        for number in np.unique(part[np.any(values, axis=1)]):
            nodes = np.flatnonzero(part == number)
            motions = rigid_motions(points[nodes], scene.hypothesis)
            held = imposed[nodes]
            wanted = values[nodes]
            ways = np.linalg.lstsq(motions[:, held].T, wanted[held], rcond=ALIKE)[0]
            rigid = np.tensordot(ways, motions, 1)
            if np.abs(rigid - wanted)[held].max() > ALIKE * np.abs(wanted).max():
                continue
            rigid[held] = wanted[held]
            moving[nodes] = np.where(np.abs(rigid) > ALIKE * np.abs(rigid).max(), rigid, 0.0)
        found[term] = csc_matrix(moving.reshape(-1, 1))
    return csc_matrix(hstack(found))
