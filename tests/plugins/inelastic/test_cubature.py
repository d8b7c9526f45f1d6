"""Cubature: points and weights beside scipy's non-negative least squares, and histories on them
beside full ones.
"""

from __future__ import annotations

import time

import numpy as np
import pytest
from scipy.optimize import nnls

from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.plugins.inelastic import cubature
from hhr_dolfinx.plugins.inelastic.cubature import Cubature, _Search, compressed, fitted


def smooth(rows: int, points: int, seed: int = 0) -> np.ndarray:
    """Waves on random points of a square, with the weights of a quadrature."""
    generator = np.random.default_rng(seed)
    places, weights = generator.random((points, 2)), generator.uniform(0.3, 1, points) / points
    waves = [
        np.cos(places @ generator.normal(size=2) * 8 + generator.uniform(0, 6)) + 0.3
        for _ in range(rows)
    ]
    return np.array([wave / (1 + number / 20) for number, wave in enumerate(waves)]) * weights


def noisy(rows: int, points: int, seed: int = 0) -> np.ndarray:
    """Numbers without any order."""
    return np.random.default_rng(seed).normal(size=(rows, points)) + 0.2


def misfit_of(rows: np.ndarray, found: Cubature) -> float:
    """|A w - A 1| / |A 1|."""
    wanted = rows.sum(axis=1)
    return float(
        np.linalg.norm(rows[:, found.points] @ found.weights - wanted) / np.linalg.norm(wanted)
    )


def sound(rows: np.ndarray, found: Cubature) -> bool:
    """Whether points increase, weights are positive, and the misfit is what it says."""
    increasing = np.diff(found.points).min(initial=1) > 0
    return bool(increasing and (found.weights > 0).all()) and found.misfit == pytest.approx(
        misfit_of(rows, found)
    )


@pytest.mark.parametrize("make, share", [(smooth, 0.6), (noisy, 0.75)])
def test_a_search_goes_on_from_another_cubature(make, share, monkeypatch):
    """For more integrals and a finer tolerance: as few points as from nothing, after few of the
    additions.
    """
    rows, added, add = make(120, 2500), [], cubature._Factor.add
    monkeypatch.setattr(
        cubature._Factor, "add", lambda *arguments: added.append(None) or add(*arguments)
    )
    first = fitted(rows[:80], 1e-3)
    counts, found = [], []
    for start in (None, first):
        added.clear()
        found.append(fitted(rows, 3e-4, start=start))
        counts.append(len(added))
    cold, warm = found
    assert sound(rows, warm) and warm.misfit <= 3e-4
    assert warm.points.size <= 1.05 * cold.points.size and counts[1] < share * counts[0]
    # points that say the same, or nothing, and more than are allowed
    twins = np.hstack([rows, rows[:, first.points], np.zeros((120, 1))])
    places = np.append(
        np.concatenate([first.points, 2500 + np.arange(first.points.size)]), twins.shape[1] - 1
    )
    again = fitted(twins, 3e-4, start=Cubature(places, np.ones(places.size), 0.0))
    assert sound(twins, again) and again.misfit <= 3e-4
    assert fitted(rows, 3e-4, most=10, start=first).points.size <= 10


@pytest.mark.parametrize(
    ("make", "size", "tolerance", "most"),
    [(smooth, (40, 2500), 1e-2, 32), (smooth, (40, 2500), 1e-4, 39), (smooth, (30, 800), 1e-13, 30),
     (noisy, (40, 2500), 1e-2, 25), (noisy, (40, 2500), 1e-4, 36), (noisy, (30, 800), 1e-13, 30)],
)  # fmt: skip
def test_tolerance_is_met_with_few_points(make, size, tolerance, most):
    """At most one for each integral, and 15 % more than one at a time of all candidates: 28, 39, 22
    and 32 of these.
    """
    rows = make(*size)
    found = fitted(rows, tolerance)
    assert sound(rows, found) and found.misfit <= tolerance and found.points.size <= most


@pytest.mark.parametrize("seed", range(8))
def test_iteration_ends_where_that_of_scipy_does(seed):
    """Integrals that no weights meet: what is left is least, and no candidate is parallel to it."""
    generator = np.random.default_rng(seed)
    rows = generator.normal(size=(60, 80)) * 10.0 ** generator.uniform(-3, 3, 80)
    rows[:, 40:50] = rows[:, :10]
    wanted = generator.normal(size=60)
    lengths = np.linalg.norm(rows, axis=0)
    end = _Search(rows, lengths, wanted).run(0.0, 60)
    left = end.misfit()
    assert np.linalg.norm(left) == pytest.approx(nnls(rows / lengths, wanted)[1], rel=1e-9)
    assert (left @ (rows / lengths)).max() < 1e-10
    assert np.abs(left @ (rows / lengths)[:, end.points]).max() < 1e-10
    assert (end.weights > 0).all()


