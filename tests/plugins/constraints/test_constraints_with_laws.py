"""Constraints, preload and springs of bodies that yield or creep."""

from dataclasses import replace

import numpy as np
import pytest
from bolted_columns import AREA, LENGTH, YOUNG, column, scene
from needs import needs
from scenes import block_scene
from scipy.optimize import brentq
from tied_blocks import tied

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import block, two_blocks
from hhr_dolfinx.plugins.inelastic.condense_flow import CorrectionSettings

LAWS = {"yields": hhr.Plasticity(0.5, 20.0), "creeps": hhr.Norton(6.0, 3.0)}
BOX = {"p": (0.0, 1.0)}


def whole(law, cells=4, ceiling=2.002):
    """A block of 1 x 2 on a floor, held sideways, pressed on its left and pulled to a ceiling on
    its right.
    """
    lower = (block.side(0, upper=False), block.side(1, upper=False))
    return block_scene(
        "whole",
        BOX,
        upper=(1, 2),
        cells=(cells, 2 * cells),
        bodies=(hhr.Body(block.SOLID, 100.0, 0.3, law),),
        contacts=(hhr.Obstacle(block.side(1, upper=True), (0, 1), ceiling),),
        displacements=tuple(hhr.Displacement(side, axis) for axis, side in enumerate(lower)),
        loads=(
            hhr.NodalForce(
                hhr.Nodes(lambda x: np.isclose(x[1], 2) & (x[0] < 0.3)), (0.1, -0.5), "p"
            ),
            hhr.NodalForce(
                hhr.Nodes(lambda x: np.isclose(x[1], 2) & (x[0] > 0.9)), (0.1, 0.6), "p"
            ),
        ),
    )


def halves(law, kind, cells=4):
    """The same of two blocks with nodes that follow those of the other one."""
    made = tied(cells=((cells, cells),) * 2, box=BOX)
    bodies = tuple(replace(body, law=law) for body in made.bodies)
    contacts = (replace(whole(law).contacts[0], surface=two_blocks.side(2, 1, upper=True)),)
    return replace(
        made,
        bodies=bodies,
        contacts=contacts,
        loads=whole(law).loads,
        constraints=(replace(made.constraints[0], pairing=kind),),
    )


PATH = [(0.0, [0.0]), *((float(k), [p]) for k, p in enumerate((0.3, 0.7, 1.0, 0.5, 0.9), start=1))]


def ordered(full, displacement):
    """Displacements of nodes in an order of their places, one for each place, (places, dim)."""
    points, dim = full.problem.points.round(9), full.problem.block_size
    _, places = np.unique(points[:, ::-1], axis=0, return_index=True)
    return displacement.reshape(-1, dim)[places]


@needs("mortar", "nonmatching", "inelastic", "nodal_loads")
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("kind", ["Mortar", "NodeToSurface"])
def test_tied_halves_are_one_body(kind, law):
    """On meshes that match, with its displacements, contact forces and plastic strains, and in
    contact with a wall.
    """
    one, two = (
        hhr.FullOrderModel(whole(LAWS[law])),
        hhr.FullOrderModel(halves(LAWS[law], getattr(hhr, kind))),
    )
    for search in ("frozen", "tangent", "elastic"):
        tight = hhr.MarchSettings(
            search=search, relative_stress=1e-11, floor_stress=1e-11, relative_force=1e-11
        )
        known, found = one.march(PATH, tight).answers, two.march(PATH, tight).answers
        for here, there in zip(found, known, strict=True):
            u = ordered(one, there.displacement())
            assert ordered(two, here.displacement()) == pytest.approx(u, abs=1e-8 * np.abs(u).max())
            forces, own = (np.sort(answer.forces()) for answer in (there, here))
            assert own == pytest.approx(forces, abs=1e-8 * known[-1].forces().max())
            plastic, own = (np.sort(answer.plastic_strain()) for answer in (there, here))
            assert own == pytest.approx(plastic, abs=1e-8 * plastic.max())
        assert known[-1].forces().max() > 1e-3 and known[-1].plastic_strain().max() > 1e-3


