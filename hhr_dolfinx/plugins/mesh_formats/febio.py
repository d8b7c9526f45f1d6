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
    """Read a file of FEBio.

    A DOCTYPE is refused: entities that it declares may expand to gigabytes, or read other files.

    Raises:
        FileContentError: with the line, for a damaged file, or a mesh in another file.
    """
    contents = Contents()
    parser = expat.ParserCreate()
    open_elements: list[Element] = []

    def end(tag: str) -> None:
        element = open_elements.pop()
        if len(open_elements) > 1 and open_elements[1].tag in ("Mesh", "Geometry"):
            _take(contents, element, open_elements[-1])

    def data(text: str) -> None:
        open_elements[-1].text = (open_elements[-1].text or "") + text

    def refuse(*_: object) -> None:
        """Raise ValueError for a DOCTYPE."""
        raise ValueError("files of FEBio have no <!DOCTYPE>")

    parser.StartElementHandler = lambda tag, attributes: open_elements.append(
        Element(tag, attributes)
    )
    parser.EndElementHandler = end
    parser.CharacterDataHandler = data
    parser.StartDoctypeDeclHandler = refuse
    parser.buffer_text = True
    with contents.reading(path):
        try:
            parser.Parse(path.read_bytes(), True)
            if not contents.points:
                raise ValueError(
                    "there is no <Mesh> or <Geometry> with nodes: save all in one file"
                )
        except expat.ExpatError as error:
            raise ValueError(f"no XML: {error}") from error
        finally:
            contents.line = parser.CurrentLineNumber
    return contents.mesh(path)


def _take(contents: Contents, element: Element, block: Element) -> None:
    """Add an item of a block of the mesh, or numbers that are the text of a set."""
    words = (element.text or "").replace(",", " ").split()
    # files of version 2 name their elements by elset
    name = block.get("name", block.get("elset", ""))
    if block.tag == "Nodes":
        contents.points[element.attrib["id"]] = [float(word) for word in words]
    elif block.tag == "Elements" and (kind := _KINDS.get(block.attrib["type"].lower())):
        # further nodes lie inside of the element
        contents.add(kind, element.attrib["id"], words[: COUNTS[kind]])
        contents.sets.setdefault(name or int(block.get("mat", "1")), []).append(
            element.attrib["id"]
        )
    elif block.tag == "Elements":
        contents.left_out[name or block.attrib["type"]] = (
            f"elements of type {block.attrib['type']} are not read"
        )
    elif block.tag in ("Surface", "Edge"):
        contents.add(_KINDS[element.tag.lower()], (name, element.attrib["id"]), words)
        contents.sets.setdefault(name, []).append((name, element.attrib["id"]))
    elif element.tag in ("NodeSet", "ElementSet") or block.tag in ("NodeSet", "ElementSet"):
        is_set = element.tag.endswith("Set")
        sets = contents.nodes if "NodeSet" in (element.tag, block.tag) else contents.sets
        members = (
            [number for word in words for number in _members(word)]
            if is_set
            else [element.attrib["id"]]
        )
        sets.setdefault(element.get("name", "") if is_set else name, []).extend(members)


def _members(word: str) -> Iterator[str]:
    """Numbers of a word of a set: one number, or a range with both ends, such as ``1:7`` or
    ``1:7:2``.
    """
    first, *bounds = word.split(":")
    if not bounds:
        yield word
        return
    if len(bounds) > 2:
        raise ValueError(f"{word!r} is no range of numbers, first:last or first:last:step")
    last, step = (*map(int, bounds), 1)[:2]
    yield from map(str, range(int(first), last + 1, step))
