"""Functions that numba compiles, with a cache on disk that knows what they call."""

from __future__ import annotations

import logging
import os
import stat
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from functools import lru_cache
from pathlib import Path
from types import CodeType
from typing import TYPE_CHECKING, Any, TypeVar

from hhr_dolfinx.errors import ModelFileWarning

if TYPE_CHECKING:
    from numba.core.dispatcher import Dispatcher
    from numba.core.event import Event

F = TypeVar("F", bound=Callable[..., Any])

_log = logging.getLogger(__name__)


def compiled(
    *, inner: bool = False, dear: str | None = None, **options: bool | str | set[str]
) -> Callable[[F], F]:
    """numba's ``njit`` with a cache on disk, or without a cache if no folder is writable.

    Python itself without numba.

    If neither the package nor the user's cache folder is writable, as in a read-only image, the
    cache is in a private folder of the user among temporary files; ``NUMBA_CACHE_DIR`` sets another
    one.

    Args:
        inner: only compiled functions call it. It has no Python wrapper, which may take seconds to
            compile.
        dear: description of a function that takes long to compile, which the log reports.
        options: options of numba.
    """
    njit = _njit()
    if njit is None:
        return lambda function: function
    if inner:
        options |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}

    def decorate(function: F) -> F:
        if dear is not None:
            _report_compilation(function, dear)
        for cache in (nullcontext, _private_cache):
            try:
                with cache():
                    return _stamped(njit(cache=True, **options)(function))
            except RuntimeError:
                continue
        return njit(**options)(function)

    return decorate


_STAMPS: dict[Callable, frozenset[tuple[str, int, int]]] = {}
"""For each compiled function the files, with time and size, of it and of what it calls."""


def _stamped(dispatcher: Dispatcher) -> Dispatcher:
    """Compile anew also where a compiled function that this one calls has changed.

    numba looks at the file of the function alone, and its cache keeps the code of what it calls.
    """
    function = dispatcher.py_func
    codes = [function.__code__]
    for code in codes:  # grows: functions within functions
        codes += [part for part in code.co_consts if isinstance(part, CodeType)]
    named = {name for code in codes for name in code.co_names}
    called = [function.__globals__.get(name) for name in named]
    status = Path(function.__code__.co_filename).stat()
    own = (function.__code__.co_filename, status.st_mtime_ns, status.st_size)
    compiled_ones = [other.py_func for other in called if hasattr(other, "py_func")]
    stamps = [_STAMPS.get(other, frozenset()) for other in compiled_ones]
    _STAMPS[function] = frozenset([own]).union(*stamps)
    file: Any = getattr(dispatcher._cache, "_cache_file", None)
    if hasattr(file, "_source_stamp"):  # else as numba has it
        file._source_stamp = (file._source_stamp, sorted(_STAMPS[function]))
    return dispatcher


@lru_cache(maxsize=1)
def _njit() -> Callable[..., Callable[[F], F]] | None:
    """numba's compiler; None without numba, of which a warning tells once."""
    try:
        from numba import njit
    except ImportError:
        warnings.warn(
            (
                "numba is not installed, and laws of bodies run as Python, much slower: pip "
                "install hhr_dolfinx[flow]"
            ),
            ModelFileWarning,
            stacklevel=2,
        )
        return None
    return njit


@contextmanager
def _private_cache() -> Iterator[None]:
    """Cache compiled functions in a folder of the user alone, as its contents are executed.

    Else a RuntimeError.
    """
    from numba.core import config

    if not hasattr(os, "getuid"):
        raise RuntimeError("no folder is known to be the user's alone")
    folder = Path(tempfile.gettempdir()) / f"hhr_dolfinx-{os.getuid()}"
    previous = config.CACHE_DIR
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
    except OSError as error:
        raise RuntimeError(str(error)) from error
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid() or status.st_mode & 0o077:
        raise RuntimeError(f"{folder} is open to others")
    config.CACHE_DIR = str(folder)
    try:
        yield
    finally:
        config.CACHE_DIR = previous


_DEAR: dict[Callable, str] = {}
"""Descriptions of functions that take long to compile."""


def _report_compilation(function: Callable[..., object], what: str) -> None:
    """Log once, at the start of the compilation of a function, that this takes long."""
    from numba.core import event

    class Report(event.Listener):
        def on_start(self, event: Event) -> None:
            dispatcher = event.data.get("dispatcher")
            done = None if dispatcher is None else _DEAR.pop(dispatcher.py_func, None)
            if done is not None:
                for reported in [key for key, value in _DEAR.items() if value == done]:
                    del _DEAR[reported]
                _log.warning(
                    (
                        "compiling %s, once for an installation: this takes a quarter of a minute "
                        "or more"
                    ),
                    done,
                )

        def on_end(self, event: Event) -> None:
            pass

    if not _DEAR:
        event.register("numba:compile", Report())
    _DEAR[function] = what
