"""Rigid motions that imposed displacements leave to bodies: what contact has to hold, and what nothing does.

K is singular along them. Those that contact resists join the unknowns of the active set, see ``contact.floating``. What
neither contact resists nor a load drives, such as the turning of a round body without friction, is left at rest.

A body whose imposed motions are those of a rigid one is lifted as a whole, so that its lift does not strain. The lift
of the thesis lives on the imposed dofs alone (section 2.6), and K lift is a load. Where K depends on
parameters so does that load, and it is far larger than any force that the body bears: what is interpolated of it
between parameters cancels, and so do the energies that bounds are made of. Where the imposed values are those of a
rigid motion, as of a block that is pressed down by its top, that motion of the whole body fits them too, and K is zero
along it whatever the moduli are.
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
"""Part of the work of its nodal forces, without their signs, that a load on a round surface may do along its turn."""
WEAK = 0.1
"""Part of the effect of other motions below which that of a turn may come from the facets of a round surface."""
ALMOST_NONE = 1e-9
"""Part of the largest effect of a motion, or of a load, below which there is none but round-off."""


@dataclass(frozen=True)
class FreeBody:
    """Connected components that can move without strain.

    Attributes:
        name: of its bodies, for messages.
        nodes: its nodes.
        motions: all of its rigid motions, (k, nodes, dim), see :func:`rigid_motions`.
        left: those that imposed displacements leave, orthonormal combinations, (l, k).
    """

    name: str
    nodes: np.ndarray
    motions: np.ndarray
    left: np.ndarray

    def columns(self, count: int) -> np.ndarray:
        """The motions that are left on all nodes, (nodes dim, l)."""
        found = np.zeros((len(self.left), count, self.motions.shape[2]))
        found[:, self.nodes] = np.tensordot(self.left, self.motions, 1)
        return found.reshape(len(self.left), -1).T


def free_bodies(
    scene: Scene, points: np.ndarray, cell_nodes: np.ndarray, bodies: np.ndarray, free: np.ndarray
) -> list[FreeBody]:
    """Bodies that can move without strain: rigid motions that vanish on their imposed dofs.

    Args:
        scene: the scene.
        points: coordinates of the nodes, (nodes, dim).
        cell_nodes: nodes of each cell, (cells, n).
        bodies: place in the scene of the body of each cell, (cells,).
        free: dofs that are not imposed, (N,) bool.
    """
    count, dim = points.shape
    part = hanging_together(count, cell_nodes)
    imposed = ~free.reshape(count, dim)
    found = []
    for number in np.unique(part[cell_nodes[:, 0]]):
        nodes = np.flatnonzero(part == number)
        motions = rigid_motions(points[nodes], scene.hypothesis)
        held = motions[:, imposed[nodes]].T
        # the imposed values of each motion that is free vanish
        _, sizes, ways = np.linalg.svd(np.vstack([held, np.zeros((len(motions), len(motions)))]), full_matrices=False)
        left = ways[sizes <= ALMOST_NONE * np.sqrt(max(len(held), 1))]
        if len(left):
            tags = sorted({str(scene.bodies[k].tag) for k in bodies[part[cell_nodes[:, 0]] == number]})
            name = f"body {', '.join(tags)} of scene '{scene.name}', around {points[nodes].mean(axis=0).tolist()},"
            found.append(FreeBody(name, nodes, motions, left))
    return found


def hanging_together(count: int, cell_nodes: np.ndarray) -> np.ndarray:
    """Connected component of each of so many nodes, by cells, (cells, n): (nodes,)."""
    starts = np.repeat(cell_nodes[:, :1], cell_nodes.shape[1], axis=1)
    graph = csr_matrix((np.ones(cell_nodes.size), (starts.ravel(), cell_nodes.ravel())), shape=(count, count))
    return connected_components(graph, directed=False)[1]


def rigid_motions(points: np.ndarray, hypothesis: str) -> np.ndarray:
    """Motions without strain: translations, then turns by the size of the body, (motions, nodes, dim)."""
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
    """The problem with the rigid motions that only contact holds; itself where all bodies are held.

    Args:
        scene: the scene.
        problem: its problem.
        bodies: place in the scene of the body of each cell, (cells,).

    Raises:
        NotSolvableError: for bodies without contact, motions that loads drive and no contact resists, and bodies that
            flow or change their shape.

    Warns:
        SceneWarning: of motions that nothing resists and nothing drives.
    """
    found = free_bodies(scene, problem.points, problem.cell_nodes, bodies, problem.free)
    if not found:
        return problem
    remedy = "Impose displacements that hold every body without its contacts"
    for body in found:
        touched = np.abs(problem.contact @ _all_dofs(body, problem.block_size, len(problem.free))).max(initial=0.0)
        if touched == 0.0 or scene.shapes or any(one.law is not None for one in scene.bodies):
            why = "" if touched == 0.0 else ". Contact alone may hold a body where nothing flows or changes its shape"
            raise NotSolvableError(f"{body.name} can move freely: it {described(body, body.left)}{why}. {remedy}")
    columns = [body.columns(len(problem.points)) for body in found]
    # bodies have no nodes in common
    motions = np.hstack([np.linalg.qr(part)[0] for part in columns])
    owner = np.repeat(np.arange(len(columns)), [part.shape[1] for part in columns])
    effect = problem.contact @ motions
    # with as many rows of zeros there is a value for each motion
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
    """Which motions, of (N, r), are turns that only the facets of round surfaces resist, (r,) bool; it warns of them.

    Turned far enough they open every gap, as no round body does. Where no load drives them they are left at rest, and
    the moment that the facets' normals leave is spread over the body.
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
    """Whether loads do work along motions, of (N, r), beyond what a mesh leaves of the balance of a round body."""
    work = np.abs(problem.loads.T @ motions)
    sizes = np.asarray(abs(problem.loads).T @ np.abs(motions))
    return (work > UNEVEN * sizes).any(axis=0)


