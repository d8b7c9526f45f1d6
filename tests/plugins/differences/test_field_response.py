"""The displacement of loads and contact forces: exact where statuses are right, whatever was trained on."""

import numpy as np
import pytest
from test_outputs import small_pellet

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import contact_residuals
from hhr_dolfinx.plugins.differences.offline import field_response, leading


@pytest.fixture(scope="module")
def pellet():
    return hhr.train(small_pellet(), (8, 6), held_out=5)


@pytest.fixture(scope="module", params=[1e-5, 1e-13])
def model(request, pellet):
    """As many modes as contact conditions, 34, of which the poorer one takes more for its RID, and 31."""
    found = pellet.build(hhr.Recipe(hhr.Pod(request.param, relative=True)).as_it_is(), checked=False)
    assert (found.fields.response.onto is None) == (request.param == 1e-5)
    return found


def test_what_is_handed_out_penetrates_nothing(pellet, model):
    """Gaps that the answer says are closed are closed, to what the projection leaves open: 0.8 % in the median."""
    problem = pellet.full_order.problem
    deepest = [
        contact_residuals(problem, answer.displacement(), answer.forces(), problem.theta(point)).penetration
        for point in problem.parameters.random(40, 5)
        for answer in [model.solve(point, outside="ignore")]
    ]
    assert np.median(deepest) < (1e-9 if model.fields.response.onto is None else 0.05)


def test_columns_are_orthonormal_in_energy_and_their_coordinates_those_of_a_projection(pellet):
    full, stiffness = pellet.full_order, pellet.full_order.problem.stiffness
    made = field_response(full, pellet.snapshots.forces, 9)
    assert made.columns.shape[1] == 9 and made.columns.T @ stiffness @ made.columns == pytest.approx(
        np.eye(9), abs=1e-9
    )
    assert made.response.onto == pytest.approx((full.problem.contact @ made.columns).T, abs=1e-9)
    loads = made.response.loaded @ made.response.loading
    assert loads == pytest.approx(full.per_load, abs=1e-10 * np.abs(full.per_load).max())
    # a pressure up to a height has more terms than there are nodes below it
    assert made.response.loaded.shape[1] < np.count_nonzero(full.per_load.any(axis=0))


def test_directions_without_a_training_are_those_along_which_forces_move_most():
    lower = np.diag([1.0, 4.0, 2.0])
    assert np.abs(leading(np.zeros((3, 2)), lower, 2)) == pytest.approx(np.eye(3)[:, [1, 2]])
