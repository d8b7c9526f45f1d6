"""POD and DEIM as functions of arrays."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.reduction.modes import deim, pod


def low_rank(rows, columns, decay, seed):
    rng = np.random.default_rng(seed)
    left, _ = np.linalg.qr(rng.normal(size=(rows, columns)))
    right, _ = np.linalg.qr(rng.normal(size=(columns, columns)))
    return left * decay ** np.arange(columns) @ right


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10**6), exponent=st.integers(1, 12), columns=st.integers(2, 12))
def test_pod_leaves_out_less_than_the_tolerance_and_no_mode_too_many(seed, exponent, columns):
    snapshots = low_rank(40, columns, 0.1, seed)
    kept_before = snapshots.copy()
    tolerance = 10.0**-exponent
    modes, values = pod(snapshots, tolerance)
    assert np.array_equal(snapshots, kept_before)
    assert modes.T @ modes == pytest.approx(np.eye(modes.shape[1]), abs=1e-12)
    left_out = np.sum((snapshots - modes @ (modes.T @ snapshots)) ** 2) / np.sum(snapshots**2)
    assert left_out < tolerance * (1 + 1e-6)
    if modes.shape[1] > 1:
        assert np.sum(values[modes.shape[1] - 1 :] ** 2) / np.sum(values**2) >= tolerance * (1 - 1e-12)


def test_pod_stops_at_the_rank():
    """Duplicated and collinear snapshots: modes of round-off are not modes."""
    two = np.array([[1.0, 0, 0, 0], [0, 1.0, 0, 0]]).T
    snapshots = np.column_stack([two, two, 2 * two[:, 0], two.sum(axis=1)])
    assert pod(snapshots, 1e-300)[0].shape[1] == 2


@pytest.mark.parametrize(
    ("snapshots", "message"),
    [(np.ones((4, 1)), "at least 2"), (np.zeros((4, 3)), "zero"), (np.full((4, 3), np.nan), "finite")],
)
def test_pod_refuses_useless_snapshots(snapshots, message):
    with pytest.raises(ReductionError, match=message):
        pod(snapshots, 1e-6)


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10**6), modes=st.integers(1, 10))
def test_deim_interpolates_its_span_exactly(seed, modes):
    rng = np.random.default_rng(seed)
    basis, _ = np.linalg.qr(rng.normal(size=(30, modes)))
    points = deim(basis)
    assert len(set(points)) == modes
    field = basis @ rng.normal(size=modes)
    rebuilt = basis @ np.linalg.solve(basis[points], field[points])
    # error amplified by the DEIM constant |(P^T V)^-1|, at most about 1e4 for 10 modes
    assert rebuilt == pytest.approx(field, abs=1e-10)


def test_deim_follows_the_algorithm():
    """Alg. 1.2 by hand: the largest entry, then the largest residual."""
    assert deim(np.array([[1.0, 0.5], [0.5, 1.0], [0.0, 0.9]])).tolist() == [0, 2]


def test_deim_refuses_dependent_columns():
    with pytest.raises(ReductionError, match="column 1"):
        deim(np.ones((4, 2)))


def test_snapshots_are_scaled_in_the_norm_of_the_modes(hertz, hertz_snapshots):
    """With ``relative`` a snapshot counts as 1 in that norm, so that the mean square of the modes' norms is 1 too.

    The squared singular values of a POD sum to that of the scaled snapshots: all have the energy 1.
    """
    columns = hertz_snapshots.displacements[:, 1:]
    energies = np.sqrt(np.einsum("nk,nk->k", columns, hertz.problem.stiffness @ columns))
    scaled = hhr.Pod(1e-8, norm="energy").of_columns(hertz.problem, columns / energies)
    found = hhr.Pod(1e-8, relative=True, norm="energy").of_columns(hertz.problem, columns)
    assert found.shape == scaled.shape
    assert np.abs(found - scaled).max() <= 1e-8 * np.abs(scaled).max()
