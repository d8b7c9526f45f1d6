"""Equilibrium of the full mesh for inelastic bodies, thesis Alg. 6.1: Newton or elastic search."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from threading import RLock
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI
from scipy.linalg.blas import daxpy
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx import ranks
from hhr_dolfinx.amplitudes import Theta
from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities
from hhr_dolfinx.contact.law import UNILATERAL_STEP, StepContact
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.contact.stiffness import FactorStore, LazyStiffness, ScaledStiffness, Stiffness
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.full_order.discretisation import Discretisation
from hhr_dolfinx.linear.rows import Rows
from hhr_dolfinx.materials.strain import ElasticPart, SparsePattern, StrainOperator
from hhr_dolfinx.models.answer import Answer, History, Path
from hhr_dolfinx.models.histories.equilibrium import DEFAULT_MARCH, MarchSettings, StressOutput
from hhr_dolfinx.plugins.inelastic.constants import check_law
from hhr_dolfinx.plugins.inelastic.equilibrium import Correction
from hhr_dolfinx.plugins.inelastic.gauss_points import at_gauss_points, material_at, stiffness_parts, strain_operator
from hhr_dolfinx.plugins.inelastic.linearised_step import PATIENCE, PATIENCE_IN_SPACE, LinearisedStepper
from hhr_dolfinx.plugins.inelastic.march import Histories, march
from hhr_dolfinx.plugins.inelastic.points import ALL_HERE, Points
from hhr_dolfinx.plugins.inelastic.points_of_ranks import PointsOfRanks
from hhr_dolfinx.plugins.inelastic.state import GaussState
from hhr_dolfinx.plugins.inelastic.state import state as gauss_of
from hhr_dolfinx.plugins.inelastic.trained import Signs
from hhr_dolfinx.plugins.inelastic.update import Material, Update
from hhr_dolfinx.scene import Scene

if TYPE_CHECKING:
    from hhr_dolfinx.formulas import Modulus
    from hhr_dolfinx.models.full import FullModel
    from hhr_dolfinx.plugins.inelastic.outputs import FlowMises


@dataclass(frozen=True)
class GaussModel:
    """Gauss points and laws of a whole mesh."""

    discretisation: Discretisation  # mesh and forms
    operator: StrainOperator  # strain at all Gauss points
    material: Material  # laws at all Gauss points
    bodies: np.ndarray  # body of each cell as its index in the scene, (cells,)
    pattern: SparsePattern  # sparsity of the stiffness
    stiffness: tuple[csr_matrix, ...]  # parts of the elastic stiffness by the same Gauss points, (N, N) each
    moduli: tuple[Modulus, ...]  # their amplitudes; empty if elasticity is constant, with a single part

    @property
    def places(self) -> int:
        """Number of Gauss points."""
        return self.operator.gauss_points

    def mises(self, output: StressOutput, cells: np.ndarray) -> FlowMises:
        """Von Mises' stress of an output in some cells."""
        from hhr_dolfinx.plugins.inelastic.outputs import mises  # imported here: most scenes have no outputs

        return mises(self.operator, output, cells)

    def equilibrium(self, full: FullModel) -> FullEquilibrium:
        """Equilibrium of a full model."""
        return FullEquilibrium(full, self)

    @classmethod
    def of(cls, scene: Scene, comm: MPI.Comm = MPI.COMM_SELF) -> GaussModel:
        """The Gauss points of a scene.

        Raises:
            SceneError: for a law with inadmissible constants somewhere in the parameter range.
        """
        if scene.hypothesis == "plane_stress":
            raise SceneError("flow in plane stress needs the thickness strain solved for: not built in")
        for body in scene.bodies:
            check_law(body.law, scene.parameters, f"body {body.tag} of scene '{scene.name}'")
        discretisation = Discretisation(scene, comm)
        operator = strain_operator(discretisation)
        bodies = discretisation.cell_bodies()
        material = material_at(scene, bodies, operator)
        pattern = operator.pattern()
        return cls(discretisation, operator, material, bodies, pattern, *stiffness_parts(material, operator, pattern))


