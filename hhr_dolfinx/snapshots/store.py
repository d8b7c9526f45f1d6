"""Snapshots on disk: one plain file per answer, at a parameter or a step of a history, so that nothing is solved twice.

A file is named by a fingerprint of the problem and of the question, and says both inside; a run that was killed leaves
only whole files. Files of another problem are never read. A step of a history is asked for by the whole path up to it
and by how it is solved: an interrupted history goes on behind its last file.
"""

from __future__ import annotations

import dis
import hashlib
import math
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import astuple, fields, is_dataclass, replace
from functools import cached_property, partial
from itertools import product
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, MemberDescriptorType, MethodType, ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import issparse

from hhr_dolfinx.certify.accuracy import contact_residuals, slack_residuals
from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import FileContentError, SnapshotFileWarning, StudyError
from hhr_dolfinx.files import MAPPED, check_layout, clear_leftovers, make_folder, read_arrays, write_arrays
from hhr_dolfinx.materials.elasticity import lame_parameters
from hhr_dolfinx.models.answer import Answer, GaussState, History
from hhr_dolfinx.models.answer import Path as History_path
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.models.histories.path import checked_path
from hhr_dolfinx.version import __version__
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    from hhr_dolfinx.materials.update import Group


DEEPEST = 50
"""Values within each other: what goes deeper holds itself."""


def add_to(digest: Any, parts: list[Any]) -> None:
    """Tell a digest of arrays, sparse or not, numbers and texts, and of lists of these, to the last bit."""
    for part in parts:
        for item in part if isinstance(part, tuple | list) else (part,):
            for array in _arrays(item):
                digest.update(f"{array.dtype.str}{array.shape}".encode() + array.tobytes())


def digest_of_values(value: Any, what: str) -> str:
    """A digest of settings, hexadecimal: of their types, numbers, texts, arrays and functions, not of their ``repr``.

    That of an array leaves out what is in its middle, and that of an object may be its address. Functions and classes
    of a user's own count with the globals that they read and with their class attributes; those of installed packages
    count with their names.

    Args:
        value: numbers, texts, arrays, functions, types, and dataclasses, collections and objects that hold such.
        what: the value in words, for the message.

    Raises:
        StudyError: for an object whose values cannot be told.
    """
    digest = hashlib.sha256()
    for piece in _pieces(value, what, 0, {}):
        digest.update(len(piece).to_bytes(8, "little") + piece)
    return digest.hexdigest()


def _arrays(item: Any) -> tuple[np.ndarray, ...]:
    return (item.indptr, item.indices, item.data) if issparse(item) else (np.ascontiguousarray(item),)


def _pieces(value: Any, what: str, depth: int, seen: dict[int, int]) -> Iterator[bytes]:
    """Bytes that stand for a value and for no other one; functions and classes seen before count with their number."""
    if depth > DEEPEST:
        raise StudyError(f"{what} holds values more than {DEEPEST} deep, or itself: no digest can be made of it")
    kind = type(value)
    yield f"{kind.__module__}.{kind.__qualname__}".encode()
    if value is None or isinstance(value, bool | int | float | complex | str | bytes):
        yield repr(value).encode()
        return
    if isinstance(value, FunctionType | type):
        if id(value) in seen:
            yield f"again {seen[id(value)]}".encode()
            return
        seen[id(value)] = len(seen)
    for part in _values_of(value, what):
        if isinstance(part, np.ndarray) and part.dtype != object:
            yield f"{part.dtype.str}{part.shape}".encode() + np.ascontiguousarray(part).tobytes()
        else:
            yield from _pieces(part, what, depth + 1, seen)
    yield b"end"


def _values_of(value: Any, what: str) -> list[Any]:
    """What a value that is no number or text is made of."""
    if issparse(value):
        return [value.shape, *_arrays(value.tocsr())]
    if isinstance(value, np.ndarray | np.generic):
        array = np.asarray(value)
        return [array] if array.dtype != object else array.tolist()
    if isinstance(value, Mapping):
        return [item for key in sorted(value, key=repr) for item in (key, value[key])]
    if isinstance(value, set | frozenset):
        return sorted(digest_of_values(item, what) for item in value)
    if isinstance(value, list | tuple):
        return list(value)
    if isinstance(value, BuiltinFunctionType | np.ufunc):
        return [getattr(value, "__module__", ""), getattr(value, "__qualname__", value.__name__)]
    if isinstance(value, MethodType):
        return [value.__func__, value.__self__]
    if isinstance(value, FunctionType):
        return _values_of_function(value)
    if isinstance(value, CodeType):
        return [value.co_code, value.co_consts, value.co_names]
    if isinstance(value, partial):
        return [value.func, value.args, value.keywords]
    if isinstance(value, ModuleType):
        return [value.__name__]
    if isinstance(value, type):
        return [value.__module__, value.__qualname__, *_class_attributes(value)]
    if is_dataclass(value):
        return [type(value), *((item.name, getattr(value, item.name)) for item in fields(value))]
    if hasattr(value, "__dict__"):
        return [type(value), vars(value)]
    raise StudyError(
        f"{what} holds {value!r}, of which no digest can be made that is the same in another run: write it as a frozen "
        "dataclass of numbers, texts and arrays"
    )


