"""Contact problems given as matrices: the answers of the full order that they are of, what fits
nothing, no DOLFINx.
"""

from contextlib import nullcontext

import contract
import numpy as np
import pytest
from mpi4py import MPI
from processes import python
from scipy import sparse

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotSolvableError, SceneError
from hhr_dolfinx.plugins.tables.matrices import _factored


@pytest.fixture(scope="module")
def full():
    return hhr.FullOrderModel(contract.blocks(), MPI.COMM_SELF)


@pytest.fixture(scope="module")
def given(full):
    """Matrices of a scene as another program would give them: without imposed dofs, one column for
    each parameter.
    """
    problem = full.problem
    free = np.flatnonzero(problem.free)
    # columns of θ = (1, ...): what each parameter adds is the difference of two points
    columns = [problem.amplitudes(point) for point in (np.zeros(2), *np.eye(2))]
    loads, gaps = (
        np.column_stack([matrix @ theta for theta in columns])
        for matrix in (problem.loads, problem.gaps)
    )
    assert not loads[:, 0].any() and abs(gaps[:, 0]).max() < 1e-15
    stiffness = sum(problem.stiffness_terms)[free][:, free]
    return {
        "parameters": full.parameters,
        "stiffness": stiffness,
        "contact": problem.contact[:, free],
        "loads": loads[free, 1:],
        "gaps": gaps[:, 1:],
        "amplitudes": full.parameters.names,
    }


def test_answers_are_those_of_the_full_order(full, given, tmp_path):
    free = full.problem.free
    row, weights = np.random.default_rng(0).normal(size=free.sum()), np.arange(4.0)
    model = hhr.condense_matrices(
        **given,
        areas=full.problem.contact_areas,
        displacement_outputs={"moved": row},
        force_outputs={"sum": weights},
    )
    hhr.save_model(tmp_path / "model.npz", model)
    again = hhr.load_model(tmp_path / "model.npz")
    pressed = 0
    for point in full.parameters.random(40, 1):
        exact = full.solve(point)
        lifted = exact.displacement() - full.problem.lifts @ full.problem.amplitudes(point)
        for found in (model.solve(point, gradient=True), again.solve(point)):
            pressed += found.forces().any()
            np.testing.assert_allclose(found.forces(), exact.forces(), rtol=0, atol=1e-11)
            np.testing.assert_allclose(found.displacement(), lifted[free], rtol=0, atol=1e-11)
            outputs = found.outputs()
            assert outputs["peak"] == pytest.approx(exact.outputs()["peak"], rel=1e-9, abs=1e-12)
            assert outputs["moved"] == pytest.approx(row @ lifted[free], rel=1e-9, abs=1e-12)
            assert outputs["sum"] == pytest.approx(weights @ exact.forces(), rel=1e-9, abs=1e-12)
    assert pressed > 40
    many = model.solve_many(full.parameters.random(40, 1)).outputs()["peak"]
    assert many[-1] == pytest.approx(outputs["peak"], rel=1e-12)
    assert "no reduction error" in model.known_error


def test_terms_may_be_formulas_in_any_order(full, given):
    """Products of parameters before parameters: the same problem, said by other terms."""
    split = {
        "loads": np.column_stack([given["loads"], given["loads"][:, 0]]),
        "gaps": np.column_stack([given["gaps"], given["gaps"][:, 0]]),
        "amplitudes": ["push * (1 - load)", "load", "push * load"],
    }
    point = {"push": 0.04, "load": 0.05}
    found = hhr.condense_matrices(**given | split).solve(point)
    np.testing.assert_allclose(found.forces(), full.solve(point).forces(), rtol=0, atol=1e-11)


def shifted(given, by, k=0):
    return {"stiffness": given["stiffness"] + by * sparse.eye(given["stiffness"].shape[0], k=k)}


