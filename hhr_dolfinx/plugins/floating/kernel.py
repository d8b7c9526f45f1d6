"""The kernel of K: rigid motions that contact prevents, and those that nothing prevents and no load
drives.

Motions that contact resists are unknowns of the active set, see
:mod:`hhr_dolfinx.plugins.floating.statuses`. Motions without resistance of contact and without
loads, such as the rotation of a round body without friction, are set to zero.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import linalg
from scipy.sparse.csgraph import connected_components

from hhr_dolfinx import registry
from hhr_dolfinx.contact.problem import ContactProblem, IndexSets
from hhr_dolfinx.errors import (
    NotOfferedError,
    NotSolvableError,
    ParameterError,
    ReductionError,
    SceneError,
    SceneWarning,
    rounded,
)
from hhr_dolfinx.full_order.free_bodies import ALMOST_NONE, FreeBody
from hhr_dolfinx.plugins.floating.elimination import (
    Floating,
    FloatingElimination,
    ReducedFloatingElimination,
)
from hhr_dolfinx.plugins.floating.interpolated import MotionsBeside
from hhr_dolfinx.plugins.floating.linearised import LinearisedMotions
from hhr_dolfinx.plugins.floating.statuses import FloatingEqualities
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    from hhr_dolfinx.contact.law import ContactLaw
    from hhr_dolfinx.contact.stiffness import Stiffness
    from hhr_dolfinx.full_order.system import SystemAt
    from hhr_dolfinx.linear.rows import Rows
    from hhr_dolfinx.models.eliminations.elimination import Elimination, Responses
    from hhr_dolfinx.models.eliminations.projected import ReducedProblem
    from hhr_dolfinx.scene import Scene

UNEVEN = 1e-3
"""Part of the work of its nodal forces, without signs, that a load on a round surface may do on its
rotation.
"""
ROUND_SURFACE_EFFECT = 0.1
"""Part of the effect of other motions up to which that of one may come from the facets of a round
surface alone.
"""
NO_WORK = 1e-9
"""Part of the largest work of a unit force along a rigid motion below which a condition does not
act on it.
"""
LOAD_SAMPLES = 64
"""Points of the box at which the sum of the loads is judged, beside its middle."""
CHANGE_ROUND_OFF = 1e-9
"""Part of the largest value below which a change counts as round-off."""


def undetermined_outputs(answer: Any) -> set[str]:
    """Names of the outputs that an undetermined motion of an answer changes."""
    fields: Any = answer.fields
    if fields.functionals is None:
        return set()
    functionals = fields.functionals.at(answer.parameter)
    theta = fields.functionals.amplitudes.dense(answer.parameter)
    before = fields.measured(answer, theta)
    names: set[str] = set()
    for motion in answer.undetermined.T:
        change = np.abs(
            fields.measured(answer._replace(unknown=answer.unknown + motion), theta) - before
        )
        least = CHANGE_ROUND_OFF * max(change.max(initial=0.0), np.abs(before).max(initial=0.0))
        pairs = zip(functionals.items, functionals.places, strict=True)
        names |= {
            functional.name for functional, rows in pairs if change[rows].max(initial=0.0) > least
        }
    return names


def undetermined_motions(answer: Any) -> str:
    """Description of the undetermined motions of an answer: the nodes of the mesh that move, and
    how.
    """
    before = answer.displacement()
    words = []
    for motion in answer.undetermined.T:
        change = answer._replace(unknown=answer.unknown + motion).displacement() - before
        field = change.reshape(-1, answer.fields.dimension)
        sizes = np.linalg.norm(field, axis=1)
        moving = np.flatnonzero(sizes > CHANGE_ROUND_OFF * sizes.max())
        way = field[moving].mean(axis=0)
        shifted = np.abs(field[moving] - way).max() <= 1e-6 * sizes.max()
        moves = (
            f"moves along {np.round(way / np.linalg.norm(way), 3).tolist()}" if shifted else "turns"
        )
        words.append(f"{_moving_bodies(answer.fields.full, moving)} {moves}")
    return ", ".join(words)


def _moving_bodies(full: Any, nodes: np.ndarray) -> str:
    """Bodies that have some nodes, by their tags.

    By the numbers of the nodes if no mesh is known, as from a file.
    """
    discretisation = getattr(full, "discretisation", None)
    if discretisation is None:
        return f"the body whose nodes have the numbers {nodes[0]} to {nodes[-1]} in the mesh"
    moving = np.isin(full.problem.cell_nodes, nodes).all(axis=1)
    tags = [full.scene.bodies[k].tag for k in np.unique(discretisation.cell_bodies()[moving])]
    return f"body {', '.join(map(str, tags))}"


@dataclass(eq=False)
class RigidKernel:
    """See :class:`~hhr_dolfinx.contact.kernel.Kernel`; m conditions, 1 + T terms.

    The class is the tool ``kernel``.
    """

    motions: np.ndarray
    idle: np.ndarray
    pins: np.ndarray
    described: str
    law: ContactLaw
    contact_of_motions: np.ndarray  #: G = B R, (m, r)
    loads: np.ndarray  #: along the motions, (r, 1 + T), the same for every stiffness
    reshaped: bool = False  #: True if B, and with it G, depends on parameters
    _known: tuple[Stiffness, FloatingEqualities] | None = field(default=None, init=False)

    @classmethod
    def of(cls, scene: Scene, problem: ContactProblem, bodies: Sequence[FreeBody]) -> RigidKernel:
        """See :class:`~hhr_dolfinx.contact.kernel.Kernels`.

        Args:
            scene: scene of the bodies.
            problem: contact problem of the full model.
            bodies: bodies that contact alone holds.

        Raises:
            NotSolvableError: for a body without contact, and for a motion that loads drive and
                nothing resists.
            SceneError: for a law of contacts that does not solve for the motions.

        Warns:
            SceneWarning: of motions without resistance and without loads.
        """
        remedy = "Impose displacements that hold every body without its contacts"
        for body in bodies:
            vector = np.zeros(
                (len(problem.points), problem.block_size)
            )  # no dof of the body is zero
            vector[body.nodes] = np.random.default_rng(0).uniform(
                1.0, 2.0, (len(body.nodes), problem.block_size)
            )
            touched = np.abs(problem.contact @ vector.ravel()).max(initial=0.0)
            if touched == 0.0:
                raise NotSolvableError(
                    f"{body.name} can move freely: it {body.described(body.left)}. {remedy}"
                )
        columns = [body.columns(len(problem.points)) for body in bodies]
        # bodies have no common nodes
        motions = np.hstack([np.linalg.qr(block)[0] for block in columns])
        owner = np.repeat(np.arange(len(columns)), [block.shape[1] for block in columns])
        effect = problem.contact @ motions
        # appended zero rows give one singular value for each motion
        _, sizes, ways = np.linalg.svd(
            np.vstack([effect, np.zeros((motions.shape[1],) * 2)]), full_matrices=False
        )
        unresisted = sizes <= ALMOST_NONE * np.sqrt(len(effect)) * problem.contact_norm
        idle = motions @ ways[unresisted].T
        _check_idle(bodies, problem, idle)
        pins = linalg.qr(motions.T * problem.free, mode="r", pivoting=True)[1][: motions.shape[1]]
        rigid = motions @ _by_body(effect, ways[unresisted], owner)
        tools = [getattr(pair, "tool", None) is not None for pair in scene.contacts]
        round_ = _round_turns(bodies, problem, rigid, np.array(tools, dtype=bool))
        if round_.any():
            idle = np.hstack([idle, rigid[:, round_]])
            rigid = rigid[:, ~round_]
        loose = "; ".join(f"{body.name} {body.described(body.left)}" for body in bodies)
        law = problem.law
        if rigid.shape[1] and law.plugin and not law.floats:
            if "range" not in registry.installed()[law.plugin].facets:
                raise SceneError(
                    f"contact alone holds bodies of scene '{scene.name}', {loose}, and its law, "
                    f"{law.name}, does not solve for their motions, nor does its plug-in have the "
                    "facet 'range', by which others do: hold them by a displacement"
                )
            from hhr_dolfinx.plugins.contact_laws.interface import Interface, Range

            law = Interface((Range(law, np.arange(len(problem.gaps))),))
        on_rows = problem.contact @ rigid, (problem.loads.T @ rigid).T
        return cls(rigid, idle, np.sort(pins), loose, law, *on_rows)

    def at(self, problem: ContactProblem) -> RigidKernel:
        """See :class:`~hhr_dolfinx.contact.kernel.Kernel`.

        Raises:
            NotOfferedError: if contact resists a motion at this shape and not at another.
        """
        effect = problem.contact @ self.motions
        idle = np.abs(problem.contact @ self.idle).max(initial=0.0)
        if idle > ALMOST_NONE * np.sqrt(len(effect)) * problem.contact_norm:
            raise NotOfferedError(
                "contact resists a motion of bodies at one shape and not at another: "
                f"{self.described}. Hold it by a displacement"
            )
        return replace(
            self, contact_of_motions=effect, loads=(problem.loads.T @ self.motions).T, reshaped=True
        )

    elimination = staticmethod(ReducedFloatingElimination)
    linearised = staticmethod(LinearisedMotions)
    undetermined_outputs = staticmethod(undetermined_outputs)
    undetermined_motions = staticmethod(undetermined_motions)

    def condensed(self, there: SystemAt) -> Floating | None:
        """See :class:`~hhr_dolfinx.contact.kernel.Kernel`.

        Lifts do not contribute: rigid motions have no strain.
        """
        if not self.motions.shape[1]:
            return None
        amplitudes = there.problem.amplitudes
        acting, slopes = amplitudes.slopes_at(there.point)
        driving = self.loads @ amplitudes(there.point)
        changes = self.loads[:, acting] @ slopes

        def drift(forces: np.ndarray, unknown: np.ndarray) -> np.ndarray:
            """R^T (F' - B'^T forces)."""
            if not self.reshaped:
                return changes
            return -self.motions.T @ there.system.explicit(there.point, forces, unknown)[0]

        return Floating(self._equalities_on(there.stiffness), driving, self.motions, drift)

    def _equalities_on(self, stiffness: Stiffness) -> FloatingEqualities:
        """Equality problems on S; cached for the last stiffness."""
        cached = self._known
        if cached is None or cached[0] is not stiffness:
            # in one assignment: several threads may call this
            self._known = cached = (
                stiffness,
                FloatingEqualities(stiffness.schur, self.contact_of_motions),
            )
        return cached[1]

    def exact(self, problem: ContactProblem, responses: Responses) -> FloatingElimination:
        """See :class:`~hhr_dolfinx.contact.kernel.Kernel`.

        Args:
            problem: contact problem of the full model.
            responses: responses of the pinned bodies.
        """
        contact_of_motions = problem.contact @ self.motions
        driving = self.motions.T @ problem.loads
        return FloatingElimination(
            responses, contact_of_motions, driving, self.motions, problem.amplitudes
        )

    def beside(self, eliminated: Elimination) -> MotionsBeside:
        """See :class:`~hhr_dolfinx.contact.kernel.Kernel`."""
        return MotionsBeside(eliminated, self.contact_of_motions, self.loads)

    def holding(self) -> np.ndarray:
        """See :class:`~hhr_dolfinx.contact.kernel.Kernel`."""
        work = np.abs(self.contact_of_motions)
        if not work.size:
            return np.zeros(0, dtype=np.int64)
        return np.flatnonzero(work.max(axis=1) > NO_WORK * work.max())

    def without(self, rows: Rows, fields: np.ndarray) -> np.ndarray:
        """See :class:`~hhr_dolfinx.contact.kernel.Kernel`.

        Args:
            rows: rows of vectors that this rank has.
            fields: fields, (N, k), of these rows.
        """
        motions = rows.of(self.motions)
        rest = fields - motions @ rows.sum(motions.T @ fields)
        # a body that moves alone has no deformation, of which modes would be made of round-off
        sizes, left = (np.sqrt(rows.sum((part**2).sum(axis=0))) for part in (fields, rest))
        return np.where(left > ALMOST_NONE * sizes, rest, 0.0)

    def first(self, rows: Rows, basis: np.ndarray) -> np.ndarray:
        """See :class:`~hhr_dolfinx.contact.kernel.Kernel`.

        Args:
            rows: rows of vectors that this rank has.
            basis: modes, of these rows.
        """
        motions = rows.of(self.motions)
        if not motions.shape[1]:
            return basis
        deformations = rows.orthonormal(np.hstack([motions, self.without(rows, basis)]))[0][
            :, motions.shape[1] :
        ]
        return np.hstack([motions, deformations])  # a QR may change the sign of the motions

    def balanced(
        self, problem: ContactProblem, basis: np.ndarray, sets: IndexSets, reduced: ReducedProblem
    ) -> ReducedProblem:
        """See :class:`~hhr_dolfinx.contact.kernel.Kernel`.

        All conditions that hold the bodies are in the RID, so all of their forces are included; K
        does no work along rigid motions. Cut off outside A, a motion would strain cells there, and
        forces would balance the projection error.

        Args:
            problem: contact problem of the full model.
            basis: modes, of these rows.
            sets: index sets of the RID.
            reduced: projected problem.

        Raises:
            ReductionError: if a condition that holds a body is outside the RID.
        """
        r = reduced.motions
        motions = basis[:, :r]
        acting = np.setdiff1d(self.holding(), sets.A_lambda)
        if acting.size:
            raise ReductionError(
                f"{acting.size} contact conditions that hold a body are outside the RID, e.g. the "
                f"one at {problem.contact_points[acting[0]].tolist()}: nothing else holds it, so "
                "that all must be in it"
            )
        loads = problem.spread.sum(motions.T @ problem.spread.of(problem.loads.tocsr()))
        stiffness = reduced.stiffness.copy()
        test = reduced.contact_test.copy()
        forces = reduced.loads.copy()
        stiffness[:r] = 0.0
        stiffness[:, :r] = 0.0
        test[:, :r] = reduced.contact_trial[:, :r]
        forces[:r] = loads
        terms = reduced.terms
        if terms is not None:
            blocks = terms.stiffness.copy()
            lifts = terms.lifts.copy()
            sums = terms.forces.copy()
            blocks[:, :r] = 0.0
            blocks[:, :, :r] = 0.0
            lifts[:, :r] = 0.0
            sums[:r] = loads
            terms = replace(terms, stiffness=blocks, lifts=lifts, forces=sums)
        return replace(reduced, stiffness=stiffness, contact_test=test, loads=forces, terms=terms)


def _round_turns(
    found: Sequence[FreeBody], problem: ContactProblem, rigid: np.ndarray, tools: np.ndarray
) -> np.ndarray:
    """Mask of the rotations, of (N, r), that only the facets of round surfaces resist, (r,) bool.

    It warns of them.

    A large rotation of this kind opens every gap, unlike that of a round body. Without loads these
    rotations are set to zero, and the moment of the facets' normals is distributed over the body.
    It also warns of loads along the axis of a cylinder, whose facets are not quite parallel to it.
    Pairs of tools, a mask (pairs,), have the normals of the tool, and no facets.
    """
    acting = problem.contact @ rigid
    effects = np.linalg.norm(acting, axis=0)
    pairs = problem.contact_pairs
    by_facets = np.ones(len(acting), dtype=bool) if pairs is None else ~tools[pairs]
    of_tools = np.linalg.norm(acting[by_facets], axis=0) <= ALMOST_NONE * effects.max(initial=0.0)
    # motions along which loads do work beyond the discretisation error of a round body
    driven = _driven(problem, rigid, UNEVEN * np.abs(rigid))
    found_round = np.zeros(rigid.shape[1], dtype=bool)
    for body in found:
        fields = rigid.reshape(len(problem.points), problem.block_size, rigid.shape[1])[body.nodes]
        indices = np.flatnonzero(np.abs(fields).max(axis=(0, 1)) > ALMOST_NONE)
        for index in indices:
            motion = fields[:, :, index]
            turning = np.abs(motion - motion.mean(axis=0)).max() > 0.5 * np.abs(motion).max()
            certain = effects[index] >= ROUND_SURFACE_EFFECT * effects[indices].max()
            if certain or of_tools[index] or not (turning or driven[index]):
                continue
            found_round[index] = turning and not driven[index]
            consequence = (
                "and no load drives: it is left at rest"
                if not driven[index]
                else "though loads drive it"
            )
            if turning:
                moves = "turns"
                reason = (
                    "are round only their facets do so, and turned far they open every gap. Hold "
                    "the turn"
                )
            else:
                along = motion.mean(axis=0) / np.abs(motion).max()
                moves = f"moves along {rounded(np.round(along, 1))}"
                reason = (
                    "are cylinders only their facets do so, and where it stops means nothing. "
                    "Hold the motion"
                )
            warn(
                f"{body.name} {moves}, which contact resists "
                f"{effects[index] / effects[indices].max():.1g} times as much as other motions of "
                f"it, {consequence}. If its surfaces {reason} by a displacement where that is "
                "not meant",
                SceneWarning,
            )
    return found_round


def _by_body(effect: np.ndarray, idle: np.ndarray, body: np.ndarray) -> np.ndarray:
    """Orthonormal combinations, (k, r), of k motions with an effect, (m, k), and those without, (l,
    k).

    Each is of one of the bodies, (k,), unless idle motions are of several at once: loads of a light
    body would be lost in round-off of those of a heavy one. Combinations of one body have effects
    as different as possible.
    """
    projector = idle.T @ idle
    _, group = connected_components(
        (np.abs(projector) > ALMOST_NONE) | (body[:, None] == body), directed=False
    )
    combinations = []
    for number in np.unique(group):
        indices = np.flatnonzero(group == number)
        count = indices.size - round(float(np.trace(projector[np.ix_(indices, indices)])))
        block = np.zeros((len(body), count))
        # appended zero rows give one singular value for each motion
        padded = np.vstack([effect[:, indices], np.zeros((indices.size, indices.size))])
        block[indices] = np.linalg.svd(padded, full_matrices=False)[2][:count].T
        combinations.append(block)
    return np.hstack(combinations)


def _driven(problem: ContactProblem, motions: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Mask of motions, (N, l), along which all loads together do work at some point of the box,
    (l,) bool.

    Loads that balance each other, such as tractions on opposite sides, do work one by one and not
    together. Work counts if it is more than the work of the magnitudes of the loads along
    ``limits``, (N, l).
    """
    work = np.asarray(problem.loads.T @ motions)
    least = np.asarray(abs(problem.loads).T @ limits)
    space = problem.parameters
    driven = np.zeros(motions.shape[1], dtype=bool)
    for point in (space.middle, *space.random(LOAD_SAMPLES, seed=0)):
        with suppress(ParameterError):  # some scenes have no meaning at some points of the box
            theta = problem.amplitudes(point)
            driven |= (
                np.abs(theta.values @ work[theta.terms]) > np.abs(theta.values) @ least[theta.terms]
            )
    return driven


