"""Command files of code_aster, as far as they are literal: they are parsed, and nothing of them is executed."""

from __future__ import annotations

import ast
import operator
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from hhr_dolfinx.errors import FileContentError, SceneError
from hhr_dolfinx.plugins.decks.comm_keywords import COMMANDS
from hhr_dolfinx.plugins.decks.deck import Deck, Left, Load, Material, Pair, Section, Support
from hhr_dolfinx.plugins.decks.keywords import OUT, READ
from hhr_dolfinx.plugins.decks.named import NamedParts
from hhr_dolfinx.plugins.decks.planes import Plane, planes_of

_OPERATORS = {ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv}
_HYPOTHESES = {"3D": "solid", "AXIS": "axisymmetric", "D_PLAN": "plane_strain", "C_PLAN": "plane_stress"}
_NUMBERS = ("DX", "DY", "DZ", "PRES", "FX", "FY", "FZ", "GRAVITE")
_COMPONENTS = ("DX", "DY", "DZ")


@dataclass(frozen=True, eq=False)
class Command:
    """A command, or a factor ``_F``, with the literal arguments that are read, and TODO lines of all others."""

    name: str
    source: str
    words: Mapping[str, object] = field(default_factory=dict)
    unread: tuple[Left, ...] = ()

    def factors(self, name: str) -> tuple[Command, ...]:
        """One factor or several."""
        found = self.words.get(name, ())
        return tuple(one for one in (found if isinstance(found, tuple) else (found,)) if isinstance(one, Command))

    def groups(self, *names: str) -> tuple[str, ...]:
        """Names of groups."""
        found = [self.words[name] for name in names if name in self.words]
        every = [one for item in found for one in (item if isinstance(item, tuple) else (item,))]
        return tuple(one for one in every if isinstance(one, str))

    @property
    def ends_at_one(self) -> bool:
        """True for a function whose last value is 1."""
        values = self.words.get("VALE")
        return isinstance(values, tuple) and values[-1:] == (1,)

    def left(self, why: str) -> Left:
        """This command as one without counterpart."""
        return Left(self.source, self.name, why)


def commands_of(path: Path) -> Iterator[Command]:
    """Commands of a file in their order; FileContentError for text that is no Python, with the line."""
    try:
        tree = ast.parse(path.read_text(errors="replace"))
    except (SyntaxError, ValueError) as error:
        raise FileContentError(f"{path.name}:{getattr(error, 'lineno', 0)} is no command file: {error}") from None
    values: dict[str, object] = {}
    for statement in tree.body:
        value = _value(getattr(statement, "value", None), values, path.name)
        value = admitted(value, value.name) if isinstance(value, Command) else value
        if isinstance(statement, ast.Assign) and isinstance(statement.targets[0], ast.Name):
            values[statement.targets[0].id] = value
        if isinstance(value, Command):
            yield value
        elif not isinstance(statement, ast.Assign | ast.Import | ast.ImportFrom | ast.Expr):
            yield Command(type(statement).__name__, f"{path.name}:{statement.lineno}", {"": None})


def admitted(command: Command, name: str) -> Command:
    """Command, or the factor ``COMMAND/FACTOR``, with the keywords that the table of its name reads."""
    keyword = COMMANDS.get(name)
    if keyword is None or keyword.rule.outcome != READ:
        return command
    words: dict[str, object] = {}
    unread: list[Left] = []
    for key, value in command.words.items():
        rule = keyword.rule_of(key, value.upper() if isinstance(value, str) else "")
        empty = isinstance(value, int | float) and not value  # a length or a rotation that is 0
        if rule.why and not empty:
            said = f"{key}={value}: {rule.why}" if isinstance(value, str | int | float) else f"{key}: {rule.why}"
            unread.append(Left(command.source, name.replace("/", " "), said))
        if rule.outcome == OUT:
            return Command(command.name, command.source, {}, tuple(unread))
        if rule.outcome == READ:
            factors = [admitted(one, f"{name}/{key}") for one in command.factors(key) if one.name == "_F"]
            unread += [left for one in factors for left in one.unread]
            words[key] = tuple(one for one in factors if one.words) if factors else value
    return Command(command.name, command.source, words, tuple(unread))


