"""What scenes that flow do under extreme conditions: two searches must agree, the reduced history follow the full."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from hhr_dolfinx.errors import HHRError
from hhr_dolfinx.flow.quasi_static import MarchSettings, march
from hhr_dolfinx.full_order.plastic import PlasticFullOrder
from hhr_dolfinx.reduction.plastic_offline import PlasticSettings, build_plastic_reduction
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.snapshots.accuracy import relative_error
from hhr_dolfinx.study.study_histories import history_errors
from hhr_dolfinx.study.verify import answer, refusal

FULL_TOLERANCE = 2e-3
"""Two searches stop at residuals of 1e-5; where a body is near its limit load the displacement moves 100 times that."""
REDUCED_TOLERANCE = 0.15
"""Two training histories of 20 steps on a coarse mesh."""


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
    except (HHRError, ValueError) as error:
        yield refusal(case.name, "full", error)
        return
    exact = histories[middle]
    worst = max(relative_error(p.unknown, q.unknown) for p, q in zip(exact.points, other.points, strict=True))
    why = f"two search operators, {sum(exact.iterations)} and {sum(other.iterations)} iterations, {exact.cuts} cuts"
    yield answer(case.name, "full", worst, "right" if worst <= FULL_TOLERANCE else "WRONG", why)
    try:
        reduction = build_plastic_reduction(full, [histories[first], histories[last]], case.recipe)
        row = history_errors(full, reduction, march(reduction.model, case.path(middle)), exact)
    except HHRError as error:
        yield refusal(case.name, "reduced", error)
        return
    why = f"displacement {row['primal_euclid']:.1e}, forces {row['dual_rid']:.1e}, {reduction.layers} layers"
    high = max(row["primal_euclid"], row["dual_rid"])
    yield answer(case.name, "reduced", high, "right" if high <= REDUCED_TOLERANCE else "WRONG", why)
