"""Checks of scenes before they are solved, with a picture of what was found, and of the
installation; the error of a mesh.
"""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.scene_checks"

PLUGIN = Plugin(
    name="scene_checks",
    public={f"{_HERE}.mesh_error": "MeshError mesh_error"},
    commands={"check": f"{_HERE}.commands:check"},
    tools={"mesh_error": f"{_HERE}.mesh_error:mesh_error"},
)
