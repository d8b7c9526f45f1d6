"""Progress of a search: elapsed seconds, and lines on its stages."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hhr_dolfinx.timing import ShareLines, now

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


def shares_on(console: Console) -> ShareLines:
    """Print the stages of a run that take longer than half a second, and their progress."""
    return ShareLines(lambda line: console.print(line, highlight=False), quiet=0.5)
