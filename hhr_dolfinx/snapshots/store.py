"""Snapshots on disk: one plain file per answer, at a parameter or a step of a history, so that nothing is solved twice.

A file is named by a fingerprint of the problem and of the question, and says both inside; a run that was killed leaves
only whole files. Files of another problem are never read. A step of a history is asked for by the whole path up to it
and by how it is solved: an interrupted history goes on behind its last file.
"""

from __future__ import annotations

import hashlib
import warnings
from dataclasses import astuple, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import issparse

from hhr_dolfinx.certify.accuracy import contact_residuals
from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import FileContentError, SnapshotFileWarning
from hhr_dolfinx.files import check_layout, clear_leftovers, make_folder, read_arrays, write_arrays
from hhr_dolfinx.models.answer import Answer, GaussState
from hhr_dolfinx.models.answer import Path as History_path
from hhr_dolfinx.models.path import MarchSettings, checked_path
from hhr_dolfinx.version import __version__

FORMAT, VERSION = "hhr_dolfinx snapshot", 4

_LAYOUT = {
    "unknown": ("float", "N"),
    "multipliers": ("float", "N_lambda"),
    "active": ("bool", "N_lambda"),
}
_GAUSS = {
    "stress": ("float", "points", "components"),
    "plastic": ("float", "points", "components"),
    "cumulated": ("float", "points"),
    "iterations": ("int",),
}
"""What a step of bodies that flow has besides."""

SOLVED = 1e-2
"""Largest relative residual of a solution: round-off reaches 1e-4 where bodies are carried by 1e8 times their size."""


class SnapshotStore:
    """Full-order answers of one problem in a folder.

    Args:
        folder: where the files are; made if missing. Several problems and processes may share it.
        full: the full model whose answers are kept. Any change of its problem or of its laws gives other files, but for
            the bounds of its parameters, on which no answer depends. All rows of the problem are needed: on several
            ranks give ``full.gathered()``.

    Attributes:
        found: number of answers that were there when asked for.

    Raises:
        FileError: if the folder cannot be made.
        SceneError: if ranks share the rows of the problem.
    """

    def __init__(self, folder: str | Path, full: Any):
        full.problem.require_whole()
        self._folder = make_folder(folder)
        clear_leftovers(self._folder)
        self._full, self._problem = full, full.problem
        self._fingerprint = _digest_of(full)
        conditions, dofs = self._problem.contact.shape
        self._sizes = {"N": dofs, "N_lambda": conditions}
        if full.equilibrium is not None:
            material = full.equilibrium.material
            self._sizes |= {"points": material.gauss_points, "components": material.components}
        self.found = 0

    def load(self, point: np.ndarray) -> Answer | None:
        """The answer kept at a parameter, or None if there is none or its file is damaged, which is warned of."""
        return self._load(np.atleast_1d(np.asarray(point, dtype=float)), self._question(point))

    def save(self, answer: Answer) -> None:
        """Keep the answer at a parameter.

        Raises:
            FileError: if its file cannot be written.
        """
        self._save(answer, self._question(answer.parameter))

    def steps(self, path: History_path, settings: MarchSettings) -> KeptSteps:
        """What is kept of a history."""
        return KeptSteps(self, checked_path(self._problem.parameters, path), settings)

    def _load(self, point: np.ndarray, question: list) -> Answer | None:
        path = self._path(question)
        try:
            header, arrays = read_arrays(path, FORMAT, VERSION)
            if header != self._header(question):
                raise FileContentError(f"{path} belongs to another problem or parameter")
            check_layout(arrays, self._layout(), self._sizes)
            answer = self._answer(point, arrays)
            self._check_solution(path, answer)
        except FileNotFoundError:
            return None
        except FileContentError as error:
            warnings.warn(
                f"{error}: {path.name} at {point.tolist()} is solved anew and replaced",
                SnapshotFileWarning,
                stacklevel=3,
            )
            return None
        self.found += 1
        return answer

    def _save(self, answer: Answer, question: list) -> None:
        values = {name: getattr(answer, name) for name in _LAYOUT}
        if answer.gauss is not None:
            values |= {"stress": answer.gauss.stress, **answer.gauss.state._asdict(), "iterations": answer.iterations}
        arrays = {name: np.asarray(values[name]) for name in self._layout()}
        check_layout(arrays, self._layout(), self._sizes)
        # one file in thousands: leftovers were cleared when the folder was opened
        write_arrays(self._path(question), self._header(question), arrays, tidy=False)

    def _layout(self) -> dict[str, tuple[str, ...]]:
        return _LAYOUT if self._full.equilibrium is None else _LAYOUT | _GAUSS

    def _answer(self, point: np.ndarray, arrays: dict[str, np.ndarray]) -> Answer:
        gauss, iterations = None, 0
        if "stress" in arrays:
            state = self._full.equilibrium.material.at_rest()
            state = state._replace(plastic=arrays["plastic"], cumulated=arrays["cumulated"])
            gauss, iterations = GaussState(arrays["stress"], state), int(arrays["iterations"])
        parts = (arrays[name] for name in _LAYOUT)
        return Answer(point, *parts, iterations, Status.CONVERGED, False, self._full, gauss=gauss)

    def _check_solution(self, path: Path, answer: Answer) -> None:
        """Refuse what does not solve the problem, whatever its checksum says.

        Raises:
            FileContentError: with the largest residual.
        """
        if answer.gauss is None:
            theta = self._problem.amplitudes(answer.parameter)
            worst = max(astuple(contact_residuals(self._problem, answer.displacement(), answer.forces(), theta)))
        else:
            signs = self._full.equilibrium.signs(answer)
            worst = signs.imbalance / signs.size if signs.size > 0 else 0.0
        if not worst <= SOLVED:
            raise FileContentError(f"{path} holds no solution, residuals of {worst:.1g}")

    def _question(self, point: np.ndarray) -> list:
        return np.ravel(np.asarray(point, dtype=float)).tolist()

    def _header(self, question: list) -> dict:
        return {"format": FORMAT, "version": VERSION, "problem": self._fingerprint.hex(), "point": question}

    def _path(self, question: list) -> Path:
        digest = hashlib.sha256(self._fingerprint + repr(question).encode())
        return self._folder / f"{digest.hexdigest()[:40]}.npz"


