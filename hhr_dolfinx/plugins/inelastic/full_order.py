"""Equilibrium of the full mesh for inelastic bodies, thesis Alg. 6.1: Newton or elastic search."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from threading import RLock
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI
from scipy.linalg.blas import daxpy
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx.amplitudes import Theta
from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, Statuses
from hhr_dolfinx.contact.kernel import kernels
from hhr_dolfinx.contact.problem import ContactProblem, Reshaping
from hhr_dolfinx.contact.stiffness import FactorStore, ScaledStiffness, SparseStiffness, Stiffness
from hhr_dolfinx.errors import NotOfferedError, SceneError
from hhr_dolfinx.formulas import Modulus, coordinate_names
from hhr_dolfinx.full_order.discretisation import ChangedClass, Discretisation, as_it_is
from hhr_dolfinx.group import group_of, share
from hhr_dolfinx.linear.rows import rows_of
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.histories.equilibrium import MarchSettings, StressOutput
from hhr_dolfinx.plugins.elasticity.parts import with_springs
from hhr_dolfinx.plugins.inelastic.constants import check_law_over_box
from hhr_dolfinx.plugins.inelastic.equilibrium import Linearisation, MaterialEquilibrium, texts_of
from hhr_dolfinx.plugins.inelastic.gauss_points import (
    at_gauss_points,
    material_at,
    stiffness_parts,
    strain_operator,
)
from hhr_dolfinx.plugins.inelastic.law import Update
from hhr_dolfinx.plugins.inelastic.linearised_step import (
    PATIENCE_IN_SPACE,
    TANGENT_ITERATIONS,
    MeshEquilibrium,
)
from hhr_dolfinx.plugins.inelastic.outputs import (
    FlowEnergy,
    FlowMises,
    check_elasticity,
    energy,
    mises,
)
from hhr_dolfinx.plugins.inelastic.points_of_ranks import PointsOfRanks
from hhr_dolfinx.plugins.inelastic.state import GaussState
from hhr_dolfinx.plugins.inelastic.state import state as gauss_of
from hhr_dolfinx.plugins.inelastic.strain import ElasticPart, SparsePattern, StrainOperator
from hhr_dolfinx.plugins.inelastic.trained import Signs
from hhr_dolfinx.plugins.inelastic.update import Material
from hhr_dolfinx.scene import Scene

if TYPE_CHECKING:
    from hhr_dolfinx.models.full import FullModel
    from hhr_dolfinx.outputs import NamedOutput


@dataclass(frozen=True)
class GaussModel:
    """Gauss points and laws of a whole mesh."""

    discretisation: LawsOnMesh  #: mesh and forms
    operator: StrainOperator  #: strain at all Gauss points
    material: Material  #: laws at all Gauss points
    bodies: np.ndarray  #: body of each cell as its index in the scene, (cells,)
    pattern: SparsePattern  #: sparsity of the stiffness
    stiffness: tuple[
        csr_matrix, ...
    ]  #: parts of the elastic stiffness by the same Gauss points, (N, N) each
    moduli: tuple[
        Modulus, ...
    ]  #: their amplitudes; empty if elasticity is constant, with a single part

    @property
    def places(self) -> int:
        """Number of Gauss points."""
        return self.operator.gauss_points

    def mises(self, output: StressOutput, cells: np.ndarray) -> FlowMises:
        """Von Mises' stress of an output in some cells."""
        return mises(self.operator, output, cells)

    def energy(self, output: NamedOutput) -> FlowEnergy:
        """Elastic energy of an output; SceneError for a law that changes the elasticity of its
        body.
        """
        # in plane stress a law at rest depends on strains across, and may flow there as if they
        # were none
        material = material_at(self.discretisation, self.bodies, self.operator, flat=False)
        check_elasticity(material, self.discretisation.scene.parameters, output)
        return energy(self.operator, self.material, output)

    def equilibrium(self, full: FullModel) -> FullOrderEquilibrium:
        """Equilibrium of a full model."""
        return FullOrderEquilibrium(full, self)


