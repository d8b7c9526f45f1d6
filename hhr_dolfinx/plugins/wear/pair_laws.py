"""Wear as a user gives it to a pair."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from hhr_dolfinx.contact.law import MeshArrays, PairLaw
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.outputs import GapAt
from hhr_dolfinx.parameters import is_number
from hhr_dolfinx.plugins.contact_laws.interface import check_areas
from hhr_dolfinx.plugins.wear.laws import WornConditions

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix

    from hhr_dolfinx.contact.rows import ContactRows


@dataclass(frozen=True)
class ArchardWear(PairLaw):
    """Archard's law: the depth that a pair loses grows by constant · pressure · speed, each second.

    The worn depth opens the gap, by backward Euler in each increment, so that increments may be
    long. Where a cycle counts, a second of the path stands for it, and ``speed`` for the way in it.

    Attributes:
        constant: depth per pressure and length, Archard's k over the hardness; a number.
        speed: sliding speed of the pair, length per second; a number.
        along_slip: the way is the slip of the pair, which has friction, instead of ``speed``: what
            an increment wears off opens the gap in the next one.
        cycles: so many cycles count for one of the path, of wear along the slip.

    Example:
        >>> hhr.ArchardWear(constant=1e-8, speed=0.2).words
        'wear, 2e-09 per pressure and second'
    """

    plugin: ClassVar[str] = "wear"
    texts: ClassVar[tuple[str, ...]] = ()

    constant: float
    speed: float = 1.0
    along_slip: bool = False
    cycles: float = 1.0

    def __post_init__(self) -> None:
        for name in ("constant", "speed", "cycles"):
            value = getattr(self, name)
            if not is_number(value) or value < 0:
                raise SceneError(
                    f"the {name} {value!r} of wear must be a number that is not negative"
                )
        if (self.speed if self.along_slip else self.cycles) != 1.0:
            raise SceneError(
                "wear has a speed, or along_slip=True and the number of cycles that count for one "
                "of the path: give one of both"
            )
        if not np.isfinite(self.constant * self.speed * self.cycles):
            raise SceneError(
                f"constant {self.constant!r} times speed {self.speed!r} and cycles {self.cycles!r} "
                "is too large"
            )

    @property
    def words(self) -> str:
        """See :class:`~hhr_dolfinx.contact.law.PairLaw`."""
        if self.along_slip:
            return f"wear, {self.constant * self.cycles:g} per pressure and slip"
        return f"wear, {self.constant * self.speed:g} per pressure and second"

    def check(self, scene: Any, what: str) -> None:
        """See :class:`~hhr_dolfinx.contact.law.PairLaw`.

        Args:
            scene: the scene.
            what: description of the contact for the message.

        Raises:
            SceneError: for an output that reads the gap of the pair by displacements alone, and for
                wear along the slip of a pair without friction.
        """
        if self.along_slip and any(law is self for law in scene.laws):
            raise SceneError(f"{what} wears along its slip, and has no friction: give it friction=")
        own = [
            k
            for k, contact in enumerate(scene.contacts)
            if any(value is self for value in vars(contact).values())
        ]
        for output in scene.outputs:
            if isinstance(output, GapAt) and output.contact in own:
                raise SceneError(
                    f"output '{output.name}' reads the gap of {what} without what is worn: leave "
                    "it out, answer.gaps() has both"
                )

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
    ) -> tuple[ContactRows, np.ndarray, WornConditions]:
        """See :class:`~hhr_dolfinx.contact.law.PairLaw`: no further rows."""
        check_areas(scene, laws)
        rates, along = np.zeros((2, len(scene.contacts)))
        for contact, law in laws.items():
            if law.along_slip:
                along[contact] = law.constant * law.cycles
            else:
                rates[contact] = law.constant * law.speed
        return rows, pairs, WornConditions(rates[pairs] / rows.areas, along[pairs])
