"""Functions in the calling convention of dolfinx-external-operator as laws, beside laws in UFL."""

from dataclasses import replace

import numpy as np
import outside_laws as outside
import pytest
from condensing import FINE, QUIET, TIGHT, apart, condensed, cycle, up, walled_tube
from mpi4py import MPI
from needs import needs
from sheared_blocks import FIRST, PATH, SECOND, rubbing

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ConvergenceError, NotOfferedError, SceneError
from hhr_dolfinx.plugins.inelastic.update import Group, Material

ELASTIC = {"young": 200.0, "poisson": 0.3}
CALLS = []


def return_mapping(deps, sigma_n, p):
    """As in the tutorial: arrays (cells, points, 4) and (cells, points) to three flat ones."""
    cells, points, size = deps.shape
    assert sigma_n.shape == deps.shape and p.shape == (cells, points) and size == 4
    given = {"yield_stress": outside.YIELD, "hardening": outside.SLOPE, **ELASTIC}
    tangents, sigma, dp = outside.von_mises(deps, sigma_n, p, **given)
    deps[:] = sigma_n[:] = p[:] = np.nan  # arguments are its own
    return tangents.reshape(-1), sigma.reshape(-1), dp.reshape(-1)


def sigma_external(derivatives):
    CALLS.append(derivatives)
    if derivatives == (1, 0, 0):
        return return_mapping
    raise NotImplementedError(
        f"No external function is defined for the requested derivative {derivatives}."
    )


def with_constants(derivatives):
    assert derivatives == (1, 0, 0, 0, 0, 0, 0)

    def mapped(deps, sigma_n, p, young, poisson, strength, slope):
        assert strength.shape == slope.shape == young.shape == p.shape == (len(deps), 1)
        given = {"young": young, "poisson": poisson, "yield_stress": strength, "hardening": slope}
        tangents, sigma, dp = outside.von_mises(deps, sigma_n, p, **given)
        return tangents, sigma, p + dp

    return mapped


NAMED = {
    "operands": ("increment", "stress", "cumulated", "young", "poisson", "strength", "slope"),
    "results": ("tangents", "stress", "cumulated"),
}


def relaxing(derivatives):
    """Maxwell's body by its whole strain: a viscous strain that is remembered, and a count of
    steps.
    """
    assert derivatives == (1, 0, 0, 0)

    def mapped(strain, viscous, steps, dt):
        elastic, _, _ = outside.von_mises(
            np.zeros(4), np.zeros(4), np.zeros(()), **ELASTIC, yield_stress=np.inf, hardening=0.0
        )
        dev = np.diag([1.0] * 4)
        dev[:3, :3] -= 1 / 3
        share = dt / (1 + dt)
        change = share[..., None] * ((strain - viscous) @ dev)
        tangents = elastic - share[..., None, None] * (elastic @ dev)
        return tangents, (strain - viscous - change) @ elastic, change, 1 + steps

    return mapped


RELAXING = {
    "operands": ("strain", "viscous", "steps", "dt"),
    "results": ("tangents", "stress", "+viscous", "steps"),
    "memory": {"viscous": 0, "steps": 1},
}


def test_histories_are_those_of_the_law_in_ufl_and_what_holds_no_code_refuses(tmp_path):
    law = hhr.ExternalOperator(sigma_external)
    made = outside.check_histories(law)
    outside.check_refused(*made, law, tmp_path)
    assert set(CALLS) == {(1, 0, 0)} and not made[0].equilibrium.material.rated


def test_derivatives_of_condensed_histories_are_those_of_the_law_in_ufl():
    """Central differences of code beside exact slopes of a program: 1e-5 of the box, so 1e-6.

    A kink is refused.
    """
    full, histories, _ = outside.reference()
    exact = condensed(full, histories)
    model = outside.other_law(exact, hhr.ExternalOperator(sigma_external))
    settings = replace(FINE, gradient=True)
    path = [(time, 0.99 * point) for time, point in up(0.9, steps=6)]
    histories = [item.march(path, settings).answers for item in (model, exact)]
    assert histories[1][-1].plastic_strain().any()
    for name in ("multipliers", "unknown"):
        found, expected = (
            np.array([getattr(answer.gradient, name) for answer in answers])
            for answers in histories
        )
        assert np.abs(expected[-1]).max() > 1e-3
        np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())
    with pytest.raises(
        NotOfferedError, match=r"sigma_external is code, whose derivatives are differences, .* kink"
    ):
        model.march(cycle(0.7), settings)  # loaded again to the same load


