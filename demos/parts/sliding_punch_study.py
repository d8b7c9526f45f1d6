"""What the demo of the sliding punch measures: forces beside the full order and other meshes, and
the picture.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import sliding_punch as demo
from matplotlib.figure import Figure
from mpi4py import MPI

import hhr_dolfinx as hhr
from hhr_dolfinx.timing import timed

PLACES = (0.0, 1.7, 3.33, 4.9)
"""Ways at which forces without friction stand beside those of a punch that is meshed there."""


def pressed_at(way: float, cells: int) -> float:
    """Force on a punch that is meshed where it would be drawn to, without friction, and only
    pushed.
    """
    there = demo.scene(None, cells=cells, start=demo.START + way)
    return hhr.FullOrderModel(there, MPI.COMM_SELF).solve((demo.PUSH, 0.0)).outputs()["pressed"]


def forces(history: hhr.History) -> np.ndarray:
    """Pressing and drawing force of each answer, (answers, 2)."""
    values = [answer.outputs() for answer in history.answers]
    return np.array([[value["pressed"], value["drawn"]] for value in values])


def study(scene: hhr.Scene, cells: int, options: Any) -> dict[str, Any]:
    """The report, and the picture in its folder."""
    model, offline = timed(lambda: hhr.slide(scene))
    steps = demo.path()
    found, quick = timed(partial(model.march, steps))
    exact, slow = timed(partial(hhr.slide(scene, condensed=False).march, steps))
    here, there = forces(found), forces(exact)
    smooth = hhr.slide(demo.scene(None, cells=cells))
    reference = []
    for way in PLACES:
        ours = forces(
            smooth.march([(0.0, (0.0, 0.0)), (1.0, (demo.PUSH, 0.0)), (2.0, (demo.PUSH, way))])
        )[-1, 0]
        reference.append(
            row(
                f"meshed at {way:g} mm",
                "force without friction [N/mm]",
                pressed_at(way, cells),
                ours,
            )
        )
    reference.append(
        row(
            "drawn, half way",
            "drawing over pressing force",
            demo.FRICTION,
            *here[40:41, 1] / here[40, 0],
        )
    )
    draw(model, found, here, options.out / "sliding_punch.png")
    width = widths(model, found)[0]
    return {
        "friction": {
            "increments": len(here),
            "iterations": {"mean": float(np.mean(found.iterations)), "max": max(found.iterations)},
            "fallbacks": sum(answer.cycled for answer in found.answers),
            "mu_kappa": None,
            "widths": demo.WAY / width,
            "errors": {"forces": float(np.abs(here - there).max() / np.abs(there).max())},
            "times": {
                "offline": offline,
                "condensed": quick / len(here),
                "full order": slow / len(here),
            },
            "reference": reference,
        }
    }


def row(case: str, quantity: str, reference: float, ours: float) -> dict[str, Any]:
    """A line of the table."""
    return {"case": case, "quantity": quantity, "reference": float(reference), "ours": float(ours),
            "error": float(abs(ours / reference - 1))}  # fmt: skip


def widths(model: Any, history: hhr.History) -> list[float]:
    """Length of what touches, of each answer."""
    return [float(model.law.area[answer.slip.pressure > 0].sum()) for answer in history.answers]


def draw(model: Any, history: hhr.History, values: np.ndarray, file: Path) -> None:
    """Pressures where the punch has come to, and forces over the way."""
    figure = Figure(figsize=(10.5, 4.4), layout="constrained")
    profile, loop = figure.subplots(1, 2)
    x = model.slave_points()[:, 0]
    for answer in history.answers[::10]:
        way = answer.parameter[1]
        profile.plot(x + way, answer.slip.pressure / model.law.area, ".-", label=f"{way:.1f} mm")
    profile.set(xlabel="x [mm]", ylabel="pressure [MPa]", title="pressure goes along")
    profile.legend(
        fontsize=8, ncols=5, title="drawn by", loc="upper center", bbox_to_anchor=(0.5, -0.14)
    )
    ways = [answer.parameter[1] for answer in history.answers]
    for column, name in enumerate(("pressed", "drawn")):
        loop.plot(ways, values[:, column], label=name)
    loop.plot(
        ways,
        demo.FRICTION * values[:, 0],
        "--",
        color="#444444",
        linewidth=1,
        label="f times pressed",
    )
    loop.set(xlabel="drawn by [mm]", ylabel="force [N/mm]", title="forces on the punch")
    loop.legend(fontsize=8)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=200)
