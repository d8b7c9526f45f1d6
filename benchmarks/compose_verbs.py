"""Verbs on a composition of capabilities: each answers, and the answer is compared.

A verb is a function of a :class:`Case`. It returns the largest relative error, raises
:class:`Wrong` for an answer that is off by more than its tolerance, and lets errors of the package
through, which are refusals.
"""

from __future__ import annotations

import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import _demos  # noqa: F401 (before the parts of demos)
import compose_exports
import compose_toys
import numpy as np
from mpi4py import MPI

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import HHRError, NotOfferedError
from hhr_dolfinx.plugins.conformance.draft import (
    ChosenSwitch,
    Excluded,
    SceneDraft,
    composed,
    has_neutral,
    switches,
)
from hhr_dolfinx.timing import now as clock

EXACT = 1e-8
"""Largest error of what is exact but for round-off: a constant stiffness, files, pages."""
INTERPOLATED = 1e-4
"""The same of models whose stiffness is interpolated over parameters."""
REDUCED = 0.05
"""The same of hyper-reduced models, trained on some points or paths; 6e-3 seen."""
OF_LAWS = 0.25
"""The same of models of inelastic bodies, trained on a few paths; 0.13 seen."""
SLOPES = 1e-3
"""The same of gradients along paths, over differences; those of laws 3e-4."""
NEUTRAL = 1e-6
"""Change of answers by a capability whose value is neutral; 4e-7 seen, of laws in axisymmetry,
whose rule has fewer points for weights 1/r than that of elastic bodies. Others are round-off.
"""
PARTS_OF_ESTIMATE = {"bound": 1.0, "estimate": 2.0}
"""Most of an error over its estimate, by the kind of estimate; indicators promise nothing."""
STEPS = (3e-4, 3e-5, 3e-6, 1e-6)
"""Steps of differences over the range of a parameter: the first that meets no kink is taken. A
contact that opens is seen by its force, a point that yields by a change with the step."""
AGREE = SLOPES / 10
"""Change of differences by a shorter step up to which none is held to meet a kink: one that both
steps meet changes them by little, and is off by more than that."""
OUTPUTS = ("force", "sunk", "moved")
"""Outputs of all drafts."""
TIGHT = {
    "search": "tangent",
    "relative_stress": 1e-10,
    "relative_force": 1e-10,
    "floor_stress": 1e-8,
    "outside": "ignore",
}
"""Settings of histories whose errors are differences of answers."""
LOOSE = hhr.MarchSettings(outside="ignore")
Made = TypeVar("Made")


class Wrong(Exception):
    """An answer that is off by more than its tolerance."""


class Unknown(Exception):
    """Nothing to compare: no error is told, or the capability has no neutral value."""


class Row(NamedTuple):
    """How a verb of a composition ended.

    Attributes:
        capabilities: names of switches.
        verb: name of the verb.
        outcome: ``works``, ``refused``, ``excluded``, ``wrong``, ``crash``, ``time out``, or
            ``none`` if there is nothing to compare.
        reason: why, in the words of the error.
        place: function of the package that refused.
        error: largest relative error.
        neutral: largest relative change of answers by neutral values.
        seconds: time.
    """

    capabilities: tuple[str, ...]
    verb: str
    outcome: str
    reason: str = ""
    place: str = ""
    error: float | None = None
    neutral: float | None = None
    seconds: float = 0.0


class Reference(NamedTuple):
    """Answers of the full model along the path: forces, displacements and outputs of each step."""

    forces: list[np.ndarray]
    displacements: list[np.ndarray]
    outputs: list[dict[str, float]]


def answers_of(model: Any, path: list, **settings: Any) -> Reference:
    """Answers of a model along a path; displacements of models that have them."""
    history = model.march(path, hhr.MarchSettings(**settings)) if settings else model.march(path)
    answers = history.answers
    return Reference(
        [answer.forces() for answer in answers],
        [answer.displacement() for answer in answers],
        [dict(answer.outputs()) for answer in answers],
    )


