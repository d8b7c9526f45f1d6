"""The only clock of the package: seconds of stages and of queries. The mathematics never reads the time."""

from __future__ import annotations

import gc
import logging
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np

from hhr_dolfinx.errors import ConvergenceError, NotSolvableError, StudyError
from hhr_dolfinx.one_thread import one_thread

logger = logging.getLogger(__name__)


def today() -> str:
    """Date and time of day in UTC, for reports: ``2026-01-31 09:05 UTC``."""
    return datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")


Announce = Callable[[str, float], None]
"""Function of the name of a stage and the fraction that is done, 0 at the start; it may raise to stop the run."""


def unannounced(stage: str, share: float) -> None:
    """Default of announcements: do nothing."""


WARM_UP = 5
"""Queries before the measurement."""
FEWEST = 3
"""Smallest number of long queries for a median."""


@dataclass
class StageLog:
    """Times of the stages of a run, in seconds, skipped stages, and attempts that a check refused.

    Entries also go to the logger ``hhr_dolfinx.timing``: stages and refusals as INFO, skipped stages as DEBUG.
    """

    times: dict[str, float] = field(default_factory=dict)
    skipped: list[dict[str, str]] = field(default_factory=list)
    refused: list[dict[str, Any]] = field(default_factory=list)

    @contextmanager
    def stage(self, name: str, announce: Announce = unannounced) -> Iterator[None]:
        """Time the block under a name, and announce its start."""
        logger.info("%s begins", name)
        announce(name, 0.0)
        start = time.perf_counter()
        try:
            yield
        finally:
            seconds = time.perf_counter() - start
            self.times[name] = self.times.get(name, 0.0) + seconds
            logger.info("%s ends after %.3g s", name, seconds)

    def say(self, what: str) -> None:
        """Log a result."""
        logger.info("%s", what)

    def skip(self, stage: str, why: str) -> None:
        """Record a stage that is not needed."""
        self.skipped.append({"stage": stage, "why": why})
        logger.debug("%s is left out: %s", stage, why)

    def refuse(self, why: str, **attempt: object) -> None:
        """Record that an attempt, such as ``layers=2``, was refused."""
        self.refused.append({**attempt, "why": why})
        shown = ", ".join(f"{name} {value}" for name, value in attempt.items())
        logger.info("the model of %s is refused: %s", shown, why)


class Stopwatch:
    """Clock of the seconds since its construction."""

    def __init__(self) -> None:
        self._start = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Elapsed seconds."""
        return time.perf_counter() - self._start


class ShareLines:
    """Progress as lines: one for each stage of a long run, then the fraction of the stage that is done.

    Args:
        write: function that writes a line.
        quiet: seconds without output at the start, since a short run needs no progress.
        every: seconds between two lines of one stage.
    """

    def __init__(self, write: Callable[[str], None], quiet: float = 2.0, every: float = 5.0):
        self._write = write
        self._quiet = quiet
        self._every = every
        self._clock = Stopwatch()
        self._last: dict[str, float] = {}

    def __call__(self, stage: str, share: float) -> None:
        """Write a line if one is due, see :data:`Announce`."""
        now = self._clock.seconds
        if now < self._quiet:
            return
        if not share or now - self._last.get(stage, -math.inf) >= self._every:
            self._last[stage] = now
            self._write(f"{now:.0f} s: {stage}" + (f", {share:.0%} done" if share else ""))


def timed(call: Callable[[], Any], repetitions: int = 1) -> tuple[Any, float]:
    """Last result of a call, and its mean time in seconds, on one thread."""
    with one_thread:
        start = time.perf_counter()
        for _ in range(repetitions):
            result = call()
        return result, (time.perf_counter() - start) / repetitions


@contextmanager
def _settled_memory() -> Iterator[None]:
    """Exclude existing objects from garbage collection in a block, which would take 0.1 s for each measurement."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def time_queries(models: dict[str, Callable[[np.ndarray], Any]], points: np.ndarray) -> dict[str, np.ndarray]:
    """Seconds per query of each model at every point, (len(points) minus a warm-up,), on one thread.

    No point is repeated, so that caches help no more than in use. The models alternate in blocks, so that a disturbance
    of the machine affects all of them. A query without an answer counts with its time.
    """
    if len(points) <= WARM_UP:
        raise StudyError(f"{len(points)} points cannot be timed: {WARM_UP} are a warm-up, give more")
    warm_up = points[:WARM_UP]
    measured = points[WARM_UP:]
    times: dict[str, list[float]] = {name: [] for name in models}
    with one_thread, _settled_memory():
        for solve in models.values():
            for point in warm_up:
                _query(solve, point)
        for block in np.array_split(measured, min(5, len(measured))):
            for name, solve in models.items():
                gc.collect()
                gc.disable()
                try:
                    for point in block:
                        start = time.perf_counter()
                        _query(solve, point)
                        times[name].append(time.perf_counter() - start)
                finally:
                    gc.enable()
    return {name: np.array(values) for name, values in times.items()}


def median_time(solve: Callable[[np.ndarray], Any], points: np.ndarray, most: float) -> float:
    """Median of the seconds of queries on one thread after a warm-up, for as many points as take ``most`` seconds.

    A rough figure in a limited time: the warm-up of long queries is shorter.
    """
    times: list[float] = []
    warm = 0
    with one_thread:
        for point in points:
            start = time.perf_counter()
            _query(solve, point)
            times.append(time.perf_counter() - start)
            if not warm:
                warm = len(times) if len(times) >= WARM_UP or sum(times) > most / 2 else 0
            elif len(times) >= warm + FEWEST and sum(times) > most:
                break
    return float(np.median(times[warm:] or times))


def _query(solve: Callable[[np.ndarray], Any], point: np.ndarray) -> None:
    with suppress(ConvergenceError, NotSolvableError):
        solve(point)
