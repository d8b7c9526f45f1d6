"""Bad input gets a clear error at the door, with what to do."""

import dataclasses
import re

import hertz_half_discs as demo
import numpy as np
import pytest
import ufl
from made_loads import made, of_form
from needs import needs
from scenes import pressed_block, pressed_pair, slope
from toy_pairing import RoundPunch

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotOfferedError, ParameterError, ReductionError, SceneError
from hhr_dolfinx.geometries import block, two_blocks
from hhr_dolfinx.geometries import hertz_half_discs as geometry
from hhr_dolfinx.reduction.projection import reduced_domain


def changed(**changes):
    return dataclasses.replace(demo.scene(), **changes)


def built(**changes):
    return hhr.FullOrderModel(changed(**changes))


@pytest.mark.parametrize("mu", [np.nan, np.inf, 0.1, 0.5, -0.3])
def test_parameters_outside_the_box(hertz, hertz_reduction, mu):
    for model in (hertz, hertz_reduction):
        with pytest.raises(
            ParameterError, match=r"mu = (.* is outside|\w+ is not finite: give a number inside)"
        ):
            model.solve(mu)


@pytest.mark.parametrize("mu", [[0.2, 0.3], [], {"nu": 0.2}, {"mu": 0.2, "nu": 0.2}])
def test_wrong_parameters(hertz_reduction, mu):
    with pytest.raises(ParameterError, match=r"mu|nu"):
        hertz_reduction.solve(mu)


def test_parameters_by_number_sequence_and_name(hertz_reduction):
    solve = hertz_reduction.solve
    assert np.array_equal(solve(0.2).forces(), solve([0.2]).forces())
    assert np.array_equal(solve(0.2).forces(), solve({"mu": 0.2}).forces())


FLOOR, WALL = hhr.Obstacle(1, (0.0, -1.0), 0.0), hhr.Obstacle(1, (1.0, 0.0), 0.0)
PAIR = hhr.NodeToNode(11, 21, (0.0, 1.0))


def body(**given):
    return hhr.Body(**{"tag": 1, "young": 1.0, "poisson": 0.3} | given)


