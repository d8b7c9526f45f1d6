"""What scenes that flow do under extreme conditions: two searches must agree, the reduced history follow the full."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from hhr_dolfinx.errors import HHRError
from hhr_dolfinx.flow.quasi_static import MarchSettings, march
from hhr_dolfinx.full_order.plastic import PlasticFullOrder
from hhr_dolfinx.reduction.plastic_offline import PlasticSettings, build_plastic_reduction
from hhr_dolfinx.reduction.plastic_trust import force_floor_of, largest_errors
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.snapshots.accuracy import relative_error
from hhr_dolfinx.study.verify import answer, refusal, said

FULL_TOLERANCE = 2e-3
"""Two searches stop at residuals of 1e-5; where a body is near its limit load the displacement moves 100 times that."""
REDUCED_TOLERANCE = {"displacement": 0.05, "forces": 0.2}
"""Largest errors over the largest size in the history; two training histories of 20 steps on a coarse mesh."""


@dataclass(frozen=True)
class HistoryCase:
    """A scene that flows, its path in time, and how it is reduced.

    Attributes:
        name: what is extreme.
        scene: makes the scene; what it raises counts as refused.
        path: times and parameters for a value.
        values: the first and the last are trained on, the middle one is tried.
        recipe: how to reduce.
    """

    name: str
    scene: Callable[[], Scene]
    path: Callable[[float], Sequence]
    values: tuple[float, float, float]
    recipe: PlasticSettings = PlasticSettings()


def verify_history(case: HistoryCase) -> Iterator[dict]:
    """Rows of the full order and, where it is not refused, of the reduced model."""
    first, middle, last = case.values
    try:
        full = PlasticFullOrder(case.scene())
        histories = {value: march(full, case.path(value)) for value in case.values}
        other = march(full, case.path(middle), MarchSettings("tangent"))
    except HHRError as error:
        yield refusal(case.name, "full", error)
        return
    exact = histories[middle]
    worst = max(relative_error(p.unknown, q.unknown) for p, q in zip(exact.points, other.points, strict=True))
    why = f"two search operators, {sum(exact.iterations)} and {sum(other.iterations)} iterations, {exact.cuts} cuts"
    yield answer(case.name, "full", worst, "right" if worst <= FULL_TOLERANCE else "WRONG", why)
    try:
        training = [histories[first], histories[last]]
        with said() as warned:
            reduction = build_plastic_reduction(full, training, case.recipe)
            found = march(reduction.model, case.path(middle))
    except HHRError as error:
        yield refusal(case.name, "reduced", error)
        return
    high = dict(
        zip(REDUCED_TOLERANCE, largest_errors(full, reduction, found, exact, force_floor_of(training)), strict=True)
    )
    within = all(high[name] <= limit for name, limit in REDUCED_TOLERANCE.items())
    parts = [*(f"{name} {value:.1e}" for name, value in high.items()), f"{reduction.layers} layers"]
    parts += [f"warned: {message}" for message in warned]
    verdict = "right" if within else "warned" if warned else "WRONG"
    yield answer(case.name, "reduced", max(high.values()), verdict, ", ".join(parts))
