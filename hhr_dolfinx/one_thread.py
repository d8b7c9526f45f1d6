"""BLAS and OpenMP on one thread of the process, as long as any thread of the package requires
it.
"""

from __future__ import annotations

import sys
from contextlib import ContextDecorator
from threading import Lock
from typing import TYPE_CHECKING

from threadpoolctl import ThreadpoolController

if TYPE_CHECKING:
    from threadpoolctl import _ThreadpoolLimiter


class _OneThread(ContextDecorator):
    """Limit of the process to one thread, from the first of overlapping blocks to the last: none
    restores another.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._blocks = 0
        self._limit: _ThreadpoolLimiter | None = None
        self._modules = 0
        self._controller: ThreadpoolController | None = None

    def __enter__(self) -> None:
        with self._lock:
            if not self._blocks:
                self._limit = self._libraries().limit(limits=1)
            self._blocks += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._blocks -= 1
            if not self._blocks and self._limit is not None:
                self._limit.restore_original_limits()
                self._limit = None

    def _libraries(self) -> ThreadpoolController:
        """Controller of the libraries in the process: a search takes 6 ms, more than a march of a
        condensed model.

        It is repeated when modules have been imported since: libraries are loaded with them.
        """
        if len(sys.modules) != self._modules:
            count = len(sys.modules)
            self._controller = ThreadpoolController()
            self._modules = count  # last: a search may fail
        return self._controller


one_thread = _OneThread()
"""A context manager and a decorator; blocks may be nested, and overlap between threads."""
