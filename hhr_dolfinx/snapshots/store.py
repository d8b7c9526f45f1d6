"""Snapshots on disk: one plain file per solution, so that nothing is solved twice.

A file is named by a fingerprint of the problem and the parameter, and is written under another name
first; a run that was killed leaves only whole files. Files of another problem are never read.
"""

from __future__ import annotations

import hashlib
import os
import zipfile
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import issparse

from hhr_dolfinx.contact.problem import ContactProblem, ContactSolution, Status

_VERSION = b"hhr_dolfinx snapshot 2"


class SnapshotStore:
    """Full-order solutions of one problem in a folder.

    Args:
        folder: where the files are; made if missing. Several problems and processes may share it.
        problem: the problem that is solved. Any change of it gives other files.

    Attributes:
        found: number of solutions that were there when asked for.
    """

    def __init__(self, folder: str | Path, problem: ContactProblem):
        self._folder = Path(folder)
        self._folder.mkdir(parents=True, exist_ok=True)
        self._fingerprint = _digest_of(problem)
        self.found = 0

    def load(self, point: np.ndarray) -> ContactSolution | None:
        """The stored solution at a parameter, or None if there is none or its file is damaged."""
        path = self._path(point)
        try:
            with np.load(path, allow_pickle=False) as file:
                primal, forces, active = file["primal"], file["forces"], file["active"]
                intact = _checksum(primal, forces, active) == str(file["sha256"])
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            intact = False
        if not intact:
            path.unlink(missing_ok=True)  # solved anew and written again
            return None
        self.found += 1
        return ContactSolution(primal, forces, active, 0, Status.CONVERGED, False)

    def save(self, point: np.ndarray, solution: ContactSolution) -> None:
        """Keep a solution."""
        path = self._path(point)
        temporary = path.with_suffix(f".{os.getpid()}.part")
        arrays = solution.primal, solution.forces, solution.active
        with open(temporary, "wb") as file:
            np.savez(file, primal=arrays[0], forces=arrays[1], active=arrays[2], sha256=np.array(_checksum(*arrays)))
        os.replace(temporary, path)

    def _path(self, point):
        digest = hashlib.sha256(self._fingerprint + np.asarray(point, dtype=float).tobytes())
        return self._folder / f"{digest.hexdigest()[:40]}.npz"


def _digest_of(problem) -> bytes:
    """Fingerprint of every bit of a problem. Where a machine assembles other last digits, snapshots are solved anew."""
    digest = hashlib.sha256(_VERSION)

    def add(value):
        if issparse(value):
            add(value.indptr)
            add(value.indices)
            add(value.data)
        elif is_dataclass(value):
            for item in fields(value):
                add(getattr(value, item.name))
        elif isinstance(value, tuple):
            for item in value:
                add(item)
        elif isinstance(value, str):
            digest.update(value.encode() + b"\0")
        else:
            array = np.ascontiguousarray(value)
            digest.update(f"{array.dtype.str}{array.shape}".encode() + array.tobytes())

    add(problem)
    return digest.digest()


def _checksum(*arrays) -> str:
    return hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()
