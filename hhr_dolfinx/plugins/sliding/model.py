"""Model of bodies that slide past the mesh on which they were paired: its surfaces are paired again
along a path.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.models.condensed import CondensedModel
from hhr_dolfinx.models.model import KeptModel
from hhr_dolfinx.plugins.friction.laws import Friction

if TYPE_CHECKING:
    from hhr_dolfinx.models.answer import Answer
    from hhr_dolfinx.models.eliminations.elimination import CondensedContact
    from hhr_dolfinx.models.histories.equilibrium import MarchSettings
    from hhr_dolfinx.parameters import PointLike
    from hhr_dolfinx.plugins.sliding.beside import BesideTools
    from hhr_dolfinx.plugins.sliding.law import SlidingLaw
    from hhr_dolfinx.plugins.sliding.repairing import SlidingPair
    from hhr_dolfinx.plugins.sliding.slider import RepairingSlider

ADVICE = {
    Status.SINGULAR: "rows are dependent where the surfaces have come to, or friction is too large",
    Status.UNSETTLED: (
        "friction is too large for one answer, or where surfaces touch changes with each pairing"
    ),
}


class SlidingModel(KeptModel):
    """Model for paths with sliding of any length; see :mod:`hhr_dolfinx.plugins.sliding.repairing`.

    Forces of an answer, and its ``multipliers``, are those of the pairs that do not slide, if there
    are any, followed by nodal ones on all dofs of the surfaces that slide. Its ``slip`` has
    pressures, slip, wear and sticking of the slave nodes, pair by pair, followed by other contacts
    with friction. The ``base`` is full or condensed, with the conditions of the pairs that do not
    slide, a row for each dof of the surfaces, and rows of the motion ``beside`` curved tools,
    without forces.
    """

    kept = ("base", "pairs", "law", "beside")

    def __init__(
        self,
        base: CondensedModel,
        pairs: tuple[SlidingPair, ...],
        law: Friction | SlidingLaw,
        beside: BesideTools,
    ):
        self.base = base
        self.parameters = base.parameters
        self.fields = base.fields
        self.pairs = tuple(pairs)
        self.law: Friction | SlidingLaw = law
        self.equilibrium = base.equilibrium
        self.beside = beside
        self.advice: Mapping[Status, str] = ADVICE

    def for_file(self) -> SlidingModel:
        """The model of plain data.

        Raises:
            NotOfferedError: for a base of full order.
        """
        if not isinstance(self.base, KeptModel):
            raise NotOfferedError(
                f"a {type(self).__name__} of the full order cannot be kept in a file: "
                f"{self.instead}"
            )
        base = self.base.for_file()
        return self if base is self.base else self.changed(base=base)

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Faults: contacts that are no slave nodes, and pairs that do not fit the base.

        The base reports its faults.
        """
        contacts = sum(pair.slave.nodes.size for pair in self.pairs)
        along = contacts * (self.dimension - 1)
        first = base_rows = self.pairs[0].first
        friction = self.law if isinstance(self.law, Friction) else self.law.friction
        normal, normal_outside = np.split(friction.normal, [contacts])
        tangential, further = np.split(friction.tangential, [along])
        if not (
            np.array_equal(normal, base_rows + np.arange(contacts))
            and np.array_equal(tangential, base_rows + contacts + np.arange(along))
            and np.concatenate([normal_outside, further]).max(initial=-1) < base_rows
        ):
            yield "its contacts are not the slave nodes of its pairs"
        for pair in self.pairs:
            if pair.first != first or pair.slave.points.shape[1] != self.dimension:
                yield "dofs of its pairs are not the rows of its base"
            first += pair.nodes * self.dimension
        if self.beside.conditions.max(initial=-1) >= base_rows:
            yield "conditions beside tools are not those of pairs that do not slide"
        if first + self.beside.conditions.size * (self.dimension - 1) != self.base.own_conditions:
            yield "its pairs do not have as many dofs as its base has rows"

    @property
    def sizes(self) -> tuple[int, int]:
        """Sizes of its base."""
        return self.base.sizes

    def contacts(self) -> Callable[[np.ndarray], CondensedContact]:
        """Compliance and free motion of all dofs of the surfaces, as rows.

        These rows are no conditions.
        """
        return self.base.contacts()

    def check_range(self, point: np.ndarray, outside: str) -> None:
        """Check by its base.

        Args:
            point: parameters, (P,).
            outside: policy for a point outside the training range.
        """
        self.base.check_range(point, outside)

    def pressures(self, answer: Answer) -> np.ndarray:
        """Pressure forces of the slave nodes, (C,), then those of the pairs that do not slide.

        Forces of an answer have all directions, on both surfaces.
        """
        contacts = sum(pair.slave.nodes.size for pair in self.pairs)
        fixed_pairs = np.flatnonzero(self.law.pressing(self.pairs[0].first))
        if "slip" not in answer.memory:
            return np.full(contacts + fixed_pairs.size, np.nan)
        return np.concatenate([answer.slip.pressure[:contacts], answer.multipliers[fixed_pairs]])

    def increments(self, settings: MarchSettings) -> RepairingSlider:
        """See :class:`AnsweringModel`; without derivatives.

        Args:
            settings: settings of the increments.

        Raises:
            NotOfferedError: for derivatives.
        """
        if settings.gradient:
            from hhr_dolfinx.plugins.sliding.law import NO_SLOPES

            raise NotOfferedError(NO_SLOPES)
        from hhr_dolfinx.plugins.sliding.slider import RepairingSlider

        return RepairingSlider(self, exactly=settings.time_tolerance is not None)

    def coupling(self, mu: PointLike) -> float:
        """NaN, for unknown: rows change along a path."""
        return np.nan

    def slave_points(self) -> np.ndarray:
        """Coordinates of the slave nodes of its pairs as meshed, (C, dim)."""
        return np.concatenate([pair.slave.points for pair in self.pairs])
