"""Rigid obstacles that are curved, whose place and size may depend on parameters."""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.obstacles"
_PAIRINGS = {
    f"{_HERE}.rounds": "Circle Cone Cylinder Sphere",
    f"{_HERE}.drawn": "Profile RigidMesh",
}

PLUGIN = Plugin(
    name="obstacles",
    needs=("nonmatching",),
    public=_PAIRINGS,
    parts={"pairings": _PAIRINGS},
    classes={
        f"{_HERE}.rigid": "Distances",
        f"{_HERE}.rounds": "Quadric",
        f"{_HERE}.drawn": "Facets",
    },
    switches={f"{_HERE}.switches": "circle moving_circle cone profile rigid_mesh"},
)
