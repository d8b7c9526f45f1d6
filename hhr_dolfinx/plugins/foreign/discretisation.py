"""Matrices and contact conditions of a scene whose K other codes have written: no mesh, no
forms.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NoReturn, cast

import numpy as np
from mpi4py import MPI
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx import registry
from hhr_dolfinx.amplitudes import bound
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.contact.rows import ContactRows
from hhr_dolfinx.errors import NotOfferedError, SceneError
from hhr_dolfinx.formulas import Modulus
from hhr_dolfinx.full_order.discrete_space import DiscreteSpace
from hhr_dolfinx.full_order.discretisation import Discretisation
from hhr_dolfinx.full_order.elasticity import ConstantElasticity
from hhr_dolfinx.full_order.free_bodies import FreeBody, components_of_nodes, vanishing
from hhr_dolfinx.full_order.still import StillMesh
from hhr_dolfinx.group import group_of, share
from hhr_dolfinx.loads import Assembler, Load, Term, checked_terms
from hhr_dolfinx.models.answer_mesh import AnswerMesh
from hhr_dolfinx.parameters import Place, Tag
from hhr_dolfinx.plugins.elasticity.parts import with_springs
from hhr_dolfinx.plugins.foreign.later import ComparedByFactors, same_supports
from hhr_dolfinx.plugins.foreign.loads import vector_of
from hhr_dolfinx.plugins.foreign.outputs import UncheckedStiffness
from hhr_dolfinx.plugins.foreign.parts import Blocks, Parts, node_mass
from hhr_dolfinx.scene import Scene

if TYPE_CHECKING:
    import ufl

    from hhr_dolfinx.full_order.system import StatedSystem
    from hhr_dolfinx.outputs import Output

ROUND_OFF = 1e-12
"""Part of the largest coefficient up to which that of a dof that K lacks is round-off."""
DIGITS = 1e-8
"""Part of the sum of all terms of the energy of a motion up to which it comes from the digits of a
file.
"""
MESHED = (
    "mesh",
    "space",
    "names",
    "_cell_tags",
    "_facet_tags",
    "_sets",
    "_dx",
    "_ds",
    "_test",
    "_trial",
)
"""Attributes of a discretisation that need a mesh of DOLFINx."""
VTK_TRIANGLE = 5
VTK_POINT = 1
"""VTK's numbers of triangles and of points."""


class OfBlocks(ConstantElasticity):
    """Elasticity of blocks: K is given, and lifts stay on imposed dofs; springs are a plug-in's."""

    def springs(self, space: DiscreteSpace) -> np.ndarray | None:
        """Stiffness to ground of each dof, (N,), by loads that resist; None without."""
        if not any(hasattr(load, "stiffness") for load in space.scene.loads):
            return None
        elasticity: ConstantElasticity = registry.tool("elasticity", f"scene '{space.scene.name}'")(
            space.scene, *space.cells_and_order
        )
        return elasticity.springs(space)


