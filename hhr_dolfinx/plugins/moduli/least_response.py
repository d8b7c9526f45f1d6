"""Lower bounds of an S that depends on parameters, so that bounds need no factor of S at each of
them.

S is the sum of the contributions S_c of connected components c of a scene, and relative to the
middle of the box

    S_c(mu) >= a_c(mu) S_c(middle),  a_c(mu) = E_c(middle) / E_c(mu) (1 + sum_k min eig of d_k
    S_c(middle)^-1 M_ck),

with d_k the components along the modes M_ck of its interpolation less those of the middle. For any
weights w > 0, S(mu) >= min_c (a_c(mu) / w_c) sum_c w_c S_c(middle): sums whose weights are powers
of a number are factored once, and each point uses the powers next to its a_c.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, eigh, eigvalsh
from scipy.linalg.lapack import dtrtri, dtrtrs

from hhr_dolfinx.contact.active_set import SchurEqualities, Status, active_set
from hhr_dolfinx.plugins.exact_errors.contact_response import ContactResponse
from hhr_dolfinx.plugins.moduli.interpolated import Compliance, Compliances, ManyContacts

LOG_WEIGHT_STEP = math.log(1.1)
"""Step of logarithms of weights: bounds are wider than with exact weights by at most the root of
half a step.
"""
KEPT_FACTORS = 64
"""Most factors that are kept, for the most recently used weights."""
KEPT_FACTOR_BYTES = 64 * 2**20
"""Memory of kept factors; a single one may take more."""
FACTORED = 1500
"""Conditions up to which weights have steps.

beyond, those of the middle are used: a factor took a second.
"""
WITH_MODES = 400
"""Conditions up to which modes of the interpolation are evaluated.

