"""Stress and forces of models trained at full loads: exact where nothing flows, errors are said."""

import condensing
import numpy as np
import pytest
from condensing import QUIET
from flow_histories import legs

from hhr_dolfinx.certify.accuracy import relative_error
from hhr_dolfinx.certify.compare import Comparison
from hhr_dolfinx.certify.trust import TrustLimits, check_comparison
from hhr_dolfinx.errors import StabilityWarning, UnstableModelError
from hhr_dolfinx.plugins.inelastic import state as module
from hhr_dolfinx.plugins.inelastic.recipe import FlowLimits
from hhr_dolfinx.plugins.inelastic.state import state_modes


def up_and_down(a, b, steps):
    return legs((0, 0), (a, b), (0, 0), steps=steps)


@pytest.fixture(scope="module")
def trained(cantilever):
    """At full loads alone."""
    known = [cantilever.march(up_and_down(1.6, b, 10)) for b in (-0.15, 0.15)]
    return cantilever, condensing.condensed(cantilever, known), known


@pytest.mark.parametrize("share", [0.02, 0.1])
def test_part_loads_without_flow_are_exact(trained, share):
    """From training at full loads, where everything flows.

    Gappy POD of the stress was up to 46 % wrong there.
    """
    full, model, _ = trained
    here, there = (
        item.march(legs((0, 0), (1.6 * share, 0.15 * share), steps=4), QUIET)
        for item in (model, full)
    )
    for one, other in zip(here.answers, there.answers, strict=True):
        assert not other.plastic_strain().any()
        # the tolerance of steps is 1e-5 of forces
        assert relative_error(one.stress().ravel(), other.stress().ravel()) < 1e-6
        assert one.estimate().primal_relative == 0.0


def test_each_point_is_foretold_by_the_others(trained):
    """Beside a fit without the point, for points where that one is determined."""
    _, model, _ = trained
    flow = model.fields.flow
    answer = model.march(legs((0, 0), (1.2, 0.1), steps=6), QUIET).answers[-1]
    plastic = answer.state().state.inelastic
    components = plastic.shape[1]
    rows = (
        np.searchsorted(flow.flowed, flow.points)[:, None] * components + np.arange(components)
    ).ravel()
    modes, found = flow.plastic.modes[rows], flow.unforeseen(plastic)
    checked = 0
    for point in range(0, len(plastic), 3):
        own = np.arange(point * components, (point + 1) * components)
        others = np.setdiff1d(np.arange(rows.size), own)
        open_ = np.linalg.eigvalsh(np.eye(components) - modes[own] @ flow.plastic.fit[:, own])
        if open_.min() < 0.1:
            continue
        shares = np.linalg.lstsq(modes[others], plastic.ravel()[others], rcond=None)[0]
        expected = flow.shear[flow.points[point]] * (plastic.ravel()[own] - modes[own] @ shares)
        assert found[point] == pytest.approx(expected, abs=1e-7 * np.abs(answer.stress()).max())
        checked += 1
    assert checked > 3


def test_errors_of_stress_are_said_in_their_size(trained):
    """On part loads, unloading and other ways.

    No path with an error above 5 % of a step's own stress is silent.
    """
    full, model, _ = trained
    errors, said = [], []
    for share in (0.2, 0.4, 0.6, 0.8, 1.0):
        for way in (-1, 0.4, 1):
            path = legs((0, 0), (1.6 * share, 0.15 * way * share), (0, 0), steps=8)
            here, there = model.march(path, QUIET), full.march(path)
            sizes = np.array([np.linalg.norm(item.stress()) for item in there.answers])
            off = [
                np.linalg.norm(a.stress() - b.stress())
                for a, b in zip(here.answers, there.answers, strict=True)
            ]
            errors.append(np.where(sizes > 1e-5 * sizes.max(), off / sizes, 0.0))
            said.append([answer.estimate().primal_relative for answer in here.answers])
    errors, said = np.array(errors), np.array(said)
    off = errors.max(axis=1) > 0.05
    assert off.any() and (said[off].max(axis=1) > model.trained.allowed(np.inf)).all()
    seen = errors > 1e-3
    # medians of other scenes were .3 to 4
    assert seen.sum() > 50 and 0.5 < np.median(said[seen] / errors[seen]) < 5


@pytest.mark.parametrize("chunk", [module.STACKED_VALUES, 7])
def test_modes_hold_small_states_and_no_round_off(chunk, monkeypatch):
    monkeypatch.setattr(module, "STACKED_VALUES", chunk)
    ways = np.linalg.qr(np.random.default_rng(0).normal(size=(50, 4)))[0]
    large, small, tiny, noise = (
        size * way for size, way in zip((1.0, 1e-2, 1e-4, 1e-9), ways.T, strict=True)
    )
    modes = state_modes([large, large + small, small, tiny, noise, np.zeros(50)], 1e-6)
    assert modes.T @ modes == pytest.approx(np.eye(modes.shape[1]), abs=1e-12)
    left = [np.linalg.norm(way - modes @ (modes.T @ way)) for way in ways.T]
    # what is a ten-thousandth counts as a tenth, and noise as a millionth
    assert max(left[:3]) < 1e-3 and left[3] == pytest.approx(1.0)
    assert state_modes([np.zeros(5)], 1e-6).shape == (5, 1)


def test_what_stays_behind_trained_part_loads(trained):
    """Trained at full load, and at 30 and 50 % of it: by their sizes, 90 and 20 % of that stress
    were wrong.
    """
    full, _, known = trained
    parts = (0.5, -0.03), (0.5, 0.03), (0.8, -0.05), (0.8, 0.05)
    known = known + [full.march(up_and_down(*load, 10)) for load in parts]
    model = condensing.condensed(full, known, attempts=1, trust=None)
    for exact in known:
        here, there = model.march(exact.path, condensing.QUIET).answers[-1], exact.answers[-1]
        for name in ("stress", "plastic_strain"):
            assert (
                relative_error(*(getattr(answer, name)().ravel() for answer in (here, there)))
                < 0.05
            )


@pytest.mark.parametrize("name", ["stress", "plastic strain"])
@pytest.mark.parametrize("error, outcome", [(0.04, None), (0.12, "warned"), (0.4, "refused")])
def test_limits_look_at_stress_and_plastic_strain(name, error, outcome):
    """Displacement and forces are right; what users read besides need not be."""
    none, wrong = np.full(2, 1e-3), np.array([1e-3, error])
    fields = (wrong, none) if name == "stress" else (none, wrong)
    rows = list(zip(["path 1", "path 2"], none, none, *fields, strict=True))
    comparison, limits = (
        Comparison.of(rows, ("stress", "plastic strain")),
        FlowLimits.of(TrustLimits.of_histories()),
    )
    if outcome is None:
        check_comparison(comparison, limits)
    elif outcome == "warned":
        with pytest.warns(
            StabilityWarning, match=f"the {name} error, .* is 12.0% at 95 % .* at path 2"
        ):
            check_comparison(comparison, limits)
    else:
        with pytest.raises(UnstableModelError, match=f"the {name} error"):
            check_comparison(comparison, limits)
