"""A model with heat as a C header: that of its mechanical model, and ``heat.h``."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib import resources

import numpy as np

from hhr_dolfinx.formulas import Scalar
from hhr_dolfinx.plugins.contact_heat.parts import HeatParts
from hhr_dolfinx.plugins.exporters.c_header import (
    Tree,
    c_header,
    declared_array,
    declared_function,
    declared_texts,
)
from hhr_dolfinx.plugins.pages.kernel import prefixed
from hhr_dolfinx.plugins.pages.packing import steps_of

UNIFORM_START_NAME = "start temperature"
"""Last parameter of a header of heat in time."""


@dataclass(frozen=True, eq=False)
class HeatData:
    """A model with heat, as its header has it."""

    parts: HeatParts
    pairs: np.ndarray  #: contact of each condition, (m,)
    outputs: list[str]  #: names of the outputs of heat, after those of the scene
    #: matrices of contact and heat by name, see ``heat.h``; of heat in time those of modes too
    matrices: dict[str, np.ndarray]

    @property
    def modes(self) -> int:
        """Number of the modes of heat in time; 0 of steady heat."""
        return len(self.matrices.get("rates", ()))


def heat_header(data: HeatData, name: str) -> tuple[str, Tree]:
    """Text of a header in C, and its names, units and ends.

    Args:
        data: the model.
        name: identifier in C that the names of the header begin with.

    Raises:
        NotOfferedError: for a model that is too large to be compiled.
    """
    names = data.parts.parameters.names
    count = len(names)
    mechanics, tree = c_header(data.parts.mechanical, f"{name}_mechanics", bounded=count)
    starts = [UNIFORM_START_NAME] if data.modes else []
    largest = [sys.float_info.max] * len(starts)
    tree = tree | {
        "names": [*names, *starts],
        "lower": [*tree["lower"][:count], *(-end for end in largest)],
        "upper": [*tree["upper"][:count], *largest],
        "path": {"fixed": [count]} if starts else None,
        "outputs": [*tree["outputs"], *({"name": flow, "unit": ""} for flow in data.outputs)],
    }
    text = (resources.files(__package__) / "heat.h").read_text(encoding="utf-8")
    text = text.replace("MODEL_TITLE", name).replace("/*DATA*/", "\n".join(_declared(data, tree)))
    text = prefixed(text, {"model": name, "mechanics": f"{name}_mechanics"})
    comment, end, rest = text.partition("*/\n")  # how to use it comes before what it uses
    return f"{comment}{end}{mechanics}{rest}", tree


def _declared(data: HeatData, tree: Tree) -> Iterator[str]:
    """Declarations of sizes, names, arrays and formulas."""
    parts = data.parts
    sliding = parts.sliding
    sizes = {
        "PARAMETERS": len(tree["names"]),
        "GIVEN": len(parts.parameters.names),
        "OUTPUTS": len(tree["outputs"]),
        "BODIES": len(data.matrices["supplied"]),
        "MODES": data.modes,
        "SLIDING": sliding.conditions.size,
        "COORDINATES": sliding.places.shape[1],
        "SUPPLIES": len(parts.conduction.amplitudes),
        "CONDUCTING": parts.contacts.size,
        "RUBBING": sliding.contacts.size,
    }
    yield from (f"#define MODEL_{name} {size}" for name, size in sizes.items())
    yield declared_texts("parameter_names", tree["names"])
    yield declared_texts("output_names", [output["name"] for output in tree["outputs"]])
    yield declared_texts("output_units", [output["unit"] for output in tree["outputs"]])
    slid = data.pairs[sliding.conditions]
    arrays = data.matrices | parts.outputs_by_condition(data.pairs)
    arrays |= {
        "lower": np.array(tree["lower"]),
        "upper": np.array(tree["upper"]),
        "sliding": sliding.conditions,
        "places": sliding.places,
    }
    yield from (declared_array(name, values) for name, values in arrays.items())
    yield from _formulas("supply", parts.conduction.amplitudes)
    conductances = dict(zip(parts.contacts.tolist(), parts.conductances, strict=True))
    yield from _formulas("conductance", [conductances.get(pair) for pair in data.pairs.tolist()])
    factors = dict(zip(sliding.contacts.tolist(), sliding.factors, strict=True))
    yield from _formulas("friction", [factors[pair] for pair in slid.tolist()])


def _formulas(name: str, scalars: Iterable[Scalar | None]) -> Iterator[str]:
    """Functions, each once, and an array of them; 0 for None."""
    functions: dict[str, str] = {}
    listed = []
    for scalar in scalars:
        if scalar is None:
            listed.append("0")
            continue
        if scalar.text not in functions:
            functions[scalar.text] = f"model_{name}_{len(functions)}"
            yield declared_function(functions[scalar.text], steps_of(scalar) or [])
        listed.append(functions[scalar.text])
    yield f"static const model_function model_{name}[] = {{{', '.join(listed) or '0'}}};"
