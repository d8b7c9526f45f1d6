"""Contents of a deck in neutral form: readers of all formats make it, and one writer turns it into
a scene.

Sources are file and line, ``deck.inp:12``; numbers have the units of the deck.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

Tag = str | int


@dataclass(frozen=True)
class DeckMaterial:
    """Constants of a material."""

    name: str
    source: str
    young: float
    poisson: float
    law: str = ""  #: law in addition to elasticity as text of Python, empty for an elastic material
    expansion: float | None = None  #: coefficient of linear expansion
    density: float | None = None  #: mass per volume
    conductivity: float | None = None  #: of heat
    specific_heat: float | None = None  #: heat per mass and temperature

    @property
    def capacity(self) -> float | None:
        """Heat per volume and temperature; None if the deck does not have it."""
        if self.density is None or self.specific_heat is None:
            return None
        return self.density * self.specific_heat


@dataclass(frozen=True)
class Section:
    """A body: the material of the cells with a tag."""

    tag: Tag
    material: DeckMaterial
    source: str


@dataclass(frozen=True)
class Support:
    """Imposed displacement ``value`` of a component, 0 to 2, of a set of nodes or a surface."""

    place: Tag
    component: int
    value: float
    source: str


@dataclass(frozen=True)
class DeckLoad:
    """A load or a constraint: ``value`` times the unit load ``text``, Python with ``{}`` for the
    amplitude.
    """

    kind: str  #: proposed name of a parameter, such as ``pressure``
    text: str
    value: float
    source: str


@dataclass(frozen=True)
class Pair:
    """A contact pair ``text``, Python with ``{}`` for its law, and a length that is added to the
    gaps.

    The text of a curved rigid surface has ``{place}`` for its motion. A gap that ``overwrites`` is
    that of all nodes, whatever the mesh has.
    """

    text: str
    friction: float
    source: str
    gap: float = 0.0
    motion: tuple[float, ...] = ()
    origin: tuple[float, ...] = ()  #: place without the motion, empty for zeros
    direction: tuple[float, ...] = ()  #: of the force that is an output, empty for none
    limit: float = math.inf  #: largest shear stress of friction
    curve: str = ""  #: soft contact as text of Python, empty for hard contact
    overwrites: bool = False
    conductance: str = ""  #: of heat, as text of Python; empty for none
    sliding: str = ""  #: heat of friction as text of Python; empty for none


@dataclass(frozen=True)
class DeckHeat:
    """Heat in the bodies of a deck, at the end of its last step."""

    temperatures: tuple[DeckLoad, ...]  #: fixed ones
    supplies: tuple[DeckLoad, ...]  #: fluxes, sources and convection
    starts: Mapping[Tag, float]  #: initial temperature of each body, without thermal strain
    seconds: float  #: duration of the last step; 0 of steady heat


@dataclass(frozen=True)
class Left:
    """A part of a deck that the scene lacks."""

    source: str
    keyword: str
    why: str

    def __str__(self) -> str:
        return f"TODO {self.source} {self.keyword}: {self.why}"


Item = DeckLoad | Support | Pair | Section
"""A part of a deck with a value that a parameter may be."""


@dataclass(frozen=True)
class DeckHistory:
    """Courses of the quantities of a deck over its steps: fractions of their values in the deck,
    linear in between.
    """

    times: tuple[float, ...]  #: in s from rest, which is 0
    courses: Mapping[Item, tuple[float, ...]]  #: one fraction for each time


@dataclass(frozen=True)
class Deck:
    """Contents of a deck at the end of its last step, or the largest values of its steps with their
    history.
    """

    path: Path  #: file of the mesh
    hypothesis: str
    sections: tuple[Section, ...]
    supports: tuple[Support, ...] = ()
    loads: tuple[DeckLoad, ...] = ()
    pairs: tuple[Pair, ...] = ()
    left: tuple[Left, ...] = ()
    seconds: float = 1.0  #: duration of all steps, for laws with rates
    constraints: tuple[DeckLoad, ...] = ()
    cuts: tuple[str, ...] = ()  #: sections along which the mesh is cut
    history: DeckHistory | None = None  #: None where the end of the last step is all that counts
    heat: DeckHeat | None = None  #: None where heat does not flow
    folded: bool = False  #: True for a mesh with folded cells of second order
    #: True if the file is a mesh without physics, for which supports and loads are proposed
    proposal: bool = False
    contact_lost: bool = False  #: True if the file states contact, and no pair of it is read
    sides: bool = False  #: names of sides of bodies that the file does not have are used
