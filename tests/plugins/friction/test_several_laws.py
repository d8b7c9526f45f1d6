"""Friction next to a gasket and to wear, each on its pair, solved together.

Expected values by projections alone.
"""

from dataclasses import replace

import my_contact_law
import numpy as np
import pytest
from mpi4py import MPI
from my_contact_law import Wear
from my_gasket import Gasket, Gaskets, GasketStep
from needs import needs
from projected_forces import Reference, cubic, projected
from stacked_pairs import PATH, stacked, with_plugins

import hhr_dolfinx as hhr
from hhr_dolfinx.contact.law import UNILATERAL
from hhr_dolfinx.formulas import Scalar
from hhr_dolfinx.plugins.contact_laws.interface import Interface, Range
from hhr_dolfinx.plugins.contact_laws.ranges import Ranges
from hhr_dolfinx.plugins.friction.laws import Friction, FrictionLaw, SlipState
from hhr_dolfinx.plugins.friction.range import FrictionStep
from hhr_dolfinx.reduction.kinds import kind_of

RATE = 0.05


@pytest.fixture(autouse=True)
def plugins(monkeypatch):
    with_plugins(monkeypatch)


def full_of(*laws, **changes):
    return hhr.FullOrderModel(stacked(*laws, **changes), MPI.COMM_SELF)


def ranges_of(model):
    """Ranges by the plug-in of their law."""
    return {part.law.plugin: part for part in model.law.ranges}


def reference_of(model, mu, linear, third):
    """The same laws on the S of a condensed model, by projections."""
    parts = ranges_of(model)
    friction, gasket, wear = (parts[name] for name in ("friction", "my_gasket", "my_contact_law"))
    rows = friction.rows
    return Reference(
        model.eliminated.responses.schur,
        rows[friction.law.normal],
        rows[friction.law.tangential],
        mu,
        gasket.rows,
        (linear * gasket.law.area, third * gasket.law.area),
        wear.rows,
        wear.law.rate,
    )


def stiffness_of(model):
    """Pressure per closure of the gaskets that is as stiff as the bodies."""
    gasket = ranges_of(model)["my_gasket"]
    return (
        np.diag(np.linalg.inv(model.eliminated.responses.schur))[gasket.rows] / gasket.law.area
    ).mean()


RATIOS = [1e-6, 1.0, 1e6]
MANY = [(10.0**power, mu) for power in range(-6, 7) for mu in (0.1, 0.3, 0.6)]


def check_against_projections(ratio, mu):
    unit = stiffness_of(hhr.condense(full_of(hhr.Coulomb(mu), Gasket(1.0, 1.0), Wear(RATE))))
    linear, third = ratio * unit, ratio * unit / 0.01**2
    model = hhr.condense(full_of(hhr.Coulomb(mu), Gasket(linear, third), Wear(RATE)))
    reference = reference_of(model, mu, linear, third)
    contact_at = model.contacts()
    slipped = 0
    for (before, _), (time, point), answer in zip(
        PATH, PATH[1:], model.march(PATH).answers, strict=False
    ):
        expected, _ = reference.increment(contact_at(np.array(point)).free_slack, time - before)
        for part in model.law.ranges:
            own = np.abs(expected[part.rows]).max()
            assert own > 0 and np.abs(answer.multipliers - expected)[part.rows].max() <= 1e-10 * own
        for found, known in (
            (answer.slip.position, reference.position),
            (answer.memory["closure"], reference.closure),
            (answer.worn, reference.worn),
        ):
            np.testing.assert_allclose(found, known, rtol=1e-9, atol=1e-12)
        slipped += answer.slip.counted()["contacts that slip"]
        assert answer.iterations <= 12 and not answer.cycled
    assert slipped


@pytest.mark.parametrize("ratio", RATIOS)
def test_three_laws_are_those_of_projections(ratio):
    """A gasket softer than the bodies, as stiff, and stiffer: forces of each pair over their own
    largest.
    """
    check_against_projections(ratio, 0.3)


@pytest.mark.parametrize(("ratio", "mu"), MANY)
def test_three_laws_are_those_of_projections_of_all_stiffnesses(ratio, mu):
    check_against_projections(ratio, mu)


