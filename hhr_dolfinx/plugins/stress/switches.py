"""A switch of outputs of the stress."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from hhr_dolfinx.geometries.two_blocks import FIRST
from hhr_dolfinx.plugins.stress.outputs import ElasticEnergy, VonMises

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.conformance.draft import SceneDraft


def energy(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """The elastic energy, which changes no answer.

    Args:
        draft: the scene to extend.
        neutral: without effect, since an output changes no answer.
    """
    return replace(draft, outputs=(*draft.outputs, ElasticEnergy("energy")))


def von_mises(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """Von Mises' stress of the lower block, which changes no answer.

    Args:
        draft: the scene to extend.
        neutral: without effect, since an output changes no answer.
    """
    return replace(draft, outputs=(*draft.outputs, VonMises("mises", FIRST)))