beyond, their eigenvalues take a minute.
"""
ZERO_EIGENVALUE = 1e-10
"""Part of the largest eigenvalue of S_c up to which one counts as zero: conditions on a body may be
dependent.
"""
SOLVED_RESIDUAL = 1e-11
"""Part of S times the forces up to which residuals are not solved for again: they are bounded
instead.
"""
LEAST_REMAINDER = 0.2
"""Smallest part of S_c(middle) that bounds S_c: if the modes sum to more, a point has its exact
factor.
"""


class ComponentExtremes(NamedTuple):
    """S_c in the middle of the box, and the extremes of its modes."""

    compliance: float  #: 1 / E_c there
    along: np.ndarray  #: components along the modes there, (r,)
    extremes: (
        np.ndarray
    )  #: least and largest eigenvalue of S_c(middle)^-1 M_ck, (r, 2); infinite where S_c is zero

    @classmethod
    def of(cls, part: Compliance, middle: np.ndarray) -> ComponentExtremes:
        """Data of one part; without an axis, along which modes change, there are no eigenvalues.

        Args:
            part: compliance of the component.
            middle: the middle of the box, (P,).
        """
        along = part.interpolant.along_modes(middle)
        extremes = np.zeros((along.size, 2))
        if part.interpolant.axes.size:
            sizes, ways = eigh(part.schur(along))
            significant = sizes > ZERO_EIGENVALUE * sizes[-1]
            half = ways[:, significant] / np.sqrt(sizes[significant])
            for index, unit in enumerate(np.eye(along.size)):
                mode = part.schur(unit)
                values = eigvalsh(half.T @ mode @ half)
                elsewhere = (
                    np.abs(mode @ ways[:, ~significant]).max(initial=0.0)
                    > ZERO_EIGENVALUE * sizes[-1]
                )
                extremes[index] = (-np.inf, np.inf) if elsewhere else (values[0], values[-1])
        return cls(part.compliance(middle), along, extremes)

    def least(self, along: np.ndarray, compliances: np.ndarray) -> np.ndarray:
        """Lower bounds a_c of S_c relative to the middle of the box, (n,).

        Zero if the bound may be too small.

        Args:
            along: components along the modes, (n, r).
            compliances: compliances 1 / E_c, (n,).
        """
        if not self.extremes.any():
            return compliances / self.compliance
        off = along - self.along
        with np.errstate(invalid="ignore"):
            remaining = 1 + np.where(
                off > 0, off * self.extremes[:, 0], off * self.extremes[:, 1]
            ).sum(axis=1)
        return np.where(remaining > LEAST_REMAINDER, remaining, 0.0) * compliances / self.compliance


@dataclass(frozen=True)
class FactoredResponse(ContactResponse):
    """S and a factor of a lower bound of S (m conditions)."""

    lower: np.ndarray  #: Cholesky factor of S, (m, m); or L with ``least`` L L^T <= S
    least: float = 1.0  #: see above; 1 for the factor of S itself
    known: tuple[float, np.ndarray] | None = None  #: :func:`amplified_by` L; None until it is known

    @cached_property
    def amplified(self) -> tuple[float, np.ndarray]:
        """Largest norm of forces of S norm 1, and largest force at each condition, (m,)."""
        longest, sizes = amplified_by(self.lower) if self.known is None else self.known
        scale = math.sqrt(self.least)
        return longest / scale, sizes / scale

    def off(self, slack: np.ndarray, forces: np.ndarray) -> float:
        """Norm |r|_{S^-1} of a slack and forces.

        r is the slack at nonzero forces or if negative, else 0.

        Args:
            slack: slack of all conditions, (m,).
            forces: contact forces, (m,).
        """
        residual = np.where((forces > 0) | (slack < 0), slack, 0.0)
        if not residual.any():
            return 0.0
        scaled = dtrtrs(self.lower, residual[:, None], lower=1)[0][:, 0]
        return math.sqrt(scaled @ scaled / self.least)


def amplified_by(lower: np.ndarray) -> tuple[float, np.ndarray]:
    """Largest Euclidean norm of x with |L^T x| = 1, and largest absolute value of each entry, (m,).

    The second is exactly ((L L^T)^-1)_ii^1/2. The first, |L^-1|, is at most the Frobenius norm, and
    the root of the largest column sum times the largest row sum.
    """
    inverse = dtrtri(lower, lower=1)[0]
    np.abs(inverse, out=inverse)
    sizes = np.sqrt(np.einsum("ij,ij->j", inverse, inverse))
    sums = float(inverse.sum(axis=0).max() * inverse.sum(axis=1).max())
    return math.sqrt(min(sums, float(sizes @ sizes))), sizes


@dataclass(frozen=True)
class ManyResponses:
    """S of several answers at different parameters (n answers, m conditions)."""

    each: list[FactoredResponse]  #: S of each answer
    schur: np.ndarray  #: S, (n, m, m)

    def __getitem__(self, k: int) -> FactoredResponse:
        return self.each[k]

    @property
    def amplified(self) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`FactoredResponse`: (n,), and (n, m)."""
        norms = [response.amplified for response in self.each]
        return np.array([longest for longest, _ in norms]), np.array([sizes for _, sizes in norms])

    def schur_times(self, forces: np.ndarray) -> np.ndarray:
        """S times forces, (n, m) each."""
        return (forces[:, None] @ self.schur)[:, 0]

    def settled(
        self, forces: np.ndarray, free: np.ndarray, schur_times_forces: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        """Forces that solve the contact problem on S.

        The search starts from the statuses of the given forces, which remain if it does not
        converge. Closed gaps count as closed: the sizes of the answers bound their round-off.

        Args:
            forces: forces to start from, >= 0, (n, m).
            free: slack without forces, (n, m).
            schur_times_forces: S times the given forces, (n, m).

        Returns:
            The forces and S times them, (n, m) each, and their error in the S norm, (n,).
        """
        touching = self.schur.diagonal(axis1=1, axis2=2) * forces > free + schur_times_forces
        solution = forces.copy()
        slack = free + schur_times_forces
        wrong = np.where(forces > 0, np.abs(slack), np.maximum(-slack, 0.0)).max(
            axis=1, initial=0.0
        )
        solved = wrong <= SOLVED_RESIDUAL * np.abs(schur_times_forces).max(axis=1, initial=0.0)
        closed = np.zeros(len(forces), dtype=bool)
        for k in np.flatnonzero(~solved):
            schur = self.schur[k]
            alone = active_set(SchurEqualities.symmetric(schur), free[k], touching[k])
            closed[k] = alone.status is Status.CONVERGED
            if closed[k]:
                solution[k] = alone.forces
        better = np.maximum(solution, 0.0)
        schur_times_better = self.schur_times(better)
        slack = free + schur_times_better
        # forces cut off at zero leave gaps open elsewhere
        closed &= solution.min(axis=1) >= 0
        slack[(better > 0) & closed[:, None]] = 0.0
        off = np.zeros(len(solution))
        rows = np.flatnonzero(~(closed & (slack.min(axis=1) >= 0)))
        off[rows] = self.off(slack[rows], better[rows], rows)
        return better, schur_times_better, off

    def off(self, slack: np.ndarray, forces: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """S^-1 norms of residuals of some answers, (k,).

        Args:
            slack: slack of these answers, (k, m).
            forces: their contact forces, (k, m).
            rows: their indices, (k,).
        """
        return np.array([self.each[k].off(slack[i], forces[i]) for i, k in enumerate(rows)])


def _alone(schur: np.ndarray) -> FactoredResponse:
    """S with its exact factor."""
    return FactoredResponse(schur, cholesky(schur, lower=True))


class LeastResponse:
    """Bounds S from below by few factored matrices."""

    def __init__(self, compliances: Compliances, middle: np.ndarray):
        self.compliances = compliances
        self.middle = middle
        conditions = len(compliances.gaps)
        fitting = KEPT_FACTOR_BYTES // (8 * max(conditions, 1) ** 2)
        self._factored = lru_cache(maxsize=int(min(max(fitting, 1), KEPT_FACTORS)))(self._made)

    def at(self, found: ManyContacts) -> ManyResponses:
        """S of some points with factors of lower bounds, or exact factors.

        Args:
            found: contact problems at these points.

        Raises:
            LinAlgError: if one S is not definite.
        """
        conditions = found.schur.shape[1]
        if (
            any(component.interpolant.axes.size for component in self.compliances.parts)
            and conditions > WITH_MODES
        ):
            return ManyResponses([_alone(schur) for schur in found.schur], found.schur)
        columns = zip(self._shares, found.along, found.compliances, strict=True)
        shares = np.stack([share.least(along, sizes) for share, along, sizes in columns], axis=1)
        steps = np.zeros(shares.shape)
        bounded = (shares > 0).all(axis=1)
        if conditions <= FACTORED:
            steps[bounded] = np.round(
                np.log(shares[bounded] / shares[bounded, :1]) / LOG_WEIGHT_STEP
            )
        least = (shares / np.exp(LOG_WEIGHT_STEP * steps)).min(axis=1)
        responses = []
        for schur, steps_of_point, size in zip(
            found.schur, steps.astype(int).tolist(), least.tolist(), strict=True
        ):
            if not size > 0:
                responses.append(_alone(schur))
                continue
            lower, amplified = self._factored(tuple(steps_of_point))
            responses.append(FactoredResponse(schur, lower, size, amplified))
        return ManyResponses(responses, found.schur)

    @cached_property
    def _shares(self) -> list[ComponentExtremes]:
        return [
            ComponentExtremes.of(component, self.middle) for component in self.compliances.parts
        ]

    def _made(self, steps: tuple[int, ...]) -> tuple[np.ndarray, tuple[float, np.ndarray]]:
        """Cholesky factor of a sum with weights of so many steps, and its :func:`amplified_by`."""
        schur = np.zeros((len(self.compliances.gaps),) * 2)
        for component, share, step in zip(self.compliances.parts, self._shares, steps, strict=True):
            schur[component.block] += component.schur(
                math.exp(LOG_WEIGHT_STEP * step) * share.compliance * share.along
            )
        # symmetric, and as large as a hundredth of all memory: LAPACK works in place
        lower = cholesky(schur.T, lower=True, overwrite_a=True)
        return lower, amplified_by(lower)
