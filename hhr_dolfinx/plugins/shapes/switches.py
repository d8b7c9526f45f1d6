"""A switch of shapes that are parameters."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from hhr_dolfinx.formulas import Formula
from hhr_dolfinx.geometries.two_blocks import FIRST
from hhr_dolfinx.plugins.shapes.shape import Shape

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.conformance.draft import SceneDraft


def shape(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """A crown of the lower block.

    On distorted quadrilaterals the rules of shapes and of constant bodies differ.

    Args:
        draft: the scene so far.
        neutral: add a value that changes nothing.
    """
    draft = (draft.of_simplices() if neutral else draft).with_parameter(
        "crown", -0.007, 0.01, 0.0 if neutral else 0.006
    )
    along, up, *further = draft.coordinates
    texts = (along, f"{up} - crown * {up} * ({along} - 2.5)**2", *further)
    crowned = Shape(FIRST, tuple(Formula(text) for text in texts))
    return replace(draft, shapes=(*draft.shapes, crowned))
