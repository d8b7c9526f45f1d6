"""Active set of bodies that only contact holds: their rigid motions are unknowns in addition to the
contact forces.

With r rigid motions and their amplitudes q, elimination of the displacement leaves the contact
problem

    slack = free_slack + S lambda - G q >= 0,   lambda >= 0,   G^T lambda = driving,

where G = B R is the effect of the motions on the contact rows. The last equation is the balance of
forces along the motions, of whole bodies in a reduced model too. On a set of statuses this is one
linear system. It is singular if the set does not hold all bodies. Then, or if statuses cycle, weak
springs hold the bodies: with a stiffness k the motions are q0 + (driving - G^T lambda) / k, and S +
G G^T / k is that of held bodies. Updating the ends q0 of the springs is the proximal point method
(R. T. Rockafellar, SIAM J. Control Optim. 14, 1976), which ends in finitely many steps for such
problems.

The forces of a solution need not determine the motions. Example: two nodes of a disc that bear
force allow a rotation about the point where their normals meet, as long as no other node touches.
All of these motions are solutions. Every model returns the one of least norm, see
:func:`open_motions`.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import lsq_linear, nnls

from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, Status, Statuses, active_set
from hhr_dolfinx.errors import SingularError
from hhr_dolfinx.linear.dense import LapackLU

SPRING_COMPLIANCES = (1e3, 1e5, 1e7, 1e9)
"""Compliances of the springs over that of the bodies: weaker springs need fewer steps and lose more
digits.
"""
PROXIMAL_STEPS = 30
"""Steps of the proximal point method with springs of one kind; two or three are usual."""
BALANCED_FORCES = 1e-12
"""Relative imbalance of the forces up to which they count as balanced."""
BODY_BALANCE_ROUND_OFF = 1e-13
"""Round-off in the balance of one body, relative to the forces on all bodies."""
ACTING = 1e-12
"""Part of the largest share of a row in the least motion, up to which the row counts as
inactive.
"""
GAP_ROUND_OFF = 1e-14
"""Part of the force that would close the largest gap, up to which a force is round-off of that
gap.
"""
BEARING = 1e-9
BEARING_OF_GAPS = 1e-12
"""Parts of the largest contact force, and of the force that would close the largest gap, up to
which a condition bears no force that holds a body: loads balance each other only up to round-off.
"""
EFFECTIVE_MOTION = 1e-10
"""Ratio of the squares of the least and the largest effect of motions above which none is without
effect: far above the square of SINGULAR_EQUALITIES, so that an SVD, which takes as long as the
rest of an answer, would find none either.
"""
SINGULAR_EQUALITIES = 1e-8
"""Relative residual of an equality problem above which it counts as singular."""


class FloatingEqualities:
    """Equality problems on S, (m, m), with rigid motions, whose effect on the contact rows is G = B
    R, (m, r).
    """

    def __init__(self, schur: np.ndarray, contact_of_motions: np.ndarray):
        self.schur = schur
        self.contact_of_motions = contact_of_motions
        count = contact_of_motions.shape[1]
        # each motion in a unit that makes its column as large as those of S: rotations of a nearly
        # round body have little effect
        self._size = float(np.abs(np.diag(schur)).mean() or 1.0)
        largest = np.abs(contact_of_motions).max(axis=0, initial=0.0)
        self._units = self._size / np.where(largest > 0, largest, 1.0)
        scaled = contact_of_motions * self._units
        self._whole = np.block([[schur, -scaled], [scaled.T, np.zeros((count, count))]])
        self._equalities = SchurEqualities.of(self._whole, LapackLU)

    def __call__(
        self, active: np.ndarray, free_slack: np.ndarray, driving: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Forces and slack, (m,) each, and motions, (r,).

        SingularError if the statuses do not hold all bodies.
        """
        both = np.concatenate([active, np.ones(driving.size, dtype=bool)])
        right = np.concatenate([free_slack, -self._units * driving])
        solution, slack = self._equalities(both, right)
        m = active.size
        residual = right[both] + self._whole[np.ix_(both, both)] @ solution[both]
        largest = np.abs(right).max(initial=1e-300)
        held = np.abs(residual).max() <= SINGULAR_EQUALITIES * largest
        # a singular system may have a solution to round-off, with motions of any size
        held = (
            held
            and self._size * np.abs(solution[m:]).max(initial=0.0) <= largest / SINGULAR_EQUALITIES
        )
        if not held or not self.balanced(solution[:m], driving).all():
            raise SingularError("the conditions that touch do not hold all bodies")
        return solution[:m], slack[:m], self._units * solution[m:]

    def bearing(self, forces: np.ndarray, free_slack: np.ndarray) -> np.ndarray:
        """Conditions that bear a force above round-off, (m,) bool.

        Args:
            forces: contact forces, (m,).
            free_slack: slack without contact forces, (m,).
        """
        closing = np.abs(free_slack).max(initial=0.0) / self._size
        return forces > BEARING * forces.max(initial=0.0) + BEARING_OF_GAPS * closing

    def left_open(self, bearing: np.ndarray) -> np.ndarray:
        """Orthonormal motions without effect on some conditions, (r, d)."""
        rows = self.contact_of_motions[bearing] * self._units
        count = rows.shape[1]
        if not rows.shape[0]:
            return np.eye(count)
        sizes = np.linalg.eigvalsh(rows.T @ rows)
        if sizes[0] > EFFECTIVE_MOTION * sizes[-1]:
            return np.zeros((count, 0))
        # all columns of G are as large as S here; a zero column is a motion without effect on any
        # condition
        ways = null_space(np.vstack([rows, np.zeros((count, count))]), rcond=SINGULAR_EQUALITIES)
        return np.linalg.qr(self._units[:, None] * ways)[0]

    def balanced(self, forces: np.ndarray, driving: np.ndarray, nothing: float = 0.0) -> np.ndarray:
        """Mask of the motions along which forces balance the loads up to round-off, (r,) bool.

        Round-off is measured by all loads too: those along a motion may be far below those of a
        heavier body.

        Args:
            forces: contact forces, (m,).
            driving: loads along the motions, (r,).
            nothing: force that counts as none.
        """
        units = self._units
        imbalance = units * np.abs(driving - forces @ self.contact_of_motions)
        sizes = units * (np.abs(driving) + np.abs(forces) @ np.abs(self.contact_of_motions))
        return (
            imbalance
            <= SINGULAR_EQUALITIES * sizes
            + BODY_BALANCE_ROUND_OFF * sizes.max(initial=0.0)
            + units * nothing
        )

    @cached_property
    def springs(self) -> tuple[tuple[np.ndarray, SchurEqualities], ...]:
        """Compliances of springs along each motion, 1 / k, (r,), and equality problems of bodies on
        them.
        """
        push = (self.contact_of_motions**2).mean(axis=0)
        unit = self._size / np.where(push > 0, push, 1.0)
        springs = []
        for compliance in (unit * weak for weak in SPRING_COMPLIANCES):
            held = self.schur + (self.contact_of_motions * compliance) @ self.contact_of_motions.T
            springs.append((compliance, SchurEqualities.of(held, LapackLU)))
        return tuple(springs)

    def several(
        self, active: np.ndarray, free_slacks: np.ndarray, drivings: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        """Solutions of least motions for many right-hand sides.

        Args:
            active: statuses, (m,) bool.
            free_slacks: slacks without contact forces, (m, k).
            drivings: loads along the motions, (r, k).

        Returns:
            Forces and slacks, (m, k) each, and motions, (r, k).
        """
        both = np.concatenate([active, np.ones(len(drivings), dtype=bool)])
        right = np.concatenate([free_slacks, -self._units[:, None] * drivings])
        solution = np.zeros_like(right)
        solution[both] = -np.linalg.lstsq(
            self._whole[np.ix_(both, both)], right[both], rcond=SINGULAR_EQUALITIES
        )[0]
        m = active.size
        slacks = (right + self._whole @ solution)[:m]
        slacks[active] = 0.0
        return solution[:m], slacks, self._units[:, None] * solution[m:]


class OpenMotions(NamedTuple):
    """Rigid motions that contact forces leave undetermined: orthonormal ones, ``ways``, (r, d), d
    >= 1.

    ``shift`` is the difference between the motions of least norm and those that were found, (r,),
    and ``opened`` are the conditions without force that were closed and are open after the shift,
    (m,) bool.
    """

    ways: np.ndarray
    shift: np.ndarray
    opened: np.ndarray


def open_motions(
    equalities: FloatingEqualities,
    forces: np.ndarray,
    free_slack: np.ndarray,
    slack: np.ndarray,
    motions: np.ndarray,
) -> OpenMotions | None:
    """Motions that no bearing condition resists; None if the forces determine all of them.

    Args:
        equalities: equality problems on S with the motions.
        forces: contact forces, (m,).
        free_slack: slack without contact forces, (m,).
        slack: slack of the solution, (m,).
        motions: amplitudes of the orthonormal motions of the solution, (r,).
    """
    bearing = equalities.bearing(forces, free_slack)
    ways = equalities.left_open(bearing)
    if not ways.shape[1]:
        return None
    rows = equalities.contact_of_motions[~bearing] @ ways
    # motions along a surface open it by round-off, which is no limit
    rows[np.abs(rows) <= ACTING * np.abs(equalities.contact_of_motions).max()] = 0.0
    change = _nearest(rows, np.maximum(slack[~bearing], 0.0), -ways.T @ motions)
    shift = ways @ change
    opening = -equalities.contact_of_motions @ shift
    return OpenMotions(
        ways, shift, ~bearing & (opening > BEARING * np.abs(opening).max(initial=0.0))
    )


def _nearest(rows: np.ndarray, limits: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The point w with rows w <= limits that is nearest to a target, (d,); w = 0 must satisfy them.

    Least distance by non-negative least squares: C. L. Lawson and R. J. Hanson, Solving Least
    Squares Problems, 1974, chapter 23.
    """
    beyond = rows @ target - limits
    if not (beyond > 0).any():
        return target
    system = np.vstack([-rows.T, beyond])
    unit = np.zeros(len(system))
    unit[-1] = 1.0

    def point(shares: np.ndarray) -> np.ndarray:
        acting = shares > ACTING * shares.max()
        # the residual of the least squares has half of the digits of the point; active rows give
        # all of them
        return target - np.linalg.lstsq(rows[acting], beyond[acting], rcond=None)[0]

    # nnls of scipy 1.15 stops too early, and bvls where rows are opposite, as examples of the tests
    # show
    nearest = point(lsq_linear(system, unit, bounds=(0.0, np.inf), method="bvls", tol=1e-15).x)
    if (rows @ nearest - limits).max() <= SINGULAR_EQUALITIES * beyond.max():
        return nearest
    return min(
        nearest, point(nnls(system, unit)[0]), key=lambda one: float((rows @ one - limits).max())
    )


def floating_set(
    equalities: FloatingEqualities,
    free_slack: np.ndarray,
    driving: np.ndarray,
    start: np.ndarray,
    pairs: Pairs | None = None,
) -> tuple[Statuses, np.ndarray]:
    """Active set with rigid motions, see :func:`active_set`.

    Args:
        equalities: equality problems on S with the motions.
        free_slack: slack without contact forces, (m,).
        driving: loads along the motions, (r,).
        start: statuses to start from, (m,) bool.
        pairs: contact pair of each condition; None for one pair.

    Returns:
        The statuses, ADRIFT if loads along the motions meet no contact, and the motions, (r,).
    """
    direct = _direct(equalities, free_slack, driving, start, pairs)
    if direct is not None:
        return direct
    contact_of_motions = equalities.contact_of_motions
    # forces that only close round-off of the gaps: without loads there are no other forces to
    # compare with
    nothing = (
        GAP_ROUND_OFF * np.abs(free_slack).max() / (np.abs(np.diag(equalities.schur)).mean() or 1.0)
    )
    ends = np.zeros(driving.size)
    spent = 0
    active = start
    for compliance, sprung in (
        spring for spring in equalities.springs for _ in range(PROXIMAL_STEPS)
    ):
        offset = ends + compliance * driving
        sprung_set = active_set(
            sprung, free_slack - contact_of_motions @ offset, active, pairs=pairs
        )
        spent += sprung_set.iterations
        if sprung_set.status is not Status.CONVERGED:
            return sprung_set._replace(iterations=spent, cycled=True), ends
        imbalance = driving - sprung_set.forces @ contact_of_motions
        ends = ends + compliance * imbalance
        active = sprung_set.active
        largest = (np.abs(driving) + sprung_set.forces @ np.abs(contact_of_motions)).max()
        close = np.abs(imbalance) <= BALANCED_FORCES * largest + nothing
        if (close & equalities.balanced(sprung_set.forces, driving, nothing)).all():
            return sprung_set._replace(iterations=spent, cycled=True), ends
        direct = _direct(equalities, free_slack, driving, active, pairs)
        if direct is not None:
            statuses, ends = direct
            return statuses._replace(iterations=spent + statuses.iterations, cycled=True), ends
    return Statuses(np.zeros(start.size), start, spent, Status.ADRIFT, True), ends


def _direct(
    equalities: FloatingEqualities,
    free_slack: np.ndarray,
    driving: np.ndarray,
    start: np.ndarray,
    pairs: Pairs | None,
) -> tuple[Statuses, np.ndarray] | None:
    """The plain active set; None if a set on the way is singular, or statuses cycle."""

    def equality(active: np.ndarray, slack: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return equalities(active, slack, driving)[:2]

    try:
        statuses = active_set(equality, free_slack, start, pairs=pairs)
        if statuses.status is not Status.CONVERGED or statuses.cycled:
            return None
        return statuses, equalities(statuses.active, free_slack, driving)[2]
    except SingularError:
        return None
