"""Elements of files of FEBio with their lines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat


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
        return next((element for element in self.items if element.tag == tag), None)

    def number(self, tag: str) -> float | None:
        """Number of a child as the file has it, without a load curve.

        None if it is not there, or a formula.
        """
        element = self.child(tag)
        try:
            return float(element.text) if element is not None else None
        except ValueError:
            return None

    def name(self, key: str) -> str:
        """Attribute, without the kind of set before a name, as in ``@surface:Lid``."""
        return self.attributes.get(key, "").rpartition(":")[2]


def tree_of(path: Path) -> Item:
    """Root of a file that the reader of its mesh has read without an error.

    That reader refuses a DOCTYPE too.
    """
    open_elements = [Item("", {}, 0)]
    parser = expat.ParserCreate()
    parser.buffer_text = True

    def start(tag: str, attributes: dict[str, str]) -> None:
        """Open an element with its ``tag`` and ``attributes``."""
        element = Item(tag, attributes, parser.CurrentLineNumber)
        open_elements[-1].items.append(element)
        open_elements.append(element)

    def data(text: str) -> None:
        open_elements[-1].text += text

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda tag: open_elements.pop()
    parser.CharacterDataHandler = data
    parser.Parse(path.read_bytes(), True)
    return open_elements[0].items[0]
