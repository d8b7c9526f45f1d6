"""Mesh files of code_aster, FEBio, LS-DYNA, Kratos, I-DEAS (``.unv``), MED, Nastran (``.bdf``) and
VTK (``.vtu``).
"""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.mesh_formats"

PLUGIN = Plugin(
    name="mesh_formats",
    readers={
        ".mail": f"{_HERE}.code_aster:read_mail",
        ".feb": f"{_HERE}.febio:read_feb",
        ".k": f"{_HERE}.ls_dyna:read_keywords",
        ".dyn": f"{_HERE}.ls_dyna:read_keywords",
        ".key": f"{_HERE}.ls_dyna:read_keywords",
        ".mdpa": f"{_HERE}.kratos:read_mdpa",
        ".vtu": f"{_HERE}.vtu:read_vtu",
        **dict.fromkeys((".med", ".mmed", ".rmed"), f"{_HERE}.med:read_med"),
        ".unv": f"{_HERE}.ideas:read_unv",
        ".bdf": f"{_HERE}.nastran:read_nastran",
        ".nas": f"{_HERE}.nastran:read_nastran",
    },
)
