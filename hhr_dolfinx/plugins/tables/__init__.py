"""Answers to many parameters: arrays, tables in files, data frames.

And models of the matrices of other programs.
"""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.tables"

PLUGIN = Plugin(
    name="tables",
    public={
        f"{_HERE}.batch": "answer_points",
        f"{_HERE}.frames": "to_pandas to_xarray",
        f"{_HERE}.matrices": "condense_matrices",
        f"{_HERE}.tables": "answer_table read_points write_answers",
    },
    commands={"answer": f"{_HERE}.commands:answer"},
)
