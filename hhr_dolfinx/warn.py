"""Warnings of the package, which a block of one thread may ignore or collect.

Until Python 3.14 ``warnings.catch_warnings`` replaces the filters of the whole process: if two
threads leave such blocks in another order than they entered them, the filters of one of them stay
for good. Here the handlers belong to the context of a thread, and the filters of the user do not
change.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import NamedTuple


class Warned(NamedTuple):
    """A warning that was collected, and the line that is reported."""

    message: str
    category: type[Warning]
    filename: str
    lineno: int


_Handler = Callable[[Warned], bool]
"""Function that handles a warning, or returns False to pass it to the enclosing handler."""
_HANDLERS: ContextVar[tuple[_Handler, ...]] = ContextVar("handlers of warnings", default=())


_INSIDE = {"hhr_dolfinx", "contextlib", "functools", "importlib"}
"""Modules whose lines say nothing to the user: those of the package, and those by which they call
each other.
"""


def warn(message: str, category: type[Warning]) -> None:
    """Warn for the line that called the package.

    A block that ignores or collects the warning comes first.

    Args:
        message: the message.
        category: class of the warning.
    """
    frame = sys._getframe(1)
    while (
        frame.f_back is not None
        and frame.f_globals.get("__name__", "").partition(".")[0] in _INSIDE
    ):
        frame = frame.f_back
    _repeat(Warned(message, category, frame.f_code.co_filename, frame.f_lineno), frame.f_globals)


def repeat(collected: Iterable[Warned]) -> None:
    """Issue collected warnings again, for their lines."""
    for warning in collected:
        _repeat(warning, None)


def _repeat(item: Warned, module_globals: dict | None) -> None:
    if any(handler(item) for handler in reversed(_HANDLERS.get())):
        return
    if module_globals is None:
        warnings.warn_explicit(*item)
    else:
        registry = module_globals.setdefault("__warningregistry__", {})
        warnings.warn_explicit(*item, str(module_globals.get("__name__", "<unknown>")), registry)


@contextmanager
def _handled(handler: _Handler) -> Iterator[None]:
    token = _HANDLERS.set((*_HANDLERS.get(), handler))
    try:
        yield
    finally:
        _HANDLERS.reset(token)


@contextmanager
def ignored(*categories: type[Warning], about: str = "") -> Iterator[None]:
    """Ignore warnings of some classes in a block of this thread, if their text contains
    ``about``.
    """
    with _handled(lambda item: issubclass(item.category, categories) and about in item.message):
        yield


@contextmanager
def collected(*categories: type[Warning]) -> Iterator[list[Warned]]:
    """Collect warnings of some classes, all by default, in a block of this thread.

    :func:`repeat` reports them.
    """
    warned: list[Warned] = []

    def take(item: Warned) -> bool:
        if categories and not issubclass(item.category, categories):
            return False
        warned.append(item)
        return True

    with _handled(take):
        yield warned


_FIRST: ContextVar[set[str] | None] = ContextVar("kinds of warnings said in a block", default=None)


@contextmanager
def first_alone() -> Iterator[None]:
    """Context in which each kind of warning that asks :func:`is_first` is given once, for many
    histories.
    """
    if _FIRST.get() is not None:  # the outermost block counts
        yield
        return
    token = _FIRST.set(set())
    try:
        yield
    finally:
        _FIRST.reset(token)


def is_first(kind: str) -> bool:
    """True for the first warning of a kind in a block of :func:`first_alone`.

    Always outside of one.
    """
    kinds = _FIRST.get()
    if kinds is None:
        return True
    if kind in kinds:
        return False
    kinds.add(kind)
    return True