def difference(found: Sequence[np.ndarray], expected: Sequence[np.ndarray]) -> float:
    """Largest difference of vectors over the largest of the expected; infinite for other shapes."""
    if [np.shape(one) for one in found] != [np.shape(one) for one in expected]:
        return float("inf")
    largest = max((float(np.linalg.norm(one)) for one in expected), default=0.0) or 1.0
    pairs = zip(found, expected, strict=True)
    errors = [float(np.linalg.norm(np.subtract(*pair))) for pair in pairs]
    return max(errors) / largest if np.isfinite(errors).all() else float("inf")


def rows_of(outputs: Sequence[dict[str, float]], names: Iterable[str]) -> list[np.ndarray]:
    """Columns of outputs, (T,) each, of which each has a size of its own."""
    return [np.array([one[name] for one in outputs]) for name in names]


def apart(found: Sequence[dict[str, float]], expected: Sequence[dict[str, float]]) -> float:
    """Largest difference of outputs, each over its largest value along the path."""
    names = sorted(set(found[0]) & set(expected[0]))
    pairs = zip(rows_of(found, names), rows_of(expected, names), strict=True)
    return max(difference([one], [other]) for one, other in pairs)


def require(error: float, tolerance: float, what: str) -> float:
    """The error.

    Raises:
        Wrong: if it exceeds the tolerance.
    """
    if not error <= tolerance:
        raise Wrong(f"{what}: off by {error:.2g}, where {tolerance:.2g} is allowed")
    return error


class Case:
    """A composition: its draft, and its models, each made once.

    Raises:
        Excluded: if the capabilities exclude each other.
        HHRError: if the scene is refused.
    """

    def __init__(self, names: Iterable[str], draft: SceneDraft | None = None):
        self.names = tuple(names)
        self.draft = composed(self.chosen()) if draft is None else draft
        self.scene = self.draft.scene()
        self.path = self.draft.path()
        self._kept: dict[str, Any] = {}

    def chosen(self, neutral: str = "") -> list[ChosenSwitch]:
        """Switches, one of them neutral."""
        known = switches()
        return [ChosenSwitch(name, known[name], name == neutral) for name in self.names]

    def _once(self, name: str, make: Callable[[], Made]) -> Made:
        """The value, or the error that making it raised."""
        if name not in self._kept:
            try:
                self._kept[name] = make()
            except Exception as error:
                self._kept[name] = error
        if isinstance(self._kept[name], Exception):
            raise self._kept[name]
        return self._kept[name]

    @property
    def full(self) -> Any:
        """The full model."""
        return self._once("full", lambda: self.draft.model(self.scene))

    @property
    def reference(self) -> Reference:
        """Answers of the full model along the path."""
        return self._once("reference", lambda: answers_of(self.full, self.path))

    @property
    def training(self) -> Any:
        """Training: points of the box, or paths where answers depend on them."""
        return self._once("training", self._trained)

    @property
    def condensed(self) -> Any:
        """The condensed model."""
        return self._once("condensed", self._condensed)

    @property
    def reduced(self) -> Any:
        """The hyper-reduced model."""
        return self._once("reduced", lambda: self.training.build())

    @cached_property
    def inelastic(self) -> bool:
        """True if a body has a law."""
        return bool(self.scene.reader)

    @cached_property
    def remembers(self) -> bool:
        """True if answers depend on the path."""
        if self.inelastic or self.draft.full is not None:
            return True
        laws = any(law is not None for law in self.scene.laws)
        return bool(laws and self.full.law.path_dependent)

    @cached_property
    def varies(self) -> bool:
        """True if the stiffness depends on parameters."""
        scene = self.scene
        other = scene.shapes or scene.system is not None
        return bool(other) or any(body.varies for body in scene.bodies)

    def _trained(self) -> Any:
        if self.draft.full is not None:
            raise NotOfferedError("a training is of usual full models: this one is made otherwise")
        if not (self.remembers or self.scene.remembers):  # laws are trained on paths in any case
            return hhr.train(self.scene, hhr.Sobol(24), held_out=6, comm=MPI.COMM_SELF)
        constant = any(not isinstance(one.values, tuple) for one in self.draft.varied)
        ways = [(1.06, 0.25), (0.75, 0.8), (0.9, 0.5)]
        if (
            not self.inelastic
        ):  # forces of three paths of friction do not span those of others: 0.06 off, with six 4e-3
            ways += [(1.0, 0.1), (0.8, 0.4), (0.65, 0.6)]
        ways += [(0.95, 0.02), (0.95, 0.98), (0.9, 0.35), (0.9, 0.65)] if constant else []
        paths = [self.draft.path(*way) for way in ways]
        return hhr.train(self.scene, paths, held_out=[self.draft.path(0.85)], comm=MPI.COMM_SELF)

    def _condensed(self) -> Any:
        if self.draft.condensed is not None:
            return self.draft.condensed(self.scene)
        return self.training.condense() if self.inelastic else hhr.condense(self.full, fields=True)

    def small(self) -> dict[str, Any]:
        """Condensed and hyper-reduced models that can be made; the error of the first if none."""
        found, errors = {}, []
        for name in ("condensed", "reduced"):
            try:
                found[name] = getattr(self, name)
            except HHRError as error:
                errors.append(error)
        if not found:
            raise errors[0]
        return found

    def tolerance(self, name: str) -> float:
        """Largest error of the forces of a small model."""
        if self.inelastic:
            return OF_LAWS
        return REDUCED if name == "reduced" else INTERPOLATED if self.varies else EXACT


