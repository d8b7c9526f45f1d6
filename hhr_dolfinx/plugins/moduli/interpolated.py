"""Interpolated condensation: S(mu) and the free slack of a scene whose stiffness depends on
parameters.

Bodies interact through contact alone, so that S = sum of S_c over connected components c, each
smooth in the parameters of that component. If a whole part has one factor E(mu), S_c = S_c(E = 1) /
E exactly. The remaining dependence is interpolated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, Protocol

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.contact.active_set import SchurEqualities
from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.errors import NotOfferedError, NotSolvableError, ParameterError
from hhr_dolfinx.linear.dense import LapackLU
from hhr_dolfinx.models.answer import Answer, ElasticFields, Meshed, SeveralAnswers, unanswered
from hhr_dolfinx.models.bound import Bound
from hhr_dolfinx.models.displacement import LinearDisplacement, dense
from hhr_dolfinx.models.eliminations.block import BlockElimination
from hhr_dolfinx.models.eliminations.elimination import CondensedContact, Elimination
from hhr_dolfinx.models.estimates import Estimate, Estimates
from hhr_dolfinx.plain import OF_THE_MESH, Rebuilt
from hhr_dolfinx.plugins.moduli.interpolation import Interpolant
from hhr_dolfinx.plugins.moduli.known_forces import KnownForces

if TYPE_CHECKING:
    from hhr_dolfinx.formulas import Scalar
    from hhr_dolfinx.models.condensed import CondensedModel
    from hhr_dolfinx.models.functionals.functional import AllOutputs
    from hhr_dolfinx.models.many import ManyAnswers
    from hhr_dolfinx.plugins.moduli.shaped import ReshapedElimination


TOGETHER_BYTES = 4e6
"""Memory of matrices S that are computed at once."""
NEW_STIFFNESS_SHARE = 0.5
"""Share of points with a new stiffness from which on S is computed for many of them at once."""


@dataclass(frozen=True)
class PrimalModes:
    """Modes of the displacement of one part, along the modes of its compliance."""

    unknowns: Annotated[Integers, "unknowns"]  #: indices of its unknowns, (n_c,)
    #: modes of K^-1 B^T, (r, n_c, m_c)
    pushed: Annotated[Floats, "modes", "unknowns", "conditions"]
    #: of K^-1 F, then of K^-1 K lift
    columns: Annotated[Floats, "terms of it", "unknowns", "modes"]


class Factored(NamedTuple):
    """The compliance 1 / E of a part, and its derivatives along the parameters, (P,)."""

    compliance: float
    slopes: np.ndarray


@dataclass(frozen=True)
class Compliance:
    """Interpolated compliance of one connected component of a scene."""

    conditions: Annotated[
        Integers, "conditions"
    ]  #: contact conditions that act on it, (m_c,), increasing
    forced: Annotated[Integers, "forced", "< terms"]  #: terms of θ whose loads act on it, (T_F,)
    lifted: Annotated[
        Integers, "lifted", "< terms"
    ]  #: terms whose imposed displacements act on it, (T_L,)
    factor: Scalar | None  #: modulus common to all of it; None without one, or for a constant one
    interpolant: Interpolant  #: of S_c for the factor 1, (m_c^2, r) modes
    columns: Annotated[
        Floats, "terms of it", "conditions", "modes"
    ]  #: of B K^-1 F, then of B K^-1 K lift
    primal: PrimalModes | None = (
        None  # modes of its unknown; None if fields are computed in another way
    )

    @cached_property
    def where(self) -> slice | np.ndarray:
        """Its conditions, as a slice if they are contiguous, which is several times as fast."""
        first = self.conditions[0]
        last = self.conditions[-1]
        return (
            slice(first, last + 1) if last - first + 1 == self.conditions.size else self.conditions
        )

    @cached_property
    def block(self) -> tuple[slice, slice] | tuple[np.ndarray, ...]:
        """Index of S_c in S."""
        return (
            (self.where, self.where)
            if isinstance(self.where, slice)
            else np.ix_(self.conditions, self.conditions)
        )

    @cached_property
    def terms(self) -> np.ndarray:
        """Terms forced and lifted, (T_F + T_L,)."""
        return np.concatenate([self.forced, self.lifted])

    def compliance(self, point: np.ndarray) -> float:
        """1 / E, which is positive wherever amplitudes are evaluated.

        See :class:`~hhr_dolfinx.amplitudes.Limits`.
        """
        return 1.0 if self.factor is None else 1.0 / self.factor.value(point)

    def compliances(self, points: np.ndarray) -> np.ndarray:
        """1 / E at many points, (n, P): (n,)."""
        return np.ones(len(points)) if self.factor is None else 1.0 / self.factor.values(points)

    def factored(self, point: np.ndarray) -> Factored:
        """1 / E at a point and its derivatives."""
        if self.factor is None:
            return Factored(1.0, np.zeros(point.size))
        modulus = self.factor.value(point)
        return Factored(1.0 / modulus, -self.factor.derivative(point) / modulus**2)

    def schur(self, along: np.ndarray) -> np.ndarray:
        """S_c for the factor 1, from components along the modes, (..., r): (..., m_c, m_c)."""
        m = self.conditions.size
        return (along @ self.interpolant.modes.T).reshape(*along.shape[:-1], m, m)

    def load_response(
        self, columns: np.ndarray, along: np.ndarray, theta: np.ndarray, compliance: float
    ) -> np.ndarray:
        """Columns of F minus those of K lift.

        Load terms scale with 1/E; terms of imposed displacements do not.

        Args:
            columns: columns of F, then of K lift, (T, rows, r).
            along: components along the modes, (r,).
            theta: θ, (1 + T,).
            compliance: 1 / E.
        """
        weights = theta[self.terms]
        weights[: self.forced.size] *= compliance
        weights[self.forced.size :] *= -1.0
        # a partial pressure has hundreds of columns, of which three are non-zero
        used = weights.nonzero()[0]
        return weights[used] @ (columns[used] @ along) if used.size else np.zeros(columns.shape[1])

    def load_responses(
        self, along: np.ndarray, theta: np.ndarray, compliances: np.ndarray
    ) -> np.ndarray:
        """Load responses of its columns at many points, (n, m_c).

        Args:
            along: components along the modes, (n, r).
            theta: θ, (n, 1 + T).
            compliances: 1 / E of each point, (n,).
        """
        weights = theta[:, self.terms]
        weights[:, : self.forced.size] *= compliances[:, None]
        weights[:, self.forced.size :] *= -1.0
        responses = np.zeros((len(theta), self.conditions.size))
        for term in np.flatnonzero(weights.any(axis=0)):
            rows = np.flatnonzero(weights[:, term])
            responses[rows] += weights[rows, term, None] * (along[rows] @ self.columns[term].T)
        return responses

    def load_response_slopes(
        self,
        columns: np.ndarray,
        ways: np.ndarray,
        theta: np.ndarray,
        changes: np.ndarray,
        factor: Factored,
    ) -> np.ndarray:
        """Derivatives of :meth:`load_response` along the parameters, (rows, P).

        Args:
            columns: columns of F, then of K lift, (T, rows, r).
            ways: components along the modes and their derivatives along the axes, (r, 1 + d).
            theta: θ, (1 + T,).
            changes: derivatives of θ, (1 + T, P).
            factor: 1 / E and its derivatives.
        """
        # terms that act or change; hundreds of others may do neither
        used = np.flatnonzero(theta[self.terms].astype(bool) | changes[self.terms].any(axis=1))
        values = np.moveaxis(columns[used] @ ways, 0, 2)
        terms = self.terms[used]
        forced = used < self.forced.size
        scales = np.where(forced, factor.compliance, -1.0)
        slopes = np.outer(values[:, 0] @ (theta[terms] * forced), factor.slopes)
        slopes += values[:, 0] @ (scales[:, None] * changes[terms])
        slopes[:, self.interpolant.axes] += values[:, 1:] @ (scales * theta[terms])
        return slopes

    def force_response_slopes(
        self, modes: np.ndarray, ways: np.ndarray, factor: Factored
    ) -> np.ndarray:
        """Derivatives of the compliance times responses to forces, (rows, P).

        Args:
            modes: responses along the modes, (rows, r).
            ways: components along the modes and their derivatives along the axes, (r, 1 + d).
            factor: 1 / E and its derivatives.
        """
        along = modes @ ways
        slopes = np.outer(along[:, 0], factor.slopes)
        slopes[:, self.interpolant.axes] += factor.compliance * along[:, 1:]
        return slopes


def _check_places(part: Compliance, number: int, conditions: int, unknowns: int) -> None:
    """Raise ValueError for indices out of their range, or arrays of other sizes.

    No annotation declares these ranges.
    """
    named = {"conditions": (part.conditions, conditions)}
    if part.primal is not None:
        named["unknowns"] = part.primal.unknowns, unknowns
    for name, (indices, count) in named.items():
        if indices.ndim != 1 or (indices.size and not 0 <= indices.min() <= indices.max() < count):
            raise ValueError(f"{name} of part {number} must be places from 0 to {count - 1}")
    m = part.conditions.size
    rank = len(part.interpolant.weights)
    if not m or (np.diff(part.conditions) <= 0).any():
        raise ValueError(f"conditions of part {number} must increase, at least one")
    if len(part.interpolant.modes) != m * m or part.columns.shape != (part.terms.size, m, rank):
        raise ValueError(
            f"part {number} of {m} conditions and {part.terms.size} terms has arrays of other sizes"
        )


@dataclass(frozen=True, eq=False)
class InterpolatedStiffness:
    """S at a point, (m, m), with the components of each part along its modes and its compliance."""

    schur: np.ndarray
    parts: list[tuple[Compliance, np.ndarray, float]]
    symmetric: bool

    @cached_property
    def equalities(self) -> SchurEqualities:
        """Equality problems on S, for all points of this stiffness."""
        return (
            SchurEqualities.symmetric(self.schur)
            if self.symmetric
            else SchurEqualities.of(self.schur, LapackLU)
        )


@dataclass(frozen=True, eq=False)
class ManyContacts:
    """Condensed contact problems at many points (n points, m conditions)."""

    owner: Compliances  #: all parts
    points: np.ndarray  #: parameters, (n, P)
    theta: np.ndarray  #: θ, (n, 1 + T)
    along: list[np.ndarray]  #: components along the modes of each part, (n, r) each
    compliances: list[np.ndarray]  #: 1 / E of each part, (n,) each
    schur: np.ndarray  #: S, (n, m, m)
    free_slack: np.ndarray  #: slack without contact forces, (n, m)

    def __getitem__(self, k: int) -> CondensedContact:
        """Contact problem at one of the points, for parts without modes of the unknown."""
        along, compliances = (
            [values[k] for values in values_of_components]
            for values_of_components in (self.along, self.compliances)
        )
        components = list(zip(self.owner.parts, along, compliances, strict=True))
        stiffness = InterpolatedStiffness(self.schur[k], components, self.owner.symmetric)
        return self.owner.contact(
            self.points[k], self.theta[k], stiffness, self.free_slack[k], np.zeros(0)
        )


@dataclass(frozen=True)
class Compliances(Elimination):
    """Interpolated elimination: all parts of a scene."""

    parts: tuple[Compliance, ...]  #: of the scene
    amplitudes: Amplitudes  #: θ as a function of the parameters
    gaps: Annotated[Floats, "conditions", "terms"]  #: D as terms of θ, (m, 1 + T)
    reshaped: Interpolant | None = (
        None  # D if it changes with the shape of the bodies, (m (1 + T), r) modes; else None
    )
    unknowns: int = 0  #: number of unknowns if the parts have modes of them; otherwise 0
    symmetric: bool = True  #: whether S is symmetric

    def __post_init__(self) -> None:
        """Refuse parts that do not fit these gaps, amplitudes and parameters of a file."""
        for number, component in enumerate(self.parts):
            _check_places(component, number, len(self.gaps), self.unknowns)

    def __call__(
        self, point: np.ndarray, stiffness: InterpolatedStiffness | None = None
    ) -> CondensedContact:
        """Contact problem at a point, (P,); ``stiffness`` is S there if it is known."""
        theta = self.theta(point)  # first, since it refuses moduli that are impossible
        answered = self.stiffness(point) if stiffness is None else stiffness
        slack = self.gaps_at(point) @ theta
        free = np.zeros(self.unknowns)
        for component, along, compliance in answered.parts:
            slack[component.where] -= component.load_response(
                component.columns, along, theta, compliance
            )
            if component.primal is not None:
                free[component.primal.unknowns] = component.load_response(
                    component.primal.columns, along, theta, compliance
                )
        return self.contact(point, theta, answered, slack, free)

    def contact(
        self,
        point: np.ndarray,
        theta: np.ndarray,
        found: InterpolatedStiffness,
        slack: np.ndarray,
        free: np.ndarray,
    ) -> CondensedContact:
        """Contact problem at a point from its arrays.

        Args:
            point: parameters, (P,).
            theta: θ there, (1 + T,).
            found: S there.
            slack: slack without contact forces, (m,).
            free: unknown without contact forces, (ell,).
        """
        respond = partial(self._compliance_times, found)
        changes = partial(self._changes, point, theta, found)
        return CondensedContact(
            found.schur, slack, free, respond, changes, self.symmetric, factored=found
        )

    def many(self, points: np.ndarray) -> ManyContacts:
        """Contact problems at many points, (n, P), by products of matrices.

        :attr:`together` limits their number.
        """
        theta = dense(self.amplitudes.of_many(points))
        slack = self.many_driven(points, theta)
        schur = np.zeros((len(points), *[len(self.gaps)] * 2))
        along = [component.interpolant.many_along_modes(points) for component in self.parts]
        compliances = [component.compliances(points) for component in self.parts]
        for component, ways, sizes in zip(self.parts, along, compliances, strict=True):
            schur[(slice(None), *component.block)] += component.schur(sizes[:, None] * ways)
            slack[:, component.where] -= component.load_responses(ways, theta, sizes)
        return ManyContacts(self, points, theta, along, compliances, schur, slack)

    def many_driven(self, points: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """D θ at many points, (n, m).

        Args:
            points: parameters, (n, P).
            theta: θ, (n, 1 + T).
        """
        if self.reshaped is None:
            return theta @ self.gaps.T
        gaps = self.reshaped.many_along_modes(points) @ self.reshaped.modes.T
        return (gaps.reshape(len(points), *self.gaps.shape) @ theta[:, :, None])[:, :, 0]

    @property
    def together(self) -> int:
        """Number of points whose S are computed at once, limited by memory."""
        return max(1, int(TOGETHER_BYTES / (8 * self.gaps.shape[0] ** 2)))

    def theta(self, point: np.ndarray) -> np.ndarray:
        """θ at a point, (1 + T,)."""
        return self.amplitudes.dense(point)

    def stiffness(self, point: np.ndarray) -> InterpolatedStiffness:
        """S and its parts at a point, (P,)."""
        schur = np.zeros((len(self.gaps), len(self.gaps)))
        evaluated = []
        for component in self.parts:
            along = component.interpolant.along_modes(point)
            compliance = component.compliance(point)
            schur[component.block] += component.schur(compliance * along)
            evaluated.append((component, along, compliance))
        return InterpolatedStiffness(schur, evaluated, self.symmetric)

    def _compliance_times(self, stiffness: InterpolatedStiffness, forces: np.ndarray) -> np.ndarray:
        """K^-1 B^T times forces, (m,) or (m, k)."""
        response = np.zeros((self.unknowns, *forces.shape[1:]))
        for component, along, compliance in stiffness.parts:
            if component.primal is not None and forces.ndim == 1:
                response[component.primal.unknowns] = compliance * (
                    along @ (component.primal.pushed @ forces[component.where])
                )
            elif component.primal is not None:
                # one pass over the modes, not one for each column
                per_force = np.tensordot(along, component.primal.pushed, 1)
                response[component.primal.unknowns] = compliance * (
                    per_force @ forces[component.where]
                )
        return response

    def _changes(
        self,
        point: np.ndarray,
        theta: np.ndarray,
        stiffness: InterpolatedStiffness,
        forces: np.ndarray,
        _: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of gaps, free displacement and S times forces."""
        size, terms = self.gaps.shape
        acting, slopes = self.amplitudes.slopes_at(point)
        changes = np.zeros((terms, point.size))
        changes[acting] = slopes
        slack = self.gaps_at(point) @ changes
        unknown_changes = np.zeros((self.unknowns, point.size))
        if self.reshaped is not None:
            gaps = self.reshaped.modes @ self.reshaped.slopes_along_modes(point)
            for axis, column in zip(self.reshaped.axes, gaps.T, strict=True):
                slack[:, axis] += column.reshape(size, terms) @ theta
        for component, along, _compliance in stiffness.parts:
            factor = component.factored(point)
            forces_of_part = forces[component.where]
            ways = np.column_stack([along, component.interpolant.slopes_along_modes(point)])
            # S_c forces of every mode, so that no derivative forms S_c
            schur_forces = (
                component.interpolant.modes.T.reshape(-1, forces_of_part.size, forces_of_part.size)
                @ forces_of_part
            ).T
            slack[component.where] += component.force_response_slopes(schur_forces, ways, factor)
            slack[component.where] -= component.load_response_slopes(
                component.columns, ways, theta, changes, factor
            )
            if component.primal is not None:
                free = component.load_response_slopes(
                    component.primal.columns, ways, theta, changes, factor
                )
                forced = component.force_response_slopes(
                    (component.primal.pushed @ forces_of_part).T, ways, factor
                )
                unknown_changes[component.primal.unknowns] = free - forced
        return slack, unknown_changes

    @cached_property
    def stiffness_axes(self) -> np.ndarray:
        """Indices of the parameters that S depends on."""
        factors = [component.factor for component in self.parts if component.factor is not None]
        axes = [factor.names.index(name) for factor in factors for name in factor.formula.variables]
        axes += [axis for component in self.parts for axis in component.interpolant.axes.tolist()]
        return np.unique(np.array(axes, dtype=np.int64))

    def along_path(self) -> Callable[[np.ndarray], CondensedContact]:
        """Elimination along a path: neighbours of equal stiffness share S."""
        shared: dict[bytes, InterpolatedStiffness] = {}

        def made(point: np.ndarray) -> CondensedContact:
            key = point[self.stiffness_axes].tobytes()
            if key not in shared:
                shared.clear()
                shared[key] = self.stiffness(point)
            return self(point, shared[key])

        return made

    def answers(self, model: Any, points: np.ndarray, raise_on_failure: bool) -> SeveralAnswers:
        """Answers to many parameters.

        Neighbours of equal stiffness share S and factors, else S of many points is computed at
        once.

        Args:
            model: the model that answers.
            points: parameters, (n, P).
            raise_on_failure: raise an error for a point without a solution.
        """
        from hhr_dolfinx.models.many import ManyAnswers

        answers: list[Answer] = []
        changes = (points[1:, self.stiffness_axes] != points[:-1, self.stiffness_axes]).any(axis=1)
        alike = bool(changes.mean() < NEW_STIFFNESS_SHARE) if len(points) > 1 else True
        if alike or self.unknowns:
            contact_at = self.along_path()
            for point in points:
                answers.append(self._answer(model, point, contact_at, raise_on_failure))
            return ManyAnswers.of(answers, model.fields)
        for block in np.array_split(points, -(-len(points) // self.together)):
            try:
                contacts = self.many(block)
            except (
                NotSolvableError,
                ParameterError,
            ):  # at one of them: one by one, errors name the point
                answers += [self._answer(model, point, self, raise_on_failure) for point in block]
                continue
            answers += [
                model.from_contact(contacts[k], block[k], raise_on_failure)
                for k in range(len(block))
            ]
        return ManyAnswers.of(answers, model.fields)

    def _answer(
        self,
        model: CondensedModel,
        point: np.ndarray,
        made: Callable[[np.ndarray], CondensedContact],
        raise_on_failure: bool,
    ) -> Answer:
        """Answer to one point; NaN if it has no contact problem, unless ``raise_on_failure``."""
        try:
            contact = made(point)
        except (NotSolvableError, ParameterError):
            if raise_on_failure:
                raise
            return unanswered(point, model.sizes, model.fields)
        return model.from_contact(contact, point, raise_on_failure)

    def gaps_at(self, point: np.ndarray) -> np.ndarray:
        """D at a point, (m, 1 + T)."""
        return (
            self.gaps
            if self.reshaped is None
            else self.reshaped.value(point).reshape(self.gaps.shape)
        )


class FieldBound(Bound, Protocol):
    """Bound for fields that solve a reduced problem, which it has."""

    def slack_of(self, unknown: np.ndarray, points: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Slack of fields, (n, m).

        Args:
            unknown: unknowns of the fields, (n, ell).
            points: parameters, (n, P).
            theta: θ, (n, 1 + T).
        """


@dataclass(frozen=True)
class InterpolatedFields(Rebuilt, LinearDisplacement, ElasticFields):
    """Fields of interpolated condensation, by Galerkin's method on a basis.

    They are the best in energy under given forces.
    """

    amplitudes: Amplitudes  #: θ as a function of the parameters
    basis: Annotated[Floats, "N", "columns"]  #: V, (N, ell)
    lifts: Annotated[csc_matrix, "N", "terms"]  #: imposed displacements, sparse, (N, 1 + T)
    galerkin: (
        BlockElimination | ReshapedElimination | None
    )  #: eliminates the unknown of the basis; None without fields
    dimension: int  #: components of the displacement at a node
    #: stress of a displacement at a parameter; None without a mesh
    stress_of: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = field(
        default=None, metadata=OF_THE_MESH
    )
    functionals: AllOutputs | None = None  #: outputs of the scene; None if it has none
    bound: FieldBound | None = None  #: bounds the error of an answer; None if its hypotheses fail
    unbounded: str = ""  #: reason why there is no bound
    #: of bodies that contact alone holds, (N, r), orthogonal to the basis; their amplitudes are the
    #: unknown of answers
    motions: Annotated[Floats, "N", "motions"] | None = None
    #: see :class:`~hhr_dolfinx.models.answer.ModelFields`
    full: Meshed | None = field(default=None, metadata=OF_THE_MESH)

    def estimate(self, answer: Answer) -> Estimate | None:
        """The bound; None without one, or without a solution."""
        if self.bound is None or not answer.converged:
            return None
        return self._estimated(self.bound, answer.parameter[None], answer.multipliers[None])[0]

    def estimates(self, many: ManyAnswers) -> Estimates | None:
        """Bounds of many answers, as many at once as memory allows."""
        bound = self.bound
        if bound is None:
            return None

        def bounded(rows: np.ndarray) -> Estimates:
            return self._estimated(bound, many.points[rows], many.multipliers[rows])

        return Estimates.by_blocks(bound.kind, many.converged, bound.together, bounded)

    def _estimated(self, bound: FieldBound, points: np.ndarray, forces: np.ndarray) -> Estimates:
        """Bounds of answers at points, (n, P), from forces, (n, m)."""
        forces = np.maximum(forces, 0.0)
        gamma = self._solver.many_under(points, forces)
        theta = dense(self.amplitudes.of_many(points))
        return bound.at(points, theta).of(
            gamma, forces, lambda: bound.slack_of(gamma, points, theta)
        )

    def displacement(self, answer: Answer) -> np.ndarray:
        """V gamma and the lift, (N,)."""
        if not answer.converged:
            return np.full(len(self.basis), np.nan)
        return self._spanned @ self._coordinates(answer) + self.lifts @ self.amplitudes(
            answer.parameter
        )

    def _per_coordinate(self, rows: csr_matrix) -> np.ndarray:
        return rows @ self._spanned

    @cached_property
    def _spanned(self) -> np.ndarray:
        """V and the motions, (N, ell + r)."""
        return self.basis if self.motions is None else np.hstack([self.basis, self.motions])

    def _terms(self, rows: csr_matrix) -> np.ndarray:
        return dense(rows @ self.lifts)

    def _coordinates(self, answer: Answer) -> np.ndarray:
        """Coordinates in the basis, gamma, (ell,), under the forces of an answer.

        NotOfferedError without fields.
        """
        gamma = self._solver.under(answer.parameter, answer.multipliers)
        return gamma if self.motions is None else np.concatenate([gamma, answer.unknown])

    def _coordinate_changes(self, answer: Answer, changes: np.ndarray) -> np.ndarray:
        """Derivatives of gamma, (ell, P)."""
        assert answer.gradient is not None
        galerkin = self._solver(answer.parameter)
        _, fixed = galerkin.at_fixed_forces(
            answer.multipliers, galerkin.unknown(answer.multipliers)
        )
        changed = fixed - galerkin.response_to_forces(answer.gradient.multipliers)
        return (
            changed if self.motions is None else np.concatenate([changed, answer.gradient.unknown])
        )

    @cached_property
    def _solver(self) -> KnownForces | ReshapedElimination:
        if self.galerkin is None:
            raise NotOfferedError(
                "this model was condensed for contact forces, and has no displacement: "
                "hhr.condense(scene, fields=True), or hhr.train(scene, ...).condense()"
            )
        if isinstance(self.galerkin, BlockElimination):
            return KnownForces(self.galerkin.problem, self.galerkin.amplitudes)
        return self.galerkin
