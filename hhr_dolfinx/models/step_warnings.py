"""Warnings of histories whose time steps are too long: one for each history, or one for all of a training."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from hhr_dolfinx.errors import TimeStepWarning

ACCEPTED = 0.05
"""Estimated time error above which a history that nobody controls is warned of."""
_COLLECTED: ContextVar[list[float] | None] = ContextVar("time errors of a training", default=None)


def complain(estimate: float, tolerance: float | None) -> None:
    """Warn of a history with a large time error, unless it was asked for, or is told of together with others."""
    together = _COLLECTED.get()
    if together is not None:
        together.append(estimate)
    elif tolerance is None and estimate > ACCEPTED:
        warnings.warn(f"the time steps of this history {_said(estimate)}", TimeStepWarning, stacklevel=5)


@contextmanager
def told_once(what: str = "") -> Iterator[None]:
    """Histories in a block warn together at its end, as ``what``; not at all without a name."""
    together = _COLLECTED.get()
    if together is not None:  # whoever asked first tells
        yield
        return
    estimates: list[float] = []
    token = _COLLECTED.set(estimates)
    try:
        yield
    finally:
        _COLLECTED.reset(token)
    large = [item for item in estimates if item > ACCEPTED]
    if what and large:
        text = f"the time steps of {len(large)} of {len(estimates)} {what} {_said(max(large))}"
        warnings.warn(text, TimeStepWarning, stacklevel=5)


def _said(estimate: float) -> str:
    return (
        f"make errors of {100 * estimate:.2g} % of the largest stress by estimate, and {100 * ACCEPTED:g} % is much: "
        "take more of them where loads are put on or held, or MarchSettings(time_tolerance=0.01)"
    )
