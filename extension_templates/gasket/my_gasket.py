"""A law of interfaces without memory, next to any others in a scene: a gasket, which bears a
pressure as it is closed.

Its pressure is p = k1 c + k3 c^3 over the closure c, minus the gap; k1 and k3 are numbers or
formulas of the parameters. The core solves it, by the curve and its derivatives alone. Such a law
must be monotone: p never falls while c grows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np

from hhr_dolfinx.contact.law import ContactLaw, PairLaw
from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.formulas import Scalar, check_over_box, formula_of
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.plugins.contact_laws.ranges import CurveStep, RangeSolver
from hhr_dolfinx.registry import Plugin


@dataclass(frozen=True, eq=False)
class Gaskets(ContactLaw):
    """Gaskets of all conditions, (m,), with the constants of each pair."""

    plugin: ClassVar[str] = "my_gasket"
    name: ClassVar[str] = "a gasket"
    remembers: ClassVar[bool] = False
    fixed: ClassVar[np.ndarray] = np.zeros(0, dtype=np.int64)

    area: Annotated[Floats, "m"]
    law: Annotated[Integers, "m"]  # index of the constants of each condition
    laws: tuple[tuple[Scalar, Scalar], ...]  # TODO: the constants of your law, as formulas

    def within(self, conditions):
        """See ContactLaw."""
        return replace(self, area=self.area[conditions], law=self.law[conditions])

    def parts(self):
        """See ContactLaw."""
        return [self.area, self.law, *(scalar.text for law in self.laws for scalar in law)]

    def opened(self, memory):
        """See ContactLaw: bodies may overlap by the closure, which answers keep."""
        return memory["closure"]

    @property
    def layout(self):
        """See ContactLaw."""
        return {"closure": ("float", "N_lambda")}

    def stored(self, memory):
        """See ContactLaw."""
        return {"closure": memory["closure"]}

    def restored(self, arrays):
        """See ContactLaw."""
        return Memory(closure=arrays["closure"])


@dataclass(frozen=True)
class Gasket(PairLaw):
    """Gasket of a pair, by the constants of its pressure k1 c + k3 c^3."""

    plugin: ClassVar[str] = "my_gasket"

    linear: float | str
    cubic: float | str = 0.0

    @property
    def texts(self):
        """See PairLaw."""
        return tuple(value for value in (self.linear, self.cubic) if isinstance(value, str))

    @property
    def words(self):
        """See PairLaw."""
        return f"gasket {self.linear} c + {self.cubic} c^3"

    def scalars(self, space, what):
        """Constants over the box; SceneError for one that is negative there: the pressure would
        fall.
        """
        scalars = tuple(
            Scalar(formula_of(value, what).text, space.names) for value in (self.linear, self.cubic)
        )
        for scalar in scalars:
            check_over_box(
                scalar,
                space,
                what,
                -1e-300,
                np.inf,
                "a gasket that softens may have several answers",
            )
        return scalars

    def check(self, scene, what):
        """See PairLaw."""
        self.scalars(scene.parameters, f"a constant of the gasket of {what}")

    @classmethod
    def attached(cls, laws, scene, rows, pairs, free, lifts, mesh):
        """See PairLaw: no further rows."""
        places = list(laws)
        number = np.array(
            [places.index(pair) if pair in laws else 0 for pair in pairs], dtype=np.int64
        )
        scalars = tuple(
            law.scalars(scene.parameters, "a constant of a gasket") for law in laws.values()
        )
        return rows, pairs, Gaskets(rows.areas, number, scalars)


class GasketRange(RangeSolver):
    """Facet ``range``, by which models solve."""

    def at_rest(self):
        """Nothing is closed."""
        return Memory(closure=np.zeros(self.law.area.size))

    def step(self, before, point, seconds):
        """See RangeSolver."""
        return GasketStep(self.law, point)


class GasketStep(CurveStep):
    """Gaskets at a point, (P,)."""

    def __init__(self, law, point):
        super().__init__(law.area.size)
        self.law, self.point = law, point
        values = np.array([[scalar.value(point) for scalar in one] for one in law.laws])
        self.linear, self.cubic = law.area * values[law.law].T

    def curve(self, closure):
        """See CurveStep."""  # TODO: the curve of your law; forces are pressures times areas
        return (
            self.linear * closure + self.cubic * closure**3,
            self.linear + 3.0 * self.cubic * closure**2,
        )

    def curve_slopes(self, closure):
        """See CurveStep."""
        slopes = np.array(
            [[scalar.derivative(self.point) for scalar in one] for one in self.law.laws]
        )
        linear, cubic = np.moveaxis(slopes[self.law.law], 1, 0)
        return (self.law.area * (linear.T * closure + cubic.T * closure**3)).T

    def after(self, forces, slack, active):
        """The closure, for outputs of gaps and residuals; no increment reads it."""
        return Memory(closure=np.maximum(-slack, 0.0))


class GasketKernel:
    """Facet ``kernel``: the same in C, for pages, C headers and units for co-simulation."""

    name = "my_gasket"
    memory = 0
    # TODO: the curve of your law in C; numbers are those of the row, values those of all formulas
    text = """
static double model_my_gasket_curve(const model_own *own, double closure, double *slope) {
    const double area = own->numbers[0], *constants = own->values + (int)own->numbers[1];
    const double linear = area * constants[0], cubic = area * constants[1];
    *slope = linear + 3 * cubic * closure * closure;
    return linear * closure + cubic * closure * closure * closure;
}

static inline double model_my_gasket_projection(const model_own *own, double y, double c,
                                                double *slope) {
    return model_resolvent(own, model_my_gasket_curve, y, c, slope);
}
"""

    def numbers(self, law):
        """Area of each row, and the place of its first constant, (k, 2)."""
        return np.column_stack([law.area, 2 * law.law])

    def formulas(self, law):
        """Both constants of each pair, in turn."""
        return [scalar for one in law.laws for scalar in one]


KERNEL = GasketKernel()
PLUGIN = Plugin(
    name="my_gasket",
    needs=("contact_laws",),
    public={"my_gasket": "Gasket"},
    classes={"my_gasket": "Gaskets"},
    memory=("closure",),
    facets={"range": "my_gasket:GasketRange", "kernel": "my_gasket:KERNEL"},
)
