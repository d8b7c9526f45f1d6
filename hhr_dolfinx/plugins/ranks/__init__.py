"""Several ranks: full models that they have together, each with some rows, and trainings that they
share.
"""

from __future__ import annotations

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.ranks"

PLUGIN = Plugin(
    name="ranks",
    tools={
        "all_rows": f"{_HERE}.gathered:gathered",
        "expected_in_space": f"{_HERE}.expected:expected_in_space",
        "group": f"{_HERE}.group:Ranks",
    },
)
