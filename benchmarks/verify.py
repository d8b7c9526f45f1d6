"""Right, refused with the reason, warned of, or wrong without a word: what a scene does under
extreme conditions.

The full order is checked against an independent solver (a saddle-point matrix factored anew for
each set of statuses), against itself from other statuses and against the contact conditions, each
pair by the forces of its own bodies; where an answer is known, against that; the reduced model
against the full order at random parameters. Where bodies flow, two search operators must find the
same history, and the reduced one must follow it.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.sparse.csgraph import connected_components

from hhr_dolfinx import errors
from hhr_dolfinx.certify.accuracy import contact_residuals, force_floor, relative_error
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.models.answer import History, Model, Path
from hhr_dolfinx.models.histories.equilibrium import MarchSettings, told_once
from hhr_dolfinx.reduction.build import build
from hhr_dolfinx.reduction.recipe import Recipe
from hhr_dolfinx.reduction.reductor import Reductor
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.snapshots.records import SnapshotSet, compute_snapshots

FULL_TOLERANCE = 1e-6
"""Two exact solvers differ by round-off times cond(K), which reaches 1e10 in extreme cases."""
REDUCED_WORST = {"primal_l2": 0.05, "dual_full_floored": 0.3}
"""At the worst point, on the whole mesh.

Forces of neighbouring nodes change places where contact grazes.
"""
REDUCED_P95 = {"primal_l2": 0.02, "dual_full_floored": 0.1}
"""At 95 % of the points."""
HISTORY_TOLERANCE = 2e-3
"""Two searches stop at residuals of 1e-5.

Where a body is near its limit load the displacement moves 100 times that.
"""
HISTORY_WORST = {"displacement": 0.05, "forces": 0.2}
"""Largest errors over the largest size in the history.