@needs("friction")
def test_code_beside_friction():
    """Condensed histories of friction are those of the law in UFL, with sliding and plastic strain:
    steps of 1e-10.
    """
    law = hhr.Plasticity(0.06, 0.5)
    bodies = hhr.Body(FIRST, 3.0, 0.3), hhr.Body(SECOND, 5.0, 0.2, law)
    full = hhr.FullOrderModel(rubbing(0.3, cells=4, bodies=bodies), MPI.COMM_SELF)
    path = [(float(time), np.array(point)) for time, point in PATH]
    settings = replace(FINE, relative_force=1e-10)
    exact = condensed(full, [full.march(path, TIGHT)], trust=None)
    code = hhr.ExternalOperator(with_constants, {"strength": 0.06, "slope": 0.5}, **NAMED)
    one, other = (item.march(path, settings) for item in (outside.other_law(exact, code), exact))
    assert max(apart(one, other, outside.FIELDS)) < 1e-9
    assert {1, 2} <= {
        status for answer in other.answers for status in answer.slip.statuses.tolist()
    }
    assert other.answers[-1].plastic_strain().max() > 1e-2
    for found, expected in zip(one.answers, other.answers, strict=True):
        np.testing.assert_allclose(
            found.slip.work, expected.slip.work, atol=1e-9 * expected.slip.work.max() + 1e-15
        )


def test_constants_are_operands_and_may_be_formulas_of_parameters_and_places():
    box = {"s": (0.5, 1.5), "H": (1.0, 10.0)}
    formulas = {"strength": "s * (1 - 0.1 * r)", "slope": "H"}
    laws = (
        hhr.Plasticity(*formulas.values()),
        hhr.ExternalOperator(with_constants, formulas, **NAMED),
    )
    fulls = [hhr.FullOrderModel(walled_tube(law, **box)) for law in laws]
    expected, found = (full.march(up(0.9, constants=(1.2, 6.0)), TIGHT) for full in fulls)
    assert (
        max(apart(found, expected, outside.FIELDS)) < 1e-12
        and found.answers[-1].plastic_strain().any()
    )
    numbers = {"strength": outside.YIELD, "slope": outside.SLOPE}
    for components in (4, 6):
        outside.check_points(hhr.ExternalOperator(with_constants, numbers, **NAMED), components)


def test_memory_and_durations():
    """A strain that is held relaxes by 1 / (1 + dt) a step."""
    law = hhr.ExternalOperator(relaxing, **RELAXING).at_points(4)
    material = Material([Group(np.arange(3), 200.0, 0.3, law)], 4)
    assert material.rated
    strain = np.tile([1e-3, -1e-3, 0.0, 2e-3], (3, 1))
    state = material.at_rest()
    for step in range(1, 4):
        found = material.update(strain, state, 0.5, tangent=True)
        state = found.state
        assert np.allclose(found.stress, 200.0 / 1.3 * strain / 1.5**step, rtol=1e-12)
        assert np.allclose(
            np.einsum("nij,nj->ni", found.tangents, strain), 200.0 / 1.3 / 1.5 * strain, rtol=1e-12
        )
        flowed = np.sqrt(2 / 3) * np.linalg.norm(strain[0]) * (1 - 1 / 1.5**step)
        assert np.allclose(state.cumulated, flowed, rtol=1e-12)
        assert np.allclose(state.memory[:, -1], step)


LARGEST = {"increment": 1.0}


def fails(derivatives):
    def mapped(deps, sigma_n, p):
        large = np.abs(deps).max(axis=(1, 2)) > LARGEST["increment"]
        found = return_mapping(deps, sigma_n, p)
        found[1].reshape(-1, 4)[large, 3] = np.inf
        return found

    return mapped