def friction_of(contacts, mu):
    """Friction of the plane on rows of which the first are pressures, and then the tangential
    ones.
    """
    none, own = np.zeros(0, dtype=np.int64), np.arange(contacts)
    law = FrictionLaw(Scalar(str(mu), ("a",)), None)
    return Friction(
        own,
        np.ones(contacts),
        np.zeros(contacts),
        0 * own,
        contacts + own,
        own,
        np.tile([1.0, 0.0], (contacts, 1)),
        (law,),
        none,
        none,
        none,
    )


def gaskets_of(constants):
    """Gaskets by their constants, (2, k)."""
    laws = tuple(
        (Scalar(repr(float(one)), ("a",)), Scalar(repr(float(three)), ("a",)))
        for one, three in constants.T
    )
    return Gaskets(np.ones(len(laws)), np.arange(len(laws)), laws)


def check_random(count, seed):
    """Random S, loads, coefficients up to 0.6 and gaskets from 1e-3 to 1e6 times as stiff as the
    bodies.
    """
    random = np.random.default_rng(seed)
    failed = []
    for number in range(count):
        contacts, gaskets = random.integers(1, 9, 2)
        size = 2 * contacts + gaskets
        root = random.standard_normal((size, size))
        schur = root @ root.T / size + 10.0 ** random.uniform(-3, 0) * np.eye(size)
        free = random.standard_normal(size)
        mu = random.uniform(0.05, 0.6)
        constants = 10.0 ** random.uniform(-3, 6, (2, gaskets)) / np.diag(schur)[-gaskets:]
        law = friction_of(contacts, mu)
        rows = np.arange(2 * contacts), np.arange(2 * contacts, size)
        point = np.zeros(1)
        steps = (
            FrictionStep(law, SlipState.at_rest(law, np.ones(law.normal.size), point), point),
            GasketStep(gaskets_of(constants), point),
        )
        found = Ranges(schur, rows, np.zeros(size)).solve(free, steps, np.zeros(size))
        c = 1.0 / np.linalg.eigvalsh(schur)[-1]
        y = found.forces - c * (free + schur @ found.forces)
        expected = np.maximum(y, 0.0)
        expected[rows[1]], _ = cubic(y[rows[1]], c, *constants)
        bound = mu * expected[law.normal]
        expected[law.tangential] = np.clip(y[law.tangential], -bound, bound)
        off = np.abs(found.forces - expected).max() / max(np.abs(expected).max(), 1e-12)
        if found.status.name != "CONVERGED" or not off <= 1e-9:
            failed.append((number, found.status, off))
    assert not failed


def test_none_of_two_hundred_random_problems_fails():
    check_random(200, 0)


def test_none_of_five_thousand_random_problems_fails():
    check_random(5000, 1)


@pytest.mark.parametrize("ratio", [1e-3, 1.0, 1e3])
def test_friction_over_a_gasket_on_one_pair(ratio):
    """The pressure that bounds friction is that of the gasket; on an S of the package."""
    model = hhr.condense(full_of(hhr.Coulomb(0.3), Gasket(1.0, 1.0), Wear(RATE)))
    friction = ranges_of(model)["friction"]
    schur = model.eliminated.responses.schur[np.ix_(friction.rows, friction.rows)]
    contacts = friction.law.normal.size
    constants = np.tile(
        ratio / np.diag(schur)[:contacts].mean() * np.array([[1.0], [1e4]]), contacts
    )
    law = friction_of(contacts, 0.3)
    pressing, tangential = np.arange(contacts), np.arange(contacts, 2 * contacts)
    solver = Ranges(schur, [np.arange(2 * contacts)], np.zeros(2 * contacts))
    for seed in range(3):
        free = 0.02 * np.random.default_rng(seed).standard_normal(2 * contacts)
        free[pressing] = -np.abs(free[pressing])
        point = np.zeros(1)
        step = FrictionStep(
            law,
            SlipState.at_rest(law, np.ones(law.normal.size), point),
            point,
            under=GasketStep(gaskets_of(constants), point),
        )
        found = solver.solve(free, [step], np.zeros(2 * contacts))

        def projection(y, c):
            forces = np.zeros(len(y))
            forces[pressing], _ = cubic(y[pressing], c, *constants)
            bound = 0.3 * forces[pressing]
            forces[tangential] = np.clip(y[tangential], -bound, bound)
            return forces

        expected, _ = projected(schur, free, projection)
        assert np.abs(found.forces - expected).max() <= 1e-10 * np.abs(expected).max()
        assert "closure" in step.after(found.forces, found.slack, found.active)


