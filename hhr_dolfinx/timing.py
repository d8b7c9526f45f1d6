"""The only clock of the package. The mathematics never reads the time."""

from __future__ import annotations

import logging
import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sized
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from typing import TypeVar

from hhr_dolfinx.one_thread import one_thread

Result = TypeVar("Result")
logger = logging.getLogger(__name__)
now = time.perf_counter
"""Seconds of a clock that only runs on."""


def today() -> str:
    """Date and time of day in UTC, for reports: ``2026-01-31 09:05 UTC``."""
    return datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")


Announce = Callable[[str, float], None]
"""Function of the name of a stage and the fraction that is done, 0 at the start.

It may raise to stop the run.
"""


def unannounced(stage: str, share: float) -> None:
    """Default of announcements: do nothing.

    Args:
        stage: name of the stage.
        share: fraction that is done.
    """


class ShareLines:
    """Progress as lines: one for each stage of a long run, then the part of it that is done.

    No line appears in the first ``quiet`` seconds, nor sooner than ``every`` seconds after the last
    one of a stage.
    """

    def __init__(self, write: Callable[[str], None], quiet: float = 2.0, every: float = 5.0):
        self._write = write
        self._quiet = quiet
        self._every = every
        self._start = now()
        self._last: dict[str, float] = {}

    @property
    def seconds(self) -> float:
        """Elapsed seconds."""
        return now() - self._start

    def __call__(self, stage: str, share: float) -> None:
        """Write a line if one is due, see :data:`Announce`."""
        seconds = self.seconds
        if seconds < self._quiet:
            return
        if not share or seconds - self._last.get(stage, -math.inf) >= self._every:
            self._last[stage] = seconds
            self._write(f"{seconds:.0f} s: {stage}" + (f", {share:.0%} done" if share else ""))


def terminal_lines() -> Announce:
    """Lines on the error stream if that is a terminal, else none; the default of long runs."""
    watched = sys.stderr is not None and sys.stderr.isatty()
    return ShareLines(partial(print, file=sys.stderr, flush=True)) if watched else unannounced


def lines_of(label: str) -> Callable[[Iterable[Result]], Iterator[Result]]:
    """Wrapper of iterations that announces their share on a terminal, under a label."""

    def announced(items: Iterable[Result]) -> Iterator[Result]:
        announce = terminal_lines()
        count = len(items) if isinstance(items, Sized) else 0
        for number, item in enumerate(items):
            if count:
                announce(label, number / count)
            yield item

    return announced


@dataclass
class StageLog:
    """Times of the stages of a run, in seconds, skipped stages, and attempts that a check refused.

    Entries also go to the logger ``hhr_dolfinx.timing``: stages and refusals as INFO, skipped
    stages as DEBUG.
    """

    times: dict[str, float] = field(default_factory=dict)
    skipped: list[dict[str, str]] = field(default_factory=list)
    refused: list[dict[str, object]] = field(default_factory=list)

    @contextmanager
    def stage(self, name: str, announce: Announce = unannounced) -> Iterator[None]:
        """Time the block under a name, and announce its start.

        Args:
            name: name of the stage.
            announce: called with the name and 0.
        """
        logger.info("%s begins", name)
        announce(name, 0.0)
        start = now()
        try:
            yield
        finally:
            seconds = now() - start
            self.times[name] = self.times.get(name, 0.0) + seconds
            logger.info("%s ends after %.3g s", name, seconds)

    def say(self, what: str) -> None:
        """Log a result."""
        logger.info("%s", what)

    def skip(self, stage: str, why: str) -> None:
        """Record a stage that is not needed.

        Args:
            stage: name of the stage.
            why: reason.
        """
        self.skipped.append({"stage": stage, "why": why})
        logger.debug("%s is left out: %s", stage, why)

    def refuse(self, why: str, **attempt: object) -> None:
        """Record that an attempt, such as ``layers=2``, was refused.

        Args:
            why: reason.
            **attempt: level of the attempt, by name.
        """
        self.refused.append({**attempt, "why": why})
        shown = ", ".join(f"{name} {value}" for name, value in attempt.items())
        logger.info("the model of %s is refused: %s", shown, why)


def timed(call: Callable[[], Result], repetitions: int = 1) -> tuple[Result, float]:
    """Last result of a call, and its mean time in seconds, on one thread.

    Args:
        call: function to time.
        repetitions: number of calls.
    """
    with one_thread:
        start = now()
        for _ in range(repetitions):
            result = call()
        return result, (now() - start) / repetitions
