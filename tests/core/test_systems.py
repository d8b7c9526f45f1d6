"""A system of a user's own: the full order answers it, and nothing that reads K reduces it as if it
were not there.
"""

import dataclasses
from contextlib import nullcontext

import numpy as np
import pytest
from mpi4py import MPI
from needs import needs
from readers_of_plugins import OF_PLUGINS, deck, scene, training
from scenes import check_alike, largest_difference, lying, space
from toy_system import Foundation, Parted

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import energy_minimum
from hhr_dolfinx.errors import NotOfferedError, SceneError
from hhr_dolfinx.formulas import Modulus
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.models.starts import KnownStatuses

pytestmark = needs("systems")


@pytest.fixture(scope="module")
def full():
    return hhr.FullOrderModel(scene())


@pytest.fixture(scope="module")
def elastic():
    """The same bodies without the foundation, whose arrays the checks use."""
    with pytest.warns(hhr.errors.SceneWarning, match="k"):
        return hhr.FullOrderModel(scene(system=None))


def saddle(problem, point, active, mass=None):
    """Displacement without lift and forces for some statuses, (N + m,), by one dense matrix.

    Complex points too.
    """
    theta, k = problem.amplitudes(point), point[problem.parameters.names.index("k")]
    free, rows = problem.free, problem.contact[active].toarray()
    stiffness, mass = problem.stiffness.toarray(), problem.mass.toarray() if mass is None else mass
    whole = np.block([[(stiffness + k * mass)[np.ix_(free, free)], rows[:, free].T],
                      [rows[:, free], np.zeros((len(rows),) * 2)]])  # fmt: skip
    loads = problem.loads @ theta - k * (mass @ (problem.lifts @ theta))
    solved = np.linalg.solve(whole, np.concatenate([loads[free], (problem.gaps @ theta)[active]]))
    found = np.zeros(free.size + active.size, dtype=solved.dtype)
    found[: free.size][free], found[free.size :][active] = (
        solved[: free.sum()],
        solved[free.sum() :],
    )
    return found


def test_the_full_order_answers_it(full, elastic):
    """Values and derivatives of a dense saddle matrix, by complex steps.

    The foundation counts for a third and more.
    """
    problem = elastic.problem
    for point in full.parameters.random(6, 1):
        answer = full.solve(point, gradient=True)
        expected = saddle(problem, point, answer.active)
        assert largest_difference(np.append(answer.unknown, answer.multipliers), expected) <= 1e-8
        slack = (
            problem.gaps @ problem.amplitudes(point)
            - problem.contact @ expected[: answer.unknown.size]
        )
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
    along = full.march([(float(k), point) for k, point in enumerate([points[0], *points])]).answers
    for point, *found in zip(points, table, (answer.forces() for answer in along), strict=True):
        forces = full.solve(point).forces()
        assert np.abs(found - forces).max() <= 1e-12 * np.abs(forces).max()


def statuses(full):
    return KnownStatuses(full.problem.middle[None], np.zeros((1, full.conditions), dtype=bool))


READERS = {
    "condense": lambda full, path: hhr.condense(full),
    "condense a scene": lambda full, path: hhr.condense(scene()),
    "exact condensation": lambda full, path: hhr.exact_condensation(full, statuses(full)),
    "condense a training": lambda full, path: training().condense(),
    "build": lambda full, path: hhr.build(
        full, hhr.compute_snapshots(full, full.parameters.random(8, 0))
    ),
    "build a training": lambda full, path: training().build(),
    "store of snapshots": lambda full, path: hhr.SnapshotStore(path, full),
    "energy": lambda full, path: energy_minimum(
        full.problem, full.solve(full.problem.middle).displacement(), None
    ),
    "all rows": lambda full, path: full.problem.stiffness,
}


@pytest.mark.parametrize(
    "reader", [*READERS, *(pytest.param(name, marks=needs(name)) for name in OF_PLUGINS)]
)
@pytest.mark.filterwarnings("ignore")
def test_what_reads_k_refuses_it(reader, full, tmp_path):
    with pytest.raises(
        NotOfferedError, match="is not offered for a user-defined system without parts"
    ):
        (READERS | OF_PLUGINS)[reader](full, tmp_path)


