"""Interfaces to other programs: UM-Bridge, Dakota, OpenTURNS, pyMOR, Tesseract; one file each."""

from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(
    name="doors",
    commands={
        "serve": "hhr_dolfinx.plugins.doors.commands:serve",
        "dakota": "hhr_dolfinx.plugins.doors.commands:dakota",
    },
)
