"""Materials of a deck: elasticity, plasticity, creep, expansion, density, heat."""

from __future__ import annotations

from collections.abc import Sequence

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.plugins.decks.deck import DeckMaterial, Left
from hhr_dolfinx.plugins.decks.inp_steps import KeywordBlock

SINGLE = ("EXPANSION", "DENSITY", "CONDUCTIVITY", "SPECIFIC HEAT")
"""Keywords of properties with one number."""
PROPERTIES = ("ELASTIC", "PLASTIC", "CREEP", *SINGLE)
"""Keywords that are read as properties of a material."""
PLATEAU = 10.0
"""Plastic strain by which the last stress of a table is continued: decks keep it, and
TabulatedHardening goes on.
"""


def materials_of(blocks: Sequence[KeywordBlock], todo: list[Left]) -> dict[str, DeckMaterial]:
    """Elastic materials, with their laws, by name in capitals.

    Properties without counterpart become TODO lines.

    Args:
        blocks: keyword blocks of the deck, in the order of its lines.
        todo: list to which TODO lines are appended.
    """
    properties: dict[str, dict[str, KeywordBlock]] = {}
    for block in blocks:
        if block.keyword == "MATERIAL":
            properties[name := block.option("NAME").upper()] = {}
        elif block.keyword in PROPERTIES and block.rows and properties:
            properties[name][block.keyword] = block
    return {
        name: _material(name, blocks_of, todo)
        for name, blocks_of in properties.items()
        if "ELASTIC" in blocks_of
    }


def _material(name: str, properties: dict[str, KeywordBlock], todo: list[Left]) -> DeckMaterial:
    elastic = properties["ELASTIC"]
    row = elastic.numbers(elastic.rows[0])
    if len(row) < 2:
        raise FileContentError(
            f"{elastic.source} *ELASTIC of material '{name}' has {row}, and E and nu are needed"
        )
    for block in properties.values():
        if len(block.rows) > 1 and block.keyword != "PLASTIC":
            todo.append(block.left(f"'{name}' depends on temperature: its first line counts"))
    single = {
        key: block.number(block.rows[0][0]) for key, block in properties.items() if key in SINGLE
    }
    return DeckMaterial(
        name,
        elastic.source,
        row[0],
        row[1],
        _law(properties, todo),
        single.get("EXPANSION"),
        single.get("DENSITY"),
        single.get("CONDUCTIVITY"),
        single.get("SPECIFIC HEAT"),
    )


def _law(properties: dict[str, KeywordBlock], todo: list[Left]) -> str:
    """Text of the law of a body; empty for an elastic one."""
    plastic = properties.get("PLASTIC")
    creep = properties.get("CREEP")
    curve = _curve(plastic, todo) if plastic is not None else []
    if creep is not None:
        curve = curve if any(stress for stress, _ in curve) else []
        factor, exponent, power = (*creep.numbers(creep.rows[0]), 0.0, 0.0)[:3]
        kind = creep.word("LAW") or "NORTON"
        if factor > 0 and exponent >= 1 and -1 < power <= 0:
            # the strain of A q^n t^m is A / (m + 1) q^n t^(m + 1), and that of PrimaryCreep (q /
            # K)^n t^(m + 1)
            resistance = (factor / (power + 1)) ** (-1 / exponent)
            if not curve:
                if not power:
                    return f"hhr.Norton({resistance!r}, {exponent!r})"
                if kind != "STRAIN":
                    todo.append(
                        creep.left(
                            f"LAW={kind}: it slows with the strain here, which is the same at "
                            "constant stress"
                        )
                    )
                return f"hhr.PrimaryCreep({resistance!r}, {exponent!r}, {power + 1!r})"
            if not power and len(curve) < 3:
                slope = (curve[-1][0] - curve[0][0]) / (curve[-1][1] or 1.0)
                return (
                    f"hhr.PlasticityWithCreep({curve[0][0]!r}, {slope!r}, {resistance!r}, "
                    f"{exponent!r})"
                )
        todo.append(
            creep.left(
                f"LAW={kind} with {', '.join(creep.rows[0])} has no counterpart, or not with "
                "*PLASTIC"
            )
        )
    return _plastic(plastic, curve, todo) if plastic is not None else ""


def _curve(block: KeywordBlock, todo: list[Left]) -> list[tuple[float, float]]:
    """Stresses and plastic strains, at the first of several temperatures."""
    rows = [(*block.numbers(row), 0.0, 0.0)[:3] for row in block.rows]
    if any(row[2] != rows[0][2] for row in rows):
        todo.append(block.left(f"depends on temperature: that at {rows[0][2]:g} counts"))
    return [(row[0], row[1]) for row in rows if row[2] == rows[0][2]]


def _plastic(block: KeywordBlock, curve: list[tuple[float, float]], todo: list[Left]) -> str:
    kind = block.word("HARDENING") or "ISOTROPIC"
    if len(curve) == 1:
        return f"hhr.Plasticity({curve[0][0]!r})"
    if kind == "KINEMATIC" and len(curve) == 2 and curve[1][1] > curve[0][1]:
        slope = (curve[1][0] - curve[0][0]) / (curve[1][1] - curve[0][1])
        return f"hhr.Chaboche({curve[0][0]!r}, (({slope!r}, 0.0),))"
    if kind != "ISOTROPIC":
        todo.append(block.left(f"HARDENING={kind} with {len(curve)} lines is read as isotropic"))
    points = [(strain, stress) for stress, strain in curve]
    return f"hhr.TabulatedHardening({(*points, (points[-1][0] + PLATEAU, points[-1][1]))!r})"
