"""Modes of transient heat: how temperatures approach their steady ones."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import bmat, csc_matrix
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import eigsh, splu

from hhr_dolfinx.plugins.contact_heat.conduction import HeatSystem
from hhr_dolfinx.plugins.contact_heat.parts import Conduction

LONGER = 10.0
"""Longest step that modes are made for, times the slowest rate but that of a level."""
SHORTER = 0.1
"""Shortest step that modes are made for, times the largest rate of a node: K_ii / M_ii."""
PER_DECADE = 2
"""Lengths of steps for which modes are made, per factor of ten; more where they are not enough."""
DENSER = 2
"""Most times that this number is doubled."""
KEPT_PART = 0.2
"""Part of the tolerance below which directions of temperatures are left out."""
INDEPENDENT = 1e-7
"""Size of a direction, of temperatures of size 1, that is not round-off of others."""
SINGULAR_SHIFT = 1e-6
"""Part of the mean rate of a node by which matrices are shifted that are singular without a
temperature; decay that is slower counts as that.
"""
UNBALANCED = 1e-11
"""Part of its size up to which heat or a change of temperatures is round-off."""


class TransientHeat(NamedTuple):
    """Transient heat of a scene, eliminated down to heat flows of contacts and modes."""

    conduction: Conduction
    rates: np.ndarray  #: of decay, (r,)
    grown: np.ndarray  #: growth of amplitudes per supply and time, (r, t)
    drained: np.ndarray  #: fall of amplitudes per heat flow and time, (r, m)
    step_error: float  #: see :class:`hhr_dolfinx.plugins.contact_heat.parts.TransientParts`


def transient_heat(system: HeatSystem, tolerance: float, shortest: float = 0.0) -> TransientHeat:
    """Temperatures of the balanced part of heat, and modes of the deviation from them.

    M T' + K T = f has T = T_s + sum of e_i phi_i with K T_s = f - c M 1, and e_i' + lambda_i e_i =
    -phi_i^T M T_s' + c phi_i^T M 1, where phi_i^T M phi_i = 1. In a body without a fixed
    temperature c makes the mean of T_s vanish: it is the rate at which the body warms where nothing
    cools it. Elsewhere c is 0. Modes are Ritz vectors of the temperatures after one implicit step
    of each length h, (M + h K)^-1 M T_s for each supply, heat flow and body that is warm all over:
    a rational Krylov space, of each body for itself.

    Args:
        system: heat of a scene, with its capacity.
        tolerance: see :func:`hhr_dolfinx.plugins.contact_heat.making.condense_transient_heat`.
        shortest: likewise; 0 for steps of any length.
    """
    size, supplies = system.lifted.shape
    flows = system.jumps.shape[0]
    fields = np.zeros((size, supplies + flows))
    found = []
    for body in _bodies(system):
        steady, warming = body.steady()
        fields[body.nodes] = steady
        found.append((body, warming, *body.modes(steady, tolerance, shortest)))
    rates = np.concatenate([one.rates for _, _, one, _ in found])
    order = np.argsort(rates, kind="stable")
    shapes = np.zeros((size, rates.size))
    grown = np.zeros((rates.size, supplies + flows))
    first = 0
    for body, warming, modes, _ in found:
        rows = slice(first, first + modes.rates.size)
        shapes[body.nodes, rows] = modes.shapes
        grown[rows] = np.outer(body.amplitudes_of_level(modes), warming)
        first = rows.stop
    conduction = Conduction(
        amplitudes=system.amplitudes,
        temperatures=fields[:, :supplies],
        per_heat=fields[:, supplies:],
        levels=shapes[:, order],
        jumps=csc_matrix(system.jumps),
        supplied=np.zeros((rates.size, supplies)),
    )
    error = max(one[-1] for one in found)
    of_supplies, of_flows = np.split(grown[order], [supplies], axis=1)
    return TransientHeat(conduction, rates[order], of_supplies, of_flows, error)


class _DecayModes(NamedTuple):
    """Temperatures of a body that decay each at its own rate; largest value 1."""

    shapes: np.ndarray  #: (k, r)
    rates: np.ndarray  #: (r,)


class _Steps(NamedTuple):
    """Steps of one length whose changes are of size 1."""

    length: float
    starts: np.ndarray  #: temperatures before, (free, f)
    changes: np.ndarray  #: fall of the temperatures, (free, f)


def _bodies(system: HeatSystem) -> Iterator[_HeatedBody]:
    """Parts of the mesh, between which heat flows through contacts alone."""
    count, owner = connected_components(system.stiffness, directed=False)
    for number in range(count):
        yield _HeatedBody(system, np.flatnonzero(owner == number))


class _HeatedBody:
    """Heat of one part of the mesh (k nodes, f supplies and heat flows).

    Args:
        system: heat of a scene.
        nodes: its nodes, (k,).
    """

    def __init__(self, system: HeatSystem, nodes: np.ndarray):
        self.nodes = nodes
        self._all_of_stiffness = csc_matrix(system.stiffness[nodes][:, nodes])
        self._all_of_capacity = csc_matrix(system.capacity[nodes][:, nodes])
        self._heat = np.hstack([system.loads[nodes], system.jumps.T.toarray()[nodes]])
        self._lifted = np.hstack(
            [system.lifted[nodes], np.zeros((nodes.size, system.jumps.shape[0]))]
        )
        self._free = np.flatnonzero(~np.isin(nodes, system.fixed))
        self._has_level = self._free.size == nodes.size
        free = self._free
        self._stiffness = csc_matrix(self._all_of_stiffness[free][:, free])
        self._capacity = csc_matrix(self._all_of_capacity[free][:, free])
        ones = np.ones(nodes.size)
        sizes = np.abs(self._all_of_stiffness) @ ones
        # a body that nothing cools keeps its level: that mode is exact
        cooled = np.abs(self._all_of_stiffness @ ones).max() > UNBALANCED * sizes.max()
        self._kept = int(self._has_level and not cooled)

    def amplitudes_of_level(self, modes: _DecayModes) -> np.ndarray:
        """Amplitudes of the temperature 1 all over, (r,)."""
        stored = self._all_of_capacity @ modes.shapes
        sizes = np.einsum("kr,kr->r", modes.shapes, stored)
        found: np.ndarray = stored.sum(axis=0) / sizes
        return found

    def steady(self) -> tuple[np.ndarray, np.ndarray]:
        """T_s per supply and its fall per heat flow, (k, f), and c of both, (f,)."""
        free = self._free
        heat = self._heat - self._all_of_stiffness @ self._lifted
        found = self._lifted.copy()
        if not self._has_level:
            if free.size:
                found[free] += splu(self._stiffness).solve(np.ascontiguousarray(heat[free]))
            return found, np.zeros(heat.shape[1])
        level = self._all_of_capacity @ np.ones(self.nodes.size)
        level /= level.sum()
        scale = self._stiffness.diagonal().mean()
        border = csc_matrix(scale * level[:, None])
        balanced = heat - np.outer(level, heat.sum(axis=0))
        balanced[:, np.abs(balanced).max(axis=0) <= UNBALANCED * np.abs(heat).max(axis=0)] = 0.0
        factor = splu(csc_matrix(bmat([[self._stiffness, border], [border.T, None]])))
        solved = factor.solve(np.vstack([balanced, np.zeros(heat.shape[1])]))
        warming = (scale * solved[-1] + heat.sum(axis=0)) / self._capacity.sum()
        return solved[:-1], warming

    def modes(
        self, steady: np.ndarray, tolerance: float, shortest: float
    ) -> tuple[_DecayModes, float]:
        """Modes, and the largest error of a step.

        Args:
            steady: steady temperatures, (k, f).
            tolerance: largest error of a step; 0 for all modes.
            shortest: shortest step; 0 for any.
        """
        if not self._free.size:
            return _DecayModes(np.zeros((self.nodes.size, 0)), np.zeros(0)), 0.0
        if tolerance == 0:
            return self._every(), 0.0
        near = self._starting(steady)
        level = np.ones((self._free.size, 1)) / np.sqrt(self._capacity.sum())
        least = KEPT_PART * tolerance
        basis = self._added(level[:, : int(self._has_level)], near, least)
        lengths = self._lengths(shortest)
        for length in lengths:
            basis = self._added(basis, self._steps(near, length).changes, least)
        for rounds in range(DENSER + 1):
            if basis.shape[1] >= self._free.size:
                return self._every(), 0.0
            between = np.sqrt(lengths[1:] * lengths[:-1])
            steps = [self._steps(near, length) for length in between]
            shapes, rates = self._projected(basis)
            error = max(self._error(shapes, rates, step) for step in steps)
            if error <= tolerance or rounds == DENSER:
                break
            for step in steps:
                basis = self._added(basis, step.changes, least)
            lengths = np.sort(np.concatenate([lengths, between]))
        return self._scaled(shapes, rates), error

    def _starting(self, steady: np.ndarray) -> np.ndarray:
        """Steady temperatures and those of a warm body, of size 1, as near as temperatures come to
        them that vanish where they are fixed, (free, f + 1).
        """
        fields = np.hstack([steady, np.ones((self.nodes.size, 1))])
        near = splu(self._capacity).solve((self._all_of_capacity @ fields)[self._free])
        sizes = self._sizes(near)
        found: np.ndarray = near[:, sizes > 0] / sizes[sizes > 0]
        return found

    def _sizes(self, fields: np.ndarray) -> np.ndarray:
        """Sizes of temperatures by the heat that they store, (f,)."""
        found: np.ndarray = np.sqrt(np.einsum("kf,kf->f", fields, self._capacity @ fields))
        return found

    def _every(self) -> _DecayModes:
        """All modes."""
        rates, shapes = eigh(self._stiffness.toarray(), self._capacity.toarray())
        if self._kept:
            ones = np.ones(self._free.size) / np.sqrt(self._capacity.sum())
            rates[0] = 0.0
            shapes[:, 0] = ones
            shapes[:, 1:] -= np.outer(ones, ones @ (self._capacity @ shapes[:, 1:]))
        return self._scaled(shapes, np.maximum(rates, 0.0))

    def _scaled(self, shapes: np.ndarray, rates: np.ndarray) -> _DecayModes:
        """Modes on all nodes whose largest value is 1, whatever the sign of a method."""
        found = np.zeros((self.nodes.size, rates.size))
        found[self._free] = shapes / shapes[np.abs(shapes).argmax(axis=0), np.arange(rates.size)]
        return _DecayModes(found, rates)

    def _lengths(self, shortest: float) -> np.ndarray:
        """Lengths of steps, from the shortest one, or below the fastest decay of the mesh, to above
        the slowest.
        """
        diagonals = self._stiffness.diagonal() / self._capacity.diagonal()
        shift = SINGULAR_SHIFT * float(diagonals.mean())
        slowest = self._slowest(1 + int(self._has_level), shift)
        longest = LONGER / max(slowest, shift)
        ends = min(max(SHORTER / diagonals.max(), shortest), longest), longest
        decades = max(np.log10(ends[1] / ends[0]), 0.0)
        return np.geomspace(*ends, 2 + int(np.ceil(PER_DECADE * decades)))

    def _slowest(self, number: int, shift: float) -> float:
        """The rate of this number from the slowest one on."""
        size = self._free.size
        if number >= size:
            return float((self._stiffness.diagonal() / self._capacity.diagonal()).max())
        start = np.random.default_rng(0).uniform(-1.0, 1.0, size)
        rates = eigsh(
            self._stiffness,
            number,
            self._capacity,
            sigma=-shift,
            v0=start,
            return_eigenvectors=False,
        )
        return float(rates.max())

    def _steps(self, near: np.ndarray, length: float) -> _Steps:
        """Steps of a length from temperatures of size 1 to 0, (free, f), but those that stay."""
        heat = length * (self._stiffness @ near)
        matrix = csc_matrix(self._capacity + length * self._stiffness)
        changes = splu(matrix).solve(heat)
        sizes = self._sizes(changes)
        kept = sizes > UNBALANCED
        return _Steps(length, near[:, kept] / sizes[kept], changes[:, kept] / sizes[kept])

    def _added(self, basis: np.ndarray, fields: np.ndarray, least: float) -> np.ndarray:
        """The basis with what fields of size 1 have beside it, without smaller directions."""
        rest = fields
        for _ in range(2):  # once leaves round-off of the first fields
            rest = rest - basis @ (basis.T @ (self._capacity @ rest))
        squares, turned = np.linalg.eigh(rest.T @ (self._capacity @ rest))
        kept = squares > max(least, INDEPENDENT) ** 2
        return np.hstack([basis, (rest @ turned[:, kept]) / np.sqrt(squares[kept])])

    def _projected(self, basis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Modes in the span of a basis, of size 1, (free, r), and their rates, (r,)."""
        others = basis[:, self._kept :]
        rates, turned = eigh(
            others.T @ (self._stiffness @ others), others.T @ (self._capacity @ others)
        )
        shapes = np.hstack([basis[:, : self._kept], others @ turned])
        return shapes, np.concatenate([np.zeros(self._kept), np.maximum(rates, 0.0)])

    def _error(self, shapes: np.ndarray, rates: np.ndarray, steps: _Steps) -> float:
        """Largest error of the changes of steps by modes of size 1."""
        damped = 1.0 - 1.0 / (1.0 + steps.length * rates)
        amplitudes = shapes.T @ (self._capacity @ steps.starts)
        missed = steps.changes - shapes @ (damped[:, None] * amplitudes)
        return float(self._sizes(missed).max(initial=0.0))
