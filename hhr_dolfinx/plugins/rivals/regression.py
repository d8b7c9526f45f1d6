"""Rivals without equations: regression of POD coefficients of displacements and forces.

They learn from the training answers of the other models, and nothing else.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.compat import extra
from hhr_dolfinx.contact.active_set import Status, Statuses
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.models.answer import Answer, found_as
from hhr_dolfinx.plugins.rivals.projection import ConeFields, RivalModel, check_elastic
from hhr_dolfinx.plugins.studies.study import Rival
from hhr_dolfinx.reduction.modes import pod

if TYPE_CHECKING:
    from hhr_dolfinx.parameters import ParameterSpace
    from hhr_dolfinx.study.training.train import Training

LEFT_OUT = 1e-10
"""Part of the squared sum of training that the POD of regressions leaves out."""
MOST_MODES = 40
"""Modes at most, of displacements and of forces."""
MOST_DEGREE = 12
"""Largest degree of polynomials."""
Predict = Callable[[np.ndarray], np.ndarray]
"""Coefficients, (n, k), of scaled parameters, (n, P)."""
Fit = Callable[[np.ndarray, np.ndarray], Predict]
"""Makes one of scaled parameters, (S, P), and coefficients of unit variance, (S, k)."""


def gaussian_process(training: Training) -> Iterator[Rival]:
    """Kriging with Matern 5/2: one length for each coefficient and parameter."""
    yield from _by_regression("Gaussian process", training)


def radial_functions(training: Training) -> Iterator[Rival]:
    """Cubic radial basis functions with a linear part."""
    yield from _by_regression("radial functions", training)


def polynomials(training: Training) -> Iterator[Rival]:
    """Legendre polynomials of total degree, as polynomial chaos of uniform parameters."""
    yield from _by_regression("polynomials", training)


def neural_network(training: Training) -> Iterator[Rival]:
    """A perceptron of two hidden layers of 64."""
    yield from _by_regression("neural network", training)


def _by_regression(method: str, training: Training) -> Iterator[Rival]:
    setting, fit = REGRESSIONS[method]
    yield Rival(method, setting, partial(Regression, training, fit))


@dataclass(frozen=True)
class Coefficients:
    """Modes of columns, and their coefficients at the training points, of unit variance.

    Attributes:
        modes: modes, (n, k).
        values: coefficients, (S, k).
        mean: their mean over training, (k,).
        scale: their standard deviation, (k,).
    """

    modes: np.ndarray
    values: np.ndarray
    mean: np.ndarray
    scale: np.ndarray

    @classmethod
    def of(cls, columns: np.ndarray) -> Coefficients:
        """POD of columns, (n, S)."""
        modes = pod(columns, LEFT_OUT)[0][:, :MOST_MODES]
        raw = (modes.T @ columns).T
        mean = raw.mean(axis=0)
        scale = raw.std(axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        return cls(modes, (raw - mean) / scale, mean, scale)

    def rebuilt(self, values: np.ndarray) -> np.ndarray:
        """Coefficients of modes from those of unit variance, (k,)."""
        return self.mean + self.scale * values


class Regression(RivalModel):
    """Displacements and forces of a regression; no contact condition is imposed.

    Args:
        training: training of the scene.
        fit: makes the regression.

    Raises:
        NotOfferedError: see :func:`~hhr_dolfinx.plugins.rivals.projection.check_elastic`.
    """

    def __init__(self, training: Training, fit: Fit):
        full = training.full_order
        snapshots = training.snapshots
        check_elastic(full, "a regression")
        self.parameters = full.parameters
        self._displacements = Coefficients.of(snapshots.displacements)
        self._forces = Coefficients.of(snapshots.forces)
        together = np.hstack([self._displacements.values, self._forces.values])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of lengths at the ends of their ranges
            self._predict = fit(scaled(full.parameters, snapshots.points), together)
        self.fields = ConeFields(full, self._displacements.modes, self._forces.modes)
        self.advice: dict[Status, str] = {}

    @property
    def sizes(self) -> tuple[int, int]:
        """Modes of displacements and of forces."""
        return self._displacements.modes.shape[1], self._forces.modes.shape[1]

    def answered(self, point: np.ndarray) -> Answer:
        """See :class:`~hhr_dolfinx.plugins.rivals.projection.RivalModel`."""
        found = self._predict(scaled(self.parameters, point[None]))[0]
        count = self.sizes[0]
        unknown = self._displacements.rebuilt(found[:count])
        forces = self._forces.modes @ self._forces.rebuilt(found[count:])
        outcome = Statuses(forces, forces > 0, 1, Status.CONVERGED, False)
        return found_as(outcome, point, unknown, self.fields)


def scaled(space: ParameterSpace, points: np.ndarray) -> np.ndarray:
    """Points, (n, P), in [-1, 1]."""
    low = np.array(space.lower)
    high = np.array(space.upper)
    return 2 * (points - low) / (high - low) - 1


def _gaussian(points: np.ndarray, values: np.ndarray) -> Predict:
    """One process for each coefficient: fine modes vary faster than coarse ones."""
    with extra("rivals", "a Gaussian process"):
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import Matern, WhiteKernel

    kernel = Matern(np.ones(points.shape[1]), (1e-2, 1e2), nu=2.5)
    kernel += WhiteKernel(1e-6, (1e-10, 1e-1))
    lengths = []
    weights = []
    for column in values.T:
        process = GaussianProcessRegressor(kernel, n_restarts_optimizer=0, random_state=0)
        process.fit(points, column)
        lengths.append(np.broadcast_to(process.kernel_.k1.length_scale, points.shape[1]))
        weights.append(process.alpha_)
    return Processes(points, np.array(lengths), np.array(weights))


@dataclass(frozen=True)
class Processes:
    """Means of Gaussian processes with Matern 5/2 and different lengths.

    C. E. Rasmussen and C. K. I. Williams, Gaussian Processes for Machine Learning, 2006, equations
    2.25 and 4.17.

    Attributes:
        points: scaled training points, (S, P).
        lengths: length of each process along each parameter, (k, P).
        weights: weights of the kernels at the training points, (k, S).
    """

    points: np.ndarray
    lengths: np.ndarray
    weights: np.ndarray

    def __call__(self, queries: np.ndarray) -> np.ndarray:
        """Means at scaled parameters, (n, P); (n, k)."""
        return np.array([self._mean(query) for query in queries])

    def _mean(self, query: np.ndarray) -> np.ndarray:
        squares = np.square(self.points - query) @ np.square(1 / self.lengths).T  # (S, k)
        distance = np.sqrt(5 * squares)
        kernel = (1 + distance + 5 / 3 * squares) * np.exp(-distance)
        mean: np.ndarray = np.einsum("ks,sk->k", self.weights, kernel)
        return mean


def _radial(points: np.ndarray, values: np.ndarray) -> Predict:
    from scipy.interpolate import RBFInterpolator

    try:
        found: Predict = RBFInterpolator(points, values, kernel="cubic", degree=1)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise ReductionError(
            "radial functions with a linear part need training points that differ, more than there "
            f"are parameters, and not all on a plane: {error}"
        ) from error
    return found


def _polynomial(points: np.ndarray, values: np.ndarray) -> Predict:
    """Degree with the smallest error on every fifth point, of those with twice as many points as
    terms.
    """
    kept = np.arange(len(points)) % 5 != 0
    best = np.inf
    degree = 0
    for tried in range(1, MOST_DEGREE + 1):
        terms = _legendre(points, tried)
        if 2 * terms.shape[1] > kept.sum():
            break
        weights = np.linalg.lstsq(terms[kept], values[kept])[0]
        off = float(np.linalg.norm(terms[~kept] @ weights - values[~kept]))
        if off < best:
            best = off
            degree = tried
    weights = np.linalg.lstsq(_legendre(points, degree), values)[0]
    return lambda queries: _legendre(queries, degree) @ weights


def _legendre(points: np.ndarray, degree: int) -> np.ndarray:
    """Products of Legendre polynomials of a total degree, (n, terms)."""
    tables = [np.polynomial.legendre.legvander(column, degree) for column in points.T]
    orders = itertools.product(range(degree + 1), repeat=len(tables))
    kept = [order for order in orders if sum(order) <= degree]
    columns = [
        np.prod([table[:, k] for table, k in zip(tables, order, strict=True)], axis=0)
        for order in kept
    ]
    return np.stack(columns, axis=1)


def _perceptron(points: np.ndarray, values: np.ndarray) -> Predict:
    with extra("rivals", "a neural network"):
        from sklearn.neural_network import MLPRegressor

    network = MLPRegressor(
        hidden_layer_sizes=(64, 64),
        activation="tanh",
        solver="lbfgs",
        max_iter=2000,
        alpha=1e-6,
        random_state=0,
    )
    predict: Predict = network.fit(points, values).predict
    return predict


REGRESSIONS: dict[str, tuple[str, Fit]] = {
    "Gaussian process": ("Matern 5/2", _gaussian),
    "radial functions": ("cubic", _radial),
    "polynomials": ("total degree", _polynomial),
    "neural network": ("64, 64", _perceptron),
}
"""Settings and regressions by their methods."""
