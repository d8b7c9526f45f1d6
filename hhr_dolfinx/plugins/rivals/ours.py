"""Rivals of our own: the thesis' recipe, and local models."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

from hhr_dolfinx import registry
from hhr_dolfinx.plugins.studies.study import Rival
from hhr_dolfinx.reduction.recipe import Deim, Enrich, ForceDeim, LoadNodes, Recipe

if TYPE_CHECKING:
    from hhr_dolfinx.study.training.train import Training

NODES = Deim(), ForceDeim(1e-4), LoadNodes()


def thesis(training: Training) -> Iterator[Rival]:
    """HHR by the steps of the thesis, with DEIM of forces, section 3.5.2."""
    for tolerance in (1e-6, 1e-8):
        recipe = Recipe.thesis(tolerance, nodes=NODES, enrichment=Enrich(10.0))
        made = partial(training.build, recipe, checked=False)
        yield Rival("HHR of the thesis", f"POD at {tolerance:g}", made)


def local(training: Training) -> Iterator[Rival]:
    """Local models whose number is found, chapter 4; none without their plug-in."""
    if "local" in registry.named("kinds"):
        yield Rival("local models", "by splitting", lambda: training.local(checked=False))
