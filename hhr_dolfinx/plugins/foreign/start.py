"""A scene file from a deck and the stiffness that its code wrote: ``hhr start part.inp --stiffness
part.sti``.

Of the deck supports, nodal forces, pressures and contact pairs are read, those of the last step;
elements and materials are in K. What has no counterpart is a TODO line.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hhr_dolfinx.errors import FileContentError, SceneError
from hhr_dolfinx.geometries.abaqus_blocks import DeckContents, blocks, name_of_loaded
from hhr_dolfinx.geometries.abaqus_deck import flat_deck
from hhr_dolfinx.plugins.foreign.case import read_case
from hhr_dolfinx.plugins.foreign.faces import Faces
from hhr_dolfinx.plugins.foreign.nodes import (
    ForeignNodes,
    read_nodes,
    solids_of_deck,
    thin_elements,
)
from hhr_dolfinx.plugins.foreign.readers import read_stiffness

MOST_LOAD_PARAMETERS = 3
"""Most loads that become parameters."""
RELATIVE_RANGE = 0.2
"""Part of its value by which a parameter varies to both sides."""
PLANE_TOLERANCE = 1e-9
"""Part of the size of a surface up to which it is a plane."""
OF_ELEMENTS = (
    "NODE", "ELEMENT", "NSET", "ELSET", "SURFACE", "MATERIAL", "ELASTIC", "DENSITY",
    "SOLID SECTION", "SHELL SECTION", "BEAM SECTION", "SURFACE INTERACTION", "SURFACE BEHAVIOR",
    "ORIENTATION", "HEADING", "STEP", "END STEP", "STATIC", "CONTACT FILE",
    "TRANSVERSE SHEAR STIFFNESS", "NODAL THICKNESS", "CONTROLS", "RESTART", "TIME POINTS",
)  # fmt: skip
"""Keywords that are in K, or have no effect."""
ACTING = ("TEMPERATURE", "AMPLITUDE", "CLEARANCE", "INITIAL CONDITIONS", "DFLUX", "CFLUX")
"""Keywords of loads and gaps, which are in no K."""
OF_MATERIALS = (
    "ELASTIC", "SOLID SECTION", "SHELL SECTION", "BEAM SECTION", "ORIENTATION",
    "SPRING", "NODAL THICKNESS",
)  # fmt: skip
"""Keywords that decide what K is, besides the mesh."""
RESULTS = ("PRINT", "FILE", "OUTPUT")
"""Ends of keywords that choose results."""


@dataclass
class Read:
    """Parts of a scene as text of Python, filled block by block.

    Attributes:
        displacements, loads, contacts, openings: items of the scene.
        values: value in the deck of each parameter by its name.
        left: TODO lines.
        motions: motion in the deck of nodes that are not in K, such as those of a plate, (3,) each.
        held: directions of each node of the deck that ``*BOUNDARY`` states.
    """

    displacements: list[str] = field(default_factory=list)
    loads: list[str] = field(default_factory=list)
    contacts: list[str] = field(default_factory=list)
    openings: list[str] = field(default_factory=list)
    values: dict[str, float] = field(default_factory=dict)
    left: list[str] = field(default_factory=list)
    motions: dict[int, np.ndarray] = field(default_factory=dict)
    held: dict[int, set[int]] = field(default_factory=dict)

    @property
    def fixed(self) -> set[int]:
        """Nodes that are held or displaced in all directions."""
        return {node for node, directions in self.held.items() if {1, 2, 3} <= directions}

    def amplitude(self, kind: str, value: float) -> str:
        """Parameter for a load of a value, as text; the number itself after a few parameters.

        Args:
            kind: kind of load, which names the parameter.
            value: value of the load.
        """
        if len(self.values) == MOST_LOAD_PARAMETERS:
            return repr(value)
        name = kind if kind not in self.values else f"{kind}_{len(self.values) + 1}"
        self.values[name] = value
        return f'"{name}"'


def scene_text(
    file: Path, stiffness: Path, target: Path, case: Path | None, dofs: Path | None
) -> tuple[str, list[str]]:
    """Text of a scene file, and its TODO lines.

    Args:
        file: deck with surfaces, supports, loads and contact.
        stiffness: K of the same mesh.
        target: the scene file, to whose folder the text refers.
        case: solved case; None for an unchecked K.
        dofs: table of dofs of the stiffness, if it needs one.

    Raises:
        FileContentError: for a deck or a stiffness that cannot be read.
        SceneError: for a deck without contact.
    """
    deck = flat_deck(file)
    results = _results(deck, file, case)
    nodes = read_nodes(file, results)
    solids = solids_of_deck(deck)
    in_k = set(read_stiffness(stiffness, dofs).nodes.tolist())
    read = Read()
    _check_steps(file)
    _supports(file, deck, in_k, read)
    if case is not None and case.suffix.lower() == ".inp":
        _check_same_model(file, case, in_k, read)
    for line, keyword, options, rows in blocks(file):
        where = f"{file.name}:{line}"
        if keyword in ("CLOAD", "DLOAD", "DSLOAD") and rows:
            _loads(read, where, keyword, line, rows, nodes)
        elif keyword == "CONTACT PAIR":
            if "ADJUST" in options:
                read.left.append(
                    f"TODO {where} *CONTACT PAIR, ADJUST: no node moves here, gaps are those of "
                    "the mesh; hhr.Opening(CONTACT, 0.0, overwrites=True) closes them"
                )
            _contact(read, where, rows, (nodes, solids), _interaction(file, options, read))
        elif keyword in ACTING:
            read.left.append(
                f"TODO {where} *{keyword}: not read beside a stiffness, and in no K: write its "
                "load vector in the other code, ForeignLoad, or give a gap as an Opening"
            )
        elif keyword not in (*OF_ELEMENTS, "BOUNDARY", "FRICTION") and not keyword.endswith(
            RESULTS
        ):
            read.left.append(
                f"TODO {where} *{keyword}: not read beside a stiffness; if it changes K, it is in K"
            )
        read.left += _ignored(where, keyword, options)
        if keyword == "STEP" and "NLGEOM" in options:
            read.left.append(f"TODO {where} *STEP, NLGEOM: displacements are small here")
    if not read.contacts:
        raise SceneError(
            f"{file.name}: a scene needs a contact pair, and no *CONTACT PAIR of it has a "
            "counterpart. Name the surface "
            "and a fixed plate in the deck" + "".join(f". {line}" for line in read.left)
        )
    files = {"results": results, "case": case, "dofs": dofs}
    return _text(file, stiffness, target, files, read), read.left


def _results(deck: DeckContents, file: Path, case: Path | None) -> Path | None:
    """Results with the nodes of shells and beams: those of the solved case; None for a deck of
    solids.
    """
    if not thin_elements(deck):
        return None
    return (file if case is None or case.suffix.lower() != ".inp" else case).with_suffix(".frd")


def _check_steps(file: Path) -> None:
    """Raise FileContentError for a deck of several steps, whose loads follow each other."""
    steps = [line for line, keyword, _, _ in blocks(file) if keyword == "STEP"]
    if len(steps) > 1:
        raise FileContentError(
            f"{file.name}:{steps[1]} *STEP: beside a stiffness one step is read, and the deck has "
            f"{len(steps)}: leave the one whose loads you mean"
        )


def _check_same_model(file: Path, case: Path, in_k: set[int], read: Read) -> None:
    """Raise FileContentError for a deck whose K would not be that of its solved case."""
    ours = list(_materials(file))
    for theirs in _materials(case):  # the deck has those of rigid plates too
        if theirs not in ours:
            raise FileContentError(
                f"*{theirs[1]} of {case.name} is not in {file.name}: K is of another material or "
                "section. Write K and solve the case anew from this deck"
            )
    held = read_case(case).held
    lost = [(node, way) for node, way in held if way not in read.held.get(node, ()) and way <= 3]
    if lost := [dof for dof in lost if dof[0] not in in_k]:
        raise FileContentError(
            f"{case.name} holds dof {lost[0][0]}.{lost[0][1]}, which K has left out, and "
            f"{file.name} does not hold it: write K and solve the case anew from this deck"
        )


def _materials(file: Path) -> Iterator[tuple[str, str, list[tuple[str, str]], list[list[str]]]]:
    """Materials and sections of a deck: material, keyword, options and lines."""
    material = ""
    for _, keyword, options, rows in blocks(file):
        if keyword == "MATERIAL":
            material = options.get("NAME", "").upper()
        if keyword in OF_MATERIALS:
            yield material if keyword == "ELASTIC" else "", keyword, sorted(options.items()), rows


def _ignored(where: str, keyword: str, options: dict[str, str]) -> Iterator[str]:
    """TODO lines of options of loads and supports that are not read."""
    if keyword not in ("CLOAD", "DLOAD", "DSLOAD", "BOUNDARY"):
        return
    if "AMPLITUDE" in options:
        yield f"TODO {where} *{keyword}, AMPLITUDE: values are those of the line, times 1"
    if options.get("OP", "").upper() == "NEW":
        yield (
            f"TODO {where} *{keyword}, OP=NEW: what was stated before stays; a support that K "
            "has left out cannot be removed"
        )


def _supports(file: Path, deck: DeckContents, in_k: set[int], read: Read) -> None:
    """Read ``*BOUNDARY``; a later line replaces those before on the same dofs."""
    stated: dict[tuple[str, int], tuple[set[int], str]] = {}
    for line, keyword, _, rows in blocks(file):
        if keyword != "BOUNDARY":
            continue
        for row in rows:
            words = [word for word in row if word]
            members = deck.members(words[0].upper()) or (
                [int(words[0])] if words[0].isdigit() else []
            )
            first = int(words[1])
            last = int(words[2]) if len(words) > 2 and words[2].isdigit() else first
            value = float(words[3]) if len(words) > 3 else 0.0
            for node in members:
                read.held.setdefault(node, set()).update(range(first, last + 1))
            if not in_k & set(members) and not _is_fixed_in_k(members, in_k, deck):
                for node in members if value else ():  # of a tool that is not in K
                    motion = read.motions.setdefault(node, np.zeros(3))
                    motion[first - 1 : min(last, 3)] = value
                continue
            for component in range(first, min(last, 3) + 1):
                _replace(stated, component, set(members))
                amplitude = f", {read.amplitude('displacement', value)}" if value else ""
                text = (
                    f"hhr.Displacement({_tag(words[0])}, {component - 1}{amplitude}),  # "
                    f"{file.name}:{line}"
                )
                stated[words[0].upper(), component] = set(members), text
    read.displacements += [text for _, text in stated.values()]


def _replace(
    stated: dict[tuple[str, int], tuple[set[int], str]], component: int, members: set[int]
) -> None:
    """Take away the supports before of a component all of whose nodes are stated again."""
    for key in [key for key, (nodes, _) in stated.items() if nodes <= members]:
        if key[1] == component:
            del stated[key]


def _is_fixed_in_k(members: Sequence[int], in_k: set[int], deck: DeckContents) -> bool:
    """True if nodes belong to an element with nodes of K: they are held there, and left out of
    it.
    """
    named = set(members)
    return any(named & set(nodes) and in_k & set(nodes) for nodes in deck.whole.values())


def _tag(word: str) -> str:
    """A node or a set as Python."""
    return word if word.isdigit() else repr(word).replace("'", '"')


def _loads(
    read: Read, where: str, keyword: str, line: int, rows: list[list[str]], nodes: ForeignNodes
) -> None:  # fmt: skip
    """Read a block of forces or pressures; forces of one node or set are one load.

    Lines of a face and a pressure that are the same are one surface of all of their elements.
    """
    forces: dict[str, np.ndarray] = {}
    pressed: set[str] = set()
    for row in rows:
        words = [word for word in row if word]
        if keyword == "CLOAD":
            if int(words[1]) > 3:
                read.left.append(
                    f"TODO {where} *CLOAD: a moment; write the load vector, ForeignLoad"
                )
                continue
            forces.setdefault(words[0], np.zeros(3))[int(words[1]) - 1] += float(words[2])
            continue
        name = words[0] if keyword == "DSLOAD" else name_of_loaded(f"DLOAD:{line}", row[1:])
        surfaces = {surface.upper(): surface for surface in nodes.surfaces}
        if not re.fullmatch(r"P\d?", words[1].upper()) or name.upper() not in surfaces:
            read.left.append(
                f"TODO {where} *{keyword} {words[1]}: write its load vector in the other code, "
                "and give it as ForeignLoad"
            )
            continue
        if keyword == "DLOAD" and name.upper() in pressed:
            continue
        pressed.add(name.upper())
        amplitude = read.amplitude("pressure", float(words[2]))
        read.loads.append(f'hhr.Pressure("{surfaces[name.upper()]}", {amplitude}),  # {where}')
    for word, force in forces.items():
        size = float(np.abs(force).max())
        vector = tuple((force / size).tolist())
        read.loads.append(
            f"hhr.NodalForce({_tag(word)}, {vector}, {read.amplitude('force', size)}),  # {where}"
        )


def _interaction(file: Path, options: dict[str, str], read: Read) -> str:
    """Friction and soft contact of the interaction of a pair as arguments; empty without."""
    wanted = options.get("INTERACTION", "").upper()
    interaction = law = friction = ""
    for line, keyword, block_options, rows in blocks(file):
        where = f"{file.name}:{line}"
        if keyword == "SURFACE INTERACTION":
            interaction = block_options.get("NAME", "").upper()
        elif interaction != wanted:
            continue
        elif keyword == "FRICTION" and "ROUGH" in block_options:
            friction = "1e6"  # forces have the same digits from 1e3 on
        elif keyword == "FRICTION" and rows:
            friction = _friction(rows[0][0], block_options)
        elif keyword == "SURFACE BEHAVIOR":
            law = _curve(where, block_options, rows, read)
    return (f", friction={friction}" if friction else "") + (f", law={law}" if law else "")


def _friction(coefficient: str, options: dict[str, str]) -> str:
    """Coulomb's law as text of Python, with the largest shear stress of ``TAUMAX``."""
    if not float(coefficient):
        return ""
    if "TAUMAX" not in options:
        return repr(float(coefficient))
    return f"hhr.Coulomb({float(coefficient)!r}, {float(options['TAUMAX'])!r})"


