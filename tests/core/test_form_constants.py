"""Numbers of materials are constants of forms: a new number takes no compilation, which lasts seconds."""

import ffcx.codegeneration.jit
import numpy as np
import pytest
from needs import needs
from scenes import largest_difference, pressed_pair

import hhr_dolfinx as hhr


@pytest.fixture
def none_compiled(monkeypatch):
    """Raise where a form is compiled that is in no cache."""

    def forbidden(*args, **others):
        raise AssertionError("a form was compiled")

    return lambda: monkeypatch.setattr(ffcx.codegeneration.jit, "_compile_objects", forbidden)


@needs("checks")
@pytest.mark.parametrize("hypothesis", ["plane_strain", "plane_stress", "axisymmetric", "solid"])
def test_new_moduli_compile_nothing(hypothesis, none_compiled):
    """Build, stress and error of the mesh; twice the moduli have twice the stiffness and the stress of a field."""
    rng = np.random.default_rng()
    young, poisson = rng.uniform(1.0, 2.0, 2), rng.uniform(0.2, 0.4, 2)

    def built(factor, ratios):
        bodies = [(float(factor * e), float(nu)) for e, nu in zip(young, ratios, strict=True)]
        full = hhr.FullOrderModel(pressed_pair(hypothesis, bodies, cells=2))
        answer = full.solve(full.parameters.middle)
        displacement = np.sin(np.arange(full.problem.free.size))  # one that does not depend on the moduli
        assert 0 < hhr.mesh_error(full, answer).energy < 1
        return full.problem.stiffness.toarray(), full.stress_of(displacement, answer.parameter)

    built(1.0, poisson)
    none_compiled()
    once, twice = built(1.0, 0.9 * poisson), built(2.0, 0.9 * poisson)
    for one, other in zip(once, twice, strict=True):
        assert largest_difference(other, 2 * one) <= 1e-14  # products of numbers in another order


@needs("checks")
def test_new_parameters_compile_nothing(none_compiled):
    """The error of the mesh at other parameters of a formula; it scales with no modulus."""
    scene = pressed_pair("plane_strain", (("E", "0.25 + 0.05 * E"), (2.0, 0.25)), {"E": (0.5, 2.0)}, cells=2)
    full = hhr.FullOrderModel(scene)
    points = full.parameters.random(2, 1)
    hhr.mesh_error(full, full.solve(points[0]))
    none_compiled()
    assert 0 < hhr.mesh_error(full, full.solve(points[1])).energy < 1


def test_constants_of_a_form_are_the_numbers():
    """K of a body with numbers is that of the same body with formulas, which is assembled by parts; round-off."""
    bodies = (1.7, 0.31), (2.0, 0.25)
    numbers = hhr.FullOrderModel(pressed_pair("plane_stress", bodies, cells=2))
    formulas = hhr.FullOrderModel(pressed_pair("plane_stress", (("E", 0.31), bodies[1]), {"E": (1.0, 3.0)}, cells=2))
    point = formulas.parameters.middle
    point[formulas.parameters.names.index("E")] = 1.7
    exact = formulas.problem.at(point).stiffness
    assert largest_difference(numbers.problem.stiffness.toarray(), exact.toarray()) <= 1e-13
