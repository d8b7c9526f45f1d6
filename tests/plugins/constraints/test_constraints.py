"""Displacements that follow others: ties, couplings, equations and periodic surfaces, in all kinds
of models.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from needs import needs
from scenes import block_scene, space
from scipy.sparse import csr_matrix
from tied_blocks import BOTTOM, LEFT, RIGHT, TOP, pressed, tied

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import energy_minimum
from hhr_dolfinx.errors import PairingWarning, SceneError
from hhr_dolfinx.geometries import block
from hhr_dolfinx.plugins.constraints.elimination import ConstraintEquations
from hhr_dolfinx.plugins.constraints.loose_equations import first_largest


def models(scene, count=8):
    """Full, condensed and hyper-reduced model."""
    training = hhr.train(scene, hhr.Sobol(count), held_out=2)
    return training.full_order, hhr.condense(training.full_order), training.build()


def test_an_equation_without_effect_changes_nothing():
    """The side moves by 0 at two nodes already: one follows the other.

    And answers with reactions agree.
    """
    low, high = hhr.Nodes.near((0.0, 0.5)), hhr.Nodes.near((1.0, 0.5))
    plain = hhr.FullOrderModel(pressed()).solve(0.8)
    one = hhr.FullOrderModel(pressed((hhr.Equation(((high, 1, 1.0), (low, 1, -1.0))),))).solve(0.8)
    assert one.displacement() == pytest.approx(plain.displacement(), abs=1e-13)
    assert one.forces() == pytest.approx(plain.forces(), abs=1e-12)


@pytest.mark.parametrize("p", [0.3, 1.0])
def test_equations_are_kept_by_all_models(p):
    """A lever: one corner of the lid goes twice as far down as the other, plus a given amount."""
    one, other = hhr.Nodes.near((0.0, 1.0)), hhr.Nodes.near((1.0, 1.0))
    scene = pressed((hhr.Equation(((one, 1, 1.0), (other, 1, -2.0)), "0.002 * p"),))
    found = []
    for model in models(scene):
        answer = model.solve(p)
        u = answer.displacement().reshape(-1, 2)
        models_points = hhr.FullOrderModel(scene).problem.points
        place = [
            int(np.linalg.norm(models_points - corner, axis=1).argmin())
            for corner in ((0, 1), (1, 1))
        ]
        assert u[place[0], 1] == pytest.approx(2 * u[place[1], 1] + 0.002 * p, abs=1e-12)
        found.append((u, answer.forces()))
    for u, forces in found[1:]:
        assert u == pytest.approx(found[0][0], abs=1e-9)
        assert forces == pytest.approx(found[0][1], abs=1e-8)


def test_the_constrained_answer_is_the_least_of_the_energy():
    """Against a penalty by hand: K + k c c^T, F + k g c, with k large, on the same mesh without
    contact.
    """
    one, other = hhr.Nodes.near((0.0, 1.0)), hhr.Nodes.near((1.0, 1.0))
    constrained = hhr.FullOrderModel(
        pressed((hhr.Equation(((one, 1, 1.0), (other, 1, -2.0)), 0.002),))
    )
    plain = hhr.FullOrderModel(pressed())
    u = constrained.solve(0.1).displacement()
    assert not constrained.solve(0.1).forces().any()
    problem = plain.problem
    place = [
        2 * int(np.linalg.norm(problem.points - corner, axis=1).argmin()) + 1
        for corner in ((0, 1), (1, 1))
    ]
    free = np.flatnonzero(problem.free)
    stiffness = problem.stiffness_terms[0].toarray()
    row = np.zeros(problem.free.size)
    row[place] = 1.0, -2.0
    system = np.block(
        [[stiffness[np.ix_(free, free)], row[free, None]], [row[None, free], np.zeros((1, 1))]]
    )
    load = problem.loads @ problem.amplitudes(np.array([0.1]))
    exact = np.linalg.solve(system, np.append(load[free], 0.002))
    assert u[free] == pytest.approx(exact[:-1], abs=1e-12)


def test_a_rigid_lid_stays_straight_and_a_mean_is_met():
    """A lid that is pressed on one half turns as a whole.

    Its mean displacement may be given instead.
    """
    half = hhr.Nodes(lambda x: np.isclose(x[1], 1) & (x[0] < 0.3))
    rigid = pressed((hhr.RigidMotion(TOP),), loads=(hhr.NodalForce(half, (0.0, -0.4), "p"),))
    for model in models(rigid):
        lid = np.isclose(hhr.FullOrderModel(rigid).problem.points[:, 1], 1.0)
        x, u = (
            hhr.FullOrderModel(rigid).problem.points[lid, 0],
            model.solve(0.7).displacement().reshape(-1, 2)[lid],
        )
        slope = np.polyfit(x, u[:, 1], 1)
        assert np.polyval(slope, x) == pytest.approx(u[:, 1], abs=1e-10) and slope[0] > 1e-4
        assert u[:, 0] == pytest.approx(u[0, 0] + 0 * x, abs=1e-10)
    mean = pressed((hhr.MeanMotion(TOP, 1, "-0.01 * p"),), loads=())
    for model in models(mean):
        lid = np.isclose(hhr.FullOrderModel(mean).problem.points[:, 1], 1.0)
        u = model.solve(0.7).displacement().reshape(-1, 2)[lid, 1]
        x = hhr.FullOrderModel(mean).problem.points[lid, 0]
        order = np.argsort(x)
        assert np.trapezoid(u[order], x[order]) == pytest.approx(-0.007, abs=1e-9)


def test_a_periodic_strip_is_one_of_many():
    """Both sides of a strip move alike, so that a given stretch of the strip is the same
    everywhere.
    """
    held = (hhr.Displacement(hhr.Nodes.near((0.0, 0.0)), 0),)
    scene = pressed((hhr.Periodic(RIGHT, LEFT, shift=(1.0, 0.0)),), held, cells=(5, 3))
    scene = replace(scene, contacts=(hhr.Obstacle(TOP, (0, 1), 5.0),))
    full = hhr.FullOrderModel(scene)
    u, points = full.solve(0.9).displacement().reshape(-1, 2), full.problem.points
    # no strain along x: uniaxial strain by the oedometric modulus
    modulus = 100.0 * 0.7 / (1.3 * 0.4)
    assert u[:, 1] == pytest.approx(-0.9 / modulus * points[:, 1], abs=1e-12)
    assert u[:, 0] == pytest.approx(0 * points[:, 0], abs=1e-12)


def test_a_quarter_of_a_square_is_all_of_it():
    """Cyclic symmetry by a right angle: under pressure all around, strains are alike, and the
    middle stays.

    A force at the corner, turned three times, does not move the middle either: without its own
    equation it would.
    """
    held = (hhr.Displacement(hhr.Nodes.near((1.0, 0.0)), 1),)
    cyclic = (hhr.Periodic(LEFT, BOTTOM, angle=np.pi / 2),)
    far = (hhr.Obstacle(TOP, (0, 1), 9.0),)
    quarter = replace(pressed(cyclic), displacements=held, contacts=far)
    full = hhr.FullOrderModel(
        replace(quarter, loads=(hhr.Pressure(RIGHT, "p"), hhr.Pressure(TOP, "p")))
    )
    shrunk = 0.5 * (1 - 2 * 0.3) * (1 + 0.3) / 100.0
    u = full.solve(0.5).displacement().reshape(-1, 2)
    assert u == pytest.approx(-shrunk * full.problem.points, abs=1e-12)
    force = hhr.NodalForce(hhr.Nodes.near((1.0, 1.0)), (1.0, 0.3), "p")
    pulled = hhr.FullOrderModel(replace(quarter, loads=(force,)))
    points, u = pulled.problem.points, pulled.solve(0.5).displacement().reshape(-1, 2)
    place = {tuple(point): k for k, point in enumerate(np.round(points, 9) + 0.0)}
    assert u[place[0.0, 0.0]] == pytest.approx([0.0, 0.0], abs=1e-12) and np.abs(u).max() > 1e-3
    for along in (0.25, 0.5, 1.0):
        one, other = u[place[along, 0.0]], u[place[0.0, along]]
        assert other == pytest.approx([-one[1], one[0]], abs=1e-12)


@pytest.mark.parametrize("right", ["0.002 * p", "0.003 * p"])
def test_equations_of_imposed_displacements_hold_or_are_refused(right):
    """A lid that goes down by 0.002 p on both of its corners cannot go down by 0.003 p on one of
    them too.
    """
    ends = [hhr.Nodes.near((x, 1.0)) for x in (0.0, 1.0)]
    driven = [
        hhr.Displacement(end, 1, way)
        for end, way in zip(ends, ("-0.002 * p", "-0.004 * p"), strict=True)
    ]
    scene = pressed((hhr.Equation(((ends[0], 1, 1.0), (ends[1], 1, -1.0)), right),))
    scene = replace(scene, displacements=(*scene.displacements, *driven), loads=())
    if right == "0.002 * p":
        assert hhr.FullOrderModel(scene).solve(1.0).converged
    else:
        with pytest.raises(SceneError, match="imposed displacements alone, which break them"):
            hhr.FullOrderModel(scene)


@pytest.mark.parametrize(
    ("constraints", "why"),
    [
        (
            (hhr.Equation(((TOP, 1, 1.0),)), hhr.Equation(((TOP, 1, 2.0),))),
            "follows by several equations",
        ),
        # the foot is imposed, the middle follows it, and the lid should determine the middle, too
        (
            (
                hhr.Equation(
                    ((hhr.Nodes.near((0, 0)), 1, 1.0), (hhr.Nodes.near((0, 0.5)), 1, -1.0))
                ),
                hhr.Equation(
                    ((hhr.Nodes.near((0, 0.5)), 1, 1.0), (hhr.Nodes.near((0, 1)), 1, -1.0))
                ),
            ),
            "by several equations",
        ),
        ((hhr.Equation((("nowhere", 1, 1.0),)),), "'nowhere' is requested"),
        ((hhr.Periodic(TOP, LEFT),), "mesh both surfaces alike"),
        (
            (
                hhr.Equation(
                    ((hhr.Nodes.near((0.5, 1)), 1, 1.0), (hhr.Nodes.near((0, 1)), 1, -1.0))
                ),
                hhr.Equation(
                    ((hhr.Nodes.near((0, 1)), 1, 1.0), (hhr.Nodes.near((0.5, 1)), 1, -1.0))
                ),
            ),
            "depend on each other",
        ),
    ],
)
def test_equations_that_cannot_be_are_refused(constraints, why):
    with pytest.raises(SceneError, match=why):
        hhr.FullOrderModel(pressed(constraints))


@dataclass(frozen=True)
class Lever:
    """A user's constraint: one corner of the lid goes down as the other one does, and by an
    amplitude more.
    """

    amplitude: object
    changes: object = lambda given: {}

    def equations(self, assembler):
        one, other = (2 * assembler.nodes(hhr.Nodes.near((x, 1.0)))[0] + 1 for x in (0.0, 1.0))
        rows = csr_matrix(([1.0, -1.0], ([0, 0], [one, other])), shape=(1, assembler.size))
        given = ConstraintEquations(rows, np.array([one]), np.ones(1))
        changed = self.changes(given)
        return replace(given, **changed) if isinstance(changed, dict) else changed


@pytest.mark.parametrize("amplitude", ["0.002 * p", 0.001, hhr.Amplitude(slopes={"p": 0.002})])
def test_a_constraint_of_a_user_takes_the_amplitudes_of_displacements(amplitude):
    """It is the equation of the package, also with dense rows."""
    own = pressed((Lever(amplitude, lambda given: {"rows": given.rows.toarray()}),))
    one, other = hhr.Nodes.near((0.0, 1.0)), hhr.Nodes.near((1.0, 1.0))
    theirs = pressed((hhr.Equation(((one, 1, 1.0), (other, 1, -1.0)), amplitude),))
    found, known = (hhr.FullOrderModel(scene).solve(0.7).displacement() for scene in (own, theirs))
    assert found == pytest.approx(known, abs=1e-14) and np.abs(known).max() > 1e-3


@pytest.mark.parametrize(
    ("changes", "why"),
    [(lambda given: (given.rows, given.dependent, given.values), "are no Equations"),
     (lambda given: {"rows": given.rows[:, :-1]}, "have rows of 49 columns, and there are 50 dofs"),
     (lambda given: {"dependent": given.dependent[[0, 0]]}, "are 1, and have the dependent dofs"),
     (lambda given: {"dependent": given.dependent + 50}, "no numbers from 0"),
     (lambda given: {"dependent": given.dependent - 50}, "no numbers from 0"),
     (lambda given: {"dependent": given.dependent * 1.0}, "no numbers from 0"),
     (lambda given: {"values": np.ones((1, 1))}, r"right-hand sides of the shape \(1, 1\)"),
     (lambda given: {"values": np.full(1, np.nan)}, "no finite numbers"),
     (lambda given: {"values": np.ones(1) * 1j}, "no finite numbers"),
     (lambda given: {"rows": given.rows * np.nan}, "no finite numbers"),
     (lambda given: {"dependent": np.array([24])}, "one determines is not in it")],
)  # fmt: skip
def test_broken_equations_of_a_user_are_refused(changes, why):
    with pytest.raises(SceneError, match=why):
        hhr.FullOrderModel(pressed((Lever(0.0, changes),)))


@needs("mortar")
@pytest.mark.parametrize("dim", [2, 3])
def test_a_constant_stress_passes_a_tie_exactly(dim):
    """The patch test of mortar methods, with nodes of both surfaces on imposed planes."""
    full = hhr.FullOrderModel(tied(dim))
    assert "constraints: Tie" in str(full.scene)
    stress = full.solve(0.8).stress()[:, dim - 1]
    assert stress == pytest.approx(np.full(stress.size, -0.8), rel=1e-9)


@needs("mortar", "moduli")
def test_tied_bodies_in_all_models():
    """With the modulus of one of them as a parameter, too."""
    stiff = hhr.Body(1, young="E", poisson=0.3), hhr.Body(2, young=100.0, poisson=0.3)
    for scene in (
        tied(wall=1.0005),
        tied(wall=1.0005, box={"p": (0.1, 1.0), "E": (50.0, 200.0)}, bodies=stiff),
    ):
        training = hhr.train(scene, hhr.Sobol(16), held_out=4)
        full = training.full_order
        for model in (training.condense(), training.build()):
            for point in ([0.35, 80.0], [0.9, 160.0]):
                point = point[: len(scene.parameters.names)]
                exact, found = full.solve(point), model.solve(point)
                size = np.abs(exact.displacement()).max()
                assert exact.forces().max() > 0
                assert found.displacement() == pytest.approx(exact.displacement(), abs=2e-4 * size)
                assert found.forces() == pytest.approx(
                    exact.forces(), abs=1e-3 * exact.forces().max()
                )


@needs("mortar", "friction")
def test_a_tied_body_that_rubs():
    """Increments of friction in full and condensed models agree."""
    scene = tied(wall=1.0005)
    rough = replace(scene, contacts=(replace(scene.contacts[0], friction=0.3),))
    full = hhr.FullOrderModel(rough)
    path = [(float(k), [p]) for k, p in enumerate((0.1, 0.5, 1.0, 0.6))]
    one, other = (model.march(path).answers[-1] for model in (full, hhr.condense(full)))
    assert one.forces() == pytest.approx(other.forces(), abs=1e-9)
    assert one.displacement() == pytest.approx(other.displacement(), abs=1e-10)


@needs("mortar", "nonmatching")
def test_a_tie_of_nodes_and_mistakes():
    scene = tied(pairing=hhr.NodeToSurface)
    u = hhr.FullOrderModel(scene).solve(1.0).displacement()
    mean = hhr.FullOrderModel(tied()).solve(1.0).displacement()
    assert u == pytest.approx(mean, abs=0.02 * np.abs(mean).max())
    with pytest.raises(SceneError, match="needs two surfaces"):
        hhr.Tie(3, 3)
    for pairing in ("mortar", hhr.NodeToNode):  # which needs a normal
        with pytest.raises(SceneError, match="must make a pairing of slave and master"):
            hhr.Tie(3, 4, pairing=pairing)
    with pytest.raises(SceneError, match="must be an integer or a name"):
        hhr.Tie(None, 3)


def imposed_twice(young, box):
    """The lid pressed down by a displacement, and the same by equations of one term: scenes with
    one answer.
    """
    outputs = hhr.ElasticEnergy("energy"), hhr.ContactForce("wall", 0, (1.0, 0.0))
    one = pressed(
        (), (hhr.Displacement(LEFT, 0), hhr.Displacement(TOP, 1, "-0.01 * p")), (), outputs=outputs
    )
    other = pressed((hhr.Equation(((TOP, 1, 1.0),), "-0.01 * p"),), loads=(), outputs=outputs)
    bodies = (hhr.Body(block.SOLID, young, 0.3),)
    return [replace(scene, parameters=space(**box), bodies=bodies) for scene in (one, other)]


@needs("stress", "moduli")
@pytest.mark.parametrize("young", [100.0, "E", "E + 20 * p"])
def test_values_of_equations_act_as_imposed_displacements(young):
    """In condensed models with moduli as parameters, and in the elastic energy, 0.01 p imposed
    either way.
    """
    box = {"p": (0.1, 1.0)} | ({} if young == 100.0 else {"E": (50.0, 200.0)})
    known, found = (hhr.FullOrderModel(scene) for scene in imposed_twice(young, box))
    point = [0.9, 190.0][: len(box)]
    exact = known.solve(point)
    assert exact.forces().max() > 0
    for model in (found, hhr.condense(found, fields=True)):
        answer = model.solve(point)
        assert answer.forces() == pytest.approx(exact.forces(), abs=1e-6 * exact.forces().max())
        assert answer.displacement() == pytest.approx(exact.displacement(), abs=1e-8)
        assert answer.outputs()["energy"] == pytest.approx(exact.outputs()["energy"], rel=1e-6)


@needs("stress", "moduli", "exact_errors")
@pytest.mark.parametrize("young", [100.0, "E"])
def test_relative_estimates_are_over_the_energy_of_the_exact_answer(young):
    """|u|_K is twice the elastic energy, rooted, also of what values of equations strain."""
    box = {"p": (0.1, 1.0)} | ({} if young == 100.0 else {"E": (50.0, 200.0)})
    mean = hhr.MeanMotion(TOP, 0, "0.004 * p")
    scene = imposed_twice(young, box)[1]
    scene = replace(
        scene, constraints=(*scene.constraints, mean), loads=(hhr.Pressure(RIGHT, "p"),)
    )
    training = hhr.train(scene, hhr.Sobol(8), held_out=2)
    point = [0.9, 190.0][: len(box)]
    size = np.sqrt(2 * training.full_order.solve(point).outputs()["energy"])
    estimate = training.build().solve(point).estimate()
    # sizes of relative bounds are lower bounds of that of the exact answer, a little below where K
    # varies
    assert (
        size * (0.98 if young == "E" else 1 - 1e-6)
        <= estimate.primal / estimate.primal_relative
        <= size * (1 + 1e-6)
    )


def test_a_rigid_lid_on_a_hinge():
    """One edge of a rigid lid is held: it turns about it, as by equations, u_z = x times that of
    the far corner.
    """
    lid, foot = block.side(2, upper=True), block.side(2, upper=False)
    far = hhr.Nodes.near((1.0, 0.0, 1.0))
    line = {
        x: hhr.Nodes(lambda y, x=x: np.isclose(y[0], x) & np.isclose(y[2], 1))
        for x in (0.0, 0.5, 1.0)
    }
    rest = hhr.Nodes(lambda y: np.isclose(y[0], 1) & np.isclose(y[2], 1) & (y[1] > 0.1))
    plain = block_scene(
        "hinge",
        {"p": (0.1, 1.0)},
        lower=(0, 0, 0),
        upper=(1, 1, 1),
        cells=(2, 2, 2),
        hypothesis="solid",
        contacts=(hhr.Obstacle(RIGHT, (1, 0, 0), 1.001),),
        displacements=(*hhr.Displacement.clamp(foot, 3), *hhr.Displacement.clamp(line[0.0], 3)),
        loads=(hhr.Pressure(lid, "p"),),
    )
    rigid = replace(plain, constraints=(hhr.RigidMotion(lid),))
    sides = tuple(hhr.Displacement(line[x], k) for x in (0.5, 1.0) for k in (0, 1))
    turns = tuple(
        hhr.Equation(((place, 2, 1.0), (far, 2, -x)))
        for place, x in ((line[0.5], 0.5), (rest, 1.0))
    )
    by_hand = replace(plain, displacements=(*plain.displacements, *sides), constraints=turns)
    found, known = (
        hhr.FullOrderModel(scene).solve(0.7).displacement() for scene in (rigid, by_hand)
    )
    assert np.abs(known).max() > 0.1
    assert found == pytest.approx(known, abs=1e-11)


def test_a_rigid_lid_that_is_pressed_down_by_a_displacement():
    """Its equations between imposed displacements hold to round-off, which breaks nothing."""
    down = hhr.Displacement(TOP, 1, "-0.01 * p")
    scene = pressed(
        (hhr.RigidMotion(TOP),), (hhr.Displacement(LEFT, 0), down), loads=(), cells=(7, 3)
    )
    full = hhr.FullOrderModel(scene)
    lid = np.isclose(full.problem.points[:, 1], 1.0)
    assert full.solve(0.7).displacement().reshape(-1, 2)[lid] == pytest.approx(
        np.tile([0.0, -0.007], (8, 1)), abs=1e-15
    )


@needs("mortar")
def test_a_tie_across_a_gap_is_said():
    """A lever of 0.1 passes on no moment."""
    with pytest.warns(PairingWarning, match="up to 0.1 apart: what they pass on has no moment"):
        hhr.FullOrderModel(tied(apart=0.1))


@pytest.mark.parametrize(
    "given, why",
    [
        ({"shift": "a"}, "must be a tuple"),
        ({"shift": (np.nan, 0.0)}, "must be finite"),
        ({"shift": (1.0, 0.0, 0.0)}, "as many numbers"),
        ({"shift": (1.0,)}, "as many numbers"),
        ({"axis": 1.0}, "0, 1 or 2"),
        ({"axis": 0}, "in the plane axis = 2"),
    ],
)
def test_mistakes_of_periodic_surfaces(given, why):
    with pytest.raises(SceneError, match=why):
        hhr.FullOrderModel(pressed((hhr.Periodic(RIGHT, LEFT, **given),)))


def test_a_meridian_does_not_turn_in_its_plane():
    with pytest.raises(SceneError, match="leave out the angle"):
        hhr.FullOrderModel(
            replace(pressed((hhr.Periodic(LEFT, BOTTOM, np.pi / 2),)), hypothesis="axisymmetric")
        )


@needs("second_order")
def test_a_mean_of_second_order_is_that_of_a_pressure():
    """Its force is a traction of the surface: with lateral strain free all over, stress is the same
    everywhere.
    """
    mean = replace(
        pressed((hhr.MeanMotion(TOP, 1, "-0.01 * p"),), loads=()),
        order=2,
        hypothesis="plane_stress",
    )
    answer = hhr.FullOrderModel(replace(mean, contacts=(hhr.Obstacle(RIGHT, (1, 0), 9.0),))).solve(
        0.5
    )
    assert answer.stress()[:, 1] == pytest.approx(-0.5 + 0 * answer.stress()[:, 1], rel=1e-9)


@pytest.mark.parametrize("friction", [None, pytest.param(0.3, marks=needs("friction"))])
def test_contact_up_to_the_edges_of_a_periodic_surface(friction):
    """A strip pushed onto a plane: σ = λ + 2 μ times the strain, at its edges too, whose two nodes
    bear one force.
    """
    held = hhr.Displacement(hhr.Nodes.near((0.0, 0.0)), 0), hhr.Displacement(BOTTOM, 1, "0.002 * p")
    more = {} if friction is None else {"friction": friction}
    strip = replace(
        pressed((hhr.Periodic(RIGHT, LEFT, shift=(1.0, 0.0)),), loads=()),
        displacements=held,
        contacts=(hhr.Obstacle(TOP, (0, 1), 1.0005, **more),),
        outputs=(hhr.ContactForce("force", 0, (0.0, 1.0)),),
    )
    expected = 100 * 0.7 / (1.3 * 0.4) * (0.002 * 0.9 - 0.0005)
    full = hhr.FullOrderModel(strip)
    assert full.problem.contact_areas[:4] == pytest.approx(np.full(4, 0.25))
    for model in (full,) if friction else models(strip):
        answer = model.solve(0.9)
        assert answer.pressure()[:4] == pytest.approx(np.full(4, expected), rel=1e-6)
        assert abs(answer.outputs()["force"]) == pytest.approx(expected, rel=1e-6)


def test_a_cell_that_repeats_in_both_directions():
    """Corners follow by two surfaces: forces on nodes that are one node in the lattice are in
    balance together.
    """
    along, up = (
        hhr.Periodic(RIGHT, LEFT, shift=(1.0, 0.0)),
        hhr.Periodic(TOP, BOTTOM, shift=(0.0, 1.0)),
    )
    force = hhr.NodalForce(hhr.Nodes.near((0.5, 0.25)), (1.0, 0.4), "p")
    held = hhr.Displacement.clamp(hhr.Nodes.near((0.0, 0.0)), 2)
    plain = replace(pressed(loads=(force,)), contacts=(hhr.Obstacle(TOP, (0, 1), 9.0),))
    free = hhr.FullOrderModel(plain).problem
    place = np.round(free.points, 9) % 1.0
    cell = np.unique(place, axis=0, return_inverse=True)[1].ravel()
    forced = int(np.linalg.norm(free.points - (0.5, 0.25), axis=1).argmin())
    for constraints in ((along, up), (up, along)):
        lattice = replace(plain, displacements=held, constraints=constraints)
        u = hhr.FullOrderModel(lattice).solve(0.5).displacement().reshape(-1, 2)
        assert np.ptp(u, axis=0).min() > 1e-4
        assert all(
            u[cell == k] == pytest.approx(np.tile(u[cell == k][0], ((cell == k).sum(), 1)))
            for k in cell
        )
        left = (free.stiffness @ u.ravel()).reshape(-1, 2)
        left[forced] -= 0.5 * np.array([1.0, 0.4])
        sums = np.stack([np.bincount(cell, left[:, k]) for k in range(2)], axis=1)
        corner = cell[np.linalg.norm(free.points, axis=1).argmin()]
        assert np.delete(sums, corner, axis=0) == pytest.approx(0.0, abs=1e-12)
        assert sums[corner] == pytest.approx([-0.5, -0.2])


@dataclass(frozen=True)
class Unconstrained:
    """A user-defined basis that does not know of constraints: modes and a few other fields of free
    dofs.
    """

    pod: hhr.Pod

    def modes(self, problem, snapshots):
        """Columns of the POD and random ones."""
        modes = self.pod.modes(problem, snapshots)
        others = (
            np.random.default_rng(0).normal(size=(len(modes), 3))
            * problem.prolongation.movable[:, None]
        )
        return np.linalg.qr(np.hstack([modes, others]))[0]


COARSE = hhr.Recipe(hhr.Pod(1e-4), enrichment=hhr.Enrich(1.5), bound=False).as_it_is()


@pytest.mark.parametrize(
    ("constraint", "recipe", "order"),
    [
        pytest.param("equation", COARSE, None, id="enrichment"),
        pytest.param(
            "equation", replace(COARSE, basis=Unconstrained(hhr.Pod(1e-4))), None, id="own basis"
        ),
        pytest.param("serendipity", COARSE, 2, marks=needs("second_order"), id="serendipity"),
    ],
)
def test_bases_keep_constraints_that_contact_nodes_lead(constraint, recipe, order):
    """Answers keep the equations, and K~ is V^T K V with K of the same mesh without them.

    A node inside moves half as far as one of the contact surface, or middles of sides as the mean
    of their ends.
    """
    inner, corner = hhr.Nodes.near((0.5, 0.5)), hhr.Nodes.near((1.0, 0.5))
    lever = hhr.Equation(((inner, 0, 1.0), (corner, 0, -0.5)))
    constraints = (lever,) if constraint == "equation" else (hhr.Serendipity(),)
    near = {"contacts": (hhr.Obstacle(RIGHT, (1, 0), 1.0005),), "order": order}
    scene = replace(pressed(constraints), **near)
    training = hhr.train(scene, hhr.Sobol(8), held_out=2)
    model = training.build(
        replace(recipe, nodes=(hhr.Zone(lambda problem: np.arange(len(problem.points))),))
    )
    follow = training.full_order.problem.prolongation
    assert follow.dependent.any()
    field = model.solve(0.93).displacement()
    assert np.abs(follow.broken(field[:, None])).max() < 1e-12 * np.abs(field).max()
    if constraint == "equation":
        points = training.full_order.problem.points
        x = [
            2 * int(np.linalg.norm(points - place, axis=1).argmin())
            for place in ((0.5, 0.5), (1.0, 0.5))
        ]
        assert field[x[0]] == pytest.approx(0.5 * field[x[1]], rel=1e-10)
    basis = model.fields.basis
    plain = hhr.FullOrderModel(replace(pressed(), **near)).problem.stiffness
    assert basis.T @ (plain @ basis) == pytest.approx(model.problem.stiffness, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("p", [0.3, 0.9])
def test_the_energy_is_that_of_the_mesh_without_the_equation(p):
    """J = U^T K U / 2 - F^T U, (1.10), with K and F of the same mesh, where the equation has a
    value.
    """
    one, other = hhr.Nodes.near((0.0, 1.0)), hhr.Nodes.near((1.0, 1.0))
    full = hhr.FullOrderModel(
        pressed((hhr.Equation(((one, 1, 1.0), (other, 1, -2.0)), "0.02 * p"),))
    )
    plain = hhr.FullOrderModel(pressed()).problem
    field = full.solve(p).displacement()
    known = 0.5 * field @ (plain.stiffness @ field) - (plain.external @ plain.theta(p)) @ field
    assert energy_minimum(full.problem, field, full.problem.theta(p)) == pytest.approx(
        known, rel=1e-12
    )
    given = full.problem.doubled_energy(
        field - full.problem.lifts @ full.problem.theta(p), full.problem.theta(p)
    )
    assert given == pytest.approx(field @ (plain.stiffness @ field), rel=1e-12)


def test_round_off_does_not_choose_the_dof_that_an_equation_determines():
    """Coefficients of a mean are equal up to round-off, which shapes and processors change."""
    sizes = np.array([[0.25, 0.25 + 1e-16, 0.1], [0.1, 0.25 - 1e-13, 0.25], [0.0, 0.1, 0.2]])
    assert first_largest(sizes).tolist() == [0, 1, 2]
