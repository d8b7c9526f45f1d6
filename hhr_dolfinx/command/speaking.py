"""Output of commands: errors and warnings as sentences on the error stream, by the first rank."""

from __future__ import annotations

import io
import logging
import sys
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import nullcontext, redirect_stdout
from functools import wraps
from typing import TYPE_CHECKING, ParamSpec, TextIO, TypeVar

from hhr_dolfinx.compat import explained, extra
from hhr_dolfinx.errors import HHRError
from hhr_dolfinx.group import launched, world

if TYPE_CHECKING:
    from rich.console import Console

with extra("study", "the command hhr"):
    import click

EXIT_OF_ERRORS = 3
"""Exit code of refused input and of errors, as in :mod:`hhr_dolfinx.command.start`."""
INTERRUPTED = 130
"""Exit code after Ctrl+C: 128 and the number of the signal, as shells have it."""
_GOES_ON = ": answers that were done are kept, and the same command goes on from there"
P = ParamSpec("P")
T = TypeVar("T")


def guarded(command: Callable[P, T], kept: str = "") -> Callable[P, T]:
    """A command whose errors are sentences and exit codes.

    A fault of this package, which has no such sentence, keeps its traceback.

    Args:
        command: the command.
        kept: text added to the message of an interrupted command.
    """

    @wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> T:
        with warnings.catch_warnings():
            # FFCx 0.9 does so when it is loaded, and would replace the handler that is set here
            logging.captureWarnings(True)
            warnings.showwarning = _once()
            end = launched().ending(f"hhr {command.__name__}")
            try:
                with nullcontext() if first_rank() else redirect_stdout(io.StringIO()):
                    result = command(*args, **kwargs)
            except BaseException as error:
                code, words = _last_words(error, kept)
                if end(code, words or traceback.format_exc()) and words:
                    click.echo(words, err=True)
                if not words:  # a fault of this package, or an exit with words of click
                    raise
                sys.exit(code)
            end(0, "")
            return result

    return run


def _last_words(error: BaseException, kept: str) -> tuple[int, str]:
    """Exit code and sentence of what ended a command.

    No sentence for a fault of this package and for exits.
    """
    if isinstance(error, KeyboardInterrupt):
        return INTERRUPTED, "interrupted" + kept
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else int(error.code is not None), ""
    if isinstance(error, click.exceptions.Exit | click.ClickException):
        return error.exit_code, ""
    if isinstance(error, Exception) and (words := _explained(error)):
        return EXIT_OF_ERRORS, f"error: {words}"
    return 1, ""


def resumable(command: Callable[P, T]) -> Callable[P, T]:
    """A guarded command that keeps its answers when it is interrupted, and goes on from them."""
    return guarded(command, _GOES_ON)


def _explained(error: Exception) -> str:
    """Message of an error, with its position if it comes from a file of the user.

    Empty for a fault of this package.
    """
    from hhr_dolfinx.by_name import place_of

    if isinstance(error, ModuleNotFoundError):
        error = explained(error)
    position = place_of(error)
    if isinstance(error, HHRError):
        return f"{position}: {error}" if position else str(error)
    return f"{position}: {type(error).__name__}: {error}" if position else ""


def _once() -> Callable[..., None]:
    """Handler that prints warnings as sentences, each once, on the first rank."""
    shown = set()

    def show(
        message: Warning | str, category: type[Warning], *_: str | int, **__: TextIO | str | None
    ) -> None:
        """Print a message once, without its category."""
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


def spoken() -> tuple[Console, Callable[[str], Callable[[Iterable], Iterator]]]:
    """The console of the first rank, and its progress bars by label."""
    from hhr_dolfinx.command.console import make_console, progress_on

    console = make_console(quiet=not first_rank())
    return console, progress_on(console)
