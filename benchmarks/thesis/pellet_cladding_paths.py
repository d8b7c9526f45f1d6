"""Random paths of the flowing pellet: inside the family it is trained on (gaps, one pace, one
height), and outside.
"""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.random import Generator
from paths import PathCase

from hhr_dolfinx.models.answer import Path

Drawn = tuple[np.ndarray, np.ndarray, float, float]
"""Times, shares of the pressure, gap, height."""
GAPS, TRAINED_HEIGHT = (5.0, 15.0), 0.9


def ramp(
    rng: Generator, steps: int = 40, pace: float = 1.0, height: float = TRAINED_HEIGHT
) -> Drawn:
    """The trained path at a random gap, pace and height as given: times, shares of the pressure,
    gap, height.
    """
    shares = np.arange(steps + 1) / steps
    return shares / pace, shares, rng.uniform(*GAPS), height


def inside(rng: Generator) -> Drawn:
    """Another gap, number of steps and last pressure."""
    steps, last = int(rng.integers(20, 80)), rng.uniform(0.6, 1.0)
    shares = last * np.arange(steps + 1) / steps
    return shares, shares, rng.uniform(*GAPS), TRAINED_HEIGHT


def unloading(rng: Generator) -> Drawn:
    """Up, down to a part of it, up again."""
    turn = rng.uniform(0.3, 1.0)
    rest = rng.uniform(0.0, 0.6) * turn
    corners = np.array([0.0, turn, rest, turn])
    times = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(corners)))])
    fine = np.unique(np.concatenate([np.linspace(0, times[-1], int(40 * times[-1]) + 1), times]))
    return fine, np.interp(fine, times, corners), rng.uniform(*GAPS), TRAINED_HEIGHT


def hold(rng: Generator) -> Drawn:
    """Up to a pressure that then stays for 0.1 to 10 s."""
    share, seconds = rng.uniform(0.4, 1.0), 10.0 ** rng.uniform(-1, 1)
    up = np.linspace(0, share, int(40 * share) + 1)
    times = np.concatenate([up, share + seconds * np.arange(1, 11) / 10])
    return times, np.minimum(times, share), rng.uniform(*GAPS), TRAINED_HEIGHT


def pace(rng: Generator) -> Drawn:
    """2 to 100 times as fast or as slow."""
    factor = 10.0 ** (rng.choice([-1, 1]) * rng.uniform(np.log10(2), 2))
    return ramp(rng, pace=factor)


def height(rng: Generator) -> Drawn:
    """Another height of the pressure."""
    return ramp(rng, height=rng.choice([rng.uniform(0.5, 0.85), rng.uniform(0.95, 1.5)]))


OUTSIDE = (unloading, hold, pace, height)


def path_cases(
    history: Callable[..., Path], seed: int, inside_count: int = 20, outside_count: int = 40
) -> Iterator[PathCase]:
    """Cases, those outside in turns of the four ways to leave what was trained.

    Args:
        history: makes times and parameters of times, shares of the pressure, a gap in um and a
            height.
        seed: of random paths.
        inside_count, outside_count: how many.
    """
    rng = np.random.default_rng(seed)
    for k in range(inside_count):
        yield PathCase(f"inside {k}", history(*inside(rng)), inside=True)
    for k in range(outside_count):
        way = OUTSIDE[k % len(OUTSIDE)]
        yield PathCase(f"{way.__name__} {k // len(OUTSIDE)}", history(*way(rng)), inside=False)