TIGHT = hhr.MarchSettings(
    relative_stress=1e-8, relative_force=1e-8, floor_stress=1e-8, iterations=300, outside="ignore"
)


def close(found, exact, near):
    """Two histories agree in displacement, contact forces and stress, over their largest values."""
    for name in ("displacement", "forces", "stress"):
        pairs = [
            (getattr(a, name)(), getattr(b, name)())
            for a, b in zip(found.answers, exact.answers, strict=True)
        ]
        size = max(np.abs(b).max() for _, b in pairs)
        assert max(np.abs(a - b).max() for a, b in pairs) <= near * size, name


WHOLE = CorrectionSettings(modes=1e-9, cubature=1e-9, attempts=1)
"""Condensing that leaves nothing out."""


def trained(full, path, *reductors):
    """A history of a full model, and models that are made of it."""
    history = full.march(path, TIGHT)
    snapshots = hhr.SnapshotSet.of_histories([history])
    return history, *(hhr.build(full, snapshots, reductor) for reductor in reductors)


@needs("mortar", "inelastic", "nodal_loads")
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.filterwarnings("ignore")
def test_a_condensed_model_of_tied_halves(law):
    history, condensed = trained(hhr.FullOrderModel(halves(LAWS[law], hhr.Mortar)), PATH, WHOLE)
    close(condensed.march(PATH, TIGHT), history, 1e-7)


@needs("mortar", "inelastic", "nodal_loads")
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.filterwarnings("ignore")
def test_a_reduced_model_of_tied_halves(law, tmp_path):
    """It has the error of that of one body: round-off with plasticity, 6 % with creep on a RID of
    half of the mesh.

    Some nodes of the RID follow others.
    """
    wrong, left = [], []
    for made in (whole(LAWS[law], 12), halves(LAWS[law], hhr.Mortar, 12)):
        full = hhr.FullOrderModel(made)
        history, reduced = trained(full, PATH, hhr.Recipe.flowing())
        found = reduced.march(PATH, TIGHT)
        if law == "yields":
            close(found, history, 1e-7)
        left.append(found.signs[-1].imbalance)
        wrong.append(
            ordered(full, found.answers[-1].displacement() - history.answers[-1].displacement())
        )
    flow = reduced.equilibrium.flow
    assert flow.cells.size < 0.6 * len(full.problem.cell_nodes)
    dofs = full.equilibrium.operator.restricted(flow.cells)[1][flow.inner]
    assert full.problem.prolongation.dependent[dofs].sum() > 5
    hhr.save_model(tmp_path / "tied.npz", reduced)
    close(hhr.load_model(tmp_path / "tied.npz").march(PATH, TIGHT), found, 1e-9)
    assert left[1] == pytest.approx(left[0], rel=1e-5, abs=1e-8)
    assert wrong[1] == pytest.approx(
        wrong[0], abs=1e-6 * np.abs(history.answers[-1].displacement()).max()
    )


def bolt(path, law, loads=(), **changes):
    """A bolt of this law between its foot and springs at its head, E A / L = 333 and k = 500,
    without its plate.
    """
    spring = hhr.Springs("HEAD", 2, SPRING, bedding=True)
    made = scene(path, (hhr.Preload("CUT", "0.03 * p"),), (spring,), gap=1.0, ways=("p", 0.0, 1.0))
    return replace(
        made,
        **{"bodies": (hhr.Body("BOLT", YOUNG, 0.3, law),), "loads": (spring, *loads)} | changes,
    )


SPRING = 500.0
"""Stiffness of the springs, force per length."""


