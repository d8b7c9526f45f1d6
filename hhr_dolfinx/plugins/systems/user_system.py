"""User-defined system, ``Scene(system=...)``: its K, its parts, and the motions of bodies that it
leaves.

A user-defined system gives K of all dofs, and F - K L on those that are not imposed. It knows
nothing of constraints and springs: these are added to its equations (:mod:`.restricted`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, issparse

from hhr_dolfinx.contact.problem import ContactProblem, strained
from hhr_dolfinx.contact.stiffness import SparseStiffness
from hhr_dolfinx.errors import HHRError, NotSolvableError, SceneError, SceneWarning
from hhr_dolfinx.formulas import Formula
from hhr_dolfinx.full_order.free_bodies import FreeBody
from hhr_dolfinx.full_order.system import SummedSystem, System, SystemAt
from hhr_dolfinx.group import ProcessGroup
from hhr_dolfinx.plugins.elasticity.unresisted import unresisted
from hhr_dolfinx.plugins.systems.parts import check_parts, check_symmetric, samples
from hhr_dolfinx.plugins.systems.restricted import (
    OfAllDofs,
    Restricted,
    own_loads,
    problem_of_all_dofs,
)
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    from hhr_dolfinx.formulas import Modulus
    from hhr_dolfinx.full_order.system import Made, Middle

Solved = TypeVar("Solved")
"""Kind of system that is made of a K."""


@dataclass(frozen=True, eq=False)
class UserSystem:
    """The tool ``systems``: see :class:`~hhr_dolfinx.full_order.system.StatedSystem`.

    Attributes:
        scene: the scene.
        stiffness: local rows of the parts of K of its bodies, of all dofs and without springs,
            (own, N) each.
        springs: stiffness to ground of each dof, (N,); None without.
    """

    scene: Scene
    stiffness: tuple[csr_matrix, ...]
    springs: np.ndarray | None

    def left_free(self, bodies: list[FreeBody], problem: ContactProblem) -> list[FreeBody]:
        """Bodies with the motions that K leaves, such as that of a foundation.

        Args:
            bodies: bodies with motions that contact, springs and displacements do not resist.
            problem: the contact problem.

        Raises:
            NotSolvableError: for motions that K leaves in the middle of the box and resists at
                other points: they are unknowns of all answers, or of none.
        """
        if not bodies:
            return bodies
        with self._of_user(problem.group):
            user_system = self._of_all_dofs(problem)
            unheld = _unresisted(bodies, problem, user_system.at(problem.middle))
            count = sum(len(body.left) for body in unheld)
            for point in samples(problem.parameters)[1:] if unheld else ():
                unheld_here = _unresisted(unheld, problem, user_system.at(point))
                if sum(len(body.left) for body in unheld_here) < count:
                    raise NotSolvableError(
                        f"{unheld[0].name} can move freely in the middle of the box: it "
                        f"{unheld[0].described(unheld[0].left)}, and the system of the scene "
                        f"resists that at {problem.parameters.described(point)}. Choose a "
                        "box in which K always resists it, or hold the body by a displacement"
                    )
        return unheld

    def system(self, problem: ContactProblem, middle: Middle, made: Made) -> System:
        """The system of a problem, with its constraints and springs.

        Args:
            problem: the contact problem.
            middle: K in the middle of the box.
            made: makes K from a matrix.

        Raises:
            SceneError: for a system that scales K of each body, with constraints or springs.
        """
        with self._of_user(problem.group):
            if problem.prolongation.map is None and self.springs is None:
                return self._given(problem, middle, self._with_pattern(problem, made))
            user_system = self._of_all_dofs(problem)
            if user_system.bodies is not None:
                raise SceneError(
                    f"the system of scene '{self.scene.name}' scales K of each body, and "
                    "constraints and springs act on K of all: make that by made(), with bodies = "
                    "None"
                )
            return Restricted(user_system, problem, self.scene.name, self.springs, made)

    def read(
        self, system: System, problem: ContactProblem
    ) -> tuple[ContactProblem, SparseStiffness]:
        """The problem with the parts of the system, which are compared, and K in the middle.

        Args:
            system: the system of the problem.
            problem: the contact problem.

        Raises:
            SceneError: if K is not made by ``made`` or not symmetric, or if parts differ from
                equations.
        """
        name = self.scene.name
        with self._of_user(problem.group):
            at = system.at(problem.middle)
            own_loads(at.loads, problem, name)
            if not isinstance(at.stiffness, SparseStiffness):
                raise SceneError(
                    f"the system of scene '{name}' has K = {at.stiffness!r}: make it by made()"
                )
            stated_problem, user_system = self._compared(system, problem)
            stated = user_system.parts()
            terms = system.parts_of_all_dofs() if isinstance(system, Restricted) else stated
            if stated is not None:
                _warn_of_moduli(self.scene, stated[0])
                stated_problem = _with_parts(stated_problem, *stated)
            for point in samples(problem.parameters):
                equations = user_system.at(point)
                matrix = _matrix_of(equations, name)
                check_symmetric(equations, matrix, name)
                if stated is not None:
                    check_parts(equations, matrix, stated_problem, name)
            return _with_parts(problem, *(terms or ((), ()))), at.stiffness

    def _compared(self, system: System, problem: ContactProblem) -> tuple[ContactProblem, System]:
        """The system as the user made it, and its problem."""
        if isinstance(system, Restricted):
            return problem_of_all_dofs(problem, self.stiffness), system.given
        return problem, system

    def _of_all_dofs(self, problem: ContactProblem) -> System:
        """The system as if no dof depended on others."""
        problem_of_all = problem_of_all_dofs(problem, self.stiffness)
        middle = OfAllDofs(problem_of_all.own_stiffness)
        make = self._with_pattern(problem_of_all, lambda matrix, _: OfAllDofs(matrix))
        return self._given(problem_of_all, lambda: middle, make)

    def _given(self, *given: Any) -> System:
        """System that the user makes of the arguments.

        Raises:
            SceneError: if it is no system.
        """
        assert self.scene.system is not None
        system = self.scene.system(*given)
        if not isinstance(system, System):
            raise SceneError(
                f"the system of a scene made {system!r}: it must make a System of the package"
            )
        if isinstance(system, SummedSystem):
            _check_terms(system.problem, given[0], self.scene.name)
        return system

    def _with_pattern(
        self, problem: ContactProblem, made: Callable[[csr_matrix, ContactProblem], Solved]
    ) -> Callable[[csr_matrix, ContactProblem], Solved]:
        """``made`` for matrices with the pattern of K of the bodies alone."""
        pattern = problem.own_stiffness

        def checked(matrix: csr_matrix, problem: ContactProblem) -> Solved:
            """System of a problem with K, the matrix.

            Raises:
                SceneError: for a K with another pattern.
            """
            same = matrix.shape == pattern.shape and matrix.nnz == pattern.nnz
            if not (same and np.array_equal(matrix.indices, pattern.indices)):
                raise SceneError(
                    "K of a user's system must have the pattern of K of the bodies: add numbers "
                    "to its data"
                )
            return made(matrix, problem)

        return checked

    @contextmanager
    def _of_user(self, group: ProcessGroup) -> Iterator[None]:
        """On several ranks errors of a system name the ranks; on one they keep their traceback."""
        try:
            yield
        except HHRError:
            raise
        except Exception as error:
            if group.size == 1:
                raise
            raise SceneError(
                f"the system of scene '{self.scene.name}' fails on {group.size} ranks, "
                f"{type(error).__name__}: {error}. Each rank has some rows: K (own, N) and loads "
                "(own,) of problem.rows are needed; or solve on one rank, "
                "FullOrderModel(scene, MPI.COMM_SELF)"
            ) from error


def _matrix_of(at: SystemAt, name: str) -> csr_matrix:
    """Local rows of K at a point, (own, N).

    Raises:
        SceneError: for a K that ``made`` did not make.
    """
    matrix: csr_matrix | None = getattr(at.stiffness, "matrix", None)
    if matrix is None:
        raise SceneError(
            f"the system of scene '{name}' has K = {at.stiffness!r}: make it by made()"
        )
    return matrix


def _check_terms(summed: ContactProblem, given: ContactProblem, name: str) -> None:
    """Raise SceneError for terms of a sum that do not go together.

    Or for terms that are not in the pattern of K of the bodies.
    """
    terms = summed.stiffness_terms
    pattern = given.own_stiffness
    if len(summed.moduli) not in (0, len(terms)):
        raise SceneError(
            f"the system of scene '{name}' has {len(summed.moduli)} weights of {len(terms)} "
            "matrices"
        )
    if any(modulus.names != given.parameters.names for modulus in summed.moduli):
        raise SceneError(
            f"weights of the system of scene '{name}' must name all parameters: "
            "problem.parameters.names"
        )
    for term in terms:
        if not issparse(term) or (term.shape, term.nnz) != (pattern.shape, pattern.nnz):
            raise SceneError(
                f"a matrix of the system of scene '{name}' is no csr_matrix in the pattern of K "
                "of the bodies: give it the numbers of all entries there, also zeros"
            )


def _warn_of_moduli(scene: Scene, weights: Iterable[Modulus]) -> None:
    """Warn of parameters in moduli of bodies that no weight of a system names.

    They may be those of stresses alone.
    """
    named = {
        name
        for weight in weights
        for text in (weight.factor, weight.rest)
        for name in Formula(text).variables
    }
    texts = [
        text
        for body in scene.bodies
        for text in (body.young, body.poisson)
        if isinstance(text, str)
    ]
    if missing := sorted({name for text in texts for name in Formula(text).variables} - named):
        warn(
            f"moduli of bodies of scene '{scene.name}' depend on {', '.join(missing)}, and K of "
            "its system does not: take problem.moduli and problem.stiffness_terms into it, unless "
            "they are those of stresses alone",
            SceneWarning,
        )


def _with_parts(
    problem: ContactProblem, moduli: Sequence[Modulus], matrices: Sequence[csr_matrix]
) -> ContactProblem:
    """The problem with the parts of K of all dofs, local rows (own, N) each. Collective."""
    prolongation = problem.prolongation
    # as in Discretisation.contact_problem: motions of dependent dofs may be rigid
    pull = csr_matrix.__matmul__ if prolongation.map is None else strained
    pulls = (problem.stacked(csr_matrix(pull(matrix, problem.lifts))) for matrix in matrices)
    return replace(
        problem,
        moduli=tuple(moduli),
        stiffness_terms=prolongation.stiffness(matrices, problem.rows, problem.group)
        if matrices
        else (),
        pulls=tuple(csc_matrix(matrix) for matrix in pulls),
    )


def _unresisted(bodies: list[FreeBody], problem: ContactProblem, at: SystemAt) -> list[FreeBody]:
    """Bodies with the motions along which K does no work."""
    return unresisted(bodies, problem, _matrix_of(at, ""))
