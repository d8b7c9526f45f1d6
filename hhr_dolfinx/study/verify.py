"""Right, refused with the reason, warned of, or wrong without a word: what a scene does under extreme conditions.

The full order is checked against an independent solver (a saddle-point matrix factored anew for each set of statuses),
against itself from other statuses and against the contact conditions, each pair by the forces of its own bodies; where
an answer is known, against that; the reduced model against the full order at random parameters.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.sparse.csgraph import connected_components

from hhr_dolfinx import errors
from hhr_dolfinx.baselines.naive import NaiveFullOrder
from hhr_dolfinx.certify.accuracy import contact_residuals, relative_error
from hhr_dolfinx.full_order.elastic import FullOrderModel
from hhr_dolfinx.reduction.offline import ReductionSettings, build_reduced_model
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.snapshots.records import SnapshotSet, compute_snapshots
from hhr_dolfinx.study.yardstick import Yardstick

FULL_TOLERANCE = 1e-6
"""Two exact solvers differ by round-off times cond(K), which reaches 1e10 in extreme cases."""
REDUCED_WORST = {"primal_l2": 0.05, "dual_full_floored": 0.3}
"""At the worst point, on the whole mesh. Forces of neighbouring nodes change places where contact grazes."""
REDUCED_P95 = {"primal_l2": 0.02, "dual_full_floored": 0.1}
"""At 95 % of the points."""


@dataclass(frozen=True)
class Known:
    """What is known of an answer beforehand.

    Attributes:
        name: what it is, in words.
        error: maps the full model, or the history of a scene that flows as far as it came, to an error.
        tolerance: error up to which an answer is right.
    """

    name: str
    error: Callable[[Any], float]
    tolerance: float

    def row(self, case: str, found: Any, warned: list[str]) -> dict:
        """Row of what was found: right, or told to be wrong by a warning, or wrong."""
        error = self.error(found)
        verdict = "right" if error <= self.tolerance else "warned" if warned else "WRONG"
        return answer(case, "known answer", error, verdict, "; warned: ".join([self.name, *warned]))


@dataclass(frozen=True)
class Case:
    """A scene, and how it is trained and reduced.

    Attributes:
        name: what is extreme.
        scene: the scene.
        recipe: how to reduce.
        select: maps the training solutions to those used.
        counts: training points along each parameter; None takes those of the run.
        known: what is known of the full order's answers; None if nothing is.
        tests: random points at which the reduced model is compared, and ten more held out of its training.
        worst_force: limit of the largest force error, smaller where no contact changes its place.
    """

    name: str
    scene: Scene
    recipe: ReductionSettings = ReductionSettings()
    select: Callable[[SnapshotSet], SnapshotSet] = lambda snapshots: snapshots
    counts: tuple[int, ...] | None = None
    known: Known | None = None
    tests: int = 40
    worst_force: float = REDUCED_WORST["dual_full_floored"]


OWN_WARNINGS = tuple(
    kind
    for kind in vars(errors).values()
    if isinstance(kind, type) and issubclass(kind, UserWarning) and kind is not errors.UncheckedWarning
)
"""Warnings of this package; that nothing was held out says nothing of a case."""


@contextmanager
def said() -> Iterator[list[str]]:
    """Collect what the package warns of in a block, as text; the list is filled at its end."""
    messages: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield messages
    messages += [str(item.message) for item in caught if issubclass(item.category, OWN_WARNINGS)]


def answer(case: str, model: str, figure: float, verdict: str, why: str) -> dict:
    """Row of an answer, ``right``, ``warned`` or ``WRONG``."""
    return {"case": case, "model": model, "outcome": verdict, "figure": float(figure), "why": why}


def refusal(case: str, model: str, error: Exception) -> dict:
    """Row of a refusal and its reason."""
    return {"case": case, "model": model, "outcome": "refused", "figure": None, "why": str(error)}


def verify(case: Case, counts: tuple[int, ...], seed: int) -> Iterator[dict]:
    """Rows of the full order and, where it is not refused, of the reduced model.

    Args:
        case: the scene.
        counts: training points along each parameter, where the case does not say it.
        seed: of random parameters.
    """
    try:
        with said() as warned:
            full_order = FullOrderModel(case.scene, MPI.COMM_SELF)
        naive, space = NaiveFullOrder(full_order), full_order.problem.parameters
        bodies = _dofs_of_pairs(full_order.problem)
        points = space.random(5, seed + 7)
        worst = np.max([_disagreement(full_order, naive, point, bodies) for point in points])
        known = max(FULL_TOLERANCE, *(_lost(full_order, point) for point in points))
    except errors.HHRError as error:
        yield refusal(case.name, "full", error)
        return
    why = "; warned: ".join(["two solvers and the contact conditions", *warned])
    yield answer(case.name, "full", worst, "right" if worst <= known else "WRONG", why)
    try:
        if case.known is not None:
            yield case.known.row(case.name, full_order, warned)
        yield _verify_reduced(case, full_order, case.counts or counts, seed)
    except errors.HHRError as error:
        yield refusal(case.name, "reduced", error)


def _dofs_of_pairs(problem) -> list[tuple[np.ndarray, np.ndarray]]:
    """For each contact pair its conditions, and the dofs of the bodies that it joins, both as masks."""
    _, body = connected_components(problem.stiffness, directed=False)
    found = []
    for pair in np.unique(problem.contact_pairs):
        rows = problem.contact_pairs == pair
        found.append((rows, np.isin(body, body[problem.contact[np.flatnonzero(rows)].indices])))
    return found


def _lost(full_order, point) -> float:
    """Relative error of the forces K U by round-off of their products: what no solver in double precision knows.

    Ten last digits, for rows of some twenty entries. Next to nothing, but where bodies are carried by 1e8 times their
    size, or keep their volume to ten digits.
    """
    stiffness, field = full_order.problem.stiffness, full_order.solve(point).primal
    products = np.linalg.norm(abs(stiffness) @ np.abs(field))
    return float(10 * np.finfo(float).eps * products / (np.linalg.norm(stiffness @ field) or 1.0))


def _disagreement(full_order, naive, point, bodies) -> float:
    """Difference of two solvers and of two starts, and what the first leaves of the contact conditions."""
    problem, ours, theirs = full_order.problem, full_order.solve(point), naive.solve(point)
    closed = full_order.solve(point, start=np.ones(len(problem.contact_pairs), dtype=bool))
    worst = [relative_error(ours.primal, theirs.primal)]
    # of whole displacements: a rigid motion has no forces, while K lift, its reaction, would hide all of them
    internal = problem.stiffness @ theirs.primal
    for rows, dofs in bodies:
        # beside the forces of a stronger pair those of a weak one would count as nothing
        floor = float(np.linalg.norm(internal[dofs]))
        worst += [relative_error(found.forces[rows], theirs.forces[rows], floor=floor) for found in (ours, closed)]
        worst.append(relative_error(np.minimum(ours.forces[rows], 0.0), np.zeros(rows.sum()), floor=floor))
    worst += asdict(contact_residuals(problem, ours.primal, ours.forces, problem.theta(point))).values()
    return float(np.max(worst))  # NaN stays NaN


def _verify_reduced(case, full_order, counts, seed) -> dict:
    """Row of the reduced model."""
    space = full_order.problem.parameters
    with said() as warned:
        snapshots = case.select(compute_snapshots(full_order, space.grid(counts)))
        held_out = compute_snapshots(full_order, space.random(case.tests + 10, seed + 1))
        reduction = build_reduced_model(full_order, snapshots, case.recipe, held_out)
    points, limits = space.random(case.tests, seed), {**REDUCED_WORST, "dual_full_floored": case.worst_force}
    found = Yardstick.at(points, full_order, snapshots).errors(reduction)
    within, parts = True, []
    for name, label in (("primal_l2", "displacement"), ("dual_full_floored", "forces")):
        values = found.values[name]
        worst, high = values.max(), np.percentile(values, 95, method="higher")
        within &= bool(worst <= limits[name] and high <= REDUCED_P95[name])
        parts.append(f"{label} {high:.1e} at 95 %, {worst:.1e} at {space.described(points[values.argmax()])}")
    unanswered = [space.described(point) for point in points[~found.answered]]
    parts += [f"no answer at {'; '.join(unanswered)}"] if unanswered else []
    parts += [f"warned: {message}" for message in warned]
    verdict = "right" if within else "warned" if warned else "WRONG"
    return answer(case.name, "reduced", found.values["dual_full_floored"].max(), verdict, "; ".join(parts))


def as_report(rows: list[dict], seed: int) -> dict:
    """Rows of cases as a report: what each figure measures, what it is held against, and what came of it.

    Args:
        rows: of :func:`verify` and of histories.
        seed: of random parameters.
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
