"""The only clock of the house: seconds of stages and of queries. The mathematics never reads the time."""

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
"""Receives the name of a stage and the share of it that is done, 0 when it begins; it may raise to stop the run."""


def unannounced(stage: str, share: float) -> None:
    """Nobody listens."""


WARM_UP = 5
"""Queries before the clock runs."""
FEWEST = 3
"""Queries of which a median is taken at least, where each takes long."""


@dataclass
class StageLog:
    """Times of the stages of a run, in seconds; what was left out; attempts that a check refused.

    What enters it is told to the logger ``hhr_dolfinx.timing`` too: stages and refusals as INFO, what was left out
    as DEBUG.
    """

    times: dict[str, float] = field(default_factory=dict)
    skipped: list[dict[str, str]] = field(default_factory=list)
    refused: list[dict[str, Any]] = field(default_factory=list)

    @contextmanager
    def stage(self, name: str, announce: Announce = unannounced) -> Iterator[None]:
        """Time the block under a name, and announce that it begins."""
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
        """Tell the logger what was made."""
        logger.info("%s", what)

    def skip(self, stage: str, why: str) -> None:
        """Record a stage that this scene does not need."""
        self.skipped.append({"stage": stage, "why": why})
        logger.debug("%s is left out: %s", stage, why)

    def refuse(self, why: str, **attempt: int) -> None:
        """Record that an attempt, such as ``layers=2``, was refused."""
        self.refused.append({**attempt, "why": why})
        shown = ", ".join(f"{name} {value}" for name, value in attempt.items())
        logger.info("the model of %s is refused: %s", shown, why)


class Stopwatch:
    """Seconds since it was made."""

    def __init__(self) -> None:
        self._start = time.perf_counter()

    @property
    def seconds(self) -> float:
        """How many have gone."""
        return time.perf_counter() - self._start


class ShareLines:
    """Writes a line for each stage of a long run, and then how much of the stage is done.

    Args:
        write: takes a line.
        quiet: seconds in which nothing is written: a short run needs no progress.
        every: seconds between two lines of one stage.
    """

    def __init__(self, write: Callable[[str], None], quiet: float = 2.0, every: float = 5.0):
        self._write = write
        self._quiet = quiet
        self._every = every
        self._clock = Stopwatch()
        self._last: dict[str, float] = {}

    def __call__(self, stage: str, share: float) -> None:
        """Write what is due, see :data:`Announce`."""
        now = self._clock.seconds
        if now < self._quiet:
            return
        if not share or now - self._last.get(stage, -math.inf) >= self._every:
            self._last[stage] = now
            self._write(f"{now:.0f} s: {stage}" + (f", {share:.0%} done" if share else ""))


def timed(call: Callable[[], Any], repetitions: int = 1) -> tuple[Any, float]:
    """The last result of a call, and its seconds on average, on one thread."""
    with one_thread:
        start = time.perf_counter()
        for _ in range(repetitions):
            result = call()
        return result, (time.perf_counter() - start) / repetitions


@contextmanager
def _settled_memory() -> Iterator[None]:
    """What is there already is not looked through for garbage again, which takes 0.1 s for each block."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def time_queries(models: dict[str, Callable[[np.ndarray], Any]], points: np.ndarray) -> dict[str, np.ndarray]:
    """Seconds per query of each model at every point, (len(points) less a warm-up,), on one thread.

    No point comes twice, so that nothing kept from an earlier query helps more than it would in use. The
    models take turns in blocks, so that a disturbance of the machine hits all of them. A query without an answer
    counts with the time it took.
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
    """Median of the seconds of queries, on one thread, behind a warm-up: of as many points as take ``most`` seconds.

    For a rough figure, which takes no longer itself than what it is asked for: a warm-up of long queries is one of few.
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
