"""What the pictures of a scene show, as data; the drawing is in ``plots``, which is loaded only to draw."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class View:
    """What the pictures of a scene show.

    Attributes:
        points: parameters whose contact pressures are drawn; fields are those of the last.
        position: maps the places of contact conditions, (m, dim), to where along the surface they are drawn, (m,).
        label: what that position is, with its unit.
        component: displacement component drawn, and its name with unit; None for no component.
        stress: unit of stress.
        pair: contact pair drawn, counted from 0.
        closed_form: maps these positions and the total force of the pair to pressures drawn beside, of elastic
            scenes; None for none.
        deformed: draw fields on the deformed mesh.
    """

    points: tuple = ()
    position: Callable[[np.ndarray], np.ndarray] = lambda places: places[:, 0]
    label: str = "x [m]"
    component: tuple[int, str] | None = None
    stress: str = "Pa"
    pair: int = 0
    closed_form: Callable[[np.ndarray, float], np.ndarray] | None = None
    deformed: bool = False
