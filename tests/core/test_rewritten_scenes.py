"""What can be written in two ways has one meaning: scenes are drawn at random and rewritten, and
answers compared.

No expected value of ours: a scene written differently is the same problem, so that its answers are
the same numbers but for the order of sums. 1e-11 of the largest is a hundred times what was seen;
of Profile and Circle see there.
"""

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import pytest
from dolfinx import mesh as dmesh
from hypothesis import given, settings
from hypothesis import strategies as st
from mpi4py import MPI
from needs import needs, present

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import block
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side, two_blocks

SAME = 1e-11
NAMES = ("push", "pull", "lowered")
LEFT, RIGHT = block.side(0, False), block.side(0, True)
FLOOR, LID = block.side(1, False), block.side(1, True)
HALVES = (71, 72)
"""Tags of the two halves of the floor, in rewritten scenes."""


@dataclass(frozen=True)
class Drawn:
    """Numbers of a scene of one block above a floor, and how they are written.

    Attributes:
        numbers: of the scene, by name.
        ways: rewritings that are in force, of WAYS.
    """

    numbers: dict[str, float] = field(default_factory=dict)
    ways: frozenset[str] = frozenset()

    def amplitude(self, name, constant, factor):
        """``constant + factor * name`` as an Amplitude, or as a formula."""
        if "formula" in self.ways:
            return f"{constant!r} + {factor!r} * {name}"
        return hhr.Amplitude(constant, {name: factor})

    def obstacle(self, surface):
        """The floor, once with a normal of length one.

        ``scaled`` multiplies the whole equation of the plane.
        """
        gap = self.numbers["gap"]
        if "profile" in self.ways:
            return hhr.Profile(surface, ((-3.0, -gap), (5.0, -gap)), smooth=False)
        if "circle" in self.ways:
            return hhr.Circle(surface, (0.0, -gap - RADIUS), RADIUS)
        length = self.numbers["length"] if "scaled" in self.ways else 1.0
        return hhr.Obstacle(surface, normal=(0.0, -length), offset=length * gap)

    def contacts(self):
        """One pair, or one for each half of the floor."""
        return tuple(map(self.obstacle, HALVES if "halves" in self.ways else (FLOOR,)))

    def opening(self):
        """The floor goes down by ``lowered``: openings of all pairs."""
        pairs = range(len(self.contacts()))
        return tuple(
            hhr.Opening(k, hhr.Amplitude(0.0, {"lowered": self.numbers["down"]})) for k in pairs
        )

    def loads(self):
        """A pressure on the lid and a traction at the right end.

        ``split`` gives the pressure in two parts.
        """
        constant, factor = self.numbers["constant"], self.numbers["pressure"]
        parts = (0.25, 0.75) if "split" in self.ways else (1.0,)
        pressures = (
            hhr.Pressure(LID, self.amplitude("push", share * constant, share * factor))
            for share in parts
        )
        aside = hhr.Traction(
            RIGHT, (0.0, 1.0), self.amplitude("pull", 0.0, self.numbers["traction"])
        )
        both = (*pressures, aside)
        return both[::-1] if "order" in self.ways else both

    def scene(self):
        """The scene as it is written."""
        names = NAMES[::-1] if "order" in self.ways else NAMES
        young = self.numbers["young"]
        return hhr.Scene(
            name="drawn",
            geometry=partial(geometry, halves="halves" in self.ways),
            hypothesis="plane_strain",
            bodies=(
                hhr.Body(
                    block.SOLID,
                    young=f"{young!r}" if "formula" in self.ways else young,
                    poisson=0.3,
                ),
            ),
            contacts=self.contacts(),
            parameters=hhr.ParameterSpace(names, (0.0,) * 3, (1.0,) * 3),
            displacements=(
                hhr.Displacement(LEFT, 0, self.amplitude("pull", 0.0, self.numbers["moved"])),
                hhr.Displacement(LEFT, 1),
            ),
            loads=self.loads(),
            openings=self.opening(),
        )


RADIUS = 1e6
"""Of a circle beside a block of length 2: its sagitta, 2e-6 of the length, is 1e-4 of the smallest
gap.
"""


