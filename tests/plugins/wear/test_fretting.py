"""Wear along the slip of pairs with friction: a pad that is drawn to and fro."""

import dataclasses
import time

import numpy as np
import pytest
from mpi4py import MPI
from needs import needs
from scenes import pair_scene, slope

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotOfferedError, SceneError
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side, two_blocks

pytestmark = [needs("friction")]
CONSTANT = 1e-6
LOAD = 0.5
AWAY = 0.02
FRICTION = 0.1


def bowed(comm):
    """The lower face of the upper block bulges by .002."""

    def warp(points, tag):
        warped = points.copy()
        bulge = 0.008 * (points[:, 0] - 0.5) ** 2 * (2 - points[:, 1])
        warped[:, 1] += (tag == SECOND) * bulge
        return warped

    return two_blocks(
        comm,
        warp=warp,
        first=((0.0, 0.0), (1.0, 1.0), (8, 4)),
        second=((0.0, 1.0), (1.0, 2.0), (8, 4)),
    )


def pad(cycles=1.0, law=None, geometry=bowed):
    """A block under a pressure, whose base is drawn aside on a block that is held."""
    faces = side(FIRST, 1, True), side(SECOND, 1, False)
    wears = hhr.ArchardWear(CONSTANT, along_slip=True, cycles=cycles) if law is None else law
    sizes = ((0.0, 0.0), (1.0, 1.0), (8, 4)), ((0.0, 1.0), (1.0, 2.0), (8, 4))
    top = side(SECOND, 1, True)
    return pair_scene(
        "fretting",
        {"press": (0.0, 1.0), "aside": (-0.05, 0.05)},
        *sizes,
        hypothesis="plane_strain",
        bodies=((100.0, 0.3), (100.0, 0.3)),
        geometry=geometry,
        contacts=(hhr.NodeToNode(*faces, (0.0, 1.0), friction=FRICTION, law=wears),),
        displacements=(
            *hhr.Displacement.clamp(side(FIRST, 1, False), 2),
            hhr.Displacement(top, 0, slope("aside")),
        ),
        loads=(hhr.Pressure(top, slope("press")),),
        outputs=(hhr.WornVolume("volume", 0), hhr.LargestPressure("peak", 0)),
    )


def cycles_of(count, away=AWAY):
    """Pressed, then so many times to one side, to the other, and back."""
    ways = [*(1, -1) * count, 0]
    points = [(0.0, 0.0), (LOAD, 0.0), *((LOAD, away * way) for way in ways)]
    return [(float(k), point) for k, point in enumerate(points)]


def test_the_depth_is_that_of_pressure_along_the_slip():
    """Each node loses constant · ∫ p ds, of which the gap of the next increments knows."""
    model = hhr.condense(pad(cycles=1e3))
    answers = model.march(cycles_of(4)).answers
    for answer in answers:
        worn = answer.memory["worn_depth"]
        np.testing.assert_allclose(worn, 1e3 * CONSTANT * answer.slip.wear, rtol=1e-12)
    last, before = answers[-1], answers[-2]
    assert last.outputs()["volume"] > before.outputs()["volume"] > 0
    exact = hhr.FullOrderModel(pad(cycles=1e3), MPI.COMM_SELF).march(cycles_of(4)).answers[-1]
    np.testing.assert_allclose(last.memory["worn_depth"], exact.memory["worn_depth"], rtol=1e-8)


def test_the_volume_is_archards_of_the_load_and_the_way():
    """Drawn far the pad slips by the motion of its top less what it shears: V = k F s."""
    flat = pad(geometry=lambda comm: two_blocks(
        comm,
        first=((0.0, 0.0), (1.0, 1.0), (8, 4)),
        second=((0.0, 1.0), (1.0, 2.0), (8, 4)),
    ))  # fmt: skip
    answers = hhr.condense(flat).march(cycles_of(2, away=0.05)).answers
    volumes = [answer.outputs()["volume"] for answer in answers]
    # from one end to the other at full slip: shear is the same at both, of the other sign
    slip = answers[2].slip.path - answers[1].slip.path
    assert slip.min() > 0.05
    force = LOAD
    weighted = (answers[3].slip.wear - answers[2].slip.wear).sum()
    assert weighted > 0
    way = (volumes[3] - volumes[2]) / (CONSTANT * force)
    sheared = 2 * FRICTION * LOAD * shear_compliance(flat)
    assert way == pytest.approx(2 * 0.05 - sheared, rel=2e-2)


