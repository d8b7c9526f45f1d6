"""A switch of outputs of the stress."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from hhr_dolfinx.geometries.two_blocks import FIRST
from hhr_dolfinx.plugins.stress.outputs import ElasticEnergy, VonMises

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.conformance.draft import Draft


def stress_outputs(draft: Draft, neutral: bool) -> Draft:
    """Von Mises' stress and the elastic energy, which change no answer."""
    outputs = VonMises("mises", FIRST), ElasticEnergy("energy")
    return replace(draft, outputs=(*draft.outputs, *outputs))
