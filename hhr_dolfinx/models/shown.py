"""One line for a console, and a small table for a notebook, of values that hold large arrays."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

SHOWN_NUMBERS = 8
"""Most numbers of a point that are shown."""


def point_of(values: Sequence[float] | np.ndarray, names: Sequence[str] = ()) -> str:
    """Text of a point of the box: ``push=3e+07, pull=1e+07``.

    Args:
        values: parameters, (P,).
        names: names of the parameters, if they are known.
    """
    numbers = [f"{float(value):.6g}" for value in list(values)[:SHOWN_NUMBERS]]
    ellipsis = ["..."] if len(values) > SHOWN_NUMBERS else []
    if len(names) == len(values):
        return ", ".join(
            [*(f"{name}={number}" for name, number in zip(names, numbers, strict=False)), *ellipsis]
        )
    return f"({', '.join([*numbers, *ellipsis])})"


def counted(number: int, what: str) -> str:
    """A number with its noun, in the plural if necessary.

    Args:
        number: how many.
        what: noun in the singular.
    """
    return f"{number} {what}{'' if number == 1 else 's'}"


def line(title: str, facts: Mapping[str, str]) -> str:
    """Line of ``repr``: the title and the facts.

    Args:
        title: name of the value.
        facts: facts by name.
    """
    return f"<{title}: {', '.join(facts.values())}>"


def table(title: str, facts: Mapping[str, str]) -> str:
    """HTML table for notebooks.

    Args:
        title: name of the value.
        facts: facts by name.
    """
    rows = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in facts.items()
    )
    return f"<table><caption>{escape(title)}</caption>{rows}</table>"


class Shown:
    """A value that prints as one line, and as a table in a notebook.

    Nothing is computed for either.
    """

    @abstractmethod
    def facts(self) -> dict[str, str]:
        """Short facts, by their names in a table; each is readable without its name in a line."""

    def __repr__(self) -> str:
        return line(type(self).__name__, self.facts())

    def _repr_html_(self) -> str:
        return table(type(self).__name__, self.facts())
