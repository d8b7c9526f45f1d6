"""Soft contact as a user gives it to a pair."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.formulas import Scalar
from hhr_dolfinx.parameters import is_number
from hhr_dolfinx.plugins.contact_laws.curve_pairs import CurvePair, points_of_table
from hhr_dolfinx.plugins.soft_contact.curves import (
    ExponentialCurve,
    LinearCurve,
    SoftCurve,
    TabularCurve,
)
from hhr_dolfinx.plugins.soft_contact.laws import SoftContacts


@dataclass(frozen=True)
class SoftContact(CurvePair):
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
    noun: ClassVar[str] = "soft contact"
    conditions: ClassVar[Callable[..., SoftContacts]] = SoftContacts

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
        self.check_constant()
        if self._has("table"):
            self._points()
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

    def _points(self) -> np.ndarray:
        return points_of_table(self.table, "the table of soft contact", "overclosure")

    @property
    def constant(self) -> float | str:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.curve_pairs.CurvePair`."""
        if self.stiffness is not None:
            return self.stiffness
        return self.scale if self.exponential is None else self.exponential[1]

    @property
    def words(self) -> str:
        """See :class:`~hhr_dolfinx.contact.law.PairLaw`."""
        shown = self.constant if isinstance(self.constant, str) else f"{self.constant:g}"
        if self.stiffness is not None:
            return f"soft contact, {shown} per length"
        if self.exponential is not None:
            return f"soft contact, exponential, {shown} at touch, 1 % at {self.exponential[0]:g}"
        assert self.table is not None
        return f"soft contact, {len(self.table)} points times {shown}"

    def curve_of(self, factor: Scalar) -> SoftCurve:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.curve_pairs.CurvePair`."""
        if self.stiffness is not None:
            return LinearCurve(factor)
        if self.exponential is not None:
            return ExponentialCurve(factor, float(self.exponential[0]))
        points = self._points()
        return TabularCurve(factor, points[:, 0].copy(), points[:, 1].copy())
