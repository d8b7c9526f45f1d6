"""Full-order model: the finite element contact problem (1.21), of elastic bodies and of bodies that flow."""

from __future__ import annotations

import logging
from collections.abc import Callable
from copy import copy
from functools import cached_property
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from mpi4py import MPI
from scipy.sparse import csc_matrix, csr_matrix, spmatrix

from hhr_dolfinx import ranks
from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, Status, active_set
from hhr_dolfinx.contact.problem import ScaledBodies
from hhr_dolfinx.errors import NotOfferedError, SceneError
from hhr_dolfinx.full_order.at_hand import AtHand
from hhr_dolfinx.full_order.checks import check_regular
from hhr_dolfinx.full_order.discretisation import Discretisation
from hhr_dolfinx.linear.sparse import FreeCholesky, low_rank_of, ordering_of
from hhr_dolfinx.models.answer import Answer, History, ModelFields, Path, found_as
from hhr_dolfinx.models.estimates import Estimate
from hhr_dolfinx.models.histories.equilibrium import DEFAULT_MARCH, MarchSettings
from hhr_dolfinx.models.histories.path import check_settings, checked_path, solve_along
from hhr_dolfinx.models.model import AnsweringModel
from hhr_dolfinx.models.strains import StrainGuard
from hhr_dolfinx.scene import Scene

if TYPE_CHECKING:
    from hhr_dolfinx.contact.floating import FloatingEqualities
    from hhr_dolfinx.contact.problem import ContactProblem
    from hhr_dolfinx.formulas import Modulus
    from hhr_dolfinx.full_order.flow import FullEquilibrium
    from hhr_dolfinx.full_order.outputs import FullShapeFunctionals
    from hhr_dolfinx.linear.rows import Rows
    from hhr_dolfinx.linear.shared import SharedCholesky
    from hhr_dolfinx.models.eliminations.elimination import CondensedContact
    from hhr_dolfinx.models.functionals.functional import Functionals

_log = logging.getLogger(__name__)

KEPT_BYTES = 1e9
"""Memory that K^-1 B^T may take; where it would take more its columns are dropped as they are made."""
_BY_ROWS = ("per_load", "scaled")
"""Cached values of a full model that are those of its own rows."""
FULL_ORDER_ADVICE = {Status.SINGULAR: "list each contact pair once, and let no two conditions hold the same dofs"}


