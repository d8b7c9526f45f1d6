"""Contact without separation in C, for pages, C headers and units for co-simulation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from hhr_dolfinx.formulas import Scalar
    from hhr_dolfinx.plugins.no_separation.laws import HeldConditions

_TEXT = """
static inline double model_no_separation_shift(const model_own *own) {
    (void)own;
    return 0;
}

static inline double model_no_separation_projection(const model_own *own, double y, double c,
                                                    double *slope) {
    *slope = own->memory[0] > 0 || y > c * own->numbers[0];
    return *slope * y;
}

static inline void model_no_separation_after(const model_own *own, double force, double slack,
                                             int active, double *memory) {
    (void)slack, (void)active;
    memory[0] = own->memory[0] > 0 || force > 0;
}
"""


class HoldingKernel:
    """Facet ``kernel``."""

    name = "no_separation"
    memory = 1
    text = _TEXT

    def numbers(self, law: HeldConditions) -> np.ndarray:
        """Overlap from which on each row presses, (k, 1).

        Args:
            law: the law of all rows.
        """
        return law.least[:, None]

    def formulas(self, law: HeldConditions) -> Sequence[Scalar]:
        """None.

        Args:
            law: the law of all rows.
        """
        return ()


HOLDING_KERNEL = HoldingKernel()
