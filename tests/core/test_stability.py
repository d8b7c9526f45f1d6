"""Inf-sup constants against their definition, and what the trust check refuses."""

import dataclasses
import math

import hertz_half_discs as demo
import numpy as np
import pytest
from needs import needs
from scenes import THESIS
from scipy import linalg

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.constants import inf_sup, singular_range
from hhr_dolfinx.certify.trust import TrustLimits, check_solvable, check_stability
from hhr_dolfinx.errors import NotSolvableError, StabilityWarning, UnstableModelError


def spd(size, rng):
    root = rng.normal(size=(size, size))
    return root @ root.T + np.eye(size)


def test_inf_sup_is_the_infimum_of_suprema():
    """sup_v q^T R v / |v| = |L^-1 R^T q| for |v|^2 = v^T G v.

    No q gives less, and one gives exactly this.
    """
    rng = np.random.default_rng(0)
    rows, primal, dual = rng.normal(size=(4, 7)), spd(7, rng), spd(4, rng)
    beta = inf_sup(rows, primal, dual)

    def quotient(q):
        return math.sqrt(q @ rows @ np.linalg.solve(primal, rows.T @ q) / (q @ dual @ q))

    assert min(quotient(q) for q in rng.normal(size=(2000, 4))) >= beta
    _, vectors = linalg.eigh(rows @ np.linalg.solve(primal, rows.T), dual)
    assert quotient(vectors[:, 0]) == pytest.approx(beta, rel=1e-10)
    assert inf_sup(np.ones((3, 2))) == 0.0, "more multipliers than modes"


def test_singular_values_of_a_matrix_that_is_not_symmetric():
    matrix = np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 5.0]])
    values = np.linalg.svd(matrix, compute_uv=False)
    assert singular_range(matrix) == pytest.approx((values[-1], values[0]), rel=1e-13)


@needs("theorems")
def test_constants_of_the_half_discs(hertz, hertz_reduction):
    """B is nodal, so kappa(B) = 1 and beta_h = sqrt(2).

    With all its constants positive the model is solvable.
    """
    stability = hertz_reduction.offline.stability
    assert stability.euclidean.beta_h == pytest.approx(math.sqrt(2), rel=1e-12)
    assert stability.sigma_max / stability.sigma_min == pytest.approx(stability.kappa_B)
    # V has orthonormal columns, so the thesis' sigma_min is the constant on the trial space
    assert stability.euclidean.beta_HR_2 == pytest.approx(stability.sigma_min, rel=1e-10)
    for constants in (stability.euclidean, stability.energy):
        # a mode cut off outside A is no longer than the whole mode; in the energy norm it may be
        assert 0 < constants.beta_HR and 0 < constants.alpha_prime
    assert stability.euclidean.beta_HR >= stability.euclidean.beta_HR_2


@needs("theorems")
def test_energy_constant_of_the_full_model(hertz, hertz_reduction):
    """beta_h^2 is the smallest eigenvalue of B K^-1 B^T in the L2 norm of the pressure: checked
    densely.
    """
    problem = hertz.problem
    free = problem.free
    contact = problem.contact[:, free].toarray()
    schur = contact @ np.linalg.solve(problem.stiffness[free][:, free].toarray(), contact.T)
    root = np.sqrt(problem.contact_areas)
    smallest = np.linalg.eigvalsh(root[:, None] * schur * root)[0]
    assert hertz_reduction.offline.stability.energy.beta_h == pytest.approx(
        math.sqrt(smallest), rel=1e-8
    )


@needs("theorems")
def test_energy_constants_do_not_depend_on_units(hertz, hertz_reduction):
    """beta scales with sqrt(1/E) in the energy norm; in the Euclidean norm it does not depend on
    E.
    """
    scene = demo.scene()
    bodies = tuple(dataclasses.replace(body, young=4 * body.young) for body in scene.bodies)
    stiff = hhr.FullOrderModel(dataclasses.replace(scene, bodies=bodies))
    snapshots = hhr.compute_snapshots(stiff, stiff.problem.parameters.grid([31]))
    stability = hhr.build(stiff, snapshots, THESIS.as_it_is()).offline.stability
    assert stability.energy.beta_h == pytest.approx(
        hertz_reduction.offline.stability.energy.beta_h / 2, rel=1e-8
    )
    assert stability.energy.beta_HR == pytest.approx(
        hertz_reduction.offline.stability.energy.beta_HR / 2, rel=1e-6
    )
    assert stability.euclidean.beta_HR == pytest.approx(
        hertz_reduction.offline.stability.euclidean.beta_HR, rel=1e-6
    )


@pytest.mark.parametrize(
    ("name", "value", "ends", "said"),
    [
        ("kappa_B", math.inf, NotSolvableError, r"1\.67"),
        ("kappa_B_2", math.inf, NotSolvableError, ""),
        ("cond_K", 1e9, UnstableModelError, "add RID layers"),
        ("cond_K", math.nan, UnstableModelError, ""),
        ("beta_HR", 0.0, UnstableModelError, ""),
        ("beta_HR_2", 0.0, UnstableModelError, ""),
        ("alpha_prime", 0.0, UnstableModelError, ""),
        ("cond_K", 3e6, StabilityWarning, "cond"),
        ("kappa_B", 50.0, StabilityWarning, "kappa"),
        ("contact_definite", -0.5, StabilityWarning, "may have two answers"),
    ],
)
def test_every_constant_refuses_or_warns(hertz_reduction, name, value, ends, said):
    good = hertz_reduction.offline.stability
    change = {name: value}
    if hasattr(good.euclidean, name):
        change = {"euclidean": dataclasses.replace(good.euclidean, **change)}
    check_stability(good, TrustLimits())
    with (pytest.warns if ends is StabilityWarning else pytest.raises)(ends, match=said):
        spoiled = dataclasses.replace(good, **change)
        check_solvable(spoiled)
        check_stability(spoiled, TrustLimits())
