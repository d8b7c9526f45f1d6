"""What the fretting demo measures: the path, its errors and times, closed forms, and the
picture.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import fretting as demo
import numpy as np
from mpi4py import MPI

import hhr_dolfinx as hhr
from hhr_dolfinx.timing import timed
from parts.friction_picture import draw_friction, tangential_forces
from parts.friction_report import differences, errors_of, sizes_and_times

STEPS = 10
"""Increments of a quarter of a cycle."""
ALONG = np.array([1.0, 0.0])


def path(cycles: int = 2) -> list:
    """Pressed, then rubbed to and fro."""
    angles = np.linspace(0.0, 2 * np.pi * cycles, 4 * STEPS * cycles + 1)
    points = [(0.0, 0.0), *((demo.PUSH, demo.SHEAR * np.sin(angle)) for angle in angles)]
    return [(float(k), (*point, demo.FRICTION)) for k, point in enumerate(points)]


class Mindlin:
    """Closed forms of equal cylinders under some forces.

    Args:
        normal, tangential: forces per depth.
        turned: tangential force at which it turned back; None on the way in.
    """

    def __init__(self, normal: float, tangential: float, turned: float | None = None):
        modulus = demo.YOUNG / (2 * (1 - demo.POISSON**2))
        self.width = np.sqrt(4 * normal * demo.RADIUS / (np.pi * modulus))
        self.peak = 2 * normal / (np.pi * self.width)
        full = demo.FRICTION * normal
        slid = abs(tangential) / full if turned is None else abs(turned - tangential) / (2 * full)
        self.sticks = self.width * np.sqrt(1 - slid)
        self.first = None if turned is None else self.width * np.sqrt(1 - abs(turned) / full)

    def traction(self, x: np.ndarray) -> np.ndarray:
        """Along the way in positive; on the way back what it was at the turn less twice what
        slipped back.
        """

        def bump(width: float) -> np.ndarray:
            return width / self.width * np.sqrt(np.maximum(1 - (x / width) ** 2, 0.0))

        shape = bump(self.width) - bump(self.sticks)
        if self.first is not None:
            shape = bump(self.width) - bump(self.first) - 2 * shape
        return demo.FRICTION * self.peak * shape


def study(scene: hhr.Scene, options: Any) -> dict[str, Any]:
    """Entries of the report; the picture goes to its folder."""
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    model, offline = timed(lambda: hhr.condense(full))
    steps = path()
    seconds, histories = {}, {}
    for name, one in (("fom_best", full), ("online", model)):
        one.march(steps[:4])
        histories[name], taken = timed(partial(one.march, steps))
        seconds[name] = [taken / (len(steps) - 1)]
    exact, found = histories["fom_best"], histories["online"]
    x = full.problem.contact_points[model.law.normal, 0]
    turn, back = STEPS, 2 * STEPS
    references, closed = [], {}
    pressures = np.array([answer.forces() for answer in found.answers])[:, model.law.normal]
    shears = tangential_forces(model.law, found, ALONG)
    for number, name, turned in ((turn, "sheared", None), (back, "back", shears[turn].sum())):
        form = Mindlin(pressures[number].sum(), shears[number].sum(), turned)
        closed[number] = form.traction(x)
        stuck = model.law.area[found.answers[number].slip.statuses == 1].sum() / 2
        references += list(beside(name, form, x, shears[number] / model.law.area, stuck))
    draw_friction(
        model.law, x, found, options.out / "fretting.png", direction=(1.0, 0.0),
        driven=("shear [mm]", np.array([answer.parameter[1] for answer in found.answers])),
        tractions={turn: "sheared", back: "back at the middle"}, closed_forms=closed,
        labels=("x [mm]", "traction [MPa]", "tangential force [N/mm]"),
    )  # fmt: skip
    return sizes_and_times(full, seconds, offline) | {"friction": {
        "increments": len(found.answers),
        "iterations": {"mean": float(np.mean(found.iterations)), "max": max(found.iterations)},
        "fallbacks": sum(answer.cycled for answer in found.answers),
        "mu_kappa": model.coupling(steps[-1][1]),
        "errors": errors_of([differences(full, found, exact)]),
        "cycles": cycles(found, shears.sum(axis=1)),
        "reference": references,
    }}  # fmt: skip


def beside(name: str, form: Mindlin, x: np.ndarray, traction: np.ndarray, stuck: float) -> Any:
    """Stick width, and the largest error of the traction clear of where slip and contact begin."""
    yield row(f"Mindlin, {name}", "half width that sticks [mm]", form.sticks, stuck)
    ends = [width for width in (form.sticks, form.first) if width is not None]
    clear = (np.abs(x) < 0.9 * form.width) & np.all(
        [np.abs(np.abs(x) - end) > 0.1 * form.width for end in ends], axis=0
    )
    off = np.abs(traction - form.traction(x))[clear].max() / np.abs(form.traction(x)).max()
    yield row(f"Mindlin, {name}", "traction, 1 + largest error by its peak", 1.0, 1 + off)


def row(case: str, quantity: str, reference: float, ours: float) -> dict[str, Any]:
    """A line of the table."""
    error = abs(ours / reference - 1)
    return {
        "case": case,
        "quantity": quantity,
        "reference": float(reference),
        "ours": float(ours),
        "error": float(error),
    }


def cycles(history: hhr.History, shear: np.ndarray) -> dict[str, float]:
    """What the last cycle wears and dissipates, and the area of its loop."""
    first, last = history.answers[-1 - 4 * STEPS], history.answers[-1]
    before, after = first.outputs(), last.outputs()
    moved = np.array([answer.parameter[1] for answer in history.answers])[-1 - 4 * STEPS :]
    force = shear[-1 - 4 * STEPS :]
    area = float(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(moved)))
    return {name: after[name] - before[name] for name in ("wear", "dissipated")} | {
        "area of the loop": area
    }