@needs("exporters", "inelastic")
def test_a_deck_and_bodies_with_a_law_refuse_it(full, tmp_path):
    with pytest.raises(
        SceneError, match=r"K is that of a user's system .* which a deck cannot say"
    ):
        deck(full, tmp_path)
    flowing = hhr.Body(two_blocks.FIRST, 3.0, 0.3, hhr.Plasticity(0.1))
    with pytest.raises(
        SceneError, match="a law states the stress of its body, and a system K of all bodies"
    ):
        dataclasses.replace(scene(), bodies=(flowing, scene().bodies[1]))


class Sparser(Foundation):
    """Leaves entries out, whose places the factors would take for those of others."""

    def equations(self, point, theta):
        matrix = self.mass.copy()
        matrix.eliminate_zeros()
        self.made(matrix, self.problem)


NO_SYSTEMS = {
    3: "must make a System",
    (lambda *given: None): "must make a System of the package",
    Sparser: "must have the pattern",
}


@pytest.mark.parametrize("system", NO_SYSTEMS)
def test_what_is_no_system_is_refused(system):
    with pytest.raises(SceneError, match=NO_SYSTEMS[system]):
        hhr.FullOrderModel(scene(system=system))


@needs("moduli")
def test_a_system_with_parts_is_reduced():
    """Condensed to the tolerance of its grid, and hyper-reduced on all cells to that of its
    basis.
    """
    trained = hhr.train(scene(system=Parted), hhr.Sobol(48), held_out=4, comm=MPI.COMM_SELF)
    full, condensed = trained.full_order, trained.condense()
    reduced = trained.build(hhr.Recipe(hhr.Pod(1e-12), domain=hhr.Rid(20, 20)).as_it_is())
    for model, off in ((condensed, 1e-5), (reduced, 1e-4)):
        check_alike(full, model, full.parameters.random(6, 1), forces=off, displacement=off)


class Understated(Parted):
    """Parts with half of the foundation."""

    def parts(self):
        (one, k), matrices = super().parts()
        return (one, Modulus("k / 2", "1", k.names)), matrices


class Pushed(Parted):
    """Loads that no part states."""

    def equations(self, point, theta):
        problem, stiffness, loads = super().equations(point, theta)
        return problem, stiffness, loads + 1e-3 * point[self.axis] * problem.free[problem.rows]


class Lifted(Parted):
    """Gaps that no part states."""

    def equations(self, point, theta):
        problem, stiffness, loads = super().equations(point, theta)
        return dataclasses.replace(problem, gaps=1.1 * problem.gaps), stiffness, loads


PARTS = {
    Understated: "K of its equations",
    Pushed: "the loads of its equations",
    Lifted: "the gaps of its equations",
}


@pytest.mark.parametrize("system", PARTS)
def test_parts_that_are_not_what_is_assembled_are_refused(system):
    """Reductors read the parts alone: half of the foundation was 31 % off under a bound of 3e-7."""
    with pytest.raises(
        SceneError, match=f"states parts, and {PARTS[system]} differ from their sum by"
    ):
        hhr.FullOrderModel(scene(system=system))


class Upright(Foundation):
    """A foundation along the last axis alone."""

    def __init__(self, *given):
        super().__init__(*given)
        dim = self.problem.block_size
        self.mass.data[self.mass.indices % dim != dim - 1] = 0.0


@pytest.mark.parametrize("system", [Foundation, Upright])
@needs("floating")
def test_a_foundation_holds_a_body_that_nothing_else_holds(system):
    """Displacement and forces of the dense saddle matrix: its kernel is that of K with the
    foundation.

    Motions sideways, which Upright leaves and no load drives, are those of least size.
    """
    box = space(p=(1.0, 10.0), k=(1.0, 20.0))
    with pytest.warns(hhr.errors.SceneWarning):
        bare = hhr.FullOrderModel(lying(cells=(4, 2), parameters=box)).problem
    warned = pytest.warns(hhr.errors.SceneWarning) if system is Upright else nullcontext()
    with warned:
        full = hhr.FullOrderModel(lying(cells=(4, 2), parameters=box, system=system))
    mass = full.system.mass.toarray()
    for point in full.parameters.random(3, 1):
        answer = full.solve(point)
        expected = saddle(bare, point, answer.active, mass)
        if system is Upright:
            idle = full.problem.kernel.idle
            assert idle.shape[1] == 1
            expected[: len(idle)] -= idle @ (idle.T @ expected[: len(idle)])
        assert answer.forces().sum() > 0.1
        assert largest_difference(np.append(answer.unknown, answer.multipliers), expected) <= 1e-8
