"""Wear in C, for pages, C headers and units for co-simulation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.errors import NotOfferedError

if TYPE_CHECKING:
    from hhr_dolfinx.formulas import Scalar
    from hhr_dolfinx.plugins.wear.laws import WornConditions

_TEXT = """
static inline double model_wear_shift(const model_own *own) { return own->memory[0]; }

static inline double model_wear_projection(const model_own *own, double y, double c,
                                           double *slope) {
    *slope = (y > 0) / (1 + c * own->numbers[0] * own->seconds);
    return *slope * y;
}

static inline void model_wear_after(const model_own *own, double force, double slack, int active,
                                    double *memory) {
    (void)slack, (void)active;
    memory[0] = own->memory[0] + own->numbers[0] * own->seconds * force;
}
"""


class WearKernel:
    """Facet ``kernel``."""

    name = "wear"
    memory = 1
    text = _TEXT

    def numbers(self, law: WornConditions) -> np.ndarray:
        """Depth per force and second of each row, (k, 1).

        Args:
            law: the law of all rows.

        Raises:
            NotOfferedError: for wear along the slip.
        """
        if law.along.any():
            raise NotOfferedError("a page or C of wear along the slip is not built in")
        return law.rate[:, None]

    def formulas(self, law: WornConditions) -> Sequence[Scalar]:
        """None.

        Args:
            law: the law of all rows.
        """
        return ()


WEAR_KERNEL = WearKernel()
