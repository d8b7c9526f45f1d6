"""Meshes of FEBio, ``.feb`` of versions 2.5, 3 and 4: nodes, elements, sets and surfaces."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element
from xml.parsers import expat

from hhr_dolfinx.geometries.raw_mesh import RawMesh
from hhr_dolfinx.plugins.mesh_formats.contents import COUNTS, Contents

_KINDS = dict(
    pair.split(":")
    for pair in (
        "hex8:hexahedron hex20:hexahedron20 hex27:hexahedron27 tet4:tetra tet10:tetra10 "
        "penta6:wedge penta15:wedge15 pyra5:pyramid pyra13:pyramid13 tri3:triangle tri6:triangle6 "
        "quad4:quad q4ans:quad q4eas:quad quad8:quad8 quad9:quad9 line2:line line3:line3 "
        "truss2:line"
    ).split()
)


def read_feb(path: Path) -> RawMesh:
    """Read a file; raise FileContentError, with the line, for a damaged one, or a mesh in another
    file.

    A DOCTYPE is refused: entities that it declares may expand to gigabytes, or read other files.
    """
    found = Contents()
    parser = expat.ParserCreate()
    inside: list[Element] = []

    def end(tag: str) -> None:
        item = inside.pop()
        if len(inside) > 1 and inside[1].tag in ("Mesh", "Geometry"):
            _take(found, item, inside[-1])

    def data(text: str) -> None:
        inside[-1].text = (inside[-1].text or "") + text

    def refuse(*_: object) -> None:
        raise ValueError("files of FEBio have no <!DOCTYPE>")

    parser.StartElementHandler = lambda tag, attributes: inside.append(Element(tag, attributes))
    parser.EndElementHandler = end
    parser.CharacterDataHandler = data
    parser.StartDoctypeDeclHandler = refuse
    parser.buffer_text = True
    with found.reading(path):
        try:
            parser.Parse(path.read_bytes(), True)
            if not found.points:
                raise ValueError(
                    "there is no <Mesh> or <Geometry> with nodes: save all in one file"
                )
        except expat.ExpatError as error:
            raise ValueError(f"no XML: {error}") from error
        finally:
            found.line = parser.CurrentLineNumber
    return found.mesh(path)


def _take(found: Contents, item: Element, block: Element) -> None:
    """Add an item of a block of the mesh, or numbers that are the text of a set."""
    words = (item.text or "").replace(",", " ").split()
    # files of version 2 name their elements by elset
    name = block.get("name", block.get("elset", ""))
    if block.tag == "Nodes":
        found.points[item.attrib["id"]] = [float(word) for word in words]
    elif block.tag == "Elements" and (kind := _KINDS.get(block.attrib["type"].lower())):
        # further nodes lie inside of the element
        found.add(kind, item.attrib["id"], words[: COUNTS[kind]])
        found.sets.setdefault(name or int(block.get("mat", "1")), []).append(item.attrib["id"])
    elif block.tag == "Elements":
        found.left_out[name or block.attrib["type"]] = (
            f"elements of type {block.attrib['type']} are not read"
        )
    elif block.tag in ("Surface", "Edge"):
        found.add(_KINDS[item.tag.lower()], (name, item.attrib["id"]), words)
        found.sets.setdefault(name, []).append((name, item.attrib["id"]))
    elif item.tag in ("NodeSet", "ElementSet") or block.tag in ("NodeSet", "ElementSet"):
        whole = item.tag.endswith("Set")
        sets = found.nodes if "NodeSet" in (item.tag, block.tag) else found.sets
        members = (
            [one for word in words for one in _members(word)] if whole else [item.attrib["id"]]
        )
        sets.setdefault(item.get("name", "") if whole else name, []).extend(members)


def _members(word: str) -> Iterator[str]:
    """Numbers of a word of a set: one number, or a range with both ends, such as ``1:7`` or
    ``1:7:2``.
    """
    first, *rest = word.split(":")
    if not rest:
        yield word
        return
    if len(rest) > 2:
        raise ValueError(f"{word!r} is no range of numbers, first:last or first:last:step")
    last, step = (*map(int, rest), 1)[:2]
    yield from map(str, range(int(first), last + 1, step))
