"""The curves in C, for pages, C headers and units for co-simulation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from hhr_dolfinx.formulas import Scalar
    from hhr_dolfinx.plugins.soft_contact.laws import SoftContacts

_TEXT = """
/* Numbers of a row: area, place of its factor, gap where its pressure begins, kind, curve. */
static double model_soft_contact_curve(const model_own *own, double d, double *slope) {
    const double area = own->numbers[0], factor = area * own->values[(int)own->numbers[1]];
    const double *more = own->numbers + 4;
    const int kind = (int)own->numbers[3];
    if (kind == 0) return *slope = factor, factor * d;
    if (kind == 1) {
        const double force = factor * exp(more[0] * (d - more[1]));
        return *slope = more[0] * force, force;
    }
    const int count = (int)more[0];
    const double *begins = more + 1, *pressures = more + 1 + count;
    int k = 0;
    while (k < count - 2 && d >= begins[k + 1]) k++;
    const double rise = (pressures[k + 1] - pressures[k]) / (begins[k + 1] - begins[k]);
    *slope = factor * rise;
    return factor * (pressures[k] + rise * (d - begins[k]));
}

static inline double model_soft_contact_projection(const model_own *own, double y, double c,
                                                   double *slope) {
    return model_resolvent(own, model_soft_contact_curve, y + c * own->numbers[2], c, slope);
}
"""


class SoftKernel:
    """Facet ``kernel``."""

    name = "soft_contact"
    memory = 0
    text = _TEXT

    def numbers(self, law: SoftContacts) -> np.ndarray:
        """Area of each row, place of its factor, its reach, kind and curve, (k, c).

        Args:
            law: the law of all rows.
        """
        longest = max(len(curve.numbers) for curve in law.curves)
        padded = np.zeros((len(law.curves), 3 + longest))
        for place, curve in enumerate(law.curves):
            told = (float(place), curve.reach, float(curve.kind), *curve.numbers)
            padded[place, : len(told)] = told
        return np.column_stack([law.area, padded[law.number]])

    def formulas(self, law: SoftContacts) -> list[Scalar]:
        """Factors of all curves, in turn.

        Args:
            law: the law of all rows.
        """
        return [curve.factor for curve in law.curves]


KERNEL = SoftKernel()