def _by_body(effect: np.ndarray, idle: np.ndarray, body: np.ndarray) -> np.ndarray:
    """Orthonormal combinations, (k, r), of k motions that have an effect, (m, k), beside those without one, (l, k).

    Each is of one of the bodies, (k,), but where idle motions are of several at once: loads of a light body would be
    lost in round-off of those of a heavy one. Those of a body differ in their effects as much as they can.
    """
    projector = idle.T @ idle
    _, group = connected_components((np.abs(projector) > ALMOST_NONE) | (body[:, None] == body), directed=False)
    found = []
    for number in np.unique(group):
        own = np.flatnonzero(group == number)
        kept = own.size - round(float(np.trace(projector[np.ix_(own, own)])))
        part = np.zeros((len(body), kept))
        # with as many rows of zeros there is a value for each motion
        padded = np.vstack([effect[:, own], np.zeros((own.size, own.size))])
        part[own] = np.linalg.svd(padded, full_matrices=False)[2][:kept].T
        found.append(part)
    return np.hstack(found)


def _all_dofs(body: FreeBody, dim: int, count: int) -> np.ndarray:
    """A vector that is not zero on the dofs of a body, (N,), nor along any direction in particular."""
    vector = np.zeros((count // dim, dim))
    vector[body.nodes] = np.random.default_rng(0).uniform(1.0, 2.0, (len(body.nodes), dim))
    return vector.ravel()


def _check_resting(found: Iterable[FreeBody], problem: ContactProblem, resting: np.ndarray) -> None:
    """Refuse motions, (N, l), that no contact resists and a load drives; warn of those that none drives."""
    if not resting.shape[1]:
        return
    # each by its own size: one that is small may have a large amplitude
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
    """What kind of motions combinations of those of a body are, (n, k): along axes, along directions, or turns."""
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
"""Part of imposed values up to which a rigid motion has the same."""


def rigid_lifts(
    scene: Scene, lifts: csc_matrix, free: np.ndarray, points: np.ndarray, cell_nodes: np.ndarray
) -> csc_matrix:
    """Lifts, (N, 1 + T), that are rigid motions of whole bodies where their imposed values are those of such motions.

    Each term is looked at by itself: of what it moves in a body, the rest that is imposed there stays. Bodies that flow
    or change their shape keep their lifts.

    Args:
        scene: the scene.
        lifts: carried by the imposed dofs alone, (N, 1 + T).
        free: dofs that are not imposed, (N,) bool.
        points: coordinates of the nodes, (nodes, dim).
        cell_nodes: nodes of each cell, (cells, n).
    """
    if scene.shapes or any(body.law is not None for body in scene.bodies):
        return lifts
    part = hanging_together(len(points), cell_nodes)
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
            moved = np.tensordot(ways, motions, 1)
            if np.abs(moved - wanted)[held].max() > ALIKE * np.abs(wanted).max():
                continue
            moved[held] = wanted[held]
            moving[nodes] = np.where(np.abs(moved) > ALIKE * np.abs(moved).max(), moved, 0.0)
        found[term] = csc_matrix(moving.reshape(-1, 1))
    return csc_matrix(hstack(found))
