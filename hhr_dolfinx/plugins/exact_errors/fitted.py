"""Contact forces on the whole surface from those of a RID, for contacts with laws: gappy POD,
limited by the laws.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated

import numpy as np

from hhr_dolfinx.contact.law import ContactLaw
from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.reduction.modes import pod

if TYPE_CHECKING:
    from hhr_dolfinx.contact.problem import ContactProblem
    from hhr_dolfinx.plugins.contact_laws.interface import Interface, Range

FORCES_LEFT_OUT = 1e-6
"""Part of the squared training forces that their modes leave out."""
MODES_PER_CONDITION = 0.9
"""Most modes of forces per loaded condition of the RID.

With as many as conditions, all forces would be explained.
"""
FORCE_ROUND_OFF = 1e-8
"""Part of the largest force of a mode below which a force counts as zero."""
OVERLAP_FACTOR = 3.0
"""Overlap outside the RID, as a multiple of that in training, beyond which the error is unknown."""
SHALLOW = 1e-2
"""Part of the gap scale that overlap may reach in any case."""
SAME_SCENE = 1e-5
"""Relative difference of numbers of one scene."""
OPEN_OUTSIDE = 1e-3
"""Part of the largest force of a law in the RID below which a contact outside counts as open: it is
fitted.
"""


def _ranged(law: ContactLaw, count: int) -> Interface:
    """The law on ranges of conditions, by the plug-in that every law of contacts needs."""
    from hhr_dolfinx.plugins.contact_laws.interface import ranged

    return ranged(law, count)


def mark_of(problem: ContactProblem) -> np.ndarray:
    """Fingerprint of a scene: products with random vectors at two points of the box, (8,).

    x·K x, x·f, y·(B x) and y·D, with x and y random.
    """
    rng = np.random.default_rng(0)
    held = problem.held
    field = rng.standard_normal(held.size) * held
    weights = rng.standard_normal(len(problem.gaps))
    products = []
    for point in problem.parameters.random(2, seed=1):
        problem_at_point = problem.at(point)
        theta = problem_at_point.amplitudes(point)
        products += [
            field @ (problem_at_point.stiffness @ field),
            field @ (problem_at_point.loads @ theta),
        ]
        products += [
            weights @ (problem_at_point.contact @ field),
            weights @ (problem_at_point.gaps @ theta),
        ]
    return np.array(products)


@dataclass(frozen=True, eq=False)
class FittedForces:
    """Completion of contact forces and statuses by modes of training forces.

    The modes are fitted to the forces of the RID.

    See :class:`~hhr_dolfinx.models.answer.InterfaceCompletion`.
    """

    whole: ContactLaw  #: of the whole contact surface
    within: Annotated[Integers, "m", "< N_lambda"]  #: conditions of the RID, (m,)
    modes: Annotated[Floats, "N_lambda", "force modes"]  #: POD modes of the forces of training
    fit: Annotated[Floats, "force modes", "m"]  #: amplitudes of the modes per force in the RID
    mark: Annotated[Floats, "8"]  #: of the full model, see :func:`mark_of`
    share: float = 1.0
    """Relative error of forces per part of them that no mode explains; 95 % of the training
    increments stay below. At least 1, and 1 without training increments.
    """
    #: deepest overlap outside the RID in training increments, over the gap scale
    depth: float = 0.0

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Faults of an indicator that would report too small errors."""
        if not (self.share >= 1.0 and self.depth >= 0.0):
            yield (
                f"the indicator has share {self.share} and depth {self.depth}: they must be >= 1 "
                "and >= 0"
            )

    @classmethod
    def fitted(
        cls, problem: ContactProblem, law: ContactLaw, within: np.ndarray, forces: np.ndarray
    ) -> FittedForces:
        """Least-squares fit of the modes of training forces to the conditions of the RID.

        Args:
            problem: the contact problem.
            law: law of the whole contact surface.
            within: conditions of the RID, (m,).
            forces: training forces, (N_lambda, S).
        """
        modes = pod(forces, FORCES_LEFT_OUT)[0]
        loaded = (
            np.abs(modes[within]).max(axis=1, initial=0.0) > FORCE_ROUND_OFF * np.abs(modes).max()
        )
        modes = np.ascontiguousarray(modes[:, : max(int(MODES_PER_CONDITION * loaded.sum()), 1)])
        return cls(law, within, modes, np.linalg.pinv(modes[within]), mark_of(problem))

    def differences(self, problem: ContactProblem) -> str:
        """Difference of the problem of a full model to the one of the training, in words.

        Empty if there is none.
        """
        trained = [*_ranged(self.whole, len(self.modes)).parts(), *self.mark]
        compared = [*_ranged(problem.law, len(self.modes)).parts(), *mark_of(problem)]
        same = len(trained) == len(compared) and all(map(_alike, trained, compared))
        return "" if same else "its stiffness, its loads, its gaps or the laws of its contacts"

    @cached_property
    def inside(self) -> ContactLaw:
        """Law of the RID, with the row numbers of the RID."""
        return self.whole.within(self.within)

    @cached_property
    def _ranges(self) -> tuple[Range, ...]:
        return _ranged(self.whole, len(self.modes)).ranges

    @cached_property
    def _elsewhere(self) -> tuple[np.ndarray, np.ndarray]:
        """Conditions outside the RID, and the matrix from forces in the RID to theirs."""
        rows = np.setdiff1d(np.arange(len(self.modes)), self.within)
        return rows, self.modes[rows] @ self.fit

    def forces(self, inside: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Forces on all conditions, (N_lambda,), limited by the laws at a point.

        Args:
            inside: forces of the RID, (m,).
            point: parameters, (P,).
        """
        return self._limited(inside, np.zeros((inside.size, 0)), point)[0]

    def force_changes(
        self, inside: np.ndarray, changes: np.ndarray, point: np.ndarray
    ) -> np.ndarray:
        """Derivatives of :meth:`forces`, (N_lambda, P).

        Args:
            inside: forces of the RID, (m,).
            changes: their derivatives, (m, P).
            point: parameters, (P,).
        """
        return self._limited(inside, changes, point)[1]

    def completed(
        self, inside: np.ndarray, active: np.ndarray, point: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Forces and statuses of all conditions, (N_lambda,) each.

        Statuses outside the RID follow from the forces.

        Args:
            inside: forces of the RID, (m,).
            active: statuses of the RID, (m,).
            point: parameters, (P,).
        """
        forces, _, statuses = self._limited(inside, np.zeros((inside.size, 0)), point)
        statuses[self.within] = active
        return forces, statuses

    def _limited(
        self, inside: np.ndarray, changes: np.ndarray, point: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Forces, derivatives and statuses of all conditions.

        A pressure within the error of the fit counts as zero.
        """
        forces = self._fitted(inside)
        slopes = self._fitted(changes)
        active = np.zeros(len(forces), dtype=bool)
        fitted = active.copy()
        fitted[self._elsewhere[0]] = True
        for law_range in self._ranges:
            rows = law_range.rows
            x = forces[rows]
            slope = slopes[rows]
            fills = fitted[rows]
            off = (
                fills
                & law_range.law.pressing(rows.size)
                & ~law_range.law.pulling(rows.size)
                & (x <= OPEN_OUTSIDE * np.abs(x[~fills]).max(initial=0.0))
            )
            x[off] = 0.0
            slope[off] = 0.0
            forces[rows], slopes[rows], active[rows] = law_range.law.limited(x, slope, fills, point)
        return forces, slopes, active

    def _fitted(self, inside: np.ndarray) -> np.ndarray:
        """Values in the RID, (m, ...), completed by the modes elsewhere, (N_lambda, ...)."""
        rows, per_force = self._elsewhere
        values = np.empty((len(self.modes), *inside.shape[1:]))
        values[self.within] = inside
        values[rows] = per_force @ inside
        return values

    def misfit(self, inside: np.ndarray) -> float:
        """Part of the forces in the RID, (m,), that no mode of training explains, from 0 to 1.

        0 without forces.

        It is proportional to the error of all forces, see docs/friction.md: the modes come from
        training, the contact forces from this increment.
        """
        size = float(np.linalg.norm(inside))
        if not size > 0:
            return 0.0 if size == 0 else math.inf
        return float(np.linalg.norm(inside - self.modes[self.within] @ (self.fit @ inside))) / size

    def indicated(
        self, inside: np.ndarray, slack: np.ndarray, scale: np.ndarray, memory: Memory
    ) -> float:
        """Estimated relative error of forces; infinite if bodies overlap outside the RID.

        Args:
            inside: forces of the RID, (m,).
            slack: slack of all conditions, (N_lambda,).
            scale: scales of their gaps, (N_lambda,).
            memory: memory of the laws.
        """
        deep = self.overlap(slack, scale, memory)
        if deep > max(OVERLAP_FACTOR * self.depth, SHALLOW) or (
            deep > FORCE_ROUND_OFF and not inside.any()
        ):
            return math.inf
        return self.share * self.misfit(inside)

    def overlap(self, slack: np.ndarray, scale: np.ndarray, memory: Memory) -> float:
        """Deepest overlap outside the RID, over the gap scale; 0 if there is none.

        A worn depth does not count as an overlap, a closed gasket does.

        Args:
            slack: slack of all conditions, (N_lambda,).
            scale: scales of their gaps, (N_lambda,).
            memory: memory of the laws.
        """
        rows = self._elsewhere[0]
        rows = rows[self.whole.pressing(len(slack))[rows]]
        opened = np.zeros(len(slack))
        for law_range in self._ranges:
            opened[law_range.rows] = (
                law_range.law.opened(memory) if law_range.law.remembers else 0.0
            )
        return float((-(slack + opened)[rows] / scale[rows]).max(initial=0.0))


forces_outside = FittedForces.fitted
"""Tool of the core, see :func:`hhr_dolfinx.registry.tool`."""


def _alike(one: str | np.ndarray | float, other: str | np.ndarray | float) -> bool:
    """True for equal texts, and for arrays that differ by round-off of the numbers of one scene."""
    if isinstance(one, str) or isinstance(other, str) or np.shape(one) != np.shape(other):
        return bool(np.array_equal(one, other))
    off = np.abs(np.subtract(one, other)).max(initial=0.0)
    return bool(off <= SAME_SCENE * np.abs(one).max(initial=0.0))
