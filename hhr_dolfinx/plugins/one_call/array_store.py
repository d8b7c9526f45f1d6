"""Arrays of long computations in a folder, so that a search that was interrupted goes on."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hhr_dolfinx.errors import FileContentError, SnapshotFileWarning
from hhr_dolfinx.files import clear_leftovers, make_folder, read_arrays, write_arrays
from hhr_dolfinx.warn import warn

ARRAYS = ("hhr_dolfinx arrays", 1)
"""Format and version of the files."""


class ArrayStore:
    """Arrays of long computations by name, one file per key.

    FileError if the folder cannot be made.

    ``problem`` is the digest of the problem that they belong to, as
    :attr:`SnapshotStore.problem_digest`: files of other problems are not read.
    """

    def __init__(self, folder: str | Path, problem: str):
        self._folder = make_folder(folder)
        clear_leftovers(self._folder)
        self._problem = problem

    def load(self, key: str) -> dict[str, np.ndarray] | None:
        """Load the arrays of a key.

        None if they are not there, or damaged, with a warning.
        """
        try:
            header, arrays = read_arrays(self._path(key), *ARRAYS)
        except FileNotFoundError:
            return None
        except FileContentError as error:
            warn(f"{error}: it is solved for again and replaced", SnapshotFileWarning)
            return None
        return arrays if header == self._header(key) else None

    def save(self, key: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Store arrays of finite numbers.

        Args:
            key: their key.
            arrays: arrays by name.

        Raises:
            FileError: if the file cannot be written.
        """
        write_arrays(self._path(key), self._header(key), arrays, tidy=False)

    def _header(self, key: str) -> dict[str, str | int]:
        kind, version = ARRAYS
        return {"format": kind, "version": version, "problem": self._problem, "key": key}

    def _path(self, key: str) -> Path:
        return (
            self._folder
            / f"{hashlib.sha256(f'{self._problem} {key}'.encode()).hexdigest()[:40]}.npz"
        )
