"""Scores of reduced models of any kind on a data set of contact problems, by files alone."""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.bench"

PLUGIN = Plugin(
    name="bench",
    public={f"{_HERE}.score": "score_submission"},
    commands={"bench": f"{_HERE}.commands:bench"},
)
