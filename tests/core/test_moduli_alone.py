"""Moduli that are parameters in the core alone: K~ is factored at each point, and what it lacks is refused by name."""

import numpy as np
import pytest
from needs import needs
from scenes import largest_difference, pressed_pair

import hhr_dolfinx as hhr
from hhr_dolfinx import registry
from hhr_dolfinx.errors import ModelFileError, NoBoundWarning, NotOfferedError
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.models.eliminations.block import BlockElimination

MATERIALS = {"E1": (1.0, 6.0), "nu1": (0.1, 0.42)}
BODIES = ("E1", "nu1"), (4.0, 0.3)


def scene():
    return pressed_pair("plane_strain", BODIES, MATERIALS, cells=4)


class Shape:
    """A shape that nobody reads."""

    tag = two_blocks.SECOND
    coordinates = "x * (1 + wide)", "y"
    variables = {"x", "y", "wide"}  # noqa: RUF012

    def check(self, parameters, hypothesis):
        """It suits every scene."""

    def moved(self, points, names, values):
        return points


@pytest.fixture(scope="module")
def training():
    return hhr.train(scene(), hhr.Sobol(32), held_out=8)


@pytest.fixture
def alone(monkeypatch):
    """No plug-in is installed."""
    monkeypatch.setattr(registry, "installed", dict)


def test_shapes_are_refused(alone):
    varying = pressed_pair("plane_strain", ((3.0, 0.3), (4.0, 0.3)), {"wide": (0.0, 0.05)}, shapes=(Shape(),))
    with pytest.raises(NotOfferedError, match="whose shapes depend on parameters, needs a plug-in"):
        hhr.FullOrderModel(varying)


def test_condensation_is_refused(alone):
    full = hhr.FullOrderModel(scene())
    with pytest.raises(NotOfferedError, match=r"condenses scene .*, whose stiffness or shape depends on"):
        hhr.condense(full)


def test_training_condenses_neither(alone, training):
    with pytest.raises(NotOfferedError, match="no installed reductor condenses"):
        training.condense()


def test_reduced_models_factor_at_each_point_and_have_no_bound(alone, training, tmp_path):
    """The same basis and RID as with the plug-in, so that answers are off by what the reduction leaves."""
    with pytest.warns(NoBoundWarning, match="no installed plug-in knows"):
        model = training.build()
    assert model.compliances is None and isinstance(model.eliminated.eliminated, BlockElimination)
    assert "depends on parameters" in model.fields.unbounded
    hhr.save_model(tmp_path / "model.npz", model)
    kept = hhr.load_model(tmp_path / "model.npz")
    full = training.full_order
    for point in full.parameters.random(5, seed=1):
        answer, exact = model.solve(point), full.solve(point)
        assert answer.estimate() is None
        assert largest_difference(answer.displacement(), exact.displacement()) < 0.05
        assert np.array_equal(kept.solve(point).forces(), answer.forces())
        gradient = model.solve(point, gradient=True).gradient
        assert np.isfinite(gradient.unknown).all()


@needs("moduli")
def test_interpolated_answers_are_those_of_the_core(training, monkeypatch):
    """1e-5 is the target of the grid of a reduced model; just after a contact closes forces are off by a few of it."""
    interpolated = training.build()
    assert interpolated.compliances is not None
    with monkeypatch.context() as patch, pytest.warns(NoBoundWarning):
        patch.setattr(registry, "installed", dict)
        factored = training.build()
    for point in training.full_order.parameters.random(5, seed=2):
        one, other = (model.solve(point).unknown for model in (interpolated, factored))
        assert largest_difference(one, other) < 1e-3


@needs("moduli")
def test_a_file_of_the_plug_in_is_refused_without_it(tmp_path, monkeypatch):
    hhr.save_model(tmp_path / "model.npz", hhr.condense(scene()))
    monkeypatch.setattr(registry, "installed", dict)
    with pytest.raises(ModelFileError, match=r"holds a .* which is unknown here: install the plug-in that has it"):
        hhr.load_model(tmp_path / "model.npz")