class LawsOnMesh(Discretisation):
    """Discretisation of bodies with laws, whose stiffness is that of their Gauss points at rest."""

    def laws(self) -> GaussModel:
        """See :class:`~hhr_dolfinx.full_order.discrete_space.DiscreteSpace`."""
        operator = strain_operator(self)
        bodies = self.cell_bodies()
        material = material_at(self, bodies, operator)
        pattern = operator.pattern()
        terms = stiffness_parts(material, operator, pattern)
        if self.springs is not None:
            terms = with_springs(self.scene.parameters.names, self.springs, *terms)
        return GaussModel(self, operator, material, bodies, pattern, *terms)

    def stiffness_terms(self) -> tuple[tuple[csr_matrix, ...], tuple[Modulus, ...]]:
        """See :class:`Discretisation`."""
        model = self.laws()
        return model.stiffness, model.moduli


class LazyStiffness(SparseStiffness):
    """Stiffness whose columns of K^-1 B^T and S are solved for when their conditions first become
    active: tangents.
    """

    @cached_property
    def equalities(self) -> SchurEqualities:
        """See :class:`Stiffness`."""
        self._known: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        return SchurEqualities(self._images, self.contact.shape[0])

    def _images(self, index: np.ndarray) -> np.ndarray:
        """Columns of S as rows, (k, m)."""
        new = [k for k in index.tolist() if k not in self._known]
        if new:
            columns = self.columns(self.contact[new].T)
            images = self.contact @ columns
            for row, k in enumerate(new):
                self._known[k] = columns[:, row], images[:, row]
        return np.array([self._known[k][1] for k in index.tolist()]).reshape(
            index.size, self.contact.shape[0]
        )

    def response_to_forces(self, forces: np.ndarray) -> np.ndarray:
        """K^-1 B^T times forces on conditions that have been active, (m,): (n,)."""
        response = np.zeros(self.contact.shape[1])
        for k in np.flatnonzero(forces).tolist():
            response += forces[k] * self._known[k][0]
        return response


