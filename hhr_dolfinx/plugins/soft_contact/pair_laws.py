"""Soft contact as a user gives it to a pair."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from hhr_dolfinx.contact.law import MeshArrays, PairLaw
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.formulas import Scalar, check_over_box, formula_of
from hhr_dolfinx.parameters import is_number
from hhr_dolfinx.plugins.contact_laws.interface import check_areas
from hhr_dolfinx.plugins.soft_contact.curves import (
    ExponentialCurve,
    LinearCurve,
    PressureCurve,
    TabularCurve,
)
from hhr_dolfinx.plugins.soft_contact.laws import SoftContacts

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix

    from hhr_dolfinx.contact.rows import ContactRows
    from hhr_dolfinx.parameters import ParameterSpace

_POSITIVE = "the pressure of soft contact must grow: give a positive number"


@dataclass(frozen=True)
class SoftContact(PairLaw):
    """Pressure over the overclosure of a pair; give one of the three curves.

    Overclosures are positive where surfaces overlap, negative across a gap.

    Attributes:
        stiffness: k of p = k h for overlaps h, pressure per length; a formula of parameters may
            stand for it.
        exponential: (c0, p0) of p = p0 exp(ln(100) h / c0): p0 at touch, 1 % of it at the gap c0,
            as CalculiX has it. p0 may be a formula.
        table: (overclosure, pressure) of each point, straight between them; beyond the last as the
            last segment. The first pressure is 0.
        scale: factor of the pressures of a table; a formula may stand for it.

    Example:
        >>> soft = hhr.SoftContact(stiffness=1e4)
        >>> soft.words
        'soft contact, 10000 per length'
    """

    plugin: ClassVar[str] = "soft_contact"

    stiffness: float | str | None = None
    exponential: tuple[float, float | str] | None = None
    table: Sequence[tuple[float, float]] | None = None
    scale: float | str = 1.0

    def __post_init__(self) -> None:
        given = [name for name in ("stiffness", "exponential", "table") if self._has(name)]
        if len(given) != 1:
            raise SceneError(
                "soft contact has one curve, by stiffness, exponential or table, and not "
                f"{' and '.join(given) or 'none'}"
            )
        if self._has("exponential"):
            self._check_exponential()
        if is_number(self._factor) and self._factor <= 0:
            raise SceneError(f"{_POSITIVE} in place of {self._factor!r}")
        if self._has("table"):
            self._check_table()
        elif self.scale != 1.0:
            raise SceneError("the scale of soft contact is that of a table")

    def _has(self, name: str) -> bool:
        return getattr(self, name) is not None

    def _check_exponential(self) -> None:
        """Raise SceneError unless there is a clearance and a pressure."""
        pair = self.exponential
        if not isinstance(pair, tuple | list) or len(pair) != 2:
            raise SceneError(f"exponential = {pair!r} must be (clearance, pressure at touch)")
        if not is_number(pair[0]) or pair[0] <= 0:
            raise SceneError(f"the clearance {pair[0]!r} of soft contact must be positive")

    def _check_table(self) -> None:
        """Raise SceneError unless overclosures grow, and pressures from zero do not fall."""
        try:
            points = np.array(self.table, dtype=float)
        except (TypeError, ValueError):
            points = np.zeros(0)
        if points.ndim != 2 or points.shape[1:] != (2,) or len(points) < 2:
            raise SceneError("the table of soft contact needs two points (overclosure, pressure)")
        if not np.isfinite(points).all() or (np.diff(points[:, 0]) <= 0).any():
            raise SceneError("overclosures in the table of soft contact must be finite and grow")
        if points[0, 1] != 0:
            raise SceneError(
                f"the table of soft contact begins with the pressure {points[0, 1]:g}, and the "
                "first must be 0, where the pressure begins"
            )
        if (np.diff(points[:, 1]) < 0).any():
            raise SceneError(
                "the pressure in the table of soft contact falls: contact that softens may have "
                "several answers, and is not built in"
            )
        if points[-1, 1] <= 0:
            raise SceneError("the table of soft contact has no pressure")

    @property
    def _factor(self) -> float | str:
        """The constant that may be a formula."""
        if self.stiffness is not None:
            return self.stiffness
        return self.scale if self.exponential is None else self.exponential[1]

    @property
    def texts(self) -> tuple[str, ...]:
        """See :class:`~hhr_dolfinx.contact.law.PairLaw`."""
        return (self._factor,) if isinstance(self._factor, str) else ()

    @property
    def words(self) -> str:
        """See :class:`~hhr_dolfinx.contact.law.PairLaw`."""
        shown = self._factor if isinstance(self._factor, str) else f"{self._factor:g}"
        if self.stiffness is not None:
            return f"soft contact, {shown} per length"
        if self.exponential is not None:
            return f"soft contact, exponential, {shown} at touch, 1 % at {self.exponential[0]:g}"
        assert self.table is not None
        return f"soft contact, {len(self.table)} points times {shown}"

    def curve(self, space: ParameterSpace, what: str) -> PressureCurve:
        """The curve over a box.

        Args:
            space: the parameters.
            what: description of the contact for the message.

        Raises:
            SceneError: for a constant that is not positive all over the box.
        """
        text = formula_of(self._factor, f"soft contact of {what}").text
        factor = Scalar(text, space.names)
        check_over_box(factor, space, f"soft contact of {what}", 0.0, np.inf, _POSITIVE)
        if self.stiffness is not None:
            return LinearCurve(factor)
        if self.exponential is not None:
            return ExponentialCurve(factor, float(self.exponential[0]))
        points = np.array(self.table, dtype=float)
        return TabularCurve(factor, points[:, 0].copy(), points[:, 1].copy())

    def check(self, scene: Any, what: str) -> None:
        """See :class:`~hhr_dolfinx.contact.law.PairLaw`."""
        self.curve(scene.parameters, what)

    @classmethod
    def attached(
        cls,
        laws: Mapping[int, Any],
        scene: Any,
        rows: ContactRows,
        pairs: np.ndarray,
        free: np.ndarray,
        lifts: csc_matrix,
        mesh: MeshArrays,
    ) -> tuple[ContactRows, np.ndarray, SoftContacts]:
        """See :class:`~hhr_dolfinx.contact.law.PairLaw`: no further rows."""
        check_areas(scene, laws)
        places = list(laws)
        number = np.array([places.index(k) if k in laws else 0 for k in pairs], dtype=np.int64)
        curves: Any = tuple(law.curve(scene.parameters, f"contact {k}") for k, law in laws.items())
        return rows, pairs, SoftContacts(rows.areas, number, curves)