@pytest.mark.parametrize(
    ("wrong", "error", "words"),
    [
        (lambda given: shifted(given, -10), NotSolvableError, "not positive definite"),
        (lambda given: shifted(given, 1, k=1), SceneError, "not symmetric"),
        (
            lambda given: {"contact": given["contact"][[0, *range(3)]]},
            NotSolvableError,
            "depend on each other",
        ),
        (lambda given: {"contact": 0 * given["contact"]}, NotSolvableError, "moves nothing"),
        (
            lambda given: {"stiffness": 0 * given["stiffness"]},
            NotSolvableError,
            "not positive definite",
        ),
        (lambda given: {"loads": given["loads"][:-1]}, SceneError, "loads are"),
        (lambda given: {"loads": given["loads"] * np.nan}, SceneError, "not finite"),
        (lambda given: {"gaps": given["gaps"].T}, SceneError, "gaps are"),
        (lambda given: {"contact": given["contact"][:, :-1]}, SceneError, "the stiffness is"),
        (lambda given: {"contact": given["contact"][:0]}, SceneError, "at least"),
        (lambda given: {"amplitudes": ["push", "lod"]}, SceneError, "lod"),
        (lambda given: {"amplitudes": ["push", None]}, SceneError, "must be a text"),
        (lambda given: {"areas": [1, 1, 1, 0]}, SceneError, "areas must be positive"),
        (lambda given: {"pairs": ["a", "b", "c", "d"]}, SceneError, "pairs must be real numbers"),
        (lambda given: {"pairs": [0.5, 0, 1, 1]}, SceneError, "pairs must be whole"),
        (lambda given: {"pairs": [0, 1e30, 1, 1]}, SceneError, "pairs must be whole"),
        (lambda given: {"pairs": [0, -1, 1, 1]}, SceneError, "pairs must be whole"),
        (
            lambda given: {"stiffness": given["stiffness"] * 1j},
            SceneError,
            "stiffness must be a matrix of real",
        ),
        (lambda given: {"stiffness": "abc"}, SceneError, "stiffness must be a matrix"),
        (lambda given: {"stiffness": None}, SceneError, "stiffness must be a matrix"),
        (lambda given: {"stiffness": np.ones((2, 2, 2))}, SceneError, "stiffness must be a matrix"),
        (lambda given: {"contact": np.ones(47)}, SceneError, "contact must be a matrix"),
        (lambda given: {"loads": given["loads"] * 1j}, SceneError, "loads must be real"),
        (lambda given: {"parameters": ("push", "load")}, SceneError, "must be a ParameterSpace"),
        (lambda given: {"amplitudes": None}, SceneError, "amplitudes must be a tuple"),
        (
            lambda given: {"amplitudes": ["push", "sqrt(load - 0.05)"]},
            SceneError,
            "finite everywhere in the box",
        ),
        (
            lambda given: {"amplitudes": ["push", "min(1, sqrt(load - 0.05))"]},
            SceneError,
            "finite everywhere",
        ),
        (
            lambda given: {"amplitudes": ["push", "table(load, 0, 0, 0.01, 1)"]},
            SceneError,
            "amplitude = table",
        ),
        (lambda given: {"force_outputs": [np.ones(4)]}, SceneError, "arrays by name"),
        (lambda given: {"force_outputs": {3: np.ones(4)}}, SceneError, "arrays by name"),
        (
            lambda given: {"areas": np.ones(4), "force_outputs": {"peak": np.ones(4)}},
            SceneError,
            "same name",
        ),
    ],
)
def test_what_does_not_fit_is_refused(given, wrong, error, words):
    with pytest.raises(error, match=words):
        hhr.condense_matrices(**given | wrong(given))


@pytest.mark.parametrize("seed", range(40))
def test_only_positive_definite_matrices_are_taken(seed):
    """By their eigenvalues; of small whole numbers, so that pivots vanish now and then."""
    rng = np.random.default_rng(seed)
    for _ in range(50):
        half = np.tril(rng.integers(-3, 5, (3, 3)))
        matrix = half + np.tril(half, -1).T + np.diag(rng.integers(0, 6, 3))
        definite = np.linalg.eigvalsh(matrix).min() > 1e-9
        with nullcontext() if definite else pytest.raises(NotSolvableError):
            _factored(sparse.csc_matrix(matrix.astype(float)))


def test_numbers_and_matrices_of_any_kind_are_taken(given):
    model = hhr.condense_matrices(**given)
    point = {"push": 0.05, "load": 0.05}
    kinds = {
        "stiffness": given["stiffness"].toarray().tolist(),
        "contact": sparse.coo_array(given["contact"]),
        "loads": sparse.csr_matrix(given["loads"]),
        "gaps": given["gaps"].tolist(),
    }
    other = hhr.condense_matrices(**given | kinds, pairs=[1, 0, 0, 1])
    np.testing.assert_allclose(other.solve(point).forces(), model.solve(point).forces(), rtol=1e-10)
    fixed = {name: np.column_stack([given[name] * (0.05, 0.05)]) for name in ("loads", "gaps")}
    constant = hhr.condense_matrices(**given | fixed | {"amplitudes": [np.float32(1), np.int64(1)]})
    np.testing.assert_allclose(
        constant.solve(point).forces(), model.solve(point).forces(), rtol=1e-10
    )


SPRINGS = """
import sys
import numpy as np
import hhr_dolfinx as hhr
model = hhr.condense_matrices(
    hhr.ParameterSpace(("pull",), (0.0,), (3.0,)),
    stiffness=[[2.0, -1.0], [-1.0, 1.0]],
    contact=[[0.0, 1.0]],
    loads=[[0.0, 0.0], [1.0, 0.0]],
    gaps=[[0.0, 1.0]],
    amplitudes=["pull", 1.0],
)
# the end of two springs in a row moves by 2 pull until it meets a wall at 1
for pull in (0.25, 0.5, 2.0):
    answer = model.solve([pull])
    assert np.allclose(answer.forces(), max(pull - 0.5, 0)), answer.forces()
    assert np.allclose(answer.displacement()[1], min(2 * pull, 1)), answer.displacement()
loaded = [name for name in ("dolfinx", "petsc4py", "mpi4py", "slepc4py") if name in sys.modules]
assert not loaded, loaded
"""


def test_springs_by_hand_and_without_dolfinx():
    python("-c", SPRINGS)
