"""Settings of the pictures of a scene, as data, which its file may hold: ``VIEW``, or a function of that name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class View:
    """Settings of the pictures of a scene.

    Attributes:
        points: parameters whose contact pressures are drawn; fields are those of the last.
        position: maps the points of contact conditions, (m, dim), to positions along the surface, (m,), for
            the pair drawn, or the first. None, and on other pairs, is the coordinate along which a surface is longest.
        label: name of that position, with its unit; None for the coordinate, in the unit of the scene.
        component: displacement component drawn, and its name with unit; None for no component.
        stress: unit of stress; None for that of the scene.
        pair: contact pair drawn, counted from 0; None for all of them, side by side.
        closed_form: maps these positions and the total force of the pair to pressures drawn for comparison, for elastic
            scenes; None for none.
        deformed: draw fields on the deformed mesh.
    """

    points: tuple = ()
    position: Callable[[np.ndarray], np.ndarray] | None = None
    label: str | None = None
    component: tuple[int, str] | None = None
    stress: str | None = None
    pair: int | None = None
    closed_form: Callable[[np.ndarray, float], np.ndarray] | None = None
    deformed: bool = False
