"""Condensation on the contact, interpolated: S(mu) and the free slack of a scene whose stiffness depends on parameters.

Bodies touch only through contact, so that S = sum of S_c over what hangs together, each smooth in the parameters of its
own. Where all of a part has one factor E(mu), S_c = S_c(E = 1) / E, which is exact; what is left is interpolated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.models.interpolation import Interpolant, split

if TYPE_CHECKING:
    from hhr_dolfinx.formulas import Scalar


@dataclass(frozen=True)
class Compliance:
    """What one part of a scene that hangs together leaves of itself once it is eliminated.

    Attributes:
        conditions: contact conditions that act on it, (m_c,).
        forced: terms of θ whose loads act on it, (T_F,).
        lifted: terms whose imposed displacements do, (T_L,).
        factor: the modulus that all of it has in common; None for none, or one that is constant.
        interpolant: of S_c, B K^-1 F and B K^-1 K lift beside each other, for the factor 1.
    """

    conditions: np.ndarray
    forced: np.ndarray
    lifted: np.ndarray
    factor: Scalar | None
    interpolant: Interpolant

    @property
    def shapes(self) -> dict[str, tuple[int, int]]:
        """Shapes of what the interpolant holds, in its order."""
        m = self.conditions.size
        return {"schur": (m, m), "forced": (m, self.forced.size), "lifted": (m, self.lifted.size)}


@dataclass(frozen=True)
class Compliances:
    """All parts of a scene; maps a point to an :class:`InterpolatedElimination`.

    Attributes:
        parts: of the scene.
        amplitudes: θ as a function of the parameters.
        gaps: D as terms of θ, (m, 1 + T); as an interpolant where they change with the shape.
        terms: 1 + T.
        size: m.
        parameters: number of parameters.
    """

    parts: tuple[Compliance, ...]
    amplitudes: Amplitudes
    gaps: np.ndarray | Interpolant
    terms: int
    size: int
    parameters: int

    def __call__(self, point: np.ndarray) -> InterpolatedElimination:
        """S and the free slack at a point, (P,)."""
        theta = _dense(self.amplitudes, point, self.terms)
        slack = self.gaps_at(point) @ theta
        schur = np.zeros((self.size, self.size))
        for part in self.parts:
            compliance = 1.0 if part.factor is None else 1.0 / part.factor.value(point)
            values = split(part.interpolant.value(point), part.shapes)
            moved = compliance * (values["forced"] @ theta[part.forced])
            if part.lifted.size:
                moved -= values["lifted"] @ theta[part.lifted]
            if part.conditions.size == self.size:  # all of them, in their order
                schur += compliance * values["schur"]
                slack -= moved
            else:
                schur[part.conditions[:, None], part.conditions] += compliance * values["schur"]
                slack[part.conditions] -= moved
        return InterpolatedElimination(self, point, schur, slack)

    def gaps_at(self, point: np.ndarray) -> np.ndarray:
        """D at a point, (m, 1 + T)."""
        if isinstance(self.gaps, Interpolant):
            return self.gaps.value(point).reshape(self.size, self.terms)
        return self.gaps


@dataclass(frozen=True)
class InterpolatedElimination:
    """See :class:`hhr_dolfinx.models.varying.Elimination`; the primal unknown is left out.

    Attributes:
        owner: what it was made by.
        point: the parameter, (P,).
        schur, free_slack: as there.
    """

    owner: Compliances
    point: np.ndarray
    schur: np.ndarray
    free_slack: np.ndarray

    def unknown(self, forces: np.ndarray) -> np.ndarray:
        """None: fields are made when somebody asks."""
        return np.zeros(0)

    def pushed(self, forces: np.ndarray) -> np.ndarray:
        """Nothing of nothing."""
        return np.zeros((0, *forces.shape[1:]))

    def at_fixed_forces(self, forces: np.ndarray, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of gaps, free displacement and S times forces."""
        owner, point = self.owner, self.point
        theta, slopes = _dense(owner.amplitudes, point, owner.terms), _dense_slopes(owner.amplitudes, point, owner.terms)
        slack = owner.gaps_at(point) @ slopes
        if isinstance(owner.gaps, Interpolant):
            changes = owner.gaps.derivative(point)
            for axis, column in zip(owner.gaps.axes, changes.T, strict=True):
                slack[:, axis] += column.reshape(owner.size, owner.terms) @ theta
        for part in owner.parts:
            slack[part.conditions] += _of_part(part, point, theta, slopes, forces[part.conditions])
        return slack, np.zeros((0, owner.parameters))


def _of_part(
    part: Compliance, point: np.ndarray, theta: np.ndarray, slopes: np.ndarray, forces: np.ndarray
) -> np.ndarray:
    """Derivatives of what a part adds to the slack while the forces stay, (m_c, P)."""

    def added(values: dict[str, np.ndarray]) -> np.ndarray:
        return values["schur"] @ forces - values["forced"] @ theta[part.forced]

    values = split(part.interpolant.value(point), part.shapes)
    compliance, change = 1.0, np.zeros(slopes.shape[1])
    if part.factor is not None:
        modulus = part.factor.value(point)
        compliance, change = 1.0 / modulus, -part.factor.derivative(point) / modulus**2
    found = np.outer(added(values), change)
    found -= compliance * (values["forced"] @ slopes[part.forced])
    found += values["lifted"] @ slopes[part.lifted]
    for axis, column in zip(part.interpolant.axes, part.interpolant.derivative(point).T, strict=True):
        changed = split(column, part.shapes)
        found[:, axis] += compliance * added(changed) + changed["lifted"] @ theta[part.lifted]
    return found


def _dense(amplitudes: Amplitudes, point: np.ndarray, terms: int) -> np.ndarray:
    """θ as an array, (1 + T,)."""
    theta, found = amplitudes(point), np.zeros(terms)
    found[theta.terms] = theta.values
    return found


def _dense_slopes(amplitudes: Amplitudes, point: np.ndarray, terms: int) -> np.ndarray:
    """Derivatives of θ as an array, (1 + T, P)."""
    acting, slopes = amplitudes.slopes_at(point)
    found = np.zeros((terms, slopes.shape[1]))
    found[acting] = slopes
    return found
