"""Picture of a history with friction: sticking and slipping contacts, tractions, and the loop of
forces.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hhr_dolfinx.compat import extra
from hhr_dolfinx.models.answer import History
from hhr_dolfinx.plugins.friction.laws import Friction

with extra("pictures", "pictures of friction"):
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure

COLOURS = ("#e8e8e8", "#2b6cb0", "#e07b39")
"""Colours of open, sticking and slipping contacts."""


def tangential_forces(friction: Friction, history: History, direction: np.ndarray) -> np.ndarray:
    """Tangential forces on the slaves along a direction, (dim,), of each answer and contact,
    (answers, C).
    """
    along = friction.tangents @ direction
    forces = np.array([answer.forces() for answer in history.answers])[:, friction.tangential]
    found = np.zeros((len(forces), friction.normal.size))
    np.add.at(found.T, friction.owner, (-forces * along).T)
    return found


def draw_friction(
    friction: Friction,
    places: np.ndarray,
    history: History,
    path: Path,
    *,
    direction: tuple[float, ...],
    driven: tuple[str, np.ndarray],
    tractions: Mapping[int, str],
    closed_forms: Mapping[int, np.ndarray] | None = None,
    labels: tuple[str, str, str] = ("place", "traction", "tangential force"),
) -> None:
    """Write the picture.

    Args:
        friction: of the model that answered.
        places: position of each contact along the surface, (C,).
        history: its answers.
        path: of the file.
        direction: of tangential forces, (dim,).
        driven: name and values of the quantity on the axis of the loop, (answers,).
        tractions: answers whose tractions are drawn, by number, with their names.
        closed_forms: known tractions of some of them, (C,) each, which are drawn as lines.
        labels: of positions, tractions and forces, with their units.
    """
    order = np.argsort(places)
    states = [answer.slip for answer in history.answers if "slip" in answer.memory]
    statuses = np.array([state.statuses for state in states])[:, order]
    forces = tangential_forces(friction, history, np.array(direction))
    figure = Figure(figsize=(12.5, 4.4), layout="constrained")
    map_, profile, loop = figure.subplots(1, 3)
    colours = ListedColormap(COLOURS)
    map_.pcolormesh(
        places[order],
        np.arange(len(statuses)) + 1,
        statuses,
        cmap=colours,
        vmin=0,
        vmax=2,
        shading="nearest",
    )
    for colour, name in zip(COLOURS, ("open", "sticks", "slips"), strict=True):
        map_.plot([], [], "s", color=colour, label=name)
    map_.set(xlabel=labels[0], ylabel="increment", title="what sticks and what slips")
    for k, (number, name) in enumerate(tractions.items()):
        values = np.divide(
            forces[number], friction.area, out=np.zeros(places.size), where=friction.area > 0
        )
        profile.plot(places[order], values[order], "o", markersize=3, color=f"C{k}", label=name)
        if closed_forms is not None and number in closed_forms:
            profile.plot(
                places[order],
                closed_forms[number][order],
                "-",
                color=f"C{k}",
                label=f"{name}, closed form",
            )
    profile.set(xlabel=labels[0], ylabel=labels[1], title="tractions")
    touched = np.abs(places[(statuses[:, np.argsort(order)] > 0).any(axis=0)])
    for axis in (map_, profile):
        axis.set_xlim(
            *(np.array([-1.3, 1.3]) * touched.max(initial=0.0) if touched.size else axis.get_xlim())
        )
    loop.plot(driven[1], forces.sum(axis=1), ".-", color="#444444")
    loop.set(xlabel=driven[0], ylabel=labels[2], title="loop")
    loop.locator_params(axis="x", nbins=5)  # long numbers would run into each other
    for axis, columns in ((map_, 3), (profile, 2)):
        axis.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=columns)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=200)