class KeptSteps:
    """The steps of one history in a store.

    Args:
        store: where they are.
        path: checked times and parameters.
        settings: how the history is solved.
    """

    def __init__(self, store: SnapshotStore, path: History_path, settings: MarchSettings):
        self._store, self._path = store, path
        how = [getattr(settings, name) for name in settings.__dataclass_fields__ if name != "outside"]
        self._questions = [[*how, [[time, *point.tolist()] for time, point in path[: n + 1]]] for n in range(len(path))]
        self._count = 0

    def load(self) -> list[Answer]:
        """Answers to the first steps, up to the first that is not there."""
        answers = []
        for (time, point), question in zip(self._path[1:], self._questions[1:], strict=True):
            answer = self._store._load(point, question)
            if answer is None:
                break
            answers.append(answer._replace(time=time))
        self._count = len(answers)
        return answers

    def save(self, answer: Answer) -> None:
        """Keep the next step.

        Raises:
            FileError: if its file cannot be written.
        """
        self._count += 1
        self._store._save(answer, self._questions[self._count])


def _digest_of(full: Any) -> bytes:
    """Fingerprint of every bit of a problem and of its laws, and of the version of the package that solves it.

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
            digest.update(type(value).__qualname__.encode() + b"\0")
            for item in fields(value):
                add(getattr(value, item.name))
        elif isinstance(value, tuple):
            for item in value:
                add(item)
        elif isinstance(value, str):
            digest.update(value.encode() + b"\0")
        elif hasattr(value, "__dict__"):  # a law or an amplitude of a user's own
            digest.update(type(value).__qualname__.encode() + b"\0")
            for name in sorted(vars(value)):
                digest.update(name.encode() + b"\0")
                add(vars(value)[name])
        elif value is not None:
            array = np.ascontiguousarray(value)
            digest.update(f"{array.dtype.str}{array.shape}".encode() + array.tobytes())

    problem: ContactProblem = full.problem
    for item in fields(problem):
        value = getattr(problem, item.name)
        add(value.names if item.name == "parameters" else value)
    if full.equilibrium is not None:
        for group in full.equilibrium.material.groups:
            add(group)
    return digest.digest()
