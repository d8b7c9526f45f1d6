"""Bodies that contact alone holds: estimates are the differences to the exact answer, and what is far off is said."""

import copy
import dataclasses

import numpy as np
import pytest
from needs import needs
from scenes import slope, space
from test_attack_floating import stack
from test_bounds import check, sizes_of
from test_floating import scene

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.differences import field_response
from hhr_dolfinx.errors import StabilityWarning
from hhr_dolfinx.models.condensed import CondensedModel

pytestmark = pytest.mark.filterwarnings("ignore:.*no contact resists and no load drives")


def leaning(cells=(16, 8), largest=0.5, **changes):
    """A crowned block that a force on its side makes lean to either side."""
    outputs = (hhr.GapAt("gap", 0, (0.0, 1.0)), hhr.ContactForce("force", 0, (0.0, 1.0)))
    box = space(p=(1.0, 10.0), t=(-largest, largest))
    return scene(cells=cells, tilt=slope("t"), parameters=box, outputs=outputs, **changes)


@pytest.fixture(scope="module")
def training():
    return hhr.train(leaning(), hhr.Sobol(12), held_out=5)


@pytest.fixture(scope="module", params=[1e-13, 1e-4, 1e-2])
def model(request, training):
    return training.build(hhr.Recipe(hhr.Pod(request.param, relative=True)).as_it_is(), checked=False)


def balanced_sizes(full):
    """S norm of the part of exact forces that balances itself, in the place of that of all: see :func:`check`."""
    along = np.linalg.qr(full.system.kernel.contact_of_motions)[0]
    return lambda field, forces: (
        sizes_of(full, field, forces) * [1, 0, 1, 1]
        + sizes_of(full, field, forces - along @ (along.T @ forces)) * [0, 1, 0, 0]
    )


def test_estimates_are_the_differences(training, model):
    """100 points of a poor training: forces off by 25 % at worst by the usual basis."""
    full = training.full_order
    parts = check(full, model, full.parameters.random(100, 5), balanced_sizes(full))
    assert (parts[:, 1:].max(axis=0) > 1e-3).all()


def test_few_columns_leave_part_of_the_displacement(training):
    """Fewer than conditions: what they leave out of what forces make is the error of the displacement."""
    full = training.full_order
    made = field_response(full, training.snapshots.forces, 4)
    model = training.build(hhr.Recipe().as_it_is(), checked=False)
    how = {"basis": made.columns, "contact_basis": full.problem.contact_rows_times(made.columns)}
    fields = dataclasses.replace(model.fields, response=made.response, bound=made.bound, output_bound=None, **how)
    parts = check(full, model.changed(fields=fields), full.parameters.random(20, 7), balanced_sizes(full))
    assert np.median(parts[:, 0]) > 1e-3


def test_fields_close_the_gaps_and_move_bodies_as_the_full_model_does(training, model):
    """S and K^-1 loads leave an error of round-off, of the rigid motions too, where forces are off by 15 %."""
    full = training.full_order
    exact_of = [(full.solve(point), model.solve(point, outside="ignore")) for point in full.parameters.random(20, 6)]
    for exact, answer in exact_of:
        field = exact.displacement()
        assert answer.displacement() == pytest.approx(field, abs=1e-8 * np.abs(field).max())
        for again in (copy.deepcopy(model), model):
            assert again.solve(answer.parameter, outside="ignore").estimate() == answer.estimate()


def test_derivatives_of_what_is_read_of_fields_are_differences(model):
    point, step = np.array([6.1, 0.21]), 1e-5
    answer = model.solve(point, outside="ignore", gradient=True)
    for axis in range(2):
        ends = [model.solve(point + way * step * np.eye(2)[axis]).outputs()["gap"] for way in (-1, 1)]
        assert answer.outputs().gradient["gap"][axis] == pytest.approx((ends[1] - ends[0]) / (2 * step), abs=1e-9)


@needs("fallback")
def test_a_safe_model_keeps_its_word(training):
    safe = training.safe_model(0.01, checked=False)
    assert isinstance(safe, CondensedModel)
    for point in training.full_order.parameters.random(20, 9):
        exact = training.full_order.solve(point).forces()
        assert np.linalg.norm(safe.solve(point).forces() - exact) <= 1e-9 * np.linalg.norm(exact)


def test_the_worst_of_many_points_is_warned_of(training):
    """Five solutions held out show nothing; of 200 points some are off by tens of per cent."""
    recipe = hhr.Recipe(hhr.Pod(1e-13, relative=True))
    with pytest.warns(StabilityWarning, match="contact force error.*of [12].. solutions compared; the worst is at"):
        hhr.build(training.full_order, training.snapshots, recipe, training.held_out)


def test_a_stack_of_free_blocks():
    """Two bodies with three motions each, one of them left at rest; few points."""
    made = stack(cells=8, parameters=space(p=(0.1, 1.0), q=(0.0, 1.0)))
    training = hhr.train(made, hhr.Sobol(6), held_out=0)
    full, model = training.full_order, training.build(hhr.Recipe().as_it_is(), checked=False)
    check(full, model, full.parameters.random(60, 1), balanced_sizes(full))
