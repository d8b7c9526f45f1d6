"""Pictures of scenes, answers and histories, and their fields for other programs: VTU files,
PyVista.
"""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.plots"

PLUGIN = Plugin(
    name="plots",
    needs=("scene_checks",),
    public={
        f"{_HERE}.fields": "write_fields",
        f"{_HERE}.surface_fields": "with_surface_fields",
    },
    classes={f"{_HERE}.surface_fields": "SurfaceFields SingleSurfaceFields"},
    answers={
        "gaps": f"{_HERE}.contact_fields:gaps",
        "statuses": f"{_HERE}.contact_fields:statuses",
        "to_pyvista": f"{_HERE}.grids:to_pyvista",
    },
    tools={
        "curves": f"{_HERE}.curves:figure_of_history",
        "drawing": f"{_HERE}.figures:figure_of",
        "fields": f"{_HERE}.fields:write_fields",
        "surface": f"{_HERE}.surface_fields:with_surface_fields",
    },
)
