"""Parts of a user's own for the benchmark of composition: the templates of extensions, a system.

They are registered as plug-ins while the benchmark runs, with the switches below.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from hhr_dolfinx import registry
from hhr_dolfinx.geometries.two_blocks import FIRST, side
from hhr_dolfinx.pairings.obstacle import Obstacle
from hhr_dolfinx.registry import Plugin

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.conformance.draft import SceneDraft

ROOT = Path(__file__).parents[1]
PLACES = ("extension_templates/contact_law", "extension_templates/law", "tests")
FOLDERS = [str(ROOT / name) for name in PLACES]
"""Folders of the parts: two templates, and the toys of the tests."""


def own_contact_law(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """Wear of a contact with a plane, which remembers: the template of contact laws."""
    from my_contact_law import Wear

    flank, offset = side(FIRST, 0, False), 100.0 if neutral else -0.9995
    wears = Wear(0.0 if neutral else 0.5)
    return draft.with_obstacle(Obstacle(flank, draft.vector(-1.0, 0.0), offset, law=wears))


def own_body_law(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """Linear creep: the template of laws of bodies."""
    from my_law import MyLaw

    law = MyLaw(1e12 if neutral else 20.0)
    return (draft.of_simplices() if neutral else draft).with_body_law(law)


def own_system(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """Bodies on a foundation whose stiffness is a parameter: the toy of systems."""
    from toy_system import Parted

    draft = draft.with_parameter("k", 0.0, 0.5, 0.0 if neutral else 0.2)
    return replace(draft, system=Parted)


@contextmanager
def registered() -> Iterator[None]:
    """Register the templates, with these switches, and the toy beside the installed plug-ins."""
    sys.path[:0] = FOLDERS
    import my_contact_law
    import my_law

    before = registry.installed
    own = (
        replace(my_contact_law.PLUGIN, switches={__name__: "own_contact_law"}),
        replace(my_law.PLUGIN, switches={__name__: "own_body_law"}),
        Plugin(name="toy_system", switches={__name__: "own_system"}),
    )
    known = dict(before())
    every = {**known, **{one.name: one for one in own if known.keys() >= set(one.needs)}}
    try:
        registry.installed = lambda: every  # type: ignore[assignment]
        _forget()
        yield
    finally:
        registry.installed = before
        _forget()
        for folder in FOLDERS:
            sys.path.remove(folder)


def _forget() -> None:
    """Clear what the registry keeps of the plug-ins."""
    for cached in (registry.facet, registry.memories, registry.asked_of_answers):
        cached.cache_clear()
