"""Bodies that contact alone holds: their rigid motions, the kernel of K, are unknowns of the contact problem."""

from __future__ import annotations

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.floating"

PLUGIN = Plugin(
    name="floating",
    optional=("contact_laws",),
    classes={f"{_HERE}.elimination": "FloatingElimination", f"{_HERE}.interpolated": "MotionsBeside"},
    tools={"kernel": f"{_HERE}.kernel:RigidKernel"},
    switches={f"{_HERE}.switches": "floating"},
)
