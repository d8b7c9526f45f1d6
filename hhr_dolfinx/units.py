"""Units of a scene, stated once: for labels, and for materials by name."""

from __future__ import annotations

import re
from dataclasses import dataclass

from hhr_dolfinx.errors import SceneError

LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
"""Units of length in metres."""
STRESSES = {
    "Pa": 1.0,
    "kPa": 1e3,
    "MPa": 1e6,
    "GPa": 1e9,
    "psi": 6894.757293168361,
    "ksi": 6894757.293168361,
}
"""Units of stress in pascals."""
FORCES = {"N": 1.0, "kN": 1e3, "MN": 1e6, "lbf": 4.4482216152605}
"""Units of force in newtons."""
_WORK = {"J": 1.0, "kJ": 1e3, "mJ": 1e-3}
_EXPONENTS = str.maketrans("²³", "23")


@dataclass(frozen=True)
class Units:
    """Units of lengths and stresses; forces are stress times length squared.

    Attributes:
        length: one of ``m``, ``cm``, ``mm``, ``um``, ``in``.
        stress: one of ``Pa``, ``kPa``, ``MPa``, ``GPa``, ``psi``, ``ksi``.
    """

    length: str = "m"
    stress: str = "Pa"

    def __post_init__(self) -> None:
        for quantity, unit, units in (
            ("length", self.length, LENGTHS),
            ("stress", self.stress, STRESSES),
        ):
            if unit not in units:
                raise SceneError(
                    f"the unit {unit!r} of {quantity} is unknown: take one of {', '.join(units)}"
                )

    @property
    def force(self) -> str:
        """Unit of force, as text."""
        return {"mm MPa": "N", "m Pa": "N", "in psi": "lbf"}.get(
            f"{self.length} {self.stress}", f"{self.stress} {self.length}²"
        )

    def force_in(self, hypothesis: str) -> str:
        """Unit of the forces of a hypothesis, as text: per unit depth in the plane."""
        return f"{self.force}/{self.length}" if hypothesis.startswith("plane") else self.force

    def work_in(self, hypothesis: str) -> str:
        """Unit of the work of these forces, as text."""
        return self.force if hypothesis.startswith("plane") else f"{self.force} {self.length}"

    def stress_of(self, pascals: float) -> float:
        """A stress in pascals as a number of the scene."""
        return pascals / STRESSES[self.stress]

    def pascals(self, stress: float) -> float:
        """A stress of the scene in pascals."""
        return stress * STRESSES[self.stress]

    def metres(self, length: float) -> float:
        """A length of the scene in metres."""
        return length * LENGTHS[self.length]

    def conflict(self, unit: str) -> str | None:
        """Unit, as text, in which a number of the scene is, if ``unit`` is another one.

        None if it fits or is unknown.

        Products and quotients of lengths, stresses, forces and works are compared, such as ``N/mm``
        and ``kN m``.
        """
        size = 1.0
        stress = length = 0
        for sign, symbol, exponent in re.findall(r"([/*·\s]*)([A-Za-z]+)\^?([\d²³]?)", unit):
            power = (-1 if "/" in sign else 1) * int((exponent or "1").translate(_EXPONENTS))
            for units, of_stress, of_length in (
                (LENGTHS, 0, 1),
                (STRESSES, 1, 0),
                (FORCES, 1, 2),
                (_WORK, 1, 3),
            ):
                if symbol in units:
                    size *= units[symbol] ** power
                    stress += of_stress * power
                    length += of_length * power
                    break
            else:
                return None
        expected = STRESSES[self.stress] ** stress * LENGTHS[self.length] ** length
        if abs(size - expected) <= 1e-6 * expected:
            return None
        powers = ((self.stress, stress), (self.length, length))
        return " ".join(
            name if power == 1 else f"{name}^{power}" for name, power in powers if power
        )
