"""Laws that soften are named when models are trained, with the state at which they do."""

import dataclasses
from typing import ClassVar

import numpy as np
import pytest
from condensing import TIGHT, condensed
from scenes import pressed_block

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import StabilityWarning
from hhr_dolfinx.forms.laws import hardening
from hhr_dolfinx.geometries import block
from hhr_dolfinx.plugins.inelastic.softening import warn_of_softening


@dataclasses.dataclass(frozen=True)
class Linear(hhr.Law):
    """Yield at 300 + H p with any slope H."""

    slope: float
    unknowns: ClassVar = {"amount": 1}

    def statement(self, at):
        """See above."""
        return hardening(at, lambda p: 300 + at.constants.slope * p)


def trained(slope):
    base = pressed_block("plane_strain", young=200.0, gap=0.0, cells=2)
    bodies = (hhr.Body(block.SOLID, 200e3, 0.3, Linear(slope)),)
    full = hhr.FullOrderModel(dataclasses.replace(base, bodies=bodies))
    paths = ([(float(k), np.array([top * k / 6])) for k in range(7)] for top in (0.03, 0.02))
    return full, [full.march(path, TIGHT) for path in paths]


@pytest.mark.parametrize("build", [condensed, lambda full, histories: hhr.build(
    full, hhr.SnapshotSet.of_histories(histories), hhr.Recipe.flowing()
)], ids=["condensed", "reduced"])  # fmt: skip
def test_softening_in_training_is_named_by_law_time_and_point(build):
    """The tangent of von Mises' flow has the eigenvalue 2 μ H / (3 μ + H) along it, Simo and Hughes
    1998, (3.3.12).
    """
    shear = 200e3 / 2.6
    least = 2 * shear * -5e3 / (3 * shear - 5e3) / 200e3
    text = (
        r"Linear softens in training at t = . s, push = 0.0\d+: at 16 Gauss points .* by up "
        f"to {-least:.2g} of E"
    )
    with pytest.warns(StabilityWarning, match=text):
        build(*trained(-5e3))


@pytest.mark.parametrize("slope", [1e-9, 500.0])
def test_perfect_plasticity_and_hardening_are_not_said_to_soften(slope, recwarn):
    full, histories = trained(slope)
    warn_of_softening(full, hhr.SnapshotSet.of_histories(histories))
    assert not [item for item in recwarn if "softens" in str(item.message)]