def _curve(where: str, options: dict[str, str], rows: list[list[str]], read: Read) -> str:
    """Soft contact of a ``*SURFACE BEHAVIOR`` as text of Python; empty for hard contact."""
    kind = options.get("PRESSURE-OVERCLOSURE", "HARD").upper()
    if "NO SEPARATION" in options:
        if kind == "HARD":
            read.left.append(
                f"TODO {where} *SURFACE BEHAVIOR, NO SEPARATION: surfaces hold from the end of the "
                "step in which they have pressed"
            )
            return "hhr.NoSeparation()"
        read.left.append(
            f"TODO {where} *SURFACE BEHAVIOR, NO SEPARATION: surfaces of this curve may open here"
        )
    numbers = [[float(word) for word in row if word] for row in rows]
    try:
        if kind == "EXPONENTIAL":
            clearance, pressure, *_ = [value for row in numbers for value in row]
            return f"hhr.SoftContact(exponential=({clearance!r}, {pressure!r}))"
        if kind == "TABULAR":
            return f"hhr.SoftContact(table={tuple((row[1], row[0]) for row in numbers)!r})"
        if kind != "HARD":
            read.left.append(
                f"TODO {where} *SURFACE BEHAVIOR, {kind}: contact is hard here, surfaces do not "
                "overlap. If that stiffness is meant, give the pair "
                f"law=hhr.SoftContact(stiffness={numbers[0][0]!r})"
            )
    except (ValueError, IndexError):
        read.left.append(f"TODO {where} *SURFACE BEHAVIOR, {kind}: its curve is not understood")
    return ""


