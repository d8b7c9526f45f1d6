"""Checks of scenes before they are solved, and of the installation; the error of a mesh.

Figures and fields.
"""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.checks"

PLUGIN = Plugin(
    name="checks",
    public={f"{_HERE}.fields": "write_fields", f"{_HERE}.mesh_error": "MeshError mesh_error"},
    commands={"check": f"{_HERE}.commands:check"},
    tools={
        "drawing": f"{_HERE}.figures:figure_of",
        "fields": f"{_HERE}.fields:write_fields",
        "mesh_error": f"{_HERE}.mesh_error:mesh_error",
    },
)
