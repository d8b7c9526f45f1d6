"""Advice of a report: the method that a scene should use, from the measurements."""

from __future__ import annotations

import math
from typing import NamedTuple

from hhr_dolfinx.plugins.studies.measure import Report

EQUALLY_ACCURATE = 1e-9
"""Relative force error below which methods count as equally accurate."""


class Advice(NamedTuple):
    """Method of an advice, ``condensed``, ``hhr`` or ``fom_best``, and its reason in words."""

    method: str
    text: str


def advice(report: Report) -> Advice:
    """Method for an elastic scene."""
    if report["work_precision"][0]["method"] == "condensed":
        return advice_condensed(report)
    if report["times"]["condensed_full"] is None:
        return advice_alone(report)
    return (
        advice_varying(report) if "offline_condensed" in report["times"] else advice_exact(report)
    )


def advice_exact(report: Report) -> Advice:
    """Exact condensation, unless it is much slower than the reduced model.

    It has no reduction error.
    """
    times = report["times"]
    error = report["errors"]["dual_full_floored"]
    reduced = times["online_full"]["median"]
    median, high, most = (percent(error[name]) for name in ("median", "p95", "max"))
    accuracy = f"force errors {median} median, {high} at 95 %, {most} at most"
    exact = times["condensed_full"]["median"]
    figures = (
        f"displacements and forces everywhere take {in_words(exact)} by exact condensation and "
        f"{in_words(reduced)} by the hyper-reduced model ({accuracy})"
    )
    if exact <= 3 * reduced:
        return Advice(
            "condensed",
            f"Use exact condensation while the stiffness stays constant: {figures}. "
            "Use the hyper-reduced model where few queries need the displacement field, or memory "
            "is short.",
        )
    text = (
        f"Use the hyper-reduced model: {figures}. "
        "Use exact condensation where no error can be afforded."
    )
    return Advice("hhr", text)


def advice_alone(report: Report) -> Advice:
    """Hyper-reduced or full model, for scenes without condensation."""
    times = report["times"]
    error = report["errors"]["dual_full_floored"]
    reduced = times["online_forces"]["median"]
    best = times["fom_best"]["median"]
    return Advice(
        "hhr" if reduced < best else "fom_best",
        f"Use {'the hyper-reduced model' if reduced < best else 'the full order'}: "
        f"forces take {in_words(reduced)} by the hyper-reduced model and {in_words(best)} by the "
        f"best full order (force errors {percent(error['median'])} median, "
        f"{percent(error['max'])} at most). No condensation is built in for this scene.",
    )


def advice_condensed(report: Report) -> Advice:
    """Condensed or full model, for scenes without hyper-reduction."""
    times = report["times"]
    error = report["errors"]["dual_full_floored"]
    reduced, best = (times[name]["median"] for name in ("online_forces", "fom_best"))
    (reason,) = [entry["why"] for entry in report["skipped"] if entry["stage"] == "hyper-reduction"]
    pays = report["break_even"]["forces"]
    after = "never pays" if pays is None else f"pays after {pays:.0f} queries"
    return Advice(
        "condensed" if reduced < best else "fom_best",
        f"Use {'condensation' if reduced < best else 'the full order'}: "
        f"forces take {in_words(reduced)} by the condensed model, which {after}, and "
        f"{in_words(best)} by the best full order (force errors {percent(error['median'])} median, "
        f"{percent(error['max'])} at most). Without hyper-reduction: {reason}.",
    )


def advice_varying(report: Report) -> Advice:
    """Method for a scene whose stiffness or shape depends on parameters, by :func:`by_favour`.

    Both are far faster than the full model.
    """
    times = report["times"]
    rows = {row["method"]: row for row in report["work_precision"] if row["setting"] in _OWN}
    names = {"condensed": "interpolated condensation", "HHR": "the hyper-reduced model"}
    # the same product of both: forces on the whole surface
    seconds = {"condensed": times["condensed"]["median"], "HHR": times["online_forces"]["median"]}
    even = report["break_even"]
    after = {"condensed": even.get("forces, condensed"), "HHR": even.get("forces")}

    def figures(method: str) -> str:
        row = rows[method]
        count = after[method]
        paid = "never pays" if count is None else f"pays after {count:.0f} queries"
        ratio = times["fom_best"]["median"] / seconds[method]
        return (
            f"{in_words(seconds[method])} for the forces, {ratio:.0f} times the best full order, "
            f"errors {row['dual_full_floored']:.1e} median and "
            f"{row['dual_full_floored_max']:.1e} at most, and {paid}"
        )

    favoured, *alternatives = by_favour(
        {name: rows[name] for name in names if name in rows}, seconds
    )
    sentence = f"Use {names[favoured]}: {figures(favoured)}."
    for alternative in alternatives:
        sentence += f" {names[alternative].capitalize()}: {figures(alternative)}."
    sentence += (
        " The hyper-reduced model is for contact conditions by the thousand, and where operators "
        "do not interpolate."
    )
    return Advice(favoured.lower(), sentence)


TRAINING_STAGES = ("full_order", "snapshots", "held_out")
"""Stages of a training, which all reduced models share."""
_OWN = ("this model", "interpolated")
"""Settings of the rows of the work-precision table that the advice compares."""


def by_favour(rows: dict[str, Report], seconds: dict[str, float]) -> list[str]:
    """Methods, first the one with the smallest largest force error among the fast ones.

    These are within a factor of three of the fastest. One that left a query without an answer has
    an infinite error, and comes after those that did not.

    Args:
        rows: rows of the work-precision table by method.
        seconds: median time of a query by method.

    Returns:
        Names of all methods, the favoured one first.
    """
    sure = [
        method for method in rows if math.isfinite(rows[method]["dual_full_floored_max"])
    ] or list(rows)
    close = [
        method
        for method in sure
        if seconds[method] <= 3 * min(seconds[candidate] for candidate in sure)
    ]
    # round-off errors count as equal, and then the fastest comes first
    favoured = min(
        close,
        key=lambda method: (
            max(rows[method]["dual_full_floored_max"], EQUALLY_ACCURATE),
            seconds[method],
        ),
    )
    return [favoured, *(method for method in rows if method != favoured)]


def percent(value: float) -> str:
    """A fraction in per cent with two digits, however small."""
    return f"{100 * value:.2g} %"


def in_words(value: float) -> str:
    """Seconds with a suitable unit."""
    for unit, size in (("us", 1e-6), ("ms", 1e-3)):
        if value < 1000 * size:
            return f"{value / size:.2f} {unit}"
    return f"{value:.2f} s"