def _contact(
    read: Read, where: str, rows: list[list[str]], given: tuple[ForeignNodes, ForeignNodes],
    argument: str,
) -> None:  # fmt: skip
    """Read a pair: a plane for a master that is held or displaced, two surfaces otherwise."""
    nodes, solids = given  # nodes of K, and of the deck as it is, which has rigid plates too
    surfaces = {name.upper(): name for name in nodes.surfaces}
    fixed = {name.upper(): surface for name, surface in solids.surfaces.items()}
    sets = {name.upper(): name for name in nodes.sets}
    slave, master = (word.upper() for word in [word for word in rows[0] if word][:2])
    if master not in {**surfaces, **fixed} or slave not in {**surfaces, **sets}:
        read.left.append(
            f"TODO {where} *CONTACT PAIR {slave}, {master}: no faces of nodes that are there"
        )
        return
    faces = fixed.get(master)
    members = set() if faces is None else set(solids.decks[faces.members].tolist())
    if faces is not None and members <= read.fixed:
        plane = _plane(solids, faces)
        if plane is None:
            read.left.append(
                f"TODO {where} *CONTACT PAIR {slave}, {master}: the held surface is no plane; "
                "give it as a RigidMesh"
            )
            return
        normal, offset = plane
        direction = f"{tuple(normal.tolist())}"
        _move(read, where, normal, [read.motions.get(node, np.zeros(3)) for node in members],
              "friction" in argument)  # fmt: skip
        if slave in surfaces:
            read.contacts.append(
                f'hhr.Obstacle("{surfaces[slave]}", {direction}, {offset!r}{argument}),  # {where}'
            )
        else:
            read.contacts.append(
                f'hhr.NodesToGround("{sets[slave]}", {direction}, '
                f"plane={offset!r}{argument}),  # {where}"
            )
        return
    if slave not in surfaces:
        read.left.append(
            f"TODO {where} *CONTACT PAIR {slave}: a slave of nodes on a body needs faces, "
            "TYPE=ELEMENT"
        )
        return
    read.contacts.append(
        f'hhr.Mortar("{surfaces[slave]}", "{surfaces[master]}"{argument}),  # {where}'
    )