class FullOrderModel(AnsweringModel, ModelFields):
    """The finite element model of a scene: K factored once, the contact on its Schur complement.

    Where nothing flows a query costs one solve with K, the statuses on S = B K^-1 B^T, and u = K^-1 F - K^-1 B^T
    lambda, on any number of ranks; the answer is the same on each. Where bodies flow histories are solved by
    :mod:`models.histories.march`; ranks, of machines that are alike, share the factors then and nothing else. PETSc
    options take the prefix ``hhr_<scene>_``. On one rank several threads may ask; on more they must not, since the
    ranks would meet in different orders.

    Args:
        scene: the scene.
        comm: MPI communicator.

    Attributes:
        scene: the scene.
        comm: MPI communicator, whose ranks ask together.
        spread: which rows of vectors and tables of dofs are here, and sums over ranks: where bodies flow each rank has
            all of them, and factors alone are shared.
        discretisation: mesh and forms.
        problem: the :class:`ContactProblem`; on several ranks each has the rows of its own dofs.
        parameters: the box of the parameters.
        per_force: K^-1 B^T on the dofs of this rank, (own dofs, N_lambda).
        keeps_columns: whether K^-1 B^T has room in memory; without it S is made when it is first asked for, and a
            displacement takes one more solution.
        equilibrium: what bodies that flow need besides; None where nothing flows.
        functionals: outputs of the scene; None where it has none.
        trained: None, since nothing is outside what a full model can answer.

    Raises:
        SceneError: for what is no scene, or one that cannot be built.
        NotSolvableError: for bodies that can move freely.
    """

    of_full_order = True
    exact = True
    unbounded = "the full model has no reduction error"

    trained = None

    def __init__(self, scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD):
        if not isinstance(scene, Scene):
            raise SceneError(f"{scene!r} is no scene: give a Scene")
        self.scene = scene
        self.comm = comm
        self.equilibrium: FullEquilibrium | None = None
        with ranks.together(comm, f"building the full model of scene '{scene.name}'"):
            if any(body.law is not None for body in scene.bodies):
                self._build_flowing()
            else:
                discretisation = Discretisation(scene, comm)
                self._factor(discretisation, *discretisation.stiffness_terms())
            self.functionals: Any = self._prepared_outputs()  # those of a shape where it depends on parameters
        self.strains = StrainGuard(self.problem, axisymmetric=scene.hypothesis == "axisymmetric")

    def _build_flowing(self) -> None:
        from hhr_dolfinx.full_order.flow import FullEquilibrium, GaussModel

        gauss = GaussModel.of(self.scene, MPI.COMM_SELF)
        self._factor(gauss.discretisation, gauss.stiffness, gauss.moduli)
        self.equilibrium = FullEquilibrium(self, gauss)

    def _prepared_outputs(self) -> Functionals | FullShapeFunctionals | None:
        if not self.scene.outputs:
            return None
        from hhr_dolfinx.full_order.outputs import functionals_of

        return functionals_of(self)

    def _factor(
        self, discretisation: Discretisation, stiffness: tuple[csr_matrix, ...], moduli: tuple[Modulus, ...] = ()
    ) -> None:
        """Eliminate everything but the contact, with own rows of the parts of K, (own dofs, N) each.

        Where K depends on parameters, what is kept is that of the middle of the box.

        Measured on one core: PETSc's own Cholesky with the ordering qmd solves plane problems fastest (1.1 ms against
        2.3 ms by LU and 1.6 ms by MUMPS at 14,000 dofs), MUMPS those in space (8 ms against 13 ms at 22,000 dofs).
        """
        self.discretisation = discretisation
        problem = discretisation.contact_problem(stiffness, moduli)
        self.problem = problem = (
            problem if discretisation.reshaped is None else discretisation.reshaped.attached(problem)
        )
        self.problem = problem = discretisation.checked(problem)
        self.parameters = problem.parameters
        self.friction = problem.friction
        self._own = problem.rows
        self._at_hand: AtHand | None = None
        self._scaled_schur: tuple[np.ndarray, np.ndarray] | None = None
        # a stiffness factored for each query: at 14,140 dofs and 162 conditions MUMPS takes 24 ms, nd 45, qmd 70, and a
        # solution for each condition 138, 272, 308 ms, which Schur complements save; that of bodies that flow serves
        # whole histories
        anew = problem.varies and all(body.law is None for body in self.scene.bodies) and self.scaled is None
        self.keeps_columns = self._has_room()
        # what is solved for once for each query, or does not keep its columns, asks for S alone
        asked = np.unique(problem.contact.indices) if anew or not self.keeps_columns else None
        self._solver = self.factors_of(problem.own_stiffness, "mumps" if anew else "qmd", asked, anew=anew)
        check_regular(problem, lambda rhs: self.spread.whole(self._solver.solve(rhs)), self.scene.name)
        contact = problem.contact_of_rows
        self._own_loads = problem.loads[self._own]
        self._contact = contact
        self._columns: np.ndarray | None = None
        self._schur: np.ndarray | None = None
        if self.keeps_columns:
            self._columns = self.solved_columns(contact.T)
        self._pairs = Pairs.of(problem.contact_pairs)
        adrift = f"hold it by a displacement, or push it: {problem.loose}"
        self.advice = {**FULL_ORDER_ADVICE, Status.ADRIFT: adrift}

    @property
    def schur(self) -> np.ndarray:
        """S in the middle of the box, (N_lambda, N_lambda)."""
        with self.factors.lock:  # no two threads make it
            if self._schur is None:
                with ranks.together(self.comm, f"making S of scene '{self.scene.name}'"):
                    whole = self.keeps_columns or self.scaled is None
                    self._schur = self._condensed() if whole else self.schur_parts.sum(axis=0)
        return self._schur

    @cached_property
    def equalities(self) -> SchurEqualities:
        """Equality problems on this S, whose factors queries share."""
        return SchurEqualities.of(self.schur)

    def _condensed(self) -> np.ndarray:
        """S of columns of K^-1 B^T that are kept, or by blocks of columns that are dropped."""
        if self._columns is not None:
            return self.spread.sum(self._contact @ self._columns)
        self._solver.refactor(self.problem.own_stiffness)
        known = self._between_last([self._contact])
        if known is not None:
            return known[0]
        conditions = self._contact.shape[0]
        _log.info(
            "K^-1 B^T would take %.1f GB: S is made of blocks of it, and a displacement takes one more solution",
            8e-9 * self.problem.free.size * conditions,
        )
        found = np.empty((conditions, conditions))
        touched, contact = self._at_contact()
        for part, block in self._solver.solved_blocks(self._contact.T, touched):
            found[:, part] = contact @ block
        return self.spread.sum(found)

    def _between_last(self, rows: list[csr_matrix]) -> list[np.ndarray] | None:
        """Each of some rows, (m, own dofs), as rows K^-1 rows^T, (m, m); None where that takes solutions."""
        made = (self._solver.between_last(item) for item in rows)
        found = [item for item in made if item is not None]
        return found if len(found) == len(rows) else None

    def _at_contact(self) -> tuple[np.ndarray, csr_matrix]:
        """Own dofs that conditions touch, and the columns of B there."""
        touched = np.unique(self._contact.indices)
        return touched, csr_matrix(self._contact[:, touched])

    def has_room(self, rows: int) -> bool:
        """Whether an array with so many rows, and a column for each condition, may be kept."""
        return 8 * rows * self.conditions <= KEPT_BYTES

    def _has_room(self) -> bool:
        """Whether K^-1 B^T is kept: where it is small, and where bodies flow or rest on what resists no motion."""
        problem = self.problem
        few = self.has_room(problem.free.size)
        return few or any(body.law is not None for body in self.scene.bodies) or problem.resting is not None

    @property
    def per_force(self) -> np.ndarray:
        """K^-1 B^T, (own dofs, N_lambda), of a constant K or that of the middle of the box.

        Where it is not kept it is solved for, and kept from then on: it may be larger than all else.
        """
        if self._columns is None:
            _log.warning("K^-1 B^T is solved for and kept: %.1f GB", 8e-9 * self.problem.free.size * self.conditions)
            with self.factors.lock:
                self._solver.refactor(self.problem.own_stiffness)
                self._columns = self.solved_columns(self._contact.T)
        return self._columns

    def pushed(self, forces: np.ndarray) -> np.ndarray:
        """K^-1 B^T times forces, (N_lambda,) or (N_lambda, k), on own dofs; one more solution where it is not kept."""
        if self._columns is not None:
            return self._columns @ forces
        return self.pushed_at(self.problem.own_stiffness, self._contact, forces)

    def pushed_everywhere(self, forces: np.ndarray) -> np.ndarray:
        """The same on all dofs of all ranks, (N,) or (N, k); collective."""
        return self.spread.whole(self.pushed(forces))

    def pressed(self, rows: csr_matrix) -> np.ndarray:
        """Some rows, (k, N), times K^-1 B^T, (k, N_lambda); as K is symmetric, B times K^-1 rows^T."""
        if not rows.shape[0]:
            return np.zeros((0, self.conditions))
        own = csr_matrix(rows)[:, self._own]
        if self._columns is not None:
            return self.spread.sum(own @ self._columns)
        return self.spread.sum(self._contact @ self.solved_columns(csc_matrix(own.T))).T

    @cached_property
    def per_load(self) -> np.ndarray:
        """K^-1 loads on the dofs of this rank, (own dofs, 1 + T), of a constant K: what bounds of all models need."""
        return self.solved_columns(self._own_loads)

    @cached_property
    def scaled(self) -> ScaledBodies | None:
        """Factors of whole bodies, where nothing else of K varies; None elsewhere."""
        return ScaledBodies.of(self.problem)

    @cached_property
    def schur_parts(self) -> np.ndarray:
        """S in the middle of the box by connected components of K, (C, N_lambda, N_lambda)."""
        assert self.scaled is not None
        if self._columns is not None:
            return self.scaled.parts(self._columns)
        bodies = self.problem.bodies
        masks = [np.bincount(body, minlength=len(self.problem.free))[self._own] > 0 for body in bodies]
        with self.factors.lock:
            self._solver.refactor(self.problem.own_stiffness)
            rows = [csr_matrix(self._contact.multiply(mask)) for mask in masks]
            known = self._between_last(rows)
            if known is not None:
                return np.stack(known)
            count = len(self.problem.gaps)
            found = np.empty((len(masks), count, count))
            touched, contact = self._at_contact()
            for part, block in self._solver.solved_blocks(self._contact.T, touched):
                for number, mask in enumerate(masks):
                    here = mask[touched]
                    found[number][:, part] = contact[:, here] @ block[here]
        return self.spread.sum(found)

    def schur_of(self, scales: np.ndarray) -> np.ndarray:
        """S for factors of the connected components, (C,): the same array for the same factors as before.

        An increment that leaves them as they are then finds what the last one factored.
        """
        known = self._scaled_schur
        if known is None or not np.array_equal(known[0], scales):
            known = scales, np.tensordot(1 / scales, self.schur_parts, 1)
            self._scaled_schur = known
        return known[1]

    @cached_property
    def rigid_taken(self) -> np.ndarray:
        """What rigid motions that only contact holds take from the slack, (N_lambda, r)."""
        return self.problem.contact @ self.problem.rigid

    @cached_property
    def rigid_loads(self) -> np.ndarray:
        """Loads along these motions, (r, 1 + T), the same for every stiffness."""
        return (self.problem.loads.T @ self.problem.rigid).T

    @cached_property
    def floating(self) -> FloatingEqualities:
        """Equality problems with these motions on a constant S, whose factors queries share."""
        from hhr_dolfinx.contact.floating import FloatingEqualities

        return FloatingEqualities(self.schur, self.rigid_taken)

    def at_rest(self, own: np.ndarray) -> np.ndarray:
        """Fields on the dofs of this rank, (own dofs, ...), without rigid motions that nothing drives or resists."""
        if self.problem.resting is None:
            return own
        motions = self.problem.resting[self._own]
        return own - motions @ self.spread.sum(motions.T @ own)

    @property
    def fields(self) -> FullOrderModel:
        """What completes its answers: itself."""
        return self

    @property
    def spread(self) -> Rows:
        """See above."""
        return self.problem.spread

    @property
    def dimension(self) -> int:
        """Components of the displacement at a node."""
        return self.problem.block_size

    @property
    def conditions(self) -> int:
        """Number of contact conditions, N_lambda."""
        return len(self.problem.gaps)

    def condensed_at(self, problem: ContactProblem, point: np.ndarray) -> AtHand:
        """S of the problem at a point, whose stiffness is factored unless it is the one at hand.

        Along a path mostly loads change, and moduli stay.
        """
        weights = self.problem.weights(point)
        known = self._at_hand
        if self.problem.reshaped is None and known is not None and np.array_equal(weights, known.weights):
            self._solver.refactor(known.stiffness)  # no work, unless another one was put in its place
            return known
        self._at_hand = None
        stiffness = problem.own_stiffness
        self._solver.refactor(stiffness)
        contact = problem.contact_of_rows
        per_force = None
        found = self._between_last([contact])
        if found is None:
            per_force = self.solved_columns(contact.T)
            found = [self.spread.sum(contact @ per_force)]
        self._at_hand = AtHand(weights, stiffness, per_force, found[0])
        return self._at_hand

    def pushed_at(self, stiffness: csr_matrix, contact: csr_matrix, forces: np.ndarray) -> np.ndarray:
        """K^-1 B^T times forces, (N_lambda,) or (N_lambda, k), of a stiffness, which is factored unless it is."""
        with self._solver.lock:
            self._solver.refactor(stiffness)
            loads = contact.T @ forces
            return self.solve_stiffness(loads) if loads.ndim == 1 else self.solved_columns(csc_matrix(loads))

    @property
    def factors(self) -> FreeCholesky | SharedCholesky:
        """Of K; where it depends on parameters, those of the parameter that was solved last."""
        return self._solver

    @property
    def block_ordering(self) -> str:
        """Ordering of factors for many right-hand sides at once."""
        return ordering_of(self.problem.block_size, "mumps")

    @property
    def pairs(self) -> Pairs | None:
        """Conditions by contact pair."""
        return self._pairs

    def __copy__(self) -> FullOrderModel:
        """Another model with the same factors."""
        model = object.__new__(FullOrderModel)
        vars(model).update(vars(self))
        return model

    def __reduce__(self) -> NoReturn:
        """Refuse to leave the process, answers included, as its factors and mesh cannot."""
        raise NotOfferedError(
            f"the full model of scene '{self.scene.name}' belongs to this process: hand on what its answers say, "
            "answer.displacement() and answer.forces(), and make a model from the scene where another is needed"
        )

    def gathered(self) -> FullOrderModel:
        """The same model on all rows: each rank has the whole problem, and they share the factors. Collective.

        For what reduces and checks, which all ranks do alike, as where bodies flow.
        """
        if self.problem.comm is None:
            return self
        problem = self.problem.gathered(self.comm)
        from hhr_dolfinx.linear.shared import SharedCholesky

        model = copy(self)
        for name in _BY_ROWS:
            vars(model).pop(name, None)
        model.problem = problem
        model._own = problem.rows
        model._own_loads = problem.loads
        model._contact = problem.contact
        model._columns = None if self._columns is None else self.spread.whole(self._columns)
        factors = self._solver
        assert isinstance(factors, FreeCholesky)
        own = self.problem.own_stiffness
        factors.refactor(own)
        model._solver = SharedCholesky(factors, self._own, own, problem.own_stiffness, self.comm)
        return model

    def factors_of(
        self, stiffness: csr_matrix, plane: str, last: np.ndarray | None = None, *, anew: bool = False
    ) -> FreeCholesky | SharedCholesky:
        """Factors of own rows of a stiffness, with an ordering for problems in the plane; ``last`` as these have it.

        ``anew`` says whether they are made for every parameter.
        """
        problem = self.problem
        ordering = ordering_of(problem.block_size, plane)
        low_rank = low_rank_of(problem.block_size, problem.free.size, anew=anew)
        if low_rank is not None:
            _log.info("%d dofs in space: blocks of the factors are compressed to %g", problem.free.size, low_rank)
        if problem.comm is None and self.comm.size > 1:
            from hhr_dolfinx.linear.shared import SharedCholesky

            given = stiffness, problem.held, self.scene.name, self.comm
            return SharedCholesky.of(*given, low_rank=low_rank, last=last)
        rows = stiffness, problem.held, self._own, self.scene.name, ordering, self.comm
        return FreeCholesky(*rows, low_rank=low_rank, last=last)

    def _answered(self, point: np.ndarray, start: Any, outside: str, gradient: bool) -> Answer:
        """A full model knows no nearest statuses: ``nearest`` starts where the free slack is negative."""
        answer = self._solved(point, start, gradient)
        self.strains.look(answer)
        return answer

    def _solved(self, point: np.ndarray, start: Any, gradient: bool) -> Answer:
        cold = start is None or isinstance(start, str)
        if self.problem.varies or gradient or self.problem.rigid is not None:
            from hhr_dolfinx.full_order.elimination import solved_anew

            return solved_anew(self, point, None if cold else start, gradient=gradient)
        theta = self.problem.amplitudes(point)
        free = self.solve_stiffness(self._own_loads @ theta)
        free_slack = self.problem.gaps @ theta - self.spread.sum(self._contact @ free)
        found = active_set(self.equalities, free_slack, free_slack < 0 if cold else start, pairs=self._pairs)
        return found_as(found, point, self.spread.whole(free - self.pushed(found.forces)), self)

    def contacts(self) -> Callable[[np.ndarray], CondensedContact]:
        """See :class:`AnsweringModel`; what K of the point before leaves is at hand."""
        from hhr_dolfinx.full_order.elimination import FullStiffness

        def made(point: np.ndarray) -> CondensedContact:
            with self.factors.lock:  # of which another thread might make those of another point
                return FullStiffness.at(self, point).contact()

        return made

    @property
    def sizes(self) -> tuple[int, int]:
        """Numbers of dofs and of contact conditions."""
        return len(self.problem.free), self.conditions

    def march(
        self,
        path: Path,
        settings: MarchSettings = DEFAULT_MARCH,
        *,
        known: list[Answer] | tuple[()] = (),
        keep: Callable[[Answer], None] = lambda answer: None,
    ) -> History:
        """Solve a history from rest, see :meth:`Model.march`.

        ``known`` are answers to its first steps, solved before; ``keep`` is told of each new one as it is there.
        """
        check_settings(settings)
        checked = checked_path(self.parameters, path)
        if self.equilibrium is None:

            def keep_small(answer: Answer) -> None:
                self.strains.look(answer)
                keep(answer)

            if self.friction is None:
                return solve_along(self, checked, settings, known=known, keep=keep_small)
            from hhr_dolfinx.models.histories.sliding import slide_along

            return slide_along(self, checked, settings, known=known, keep=keep_small)
        from hhr_dolfinx.models.histories.march import march

        equilibrium = self.equilibrium if settings.gradient else self.equilibrium.on_ranks(self.comm)
        return march(equilibrium, checked, settings, known=known, keep=keep)

    def solve_stiffness(self, own_rhs: np.ndarray) -> np.ndarray:
        """K^-1 times a vector, each rank with its own rows."""
        return self.at_rest(self._solver.solve(self.at_rest(own_rhs)))

    def solve_with(self, stiffness: csr_matrix, own_rhs: np.ndarray) -> np.ndarray:
        """K^-1 times a vector for a stiffness, (own dofs, N), which is factored again if another one was meanwhile."""
        with self._solver.lock:
            self._solver.refactor(stiffness)
            return self.solve_stiffness(own_rhs)

    def solved_columns(self, columns: spmatrix) -> np.ndarray:
        """K^-1 times the columns of a sparse matrix, (own dofs, k), each rank with its own rows."""
        found = self._solver.solve_columns(columns)
        resting = self.problem.resting
        if resting is None or not resting.shape[1]:
            return found
        own = resting[self._own]
        work = self.spread.sum(own.T @ columns)
        drawn = np.stack([self._solver.solve(motion) for motion in own.T], axis=1)
        return self.at_rest(found - drawn @ work)

    # what completes an answer, see models.answer.Fields

    def displacement(self, answer: Answer) -> np.ndarray:
        """U0 and the lift, (N,)."""
        return answer.unknown + self.problem.lifts @ self.problem.amplitudes(answer.parameter)

    def forces(self, answer: Answer) -> np.ndarray:
        """The multipliers, (N_lambda,), for the caller to change as he likes."""
        return answer.multipliers.copy()

    def stress(self, answer: Answer) -> np.ndarray:
        """Stress in Kelvin's notation: at all Gauss points where bodies flow, else in the middle of each cell."""
        if answer.gauss is not None:
            return answer.gauss.stress.copy()
        return self.stress_of(self.displacement(answer), answer.parameter)

    @property
    def full(self) -> FullOrderModel:
        """Itself, of its own answers; see :class:`~hhr_dolfinx.models.answer.ModelFields`."""
        return self

    def areas(self, mu: Any) -> np.ndarray:
        """Tributary areas of the contact conditions at a parameter, on which shapes may depend, (N_lambda,)."""
        shaped = self.problem.reshaped
        return (self.problem if shaped is None else shaped(self.parameters.point(mu))).contact_areas

    def facts(self) -> dict[str, str]:
        """See :class:`~hhr_dolfinx.models.shown.Shown`."""
        return {"scene": f"scene '{self.scene.name}'", **super().facts()}

    def stress_of(self, displacement: np.ndarray, mu: Any = None) -> np.ndarray:
        """Elastic stress of a displacement (N,) in the middle of each cell, Kelvin's notation, (cells, components).

        What depends on parameters is that of ``mu``; None takes the middle of the box.
        """
        point = self.problem.middle if mu is None else self.parameters.point(mu)
        return self.discretisation.stress(displacement, point)

    def plastic_strain(self, answer: Answer) -> np.ndarray:
        """Cumulated plastic strain at all Gauss points; empty where nothing flows."""
        return np.zeros(0) if answer.gauss is None else answer.gauss.state.cumulated.copy()

    def estimate(self, answer: Answer) -> Estimate | None:
        """No error but that of the mesh, which is not estimated; None without an answer."""
        return Estimate.exact(self.functionals) if answer.converged else None

    def measured(self, answer: Answer, theta: np.ndarray) -> np.ndarray:
        """Rows of the outputs times the displacement, (K,)."""
        assert self.functionals is not None
        return self.functionals.at(answer.parameter).measured(self.displacement(answer))

    def measured_changes(self, answer: Answer, changes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of all forces and of these products: :class:`~models.functionals.functional.MeasuredFields`."""
        assert self.functionals is not None
        forces, field = self.coordinate_changes(answer, changes)
        return forces, self.functionals.at(answer.parameter).measured(field)

    def coordinates(self, answer: Answer, theta: np.ndarray) -> np.ndarray:
        """The displacement, see :class:`~models.functionals.functional.ShapedFields`."""
        return self.displacement(answer)

    def coordinate_changes(self, answer: Answer, changes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of all forces and of the displacement."""
        assert answer.gradient is not None
        return answer.gradient.multipliers, answer.gradient.unknown + self.problem.lifts @ changes
