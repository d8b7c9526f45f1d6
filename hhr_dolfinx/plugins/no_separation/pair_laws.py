"""Contact without separation as a user gives it to a pair."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from hhr_dolfinx.contact.law import MeshArrays, PairLaw
from hhr_dolfinx.plugins.no_separation.laws import ROUND_OFF_OVERLAP, HeldConditions

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix

    from hhr_dolfinx.contact.rows import ContactRows
    from hhr_dolfinx.scene import Scene


@dataclass(frozen=True)
class NoSeparation(PairLaw):
    """Surfaces that have pressed on each other do not open any more; they slide, with the friction
    of the pair if it has some.

    A condition is held from the end of the increment in which it has pressed.

    Example:
        >>> pair = hhr.Obstacle(
        ...     "base", normal=(0, -1), offset=0.0, friction=0.2, law=hhr.NoSeparation()
        ... )
        >>> pair.law.words
        'no separation'
    """

    plugin: ClassVar[str] = "no_separation"
    texts: ClassVar[tuple[str, ...]] = ()
    words: ClassVar[str] = "no separation"

    def check(self, scene: Scene, what: str) -> None:
        """No scene is refused.

        Args:
            scene: not read.
            what: not read.
        """

    @classmethod
    def attached(
        cls,
        laws: Mapping[int, NoSeparation],
        scene: Scene,
        rows: ContactRows,
        pairs: np.ndarray,
        free: np.ndarray,
        lifts: csc_matrix,
        mesh: MeshArrays,
    ) -> tuple[ContactRows, np.ndarray, HeldConditions]:
        """No further rows, see :class:`~hhr_dolfinx.contact.law.PairLaw`.

        Args:
            laws: laws by pair.
            scene: scene of the contacts.
            rows: conditions of the pressures.
            pairs: contact pair of each of them, (m,).
            free, lifts: not read.
            mesh: nodes and cells.
        """
        least = ROUND_OFF_OVERLAP * float(np.ptp(mesh.points, axis=0).max())
        return rows, pairs, HeldConditions(np.full(pairs.size, least))
