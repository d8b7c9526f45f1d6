"""Files of a user's own: an elimination, a way to reduce, a kind of output; no file of the package changes."""

import dataclasses
import pickle

import numpy as np
import pytest
from needs import present
from scenes import pressed_pair
from toy_functional import SmoothPeak
from toy_reductor import DenseCondensation

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ReductionError

OUTPUTS = (hhr.LargestPressure("peak", 0, unit="MPa"), SmoothPeak("smooth", 0))


@pytest.fixture(scope="module")
def training():
    scene = pressed_pair("plane_strain", ((2.0, 0.3), (5.0, 0.3)), {}, cells=3)
    return hhr.train(dataclasses.replace(scene, outputs=OUTPUTS), hhr.Sobol(16), held_out=5)


@pytest.fixture(scope="module")
def model(training):
    return training.build(DenseCondensation())


def test_it_answers_as_the_full_order_does(training, model):
    """Many at once, along a path and copied; one by one, with derivatives and from a file it does by check_reductor."""
    points = training.full_order.parameters.random(6, 3)
    exact = np.array([training.full_order.solve(point).forces() for point in points])
    for one in (model, pickle.loads(pickle.dumps(model))):
        along = one.march([(float(k), point) for k, point in enumerate(points)]).answers
        for found, known in ((one.solve_many(points).forces(), exact), ([a.forces() for a in along], exact[1:])):
            assert (np.abs(found - known).max(axis=1) <= 1e-9 * known.max(axis=1)).all()


def test_a_reductor_refuses_in_its_own_words_and_others_are_told(training):
    with pytest.raises(ValueError, match="are more than 3"):
        training.build(DenseCondensation(most=3))
    with pytest.raises(ReductionError, match="is no recipe"):
        training.build("condensation")
    if present("moduli"):
        from hhr_dolfinx.plugins.moduli.condense import Condensation

        with pytest.raises(ReductionError, match="does not depend on parameters"):
            training.build(Condensation())


class Returning:
    """A way to reduce that returns whatever it is given."""

    def __init__(self, made):
        self.made = made

    def reduced(self, full, snapshots, held_out):
        return self.made


def test_what_a_way_to_reduce_may_return(training, model):
    """Models of the same scene, and nothing else; the class alone is no way to reduce."""
    assert training.build(Returning(model)) is model
    other = hhr.FullOrderModel(pressed_pair("plane_strain", ((2.0, 0.3), (5.0, 0.3)), {}, cells=4))
    for made, why in ((None, "must return a model"), ("model", "must return a model"), (other, "of the same scene")):
        with pytest.raises(ReductionError, match=why):
            training.build(Returning(made))
    with pytest.raises(ReductionError, match="DenseCondensation is a class, give a value of it"):
        training.build(DenseCondensation)