def _installed(module: str) -> bool:
    """Whether a module is of Python, of this package or of another one that is installed: its code is not a user's."""
    first = module.partition(".")[0]
    file = getattr(sys.modules.get(first), "__file__", None) or ""
    if first in sys.stdlib_module_names or first == __name__.partition(".")[0]:
        return True
    return bool({"site-packages", "dist-packages"} & set(Path(file).parts))


def _values_of_function(function: FunctionType) -> list[Any]:
    """Code, defaults, closure and, of a user's own function, the globals that its code reads."""
    held = [cell.cell_contents for cell in function.__closure__ or ()]
    names = [function.__module__, function.__qualname__]
    known = [*names, function.__code__, function.__defaults__, function.__kwdefaults__, held]
    if _installed(function.__module__ or ""):
        return known
    found: dict[str, Any] = {}
    for code in _codes(function.__code__):
        for name in {step.argval for step in dis.get_instructions(code) if step.opname == "LOAD_GLOBAL"}:
            if name not in function.__globals__:
                continue  # of Python itself
            item = found[name] = function.__globals__[name]
            if isinstance(item, ModuleType) and not _installed(item.__name__):
                found |= {f"{name}.{part}": vars(item)[part] for part in code.co_names if part in vars(item)}
    return [*known, found]


def _codes(code: CodeType) -> Iterator[CodeType]:
    """A code and those of functions that are made in it."""
    yield code
    for part in code.co_consts:
        if isinstance(part, CodeType):
            yield from _codes(part)


def _class_attributes(kind: type) -> list[Any]:
    """Attributes and methods of a user's own class and of its own bases, without what Python writes itself."""
    found: list[Any] = []
    for base in kind.__mro__:
        if _installed(base.__module__):
            continue
        for name, item in vars(base).items():
            if isinstance(item, staticmethod | classmethod):
                item = item.__func__
            elif isinstance(item, property | cached_property):
                item = item.fget if isinstance(item, property) else item.func
            written = isinstance(item, FunctionType) and item.__code__.co_filename != "<string>"
            plain = not name.startswith("__") and name != "_abc_impl" and not isinstance(item, FunctionType)
            if written or (plain and not isinstance(item, MemberDescriptorType)):  # those of __slots__
                found.append((name, item))
    return found


FORMAT = "hhr_dolfinx snapshot"
VERSION = 6

_LAYOUT: dict[str, tuple[str, ...]] = {
    "unknown": ("float", "N"),
    "multipliers": ("float", "N_lambda"),
    "active": ("bool", "N_lambda"),
}
_GAUSS: dict[str, tuple[str, ...]] = {
    "stress": ("float", "points", "components"),
    "plastic": ("float", "points", "components"),
    "cumulated": ("float", "points"),
    "iterations": ("int",),
    "ends": ("float", "ends"),
    "time_error": ("float",),
}
"""What a step of bodies that flow has besides."""
_PARTS: dict[str, tuple[str, ...]] = {name: _GAUSS[name] for name in ("iterations", "ends", "time_error")}
_SLIP: dict[str, tuple[str, ...]] = {
    "position": ("float", "tangential"),
    **{name: ("float", "frictional") for name in ("path", "work", "wear", "pressure", "bound")},
    "statuses": ("int", "frictional"),
}
"""What a step with friction has besides."""

UNKNOWN = -1.0
"""Time error of a step of which none was estimated."""
SOLVED = 1e-2
"""Largest relative residual of a solution: round-off reaches 1e-4 where bodies are carried by 1e8 times their size."""


