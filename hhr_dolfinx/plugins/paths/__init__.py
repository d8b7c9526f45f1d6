"""Load paths: families of them, and training, comparison and commands of answers that depend on
their path.
"""

from __future__ import annotations

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.paths"


PLUGIN = Plugin(
    name="paths",
    public={f"{_HERE}.path_families": "Leg NamedPath PathFamily"},
    commands={"march": f"{_HERE}.commands:march"},
    tools={
        "histories": f"{_HERE}.histories:Paths",
        "queries": f"{_HERE}.queries:training_queries",
    },
)