BODY, FLAT = body(), block.side(1, upper=False)
BLOCK, HIGHER = pressed_block("plane_strain"), slope("height")
TWICE = "contacts 0 and 1 are the same pair"
FACING = hhr.NodeToNode(two_blocks.side(1, 1, True), two_blocks.side(2, 1, False), (0, 1))
UNLIKE = pressed_pair("plane_strain", ((1.0, 0.3), (1.0, 0.3)), matching=False, contacts=(FACING,))
REFUSED = [
    # of a mesh
    (
        lambda: built(contacts=(hhr.NodeToNode(geometry.UPPER_ARC, geometry.LOWER_ARC, (0, 1)),)),
        "do not face each",
    ),
    (
        lambda: built(contacts=(hhr.NodeToNode(geometry.LOWER_ARC, geometry.UPPER_ARC, (0, -1)),)),
        "do not face each",
    ),
    (
        lambda: built(contacts=(hhr.Obstacle(geometry.LOWER_ARC, (0, -1), 0.0),)),
        "do not face each other",
    ),
    (
        lambda: built(contacts=(hhr.Obstacle(99, (0, 1), 0.0),)),
        r"facet tags \[99\] are not in the mesh",
    ),
    (lambda: built(bodies=(body(tag=7),)), r"cell tags \[7\]"),
    (lambda: built(bodies=(body(tag=geometry.LOWER),)), r"\[2\] belong to no body"),
    (lambda: built(displacements=(hhr.Displacement(geometry.LOWER_FLAT, 2),)), "component 2"),
    (lambda: built(contacts=(hhr.NodeToNode(11, 12, (0, 0)),)), "normal"),
    (lambda: built(contacts=(hhr.NodeToNode(11, 12, (0, 1, 0)),)), "must have 2 numbers"),
    (
        lambda: built(displacements=(hhr.Displacement(21, 1, HIGHER),)),
        r"\['height'\], .* parameters are \('mu',\)",
    ),
    (
        lambda: built(displacements=(hhr.Displacement(21, 0), hhr.Displacement(21, 0, 1.0))),
        "different values",
    ),
    (lambda: hhr.FullOrderModel(UNLIKE), r"face each other.*no partner, e\.g\. at \["),
    # on an arc
    (lambda: built(loads=(hhr.PartialPressure(geometry.LOWER_ARC, 1.0, "mu", 0),)), "not straight"),
    # a pair whose nodes are all imposed
    (
        lambda: hhr.FullOrderModel(
            dataclasses.replace(BLOCK, displacements=hhr.Displacement.clamp(FLAT, 2))
        ),
        "empty",
    ),
    # of a scene
    (lambda: changed(hypothesis="plane"), "plane_strain"),
    (lambda: changed(contacts=()), "without contact"),
    (lambda: changed(bodies=()), "body"),
    (lambda: changed(name="two words"), "identifier"),
    (lambda: changed(name=7), "scene name 7 must be an identifier"),
    (
        lambda: changed(geometry="mesh.msh"),
        r"geometry = 'mesh\.msh' must be a function of a communicator",
    ),
    (lambda: changed(parameters=("mu",)), r"parameters = \('mu',\) must be a ParameterSpace"),
    (
        lambda: changed(bodies=(BODY, body(tag=2), body(young=9.0))),
        "bodies 0 and 2 .* the same cell tag 1: .* would add up",
    ),
    (
        lambda: changed(contacts=(PAIR, FLOOR, PAIR)),
        r"contacts 0 and 2 are the same pair of surfaces \(11, 21\)",
    ),
    (lambda: changed(contacts=(PAIR, hhr.NodeToNode(21, 11, (0.0, -2.0)))), TWICE),
    pytest.param(
        lambda: changed(contacts=(PAIR, hhr.DoublePass(21, 11))), TWICE, marks=needs("nonmatching")
    ),
    (
        lambda: changed(contacts=(FLOOR, hhr.Obstacle(1, (0.0, -3.0), 0.5))),
        r"the same pair of surfaces \(1,\)",
    ),
    (
        lambda: changed(contacts=(hhr.NodeToNode(11, 11, (0.0, 1.0)),)),
        "contact 0 pairs surface 11 with itself",
    ),
    (
        lambda: changed(openings=(hhr.Opening(1, 1.0),)),
        "an opening names contact 1, of 1 counted from 0",
    ),
    (
        lambda: changed(
            openings=(hhr.Opening(0, 1.0, True), hhr.Opening(0, 1.0), hhr.Opening(0, 2.0, True))
        ),
        "openings 0 and 2 both overwrite the gaps of contact 0",
    ),
    (
        lambda: changed(loads=(hhr.PartialPressure(1, 1.0, "h"),)),
        r"up to 'h': .* one of the parameters \('mu',\)",
    ),
    *(
        (lambda order=order: changed(order=order), "must be 1 or 2")
        for order in (3, 2.0, True, 0, "2")
    ),
    # materials
    *((lambda young=young: body(young=young), "positive") for young in (0.0, -1.0, np.nan)),
    *((lambda poisson=poisson: body(poisson=poisson), "positive") for poisson in (0.5, np.nan)),
    (lambda: body(young=10**400), "must be positive and finite"),
    (lambda: body(young=np.inf), "body 1: young = inf must be positive and finite"),
    (lambda: body(young="210 GPa"), "young of body 1: the formula '210 GPa' cannot be read"),
    (
        lambda: body(young=hhr.Amplitude(1.0)),
        r"young = Amplitude\(.* must be a number, or a formula of the parameters",
    ),
    (lambda: body(tag=" "), "the tag ' ' of a body must be an integer or a name"),
    (lambda: body(tag=1.0), r"the tag 1\.0 of a body must be an integer"),
    # loads, displacements, openings
    (
        lambda: hhr.Opening(0, "2"),
        r"amplitude '2' of the opening of contact 0 must be a finite number or an Ampl",
    ),
    (
        lambda: hhr.Pressure(1, np.nan),
        "the amplitude nan of the pressure on tag 1 must be a finite number",
    ),
    (lambda: hhr.Traction(1, (0, 1), None), "the amplitude None of the traction on tag 1"),
    (
        lambda: hhr.Opening(0, {"mu": 1.0}),
        "of the opening of contact 0 must be a finite number or an Amplitude",
    ),
    (
        lambda: hhr.Displacement(1, 0, lambda mu: mu),
        "of the displacement on tag 1 must be a finite number or",
    ),
    (
        lambda: hhr.Displacement(1, (0, 1)),
        r"component \(0, 1\) of the displacement on tag 1 .* one Displacement for each",
    ),
    (lambda: hhr.Displacement(1, 0.5), r"component 0\.5 of the displacement on tag 1"),
    (
        lambda: hhr.Traction(1, (0.0, 0.0), 1.0),
        r"the traction \(0\.0, 0\.0\) on tag 1 must be finite and not zero",
    ),
    (lambda: hhr.Traction(1, (0, np.nan), 1.0), "finite"),
    (lambda: hhr.Traction(1, 1.0, 1.0), "the direction of a traction must be a tuple"),
    (
        lambda: hhr.Opening(0.5, 1.0),
        r"contact 0\.5 of an opening must be the place of a pair in Scene\.contacts",
    ),
    (lambda: hhr.Opening(-1, 1.0), "contact -1 of an opening must be the place"),
    (
        lambda: hhr.PartialPressure(1, 1.0, "mu", axis=2),
        "axis 2 of the partial pressure on tag 1 must be 0 or 1",
    ),
    (lambda: hhr.Amplitude("1"), "amplitude '1' .* must be finite numbers"),
    (lambda: hhr.Amplitude(True), "amplitude True .* must be finite numbers"),
    (lambda: hhr.Amplitude(np.nan), "finite"),
    (
        lambda: hhr.Amplitude(0.0, ("mu", 1.0)),
        r"the slopes \('mu', 1\.0\) of an amplitude need a number by param",
    ),
    (lambda: hhr.Amplitude(0.0, {"mu": "1"}), "must be finite numbers"),
    (lambda: slope("mu", np.inf), "finite"),
    (
        lambda: hhr.Obstacle(1, (0, 1), "0"),
        "the offset '0' of the obstacle at surface 1 .*add an Opening",
    ),
    (lambda: hhr.Obstacle(1, (0, 1), np.nan), "finite"),
    # boxes of parameters
    (
        lambda: hhr.ParameterSpace("mu", (0.0,), (1.0,)),
        r"names = 'mu' .* must be a tuple: .* \('mu',\)",
    ),
    (
        lambda: hhr.ParameterSpace(("mu",), 0.0, (1.0,)),
        r"lower = 0\.0 .* must be a tuple: .* \(0\.0,\)",
    ),
    (lambda: hhr.ParameterSpace(("mu",), (0.0,), ("1",)), r"upper = \('1',\) .* must hold numbers"),
    (lambda: hhr.ParameterSpace((1,), (0.0,), (1.0,)), r"names = \(1,\) .* must hold names"),
    (
        lambda: hhr.ParameterSpace(("a", "b", "a"), (0.0,) * 3, (1.0,) * 3),
        r"named twice in \('a', 'b', 'a'\)",
    ),
    (lambda: hhr.ParameterSpace((), (), ()), "parameter"),
    (lambda: hhr.ParameterSpace(("a", "b"), (0,), (1,)), "need one lower and one upper"),
    *(
        (lambda low=low: hhr.ParameterSpace(("a",), (low,), (0.0,)), "must be (incr|finite)")
        for low in (0, 1, np.nan)
    ),
]


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_scenes_and_parts_of_them_that_are_refused(make, message):
    with pytest.raises(SceneError, match=message):
        make()


