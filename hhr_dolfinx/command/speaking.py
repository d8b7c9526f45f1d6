"""Output of commands: errors and warnings as sentences on the error stream, by the first rank."""

from __future__ import annotations

import logging
import sys
import warnings
from collections.abc import Callable
from functools import wraps
from typing import Any

from hhr_dolfinx.compat import explained, extra
from hhr_dolfinx.errors import HHRError
from hhr_dolfinx.group import world

with extra("study", "the command hhr"):
    import click

REFUSED = 3
INTERRUPTED = 130
_GOES_ON = ": answers that were done are kept, and the same command goes on from there"
Command = Callable[..., Any]


def guarded(command: Command, kept: str = "") -> Command:
    """A command whose errors are sentences and exit codes; ``kept`` is added to the message if it is interrupted.

    A fault of this package, which has no such sentence, keeps its traceback.
    """

    @wraps(command)
    def run(*args: Any, **kwargs: Any) -> Any:
        with warnings.catch_warnings():
            # FFCx 0.9 does so when it is loaded, and would replace the handler that is set here
            logging.captureWarnings(True)
            warnings.showwarning = _once()
            try:
                return command(*args, **kwargs)
            except KeyboardInterrupt:
                _say("interrupted" + kept)
                sys.exit(INTERRUPTED)
            except Exception as error:
                _say(f"error: {_explained(error)}")
            sys.exit(REFUSED)

    return run


def resumable(command: Command) -> Command:
    """A guarded command that keeps its answers when it is interrupted, and goes on from them."""
    return guarded(command, _GOES_ON)


def _explained(error: Exception) -> str:
    """Message of an error, with its position if it comes from a file of the user; a fault of this package is raised."""
    from hhr_dolfinx.by_name import place_of

    if isinstance(error, ModuleNotFoundError):
        error = explained(error)
    place = place_of(error)
    if isinstance(error, HHRError):
        return f"{place}: {error}" if place else str(error)
    if not place:
        raise error
    return f"{place}: {type(error).__name__}: {error}"


def _once() -> Callable[..., None]:
    """Handler that prints warnings as sentences, each once, on the first rank."""
    shown = set()

    def show(message: object, category: object, *_: Any, **__: Any) -> None:
        if str(message) not in shown:
            shown.add(str(message))
            _say(f"warning: {message}")

    return show


def _say(text: str) -> None:
    if first_rank():
        click.echo(text, err=True)


def first_rank() -> bool:
    """True if this process prints; evaluation of a model needs no MPI."""
    comm = world()
    return comm is None or comm.rank == 0


def spoken() -> tuple[Any, Any]:
    """The console of the first rank, and its progress bars by label."""
    from hhr_dolfinx.command.console import make_console, progress_on

    console = make_console(quiet=not first_rank())
    return console, progress_on(console)
