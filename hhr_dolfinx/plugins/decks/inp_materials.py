"""Materials of a deck: elasticity, plasticity, creep, expansion, density."""

from __future__ import annotations

from collections.abc import Sequence

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.plugins.decks.deck import Left, Material
from hhr_dolfinx.plugins.decks.inp_words import Block

OF_MATERIALS = frozenset({"MATERIAL", "ELASTIC", "PLASTIC", "CREEP", "EXPANSION", "DENSITY"})
"""Keywords that are read as parts of a material."""
PLATEAU = 10.0
"""Plastic strain up to which the last stress of a table is continued: decks keep it, TabulatedHardening goes on."""


def materials_of(found: Sequence[Block]) -> tuple[dict[str, Material], list[Left]]:
    """Elastic materials, with their laws, by name in capitals, and properties without counterpart."""
    materials: dict[str, Material] = {}
    left: list[Left] = []
    name = ""
    own: dict[str, Block] = {}
    for block in (*found, Block("", 0, "MATERIAL", {"NAME": ""}, ())):
        if block.keyword == "MATERIAL":
            if "ELASTIC" in own:
                materials[name.upper()] = _material(name, own, left)
            name = block.option("NAME")
            own = {}
        elif block.keyword in OF_MATERIALS and block.rows:
            own[block.keyword] = block
    return materials, left


def _material(name: str, own: dict[str, Block], left: list[Left]) -> Material:
    elastic = own["ELASTIC"]
    kind = elastic.options.get("TYPE", "ISOTROPIC").upper()
    row = elastic.numbers(elastic.rows[0])
    if kind not in ("ISO", "ISOTROPIC") or len(row) < 2:
        raise FileContentError(
            f"{elastic.source} *ELASTIC of material '{name}' must have E and nu, and is TYPE={kind} with {row}: give it "
            "isotropic constants, and change the body to hhr.Orthotropic in the scene"
        )
    for block in own.values():
        width = {"ELASTIC": 3, "PLASTIC": 3, "CREEP": 4, "EXPANSION": 2, "DENSITY": 2}[block.keyword]
        if len(block.rows) > 1 and len(block.rows[0]) >= width and block.keyword != "PLASTIC":
            left.append(block.left(f"'{name}' depends on temperature: its first line is taken"))
    single = {key: own[key].number(own[key].rows[0][0]) for key in ("EXPANSION", "DENSITY") if key in own}
    return Material(
        name, elastic.source, row[0], row[1], _law(own, left), single.get("EXPANSION"), single.get("DENSITY")
    )


def _law(own: dict[str, Block], left: list[Left]) -> str:
    """Text of the law of bodies; empty for an elastic material."""
    curve = _curve(own["PLASTIC"], left) if "PLASTIC" in own else []
    creep = own.get("CREEP")
    if creep is None:
        return _plastic(own["PLASTIC"], curve, left) if curve else ""
    factor, exponent, power = (*creep.numbers(creep.rows[0]), 0.0, 0.0)[:3]
    kind = creep.options.get("LAW", "STRAIN").upper()
    if kind not in ("STRAIN", "TIME", "NORTON") or not factor > 0 or exponent < 1:
        left.append(creep.left(f"LAW={kind} with {creep.rows[0]} is not Norton's"))
        return _plastic(own["PLASTIC"], curve, left) if curve else ""
    # A q^n t^m is (q / K)^n t^m of PrimaryCreep's strain, A / (m + 1) q^n t^(m + 1)
    resistance = (factor / (power + 1)) ** (-1 / exponent)
    if power:
        if curve:
            left.append(own["PLASTIC"].left("plasticity beside creep that depends on time: creep is taken alone"))
        return f"hhr.PrimaryCreep({resistance!r}, {exponent!r}, {power + 1!r})"
    if curve:
        slope = (curve[-1][0] - curve[0][0]) / (curve[-1][1] or 1.0)
        if len(curve) > 2:
            left.append(own["PLASTIC"].left("beside creep hardening is linear: from its first to its last point"))
        return f"hhr.PlasticityWithCreep({curve[0][0]!r}, {slope!r}, {resistance!r}, {exponent!r})"
    return f"hhr.Norton({resistance!r}, {exponent!r})"


def _curve(block: Block, left: list[Left]) -> list[tuple[float, float]]:
    """Stresses and plastic strains, at the first of several temperatures."""
    rows = [block.numbers(row) for row in block.rows]
    temperatures = [row[2] for row in rows if len(row) > 2]
    if len(set(temperatures)) > 1:
        left.append(block.left(f"depends on temperature: that at {temperatures[0]:g} is taken"))
    kept = [row for row in rows if len(row) < 3 or row[2] == temperatures[0]]
    return [(row[0], row[1] if len(row) > 1 else 0.0) for row in kept]


def _plastic(block: Block, curve: list[tuple[float, float]], left: list[Left]) -> str:
    kind = block.options.get("HARDENING", "ISOTROPIC").upper()
    if len(curve) == 1:
        return f"hhr.Plasticity({curve[0][0]!r})"
    if kind == "KINEMATIC" and len(curve) == 2:
        slope = (curve[1][0] - curve[0][0]) / (curve[1][1] - curve[0][1])
        return f"hhr.Chaboche({curve[0][0]!r}, (({slope!r}, 0.0),))"
    if kind != "ISOTROPIC":
        left.append(block.left(f"HARDENING={kind} is taken as isotropic"))
    points = [(strain, stress) for stress, strain in curve]
    return f"hhr.TabulatedHardening({(*points, (points[-1][0] + PLATEAU, points[-1][1]))!r})"
