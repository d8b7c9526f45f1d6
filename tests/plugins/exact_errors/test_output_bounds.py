"""Estimates of outputs are their differences to those of the exact answer."""

import numpy as np
import pytest
from needs import needs
from pellet_outputs import small_pellet
from scenes import pressed_pair
from toy_functional import SmoothPeak

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ParameterError
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.plugins.exact_errors import outputs as output_difference

POOR = hhr.Recipe(cone=True).as_it_is()
"""Forces and displacements of training alone, so that errors are large."""
NEAR = 1e-9
"""Part of the largest value of an output by which an estimate may be off the error."""


def with_outputs(hypothesis):
    """A pair of blocks with outputs of every kind, and one of a user's own."""
    lower, upper = two_blocks.FIRST, two_blocks.SECOND
    outputs = (
        hhr.LargestPressure("peak", 0),
        SmoothPeak("smooth", 0),
        hhr.ContactForce("force", 0, (0.0, 0.0, 1.0) if hypothesis == "solid" else (0.0, 1.0)),
        hhr.ContactWidth("area", 0),
        hhr.VonMises("largest", lower),
        hhr.VonMises("mean", upper, "mean"),
        hhr.ElasticEnergy("energy"),
        hhr.LinearForm("moved", lambda a: a.test[0] * a.dx(lower)),
    )
    return pressed_pair(hypothesis, ((2.0, 0.3), (1.0, 0.2)), cells=3, outputs=outputs)


def check(full, model, points):
    """Estimates are the errors; medians of these over the largest values, by name."""
    found = {}
    for point in points:
        exact, answer = full.solve(point).outputs(), model.solve(point, outside="ignore")
        values, said = answer.outputs(), answer.estimate().outputs
        assert set(said) <= set(values)
        for name, one in said.items():
            found.setdefault(name, []).append(
                [abs(values[name] - exact[name]), one, abs(exact[name])]
            )
    medians = {}
    for name, rows in found.items():
        error, one, size = np.array(rows).T
        assert (error <= one).all() and (one - error <= NEAR * size.max()).all(), name
        medians[name] = np.median(error) / size.max()
    return medians


@pytest.fixture(scope="module")
def pellet():
    return hhr.train(small_pellet(), (8, 6), held_out=5)


def test_outputs_of_the_pellet(pellet):
    full = pellet.full_order
    poor = hhr.build(full, pellet.snapshots.take(slice(None, None, 7)), POOR)
    names = {output.name for output in full.scene.outputs}
    assert full.solve((100.0, 3.0)).estimate().outputs == dict.fromkeys(names, 0.0)
    for model in (pellet.build(checked=False), poor):
        medians = check(full, model, full.parameters.random(60, 0))
        assert set(medians) == names
        # the contact that is lost, and the area under load, jump: they are right at most points
        assert (
            model is not poor
            or min(medians[name] for name in set(medians) - {"area", "lost"}) > 1e-6
        )


@needs("fallback")
def test_outputs_with_too_many_rows_have_none(pellet, monkeypatch):
    """Von Mises' stress of a large body: the exact state is not read there, and that is said."""
    monkeypatch.setattr(output_difference, "MOST_ENTRIES", 400)
    model = hhr.build(pellet.full_order, pellet.snapshots, POOR)
    medians = check(pellet.full_order, model, pellet.full_order.parameters.random(5, 1))
    left_out = [
        output.name for output in pellet.full_order.scene.outputs if output.name not in medians
    ]
    assert {"largest", "mean"} <= set(left_out) and "peak" in medians
    assert model.known_error.endswith(f". No bound of {', '.join(left_out)}")
    with pytest.raises(ParameterError, match="'largest': it reads more"):
        hhr.FallbackModel(model, pellet.full_order, of="largest")


@pytest.mark.parametrize("hypothesis", ["plane_stress", "axisymmetric", "solid"])
def test_outputs_of_pairs_of_blocks(hypothesis):
    """Imposed motions, loads and gaps as parameters.

    Few points of training, so that errors are large.
    """
    full = hhr.FullOrderModel(with_outputs(hypothesis))
    model = hhr.build(full, hhr.compute_snapshots(full, hhr.Sobol(4).points(full.parameters)), POOR)
    medians = check(full, model, full.parameters.random(40, 3))
    assert min(medians[name] for name in ("force", "energy", "moved", "peak", "smooth")) > 1e-6
