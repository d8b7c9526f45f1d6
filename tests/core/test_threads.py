"""Models shared by threads, handed to workers, and used where PETSc is missing: the same bits everywhere."""

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
from sheared import PATH, rubbing
from threads import THREADS, at_once

import hhr_dolfinx as hhr
from hhr_dolfinx.contact.active_set import SchurEqualities
from hhr_dolfinx.errors import HHRError, OutsideTrainingError
from hhr_dolfinx.formulas import coordinate_names
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.linear.dense import LapackLU, PetscLU, dense_factors
from hhr_dolfinx.reduction.exact import exact_condensation

pytestmark = pytest.mark.usefixtures("restless")


def answers(model, points):
    """Primal unknowns and forces, as bytes: equal to the last bit or not at all."""
    solutions = [model.solve(point) for point in points]
    return [(solution.unknown.tobytes(), solution.multipliers.tobytes()) for solution in solutions]


def check_threads(models, points, rounds=1):
    """Each thread asks its model for the points in other orders; every answer is that of one thread alone."""
    expected = answers(models[0], points)

    def job(k):
        dice = np.random.default_rng(k)
        for _ in range(rounds):
            order = dice.permutation(len(points))
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


def twin(model):
    """A model of the same arrays, with factors of its own."""
    return hhr.ReducedModel(model.problem, model.parameters, model.fields, model.trained, known=model.known)


def test_models_are_shared(pellet, reduced):
    """The full one, of whose points there are fewer, exact condensation, and reduced ones: one, and twins of it."""
    full_order, snapshots, points = pellet
    condensed = exact_condensation(full_order, snapshots.known_statuses())
    check_threads([full_order] * THREADS, points[:50])
    for models in ([condensed] * THREADS, [reduced] * THREADS, [twin(reduced) for _ in range(THREADS)]):
        check_threads(models, points)
    assert not pickle.loads(pickle.dumps(reduced)).known.active.flags.writeable


@pytest.mark.slow
@pytest.mark.parametrize("own", [False, True], ids=["one model", "models of their own"])
def test_a_hundred_thousand_queries_by_each_thread(pellet, reduced, own):
    models = [twin(reduced) if own else reduced for _ in range(THREADS)]
    check_threads(models, pellet[0].parameters.random(2000, 8), rounds=50)


@pytest.fixture(scope="module")
def small_flow():
    full = flowing.flowing_full()
    return {"full": full, "reduced": flowing.flowing_reduction(full)}


def history_bits(model, gap, steps, settings=None):
    """All that the steps of a history left behind, as bytes."""
    history = model.march(demo.path(gap, steps), settings or hhr.MarchSettings(outside="ignore"))
    parts = [(a.unknown, a.multipliers, a.displacement(), a.forces(), a.stress()) for a in history.answers]
    return [part.tobytes() for step in parts for part in step]


@needs("inelastic", "nonmatching")
@pytest.mark.parametrize(
    ("kind", "search", "steps"), [("full", "frozen", 12), ("full", "elastic", 6), ("reduced", "elastic", 6)]
)
def test_histories_on_one_model(kind, search, steps, small_flow):
    """The tangents of one history are not solved with the factors of another."""
    model, settings = small_flow[kind], hhr.MarchSettings(search, iterations=300, outside="ignore")
    jobs = [lambda gap=gap: history_bits(model, gap, steps, settings) for gap in (5.0, 8.0, 10.0, 12.0)]
    expected = [job() for job in jobs]
    assert at_once(jobs) == expected


@needs("inelastic", "nonmatching")
def test_an_operator_outlives_the_next_one(small_flow):
    """Factors that another linearisation has replaced are made again, not mixed up."""
    full, model = small_flow["full"], small_flow["full"].equilibrium
    theta, material = model.amplitudes(np.array([100.0, 0.9, 4e-3])), model.material
    strain = model.strain(np.zeros(model.size), theta)
    tangents = material.update(strain, material.at_rest(), 1.0, tangent=True).tangents
    residual, x, active = full.problem.loads @ theta, np.zeros(model.size), np.ones(model.conditions, dtype=bool)
    first = model.linearised(tangents)
    before = first.correct(residual, x, theta, active)
    model.linearised(2 * tangents).correct(residual, x, theta, active)
    after = first.correct(residual, x, theta, ~active)
    assert np.array_equal(after.change, before.change) and np.array_equal(after.found.forces, before.found.forces)


@pytest.mark.parametrize("factorise", [PetscLU, LapackLU])
def test_one_factor(factorise):
    rng = np.random.default_rng(2)
    factor, sides = factorise(rng.normal(size=(60, 60))), rng.normal(size=(20, 60))
    expected = [factor.solve(side).tobytes() for side in sides] * 20
    assert (
        at_once([lambda: [factor.solve(side).tobytes() for _ in range(20) for side in sides]] * THREADS)
        == [expected] * THREADS
    )


def test_petsc_options_are_heeded_whenever_they_are_set():
    PetscLU(np.eye(2))
    options = PETSc.Options()
    options["hhr_dense_pc_factor_mat_ordering_type"] = "rcm"
    options["hhr_dense_ksp_type"] = "gmres"
    try:
        assert PetscLU(np.eye(2))._ksp.getType() == "gmres"
    finally:
        for name in ("hhr_dense_pc_factor_mat_ordering_type", "hhr_dense_ksp_type"):
            options.delValue(name)
    assert PetscLU(np.eye(2))._ksp.getType() == "preonly"


