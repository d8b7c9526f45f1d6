"""Interface of the full-order model, for modules that check, store and reduce its answers.

They read arrays of the contact problem and solve with its factors, and never see the mesh. The model itself is
:class:`hhr_dolfinx.full_order.full.FullOrderModel`; another one with these members serves as well.

Sizes: N dofs, n of them on this rank; N_lambda contact conditions; 1 + T terms of θ; P parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Protocol, cast

import numpy as np

from hhr_dolfinx.models.answer import Answer, Fields, History, Model, Path, SeveralAnswers
from hhr_dolfinx.models.histories.equilibrium import FullEquilibrium, MarchSettings
from hhr_dolfinx.trained import USUAL

if TYPE_CHECKING:
    from mpi4py.MPI import Comm
    from scipy.sparse import csr_matrix

    from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, Status
    from hhr_dolfinx.contact.law import ContactLaw
    from hhr_dolfinx.contact.problem import ContactProblem, ScaledBodies
    from hhr_dolfinx.contact.stiffness import FactorStore, SparseStiffness, Stiffness
    from hhr_dolfinx.group import Group
    from hhr_dolfinx.linear.rows import Rows
    from hhr_dolfinx.linear.sparse import FreeCholesky
    from hhr_dolfinx.models.functionals.functional import Functionals, ShapeFunctionals
    from hhr_dolfinx.models.strains import StrainGuard
    from hhr_dolfinx.parameters import ParameterSpace, PointLike, PointsLike


class Equations(Protocol):
    """Dependence of the equations on parameters."""

    @property
    def bodies(self) -> ScaledBodies | None:
        """Moduli of whole bodies, if nothing else of K varies; None otherwise."""

    def stiffness(self, point: np.ndarray) -> Stiffness:
        """K at a point, (P,)."""


class NamedScene(Protocol):
    """The scene of a model, as messages need it."""

    @property
    def name(self) -> str:
        """Name of the scene."""


class FullModel(Fields, Model, Protocol):
    """The full-order model: solves points and paths, completes its own answers, and lends its factors."""

    @property
    def scene(self) -> NamedScene:
        """The scene."""

    @property
    def comm(self) -> Comm:
        """Ranks that call the model together."""

    @property
    def problem(self) -> ContactProblem:
        """The algebraic contact problem; on several ranks each has the rows of its dofs."""

    @property
    def parameters(self) -> ParameterSpace:
        """The box of the parameters."""

    @property
    def system(self) -> Equations:
        """The equations at any point."""

    @property
    def stiffness(self) -> SparseStiffness:
        """K, if it is constant; otherwise K in the middle of the box."""

    @property
    def store(self) -> FactorStore:
        """Factors of K."""

    @property
    def schur(self) -> np.ndarray:
        """S = B K^-1 B^T of this K, (N_lambda, N_lambda)."""

    @property
    def equalities(self) -> SchurEqualities:
        """Equality problems on this S."""

    @property
    def per_force(self) -> np.ndarray:
        """K^-1 B^T, (n, N_lambda)."""

    @property
    def per_load(self) -> np.ndarray:
        """K^-1 loads, (n, 1 + T)."""

    @property
    def keeps_columns(self) -> bool:
        """True if K^-1 B^T has room in memory."""

    @property
    def functionals(self) -> Functionals | ShapeFunctionals | None:
        """Outputs of the scene; None if it has none."""

    @property
    def equilibrium(self) -> FullEquilibrium | None:
        """Equilibrium of bodies with laws; None if all bodies are elastic."""

    @property
    def law(self) -> ContactLaw:
        """Law of the contact conditions."""

    @property
    def strains(self) -> StrainGuard:
        """Check that strains in its answers are small."""

    @property
    def group(self) -> Group:
        """Processes that have the model together."""

    @property
    def spread(self) -> Rows:
        """Rows of this rank, and sums over ranks."""

    @property
    def conditions(self) -> int:
        """Number of contact conditions, N_lambda."""

    @property
    def sizes(self) -> tuple[int, int]:
        """Numbers of dofs and of contact conditions of an answer."""

    @property
    def pairs(self) -> Pairs | None:
        """Conditions by contact pair."""

    @property
    def advice(self) -> Mapping[Status, str]:
        """Remedy for each status, for messages."""

    def march(
        self,
        path: Path,
        settings: MarchSettings = ...,
        *,
        known: list[Answer] | tuple[()] = (),
        keep: Callable[[Answer], None] = ...,
    ) -> History:
        """Answer a path from rest, see :meth:`Model.march`.

        ``known`` are answers to its first steps, solved before; ``keep`` is called with each new one.
        """

    def solve_many(self, points: PointsLike, *, raise_on_failure: bool = True, outside: str = USUAL) -> SeveralAnswers:
        """Answer many parameters, (k, P), one by one."""

    def gathered(self) -> FullModel:
        """The same model with all rows on each rank, where the ranks share the factors. Collective."""

    def stress_of(self, displacement: np.ndarray, mu: PointLike | None = None) -> np.ndarray:
        """Elastic stress of a displacement, (N,), at cell midpoints in Kelvin's notation, (cells, components)."""

    def areas(self, mu: PointLike) -> np.ndarray:
        """Tributary areas of the contact conditions at a parameter, (N_lambda,)."""

    def pushed_everywhere(self, forces: np.ndarray) -> np.ndarray:
        """K^-1 B^T times forces, (N_lambda,) or (N_lambda, k), on all dofs, (N,) or (N, k). Collective."""

    def pressed(self, rows: csr_matrix) -> np.ndarray:
        """Some rows, (k, N), times K^-1 B^T, (k, N_lambda). Collective."""

    def has_room(self, rows: int) -> bool:
        """True if an array with so many rows, and a column for each condition, may be kept."""

    def factors_of(
        self, stiffness: csr_matrix, plane: str, last: np.ndarray | None = None, *, anew: bool = False
    ) -> FreeCholesky:
        """Factors of own rows of a stiffness, (n, N), with an ordering for plane problems."""


def plain_outputs(full: FullModel) -> Functionals | None:
    """Outputs of a scene without shape parameters, which are plain data; None if it has none."""
    assert full.problem.reshaped is None
    return cast("Functionals | None", full.functionals)
