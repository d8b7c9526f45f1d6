"""The computation of a command file of code_aster: its loads with their factors at its end, its
contact and model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.plugins.decks.comm_commands import Command, number
from hhr_dolfinx.plugins.decks.deck import Left

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.decks.comm_commands import Value

SOLVERS = ("MECA_STATIQUE", "STAT_NON_LINE")
CHARGES = ("AFFE_CHAR_MECA", "AFFE_CHAR_CINE")


@dataclass(frozen=True)
class Computation:
    """Commands that act at the end of the last computation of a file.

    Attributes:
        charges: factor of each command that makes loads or supports.
        contacts: commands of contact.
        models: commands of models.
        fields: commands that give bodies materials.
        left: TODO lines of what does not act, or not as the file says.
    """

    charges: Mapping[Command, float]
    contacts: tuple[Command, ...]
    models: tuple[Command, ...]
    fields: tuple[Command, ...]
    left: tuple[Left, ...]


def computation_of(commands: Sequence[Command]) -> Computation:
    """Find what acts in the last command that solves; all commands act in a file without one."""
    solvers = [command for command in commands if command.name in SOLVERS]
    charges = [command for command in commands if command.name in CHARGES]
    contacts = [command for command in commands if command.name == "DEFI_CONTACT"]
    models = [command for command in commands if command.name == "AFFE_MODELE"]
    fields = [command for command in commands if command.name == "AFFE_MATERIAU"]
    if not solvers:
        todo = [
            command.left("no MECA_STATIQUE or STAT_NON_LINE names it: it acts whole")
            for command in (*charges, *contacts)
        ]
        full = dict.fromkeys(charges, 1.0)
        return Computation(full, tuple(contacts), tuple(models), tuple(fields), tuple(todo))
    last = solvers[-1]
    todo = [command.left("a later computation counts, at its end") for command in solvers[:-1]]
    factors: dict[Command, float] = {}
    for excited in last.factors("EXCIT"):
        charge = excited.words.get("CHARGE")
        if isinstance(charge, Command):
            factor = _factor(excited, last)
            if isinstance(factor, str):
                todo.append(
                    last.left(f"a load is multiplied by a function {factor}: it counts whole")
                )
            factors[charge] = factors.get(charge, 0.0) + (
                1.0 if isinstance(factor, str) else factor
            )
    contact = last.words.get("CONTACT")
    used = tuple(command for command in contacts if command is contact)
    todo += [
        command.left(f"it does not act: no EXCIT of {last.name} names it")
        for command in charges
        if command not in factors
    ]
    todo += [
        command.left(f"it does not act: {last.name} does not name it")
        for command in contacts
        if command not in used
    ]
    return Computation(
        {command: factors[command] for command in charges if command in factors},
        used,
        _named(last, "MODELE", models),
        _named(last, "CHAM_MATER", fields),
        tuple(todo),
    )


def _named(solver: Command, key: str, among: Sequence[Command]) -> tuple[Command, ...]:
    """The command that a keyword names; the last one for a keyword that is not literal."""
    value = solver.words.get(key)
    return tuple(command for command in among if command is value) or tuple(among[-1:])


def _factor(excited: Command, solver: Command) -> float | str:
    """Factor of a load at the end of the computation, or what is wrong with its function."""
    multiplier = excited.numbers("COEF_MULT")
    scale = multiplier[0] if multiplier else 1.0
    curve = excited.words.get("FONC_MULT")
    if "FONC_MULT" not in excited.words:
        return scale
    if not isinstance(curve, Command) or not curve.words:
        return "that is not read"
    if curve.name == "DEFI_CONSTANTE":
        constant = curve.numbers("VALE")
        return scale * constant[0] if constant else "that is not literal"
    points = _points(curve)
    if points is None:
        return (
            "that is not read: a DEFI_FONCTION of INST with literal values, linear in between, is"
        )
    x, y = points
    if np.ptp(y) == 0.0 and {curve.words.get(side) for side in ("PROL_DROITE", "PROL_GAUCHE")} == {
        "CONSTANT"
    }:
        return float(scale * y[0])
    end = _end(solver)
    if end is None:
        return "of a time whose end is not literal"
    if x[0] <= end <= x[-1]:
        return float(scale * np.interp(end, x, y))
    side, a, b = ("PROL_DROITE", -2, -1) if end > x[-1] else ("PROL_GAUCHE", 1, 0)
    match curve.words.get(side, "EXCLU"):
        case "CONSTANT":
            return float(scale * y[b])
        case "LINEAIRE" if len(x) > 1:
            return float(scale * (y[b] + (end - x[b]) * (y[b] - y[a]) / (x[b] - x[a])))
    return f"that has no value at the end, {end:g}"


def _points(curve: Command) -> tuple[np.ndarray, np.ndarray] | None:
    """Times, which increase, and values of a function of the time that is linear in between.

    None for others.
    """
    kinds = curve.words.get("INTERPOL", "LIN")
    linear = {*(kinds if isinstance(kinds, tuple) else (kinds,))} == {"LIN"}
    if curve.name != "DEFI_FONCTION" or curve.words.get("NOM_PARA") != "INST" or not linear:
        return None
    if (values := curve.numbers("VALE")) is not None:
        x = values[::2]
        y = values[1::2]
    else:
        x, y = (curve.numbers(name) or () for name in ("ABSCISSE", "ORDONNEE"))
    if not x or len(x) != len(y):
        return None
    order = np.argsort(x, kind="stable")
    times = np.array(x)[order]
    return (times, np.array(y)[order]) if (np.diff(times) > 0).all() else None


def _end(solver: Command) -> float | None:
    """Time at the end of a computation; None for one that is not literal."""
    steps = next(iter(solver.factors("INCREMENT")), solver)
    for key in ("INST_FIN", "INST"):
        if key in steps.words:
            value = steps.numbers(key)
            return value[-1] if value else None
    return _last(steps.words["LIST_INST"]) if "LIST_INST" in steps.words else None


def _last(times: Value) -> float | None:
    """Last time of a list; None for one that is not literal."""
    if not isinstance(times, Command):
        return None
    for inner in times.factors("DEFI_LIST"):
        values = inner.numbers("VALE")
        return values[-1] if values else _last(inner.words.get("LIST_INST"))
    intervals = times.factors("INTERVALLE")
    if intervals:
        return number(intervals[-1].words.get("JUSQU_A"))
    values = times.numbers("VALE") or times.numbers("DEBUT")
    return values[-1] if values else None
