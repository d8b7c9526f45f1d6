"""POD and DEIM as functions of arrays, and enrichment by finite element functions, Alg. 3.1."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from needs import needs
from scenes import largest_difference, pressed_pair

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotSolvableError, ReductionError
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.reduction.enrichment import enrich, record_enrichment
from hhr_dolfinx.reduction.modes import deim, pod
from hhr_dolfinx.reduction.projection import reduced_domain
from hhr_dolfinx.timing import StageLog


@pytest.fixture(scope="module")
def few_modes(hertz, hertz_snapshots):
    basis, _ = pod(hertz_snapshots.displacements, 1e-4)
    sets = reduced_domain(hertz.problem, hertz.problem.contact_slaves[20:30], layers=1)
    assert basis.shape[1] < len(sets.A_lambda)
    return basis, sets


@pytest.fixture(scope="module")
def enriched(hertz, few_modes):
    return enrich(hertz.problem, *few_modes, kappa_max=5.0)


def kappa(problem, basis, sets):
    return np.linalg.cond((problem.contact @ basis)[sets.A_lambda])


def functions_of(problem, conditions):
    """Finite element functions along the normal e_y of contact conditions, (N, n)."""
    return np.eye(problem.free.size)[:, 2 * problem.contact_slaves[conditions] + 1]


def test_rank_first_then_kappa(hertz, few_modes, enriched):
    basis, sets = few_modes
    missing = len(sets.A_lambda) - basis.shape[1]
    assert all(math.isinf(value) for value in enriched.kappas[:missing])
    finite = enriched.kappas[missing:]
    assert finite == sorted(finite, reverse=True) and finite[-1] <= 5.0 < finite[-2]
    assert kappa(hertz.problem, enriched.basis, sets) == pytest.approx(finite[-1], rel=1e-8)


def test_span_is_that_of_modes_and_contact_functions(hertz, few_modes, enriched):
    basis, _ = few_modes
    assert enriched.basis.T @ enriched.basis == pytest.approx(
        np.eye(enriched.basis.shape[1]), abs=1e-12
    )
    for columns in (basis, functions_of(hertz.problem, enriched.added)):
        assert enriched.basis @ (enriched.basis.T @ columns) == pytest.approx(columns, abs=1e-12)
    assert enriched.basis.shape[1] == basis.shape[1] + len(enriched.added)


def test_each_choice_is_the_best_one(hertz, few_modes, enriched):
    """Greedy against brute force: no other single function would have given a smaller kappa."""
    basis, sets = few_modes
    before = enrich(hertz.problem, basis, sets, kappa_max=enriched.kappas[-2] * (1 + 1e-9))
    others = []
    for function in functions_of(hertz.problem, np.setdiff1d(sets.A_lambda, before.added)).T:
        together, _ = np.linalg.qr(np.column_stack([before.basis, function]))
        others.append(kappa(hertz.problem, together, sets))
    assert enriched.kappas[-1] == pytest.approx(min(others), rel=1e-6)


def test_while_rows_are_dependent_the_farthest_is_taken(hertz, few_modes, enriched):
    """Of all functions that are left the one whose image lies farthest outside of the range of B~,
    by least squares.
    """
    basis, sets = few_modes
    missing, rows = sum(map(math.isinf, enriched.kappas)), hertz.problem.contact[sets.A_lambda]
    left = list(sets.A_lambda)
    for condition in enriched.added[:missing]:
        reached, chosen = rows @ basis, left.index(condition)
        functions = functions_of(hertz.problem, left).T
        columns = [
            np.linalg.qr(np.column_stack([basis, function]))[0][:, -1] for function in functions
        ]
        images = rows @ np.transpose(columns)
        distances = np.linalg.norm(
            images - reached @ np.linalg.lstsq(reached, images, rcond=None)[0], axis=0
        )
        assert distances[chosen] == pytest.approx(max(distances), rel=1e-9)
        basis = np.column_stack([basis, columns[chosen]])
        left.remove(condition)
    assert missing > 5 and np.linalg.matrix_rank(rows @ basis) == len(sets.A_lambda)


def test_choices_know_no_units(hertz, few_modes, enriched):
    """Rows of mortar contact are as small as areas in square metres."""
    small = dataclasses.replace(hertz.problem, contact=1e-9 * hertz.problem.contact)
    other = enrich(small, *few_modes, kappa_max=5.0)
    assert enriched.added.tolist() == other.added.tolist()
    assert enriched.kappas[-1] == pytest.approx(other.kappas[-1], rel=1e-9)


@pytest.mark.parametrize("size", [0.0, 1e-14, 1e-12, 1e-10, -1e-12])
def test_choices_know_no_round_off(hertz, few_modes, size):
    """The least important mode of a POD has round-off of answers over its singular value, which is
    no direction.

    Modes with such parts along all functions of the contact have B~ of full rank to 1e-13, and
    choices were by noise.
    """
    basis, sets = few_modes
    movable = hertz.problem.free[:, None]
    # as many columns as rows of B~, most of which do no work on the contact but for the noise
    still = (
        np.random.default_rng(0).standard_normal((len(basis), len(sets.A_lambda) - basis.shape[1]))
        * movable
    )
    still[np.unique(hertz.problem.contact.indices)] = 0.0
    clean = np.linalg.qr(np.hstack([basis, still]))[0]
    moved = np.random.default_rng(1).standard_normal(clean.shape) * movable
    known, found = (
        enrich(hertz.problem, one, sets, kappa_max=5.0)
        for one in (clean, np.linalg.qr(clean + size * moved)[0])
    )
    assert found.added.tolist() == known.added.tolist()
    assert found.kappas == pytest.approx(known.kappas, rel=1e-6)
    assert math.isinf(known.kappas[0]) and math.isfinite(known.kappas[-1])


def test_everything_added_or_a_stall_is_said(hertz, few_modes):
    found = enrich(hertz.problem, *few_modes, kappa_max=1.0)
    assert found.stalled or len(found.added) == len(few_modes[1].A_lambda)


def test_good_basis_is_left_alone(hertz, hertz_reduction):
    assert len(hertz_reduction.offline.enrichment.added) == 0
    assert "enrichment" in {item["stage"] for item in hertz_reduction.offline.log.skipped}


def test_enriched_model_is_solvable_where_the_plain_one_was_not(hertz, hertz_snapshots):
    """One more layer brings in 9 contact nodes for 8 modes."""
    recipe = hhr.Recipe.thesis(1e-8, domain=hhr.Rid(1, 1))
    with pytest.raises(NotSolvableError, match=r"1\.67"):
        hhr.build(hertz, hertz_snapshots, dataclasses.replace(recipe, enrichment=None))
    reduction = hhr.build(hertz, hertz_snapshots, recipe)
    assert len(reduction.offline.enrichment.added) > 0 and reduction.offline.stability.kappa_B <= 10
    solution, reference = (
        reduction.solve(0.3),
        hertz.solve(0.3).forces()[reduction.offline.sets.A_lambda],
    )
    assert np.linalg.norm(solution.multipliers - reference) < 0.05 * np.linalg.norm(reference)


@pytest.fixture(scope="module")
def pair_and_stop():
    """Contact of two blocks, and a stop for the same surface, so that each slave node carries two
    conditions.
    """
    slave, master = (
        two_blocks.side(two_blocks.SECOND, 1, False),
        two_blocks.side(two_blocks.FIRST, 1, True),
    )
    contacts = (
        hhr.NodeToNode(slave, master, (0.0, -1.0)),
        hhr.Obstacle(slave, (0.0, -1.0), -0.985),
    )
    scene = pressed_pair("plane_strain", ((3.0, 0.3), (30.0, 0.2)), contacts=contacts, cells=8)
    training = hhr.train(scene, hhr.Sobol(32))
    return training.full_order, training.build(hhr.Recipe().as_it_is())


@needs("shared_nodes")
def test_twin_conditions_are_both_held_and_clamps_stay(pair_and_stop):
    """The function of the stop was once taken for the pair too: clamps moved by 4e-4, and rows
    stayed dependent.
    """
    full, model = pair_and_stop
    record = model.offline
    assert math.isfinite(record.stability.kappa_B) and record.stability.kappa_B <= 10
    assert not record.basis[~full.problem.free].any()
    assert record.basis.T @ record.basis == pytest.approx(np.eye(record.basis.shape[1]), abs=1e-12)
    for point in full.parameters.random(20, 1):
        imposed = (full.problem.lifts @ full.problem.theta(point))[~full.problem.free]
        assert model.solve(point).displacement()[~full.problem.free] == pytest.approx(
            imposed, abs=0
        )


@needs("exact_errors", "shared_nodes")
def test_estimates_are_right_where_conditions_are_twins(pair_and_stop):
    """5 of these 200 points were beyond their bound."""
    full, model = pair_and_stop
    from bound_checks import check

    check(full, model, full.parameters.random(200, 3))


def test_a_function_in_the_span_is_left_out_and_named(hertz, few_modes):
    """The basis holds one candidate to the last bit.

    Its length is zero, and round-off of it is no direction.
    """
    basis, sets = few_modes
    held = sets.A_lambda[3]
    both = np.hstack([functions_of(hertz.problem, [held]), basis])
    enriched = enrich(hertz.problem, np.linalg.qr(both)[0], sets, kappa_max=1.0)
    log = StageLog()
    record_enrichment(enriched, 1.0, log)
    assert list(enriched.left_out) == [held] and held not in enriched.added
    assert any(
        str(held) in item["why"] for item in log.skipped if item["stage"] == "enrichment_twins"
    )


def test_a_basis_that_moves_clamps_is_refused(hertz, few_modes):
    basis, sets = few_modes
    with pytest.raises(ReductionError, match=r"moves imposed dofs by .* > 1e-08"):
        enrich(hertz.problem, np.linalg.qr(basis + 1e-6)[0], sets, kappa_max=5.0)


@needs("shared_nodes")
def test_conditions_that_say_the_same_are_told(pair_and_stop):
    """On an imposed master a pair is a stop: no basis helps, and more modes were advised."""
    scene = pair_and_stop[0].scene
    held = hhr.Displacement.clamp(two_blocks.side(two_blocks.FIRST, 1, True), 2)
    rigid = dataclasses.replace(scene, displacements=(*scene.displacements, *held))
    with pytest.raises(NotSolvableError, match="9 contact conditions say the same as another one"):
        hhr.train(rigid, hhr.Sobol(16)).build()


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10**6), exponent=st.integers(1, 12), columns=st.integers(2, 12))
def test_pod_leaves_out_less_than_the_tolerance_and_no_mode_too_many(seed, exponent, columns):
    rng = np.random.default_rng(seed)
    left, right = (np.linalg.qr(rng.normal(size=(rows, columns)))[0] for rows in (40, columns))
    snapshots = left * 0.1 ** np.arange(columns) @ right
    kept_before = snapshots.copy()
    tolerance = 10.0**-exponent
    modes, values = pod(snapshots, tolerance)
    assert np.array_equal(snapshots, kept_before)
    assert modes.T @ modes == pytest.approx(np.eye(modes.shape[1]), abs=1e-12)
    left_out = np.sum((snapshots - modes @ (modes.T @ snapshots)) ** 2) / np.sum(snapshots**2)
    assert left_out < tolerance * (1 + 1e-6)
    if modes.shape[1] > 1:
        assert np.sum(values[modes.shape[1] - 1 :] ** 2) / np.sum(values**2) >= tolerance * (
            1 - 1e-12
        )


def test_pod_stops_at_the_rank():
    """Duplicated and collinear snapshots: modes of round-off are not modes."""
    assert (
        pod(np.eye(4)[:, :2] @ [[1.0, 0, 1, 0, 2, 1], [0, 1, 0, 1, 0, 1]], 1e-300)[0].shape[1] == 2
    )


@pytest.mark.parametrize(
    ("snapshots", "message"),
    [
        (np.ones((4, 1)), "at least 2"),
        (np.zeros((4, 3)), "zero"),
        (np.full((4, 3), np.nan), "finite"),
    ],
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
    # error amplified by the DEIM constant |(P^T V)^-1|, at most about 1e4 for 10 modes
    assert basis @ np.linalg.solve(basis[points], field[points]) == pytest.approx(field, abs=1e-10)


def test_deim_follows_the_algorithm():
    """Alg. 1.2 by hand: the largest entry, then the largest residual."""
    assert deim(np.array([[1.0, 0.5], [0.5, 1.0], [0.0, 0.9]])).tolist() == [0, 2]


def test_deim_refuses_dependent_columns():
    with pytest.raises(ReductionError, match="column 1"):
        deim(np.ones((4, 2)))


def test_snapshots_are_scaled_in_the_norm_of_the_modes(hertz, hertz_snapshots):
    """With ``relative`` a snapshot counts as 1 in that norm: the scaled ones have the energy 1."""
    columns = hertz_snapshots.displacements[:, 1:]
    energies = np.sqrt(np.einsum("nk,nk->k", columns, hertz.problem.stiffness @ columns))
    scaled = hhr.Pod(1e-8, norm="energy").of_columns(hertz.problem, columns / energies)
    found = hhr.Pod(1e-8, relative=True, norm="energy").of_columns(hertz.problem, columns)
    assert found.shape == scaled.shape and largest_difference(found, scaled) <= 1e-8
