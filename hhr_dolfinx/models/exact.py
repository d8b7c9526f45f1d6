"""Fields of exact condensation: the displacement is a linear map of forces and loads."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Annotated

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx.amplitudes import Amplitudes, Theta
from hhr_dolfinx.declared import Floats
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.models.answer import Answer, ElasticFields, Meshed
from hhr_dolfinx.models.displacement import LinearDisplacement, dense
from hhr_dolfinx.models.estimates import Estimate
from hhr_dolfinx.plain import OF_THE_MESH, Rebuilt

if TYPE_CHECKING:
    from hhr_dolfinx.models.functionals.functional import Functionals


class _Exact(Rebuilt, LinearDisplacement, ElasticFields):
    """Fields of exact condensation: outputs act on forces, or on the displacement less its lift."""

    amplitudes: Amplitudes
    lifts: csc_matrix
    per_term: np.ndarray
    functionals: Functionals | None

    unbounded = "exact condensation has no reduction error"
    exact = True

    @property
    @abstractmethod
    def _reads_fields(self) -> bool:
        """True if outputs act on displacements."""

    @abstractmethod
    def _unknown(self, answer: Answer, theta: Theta) -> np.ndarray:
        """K^-1 (loads - B^T λ), (N,)."""

    def displacement(self, answer: Answer) -> np.ndarray:
        """K^-1 (loads - B^T λ) and the lift, (N,).

        NotOfferedError by a copy or a file without columns of K^-1 B^T.
        """
        theta = self.amplitudes(answer.parameter)
        return self._unknown(answer, theta) + self.lifts @ theta

    def estimate(self, answer: Answer) -> Estimate | None:
        """Zero error: the model is as exact as the full one."""
        return Estimate.exact(self.functionals) if answer.converged else None

    def _terms(self, rows: csr_matrix) -> np.ndarray:
        lifted = dense(rows @ self.lifts)
        return lifted if self._reads_fields else lifted + rows @ self.per_term


@dataclass(frozen=True)
class ExactFields(_Exact):
    """Fields of exact condensation with K^-1 B^T.

    See :class:`hhr_dolfinx.models.answer.ModelFields`.
    """

    amplitudes: Amplitudes  #: θ as a function of the parameters
    lifts: Annotated[csc_matrix, "N", "terms"]  #: imposed displacements, sparse, (N, 1 + T)
    per_force: Annotated[Floats, "N", "m"]  #: K^-1 B^T, (N, N_lambda)
    per_term: Annotated[Floats, "N", "terms"]  #: K^-1 loads, (N, 1 + T)
    dimension: int  #: components of the displacement at a node
    floats: bool = (
        False  # whether bodies have rigid motions, which only the unknown of an answer has
    )
    #: stress of a displacement; None of a copy or from a file, since a mesh belongs to one process
    stress_of: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = field(
        default=None, metadata=OF_THE_MESH
    )
    functionals: Functionals | None = None  #: outputs of the scene; None if it has none
    full: Meshed | None = field(default=None, metadata=OF_THE_MESH)  #: see ModelFields

    def without_columns(self) -> ExactFields | SolvedFields:
        """Fields with rows of outputs alone, instead of K^-1 B^T.

        The same for bodies with rigid motions, whose outputs read displacements, and for outputs
        with more rows than there are dofs, as a largest stress may have.
        """
        nothing = csr_matrix((0, self.per_force.shape[0]))
        rows = nothing if self.functionals is None else self.functionals.rows
        if self.floats or rows.shape[0] >= self.per_force.shape[0]:
            return self
        per_term = np.zeros_like(self.per_term)  # zeros take no room in a file
        per_term[rows.indices] = self.per_term[rows.indices]
        return SolvedFields(
            amplitudes=self.amplitudes,
            lifts=self.lifts,
            per_term=per_term,
            dimension=self.dimension,
            measured_per_force=-(rows @ self.per_force),
            functionals=self.functionals,
        )

    @property
    def conditions(self) -> int:
        """Number of contact conditions; the model keeps all."""
        return self.per_force.shape[1]

    @property
    def _reads_fields(self) -> bool:
        return self.floats

    def _unknown(self, answer: Answer, theta: Theta) -> np.ndarray:
        """Unknown of the answer if that has fields; otherwise it is computed."""
        return (
            answer.unknown
            if answer.unknown.size
            else self.per_term @ theta - self.per_force @ answer.multipliers
        )

    def _per_coordinate(self, rows: csr_matrix) -> csr_matrix | np.ndarray:
        return rows if self.floats else rows @ self.per_force

    def _coordinates(self, answer: Answer) -> np.ndarray:
        return answer.unknown if self.floats else -answer.multipliers

    def _coordinate_changes(self, answer: Answer, changes: np.ndarray) -> np.ndarray:
        assert answer.gradient is not None
        return answer.gradient.unknown if self.floats else -answer.gradient.multipliers


@dataclass(frozen=True)
class SolvedFields(_Exact):
    """Fields of exact condensation whose K^-1 B^T does not fit in memory.

    A displacement takes one full solve.

    Parts without a comment are those of :class:`ExactFields`.
    """

    amplitudes: Amplitudes
    lifts: Annotated[csc_matrix, "N", "terms"]
    per_term: Annotated[Floats, "N", "terms"]
    dimension: int
    #: rows of the outputs times -K^-1 B^T, (K, N_lambda). It has no rows if outputs have too many,
    #: as a largest stress has; outputs then evaluate displacements, one more solve each
    measured_per_force: Annotated[Floats, "rows of outputs", "m"]
    #: K^-1 B^T times forces; None of a copy or from a file, since factors belong to one process
    response_to_forces: Callable[[np.ndarray], np.ndarray] | None = field(
        default=None, metadata=OF_THE_MESH
    )
    stress_of: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = field(
        default=None, metadata=OF_THE_MESH
    )
    functionals: Functionals | None = None
    full: Meshed | None = field(default=None, metadata=OF_THE_MESH)

    @property
    def conditions(self) -> int:
        """Number of contact conditions; the model keeps all."""
        return self.measured_per_force.shape[1]

    @cached_property
    def _reads_fields(self) -> bool:
        assert self.functionals is not None
        return bool(self.functionals.rows.shape[0] != len(self.measured_per_force))

    def _unknown(self, answer: Answer, theta: Theta) -> np.ndarray:
        return self.per_term @ theta - self._response(answer.multipliers)

    @property
    def _response(self) -> Callable[[np.ndarray], np.ndarray]:
        if self.response_to_forces is None:
            raise NotOfferedError(
                "a model that was copied or read from a file has no factors, and where the "
                "columns of K^-1 B^T have no room, or were left out, a displacement needs them: "
                "ask the model where it was made, or the full one, full.solve(mu)"
            )
        return self.response_to_forces

    def _per_coordinate(self, rows: csr_matrix) -> csr_matrix | np.ndarray:
        return rows if self._reads_fields else self.measured_per_force

    def _coordinates(self, answer: Answer) -> np.ndarray:
        if self._reads_fields:
            return self._unknown(answer, self.amplitudes(answer.parameter))
        return answer.multipliers

    def _coordinate_changes(self, answer: Answer, changes: np.ndarray) -> np.ndarray:
        assert answer.gradient is not None
        forces = answer.gradient.multipliers
        return self.per_term @ changes - self._response(forces) if self._reads_fields else forces
