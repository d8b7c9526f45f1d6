"""Couplings of nodes with a reference point: rigid and distributing ones, and forces on the
point.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import qr
from scipy.sparse import csc_matrix

from hhr_dolfinx.amplitudes import Amplitude, check_amplitude
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.forms import elasticity
from hhr_dolfinx.formulas import Formula
from hhr_dolfinx.full_order.free_bodies import rigid_motions
from hhr_dolfinx.loads import Assembler, Term
from hhr_dolfinx.parameters import Place, Tag, as_tuple, check_place, is_number, is_whole
from hhr_dolfinx.plugins.constraints.elimination import ConstraintEquations
from hhr_dolfinx.plugins.constraints.equations import equations_of, nodes_at
from hhr_dolfinx.plugins.constraints.loose_equations import first_largest

UNDETERMINED = 1e-8
"""Part of a motion that nodes do not show above which they leave it undetermined."""
EDGES_ONLY = "edges"
"""Value of ``by_area`` that leaves out nodes in the middle of faces."""
ANGLES = "angles"
"""Value of ``by_area`` for the mean of the angles by which nodes turn."""
QUADRILATERAL_CORNERS = 4
"""Number of corners of a quadrilateral of nine nodes, of which those of edges follow, and the
middle is the last.
"""
ROTATION_PLANES = {2: ((0, 1),), 3: ((1, 2), (2, 0), (0, 1))}
"""Axes of the planes of rotations, by the dimension."""


@dataclass(frozen=True)
class RigidMotion:
    """Some nodes move as a rigid body: a rigid coupling, which forces and displacements on its
    nodes then move.

    In axisymmetry they move along the axis alone, and not along the radius. Equations that imposed
    displacements or other constraints imply are left out. The motion of a
    reference point is imposed by :class:`MeanMotion` of the same place, and forces on it are a
    :class:`CoupledForce`.

    Attributes:
        place: set, surface or :class:`~hhr_dolfinx.parameters.Place`.
        components: those that move so, ``(2,)``; None for all of them. A set that stays a plane has
            that along its normal.
    """

    place: Tag | Place
    components: tuple[int, ...] | None = None
    amplitude: Amplitude = field(default=Amplitude(), init=False)

    def __post_init__(self) -> None:
        check_place("rigid motion", self.place)
        _check_components(self)

    def equations(self, assembler: Assembler) -> ConstraintEquations:
        """See :class:`~hhr_dolfinx.plugins.constraints.elimination.Constraint`.

        Raises:
            SceneError: for a single node.
        """
        nodes, points = nodes_at(assembler, self.place, self)
        dim = points.shape[1]
        if len(points) < 2:
            raise SceneError(f"{self!r} needs two nodes or more")
        coupled = _coupled(self, dim)
        motions = rigid_motions(points, assembler.hypothesis)[:, :, coupled].reshape(
            -1, len(points) * len(coupled)
        )
        # dofs that the motions follow from are the best of all; the others follow these
        _, triangle, order = qr(motions, mode="economic", pivoting=True)
        rank = int((np.abs(np.diag(triangle)) > 1e-9 * abs(triangle[0, 0])).sum())
        leading = order[:rank]
        following = order[rank:]
        follows = (
            np.linalg.lstsq(motions[:, leading].T, np.eye(rank), rcond=None)[0].T
            @ motions[:, following]
        )
        dofs = (dim * nodes[:, None] + coupled).ravel()
        count = following.size
        leads = [
            (-follows[k], np.arange(count), np.full(count, dofs[leading[k]])) for k in range(rank)
        ]
        entries = [(np.ones(count), np.arange(count), dofs[following]), *leads]
        return equations_of(entries, dofs[following], assembler.size, loose=True)


def fit_of(
    points: np.ndarray,
    weights: np.ndarray,
    component: int,
    point: Sequence[float] | None,
    coupled: np.ndarray,
    turns: Sequence[tuple[int, int]],
) -> np.ndarray | None:
    """Coefficients of the displacements of points in the motion of a reference point.

    The displacement a and the rotation b of the point x minimise the sum of w |u_k - a - b x (x_k -
    x)|^2 over points in the coupled components.

    Args:
        points: coordinates of the points, (n, dim).
        weights: weights w, (n,), with the sum 1.
        component: component of the motion: displacements, then rotations.
        point: the reference point, (dim,); None for the weighted centre.
        coupled: coupled components of the displacement.
        turns: pair of axes of each rotation.

    Returns:
        Coefficients, (n, dim); None if the component is undetermined.
    """
    dim = points.shape[1]
    size = np.ptp(points, axis=0).max() or 1.0
    away = (points - (weights @ points if point is None else point)) / size
    motions = np.zeros((dim + len(turns), len(points), dim))
    motions[np.arange(dim), :, np.arange(dim)] = 1.0
    for k, (first, second) in enumerate(turns, start=dim):
        motions[k, :, first] = -away[:, second]
        motions[k, :, second] = away[:, first]
    motions[:, :, np.setdiff1d(np.arange(dim), coupled)] = 0.0
    weighted = motions * weights[:, None]
    inertia = np.einsum("anc,bnc->ab", weighted, motions)
    unit = np.eye(len(motions))[component]
    shares = np.linalg.pinv(inertia, rcond=1e-10, hermitian=True) @ unit
    if np.abs(inertia @ shares - unit).max() > UNDETERMINED:
        return None
    return np.einsum("a,anc->nc", shares, weighted) / (size if component >= dim else 1.0)


@dataclass(frozen=True)
class _Coupled:
    """Motion of a reference point by a fit to that of nodes, which is exact on nodes of a
    :class:`RigidMotion`.
    """

    place: Tag | Place
    component: int
    amplitude: Amplitude | Formula = Amplitude()
    point: tuple[float, ...] | None = None
    components: tuple[int, ...] | None = None
    by_area: bool | str = True

    def __post_init__(self) -> None:
        description = f"the {type(self).__name__} of {self.place!r}"
        if self.by_area not in (True, False, EDGES_ONLY, ANGLES):
            choices = f"True, False, {EDGES_ONLY!r} or {ANGLES!r}"
            raise SceneError(f"by_area = {self.by_area!r} of {description} must be {choices}")
        if self.by_area == ANGLES and (self.component < 3 or self.point or self.components):
            raise SceneError(
                f"by_area = {ANGLES!r} of {description} is for a rotation in space, 3 to 5, about "
                "the centre alone"
            )
        check_place(description, self.place)
        if not is_whole(self.component, 0) or self.component > 5:
            raise SceneError(
                f"component {self.component!r} of {description} must be 0 to 5, in the plane 0, 1 "
                "or 2"
            )
        if self.point is not None:
            object.__setattr__(self, "point", as_tuple(f"the point of {description}", self.point))
            if not all(is_number(value) for value in self.point):
                raise SceneError(
                    f"point = {self.point} of {description} must be finite coordinates"
                )
        _check_components(self)
        check_amplitude(self, description, formulas=True)

    def _fit(self, assembler: Assembler) -> tuple[np.ndarray, np.ndarray]:
        """Dofs of the nodes, (n dim,), and their coefficients in the component of the motion."""
        nodes, points = nodes_at(
            assembler, self.place, self, whole=self.by_area in (True, EDGES_ONLY)
        )
        dim = points.shape[1]
        turns = () if assembler.hypothesis == "axisymmetric" else ROTATION_PLANES[dim]
        if self.component >= dim + len(turns) or (
            self.point is not None and len(self.point) != dim
        ):
            raise SceneError(
                f"component {self.component} of {self!r} does not exist in {dim} dimensions, or "
                "its point has another number of coordinates; in axisymmetry there are no "
                "rotations"
            )
        if self.by_area == ANGLES:
            return (dim * nodes[:, None] + np.arange(dim)).ravel(), _angles(
                points, turns[self.component - dim]
            ).ravel()
        coupled = _coupled(self, dim)
        coefficients = fit_of(
            points, self._weights(assembler, nodes), self.component, self.point, coupled, turns
        )
        if coefficients is None:
            raise SceneError(
                f"the nodes of {self!r} leave component {self.component} undetermined: couple "
                "more nodes"
            )
        return (dim * nodes[:, None] + np.arange(dim)).ravel(), coefficients.ravel()

    def _weights(self, assembler: Assembler, nodes: np.ndarray) -> np.ndarray:
        """Weights of nodes with the sum 1, (n,)."""
        weights = np.ones(nodes.size)
        if self.by_area in (True, EDGES_ONLY) and isinstance(self.place, int | str):
            with suppress(SceneError):  # a set of nodes without facets
                surface = assembler.surface(self.place)
                weights = np.bincount(
                    np.searchsorted(nodes, surface.nodes), surface.areas, nodes.size
                )
                if (
                    surface.quadratic is not None
                ):  # the integral of each function, whose corners have less than areas
                    (dim,) = assembler.test.ufl_shape
                    along = np.eye(dim)[-1].tolist()
                    form = elasticity.traction(
                        assembler.test, along, assembler.hypothesis, assembler.ds(self.place)
                    )
                    weights = assembler.vector(form)[dim * nodes + dim - 1]
                    if self.by_area == EDGES_ONLY:
                        weights = _of_edges(
                            weights, np.searchsorted(nodes, surface.nodes)[surface.quadratic.nodes]
                        )
        return weights / weights.sum()


def _angles(points: np.ndarray, turn: tuple[int, int]) -> np.ndarray:
    """Coefficients, (n, dim), of the displacements of points in the mean of their angles about the
    axis at the centre.

    Points on the axis count as such that do not turn, as in CalculiX.
    """
    away = points - points.mean(axis=0)
    squares = (away[:, list(turn)] ** 2).sum(axis=1)
    beside = squares > UNDETERMINED**2 * (away**2).sum(axis=1).mean()
    coefficients = np.zeros_like(points)
    for axis, normal_axis, sign in ((turn[0], turn[1], -1.0), (turn[1], turn[0], 1.0)):
        coefficients[beside, axis] = sign * away[beside, normal_axis] / squares[beside]
    shares: np.ndarray = (coefficients - coefficients.mean(axis=0)) / len(points)
    return shares


def _of_edges(weights: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Weights of nodes, (n,), with those in the middle of facets, (F, K), by the functions of
    serendipity elements.
    """
    if facets.shape[1] <= 2 * QUADRILATERAL_CORNERS:
        return weights
    edge_weights = weights.copy()
    middle = facets[:, -1]
    np.add.at(edge_weights, facets[:, QUADRILATERAL_CORNERS:-1], weights[middle, None] / 2)
    np.add.at(edge_weights, facets[:, :QUADRILATERAL_CORNERS], -weights[middle, None] / 4)
    edge_weights[middle] = 0.0
    return edge_weights