def ranged(model):
    """A condensed model with friction alone, whose friction is a range next to unilateral contact
    if there is any.
    """
    rows = np.sort(np.concatenate([model.law.normal, model.law.tangential]))
    rest = np.setdiff1d(np.arange(model.own_conditions), rows)
    parts = (Range(model.law.within(rows), rows), Range(UNILATERAL, rest))
    return model.changed(law=Interface(parts if rest.size else parts[:1]))


def test_friction_alone_keeps_its_own_solver_and_is_the_same_as_a_range():
    model = hhr.condense(full_of(hhr.Coulomb(0.3)))
    assert type(model.law) is Friction
    one, other = (each.march(PATH).answers for each in (model, ranged(model)))
    for own, found in zip(one, other, strict=True):
        assert (
            np.abs(own.multipliers - found.multipliers).max()
            <= 1e-12 * np.abs(own.multipliers).max()
        )
        assert np.abs(own.slip.work - found.slip.work).max() <= 1e-12 * own.slip.work.max()
        np.testing.assert_array_equal(own.active, found.active)
    scene = stacked(hhr.Coulomb(0.3))
    model = hhr.condense(
        hhr.FullOrderModel(replace(scene, contacts=scene.contacts[:1]), MPI.COMM_SELF)
    )
    settings = hhr.MarchSettings(time_tolerance=1e-2)
    one, other = (each.march(PATH, settings) for each in (model, ranged(model)))
    assert max(answer.parts for answer in one.answers) > 2
    assert [answer.parts for answer in one.answers] == [answer.parts for answer in other.answers]
    assert one.answers[-1].time_error == pytest.approx(other.answers[-1].time_error, rel=1e-9)


def test_full_and_condensed_models_files_and_stores_agree(tmp_path):
    full = full_of(hhr.Coulomb(0.3), Gasket(1.0, 50.0), Wear(RATE))
    condensed = hhr.condense(full)
    hhr.save_model(tmp_path / "model.npz", condensed)
    known = [Gaskets, my_contact_law.Wearing]
    loaded = hhr.load_model(tmp_path / "model.npz", known=known)
    exact = full.march(PATH).answers
    for own, there, kept in zip(
        exact, condensed.march(PATH).answers, loaded.march(PATH).answers, strict=True
    ):
        assert np.abs(own.forces() - there.forces()).max() <= 1e-12 * np.abs(own.forces()).max()
        np.testing.assert_array_equal(there.forces(), kept.forces())
        for name, array in condensed.law.stored(there.memory).items():
            np.testing.assert_array_equal(array, condensed.law.stored(kept.memory)[name])
    stores = (hhr.SnapshotStore(tmp_path, full) for _ in range(2))
    first, second = (
        hhr.compute_snapshots(full, [PATH], store=store).histories[0] for store in stores
    )
    for own, other in zip(first.answers, second.answers, strict=True):
        np.testing.assert_array_equal(own.memory["closure"], other.memory["closure"])
        np.testing.assert_array_equal(own.slip.position, other.slip.position)
    further = full.march(PATH, known=list(second.answers[:2]))
    np.testing.assert_array_equal(further.answers[-1].multipliers, first.answers[-1].multipliers)


NAMES = ("push", "slide", "mu", "k1", "k3")
BOX = hhr.ParameterSpace(NAMES, (0.0, -0.2, 0.1, 0.1, 1.0), (0.3, 0.2, 0.8, 5.0, 200.0))
SMOOTH = [
    (0.0, (0.001, 0.0)),
    (1.0, (0.02, 0.0)),
    (2.0, (0.02, 0.004)),
    (3.5, (0.015, -0.002)),
    (4.0, (0.04, 0.01)),
]
CONSTANTS = np.array([0.3, 1.0, 50.0])


def test_gradients_of_all_increments_are_those_of_differences():
    model = hhr.condense(full_of(hhr.Coulomb("mu"), Gasket("k1", "k3"), Wear(RATE), parameters=BOX))

    def path(changes):
        return [(time, np.append(point, CONSTANTS) + changes) for time, point in SMOOTH]

    def forces(changes):
        answers = model.march(path(changes), hhr.MarchSettings(outside="ignore")).answers
        return np.concatenate([answer.multipliers for answer in answers])

    answers = model.march(path(0.0), hhr.MarchSettings(gradient=True)).answers
    assert sum(answer.slip.counted()["contacts that slip"] for answer in answers) > 4
    assert not any(answer.gradient.one_sided for answer in answers)
    found = np.concatenate([answer.gradient.multipliers for answer in answers])
    for number, step in enumerate(1e-5 * np.array([0.01, 0.01, 0.3, 1.0, 50.0])):
        shift = step * np.eye(5)[number]
        expected = (forces(shift) - forces(-shift)) / (2 * step)
        assert np.abs(found[:, number] - expected).max() <= 1e-6 * np.abs(expected).max()


