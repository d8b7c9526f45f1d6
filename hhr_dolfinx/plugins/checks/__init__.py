"""Checks of scenes before they are solved, and of the installation; the error of a mesh.

Figures and fields.
"""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.checks"

PLUGIN = Plugin(
    name="checks",
    public={f"{_HERE}.fields": "write_fields", f"{_HERE}.mesh_error": "MeshError mesh_error"},
    commands={"check": f"{_HERE}.commands:check"},
    answers={
        "gaps": f"{_HERE}.contact_fields:gaps",
        "statuses": f"{_HERE}.contact_fields:statuses",
        "to_pyvista": f"{_HERE}.grids:to_pyvista",
    },
    tools={
        "curves": f"{_HERE}.curves:figure_of_history",
        "drawing": f"{_HERE}.figures:figure_of",
        "fields": f"{_HERE}.fields:write_fields",
        "mesh_error": f"{_HERE}.mesh_error:mesh_error",
    },
)