class ForeignDiscretisation(Discretisation):
    """Matrices and contact conditions of a scene whose system is a ``ForeignStiffness``.

    Nodes have three dofs each: displacements, rotations as those of further nodes, and dofs of the
    other code alone. Cells are pairs of nodes that K couples. The L2
    product of fields is the mean over nodes.

    Raises:
        SceneError: for files, cases, names, or conditions on dofs that K lacks.
    """

    def __init__(self, scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD):
        system = cast("Blocks", scene.system)
        self.scene = scene
        self.group = group_of(comm)
        _check(scene, system)
        with self.group.together(f"the blocks of scene '{scene.name}'"):
            self.parts = Parts(system.blocks)
            if self.group.size > 1:
                self.parts.compare()
            count = len(self.parts.points)
        self.order = 1
        self.size = 3 * count
        # equal shares of the nodes
        nodes = share(count, self.group.number, self.group.size)
        self.rows = slice(3 * nodes.start, 3 * nodes.stop)
        self._own_nodes = nodes
        self.shape = StillMesh()
        self._compared_later = False
        self.elasticity = OfBlocks(scene, *self.cells_and_order)
        self.mean_dilatation = tuple(False for _ in scene.bodies)
        self._fields = {
            number: displacement.at(self.parts.points, scene.hypothesis)
            for number, displacement in enumerate(scene.displacements)
            if displacement.field is not None
        }

    has_mesh = False

    def __getattr__(self, name: str) -> Any:
        """Refuse what needs a mesh of DOLFINx, such as stresses of elements."""
        if name in MESHED:
            raise NotOfferedError(
                f"strains, integrals and cells of scene '{self.scene.name}' are not known: its K "
                "comes from "
                "another code, which has the elements. Leave out what needs them, or solve there"
            )
        raise AttributeError(f"a {type(self).__name__} has no {name!r}")

    @property
    def cells_and_order(self) -> tuple[str, int]:
        """Kind of cells for settings of elasticity, which has no form here."""
        return "hexahedron", 1

    def stiffness_terms(self) -> tuple[tuple[csr_matrix, ...], tuple[Modulus, ...]]:
        """Local rows of the K of each block, and their factors; one K and no factor if none varies;
        springs last.
        """
        names = self.scene.parameters.names
        blocks = self.parts.blocks
        moduli = tuple(Modulus(block.formula, "1", names) for block in blocks)
        terms = tuple(csr_matrix(term[self.rows]) for term in self.parts.matrices)
        if not any(block.variables for block in blocks):
            middle = self.scene.parameters.middle
            first = terms[0]
            pairs = zip(moduli, terms, strict=True)
            data = sum(
                modulus.value(middle) * term.data for modulus, term in pairs
            )  # zeros keep places
            terms = (csr_matrix((data, first.indices, first.indptr), first.shape),)
            moduli = ()
        if (springs := self.springs) is None:
            return terms, moduli
        return with_springs(names, springs, terms, moduli, self.rows.start)

    def contact_problem(
        self, stiffness: tuple[csr_matrix, ...], moduli: tuple[Modulus, ...] = ()
    ) -> ContactProblem:
        """See :class:`Discretisation`; conditions and loads on dofs that K lacks are refused.

        Solved cases are compared before, unless a full model calls :meth:`stated`.

        Args:
            stiffness: terms of K, (N, N) each.
            moduli: factor of each term at a point.
        """
        if not self._compared_later:
            self.parts.compare()
        problem = super().contact_problem(stiffness, moduli)
        rows = problem.whole_contact
        assert rows is not None
        self._check_known(abs(rows).max(axis=0).toarray().ravel(), "contact")
        self._check_known(abs(problem.forces).max(axis=1).toarray().ravel(), "a load")
        return problem

    def _contacts(self) -> tuple[ContactRows, np.ndarray, list[Term]]:
        """Rows of all pairs, before those without a free dof are left out."""
        rows, pairs, terms = super()._contacts()
        self._check_known(abs(rows.matrix).max(axis=0).toarray().ravel(), "contact")
        return rows, pairs, terms

    def _check_known(self, sizes: np.ndarray, what: str) -> None:
        """Raise SceneError where dofs that K lacks, and that no displacement holds, have a
        coefficient, (N,).
        """
        free = super()._displacements()[1]
        lost = np.flatnonzero(
            (sizes > ROUND_OFF * sizes.max(initial=0.0)) & free & ~self.parts.known
        )
        if lost.size:
            raise SceneError(
                f"{what} of scene '{self.scene.name}' acts on {lost.size} dofs that K does not "
                "have, first "
                f"{self.parts.described(lost[0])}: the run that wrote K holds it, makes it "
                "dependent (MPC, *TIE, "
                "coupling), or did not retain it. If it is held at zero there, say so by a "
                "Displacement; else write K "
                "without that constraint, or retain the dof"
            )

    def stated(self, stiffness: tuple[csr_matrix, ...]) -> StatedSystem:
        """The system of the parts as they are: blocks keep their factors if only whole ones
        vary.

        A full model factors K anyway: where the scene holds what the solved cases hold, these are
        compared by its factors.
        """
        alone = self.group.size == 1 and self.springs is None
        self._compared_later = alone and same_supports(self.parts, self.free_dofs)
        if not self._compared_later:
            return self.shape
        names = self.scene.parameters.names
        middle = self.scene.parameters.middle
        factors = [Modulus(block.formula, "1", names).value(middle) for block in self.parts.blocks]
        return ComparedByFactors(self.parts, factors)

    def free_bodies(self, problem: ContactProblem) -> list[FreeBody]:
        """Connected parts of K with the rigid motions along which it does no work, and that
        supports and constraints leave.

        Of dofs that K lacks only K says whether they are held (a support) or not (a dof that is not
        retained).
        """
        fixed = ~problem.prolongation.movable & self.parts.known
        if self.springs is not None:
            fixed |= self.springs != 0
        components = list(self._components(problem))
        if problem.prolongation.map is None:
            bodies = [
                replace(body, left=vanishing(body.motions[:, fixed.reshape(-1, 3)[body.nodes]].T))
                for body in components
            ]
        else:
            request = f"scene '{self.scene.name}', whose blocks constraints join,"
            # dofs of K need not be displacements of places, so motions are those of each block
            bodies = registry.tool("joined_bodies", request)(
                components, problem.prolongation, problem.points, fixed.reshape(-1, 3), None
            )
        bodies = [replace(body, left=self._unresisted(body)) for body in bodies]
        return [body for body in bodies if len(body.left)]

    def _components(self, problem: ContactProblem) -> Iterator[FreeBody]:
        """Connected parts of K, with all of their rigid motions."""
        parts = self.parts
        label = components_of_nodes(len(problem.points), problem.cell_nodes)
        motions = np.hstack([placed.motions for placed in parts.made]).reshape(6, -1, 3)
        known_dofs = parts.known.reshape(-1, 3)
        for number in np.unique(label[known_dofs.any(axis=1)]):
            nodes = np.flatnonzero(label == number)
            points = problem.points[np.intersect1d(nodes, parts.with_places)]
            if not len(points):
                continue
            about_middle = _about_middle(motions[:, nodes], points)
            block = parts.blocks[int(parts.block_of(nodes[:1])[0])]
            where = np.round(points.mean(axis=0), 6).tolist()
            name = f"block '{block.name}' of scene '{self.scene.name}', around {where},"
            yield FreeBody(name, nodes, about_middle * known_dofs[nodes], np.eye(6))

    def _unresisted(self, body: FreeBody) -> np.ndarray:
        """Combinations of motions of a body, (l, k), of those left, along which K does no work up
        to its digits.
        """
        ways = body.left
        dofs = (3 * body.nodes[:, None] + np.arange(3)).ravel()
        columns = ways @ body.motions.reshape(len(body.motions), -1)
        stiffness = sum(self.parts.matrices[1:], start=self.parts.matrices[0])[dofs][:, dofs]
        energies = columns @ (stiffness @ columns.T)
        sizes = np.abs(columns) @ (abs(stiffness) @ np.abs(columns).T)
        values, rotated = np.linalg.eigh((energies + energies.T) / 2)
        idle = rotated[:, np.abs(values) <= DIGITS * sizes.max(initial=0.0)].T
        # a K of few directions, such as a membrane's, has no dof along some motions
        turns, lengths, _ = np.linalg.svd(idle @ columns, full_matrices=False)
        moving = lengths > DIGITS * np.linalg.norm(body.motions)
        return turns[:, moving].T @ idle @ ways

    def load_terms(self) -> list[Term]:
        """Terms of all loads."""
        return [term for load in self.scene.loads for term in self._terms(load)]

    def _terms(self, load: Load) -> list[Term]:
        """Terms of a load: of those that know no mesh by the blocks, of others by their own
        method.
        """
        forces = vector_of(load, self.parts)
        if forces is None:
            return checked_terms(load, self.assembler(load))
        amplitude = bound(load.amplitude, self.scene.parameters)  # type: ignore[attr-defined]
        return [Term(amplitude, csc_matrix(forces[:, None]))]

    def assembler(self, load: Load | Output) -> Assembler:
        """Interface for a load or an output; integrals over a mesh are refused."""
        refuse = partial(self._refuse, load)
        return Assembler(
            test=SimpleNamespace(ufl_shape=(3,)),
            hypothesis=self.scene.hypothesis,
            parameters=self.scene.parameters,
            size=self.size,
            ds=refuse,
            dx=refuse,
            vector=refuse,
            surface=self.surface,
            nodes=partial(self.nodes, whole=False),
            points=self._points,
            cells=self._cell_nodes,
            eigenstress=refuse,
        )

    def _refuse(self, load: Load | Output, *given: Tag | ufl.Form) -> NoReturn:
        raise NotOfferedError(
            f"{type(load).__name__} is an integral over a mesh, and the blocks of scene "
            f"'{self.scene.name}' have a K of "
            "another code alone: write its load vector there, and give it as ForeignLoad"
        )

    def surface(self, tag: Tag) -> Any:
        """Surface with a name, or the nodes of a set without facets."""
        return self.parts.surface(tag)

    def nodes(self, tag: Tag | Place, whole: bool = True) -> np.ndarray:
        """Numbers of the nodes of a set, a surface or a place, (k,).

        Args:
            tag: set, surface or place.
            whole: has no effect here.
        """
        return self.parts.nodes(tag)

    def cells_of(self, tag: Tag) -> np.ndarray:
        """Local numbers of the pairs of nodes of a block."""
        number = [body.tag for body in self.scene.bodies].index(tag)
        return np.flatnonzero(self.cell_bodies() == number)

    def check_cells(self, tag: Tag) -> None:
        """Do nothing: each block has nodes."""

    def cell_bodies(self) -> np.ndarray:
        """Block of each pair of nodes of this rank, (cells,)."""
        pairs = self.parts.pairs
        local = share(len(pairs), self.group.number, self.group.size)
        return self.parts.block_of(pairs[local.start : local.stop, 0])

    def stress(self, displacement: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Refuse: K knows no strains.

        Args:
            displacement: displacement of all dofs, (N,).
            point: parameters, (P,).

        Raises:
            NotOfferedError: always.
        """
        raise NotOfferedError(
            f"stresses of scene '{self.scene.name}' are not known: its K comes from another code, "
            "which has the "
            "elements. Write the displacement there"
        )

    def answer_mesh(self, problem: ContactProblem) -> AnswerMesh:
        """Outer faces of the blocks as triangles; nodes where there are none."""
        outer = self.parts.outer
        cells = np.arange(len(problem.points))[:, None] if outer is None else outer.triangles()
        units = self.scene.units
        return AnswerMesh(
            points=problem.points,
            cells=cells,
            kind=VTK_POINT if outer is None else VTK_TRIANGLE,
            bodies=self.parts.block_of(cells[:, 0]),
            contact_points=problem.contact_points,
            slaves=problem.contact_slaves,
            contacts=tuple(
                problem.pressing_of(contact) for contact in range(len(self.scene.contacts))
            ),
            name=self.scene.name,
            axisymmetric=False,
            parameters=tuple(self.scene.parameters.names),
            length="" if units is None else units.length,
            stress="" if units is None else units.stress,
        )

    @property
    def free_dofs(self) -> np.ndarray:
        """Dofs that are not imposed, (N,) bool."""
        return self._displacements()[1]

    def _displacements(self) -> tuple[list[Term], np.ndarray]:
        """See :class:`Discretisation`; dofs that K lacks are not free, and cannot be displaced."""
        terms, free = super()._displacements()
        lost = ~self.parts.known
        for term in terms:
            imposed = csc_matrix(term.columns).tocoo().row
            if lost[imposed].any():
                dof = imposed[lost[imposed]][0]
                raise SceneError(
                    f"a displacement of scene '{self.scene.name}' moves "
                    f"{self.parts.described(dof)}, and K does not "
                    "have this dof: write K without the support there"
                )
        return terms, free & ~lost

    def _tagged_dofs(self, tag: Tag | Place, component: int) -> np.ndarray:
        """Dofs of a component of nodes; 3 to 5 are rotations."""
        nodes = self.nodes(tag)
        if component > 5:
            raise SceneError(
                f"component {component} on {tag} does not exist: 0 to 2 are displacements, 3 to 5 "
                "rotations"
            )
        if component > 2:
            nodes = self.parts.turning(nodes)
            component = component - 3
        return 3 * nodes + component

    def _imposed(self, number: int, dofs: np.ndarray) -> np.ndarray:
        """Imposed values of a displacement on dofs for the amplitude 1."""
        return self._fields[number][dofs // 3] if number in self._fields else np.ones(dofs.size)

    def _points(self) -> np.ndarray:
        return self.parts.points

    def _cell_nodes(self) -> np.ndarray:
        return self.parts.pairs

    def _node_mass(self) -> csr_matrix:
        local = self._own_nodes
        return node_mass(len(self.parts.points))[local.start : local.stop]


def _check(scene: Scene, system: Blocks) -> None:
    """Raise SceneError for bodies that are no blocks, other hypotheses, and blocks without a case
    or a word of it.
    """
    names = tuple(block.name for block in system.blocks)
    if (
        scene.hypothesis != "solid"
        or len(scene.bodies) != len(names)
        or any(body.law for body in scene.bodies)
    ):
        raise SceneError(
            f"scene '{scene.name}' has a foreign stiffness: its hypothesis must be 'solid' and "
            "its bodies "
            f"foreign.bodies, one without a law for each of the blocks {names}; "
            "foreign.scene(name, ...) gives both"
        )
    if system.unchecked and not any(
        isinstance(output, UncheckedStiffness) for output in scene.outputs
    ):
        raise SceneError(
            f"blocks {', '.join(system.unchecked)} of scene '{scene.name}' have no solved case: "
            "each answer must say "
            "so, outputs=(hhr.UncheckedStiffness(), ...)"
        )


def _about_middle(motions: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Rigid motions of nodes, (6, n, 3), with rotations about the middle of points, scaled by their
    size.
    """
    middle = points.mean(axis=0)
    size = float(np.ptp(points, axis=0).max()) or 1.0
    scaled = motions.copy()
    for axis in range(3):
        shift = np.cross(np.eye(3)[axis], middle)
        scaled[3 + axis] = (motions[3 + axis] - np.tensordot(shift, motions[:3], 1)) / size
    return scaled