LEAVING = [
    *SMOOTH[:4],
    (4.5, (0.0003, 0.0)),
    (5.0, (0.0005, 0.001)),
    (6.0, (0.03, 0.002)),
    (7.0, (0.028, 0.004)),
]
"""The upper block is lifted until worn contacts open, and comes back."""


@pytest.mark.parametrize(
    "laws", [(hhr.Coulomb(0.3), Wear(RATE)), (Wear(RATE), None, hhr.Coulomb(0.3))]
)
def test_gradients_of_wear_beside_friction_as_contacts_open_and_close(laws):
    """Over differences of all steps, whose statuses are those of the path itself: no kink is
    between.
    """
    model = hhr.condense(full_of(*laws, gap=0.002))

    def ends(change):
        path = [(time, np.add(point, change)) for time, point in LEAVING]
        return model.march(path, hhr.MarchSettings(outside="ignore")).answers

    answers = model.march(LEAVING, hhr.MarchSettings(gradient=True, outside="ignore")).answers
    (wearing,) = (part.rows for part in model.law.ranges if part.law.plugin == "my_contact_law")
    touching = np.array([answer.forces()[wearing] > 0 for answer in answers])
    reopened = touching[:-1] & ~touching[1:]
    assert reopened.any() and (~touching[:-1] & touching[1:])[reopened.any(axis=1).argmax() :].any()
    found = np.array([answer.gradient.multipliers for answer in answers])
    expected, step = np.zeros_like(found), 1e-7
    for number in range(2):
        both = [ends(sign * step * np.eye(2)[number]) for sign in (1, -1)]
        for moved in both:
            assert all(
                np.array_equal(one.active, other.active)
                for one, other in zip(moved, answers, strict=True)
            )
        expected[..., number] = np.subtract(
            *([answer.multipliers for answer in one] for one in both)
        ) / (2 * step)
    assert np.abs(found - expected).max() <= 1e-6 * np.abs(expected).max()


def check_laws(full, answer, mu, constants, position=0.0):
    """Equilibrium of an answer, and its forces are the projection of themselves less its own
    slacks.
    """
    residuals = kind_of(full).residuals(answer)
    assert residuals.equilibrium <= 1e-10
    parts = ranges_of(full)
    friction, gasket = parts["friction"], parts["my_gasket"]
    theta = full.problem.amplitudes(answer.parameter)
    slack = full.problem.gaps @ theta - full.problem.contact @ (
        answer.displacement() - full.problem.lifts @ theta
    )
    normal, tangential = friction.rows[friction.law.normal], friction.rows[friction.law.tangential]
    slack[tangential] -= position
    forces = answer.forces()
    c = 0.1 * np.abs(forces).max() / np.abs(slack).max()
    y = forces - c * slack
    expected = np.maximum(y, 0.0)
    expected[gasket.rows], _ = cubic(
        y[gasket.rows], c, *(value * gasket.law.area for value in constants)
    )
    bound = mu * expected[normal]
    expected[tangential] = np.clip(y[tangential], -bound, bound)
    assert np.abs(forces - expected).max() <= 1e-9 * np.abs(forces).max()
    return np.array([forces[normal].sum(), forces[gasket.rows].sum(), forces[tangential].sum()])


HELD = [
    (0.0, (0.001, 0.0)),
    (1.0, (0.02, 0.0)),
    (2.0, (0.02, 0.001)),
    (3.5, (0.01, -0.001)),
    (4.0, (0.04, 0.001)),
]