def _move(
    read: Read, where: str, normal: np.ndarray, motions: list[np.ndarray], with_friction: bool
) -> None:
    """Open the gap of the next contact by the motion of a plane along its normal, (3,)."""
    motion = motions[0]
    if any((other != motion).any() for other in motions):
        read.left.append(
            f"TODO {where} *CONTACT PAIR: nodes of the held surface move apart from each other; "
            "its gap is that of the mesh"
        )
        return
    opened = float(normal @ motion)
    if opened:
        named = read.amplitude("motion", opened)
        amplitude = f"slopes={{{named}: 1.0}}" if named.startswith('"') else named
        read.openings.append(
            f"hhr.Opening({len(read.contacts)}, hhr.Amplitude({amplitude})),  # {where}"
        )
    if with_friction and np.linalg.norm(motion - opened * normal) > 0:
        read.left.append(
            f"TODO {where} *CONTACT PAIR: a plane that moves along the body does not drag it by "
            "friction here: move the body instead"
        )


def _plane(nodes: ForeignNodes, faces: Faces) -> tuple[np.ndarray, float] | None:
    """Normal into a flat surface, (3,), and its offset, n·x; None for a surface that is not
    flat.
    """
    points = nodes.points[faces.members]
    middle = points.mean(axis=0)
    _, sizes, ways = np.linalg.svd(points - middle)
    if sizes[-1] > PLANE_TOLERANCE * sizes[0] + 1e-12 * np.abs(points).max():
        return None
    inwards = np.concatenate(faces.inner).mean(axis=0) - middle
    normal = ways[-1] * np.sign(ways[-1] @ inwards)
    normal = np.round(normal, 12) + 0.0
    return normal, float(f"{normal @ middle:.12g}")


