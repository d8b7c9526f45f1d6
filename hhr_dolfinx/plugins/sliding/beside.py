"""Curved tools beside surfaces that slide: their rows are those of the mesh, and hold as long as
bodies stay there.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.errors import FarSlidingWarning
from hhr_dolfinx.warn import is_first, warn

LOADED_CONDITION = 1e-9
"""Part of the largest force below which a condition is not under load."""


@dataclass(frozen=True, eq=False)
class BesideTools:
    """Conditions of curved tools; those of planes hold wherever a body slides along them."""

    conditions: Annotated[Integers, "beside tools"]  #: their numbers in the base, (c,)
    widths: Annotated[Floats, "beside tools"]  #: largest facet at the slave node of each, (c,)

    @classmethod
    def none(cls) -> BesideTools:
        """No tools."""
        return cls(np.zeros(0, dtype=np.int64), np.zeros(0))

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Faults: widths that are not positive."""
        if (self.widths <= 0).any():
            yield "facets beside tools have no width"

    def check(self, forces: np.ndarray, motion: np.ndarray, largest: float, place: str) -> bool:
        """Warn if a condition under load has slid along its tool by more than a facet.

        Args:
            forces: contact forces of the base, (m,).
            motion: motion along the tangents of each condition, (c, dim - 1).
            largest: largest norm of forces so far, their unit.
            place: the parameter, in words.

        Warns:
            FarSlidingWarning: with the condition that has slid farthest.

        Returns:
            True after a warning.
        """
        way = np.linalg.norm(motion, axis=1)
        share = np.where(
            forces[self.conditions] > LOADED_CONDITION * largest, way / self.widths, 0.0
        )
        if not share.max(initial=0.0) > 1.0:
            return False
        at = int(share.argmax())
        if is_first("far sliding along a tool"):
            warn(
                f"at {place}: condition {self.conditions[at]} has slid by {way[at]:.3g} along a "
                f"curved tool, {share[at]:.2g} facets, and its gap and normal are those of its "
                "place on the mesh. Make the tool a body whose nodes are imposed, which hhr.slide "
                "pairs again",
                FarSlidingWarning,
            )
        return True
