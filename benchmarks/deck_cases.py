"""Scenes in Python beside the decks: press fits by every pairing, LE10 in other formats, and faults that were found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

@dataclass(frozen=True)
class Case:
    """A scene: ``run`` gives its number; a text as ``reference`` is part of a sentence that refuses it."""

    source: str
    kind: str
    run: Callable[[Path], float]
    quantity: str
    reference: float | str
    by: str = "closed form"
    within: float = 0.01


CASES: tuple[Case, ...] = ()
