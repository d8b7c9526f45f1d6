"""The full-order model as modules see it that check, store and reduce its answers.

They read arrays of the contact problem and solve with its factors, and never see the mesh. The
model itself is :class:`hhr_dolfinx.full_order.full.FullOrderModel`.

Sizes: N dofs, n of them on this rank; N_lambda contact conditions; 1 + T terms of θ; P parameters.
"""

from __future__ import annotations

import logging
from abc import abstractmethod
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, cast

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx.models.answer import Answer, ElasticFields, History, Path, SeveralAnswers
from hhr_dolfinx.models.histories.equilibrium import (
    DEFAULT_MARCH,
    FullEquilibrium,
    MarchSettings,
)
from hhr_dolfinx.models.histories.path import check_settings, checked_path
from hhr_dolfinx.models.model import AnsweringModel

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

    from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities
    from hhr_dolfinx.contact.problem import ContactProblem, ScaledBodies
    from hhr_dolfinx.contact.stiffness import FactorStore, SparseStiffness, Stiffness
    from hhr_dolfinx.group import ProcessGroup
    from hhr_dolfinx.linear.rows import Rows
    from hhr_dolfinx.linear.sparse import FreeCholesky
    from hhr_dolfinx.models.answer_mesh import AnswerMesh
    from hhr_dolfinx.models.functionals.functional import AllOutputs, Functionals
    from hhr_dolfinx.parameters import PointLike, PointsLike


_log = logging.getLogger(__name__)
Checked = TypeVar("Checked", bound=AnsweringModel)

RESPONSE_BYTES = 1e9
"""Memory that K^-1 B^T may take; if it would take more its columns are dropped after use."""


class Equations(Protocol):
    """Dependence of the equations on parameters."""

    bodies: (
        ScaledBodies | None
    )  #: moduli of whole bodies, if nothing else of K varies; None otherwise

    def stiffness(self, point: np.ndarray) -> Stiffness:
        """K at a point, (P,)."""


class Guard:
    """Check that strains in answers of a full model are small, which does nothing here.

    A plug-in derives one, its tool ``small_strains``, made with the problem and whether strains
    have a hoop component.
    """

    def __init__(self, problem: ContactProblem, *, axisymmetric: bool):
        pass

    def paused(self) -> AbstractContextManager[None]:
        """Suspend the check in a block whose caller checks all answers at once."""
        return nullcontext()

    def look(self, answer: Answer) -> None:
        """Check an answer of the full model."""

    def check(self, full: FullModel, *sets: Any) -> None:
        """Check sets of answers.

        Args:
            full: the full model.
            *sets: :class:`~hhr_dolfinx.snapshots.records.SnapshotSet` or None each.
        """

    def corners(self, full: FullModel, model: Checked) -> Checked:
        """Check a model in corners of its parameter range.

        The model, with a limit if it is off there.

        Args:
            full: the full model.
            model: the model to check.

        Returns:
            The model, with a limit if it is off there.
        """
        return model