class SnapshotStore:
    """Full-order answers of one problem in a folder.

    Args:
        folder: where the files are; made if missing. Several problems and processes may share it.
        full: the full model whose answers are kept. Any change of its problem or of its laws gives other files, but for
            the bounds of its parameters, on which no answer depends. Ranks that have a model together make a store
            together, of which one reads and writes.

    Attributes:
        found: number of answers that were there when asked for.

    Raises:
        FileError: if the folder cannot be made.
    """

    def __init__(self, folder: str | Path, full: Any):
        self._full = full
        self._problem = full.problem
        self._fingerprint = _digest_of(full)  # together, before any rank may fail by itself
        self._folder = make_folder(folder)
        clear_leftovers(self._folder)
        self._behaviours: dict[tuple, str] = {}
        conditions, dofs = self._problem.contact.shape
        self._sizes = {"N": dofs, "N_lambda": conditions}
        friction = self._problem.friction
        if friction is not None:
            self._sizes |= {"tangential": friction.tangential.size, "frictional": friction.normal.size}
        if full.equilibrium is not None:
            material = full.equilibrium.material
            self._sizes |= {"points": material.gauss_points, "components": material.components}
        self.found = 0

    def load(self, point: np.ndarray) -> Answer | None:
        """The answer kept at a parameter, or None if there is none or its file is damaged, which is warned of."""
        point = np.array(point, dtype=float, ndmin=1)
        return self._load(point, self._asked(point))

    def read(self, point: np.ndarray) -> Answer | None:
        """The same, of which nobody has looked yet whether it is a solution."""
        point = np.array(point, dtype=float, ndmin=1)
        question = self._asked(point)
        with self._damaged_told(point, question):
            return self._read(point, question)
        return None

    def judged(self, answer: Answer, *, aloud: bool = True) -> Answer | None:
        """An answer that was read, if it is a solution; ranks that share the rows ask together, and one warns aloud."""
        question = self._asked(answer.parameter)
        with self._damaged_told(answer.parameter, question, aloud):
            self._judge(answer, question)
            return answer
        return None

    def save(self, answer: Answer) -> None:
        """Keep the answer at a parameter.

        Raises:
            FileError: if its file cannot be written.
        """
        self._save(answer, self._asked(answer.parameter))

    @property
    def folder(self) -> Path:
        """Where the files are."""
        return self._folder

    @property
    def problem_digest(self) -> str:
        """What tells the problem of these answers from all others, hexadecimal."""
        return self._fingerprint.hex()

    def steps(self, path: History_path, settings: MarchSettings) -> KeptSteps:
        """What is kept of a history."""
        return KeptSteps(self, checked_path(self._problem.parameters, path), settings)

    def _asked(self, point: np.ndarray) -> list[Any]:
        """A point, and what amplitudes that are not affine and laws with formulas are there."""
        driven = [amplitude(point) for amplitude in self._problem.amplitudes.nonaffine]
        numbers = [float(item) for pair in driven for part in pair for item in part]
        return [*point.tolist(), *numbers, *self._laws_at(point)]

    def _laws_at(self, point: np.ndarray) -> list[str]:
        """A digest of what each body with formulas answers with its constants at a point, and of its modulus there."""
        if self._full.equilibrium is None:
            return []
        material = self._full.equilibrium.material
        digests = []
        for place, constants in enumerate(material.constants(point)):
            if constants:
                key = place, *constants.values()
                if key not in self._behaviours:
                    digest = hashlib.sha256()
                    add_to(digest, [list(constants.values()), *_answers_of(material.at(point).groups[place])])
                    self._behaviours[key] = digest.hexdigest()
                digests.append(self._behaviours[key])
        return digests

    def _load(self, point: np.ndarray, question: list, forces: float = 0.0) -> Answer | None:
        """The answer to a question, see :meth:`_residual`."""
        with self._damaged_told(point, question):
            answer = self._read(point, question)
            if answer is not None:
                self._judge(answer, question, forces)
            return answer
        return None

    @contextmanager
    def _damaged_told(self, point: np.ndarray, question: list, aloud: bool = True) -> Iterator[None]:
        """Warn of a file that holds no answer, and go on behind the block."""
        try:
            yield
        except FileContentError as error:
            message = f"{error}: {self._path(question).name} at {point.tolist()} is solved anew and replaced"
            if aloud:
                warn(message, SnapshotFileWarning, stacklevel=5)

    def _read(self, point: np.ndarray, question: list) -> Answer | None:
        """What a file holds; None if there is none."""
        path = self._path(question)
        try:
            header, arrays = read_arrays(path, FORMAT, VERSION, mapped=True)
        except FileNotFoundError:
            return None
        if header != self._header(question):
            raise FileContentError(f"{path} belongs to another problem or parameter")
        check_layout(arrays, self._layout(), self._sizes)
        return self._answer(point, arrays)

    def _judge(self, answer: Answer, question: list, forces: float = 0.0) -> None:
        """Raise FileContentError for what is no solution, see :meth:`_residual`; count what is one."""
        worst = self._residual(answer, forces)
        if not worst <= SOLVED:
            raise FileContentError(f"{self._path(question)} holds no solution, residuals of {worst:.1g}")
        self.found += 1

    def _save(self, answer: Answer, question: list) -> None:
        values = {name: getattr(answer, name) for name in _LAYOUT}
        if answer.gauss is not None:
            values |= {"stress": answer.gauss.stress, **answer.gauss.state._asdict()}
        values |= {} if answer.slip is None else answer.slip._asdict()
        values |= {name: getattr(answer, name) for name in _PARTS if name in self._layout()}
        if np.isnan(answer.time_error):  # of friction without a tolerance; files hold numbers
            values["time_error"] = UNKNOWN
        arrays = {name: np.asarray(values[name]) for name in self._layout()}
        check_layout(arrays, self._layout(), self._sizes)
        # one file in thousands: leftovers were cleared when the folder was opened
        write_arrays(self._path(question), self._header(question), arrays, tidy=False)

    def _layout(self) -> dict[str, tuple[str, ...]]:
        layout = _LAYOUT if self._full.equilibrium is None else _LAYOUT | _GAUSS
        return layout if self._problem.friction is None else layout | _PARTS | _SLIP

    def _answer(self, point: np.ndarray, arrays: dict[str, np.ndarray]) -> Answer:
        gauss = None
        slip = None
        iterations = 0
        steps: dict[str, Any] = {}
        if "stress" in arrays:
            state = self._full.equilibrium.material.at_rest()
            state = state._replace(plastic=arrays["plastic"], cumulated=arrays["cumulated"])
            gauss = GaussState(arrays["stress"], state)
        if "position" in arrays:
            from hhr_dolfinx.contact.friction import SlipState

            slip = SlipState(**{name: arrays[name] for name in _SLIP})
        if "ends" in arrays:
            iterations = int(arrays["iterations"])
            known = float(arrays["time_error"])
            steps = {"time_error": math.nan if known == UNKNOWN else known, "ends": tuple(arrays["ends"].tolist())}
        unknown, multipliers, active = (arrays[name] for name in _LAYOUT)
        how = iterations, Status.CONVERGED, False, self._full
        return Answer(point, unknown, multipliers, active, *how, gauss=gauss, slip=slip, **steps)

    def _residual(self, answer: Answer, forces: float) -> float:
        """Largest relative residual of an answer, whatever the checksum of its file says.

        Args:
            answer: to be judged.
            forces: norm of the forces at steps before, beside which those of unloaded bodies are measured.
        """
        theta = self._problem.amplitudes(answer.parameter)
        if answer.gauss is None:
            problem = self._problem.at(answer.parameter)
            return max(astuple(contact_residuals(problem, answer.displacement(), answer.forces(), theta)))
        signs = self._full.equilibrium.signs(answer)
        _, pull = slack_residuals(self._problem, answer.unknown, answer.multipliers, theta)
        return max(pull, signs.imbalance / (max(signs.size, forces) or 1.0))

    def _header(self, question: list) -> dict:
        return {"format": FORMAT, "version": VERSION, "problem": self._fingerprint.hex(), "point": question}

    def _digest(self, question: list) -> str:
        return hashlib.sha256(self._fingerprint + repr(question).encode()).hexdigest()[:40]

    def _path(self, question: list) -> Path:
        return self._folder / f"{self._digest(question)}.npz"