@dataclass(frozen=True)
class MeanMotion(_Coupled):
    """The mean motion of some nodes along a component is the amplitude: a distributing coupling.

    It is the displacement or the rotation of a reference point, by the weighted fit of a rigid
    motion to that of the nodes. On nodes that a :class:`RigidMotion` moves too, it is exact.

    Attributes:
        place: set, surface or :class:`~hhr_dolfinx.parameters.Place`.
        component: 0 to 2 of the displacement, 3 to 5 of the rotation in rad; in the plane 2 is the
            rotation.
        amplitude: the motion: a number, an Amplitude, or a formula of the parameters as text.
        point: the reference point, (dim,); None for the centre of the nodes, whose displacement is
            their mean.
        components: those of the nodes that are coupled; None for all of them.
        by_area: True if nodes of a surface, or of a set that holds whole facets, count by their
            areas; False if alike. With ``"edges"`` those in the middle of faces count for corners
            and edges, as in elements of 20 nodes. With ``"angles"`` a rotation is the mean of those
            of all nodes about the axis at their centre: ``*MPC MEANROT``.
    """

    def equations(self, assembler: Assembler) -> ConstraintEquations:
        """See :class:`~hhr_dolfinx.plugins.constraints.elimination.Constraint`.

        Raises:
            SceneError: for undetermined motions.
        """
        dofs, coefficients = self._fit(assembler)
        nonzero = coefficients != 0
        entries = coefficients[nonzero], np.zeros(int(nonzero.sum()), dtype=int), dofs[nonzero]
        dependent = dofs[[first_largest(np.abs(coefficients))]]
        return equations_of([entries], dependent, assembler.size, np.ones(1), loose=True)


