"""Seconds of queries of several models on the same points."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np

from hhr_dolfinx.errors import ConvergenceError, NotSolvableError, StudyError
from hhr_dolfinx.one_thread import one_thread
from hhr_dolfinx.timing import now

WARM_UP = 5
"""Queries before the measurement."""


def time_queries(models: dict[str, Callable[[np.ndarray], Any]], points: np.ndarray) -> dict[str, np.ndarray]:
    """Seconds per query of each model at every point, (len(points) minus a warm-up,), on one thread.

    No point is repeated, so that caches help no more than in use. The models alternate in blocks, so that a disturbance
    of the machine affects all of them. A query without an answer counts with its time.
    """
    if len(points) <= WARM_UP:
        raise StudyError(f"{len(points)} points cannot be timed: {WARM_UP} are a warm-up, give more")
    measured = points[WARM_UP:]
    times: dict[str, list[float]] = {name: [] for name in models}
    with one_thread, _settled_memory():
        for solve in models.values():
            for point in points[:WARM_UP]:
                _query(solve, point)
        for block in np.array_split(measured, min(5, len(measured))):
            for name, solve in models.items():
                gc.collect()
                gc.disable()
                try:
                    for point in block:
                        start = now()
                        _query(solve, point)
                        times[name].append(now() - start)
                finally:
                    gc.enable()
    return {name: np.array(values) for name, values in times.items()}


def _query(solve: Callable[[np.ndarray], Any], point: np.ndarray) -> None:
    with suppress(ConvergenceError, NotSolvableError):
        solve(point)


@contextmanager
def _settled_memory() -> Iterator[None]:
    """Exclude existing objects from garbage collection in a block, which would take 0.1 s for each measurement."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
