"""Mesh files of code_aster (``.mail``), FEBio (``.feb``), LS-DYNA (``.k``) and Kratos (``.mdpa``)."""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.mesh_formats"

PLUGIN = Plugin(
    name="mesh_formats",
    readers={
        ".mail": f"{_HERE}.code_aster:read_mail",
        ".feb": f"{_HERE}.febio:read_feb",
        ".k": f"{_HERE}.ls_dyna:read_keywords",
        ".key": f"{_HERE}.ls_dyna:read_keywords",
        ".mdpa": f"{_HERE}.kratos:read_mdpa",
    },
)
