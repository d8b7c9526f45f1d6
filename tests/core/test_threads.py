"""Models and factors shared by threads, handed to workers, used where PETSc is missing: the same
bits everywhere.
"""

import multiprocessing
import pickle
import threading

import flowing
import numpy as np
import pellet_cladding as pellet_demo
import pellet_cladding_plastic as demo
import pytest
from needs import needs
from petsc4py import PETSc
from scenes import pressed_pair
from sheared_blocks import PATH, rubbing
from threads import THREADS, at_once

import hhr_dolfinx as hhr
from hhr_dolfinx.contact.active_set import SchurEqualities
from hhr_dolfinx.contact.stiffness import FactorStore, SparseStiffness
from hhr_dolfinx.errors import HHRError, NotSolvableError, OutsideTrainingError
from hhr_dolfinx.formulas import coordinate_names
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.linear.dense import LapackLU, PetscLU, dense_factors
from hhr_dolfinx.reduction.exact import exact_condensation

pytestmark = pytest.mark.usefixtures("restless")


def answers(model, points):
    """Primal unknowns and forces, as bytes: equal to the last bit or not at all."""
    solutions = [model.solve(point) for point in points]
    return [(solution.unknown.tobytes(), solution.multipliers.tobytes()) for solution in solutions]


def check_threads(models, points):
    """Each thread asks its model for the points in another order.

    Every answer is that of one thread alone.
    """
    expected = answers(models[0], points)

    def job(k):
        order = np.random.default_rng(k).permutation(len(points))
        assert answers(models[k], points[order]) == [expected[place] for place in order]

    at_once([lambda k=k: job(k) for k in range(len(models))])


@pytest.fixture(scope="module")
def pellet():
    """A full model whose queries mostly change statuses, with its training."""
    full_order = hhr.FullOrderModel(pellet_demo.scene(**pellet_demo.QUICK_MESH))
    space = full_order.parameters
    return full_order, hhr.compute_snapshots(full_order, space.grid([6, 6])), space.random(150, 5)


@pytest.fixture(scope="module")
def reduced(pellet):
    full_order, snapshots, _ = pellet
    return hhr.build(full_order, snapshots, hhr.Recipe().as_it_is())


def test_models_are_shared(pellet, reduced):
    """The full one, of whose points there are fewer, exact condensation, and reduced ones: one, and
    twins of it.

    Twins have the same arrays, and factors of their own.
    """
    full_order, snapshots, points = pellet
    condensed = exact_condensation(full_order, snapshots.known_statuses())
    check_threads([full_order] * THREADS, points[:50])
    arrays = reduced.problem, reduced.parameters, reduced.fields, reduced.trained
    twins = [hhr.ReducedModel(*arrays, known=reduced.known) for _ in range(THREADS)]
    for models in ([condensed] * THREADS, [reduced] * THREADS, twins):
        check_threads(models, points)
    assert not pickle.loads(pickle.dumps(reduced)).known.active.flags.writeable


@pytest.fixture(scope="module")
def small_flow():
    full = flowing.flowing_full()
    return {"full": full, "reduced": flowing.flowing_reduction(full)}


def history_bits(model, gap, steps, settings=None):
    """All that the steps of a history left behind, as bytes."""
    history = model.march(demo.path(gap, steps), settings or hhr.MarchSettings(outside="ignore"))
    parts = [
        (a.unknown, a.multipliers, a.displacement(), a.forces(), a.stress())
        for a in history.answers
    ]
    return [part.tobytes() for step in parts for part in step]


@needs("inelastic", "nonmatching")
@pytest.mark.parametrize(
    ("kind", "search", "steps"),
    [("full", "frozen", 12), ("full", "elastic", 6), ("reduced", "elastic", 6)],
)
def test_histories_on_one_model(kind, search, steps, small_flow):
    """The tangents of one history are not solved with the factors of another."""
    model, settings = small_flow[kind], hhr.MarchSettings(search, iterations=300, outside="ignore")
    jobs = [
        lambda gap=gap: history_bits(model, gap, steps, settings) for gap in (5.0, 8.0, 10.0, 12.0)
    ]
    assert [job() for job in jobs] == at_once(jobs)


@needs("inelastic", "nonmatching")
def test_an_operator_outlives_the_next_one(small_flow):
    """Factors that another linearisation has replaced are made again, not mixed up."""
    full, model = small_flow["full"], small_flow["full"].equilibrium
    theta, material = model.amplitudes(np.array([100.0, 0.9, 4e-3])), model.material
    strain = model.strain(np.zeros(model.size), theta)
    tangents = material.update(strain, material.at_rest(), 1.0, tangent=True).tangents
    residual, x, active = (
        full.problem.loads @ theta,
        np.zeros(model.size),
        np.ones(model.conditions, dtype=bool),
    )
    first = model.linearised(tangents)
    before = first.correct(residual, x, theta, active)
    model.linearised(2 * tangents).correct(residual, x, theta, active)
    after = first.correct(residual, x, theta, ~active)
    assert np.array_equal(after[0], before[0]) and np.array_equal(after[1].forces, before[1].forces)


