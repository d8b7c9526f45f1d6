"""The path of a history, and its solution by elastic models."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, Protocol

import numpy as np

from hhr_dolfinx.errors import ParameterError
from hhr_dolfinx.models.answer import Answer, History, Model, Path
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.parameters import ParameterSpace, PointLike, named_values


def check_settings(settings: MarchSettings) -> None:
    """Check the settings of a history.

    Raises:
        ParameterError: for a value that is no MarchSettings.
    """
    if not isinstance(settings, MarchSettings):
        raise ParameterError(
            f"the settings {settings!r} of a history must be MarchSettings, or left out"
        )


def checked_path(parameters: ParameterSpace, path: Iterable[tuple[float, PointLike]]) -> Path:
    """Check a whole path before any of it is solved.

    Args:
        parameters: the box of the parameters.
        path: times in seconds and parameters, the first ones at rest.

    Raises:
        ParameterError: if it is empty, a parameter is not finite or outside the box, or times do
            not increase.
    """
    try:
        pairs = [(float(time), target) for time, target in map(_pair, path)]
    except ParameterError:  # a ValueError too
        raise
    except (TypeError, ValueError):
        raise ParameterError(
            "a path is a list of pairs: a time in seconds and the parameters there"
        ) from None
    checked = [(time, parameters.point(target)) for time, target in pairs]
    if not checked:
        raise ParameterError(
            "the path is empty: its first time and parameter are where the model is at rest"
        )
    times = np.array([time for time, _ in checked])
    if not np.isfinite(times).all():
        raise ParameterError(
            f"times must be finite, and number {int(np.argmin(np.isfinite(times)))} is not"
        )
    late = np.flatnonzero(np.diff(times) <= 0)
    if late.size:
        before, after = times[late[0] : late[0] + 2]
        raise ParameterError(f"times must increase: {after:g} s comes after {before:g} s")
    return checked


def _pair(step: Any) -> Any:
    """Time and parameters of a step of a path.

    Of one that has the name ``time``, the other names are parameters.
    """
    named = None if type(step) is tuple else named_values(step)
    if named is None:
        return step
    if "time" not in named:
        raise ParameterError(
            f"a step of a path names {list(named)} and no 'time': give pairs, or name its time"
        )
    return named.pop("time"), named


@contextmanager
def left_with(history: History) -> Iterator[None]:
    """Give an error of a block the attribute ``history``, with the steps before.

    A keyboard interrupt gets it too.
    """
    try:
        yield
    except BaseException as stop:  # a law may raise anything, and a user may interrupt
        with suppress(AttributeError):
            stop.history = history  # type: ignore[attr-defined]
        raise


class Walk(Protocol):
    """Solver of the steps of one history, one after another."""

    def known(self, number: int, answer: Answer) -> Answer:
        """Take in the answer of step ``number``, from 1 on, which the full model solved before.

        Args:
            number: number of the step, from 1 on.
            answer: its answer, which the full model solved before.
        """

    def solved(self, number: int, time: float, point: np.ndarray) -> Answer:
        """Answer at the end of a step, at a time and a point, (P,).

        Args:
            number: number of the step, from 1 on.
            time: end of the step, in seconds.
            point: parameter there, (P,).
        """


def walked(
    walk: Walk,
    path: Path,
    history: History,
    known: Sequence[Answer],
    keep: Callable[[Answer], None],
) -> History:
    """Answer a checked path into a history: known steps first.

    Args:
        walk: solver of the steps.
        path: times and parameters.
        history: history to which the answers are appended.
        known: answers to the first steps, solved before.
        keep: called with each new answer.
    """
    with left_with(history):
        for number, (time, point) in enumerate(path[1:], start=1):
            new = number > len(known)
            answer = (
                walk.solved(number, time, point) if new else walk.known(number, known[number - 1])
            )
            history.cuts += answer.parts > 1
            history.answers.append(answer)
            if new:
                keep(answer)
    return history


class _PointByPoint:
    """Steps of an elastic model: every point is solved from the statuses of the one before."""

    def __init__(self, model: Model, settings: MarchSettings):
        self.model = model
        self.outside = settings.outside
        # baselines may lack gradients: pass the argument only if it is set
        self.wanted = {"gradient": True} if settings.gradient else {}
        self.start: str | np.ndarray = "nearest"

    def known(self, number: int, answer: Answer) -> Answer:
        """Keep the statuses of an answer as the next start.

        Args:
            number: not used.
            answer: answer of the step.
        """
        self.start = answer.active
        return answer

    def solved(self, number: int, time: float, point: np.ndarray) -> Answer:
        """Answer at a point, whatever was before.

        Args:
            number: not used.
            time: end of the step, in seconds.
            point: parameter there, (P,).
        """
        answer = self.model.solve(point, start=self.start, outside=self.outside, **self.wanted)
        self.start = answer.active
        return answer._replace(time=time, time_error=0.0)


def solve_along(
    model: Model,
    path: Path,
    settings: MarchSettings,
    *,
    known: Sequence[Answer] = (),
    keep: Callable[[Answer], None] = lambda answer: None,
) -> History:
    """History of an elastic model along a checked path.

    Every point is solved from the statuses of the one before. Of the settings ``outside`` and
    ``gradient`` count.

    Args:
        model: model that answers.
        path: times and parameters.
        settings: settings of the history.
        known: answers to the first steps, solved before.
        keep: called with each new answer.
    """
    check_settings(settings)
    return walked(_PointByPoint(model, settings), path, History(*path[0]), known, keep)
