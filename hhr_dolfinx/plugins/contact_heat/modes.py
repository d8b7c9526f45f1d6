"""Modes of transient heat: how temperatures approach their steady ones."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import csc_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import eigsh, splu

from hhr_dolfinx.plugins.contact_heat.conduction import HeatSystem, steady_fields
from hhr_dolfinx.plugins.contact_heat.parts import Conduction

SHORTER = 10.0
"""Slowest rate over that of the longest step that modes are made for."""
PER_DECADE = 2
"""Lengths of steps for which modes are made, per factor of ten; more where they are not enough."""
DENSER = 3
"""Most times that this number is doubled."""
KEPT_PART = 0.2
"""Part of the tolerance below which directions of temperatures are left out."""
SHIFT = 1e-6
"""Part of the mean rate by which matrices are shifted that are singular without a temperature."""


class Modes(NamedTuple):
    """Temperatures that decay each at its own rate (r modes); largest value 1."""

    shapes: np.ndarray  #: (n, r)
    rates: np.ndarray  #: (r,)
    capacities: np.ndarray  #: shape^T M_T shape, (r,)

    def reading(self, capacity: csr_matrix) -> np.ndarray:
        """Amplitude of each mode in temperatures of the nodes, (r, n).

        Args:
            capacity: M_T, (n, n).
        """
        found: np.ndarray = (capacity @ self.shapes).T / self.capacities[:, None]
        return found


class TransientHeat(NamedTuple):
    """Transient heat of a scene, eliminated down to heat flows of contacts and modes."""

    conduction: Conduction
    modes: Modes
    step_error: float  #: see :class:`hhr_dolfinx.plugins.contact_heat.parts.TransientParts`


def transient_heat(system: HeatSystem, tolerance: float) -> TransientHeat:
    """Steady temperatures and modes of the deviation from them.

    M T' + K T = f has T = T_s + sum of e_i phi_i, where T_s is steady, and e_i' + lambda_i e_i =
    -phi_i^T M T_s'. Levels of bodies that contact alone feeds are modes without decay, which heat
    feeds. Modes are Ritz vectors of the temperatures after one implicit step of each length h,
    (M + h K)^-1 M T_s for each supply, heat flow and body that is warm all over: a rational Krylov
    space.

    Args:
        system: heat of a scene, with its capacity.
        tolerance: see :func:`hhr_dolfinx.plugins.contact_heat.making.condense_transient_heat`.
    """
    levels = _modes(system.capacity, system.levels, np.zeros(system.levels.shape[1]))
    temperatures, per_heat = _without_levels(system, levels)
    warm = _warm_bodies(system)
    stepping = _Stepping(system, np.hstack([temperatures, per_heat, warm]))
    shapes, rates, error = stepping.ritz(levels, tolerance)
    modes = _modes(system.capacity, shapes, rates)
    fed = system.levels.shape[1]
    supplied = np.zeros((rates.size, system.loads.shape[1]))
    supplied[:fed] = levels.shapes.T @ system.loads
    conduction = Conduction(
        amplitudes=system.amplitudes,
        temperatures=temperatures,
        per_heat=per_heat,
        levels=modes.shapes,
        jumps=csc_matrix(system.jumps),
        supplied=supplied,
    )
    return TransientHeat(conduction, modes, error)


def _modes(capacity: csr_matrix, shapes: np.ndarray, rates: np.ndarray) -> Modes:
    """Modes whose largest value is 1, whatever the sign of a method."""
    scaled = shapes / shapes[np.abs(shapes).argmax(axis=0), np.arange(rates.size)]
    return Modes(scaled, rates, np.einsum("nr,nr->r", scaled, capacity @ scaled))


def _without_levels(system: HeatSystem, levels: Modes) -> tuple[np.ndarray, np.ndarray]:
    """Steady temperatures per supply, (n, t), and their fall per heat flow, (n, m); bodies that
    contact alone feeds lose what they are given, all over, and are at 0 in the mean.
    """

    def balanced(heat: np.ndarray) -> np.ndarray:
        warming = levels.shapes.T @ heat / levels.capacities[:, None]
        return heat - system.capacity @ (levels.shapes @ warming)

    reading = levels.reading(system.capacity)
    fields = steady_fields(system, balanced(system.loads), balanced(system.jumps.T.toarray()))
    first, second = (field - levels.shapes @ (reading @ field) for field in fields)
    return first, second


def _warm_bodies(system: HeatSystem) -> np.ndarray:
    """1 in each part of the mesh, from which histories start, (n, parts)."""
    count, owner = connected_components(system.stiffness, directed=False)
    return (owner[:, None] == np.arange(count)).astype(float)


class _Stepping:
    """Temperatures after one step from steady ones, where temperatures are not fixed (k nodes).

    Args:
        system: heat of a scene.
        fields: steady temperatures, (n, f).
    """

    def __init__(self, system: HeatSystem, fields: np.ndarray):
        self._count = len(fields)
        self._fed = system.levels.shape[1]
        self._free = np.setdiff1d(np.arange(self._count), system.fixed)
        self._stiffness = csc_matrix(system.stiffness[self._free][:, self._free])
        self._capacity = csc_matrix(system.capacity[self._free][:, self._free])
        stored = (system.capacity @ fields)[self._free]
        near = splu(self._capacity).solve(stored)
        sizes = np.sqrt(np.einsum("kf,kf->f", near, stored))
        self._stored = stored[:, sizes > 0] / sizes[sizes > 0]

    def ritz(self, levels: Modes, tolerance: float) -> tuple[np.ndarray, np.ndarray, float]:
        """Shapes of modes, (n, r), their rates, (r,), and the largest error of a step; levels are
        the first of them.

        Args:
            levels: modes without decay.
            tolerance: largest error of a step; 0 for all modes.
        """
        start = (levels.shapes / np.sqrt(levels.capacities))[self._free]
        if tolerance == 0:
            rates, basis = eigh(self._stiffness.toarray(), self._capacity.toarray())
            basis[:, : self._fed] = start
            basis = self._added(start, basis[:, self._fed :], 0.0)
            return *self._projected(basis), 0.0
        lengths = self._lengths()
        basis = start
        for length in lengths:
            basis = self._added(basis, self._after(length), KEPT_PART * tolerance)
        for _ in range(DENSER):
            between = np.sqrt(lengths[1:] * lengths[:-1])
            shapes, rates = self._projected(basis)
            fields = [self._after(length) for length in between]
            pairs = zip(between, fields, strict=True)
            error = max(self._error(shapes[self._free], rates, *pair) for pair in pairs)
            if error <= tolerance:
                break
            for field in fields:
                basis = self._added(basis, field, KEPT_PART * tolerance)
            lengths = np.sort(np.concatenate([lengths, between]))
        return shapes, rates, error

    def _lengths(self) -> np.ndarray:
        """Lengths of steps, from below the fastest decay of the mesh to above the slowest."""
        diagonals = self._stiffness.diagonal() / self._capacity.diagonal()
        start = np.random.default_rng(0).uniform(-1.0, 1.0, self._free.size)
        shift = SHIFT * float(diagonals.mean())
        count = min(self._fed + 1, self._free.size - 1)
        slow = eigsh(
            self._stiffness,
            count,
            self._capacity,
            sigma=-shift,
            v0=start,
            return_eigenvectors=False,
        )
        ends = 1.0 / diagonals.max(), SHORTER / max(float(slow.max()), shift)
        decades = max(np.log10(ends[1] / ends[0]), 0.0)
        return np.geomspace(*ends, 2 + int(np.ceil(PER_DECADE * decades)))

    def _after(self, length: float) -> np.ndarray:
        """Temperatures after a step of a length whose steady ones vanish, (k, f)."""
        found: np.ndarray = splu(csc_matrix(self._capacity + length * self._stiffness)).solve(
            self._stored
        )
        return found

    def _added(self, basis: np.ndarray, fields: np.ndarray, least: float) -> np.ndarray:
        """The basis with what fields have beside it, without directions of smaller sizes."""
        rest = fields
        for _ in range(2):  # once leaves round-off of the first fields
            rest = rest - basis @ (basis.T @ (self._capacity @ rest))
        squares, turned = np.linalg.eigh(rest.T @ (self._capacity @ rest))
        kept = squares > max(least, 1e-7 * np.sqrt(max(squares.max(initial=0.0), 0.0))) ** 2
        return np.hstack([basis, (rest @ turned[:, kept]) / np.sqrt(squares[kept])])

    def _projected(self, basis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Modes in the span of a basis, (n, r), and their rates, (r,)."""
        others = basis[:, self._fed :]
        rates, turned = eigh(
            others.T @ (self._stiffness @ others), others.T @ (self._capacity @ others)
        )
        shapes = np.zeros((self._count, basis.shape[1]))
        shapes[self._free] = np.hstack([basis[:, : self._fed], others @ turned])
        return shapes, np.concatenate([np.zeros(self._fed), rates])

    def _error(
        self, shapes: np.ndarray, rates: np.ndarray, length: float, fields: np.ndarray
    ) -> float:
        """Largest error of a step by modes whose sizes are 1, over the size of steady ones."""
        found = (shapes.T @ self._stored) / (1.0 + length * rates)[:, None]
        missed = fields - shapes @ found
        squares = np.einsum("kf,kf->f", missed, self._capacity @ missed)
        return float(np.sqrt(squares.max(initial=0.0)))