@pytest.mark.parametrize("factorise", [PetscLU, LapackLU])
def test_one_factor(factorise):
    rng = np.random.default_rng(2)
    factor, sides = factorise(rng.normal(size=(60, 60))), rng.normal(size=(20, 60))
    expected = [factor.solve(side).tobytes() for side in sides]
    found = at_once([lambda: [factor.solve(side).tobytes() for side in [*sides] * 20]] * THREADS)
    assert found == [expected * 20] * THREADS


def test_petsc_options_are_heeded_whenever_they_are_set():
    PetscLU(np.eye(2))
    options = PETSc.Options("hhr_dense_")
    options["pc_factor_mat_ordering_type"], options["ksp_type"] = "rcm", "gmres"
    try:
        assert PetscLU(np.eye(2))._ksp.getType() == "gmres"
    finally:
        options.delValue("pc_factor_mat_ordering_type")
        options.delValue("ksp_type")
    assert PetscLU(np.eye(2))._ksp.getType() == "preonly"


def test_memory_of_kept_factors_is_bounded():
    """Sets of all sizes of 120 conditions: 16 k^2 bytes of factors and 8 k m of columns each, 16 MB
    in all.
    """
    m, rng = 120, np.random.default_rng(0)
    root = rng.normal(size=(m, m))
    schur, free_slack = root @ root.T / m + np.eye(m), rng.normal(size=m)
    equalities, most = SchurEqualities.of(schur), 0
    assert equalities.most_bytes == 64 * 2**20
    equalities.most_bytes = 2**22
    for size in range(1, m + 1):
        active = np.zeros(m, dtype=bool)
        active[rng.permutation(m)[:size]] = True
        forces, slack = equalities(active, free_slack)
        # cond(S) is about 5: round-off
        assert slack + 0.0 == pytest.approx(
            np.where(active, 0.0, free_slack + schur @ forces), abs=1e-11
        )
        sizes = [entry[0].size for entry in equalities._entries.values()]
        most = max(most, sum(16 * k * k + 8 * k * m for k in sizes))
    # what is left is of use: the bound is filled, not emptied
    assert 0.8 * 2**22 < most <= 2**22 and equalities.kept_bytes <= 2**22
    # a set beyond the bound is answered and not kept
    equalities = SchurEqualities.of(np.eye(4))
    equalities.most_bytes = 100
    for _ in range(2):
        assert equalities(np.ones(4, dtype=bool), -np.ones(4))[0].tolist() == [1.0] * 4
    assert equalities.kept_bytes <= 100


def test_prepared_statuses_factor_nothing():
    """What fits is factored beforehand, behind one that is too large too.

    Answers are those of factors made anew.
    """
    made = []

    def factorise(block):
        made.append(len(block))
        return dense_factors(block)

    rng = np.random.default_rng(0)
    root, free_slack = rng.normal(size=(8, 8)), rng.normal(size=8)
    schur = root @ root.T + np.eye(8)
    statuses = np.array([[True] * 8, [True, False] * 4])
    equalities = SchurEqualities.of(schur, factorise)
    equalities.prepare(statuses, 500)
    assert made == [4]
    found = equalities(statuses[1], free_slack)
    assert made == [4]
    for mine, other in zip(found, SchurEqualities.of(schur)(statuses[1], free_slack), strict=True):
        assert np.array_equal(mine, other)


@needs("inelastic", "nonmatching")
def test_a_copy_of_bodies_that_flow_marches_alike(small_flow):
    """With what it was trained on, which asks at its door too."""
    model = small_flow["reduced"]
    again = pickle.loads(pickle.dumps(model))
    assert again.offline is None
    assert history_bits(again, 10.0, 6) == history_bits(model, 10.0, 6)
    assert again.trained.imbalance == again.equilibrium.trained.imbalance == model.trained.imbalance
    with pytest.raises(OutsideTrainingError):
        again.march(demo.path(16.0, 6), hhr.MarchSettings(outside="refuse"))


@needs("inelastic", "nonmatching")
def test_workers_of_a_pool(pellet, reduced, small_flow):
    """Processes that start from nothing get the model by pickle."""
    points = pellet[2][:8]
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        found = pool.map(reduced.solve, list(points))
        histories = pool.starmap(
            history_bits, [(small_flow["reduced"], gap, 6) for gap in (8.0, 10.0)]
        )
    for there, here in zip(found, map(reduced.solve, points), strict=True):
        assert np.array_equal(there.displacement(), here.displacement())
        assert np.array_equal(there.forces(), here.forces())
    assert histories == [history_bits(small_flow["reduced"], gap, 6) for gap in (8.0, 10.0)]