@needs("inelastic", "nodal_loads")
@pytest.mark.filterwarnings("ignore")
def test_a_preloaded_bolt_relaxes(tmp_path):
    """In series with a spring: (1/E + A/(k L)) σ' = -(σ/K)^n, by the implicit Euler method and,
    closely, in time.
    """
    limit, exponent = 10.0, 3.0
    full = hhr.FullOrderModel(bolt(column(tmp_path / "bolt.inp"), hhr.Norton(limit, exponent)))
    times = np.concatenate([[0.0], 1e-12 + np.linspace(0.0, 0.05, 41)])
    path = [(float(t), [float(k > 0)]) for k, t in enumerate(times)]
    exact, *others = trained(full, path, hhr.Recipe.flowing(), WHOLE)
    give = 1 / YOUNG + AREA / (SPRING * LENGTH)
    first = stress = 0.03 / LENGTH / give
    for k, step in enumerate(np.diff(times[1:]), start=1):
        before = stress
        stress = brentq(lambda s: give * (s - before) + step * (s / limit) ** exponent, 0.0, before)
        assert exact.answers[k].stress()[:, 2] == pytest.approx(stress, rel=1e-7)
    closed = (first ** (1 - exponent) + (exponent - 1) * 0.05 / (limit**exponent * give)) ** (
        1 / (1 - exponent)
    )
    assert stress == pytest.approx(closed, rel=0.02) and stress < 0.6 * first
    for model in others:
        close(model.march(path, TIGHT), exact, 1e-6)


@needs("inelastic", "nodal_loads")
@pytest.mark.filterwarnings("ignore")
def test_a_bolt_that_yields_and_a_force_in_it(tmp_path):
    """The shortening is that of bar and spring with hardening.

    A force F alone moves the head by F / k.
    """
    limit, slope = 3.0, 100.0
    path = column(tmp_path / "bolt.inp")
    full = hhr.FullOrderModel(bolt(path, hhr.Plasticity(limit, slope)))
    ways = [(0.0, [0.0]), (1.0, [0.5]), (2.0, [1.0])]
    exact, *others = trained(full, ways, hhr.Recipe.flowing(), WHOLE)
    stress = (0.03 / LENGTH + limit / slope) / (1 / YOUNG + 1 / slope + AREA / (SPRING * LENGTH))
    assert exact.answers[-1].stress()[:, 2] == pytest.approx(stress, rel=1e-7) and stress > limit
    assert exact.answers[-1].plastic_strain() == pytest.approx((stress - limit) / slope, rel=1e-6)
    for model in others:
        close(model.march(ways, TIGHT), exact, 1e-6)
    force = (hhr.BoltForce("CUT", "4 * p"),)
    forced = hhr.FullOrderModel(
        bolt(path, hhr.Plasticity(limit, slope), force, constraints=(hhr.ForcedSection("CUT"),))
    )
    last = forced.march(ways).answers[-1]
    assert last.stress()[:, 2] == pytest.approx(4.0 / AREA, rel=1e-7)
    assert last.outputs()["head"] == pytest.approx(-4.0 / SPRING, rel=1e-7)


@needs("inelastic", "nodal_loads")
def test_an_equation_is_a_displacement():
    """Of a lid of a body that yields, imposed as an equation of each of its nodes or as a
    displacement.
    """
    lid = [hhr.Nodes.near((x, 2.0)) for x in np.linspace(0, 1, 5)]
    made = replace(
        whole(LAWS["yields"]),
        loads=(),
        contacts=(hhr.Obstacle(block.side(0, True), (1, 0), 1.002),),
    )
    driven = hhr.Displacement(block.side(1, True), 1, "-0.05 * p")
    one = hhr.FullOrderModel(replace(made, displacements=(*made.displacements, driven)))
    equations = tuple(hhr.Equation(((node, 1, 2.0),), "-0.1 * p") for node in lid)
    two = hhr.FullOrderModel(replace(made, constraints=equations))
    known, found = (model.march(PATH, TIGHT) for model in (one, two))
    assert known.answers[-1].plastic_strain().max() > 1e-3 and known.answers[-1].forces().max() > 0
    close(found, known, 1e-7)