class FullModel(AnsweringModel, ElasticFields):
    """The full-order model.

    It solves points and paths, completes its own answers, and lends its factors.
    """

    scene: Any  #: messages need its name
    group: ProcessGroup  #: processes that have the model together
    #: the algebraic contact problem; on several ranks each has the rows of its dofs
    problem: ContactProblem
    system: Equations  #: the equations at any point
    stiffness: SparseStiffness  #: K, if it is constant; otherwise K in the middle of the box
    store: FactorStore  #: factors of K, leased by K of this and other points
    #: whether K^-1 B^T has room in memory; else S is made at its first use, and a displacement
    #: takes one more solution
    keeps_columns: bool
    functionals: AllOutputs | None  #: outputs of the scene; None if it has none
    equilibrium: FullEquilibrium | None = (
        None  # equilibrium of bodies with laws; None if all bodies are elastic
    )
    strains: Guard  #: check that strains in its answers are small
    pairs: Pairs | None  #: conditions by contact pair

    @property
    def comm(self) -> Comm:
        """MPI communicator; calls are collective."""
        return self.group.comm

    @property
    def spread(self) -> Rows:
        """Rows of this rank, and sums over ranks."""
        return self.problem.spread

    @property
    def conditions(self) -> int:
        """Number of contact conditions, N_lambda."""
        return len(self.problem.gaps)

    @property
    def sizes(self) -> tuple[int, int]:
        """Numbers of dofs and of contact conditions of an answer."""
        return len(self.problem.free), self.conditions

    @cached_property
    def schur(self) -> np.ndarray:
        """S = B K^-1 B^T of this K, (N_lambda, N_lambda)."""
        with self.group.together(f"making S of scene '{self.scene.name}'"):
            return self.stiffness.schur

    @cached_property
    def equalities(self) -> SchurEqualities:
        """Equality problems on this S, whose factors are shared by queries."""
        self.schur  # noqa: B018 (an error is raised on all ranks)
        return self.stiffness.equalities

    @cached_property
    def per_load(self) -> np.ndarray:
        """K^-1 loads on the dofs of this rank, (n, 1 + T), of a constant K: input of all bounds."""
        return self.stiffness.columns(self.problem.loads[self.problem.rows])

    def pushed_everywhere(self, forces: np.ndarray) -> np.ndarray:
        """K^-1 B^T times forces, (N_lambda,) or (N_lambda, k), on all dofs, (N,) or (N, k).

        Collective.
        """
        return self.spread.whole(self.stiffness.response_to_forces(forces))

    def pressed(self, rows: csr_matrix) -> np.ndarray:
        """Some rows, (k, N), times K^-1 B^T, (k, N_lambda); as K is symmetric, B times K^-1 rows^T.

        Collective.
        """
        if not rows.shape[0]:
            return np.zeros((0, self.conditions))
        local = csr_matrix(rows)[:, self.problem.rows]
        if self.stiffness.has_response:
            return self.spread.sum(local @ self.stiffness.response)
        return self.problem.contact_rows_times(self.stiffness.columns(csc_matrix(local.T))).T

    @property
    def per_force(self) -> np.ndarray:
        """K^-1 B^T, (n, N_lambda), of a constant K or that of the middle of the box.

        If it is not kept it is computed, and kept afterwards: it may be larger than everything
        else.
        """
        if not self.stiffness.has_response:
            _log.warning(
                "K^-1 B^T is solved for and kept: %.1f GB",
                8e-9 * self.problem.free.size * self.conditions,
            )
        return self.stiffness.response

    def solve_many(self, points: PointsLike, **how: Any) -> SeveralAnswers:
        """Answer many parameters, see :meth:`AnsweringModel.solve_many`; the same on all ranks.

        Args:
            points: parameters, (n, P).
            **how: see :meth:`AnsweringModel.solve_many`.
        """
        self.agree("solve_many", lambda: self.parameters.points(points), **how)
        return super().solve_many(points, **how)

    def march(
        self,
        path: Path,
        settings: MarchSettings = DEFAULT_MARCH,
        *,
        known: list[Answer] | tuple[()] = (),
        keep: Callable[[Answer], None] = lambda answer: None,
    ) -> History:
        """Answer a path from rest, see :meth:`Model.march`.

        Args:
            path: times and parameters.
            settings: settings of the solution.
            known: answers to the first steps, solved before.
            keep: called with each new answer.
        """
        checked: Path = []

        def steps() -> np.ndarray:
            check_settings(settings)
            checked[:] = checked_path(self.parameters, path)
            return np.array([(time, *point) for time, point in checked])

        if self.group.size > 1:
            self.agree("march", steps, settings=settings)
        else:
            steps()

        def keep_small(answer: Answer) -> None:
            if (
                self.equilibrium is None
            ):  # steps of bodies with laws are looked at as they are solved
                self.strains.look(answer)
            keep(answer)

        return self.follow(checked, settings, known=known, keep=keep_small)

    @property
    def shared(self) -> bool:
        """See :class:`AnsweringModel`."""
        return self.group.size > 1

    def agree(self, call: str, points: Callable[[], np.ndarray], **how: Any) -> None:
        """Compare the calls of all ranks.

        Args:
            call: name of the method.
            points: returns its points, (n, P), or points with their times, (n, 1 + P).
            **how: further arguments of the call.

        Raises:
            RankError: on all ranks, if they call it differently.
        """
        if self.group.size == 1:
            return

        def request() -> list[str | np.ndarray]:
            table = points()
            last = (
                self.parameters.described(table[-1][-len(self.parameters.names) :])
                if len(table)
                else "no point"
            )
            words = (
                f"{call} at {last}"
                if len(table) < 2
                else f"{call} at {len(table)} points, the last {last}"
            )
            values = (
                value if isinstance(value, np.ndarray) else f"{name}={value!r}"
                for name, value in how.items()
            )
            return [words, table, *values]

        self.group.agreed(f"the full model of scene '{self.scene.name}'", request)

    @abstractmethod
    def gathered(self) -> FullModel:
        """Full model with all rows on each rank, where the ranks share factors. Collective."""

    @abstractmethod
    def stress_of(self, displacement: np.ndarray, mu: PointLike | None = None) -> np.ndarray:
        """Elastic stress at cell midpoints in Kelvin's notation, (cells, components).

        Args:
            displacement: displacement, lift included, (N,).
            mu: parameter, for its moduli; None for the middle of the box.
        """

    @abstractmethod
    def answer_mesh(self) -> AnswerMesh:
        """See :class:`~hhr_dolfinx.models.answer.Meshed`. Collective."""

    def areas(self, mu: PointLike) -> np.ndarray:
        """Tributary areas of the contact conditions at a parameter, (N_lambda,).

        Shapes may depend on it.
        """
        shaped = self.problem.reshaped
        return (self.problem if shaped is None else shaped(self.parameters.point(mu))).contact_areas

    def has_room(self, rows: int) -> bool:
        """True if an array with so many rows, and a column for each condition, may be kept."""
        return 8 * rows * self.conditions <= RESPONSE_BYTES

    @abstractmethod
    def factors_of(
        self,
        stiffness: csr_matrix,
        plane: str,
        last: np.ndarray | None = None,
        *,
        anew: bool = False,
    ) -> FreeCholesky:
        """Factors of own rows of a stiffness, (n, N), with an ordering for plane problems.

        Args:
            stiffness: local rows of the matrix, (n, N).
            plane: name of the ordering for plane problems.
            last: dofs between which K^-1 is needed, increasing; None for none.
            anew: True if factors are made for every parameter.
        """


def plain_outputs(full: FullModel) -> Functionals | None:
    """Outputs of a scene as plain data.

    None without any, and if shapes are parameters, which change them.
    """
    return (
        None if full.problem.reshaped is not None else cast("Functionals | None", full.functionals)
    )
