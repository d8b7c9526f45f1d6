"""Contents of a deck in neutral form: readers of all formats make it, and one writer turns it into a scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

Tag = str | int


@dataclass(frozen=True)
class Material:
    """Constants of a material, in the units of the deck.

    Attributes:
        name: its name in the deck.
        source: file and line of its elasticity, ``deck.inp:12``.
        young, poisson: Young's modulus and Poisson's ratio.
        law: law in addition to elasticity as text of Python; empty for an elastic material.
        expansion: coefficient of linear expansion; None if it is not given.
        density: mass per volume; None if it is not given.
    """

    name: str
    source: str
    young: float
    poisson: float
    law: str = ""
    expansion: float | None = None
    density: float | None = None


@dataclass(frozen=True)
class Section:
    """A body: the material of the cells with a tag."""

    tag: Tag
    material: Material
    source: str


@dataclass(frozen=True)
class Support:
    """Imposed displacement ``value`` of a component; supports of a block share a parameter.

    ``place`` is the name of a set of the mesh, or text of Python for other nodes if ``code`` is true.
    """

    place: Tag
    component: int
    value: float
    source: str


@dataclass(frozen=True)
class Load:
    """A load ``value`` times a unit load.

    Attributes:
        kind: proposed name of a parameter, such as ``pressure``.
        text: the unit load as text of Python, with ``{}`` for its amplitude.
        value: amplitude.
        source: file and line.
    """

    kind: str
    text: str
    value: float
    source: str


@dataclass(frozen=True)
class Pair:
    """A contact pair.

    Attributes:
        text: the pair as text of Python, with ``{}`` for its friction.
        friction: coefficient of Coulomb's law; 0 without.
        source: file and line.
        gap: length that is added to the gaps of the mesh.
        words: comment on its choice.
    """

    text: str
    friction: float
    source: str
    gap: float = 0.0
    words: str = ""


@dataclass(frozen=True)
class Left:
    """A part of a deck that the scene lacks."""

    source: str
    keyword: str
    why: str

    def __str__(self) -> str:
        return f"TODO {self.source} {self.keyword}: {self.why}"


@dataclass(frozen=True)
class Deck:
    """Contents of a deck.

    Attributes:
        path: file of the mesh, to which names refer.
        hypothesis: that of a scene.
        sections: bodies with their materials.
        supports, loads, pairs: supports, loads and contact pairs of the last step.
        left: parts without counterpart.
        seconds: duration of all steps, for laws with rates.
        title: words on the origin of the scene.
    """

    path: Path
    hypothesis: str
    sections: tuple[Section, ...]
    supports: tuple[Support, ...] = ()
    loads: tuple[Load, ...] = ()
    pairs: tuple[Pair, ...] = ()
    left: tuple[Left, ...] = ()
    seconds: float = 1.0
    title: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
