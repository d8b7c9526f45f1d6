"""Right, refused with the reason, warned of, or wrong without a word: what a scene does under extreme conditions.

The full order is checked against an independent solver (a saddle-point matrix factored anew for each set of statuses)
and against the contact conditions themselves; the reduced model against the full order at random parameters.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass

import numpy as np
from mpi4py import MPI

from hhr_dolfinx import errors
from hhr_dolfinx.baselines.naive import NaiveFullOrder
from hhr_dolfinx.full_order.elastic import FullOrderModel
from hhr_dolfinx.reduction.offline import ReductionSettings, build_reduced_model
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.snapshots.accuracy import contact_residuals, relative_error
from hhr_dolfinx.snapshots.solutions import SnapshotSet, compute_snapshots
from hhr_dolfinx.study.yardstick import Yardstick

FULL_TOLERANCE = 1e-6
"""Two exact solvers differ by round-off times cond(K), which reaches 1e10 in extreme cases."""
REDUCED_WORST = {"primal_l2": 0.05, "dual_full_floored": 0.3}
"""At the worst point, on the whole mesh. Forces of neighbouring nodes change places where contact grazes."""
REDUCED_P95 = {"primal_l2": 0.02, "dual_full_floored": 0.1}
"""At 95 % of the points."""


@dataclass(frozen=True)
class Case:
    """A scene, and how it is trained and reduced.

    Attributes:
        name: what is extreme.
        scene: the scene.
        recipe: how to reduce.
        select: maps the training solutions to those used.
    """

    name: str
    scene: Scene
    recipe: ReductionSettings = ReductionSettings()
    select: Callable[[SnapshotSet], SnapshotSet] = lambda snapshots: snapshots


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
        counts: training points along each parameter.
        seed: of random parameters.
    """
    try:
        with said() as warned:
            full_order = FullOrderModel(case.scene, MPI.COMM_SELF)
        naive, space = NaiveFullOrder(full_order), full_order.problem.parameters
        worst = max(_disagreement(full_order, naive, point) for point in space.random(5, seed + 7))
    except errors.HHRError as error:
        yield refusal(case.name, "full", error)
        return
    why = "; warned: ".join(["two solvers and the contact conditions", *warned])
    yield answer(case.name, "full", worst, "right" if worst <= FULL_TOLERANCE else "WRONG", why)
    try:
        yield _verify_reduced(case, full_order, counts, seed)
    except errors.HHRError as error:
        yield refusal(case.name, "reduced", error)


def _disagreement(full_order, naive, point) -> float:
    """Difference of two solvers, and what the first leaves of the contact conditions."""
    problem, ours, theirs = full_order.problem, full_order.solve(point), naive.solve(point)
    load = np.linalg.norm(problem.loads @ problem.theta(point))
    return max(
        relative_error(ours.primal, theirs.primal),
        relative_error(ours.forces, theirs.forces, floor=load),
        *asdict(contact_residuals(problem, ours.primal, ours.forces, problem.theta(point))).values(),
    )


def _verify_reduced(case, full_order, counts, seed) -> dict:
    """Row of the reduced model."""
    space = full_order.problem.parameters
    with said() as warned:
        snapshots = case.select(compute_snapshots(full_order, space.grid(counts)))
        held_out = compute_snapshots(full_order, space.random(50, seed + 1))
        reduction = build_reduced_model(full_order, snapshots, case.recipe, held_out)
    points = space.random(40, seed)
    found = Yardstick.at(points, full_order, snapshots).errors(reduction)
    within, parts = True, []
    for name, label in (("primal_l2", "displacement"), ("dual_full_floored", "forces")):
        values = found.values[name]
        worst, high = values.max(), np.percentile(values, 95, method="higher")
        within &= bool(worst <= REDUCED_WORST[name] and high <= REDUCED_P95[name])
        parts.append(f"{label} {high:.1e} at 95 %, {worst:.1e} at {space.described(points[values.argmax()])}")
    unanswered = [space.described(point) for point in points[~found.answered]]
    parts += [f"no answer at {'; '.join(unanswered)}"] if unanswered else []
    parts += [f"warned: {message}" for message in warned]
    verdict = "right" if within else "warned" if warned else "WRONG"
    return answer(case.name, "reduced", found.values["dual_full_floored"].max(), verdict, "; ".join(parts))
