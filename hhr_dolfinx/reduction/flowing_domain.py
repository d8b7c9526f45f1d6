"""Gauss points where training flowed, and a cubature on few of them for the stress of the plastic correction."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import linalg

from hhr_dolfinx.contact.active_set import active_set
from hhr_dolfinx.materials.strain import StrainOperator
from hhr_dolfinx.reduction.cubature import Cubature, compressed, fitted
from hhr_dolfinx.reduction.elastic_response import ElasticResponse

if TYPE_CHECKING:
    from hhr_dolfinx.models.answer import Answer
    from hhr_dolfinx.reduction.condense_flow import CorrectionSettings

ROWS = 1500
"""Integrals that a cubature is fitted to at most, before they are compressed."""
CHUNK = 2000
"""Gauss points whose contributions are made at once."""
FLOWED = 1e-4
"""Plastic strain, relative to the largest of any training state, from which on a point may carry weight."""
ALIKE = 1e-4
"""Part of the norm of training states that their compression leaves out."""


def correction_strain(
    full: Any, elastic: ElasticResponse, answer: Answer, correction: np.ndarray, strain: StrainAt
) -> np.ndarray:
    """Strain ε_c of the correction of a full answer, (p, c): it moves contact forces, which strain too."""
    problem, equilibrium = full.problem, full.equilibrium.at(answer.parameter)
    theta = problem.amplitudes(answer.parameter)
    scale = elastic.factors.compliances(answer.parameter)[elastic.parts]
    free = scale * (elastic.forced @ theta) + elastic.given @ theta - problem.lifts @ theta
    slack = problem.gaps @ theta - problem.contact @ free
    found = active_set(equilibrium.elastic.equalities, slack, slack < 0, pairs=full.pairs)
    return strain.of(correction - scale * (elastic.per_force @ (answer.multipliers - found.forces)))


@dataclass(frozen=True)
class FlowingDomain:
    """Gauss points where anything flowed in training: the candidates of a cubature.

    Attributes:
        points: their numbers, (p,).
        weights: quadrature weight times 2 μ in the middle of the box, (p,).
        deviators: of the strain of the modes, (p, c, ell).
    """

    points: np.ndarray
    weights: np.ndarray
    deviators: np.ndarray

    @classmethod
    def of(cls, full: Any, basis: np.ndarray, answers: Sequence[Answer], sizes: np.ndarray) -> FlowingDomain:
        """Of training answers with corrections of some energy norms."""
        equilibrium = full.equilibrium
        largest = np.zeros(equilibrium.material.gauss_points)
        for answer, size in zip(answers, sizes, strict=True):
            largest = np.maximum(largest, np.abs(answer.state().state.plastic).max(axis=1) / size)
        points = np.flatnonzero(largest > FLOWED * largest.max())
        deviators = np.stack([deviator(equilibrium.strain_of(column)[points]) for column in basis.T], axis=2)
        elastic = equilibrium.material.moduli_at(full.problem.middle).elastic
        return cls(points, (equilibrium.operator.weights.ravel() * elastic[:, -1, -1])[points], deviators)

    def stressed(
        self,
        full: Any,
        elastic: ElasticResponse,
        answers: Sequence[Answer],
        corrections: np.ndarray,
        sizes: np.ndarray,
    ) -> np.ndarray:
        """ε_p - dev ε_c at training states, over the energy norms of their corrections, (S, p c)."""
        there = StrainAt(full.equilibrium.operator, self.points)
        found = np.empty((len(answers), self.deviators[:, :, 0].size))
        for k, (answer, correction) in enumerate(zip(answers, corrections.T, strict=True)):
            plastic = answer.state().state.plastic[self.points]
            strain = correction_strain(full, elastic, answer, correction, there)
            found[k] = (plastic - deviator(strain)).ravel() / sizes[k]
        return found

    def cubature(self, stressed: np.ndarray, settings: CorrectionSettings, start: Cubature | None = None) -> Cubature:
        """Points and weights for :meth:`stressed` states, (S, p c), and loosely for energies of the modes.

        ``start`` is a cubature of the same states for fewer modes, or for a larger tolerance.
        """
        few = _alike(stressed, ROWS // self.deviators.shape[2])
        few = few.reshape(len(few), self.points.size, -1)
        pairs = np.triu_indices(self.deviators.shape[2])

        def needed() -> Iterator[np.ndarray]:
            for part in _chunks(self.points.size):
                tested = self.weights[part, None, None] * self.deviators[part]
                yield np.einsum("pcj,rpc->jrp", tested, few[:, part], optimize=True).reshape(-1, tested.shape[0])

        def energies() -> Iterator[np.ndarray]:
            for part in _chunks(self.points.size):
                tested = self.weights[part, None, None] * self.deviators[part]
                yield np.einsum("pcj,pci->jip", tested, self.deviators[part], optimize=True)[pairs]

        rows = compressed(needed, 0.1 * settings.cubature)
        loose = compressed(energies, 0.1 * settings.stability)
        rows /= np.linalg.norm(rows.sum(axis=1))
        loose *= settings.cubature / settings.stability / np.linalg.norm(loose.sum(axis=1))
        return fitted(np.vstack([rows, loose]), settings.cubature, settings.most_points, start)

    def largest_energy(self, cubature: Cubature) -> float:
        """Largest energy of a mode by a cubature."""
        scale = np.sqrt(cubature.weights * self.weights[cubature.points])
        chosen = self.deviators[cubature.points] * scale[:, None, None]
        return float(np.linalg.norm(chosen.reshape(-1, chosen.shape[2]), 2) ** 2)

    def work(self, strain: StrainAt) -> Callable[[np.ndarray], np.ndarray]:
        """Maps fields (N, k) to ∫ (G V)^T 2 μ dev G u, (ell, k)."""
        tested = (self.weights[:, None, None] * self.deviators).reshape(-1, self.deviators.shape[2])
        return lambda columns: np.stack([tested.T @ strain.of(column).ravel() for column in columns.T], axis=1)


def deviator(strain: np.ndarray) -> np.ndarray:
    """Deviators of strains, (n, c)."""
    found = strain.copy()
    found[:, :3] -= found[:, :3].mean(axis=1, keepdims=True)
    return found


def _chunks(count: int) -> Iterator[slice]:
    return (slice(start, min(start + CHUNK, count)) for start in range(0, count, CHUNK))


def _alike(states: np.ndarray, most: int) -> np.ndarray:
    """Few rows with the products of many, (S, n) -> (r, n): by the method of snapshots."""
    squares, ways = linalg.eigh(states @ states.T)
    count = min(int((squares > ALIKE**2 * squares[-1]).sum()), most)
    return ways[:, ::-1][:, :count].T @ states


class StrainAt:
    """Strain at some Gauss points, by the cells around them alone.

    Args:
        operator: of the whole mesh.
        points: numbers of the points.

    Attributes:
        points: as given.
    """

    def __init__(self, operator: StrainOperator, points: np.ndarray):
        per_cell = operator.per_cell
        cells, where = np.unique(points // per_cell, return_inverse=True)
        self._operator, self._dofs = operator.restricted(cells)
        self._places = where * per_cell + points % per_cell
        self.points = points

    def of(self, column: np.ndarray) -> np.ndarray:
        """Of a field (N,), (n, c)."""
        return self._operator.strain(column[self._dofs])[self._places]

    def __call__(self, columns: np.ndarray) -> np.ndarray:
        """Of fields (N, k), component by component, (k, c n)."""
        return np.array([self.of(column).T.ravel() for column in columns.T])