def test_petsc_asked_for_where_it_is_missing(monkeypatch):
    monkeypatch.setattr("hhr_dolfinx.linear.dense.petsc", lambda: None)
    with pytest.raises(HHRError, match="LapackLU"):
        PetscLU(np.eye(2))


def test_a_full_model_and_its_answers_stay_in_their_process(hertz):
    """With what to hand on in their place."""
    for item in (hertz, hertz.solve(0.3)):
        with pytest.raises(
            TypeError, match=r"belongs to this process: hand on .* answer\.displacement\(\)"
        ):
            pickle.dumps(item)


@needs("nonmatching", "shapes")
def test_two_threads_at_two_shapes(monkeypatch):
    """Each has the B of its own shape, that with imposed dofs too: it was once left where the other
    thread took it.
    """
    from hhr_dolfinx.plugins.shapes.reshaped import Reshaped

    x, y = coordinate_names("plane_strain")
    wider = hhr.Shape(two_blocks.SECOND, (f"1 + ({x} - 1) * (1 + wide)", y))
    scene = pressed_pair(
        "plane_strain",
        ((3.0, 0.3), (4.0, 0.3)),
        {"wide": (0.0, 0.2)},
        matching=False,
        shapes=(wider,),
        cells=2,
    )
    alone, shared = (hhr.FullOrderModel(scene).problem for _ in range(2))
    points = [np.append(alone.middle[:-1], wide) for wide in (0.02, 0.18)]
    expected = [alone.reshaped(point) for point in points]
    assert abs(expected[0].whole_contact - expected[1].whole_contact).max() > 0.05
    ordered, both = Reshaped._ordered, threading.Barrier(2)

    def waiting(*arguments):
        """Both problems are assembled before either is put in order."""
        both.wait(timeout=20)
        return ordered(*arguments)

    monkeypatch.setattr(Reshaped, "_ordered", waiting)
    found = at_once([lambda point=point: shared.reshaped(point) for point in points])
    for problem, other in zip(found, expected, strict=True):
        assert abs(problem.whole_contact - other.whole_contact).max() == 0.0
        assert abs(problem.contact - other.contact).max() == 0.0


@pytest.fixture(
    params=[(0.3, {}), ("nu", {"nu": (0.1, 0.4)})], ids=["whole bodies", "Poisson's ratio"]
)
def varying_friction(request):
    """Two blocks with friction of which both moduli vary: those of whole bodies, or Poisson's ratio
    too.
    """
    ratio, box = request.param
    return hhr.FullOrderModel(
        rubbing(cells=4, bodies=(("E", ratio), ("2 * E", 0.2)), box={"E": (2.0, 4.0), **box})
    )


@needs("friction", "elasticity")
def test_a_contact_problem_outlives_that_of_another_point(varying_friction):
    """Derivatives of one point are its own though the factors were made for another one since."""
    full = varying_friction
    forces, points = np.linspace(0.1, 1.0, full.conditions), full.parameters.random(3, seed=1)
    expected = []
    for point in points:
        contact = full.contacts()(point)
        unknown = contact.unknown(forces)
        expected.append((unknown, contact.at_fixed_forces(forces, unknown)))
    contacts = list(map(full.contacts(), points))
    for contact, (unknown, derivatives) in zip(contacts, expected, strict=True):
        found = contact.at_fixed_forces(forces, unknown)
        assert all(
            np.array_equal(mine, other) for mine, other in zip(found, derivatives, strict=True)
        )


@needs("friction", "elasticity")
def test_gradients_of_one_full_model_with_friction(varying_friction):
    """Slopes of marches in threads are those of one thread, bit by bit, though each has a stiffness
    of its own.
    """
    full = varying_friction

    def job(k):
        moduli = (2.0 + 0.2 * k, 0.1 + 0.03 * k)[: len(full.parameters.names) - 2]
        path = [(time, (*loads, *moduli)) for time, loads in PATH[:4]]
        answers = full.march(path, hhr.MarchSettings(gradient=True)).answers
        parts = [(a.multipliers, a.gradient.multipliers, a.gradient.unknown) for a in answers]
        return [part.tobytes() for step in parts for part in step]

    assert [job(k) for k in range(THREADS)] == at_once([lambda k=k: job(k) for k in range(THREADS)])


# ---------------------------------------------------------------- stiffness as a value, and the
# store of factors


@pytest.fixture(scope="module")
def full():
    """Two blocks, each with a modulus of its own."""
    return hhr.FullOrderModel(
        pressed_pair(
            "plane_strain", (("E1", 0.3), ("E2", 0.3)), {"E1": (2.0, 4.0), "E2": (2.0, 5.0)}
        )
    )


