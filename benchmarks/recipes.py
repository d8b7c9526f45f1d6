"""Recipes at random and what becomes of them, for ``random_recipes.py``."""

import re
import warnings
from collections import Counter
from typing import Any

import numpy as np

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import summary
from hhr_dolfinx.errors import HHRError, StabilityWarning
from hhr_dolfinx.plugins.studies.measure import References
from hhr_dolfinx.study.training.train import Training

REQUIRED, RIGHT = {"p95": 0.1, "max": 0.3}, {"p95": 0.03, "max": 0.1}
"""Force errors that a model accepted in silence must not exceed.

Those below which a warning was needless.
"""


def recipe(rng: np.random.Generator) -> hhr.Recipe:
    """A recipe that is allowed, be it sensible or not."""
    tolerance, layers = 10 ** rng.uniform(-13, -2), int(rng.integers(5))
    extended = rng.choice([None, tolerance * 10 ** rng.uniform(-4, 0)])
    dual = rng.choice([None, 10 ** rng.uniform(-9, -1)])
    relative = bool(rng.integers(2))
    domain = hhr.Rid(layers, layers + 2 * int(rng.integers(2)))
    enrichment = hhr.Enrich(30 ** rng.random())
    plain = hhr.Pod(tolerance, relative)
    forces = () if dual is None else (hhr.ForceDeim(dual, relative),)
    nodes = (hhr.Deim(plain), *forces, hhr.LoadNodes())
    return hhr.Recipe(
        plain if extended is None else hhr.Pod(extended, relative), nodes, domain, enrichment
    )


def judged(training: Training, drawn: hhr.Recipe, references: References) -> dict[str, Any]:
    """What a user is told of a model, and how wrong its forces are on the whole surface."""
    row = {name: value for name, value in drawn.described().items() if name != "trust"}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", StabilityWarning)
        try:
            model = training.build(drawn)
        except HHRError as refused:
            return {**row, "outcome": "refused", "said": [str(refused)], "p95": None, "max": None}
    said = [str(item.message) for item in caught if issubclass(item.category, StabilityWarning)]
    errors = summary(references.errors(model).values["dual_full_floored"])
    row |= {"outcome": "warned" if said else "accepted", "said": said}
    return {**row, "p95": errors["p95"], "max": errors["max"]}


def within(row: dict, limits: dict) -> bool:
    """Whether errors are within limits."""
    return all(row[name] <= limit for name, limit in limits.items())


def summed_up(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Counts of outcomes, the worst that was accepted in silence, and how many warnings were right
    or needless.
    """
    outcomes = {
        name: [row for row in rows if row["outcome"] == name]
        for name in ("accepted", "warned", "refused")
    }
    accepted, warned = outcomes["accepted"], outcomes["warned"]
    return {
        **{name: len(found) for name, found in outcomes.items()},
        "silently_wrong": sum(not within(row, REQUIRED) for row in accepted),
        **{
            f"worst_{name}": max((row[name] for row in accepted), default=None) for name in REQUIRED
        },
        "rightly_warned": sum(not within(row, REQUIRED) for row in warned),
        "needlessly_warned": sum(within(row, RIGHT) for row in warned),
    }


def warnings_given(rows: list[dict]) -> dict[str, int]:
    """How often each warning was given; a message begins with what it is about."""
    told = [text for row in rows if row["outcome"] == "warned" for text in row["said"]]
    return dict(Counter(re.split(" = |, ", text)[0] for text in told))
