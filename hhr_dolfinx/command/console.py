"""Output of commands and studies: with bars on a terminal; in whole lines in a pipe or a log
file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sized
from typing import TypeVar

from hhr_dolfinx.compat import extra

with extra("study", "the console"):
    from rich.console import Console
    from rich.progress import track
    from rich.table import Column, Table

__all__ = ["Column", "Console", "Table", "make_console", "progress_on"]

T = TypeVar("T")
_NO_LIMIT = 10_000
_ANY_HEIGHT = 25
"""Columns and lines of a console without a window. rich assumes 80 columns unless both are
given.
"""


def make_console(quiet: bool = False) -> Console:
    """A console on standard output, which breaks lines only at the edge of a window.

    Lines of a log are kept whole, however long, for ``grep``. Colours are left to rich, which
    writes none outside a terminal unless it is forced to (``FORCE_COLOR``). Brackets are printed,
    as names of folders have them.
    """
    console = Console(quiet=quiet, markup=False)
    if _is_watched(console):
        return console
    return Console(quiet=quiet, markup=False, width=_NO_LIMIT, height=_ANY_HEIGHT)


def progress_on(console: Console) -> Callable[[str], Callable[[Iterable], Iterator]]:
    """Function from a label to a wrapper of iterations: a bar that vanishes, or one line outside a
    terminal.

    Bars move the cursor, and must not be written to a file, even if colours are forced.
    """
    shown = _bar if _is_watched(console) else _line
    return lambda label: lambda items: shown(label, items, console)


def _bar(label: str, items: Iterable[T], console: Console) -> Iterator[T]:
    yield from track(items, description=f"{label:10}", console=console, transient=True)


def _line(label: str, items: Iterable[T], console: Console) -> Iterator[T]:
    count = f": {len(items)} to do" if isinstance(items, Sized) else ""
    if count != ": 0 to do":
        console.print(f"{label}{count}", highlight=False)
    yield from items


def _is_watched(console: Console) -> bool:
    """True if a window shows the output: a terminal that can move its cursor, or a notebook."""
    isatty = getattr(console.file, "isatty", lambda: False)
    return console.is_jupyter or (isatty() and console.is_terminal and not console.is_dumb_terminal)
