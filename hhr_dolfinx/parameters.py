"""Parameters of a scene and the amplitudes of its loads, as plain data.

Every load of a scene is an amplitude times a fixed shape. The amplitudes
theta(mu) = (1, theta_1(mu), ..., theta_T(mu)) are affine in the parameters here, so a model
on disk is data only and nothing that is loaded is ever executed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hhr_dolfinx.errors import ParameterError, SceneError


@dataclass(frozen=True)
class Amplitude:
    """Affine function of the parameters: ``constant + sum(slopes[name] * value of name)``."""

    constant: float = 0.0
    slopes: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class ParameterSpace:
    """The box in which a scene is solved.

    Attributes:
        names: one name per parameter.
        lower: smallest value of each parameter, in its unit.
        upper: largest value of each parameter.

    Raises:
        SceneError: if the lengths differ, or a bound is not finite or not below its partner.
    """

    names: tuple[str, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]

    def __post_init__(self):
        """Check the box once, and keep its bounds as arrays for the queries."""
        if not self.names or not len(self.names) == len(self.lower) == len(self.upper):
            raise SceneError(f"parameters {self.names} need one lower and one upper bound each")
        bounds = np.array([self.lower, self.upper], dtype=float)
        if not np.isfinite(bounds).all() or not (bounds[0] < bounds[1]).all():
            raise SceneError(f"bounds {self.lower} .. {self.upper} of {self.names} must be finite and increasing")
        # room for round-off in grids that end on the bounds
        slack = 1e-12 * (bounds[1] - bounds[0])
        object.__setattr__(
            self, "_box", list(zip((bounds[0] - slack).tolist(), (bounds[1] + slack).tolist(), strict=True))
        )

    def point(self, mu) -> np.ndarray:
        """Turn a number, a sequence or a mapping by name into a checked point, shape (P,).

        Raises:
            ParameterError: for a wrong length, a missing name, NaN, or a value outside the box.
        """
        if isinstance(mu, Mapping):
            missing = set(self.names) ^ set(mu)
            if missing:
                raise ParameterError(f"parameters {sorted(missing)} do not match {self.names}")
            mu = [mu[name] for name in self.names]
        point = np.array(mu, dtype=float, ndmin=1)
        if point.shape != (len(self.names),):
            raise ParameterError(f"expected {len(self.names)} parameters {self.names}, got shape {point.shape}")
        for value, (low, high) in zip(point.tolist(), self._box):  # noqa: B905 (hot path)
            if not low <= value <= high:  # NaN fails too
                raise ParameterError(self._complaint(point))
        return point

    def _complaint(self, point):
        lines = [
            f"{name} = {value:g} is outside [{low:g}, {high:g}]"
            for name, value, low, high in zip(self.names, point, self.lower, self.upper, strict=True)
            if not low <= value <= high
        ]
        return "; ".join(lines) + ": widen the parameter space and train again, or choose a value inside"

    def grid(self, counts: Sequence[int]) -> np.ndarray:
        """Regular grid with ``counts`` points along each parameter, shape (prod(counts), P)."""
        axes = [np.linspace(low, high, count) for low, high, count in zip(self.lower, self.upper, counts, strict=True)]
        return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)

    def random(self, count: int, seed: int) -> np.ndarray:
        """Uniform random points of the box, shape (count, P), the same for the same seed."""
        return np.random.default_rng(seed).uniform(self.lower, self.upper, (count, len(self.names)))


@dataclass(frozen=True)
class Amplitudes:
    """All amplitudes of a scene: theta(mu) = constant + slopes @ mu.

    Attributes:
        constant: (1 + T,), whose first entry is the 1 of the parameter-free part.
        slopes: (1 + T, P).
    """

    constant: np.ndarray
    slopes: np.ndarray

    @classmethod
    def collect(cls, amplitudes: Sequence[Amplitude], space: ParameterSpace) -> Amplitudes:
        """Stack single amplitudes behind the leading constant 1.

        Raises:
            SceneError: if a slope names an unknown parameter.
        """
        unknown = {name for amplitude in amplitudes for name in amplitude.slopes} - set(space.names)
        if unknown:
            raise SceneError(f"amplitudes name {sorted(unknown)}, the scene's parameters are {space.names}")
        constant = np.array([1.0] + [amplitude.constant for amplitude in amplitudes])
        rows = [[0.0] * len(space.names)]
        rows += [[amplitude.slopes.get(name, 0.0) for name in space.names] for amplitude in amplitudes]
        return cls(constant, np.array(rows))

    def __call__(self, point: np.ndarray) -> np.ndarray:
        """Evaluate theta at a checked point, shape (1 + T,)."""
        return self.constant + self.slopes @ point