def shear_compliance(scene):
    """Mean slip of the base over the shear force: both blocks, stuck, by the model."""
    stuck = dataclasses.replace(
        scene, contacts=(dataclasses.replace(scene.contacts[0], friction=1e3, law=None),)
    )
    stuck = dataclasses.replace(
        stuck, outputs=(hhr.Reaction("shear", side(SECOND, 1, True), (1.0, 0.0)),)
    )
    answers = hhr.condense(stuck).march(
        [(0.0, (0.0, 0.0)), (1.0, (LOAD, 0.0)), (2.0, (LOAD, 1e-4))]
    )
    shears = [answer.outputs()["shear"] for answer in answers.answers]
    return 1e-4 / abs(shears[1] - shears[0])


@pytest.mark.slow
def test_cycles_in_blocks_end_as_cycles_one_by_one():
    """1000 cycles, in blocks of 1, 10 and 100: volume of a stroke and peak within 2 per cent, from
    the first whole stroke to the last.
    """
    ends = []
    for block in (1, 10, 100):
        law = hhr.ArchardWear(300 * CONSTANT, along_slip=True, cycles=float(block))
        count = 1000 // block
        answers = hhr.condense(pad(law=law)).march(cycles_of(count)).answers
        first, last = (answers[k].outputs() for k in (1, -2))
        stroke = (last["volume"] - first["volume"]) / (2 * count - 1) / block
        ends.append([stroke, last["peak"]])
    assert ends[1] == pytest.approx(ends[0], rel=0.02)
    assert ends[2] == pytest.approx(ends[0], rel=0.02)


@pytest.mark.slow
def test_a_million_cycles_of_a_pad():
    """In blocks of 2000, in less than ten minutes: its volume is that of load and way, and the
    pressure on its middle, which bulged, goes to the rim.
    """
    began = time.perf_counter()
    law = hhr.ArchardWear(CONSTANT, along_slip=True, cycles=2000.0)
    model = hhr.condense(pad(law=law))
    answers = model.march(cycles_of(500)).answers
    assert time.perf_counter() - began < 600
    volume = answers[-2].outputs()["volume"] - answers[1].outputs()["volume"]
    way = 999 * (2 * AWAY - 2 * FRICTION * LOAD * shear_compliance(pad()))
    assert volume == pytest.approx(CONSTANT * 2000 * LOAD * way, rel=0.05)
    middle = [answer.slip.pressure[4] for answer in (answers[0], answers[-1])]
    assert middle[1] < 0.9 * middle[0]


@pytest.mark.parametrize(("law", "said"), [
    ({"along_slip": True, "speed": 2.0}, "one of both"),
    ({"cycles": 10.0}, "one of both"),
    ({"along_slip": True, "cycles": -1.0}, "cycles"),
])  # fmt: skip
def test_mistakes_are_named(law, said):
    with pytest.raises(SceneError, match=said):
        hhr.ArchardWear(CONSTANT, **law)


def test_it_needs_friction_and_has_no_derivatives():
    scene = pad()
    bare = dataclasses.replace(scene.contacts[0], friction=None)
    with pytest.raises(SceneError, match="has no friction"):
        hhr.condense(dataclasses.replace(scene, contacts=(bare,)))
    with pytest.raises(NotOfferedError, match="along the slip"):
        hhr.condense(scene).march(cycles_of(1), hhr.MarchSettings(gradient=True))


@needs("sliding")
def test_pairs_that_slide_by_any_length_are_refused():
    scene = pad()
    pair = scene.contacts[0]
    surfaces = hhr.NodeToSurface(pair.first, pair.second, friction=0.1, law=pair.law)
    sliding = dataclasses.replace(scene, contacts=(surfaces,), outputs=())
    with pytest.raises(NotOfferedError, match="along the slip"):
        hhr.slide(sliding)


def test_gaps_of_worn_pairs_under_friction_are_not_read_alone():
    read = (hhr.GapAt("gap", 0, (0.5, 1.0)),)
    with pytest.raises(SceneError, match="without what is worn"):
        dataclasses.replace(pad(), outputs=read)
