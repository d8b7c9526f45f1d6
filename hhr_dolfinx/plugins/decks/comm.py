"""Command files of code_aster, as far as they are literal: materials, supports, loads and contacts
of a scene.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.plugins.decks.bodies import bodies_of
from hhr_dolfinx.plugins.decks.comm_commands import Command, commands_of, number
from hhr_dolfinx.plugins.decks.comm_keywords import COMMANDS, HYPOTHESES
from hhr_dolfinx.plugins.decks.comm_solver import computation_of
from hhr_dolfinx.plugins.decks.comm_surcharge import Applied, covered_by, what_counts
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
from hhr_dolfinx.plugins.decks.inp_history import in_order
from hhr_dolfinx.plugins.decks.named import NamedParts
from hhr_dolfinx.plugins.decks.planes import Plane, planes_of

PLANE_MODELS = tuple(name for name, hypothesis in HYPOTHESES.items() if hypothesis != "solid")
_NUMBERS = ("DX", "DY", "DZ", "PRES", "FX", "FY", "FZ")
_COMPONENTS = ("DX", "DY", "DZ")
_IMPOSED = ("DDL_IMPO", "FACE_IMPO", "MECA_IMPO")
_FORCES = ("FORCE_NODALE", "FORCE_FACE", "FORCE_CONTOUR")


def read_comm(path: Path, mesh: Path, parts: NamedParts) -> Deck:
    """Read materials, supports, loads and contacts of a command file, with the groups of its mesh.

    Args:
        path: the command file.
        mesh: file of its mesh.
        parts: bodies, surfaces and sets of this mesh.

    Raises:
        FileContentError: for a file that is no Python.
        SceneError: for bodies without a literal elastic material.
    """
    commands = list(commands_of(path))
    acting = computation_of(commands)
    sections = [*_sections(acting.fields, parts)]
    if not sections:
        raise SceneError(
            f"{path.name} gives no body a literal material: DEFI_MATERIAU(ELAS=_F(E=..., NU=...))"
        )
    planes, curved = planes_of(mesh)
    todo = [entry for command in commands for entry in command.unread]
    todo += [command.left("not read") for command in commands if command.name not in COMMANDS]
    loaded: list[Applied | DeckLoad | Left] = []
    for command, factor in acting.charges.items():
        for kind in command.words:
            for entry in command.factors(kind):
                loaded += _weight(entry, factor, parts, sections) if kind == "PESANTEUR" else []
                loaded += _loaded(command, kind, entry, factor, parts, planes)
    hypothesis = _hypothesis(acting.models, parts, todo)
    acting_entries = [*what_counts([entry for entry in loaded if isinstance(entry, Applied)])]
    acting_entries += [entry for entry in loaded if not isinstance(entry, Applied)]
    paired = [
        entry for command in acting.contacts for entry in _pairs(command, parts, planes, curved)
    ]
    supports = tuple(entry for entry in acting_entries if isinstance(entry, Support))
    loads = [
        _of_rings(entry) if hypothesis == "axisymmetric" else entry
        for entry in acting_entries
        if isinstance(entry, DeckLoad)
    ]
    pairs = tuple(entry for entry in paired if isinstance(entry, Pair))
    todo += [
        *acting.left,
        *(entry for entry in (*acting_entries, *paired) if isinstance(entry, Left)),
    ]
    return Deck(
        mesh,
        hypothesis,
        tuple(sections),
        supports,
        tuple(loads),
        pairs or parts.out_of_reach(supports),
        in_order(todo),
        contact_lost=bool(acting.contacts) and not pairs,
    )


def _hypothesis(models: Sequence[Command], parts: NamedParts, todo: list[Left]) -> str:
    """Hypothesis of the model; SceneError for a plane mesh without a model that is read."""
    factors = [factor for command in models for factor in command.factors("AFFE")]
    kinds = {
        HYPOTHESES.get(str(factor.words.get("MODELISATION")).upper()): factor for factor in factors
    }
    models_of = {kind: factor for kind, factor in kinds.items() if kind is not None}
    if not models_of and parts.raw.dim == 2:
        source = f"{models[0].source} AFFE_MODELE" if models else "the command file"
        raise SceneError(
            f"{source} has no MODELISATION that is read, and a plane mesh needs one: "
            f"{', '.join(PLANE_MODELS)}"
        )
    hypothesis = next(iter(models_of), "solid")
    todo += [
        factor.left(f"all cells are {hypothesis}")
        for kind, factor in models_of.items()
        if kind != hypothesis
    ]
    return hypothesis


def _sections(fields: Sequence[Command], parts: NamedParts) -> Iterator[Section]:
    """Bodies with their materials; SceneError for a factor without a body of the mesh or a literal
    elastic material.
    """
    groups: dict[Command, list[Tag] | None] = {}
    for factor in (inner for command in fields for inner in command.factors("AFFE")):
        title = f"{factor.source} AFFE_MATERIAU"
        names = factor.groups("GROUP_MA")
        tags = [tag for tag in map(parts.body, names) if tag is not None]
        if len(tags) < len(names):
            raise SceneError(f"{title}: the mesh has no body of {names}")
        if not names and ("GROUP_MA" in factor.words or factor.words.get("TOUT") != "OUI"):
            raise SceneError(f"{title}: it has no literal GROUP_MA, nor TOUT='OUI'")
        groups[factor] = None if factor.words.get("TOUT") == "OUI" else tags
    titles = [f"{factor.source} AFFE_MATERIAU" for factor in groups]
    for factor, tags in zip(groups, bodies_of(parts, [*groups.values()], titles), strict=True):
        if tags:
            material = _material(factor)
            yield from (Section(tag, material, factor.source) for tag in tags)


def _material(factor: Command) -> DeckMaterial:
    """Elastic material of a factor of AFFE_MATERIAU; SceneError for one that is not literal."""
    value = factor.words.get("MATER")
    material = value[0] if isinstance(value, tuple) and value else value
    elastic = next(iter(material.factors("ELAS")), None) if isinstance(material, Command) else None
    young, poisson, expansion, density = (
        number(elastic.words.get(name)) if elastic is not None else None
        for name in ("E", "NU", "ALPHA", "RHO")
    )
    if elastic is None or young is None or poisson is None:
        raise SceneError(
            f"{factor.source} AFFE_MATERIAU: the material has no literal ELAS=_F(E=..., NU=...)"
        )
    return DeckMaterial("ELAS", elastic.source, young, poisson, "", expansion, density)


def _weight(
    factor: Command, scale: float, parts: NamedParts, sections: Sequence[Section]
) -> Iterator[DeckLoad | Left]:
    """Weights of all bodies: DIRECTION has any length, and only its direction counts (U4.44.01,
    PESANTEUR).
    """
    direction = factor.numbers("DIRECTION")
    gravity = factor.numbers("GRAVITE")
    if factor.groups("GROUP_MA"):
        yield factor.left("PESANTEUR of a group has no counterpart: hhr.BodyForce in loads")
        return
    if direction is None or gravity is None:
        yield factor.left("PESANTEUR without a literal GRAVITE and DIRECTION has no counterpart")
        return
    if not any(direction):
        yield factor.left("DIRECTION of PESANTEUR is zero, and no weight acts: give it a direction")
        return
    unit = tuple((np.array(direction) / np.linalg.norm(direction))[: parts.raw.dim].tolist())
    for section in sections:
        if section.material.density is None:
            yield factor.left(f"PESANTEUR: the material of body '{section.tag}' has no RHO")
        elif any(unit):
            text = f"hhr.BodyForce({section.tag!r}, {unit}, {{}})"
            yield DeckLoad(
                "weight", text, scale * gravity[0] * section.material.density, factor.source
            )


def _loaded(
    command: Command,
    kind: str,
    factor: Command,
    scale: float,
    parts: NamedParts,
    planes: Mapping[str, Plane],
) -> Iterator[Applied | Left]:
    """Supports or loads of a factor of AFFE_CHAR_MECA, and what is left of them.

    Motions of rigid planes are noted.
    """
    if kind == "PESANTEUR":
        return
    dim = parts.raw.dim
    values = {name: number(factor.words[name]) for name in _NUMBERS if name in factor.words}
    scaled = {name: value * scale for name, value in values.items() if value is not None}
    if lost := [
        name for name, value in values.items() if value is None and factor.words[name] is not None
    ]:
        yield factor.left(f"{', '.join(lost)} of {kind} is no number")
    groups = factor.groups("GROUP_MA", "GROUP_NO")
    held = factor.words.get("LIAISON") == "ENCASTRE" or factor.words.get("BLOCAGE") == "DEPLACEMENT"
    imposed = dict.fromkeys(_COMPONENTS, 0.0) if held else scaled
    if held and any(scaled.values()):
        yield factor.left(f"{kind}: it holds the group and moves it too, and here it is held")
    for name in groups:
        target = parts.place(name)
        surface = parts.surface(name)
        if kind in _IMPOSED and target is None and name.upper() in planes:
            for k in range(dim):
                planes[name.upper()][2][k] = imposed.get(_COMPONENTS[k], 0.0)
        elif kind in _IMPOSED and target is not None:
            nodes = covered_by(parts, target, of_facets=False)
            for k, axis in enumerate(_COMPONENTS[:dim]):
                if axis in imposed:
                    support = Support(target, k, imposed[axis], factor.source)
                    yield Applied(command, kind, factor, frozenset({axis}), nodes, (support,))
        elif (kind == "PRES_REP" and surface is not None) or (
            kind in _FORCES and target is not None
        ):
            at = target if surface is None or kind == "FORCE_NODALE" else surface
            assert at is not None  # a surface is a place
            facets = covered_by(parts, at, of_facets=kind != "FORCE_NODALE")
            loads = _loads(kind, scaled, at, dim, factor.source)
            yield Applied(command, kind, factor, frozenset(scaled), facets, loads)
        else:
            yield factor.left(f"{kind} of '{name}' has no counterpart, or is not in the mesh")
    if not groups:
        yield factor.left(f"{kind} without a group has no counterpart")


def _loads(
    kind: str, own: Mapping[str, float], place: Tag, dim: int, source: str
) -> tuple[DeckLoad, ...]:
    """Pressure on a surface, or a force of each component on a place."""
    if kind == "PRES_REP":
        return (
            (DeckLoad("pressure", f"hhr.Pressure({place!r}, {{}})", own["PRES"], source),)
            if "PRES" in own
            else ()
        )
    load_class = "NodalForce" if kind == "FORCE_NODALE" else "Traction"
    forces = [own.get(name, 0.0) for name in ("FX", "FY", "FZ")[:dim]]
    units = [tuple(np.eye(dim)[k].tolist()) for k in range(dim)]
    texts = [f"hhr.{load_class}({place!r}, {unit}, {{}})" for unit in units]
    return tuple(
        DeckLoad("force", text, value, source)
        for text, value in zip(texts, forces, strict=True)
        if value
    )


def _of_rings(load: DeckLoad) -> DeckLoad:
    """A force of a node on its whole ring: in axisymmetry code_aster has that of one radian."""
    return (
        replace(load, value=2 * np.pi * load.value)
        if load.text.startswith("hhr.NodalForce")
        else load
    )


def _pairs(
    command: Command, parts: NamedParts, planes: Mapping[str, Plane], curved: Sequence[str]
) -> Iterator[Pair | Left]:
    """Pairs of a DEFI_CONTACT: a straight line or flat surface without cells, as rigid tools have,
    is an obstacle.
    """
    for zone in command.factors("ZONE"):
        names = [(*zone.groups(key), "")[0] for key in ("GROUP_MA_ESCL", "GROUP_MA_MAIT")]
        slave, master = surfaces = [parts.surface(name) for name in names]
        friction = (
            number(zone.words.get("COULOMB", 0.0))
            if command.words.get("FROTTEMENT") == "COULOMB"
            else 0.0
        )
        if friction is None:
            yield zone.left(
                "COULOMB is not literal, and the pair is frictionless: give it friction="
            )
        if slave is not None and master is not None:
            yield parts.pair(slave, master, friction or 0.0, zone.source)
            continue
        deformable = slave if slave is not None else master
        lost = [name for name, surface in zip(names, surfaces, strict=True) if surface is None]
        tool = lost[0].upper()
        if deformable is None or tool not in planes:
            round_tool = (
                "it is curved, and has no cells: hhr.Profile, hhr.Sphere or hhr.RigidMesh in "
                "contacts"
            )
            reason = round_tool if tool in curved else "it is no surface with facets of the mesh"
            yield zone.left(f"the pair of {names} is not in the scene. '{lost[0]}': {reason}")
            continue
        point, normal, motion = planes[tool]
        along = motion - (motion @ normal) * normal
        if friction and along.any():
            yield zone.left(
                "a rigid plane that moves along the body does not drag it here: hhr.drive(scene, "
                "CONTACT, at=.., motion={..}) does"
            )
        pair = parts.on_plane(deformable, point, normal, friction or 0.0, zone.source)
        yield replace(pair, gap=float(motion @ parts.towards(deformable, normal)))
