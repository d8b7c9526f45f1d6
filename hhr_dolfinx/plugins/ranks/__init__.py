"""Several ranks: full models that they have together, each with some rows, and trainings that they share."""

from __future__ import annotations

from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(name="ranks", tools={"group": "hhr_dolfinx.plugins.ranks.group:Ranks"})