class KeptSteps:
    """The steps of one history in a store.

    Args:
        store: where they are.
        path: checked times and parameters.
        settings: how the history is solved.
    """

    def __init__(self, store: SnapshotStore, path: History_path, settings: MarchSettings):
        self._store = store
        self._path = path
        how = [getattr(settings, name) for name in settings.__dataclass_fields__ if name not in ("outside", "gradient")]
        question = [item if item is None or isinstance(item, str) else float(item) for item in how]
        self._questions: list[list] = []
        for time, point in path:
            # each asks for the one before by its digest: with the whole path in each, files would grow along it
            question = [store._digest(question), time, *store._asked(point)]
            self._questions.append(question)
        self._count = 0

    def load(self) -> list[Answer]:
        """Answers to the first steps, up to the first that is not there."""
        answers = []
        forces = 0.0
        equilibrium = self._store._full.equilibrium
        for (time, point), question in zip(self._path[1:], self._questions[1:], strict=True):
            answer = self._store._load(point, question, forces)
            if answer is None:
                break
            answers.append(answer._replace(time=time))
            forces = 0.0 if equilibrium is None else max(forces, equilibrium.signs(answer).size)
        self._count = len(answers)
        return answers

    def on_disk(self, history: History) -> History:
        """A history all of whose steps are kept; large ones are left on the disk and give their memory back."""
        gauss = history.answers[-1].gauss if history.answers else None
        if gauss is None or gauss.stress.nbytes < MAPPED:
            return history
        found = self._store.found
        answers = self.load()
        self._store.found = found
        return replace(history, answers=answers) if len(answers) == len(history.answers) else history

    def save(self, answer: Answer) -> None:
        """Keep the next step.

        Raises:
            FileError: if its file cannot be written.
        """
        self._count += 1
        self._store._save(answer, self._questions[self._count])


