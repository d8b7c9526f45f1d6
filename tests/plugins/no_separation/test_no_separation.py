"""Contact without separation: closed forms of a block, projections as a reference, decks."""

import dataclasses

import numpy as np
import pytest
from mpi4py import MPI
from needs import needs
from projected_forces import projected
from scenes import lying, pressed_block, space
from stacked_pairs import PATH, stacked

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import contact_residuals

pytestmark = [needs("no_separation")]
BLOCK = 3.0 / (1 - 0.3**2) / 2
"""Pressure of the block of height 2 in plane strain over its shortening."""
GAP = 0.01


def held_block(**changes):
    """The block whose pressure is uniform, above a floor from which it does not separate."""
    scene = pressed_block("plane_strain")
    floor = dataclasses.replace(scene.contacts[0], law=hhr.NoSeparation())
    outputs = hhr.ContactForce("force", 0, (0.0, 1.0)), hhr.GapAt("gap", 0, (0.5, 0.0))
    given = {"contacts": (floor,), "outputs": outputs, "parameters": space(push=(-0.1, 0.1))}
    return dataclasses.replace(scene, **given | changes)


def test_a_block_is_pulled_once_it_has_pressed(tmp_path):
    """Before it touches nothing holds it; then its pressure has both signs, to round-off."""
    full = hhr.FullOrderModel(held_block(), MPI.COMM_SELF)
    model = hhr.condense(full)
    hhr.save_model(tmp_path / "model.npz", model)
    pushes = (0.0, -0.02, 0.008, 0.05, 0.03, -0.04, 0.012)
    path = [(float(k), (push,)) for k, push in enumerate(pushes)]
    for each in (full, model, hhr.load_model(tmp_path / "model.npz")):
        for push, answer in zip(pushes[1:], each.march(path).answers, strict=True):
            touched = pushes.index(push) >= pushes.index(0.05)
            pressure = BLOCK * (push - GAP) if touched else 0.0
            found = answer.outputs()
            assert found["force"] == pytest.approx(1.5 * pressure, rel=1e-10, abs=1e-13)
            assert found["gap"] == pytest.approx(0.0 if touched else GAP - push, abs=1e-12)


def test_what_pulls_is_no_fault_of_an_answer():
    """Residuals name tension of contacts that may not pull alone."""
    full = hhr.FullOrderModel(held_block(), MPI.COMM_SELF)
    path = [(0.0, (0.0,)), (1.0, (0.05,)), (2.0, (-0.04,))]
    answer = full.march(path).answers[-1]
    assert answer.multipliers.min() < 0
    at = full.problem.at(answer.parameter)
    found = contact_residuals(
        at, answer.displacement(), answer.multipliers, at.amplitudes(answer.parameter)
    )
    assert found.sign == 0 and found.penetration < 1e-12 and found.equilibrium < 1e-10


@pytest.mark.parametrize("friction", [None, pytest.param(0.3, marks=needs("friction"))])
def test_forces_are_those_of_projections(friction):
    """Two blocks that are pressed, turned and pulled, with friction over it: no Newton method."""
    box = hhr.ParameterSpace(("push", "slide"), (-0.3, -0.2), (0.3, 0.2))
    path = [*PATH, (5.0, (-0.03, 0.02)), (6.0, (0.01, 0.0))]
    scene = stacked(parameters=box)
    pair = dataclasses.replace(scene.contacts[0], friction=friction, law=hhr.NoSeparation())
    scene = dataclasses.replace(scene, contacts=(pair, *scene.contacts[1:]))
    model = hhr.condense(scene)
    schur = model.eliminated.responses.schur
    held_rows = np.arange(5) if friction is None else friction_rows(model).normal
    slipping = np.zeros(0, dtype=int) if friction is None else friction_rows(model).tangential
    held = np.zeros(held_rows.size, dtype=bool)
    position = np.zeros(slipping.size)
    forces = None
    contact_at = model.contacts()
    for (_, point), answer in zip(path[1:], model.march(path).answers, strict=True):
        free = contact_at(np.array(point)).free_slack.copy()
        free[slipping] -= position

        def projection(y, c, held=held):
            found = np.maximum(y, 0.0)
            found[held_rows[held]] = y[held_rows[held]]
            bound = 0.3 * np.maximum(found[held_rows], 0.0) if slipping.size else 0.0
            found[slipping] = np.clip(y[slipping], -bound, bound)
            return found

        forces, _ = projected(schur, free, projection, forces)
        np.testing.assert_allclose(
            answer.multipliers, forces, rtol=0, atol=1e-9 * np.abs(forces).max()
        )
        slack = free + schur @ forces
        if slipping.size:
            bound = 0.3 * np.maximum(forces[held_rows], 0.0)
            slips = np.abs(forces[slipping]) >= bound * (1.0 - 1e-9)
            position = position + np.where(slips, slack[slipping], 0.0)
        held = held | (forces[held_rows] > 0)
    assert held.any() and forces is not None


