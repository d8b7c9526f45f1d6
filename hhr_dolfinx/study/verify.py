"""Right, refused with the reason, warned of, or wrong without a word: what a scene does under extreme conditions.

The full order is checked against an independent solver (a saddle-point matrix factored anew for each set of statuses)
and against the contact conditions themselves; the reduced model against the full order at random parameters.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from hhr_dolfinx.baselines.naive import NaiveFullOrder
from hhr_dolfinx.contact.problem import ContactProblem, ContactSolution
from hhr_dolfinx.errors import HHRError, PairingWarning, StabilityWarning
from hhr_dolfinx.full_order.elastic import FullOrderModel
from hhr_dolfinx.reduction.offline import ReductionSettings, build_reduced_model
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.snapshots.accuracy import relative_error
from hhr_dolfinx.snapshots.solutions import SnapshotSet, compute_snapshots
from hhr_dolfinx.study.yardstick import Yardstick

FULL_TOLERANCE = 1e-6
"""Two exact solvers differ by round-off times cond(K), which reaches 1e10 in extreme cases."""
REDUCED_TOLERANCE = {"primal_l2": 0.02, "dual_full_floored": 0.1}
"""At the 95th percentile: what the trust check lets pass without a warning."""


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


@contextmanager
def said() -> Iterator[list[str]]:
    """Collect what the package warns of in a block, as text; the list is filled at its end."""
    messages: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield messages
    messages += [str(item.message) for item in caught if issubclass(item.category, StabilityWarning | PairingWarning)]


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
    except HHRError as error:
        yield refusal(case.name, "full", error)
        return
    why = "; warned: ".join(["two solvers and the contact conditions", *warned])
    yield answer(case.name, "full", worst, "right" if worst <= FULL_TOLERANCE else "WRONG", why)
    try:
        yield _verify_reduced(case, full_order, counts, seed)
    except HHRError as error:
        yield refusal(case.name, "reduced", error)


def contact_residual(problem: ContactProblem, solution: ContactSolution, mu) -> float:
    """Largest violation of (1.21), each part relative to its scale."""
    theta = problem.theta(mu)
    homogeneous, load = solution.primal - problem.lifts @ theta, problem.loads @ theta
    slack = problem.gaps @ theta - problem.contact @ homogeneous
    residual = (problem.stiffness @ homogeneous + problem.contact.T @ solution.forces - load)[problem.free]
    # round-off in K u is that of the largest product summed, not of the sum
    force = (abs(problem.stiffness) @ np.abs(homogeneous)).max() + np.abs(load).max() or 1.0
    length = np.abs(problem.gaps @ theta).max() + np.abs(homogeneous).max() or 1.0
    return max(np.abs(residual).max() / force, -slack.min() / length, -solution.forces.min() / force, 0.0)


def _disagreement(full_order, naive, point) -> float:
    """Difference of two solvers, and what the first leaves of the contact conditions."""
    problem, ours, theirs = full_order.problem, full_order.solve(point), naive.solve(point)
    load = np.linalg.norm(problem.loads @ problem.theta(point))
    return max(
        relative_error(ours.primal, theirs.primal),
        relative_error(ours.forces, theirs.forces, floor=load),
        contact_residual(problem, ours, point),
    )


def _verify_reduced(case, full_order, counts, seed) -> dict:
    """Row of the reduced model."""
    space = full_order.problem.parameters
    with said() as warned:
        snapshots = case.select(compute_snapshots(full_order, space.grid(counts)))
        held_out = compute_snapshots(full_order, space.random(20, seed + 1))
        reduction = build_reduced_model(full_order, snapshots, case.recipe, held_out)
    errors = Yardstick.at(space.random(40, seed), full_order, snapshots).errors(reduction)
    high = {}
    for name in REDUCED_TOLERANCE:
        answered = errors.values[name][errors.answered]
        high[name] = float(np.percentile(answered, 95, method="higher")) if answered.size else np.inf
    why = f"displacement {high['primal_l2']:.1e}, forces {high['dual_full_floored']:.1e}"
    why = "; warned: ".join([f"{why}, {errors.unanswered} of 40 unanswered", *warned])
    within = all(high[name] <= limit for name, limit in REDUCED_TOLERANCE.items())
    verdict = "right" if within else "warned" if warned else "WRONG"
    return answer(case.name, "reduced", max(high.values()), verdict, why)
