"""Data of a kernel as plain values, by which a page lays out records in memory as the C sources
declare them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache

import numpy as np

from hhr_dolfinx.plugins.pages.kernel import kernel_file
from hhr_dolfinx.plugins.pages.packing import Json, Steps
from hhr_dolfinx.plugins.pages.records import Data, Field, KernelData, RecordedFormula, Struct

_TYPEDEF = re.compile(r"typedef struct \{([^{}]*)\} model_(\w+);")
_SCALARS = {"double": "d", "int": "i", "model_function": "i"}
_POINTERS = {"double": "D", "int": "I", "model_function": "I"}


@cache
def layouts() -> dict[str, dict[str, str]]:
    """Codes of the fields of each record, in their order in C.

    ``d`` is a double, ``i`` an int or the number of a formula, ``D`` and ``I`` point to several of
    them, ``R KIND`` to records, and ``r KIND`` is a record inside.
    """
    fields = records_in(kernel_file("kernel.h") + kernel_file("sizes.h"))
    wanted = ["sizes", "data"]
    for kind in wanted:  # which grows
        nested = (code[2:] for code in fields[kind].values() if len(code) > 1)
        wanted += [inner for inner in nested if inner not in wanted]
    return {kind: fields[kind] for kind in wanted}


def records_in(text: str) -> dict[str, dict[str, str]]:
    """Codes of the fields of each record that C sources declare, see :func:`layouts`."""
    code = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    return {kind: dict(_fields(body)) for body, kind in _TYPEDEF.findall(code)}


def _fields(body: str) -> Iterator[tuple[str, str]]:
    for statement in filter(None, map(str.strip, body.split(";"))):
        kind, names = statement.removeprefix("const ").split(maxsplit=1)
        for name in names.split(","):
            plain = name.strip()
            record = kind.removeprefix("model_")
            table, code = (_POINTERS, "R") if plain.startswith("*") else (_SCALARS, "r")
            yield plain.lstrip("*"), table.get(kind, f"{code} {record}")


def encoded(kernel: KernelData) -> dict[str, Json]:
    """Layouts, sizes, data and formulas as plain values; arrays of the page are named."""
    writer = LayoutWriter(layouts(), [])
    sizes = {name.lower(): value for name, value in kernel.sizes.items()}
    return {
        "layouts": {kind: list(fields.values()) for kind, fields in layouts().items()},
        "sizes": {name: sizes.get(name, 0) for name in layouts()["sizes"]},
        "data": writer.record(Struct("data", kernel.data)),
        "formulas": writer.formulas,
    }


class LayoutWriter:
    """Records as plain values; formulas become their numbers.

    Args:
        records: see :func:`layouts`.
        formulas: known formulas, to which further ones are added.
    """

    def __init__(self, records: dict[str, dict[str, str]], formulas: list[Steps]):
        self.records = records
        self.formulas = formulas

    def record(self, record: Struct) -> list[Json]:
        """Values of the fields in their order."""
        return [
            self.value(record.fields.get(name), code)
            for name, code in self.records[record.kind].items()
        ]

    def value(self, value: Field | Data, code: str) -> Json:
        """Plain value of a field with a code of :func:`layouts`."""
        if isinstance(value, RecordedFormula):
            if value.steps is None:
                return 0
            if value.steps not in self.formulas:
                self.formulas.append(value.steps)
            return self.formulas.index(value.steps) + 1
        if isinstance(value, Struct):
            values = self.record(value)
            return values if code.startswith("r") else [values]
        if code.startswith("r"):
            return self.record(Struct(code[2:], {}))
        if isinstance(value, list):
            return [
                self.record(entry) if isinstance(entry, Struct) else self.value(entry, "i")
                for entry in value
            ]
        if isinstance(value, np.ndarray):
            return value.tolist()
        return "Infinity" if value == np.inf else value
