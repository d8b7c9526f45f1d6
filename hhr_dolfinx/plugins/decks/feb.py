"""Physics of files of FEBio 3 and 4: isotropic materials, displacements, pressures, sliding and
tied surfaces.

Everything else of a section of physics is a TODO line, items and their children.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from hhr_dolfinx.plugins.decks.deck import (
    Deck,
    DeckLoad,
    DeckMaterial,
    Left,
    Pair,
    Section,
    Support,
    Tag,
)
from hhr_dolfinx.plugins.decks.feb_curves import FebNumbers
from hhr_dolfinx.plugins.decks.feb_items import Item, tree_of
from hhr_dolfinx.plugins.decks.named import NamedParts
from hhr_dolfinx.plugins.decks.stated import ELSEWHERE, NOT_READ, OF_FEBIO

_ELASTIC = ("isotropic elastic", "neo-Hookean")
"""Materials that are linear for small strains."""
_HELD = ("zero displacement", "fix")
_MOVED = ("prescribed displacement", "prescribe")
_READ = {
    "material": ("E", "v", "density"),
    "bc": ("x_dof", "y_dof", "z_dof", "dofs", "dof", "value", "scale", "relative"),
    "surface_load": ("pressure", "linear", "symmetric_stiffness"),
    "contact": ("fric_coeff",),
}
"""Children of items that are read."""
_ATTRIBUTES = frozenset(("id", "name", "type", "node_set", "surface", "surface_pair"))
"""Attributes of items that are read."""
_SOLVER = frozenset(
    "penalty auto_penalty update_penalty laugon tolerance gaptol minaug maxaug search_tol "
    "search_radius two_pass "
    "symmetric_stiffness seg_up augs knmult node_reloc fric_penalty "
    "flip_primary flip_secondary".split()
)
"""Children of contacts that choose how a penalty is found; contact is hard here."""


def read_febio(path: Path, parts: NamedParts) -> Deck | None:
    """Physics of a file of FEBio whose mesh is read.

    Args:
        path: path of the file.
        parts: bodies, surfaces and sets of the mesh.

    Returns:
        The deck; None for a file of version 2, or with a material that is not read.
    """
    root = tree_of(path)
    numbers = FebNumbers(root)
    sections = list(_sections(root, numbers, path, parts))
    domains = root.child("MeshDomains")
    if not sections or domains is None or len(sections) < len(domains.items):
        return None
    entries: list[Support | DeckLoad | Pair | Left] = [*_unread(root, numbers, path)]
    for section in root.items:
        for element in section.items:
            entries += _made(section.tag, element, numbers, path, parts)
    supports = tuple(entry for entry in entries if isinstance(entry, Support))
    ties = tuple(entry for entry in entries if isinstance(entry, DeckLoad) and not entry.kind)
    pairs = tuple(entry for entry in entries if isinstance(entry, Pair))
    in_steps = [part for step in root.items if step.tag == "Step" for part in step.items]
    contacts = [
        section
        for parent in (root, *in_steps)
        for section in parent.items
        if section.tag == "Contact"
    ]
    return Deck(
        path,
        "solid",
        tuple(sections),
        supports,
        tuple(entry for entry in entries if isinstance(entry, DeckLoad) and entry.kind),
        pairs or parts.out_of_reach(supports),
        tuple(entry for entry in entries if isinstance(entry, Left)),
        constraints=ties,
        contact_lost=sum(len(section.items) for section in contacts) > len(ties) and not pairs,
    )


def _unread(root: Item, numbers: FebNumbers, path: Path) -> Iterator[Left]:
    """Sections of physics in other files, and an end of the computation that the file does not
    state.
    """
    for section in root.items:
        if section.tag == "Include" or (
            section.tag in (*OF_FEBIO, "LoadData", "Control") and "from" in section.attributes
        ):
            file = section.attributes.get("from", section.text.strip())
            yield Left(f"{path.name}:{section.line}", f'<{section.tag} from="{file}">', ELSEWHERE)
    if numbers.end is None and numbers.uses_curves:
        reason = (
            "the file does not say when its computation ends: load curves have the values of "
            "their last points"
        )
        yield Left(path.name, "<Control>", reason)


def _sections(root: Item, numbers: FebNumbers, path: Path, parts: NamedParts) -> Iterator[Section]:
    """Bodies with materials that are read, by the domains of the file."""
    materials = root.child("Material")
    by_name = {
        element.attributes.get("name", ""): element
        for element in (materials.items if materials else ())
    }
    domains = root.child("MeshDomains")
    for domain in domains.items if domains else ():
        material = by_name.get(domain.attributes.get("mat", ""))
        tag = parts.body(domain.attributes.get("name", ""))
        if material is None or tag is None or material.attributes.get("type") not in _ELASTIC:
            continue
        young = numbers.of(material, "E")
        poisson = numbers.of(material, "v")
        if young is not None and poisson is not None:
            name = material.attributes["name"]
            source = f"{path.name}:{material.line}"
            yield Section(
                tag, DeckMaterial(name, source, young, poisson), f"{path.name}:{domain.line}"
            )


def _made(
    section: str, item: Item, numbers: FebNumbers, path: Path, parts: NamedParts
) -> Iterator[Support | DeckLoad | Pair | Left]:
    """Parts of a scene of an item, and what is left of it."""
    remedy = OF_FEBIO.get(section)
    if remedy is None:
        return
    source = f"{path.name}:{item.line}"
    kind = item.attributes.get("type", "")
    name = f'<{item.tag} type="{kind}">'
    parts_of_scene: list[Support | DeckLoad | Pair] = []
    if section == "Boundary" and item.tag == "bc":
        parts_of_scene = list(_supports(item, kind, source, numbers, parts))
    elif section == "Loads" and item.tag == "surface_load" and kind == "pressure":
        surface = parts.surface(item.name("surface"))
        value = numbers.of(item, "pressure")
        if surface is not None and value is not None:
            parts_of_scene = [
                DeckLoad("pressure", f"hhr.Pressure({surface!r}, {{}})", value, source)
            ]
    elif section == "Contact":
        parts_of_scene = list(_pairs(item, kind, source, numbers, parts))
    read = bool(parts_of_scene) or (section == "Material" and kind in _ELASTIC)
    for child in item.items:
        if lost := numbers.why_not(child):
            yield Left(
                f"{path.name}:{child.line}", f'<{child.tag} lc="{child.attributes["lc"]}">', lost
            )
    if not read:
        yield Left(source, name, remedy)
        return
    yield from parts_of_scene
    if kind == "neo-Hookean":
        yield Left(source, name, "strains are small here")
    for key in sorted(item.attributes.keys() - _ATTRIBUTES):
        yield Left(source, f'<{item.tag} {key}="{item.attributes[key]}">', NOT_READ)
    read_children = _READ.get(item.tag, ())
    for child in item.items:
        formula = child.tag == "fric_coeff" and item.number(child.tag) is None
        if formula or (
            child.tag not in read_children and not (section == "Contact" and child.tag in _SOLVER)
        ):
            yield Left(
                f"{path.name}:{child.line}", f"<{child.tag}>", f"{NOT_READ}: {child.text.strip()}"
            )


def _supports(
    item: Item, kind: str, source: str, numbers: FebNumbers, parts: NamedParts
) -> Iterator[Support]:
    target = parts.place(item.name("node_set"))
    if target is None:
        return
    if kind in _HELD:
        words = (child.text if (child := item.child("dofs")) is not None else "").split(",")
        listed = {word.strip() for word in words}
        for k, axis in enumerate("xyz"):
            if axis in listed or item.number(f"{axis}_dof") == 1:
                yield Support(target, k, 0.0, source)
    elif kind in _MOVED and (dof := item.child("dof")) is not None:
        tag = "value" if item.child("value") is not None else "scale"
        value = numbers.of(item, tag)
        if value is not None and dof.text.strip() in ("x", "y", "z"):
            yield Support(target, "xyz".index(dof.text.strip()), value, source)


def _pairs(
    item: Item, kind: str, source: str, numbers: FebNumbers, parts: NamedParts
) -> Iterator[Pair | DeckLoad]:
    """The pair of a sliding contact, whose primary surface is the slave, or a tie."""
    mesh = numbers.root.child("Mesh")
    pairs = {
        element.attributes.get("name"): element
        for element in (mesh.items if mesh else ())
        if element.tag == "SurfacePair"
    }
    pair = pairs.get(item.attributes.get("surface_pair"))
    words = (
        [
            element.text.strip() if (element := pair.child(tag)) else ""
            for tag in ("primary", "secondary")
        ]
        if pair
        else []
    )
    surfaces: list[Tag] = [tag for word in words if (tag := parts.surface(word)) is not None]
    if len(surfaces) == 2 and kind.startswith("sliding"):
        yield parts.pair(surfaces[0], surfaces[1], numbers.of(item, "fric_coeff") or 0.0, source)
    elif len(surfaces) == 2 and kind.startswith("tied"):
        yield DeckLoad("", f"hhr.Tie({surfaces[0]!r}, {surfaces[1]!r})", 0.0, source)
