"""Baselines: exact where they are exact, and as described where they are not."""

import hertz_half_discs as demo
import numpy as np
import pytest
from coarser import CoarserMesh
from mpi4py import MPI
from peers import DualBasisModel, cone_projected_greedy, nonnegative_factors
from scenes import check_like

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotSolvableError, SceneError
from hhr_dolfinx.linear.dense import LapackLU, PetscLU
from hhr_dolfinx.reduction.exact import exact_condensation


@pytest.mark.parametrize("mu", [0.15, 0.2345, 0.45])
def test_condensed_is_exact(hertz, hertz_snapshots, mu):
    exact = hertz.solve(mu)
    known = hertz_snapshots.known_statuses()
    condensed, forces_only = (
        exact_condensation(hertz, known, field=field).solve(mu) for field in (True, False)
    )
    for answer in (condensed, forces_only):
        check_like(answer, exact, displacement=1e-11, forces=1e-11)
    assert forces_only.unknown.size == 0 and np.array_equal(
        forces_only.forces(), condensed.forces()
    )


def test_statuses_of_something_else(hertz, hertz_snapshots):
    known = hertz_snapshots.known_statuses()
    other = hertz_snapshots.known_statuses(slice(0, -1))
    for given in (
        None,
        hertz_snapshots,
        known.active,
        other,
        hertz_snapshots.take([]).known_statuses(),
    ):
        with pytest.raises(
            SceneError, match=r"conditions of this scene at one point or more: snapshots\.known"
        ):
            hhr.exact_condensation(hertz, given)


def test_greedy_cone():
    """Picked by hand: the largest snapshot, then the one farthest from its cone.

    A multiple is never picked.
    """
    forces = np.array([[3.0, 6.0, 0.0, 1.0], [0.0, 0.0, 2.0, 1.0], [0.0, 0.0, 0.0, 0.5]])
    basis = cone_projected_greedy(forces, 10)
    assert basis[:, 0].tolist() == [1, 0, 0] and basis[:, 1].tolist() == [0, 1, 0]
    assert basis.shape[1] == 3
    assert cone_projected_greedy(forces, 2).shape[1] == 2


def test_nonnegative_factors_rebuild_a_factorised_matrix():
    rng = np.random.default_rng(1)
    forces = rng.uniform(size=(8, 2)) @ rng.uniform(size=(2, 30))
    factors = nonnegative_factors(forces, 2)
    assert factors.min() >= 0
    rebuilt = factors @ np.linalg.lstsq(factors, forces, rcond=None)[0]
    assert np.linalg.norm(rebuilt - forces) < 1e-3 * np.linalg.norm(forces)


def test_dual_basis_model_with_all_unit_vectors_finds_the_forces(hertz, hertz_snapshots):
    """With the whole dual space, supremizers make the model exact: it is condensation in
    disguise.
    """
    model = DualBasisModel(hertz, hertz_snapshots, np.eye(55), modes=14)
    for mu in (0.168, 0.4321):
        check_like(model.solve(mu), hertz.solve(mu), displacement=1e-8, forces=1e-8)


def test_coarser_meshes_converge_to_the_fine_one(hertz):
    exact = hertz.solve(0.3)
    errors = []
    for segments, flat in ((14, 4), (28, 7), (56, 14)):
        coarse = hhr.FullOrderModel(
            demo.scene(arc_segments=segments, flat_segments=flat), MPI.COMM_SELF
        )
        answer = CoarserMesh(coarse, hertz.problem, hertz.problem.parameters.grid([3])).solve(0.3)
        pairs = (answer.displacement(), exact.displacement()), (answer.forces(), exact.forces())
        errors.append(
            [np.linalg.norm(found - known) / np.linalg.norm(known) for found, known in pairs]
        )
    errors = np.array(errors)
    assert (errors[1] < 0.7 * errors[0]).all()
    assert errors[2].max() < 1e-10  # the same mesh


@pytest.mark.parametrize("factorise", [PetscLU, LapackLU])
def test_dense_factors(factorise):
    matrix = np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 5.0], [3.0, 0.0, 1.0]])
    factor = factorise(matrix)
    found = [factor.solve(rhs) for rhs in np.eye(3)]
    factorise(np.eye(3)).solve(np.full(3, 7.0))  # solutions are new arrays
    assert matrix @ np.transpose(found) == pytest.approx(np.eye(3), abs=1e-14)
    with pytest.raises(NotSolvableError, match="singular"):
        factorise(np.ones((2, 2)))
    with pytest.raises(NotSolvableError, match="not finite"):
        factorise(np.array([[np.nan]]))
