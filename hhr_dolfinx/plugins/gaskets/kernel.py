"""Gaskets in C, for pages, C headers and units for co-simulation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from hhr_dolfinx.formulas import Scalar
    from hhr_dolfinx.plugins.gaskets.laws import GasketLayers

_TEXT = """
/* Numbers of a row: area, place of its factor, gap where it begins, count of points, then their
   closures, pressures and sets. */
static double model_gaskets_between(const model_own *own, int list, double d, double *slope) {
    const int count = (int)own->numbers[3];
    const double *begins = own->numbers + 4, *values = begins + list * count;
    int k = 0;
    while (k < count - 2 && d >= begins[k + 1]) k++;
    *slope = (values[k + 1] - values[k]) / (begins[k + 1] - begins[k]);
    return values[k] + *slope * (d - begins[k]);
}

static double model_gaskets_curve(const model_own *own, double d, double *slope) {
    const double factor = own->numbers[0] * own->values[(int)own->numbers[1]];
    const double largest = own->memory[0];
    double pressure, unused;
    if (d >= largest) {
        pressure = model_gaskets_between(own, 1, d, slope);
    } else {
        const double left = model_gaskets_between(own, 2, largest, &unused);
        const double rise = model_gaskets_between(own, 1, largest, &unused) / (largest - left);
        *slope = d > left ? rise : 0;
        pressure = *slope * (d - left);
    }
    *slope *= factor;
    return factor * pressure;
}

static inline double model_gaskets_projection(const model_own *own, double y, double c,
                                              double *slope) {
    return model_resolvent(own, model_gaskets_curve, y, c, slope);
}

static inline double model_gaskets_shift(const model_own *own) { return -own->numbers[2]; }

static inline void model_gaskets_after(const model_own *own, double force, double slack, int active,
                                       double *memory) {
    (void)force, (void)active;
    memory[0] = fmax(own->memory[0], -slack);
}
"""


class GasketKernel:
    """Facet ``kernel``."""

    name = "gaskets"
    memory = 1
    text = _TEXT

    def numbers(self, law: GasketLayers) -> np.ndarray:
        """Area of each row, place of its factor, and its curve, (k, c).

        Args:
            law: the law of all rows.
        """
        longest = max(curve.closures.size for curve in law.curves)
        padded = np.zeros((len(law.curves), 3 + 3 * longest))
        for place, curve in enumerate(law.curves):
            count = curve.closures.size
            numbers = (place, curve.reach, count, *curve.closures, *curve.pressures, *curve.sets)
            padded[place, : len(numbers)] = numbers
        return np.column_stack([law.area, padded[law.number]])

    def formulas(self, law: GasketLayers) -> list[Scalar]:
        """Factors of all curves, in turn.

        Args:
            law: the law of all rows.
        """
        return [curve.factor for curve in law.curves]


GASKET_KERNEL = GasketKernel()
