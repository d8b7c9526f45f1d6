"""Progress of a search: elapsed seconds, and lines on its stages."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from hhr_dolfinx.timing import now

if TYPE_CHECKING:
    from hhr_dolfinx.command.console import Console


class Stopwatch:
    """Clock of the seconds since its construction."""

    def __init__(self) -> None:
        self._start = now()

    @property
    def seconds(self) -> float:
        """Elapsed seconds."""
        return now() - self._start


class ShareLines:
    """Progress as lines: one for each stage of a long run, then the share that is done.

    There is none in the first ``quiet`` seconds, nor sooner than ``every`` seconds after the last
    one of a stage.
    """

    def __init__(self, write: Callable[[str], None], quiet: float = 2.0, every: float = 5.0):
        self._write = write
        self._quiet = quiet
        self._every = every
        self._clock = Stopwatch()
        self._last: dict[str, float] = {}

    def __call__(self, stage: str, share: float) -> None:
        """Write a line if one is due, see :data:`hhr_dolfinx.timing.Announce`."""
        seconds = self._clock.seconds
        if seconds < self._quiet:
            return
        if not share or seconds - self._last.get(stage, -math.inf) >= self._every:
            self._last[stage] = seconds
            self._write(f"{seconds:.0f} s: {stage}" + (f", {share:.0%} done" if share else ""))


def shares_on(console: Console) -> ShareLines:
    """Print the stages of a run that take longer than half a second, and their progress."""
    return ShareLines(lambda line: console.print(line, highlight=False), quiet=0.5)
