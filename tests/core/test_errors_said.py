"""What answers say of their errors holds in the norms that users read: nodal forces and pressures,
beside energies.
"""

import copy
import dataclasses
import logging

import contract
import numpy as np
import pellet_materials as materials_demo
import pytest
from local_models_by_hand import pellet_training
from mpi4py import MPI
from needs import needs, present
from scenes import pressed_block

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import BoundError, ParameterError, StabilityWarning
from hhr_dolfinx.models.estimates import (
    ESTIMATE_NUMBERS,
    STRESS_INDICATOR,
    Estimate,
    Estimates,
    relative_error,
)

POOR = hhr.Recipe().as_it_is()
OUTPUTS = (hhr.LargestPressure("peak", 0, unit="MPa"), hhr.ContactWidth("area", 0))


@pytest.fixture(scope="module")
def pellet():
    return pellet_training((8, 6), OUTPUTS)


@pytest.fixture(scope="module")
def reduced(pellet):
    return pellet.build(checked=False)


@pytest.fixture(scope="module")
def materials():
    scene = materials_demo.scene(radial_cells=8, axial_cells=10, cladding_radial_cells=2)
    return hhr.train(scene, hhr.Sobol(48), held_out=0, comm=MPI.COMM_SELF)


@pytest.fixture(scope="module")
def condensed(materials):
    return materials.condense()


def compared(full, model, points):
    """Errors of forces and of pressures, sizes of the exact ones, bounds and relative bounds, (2,
    n) each.
    """
    rows = []
    for point in points:
        exact, answer = full.solve(point).forces(), model.solve(point, outside="ignore")
        areas = full.problem.at(point).contact_areas
        off, said = answer.forces() - exact, answer.estimate()
        errors = np.linalg.norm(off), np.abs(off / areas).max()
        sizes = np.linalg.norm(exact), (exact / areas).max()
        relative = said.forces_euclid_relative, said.pressure_relative
        rows.append([errors, sizes, (said.forces_euclid, said.pressure), relative])
    return np.array(rows).transpose(1, 2, 0)


def check(full, model, points, most):
    """No error exceeds what is said; the median of said over true, where there is an error, is
    below ``most``.
    """
    errors, sizes, bounds, relative = compared(full, model, points)
    least = model.fields.bound.least[1:, None]
    assert (errors <= bounds).all()
    assert (errors / np.maximum(sizes, least) <= relative * (1 + 1e-12)).all()
    off = errors > 1e-10 * sizes
    assert off.mean() > 0.9
    for bound, error, row in zip(bounds, errors, off, strict=True):
        assert np.median(bound[row] / error[row]) < most
    return errors / sizes


@needs("moduli")
def test_six_parameters(materials, condensed):
    """S is interpolated to 1e-9, proved.

    Medians measured: HHR 1.001, 1.001; condensed to 1e-5 1.2, 3.1.
    """
    from hhr_dolfinx.plugins.moduli.interpolate import GridSettings

    full = materials.full_order
    model = materials.build(materials_demo.RECIPE, checked=False)
    points = full.parameters.random(40, 1)
    assert condensed.fields.bound.proved
    check(full, model, points, 1.1)
    coarse = materials.condense(GridSettings())
    check(full, coarse, points, 4.0)
    # answers are by what the bound interpolates unless they are to be coarse: 1e-7 and 1e-12 of
    # them measured
    errors = compared(full, coarse, points)[0]
    finer, _, bounds, _ = compared(full, condensed, points)
    assert (finer <= bounds).all()
    assert (finer.max(axis=1) < 1e-3 * errors.max(axis=1)).all()


@needs("exact_errors")
def test_many_estimates_are_those_of_each(reduced):
    """Two ways to the same forces, to round-off of these; a copy knows bounds of outputs too."""
    points = reduced.parameters.random(20, seed=2)
    many = reduced.solve_many(points, outside="ignore")
    for known in (many.estimates(), copy.deepcopy(many.estimates())):
        for k, point in enumerate(points):
            assert known[k].outputs and dict(known[k].outputs) == dict(many[k].estimate().outputs)
            alone = reduced.solve(point, outside="ignore").estimate()
            least = 1e-9 * max(getattr(alone, name) for name in ESTIMATE_NUMBERS)
            for name in ESTIMATE_NUMBERS:
                # of displacements 1e-9 of their energies is left, known to the round-off of these:
                # 2e-6 were measured
                part = 1e-5 if name.startswith("primal") else 1e-6
                assert getattr(known[k], name) == pytest.approx(
                    getattr(alone, name), rel=part, abs=least
                ), name


