"""The contact problem on a mesh whose shape depends on parameters, assembled at each parameter."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache
from threading import RLock
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem
from scipy.sparse import csr_matrix

from hhr_dolfinx import compat
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import (
    NotOfferedError,
    PairingWarning,
    ParameterError,
    SceneError,
    ShapeError,
)
from hhr_dolfinx.formulas import box_samples, coordinate_names
from hhr_dolfinx.full_order.checks import FOLDED, jacobians_of
from hhr_dolfinx.full_order.still import StillMesh
from hhr_dolfinx.full_order.system import System
from hhr_dolfinx.plugins.elasticity.gauss_points import degree_of
from hhr_dolfinx.plugins.elasticity.locking import SIMPLICES
from hhr_dolfinx.plugins.shapes.cells import Middles, MovingCells
from hhr_dolfinx.plugins.shapes.interpolated import reshaped_functionals
from hhr_dolfinx.plugins.shapes.outputs import FullShapeFunctionals
from hhr_dolfinx.warn import ignored

if TYPE_CHECKING:
    import ufl

    from hhr_dolfinx.amplitudes import Theta
    from hhr_dolfinx.contact.stiffness import Stiffness
    from hhr_dolfinx.full_order.discrete_space import DiscreteSpace
    from hhr_dolfinx.full_order.discretisation import Discretisation
    from hhr_dolfinx.full_order.system import Made, Middle, Parts
    from hhr_dolfinx.loads import Term
    from hhr_dolfinx.models.histories.equilibrium import FullEquilibrium

MAP_ROUND_OFF = 1e-9
"""Part of the size of the mesh up to which two maps of one node agree."""
MOST_SHAPE_BYTES = 5e8
"""Memory for problems of previous shapes."""
MAP_SAMPLES = 32
"""Number of points, in addition to the corners of the box, at which maps are checked."""
COMPARED_CORNERS = 33
"""Most shapes at which it is looked which nodes face each other, the middle of the box and corners
of it.
"""


MESH_STEP = 1e-5
"""Part of the box by which a mesh is displaced for finite differences: their error is its square,
and for smaller ones round-off of the assembly dominates.
"""


def stiffness_degree(cell: str, hypothesis: str, order: int = 1) -> int:
    """Degree of the rule of the stiffness for shapes that depend on parameters.

    Full and reduced models use it. On simplices the strain has a degree one below the displacement;
    in axisymmetry they use more points, for weights 1 / r. Other cells use one point more than
    their order along each axis, the usual full integration: exact on parallelograms and
    parallelepipeds. All weights are positive: the rule of degree 3 on tetrahedra has a negative
    one.

    Args:
        cell: kind of the cells.
        hypothesis: hypothesis of the scene.
        order: order of the displacement.
    """
    if cell in SIMPLICES:
        return max(1, 2 * order - 2) if hypothesis != "axisymmetric" else 2 * order + 2
    return 2 * order + 1


class ReassembledSystem(System):
    """Assembled on the mesh of each point, with other rows and gaps.

    ``problem.reshaped`` has its parts.
    """

    def parts(self) -> Parts:
        """See :class:`System`."""
        return self.problem.moduli, self.problem.stiffness_terms

    def equations(
        self, point: np.ndarray, theta: Theta
    ) -> tuple[ContactProblem, Stiffness, np.ndarray]:
        """See :class:`System`.

        Args:
            point: parameters, (P,).
            theta: θ there.
        """
        problem = self.problem.at(point)
        return (
            problem,
            self.made(problem.own_stiffness, problem),
            problem.loads[problem.rows] @ theta,
        )

    def explicit(
        self, point: np.ndarray, forces: np.ndarray, unknown: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`System`; by central differences of the equations on displaced meshes.

        Args:
            point: parameters, (P,).
            forces: contact forces, (m,).
            unknown: displacement, (n,).
        """

        def residual_and_slack(displaced: np.ndarray) -> np.ndarray:
            problem = self.problem.at(displaced)
            theta = problem.amplitudes(displaced)
            residual = (
                problem.stiffness @ unknown + problem.contact.T @ forces - problem.loads @ theta
            )
            return np.append(residual, problem.gaps @ theta - problem.contact @ unknown)

        slopes = self.problem.parameters.differences(residual_and_slack, point, MESH_STEP)
        return slopes[: unknown.size], slopes[unknown.size :]