@dataclass(frozen=True)
class CoupledForce(_Coupled):
    """A force or a moment on a reference point that some nodes carry: the load of a rigid or
    distributing coupling.

    The forces on the nodes are those that do the same work as the force on the point, whose motion
    is that of :class:`MeanMotion`; in axisymmetry they are those of all of the ring.

    Attributes:
        place: set, surface or :class:`~hhr_dolfinx.parameters.Place`.
        component: 0 to 2 of the force, 3 to 5 of the moment; in the plane 2 is the moment.
        amplitude: force or moment: a number, an Amplitude, or a formula of the parameters as text.
        point: the reference point, (dim,); None for the centre of the nodes.
        components: those of the nodes that are coupled; None for all of them.
        by_area: True if nodes of a surface, or of a set that holds whole facets, count by their
            areas; False if alike. With ``"edges"`` those in the middle of faces count for corners
            and edges, as in elements of 20 nodes. With ``"angles"`` a rotation is the mean of those
            of all nodes about the axis at their centre: ``*MPC MEANROT``.
    """

    def terms(self, assembler: Assembler) -> list[Term]:
        """One vector."""
        dofs, coefficients = self._fit(assembler)
        columns = csc_matrix((coefficients, (dofs, np.zeros_like(dofs))), shape=(assembler.size, 1))
        return [Term(self.amplitude, columns)]


def _check_components(item: RigidMotion | _Coupled) -> None:
    components = item.components
    if components is None:
        return
    components = as_tuple(f"components of {type(item).__name__}", components)
    if not components or not all(
        is_whole(component, 0) and component < 3 for component in components
    ):
        raise SceneError(
            f"components = {components} of the {type(item).__name__} of {item.place!r} must be "
            "among 0, 1 and 2"
        )
    object.__setattr__(item, "components", tuple(sorted(set(components))))


def _coupled(item: RigidMotion | _Coupled, dim: int) -> np.ndarray:
    """Components that are coupled."""
    return np.array([k for k in range(dim) if item.components is None or k in item.components])
