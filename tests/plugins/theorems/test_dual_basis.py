"""Theorem 2 on the RID of half-discs: both sides, and what they are with the whole dual space."""

import numpy as np
import pytest
from dual_basis import theorem_2
from mpi4py import MPI
from scipy import linalg

import hhr_dolfinx as hhr

POINTS = np.array([[0.171], [0.233], [0.318], [0.447]])


@pytest.fixture(scope="module")
def model(hertz):
    """Of two training answers: its displacements are off between them."""
    training = hhr.train(hertz.scene, np.array([[0.2], [0.4]]), held_out=0, comm=MPI.COMM_SELF)
    return training.build(checked=False)


def test_both_sides_of_theorem_2(hertz, hertz_snapshots, model):
    """A cone of five training answers: errors are there, and right sides are above them."""
    cone = hertz_snapshots.forces[:, 3::6]
    found = theorem_2(hertz, model, cone, POINTS)
    assert 0 < found.beta_RB <= 1 + 1e-9
    for sides in (found.displacements, found.forces):
        left, right = sides.T
        assert (left > 0).all() and (left <= right).all()


def test_the_whole_dual_space_leaves_no_infimum_over_forces(hertz, model):
    """The right side of (2.69) is then that of theorem 3, in the norms in which M_a = 1: the error
    of the displacement over the inf-sup constant.
    """
    found = theorem_2(hertz, model, np.eye(hertz.conditions), POINTS)
    right = found.displacements[:, 0] / found.beta_RB
    np.testing.assert_allclose(found.forces[:, 1], right, rtol=1e-6)
    assert (found.forces[:, 0] <= found.forces[:, 1] * (1 + 1e-9)).all()


def test_the_inf_sup_constant_is_that_of_its_definition(hertz, hertz_snapshots, model):
    """(2.65) by brute force over the span of the cone: sup over displacements of b is |V^T B^T q|
    in the energy norm of an orthonormal V.
    """
    cone = hertz_snapshots.forces[:, 3::6]
    found = theorem_2(hertz, model, cone, POINTS[:1])
    sets = model.offline.sets
    stiffness = hertz.problem.stiffness[sets.A][:, sets.A].toarray()
    rows = hertz.problem.contact[sets.A_lambda][:, sets.A].toarray()
    basis = linalg.orth(model.offline.basis[sets.A])
    gram = linalg.inv(linalg.sqrtm(basis.T @ stiffness @ basis).real)
    compliance = rows @ linalg.solve(stiffness, rows.T)
    inside = cone[sets.A_lambda]
    quotients = []
    for weights in np.random.default_rng(1).normal(size=(2000, inside.shape[1])):
        force = inside @ weights
        pushed = np.linalg.norm(gram @ (basis.T @ (rows.T @ force)))
        quotients.append(pushed / np.sqrt(force @ compliance @ force))
    assert found.beta_RB <= min(quotients) * (1 + 1e-6)
    assert min(quotients) < 1.5 * found.beta_RB