def test_what_is_listed_twice_with_reason():
    """One surface between two obstacles, and two surfaces that meet in two directions."""
    changed(contacts=(FLOOR, WALL))
    changed(contacts=(PAIR, hhr.NodeToNode(11, 21, (1.0, 0.0))))


@pytest.mark.parametrize(
    ("name", "single", "other"),
    [
        ("bodies", hhr.Body(1, 1.0, 0.3), "a Body"),
        ("contacts", FLOOR, "a contact pair with tags and rows"),
        ("displacements", hhr.Displacement(1, 0), "a Displacement"),
        ("loads", hhr.Pressure(1, 1.0), "a load with terms, such as Pressure"),
        ("openings", hhr.Opening(0, 1.0), "an Opening"),
    ],
)
def test_parts_of_a_scene_are_tuples(name, single, other):
    """A list will do; what stands alone or is something else is named with the remedy."""
    assert getattr(changed(**{name: [single]}), name) == (single,)
    kind = type(single).__name__
    said = rf"Scene\.{name} must be a tuple, and is {kind}.*: write \({kind}\(\.\.\.\),\)"
    with pytest.raises(SceneError, match=said):
        changed(**{name: single})
    for wrong in ("1", kind, type(single), 7):
        with pytest.raises(
            SceneError, match=rf"{name}\[1\] of scene 'hertz_half_discs' is .*: it must be {other}"
        ):
            changed(**{name: (single, wrong)})