def _digest_of(full: Any) -> bytes:
    """Fingerprint of every bit of a problem and of its laws, and of the version of the package that solves it.

    The bounds of the parameters are left out: a wider box finds the solutions of the narrower one. Amplitudes that are
    not affine are left out too: each question holds what they are at its point. Of laws with formulas these stand here,
    since a step may be cut, and what such a law answers in the questions. Rigid motions follow from the rest. Where a
    machine assembles other last digits, snapshots are solved anew, and so where other ranks have other rows.
    """
    digest = hashlib.sha256(f"{FORMAT} {VERSION} of hhr_dolfinx {__version__}\0".encode())
    problem: ContactProblem = full.problem
    problem.require_parts("a store of snapshots")
    others = "amplitudes parameters moduli reshaped rigid resting pins loose whole_contact friction comm".split()
    others += [] if problem.comm is None else ["stiffness_terms", "node_mass", "first"]  # the same on all ranks
    parts = [getattr(problem, item.name) for item in fields(problem) if item.name not in others]
    parts += [] if problem.comm is None else _digests_of_rows(problem)
    parts += [problem.parameters.names, problem.amplitudes.constant, problem.amplitudes.slopes]
    parts += [text for modulus in problem.moduli for text in (modulus.factor, modulus.rest)]
    parts += [] if problem.reshaped is None else [problem.reshaped.described]
    if problem.friction is not None:
        friction = problem.friction
        scalars = [scalar for law in friction.laws for scalar in (law.coefficient, law.limit)]
        parts += ["" if scalar is None else scalar.text for scalar in scalars]
        parts += [friction.normal, friction.area, friction.law, friction.tangential, friction.owner, friction.tangents]
        parts += [friction.fixed, friction.twice]
    groups = () if full.equilibrium is None else full.equilibrium.material.groups
    parts += [part for group in groups for part in (group.indices, group.young, group.poisson, _answers_of(group))]
    if full.equilibrium is not None and full.equilibrium.eigenstrains.nnz:
        parts.append(full.equilibrium.eigenstrains)
    add_to(digest, parts)
    return digest.digest()


def _digests_of_rows(problem: ContactProblem) -> list[str]:
    """Digests of the rows that each rank has of the large matrices, in the order of the ranks. Collective."""
    assert problem.comm is not None
    own = hashlib.sha256()
    add_to(own, [problem.stiffness_terms, problem.node_mass, problem.first])
    return problem.comm.allgather(own.hexdigest())


def _answers_of(group: Group) -> list[Any]:
    """What the law of a body answers under fixed stresses: what counts is what it does, whatever its code says."""
    if group.law is None:
        return []
    from hhr_dolfinx.materials.constants import formulas_of

    formulas = formulas_of(group.law)
    if formulas or isinstance(group.young, str):  # without numbers it answers nothing
        return [text for pair in formulas.items() for text in pair]
    _, shear = lame_parameters(group.young, group.poisson)
    trial = group.young * np.logspace(-8, 0, 201)
    found: list[Any] = []
    for strain, dt in product((0.0, 1e-3, 0.1, 1.0), (1e-3, 1.0, 1e3)):
        try:
            found += [np.asarray(part, float) for part in group.law.flow(trial.copy(), 0 * trial + strain, shear, dt)]
        except Exception as error:  # that there is no flow says something too
            found.append(type(error).__name__)
    return found
