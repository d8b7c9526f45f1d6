"""Laws of contacts beside the unilateral one: histories by increments, and each law on its range of conditions."""

from __future__ import annotations

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.contact_laws"

PLUGIN = Plugin(
    name="contact_laws",
    optional=("inelastic",),
    classes={f"{_HERE}.interface": "Interface Range"},
    facets={"steps": f"{_HERE}.steps:STEPS", "flow_slopes": f"{_HERE}.flow_slopes:FlowSlopes"},
    tools={"laws": f"{_HERE}.interface:joint", "reduced_law": f"{_HERE}.reduction:completed"},
)