def _check_idle(found: Iterable[FreeBody], problem: ContactProblem, idle: np.ndarray) -> None:
    """Refuse motions, (N, l), without resistance of contact and with loads.

    Warn of those without loads.
    """
    if not idle.shape[1]:
        return
    sizes = np.abs(idle).max(axis=0)
    moving = (
        np.abs(idle).reshape(len(problem.points), -1, idle.shape[1]).max(axis=1)
        > ALMOST_NONE * sizes
    )
    driven = _driven(
        problem, idle, ALMOST_NONE * sizes * np.repeat(moving, problem.block_size, axis=0)
    )
    for motion, loaded in zip(idle.T, driven, strict=True):
        texts = []
        for body in found:
            field = motion.reshape(len(problem.points), -1)[body.nodes]
            if np.abs(field).max() > ALMOST_NONE * np.abs(motion).max():
                flat = body.motions.reshape(len(body.motions), -1)
                way = np.linalg.lstsq(flat.T, field.ravel(), rcond=None)[0]
                texts.append(f"{body.name} {body.described(way[None] / np.linalg.norm(way))}")
        text = " while ".join(texts)
        if loaded:
            raise NotSolvableError(
                f"{text}, which loads drive and no contact resists: there is no equilibrium. Hold "
                "it by a displacement, or add the contact that does"
            )
        warn(
            f"{text}, which no contact resists and no load drives: it is left at rest. Hold it by "
            "a displacement where that is not meant",
            SceneWarning,
        )
