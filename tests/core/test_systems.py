"""A system of a user's own: the full order answers it, and nothing that reads K reduces it as if it were not there."""

import dataclasses

import numpy as np
import pytest
from mpi4py import MPI
from needs import needs
from scenes import check_alike, pressed_pair
from toy_system import Foundation, Parted

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import energy_minimum
from hhr_dolfinx.errors import NotOfferedError, SceneError
from hhr_dolfinx.full_order.discretisation import Discretisation
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.models.starts import KnownStatuses
from hhr_dolfinx.registry import installed

BOX = {"k": (0.0, 20.0)}


def scene(**others):
    given = {"outputs": (hhr.ContactForce("force", 0, (0.0, 1.0)),), "system": Foundation} | others
    return pressed_pair("plane_strain", ((3.0, 0.3), (4.0, 0.3)), BOX, cells=4, **given)


@pytest.fixture(scope="module")
def full():
    return hhr.FullOrderModel(scene())


@pytest.fixture(scope="module")
def elastic():
    """The same bodies without the foundation, whose arrays the checks use."""
    with pytest.warns(hhr.errors.SceneWarning, match="k"):
        return hhr.FullOrderModel(scene(system=None))


def saddle(problem, point, active):
    """Displacement without lift and forces for some statuses, (N + m,), by one dense matrix; complex points too."""
    theta, k = problem.amplitudes(point), point[problem.parameters.names.index("k")]
    free, rows = problem.free, problem.contact[active].toarray()
    stiffness, mass = problem.stiffness.toarray(), problem.mass.toarray()
    whole = np.block([[(stiffness + k * mass)[np.ix_(free, free)], rows[:, free].T],
                      [rows[:, free], np.zeros((len(rows),) * 2)]])  # fmt: skip
    loads = problem.loads @ theta - k * (mass @ (problem.lifts @ theta))
    solved = np.linalg.solve(whole, np.concatenate([loads[free], (problem.gaps @ theta)[active]]))
    found = np.zeros(free.size + active.size, dtype=solved.dtype)
    found[: free.size][free], found[free.size :][active] = solved[: free.sum()], solved[free.sum() :]
    return found


def test_the_full_order_answers_it(full, elastic):
    """Values and derivatives of a dense saddle matrix, by complex steps; the foundation counts for a third and more."""
    problem = elastic.problem
    for point in full.parameters.random(6, 1):
        answer = full.solve(point, gradient=True)
        found = np.append(answer.unknown, answer.multipliers)
        expected = saddle(problem, point, answer.active)
        assert np.abs(found - expected).max() <= 1e-8 * np.abs(expected).max()
        slack = problem.gaps @ problem.amplitudes(point) - problem.contact @ expected[: answer.unknown.size]
        assert slack.min() > -1e-10 and expected[answer.unknown.size :].min() > -1e-10
        slopes = np.vstack([answer.gradient.unknown, answer.gradient.multipliers])
        for axis in range(point.size):
            moved = point.astype(complex)
            moved[axis] += 1e-30j
            exact = saddle(problem, moved, answer.active).imag / 1e-30
            assert np.abs(slopes[:, axis] - exact).max() <= 1e-8 * np.abs(exact).max(initial=1e-300)
    stiff = {"push": 0.05, "slide": 0.0, "load": 0.05, "gap": 0.0, "k": 20.0}
    with_it, without = (one.solve(stiff).outputs()["force"] for one in (full, elastic))
    assert abs(with_it / without - 1) > 0.3


@needs("tables")
def test_it_answers_along_paths_and_in_tables(full):
    points = full.parameters.random(4, 2)
    table = hhr.answer_points(full, points).forces
    history = full.march([(float(k), point) for k, point in enumerate(points)])
    for k, point in enumerate(points):
        forces = full.solve(point).forces()
        np.testing.assert_allclose(table[k], forces, rtol=0, atol=1e-12 * np.abs(forces).max(initial=1e-300))
        if k:
            found = history.answers[k - 1].forces()
            np.testing.assert_allclose(found, forces, rtol=0, atol=1e-12 * np.abs(forces).max(initial=1e-300))


def training():
    return hhr.train(scene(), hhr.Sobol(8), held_out=2, comm=MPI.COMM_SELF)


def statuses(full):
    return KnownStatuses(full.problem.middle[None], np.zeros((1, full.conditions), dtype=bool))


def naive(full):
    from hhr_dolfinx.plugins.baselines.naive import NaiveFullOrder

    return NaiveFullOrder(full)


