"""Baselines: exact where they are exact, and as described where they are not."""

import hertz_half_discs as demo
import numpy as np
import pytest
from coarser import CoarserMesh
from mpi4py import MPI
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