def test_numbers_are_constant_amplitudes():
    items = (
        hhr.Displacement(1, 0, 2),
        hhr.Traction(1, [0.0, 1.0], 2.0),
        hhr.Pressure(1, np.float64(2.0)),
    )
    for item in (*items, hhr.PartialPressure(1, 2.0, "mu"), hhr.Opening(0, 2.0)):
        assert item.amplitude == hhr.Amplitude(2.0)


def of_term(amplitude, columns=None):
    return made(
        lambda ask: [hhr.Term(amplitude, np.ones(ask.size) if columns is None else columns)]
    )


@dataclasses.dataclass(frozen=True)
class Curve:
    count: int = 1
    found: tuple = ((0,), (1.0,))

    def __call__(self, point):
        return self.found


LINEAR = "the form of Made.* must be linear in v"


class NoRows(RoundPunch):
    def rows(self, surfaces, dofs):
        return None


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (of_form(lambda v, ds: None), LINEAR + " .*, and is None"),
        (
            of_form(lambda v, ds: ufl.inner(ufl.TrialFunction(v.ufl_function_space()), v) * ds),
            LINEAR,
        ),
        (of_form(lambda v, ds: ufl.inner(v, v) * ds), LINEAR),
        (
            of_term(hhr.Amplitude(1.0), np.full(50, np.nan)),
            "the nodal forces of Made.* are not finite",
        ),
        (made(lambda ask: ask.ds(77)), r"facet tags \[77\] are not in the mesh, which has \[.*21"),
        (made(lambda ask: ask.dx(77)), r"cell tags \[77\] are not in the mesh, which has \[1\]"),
        (made(lambda ask: None), "the terms of Made.* must be a list of Term, and are None"),
        (made(lambda ask: [1.0]), r"the terms of Made.* must be a list of Term, and are \[1\.0\]"),
        (
            of_term(1.0),
            (
                r"the amplitude 1\.0 of Made.* must be an Amplitude, or a frozen dataclass "
                "with a count"
            ),
        ),
        (of_term(lambda point: 1.0), "must be an Amplitude, or a frozen dataclass"),
        (of_term(slope("pull")), r"an amplitude names \['pull'\], the scene's parameters"),
        (
            of_term(hhr.Amplitude(1.0), np.ones(3)),
            r"has 1 amplitudes: its columns must be .* of shape \(50, 1\)",
        ),
        (of_term(Curve(2)), r"has 2 amplitudes: its columns must be .* of shape \(50, 2\)"),
        (of_term(Curve(0)), "the count 0 of Curve.* must be its number of columns"),
        (
            of_term(Curve(1, ((1,), (1.0,)))),
            r"Curve.* must return columns, each once and below its count 1",
        ),
        (of_term(Curve(2, ((0, 0), (1.0, 1.0)))), "must return columns, each once"),
        (of_term(Curve(1, ((0,), (np.nan,)))), "must return columns"),
        (of_term(Curve(1, 1.0)), "must return columns"),
        (
            {"contacts": (NoRows(20, (0.3, -9.0), 1.0),)},
            "the rows of NoRows.* must be ContactRows, and are None",
        ),
        (
            {"contacts": (RoundPunch(20, (0.3, -9.0), 1.0),) * 2},
            "contacts 0 and 1 are the same pair",
        ),
    ],
)
def test_loads_and_pairings_of_a_users_own(changes, message):
    with pytest.raises(SceneError, match=message):
        hhr.FullOrderModel(dataclasses.replace(BLOCK, **changes))


