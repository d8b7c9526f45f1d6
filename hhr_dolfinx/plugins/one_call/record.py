"""Record of a search: its models, with their errors, times and outcomes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from html import escape
from typing import Any

from hhr_dolfinx.plugins.one_call.target import Target

CONFIDENCE = 0.9
"""Confidence that no larger share of the box exceeds the target than fresh answers allow, see
:func:`share_beyond`.
"""
MET = "met"
LONG_OUTCOME = 40
"""Length of the outcome of a model above which it is printed below the table, once for all models
that share it.
"""


@dataclass(frozen=True)
class Tried:
    """One model of the search."""

    method: str  #: ``condensed``, ``hhr`` or ``local``
    setting: str  #: its settings
    full_answers: int  #: of the full model from the start of the search to the check of this model
    seconds: float  #: to build it, including its full answers
    #: median seconds of a query of the target, for a point or a history; NaN if it was not timed
    query: float = math.nan
    #: the largest known error, by the names of the target; empty if the model was not built
    errors: Mapping[str, float] = field(default_factory=dict)
    known: str = ""  #: source of the errors
    bytes: int = 0  #: size in a file; 0 without a limit in the budget
    outcome: str = ""  #: ``met``, or the reason why not
    #: largest share of the box that may exceed the target, with a confidence of 90 %, if none of
    #: the random fresh answers does; NaN if each answer has a bound or is exact, and if the target
    #: is not met
    beyond: float = math.nan

    @property
    def met(self) -> bool:
        """True if it meets the target."""
        return self.outcome == MET


@dataclass(frozen=True)
class Reduction:
    """Record of a search, see :func:`~hhr_dolfinx.plugins.one_call.search.reduce`.

    Attributes:
        scene, wish: its name, and the target accuracy.
        tried: models in the order of the search.
        chosen: number of the returned model; None if there is no model.
        full_answers, seconds: of the whole search.
        reason: why the target is not met, or empty.
        answered: part of the box in which the model answers; it refuses the rest, where strains
            mean nothing.
    """

    scene: str
    wish: Target
    tried: tuple[Tried, ...]
    chosen: int | None
    full_answers: int
    seconds: float
    reason: str = ""
    answered: float = 1.0

    @property
    def met(self) -> bool:
        """True if the target is met, as far as is known."""
        return self.chosen is not None and self.tried[self.chosen].met

    @property
    def reasons(self) -> tuple[str, ...]:
        """Reasons why models were refused or stopped, each once, in the order of occurrence."""
        return tuple(
            dict.fromkeys(
                attempt.outcome for attempt in self.tried if len(attempt.outcome) > LONG_OUTCOME
            )
        )

    @property
    def numbered(self) -> tuple[str, ...]:
        """These reasons with their numbers in the table."""
        return tuple(f"({number}) {reason}" for number, reason in enumerate(self.reasons, 1))

    @property
    def table(self) -> str:
        """A row for each model of the search, with the numbers of long reasons."""
        heads = (
            "",
            "method",
            "setting",
            "full answers",
            "build",
            "an answer",
            *self.wish.of,
            "known by",
            "outcome",
        )
        rows = [heads, *(self._row(number, attempt) for number, attempt in enumerate(self.tried))]
        widths = [max(len(row[k]) for row in rows) for k in range(len(heads))]
        lines = [
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
            for row in rows
        ]
        return "\n".join(lines)

    def __str__(self) -> str:
        return "\n".join([self.table, *self.numbered, self.verdict])

    def _repr_html_(self) -> str:
        return f"<pre>{escape(str(self))}</pre>"

    @property
    def verdict(self) -> str:
        """Sentence on whether the target is met."""
        target = f"an error of {self.wish.error:.3g} in {' and '.join(self.wish.of)}"
        spent = f"it took {self.full_answers} full answers and {self.seconds:.3g} s"
        if self.chosen is None:
            return f"there is no model: {self.reason}; {spent}"
        if not self.met:
            return f"{target} is not met: {self.reason}. The best model is returned; {spent}"
        model = self.tried[self.chosen]
        sure = (
            f"at {100 * CONFIDENCE:g} % confidence at most {100 * model.beyond:.2g} % of the box "
            "exceeds it"
        )
        where = (
            ""
            if self.answered == 1.0
            else f" in {self.answered:.2%} of the box, and the model refuses the rest"
        )
        return "; ".join(
            [
                f"{target} is met{where}, {model.known}",
                *([] if math.isnan(model.beyond) else [sure]),
                spent,
            ]
        )

    def _row(self, number: int, item: Tried) -> tuple[str, ...]:
        outcome = item.outcome
        if outcome in self.reasons:
            outcome = f"{outcome.split(':')[0]} ({self.reasons.index(outcome) + 1})"
        return (
            "->" if number == self.chosen else "",
            item.method,
            item.setting,
            str(item.full_answers),
            "-" if math.isnan(item.seconds) else f"{item.seconds:.3g} s",
            "-" if math.isnan(item.query) else f"{1e3 * item.query:.3g} ms",
            *(f"{item.errors[name]:.2g}" if name in item.errors else "-" for name in self.wish.of),
            item.known or "-",
            outcome,
        )

    def described(self) -> dict[str, Any]:
        """The record as plain values, for a report."""
        return asdict(self) | {"met": self.met, "verdict": self.verdict}


def share_beyond(count: int) -> float:
    """Largest share of the box that may exceed a limit, with confidence.

    None of so many random points does.

    With a larger share p, the probability (1 - p)^count of none in ``count`` points would be below
    1 - CONFIDENCE.
    """
    return 1.0 - (1.0 - CONFIDENCE) ** (1.0 / count)