# ---------------------------------------------------------------- verbs


def full(case: Case) -> float:
    """Answers are finite; without memory no force pulls, and each is that of its point alone."""
    reference = case.reference
    if not all(np.isfinite(list(one.values())).all() for one in reference.outputs):
        raise Wrong("outputs are not finite")
    if case.remembers:
        return 0.0
    alone = case.full.solve(case.path[-1][1])
    error = difference([alone.forces()], reference.forces[-1:])
    error = max(error, difference([alone.displacement()], reference.displacements[-1:]))
    pulled = [np.minimum(one, 0.0) for one in reference.forces]
    size = max(float(np.linalg.norm(one)) for one in reference.forces) or 1.0
    require(max(float(np.linalg.norm(one)) for one in pulled) / size, EXACT, "forces that pull")
    return require(error, EXACT, "an answer alone")


def many(case: Case) -> float:
    """Answers to two points at once, beside those of the path where these do not depend on it."""
    points = np.array([point for _, point in case.path[1:3]])
    found = case.full.solve_many(points).outputs()
    if case.remembers:
        alone = [dict(case.full.solve(point).outputs()) for point in points]
    else:
        alone = case.reference.outputs[:2]
    together = [{name: values[k] for name, values in found.items()} for k in range(2)]
    return require(apart(together, alone), INTERPOLATED if case.inelastic else EXACT, "many points")


def gradient(case: Case) -> float:
    """Derivatives of outputs along the path, beside differences."""
    history = case.full.march(case.path, hhr.MarchSettings(gradient=True, **TIGHT))
    outputs = history.answers[-1].outputs()
    lower, upper = np.array(case.full.parameters.lower), np.array(case.full.parameters.upper)
    found = [np.asarray(outputs.gradient[name]) * (upper - lower) for name in OUTPUTS]
    expected = differences(case, contact_of(history.answers), np.diag(upper - lower))
    error = max(difference([one], [other]) for one, other in zip(found, expected, strict=True))
    if error > SLOPES and getattr(outputs, "one_sided", False):
        raise Unknown(f"derivatives are told to be one-sided; differences are {error:.2g} off")
    return require(error, SLOPES, "derivatives of outputs")


def contact_of(answers: Sequence[Any]) -> np.ndarray:
    """Statuses along a path, (T, m): signs of all forces."""
    return np.array([np.sign(answer.forces()) for answer in answers])


