"""Command files of code_aster, as far as they are literal: they are parsed, and nothing of them is executed."""

from __future__ import annotations

import ast
import operator
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hhr_dolfinx.errors import FileContentError, SceneError
from hhr_dolfinx.plugins.decks.deck import Deck, Left, Load, Material, Pair, Section, Support
from hhr_dolfinx.plugins.decks.named import NamedParts

_OPERATORS = {ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv}
_WITHOUT_EFFECT = frozenset(
    "DEBUT POURSUITE FIN LIRE_MAILLAGE MODI_MAILLAGE DEFI_LIST_REEL DEFI_LIST_INST DEFI_FONCTION MECA_STATIQUE "
    "STAT_NON_LINE CALC_CHAMP IMPR_RESU IMPR_TABLE POST_RELEVE_T TEST_RESU TEST_TABLE DEFI_GROUP CREA_TABLE".split()
)
_HYPOTHESES = {"3D": "solid", "AXIS": "axisymmetric", "D_PLAN": "plane_strain", "C_PLAN": "plane_stress"}
_NO_LOADS = frozenset({"MODELE", "INFO", "DOUBLE_LAGRANGE"})
_COMPONENTS = ("DX", "DY", "DZ")


@dataclass(frozen=True)
class Command:
    """A command, or a factor ``_F``, with its literal arguments; those that are not literal are named."""

    name: str
    source: str
    words: Mapping[str, Any] = field(default_factory=dict)

    def factors(self, name: str) -> tuple[Command, ...]:
        """One factor or several."""
        found = self.words.get(name, ())
        return tuple(one for one in (found if isinstance(found, tuple) else (found,)) if isinstance(one, Command))

    def groups(self, *names: str) -> tuple[str, ...]:
        """Names of groups."""
        found = [self.words[name] for name in names if name in self.words]
        return tuple(one for item in found for one in (item if isinstance(item, tuple) else (item,)))

    def left(self, why: str) -> Left:
        """This command as one without counterpart."""
        return Left(self.source, self.name, why)


def commands_of(path: Path) -> Iterator[Command]:
    """Commands of a file in their order; FileContentError for text that is no Python, with the line."""
    try:
        tree = ast.parse(path.read_text(errors="replace"))
    except (SyntaxError, ValueError) as error:
        raise FileContentError(f"{path.name}:{getattr(error, 'lineno', 0)} is no command file: {error}") from None
    values: dict[str, Any] = {}
    for statement in tree.body:
        value = _value(getattr(statement, "value", None), values, path.name)
        if isinstance(statement, ast.Assign) and isinstance(statement.targets[0], ast.Name):
            values[statement.targets[0].id] = value
        if isinstance(value, Command):
            yield value
        elif not isinstance(statement, ast.Assign | ast.Import | ast.ImportFrom | ast.Expr):
            yield Command(type(statement).__name__, f"{path.name}:{statement.lineno}", {"": None})


def _value(node: ast.AST | None, values: Mapping[str, Any], file: str) -> Any:
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
    found = list(commands_of(path))
    sections: list[Section] = []
    supports: list[Support] = []
    loads: list[Load] = []
    pairs: list[Pair] = []
    left: list[Left] = []
    hypothesis = "solid" if parts.raw.dim == 3 else "plane_strain"
    for command in found:
        if command.name == "AFFE_MODELE":
            kinds = [one.words.get("MODELISATION") for one in command.factors("AFFE")]
            hypothesis = next((_HYPOTHESES[kind] for kind in kinds if kind in _HYPOTHESES), hypothesis)
        elif command.name == "AFFE_MATERIAU":
            sections += _sections(command, parts)
        elif command.name in ("AFFE_CHAR_MECA", "AFFE_CHAR_CINE"):
            for kind in (word for word in command.words if word not in _NO_LOADS):
                for factor in command.factors(kind):
                    _load(kind, factor, parts, sections, supports, loads, left)
                if not command.factors(kind):
                    left.append(command.left(f"{kind} is not literal, or not read"))
        elif command.name == "DEFI_CONTACT":
            pairs += _pairs(command, parts, left)
        elif command.name not in (*_WITHOUT_EFFECT, "DEFI_MATERIAU"):
            left.append(command.left("not read"))
        for excited in command.factors("EXCIT"):
            curve = excited.words.get("FONC_MULT")
            if isinstance(curve, Command) and (curve.words.get("VALE") or (None,))[-1] != 1:
                left.append(
                    command.left("a load is multiplied by a function that does not end at 1: it is taken whole")
                )
    if not sections:
        raise SceneError(f"{path.name} gives no body a literal material: DEFI_MATERIAU(ELAS=_F(E=..., NU=...))")
    contacts = tuple(pairs) or parts.out_of_reach(supports)
    return Deck(mesh, hypothesis, tuple(sections), tuple(supports), tuple(loads), contacts, tuple(left))


