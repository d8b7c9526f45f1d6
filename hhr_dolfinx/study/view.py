"""Settings of the pictures of a scene, as data; ``plots`` draws them, and is imported on demand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from hhr_dolfinx.units import Units


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

    def along(self, places: np.ndarray, pair: int, units: Units | None) -> tuple[np.ndarray, str]:
        """Positions of the conditions of one contact along its surface, (m,), and their label."""
        unit = "" if units is None else f" [{units.length}]"
        meant = pair == (self.pair or 0)
        if meant and self.position is not None:
            return self.position(places), self.label or f"position along the surface{unit}"
        axis = int(np.ptp(places, axis=0).argmax())
        named = f"{'xyz'[axis]}{unit}"
        return places[:, axis], (self.label or named) if meant else named

    def of(self, units: Units | None) -> View:
        """The view with the unit of stress of a scene, if it has none."""
        return self if self.stress is not None else replace(self, stress="Pa" if units is None else units.stress)
