"""Columns of outputs of models with heat, for tables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple


class OutputColumn(NamedTuple):
    """A column of a table."""

    name: str
    unit: str


@dataclass(frozen=True)
class OutputColumns:
    """Outputs of a model with heat, which has no estimates of errors as it has no error."""

    items: tuple[OutputColumn, ...]


@dataclass(frozen=True)
class HeatFields:
    """Outputs and estimates of a model, as tables read them, see
    :class:`~hhr_dolfinx.models.answer.ModelFields`.
    """

    functionals: OutputColumns
    output_bound: None = None
    estimated: str = ""