class FullOrderEquilibrium(MeshEquilibrium):
    """Equilibrium of U0, with the elastic factors of a full model.

    Each of several ranks has all dofs of vectors, and all Gauss points except in objects made by
    :meth:`on_ranks`.
    """

    problem: ContactProblem
    symmetric = True

    def __init__(self, full: FullModel, gauss: GaussModel):
        super().__init__()
        problem = full.problem
        self.fields = self._full = full
        self._discretisation = gauss.discretisation
        self.shape = problem.reshaped
        if self.shape is not None and (full.comm.size > 1 or problem.kernel is not None):
            raise SceneError(
                f"the shape of scene '{full.scene.name}' depends on parameters, and bodies flow: "
                "build its model on one rank, and hold all bodies by displacements"
            )
        self.springs = (
            gauss.discretisation.springs
        )  # stiffness to ground of each dof, (N,); None without
        self._lay(gauss, problem)
        self.places = gauss.places
        self.mises = gauss.mises
        self.energy = gauss.energy
        self.amplitudes = problem.amplitudes
        self.parameters = problem.parameters
        self.lifts = problem.lifts
        self.size = problem.free.size
        self.conditions = problem.contact.shape[0]
        self.law = problem.law
        self.points = np.arange(self.operator.gauss_points)
        self.per_cell = self.operator.per_cell
        self.patience = PATIENCE_IN_SPACE if problem.block_size == 3 else TANGENT_ITERATIONS
        self._pairs = Pairs.of(problem.contact_pairs)
        # made for factoring, while that of the elastic stiffness is made for solving: on one core,
        # in the plane at 13,700 dofs, nd takes 31 ms to factor and 1.1 ms to solve, qmd 53 and 1.4
        # ms
        self._tangent_factors = self._no_tangents()
        # two paths must not factor alternately; results are correct without it
        self.lock = RLock()
        self._body = np.zeros(self.size, dtype=int)
        self._body[self.operator.dofs] = gauss.bodies[:, None]
        self._ranks: PointsOfRanks | None = None
        self._rows = problem.spread
        self._spread: FullOrderEquilibrium | None = None
        shaped = (
            ()
            if self.shape is None
            else tuple(problem.parameters.names[axis] for axis in self.shape.axes)
        )
        self.moduli = texts_of(gauss.moduli) + shaped
        self._set_middle(gauss.material)

    def _lay(self, gauss: GaussModel, problem: ContactProblem) -> None:
        """Set what depends on the shape of the bodies but the elasticity."""
        self.problem = problem
        # with K of all dofs, as if none depended on others
        independent = replace(problem.prolongation, map=None)
        self._meshed = replace(problem, stiffness_terms=gauss.stiffness, prolongation=independent)
        self.operator = gauss.operator
        self._pattern = gauss.pattern
        self._transposed = problem.contact.T.tocsr()
        strains = self.operator.gauss_points * self.operator.components
        self.eigenstrains = csc_matrix((strains, problem.amplitudes.firsts[-1]))
        if any(hasattr(load, "eigenstrain_of") for load in self._discretisation.scene.loads):
            self.eigenstrains = at_gauss_points(self._discretisation, self.operator)

    def _reshape(self, shape: Reshaping, point: np.ndarray) -> None:
        """Set all that the shape at a point, (P,), changes but the stiffness."""
        problem = shape(point)
        with shape.at(point):
            gauss = self._discretisation.laws()
            self._lay(gauss, problem)
        self.material = gauss.material.moduli_at(point)

    def _set_middle(self, material: Material) -> None:
        """Set the elasticity of the middle of the box; the material keeps its formulas."""
        full = self._full
        self.material = material.moduli_at(self.problem.middle)
        self._set_stiffness(self._meshed.own_stiffness)
        self.elastic = self._linearisation(
            full.stiffness, self._response_to_forces, self._unchanged.tangents
        )
        self.material = material

    def _no_tangents(self) -> FactorStore:
        """Empty store of the factors of one tangent."""
        return FactorStore(lambda matrix: self._full.factors_of(matrix, "nd"))

    def alongside(self) -> FullOrderEquilibrium:
        """See :class:`MaterialEquilibrium`; with separate factors, so that both histories
        keep their frozen tangents.
        """
        equilibrium = copy(self)
        equilibrium._tangent_factors = self._no_tangents()
        return equilibrium

    def stress(self, answer: Answer) -> np.ndarray:
        """Stress of an answer at all Gauss points, (Gauss points, components)."""
        return gauss_of(answer).stress.copy()

    def plastic_strain(self, answer: Answer) -> np.ndarray:
        """Cumulated plastic strain of an answer at all Gauss points."""
        return gauss_of(answer).state.cumulated.copy()

    def _marching(self, settings: MarchSettings) -> FullOrderEquilibrium:
        """Ranks share the Gauss points, but for derivatives.

        NotOfferedError for derivatives along shapes.
        """
        if settings.gradient and self.shape is not None:
            raise NotOfferedError(
                "derivatives of histories along shapes are not built in, since strains change "
                "with them: take differences of answers"
            )
        return self if settings.gradient else self.on_ranks(self._full.comm)

    def on_ranks(self, comm: MPI.Comm) -> FullOrderEquilibrium:
        """Equilibrium with some of the Gauss points on each rank, for collective paths.

        Itself on one rank.
        """
        cells = len(self.operator.weights)
        if comm.size == 1 or cells < comm.size:
            return self
        if self._spread is None:
            self._spread = self._sharing(PointsOfRanks(cells, self.per_cell, comm))
            mine = share(self.size, comm.rank, comm.size)
            self._spread._rows = rows_of(slice(mine.start, mine.stop), self.size, group_of(comm))
        return self._spread

    def _sharing(self, points: PointsOfRanks) -> FullOrderEquilibrium:
        """Equilibrium with the Gauss points of some cells."""
        equilibrium = copy(self)
        MaterialEquilibrium.__init__(equilibrium)
        operator = self.operator
        arrays = {
            name: getattr(operator, name)[points.cells] for name in ("gradients", "weights", "dofs")
        }
        equilibrium.operator = replace(operator, **arrays)
        equilibrium.together = points
        equilibrium._ranks = points
        equilibrium._pattern = replace(self._pattern, position=self._pattern.position[points.cells])
        components = operator.components
        rows = slice(points.points.start * components, points.points.stop * components)
        equilibrium.eigenstrains = csc_matrix(self.eigenstrains.tocsr()[rows])
        numbers = np.arange(points.points.start, points.points.stop)
        equilibrium._set_middle(self.material.restricted(numbers, empty=True))
        return equilibrium

    def _weights(self, point: np.ndarray) -> np.ndarray:
        weights = self.problem.weights(point)
        return weights if self.shape is None else np.append(weights, point[list(self.shape.axes)])

    def _set_elasticity(self, weights: np.ndarray, point: np.ndarray) -> None:
        """Set K at a point, and all that depends on the shape there.

        If its parts have separate dofs, nothing is factored: K^-1 and K^-1 B^T are those of the
        middle, row by row divided by the modulus. Otherwise columns of K^-1 B^T are solved for as
        conditions become active.
        """
        full = self._full
        if self.shape is not None:
            self._reshape(self.shape, point)
            weights = self.problem.weights(point)
        self._set_stiffness(self._meshed.stiffness_of(weights))
        tangents = self._unchanged.tangents
        if full.system.bodies is None:
            self.elastic = self._lazy(self.problem.stiffness_of(weights), full.store, tangents)
            return
        scaled = full.system.stiffness(point)
        assert isinstance(scaled, ScaledStiffness)
        moduli = scaled.own
        self.elastic = self._linearisation(
            scaled, lambda forces: self._response_to_forces(forces) / moduli, tangents
        )

    def _set_stiffness(self, stiffness: csr_matrix) -> None:
        """Set the elastic stiffness of the material, whose moduli are numbers."""
        self._unchanged: ElasticPart = ElasticPart(self.material.elastic, stiffness.data.copy())
        self._sizes = abs(stiffness)

    def _lazy(self, matrix: csr_matrix, store: FactorStore, moduli: np.ndarray) -> Linearisation:
        """The linearisation of a matrix whose columns of K^-1 B^T are solved for when conditions
        become active.
        """
        lazy = LazyStiffness(matrix, self.problem, store)
        return self._linearisation(lazy, lazy.response_to_forces, moduli)

    def _linearisation(
        self, stiffness: Stiffness, push: Callable[[np.ndarray], np.ndarray], moduli: np.ndarray
    ) -> Linearisation:
        problem = self.problem
        arrays = problem.contact, problem.gaps, self._pairs, moduli
        equalities = stiffness.equalities
        motions = None
        if problem.kernel is not None and problem.held_by_contact:
            motions = kernels().linearised(
                equalities, problem.kernel.contact_of_motions, problem.kernel.motions
            )
        return Linearisation(*arrays, stiffness.solve, push, equalities, stiffness.held, motions)

    def _response_to_forces(self, forces: np.ndarray) -> np.ndarray:
        """K^-1 B^T λ in the middle of the box, by the columns of loaded conditions: few of a
        contact in space.

        Added one by one: a copy of hundreds of them takes longer.
        """
        columns = self._rows.of(self._full.per_force)
        response = np.zeros(len(columns))
        for k in np.flatnonzero(forces).tolist():
            response = daxpy(columns[:, k], response, a=forces[k])
        return self._rows.whole(response)

    def field(self, x: np.ndarray) -> np.ndarray:
        """U0."""
        return x

    def contact_load(self, forces: np.ndarray) -> np.ndarray:
        """B^T λ."""
        return self._transposed @ forces

    def residual(
        self, x: np.ndarray, gauss: GaussState | Update, theta: Theta
    ) -> tuple[np.ndarray, np.ndarray]:
        """Loads less internal forces on free dofs, and the norm of their terms in each body.

        Args:
            x: unknown, (n,).
            gauss: stress and state at the Gauss points.
            theta: amplitudes θ of the loads at the parameter.
        """
        loads = self.problem.external @ theta
        grounded = 0.0 if self.springs is None else self.springs * (x + self.lifts @ theta)
        internal, size = self.internal(gauss.stress, grounded)
        return loads - internal, self.norms(np.abs(loads) + size)

    def elastic_statuses(self, theta: Theta) -> Statuses:
        """Contact forces of the elastic bodies, without inelastic strain, and their statuses."""
        nothing = np.zeros(self.size)
        strain = self.strain(nothing, theta)
        state = self.material.at_rest()
        stress = np.einsum("nij,nj->ni", self.material.elastic, strain)
        residual, _ = self.residual(nothing, GaussState(stress, state), theta)
        return self.elastic.correct(
            residual, nothing, theta, np.zeros(self.conditions, dtype=bool)
        )[1]

    def internal(
        self, stress: np.ndarray, grounded: np.ndarray | float = 0.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Forces of a stress and of springs on free dofs, and the size of their terms.

        Forces on dependent dofs are included.

        Args:
            stress: stress at the Gauss points, (Gauss points, components).
            grounded: forces of springs to ground, (N,).
        """
        internal, size = self.operator.internal(stress)
        if self._ranks is not None:
            internal, size = self._ranks.summed(np.stack([internal, size]))
        internal = internal + grounded
        size = size + np.abs(grounded)
        prolongation = self.problem.prolongation
        free = prolongation.free
        return prolongation.restrict(internal) * free, prolongation.restrict_sizes(size) * free

    def norms(self, residual: np.ndarray) -> np.ndarray:
        """Norm of a residual on the dofs of each body, (bodies,)."""
        return np.sqrt(np.bincount(self._body, residual**2))

    def stiffness(self, tangents: np.ndarray) -> csr_matrix:
        """K_T of consistent tangents at all Gauss points, (N, N)."""
        elastic = self._unchanged
        if self._ranks is None:
            matrix = self.operator.stiffness(tangents, self._pattern, elastic)
        else:
            nothing = ElasticPart(elastic.tangents, np.zeros_like(elastic.data))
            matrix = self.operator.stiffness(tangents, self._pattern, nothing)
            matrix.data = elastic.data + self._ranks.summed(matrix.data)
        return self.problem.prolongation.stiffness([matrix])[0]

    def signs(self, answer: Answer) -> Signs:
        """Residual of the free dofs and its scale.

        Gaps are satisfied to the tolerance of the solver.
        """
        residual, sizes = self.residual(
            answer.unknown, gauss_of(answer), self.amplitudes(answer.parameter)
        )
        imbalance = (residual - self.contact_load(answer.multipliers)) * self.problem.free
        return Signs(float(np.linalg.norm(imbalance)), float(np.linalg.norm(sizes)), 0.0)

    def linearised(self, tangents: np.ndarray) -> Linearisation:
        """Factor the symmetric part of the tangent stiffness.

        The previous one must then be factored again.
        """
        symmetric = (tangents + tangents.swapaxes(1, 2)) / 2
        linearisation = self._lazy(self.stiffness(symmetric), self._tangent_factors, tangents)
        with linearisation.held():  # raises an error for a singular tangent
            return linearisation


def equilibrium_of(full: FullModel) -> FullOrderEquilibrium:
    """Equilibrium of a full model of inelastic bodies.

    Raises:
        NotOfferedError: for elastic bodies, and for laws that another plug-in reads.
    """
    equilibrium: Any = full.equilibrium
    if equilibrium is None or equilibrium.reader != "inelastic":
        raise NotOfferedError(
            f"bodies of scene '{full.scene.name}' have no laws of plasticity or creep"
        )
    return equilibrium


def bodies_of(scene: Scene, kind: ChangedClass = as_it_is) -> GaussModel:
    """The Gauss points of a scene: the facet ``full_order``.

    Args:
        scene: the scene.
        kind: changes the class of its finite element model.

    Raises:
        SceneError: for constants of laws not valid in the box.
    """
    for body in scene.bodies:
        names = coordinate_names(scene.hypothesis)
        check_law_over_box(
            body.law, scene.parameters, f"body {body.tag} of scene '{scene.name}'", names
        )
    model: Any = kind(LawsOnMesh)(scene, MPI.COMM_SELF)
    bodies: GaussModel = model.laws()
    return bodies