@needs("floating")
@pytest.mark.parametrize(("linear", "third"), [(1.0, 50.0), (1e-3, 1.0), (1e4, 1e6)])
def test_bodies_that_contact_alone_holds(linear, third):
    """The lower block lies on the gasket and bears the upper one, which rubs on it: balance by
    hand, and the laws.
    """
    scene = stacked(hhr.Coulomb(0.3), Gasket(linear, third))
    scene = replace(scene, displacements=scene.displacements[2:], contacts=scene.contacts[:2])
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    exact = full.march(HELD).answers
    position = 0.0
    for answer, small in zip(exact, hhr.condense(full).march(HELD).answers, strict=True):
        pressed, borne, sheared = check_laws(full, answer, 0.3, (linear, third), position)
        assert pressed == pytest.approx(borne, rel=1e-9) and abs(sheared) <= 1e-9 * pressed
        assert (
            np.abs(answer.forces() - small.forces()).max() <= 1e-8 * np.abs(answer.forces()).max()
        )
        position = answer.slip.position
    found = full.march(HELD, hhr.MarchSettings(gradient=True)).answers[-1].gradient.multipliers
    for number in range(2):
        steps = 1e-6 * np.eye(2)[number]
        paths = [[(time, np.add(point, sign * steps)) for time, point in HELD] for sign in (1, -1)]
        ends = [
            full.march(path, hhr.MarchSettings(outside="ignore")).answers[-1].multipliers
            for path in paths
        ]
        expected = (ends[0] - ends[1]) / 2e-6
        assert np.abs(found[:, number] - expected).max() <= 1e-5 * np.abs(expected).max() + 1e-7


@needs("floating")
def test_motions_that_nothing_determines_are_said():
    """The lower block may slide on a gasket as long as nothing rubs on it, away from a wall."""
    scene = stacked(None, Gasket(1.0, 50.0))
    scene = replace(scene, displacements=scene.displacements[2:])
    with pytest.warns(hhr.errors.UndeterminedWarning):
        answer = hhr.FullOrderModel(scene, MPI.COMM_SELF).solve((0.02, 0.0))
    assert answer.undetermined is not None and answer.undetermined.shape[1] == 1


OUTPUTS = (
    hhr.DissipatedWork("work", 0), hhr.LargestSlip("slip", 0), hhr.SlipArea("slipping", 0),
    hhr.StickArea("sticking", 0),
    hhr.FrictionForce("force", 0, direction=(1.0, 0.0)), hhr.LargestWear("wear", 0, constant=2.0),
)  # fmt: skip


def test_outputs_of_friction_read_its_range(tmp_path):
    """They are those of friction alone beside a gasket and wear that do not touch.

    And the work is that of forces.
    """
    one, other = (
        full_of(hhr.Coulomb(0.3), *laws, gap=1.0, outputs=OUTPUTS)
        for laws in ((), (Gasket(1.0), Wear(0.0)))
    )
    assert type(one.law) is Friction and isinstance(other.law, Interface)
    models = one, other, hhr.condense(other)
    for answers in zip(*(model.march(PATH).answers for model in models), strict=True):
        expected, *found = (
            [answer.outputs()[output.name] for output in OUTPUTS] for answer in answers
        )
        for values in found:
            np.testing.assert_allclose(values, expected, rtol=1e-9, atol=1e-12)
    assert expected[0] > 0 and expected[1] > 0
    with pytest.raises(hhr.errors.SceneError, match="contact 1 has no friction"):
        full_of(hhr.Coulomb(0.3), Gasket(1.0), outputs=(hhr.DissipatedWork("work", 1),)).outputs(
            (0.02, 0.0)
        )
    assert other.law.of("friction").normal.tolist() == one.law.normal.tolist()


def test_uniqueness_is_that_of_friction_on_the_whole_s():
    full = full_of(hhr.Coulomb(0.3))
    alone = full.coupling((0.02, 0.0))
    both = full_of(hhr.Coulomb(0.3), Gasket(1.0), Wear(RATE)).coupling((0.02, 0.0))
    assert both == pytest.approx(alone, rel=1e-9) and 0 < alone
    assert full_of(None, Gasket(1.0), Wear(RATE)).uniqueness((0.02, 0.0)) == "one answer"


def test_surfaces_that_slide_far_are_warned_of():
    far = [(0.0, (0.02, 0.0)), (1.0, (0.02, 0.0)), (2.0, (0.02, 0.2))]
    model = hhr.condense(full_of(hhr.Coulomb(0.05), Gasket(1.0), cells=8))
    with pytest.warns(hhr.errors.FarSlidingWarning, match="has slid by"):
        model.march(far)


