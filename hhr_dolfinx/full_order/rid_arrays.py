"""What reduced models of scenes whose shape depends on parameters take from the mesh, as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx import compat
from hhr_dolfinx.contact.problem import ContactProblem, ContactRows, masked
from hhr_dolfinx.errors import PairingWarning, SceneError
from hhr_dolfinx.forms import elasticity
from hhr_dolfinx.formulas import Modulus
from hhr_dolfinx.full_order.checks import CORNERS
from hhr_dolfinx.full_order.locking import stiffness_degree
from hhr_dolfinx.loads import first_load, placed
from hhr_dolfinx.models.eliminations.shaped import SurfacePatch
from hhr_dolfinx.models.functionals.cells import CellRule
from hhr_dolfinx.parameters import Tag
from hhr_dolfinx.warn import ignored

if TYPE_CHECKING:
    from hhr_dolfinx.full_order.discretisation import Discretisation
    from hhr_dolfinx.shapes import Shape


@dataclass(frozen=True)
class BodyArrays:
    """A body.

    Attributes:
        cells: numbers of its cells, (c,).
        volume: λ', weight of the change of volume.
        shape: μ', weight of the change of shape.
        mean_dilatation: whether it takes the mean dilatation of each cell.
    """

    cells: np.ndarray
    volume: Modulus
    shape: Modulus
    mean_dilatation: bool


class ShapedArrays:
    """Arrays of a scene whose shape depends on parameters; nodes, cells and dofs are those of its problem.

    Args:
        discretisation: of the scene.
        problem: its problem.

    Attributes:
        hypothesis: of the scene.
        names: of the parameters.
        axes: places of the parameters that shapes name, (d,).
        middles: nodes that shapes leave in the middle of others.
        reference: coordinates of the nodes on the mesh as it was made, (n, dim).
        shapes: the shapes, and the nodes of each.
        bodies: the bodies.
        pairings: of the contact pairs.
        surfaces: whole surfaces of each pair.
        openings: what openings add to the gaps, (N_lambda, 1 + T).

    Raises:
        SceneError: for graded bodies.
    """

    def __init__(self, discretisation: Discretisation, problem: ContactProblem):
        scene = discretisation.scene
        reshaped = discretisation.reshaped
        if reshaped is None:
            raise SceneError(f"the shape of scene '{scene.name}' does not depend on parameters")
        graded = [body.tag for body in scene.bodies if body.grading is not None]
        if graded:
            raise SceneError(
                f"bodies {graded} of scene '{scene.name}' are graded, and shapes depend on parameters: a reduced "
                "model cannot evaluate their grading where cells have moved. Divide a body into several, or take an "
                "interpolated condensation"
            )
        self._owner = discretisation
        self._problem = problem
        self._reshaped = reshaped
        self.hypothesis = scene.hypothesis
        self.names = scene.parameters.names
        self.axes = np.array(reshaped.axes, dtype=np.int64)
        self._cell = discretisation.mesh.topology.cell_name()
        self._geometry = self._geometry_nodes()
        self.middles = reshaped.middles()
        self.reference = self._dof_order(reshaped.reference)
        self.shapes = self._shapes()
        self.bodies = tuple(self._bodies())
        self.pairings = scene.contacts
        whole = {tag: self._whole(tag) for pairing in scene.contacts for tag in pairing.tags}
        self.surfaces = tuple(tuple(whole[tag] for tag in pairing.tags) for pairing in scene.contacts)
        self.openings = np.zeros_like(problem.gaps)
        first = first_load(scene) - len(scene.openings)
        for k, item in enumerate(scene.openings, start=first):
            self.openings[problem.contact_pairs == item.contact, k] = 1.0

    @property
    def rule(self) -> CellRule:
        """Quadrature of the stiffness."""
        order = self._owner.order
        points, weights = compat.quadrature(self._cell, stiffness_degree(self._cell, self.hypothesis, order))
        return CellRule(weights, *compat.shape_functions(self._cell, points, order))

    def coordinates(self, point: np.ndarray) -> np.ndarray:
        """Coordinates of all nodes at a point, (n, dim)."""
        return self._dof_order(self._reshaped.coordinates(point))

    def rows(self, point: np.ndarray) -> tuple[ContactRows, np.ndarray]:
        """Contact rows of all pairs at a point, those of imposed nodes included, and the pair of each."""
        with self._reshaped.at(point), ignored(PairingWarning):
            return self._owner.contact_rows()

    def forces(self, point: np.ndarray) -> csc_matrix:
        """F on free dofs at a point, sparse, (N, 1 + T)."""
        shape = self._problem.loads.shape
        with self._reshaped.at(point):
            terms = self._owner.load_terms()
        return masked(placed(terms, first_load(self._owner.scene), shape), self._problem.free)

    def _geometry_nodes(self) -> np.ndarray:
        """Node of the geometry of each node of the dofs, (n,)."""
        order = np.zeros(len(self._problem.points), dtype=np.int64)
        of_cells = compat.geometry_dofmap(self._owner.mesh)
        order[self._problem.cell_nodes[:, : of_cells.shape[1]]] = of_cells
        return order

    def _dof_order(self, coordinates: np.ndarray) -> np.ndarray:
        return self.middles.placed(coordinates[self._geometry, : self._problem.block_size])

    def _shapes(self) -> tuple[tuple[Shape, np.ndarray], ...]:
        cells = self._problem.cell_nodes[:, : compat.geometry_dofmap(self._owner.mesh).shape[1]]
        scene = self._owner.scene
        return tuple((shape, np.unique(cells[self._owner.cells_of(shape.tag)])) for shape in scene.shapes)

    def _bodies(self) -> list[BodyArrays]:
        found = []
        for body, mean in zip(self._owner.scene.bodies, self._owner.mean_dilatation, strict=True):
            parts = elasticity.unit_moduli(str(body.poisson), self.hypothesis)
            volume, shape = (Modulus(str(body.young), part, self.names) for part in parts)
            found.append(BodyArrays(self._owner.cells_of(body.tag).astype(np.int64), volume, shape, mean))
        return found

    def _whole(self, tag: Tag) -> SurfacePatch:
        """A whole surface, with the nodes behind its facets."""
        surface = self._owner.surface(tag)
        cells = self._problem.cell_nodes
        facets = surface.nodes[surface.facets if surface.quadratic is None else surface.quadratic.nodes]
        count = facets.shape[1]
        nodes = len(self._problem.points)
        near = np.zeros(nodes, dtype=bool)
        near[facets] = True
        tried = cells[near[cells].sum(axis=1) >= count]
        # the cell of a facet has all of its nodes
        shared = (_incidence(facets, nodes) @ _incidence(tried, nodes).T).tocoo()
        whole = shared.data > count - 0.5
        behind = tried[shared.col[whole]][np.argsort(shared.row[whole], kind="stable")]
        corners = behind[:, : CORNERS[self._cell]]
        far = corners[~(corners[:, :, None] == facets[:, None]).any(axis=2)]
        return SurfacePatch(tag, facets, far.reshape(len(facets), -1), np.zeros(0, dtype=np.int64))


def _incidence(parts: np.ndarray, nodes: int) -> csr_matrix:
    """Cells or facets by nodes, (p, k) -> (p, nodes), 1 where the node belongs to it."""
    count, k = parts.shape
    return csr_matrix((np.ones(count * k), (np.repeat(np.arange(count), k), parts.ravel())), shape=(count, nodes))
