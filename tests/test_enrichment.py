"""Enrichment by finite element functions, Alg. 3.1."""

import math

import numpy as np
import pytest

import hhr_dolfinx as hhr
from hhr_dolfinx.reduction.enrichment import enrich
from hhr_dolfinx.reduction.pod import pod
from hhr_dolfinx.reduction.rid import reduced_domain


@pytest.fixture(scope="module")
def few_modes(hertz, hertz_snapshots):
    """Two modes and a RID with many more contacts than that."""
    basis, _ = pod(hertz_snapshots.displacements, 1e-4)
    sets = reduced_domain(hertz.problem, hertz.problem.contact_slaves[20:30], layers=1)
    assert basis.shape[1] < len(sets.A_lambda)
    return basis, sets


def kappa(problem, basis, sets):
    return np.linalg.cond((problem.contact @ basis)[sets.A_lambda])


def test_rank_first_then_kappa(hertz, few_modes):
    basis, sets = few_modes
    enriched = enrich(hertz.problem, basis, sets, kappa_max=5.0)
    missing = len(sets.A_lambda) - basis.shape[1]
    assert all(math.isinf(value) for value in enriched.kappas[:missing])
    finite = enriched.kappas[missing:]
    assert finite == sorted(finite, reverse=True) and finite[-1] <= 5.0 < finite[-2]
    assert kappa(hertz.problem, enriched.basis, sets) == pytest.approx(finite[-1], rel=1e-8)


def test_span_is_that_of_modes_and_contact_functions(hertz, few_modes):
    basis, sets = few_modes
    enriched = enrich(hertz.problem, basis, sets, kappa_max=5.0)
    assert enriched.basis.T @ enriched.basis == pytest.approx(np.eye(enriched.basis.shape[1]), abs=1e-12)
    slaves = hertz.problem.contact_slaves[enriched.added]
    functions = np.eye(hertz.problem.free.size)[:, 2 * slaves + 1]  # contact normal e_y
    for columns in (basis, functions):
        assert enriched.basis @ (enriched.basis.T @ columns) == pytest.approx(columns, abs=1e-12)
    assert enriched.basis.shape[1] == basis.shape[1] + len(slaves)


def test_each_choice_is_the_best_one(hertz, few_modes):
    """Greedy against brute force: no other single function would have given a smaller kappa."""
    basis, sets = few_modes
    path = enrich(hertz.problem, basis, sets, kappa_max=5.0)
    before = enrich(hertz.problem, basis, sets, kappa_max=path.kappas[-2] * (1 + 1e-9))
    others = []
    for condition in np.setdiff1d(sets.A_lambda, before.added):
        function = np.zeros(hertz.problem.free.size)
        function[2 * hertz.problem.contact_slaves[condition] + 1] = 1.0
        together, _ = np.linalg.qr(np.column_stack([before.basis, function]))
        others.append(kappa(hertz.problem, together, sets))
    assert path.kappas[-1] == pytest.approx(min(others), rel=1e-6)


def test_everything_added_or_a_stall_is_said(hertz, few_modes):
    basis, sets = few_modes
    enriched = enrich(hertz.problem, basis, sets, kappa_max=1.0)
    assert enriched.stalled or len(enriched.added) == len(sets.A_lambda)


def test_good_basis_is_left_alone(hertz, hertz_reduction):
    assert len(hertz_reduction.offline.enrichment.added) == 0
    assert "enrichment" in {item["stage"] for item in hertz_reduction.offline.log.skipped}


def test_enriched_model_is_solvable_where_the_plain_one_was_not(hertz, hertz_snapshots):
    reduction = hhr.build(hertz, hertz_snapshots, hhr.Recipe.thesis(1e-8, domain=hhr.Rid(1, 1)))
    assert len(reduction.offline.enrichment.added) > 0 and reduction.offline.stability.kappa_B <= 10
    solution, reference = reduction.solve(0.3), hertz.solve(0.3).forces()[reduction.offline.sets.A_lambda]
    assert np.linalg.norm(solution.multipliers - reference) < 0.05 * np.linalg.norm(reference)