def geometry(comm, halves=False):
    """A block of 2 x 1, whose floor has one tag, or one for each half."""
    mesh, cells, facets = block.block(comm, lower=(0.0, 0.0), upper=(2.0, 1.0), cells=(8, 3))
    if not halves:
        return mesh, cells, facets
    middles = dmesh.compute_midpoints(mesh, 1, facets.indices)
    tags = np.where(middles[:, 0] < 1.0, *HALVES)
    values = np.where(facets.values == FLOOR, tags, facets.values).astype(np.int32)
    return mesh, cells, dmesh.meshtags(mesh, 1, facets.indices, values)


def drawn_numbers(seed):
    """Numbers of a scene in which contact opens and closes in the box."""
    random = np.random.default_rng(seed)
    low_and_high = {
        "young": (5.0, 20.0),
        "gap": (0.02, 0.05),
        "length": (0.2, 5.0),
        "pressure": (0.3, 0.8),
        "constant": (0.0, 0.1),
        "traction": (-0.2, 0.3),
        "moved": (-0.02, 0.02),
        "down": (0.0, 0.03),
    }
    return {name: float(random.uniform(*ends)) for name, ends in low_and_high.items()}


def solved(scene, point):
    """Displacement, and contact forces in the order of the first coordinate."""
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    answer = full.solve(point)
    order = np.argsort(full.problem.contact_points[:, 0], kind="stable")
    return answer.displacement(), np.asarray(answer.forces())[order]


def differences(first, second):
    """Largest differences of displacement and forces, each over the largest of the first."""
    pairs = zip(first, second, strict=True)
    return [np.abs(a - b).max() / max(np.abs(a).max(), 1e-300) for a, b in pairs]


OF_PLUGINS = {"formula": ("elasticity",), "halves": ("shared_nodes",)}
WAYS = ("formula", "scaled", "split", "order", "halves")
POINTS = st.fixed_dictionaries({name: st.floats(0.0, 1.0) for name in NAMES})


@needs("elasticity", "shared_nodes")
@given(st.integers(0, 10_000), st.sets(st.sampled_from(WAYS), min_size=1), POINTS)
@settings(max_examples=12, derandomize=True)
def test_a_scene_written_in_another_way_has_the_same_answers(seed, ways, point):
    first = Drawn(drawn_numbers(seed))
    rewritten = replace(first, ways=frozenset(ways))
    assert max(differences(solved(first.scene(), point), solved(rewritten.scene(), point))) < SAME


@pytest.mark.parametrize(
    "way", [pytest.param(way, marks=needs(*OF_PLUGINS.get(way, ()))) for way in WAYS]
)
def test_each_way_alone_where_contact_is_partly_open(way):
    first = Drawn(drawn_numbers(3))
    point = {"push": 0.6, "pull": 0.8, "lowered": 0.4}
    known = solved(first.scene(), point)
    assert 0 < np.count_nonzero(known[1]) < len(known[1])
    assert (
        max(differences(known, solved(replace(first, ways=frozenset([way])).scene(), point))) < SAME
    )


@needs("obstacles")
@pytest.mark.parametrize(("way", "bar"), [("profile", SAME), ("circle", 3e-4)])
def test_a_curve_without_a_bend_is_the_plane(way, bar):
    """The circle's sagitta of 2e-6 moves forces by up to 1.4e-4 of the largest."""
    first = Drawn(drawn_numbers(3))
    for point in (
        {"push": 0.6, "pull": 0.8, "lowered": 0.4},
        {"push": 0.9, "pull": 0.1, "lowered": 0.0},
    ):
        known = solved(first.scene(), point)
        assert (
            max(differences(known, solved(replace(first, ways=frozenset([way])).scene(), point)))
            < bar
        )


def tables(point):
    """One point in all forms that have names, in an order that is not that of the parameters."""
    turned = dict(sorted(point.items()))
    assert tuple(turned) != NAMES
    yield "dict", turned
    if present("tables"):
        pandas = pytest.importorskip("pandas")
        yield "series", pandas.Series(turned)


