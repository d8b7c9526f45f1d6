"""A neural network that learns from training answers and from the equations."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg
from scipy.optimize import minimize

from hhr_dolfinx.plugins.rivals.projection import check_elastic
from hhr_dolfinx.plugins.rivals.regression import Coefficients, Predict, Regression, scaled
from hhr_dolfinx.plugins.studies.study import Rival

if TYPE_CHECKING:
    from hhr_dolfinx.study.training.train import Training

NEURONS = 64
MOST_FIT_STEPS = 2000
COLLOCATED = 4
"""Neurons of each of two layers, steps of L-BFGS, and points of the equations for each one of
training.
"""
MOST_COLLOCATED = 400_000
"""Most contact conditions at all points of the equations together."""
ENERGY_ROUND_OFF = 1e-12
"""Part of the largest energy of unknowns that is round-off."""


def informed_network(training: Training) -> Iterator[Rival]:
    """Equations and contact conditions in the loss, these by the function of Fischer and Burmeister
    (T. Sahin, M. von Danwitz and A. Popp, Adv. Model. Simul. Eng. Sci. 11, 2024).

    Theirs solves one problem by coordinates; this one answers for parameters, by coefficients of
    POD modes.
    """
    yield Rival("physics-informed network", "64, 64", partial(_made, training))


def _made(training: Training) -> Regression:
    full = training.full_order
    check_elastic(full, "a physics-informed network", one_stiffness=True)
    return Regression(training, partial(_informed, training))


@dataclass(frozen=True)
class ContactEquations:
    """Equations and contact conditions of coefficients z of modes, (n, k), at points of amplitudes
    θ, (n, 1 + T).

    Attributes:
        balance, loaded: energy's coordinates of the error of equilibrium, z balance - θ loaded.
        slack, gaps: slack over its size, θ gaps - z slack.
        forces: forces over their size, z forces.
    """

    balance: np.ndarray
    loaded: np.ndarray
    slack: np.ndarray
    gaps: np.ndarray
    forces: np.ndarray

    @classmethod
    def of(cls, training: Training, fields: np.ndarray, forces: np.ndarray) -> ContactEquations:
        """Equations of a training.

        Args:
            training: training of the scene.
            fields: modes of displacements, (N, k1).
            forces: modes of forces, (m, k2).
        """
        full = training.full_order
        problem = full.problem
        loaded = full.stiffness.columns(problem.loads)
        columns = np.hstack([fields, full.per_force @ forces, loaded])
        energy = columns.T @ (problem.own_stiffness @ columns)
        values, vectors = linalg.eigh((energy + energy.T) / 2)
        kept = values > ENERGY_ROUND_OFF * values[-1]
        coordinates = vectors[:, kept] * np.sqrt(values[kept])
        known = training.snapshots.displacements
        size = np.sqrt(np.mean(np.sum(known * (problem.own_stiffness @ known), axis=0)))
        largest = np.abs(training.snapshots.forces).max()
        far = largest * full.schur.diagonal().mean()
        count = fields.shape[1] + forces.shape[1]
        moves = np.zeros((count, len(forces)))
        moves[: fields.shape[1]] = (problem.contact @ fields).T
        pushes = np.zeros_like(moves)
        pushes[fields.shape[1] :] = forces.T
        return cls(
            coordinates[:count] / size,
            coordinates[count:] / size,
            moves / far,
            problem.gaps.T / far,
            pushes / largest,
        )

    def errors(self, unknown: np.ndarray, theta: np.ndarray) -> tuple[float, np.ndarray]:
        """Mean squares of the error of equilibrium and of a + b - (a² + b²)^½ of forces and slacks,
        both together, and their gradient, (n, k).

        Args:
            unknown: coefficients, (n, k).
            theta: amplitudes, (n, 1 + T).
        """
        off = unknown @ self.balance - theta @ self.loaded
        forces = unknown @ self.forces
        slack = theta @ self.gaps - unknown @ self.slack
        length = np.hypot(forces, slack)
        broken = forces + slack - length
        length = np.where(length > 0, length, 1.0)
        of_forces = broken * (1 - forces / length)
        of_slack = broken * (1 - slack / length)
        energies = (2 / len(off)) * off @ self.balance.T
        conditions = (2 / broken.size) * (of_forces @ self.forces.T - of_slack @ self.slack.T)
        size = np.sum(off**2) / len(off) + np.mean(broken**2)
        return float(size), energies + conditions


@dataclass(frozen=True)
class Perceptron:
    """Two layers of tanh, and a linear one."""

    layers: list[np.ndarray]  #: weights with a row of shifts, (in + 1, out) each

    @classmethod
    def of(cls, flat: np.ndarray, sizes: list[tuple[int, int]]) -> Perceptron:
        """Layers from all their weights.

        Args:
            flat: weights, one after another.
            sizes: of each layer, (in + 1, out).
        """
        ends = np.cumsum([rows * columns for rows, columns in sizes])[:-1]
        parts = np.split(flat, ends)
        return cls([part.reshape(size) for part, size in zip(parts, sizes, strict=True)])

    def passed(self, points: np.ndarray) -> list[np.ndarray]:
        """Points, (n, P), and the outputs of each layer."""
        states = [points]
        for number, layer in enumerate(self.layers):
            state = states[-1] @ layer[:-1] + layer[-1]
            states.append(state if number == len(self.layers) - 1 else np.tanh(state))
        return states

    def pulled_back(self, states: list[np.ndarray], gradient: np.ndarray) -> np.ndarray:
        """Gradient along all weights.

        Args:
            states: of :meth:`passed`.
            gradient: along the outputs of the last layer, (n, k).
        """
        found = []
        for number in range(len(self.layers) - 1, -1, -1):
            found.append(np.vstack([states[number].T @ gradient, gradient.sum(axis=0)]).ravel())
            gradient = (gradient @ self.layers[number][:-1].T) * (1 - states[number] ** 2)
        return np.concatenate(found[::-1])


def _informed(training: Training, points: np.ndarray, values: np.ndarray) -> Predict:
    """Fit of :class:`Regression`, of scaled points, (S, P), and coefficients, (S, k)."""
    full = training.full_order
    fields = Coefficients.of(training.snapshots.displacements)
    forces = Coefficients.of(training.snapshots.forces)
    equations = ContactEquations.of(training, fields.modes, forces.modes)
    mean = np.concatenate([fields.mean, forces.mean])
    scale = np.concatenate([fields.scale, forces.scale])
    most = max(MOST_COLLOCATED // len(forces.modes), 1)
    collocation = full.parameters.random(min(COLLOCATED * len(points), most), 0)
    terms = np.eye(full.problem.gaps.shape[1])
    theta = np.stack([terms @ full.problem.amplitudes(point) for point in collocation])
    everywhere = np.vstack([points, scaled(full.parameters, collocation)])
    ends = [points.shape[1], NEURONS, NEURONS, values.shape[1]]
    sizes = [(before + 1, after) for before, after in itertools.pairwise(ends)]

    def loss(flat: np.ndarray) -> tuple[float, np.ndarray]:
        network = Perceptron.of(flat, sizes)
        states = network.passed(everywhere)
        data = states[-1][: len(points)] - values
        size, along = equations.errors(mean + scale * states[-1][len(points) :], theta)
        gradient = np.vstack([2 * data / data.size, along * scale])
        return float(np.mean(data**2)) + size, network.pulled_back(states, gradient)

    random = np.random.default_rng(0)
    start = [random.normal(0, (1 / rows) ** 0.5, (rows, columns)) for rows, columns in sizes]
    first = np.concatenate([layer.ravel() for layer in start])
    found = minimize(loss, first, jac=True, method="L-BFGS-B", options={"maxiter": MOST_FIT_STEPS})
    trained = Perceptron.of(found.x, sizes)
    return lambda queries: trained.passed(queries)[-1]
