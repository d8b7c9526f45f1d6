"""Parts and instances of an Abaqus deck: each part has nodes 1, 2, ..., and instances place it in
the assembly.

A set of an instance is called ``Instance.Set``, as in Abaqus, and also ``Set`` if nothing else has
this name. The cells of an instance are a set with the name of the instance.
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace

import numpy as np

from hhr_dolfinx.geometries.abaqus_blocks import (
    COUPLED,
    LOADED,
    STRIDE,
    DeckContents,
    name_coupled,
    name_loaded,
    number_of,
    take,
)
from hhr_dolfinx.geometries.abaqus_generated import GENERATED, generate

_KINDS = {"nset": "node_sets", "elset": "element_sets", "surface": "faces"}
"""Fields of a deck by the kind of the names in it; unions are surfaces too."""


class Assembly:
    """Blocks of a deck by the part, instance or assembly that they belong to.

    Attributes:
        deck: nodes, elements and sets of the assembly, with those of all instances that are
            complete.
        parts: contents of each part, by name in capitals.
        placed: names in capitals of parts that have an instance.
    """

    def __init__(self) -> None:
        self.deck = DeckContents()
        self.parts: dict[str, DeckContents] = {}
        self.placed: set[str] = set()
        self._own = self.deck
        self._instance = ""
        self._coupled: list[tuple[DeckContents, str, dict[str, str], list[list[str]]]] = []

    def take(
        self, keyword: str, options: dict[str, str], rows: list[list[str]], line: int = 0
    ) -> None:
        """Add a block to its part, instance or assembly.

        Args:
            keyword: keyword of the block in capitals, without its star.
            options: options of the block, by name in capitals.
            rows: words of the data lines of the block.
            line: line of the file at which the block begins.

        Raises:
            ValueError: for a block that is damaged or not supported.
        """
        if keyword in (
            "PART",
            "INSTANCE",
            "ASSEMBLY",
            "END PART",
            "END INSTANCE",
            "END ASSEMBLY",
            "STEP",
        ):
            self._close()
        if keyword == "PART":
            self._own = self.parts.setdefault(
                self.deck.named("part", options["NAME"]), DeckContents()
            )
        elif keyword == "INSTANCE":
            self._open(options, rows)
        else:
            numbered = self._with_numbers(keyword, options, rows)
            if keyword in GENERATED:
                generate(self._own, keyword, options, rows)
            take(self._own, keyword, options, numbered)
            if keyword in LOADED:
                name_loaded(self._own, f"{keyword}:{line}", numbered)
            elif keyword in COUPLED:
                # their sets may follow
                self._coupled.append((self._own, f"{keyword}:{line}", options, numbered))

    def flat(self) -> DeckContents:
        """All instances as one deck; parts are taken as they are if nothing places them."""
        self._close()
        self._name_coupled()
        if not self.deck.instances:
            for name, contents in self.parts.items():
                _join(self.deck, self.deck.spelling["part", name], contents)
        else:
            for name in self.parts.keys() - self.placed:
                self.deck.left_out[self.deck.spelling["part", name]] = (
                    "a part that no instance places"
                )
        _add_short_names(self.deck)
        return self.deck

    def _open(self, options: dict[str, str], rows: list[list[str]]) -> None:
        """Begin an instance: the part, moved and turned, to which the blocks of the instance are
        added.
        """
        if "LIBRARY" in options:
            raise ValueError(
                "instances of the results of another analysis are not supported: write its mesh "
                "as a part"
            )
        part = options.get("PART", "").upper()
        if part not in self.parts:
            raise ValueError(f"there is no part {options.get('PART', '')!r} before it")
        self.placed.add(part)
        contents = self.parts[part]
        self._own = deepcopy(replace(contents, nodes={}, elements={}, whole={}, types={}))
        # of a large part these would take seconds, and no block changes them
        self._own.elements = dict(contents.elements)
        self._own.whole = dict(contents.whole)
        self._own.types = dict(contents.types)
        self._own.nodes = _moved(
            contents.nodes, [[number_of(word) for word in row] for row in rows]
        )
        self._instance = options["NAME"]

    def _close(self) -> None:
        """End a part or an instance."""
        if self._instance:
            self._name_coupled()
            _join(self.deck, self._instance, self._own)
        self._own = self.deck
        self._instance = ""

    def _name_coupled(self) -> None:
        """Name the nodes of constraints of the deck, or of the instance that ends."""
        for coupled in self._coupled:
            if coupled[0] is self._own:
                name_coupled(*coupled)
        self._coupled = [coupling for coupling in self._coupled if coupling[0] is not self._own]

    def _with_numbers(
        self, keyword: str, options: dict[str, str], rows: list[list[str]]
    ) -> list[list[str]]:
        """Rows of a set, surface or load of the assembly, with the numbers of the flat deck for
        ``Instance.7``.

        Sets with the option INSTANCE name members by their names and numbers in that instance.
        """
        if (
            self._own is not self.deck
            or keyword not in ("NSET", "ELSET", "SURFACE", *LOADED, *COUPLED)
            or not self.deck.instances
        ):
            return rows
        prefix = f"{options['INSTANCE']}." if "INSTANCE" in options else ""
        offsets = {name.upper(): (k + 1) * STRIDE for k, name in enumerate(self.deck.instances)}
        if keyword in (*LOADED, *COUPLED):  # a mesh is not refused for the name of a load
            count = 1 if keyword in LOADED else None
            flags = [
                [word.rpartition(".")[0].upper() in offsets for word in row[:count]] for row in rows
            ]
            return [
                [
                    *(
                        _flat("", word, offsets) if is_member else word
                        for word, is_member in zip(row, inner, strict=False)
                    ),
                    *row[len(inner) :],
                ]
                for row, inner in zip(rows, flags, strict=True)
            ]
        # the step of a range and the face of an element are no members
        members = (
            2
            if "GENERATE" in options
            else 1
            if keyword == "SURFACE" and "COMBINE" not in options
            else None
        )
        return [
            [
                *(_flat(prefix, word, offsets) for word in row[:members]),
                *([] if members is None else row[members:]),
            ]
            for row in rows
        ]


def _flat(inside: str, word: str, known: dict[str, int]) -> str:
    """Name or number in the flat deck of a member of an assembly's set."""
    name, _, number = f"{inside}{word}".rpartition(".")
    if not word or not number.isdigit():
        return f"{inside}{word}" if word else word
    if name and name.upper() not in known:
        raise ValueError(f"there is no instance '{name}' before it")
    return str(known.get(name.upper(), 0) + int(number))


