"""What scenes that flow do under extreme conditions: two searches must agree, the reduced history follow the full."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from hhr_dolfinx.certify.accuracy import relative_error
from hhr_dolfinx.errors import HHRError
from hhr_dolfinx.full_order.plastic import PlasticFullOrder
from hhr_dolfinx.models.march import MarchSettings, march
from hhr_dolfinx.reduction.plastic_offline import PlasticSettings, build_plastic_reduction
from hhr_dolfinx.reduction.plastic_trust import force_floor_of, largest_errors
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.study.verify import Known, answer, refusal, said

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
        tried: the path compared, for the middle value; None for the family that was trained.
        known: what is known of the history compared, or of the part kept of one that is refused; None if nothing is.
    """

    name: str
    scene: Callable[[], Scene]
    path: Callable[[float], Sequence]
    values: tuple[float, float, float]
    recipe: PlasticSettings = PlasticSettings()
    tried: Callable[[float], Sequence] | None = None
    known: Known | None = None


def verify_history(case: HistoryCase) -> Iterator[dict]:
    """Rows of the full order and, where it is not refused, of the reduced model."""
    first, middle, last = case.values
    tried = (case.tried or case.path)(middle)
    warned: list[str] = []
    try:
        with said() as warned:
            full = PlasticFullOrder(case.scene())
        training = [march(full, case.path(value)) for value in (first, last)]
        exact = march(full, tried)
        other = march(full, tried, MarchSettings("tangent"))
    except HHRError as error:
        yield refusal(case.name, "full", error)
        if case.known is not None and hasattr(error, "history"):
            yield case.known.row(case.name, error.history, warned)
        return
    worst = max(relative_error(p.unknown, q.unknown) for p, q in zip(exact.points, other.points, strict=True))
    why = f"two search operators, {sum(exact.iterations)} and {sum(other.iterations)} iterations, {exact.cuts} cuts"
    why = "; warned: ".join([why, *warned])
    yield answer(case.name, "full", worst, "right" if worst <= FULL_TOLERANCE else "WRONG", why)
    if case.known is not None:
        yield case.known.row(case.name, exact, warned)
    yield _verify_reduced(case, full, training, exact)


def _verify_reduced(case, full, training, exact) -> dict:
    """Row of the reduced model, compared with one exact history."""
    try:
        with said() as doubts:
            reduction = build_plastic_reduction(full, training, case.recipe)
        with said() as told:
            found = march(reduction.model, exact.path)
    except HHRError as error:
        return refusal(case.name, "reduced", error)
    high = dict(
        zip(REDUCED_TOLERANCE, largest_errors(full, reduction, found, exact, force_floor_of(training)), strict=True)
    )
    within = all(high[name] <= limit for name, limit in REDUCED_TOLERANCE.items())
    parts = [*(f"{name} {value:.1e}" for name, value in high.items()), f"{reduction.layers} layers"]
    parts += [f"warned: {message}" for message in (*doubts, *told)]
    if case.tried is None:
        verdict = "right" if within else "warned" if doubts or told else "WRONG"
    else:
        # where nothing was trained a good answer is luck, and only the model itself can say so when it is asked
        verdict = "warned" if told else "right" if within else "WRONG"
    return answer(case.name, "reduced", max(high.values()), verdict, ", ".join(parts))
