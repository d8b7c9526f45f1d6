"""Friction on the whole contact surface from the contacts of a RID: forces by gappy POD, slip from the displacement.

Slip needs no completion. The position of a tangential row is its slack under the displacement, D - B u, whether the
contact sticks or slips, and the displacement is available everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.plugins.friction.laws import Friction
from hhr_dolfinx.plugins.friction.sliding_set import bounds

if TYPE_CHECKING:
    from hhr_dolfinx.contact.problem import ContactProblem

FULL = 1e-3
"""Margin, as a part of its bound, within which a tangential force outside the RID counts as slipping: it is fitted
and has no status."""
MOST = 0.9
"""Most modes of forces per loaded condition of the RID; with as many modes as conditions, every force would be
explained."""
ROUND_OFF = 1e-8
"""Part of the largest force of a mode below which a force counts as zero."""
DEEP = 3.0
"""Overlap outside the RID, as a multiple of that in training, beyond which the error is unknown."""
SHALLOW = 1e-2
"""Part of the gap scale that overlap may reach in any case."""
ALIKE = 1e-5
"""Relative difference of numbers of one scene."""
PRESSED = 1e-3
"""Part of the largest force of an answer below which a contact outside the RID counts as open: it is fitted."""


def mark_of(problem: ContactProblem) -> np.ndarray:
    """Numbers that another scene, mesh, material, load or gap changes: energies of random fields, (8,).

    At two points of the box, with x and y random: x·K x and x·f, and y·(B x) and y·D of contact.
    """
    rng = np.random.default_rng(0)
    held = problem.held
    field = rng.standard_normal(held.size) * held
    weights = rng.standard_normal(len(problem.gaps))
    found = []
    for point in problem.parameters.random(2, seed=1):
        there = problem.at(point)
        theta = there.amplitudes(point)
        found += [field @ (there.stiffness @ field), field @ (there.loads @ theta)]
        found += [weights @ (there.contact @ field), weights @ (there.gaps @ theta)]
    return np.array(found)


@dataclass(frozen=True, eq=False)
class FrictionalFields:
    """Completion of forces and statuses of contacts with friction."""

    friction: Friction  # of the whole contact surface
    within: Annotated[Integers, "m", "< N_lambda"]  # conditions of the RID, (m,)
    modes: Annotated[Floats, "N_lambda", "force modes"]  # POD modes of the forces of training
    fit: Annotated[Floats, "force modes", "m"]  # amplitudes of the modes per force in the RID
    mark: Annotated[Floats, "8"]  # fingerprint of the full model, see :func:`mark_of`
    share: float = 1.0
    """Relative error of forces per part of them that no mode explains; 95 % of the training increments stay below. At
    least 1, and 1 without training increments."""
    depth: float = 0.0  # deepest overlap outside the RID in training increments, over the gap scale of its condition

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Faults of an indicator that would report too small errors."""
        if not (self.share >= 1.0 and self.depth >= 0.0):
            yield f"the indicator has a share of {self.share} and a depth of {self.depth}: from 1 and 0 on they may be"

    @classmethod
    def fitted(cls, problem: ContactProblem, within: np.ndarray, modes: np.ndarray) -> FrictionalFields:
        """Least-squares fit on the RID (gappy POD) by the first of the modes of forces, (N_lambda, k)."""
        friction: Any = problem.law
        loaded = np.abs(modes[within]).max(axis=1, initial=0.0) > ROUND_OFF * np.abs(modes).max()
        modes = np.ascontiguousarray(modes[:, : max(int(MOST * loaded.sum()), 1)])
        return cls(friction, within, modes, np.linalg.pinv(modes[within]), mark_of(problem))

    @property
    def whole(self) -> Friction:
        """See :class:`~hhr_dolfinx.models.answer.InterfaceCompletion`."""
        return self.friction

    def differences(self, problem: ContactProblem, point: np.ndarray) -> str:
        """See :class:`~hhr_dolfinx.models.answer.InterfaceCompletion`."""
        law: Any = problem.law
        bounds_ = zip(self.friction.bounds(point), law.bounds(point), strict=True)
        mark = mark_of(problem)
        sizes = np.maximum(np.abs(mark), np.abs(self.mark))
        alike = all(one.shape == other.shape and np.allclose(one, other, rtol=ALIKE) for one, other in bounds_)
        same = alike and not (np.abs(mark - self.mark) > ALIKE * sizes).any()
        return "" if same else "its stiffness, its loads, its gaps or its friction"

    @cached_property
    def inside(self) -> Friction:
        """Friction of the RID, with the row numbers of the RID."""
        return self.friction.within(self.within)

    @cached_property
    def own(self) -> np.ndarray:
        """Indices of the tangential rows of the RID among all tangential ones, in the order of the RID."""
        return np.searchsorted(self.friction.tangential, self.within[self.inside.tangential])

    @cached_property
    def outside(self) -> np.ndarray:
        """Contacts outside the RID, (c,)."""
        return np.flatnonzero(~np.isin(self.friction.normal, self.within))

    @cached_property
    def rows_outside(self) -> np.ndarray:
        """Indices of the tangential rows outside the RID among all tangential ones, (t,)."""
        return np.flatnonzero(~np.isin(self.friction.tangential, self.within))

    @cached_property
    def _elsewhere(self) -> tuple[np.ndarray, np.ndarray]:
        """Conditions outside the RID, and the matrix from forces in the RID to theirs."""
        rows = np.setdiff1d(np.arange(len(self.modes)), self.within)
        return rows, self.modes[rows] @ self.fit

    @cached_property
    def _pressing_outside(self) -> np.ndarray:
        """Normal conditions outside the RID."""
        return np.setdiff1d(self._elsewhere[0], self.friction.tangential)

    def forces(self, inside: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Forces on all conditions from those of the RID, (m,), limited by the laws at a point, (N_lambda,)."""
        found, _, size, admitted, beyond = self._unlimited(inside, point)
        share = np.divide(admitted, size, out=np.ones(size.size), where=beyond)
        found[self.friction.tangential] *= share[self.friction.owner]
        return found

    def _unlimited(self, inside: np.ndarray, point: np.ndarray) -> tuple[np.ndarray, ...]:
        """Fitted forces, open conditions; of tangential forces the size, the limit, and whether it is exceeded."""
        friction = self.friction
        found = self._fitted(inside)
        pressing = self._pressing_outside
        # a pressure within the error of the fit is none
        off = pressing[found[pressing] <= PRESSED * np.abs(inside).max(initial=0.0)]
        found[off] = 0.0
        size = friction.lengths(found[friction.tangential])
        admitted = bounds(*friction.bounds(point), found[friction.normal])
        beyond = np.zeros(size.size, dtype=bool)
        beyond[self.outside] = size[self.outside] > admitted[self.outside]
        return found, off, size, admitted, beyond

    def force_changes(self, inside: np.ndarray, changes: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Derivatives of :meth:`forces`, (N_lambda, P), from those of the RID, (m, P)."""
        friction = self.friction
        found, off, size, admitted, beyond = self._unlimited(inside, point)
        slopes = self._fitted(changes)
        slopes[off] = 0.0
        coefficient, limit = friction.bounds(point)
        rows = friction.tangential[beyond[friction.owner]]
        owner = friction.owner[beyond[friction.owner]]
        of_coefficient, of_limit = friction.bound_slopes(point)
        pressure = found[friction.normal][:, None]
        with np.errstate(invalid="ignore"):  # of Tresca's law, which has no coefficient
            carried = coefficient[:, None] * slopes[friction.normal] + of_coefficient * pressure
        of_bound = np.where((admitted < limit)[:, None], carried, of_limit)
        # bound t / |t| of a fitted force t
        along = (found[rows] / size[owner])[:, None]
        grown = np.zeros((size.size, slopes.shape[1]))
        np.add.at(grown, owner, along * slopes[rows])
        turned = (admitted / np.where(size > 0, size, 1.0))[owner, None] * (slopes[rows] - along * grown[owner])
        slopes[rows] = along * of_bound[owner] + turned
        return slopes

    def _fitted(self, inside: np.ndarray) -> np.ndarray:
        """Values in the RID, (m, ...), completed by the modes elsewhere, (N_lambda, ...)."""
        rows, per_force = self._elsewhere
        found = np.empty((len(self.modes), *inside.shape[1:]))
        found[self.within] = inside
        found[rows] = per_force @ inside
        return found

    def misfit(self, inside: np.ndarray) -> float:
        """Part of the forces in the RID, (m,), that no mode of training explains, from 0 to 1; 0 without forces.

        It is proportional to the error of all forces, see docs/friction.md: the modes come from training, the contact
        forces from this increment.
        """
        size = float(np.linalg.norm(inside))
        if not size > 0:
            return 0.0 if size == 0 else math.inf
        return float(np.linalg.norm(inside - self.modes[self.within] @ (self.fit @ inside))) / size

    def indicated(self, inside: np.ndarray, slack: np.ndarray, scale: np.ndarray) -> float:
        """See :class:`InterfaceCompletion`; infinite if bodies overlap outside the RID."""
        deep = self.overlap(slack, scale)
        if deep > max(DEEP * self.depth, SHALLOW) or (deep > ROUND_OFF and not inside.any()):
            return math.inf
        return self.share * self.misfit(inside)

    def overlap(self, slack: np.ndarray, scale: np.ndarray) -> float:
        """Deepest overlap outside the RID, over the gap scale; 0 if none."""
        rows = self._pressing_outside
        return float((-slack[rows] / scale[rows]).max(initial=0.0))

    def active(self, inside: np.ndarray, forces: np.ndarray, bound: np.ndarray) -> np.ndarray:
        """Statuses of all conditions, (N_lambda,): of the RID as given, (m,) bool, and elsewhere from the forces."""
        friction = self.friction
        found = np.zeros(len(self.modes), dtype=bool)
        found[friction.normal] = forces[friction.normal] > 0
        sticks = found[friction.normal] & (friction.lengths(forces[friction.tangential]) < (1.0 - FULL) * bound)
        found[friction.tangential] = sticks[friction.owner]
        found[self.within] = inside
        return found