def _text(
    file: Path, stiffness: Path, target: Path, files: dict[str, Path | None], read: Read
) -> str:
    """The scene file; ``files`` are arguments of the block."""
    folder = target.absolute().parent

    def path(location: Path) -> str:
        return f'HERE / "{Path(os.path.relpath(location.absolute(), folder)).as_posix()}"'

    stem = re.sub(r"\W", "_", file.stem)
    stem = stem if stem.isidentifier() else f"deck_{stem}"
    block = [f"{path(stiffness)},", f"{path(file)},"]
    block += [
        f"{name}={path(location)}," for name, location in files.items() if location is not None
    ]
    block += ["unchecked=True,"] if files["case"] is None else []
    if not read.values:
        read.values["lift"] = 0.0
        read.openings.append('hhr.Opening(0, hhr.Amplitude(slopes={"lift": 1.0})),')
    outputs = ["hhr.UncheckedStiffness(),"] if files["case"] is None else []
    for number in range(len(read.contacts)):
        outputs.append(f'hhr.LargestPressure("largest pressure {number}", contact={number}),')
        outputs += [
            f'hhr.ContactForce("force {number} {axis}", contact={number}, direction={tuple(way)}),'
            for axis, way in zip("xyz", np.eye(3).tolist(), strict=True)
        ]
    lines = [
        f'"""Scene of {file.name} with the stiffness {stiffness.name}, written by hhr start.',
        "",
    ]
    lines += [
        f"    hhr solve {target.name}    # the middle of the box, which is the state of the deck"
        + (", but for the TODO lines" if read.left else "")
    ]
    lines += [f"    hhr reduce {target.name}   # a model of all of the box", '"""', ""]
    lines += [
        "from pathlib import Path",
        "",
        "import hhr_dolfinx as hhr",
        "",
        "HERE = Path(__file__).parent",
    ]
    lines += [f"# {todo}" for todo in read.left]
    lines += [
        "",
        "foreign = hhr.ForeignStiffness(",
        "    hhr.ForeignBlock(",
        *(f"        {line}" for line in block),
    ]
    lines += ["    )", ")", "scene = foreign.scene(", f'    "{stem}",']
    arguments = {
        "contacts": read.contacts,
        "displacements": read.displacements,
        "loads": read.loads,
    }
    for name, texts in {**arguments, "openings": read.openings, "outputs": outputs}.items():
        if texts:
            lines += [f"    {name}=(", *(f"        {text}" for text in texts), "    ),"]
    lines += [*_space(read.values), ")"]
    return "\n".join(lines) + "\n"


def _space(values: dict[str, float]) -> Iterator[str]:
    """Lines of the box of parameters."""
    ends = [
        sorted(((1 - RELATIVE_RANGE) * value, (1 + RELATIVE_RANGE) * value))
        if value
        else [-0.001, 0.001]
        for value in values.values()
    ]
    names = ", ".join(f'"{name}"' for name in values)
    lower, upper = (", ".join(f"{end[k]:.12g}" for end in ends) for k in (0, 1))
    yield "    parameters=hhr.ParameterSpace("
    yield f"        ({names},), lower=({lower},), upper=({upper},)"
    yield "    ),"


def write_scene(
    file: Path, stiffness: Path, target: Path, case: Path | None, dofs: Path | None
) -> list[str]:
    """Write a scene file; its TODO lines.

    Args:
        file, stiffness, target, case, dofs: see :func:`scene_text`.

    Raises:
        FileContentError: for a solved case that does not exist, and as :func:`scene_text` does.
    """
    from hhr_dolfinx.files import replacing

    if case is not None and not case.is_file():
        raise FileContentError(f"there is no solved case {case}")
    text, todo = scene_text(file, stiffness, target, case, dofs)
    with replacing(target, text=True) as out:
        out.write(text)
    return todo