def _value(node: ast.AST | None, values: Mapping[str, object], file: str) -> object:
    """Value of a literal, of a sum or product of such, or of a command; None for anything else."""
    match node:
        case ast.Constant(value=value):
            return value
        case ast.Name(id=name):
            return values.get(name)
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            found = _value(inner, values, file)
            return -found if isinstance(found, int | float) else None
        case ast.BinOp(left=first, op=op, right=second) if type(op) in _OPERATORS:
            a, b = (_value(one, values, file) for one in (first, second))
            both = isinstance(a, int | float) and isinstance(b, int | float)
            return _OPERATORS[type(op)](a, b) if both and not (isinstance(op, ast.Div) and b == 0) else None
        case ast.Tuple(elts=items) | ast.List(elts=items):
            return tuple(_value(one, values, file) for one in items)
        case ast.Call(func=ast.Name(id=name), keywords=words):
            found = {word.arg: _value(word.value, values, file) for word in words if word.arg}
            return Command(name, f"{file}:{node.lineno}", found)
    return None


def read_comm(path: Path, mesh: Path, parts: NamedParts) -> Deck:
    """Read materials, supports, loads and contacts of a command file, with the groups of its mesh.

    Raises:
        FileContentError: for a file that is no Python.
        SceneError: for bodies without a literal elastic material.
    """
    commands = list(commands_of(path))
    sections = [one for command in commands if command.name == "AFFE_MATERIAU" for one in _sections(command, parts)]
    if not sections:
        raise SceneError(f"{path.name} gives no body a literal material: DEFI_MATERIAU(ELAS=_F(E=..., NU=...))")
    planes, curved = planes_of(mesh)
    made: list[Support | Load | Left] = []
    for command in commands:
        made += command.unread
        if command.name in ("AFFE_CHAR_MECA", "AFFE_CHAR_CINE"):
            for kind in command.words:
                made += [i for one in command.factors(kind) for i in _loaded(kind, one, parts, sections, planes)]
                made += [] if command.factors(kind) else [command.left(f"{kind} is not literal")]
        elif command.name not in COMMANDS:
            made.append(command.left("not read"))
        for excited in command.factors("EXCIT"):
            curve = excited.words.get("FONC_MULT")
            if curve is not None and not (isinstance(curve, Command) and curve.ends_at_one):
                made.append(command.left("a load is multiplied by a function that does not end at 1: it counts whole"))
    contacts = [command for command in commands if command.name == "DEFI_CONTACT"]
    paired = [one for command in contacts for one in _pairs(command, parts, planes, curved)]
    supports = tuple(one for one in made if isinstance(one, Support))
    pairs = tuple(one for one in paired if isinstance(one, Pair))
    return Deck(
        mesh,
        _hypothesis(commands, parts),
        tuple(sections),
        supports,
        tuple(one for one in made if isinstance(one, Load)),
        pairs or parts.out_of_reach(supports),
        tuple(one for one in (*made, *paired) if isinstance(one, Left)),
        contact_lost=bool(contacts) and not pairs,
    )


def _hypothesis(commands: Sequence[Command], parts: NamedParts) -> str:
    """Hypothesis of the last model."""
    hypothesis = "solid" if parts.raw.dim == 3 else "plane_strain"
    for command in (one for one in commands if one.name == "AFFE_MODELE"):
        kinds = [str(one.words.get("MODELISATION")) for one in command.factors("AFFE")]
        hypothesis = next((_HYPOTHESES[kind] for kind in kinds if kind in _HYPOTHESES), hypothesis)
    return hypothesis


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def _sections(command: Command, parts: NamedParts) -> Iterator[Section]:
    for factor in command.factors("AFFE"):
        given = factor.words.get("MATER")
        material = given[0] if isinstance(given, tuple) and given else given
        elastic = next(iter(material.factors("ELAS")), None) if isinstance(material, Command) else None
        young, poisson, expansion, density = (
            _number(elastic.words.get(name)) if elastic is not None else None for name in ("E", "NU", "ALPHA", "RHO")
        )
        if elastic is None or young is None or poisson is None:
            raise SceneError(f"{factor.source} {command.name}: the material has no literal ELAS=_F(E=..., NU=...)")
        own = Material("ELAS", elastic.source, young, poisson, "", expansion, density)
        names = factor.groups("GROUP_MA")
        for tag in [parts.body(name) for name in names] if names else parts.apart():
            if tag is None:
                raise SceneError(f"{factor.source} {command.name}: the mesh has no body of {names}")
            yield Section(tag, own, factor.source)