def _moved(nodes: dict[int, list[float]], rows: list[list[float]]) -> dict[int, list[float]]:
    """Nodes moved by the first row, then turned about the axis through two points by an angle in
    degrees.

    The formula of Rodrigues, for the unit vector e of the axis: cos x + sin e x x + (1 - cos) e (e
    . x).

    Raises:
        ValueError: for rows of another length, or an axis of two equal points.
    """
    if not rows:
        return nodes
    shift, turn = (
        ([], rows[0]) if len(rows[0]) >= 7 else (rows[0], rows[1] if len(rows) > 1 else [])
    )
    if turn and len(turn) != 7:
        raise ValueError(
            f"the rotation of an instance has two points and an angle, and not {len(turn)} numbers"
        )
    points = np.array(list(nodes.values())).reshape(-1, 3) + np.array((*shift, 0.0, 0.0, 0.0)[:3])
    if turn:
        start = np.array(turn[:3])
        end = np.array(turn[3:6])
        if not (length := np.linalg.norm(end - start)):
            raise ValueError(
                "the axis of rotation of an instance goes through two points that are the same"
            )
        axis = (end - start) / length
        angle = np.deg2rad(turn[6])
        off = points - start
        turned = np.cos(angle) * off + np.sin(angle) * np.cross(axis, off)
        points = start + turned + (1 - np.cos(angle)) * np.outer(off @ axis, axis)
    return dict(zip(nodes, points.tolist(), strict=True))


def _join(deck: DeckContents, instance: str, own: DeckContents) -> None:
    """Add an instance to a deck: its numbers increase by a multiple of STRIDE, and its names have
    its name in front.
    """
    deck.instances.append(instance)
    first = len(deck.instances) * STRIDE
    upper = instance.upper()
    deck.nodes |= {first + n: coordinates for n, coordinates in own.nodes.items()}
    deck.elements |= {
        first + n: (kind, [first + k for k in nodes]) for n, (kind, nodes) in own.elements.items()
    }
    deck.whole |= {first + n: [first + k for k in nodes] for n, nodes in own.whole.items()}
    deck.types |= {first + n: name for n, name in own.types.items()}
    for sets, added in ((deck.node_sets, own.node_sets), (deck.element_sets, own.element_sets)):
        sets |= {f"{upper}.{name}": [first + n for n in numbers] for name, numbers in added.items()}
    deck.unsorted |= {f"{upper}.{name}" for name in own.unsorted}
    for name, listed in own.faces.items():
        deck.faces[f"{upper}.{name}"] = [
            (str(first + int(element)) if element.isdigit() else f"{upper}.{element}", face)
            for element, face in listed
        ]
    deck.unions |= {
        f"{upper}.{name}": [f"{upper}.{member}" for member in members]
        for name, members in own.unions.items()
    }
    deck.left_out |= {f"{instance}.{name}": reason for name, reason in own.left_out.items()}
    deck.spelling |= {
        (kind, f"{upper}.{name}"): f"{instance}.{spelt}"
        for (kind, name), spelt in own.spelling.items()
    }
    if own.elements:
        deck.element_sets.setdefault(
            deck.named("elset", instance), [first + n for n in own.elements]
        )


def _add_short_names(deck: DeckContents) -> None:
    """Add the sets of instances by their names without that of the instance, unless several sets
    have this name.
    """
    taken = {name for kind, name in deck.spelling if kind in _KINDS}
    holders: dict[str, list[tuple[str, str, str]]] = {}
    for kind, full in deck.spelling:
        for instance in deck.instances if kind in _KINDS else ():
            if full.startswith(f"{instance.upper()}."):
                holders.setdefault(full[len(instance) + 1 :], []).append((kind, full, instance))
    for name, sets in holders.items():
        if name in taken:
            continue
        spelt = [deck.spelling[kind, full] for kind, full, _ in sets]
        short = spelt[0][len(sets[0][2]) + 1 :]
        if len({instance for _, _, instance in sets}) == 1:
            for kind, full, _ in sets:
                _add_short_name(deck, kind, name, full, short)
        elif not name.startswith("_"):  # names that Abaqus/CAE makes
            choices = " or ".join(repr(spelling) for spelling in dict.fromkeys(spelt))
            deck.left_out[short] = f"is in several instances: name it {choices}"


def _add_short_name(deck: DeckContents, kind: str, name: str, full: str, spelt: str) -> None:
    """Add one set by its short name."""
    deck.spelling[kind, name] = spelt
    if kind == "surface" and full in deck.unions:
        deck.unions[name] = deck.unions[full]
    elif full in (held := getattr(deck, _KINDS[kind])):
        held[name] = held[full]
        deck.unsorted |= {name} if full in deck.unsorted and kind == "nset" else set()