def test_steps_are_cut_by_the_errors_of_each_range():
    """A gasket a million times softer than the bodies counts by its own forces, and so does the
    wear.
    """
    model = hhr.condense(full_of(hhr.Coulomb(0.3), Gasket(1e-6, 1e-4), Wear(0.2)))
    fine, coarse = (
        model.march(PATH, hhr.MarchSettings(time_tolerance=tolerance)) for tolerance in (2e-3, 3e-2)
    )
    assert max(answer.parts for answer in coarse.answers) > 2
    for part in model.law.ranges:
        off, size = 0.0, 0.0
        for one, other in zip(coarse.answers, fine.answers, strict=True):
            off = max(off, np.linalg.norm((one.multipliers - other.multipliers)[part.rows]))
            size = max(size, np.linalg.norm(other.multipliers[part.rows]))
        assert off <= 2.0 * coarse.answers[-1].time_error * size


@needs("inelastic")
def test_inelastic_bodies_wear_by_the_seconds_of_their_steps():
    """Plastic blocks: the curve of the gasket, the cone of friction, and depths by backward Euler,
    by hand.

    In full and condensed models, whose modes and cubature leave out 1e-6.
    """
    from hhr_dolfinx.plugins.inelastic.condense_flow import CorrectionSettings

    scene = stacked(hhr.Coulomb(0.3), Gasket(1.0, 50.0), Wear(RATE), cells=2)
    plastic = tuple(replace(body, law=hhr.Plasticity(0.03, 0.5)) for body in scene.bodies)
    full = hhr.FullOrderModel(replace(scene, bodies=plastic), MPI.COMM_SELF)
    parts = ranges_of(full)
    friction, gasket, wear = (parts[name] for name in ("friction", "my_gasket", "my_contact_law"))
    tight = hhr.MarchSettings(
        **dict.fromkeys(("relative_force", "relative_stress", "floor_stress"), 1e-9)
    )
    history = full.march(PATH[:3], tight)
    settings = CorrectionSettings(modes=1e-6, cubature=1e-6, trust=None)
    condensed = hhr.build(full, hhr.SnapshotSet.of_histories([history]), settings)
    every = [answer.forces() for answer in history.answers]
    for model in (full, condensed):
        worn = 0.0
        answers = model.march(PATH[:3], tight).answers
        for (before, _), (time, _), answer, exact in zip(
            PATH, PATH[1:3], answers, every, strict=False
        ):
            forces = answer.forces()
            np.testing.assert_allclose(forces, exact, atol=1e-6 * np.abs(every).max())
            worn = (
                worn
                + RATE / full.problem.contact_areas[wear.rows] * (time - before) * forces[wear.rows]
            )
            np.testing.assert_allclose(answer.worn, worn, rtol=1e-9)
            c = answer.memory["closure"]
            np.testing.assert_allclose(
                forces[gasket.rows], gasket.law.area * (c + 50.0 * c**3), rtol=1e-9, atol=1e-12
            )
            bound = 0.3 * forces[friction.rows[friction.law.normal]]
            assert (np.abs(forces[friction.rows[friction.law.tangential]]) <= bound + 1e-12).all()
            assert answer.memory["gauss"].state.cumulated.max() > 0
        assert worn.max() > 0 and answer.slip.counted()["contacts that slip"]
    assert max(answer.iterations for answer in answers) <= 6


@needs("moduli")
def test_moduli_may_be_parameters():
    space = hhr.ParameterSpace(("push", "slide", "young"), (0.0, -0.2, 1.0), (0.3, 0.2, 4.0))
    scene = stacked(hhr.Coulomb(0.3), Gasket(1.0, 50.0), Wear(RATE), parameters=space)
    scene = replace(scene, bodies=(hhr.Body(1, "young", 0.3), scene.bodies[1]))
    path = [(time, (*point, 3.0)) for time, point in PATH]
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    fixed = replace(
        scene, bodies=(hhr.Body(1, 3.0, 0.3), scene.bodies[1]), parameters=stacked().parameters
    )
    expected = hhr.FullOrderModel(fixed, MPI.COMM_SELF).march(PATH).answers
    for model in (full, hhr.condense(full)):
        for one, other in zip(expected, model.march(path).answers, strict=True):
            assert np.abs(one.forces() - other.forces()).max() <= 1e-9 * np.abs(one.forces()).max()


@needs("conformance")
@pytest.mark.parametrize("law", [hhr.Coulomb(0.3), hhr.Tresca(0.01), hhr.Tresca(0.1)])
def test_friction_keeps_the_contract_of_laws(law):
    """At the end of its path the contact is open: forces of round-off are no scale for a
    residual.
    """
    from hhr_dolfinx.testing import check_contact_law

    check_contact_law(law)