def test_hard_tables():
    """Points that do nothing, points twice, rows twice, and rows and points of very different
    size.
    """
    rows = smooth(20, 600)
    generator = np.random.default_rng(3)
    rows[:, ::7] = 0
    rows[:, 1::7] = rows[:, 2::7]
    rows = np.vstack([rows, rows[:5], np.zeros((2, 600)), 1e-12 * noisy(2, 600)])
    rows *= 10.0 ** generator.uniform(-8, 8, 600)
    for scales in (np.ones(len(rows)), 10.0 ** generator.uniform(-3, 3, len(rows))):
        found = fitted(rows * scales[:, None], 1e-9)
        assert sound(rows * scales[:, None], found) and found.misfit <= 1e-9
        assert scales.max() > 1 or not (found.points % 7 == 0).any()


def test_rows_that_cancel_and_rows_of_nothing():
    """One integral that is small beside what adds up to it, and integrals that are zero."""
    row = np.concatenate([np.ones(50), -np.ones(49)])
    found = fitted(row[None], 1e-12)
    assert (found.points.size, found.misfit) == (1, 0.0)
    assert fitted(np.zeros((3, 10)), 1e-3).points.size == 0


def test_most_points():
    rows = smooth(40, 2000)
    few = fitted(rows, 1e-6, most=10)
    assert few.points.size <= 10
    assert sound(rows, few)
    assert 1e-6 < few.misfit < 0.5


@pytest.mark.parametrize(
    ("rows", "options", "words"),
    [
        (np.array([[1.0, np.nan]]), {}, "point 1 .* not finite"),
        (np.array([[1.0, np.inf]]), {}, "not finite"),
    ],
)
def test_refused(rows, options, words):
    with pytest.raises(ReductionError, match=words):
        fitted(rows, **({"tolerance": 1e-3} | options))


def test_compression_keeps_what_counts():
    """Hundreds of rows of a few functions: weights for the few serve the many."""
    few = smooth(15, 3000)
    rows = np.random.default_rng(1).normal(size=(300, 15)) @ few
    fewer = compressed(lambda: np.array_split(rows, 7, axis=1), 1e-6)
    assert fewer.shape[0] <= 15
    assert np.linalg.norm(fewer) == pytest.approx(np.linalg.norm(rows), rel=1e-9)
    found = fitted(fewer, 1e-5)
    assert misfit_of(rows, found) < 2e-5


def test_compression_leaves_out_what_was_allowed():
    rows = noisy(40, 500) * 10.0 ** -np.linspace(0, 6, 40)[:, None]
    for tolerance in (1e-1, 1e-3):
        fewer = compressed(lambda: [rows], tolerance)
        values = np.linalg.svd(rows, compute_uv=False)
        left_out = np.sqrt((values[len(fewer) :] ** 2).sum() / (values**2).sum())
        assert left_out <= tolerance
        assert np.allclose(np.linalg.norm(fewer, axis=1), values[: len(fewer)])


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4])
def test_compression_of_many_rows_in_a_subspace(tolerance, monkeypatch):
    """As good as with all eigenvectors, and to the same number of rows."""
    generator = np.random.default_rng(2)
    rows = (generator.normal(size=(600, 400)) * 10.0 ** -np.linspace(0, 12, 400)) @ noisy(400, 900)
    exact = compressed(lambda: [rows], tolerance)
    monkeypatch.setattr(cubature, "SKETCHED", 100)
    monkeypatch.setattr(cubature, "SUBSPACE_GROWTH", 32)
    found = compressed(lambda: np.array_split(rows, 3, axis=1), tolerance)
    assert abs(len(found) - len(exact)) <= 1 and len(found) < 250
    left_out = 1 - (found**2).sum() / (rows**2).sum()
    assert left_out <= 1.01 * tolerance**2
    assert np.allclose(np.linalg.norm(found, axis=1)[:20], np.linalg.norm(exact, axis=1)[:20])


@pytest.mark.parametrize(
    ("chunks", "tolerance", "words"),
    [
        (lambda: [np.ones((2, 3)), np.ones((3, 3))], 1e-3, "chunk 1 .* shape"),
        (lambda: [np.full((2, 3), np.nan)], 1e-3, "chunk 0 .* not finite"),
        (lambda: [], 1e-3, "no rows"),
    ],
)
def test_refused_compressions(chunks, tolerance, words):
    with pytest.raises(ReductionError, match=words):
        compressed(chunks, tolerance)


def test_many_points_in_seconds():
    """A fifth of the largest tables: the whole of it takes seconds, scipy's minutes."""
    rows = noisy(300, 20000)
    start = time.process_time()
    assert fitted(rows, 1e-3).points.size > 100
    assert time.process_time() - start < 10
