"""Snapshots on disk, so that nothing is solved twice.

One plain file per answer, at a parameter or a step of a history.

The name of a file is a fingerprint of the problem and the query, and its header has both: files of
another problem are never read. The query of a history's step is the whole path up to it with the
settings of the solution.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import astuple, fields, is_dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import issparse

from hhr_dolfinx.certify.accuracy import contact_residuals
from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.declared import check_layout
from hhr_dolfinx.errors import FileContentError, SnapshotFileWarning
from hhr_dolfinx.files import clear_leftovers, make_folder, read_arrays, write_arrays
from hhr_dolfinx.memory import NO_MEMORY
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.histories.equilibrium import facet_of
from hhr_dolfinx.version import __version__
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    from hhr_dolfinx.files import Json
    from hhr_dolfinx.models.full import FullModel
    from hhr_dolfinx.parameters import ParameterSpace


def add_to(digest: hashlib._Hash, parts: Sequence[object]) -> None:
    """Update a digest with values, to the last bit.

    Args:
        digest: digest of :mod:`hashlib`.
        parts: arrays, sparse or not, numbers and texts, and lists of these.
    """
    for entry in parts:
        for value in entry if isinstance(entry, tuple | list) else (entry,):
            for array in arrays_of(value):
                digest.update(bytes_of(array))


def bytes_of(array: np.ndarray) -> bytes:
    """Type, shape and entries of an array.

    Raises:
        TypeError: for an array of objects: its bytes are addresses, which differ from process to
            process.
    """
    if array.dtype.hasobject:
        raise TypeError(
            f"{array!r} has no bytes that identify it: give its arrays, numbers and texts"
        )
    return f"{array.dtype.str}{array.shape}".encode() + array.tobytes()


def arrays_of(item: Any) -> tuple[np.ndarray, ...]:
    """Arrays of a sparse matrix, or a value as an array."""
    return (
        (item.indptr, item.indices, item.data) if issparse(item) else (np.ascontiguousarray(item),)
    )


def parts_of(item: object) -> list[object]:
    """Arrays, numbers and texts of a value: the fields of a dataclass, those of fields too.

    None of None.
    """
    if item is None:
        return []
    if is_dataclass(item):
        return [
            value for attribute in fields(item) for value in parts_of(getattr(item, attribute.name))
        ]
    return [item]


Query = Sequence[float | str | None]
"""Values of a point, and those of amplitudes and laws there, which a stored answer has."""

SNAPSHOT_FORMAT = "hhr_dolfinx snapshot"
"""Content of a file, in its header."""
SNAPSHOT_VERSION = 6
"""Version of this format: snapshots of another one are not found, and solved for again."""
_LAYOUT: dict[str, tuple[str, ...]] = {
    "unknown": ("float", "N"),
    "multipliers": ("float", "N_lambda"),
    "active": ("bool", "N_lambda"),
}
_PARTS: dict[str, tuple[str, ...]] = {
    "iterations": ("int",),
    "ends": ("float", "ends"),
    "time_error": ("float",),
}
"""Additional arrays of a step that may be solved in parts."""

NO_TIME_ERROR = -1.0
"""Time error of a step without an estimate."""
SNAPSHOT_RESIDUAL = 1e-2
"""Largest relative residual of a solution: round-off reaches 1e-4 if bodies are displaced by 1e8
times their size.
"""


class StoredLaws:
    """Memory of laws of bodies in files.

    The facet ``store`` of a plug-in makes it of a full equilibrium.

    The methods here are those of elastic bodies, which remember nothing. ``layout`` has the types
    and sizes of the arrays of an answer, by name, and ``sizes`` the values of these sizes.
    """

    layout: Mapping[str, tuple[str, ...]] = MappingProxyType({})
    sizes: Mapping[str, int] = MappingProxyType({})

    def __init__(self, problem: ContactProblem):
        self._problem = problem

    def fingerprint(self) -> list[object]:
        """Arrays, numbers and texts that identify the laws.

        A digest is updated with them by :func:`add_to`.
        """
        return []

    def query(self, point: np.ndarray) -> list[str]:
        """Digests of what laws with formulas do at a point, (P,)."""
        return []

    def arrays(self, answer: Answer) -> dict[str, np.ndarray]:
        """Memory of an answer as arrays, by the names of the layout."""
        return {}

    def memory(self, arrays: Mapping[str, np.ndarray]) -> dict[str, Any]:
        """Parts of the memory of an answer, by name."""
        return {}

    def residual(self, answer: Answer, forces: float) -> float:
        """Largest relative residual of an answer.

        Args:
            answer: the answer.
            forces: norm of the forces at previous steps, the scale for unloaded bodies.
        """
        problem = self._problem.at(answer.parameter)
        theta = self._problem.amplitudes(answer.parameter)
        opened = self._problem.law.opened(answer.memory)
        return max(
            astuple(
                contact_residuals(problem, answer.displacement(), answer.forces(), theta, opened)
            )
        )

    def size(self, answer: Answer) -> float:
        """Norm of the forces of an answer, for the residual of later steps."""
        return 0.0

    def is_large(self, answer: Answer) -> bool:
        """True if the memory of such answers is better mapped from disk."""
        return False


def stored_laws(full: FullModel) -> StoredLaws:
    """Laws of the bodies of a full model, as files keep them."""
    if full.equilibrium is None:
        return StoredLaws(full.problem)
    laws: StoredLaws = facet_of(full.equilibrium, "store", "a store of snapshots")(full)
    return laws


class SnapshotStore:
    """Full-order answers of one problem in a folder.

    Args:
        folder: folder of the files, made if missing. Several problems and processes may share it.
        full: full model whose answers are stored. Any change of its problem or laws changes the
            file names; the bounds of its parameters do not, as no answer depends on them. If the
            model is distributed over ranks, all of them make the store, and one reads and writes.

    Attributes:
        folder: folder of the files.
        found: number of queries whose answer was in the store.
        laws: laws of the bodies, as files keep them.

    Raises:
        FileError: if the folder cannot be made.
    """

    def __init__(self, folder: str | Path, full: FullModel):
        self._full = full
        self._problem = full.problem
        self.laws = stored_laws(full)
        self._fingerprint = _digest_of(
            full
        )  # collective, before anything that may fail on one rank
        self.folder = make_folder(folder)
        clear_leftovers(self.folder)
        conditions, dofs = self._problem.contact.shape
        self._law = self._problem.law
        self._sizes = {"N": dofs, "N_lambda": conditions, **self._law.sizes, **self.laws.sizes}
        self.found = 0

    def load(self, point: np.ndarray) -> Answer | None:
        """Load the answer at a parameter; None if it is not there.

        For a damaged file None too, with a warning.
        """
        point = np.array(point, dtype=float, ndmin=1)
        return self.load_query(point, self.query_at(point))

    def read(self, point: np.ndarray) -> Answer | None:
        """Read the answer at a parameter as :meth:`load`, without a check of its residual."""
        point = np.array(point, dtype=float, ndmin=1)
        query = self.query_at(point)
        with self._damage_reported(point, query):
            return self._read(point, query)
        return None

    def judged(self, answer: Answer, *, aloud: bool = True) -> Answer | None:
        """The given answer if it is a solution, else None. Collective.

        Args:
            answer: the answer.
            aloud: warn of a damaged file.
        """
        query = self.query_at(answer.parameter)
        with self._damage_reported(answer.parameter, query, aloud):
            self._judge(answer, query)
            return answer
        return None

    def save(self, answer: Answer) -> None:
        """Store the answer at a parameter; FileError if its file cannot be written."""
        self.save_query(answer, self.query_at(answer.parameter))

    @property
    def parameters(self) -> ParameterSpace:
        """Parameters of the problem."""
        return self._problem.parameters

    @property
    def problem_digest(self) -> str:
        """Hexadecimal fingerprint of the problem of these answers."""
        return self._fingerprint.hex()

    def query_at(self, point: np.ndarray) -> list[float | str]:
        """Query of a point.

        Returns:
            Its values, and those of non-affine amplitudes and of laws with formulas there.
        """
        nonaffine = [amplitude(point) for amplitude in self._problem.amplitudes.nonaffine]
        numbers = [float(value) for pair in nonaffine for values in pair for value in values]
        return [*point.tolist(), *numbers, *self.laws.query(point)]

    def load_query(self, point: np.ndarray, query: Query, forces: float = 0.0) -> Answer | None:
        """Answer to a query, checked; None if it is not there.

        Args:
            point: parameter, (P,).
            query: the query.
            forces: see :meth:`StoredLaws.residual`.
        """
        with self._damage_reported(point, query):
            answer = self._read(point, query)
            if answer is not None:
                self._judge(answer, query, forces)
            return answer
        return None

    @contextmanager
    def _damage_reported(
        self, point: np.ndarray, query: Query, aloud: bool = True
    ) -> Iterator[None]:
        """Warn of a file without a valid answer instead of raising.

        The program continues after the block.
        """
        try:
            yield
        except FileContentError as error:
            message = (
                f"{error}: {self._path(query).name} at {point.tolist()} is solved anew and replaced"
            )
            if aloud:
                warn(message, SnapshotFileWarning)

    def _read(self, point: np.ndarray, query: Query) -> Answer | None:
        path = self._path(query)
        try:
            header, arrays = read_arrays(path, SNAPSHOT_FORMAT, SNAPSHOT_VERSION, mapped=True)
        except FileNotFoundError:
            return None
        if header != self._header(query):
            raise FileContentError(f"{path} belongs to another problem or parameter")
        check_layout(arrays, self._layout(), self._sizes)
        return self._answer(point, arrays)

    def _judge(self, answer: Answer, query: Query, forces: float = 0.0) -> None:
        """Raise FileContentError for an answer that is no solution, in spite of its checksum.

        Count solutions.
        """
        worst = self.laws.residual(answer, forces)
        if not worst <= SNAPSHOT_RESIDUAL:
            raise FileContentError(
                f"{self._path(query)} holds no solution, residuals of {worst:.1g}"
            )
        self.found += 1

    def save_query(self, answer: Answer, query: Query) -> None:
        """Store the answer to a query.

        Args:
            answer: the answer.
            query: the query.

        Raises:
            FileError: if its file cannot be written.
        """
        values = {name: getattr(answer, name) for name in _LAYOUT}
        values |= self.laws.arrays(answer)
        values |= self._law.stored(answer.memory)
        values |= {name: getattr(answer, name) for name in _PARTS if name in self._layout()}
        if np.isnan(
            answer.time_error
        ):  # without a tolerance there is none; files hold finite numbers
            values["time_error"] = NO_TIME_ERROR
        arrays = {name: np.asarray(values[name]) for name in self._layout()}
        check_layout(arrays, self._layout(), self._sizes)
        # one file in thousands: leftovers were cleared when the folder was opened
        write_arrays(self._path(query), self._header(query), arrays, tidy=False)

    def _layout(self) -> dict[str, tuple[str, ...]]:
        remembered = {**self.laws.layout, **self._law.layout}
        return _LAYOUT | remembered | (_PARTS if remembered else {})

    def _answer(self, point: np.ndarray, arrays: dict[str, np.ndarray]) -> Answer:
        memory = NO_MEMORY | self.laws.memory(arrays) | self._law.restored(arrays)
        iterations = 0
        steps: dict[str, Any] = {}
        if "ends" in arrays:
            iterations = int(arrays["iterations"])
            time_error = float(arrays["time_error"])
            steps = {
                "time_error": math.nan if time_error == NO_TIME_ERROR else time_error,
                "ends": tuple(arrays["ends"].tolist()),
            }
        unknown, multipliers, active = (arrays[name] for name in _LAYOUT)
        search = iterations, Status.CONVERGED, False, self._full
        return Answer(point, unknown, multipliers, active, *search, memory=memory, **steps)

    def _header(self, query: Query) -> dict[str, Json]:
        return {
            "format": SNAPSHOT_FORMAT,
            "version": SNAPSHOT_VERSION,
            "problem": self._fingerprint.hex(),
            "point": query,
        }

    def digest(self, query: Query) -> str:
        """Hexadecimal digest of the problem and a query, the name of its file."""
        return hashlib.sha256(self._fingerprint + repr(query).encode()).hexdigest()[:40]

    def _path(self, query: Query) -> Path:
        return self.folder / f"{self.digest(query)}.npz"


def _digest_of(full: FullModel) -> bytes:
    """Fingerprint of every bit of a problem and its laws.

    The version of the package that solves it enters too.

    The bounds of the parameters are left out: a wider box finds the solutions of a narrower one. So
    are non-affine amplitudes: each query has their values at its point. Formulas of laws enter
    here, since a step may be cut, and the answers of such laws enter the queries. Snapshots are
    solved again on a machine that assembles other last digits, or with another distribution of rows
    over ranks.
    """
    digest = hashlib.sha256(
        f"{SNAPSHOT_FORMAT} {SNAPSHOT_VERSION} of hhr_dolfinx {__version__}\0".encode()
    )
    problem: ContactProblem = full.problem
    problem.require_parts("a store of snapshots")
    excluded = "amplitudes parameters moduli reshaped kernel whole_contact law group".split()
    local = [] if problem.spread.all_here else ["stiffness_terms", "node_mass", "first"]
    included = (
        attribute.name for attribute in fields(problem) if attribute.name not in (*excluded, *local)
    )
    values = [value for name in included for value in parts_of(getattr(problem, name))]
    if local:  # rows of the large matrices, in the order of the ranks
        rows = hashlib.sha256()
        add_to(rows, [getattr(problem, name) for name in local])
        values += problem.group.gathered(rows.hexdigest())
    values += [problem.parameters.names, problem.amplitudes.constant, problem.amplitudes.slopes]
    values += [text for modulus in problem.moduli for text in (modulus.factor, modulus.rest)]
    values += [] if problem.reshaped is None else [problem.reshaped.described]
    values += problem.law.parts()
    values += stored_laws(full).fingerprint()
    add_to(digest, values)
    return digest.digest()