class FullEquilibrium(Histories):
    """Equilibrium of U0, see :class:`hhr_dolfinx.models.histories.equilibrium.Equilibrium`.

    Each of several ranks has all dofs of vectors, and all Gauss points except in objects made by :meth:`on_ranks`.

    Args:
        full: the full model, whose elastic factors are used.
        gauss: Gauss points and laws.

    Attributes:
        eigenstrains: strains without stress for each term of θ, sparse, (Gauss points * components, 1 + T).
        lock: held during a load path, so that two paths do not factor alternately; results are correct without it.
    """

    trained = None
    together: Points = ALL_HERE

    def __init__(self, full: FullModel, gauss: GaussModel):
        problem = full.problem
        self.fields = self._full = full
        self.problem = problem
        self.operator = gauss.operator
        self.amplitudes = problem.amplitudes
        self.parameters = problem.parameters
        self.size = problem.free.size
        self.conditions = problem.contact.shape[0]
        self.law = problem.law
        self.points = np.arange(self.operator.gauss_points)
        self.per_cell = self.operator.per_cell
        self._pattern = gauss.pattern
        self._pairs = Pairs.of(problem.contact_pairs)
        # made for factoring, while that of the elastic stiffness is made for solving: on one core, in the plane at
        # 13,700 dofs, nd takes 31 ms to factor and 1.1 ms to solve, qmd 53 and 1.4 ms
        self._tangent_factors = FactorStore(lambda matrix: full.factors_of(matrix, "nd"))
        self.lock = RLock()
        self._body = np.zeros(self.size, dtype=int)
        self._body[self.operator.dofs] = gauss.bodies[:, None]
        self._transposed = problem.contact.T.tocsr()
        self._lifted = bool(problem.lifts.nnz)
        self.eigenstrains = csc_matrix((self.points.size * self.operator.components, problem.amplitudes.firsts[-1]))
        if any(hasattr(load, "eigenstrain_of") for load in gauss.discretisation.scene.loads):
            self.eigenstrains = at_gauss_points(gauss.discretisation, problem, self.operator)
        self._set_elasticity(gauss.material.moduli_at(problem.middle), problem.own_stiffness)
        self.elastic = _SparseLinearisation(
            problem, self._pairs, full.stiffness, full.equalities, self._response_to_forces, self._unchanged.tangents
        )
        self.material = gauss.material
        self.young = tuple(modulus.factor for modulus in gauss.moduli)
        self._middle = self
        self._last: tuple[np.ndarray, FullEquilibrium] | None = None
        self._ranks: PointsOfRanks | None = None
        self._rows = problem.spread
        self._spread: FullEquilibrium | None = None

    @property
    def places(self) -> int:
        """Number of Gauss points."""
        return self.operator.gauss_points

    def mises(self, output: StressOutput, cells: np.ndarray) -> FlowMises:
        """Von Mises' stress of an output in some cells."""
        from hhr_dolfinx.plugins.inelastic.outputs import mises  # imported here: most scenes have no outputs

        return mises(self.operator, output, cells)

    def stress(self, answer: Answer) -> np.ndarray:
        """Stress of an answer at all Gauss points, (Gauss points, components)."""
        return gauss_of(answer).stress.copy()

    def plastic_strain(self, answer: Answer) -> np.ndarray:
        """Cumulated plastic strain of an answer at all Gauss points."""
        return gauss_of(answer).state.cumulated.copy()

    def march(
        self,
        path: Path,
        settings: MarchSettings = DEFAULT_MARCH,
        *,
        known: Sequence[Answer] = (),
        keep: Callable[[Answer], None] = lambda answer: None,
    ) -> History:
        """History along a checked path; ranks share the Gauss points, but for derivatives."""
        solver = self if settings.gradient else self.on_ranks(self._full.comm)
        return march(solver, path, settings, known=known, keep=keep)

    def on_ranks(self, comm: MPI.Comm) -> FullEquilibrium:
        """The same equilibrium with some of the Gauss points on each rank, for collective paths; itself on one rank."""
        cells = len(self.operator.weights)
        if comm.size == 1 or cells < comm.size:
            return self
        if self._spread is None:
            self._spread = self._sharing(PointsOfRanks(cells, self.per_cell, comm))
            mine = ranks.share(self.size, comm.rank, comm.size)
            self._spread._rows = Rows(slice(mine.start, mine.stop), self.size, comm)
        return self._spread

    def _sharing(self, points: PointsOfRanks) -> FullEquilibrium:
        """The same equilibrium with the Gauss points of some cells."""
        found = copy(self)
        operator = self.operator
        arrays = {name: getattr(operator, name)[points.cells] for name in ("gradients", "weights", "dofs")}
        found.operator = replace(operator, **arrays)
        found.together = points
        found._ranks = points
        found._pattern = replace(self._pattern, position=self._pattern.position[points.cells])
        components = operator.components
        rows = slice(points.points.start * components, points.points.stop * components)
        found.eigenstrains = csc_matrix(self.eigenstrains.tocsr()[rows])
        material = self.material.between(points.points)
        found._set_elasticity(material.moduli_at(self.problem.middle), self.problem.own_stiffness)
        found.elastic = replace(self.elastic, push=found._response_to_forces, moduli=found._unchanged.tangents)
        found.material = material
        found._middle = found
        found._last = None
        return found

    def at(self, point: np.ndarray) -> FullEquilibrium:
        """The equilibrium with the elasticity of a point, (P,): itself if elasticity is constant.

        The last one is cached. If each part of K has separate dofs, as different connected components, nothing is
        factored or solved for again: K^-1 and K^-1 B^T are those of the middle of the box, row by row divided by the
        modulus. Otherwise K is factored, and columns of K^-1 B^T are solved for as conditions become active.

        Raises:
            SceneError: for an inadmissible modulus at the point.
        """
        middle = self._middle
        problem = self.problem
        if not problem.moduli:
            return self
        weights = problem.weights(point)
        last = middle._last
        if last is not None and np.array_equal(last[0], weights):
            return last[1]
        found = copy(middle)
        found._last = None
        stiffness = problem.combined(weights)
        found._set_elasticity(middle.material.moduli_at(point), stiffness)
        found.elastic = middle._elastic_of(point, stiffness, found._unchanged.tangents)
        # in one assignment: several threads may call this
        middle._last = weights, found
        return found

    def _set_elasticity(self, material: Material, stiffness: csr_matrix) -> None:
        """Set a material with constant moduli, and its elastic stiffness."""
        self.material = material
        self._unchanged: ElasticPart = ElasticPart(material.elastic, stiffness.data.copy())
        self._sizes = abs(stiffness)

    def _elastic_of(self, point: np.ndarray, matrix: csr_matrix, moduli: np.ndarray) -> _SparseLinearisation:
        """The elastic linearisation of K at a point, with elastic tangents."""
        full = self._full
        if full.system.bodies is None:
            return self._lazy(matrix, full.store, moduli)
        scaled = full.system.stiffness(point)
        assert isinstance(scaled, ScaledStiffness)
        given = self.problem, self._pairs, scaled, scaled.equalities
        return _SparseLinearisation(*given, lambda forces: self._response_to_forces(forces) / scaled.own, moduli)

    def _lazy(self, matrix: csr_matrix, store: FactorStore, moduli: np.ndarray) -> _SparseLinearisation:
        """The linearisation of a matrix whose columns of K^-1 B^T are solved for when conditions become active."""
        lazy = LazyStiffness(matrix, self.problem, store)
        return _SparseLinearisation(self.problem, self._pairs, lazy, lazy.equalities, lazy.response_to_forces, moduli)

    def _response_to_forces(self, forces: np.ndarray) -> np.ndarray:
        """K^-1 B^T λ in the middle of the box, by the columns of loaded conditions: few of a contact in space.

        Columns are added one by one: a copy of hundreds of them takes longer.
        """
        columns = self._rows.of(self._full.per_force)
        found = np.zeros(len(columns))
        for k in np.flatnonzero(forces).tolist():
            found = daxpy(columns[:, k], found, a=forces[k])
        return self._rows.whole(found)

    def strain(self, x: np.ndarray, theta: Theta) -> np.ndarray:
        """Strain of U0 + lift at all Gauss points, less eigenstrains."""
        found = self.operator.strain(x + self.problem.lifts @ theta if self._lifted else x)
        return found - (self.eigenstrains @ theta).reshape(found.shape) if self.eigenstrains.nnz else found

    def strain_of(self, change: np.ndarray) -> np.ndarray:
        """Strain of a change of U0 at all Gauss points."""
        return self.operator.strain(change)

    def contact_load(self, forces: np.ndarray) -> np.ndarray:
        """B^T λ."""
        return self._transposed @ forces

    def gaps(self, theta: Theta) -> np.ndarray:
        """Gaps less the lift, (N_lambda,)."""
        return self.problem.gaps @ theta

    def gaps_at(self, x: np.ndarray, theta: Theta) -> np.ndarray:
        """The same gaps for any displacement, (conditions,)."""
        return self.gaps(theta)

    def residual(self, x: np.ndarray, gauss: GaussState | Update, theta: Theta) -> tuple[np.ndarray, np.ndarray]:
        """Loads less internal forces on free dofs, and the norm of their terms in each body."""
        loads = self.problem.external @ theta
        internal, size = self.operator.internal(gauss.stress)
        if self._ranks is not None:
            internal, size = self._ranks.summed(np.stack([internal, size]))
        free = self.problem.free
        return loads - internal * free, self.norms(np.abs(loads) + size * free)

    def norms(self, residual: np.ndarray) -> np.ndarray:
        """Norm of a residual on the dofs of each body, (bodies,)."""
        return np.sqrt(np.bincount(self._body, residual**2))

    def round_off(self, x: np.ndarray, theta: Theta) -> np.ndarray:
        """Round-off of the residual, from sums of stiffness times displacement in double precision, (bodies,)."""
        return 1e-13 * self.norms(self._sizes @ np.abs(x + self.problem.lifts @ theta))

    def stiffness(self, tangents: np.ndarray) -> csr_matrix:
        """K_T of consistent tangents at all Gauss points, (N, N)."""
        elastic = self._unchanged
        if self._ranks is None:
            return self.operator.stiffness(tangents, self._pattern, elastic)
        nothing = ElasticPart(elastic.tangents, np.zeros_like(elastic.data))
        found = self.operator.stiffness(tangents, self._pattern, nothing)
        found.data = elastic.data + self._ranks.summed(found.data)
        return found

    def signs(self, answer: Answer) -> Signs:
        """Residual of the free dofs and its scale; gaps are satisfied to the tolerance of the solver."""
        residual, sizes = self.residual(answer.unknown, gauss_of(answer), self.amplitudes(answer.parameter))
        left = (residual - self.contact_load(answer.multipliers)) * self.problem.free
        return Signs(float(np.linalg.norm(left)), float(np.linalg.norm(sizes)), 0.0)

    def responding_at(self, point: np.ndarray) -> FullEquilibrium:
        """Itself: strain, gaps and F at a given displacement do not depend on moduli."""
        return self

    def stepper(self, settings: MarchSettings) -> LinearisedStepper:
        """Solver of the steps of a load path."""
        in_space = self.problem.block_size == 3
        return LinearisedStepper(self, settings, PATIENCE_IN_SPACE if in_space else PATIENCE)

    def linearised(self, tangents: np.ndarray) -> _SparseLinearisation:
        """Factor the tangent stiffness; the previous linearisation must then be factored again."""
        stiffness = self.stiffness(tangents)
        found = self._lazy(stiffness, self._tangent_factors, tangents)
        with found.stiffness.held():  # raises an error for a singular tangent
            return found