def test_an_exact_model_has_no_error_of_an_output(pellet):
    """Without bounds that could say how large the output is at least."""
    model = hhr.condense(pellet.full_order)
    answer = model.solve(model.parameters.middle)
    for item in model.fields.functionals.items:
        assert relative_error(answer, answer.estimate(), item.name) == 0.0


def test_elastic_histories_have_no_time_error(reduced):
    middle = reduced.parameters.middle
    assert reduced.march([(0.0, middle), (1.0, 1.01 * middle)]).time_error.tolist() == [0.0]


def test_estimates_of_parts_are_put_in_order():
    one = Estimates("bound", *np.arange(16.0).reshape(8, 2))
    both = Estimates.joined([(np.array([2, 0]), one), (np.array([1]), None)], 3)
    assert both.kind == "bound" and np.isnan(both.pressure).tolist() == [False, True, False]
    assert both[2] == one[0] and both[0] == one[1]
    assert Estimates.joined([(np.array([0]), None)], 1) is None
    # an indicator of the stress is silent on forces, and has no number for them
    assert np.isinf(Estimate.indicated(0.5, STRESS_INDICATOR).forces_euclid_relative)
    single = Estimates.of([None, Estimate.indicated(0.5)])
    assert (
        single.kind == "indicator"
        and single[1] == Estimate.indicated(0.5)
        and np.isinf(single.pressure[1])
    )


@needs("local_models", "exact_errors")
def test_local_models_measure_by_the_same_sizes(pellet, reduced):
    """Each is trained on a part, and the largest forces of all parts count."""
    local, points = (
        pellet.local(hhr.Clusters(2), checked=False),
        pellet.full_order.parameters.random(30, 6),
    )
    for model in local.models:
        assert model.fields.bound.least == pytest.approx(reduced.fields.bound.least, rel=1e-12)
    said, full = local.solve_many(points, outside="ignore").estimates(), pellet.full_order
    off = [
        local.solve(point, outside="ignore").forces() - full.solve(point).forces()
        for point in points
    ]
    assert (np.linalg.norm(off, axis=1) <= said.forces_euclid).all()
    assert (np.abs(off / full.problem.contact_areas).max(axis=1) <= said.pressure).all()
    assert local.known_error == reduced.known_error


@needs("exact_errors")
def test_a_point_without_contact_is_not_infinitely_wrong():
    """No force is exact and predicted.

    An imposed motion moves a block rigidly: what cancels its lift has round-off.
    """
    full = hhr.FullOrderModel(pressed_block("plane_strain", cells=6))
    snapshots = hhr.compute_snapshots(full, np.linspace(0.001, 0.1, 12)[:, None])
    model, stiffness = hhr.build(full, snapshots, POOR), full.problem.stiffness
    words = ("forces", "pressure") if present("fallback") else ()
    safe = [hhr.FallbackModel(model, full, 0.01, of=of) for of in words]
    for push in np.linspace(0.001, 0.0099, 100):
        answer = model.solve(push)
        said, moved = answer.estimate(), answer.displacement() - full.solve(push).displacement()
        assert np.sqrt(max(moved @ (stiffness @ moved), 0.0)) <= said.primal
        # round-off of 1e-10 over a thousandth of the largest forces
        assert max(said.dual_relative, said.forces_euclid_relative, said.pressure_relative) < 1e-5
        assert not any(item.fell_back(item.solve(push)) for item in safe)