def test_memory_of_kept_factors_is_bounded():
    """400 conditions, sets of all sizes: 16 k^2 bytes of factors and 8 k m of columns each, 1.3 GB in all."""
    m, rng = 400, np.random.default_rng(0)
    root = rng.normal(size=(m, m))
    schur, free_slack = root @ root.T / m + np.eye(m), rng.normal(size=m)
    equalities = SchurEqualities.of(schur)
    most = 0
    for size in (*range(10, m, 6), m):
        active = np.zeros(m, dtype=bool)
        active[rng.permutation(m)[:size]] = True
        forces, slack = equalities(active, free_slack)
        # cond(S) is about 5: round-off
        assert slack + 0.0 == pytest.approx(np.where(active, 0.0, free_slack + schur @ forces), abs=1e-11)
        sizes = [entry[0].size for entry in equalities._entries.values()]
        most = max(most, sum(16 * k * k + 8 * k * m for k in sizes))
    # what is left is of use: the bound is filled, not emptied
    assert 0.8 * 64e6 < most <= 64 * 2**20
    assert equalities.kept_bytes <= equalities.most_bytes == 64 * 2**20


def test_a_set_beyond_the_bound_is_answered_and_not_kept():
    equalities = SchurEqualities.of(np.eye(4))
    equalities.most_bytes = 100
    for _ in range(2):
        assert equalities(np.ones(4, dtype=bool), -np.ones(4))[0].tolist() == [1.0] * 4
    assert equalities.kept_bytes <= 100


def test_prepared_statuses_factor_nothing():
    """What fits is factored beforehand, behind one that is too large too; answers are those of factors made anew."""
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
        histories = pool.starmap(history_bits, [(small_flow["reduced"], gap, 6) for gap in (8.0, 10.0)])
    for there, point in zip(found, points, strict=True):
        here = reduced.solve(point)
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
        with pytest.raises(TypeError, match=r"belongs to this process: hand on .* answer\.displacement\(\)"):
            pickle.dumps(item)


@needs("nonmatching", "shapes")
def test_two_threads_at_two_shapes(monkeypatch):
    """Each has the B of its own shape, that with imposed dofs too: it was once left where the other thread took it."""
    from hhr_dolfinx.plugins.shapes.reshaped import Reshaped

    x, y = coordinate_names("plane_strain")
    wider = hhr.Shape(two_blocks.SECOND, (f"1 + ({x} - 1) * (1 + wide)", y))
    scene = pressed_pair("plane_strain", ((3.0, 0.3), (4.0, 0.3)), {"wide": (0.0, 0.2)}, matching=False,
                         shapes=(wider,), cells=2)  # fmt: skip
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


VARYING = {
    "whole bodies": ({"poisson": 0.3}, {"E": (2.0, 4.0)}),
    "Poisson's ratio": ({"poisson": "nu"}, {"E": (2.0, 4.0), "nu": (0.1, 0.4)}),
}


@pytest.fixture(params=VARYING)
def varying_friction(request):
    """Two blocks with friction of which both moduli vary: those of whole bodies, or Poisson's ratio too."""
    ratio, box = VARYING[request.param]
    first = hhr.Body(two_blocks.FIRST, young="E", **ratio)
    scene = rubbing(cells=4, bodies=(first, hhr.Body(two_blocks.SECOND, "2 * E", 0.2)), box=box)
    return hhr.FullOrderModel(scene)


@needs("friction")
def test_a_contact_problem_outlives_that_of_another_point(varying_friction):
    """Derivatives of one point are its own though the factors were made for another one since."""
    full = varying_friction
    forces = np.linspace(0.1, 1.0, full.conditions)
    points = full.parameters.random(3, seed=1)
    expected = []
    for point in points:
        contact = full.contacts()(point)
        unknown = contact.unknown(forces)
        expected.append((unknown, contact.at_fixed_forces(forces, unknown)))
    made = full.contacts()
    contacts = [made(point) for point in points]
    for contact, (unknown, derivatives) in zip(contacts, expected, strict=True):
        found = contact.at_fixed_forces(forces, unknown)
        assert all(np.array_equal(mine, other) for mine, other in zip(found, derivatives, strict=True))


@needs("friction")
def test_gradients_of_one_full_model_with_friction(varying_friction):
    """Slopes of marches in threads are those of one thread, bit by bit, though each has a stiffness of its own."""
    full = varying_friction
    settings = hhr.MarchSettings(gradient=True)

    def job(k):
        moduli = (2.0 + 0.2 * k, 0.1 + 0.03 * k)[: len(full.parameters.names) - 2]
        answers = full.march([(time, (*loads, *moduli)) for time, loads in PATH[:4]], settings).answers
        return [
            (a.multipliers.tobytes(), a.gradient.multipliers.tobytes(), a.gradient.unknown.tobytes()) for a in answers
        ]

    jobs = [lambda k=k: job(k) for k in range(THREADS)]
    expected = [one() for one in jobs]
    assert at_once(jobs) == expected