def test_points_without_an_answer_cut_the_step_and_are_named(monkeypatch):
    full = hhr.FullOrderModel(walled_tube(hhr.ExternalOperator(fails)))
    once = [up(0.9)[0], up(0.9)[-1]]
    exact = full.march(once, QUIET).answers[-1]
    monkeypatch.setitem(LARGEST, "increment", 0.5 * np.abs(exact.stress()).max() / 200.0)
    cut = full.march(once, QUIET).answers[-1]
    assert cut.converged and cut.parts > exact.parts == 1
    monkeypatch.setitem(LARGEST, "increment", 1e-7)
    with pytest.raises(
        ConvergenceError, match=r"fails has no answer at \d+ points, such as for the strain \("
    ):
        full.march(once, QUIET)


def test_condensed_steps_are_cut_where_code_has_no_answer(monkeypatch):
    """As full ones are."""
    model = outside.other_law(condensed(*outside.reference()[:2]), hhr.ExternalOperator(fails))
    once = [up(0.9)[0], up(0.9)[-1]]
    exact = model.march(once, QUIET).answers[-1]
    monkeypatch.setitem(LARGEST, "increment", 0.5 * np.abs(exact.state().stress).max() / 200.0)
    cut = model.march(once, QUIET).answers[-1]
    assert cut.converged and cut.parts > exact.parts == 1
    monkeypatch.setitem(LARGEST, "increment", 1e-7)
    with pytest.raises(
        ConvergenceError, match=r"fails has no answer at \d+ points, such as for the strain \("
    ):
        model.march(once, QUIET)


def test_stores_know_source_and_constants(tmp_path):
    law, other = (
        hhr.ExternalOperator(with_constants, {"strength": 1.0, "slope": h}, **NAMED)
        for h in (5.0, 6.0)
    )
    outside.check_store(law, other, tmp_path / "constants")
    outside.check_store(
        hhr.ExternalOperator(sigma_external), hhr.ExternalOperator(fails), tmp_path / "sources"
    )
    one = hhr.ExternalOperator(lambda orders: return_mapping)
    other = hhr.ExternalOperator(lambda orders: None)
    assert one.name == other.name and one.at_points(4).identity != other.at_points(4).identity
    compiled = hhr.ExternalOperator(len)  # has no source
    assert compiled.identity[0] == "len" and compiled.identity[1] == "builtins"


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        ({"operands": ("stress", "increment")}, "begin with strain or increment"),
        ({"operands": ("increment", "temperature")}, r"\['temperature'\] are missing or unknown"),
        ({"results": ("tangents", "+cumulated")}, r"\['stress'\] are missing or unknown"),
        ({"results": ("tangents", "stress", "damage")}, r"\['damage'\] are missing or unknown"),
        ({"memory": {"damage": 1}}, r"\['damage'\] are missing or unknown"),
    ],
)
def test_what_is_no_law_is_refused(wrong, why):
    with pytest.raises(SceneError, match=why):
        hhr.ExternalOperator(sigma_external, **wrong)


def test_a_function_that_returns_something_else_is_refused():
    law = hhr.ExternalOperator(lambda orders: lambda *given: return_mapping(*given)[:2])
    with pytest.raises(SceneError, match=r"<lambda> does not return its results \('tangents'"):
        hhr.FullOrderModel(walled_tube(law)).march(up(0.9), TIGHT)


@pytest.mark.parametrize(
    ("found", "given"),
    [
        (lambda *_: None, {}),
        (lambda *_: ("a", "b", "c"), {}),
        (lambda e, *_: (e, e, e), {}),
        (None, {"constants": {"cumulated": 1.0}}),
        (None, {"constants": {"dt": 1.0}}),
        (None, {"operands": ()}),
        (None, {"memory": {"stress": 1}}),
        (None, {"results": ("+tangents", "stress")}),
    ],
)
def test_results_and_names_that_cannot_be_are_refused(found, given):
    """By words at the door, and not by an exception of arrays, or by a constant that replaces a
    variable.
    """
    with pytest.raises(SceneError):
        law = hhr.ExternalOperator(lambda orders: found, **given)
        assert not given
        hhr.FullOrderModel(walled_tube(law)).march(up(0.9), TIGHT)
