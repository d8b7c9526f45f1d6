"""What S is at least where it depends on parameters, so that bounds need no factor of S at each of them.

S is the sum of what connected components c of a scene have of it, S_c, and beside the middle of the box

    S_c(mu) >= a_c(mu) S_c(middle),  a_c(mu) = E_c(middle) / E_c(mu) (1 + sum_k min eig of d_k S_c(middle)^-1 M_ck),

d_k being how far the components along the modes M_ck of its interpolation are off those of the middle. With any weights
w > 0, S(mu) >= min_c (a_c(mu) / w_c) sum_c w_c S_c(middle): sums whose weights are powers of a number are factored
once, and each point takes that of the powers next to its a_c.
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
from hhr_dolfinx.models.bounds.contact_response import ContactResponse
from hhr_dolfinx.models.eliminations.interpolated import Compliance, Compliances, ManyContacts

STEP = math.log(1.1)
"""Of logarithms of weights: bounds of forces are at most the root of its half wider than with weights of each point."""
KEPT = 64
KEPT_BYTES = 64 * 2**20
"""Factors that are kept, of the weights asked for last: so many at most, and so many bytes unless one takes more."""
FACTORED = 1500
"""Conditions up to which weights have steps; beyond, those of the middle serve all points: a factor took a second."""
WITH_MODES = 400
"""Conditions up to which modes of the interpolation are measured; beyond, their eigenvalues take a minute."""
NOTHING = 1e-10
"""Part of the largest eigenvalue of S_c below which it is nothing: conditions may depend on each other on a body."""
SOLVED = 1e-11
"""Part of what forces push that they may leave open and need not be solved for again: it is bounded as they stand."""
LEAST = 0.2
"""Part of S_c(middle) that S_c must be at least: where modes add up to more a point has a factor of its own."""


class Share(NamedTuple):
    """What S_c is made of in the middle of the box, and what modes may take from it.

    Attributes:
        compliance: 1 / E_c there.
        along: components along the modes there, (r,).
        extremes: least and largest eigenvalue of S_c(middle)^-1 M_ck, (r, 2), where S_c is not zero; infinite ones
            where a mode is not zero elsewhere.
    """

    compliance: float
    along: np.ndarray
    extremes: np.ndarray

    @classmethod
    def of(cls, part: Compliance, middle: np.ndarray) -> Share:
        """Of one part; nothing is measured where it has no axis, along which its modes change."""
        along = part.interpolant.along_modes(middle)
        extremes = np.zeros((along.size, 2))
        if part.interpolant.axes.size:
            sizes, ways = eigh(part.schur(along))
            there = sizes > NOTHING * sizes[-1]
            half = ways[:, there] / np.sqrt(sizes[there])
            for place, unit in enumerate(np.eye(along.size)):
                mode = part.schur(unit)
                values = eigvalsh(half.T @ mode @ half)
                elsewhere = np.abs(mode @ ways[:, ~there]).max(initial=0.0) > NOTHING * sizes[-1]
                extremes[place] = (-np.inf, np.inf) if elsewhere else (values[0], values[-1])
        return cls(part.compliance(middle), along, extremes)

    def least(self, along: np.ndarray, compliances: np.ndarray) -> np.ndarray:
        """a_c at components along the modes, (n, r), and compliances, (n,): (n,); zero where it may be small."""
        if not self.extremes.any():
            return compliances / self.compliance
        off = along - self.along
        with np.errstate(invalid="ignore"):
            left = 1 + np.where(off > 0, off * self.extremes[:, 0], off * self.extremes[:, 1]).sum(axis=1)
        return np.where(left > LEAST, left, 0.0) * compliances / self.compliance


@dataclass(frozen=True)
class FactoredResponse(ContactResponse):
    """S and a factor of what it is at least (m conditions).

    Attributes:
        lower: Cholesky factor of S, (m, m); or L of a matrix which times ``least`` is at most S.
        least: see there; 1 for the factor of S itself.
        known: :func:`amplified_by` L; None where it is not known yet.
    """

    lower: np.ndarray
    least: float = 1.0
    known: tuple[float, np.ndarray] | None = None

    @cached_property
    def amplified(self) -> tuple[float, np.ndarray]:
        """The most that forces of S norm 1 have in the Euclidean norm, and at each condition, (m,)."""
        longest, sizes = amplified_by(self.lower) if self.known is None else self.known
        scale = math.sqrt(self.least)
        return longest / scale, sizes / scale

    def off(self, slack: np.ndarray, forces: np.ndarray) -> float:
        """|r|_{S^-1} of a slack and forces, (m,) each: r is the slack where there is a force, or it is negative."""
        left = np.where((forces > 0) | (slack < 0), slack, 0.0)
        if not left.any():
            return 0.0
        found = dtrtrs(self.lower, left[:, None], lower=1)[0][:, 0]
        return math.sqrt(found @ found / self.least)


def amplified_by(lower: np.ndarray) -> tuple[float, np.ndarray]:
    """The most that x with |L^T x| = 1 has in the Euclidean norm, and in each place, (m,).

    Of the second ((L L^T)^-1)_ii^1/2 is the exact value. The first, |L^-1|, is at most the Frobenius norm, and at most
    the root of the largest column sum times the largest row sum.
    """
    inverse = dtrtri(lower, lower=1)[0]
    np.abs(inverse, out=inverse)
    sizes = np.sqrt(np.einsum("ij,ij->j", inverse, inverse))
    sums = float(inverse.sum(axis=0).max() * inverse.sum(axis=1).max())
    return math.sqrt(min(sums, float(sizes @ sizes))), sizes


@dataclass(frozen=True)
class ManyResponses:
    """S of several answers, each its own (n answers, m conditions).

    Attributes:
        each: of each.
        schur: S, (n, m, m).
    """

    each: list[FactoredResponse]
    schur: np.ndarray

    def __getitem__(self, k: int) -> FactoredResponse:
        return self.each[k]

    @property
    def amplified(self) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`FactoredResponse`: (n,), and (n, m)."""
        found = [one.amplified for one in self.each]
        return np.array([longest for longest, _ in found]), np.array([sizes for _, sizes in found])

    def pushed(self, forces: np.ndarray) -> np.ndarray:
        """S times forces, (n, m) each."""
        return (forces[:, None] @ self.schur)[:, 0]

    def settled(self, forces: np.ndarray, free: np.ndarray, pushed: np.ndarray) -> tuple[np.ndarray, ...]:
        """Forces that solve the contact problem on S, S times them, (n, m) each, and their error in the S norm, (n,).

        The search starts from the statuses of given forces, which stay where it does not settle. Gaps that are closed
        count as closed: round-off there is bounded by the sizes of the answers.

        Args:
            forces: not negative, (n, m).
            free: slack without forces, (n, m).
            pushed: S times the forces, (n, m).
        """
        touching = self.schur.diagonal(axis1=1, axis2=2) * forces > free + pushed
        found = forces.copy()
        slack = free + pushed
        wrong = np.where(forces > 0, np.abs(slack), np.maximum(-slack, 0.0)).max(axis=1, initial=0.0)
        solved = wrong <= SOLVED * np.abs(pushed).max(axis=1, initial=0.0)
        closed = np.zeros(len(forces), dtype=bool)
        for k in np.flatnonzero(~solved):
            schur = self.schur[k]
            alone = active_set(SchurEqualities.symmetric(schur), free[k], touching[k])
            closed[k] = alone.status is Status.CONVERGED
            if closed[k]:
                found[k] = alone.forces
        better = np.maximum(found, 0.0)
        less = self.pushed(better)
        slack = free + less
        # a force that was cut off leaves gaps open elsewhere
        closed &= found.min(axis=1) >= 0
        slack[(better > 0) & closed[:, None]] = 0.0
        off = np.zeros(len(found))
        rows = np.flatnonzero(~(closed & (slack.min(axis=1) >= 0)))
        off[rows] = self.off(slack[rows], better[rows], rows)
        return better, less, off

    def off(self, slack: np.ndarray, forces: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Norms of residuals of some answers, by their numbers, (k,)."""
        return np.array([self.each[k].off(slack[i], forces[i]) for i, k in enumerate(rows)])


def _alone(schur: np.ndarray) -> FactoredResponse:
    """S with a factor of its own."""
    return FactoredResponse(schur, cholesky(schur, lower=True))


class LeastResponse:
    """Bounds S from below by few matrices that are factored.

    Args:
        compliances: S.
        middle: of the box, (P,).
    """

    def __init__(self, compliances: Compliances, middle: np.ndarray):
        self.compliances = compliances
        self.middle = middle
        conditions = len(compliances.gaps)
        fitting = KEPT_BYTES // (8 * max(conditions, 1) ** 2)
        self._factored = lru_cache(maxsize=int(min(max(fitting, 1), KEPT)))(self._made)

    def at(self, found: ManyContacts) -> ManyResponses:
        """S of some points with factors of what they are at least, or of themselves.

        Raises:
            LinAlgError: where one is not definite.
        """
        conditions = found.schur.shape[1]
        if any(part.interpolant.axes.size for part in self.compliances.parts) and conditions > WITH_MODES:
            return ManyResponses([_alone(schur) for schur in found.schur], found.schur)
        columns = zip(self._shares, found.along, found.compliances, strict=True)
        shares = np.stack([share.least(along, sizes) for share, along, sizes in columns], axis=1)
        steps = np.zeros(shares.shape)
        known = (shares > 0).all(axis=1)
        if conditions <= FACTORED:
            steps[known] = np.round(np.log(shares[known] / shares[known, :1]) / STEP)
        least = (shares / np.exp(STEP * steps)).min(axis=1)
        responses = []
        for schur, own, size in zip(found.schur, steps.astype(int).tolist(), least.tolist(), strict=True):
            if not size > 0:
                responses.append(_alone(schur))
                continue
            lower, amplified = self._factored(tuple(own))
            responses.append(FactoredResponse(schur, lower, size, amplified))
        return ManyResponses(responses, found.schur)

    @cached_property
    def _shares(self) -> list[Share]:
        return [Share.of(part, self.middle) for part in self.compliances.parts]

    def _made(self, steps: tuple[int, ...]) -> tuple[np.ndarray, tuple[float, np.ndarray]]:
        """Cholesky factor of a sum with weights of so many steps, and what it amplifies."""
        schur = np.zeros((len(self.compliances.gaps),) * 2)
        for part, share, step in zip(self.compliances.parts, self._shares, steps, strict=True):
            schur[part.block] += part.schur(math.exp(STEP * step) * share.compliance * share.along)
        # symmetric, and as large as a hundredth of all memory: LAPACK takes it as it lies
        lower = cholesky(schur.T, lower=True, overwrite_a=True)
        return lower, amplified_by(lower)
