"""Functions on the mesh of a scene: measures, tags, surfaces, assembly; no contact mechanics."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from petsc4py import PETSc
from scipy.sparse import csr_matrix
from ufl.algorithms import compute_form_data
from ufl.algorithms.check_arities import ArityMismatch

from hhr_dolfinx import compat
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.forms import contact, elasticity
from hhr_dolfinx.full_order.checks import (
    SUPPORTED_CELLS,
    build_geometry,
    check_outer,
    check_present,
    order_of,
    tagged,
)
from hhr_dolfinx.group import group_of
from hhr_dolfinx.loads import Assembler, Terms
from hhr_dolfinx.pairings.surface import Surface, make_surface
from hhr_dolfinx.parameters import Place, Tag
from hhr_dolfinx.scene import Scene

if TYPE_CHECKING:
    from hhr_dolfinx.loads import Load
    from hhr_dolfinx.models.histories.equilibrium import LawsAtPlaces
    from hhr_dolfinx.outputs import Output


class DiscreteSpace(ABC):
    """Lagrange functions on the mesh of a scene, on a communicator, with measures and assembly.

    Raises:
        SceneError: for a mesh that does not fit the scene, or missing tags.
    """

    #: True for bodies that use the mean dilatation of their cells
    mean_dilatation: tuple[bool, ...]
    terms: Terms  #: of θ, set when a problem is assembled: their order is the same for all shapes

    def __init__(self, scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD):
        compat.require_dolfinx()
        self.scene = scene
        self.group = group_of(comm)
        with self.group.together(f"the geometry of scene '{scene.name}'"):
            # mesh of DOLFINx, its tags, names of bodies and surfaces in it, and sets of nodes by
            # name
            self.mesh, self._cell_tags, self._facet_tags, self.names, self._sets = build_geometry(
                scene, self.group
            )
        dim = self.mesh.geometry.dim
        self.order = order_of(scene, self.mesh)  # degree of its functions, 1 or 2
        # vector Lagrange space of that degree
        self.space = fem.functionspace(self.mesh, ("Lagrange", self.order, (dim,)))
        nodes = self.space.dofmap.index_map
        self.rows = slice(*(dim * n for n in nodes.local_range))  # range of the own dofs
        self.size = dim * nodes.size_global  # N, number of all dofs
        self._dx = ufl.Measure("dx", domain=self.mesh, subdomain_data=self._cell_tags)
        self._ds = ufl.Measure("ds", domain=self.mesh, subdomain_data=self._facet_tags)
        self._trial = ufl.TrialFunction(self.space)
        self._test = ufl.TestFunction(self.space)
        self._linear: set[str] = set()

    @property
    @abstractmethod
    def free_dofs(self) -> np.ndarray:
        """Dofs that are not imposed, (N,) bool."""

    @abstractmethod
    def assembler(self, load: Load | Output) -> Assembler:
        """Interface for a load or an output."""

    def laws(self) -> LawsAtPlaces | None:
        """Laws on the mesh as it lies, which shapes move; None if all bodies are elastic."""
        return None

    @property
    def cells_and_order(self) -> tuple[str, int]:
        """Kind of the cells, and degree of the displacement."""
        return self.mesh.topology.cell_name(), self.order

    @property
    def arguments(self) -> tuple[ufl.Argument, ufl.Argument]:
        """Trial and test function."""
        return self._trial, self._test

    def cells_of(self, tag: Tag) -> np.ndarray:
        """Local numbers of the cells of a body."""
        return tagged(self._cell_tags, self.names.cell(tag))

    @abstractmethod
    def cells(self, tag: Tag) -> ufl.Measure:
        """Measure of the cells of a body for its stiffness."""

    def constant(self, value: float | str) -> fem.Constant:
        """A number or its string, in a form without compiled values: each new value would take
        seconds to compile.
        """
        return fem.Constant(self.mesh, float(value))

    @cached_property
    def _mass_form(self):
        return compat.jitted(
            fem.form, elasticity.mass(self._trial, self._test, self.scene.hypothesis, self._dx)
        )

    def own_rows(self, matrix: PETSc.Mat) -> csr_matrix:
        """Local rows of a matrix, (own dofs, N); the matrix is destroyed. Collective.

        PETSc keeps objects that ranks share until all of them destroy these explicitly.
        """
        indptr, indices, data = matrix.getValuesCSR()
        matrix.destroy()
        return csr_matrix(
            (data, indices, indptr), shape=(self.rows.stop - self.rows.start, self.size)
        )

    def cell_bodies(self) -> np.ndarray:
        """Body of each cell of this rank as its index in the scene, (cells,)."""
        bodies = np.full(self.mesh.topology.index_map(self.mesh.topology.dim).size_local, -1)
        for index, body in enumerate(self.scene.bodies):
            cells = self.cells_of(body.tag)
            bodies[cells[cells < bodies.size]] = index
        return bodies

    def _outer_facets(self, load: str, tag: Tag) -> ufl.Measure:
        """Measure of the facets with a tag, for a load of this class."""
        check_outer(load, tag, self.mesh, self._facet_tags, self.names, self.group)
        return self._ds(self.names.facet(tag))

    def _cells(self, tag: Tag) -> ufl.Measure:
        """Measure of the cells with a tag."""
        self.check_cells(tag)
        return self._dx(self.names.cell(tag))

    def check_cells(self, tag: Tag) -> None:
        """Raise SceneError if no cell has a tag."""
        check_present("cell", self._cell_tags, [tag], self.names, self.group)

    def _tagged_dofs(self, tag: Tag | Place, component: int) -> np.ndarray:
        dim = self.mesh.geometry.dim
        if not 0 <= component < dim:
            raise SceneError(
                f"component {component} of the displacement on tag {tag} does not exist: the mesh "
                f"of scene '{self.scene.name}' has {dim} dimensions, take a component below that, "
                "counted from 0"
            )
        return dim * self.nodes(tag) + component

    def nodes(self, tag: Tag | Place, whole: bool = True) -> np.ndarray:
        """Numbers of the nodes of tagged facets, of a set of the mesh or of a place, (k,), in their
        order.

        Args:
            tag: facet tag, name of a set of nodes, or a place.
            whole: of a set that holds whole facets take all of their nodes, also those in the
                middle of faces.

        Raises:
            SceneError: for a tag that the mesh lacks, or a place without nodes.
        """
        if not isinstance(tag, int | str):
            selected = self.by_place[np.unique(tag.nodes(self._points()[self.by_place]))]
            if not selected.size:
                raise SceneError(
                    f"{tag!r} of scene '{self.scene.name}' holds no node of its mesh: move or "
                    "widen it"
                )
            return selected
        owned = (
            self._nodes_of_set(self._sets[tag])
            if tag in self._sets
            else np.zeros(0, dtype=np.int64)
        )
        if tag not in self._sets or (whole and tag in self.names.facets):
            check_present("facet", self._facet_tags, [tag], self.names, self.group)
            facets = tagged(self._facet_tags, self.names.facet(tag))
            local = fem.locate_dofs_topological(self.space, self.mesh.topology.dim - 1, facets)
            owned = np.union1d(owned, local[local < self.space.dofmap.index_map.size_local])
        return np.unique(self.group.joined(owned + self.space.dofmap.index_map.local_range[0]))

    @cached_property
    def by_place(self) -> np.ndarray:
        """Numbers of the nodes that places hold, (k,): all but those of bodies that they do not
        name. Collective.
        """
        every = np.arange(len(self._points()))
        hidden = [body.tag for body in self.scene.bodies if not body.by_place]
        if not hidden:
            return every
        cells = np.concatenate([self.cells_of(tag) for tag in hidden])
        local = np.unique(self.space.dofmap.list[cells]).astype(np.int32)
        numbers = self.space.dofmap.index_map.local_to_global(local)
        return np.setdiff1d(every, self.group.joined(numbers))

    def _nodes_of_set(self, numbers: np.ndarray) -> np.ndarray:
        """Own nodes, (k,), for numbers of points of the file, on cells of first order with those
        between them.
        """
        in_set = np.isin(self.mesh.geometry.input_global_indices, numbers)[
            compat.geometry_dofmap(self.mesh)
        ]
        nodes = self.space.dofmap.list
        edges, _ = compat.topology(self.mesh.topology.cell_name())
        corners = SUPPORTED_CELLS[self.mesh.topology.cell_name()]
        held = np.zeros(nodes.shape, dtype=bool)
        held[:, : in_set.shape[1]] = in_set
        if self.order > 1 and in_set.shape[1] == corners:
            held[:, corners : corners + len(edges)] |= in_set[:, np.array(edges)].all(axis=2)
        selected = np.unique(nodes[held])
        return selected[selected < self.space.dofmap.index_map.size_local]

    def _load_vector(self, load: Load | Output, form: ufl.Form) -> np.ndarray:
        """Assemble a form that is linear in v, (N,)."""
        arguments = form.arguments() if isinstance(form, ufl.Form) else ()
        try:
            # the check takes as long as assembling, and shapes assemble the same forms repeatedly
            linear = arguments == (self._test,) and (
                form.signature() in self._linear or compute_form_data(form)
            )
        except ArityMismatch:
            linear = False
        if not linear:
            raise SceneError(
                f"the form of {load!r} must be linear in v and integrated over ds or dx, and is "
                f"{form!r}"
            )
        self._linear.add(form.signature())
        return self._assemble_vector(form)

    def surface(self, tag: Tag) -> Surface:
        """The facets with a tag on the current mesh."""
        dim = self.mesh.geometry.dim
        points = self._points()
        hypothesis = self.scene.hypothesis
        ds = self._ds(self.names.facet(tag))
        area = self._assemble_vector(contact.tributary_area(self._test, hypothesis, ds))[::dim]
        weights = elasticity.weight_at(points[:, 0], hypothesis)
        facets, inner = self._facets(tag)
        surface = make_surface(tag, facets, inner, points, weights, area)
        if surface.quadratic is None:
            return surface
        return replace(surface, free=self.free_dofs.reshape(-1, dim)[surface.nodes])

    def _facets(self, tag: Tag) -> tuple[np.ndarray, ...]:
        """Nodes of the tagged facets and the middle of the opposite nodes in their cells, gathered
        from all ranks.
        """
        topology = self.mesh.topology
        dofmap = self.space.dofmap
        tdim = topology.dim
        dim = self.mesh.geometry.dim
        topology.create_connectivity(tdim - 1, tdim)
        topology.create_connectivity(tdim, tdim - 1)
        to_cell = topology.connectivity(tdim - 1, tdim)
        to_facets = topology.connectivity(tdim, tdim - 1)
        corners = [
            dofmap.dof_layout.entity_closure_dofs(tdim - 1, k)
            for k in range(len(to_facets.links(0)))
        ]
        coordinates = self.space.tabulate_dof_coordinates()[:, :dim]
        vertices = SUPPORTED_CELLS[topology.cell_name()]
        nodes = []
        inner = []
        for facet in tagged(self._facet_tags, self.names.facet(tag)):
            cell = to_cell.links(facet)[0]
            # all contribute the facets of their cells
            if cell < topology.index_map(tdim).size_local:
                local = int(np.flatnonzero(to_facets.links(cell) == facet)[0])
                cell_nodes = dofmap.cell_dofs(cell)
                nodes.append(cell_nodes[corners[local]])
                far = np.setdiff1d(np.arange(vertices), corners[local])
                inner.append(coordinates[cell_nodes[far]].mean(axis=0))
        count = len(corners[0])
        local_nodes = np.array(nodes, dtype=np.int32).reshape(-1, count)
        numbers = dofmap.index_map.local_to_global(local_nodes.ravel()).reshape(-1, count)
        gathered = self.group.gathered((numbers, np.array(inner).reshape(-1, dim)))
        return tuple(np.concatenate(arrays) for arrays in zip(*gathered, strict=True))

    def _points(self):
        local = self.space.tabulate_dof_coordinates()[: self.space.dofmap.index_map.size_local]
        return self.group.joined(local)[:, : self.mesh.geometry.dim]

    def _cell_nodes(self):
        owned = self.mesh.topology.index_map(self.mesh.topology.dim).size_local
        local = self.space.dofmap.list[:owned]
        numbers = self.space.dofmap.index_map.local_to_global(local.ravel().astype(np.int32))
        return self.group.joined(numbers.reshape(local.shape))

    def _assemble_vector(self, form: ufl.Form) -> np.ndarray:
        vector = fem_petsc.assemble_vector(compat.jitted(fem.form, form))
        vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        values = self.group.joined(vector.array)
        vector.destroy()
        return values
