"""Formulas in UFL as straight-line programs: numbers in a file, evaluated without UFL and
DOLFINx; loops that numba compiles.
"""

from hhr_dolfinx.registry import Plugin

_PROGRAM = "hhr_dolfinx.plugins.ufl_programs.program"

PLUGIN = Plugin(
    name="ufl_programs",
    classes={_PROGRAM: "Program"},
    tools={"compiled": "hhr_dolfinx.plugins.ufl_programs.compiled:compiled"},
)