READERS = {
    "condense": lambda full, path: hhr.condense(full),
    "condense a scene": lambda full, path: hhr.condense(scene()),
    "exact condensation": lambda full, path: hhr.exact_condensation(full, statuses(full)),
    "condense a training": lambda full, path: training().condense(),
    "build": lambda full, path: hhr.build(full, hhr.compute_snapshots(full, full.parameters.random(8, 0))),
    "build a training": lambda full, path: training().build(),
    "local models": lambda full, path: training().local(),
    "fallback": lambda full, path: training().safe_model(0.1),
    "reduce": lambda full, path: hhr.reduce(scene(), 0.1, comm=MPI.COMM_SELF),
    "slide": lambda full, path: hhr.slide(scene(matching=False, openings=(), outputs=())),
    "greedy training": lambda full, path: hhr.train(scene(), hhr.Greedy(), comm=MPI.COMM_SELF),
    "study": lambda full, path: hhr.study_scene(scene(), hhr.StudySettings(training=hhr.Sobol(8)), path),
    "naive full order": lambda full, path: naive(full).solve(full.problem.middle),
    "store of snapshots": lambda full, path: hhr.SnapshotStore(path, full),
    "error of the mesh": lambda full, path: hhr.mesh_error(full, full.solve(full.problem.middle)),
    "energy": lambda full, path: energy_minimum(full.problem, full.solve(full.problem.middle).displacement(), None),
    "output that reads K": lambda full, path: hhr.FullOrderModel(scene(outputs=(hhr.ElasticEnergy("energy"),))),
    "all rows": lambda full, path: full.problem.stiffness,
}  # fmt: skip


OF_PLUGINS = {
    "local models": "local",
    "fallback": "fallback",
    "reduce": "one_call",
    "greedy training": "greedy",
    "error of the mesh": "checks",
    "output that reads K": "stress",
    "naive full order": "baselines",
    "slide": "sliding",
    "study": "studies",
}


@pytest.mark.parametrize("reader", [name for name in READERS if OF_PLUGINS.get(name) in (None, *installed())])
@pytest.mark.filterwarnings("ignore")
def test_what_reads_k_refuses_it(reader, full, tmp_path):
    with pytest.raises(NotOfferedError, match="is not offered for a user-defined system without parts"):
        READERS[reader](full, tmp_path)


@needs("exporters", "inelastic")
def test_a_deck_and_bodies_with_a_law_refuse_it(tmp_path):
    from hhr_dolfinx.plugins.exporters.deck import write_deck

    with pytest.raises(SceneError, match=r"K is that of a user's system .* which a deck cannot say"):
        write_deck(tmp_path / "deck.inp", Discretisation(scene(), MPI.COMM_SELF), scene().parameters.middle)
    flowing = hhr.Body(two_blocks.FIRST, 3.0, 0.3, hhr.Plasticity(0.1))
    with pytest.raises(SceneError, match="must make a System, of bodies without laws and shapes"):
        dataclasses.replace(scene(), bodies=(flowing, scene().bodies[1]))


def test_what_is_no_system_is_refused():
    with pytest.raises(SceneError, match="must make a System of the package"):
        hhr.FullOrderModel(scene(system=lambda *given: None))
    with pytest.raises(SceneError, match="must make a System"):
        scene(system=3)


class Sparser(Foundation):
    """Leaves entries out, whose places the factors would take for those of others."""

    def equations(self, point, theta):
        matrix = self.mass.copy()
        matrix.eliminate_zeros()
        self.made(matrix, self.problem)


def test_a_matrix_of_another_pattern_is_refused():
    with pytest.raises(SceneError, match="must have the pattern of K of the bodies"):
        hhr.FullOrderModel(scene(system=Sparser))


@needs("moduli")
def test_a_system_with_parts_is_reduced():
    """Condensed to the tolerance of its grid, and hyper-reduced on all cells to that of its basis."""
    trained = hhr.train(scene(system=Parted), hhr.Sobol(48), held_out=4, comm=MPI.COMM_SELF)
    full, condensed = trained.full_order, trained.condense()
    reduced = trained.build(hhr.Recipe(hhr.Pod(1e-12), domain=hhr.Rid(20, 20)).as_it_is())
    for model, off in ((condensed, 1e-5), (reduced, 1e-4)):
        check_alike(full, model, full.parameters.random(6, 1), forces=off, displacement=off)
