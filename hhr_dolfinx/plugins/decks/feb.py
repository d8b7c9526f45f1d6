"""Physics of files of FEBio 3 and 4: isotropic materials, displacements, pressures, sliding and tied surfaces.

Everything else of a section of physics is a TODO line, items and their children.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from hhr_dolfinx.plugins.decks.deck import Deck, Left, Load, Material, Pair, Section, Support, Tag
from hhr_dolfinx.plugins.decks.named import NamedParts
from hhr_dolfinx.plugins.decks.stated import OF_FEBIO, OTHER

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
_SOLVER = frozenset(
    "penalty auto_penalty update_penalty laugon tolerance gaptol minaug maxaug search_tol search_radius two_pass "
    "symmetric_stiffness seg_up augs knmult node_reloc fric_penalty flip_primary flip_secondary".split()
)
"""Children of contacts that choose how a penalty is found; contact is hard here."""


@dataclass
class Item:
    """An element of XML with its line."""

    tag: str
    attributes: Mapping[str, str]
    line: int
    text: str = ""
    items: list[Item] = field(default_factory=list)

    def child(self, tag: str) -> Item | None:
        """First child of a tag."""
        return next((one for one in self.items if one.tag == tag), None)

    def number(self, tag: str) -> float | None:
        """Number of a child; None if it is not there, or a formula."""
        one = self.child(tag)
        try:
            return float(one.text) if one is not None else None
        except ValueError:
            return None

    def name(self, key: str) -> str:
        """Attribute, without the kind of set before a name, as in ``@surface:Lid``."""
        return self.attributes.get(key, "").rpartition(":")[2]


def read_febio(path: Path, parts: NamedParts) -> Deck | None:
    """Read a file whose mesh is read; None for one of version 2, or with a material that is not read."""
    root = _tree(path)
    sections = list(_sections(root, path, parts))
    domains = root.child("MeshDomains")
    if not sections or domains is None or len(sections) < len(domains.items):
        return None
    made: list[Support | Load | Pair | Left] = [
        one for section in root.items for item in section.items for one in _made(section.tag, item, root, path, parts)
    ]
    supports = tuple(one for one in made if isinstance(one, Support))
    ties = tuple(one for one in made if isinstance(one, Load) and not one.kind)
    pairs = tuple(one for one in made if isinstance(one, Pair))
    stated = root.child("Contact")
    return Deck(
        path,
        "solid",
        tuple(sections),
        supports,
        tuple(one for one in made if isinstance(one, Load) and one.kind),
        pairs or parts.out_of_reach(supports),
        tuple(one for one in made if isinstance(one, Left)),
        constraints=ties,
        contact_lost=stated is not None and len(stated.items) > len(ties) and not pairs,
    )


def _tree(path: Path) -> Item:
    """Root of a file; FileContentError comes before, from the reader of its mesh, which refuses a DOCTYPE too."""
    inside = [Item("", {}, 0)]
    parser = expat.ParserCreate()
    parser.buffer_text = True

    def start(tag: str, attributes: dict[str, str]) -> None:
        item = Item(tag, attributes, parser.CurrentLineNumber)
        inside[-1].items.append(item)
        inside.append(item)

    def data(text: str) -> None:
        inside[-1].text += text

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda tag: inside.pop()
    parser.CharacterDataHandler = data
    parser.Parse(path.read_bytes(), True)
    return inside[0].items[0]


def _sections(root: Item, path: Path, parts: NamedParts) -> Iterator[Section]:
    """Bodies with materials that are read, by the domains of the file."""
    materials = root.child("Material")
    by_name = {one.attributes.get("name", ""): one for one in (materials.items if materials else ())}
    domains = root.child("MeshDomains")
    for domain in domains.items if domains else ():
        item = by_name.get(domain.attributes.get("mat", ""))
        tag = parts.body(domain.attributes.get("name", ""))
        if item is None or tag is None or item.attributes.get("type") not in _ELASTIC:
            continue
        young = item.number("E")
        poisson = item.number("v")
        if young is not None and poisson is not None:
            name = item.attributes["name"]
            source = f"{path.name}:{item.line}"
            yield Section(tag, Material(name, source, young, poisson), f"{path.name}:{domain.line}")


def _made(
    section: str, item: Item, root: Item, path: Path, parts: NamedParts
) -> Iterator[Support | Load | Pair | Left]:
    """Parts of a scene of an item, and what is left of it."""
    why = OF_FEBIO.get(section)
    if why is None:
        return
    source = f"{path.name}:{item.line}"
    kind = item.attributes.get("type", "")
    name = f'<{item.tag} type="{kind}">'
    made: list[Support | Load | Pair] = []
    if section == "Boundary" and item.tag == "bc":
        made = list(_supports(item, kind, source, root, parts))
    elif section == "Loads" and item.tag == "surface_load" and kind == "pressure":
        surface = parts.surface(item.name("surface"))
        value = item.number("pressure")
        if surface is not None and value is not None:
            value *= _curve(root, item.child("pressure"))
            made = [Load("pressure", f"hhr.Pressure({surface!r}, {{}})", value, source)]
    elif section == "Contact":
        made = list(_pairs(item, kind, source, root, parts))
    read = bool(made) or (section == "Material" and kind in _ELASTIC)
    if not read:
        yield Left(source, name, why)
        return
    yield from made
    if kind == "neo-Hookean":
        yield Left(source, name, "strains are small here")
    known = _READ.get(item.tag, ())
    for child in item.items:
        if child.tag not in known and not (section == "Contact" and child.tag in _SOLVER):
            yield Left(f"{path.name}:{child.line}", f"<{child.tag}>", f"{OTHER}: {child.text.strip()}")


def _supports(item: Item, kind: str, source: str, root: Item, parts: NamedParts) -> Iterator[Support]:
    place = parts.place(item.name("node_set"))
    if place is None:
        return
    if kind in _HELD:
        words = (one.text if (one := item.child("dofs")) is not None else "").split(",")
        listed = {word.strip() for word in words}
        for k, axis in enumerate("xyz"):
            if axis in listed or item.number(f"{axis}_dof") == 1:
                yield Support(place, k, 0.0, source)
    elif kind in _MOVED and (dof := item.child("dof")) is not None:
        tag = "value" if item.child("value") is not None else "scale"
        value = item.number(tag)
        if value is not None and dof.text.strip() in ("x", "y", "z"):
            yield Support(place, "xyz".index(dof.text.strip()), value * _curve(root, item.child(tag)), source)


def _pairs(item: Item, kind: str, source: str, root: Item, parts: NamedParts) -> Iterator[Pair | Load]:
    """The pair of a sliding contact, whose primary surface is the slave, or a tie."""
    mesh = root.child("Mesh")
    pairs = {one.attributes.get("name"): one for one in (mesh.items if mesh else ()) if one.tag == "SurfacePair"}
    pair = pairs.get(item.attributes.get("surface_pair"))
    words = [one.text.strip() if (one := pair.child(tag)) else "" for tag in ("primary", "secondary")] if pair else []
    surfaces: list[Tag] = [tag for word in words if (tag := parts.surface(word)) is not None]
    if len(surfaces) == 2 and kind.startswith("sliding"):
        yield parts.pair(surfaces[0], surfaces[1], item.number("fric_coeff") or 0.0, source)
    elif len(surfaces) == 2 and kind.startswith("tied"):
        yield Load("", f"hhr.Tie({surfaces[0]!r}, {surfaces[1]!r})", 0.0, source)


def _curve(root: Item, item: Item | None) -> float:
    """Last value of the load curve of a value, 1 without one."""
    number = item.attributes.get("lc") if item is not None else None
    data = root.child("LoadData")
    for one in data.items if data and number else ():
        points = one.child("points")
        if one.attributes.get("id") == number and points is not None and points.items:
            return float(points.items[-1].text.split(",")[1])
    return 1.0