def _loaded(
    kind: str, factor: Command, parts: NamedParts, sections: Sequence[Section], planes: Mapping[str, Plane]
) -> Iterator[Support | Load | Left]:
    """Supports or loads of a factor of AFFE_CHAR_MECA, and what is left of them; motions of rigid planes are noted."""
    dim = parts.raw.dim
    values = {name: _number(factor.words[name]) for name in _NUMBERS if name in factor.words}
    own = {name: value for name, value in values.items() if value is not None}
    lost = [name for name, value in values.items() if value is None]
    if lost:
        yield factor.left(f"{', '.join(lost)} of {kind} is not literal")
    forces = [own.get(name, 0.0) for name in ("FX", "FY", "FZ")[:dim]]
    given = factor.groups("GROUP_MA", "GROUP_NO")
    direction = factor.words.get("DIRECTION")
    if kind == "PESANTEUR" and isinstance(direction, tuple) and None not in map(_number, direction) and not given:
        for item in sections:
            if item.material.density is not None:
                text = f"hhr.BodyForce({item.tag!r}, {direction[:dim]}, {{}})"
                yield Load("weight", text, own.get("GRAVITE", 0.0) * item.material.density, factor.source)
        return
    for name in given:
        place = parts.place(name)
        surface = parts.surface(name)
        held = factor.words.get("LIAISON") == "ENCASTRE" or factor.words.get("BLOCAGE") == "DEPLACEMENT"
        imposed = dict.fromkeys(_COMPONENTS, 0.0) if held else own
        if kind in ("DDL_IMPO", "FACE_IMPO", "MECA_IMPO") and place is None and name.upper() in planes:
            for k in range(dim):
                planes[name.upper()][2][k] = imposed.get(_COMPONENTS[k], 0.0)
        elif kind in ("DDL_IMPO", "FACE_IMPO", "MECA_IMPO") and place is not None:
            components = [k for k in range(dim) if _COMPONENTS[k] in imposed]
            yield from (Support(place, k, imposed[_COMPONENTS[k]], factor.source) for k in components)
        elif kind == "PRES_REP" and surface is not None:
            yield Load("pressure", f"hhr.Pressure({surface!r}, {{}})", own.get("PRES", 0.0), factor.source)
        elif kind in ("FORCE_NODALE", "FORCE_FACE", "FORCE_CONTOUR") and place is not None:
            what = "NodalForce" if kind == "FORCE_NODALE" else "Traction"
            for k in np.flatnonzero(forces).tolist():
                unit = tuple(np.eye(dim)[k].tolist())
                yield Load("force", f"hhr.{what}({place!r}, {unit}, {{}})", forces[k], factor.source)
        else:
            yield factor.left(f"{kind} of '{name}' has no counterpart, or is not in the mesh")
    if not given:
        yield factor.left(f"{kind} without a group has no counterpart")


def _pairs(
    command: Command, parts: NamedParts, planes: Mapping[str, Plane], curved: Sequence[str]
) -> Iterator[Pair | Left]:
    """Pairs of a DEFI_CONTACT: a straight line or flat surface without cells, as rigid tools have, is an obstacle."""
    for zone in command.factors("ZONE"):
        names = [(*zone.groups(key), "")[0] for key in ("GROUP_MA_ESCL", "GROUP_MA_MAIT")]
        slave, master = surfaces = [parts.surface(name) for name in names]
        friction = _number(zone.words.get("COULOMB", 0.0)) if command.words.get("FROTTEMENT") == "COULOMB" else 0.0
        if friction is None:
            yield zone.left("COULOMB is not literal, and the pair is frictionless: give it friction=")
        if slave is not None and master is not None:
            yield parts.pair(slave, master, friction or 0.0, zone.source)
            continue
        deformable = slave if slave is not None else master
        lost = [name for name, surface in zip(names, surfaces, strict=True) if surface is None]
        tool = lost[0].upper()
        if deformable is None or tool not in planes:
            round_tool = "it is curved, and has no cells: hhr.Profile, hhr.Sphere or hhr.RigidMesh in contacts"
            why = round_tool if tool in curved else "it is no surface with facets of the mesh"
            yield zone.left(f"the pair of {names} is not in the scene. '{lost[0]}': {why}")
            continue
        point, normal, motion = planes[tool]
        along = motion - (motion @ normal) * normal
        if friction and along.any():
            yield zone.left("a rigid plane that moves along the body does not drag it: move the body instead")
        pair = parts.on_plane(deformable, point, normal, friction or 0.0, zone.source)
        yield replace(pair, gap=float(motion @ parts.towards(deformable, normal)))
