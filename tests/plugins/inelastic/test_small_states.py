"""Histories that hardly flow count in a model beside those of full loads."""

import condensing
import numpy as np
import pytest
from test_door import legs

from hhr_dolfinx.certify.compare import Comparison
from hhr_dolfinx.certify.trust import TrustLimits, check_comparison
from hhr_dolfinx.errors import StabilityWarning, UnstableModelError
from hhr_dolfinx.reduction import modes as module
from hhr_dolfinx.reduction.modes import state_modes


@pytest.mark.parametrize("chunk", [module.CHUNK, 7])
def test_modes_hold_small_states_and_no_round_off(chunk, monkeypatch):
    monkeypatch.setattr(module, "CHUNK", chunk)
    ways = np.linalg.qr(np.random.default_rng(0).normal(size=(50, 4)))[0]
    large, small, tiny, noise = (size * way for size, way in zip((1.0, 1e-2, 1e-4, 1e-9), ways.T, strict=True))
    modes = state_modes([large, large + small, small, tiny, noise, np.zeros(50)], 1e-6)
    assert modes.T @ modes == pytest.approx(np.eye(modes.shape[1]), abs=1e-12)
    left = [np.linalg.norm(way - modes @ (modes.T @ way)) for way in ways.T]
    # what is a ten-thousandth counts as a tenth, and noise as a millionth
    assert max(left[:3]) < 1e-3 and left[3] == pytest.approx(1.0)
    assert state_modes([np.zeros(5)], 1e-6).shape == (5, 1)


def test_what_stays_behind_trained_part_loads(cantilever):
    """Trained at full load, and at 30 and 50 % of it: by their sizes, 90 and 20 % of that stress were wrong."""
    loads = [(1.6, -0.15), (1.6, 0.15), (0.5, -0.03), (0.5, 0.03), (0.8, -0.05), (0.8, 0.05)]
    known = [cantilever.march(legs((0, 0), load, (0, 0), steps=10)) for load in loads]
    model = condensing.condensed(cantilever, known, attempts=1, trust=None)
    for exact in known:
        here, there = model.march(exact.path, condensing.QUIET).answers[-1], exact.answers[-1]
        for name in ("stress", "plastic_strain"):
            found, right = (getattr(answer, name)() for answer in (here, there))
            assert np.linalg.norm(found - right) < 0.05 * np.linalg.norm(right)


@pytest.mark.parametrize("name", ["stress", "plastic strain"])
@pytest.mark.parametrize("error, outcome", [(0.04, None), (0.12, "warned"), (0.4, "refused")])
def test_limits_look_at_stress_and_plastic_strain(name, error, outcome):
    """Displacement and forces are right; what users read besides need not be."""
    none, wrong = np.full(2, 1e-3), np.array([1e-3, error])
    fields = (wrong, none) if name == "stress" else (none, wrong)
    comparison, limits = Comparison(["path 1", "path 2"], none, none, *fields), TrustLimits.of_histories()
    if outcome is None:
        check_comparison(comparison, limits)
    elif outcome == "warned":
        with pytest.warns(StabilityWarning, match=f"the {name} error, .* is 12.0% at 95 % .* at path 2"):
            check_comparison(comparison, limits)
    else:
        with pytest.raises(UnstableModelError, match=f"the {name} error"):
            check_comparison(comparison, limits)
