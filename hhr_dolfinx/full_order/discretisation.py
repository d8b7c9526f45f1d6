"""From a scene to matrices: DOLFINx assembles, PETSc holds, thesis (1.21)-(1.22).

It makes a :class:`ContactProblem` whose large matrices are distributed: each process has the rows
of its dofs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
import ufl
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from scipy.sparse import csc_matrix, csr_matrix, identity
from ufl.core.expr import Expr

from hhr_dolfinx import registry
from hhr_dolfinx.amplitudes import Amplitude, Amplitudes, bound
from hhr_dolfinx.contact.kernel import Kernels
from hhr_dolfinx.contact.law import UNILATERAL, ContactLaw, MeshArrays, PairLaw, check_attached
from hhr_dolfinx.contact.problem import ContactProblem, strained
from hhr_dolfinx.contact.prolongation import Prolongation
from hhr_dolfinx.contact.rows import ContactRows, joined
from hhr_dolfinx.contact.shares import Shares
from hhr_dolfinx.errors import SceneError, rounded
from hhr_dolfinx.full_order.answer_mesh import answer_mesh_of
from hhr_dolfinx.full_order.checks import conditions_with_unknowns, warn_of_idle_parameters
from hhr_dolfinx.full_order.discrete_space import DiscreteSpace
from hhr_dolfinx.full_order.elasticity import elasticity_of
from hhr_dolfinx.full_order.eliminated import DependentDofs
from hhr_dolfinx.full_order.free_bodies import FreeBody, free_bodies
from hhr_dolfinx.full_order.still import StillMesh
from hhr_dolfinx.loads import Assembler, Load, Term, Terms, checked_terms
from hhr_dolfinx.pairings.surface import normalised
from hhr_dolfinx.parameters import Tag
from hhr_dolfinx.scene import Scene

if TYPE_CHECKING:
    from hhr_dolfinx.formulas import Formula, Modulus
    from hhr_dolfinx.full_order.system import StatedSystem
    from hhr_dolfinx.models.answer_mesh import AnswerMesh
    from hhr_dolfinx.outputs import Output

ONE_LINE = 0.7
"""Cosine of two directions above which conditions of a node may be one: averaged normals differ by
up to 40 degrees.
"""


class Discretisation(DiscreteSpace):
    """Finite element model of a scene: matrices, loads and contact conditions on its mesh.

    Raises:
        NotOfferedError: for shapes, if no installed plug-in deforms meshes.
        SceneError: for a mesh that does not suit the scene, missing tags, surfaces that do not face
            each other, or conflicting displacements.
    """

    #: False for the matrices of a system that has no mesh
    has_mesh = True

    def __init__(self, scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD):
        super().__init__(scene, comm)
        self.elasticity = elasticity_of(self)
        self.mean_dilatation = self.elasticity.mean_dilatation
        # on the mesh before it is deformed
        self._fields = {
            number: displacement.at(self._points(), scene.hypothesis)
            for number, displacement in enumerate(scene.displacements)
            if displacement.field is not None
        }
        self.shape = StillMesh()
        if scene.shapes:
            request = f"scene '{scene.name}', whose shapes depend on parameters,"
            # outside of evaluations the mesh has the shape of the middle of the box
            self.shape = registry.tool("shapes", request)(self)

    def cells(self, tag: Tag) -> ufl.Measure:
        """See :class:`DiscreteSpace`."""
        return self.shape.measure(self._dx(self.names.cell(tag)))

    def stiffness_terms(self) -> tuple[tuple[csr_matrix, ...], tuple[Modulus, ...]]:
        """Local rows of the parts of K, and their moduli; one part and no modulus if K is
        constant.
        """
        return self.elasticity.stiffness_terms(self)

    @property
    def springs(self) -> np.ndarray | None:
        """Stiffness to ground of each dof, (N,), by loads that resist; None without."""
        return self.elasticity.springs(self)

    def contact_problem(
        self, stiffness: tuple[csr_matrix, ...], moduli: tuple[Modulus, ...] = ()
    ) -> ContactProblem:
        """Assemble the contact problem (1.21).

        Only large matrices are distributed.

        Args:
            stiffness: local rows of the parts of K, (own dofs, N) each.
            moduli: modulus of each part; empty if K is constant.
        """
        scene = self.scene
        imposed, free = self._displacements()
        eliminated = self._eliminated(free, imposed)
        imposed += eliminated.terms
        rows, pairs, opened = self._contacts()
        self.terms = Terms(scene.parameters, imposed=imposed, gaps=opened, loads=self.load_terms())
        limits = tuple(
            limit for body in scene.bodies for limit in body.limits(scene.parameters.names)
        )
        amplitudes = self.terms.amplitudes(limits)
        lifts = self.terms.columns("imposed", self.size)
        lifts = self.elasticity.lifted(self, lifts, free)
        eliminated = replace(eliminated, prolongation=eliminated.prolongation.lifted(lifts))
        prolongation = eliminated.prolongation
        added = self.terms.columns("gaps", rows.gap.size).toarray()
        rows, pairs, gaps, law, shares = self.conditions(rows, pairs, added, eliminated, amplitudes)
        # K of a constant scene has no round-off of rigid motions to lose
        pull = strained if moduli or scene.constraints else csr_matrix.__matmul__
        return ContactProblem(
            stiffness_terms=prolongation.stiffness(stiffness, self.rows, self.group),
            moduli=moduli,
            node_mass=self._node_mass(),
            prolongation=prolongation,
            forces=self.terms.columns("loads", self.size),
            pulls=tuple(
                csc_matrix(self.group.stacked(pull(term, prolongation.lifts))) for term in stiffness
            ),
            contact=_without_columns(prolongation.rows(rows.matrix), ~prolongation.free),
            gaps=np.asfortranarray(gaps),
            contact_slaves=rows.slaves,
            contact_pairs=pairs,
            contact_points=rows.points,
            contact_areas=rows.areas,
            shares=shares,
            cell_nodes=self._cell_nodes(),
            points=self._points(),
            amplitudes=amplitudes,
            parameters=scene.parameters,
            first=self.rows.start,
            whole_contact=rows.matrix,
            law=law,
            group=self.group,
        )

    def conditions(
        self,
        rows: ContactRows,
        pairs: np.ndarray,
        opened: np.ndarray,
        eliminated: DependentDofs,
        amplitudes: Amplitudes,
    ) -> tuple[ContactRows, np.ndarray, np.ndarray, ContactLaw, Shares | None]:
        """Rows, pairs, gaps, law and shares of the conditions with unknowns.

        Args:
            rows: rows of all pairs.
            pairs: contact pair of each row, (m,).
            opened: part of the gaps that openings and moving obstacles add, (m, 1 + T).
            eliminated: dependent dofs of the scene.
            amplitudes: amplitudes of the terms.
        """
        scene = self.scene
        prolongation = eliminated.prolongation
        lifts = prolongation.lifts
        rows, pairs, opened = eliminated.joined(prolongation, rows, pairs, opened)
        gaps = _gaps(rows, opened, lifts)
        acting = replace(rows, matrix=prolongation.rows(rows.matrix))
        unknown = conditions_with_unknowns(scene, acting, gaps, amplitudes, prolongation.free)
        both = np.hstack([gaps, opened])[unknown]
        rows, pairs, both = eliminated.merged(
            prolongation, rows.take(unknown), pairs[unknown], both
        )
        gaps, opened = np.hsplit(both, 2)
        shares = None
        common = _nodes_of_several(prolongation.rows(rows.matrix), pairs, rows.points.shape[1])
        if common.size:
            request = (
                f"scene '{scene.name}', whose contacts share the node at "
                f"{rounded(self._points()[common[0]])},"
            )
            share = registry.tool("shared_nodes", request)
            rows, pairs, opened, shares = share(
                self, (rows, pairs, opened), prolongation, amplitudes, common
            )
            if shares is not None:
                gaps = _gaps(rows, opened, lifts)
        law: ContactLaw = UNILATERAL
        if laws := {index: law for index, law in enumerate(scene.laws) if law is not None}:
            rows, pairs, law = self._with_laws(laws, rows, pairs, prolongation)
            shares = None if shares is None else shares.extended(rows.slaves, pairs, len(gaps))
            gaps = np.vstack([gaps, -(rows.matrix[len(gaps) :] @ lifts).toarray()])
        return rows, pairs, gaps, law, shares

    def _eliminated(self, free: np.ndarray, imposed: list[Term]) -> DependentDofs:
        """Dependent dofs of the constraints.

        ``free`` ones are not imposed, (N,), and the lifts of others are.
        """
        if not self.scene.constraints:
            return DependentDofs(Prolongation.of_free(free))
        eliminate = registry.tool(
            "constraints", f"scene '{self.scene.name}', which has constraints,"
        )
        eliminated: DependentDofs = eliminate(
            self.scene, self.assembler, self._cell_nodes(), free, imposed
        )
        return eliminated

    def _node_mass(self) -> csr_matrix:
        """Local rows of the Gram matrix of the L2 product of one component, (own nodes, nodes)."""
        mass = fem_petsc.assemble_matrix(self._mass_form)
        mass.assemble()
        dim = self.mesh.geometry.dim
        return csr_matrix(self.own_rows(mass)[::dim][:, ::dim])

    def _with_laws(
        self,
        laws: dict[int, PairLaw],
        rows: ContactRows,
        pairs: np.ndarray,
        prolongation: Prolongation,
    ) -> tuple[ContactRows, np.ndarray, ContactLaw]:
        """Append the rows of laws by pair to the conditions.

        Return all rows, the pair of each, and the law on them.
        """
        scene = self.scene
        of_plugins: dict[str, dict[int, PairLaw]] = {}
        for index, law in laws.items():
            of_plugins.setdefault(law.plugin, {})[index] = law
        attached = [
            self._attached(laws_of_plugin, rows, pairs, prolongation)
            for laws_of_plugin in of_plugins.values()
        ]
        join = registry.tool(
            "laws", f"scene '{scene.name}', whose contacts have {laws[min(laws)].words},"
        )
        conditions: tuple[ContactRows, np.ndarray, ContactLaw] = join(
            scene, list(of_plugins.values()), attached, rows, pairs
        )
        return conditions

    def _attached(
        self,
        laws: dict[int, PairLaw],
        rows: ContactRows,
        pairs: np.ndarray,
        prolongation: Prolongation,
    ) -> tuple[ContactRows, np.ndarray, ContactLaw]:
        """Conditions with the rows of the laws of one plug-in."""
        scene = self.scene
        first, *further = laws.values()
        if any(
            getattr(law.attached, "__func__", None) is not getattr(first.attached, "__func__", None)
            for law in further
        ):
            raise SceneError(
                f"contacts of scene '{scene.name}' have laws of several classes, each with its "
                "attached(): that is not built in. Give them a common one, which reads them all"
            )
        mesh = MeshArrays(self._points(), self._cell_nodes(), self.order)
        attached = first.attached(
            laws, scene, rows, pairs, prolongation.movable, prolongation.lifts, mesh
        )
        check_attached(first, attached[2])
        if not np.array_equal(attached[1][: pairs.size], pairs):
            raise SceneError(
                f"attached() of {type(first).__name__} must append rows to the conditions, and "
                "keep these"
            )
        return attached

    def load_terms(self) -> list[Term]:
        """Terms of all loads on the current mesh."""
        return [
            term for load in self.scene.loads for term in checked_terms(load, self.assembler(load))
        ]

    def checked(
        self, problem: ContactProblem, stated: StatedSystem | None = None
    ) -> ContactProblem:
        """The problem with the kernel of K of a system.

        Checks for errors that only the whole scene shows.

        Args:
            problem: the contact problem.
            stated: user-defined system; None for that of the bodies.
        """
        free = self.free_bodies(problem)
        free = (stated or self.shape).left_free(free, problem)
        if free:
            request = (
                f"{free[0].name} can move freely: it {free[0].described(free[0].left)}. To hold "
                "it by contact alone"
            )
            kernels: Kernels = registry.tool("kernel", request)
            kernel = kernels.of(self.scene, problem, free)
            problem = replace(problem, kernel=kernel, law=kernel.law)
        warn_of_idle_parameters(self.scene, problem.amplitudes)
        return self.shape.attached(problem)

    def stated(self, stiffness: tuple[csr_matrix, ...]) -> StatedSystem:
        """The system of local rows of the parts of K of all dofs, (own dofs, N): that of bodies, or
        of a user.
        """
        if self.scene.system is None:
            return self.shape
        made = registry.tool(
            "systems", f"scene '{self.scene.name}', which has a user-defined system,"
        )
        found: StatedSystem = made(self.scene, stiffness, self.springs)
        return found

    def free_bodies(self, problem: ContactProblem) -> list[FreeBody]:
        """Bodies with rigid motions that imposed displacements, constraints and springs leave.

        Collective.
        """
        return free_bodies(self.scene, problem, self.group.joined(self.cell_bodies()), self.springs)

    def answer_mesh(self, problem: ContactProblem) -> AnswerMesh:
        """Mesh of the answers, see :func:`~hhr_dolfinx.full_order.answer_mesh.answer_mesh_of`."""
        return answer_mesh_of(self, problem)

    def stress(self, displacement: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Stress of a displacement, see :meth:`~ConstantElasticity.stress_in_cells`.

        Args:
            displacement: the displacement, (N,).
            point: parameters, (P,).
        """
        with self.shape.at(point):
            return self.elasticity.stress_in_cells(self, displacement, point)

    @cached_property
    def free_dofs(self) -> np.ndarray:
        """See :class:`DiscreteSpace`."""
        return self._displacements()[1]

    def _displacements(self) -> tuple[list[Term], np.ndarray]:
        """Lifts of nonzero displacements, and the dofs that are not imposed, (N,)."""
        terms = []
        owner = np.full(self.size, -1)
        for number, displacement in enumerate(self.scene.displacements):
            dofs = self._tagged_dofs(displacement.tag, displacement.component)
            clash = dofs[owner[dofs] >= 0]
            for before in set(owner[clash].tolist()):
                self._check_clash(number, before, clash[owner[clash] == before])
            dofs = np.setdiff1d(dofs, clash)
            owner[dofs] = number
            amplitude = bound(displacement.amplitude, self.scene.parameters)
            if amplitude != Amplitude():
                entries = self._imposed(number, dofs), (dofs, np.zeros_like(dofs))
                terms.append(Term(amplitude, csc_matrix(entries, shape=(self.size, 1))))
        return terms, owner < 0

    def _imposed(self, number: int, dofs: np.ndarray) -> np.ndarray:
        """Imposed values of a displacement, by its index in the scene, on dofs for the amplitude
        1.
        """
        if number not in self._fields:
            return np.ones(dofs.size)
        return self._fields[number][dofs // self.mesh.geometry.dim]

    def _check_clash(self, number: int, other: int, dofs: np.ndarray) -> None:
        """Raise SceneError if two displacements, by their indices in the scene, differ on dofs of
        both.
        """
        later, before = (self.scene.displacements[index] for index in (number, other))
        same = np.array_equal(self._imposed(number, dofs), self._imposed(other, dofs))
        if before.amplitude != later.amplitude or not same:
            node, component = divmod(int(dofs[0]), self.mesh.geometry.dim)
            raise SceneError(
                f"displacements {other} on tag {before.tag} and {number} on tag {later.tag} impose "
                f"different values on one node, of component {component} at "
                f"{rounded(self._points()[node])}: leave one of them out, or give surfaces that "
                "no node has in common"
            )

    def assembler(self, load: Load | Output) -> Assembler:
        """Interface for a load or an output."""
        return Assembler(
            test=self._test,
            hypothesis=self.scene.hypothesis,
            parameters=self.scene.parameters,
            size=self.size,
            ds=partial(self._outer_facets, type(load).__name__),
            dx=self._cells,
            vector=partial(self._load_vector, load),
            surface=self.surface,
            nodes=partial(self.nodes, whole=False),
            points=self._points,
            cells=self._cell_nodes,
            eigenstress=partial(self._eigenstress, load),
        )

    def _eigenstress(
        self, load: Load | Output, tag: Tag, strain: Expr
    ) -> list[tuple[Formula, np.ndarray]]:
        return self.elasticity.eigenstress(self, tag, strain, partial(self._load_vector, load))

    def contact_rows(self) -> tuple[ContactRows, np.ndarray]:
        """Rows of all pairs on the current mesh, and the pair of each."""
        return self._contacts()[:2]

    def _contacts(self) -> tuple[ContactRows, np.ndarray, list[Term]]:
        """Rows of all pairs, the pair of each row, and terms of openings and pairings, which add to
        gaps, with columns (N_lambda, k).
        """
        rows_of_pairs = []
        opened: list[tuple[int, Term]] = []
        for index, pairing in enumerate(self.scene.contacts):
            surfaces = [self.surface(tag) for tag in pairing.tags]
            if (quadratic := surfaces[0].quadratic) is not None:
                quadratic.warn_of_straight_sides(surfaces)
            rows = pairing.rows(surfaces, self.size)
            if not isinstance(rows, ContactRows):
                raise SceneError(f"the rows of {pairing!r} must be ContactRows, and are {rows!r}")
            if rows.gap.size == 0 or rows.matrix.shape[1] != self.size:
                raise SceneError(
                    f"{pairing} made {rows.gap.size} conditions on {rows.matrix.shape[1]} of "
                    f"{self.size} dofs"
                )
            changes = pairing.gap_terms(surfaces, rows) if hasattr(pairing, "gap_terms") else []
            self.shape.check_still(f"contact {index}", surfaces[0].nodes, changes)
            opened += [(index, term) for term in changes]
            if self.scene.overwritten(index):
                if changes:
                    raise SceneError(
                        f"an opening overwrites the gaps of contact {index}, which moves by a "
                        "formula"
                    )
                rows = replace(rows, gap=np.zeros(rows.gap.size))
            rows_of_pairs.append(rows)
        pairs = np.repeat(np.arange(len(rows_of_pairs)), [rows.gap.size for rows in rows_of_pairs])
        unit_columns = csc_matrix(identity(pairs.size))
        terms = [
            Term(pairing.amplitude, (pairs == pairing.contact)[:, None].astype(float))
            for pairing in self.scene.openings
        ]
        terms += [
            replace(term, columns=unit_columns[:, pairs == index] @ term.columns)
            for index, term in opened
        ]
        return joined(rows_of_pairs), pairs, terms


ChangedClass = Callable[[type[Discretisation]], type[Discretisation]]
"""Makes the class of a finite element model from that of its scene."""


def as_it_is(made: type[Discretisation]) -> type[Discretisation]:
    """The class itself."""
    return made


def discretised(
    scene: Scene,
    comm: MPI.Comm = MPI.COMM_WORLD,
    kind: ChangedClass = as_it_is,
) -> Discretisation:
    """Discretisation of a scene, by the class that its system states if that has its own matrices.

    Args:
        scene: the scene.
        comm: processes of the model.
        kind: changes the class of the model.

    Raises:
        NotOfferedError, SceneError: see :class:`Discretisation`.
    """
    return kind(getattr(scene.system, "discretised", Discretisation))(scene, comm)


def _gaps(rows: ContactRows, opened: np.ndarray, lifts: csc_matrix) -> np.ndarray:
    """D - B lift by term, (m, 1 + T), with gaps that openings add."""
    gaps = opened - (rows.matrix @ lifts).toarray()
    gaps[:, 0] += rows.gap
    return gaps


def _nodes_of_several(acting: csr_matrix, pairs: np.ndarray, dimension: int) -> np.ndarray:
    """Nodes on which conditions of several contacts act along one line, by the rows of B T, (m, N),
    and their contacts.

    These conditions may say the same; those along other lines, as in a corner, do not.
    """
    entries = acting.tocoo()
    nodes, component = np.divmod(entries.col, dimension)
    several = csr_matrix((np.ones(entries.nnz), (pairs[entries.row], nodes))).getnnz(axis=0) > 1
    shared = []
    for node in np.flatnonzero(several):
        at_node = nodes == node
        rows, row_index = np.unique(entries.row[at_node], return_inverse=True)
        ways = np.zeros((rows.size, dimension))
        ways[row_index, component[at_node]] = entries.data[at_node]
        apart = pairs[rows][:, None] != pairs[rows]
        if (np.abs(normalised(ways) @ normalised(ways).T) > ONE_LINE)[apart].any():
            shared.append(node)
    return np.array(shared, dtype=int)


def _without_columns(matrix: csr_matrix, columns: np.ndarray) -> csr_matrix:
    """Copy of a sparse matrix with some columns set to zero."""
    entries = matrix.tocoo()
    keep = ~columns[entries.col]
    return csr_matrix(
        (entries.data[keep], (entries.row[keep], entries.col[keep])), shape=matrix.shape
    )