class Reshaped(StillMesh):
    """Deforms the mesh of a scene and assembles its problem again; serial.

    See :class:`~hhr_dolfinx.contact.problem.Reshaping`. The discretisation owns the mesh, which has
    the shape of the middle of the box outside of evaluations. SceneError for maps that tear bodies
    apart or invert cells somewhere in the parameter range.
    """

    interpolated_outputs = staticmethod(reshaped_functionals)

    def __init__(self, discretisation: Discretisation):
        scene = discretisation.scene
        if discretisation.group.size > 1:
            raise SceneError(
                f"the shape of scene '{scene.name}' depends on parameters: build its model on one "
                "rank"
            )
        self._owner = discretisation
        self._lock = RLock()
        names = scene.parameters.names
        used = set().union(*(shape.variables for shape in scene.shapes))
        self.axes = tuple(index for index, name in enumerate(names) if name in used)
        self.described = "; ".join(
            f"{shape.tag}: " + ", ".join(formula.text for formula in shape.coordinates)
            for shape in scene.shapes
        )
        mesh = discretisation.mesh
        self._cells = compat.geometry_dofmap(mesh)
        self.reference = (
            mesh.geometry.x.copy()
        )  # of the nodes of the geometry in the mesh of the scene, (nodes, 3)
        # numbers of the nodes that each shape moves
        self.nodes = [
            np.unique(self._cells[discretisation.cells_of(shape.tag)]) for shape in scene.shapes
        ]
        self._check_box()
        self._middle = scene.parameters.middle
        mesh.geometry.x[:] = self.coordinates(self._middle)
        self._base: ContactProblem | None = None
        self._springs: np.ndarray | None = None  # dofs that have one, (N,)

    def coordinates(self, point: np.ndarray) -> np.ndarray:
        """Coordinates of the nodes of the geometry at a point, (nodes, 3).

        Args:
            point: parameters, (P,).

        Raises:
            SceneError: if two shapes move a common node differently.
        """
        scene = self._owner.scene
        coordinates = self.reference.copy()
        names = coordinate_names(scene.hypothesis)
        dim = self._owner.mesh.geometry.dim
        values = dict(zip(scene.parameters.names, point.tolist(), strict=True))
        size = np.ptp(self.reference, axis=0).max()
        seen = np.zeros(len(coordinates), dtype=bool)
        for shape, nodes in zip(scene.shapes, self.nodes, strict=True):
            mapped = shape.moved(self.reference[nodes, :dim], names, values)
            both = seen[nodes] & (
                np.abs(coordinates[nodes, :dim] - mapped).max(axis=1) > MAP_ROUND_OFF * size
            )
            if both.any():
                raise SceneError(
                    f"the shape of body {shape.tag} tears it from its neighbour, at "
                    f"{self.reference[nodes][both][0]}: two bodies that share nodes must move "
                    "them alike"
                )
            coordinates[nodes, :dim] = mapped
            seen[nodes] = True
        return coordinates

    def middles(self) -> Middles:
        """Nodes that the geometry lacks: displacements of second order on cells of first order."""
        cells = self._owner.space.dofmap.list
        count = self._cells.shape[1]
        if count == cells.shape[1]:
            return Middles(np.zeros(0, dtype=np.int64), np.zeros((0, 1), dtype=np.int64))
        kind = self._owner.mesh.topology.cell_name()
        coordinates = compat.nodes_of_cell(kind, self._owner.order)[count:]
        weights = compat.shape_functions(kind, coordinates)[0]
        most = round(1 / weights[weights > MAP_ROUND_OFF].min())
        between = np.array(
            [np.repeat(np.arange(count), np.round(row * most).astype(int)) for row in weights]
        )
        nodes, first = np.unique(cells[:, count:], return_index=True)
        cell, index = np.divmod(first, len(coordinates))
        return Middles(
            nodes.astype(np.int64), cells[cell[:, None], between[index]].astype(np.int64)
        )

    def moving_cells(self, cells: np.ndarray, mean_dilatation: bool) -> MovingCells:
        """Cells as arrays, from which a model computes their strain.

        Args:
            cells: their numbers, (c,).
            mean_dilatation: True if they have the mean dilatation.
        """
        discretisation = self._owner
        mesh = discretisation.mesh
        scene = discretisation.scene
        kind = mesh.topology.cell_name()
        space = discretisation.space
        middle = compat.interpolation_points(
            fem.functionspace(mesh, ("Discontinuous Lagrange", 0)).element
        )
        points, weights = compat.quadrature(kind, degree_of(discretisation))
        # displacement and geometry have the same shape functions, with the same middles
        values, slopes = compat.shape_functions(
            kind, np.vstack([middle, points]), discretisation.order
        )
        nodes, cells_here = np.unique(space.dofmap.list[cells], return_inverse=True)
        cells_here = cells_here.reshape(len(cells), -1).astype(np.int64)
        geometry = compat.geometry_dofmap(mesh)[cells]
        of_geometry = np.full(nodes.size, -1)
        of_geometry[cells_here[:, : geometry.shape[1]]] = geometry
        moves = [np.isin(of_geometry, nodes_of_shape) for nodes_of_shape in self.nodes]
        shapes_with_masks = [
            (shape, mask) for shape, mask in zip(scene.shapes, moves, strict=True) if mask.any()
        ]
        selected = slice(1, None) if mean_dilatation else slice(1, 1)
        return MovingCells(
            shapes=tuple(shape for shape, _ in shapes_with_masks),
            moved=tuple(mask for _, mask in shapes_with_masks),
            coordinates=coordinate_names(scene.hypothesis),
            parameters=scene.parameters.names,
            middles=self.middles().among(nodes),
            points=self.reference[of_geometry, : mesh.geometry.dim].copy(),
            nodes=nodes.astype(np.int64),
            cells=cells_here,
            values=values[0],
            slopes=slopes[0],
            weights=weights if mean_dilatation else np.zeros(0),
            gauss_values=values[selected],
            gauss_slopes=slopes[selected],
            axisymmetric=scene.hypothesis == "axisymmetric",
        )

    @contextmanager
    def at(self, point: np.ndarray) -> Iterator[None]:
        """Context in which the mesh has the shape of a point."""
        geometry = self._owner.mesh.geometry
        with self._lock:
            before = geometry.x.copy()
            geometry.x[:] = self.coordinates(point)
            try:
                yield
            finally:
                geometry.x[:] = before

    def __call__(self, point: np.ndarray) -> ContactProblem:
        """The problem at a point, (P,), its conditions in the order of the base problem.

        ShapeError if other nodes are in contact there, or the boundary of a partial pressure is
        displaced.
        """
        return self._kept(point[list(self.axes)].tobytes())

    def system(self, problem: ContactProblem, middle: Middle, made: Made) -> ReassembledSystem:
        """See :class:`StillMesh`.

        Args:
            problem: the contact problem.
            middle: K in the middle of the box.
            made: makes K from a matrix.
        """
        return ReassembledSystem(problem, middle, made)

    def measure(self, dx: ufl.Measure) -> ufl.Measure:
        """See :class:`StillMesh`; with the rule of reduced models."""
        kind, order = self._owner.cells_and_order
        return dx(degree=stiffness_degree(kind, self._owner.scene.hypothesis, order))

    def attached(self, problem: ContactProblem) -> ContactProblem:
        """Attach the base problem, that of the middle of the box, whose order the others have.

        SceneError if contact alone holds a body whose shape depends on parameters, for a law that
        reads areas on its surface, and for constraints whose coefficients change with it.
        """
        self._check_held(problem)
        self._check_areas(problem)
        self._base = replace(problem, reshaped=self)
        springs = self._owner.springs
        self._springs = None if springs is None else springs != 0
        terms = (
            sum(term.data.nbytes for term in problem.stiffness_terms)
            + problem.node_mass.data.nbytes
        )
        # tables of forces, fields and outputs use the same shapes, which take seconds to assemble
        # and to pair
        self._kept = lru_cache(maxsize=max(1, int(MOST_SHAPE_BYTES / terms)))(self._assembled)
        self._check_constraints(problem)
        return self._base

    def _check_held(self, problem: ContactProblem) -> None:
        """Rigid motions of a body whose shape depends on parameters would depend on it too."""
        if problem.kernel is None:
            return
        rigid = np.abs(np.hstack([problem.kernel.motions, problem.kernel.idle])).max(axis=1)
        moving = np.repeat(self._moving_nodes(), problem.block_size)
        if (moving & (rigid > MAP_ROUND_OFF * rigid.max())).any():
            raise SceneError(
                f"contacts that alone hold a body of scene '{self._owner.scene.name}' act on one "
                "whose shape depends on parameters: that is built in for bodies that keep their "
                "shape"
            )

    def _check_constraints(self, problem: ContactProblem) -> None:
        """Raise SceneError for constraints whose coefficients depend on shapes.

        The shape of a corner of the box is compared.
        """
        coupling = problem.prolongation.map
        moving = np.repeat(self._moving_nodes(), problem.block_size)
        if coupling is not None and (moving & _coupled(coupling)).any():
            try:
                self(np.array(problem.parameters.lower))
            except ShapeError as error:
                raise SceneError(f"scene '{self._owner.scene.name}', {error}") from None

    def _check_springs(self, problem: ContactProblem, point: np.ndarray) -> None:
        """ShapeError for springs that choose other nodes by their places on the current mesh."""
        if self._springs is None or (springs := self._owner.springs) is None:
            return
        if not np.array_equal(springs != 0, self._springs):
            raise ShapeError(
                f"at {problem.parameters.described(point)} springs are at other nodes than in the "
                "middle of the box: their places move with the shape. Name them by a facet tag, "
                "or by places that stay"
            )

    def _check_areas(self, problem: ContactProblem) -> None:
        """Refuse a law that reads areas on slave surfaces whose areas change with a shape."""
        law = problem.law
        if not law.plugin or law.reshapes:
            return
        scene = self._owner.scene
        with_law = [
            number for number, law_of_pair in enumerate(scene.laws) if law_of_pair is not None
        ]
        slaves = problem.contact_slaves[np.isin(problem.contact_pairs, with_law)]
        if self._moving_nodes()[slaves].any():
            raise SceneError(
                f"contacts of scene '{scene.name}' have {law.name}, which reads the areas of "
                "slave nodes, and these are on a body whose shape depends on parameters: areas of "
                "one shape are kept. Make the surface of the body that keeps its shape the slave"
            )

    def touching(self) -> ContactProblem:
        """See :class:`~hhr_dolfinx.contact.problem.Reshaping`; by shapes in corners of the box."""
        assert self._base is not None
        total = abs(self._base.contact)
        corners = box_samples(self._base.parameters, 1)[:-1]
        _, first = np.unique(corners[:, list(self.axes)], axis=0, return_index=True)
        for point in corners[np.sort(first)[:COMPARED_CORNERS]]:
            total = total + abs(self(point).contact)
        return replace(self._base, contact=csr_matrix(total))

    def check_still(self, what: str, nodes: np.ndarray, terms: Sequence[Term]) -> None:
        """Refuse gaps that depend on the position of nodes that a shape moves.

        Args:
            what: name of these terms, for the message.
            nodes: the nodes, (n,).
            terms: terms of their gaps.

        Raises:
            NotOfferedError: for a term with a position, if a shape moves one of the nodes.
        """
        if (
            any(hasattr(term.amplitude, "points") for term in terms)
            and self._moving_nodes()[nodes].any()
        ):
            raise NotOfferedError(
                f"{what} of scene '{self._owner.scene.name}' is with a curved obstacle whose "
                "place or size depends on parameters, and its surface moves with a shape, on "
                "which its gaps depend in another way: give the obstacle numbers, or move it past "
                "a body that keeps its shape"
            )

    def _moving_nodes(self) -> np.ndarray:
        """Nodes of the displacement that shapes move, (nodes,) bool."""
        owner = self._owner
        moving = np.zeros(len(owner._points()), dtype=bool)
        for shape in owner.scene.shapes:
            moving[owner._cell_nodes()[owner.cells_of(shape.tag)]] = True
        return moving

    def outputs(
        self, space: DiscreteSpace, problem: ContactProblem, equilibrium: FullEquilibrium | None
    ) -> FullShapeFunctionals:
        """Outputs of the scene on the mesh of each shape.

        Args:
            space: space of the displacement; not used.
            problem: the contact problem.
            equilibrium: laws of the bodies; not used.
        """
        return FullShapeFunctionals(self._owner, self, self.moving_cells, problem)

    def _assembled(self, key: bytes) -> ContactProblem:
        """The problem for a shape; no other parameter changes it."""
        point = self._middle.copy()
        point[list(self.axes)] = np.frombuffer(key)
        # between the checked points of the box a map may still fold
        fault = self._fault(self.coordinates(point), point)
        if fault:
            raise ShapeError(fault)
        with (
            self.at(point),
            ignored(PairingWarning),
        ):  # the warning was shown when the model was built
            problem = self._owner.contact_problem(*self._owner.stiffness_terms())
            self._check_springs(problem, point)
        assert self._base is not None
        return self._ordered(problem, self._base, point)

    def _ordered(
        self, problem: ContactProblem, base: ContactProblem, point: np.ndarray
    ) -> ContactProblem:
        """Sort rows by their slave node: a pairing may order them differently for another shape."""
        keys = [
            np.lexsort((entry.contact_slaves, entry.contact_pairs)) for entry in (base, problem)
        ]
        pairs = zip(keys, (base, problem), strict=True)
        same = [
            np.column_stack([entry.contact_slaves, entry.contact_pairs])[key]
            for key, entry in pairs
        ]
        if not np.array_equal(same[0], same[1]):
            raise ShapeError(
                f"at {base.parameters.described(point)} other nodes are in contact than in the "
                "middle of the box: the shape changes which surfaces face each other. Narrow the "
                "box, or tag surfaces that face in all of it"
            )
        if not _alike(base.prolongation.map, problem.prolongation.map):
            raise ShapeError(
                f"at {base.parameters.described(point)} coefficients of constraints are others "
                "than in the middle of the box: means over surfaces, and rigid motions, change "
                "with the shape of their bodies. That is built in for bodies that keep their "
                "shape, and for equations between dofs"
            )
        for before, after in zip(
            base.amplitudes.nonaffine, problem.amplitudes.nonaffine, strict=True
        ):
            line, line_after = (getattr(entry, "positions", None) for entry in (before, after))
            if (
                line is not None
                and line_after is not None
                and not np.allclose(line, line_after, rtol=1e-12)
            ):
                raise ShapeError(
                    "the line of a partial pressure moves with the shape: press on a surface that "
                    "does not, or on all"
                )
        order = np.empty(len(problem.gaps), dtype=np.int64)
        order[keys[0]] = keys[1]
        rows = (
            "contact whole_contact gaps contact_slaves contact_pairs contact_points contact_areas"
        )
        ordered = {name: getattr(problem, name)[order] for name in rows.split()}
        shares = None if problem.shares is None else problem.shares.ordered(order)
        ordered_problem = replace(
            problem, **ordered | {"gaps": np.asfortranarray(ordered["gaps"])}, shares=shares
        )
        return (
            ordered_problem
            if base.kernel is None
            else replace(ordered_problem, kernel=base.kernel.at(ordered_problem), law=base.law)
        )

    def _check_box(self) -> None:
        """Raise SceneError for maps that invert a cell in a corner of the box or between."""
        scene = self._owner.scene
        for point in box_samples(scene.parameters, MAP_SAMPLES):
            try:
                coordinates = self.coordinates(point)
            except ParameterError as error:
                raise SceneError(
                    f"a shape of scene '{scene.name}' at {scene.parameters.described(point)}: "
                    f"{error}. Give the table further points, or narrow the box"
                ) from None
            fault = self._fault(coordinates, point)
            if fault:
                raise SceneError(fault)

    def _fault(self, coordinates: np.ndarray, point: np.ndarray) -> str:
        """Message about invalid cells with nodes at some coordinates at a point.

        Empty if all are valid.
        """
        scene = self._owner.scene
        dim = self._owner.mesh.geometry.dim
        corners = coordinates[self._cells][:, :, :dim]
        where = scene.parameters.described(point)
        if not np.isfinite(corners).all():
            return f"a shape of scene '{scene.name}' is not finite at {where}: check its formulas"
        mesh = self._owner.mesh
        sign = np.sign(jacobians_of(mesh, self.reference[self._cells][:, :, :dim]).mean(axis=1))[
            :, None
        ]
        jacobians = jacobians_of(mesh, corners) * sign
        bad = np.flatnonzero(jacobians.min(axis=1) <= FOLDED * np.abs(jacobians).max(axis=1))
        if not bad.size:
            return ""
        centre = self.reference[self._cells[bad[0]]].mean(axis=0)[:dim].tolist()
        return (
            f"a shape of scene '{scene.name}' turns {bad.size} cells inside out at {where}, e.g. "
            f"around {centre}: narrow the box, or move the nodes around it too"
        )


def _coupled(coupling: csr_matrix) -> np.ndarray:
    """Dofs that depend on others, and those that they follow, by T, (N, N): (N,) bool."""
    rows, columns = coupling.nonzero()
    apart = rows != columns
    dofs = np.asarray(coupling.diagonal()) != 1.0
    dofs[rows[apart]] = True
    dofs[columns[apart]] = True
    return dofs


def _alike(one: csr_matrix | None, other: csr_matrix | None) -> bool:
    """True if two maps of dofs, or their absence, are the same up to round-off."""
    if one is None or other is None:
        return one is other
    return bool(abs(one - other).max() <= MAP_ROUND_OFF)