def differences(case: Case, closed: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """Derivatives of outputs, (outputs, P), times ranges, (P, P) diagonal, by a step that meets no
    kink.

    Raises:
        Unknown: if contacts open or close, or points yield, within the smallest steps.
    """
    before: np.ndarray | None = None
    for step in STEPS:
        columns = [slopes(case, closed, width, step) for width in widths]
        if any(column is None for column in columns):
            continue
        found = np.transpose(columns)
        if before is not None:
            pairs = zip(found, before, strict=True)
            if max(difference([one], [other]) for one, other in pairs) <= AGREE:
                return found
        before = found
    raise Unknown("contacts open or close, or points yield, within the step of differences")


def slopes(case: Case, closed: np.ndarray, width: np.ndarray, step: float) -> np.ndarray | None:
    """Derivatives of outputs along a range, (P,), times that range.

    None if a contact opens or closes.
    """
    ends = []
    for sign in (1.0, -1.0):
        moved = [(time, point + sign * step * width) for time, point in case.path]
        ends.append(case.full.march(moved, hhr.MarchSettings(**TIGHT)).answers)
    if not all(np.array_equal(contact_of(one), closed) for one in ends):
        return None
    values = [[one[-1].outputs()[name] for name in OUTPUTS] for one in ends]
    return np.subtract(*values) / (2 * step)


def _model(name: str) -> Callable[[Case], float]:
    def verb(case: Case) -> float:
        """Answers of a small model along the path, beside those of the full one."""
        model = getattr(case, name)
        found = answers_of(model, case.path, outside="ignore")
        tolerance = case.tolerance(name)
        forces = require(difference(found.forces, case.reference.forces), tolerance, "forces")
        outputs = require(apart(found.outputs, case.reference.outputs), tolerance * 10, "outputs")
        moved = difference(found.displacements, case.reference.displacements)
        return max(forces, outputs, require(moved, tolerance * 10, "displacements"))

    return verb


def file(case: Case) -> float:
    """Answers of small models that were saved and loaded."""
    worst = 0.0
    for name, model in case.small().items():
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "model.npz"
            hhr.save_model(path, model)
            kept = hhr.load_model(path)
            found = answers_of(kept, case.path, outside="ignore")
        expected = answers_of(model, case.path, outside="ignore")
        error = difference(found.forces, expected.forces)
        error = max(error, apart(found.outputs, expected.outputs))
        worst = max(worst, require(error, EXACT, f"the {name} model of a file"))
    return worst


def estimate(case: Case) -> float:
    """What small models tell of their errors covers the errors measured; the largest part of it."""
    parts, silent = [], []
    for name, model in case.small().items():
        history = model.march(case.path, LOOSE)
        size = max(float(np.linalg.norm(one)) for one in case.reference.forces)
        for answer, exact in zip(history.answers, case.reference.forces, strict=True):
            told = answer.estimate()
            known = told is not None and told.kind in PARTS_OF_ESTIMATE
            if not known or not np.isfinite(told.forces_euclid):
                silent.append(name)
                continue
            error = float(np.linalg.norm(answer.forces() - exact))
            part = max(error - EXACT * size, 0.0) / max(told.forces_euclid, 1e-300)
            allowed = PARTS_OF_ESTIMATE[told.kind]
            parts.append(require(part, allowed, f"error over the {told.kind} of the {name} model"))
    if not parts:
        models = " and ".join(dict.fromkeys(silent))
        raise Unknown(f"no bound or estimate of forces of {models} models")
    return max(parts)


def page(case: Case) -> float:
    """Answers of a page in node."""
    found, expected = compose_exports.page(case.condensed, case.full, case.path, case.remembers)
    return require(difference(found, expected), 10 * EXACT, "forces of the page")


def embed(case: Case) -> float:
    """Answers of a C header that was compiled."""
    found, expected = compose_exports.header(case.condensed, case.path, case.remembers)
    return require(difference(found, expected), 10 * EXACT, "forces of the C header")


def neutral(case: Case) -> float:
    """Largest change of outputs by a neutral value, beside the scene without the capability."""
    known, changes = switches(), []
    for name in case.names:
        if not has_neutral(known[name]):
            continue
        try:
            changes.append(_changed(case, name))
        except Excluded:
            continue  # the neutral scene has cells that exclude another capability
        except HHRError:
            if composed(case.chosen(name)).kind == case.draft.kind:
                raise
    if not changes:
        raise Unknown("no capability has a neutral value here")
    error, name = max(changes)
    if not error <= NEUTRAL:
        raise Wrong(f"neutral {name} changes the answer by {error:.2g}")
    return error


def _changed(case: Case, name: str) -> tuple[float, str]:
    """Change of outputs by a neutral value; the scene without it has the same kind.

    The neutral capability comes last, to a place that the others leave: a law of the first body
    that has none would else move that of another capability to the second body.
    """
    rest = [one for one in case.chosen() if one.name != name]
    with_it = composed([*rest, *(one for one in case.chosen(name) if one.name == name)])
    without = composed(rest, SceneDraft(kind=with_it.kind))
    settings = TIGHT if case.inelastic else {}
    found, expected = (outputs_of(draft, **settings) for draft in (with_it, without))
    if any(body.grading is not None for body in case.scene.bodies) and case.inelastic:
        # where laws are evaluated the grading is another one than in the middle of a cell
        found = [{key: value for key, value in one.items() if key != "mises"} for one in found]
    return apart(found, expected), name


def outputs_of(draft: SceneDraft, **settings: Any) -> list[dict[str, float]]:
    """Outputs of the full model of a draft along its path."""
    return answers_of(draft.model(draft.scene()), draft.path(), **settings).outputs


VERBS: dict[str, Callable[[Case], float]] = {
    "full": full,
    "many": many,
    "gradient": gradient,
    "condense": _model("condensed"),
    "HHR": _model("reduced"),
    "file": file,
    "estimate": estimate,
    "page": page,
    "C": embed,
    "neutral": neutral,
}
"""All verbs by name."""


# ---------------------------------------------------------------- rows


def place_of(error: BaseException) -> str:
    """The innermost function of the package that an error came through."""
    frames = traceback.extract_tb(error.__traceback__)
    inside = [one for one in frames if "/hhr_dolfinx/" in one.filename]
    if not inside:
        return ""
    return f"{inside[-1].filename.rpartition('/hhr_dolfinx/')[2]}:{inside[-1].name}"


def ended(names: tuple[str, ...], verb: str, run: Callable[[], float]) -> Row:
    """The row of a verb."""
    try:
        error = run()
    except Excluded as reason:
        return Row(names, verb, "excluded", str(reason))
    except Unknown as reason:
        return Row(names, verb, "none", str(reason))
    except Wrong as reason:
        return Row(names, verb, "wrong", str(reason))
    except HHRError as reason:
        return Row(names, verb, "refused", f"{reason}", place_of(reason) or "benchmarks")
    except Exception as reason:  # what else comes is the finding
        return Row(names, verb, "crash", f"{type(reason).__name__}: {reason}", place_of(reason))
    measured = {"neutral": error} if verb == "neutral" else {"error": error}
    return Row(names, verb, "works", **measured)


def tried(names: Iterable[str], verbs: Iterable[str]) -> Iterator[Row]:
    """Rows of all verbs of a composition; a scene that is refused ends all of them alike."""
    own = tuple(names)
    case: Case | None = None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for verb in verbs:
            begin = clock()

            def run(verb: str = verb) -> float:
                nonlocal case
                if case is None:
                    case = Case(own)
                if verb != "full":
                    _ = case.reference  # what the full model refuses no other verb does
                return VERBS[verb](case)

            row = ended(own, verb, run)
            yield row._replace(seconds=round(clock() - begin, 2))


def in_a_child(connection: Any, names: tuple[str, ...], verbs: tuple[str, ...]) -> None:
    """Send the rows of a composition through a pipe: what a child process runs."""
    with compose_toys.registered():
        for row in tried(names, verbs):
            connection.send(row)
    connection.close()
