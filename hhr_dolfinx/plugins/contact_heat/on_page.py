"""Steady heat on a page: ``heat.h`` beside the kernel of contact, and temperatures to draw."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.plugins.pages.kernel import page_sources, prefixed
from hhr_dolfinx.plugins.pages.laws import Laws
from hhr_dolfinx.plugins.pages.layout import LayoutWriter, layouts, records_in
from hhr_dolfinx.plugins.pages.packing import (
    BASE64,
    MODE_BYTES,
    Json,
    Packed,
    modes_of,
    packed_levels,
    steps_of,
)
from hhr_dolfinx.plugins.pages.records import RecordedFormula, Struct

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from hhr_dolfinx.models.condensed import CondensedModel
    from hhr_dolfinx.plugins.contact_heat.heated import HeatAnswer, HeatedModel
    from hhr_dolfinx.plugins.pages.scenery import Scenery

HEAT_KERNEL = Path(__file__).with_name("heat.wasm")
"""The compiled kernel of contact with heat."""
WARMTH = 1e-4
"""Relative error of temperatures less their mean by truncation of modes: their largest error over
their range is what one sees.
"""
WARM_ANSWERS = 200
"""Answers from which modes of temperatures are computed."""


def heat_sources() -> dict[str, str]:
    """Sources of that kernel, see :func:`~hhr_dolfinx.plugins.pages.kernel.page_sources`."""
    text = "".join(map(_file, ("sizes.h", "heat.h", "page.c")))
    return page_sources([], Laws(None, ()), prefixed(text, {"model": "heat", "mechanics": "model"}))


def _file(name: str) -> str:
    return (resources.files(__package__) / name).read_text(encoding="utf-8")


@dataclass(frozen=True, eq=False)
class HeatOnPage:
    """See :class:`~hhr_dolfinx.plugins.pages.added.AddedToPage`.

    Attributes:
        model: model of steady heat.
        solve: its answer to a point, from contact without heat; not balanced where it has none.
    """

    kind: ClassVar[str] = "heat"

    model: HeatedModel
    solve: Callable[[np.ndarray], HeatAnswer]

    @property
    def script(self) -> str:
        """Script of the page."""
        return _file("heat.js")

    @property
    def code(self) -> bytes:
        """Kernel of the page."""
        return HEAT_KERNEL.read_bytes()

    @property
    def contact(self) -> CondensedModel:
        """Contact under heat flows and temperatures that are given."""
        return self.model.mechanical

    @property
    def size(self) -> int:
        """Bytes of its arrays as text, without pictures."""
        return int(8 * BASE64 * sum(matrix.size for matrix in self.model.coupling.values()))

    @property
    def pictured(self) -> HeatPictured:
        """The model as pictures read it."""
        return HeatPictured(self.model, self.solve)

    def tree(
        self, tree: dict[str, Any], scenery: Scenery, arrays: Packed, room: int
    ) -> dict[str, Json]:
        """See :class:`~hhr_dolfinx.plugins.pages.added.AddedToPage`.

        Args:
            tree: tree of the contact problem, with its kernel.
            scenery: drawn mesh and contact of the scene.
            arrays: packed arrays, to which those of the tree are added.
            room: bytes for all arrays, as text.
        """
        space = self.model.parameters
        outputs = [
            *tree["outputs"],
            *({"name": name, "unit": ""} for name in self.model.flow_outputs),
        ]
        count = len(space.names)
        kernel = tree["kernel"]
        largest = sys.float_info.max  # the kernel solves for any heat flow
        for name, end in (("lower", -largest), ("upper", largest)):
            ends = kernel["data"][list(layouts()["data"]).index(name)]
            ends[count:] = [end] * (len(ends) - count)
        return {
            "names": list(space.names),
            "lower": list(map(float, space.lower)),
            "upper": list(map(float, space.upper)),
            "outputs": outputs,
            "kernel": kernel | self._kernel(kernel, len(outputs), arrays),
            "heat": {
                "supplies": len(self.model.conduction.amplitudes),
                "temperature": self._temperature(scenery, arrays, room),
            },
        }

    def _kernel(self, kernel: dict[str, Any], outputs: int, arrays: Packed) -> dict[str, Json]:
        """Records of heat in the kernel."""
        model = self.model
        parts = model.parts
        sliding = parts.sliding
        records = {f"heat_{name}": fields for name, fields in records_in(_file("sizes.h")).items()}
        writer = LayoutWriter(records, list(kernel["formulas"]))
        sizes = {
            "parameters": len(model.parameters.names),
            "outputs": outputs,
            "bodies": len(model.conduction.supplied),
            "sliding": sliding.conditions.size,
            "coordinates": sliding.places.shape[1],
            "supplies": len(model.conduction.amplitudes),
            "conducting": parts.contacts.size,
            "sliding_contacts": sliding.contacts.size,
        }
        conductances = dict(zip(parts.contacts.tolist(), parts.conductances, strict=True))
        factors = dict(zip(sliding.contacts.tolist(), sliding.factors, strict=True))
        slid = model.pairs[sliding.conditions]
        numbers = parts.outputs_by_condition(model.pairs) | {"sliding": sliding.conditions}
        data: dict[str, Any] = {
            "lower": np.array(model.parameters.lower, dtype=float),
            "upper": np.array(model.parameters.upper, dtype=float),
            "supply": _recorded(model.conduction.amplitudes),
            "conductance": _recorded([conductances.get(pair) for pair in model.pairs.tolist()]),
            "friction": _recorded([factors[pair] for pair in slid.tolist()]),
        }
        data |= {
            name: arrays.put(f"heat_{name}", matrix)
            for name, matrix in {**model.coupling, "places": sliding.places}.items()
        }
        data |= {name: arrays.put(f"heat_{name}", rows, "<i4") for name, rows in numbers.items()}
        heat = {
            "sizes": writer.record(Struct("heat_sizes", sizes)),
            "data": writer.record(Struct("heat_data", data)),
        }
        layouts = {name: list(fields.values()) for name, fields in records.items()}
        return {
            "layouts": kernel["layouts"] | layouts,
            "formulas": writer.formulas,
            "heat": heat,
        }

    def _temperature(self, scenery: Scenery, arrays: Packed, room: int) -> dict[str, Json] | None:
        """Mean temperature, the mean of answers over it, modes of what is left at the drawn nodes,
        and their map from one, supplies, heat flows, heat of friction and levels; None without
        room or without answers.
        """
        conduction = self.model.conduction
        nodes = scenery.nodes
        space = self.model.parameters
        answers = [self.solve(point) for point in space.random(WARM_ANSWERS, 0)]
        seen = [answer.temperature()[nodes] for answer in answers if answer.converged]
        numbers = int(min(MODE_BYTES, room - arrays.size) / (2 * BASE64)) - nodes.size
        if not seen or numbers < 0:
            return None
        mean = np.mean(seen, axis=0)
        offset = float(mean.mean())
        modes = modes_of(np.array(seen).T - mean[:, None], WARMTH, numbers)
        if modes is None:  # of temperatures that are the same everywhere
            modes = np.zeros((nodes.size, 0))
        columns = (conduction.temperatures, -conduction.per_heat, conduction.levels)
        by = np.hstack([-modes.T @ mean[:, None], *(modes.T @ column[nodes] for column in columns)])
        first = np.zeros((1, by.shape[1]))
        first[0, 0] = 1.0
        rows = np.vstack([mean - offset, modes.T])
        tree = {"kind": "linear", "heat": arrays.put("heat_by", np.vstack([first, by]))}
        return tree | {"offset": offset} | packed_levels("heat_modes", rows, arrays)


def _recorded(scalars: Any) -> list[RecordedFormula]:
    return [RecordedFormula(steps_of(scalar)) for scalar in scalars]


@dataclass(eq=False)
class HeatPictured:
    """A model with heat as pictures read a condensed model.

    Attributes:
        model: the model.
        solve: see :class:`HeatOnPage`.
    """

    model: HeatedModel
    solve: Callable[[np.ndarray], HeatAnswer]

    equilibrium: ClassVar[None] = None

    def __post_init__(self) -> None:
        mechanical = self.model.mechanical
        self.parameters = self.model.parameters
        self.fields = mechanical.fields
        self.law = mechanical.law
        self.eliminated = mechanical.eliminated
        self.dimension = mechanical.dimension
        self.conditions = mechanical.conditions

    def solve_many(self, points: np.ndarray, **how: Any) -> Iterator[Answer]:
        """Answers of the contact problem under heat, where there is a balance.

        Args:
            points: parameters of the user, (n, P).
            **how: not read.
        """
        for point in points:
            answer = self.solve(point)
            if answer.converged:
                yield answer.mechanical