def _sections(command: Command, parts: NamedParts) -> Iterator[Section]:
    for factor in command.factors("AFFE"):
        given = factor.words.get("MATER")
        material = given[0] if isinstance(given, tuple) and given else given
        elastic = next(iter(material.factors("ELAS")), None) if isinstance(material, Command) else None
        words = elastic.words if elastic is not None else {}
        if not isinstance(words.get("E"), int | float) or not isinstance(words.get("NU"), int | float):
            raise SceneError(f"{factor.source} {command.name}: the material has no literal ELAS=_F(E=..., NU=...)")
        assert elastic is not None
        own = Material(
            "ELAS", elastic.source, float(words["E"]), float(words["NU"]), "", words.get("ALPHA"), words.get("RHO")
        )
        names = factor.groups("GROUP_MA")
        for tag in [parts.body(name) for name in names] if names else parts.apart():
            if tag is None:
                raise SceneError(f"{factor.source} {command.name}: the mesh has no body of {names}")
            yield Section(tag, own, factor.source)


def _load(
    kind: str, factor: Command, parts: NamedParts, sections: list[Section], supports: list[Support],
    loads: list[Load], left: list[Left],
) -> None:  # fmt: skip
    """Add the supports or loads of a factor of AFFE_CHAR_MECA."""
    dim = parts.raw.dim
    given = factor.groups("GROUP_MA", "GROUP_NO")
    values = {name: value for name, value in factor.words.items() if isinstance(value, int | float)}
    places = [parts.place(name) for name in given]
    forces = [values.get(name, 0.0) for name in ("FX", "FY", "FZ")[:dim]]
    vector = next(((k, value) for k, value in enumerate(forces) if value), None)
    if kind == "PESANTEUR" and isinstance(factor.words.get("DIRECTION"), tuple):
        direction = tuple(float(one) for one in factor.words["DIRECTION"][:dim])
        for item in sections:
            if item.material.density is not None:
                value = values.get("GRAVITE", 0.0) * item.material.density
                loads.append(Load("weight", f"hhr.BodyForce({item.tag!r}, {direction}, {{}})", value, factor.source))
        return
    for name, place in zip(given, places, strict=True):
        surface = parts.surface(name)
        if kind in ("DDL_IMPO", "FACE_IMPO", "MECA_IMPO") and place is not None and "DNOR" not in values:
            held = factor.words.get("LIAISON") == "ENCASTRE" or factor.words.get("BLOCAGE") == "DEPLACEMENT"
            own = dict.fromkeys(_COMPONENTS, 0.0) if held else values
            supports += [Support(place, k, float(own[one]), factor.source)
                         for k, one in enumerate(_COMPONENTS[:dim]) if one in own]  # fmt: skip
        elif kind == "PRES_REP" and surface is not None and "PRES" in values:
            loads.append(Load("pressure", f"hhr.Pressure({surface!r}, {{}})", float(values["PRES"]), factor.source))
        elif kind in ("FORCE_NODALE", "FORCE_FACE", "FORCE_CONTOUR") and vector and place is not None:
            what = "NodalForce" if kind == "FORCE_NODALE" else "Traction"
            for k, value in enumerate(forces):
                unit = tuple(float(k == other) for other in range(dim))
                if value:
                    loads.append(Load("force", f"hhr.{what}({place!r}, {unit}, {{}})", float(value), factor.source))
        else:
            left.append(
                factor.left(f"{kind} of '{name}' has no literal value or no counterpart, or is not in the mesh")
            )
    if not given:
        left.append(factor.left(f"{kind} without a group has no counterpart"))


def _pairs(command: Command, parts: NamedParts, left: list[Left]) -> Iterator[Pair]:
    for zone in command.factors("ZONE"):
        names = [(*zone.groups(key), "")[0] for key in ("GROUP_MA_ESCL", "GROUP_MA_MAIT")]
        slave, master = (parts.surface(name) for name in names)
        if slave is None or master is None:
            left.append(zone.left(f"the mesh has no surfaces {names}"))
            continue
        friction = zone.words.get("COULOMB") if command.words.get("FROTTEMENT") == "COULOMB" else None
        yield parts.pair(slave, master, float(friction or 0.0), zone.source)