SPACE = hhr.ParameterSpace(("a", "b"), (0.0, 1.0), (1.0, 2.0))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: SPACE.grid([3]),
            r"counts \[3\] of a grid must be 2 positive integers, one for each of \('a', 'b'\)",
        ),
        (lambda: SPACE.grid(3), "counts 3 of a grid must be 2 positive integers"),
        (lambda: SPACE.grid([3, 0]), "must be 2 positive integers"),
        (lambda: SPACE.grid([3, 2.0]), "must be 2 positive integers"),
        (
            lambda: SPACE.random(0, 1),
            "0 random points from seed 1: the count must be a positive integer",
        ),
        (lambda: SPACE.random(5, -1), "5 random points from seed -1: .* not negative"),
        (lambda: SPACE.point("text"), "expected 2 numbers for .* got 'text'"),
        (
            lambda: SPACE.points([0.5, 1.5]),
            r"points have the shape \(2,\): give one row per point and one column",
        ),
        (lambda: SPACE.points([[0.5], [0.6]]), r"points have the shape \(2, 1\)"),
        (lambda: SPACE.points(np.zeros((0, 2))), r"points have the shape \(0, 2\)"),
        (lambda: SPACE.points([[0.5, 1.5], [0.5]]), "a table of points needs numbers in columns"),
        (lambda: SPACE.points([[0.5, 1.5], [0.5, 2.5]]), r"b = 2\.5 is outside \[1, 2\]"),
    ],
)
def test_grids_and_tables_of_points(make, message):
    with pytest.raises(ParameterError, match=message):
        make()


def test_points_of_one_parameter_need_no_column(hertz):
    flat, table = (hhr.compute_snapshots(hertz, points) for points in ([0.2, 0.4], [[0.2], [0.4]]))
    assert flat.points.shape == (2, 1) and np.array_equal(flat.displacements, table.displacements)
    with pytest.raises(
        ParameterError, match=r"shape \(1, 2\): .* one column for each of \('mu',\)"
    ):
        hhr.compute_snapshots(hertz, [[0.2, 0.4]])


def test_a_rid_without_contact(hertz):
    with pytest.raises(ReductionError, match="no contact condition"):
        reduced_domain(hertz.problem, np.abs(hertz.problem.points[:, [1]]).argmax(axis=0))


def test_a_rid_that_no_load_reaches(hertz, hertz_snapshots):
    with pytest.raises(ReductionError, match="the zone"):
        hhr.build(
            hertz,
            hertz_snapshots,
            hhr.Recipe.thesis(1e-4, nodes=(hhr.Deim(), hhr.Zone(lambda problem: []))),
        )


def test_meshes_without_sense():
    with pytest.raises(ValueError, match="even"):
        geometry.half_discs(None, arc_segments=7)
    with pytest.raises(ValueError, match="radius"):
        geometry.half_discs(None, radius=-1.0)


@pytest.mark.parametrize(
    ("make", "why"),
    [
        (lambda: hhr.Body("a", E=1.0, poisson=0.3), "Body has no argument 'E': is 'young' meant?"),
        (
            lambda: hhr.Body("a", young=1.0, nu=0.3),
            "Body has no argument 'nu': is 'poisson' meant?",
        ),
        (
            lambda: hhr.Obstacle(1, (0, -1), ofset=1.0),
            "Obstacle has no argument 'ofset': is 'offset' meant?",
        ),
        (lambda: hhr.Pressure(1, p=2.0), "Pressure has no argument 'p': is 'amplitude' meant?"),
        (
            lambda: hhr.ContactForce("f", 0, (0, 1), contacts=1),
            "ContactForce has no argument 'contacts': is 'contact'",
        ),
        (
            lambda: hhr.ParameterSpace(("a",), (0,), (1,), unit="m"),
            "no argument 'unit'. Its arguments are names, low",
        ),
        (lambda: changed(load=()), "Scene has no argument 'load': is 'loads' meant?"),
        pytest.param(
            lambda: hhr.Plasticity(sigma_y=300.0),
            "Plasticity has no argument 'sigma_y': is 'yield_stress' meant?",
            marks=needs("inelastic"),
        ),
        pytest.param(
            lambda: hhr.Coulomb(mu=0.3),
            "Coulomb .* is 'coefficient' meant?",
            marks=needs("friction"),
        ),
    ],
)
def test_an_unknown_argument_is_refused_with_the_right_name(make, why):
    with pytest.raises(SceneError, match=re.escape(why).replace(r"\.\*", ".*")):
        make()


def test_parameters_as_arguments_are_refused_with_the_mapping():
    full = hhr.FullOrderModel(pressed_block("plane_strain", cells=2))
    for query in (full.solve, full.outputs):
        with pytest.raises(ParameterError, match=r"solve\(\{'push': 0\.05\}\)"):
            query(push=0.05)
        with pytest.raises(ParameterError, match=r"solve\(\{'push': \.\.\.\}\)"):
            query()
    with pytest.raises(NotOfferedError, match="solve has no argument speed here"):
        full.solve(0.05, speed=1.0)
