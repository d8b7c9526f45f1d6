"""Bodies that slide past the mesh on which they were paired: a model of their surfaces, paired anew along a path."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.contact.friction import Friction
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.models.model import AnsweringModel

if TYPE_CHECKING:
    from hhr_dolfinx.models.eliminations.elimination import CondensedContact
    from hhr_dolfinx.models.histories.equilibrium import MarchSettings
    from hhr_dolfinx.models.histories.repairing import RepairingSlider, SlidingPair

ADVICE = {
    Status.SINGULAR: "rows are dependent where the surfaces have come to, or friction is too large",
    Status.UNSETTLED: "friction is too large for one answer, or the step too long: take smaller steps",
}


class SlidingModel(AnsweringModel):
    """Answers paths along which surfaces slide by any length; see :mod:`hhr_dolfinx.models.histories.repairing`.

    Forces of an answer are nodal ones, on all dofs of the surfaces, and so are its ``multipliers``; pressures, slip and
    wear of the slave nodes are in its ``slip``.

    Args:
        base: full or condensed, with a row for each dof of the surfaces.
        pairs: the surfaces.
        friction: its contacts are the slave nodes, pair by pair.
    """

    instead: ClassVar[str] = "its pairings are code. Keep the scene, and condense it again"

    def __init__(self, base: Any, pairs: Sequence[SlidingPair], friction: Friction):
        self.base = base
        self.parameters = base.parameters
        self.fields = base.fields
        self.pairs = tuple(pairs)
        self.friction = friction
        self.advice: Mapping[Status, str] = ADVICE

    @property
    def sizes(self) -> tuple[int, int]:
        """Those of its base."""
        return self.base.sizes

    def contacts(self) -> Callable[[np.ndarray], CondensedContact]:
        """Compliance and free motion of all dofs of the surfaces, as rows that are no conditions yet."""
        return self.base.contacts()

    def check_range(self, point: np.ndarray, outside: str) -> None:
        """That of its base."""
        self.base.check_range(point, outside)

    def slider(self, settings: MarchSettings) -> RepairingSlider:
        """See :class:`AnsweringModel`; without derivatives."""
        if settings.gradient:
            raise NotOfferedError(
                "derivatives of bodies that slide past their mesh are not built in: pairings change along a path. Take "
                "differences of answers"
            )
        from hhr_dolfinx.models.histories.repairing import RepairingSlider

        return RepairingSlider(self, exactly=settings.time_tolerance is not None)

    def coupling(self, mu: Any) -> float:
        """Not known: rows change along a path."""
        return np.nan

    def slave_points(self) -> np.ndarray:
        """Where its contacts are meshed, (C, dim)."""
        return np.concatenate([pair.slave.points for pair in self.pairs])