@needs("tables")
def test_names_count_and_not_places():
    """For one point and for many, in full and reduced models, with outputs and gradients."""
    pandas = pytest.importorskip("pandas")
    scene = replace(
        Drawn(drawn_numbers(5)).scene(),
        outputs=(hhr.LargestPressure("peak", 0), hhr.ContactForce("force", 0, (0, 1))),
    )
    model = hhr.condense(scene)
    points = scene.parameters.random(5, seed=2)
    known = model.solve_many(points).outputs()
    frame = pandas.DataFrame(points, columns=list(NAMES))[sorted(NAMES)]
    for columns in (
        frame,
        {name: frame[name].to_numpy() for name in sorted(NAMES)},
        frame.to_dict("records"),
    ):
        for name, values in model.solve_many(columns).outputs().items():
            np.testing.assert_array_equal(values, known[name], err_msg=f"{type(columns)} {name}")
    for row, point in enumerate(points):
        for kind, one in tables(dict(zip(NAMES, point.tolist(), strict=True))):
            answer = model.outputs(one, gradient=True)
            assert answer["peak"] == pytest.approx(known["peak"][row], rel=1e-12, abs=1e-14), kind
            slopes = model.outputs(point, gradient=True).gradient["peak"]
            np.testing.assert_allclose(answer.gradient["peak"], slopes, rtol=1e-12, atol=1e-14)


SPLIT = {side(FIRST, 1, True): (51, 52), side(SECOND, 1, False): (61, 62)}


def parted(comm, cells, split):
    """Two blocks on each other, with one or two tags on both sides of their interface."""
    mesh, bodies, facets = two_blocks(
        comm, first=((0, -1), (2, 0), (cells[0], 2)), second=((0, 0), (2, 1), (cells[1], 2))
    )
    middles = dmesh.compute_midpoints(mesh, 1, facets.indices)
    values = facets.values.copy()
    for tag, ends in SPLIT.items() if split else ():
        chosen = facets.values == tag
        values[chosen] = np.where(middles[chosen, 0] < 1, *ends)
    return mesh, bodies, dmesh.meshtags(mesh, 1, facets.indices, values)


def stacked(pairing, cells, split):
    """The upper block pressed and bent by its lid, on one pair or on two whose slaves share a
    node.
    """
    slaves, masters = (
        SPLIT[tag] if split else (tag,) for tag in (side(SECOND, 1, False), side(FIRST, 1, True))
    )
    sides = [side(SECOND, 0, False), side(SECOND, 1, True)]
    return hhr.Scene(
        name="stacked",
        geometry=partial(parted, cells=cells, split=split),
        hypothesis="plane_strain",
        bodies=(hhr.Body(FIRST, young=1e3, poisson=0.2), hhr.Body(SECOND, young=5e2, poisson=0.3)),
        contacts=tuple(map(pairing, slaves, masters)),
        parameters=hhr.ParameterSpace(("press", "bend"), (0.0, 0.0), (10.0, 10.0)),
        displacements=(
            *hhr.Displacement.clamp(side(FIRST, 1, False), 2),
            hhr.Displacement(sides[0], 0),
        ),
        loads=(
            hhr.Pressure(sides[1], hhr.Amplitude(slopes={"press": 1.0})),
            hhr.Traction(side(SECOND, 0, True), (0.0, 1.0), hhr.Amplitude(slopes={"bend": 1.0})),
        ),
        outputs=tuple(hhr.ContactForce(f"force {k}", k, (0.0, 1.0)) for k in range(len(slaves))),
    )


PAIRINGS = [
    pytest.param(
        lambda s, m: hhr.NodeToNode(s, m, (0, -1)), (8, 8), id="NodeToNode", marks=needs("floating")
    ),
    pytest.param(
        lambda s, m: hhr.NodeToSurface(s, m),
        (6, 8),
        id="NodeToSurface",
        marks=needs("floating", "nonmatching"),
    ),
    pytest.param(
        lambda s, m: hhr.Mortar(s, m), (6, 8), id="Mortar", marks=needs("floating", "mortar")
    ),
]


@needs("shared_nodes")
@pytest.mark.parametrize(("pairing", "cells"), PAIRINGS)
def test_an_interface_stated_as_two_pairs_is_one(pairing, cells):
    """Conditions at the shared node are one, whose force both pairs share: nothing is lost or
    counted twice.
    """
    point = {"press": 6.0, "bend": 4.0}
    known = solved(stacked(pairing, cells, split=False), point)
    halves = stacked(pairing, cells, split=True)
    assert max(differences(known, solved(halves, point))) < 1e-10
    outputs = hhr.FullOrderModel(halves, MPI.COMM_SELF).solve(point).outputs()
    assert sum(outputs[name] for name in outputs) == pytest.approx(known[1].sum(), rel=1e-9)
