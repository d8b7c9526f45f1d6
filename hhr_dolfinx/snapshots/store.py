"""Snapshots on disk: one plain file per solution, so that nothing is solved twice.

A file is named by a fingerprint of the problem and the parameter, and says both inside; a run that was killed
leaves only whole files. Files of another problem are never read.
"""

from __future__ import annotations

import hashlib
import warnings
from dataclasses import astuple, fields, is_dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import issparse

from hhr_dolfinx.certify.accuracy import contact_residuals
from hhr_dolfinx.contact.problem import ContactProblem, ContactSolution, Status
from hhr_dolfinx.errors import FileContentError, SnapshotFileWarning
from hhr_dolfinx.files import check_layout, clear_leftovers, make_folder, read_arrays, write_arrays
from hhr_dolfinx.version import __version__

FORMAT, VERSION = "hhr_dolfinx snapshot", 3

_LAYOUT = {
    "primal": ("float", "N"),
    "forces": ("float", "N_lambda"),
    "active": ("bool", "N_lambda"),
}


SOLVED = 1e-2
"""Largest relative residual of a solution: round-off reaches 1e-4 where bodies are carried by 1e8 times their size."""


class SnapshotStore:
    """Full-order solutions of one problem in a folder.

    Args:
        folder: where the files are; made if missing. Several problems and processes may share it.
        problem: the problem that is solved. Any change of it gives other files, but for the bounds of its
            parameters, on which no solution depends.

    Attributes:
        found: number of solutions that were there when asked for.

    Raises:
        FileError: if the folder cannot be made.
    """

    def __init__(self, folder: str | Path, problem: ContactProblem):
        self._folder = make_folder(folder)
        clear_leftovers(self._folder)
        self._problem, self._fingerprint = problem, _digest_of(problem)
        conditions, dofs = problem.contact.shape
        self._sizes = {"N": dofs, "N_lambda": conditions}
        self.found = 0

    def load(self, point: np.ndarray) -> ContactSolution | None:
        """The stored solution at a parameter, or None if there is none or its file is damaged, which is warned of."""
        path = self._path(point)
        try:
            header, arrays = read_arrays(path, FORMAT, VERSION)
            if header != self._header(point):
                raise FileContentError(f"{path} belongs to another problem or parameter")
            check_layout(arrays, _LAYOUT, self._sizes)
            self._check_solution(path, point, arrays)
        except FileNotFoundError:
            return None
        except FileContentError as error:
            warnings.warn(
                f"{error}: {path.name} at {np.ravel(point).tolist()} is solved anew and replaced",
                SnapshotFileWarning,
                stacklevel=2,
            )
            return None
        self.found += 1
        return ContactSolution(**arrays, iterations=0, status=Status.CONVERGED, cycled=False)

    def _check_solution(self, path, point, arrays) -> None:
        """Refuse what does not solve the problem, whatever its checksum says.

        Raises:
            FileContentError: with the largest residual.
        """
        theta = self._problem.amplitudes(np.atleast_1d(point))
        found = astuple(contact_residuals(self._problem, arrays["primal"], arrays["forces"], theta))
        if not max(found) <= SOLVED:
            raise FileContentError(f"{path} holds no solution, residuals of {max(found):.1g}")

    def save(self, point: np.ndarray, solution: ContactSolution) -> None:
        """Keep a solution.

        Raises:
            FileError: if its file cannot be written.
        """
        arrays = {name: np.asarray(getattr(solution, name)) for name in _LAYOUT}
        check_layout(arrays, _LAYOUT, self._sizes)
        # one file in thousands: leftovers were cleared when the folder was opened
        write_arrays(self._path(point), self._header(point), arrays, tidy=False)

    def _header(self, point) -> dict:
        place = np.ravel(np.asarray(point, dtype=float)).tolist()
        return {"format": FORMAT, "version": VERSION, "problem": self._fingerprint.hex(), "point": place}

    def _path(self, point) -> Path:
        digest = hashlib.sha256(self._fingerprint + np.asarray(point, dtype=float).tobytes())
        return self._folder / f"{digest.hexdigest()[:40]}.npz"


def _digest_of(problem) -> bytes:
    """Fingerprint of every bit of a problem, and of the version of the package that solves it.

    The bounds of the parameters are left out: a wider box finds the solutions of the narrower one. Where a machine
    assembles other last digits, snapshots are solved anew.
    """
    digest = hashlib.sha256(f"{FORMAT} {VERSION} of hhr_dolfinx {__version__}\0".encode())

    def add(value):
        if issparse(value):
            add(value.indptr)
            add(value.indices)
            add(value.data)
        elif is_dataclass(value):
            add(type(value).__qualname__)
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

    for item in fields(problem):
        value = getattr(problem, item.name)
        add(value.names if item.name == "parameters" else value)
    return digest.digest()