@needs("fallback", "exact_errors")
def test_safe_models_keep_the_error_that_is_asked_for(pellet):
    """Of sixteen snapshots, with 0.05 allowed.

    Those of energies hand out nodal forces and pressures that are worse.
    """
    full, few = pellet.full_order, pellet.snapshots.take(slice(None, None, 3))
    poor, points = hhr.build(full, few, POOR), full.parameters.random(60, 5)
    areas, stiffness = full.problem.contact_areas, full.problem.stiffness
    measured = {
        "forces": (lambda answer: answer.forces(), np.linalg.norm),
        "pressure": (lambda answer: answer.forces() / areas, lambda values: np.abs(values).max()),
        "displacement": (
            lambda answer: answer.displacement(),
            lambda field: np.sqrt(field @ (stiffness @ field)),
        ),
        "peak": (lambda answer: answer.outputs()["peak"], abs),
        "area": (lambda answer: answer.outputs()["area"], abs),
    }
    fallen = {}
    for of, (value, size) in measured.items():
        safe = hhr.FallbackModel(poor, full, 0.05, of=of)
        for point in points:
            found, exact = value(safe.solve(point)), value(full.solve(point))
            assert size(found - exact) <= 0.05 * size(exact)
        fallen[of] = safe.share
        assert of in safe.known_error and "0.05" in safe.known_error
    assert 0 < fallen["forces"] < fallen["pressure"] < 1 and 0 < fallen["peak"] < fallen["pressure"]


@needs("fallback", "moduli")
def test_words_that_are_no_error(pellet, reduced, materials):
    with pytest.raises(
        ParameterError,
        match=r"'energy' is no error .* 'forces', 'pressure', 'displacement', 'peak'",
    ):
        pellet.safe_model(of="energy")
    for word in (3, "", True):
        with pytest.raises(ParameterError, match="is no error"):
            hhr.FallbackModel(reduced, pellet.full_order, of=word)
    scene = dataclasses.replace(materials.full_order.scene, outputs=OUTPUTS)
    training = hhr.train(scene, hhr.Sobol(16), held_out=0, comm=MPI.COMM_SELF)
    with pytest.raises(
        ParameterError, match="output 'peak': outputs have one only where the stiffness"
    ):
        training.safe_model(of="peak", checked=False)


@needs("moduli")
def test_models_say_which_errors_they_know(pellet, reduced, condensed, caplog):
    proved = (
        "bound, proved: the displacement in energy; nodal contact forces, Euclidean and in "
        "energy; pressures"
    )
    assert reduced.known_error == f"{proved}; outputs peak, area"
    assert condensed.known_error == proved
    assert pellet.full_order.known_error == "exact: the full model has no reduction error"
    exact = hhr.exact_condensation(pellet.full_order, pellet.snapshots.known_statuses())
    assert exact.known_error == "exact: exact condensation has no reduction error"
    with caplog.at_level(logging.INFO, logger="hhr_dolfinx"):
        without = hhr.build(
            pellet.full_order, pellet.snapshots, dataclasses.replace(POOR, bound=False)
        )
    assert (
        without.known_error == "none: the recipe asks for none"
        and without.known_error in caplog.text
    )


@needs("fallback", "floating", "moduli")
@pytest.mark.filterwarnings("ignore:.*no contact resists and no load drives")
def test_a_body_that_contact_holds_is_named_by_all_that_is_made_of_it(tmp_path, caplog):
    """Where its modulus is a parameter too; of a constant stiffness there is a bound."""
    training = contract.training("floating moduli")
    assert (
        contract.training("floating").build(checked=False).known_error.startswith("bound, proved")
    )
    with caplog.at_level(logging.INFO, logger="hhr_dolfinx"):
        model = training.build(checked=False)
    loose = training.full_order.problem.kernel.described
    assert (
        loose
        and model.known_error.startswith("none: contact alone holds bodies")
        and loose in model.known_error
    )
    assert model.known_error in caplog.text
    hhr.save_model(tmp_path / "model.npz", model)
    assert hhr.load_model(tmp_path / "model.npz").known_error == model.known_error
    with pytest.raises(BoundError, match="contact alone holds bodies"):
        hhr.FallbackModel(model, training.full_order)


@needs("moduli")
def test_condensed_models_are_not_told_of_layers(materials):
    """Few answers hardly span displacements, and forces are right all the same: there is no RID to
    add layers to.
    """
    held_out = hhr.compute_snapshots(
        materials.full_order, materials.full_order.parameters.random(20, 9)
    )
    few = dataclasses.replace(
        materials, snapshots=materials.snapshots.take(np.arange(24)), held_out=held_out
    )
    with pytest.warns(StabilityWarning, match="displacement error") as caught:
        few.condense()
    told = " ".join(str(item.message) for item in caught)
    assert "RID" not in told and "train on more points" in told and "contact force" not in told
