"""The indicator of contact forces of histories: exact for the full order, it ranks, and corrected forces are better."""

import pickle

import condensing
import numpy as np
import pytest
import varied
from condensing import QUIET
from scipy.stats import spearmanr
from test_door import legs

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.plugins.inelastic.project import force_correction
from hhr_dolfinx.study.training.train import Training

LOADS = [(1.6, 0.05), (1.2, -0.1), (0.8, 0.1), (1.5, 0.14), (0.4, 0.0)]
"""Largest A and B of unseen paths of the cantilever: between those of its training, and parts of them."""


def up_and_down(a, b, steps):
    return legs((0, 0), (a, b), (0, 0), steps=steps)


@pytest.fixture(scope="module")
def known(cantilever):
    """The correction, training histories, and others."""
    training = [cantilever.march(up_and_down(1.6, b, 10)) for b in (-0.15, 0.15)]
    return force_correction(cantilever), training, [cantilever.march(up_and_down(*load, 8)) for load in LOADS]


def test_the_full_order_needs_no_correction(known):
    """Its forces are those of its own plastic strain; moduli that vary, heat and strains without stress besides."""
    hot = varied.full()
    for correction, history in ((known[0], known[2][0]), (force_correction(hot), hot.march(varied.path(7.0, 210e3)))):
        largest = max(np.linalg.norm(answer.forces()) for answer in history.answers)
        found = correction.of(history)
        assert largest > 0 and len(found) == len(history.answers)
        assert max(item.error for item in found) < 1e-4 * largest  # steps are solved to 1e-5 of their forces


@pytest.mark.parametrize("method", ["condensed flow", "HHR"])
def test_it_ranks_errors_of_forces_and_lessens_them(cantilever, known, method):
    """Where the misfit of the stress says little: rank correlations of 0.2 and 0.8 with the same errors."""
    correction, training, histories = known
    if method == "HHR":
        model = hhr.build(cantilever, hhr.SnapshotSet.of_histories(training), hhr.Recipe.flowing().as_it_is())
    else:
        model = condensing.condensed(cantilever, training, attempts=1, trust=None)
    rows = []
    for exact in histories:
        found = model.march(exact.path, QUIET)
        for here, there, better in zip(found.answers, exact.answers, correction.of(found), strict=True):
            if there.forces().any():
                wrong, left = (np.linalg.norm(item - there.forces()) for item in (here.forces(), better.forces))
                rows.append((better.error, wrong, left))
                assert better.error == pytest.approx(np.linalg.norm(better.forces - here.forces()))
    indicator, wrong, left = np.array(rows).T
    assert len(rows) > 50 and spearmanr(indicator, wrong).statistic > 0.85
    assert np.median(left) < 0.5 * np.median(wrong)
    assert 0.5 < np.median(indicator / wrong) < 1.5


def test_it_can_be_copied_and_says_its_size(known):
    correction, _, histories = known
    before = correction.of(histories[1])
    again = pickle.loads(pickle.dumps(correction))
    assert again.nbytes == correction.nbytes > 0
    for one, other in zip(before, again.of(histories[1]), strict=True):
        assert other.error == one.error and np.array_equal(other.forces, one.forces)


def test_what_it_is_not_for(known):
    correction, training, _ = known
    with pytest.raises(ReductionError, match="give histories of the scene"):
        correction.of(condensing.tubes()[1][0])
    elastic = hhr.FullOrderModel(condensing.walled_tube(None))
    with pytest.raises(ReductionError, match="nothing flows"):
        Training(elastic, hhr.SnapshotSet.of_histories(training), None, None).force_correction()