Two training histories of 20 steps on a coarse mesh.
"""


FINER = (1, 2, 4, 8)
"""Parts of the steps of a path that are tried until two searches need the same steps."""


def finer(path: Path, parts: int) -> Path:
    """A path whose steps are in equal parts."""
    ends = [
        (start + share * (end - start), here + share * (there - here))
        for (start, here), (end, there) in pairwise(path)
        for share in np.arange(1, parts + 1) / parts
    ]
    return [path[0], *ends]


OWN_WARNINGS = tuple(
    kind
    for kind in vars(errors).values()
    if isinstance(kind, type)
    and issubclass(kind, UserWarning)
    and kind is not errors.UncheckedWarning
)
"""Warnings of this package; that nothing was held out says nothing of a case."""


@contextmanager
def recorded_warnings() -> Iterator[list[str]]:
    """Collect what the package warns of in a block, as text; the list is filled at its end."""
    messages: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield messages
    messages += [str(item.message) for item in caught if issubclass(item.category, OWN_WARNINGS)]


Line = dict[str, Any]
"""A row of the table: case, model, outcome, figure, why."""


def line(case: str, model: str, outcome: str, why: str, figure: float | None = None) -> Line:
    """Row of an answer, ``right``, ``warned`` or ``WRONG`` by a figure, or of what was
    ``refused``.
    """
    figure = None if figure is None else float(figure)
    return {"case": case, "model": model, "outcome": outcome, "figure": figure, "why": why}


@dataclass(frozen=True)
class Known:
    """What is known of an answer beforehand.

    Attributes:
        name: what it is, in words.
        error: maps the full model, or the history of a scene that flows as far as it came, to an
            error.
        tolerance: error up to which an answer is right.
    """

    name: str
    error: Callable[[Any], float]
    tolerance: float

    def row(self, case: str, found: Any, warned: list[str]) -> Line:
        """Row of what was found: right, or told to be wrong by a warning, or wrong."""
        error = self.error(found)
        verdict = "right" if error <= self.tolerance else "warned" if warned else "WRONG"
        return line(case, "known answer", verdict, "; warned: ".join([self.name, *warned]), error)


@dataclass(frozen=True)
class Checked:
    """What was found of a full model.

    Attributes:
        worst: largest difference to another search.
        tolerance: what round-off, or the tolerance of the searches, explains.
        why: what was compared.
        shown: what the error of a known answer is told by.
        training: histories to train on, where bodies flow.
    """

    worst: float
    tolerance: float
    why: str
    shown: Any
    training: Sequence[History] = ()


@dataclass(frozen=True)
class Case:
    """A scene, and how it is trained and reduced.

    Attributes:
        name: what is extreme.
        scene: the scene.
        recipe: how to reduce; None for the usual way.
        select: maps the training solutions to those used.
        counts: training points along each parameter; None takes those of the run.
        known: what is known of the full order's answers; None if nothing is.
        tests: random points at which the reduced model is compared, and ten more held out of its
            training.
        worst_force: limit of the largest force error, smaller where no contact changes its place.
    """

    name: str
    scene: Scene
    recipe: Recipe | None = None
    select: Callable[[SnapshotSet], SnapshotSet] = lambda snapshots: snapshots
    counts: tuple[int, ...] | None = None
    known: Known | None = None
    tests: int = 40
    worst_force: float = REDUCED_WORST["dual_full_floored"]

    def built(self) -> FullOrderModel:
        """The full model."""
        return FullOrderModel(self.scene, MPI.COMM_SELF)

    def check(self, full: FullOrderModel, seed: int) -> Checked:
        """The full model beside an independent solver at random parameters."""
        from hhr_dolfinx.plugins.baselines.naive import NaiveFullOrder

        naive, bodies, points = (
            NaiveFullOrder(full),
            _dofs_of_pairs(full.problem),
            full.parameters.random(5, seed + 7),
        )
        worst = np.max([_disagreement(full, naive, point, bodies) for point in points])
        tolerance = max(FULL_TOLERANCE, *(_lost(full, point) for point in points))
        return Checked(worst, tolerance, "two solvers and the contact conditions", full)

    def check_reduced(
        self, full: FullOrderModel, checked: Checked, counts: tuple[int, ...], seed: int
    ) -> Line:
        """Row of the reduced model at random parameters."""
        from hhr_dolfinx.plugins.studies.measure import References

        space = full.parameters
        with recorded_warnings() as warned:
            snapshots = self.select(compute_snapshots(full, space.grid(self.counts or counts)))
            held_out = compute_snapshots(full, space.random(self.tests + 10, seed + 1))
            model = build(full, snapshots, self.recipe, held_out)
        points, limits = (
            space.random(self.tests, seed),
            {**REDUCED_WORST, "dual_full_floored": self.worst_force},
        )
        found = References.at(points, full, snapshots).errors(model)
        within, parts = True, []
        for name, label in (("primal_l2", "displacement"), ("dual_full_floored", "forces")):
            values = found.values[name]
            worst, high = values.max(), np.percentile(values, 95, method="higher")
            within &= bool(worst <= limits[name] and high <= REDUCED_P95[name])
            parts.append(
                f"{label} {high:.1e} at 95 %, {worst:.1e} at "
                f"{space.described(points[values.argmax()])}"
            )
        unanswered = [space.described(point) for point in points[~found.answered]]
        parts += [f"no answer at {'; '.join(unanswered)}"] if unanswered else []
        parts += [f"warned: {message}" for message in warned]
        verdict = "right" if within else "warned" if warned else "WRONG"
        return line(
            self.name, "reduced", verdict, "; ".join(parts), found.values["dual_full_floored"].max()
        )


@dataclass(frozen=True)
class HistoryCase:
    """A scene that flows, its path in time, and how it is reduced.

    Attributes:
        name: what is extreme.
        scene: makes the scene; what it raises counts as refused.
        path: times and parameters for a value.
        values: the first and the last are trained on, the middle one is tried.
        recipe: how to reduce; None for the usual way.
        tried: the path compared, for the middle value; None for the family that was trained.
        known: what is known of the history compared, or of the part kept of one that is refused;
            None if nothing is.
    """

    name: str
    scene: Callable[[], Scene]
    path: Callable[[float], Path]
    values: tuple[float, float, float]
    recipe: Recipe | Reductor | None = None
    tried: Callable[[float], Path] | None = None
    known: Known | None = None

    def built(self) -> FullOrderModel:
        """The full model."""
        return FullOrderModel(self.scene(), MPI.COMM_SELF)

    def check(self, full: FullOrderModel, seed: int) -> Checked:
        """A full history beside that of another search operator."""
        first, middle, last = self.values
        training = [full.march(self.path(value)) for value in (first, last)]
        tried = (self.tried or self.path)(middle)
        for parts in FINER:  # a step that one search cuts and the other does not is another step
            exact, other = (
                full.march(finer(tried, parts), how)
                for how in (MarchSettings(), MarchSettings("tangent"))
            )
            if exact.cuts == other.cuts:
                break
        worst = max(
            relative_error(p.unknown, q.unknown)
            for p, q in zip(exact.answers, other.answers, strict=True)
        )
        iterations = f"{sum(exact.iterations)} and {sum(other.iterations)} iterations"
        why = f"two search operators, {iterations}, {exact.cuts} cuts"
        return Checked(worst, HISTORY_TOLERANCE, why, exact, training)

    def check_reduced(
        self, full: FullOrderModel, checked: Checked, counts: tuple[int, ...], seed: int
    ) -> Line:
        """Row of the reduced model along the path of the full one."""
        from hhr_dolfinx.plugins.paths.compared import largest_errors

        exact, snapshots = checked.shown, SnapshotSet.of_histories(checked.training)
        with recorded_warnings() as doubts:
            model = build(full, snapshots, self.recipe)
        # steps are those of the full order: what they are off by says nothing of the model
        with recorded_warnings() as told, told_once():
            found = model.march(exact.path)
        floor = force_floor(full.problem, snapshots)
        high = dict(zip(HISTORY_WORST, largest_errors(full, found, exact, floor), strict=True))
        within = all(high[name] <= limit for name, limit in HISTORY_WORST.items())
        parts = [f"{name} {value:.1e}" for name, value in high.items()]
        parts += (
            [f"{model.offline.layers} layers"] if isinstance(self.recipe, Recipe) else ["condensed"]
        )
        parts += [f"warned: {message}" for message in (*doubts, *told)]
        if self.tried is None:
            verdict = "right" if within else "warned" if doubts or told else "WRONG"
        else:
            # where nothing was trained a good answer is luck, and only the model itself can say so
            # when it is asked
            verdict = "warned" if told else "right" if within else "WRONG"
        return line(self.name, "reduced", verdict, ", ".join(parts), max(high.values()))


def verify(case: Case | HistoryCase, counts: tuple[int, ...], seed: int) -> Iterator[Line]:
    """Rows of the full order and, where it is not refused, of the reduced model.

    ``counts`` are training points along each parameter, where the case does not say it.
    """
    try:
        with recorded_warnings() as warned:
            full = case.built()
        checked = case.check(full, seed)
    except errors.HHRError as error:
        yield line(case.name, "full", "refused", str(error))
        if case.known is not None and hasattr(error, "history"):
            yield case.known.row(case.name, error.history, warned)
        return
    verdict = "right" if checked.worst <= checked.tolerance else "WRONG"
    yield line(case.name, "full", verdict, "; warned: ".join([checked.why, *warned]), checked.worst)
    try:
        if case.known is not None:
            yield case.known.row(case.name, checked.shown, warned)
        yield case.check_reduced(full, checked, counts, seed)
    except errors.HHRError as error:
        yield line(case.name, "reduced", "refused", str(error))


def _dofs_of_pairs(problem: ContactProblem) -> list[tuple[np.ndarray, np.ndarray]]:
    """For each contact pair its conditions, and the dofs of the bodies that it joins, both as
    masks.
    """
    _, body = connected_components(problem.stiffness, directed=False)
    found = []
    for pair in np.unique(problem.contact_pairs):
        rows = problem.contact_pairs == pair
        found.append((rows, np.isin(body, body[problem.contact[np.flatnonzero(rows)].indices])))
    return found


def _lost(full: FullOrderModel, point: np.ndarray) -> float:
    """Relative error of the forces K U by round-off of their products: what no solver in double
    precision knows.

    Ten last digits, for rows of some twenty entries. Next to nothing, but where bodies are carried
    by 1e8 times their size, or keep their volume to ten digits.
    """
    stiffness, field = full.problem.at(point).stiffness, full.solve(point).displacement()
    products = np.linalg.norm(abs(stiffness) @ np.abs(field))
    return float(10 * np.finfo(float).eps * products / (np.linalg.norm(stiffness @ field) or 1.0))


def _disagreement(
    full: FullOrderModel,
    naive: Model,
    point: np.ndarray,
    bodies: list[tuple[np.ndarray, np.ndarray]],
) -> float:
    """Difference of two solvers and of two starts, and what the first leaves of the contact
    conditions.
    """
    problem, ours = full.problem.at(point), full.solve(point)
    try:
        theirs = naive.solve(point)
    except errors.HHRError:
        if ours.undetermined is None:
            raise
        # its matrix is singular along the motion, which round-off hides on some processors
        theirs = full.solve(point, start=~ours.active)
    closed = full.solve(point, start=np.ones(len(problem.contact_pairs), dtype=bool)).forces()
    displacement, forces, expected = ours.displacement(), ours.forces(), theirs.forces()
    other = theirs.displacement()
    if ours.undetermined is not None:  # which each solver chooses, and of which the answer warns
        motions = ours.undetermined
        other = other - motions @ np.linalg.lstsq(motions, other - displacement, rcond=None)[0]
    worst = [relative_error(displacement, other)]
    # of whole displacements: a rigid motion has no forces, while K lift, its reaction, would hide
    # all of them
    internal = problem.stiffness @ theirs.displacement()
    for rows, dofs in bodies:
        # beside the forces of a stronger pair those of a weak one would count as nothing
        floor = float(np.linalg.norm(internal[dofs]))
        worst += [
            relative_error(found[rows], expected[rows], floor=floor) for found in (forces, closed)
        ]
        worst.append(
            relative_error(np.minimum(forces[rows], 0.0), np.zeros(rows.sum()), floor=floor)
        )
    worst += asdict(contact_residuals(problem, displacement, forces, problem.theta(point))).values()
    return float(np.max(worst))  # NaN stays NaN


def as_report(rows: list[Line], seed: int) -> dict[str, Any]:
    """Rows of :func:`verify` as a report: what each figure measures, what it is held against, and
    what came of it.
    """
    cases = [
        {
            "case": row["case"],
            "quantity": "largest relative error" if row["figure"] is not None else None,
            "reference": _REFERENCES[row["model"]],
            "ours": row["why"],
            "error": row["figure"],
            "outcome": row["outcome"].lower(),
        }
        for row in rows
    ]
    return {"scene": "extreme_cases", "seed": seed, "cases": cases}


_REFERENCES = {
    "full": "another search for the same full order",
    "known answer": "known answer",
    "reduced": "full order",
}
"""What each kind of row is held against."""