@dataclass(frozen=True)
class _SparseLinearisation:
    """A linearisation of the full problem, see :class:`hhr_dolfinx.models.histories.equilibrium.Linearisation`."""

    problem: ContactProblem  # the full problem
    pairs: Pairs | None  # its conditions by contact pair
    stiffness: Stiffness  # K, elastic or tangent
    equalities: SchurEqualities  # on S = B K^-1 B^T
    push: Callable[[np.ndarray], np.ndarray]  # maps forces to K^-1 B^T λ, (N,)
    moduli: np.ndarray  # tangents at the Gauss points

    def correct(
        self,
        residual: np.ndarray,
        x: np.ndarray,
        theta: Theta,
        active: np.ndarray,
        contact: StepContact = UNILATERAL_STEP,
    ) -> Correction:
        """Solve K δ + B^T λ = residual, B (x + δ) <= gaps."""
        problem = self.problem
        with self.stiffness.held():  # columns of S are solved for within the active set
            free = self.stiffness.solve(residual)
            slack = problem.gaps @ theta - problem.contact @ (x + free)
            found = contact.solved(self.equalities, slack, active, self.pairs)
        return Correction(free - self.push(found.forces), found)

    def changed(self, residual: np.ndarray, gaps: np.ndarray, active: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Solve K δ + B^T λ = residual, with B δ = gaps on active conditions and λ = 0 on the others."""
        with self.stiffness.held():
            free = self.stiffness.solve(residual)
            forces, _ = self.equalities(active, gaps - self.problem.contact @ free)
            return free - self.push(forces), forces


def bodies_of(scene: Scene) -> GaussModel:
    """The Gauss points of a scene: the facet ``full_order``."""
    return GaussModel.of(scene)