def friction_rows(model):
    """Friction of the conditions, by their numbers among all."""
    return model.law.of("friction")


def test_round_off_is_no_pressure():
    """Blocks that only touch, slid aside and pulled apart, are not held."""
    box = hhr.ParameterSpace(("push", "slide"), (-0.3, -0.2), (0.3, 0.2))
    full = hhr.FullOrderModel(stacked(hhr.NoSeparation(), parameters=box), MPI.COMM_SELF)
    for model in (full, hhr.condense(full)):
        for seed in range(5):
            aside = np.random.default_rng(seed).uniform(-0.1, 0.1, 3)
            path = [(0.0, (0.0, 0.0)), *((k + 1.0, (0.0, way)) for k, way in enumerate(aside))]
            touching = model.march(path).answers[-1]
            held = touching.memory["held"] > 0
            between = touching.multipliers[: held.size]
            assert (np.abs(between[~held]) < 1e-12).all()
            pulled = model.march([*path, (9.0, (-0.02, aside[-1]))]).answers[-1]
            assert not pulled.multipliers[: held.size][~held].any()


@needs("floating")
@pytest.mark.filterwarnings("ignore:body 2 .* moves along axis 0")
def test_a_free_body_is_loaded_unloaded_and_lifted():
    """Forces bear the load, of both signs, and none."""
    scene = lying(bulge=0.0, parameters=space(p=(-10.0, 10.0)))
    pair = dataclasses.replace(scene.contacts[0], law=hhr.NoSeparation())
    full = hhr.FullOrderModel(dataclasses.replace(scene, contacts=(pair,)), MPI.COMM_SELF)
    width = np.ptp(full.problem.contact_points[:, 0])
    loads = (0.0, 5.0, 0.0, 5.0, -5.0)
    path = [(float(k), (load,)) for k, load in enumerate(loads)]
    for model in (full, hhr.condense(full)):
        for load, answer in zip(loads[1:], model.march(path).answers, strict=True):
            assert answer.forces().sum() == pytest.approx(load * width, rel=1e-9, abs=1e-10)


@needs("conformance")
def test_it_keeps_the_contract_of_contact_laws():
    """Full, condensed, files, cuts, hyper-reduced and compiled, on blocks of other sizes."""
    from hhr_dolfinx.testing import check_contact_law

    check_contact_law(hhr.NoSeparation())


def test_derivatives_are_those_of_differences():
    """Of a path that pulls in the end."""
    model = hhr.condense(held_block())
    pushes = np.array([0.0, 0.05, -0.03])

    def last(moved, gradient=False):
        path = [(float(k), (push + moved,)) for k, push in enumerate(pushes)]
        return model.march(path, hhr.MarchSettings(gradient=gradient)).answers[-1]

    found = last(0.0, gradient=True).gradient
    expected = (last(1e-6).multipliers - last(-1e-6).multipliers) / 2e-6
    assert found.multipliers[:, 0] == pytest.approx(expected, rel=1e-7)
    assert not found.one_sided
