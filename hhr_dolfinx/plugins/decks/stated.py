"""Physics that mesh files of FEBio, LS-DYNA, Kratos and Nastran state beside their mesh, line by
line.

``hhr start`` reads the mesh of these files. Materials, supports, loads and contact become TODO
lines with a remedy.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from xml.parsers import expat

from hhr_dolfinx.plugins.decks.deck import Left

BODY = "the file states a material: give hhr.Body its young=, poisson= and law="
SUPPORT = "the file states a motion: hhr.Displacement in displacements"
LOAD = "the file states a load: hhr.Pressure, hhr.Traction or hhr.NodalForce in loads"
CONTACT = "the file states contact: name its pair and its friction= in contacts"
CONSTRAINT = "the file states a constraint: hhr.Tie, hhr.Equation or hhr.RigidMotion in constraints"
STATED_STEPS = "the file states steps: hhr.Leg in a hhr.PathFamily"
NOT_READ = "the file states it, and it is not read"
ELSEWHERE = "this section is in another file, which is not read: put it into this one"
OF_FEBIO = {
    "Material": BODY,
    "Boundary": SUPPORT,
    "Loads": LOAD,
    "Contact": CONTACT,
    "Constraints": CONSTRAINT,
    "Rigid": CONSTRAINT,
    "Discrete": "the file states springs: hhr.Springs in loads",
    "Initial": NOT_READ,
    "Step": STATED_STEPS,
}
"""Sections of a file of FEBio whose items are physics."""
_OF_DYNA = {
    "MAT_": BODY,
    "BOUNDARY_": SUPPORT,
    "LOAD_": LOAD,
    "CONTACT_": CONTACT,
    "CONSTRAINED_": CONSTRAINT,
    "INITIAL_": NOT_READ,
    "RIGIDWALL_": "the file states a rigid wall: hhr.Obstacle in contacts",
    "DEFINE_": NOT_READ,
    "EOS_": BODY,
    "PARAMETER": NOT_READ,
    "HOURGLASS": NOT_READ,
    "DAMPING_": NOT_READ,
}
"""Beginnings of keywords of LS-DYNA that are physics.

CONTROL_, DATABASE_ and those of the mesh are not.
"""
_OF_NASTRAN = {
    **dict.fromkeys(
        ("MAT1", "MAT2", "MAT3", "MAT8", "MAT9", "MATS1", "MATHP", "TABLES1", "CREEP"), BODY
    ),
    **dict.fromkeys(("SPC", "SPC1", "SPCD", "SPCADD"), SUPPORT),
    **dict.fromkeys(
        (
            "FORCE",
            "FORCE1",
            "FORCE2",
            "MOMENT",
            "PLOAD",
            "PLOAD1",
            "PLOAD2",
            "PLOAD4",
            "GRAV",
            "RFORCE",
        ),
        LOAD,
    ),
    **dict.fromkeys(("TEMP", "TEMPD", "LOAD"), LOAD),
    **dict.fromkeys(
        ("BCONP", "BLSEG", "BFRIC", "BCTABLE", "BCBODY", "BSURF", "BCTSET", "BCPARA", "BGSET"),
        CONTACT,
    ),
    **dict.fromkeys(("MPC", "MPCADD", "BOLT"), CONSTRAINT),
}
"""Cards of Nastran that are physics."""


def stated_in(path: Path) -> list[Left]:
    """Statements of a file that are no part of its mesh; none for formats without physics."""
    readers: dict[str, Callable[[Path], Iterator[Left]]] = {
        ".feb": _of_febio,
        **dict.fromkeys((".k", ".key", ".dyn"), _of_dyna),
        ".mdpa": _of_kratos,
        **dict.fromkeys((".bdf", ".nas"), _of_nastran),
    }
    reader = readers.get(path.suffix.lower())
    return [] if reader is None else list(reader(path))


def _lines(path: Path) -> Iterator[tuple[str, str]]:
    """Lines of a file with their places."""
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    yield from (
        (f"{path.name}:{number}", line) for number, line in enumerate(text.splitlines(), start=1)
    )


def _of_febio(path: Path) -> Iterator[Left]:
    """Items of the sections of a file, which the reader of meshes has parsed before."""
    todo: list[Left] = []
    open_tags: list[str] = []
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        """Note an element with its ``tag`` and ``attributes``, if it is physics."""
        if len(open_tags) == 2 and (remedy := OF_FEBIO.get(open_tags[1])):
            words = " ".join(f'{key}="{value}"' for key, value in attributes.items() if key != "id")
            todo.append(
                Left(
                    f"{path.name}:{parser.CurrentLineNumber}",
                    f"<{tag} {words}>".replace(" >", ">"),
                    remedy,
                )
            )
        elif len(open_tags) == 1 and tag in OF_FEBIO and "from" in attributes:
            keyword = f'<{tag} from="{attributes["from"]}">'
            todo.append(Left(f"{path.name}:{parser.CurrentLineNumber}", keyword, ELSEWHERE))
        open_tags.append(tag)

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda tag: open_tags.pop()
    parser.Parse(path.read_bytes(), True)
    yield from todo


def _of_dyna(path: Path) -> Iterator[Left]:
    for source, line in _lines(path):
        keyword = line[1:].strip().upper() if line.startswith("*") else ""
        for begin, remedy in _OF_DYNA.items():
            if keyword.startswith(begin):
                yield Left(source, f"*{keyword}", remedy)


def _of_kratos(path: Path) -> Iterator[Left]:
    """Values in blocks of properties and of data of nodes, elements and conditions, and processes
    of tables.
    """
    block_name = ""
    for source, line in _lines(path):
        words = line.partition("//")[0].split()
        if words[:1] == ["Begin"]:
            data = words[1] in ("Properties", "Table") or words[1].endswith("Data")
            block_name = words[1] if data and not block_name else block_name
            kind = (
                SUPPORT
                if words[1] == "NodalData"
                else LOAD
                if words[1] == "ConditionalData"
                else ""
            )
            if kind:
                yield Left(source, " ".join(words[1:]), kind)
        elif words[:1] == ["End"]:
            block_name = "" if words[1:2] == [block_name] else block_name
        elif words and block_name in ("Properties", "ModelPartData"):
            yield Left(source, " ".join(words), BODY if block_name == "Properties" else NOT_READ)


def _of_nastran(path: Path) -> Iterator[Left]:
    for source, line in _lines(path):
        card = re.split(r"[ ,*]", line.strip().upper(), maxsplit=1)[0]
        if card in _OF_NASTRAN and not re.match(rf"\s*{card}\s*=", line, re.IGNORECASE):
            yield Left(source, card, _OF_NASTRAN[card])
