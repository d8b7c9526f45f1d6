"""Conformance check of a law of an inelastic body, see :mod:`hhr_dolfinx.testing`."""

from __future__ import annotations

from typing import Any

import numpy as np

from hhr_dolfinx.plugins.inelastic.update import Group, Material, flow_of
from hhr_dolfinx.testing import OF_FUNCTIONS, OTHER_IN_A_FILE, ROUND_OFF, STEP, blaming, from_file, require

WRONG = {
    "file": OTHER_IN_A_FILE,
    "idle": "nothing flows under strains of {:g} with young = {:g}: give check_law both in its units",
    "alone": "flow at one point depends on other points: compute each entry of the arrays by itself",
    "zero": "it flows without stress: return 0 where the trial stress is 0",
    "slope": "its slope is {:.6g} at the trial stress {:.6g}, and differences give {:.6g}: return the derivative",
    "softens": "its slope is outside 0 to 1 / (3 mu), so that stress falls as strain grows: leave softening out",
    "rated": "it declares rated = False and depends on dt: leave that declaration out",
    "surface": "stress ends above its surface, since a second return flows on: solve for the surface at the step's end",
}
"""What the check says of a law: what is wrong, and what to do."""


@blaming
def check_law(law: Any, *, young: float = 200.0, poisson: float = 0.3, strain: float = 0.02, dt: float = 0.1) -> None:
    """Check a law of an inelastic body, for moduli, strains and a time step at which it flows.

    One that declares ``rated = False`` does not depend on dt, and returns to its surface or below.
    """
    random = np.random.default_rng(0)
    mu = young / (2 + 2 * poisson)
    material = Material([Group(np.arange(60), young, poisson, law)], 4)
    state = material.at_rest()
    path = np.zeros((60, 4))
    for _ in range(8):
        path = path + strain / 4 * random.standard_normal(path.shape)
        state = material.update(path, state, dt, tangent=False).state  # refuses flow that does not dissipate
    require(state.cumulated.any(), WRONG["idle"], strain, young)
    trial = 2 * mu * strain * 10 ** random.uniform(-1, 0.5, 60)
    old = state.cumulated
    flow = amount, slope = flow_of(law, trial, old, mu, dt)
    alone = np.hstack([flow_of(law, trial[k : k + 1], old[k : k + 1], mu, dt) for k in range(60)])
    require(np.allclose(alone, flow, rtol=1e-12, atol=0), WRONG["alone"])
    require(not flow_of(law, np.zeros(60), old, mu, dt)[0].any(), WRONG["zero"])
    low, high = (flow_of(law, trial * (1 + step), old, mu, dt)[0] for step in (-STEP, STEP))
    found = (high - low) / (2 * STEP * trial)
    wrong = np.where((low > 0) == (high > 0), np.abs(slope - found), 0.0)  # not where flow begins
    worst = int(wrong.argmax())
    right = wrong[worst] <= OF_FUNCTIONS * np.abs(found).max()
    require(right, WRONG["slope"], slope[worst], trial[worst], found[worst])
    require(slope.min() >= 0 and 3 * mu * slope.max() <= 1 + ROUND_OFF, WRONG["softens"])
    if not getattr(law, "rated", True):
        require(np.array_equal(amount, flow_of(law, trial, old, mu, 7 * dt)[0]), WRONG["rated"])
        further = flow_of(law, trial - 3 * mu * amount, old + amount, mu, dt)[0]
        require((3 * mu * further <= ROUND_OFF * trial).all(), WRONG["surface"])
    require(np.array_equal(flow_of(from_file(law), trial, old, mu, dt), flow), WRONG["file"])
