"""Full-order model: the finite element contact problem (1.21)."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import nullcontext
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from mpi4py import MPI
from scipy.sparse import csr_matrix

from hhr_dolfinx import registry
from hhr_dolfinx.contact.active_set import Pairs, Status
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.contact.stiffness import FactorStore, SparseStiffness
from hhr_dolfinx.errors import NotOfferedError, SceneError
from hhr_dolfinx.full_order.discretisation import (
    ChangedClass,
    Discretisation,
    as_it_is,
    discretised,
)
from hhr_dolfinx.full_order.system import System
from hhr_dolfinx.full_order.with_laws import with_laws
from hhr_dolfinx.group import group_of
from hhr_dolfinx.linear.sparse import FreeCholesky, low_rank_of, ordering_of
from hhr_dolfinx.models.answer import Answer, CheckedStart
from hhr_dolfinx.models.answer_mesh import AnswerMesh
from hhr_dolfinx.models.eliminations.elimination import CondensedContact
from hhr_dolfinx.models.estimates import Estimate
from hhr_dolfinx.models.full import FullModel, Guard
from hhr_dolfinx.scene import Scene

if TYPE_CHECKING:
    from hhr_dolfinx.formulas import Modulus
    from hhr_dolfinx.parameters import PointLike

_log = logging.getLogger(__name__)

FULL_ORDER_ADVICE = {
    Status.SINGULAR: "list each contact pair once, and let no two conditions hold the same dofs"
}


class FullOrderModel(FullModel):
    """The finite element model of a scene: K factored once, the contact on its Schur complement.

    For elastic bodies a query costs one solve with K, the statuses on S = B K^-1 B^T, and u = K^-1
    F - K^-1 B^T lambda, on any number of ranks; the answer is the same on each. Paths of bodies
    with laws are solved by the plug-in that reads the laws; ranks, on similar machines, then share
    only the factors. PETSc options take the prefix ``hhr_<scene>_``. On one rank several threads
    may call the model; on several ranks they must not, since the order of collective calls would
    differ. It has the attributes of :class:`~hhr_dolfinx.models.full.FullModel`, and
    ``discretisation``, mesh and forms.

    Args:
        scene: the scene.
        comm: MPI communicator.

    Raises:
        SceneError: for an invalid scene, or one that cannot be built.
        NotSolvableError: for bodies that can move freely.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> full = hhr.FullOrderModel(scene)
        >>> answer = full.solve({"push": 50.0})
        >>> answer.status.value, round(answer.outputs()["peak"], 1)
        ('the statuses satisfy all contact conditions', 56.5)
        >>> answer.displacement().shape, answer.forces().shape
        ((90,), (8,))
    """

    exact = True
    unbounded = "the full model has no reduction error"

    trained = None  # no training range
    kind: ChangedClass = staticmethod(as_it_is)
    scene: Scene
    system: System

    def __init__(self, scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD):
        self.scene = scene
        self.group = group_of(comm)
        self.group.agreed("building a full model", self._asked)
        if not isinstance(scene, Scene):
            raise SceneError(f"{scene!r} is no scene: give a Scene")
        with self.group.together(f"building the full model of scene '{scene.name}'"):
            if scene.reader:
                bodies_with_laws = with_laws(scene, self.kind)
                self._factor(
                    bodies_with_laws.discretisation,
                    bodies_with_laws.stiffness,
                    bodies_with_laws.moduli,
                )
                self.equilibrium = bodies_with_laws.equilibrium(self)
            else:
                discretisation = discretised(scene, comm, self.kind)
                self._factor(discretisation, *discretisation.stiffness_terms())
            self.functionals = None
            if scene.outputs:
                shape = self.discretisation.shape
                self.functionals = shape.outputs(
                    self.discretisation, self.problem, self.equilibrium
                )
        guard = registry.offered("small_strains") or Guard
        self.strains = guard(self.problem, axisymmetric=scene.hypothesis == "axisymmetric")

    def _asked(self) -> list[str | np.ndarray]:
        """Words of the scene, which must be the same on all ranks."""
        return [f"scene '{getattr(self.scene, 'name', self.scene)}'", repr(self.scene)]

    def _factor(
        self,
        discretisation: Discretisation,
        stiffness: tuple[csr_matrix, ...],
        moduli: tuple[Modulus, ...] = (),
    ) -> None:
        """Eliminate everything except the contact, with local rows of the parts of K, (own dofs, N)
        each.

        If K depends on parameters, factors of the middle of the box are kept.

        Measured on one core: PETSc's own Cholesky with the ordering qmd solves plane problems
        fastest (1.1 ms against 2.3 ms by LU and 1.6 ms by MUMPS at 14,000 dofs), MUMPS those in
        space (8 ms against 13 ms at 22,000 dofs).
        """
        self.discretisation = discretisation
        stated = discretisation.stated(stiffness)
        problem = discretisation.checked(discretisation.contact_problem(stiffness, moduli), stated)
        self.problem = problem
        self.parameters = problem.parameters
        self.law = problem.law
        few = self.has_room(problem.free.size)
        self.keeps_columns = few or bool(self.scene.reader) or problem.kernel is not None
        self.stiffness: SparseStiffness
        self.system = stated.system(problem, lambda: self.stiffness, self._stiffness_of)
        # a stiffness factored for each query: at 14,140 dofs and 162 conditions MUMPS takes 24 ms,
        # nd 45, qmd 70, and a solution for each condition 138, 272, 308 ms, which Schur complements
        # save; factors of bodies with laws are used for whole load paths
        anew = self.system.anew and not self.scene.reader
        # only S is needed if it is used once for each query, or if columns are not kept
        last = np.unique(problem.contact.indices) if anew or not self.keeps_columns else None
        ordering = "mumps" if anew else "qmd"
        self.store = FactorStore(lambda matrix: self.factors_of(matrix, ordering, last, anew=anew))
        self.stiffness = self._middle()
        self.problem, self.stiffness = stated.read(self.system, problem)
        with self.store.of(self.stiffness.matrix):  # refuses a K that is singular
            pass
        if self.keeps_columns:
            self.stiffness.response  # noqa: B018 (made before threads ask)
        self.pairs = Pairs.of(problem.contact_pairs)
        self.advice = dict(FULL_ORDER_ADVICE)
        if problem.kernel is not None:
            self.advice[Status.ADRIFT] = (
                f"hold it by a displacement, or push it: {problem.kernel.described}"
            )

    def _middle(self, **known: Any) -> SparseStiffness:
        """K in the middle of the box; ``response`` and S may be given if they are known."""
        problem = self.problem
        bodies = (
            None
            if self.system.bodies is None
            else [problem.spread.mine(body) for body in problem.bodies]
        )
        settings = {"components": bodies, "keeps": self.keeps_columns, "symmetric": False} | known
        return SparseStiffness(problem.own_stiffness, problem, self.store, **settings)

    def _stiffness_of(self, matrix: csr_matrix, problem: ContactProblem) -> SparseStiffness:
        """K of local rows of a matrix, (own dofs, N), with the rows of a problem."""
        stiffness = SparseStiffness(matrix, problem, self.store, keeps=self.keeps_columns)
        return stiffness.lent(self.stiffness) if matrix is self.stiffness.matrix else stiffness

    @property
    def fields(self) -> FullOrderModel:
        """Fields of its answers: the model itself."""
        return self

    @property
    def dimension(self) -> int:
        """Components of the displacement at a node."""
        return self.problem.block_size

    def __copy__(self) -> FullOrderModel:
        """Another model with the same factors."""
        model = object.__new__(type(self))
        vars(model).update(vars(self))
        return model

    def __reduce__(self) -> NoReturn:
        """Refuse to be pickled, with its answers: factors and mesh cannot be."""
        raise NotOfferedError(
            f"the full model of scene '{self.scene.name}' belongs to this process: hand on what "
            "its answers say, answer.displacement() and answer.forces(), and make a model from "
            "the scene where another is needed"
        )

    def gathered(self) -> FullOrderModel:
        """Model with all rows on each rank, whose factors the ranks share. Collective.

        For reduction and checks that all ranks do in the same way, as for bodies with laws.
        """
        if self.spread.all_here:
            return self
        request = f"the full model of scene '{self.scene.name}' with all of its rows"
        model: FullOrderModel = registry.tool("all_rows", request)(self)
        return model

    def factors_of(
        self,
        stiffness: csr_matrix,
        plane: str,
        last: np.ndarray | None = None,
        *,
        anew: bool = False,
    ) -> FreeCholesky:
        """Factors of a stiffness.

        Args:
            stiffness: its local rows, (own dofs, N).
            plane: ordering for problems in the plane.
            last: dofs to eliminate last, see :class:`~hhr_dolfinx.linear.sparse.FreeCholesky`.
            anew: True if factors are made for every parameter.
        """
        problem = self.problem
        ordering = ordering_of(problem.block_size, plane)
        low_rank = low_rank_of(problem.block_size, problem.free.size, anew=anew)
        if low_rank is not None:
            _log.info(
                "%d dofs in space: blocks of the factors are compressed to %g",
                problem.free.size,
                low_rank,
            )
        if problem.spread.all_here and self.group.size > 1:
            return self.group.factors(
                stiffness, problem.held, self.scene.name, low_rank=low_rank, last=last
            )
        rows = stiffness, problem.held, problem.rows, self.scene.name, ordering, self.comm
        return FreeCholesky(*rows, low_rank=low_rank, last=last)

    def _answered(
        self, point: np.ndarray, start: CheckedStart, outside: str, gradient: bool
    ) -> Answer:
        """Answer a point; a full model has no nearest statuses: ``nearest`` starts from the sign of
        the free slack.
        """
        start = None if isinstance(start, str) else start
        user_code = self.scene.system is not None
        with (
            self.group.together(f"solving scene '{self.scene.name}'")
            if user_code
            else nullcontext()
        ):
            answer = self.system.answer(point, start, self.pairs, self, gradient)
        if answer.converged:  # strains of an iterate of a search without an end mean nothing
            self.strains.look(answer)
        return answer

    def contacts(self) -> Callable[[np.ndarray], CondensedContact]:
        """See :class:`AnsweringModel`; an unchanged stiffness is the same object at the next
        point.
        """

        def made(point: np.ndarray) -> CondensedContact:
            at = self.system.at(point)
            with at.stiffness.held():  # threads at other points would factor K of each twice
                return at.contact()

        return made

    # fields of an answer, see models.answer.ModelFields

    def displacement(self, answer: Answer) -> np.ndarray:
        """U0 and the lift, (N,)."""
        return answer.unknown + self.problem.lifts @ self.problem.amplitudes(answer.parameter)

    def stress(self, answer: Answer) -> np.ndarray:
        """Stress in Kelvin's notation: in the middle of each cell, or where laws of bodies are
        evaluated.
        """
        if self.equilibrium is not None:
            return self.equilibrium.stress(answer)
        return self.stress_of(self.displacement(answer), answer.parameter)

    @property
    def full(self) -> FullOrderModel:
        """The model itself; see :class:`~hhr_dolfinx.models.answer.ModelFields`."""
        return self

    def answer_mesh(self) -> AnswerMesh:
        """See :class:`~hhr_dolfinx.models.answer.Meshed`. Collective."""
        return self.discretisation.answer_mesh(self.problem)

    def facts(self) -> dict[str, str]:
        """See :class:`~hhr_dolfinx.models.shown.Shown`."""
        return {"scene": f"scene '{self.scene.name}'", **super().facts()}

    def stress_of(self, displacement: np.ndarray, mu: PointLike | None = None) -> np.ndarray:
        """Elastic stress in the middle of each cell, Kelvin's notation, (cells, components).

        Args:
            displacement: the displacement, (N,).
            mu: parameters of the moduli; None for the middle of the box.
        """
        point = self.problem.middle if mu is None else self.parameters.point(mu)
        return self.discretisation.stress(displacement, point)

    def estimate(self, answer: Answer) -> Estimate | None:
        """Zero error: that of the mesh is not estimated; None without an answer."""
        return Estimate.exact(self.functionals) if answer.converged else None

    def measured(self, answer: Answer, theta: np.ndarray) -> np.ndarray:
        """Rows of the outputs times the displacement, (K,).

        Args:
            answer: an answer of the model.
            theta: amplitudes, (1 + T,).
        """
        assert self.functionals is not None
        return self.functionals.at(answer.parameter).measured(self.displacement(answer))

    def measured_changes(
        self, answer: Answer, changes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of all forces and of these products:
        :class:`~models.displacement.LinearDisplacement`.

        Args:
            answer: an answer with a gradient.
            changes: derivatives of the amplitudes, (1 + T, P).
        """
        assert self.functionals is not None
        forces, field = self.coordinate_changes(answer, changes)
        return forces, self.functionals.at(answer.parameter).measured(field)

    def coordinates(self, answer: Answer, theta: np.ndarray) -> np.ndarray:
        """The displacement, on which rows of outputs act where shapes are parameters.

        Args:
            answer: an answer of the model.
            theta: amplitudes, (1 + T,).
        """
        return self.displacement(answer)

    def coordinate_changes(
        self, answer: Answer, changes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of all forces and of the displacement.

        Args:
            answer: an answer with a gradient.
            changes: derivatives of the amplitudes, (1 + T, P).
        """
        assert answer.gradient is not None
        return answer.gradient.multipliers, answer.gradient.unknown + self.problem.lifts @ changes