@pytest.fixture(scope="module")
def matrices(full):
    """K at eight points, and by dense algebra S of each, (8, m, m)."""
    problem, free = full.problem, full.problem.free
    found = [problem.at(point).own_stiffness for point in full.parameters.random(THREADS, 1)]
    rows = problem.contact[:, free].toarray()
    return found, [
        rows @ np.linalg.solve(one.toarray()[np.ix_(free, free)], rows.T) for one in found
    ]


def counting(full):
    """What makes factors, and the list of those it has made."""
    made = []

    def make(matrix):
        made.append(full.factors_of(matrix, "nd"))
        return made[-1]

    return make, made


def stiffness(full, matrix, store, kind=SparseStiffness):
    return kind(matrix, full.problem, store)


@needs("elasticity")
@pytest.mark.parametrize("most", [1, 2, THREADS])
def test_threads_share_a_store(most, full, matrices):
    """Each solves with its own matrix, bit by bit as one thread, and S is that of dense algebra.

    The store has room.
    """
    make, made = counting(full)
    store, loads = FactorStore(make, most), np.linspace(-1.0, 1.0, full.problem.free.size)

    def job(k):
        one = stiffness(full, matrices[0][k], store)
        solved = [one.solve(loads) for _ in range(4)]
        return np.concatenate(
            [*solved, one.schur.ravel(), one.response_to_forces(np.ones(full.conditions))]
        )

    expected = [job(k) for k in range(THREADS)]
    for found, known in zip(
        at_once([lambda k=k: job(k) for k in range(THREADS)]), expected, strict=True
    ):
        assert found.tobytes() == known.tobytes()
    for k, schur in enumerate(matrices[1]):
        found = stiffness(full, matrices[0][k], store).schur
        assert np.abs(found - schur).max() <= 1e-12 * np.abs(schur).max()
    assert len(made) == most


@needs("elasticity")
def test_what_is_in_the_store_is_not_factored_again(full, matrices):
    """The matrix that was not used for longest gives way."""
    make, made = counting(full)
    store = FactorStore(make, 2)
    first, second, third = matrices[0][:3]
    for matrix in (first, second, first):
        with store.of(matrix):
            pass
    assert [item.holds(matrix) for item, matrix in zip(made, (first, second), strict=True)] == [
        True,
        True,
    ]
    with store.of(third) as factors:
        assert factors is made[1] and factors.holds(third)
    with store.of(first) as factors:
        assert factors is made[0]


@needs("elasticity")
def test_a_thread_leases_one_matrix_at_a_time(full, matrices):
    """The same one again within its lease.

    Another one is refused, since threads would wait for each other.
    """
    store = FactorStore(counting(full)[0], 2)
    one, other = matrices[0][:2]
    with store.of(one) as factors:
        with store.of(one) as again:
            assert again is factors
        with (
            pytest.raises(RuntimeError, match="factors of two matrices are leased"),
            store.of(other),
        ):
            pass
        assert factors.holds(one)
    with store.of(other) as factors:
        assert factors.holds(other)


@needs("elasticity")
def test_a_refused_matrix_leaves_the_store_as_it_was(full, matrices):
    """Behind one that is singular others are factored, by the same thread and by others."""
    store = FactorStore(counting(full)[0])
    good = stiffness(full, matrices[0][0], store)
    expected, singular = good.solve(np.ones(full.problem.free.size)), good.matrix.copy()
    singular.data[:] = 0.0
    with pytest.raises(NotSolvableError):
        stiffness(full, singular, store).solve(np.ones(full.problem.free.size))
    for found in at_once([lambda: good.solve(np.ones(full.problem.free.size))] * 2):
        np.testing.assert_array_equal(found, expected)


@needs("elasticity")
@needs("inelastic")
def test_lazy_columns_are_those_of_s(full, matrices):
    """Of the conditions that were active; forces elsewhere are none."""
    from hhr_dolfinx.plugins.inelastic.full_order import LazyStiffness

    store = FactorStore(counting(full)[0])
    lazy = stiffness(full, matrices[0][0], store, LazyStiffness)
    active = np.arange(full.conditions) < 3
    forces, slack = lazy.equalities(active, -np.ones(full.conditions))
    known = stiffness(full, matrices[0][0], store)
    for mine, other in zip(
        (forces, slack), known.equalities(active, -np.ones(full.conditions)), strict=True
    ):
        assert np.abs(mine - other).max() <= 1e-12 * np.abs(other).max()
    expected = known.response_to_forces(forces)
    assert (
        np.abs(lazy.response_to_forces(forces) - expected).max() <= 1e-12 * np.abs(expected).max()
    )
