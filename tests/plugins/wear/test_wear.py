"""Archard's wear: volumes and worn-in pressures in closed form, long increments, other laws."""

import dataclasses

import numpy as np
import pytest
from mpi4py import MPI
from needs import needs
from scenes import pair_scene, slope

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side, two_blocks
from hhr_dolfinx.testing import check_contact_law

RATE = 0.02
READ = (
    hhr.WornVolume("volume", 0),
    hhr.WornDepth("depth", 0),
    hhr.LargestPressure("peak", 0),
    hhr.ContactForce("force", 0, (0.0, 1.0)),
)


def bowed(comm):
    def warp(points, tag):
        moved = points.copy()
        moved[:, 1] += (tag == SECOND) * 0.1 * (points[:, 0] - 0.5) ** 2 * (2 - points[:, 1])
        return moved

    return two_blocks(
        comm,
        warp=warp,
        first=((0.0, 0.0), (1.0, 1.0), (8, 4)),
        second=((0.0, 1.0), (1.0, 2.0), (8, 4)),
    )


def blocks(law=None, load=True, **others):
    """A bowed block on a flat one, pressed by a pressure on soft springs, or moved."""
    faces = side(FIRST, 1, True), side(SECOND, 1, False)
    top = side(SECOND, 1, True)
    held = [*hhr.Displacement.clamp(side(FIRST, 1, False), 2), hhr.Displacement(top, 0)]
    given = {
        "hypothesis": "plane_strain",
        "bodies": ((3.0, 0.3), (5.0, 0.2)),
        "contacts": (hhr.NodeToNode(*faces, (0.0, 1.0), law=law or hhr.ArchardWear(RATE)),),
        "displacements": (*held,)
        if load
        else (*held, hhr.Displacement(top, 1, slope("press", -1.0))),
        "loads": (hhr.Pressure(top, slope("press")),) if load else (),
        "outputs": READ,
        "geometry": bowed,
    }
    sizes = ((0.0, 0.0), (1.0, 1.0), (8, 4)), ((0.0, 1.0), (1.0, 2.0), (8, 4))
    return pair_scene("worn", {"press": (0.0, 0.05)}, *sizes, **given | others)


def history(model, steps, seconds, press=0.04):
    path = [(seconds * k / steps, (press if k else 0.0,)) for k in range(steps + 1)]
    return model.march(path).answers


@needs("floating")
def test_the_volume_is_archards_and_the_pressure_wears_in():
    """V = k F t whatever the pressure, to round-off; in the end it is uniform, F / A."""
    model = hhr.condense(blocks())
    answers = history(model, 60, 6000.0)
    for k in (0, 10, 59):
        found = answers[k].outputs()
        assert found["force"] == pytest.approx(-0.04, rel=1e-9)
        assert found["volume"] == pytest.approx(RATE * 0.04 * 100.0 * (k + 1), rel=1e-9)
    new = history(hhr.condense(blocks(hhr.ArchardWear(0.0))), 1, 1.0)[-1].outputs()["peak"]
    worn = answers[-1].outputs()["peak"]
    assert new > 1.5 * 0.04 and worn == pytest.approx(0.04, rel=1e-3)


@needs("floating")
def test_long_increments_are_those_of_short_ones():
    """Increments of 1, 10 and 100 cycles end within 2 per cent, in depth and pressure."""
    model = hhr.condense(blocks())
    short, long, longest = (
        history(model, steps, 1000.0)[-1].outputs() for steps in (1000, 100, 10)
    )
    for name in ("volume", "depth", "peak"):
        assert long[name] == pytest.approx(short[name], rel=0.002), name
        assert longest[name] == pytest.approx(short[name], rel=0.02), name


@needs("floating")
def test_a_worn_gap_is_open_when_the_load_is_gone():
    full = hhr.FullOrderModel(blocks(load=False))
    model = hhr.condense(full)
    path = [(0.0, (0.0,)), (100.0, (0.02,)), (100.1, (0.0,))]
    for which in (full, model):
        answers = which.march(path).answers
        worn = answers[0].outputs()
        assert worn["depth"] > 1e-3 and worn["peak"] > 0
        gone = answers[1]
        assert not gone.forces().any() and gone.outputs()["depth"] == pytest.approx(worn["depth"])
    exact, found = full.march(path).answers, model.march(path).answers
    for one, other in zip(exact, found, strict=True):
        np.testing.assert_allclose(other.forces(), one.forces(), rtol=0, atol=1e-12)


def test_beside_friction_on_another_pair():
    """Outputs read the pair that they name, whatever its place in the scene."""
    scene = blocks(load=False)
    wall = hhr.Obstacle(side(SECOND, 0, True), normal=(1.0, 0.0), offset=1.001, friction=0.2)
    both = dataclasses.replace(
        scene,
        contacts=(wall, *scene.contacts),
        outputs=tuple(
            dataclasses.replace(output, contact=1) if hasattr(output, "contact") else output
            for output in scene.outputs
        ),
    )
    path = [(0.0, (0.0,)), (100.0, (0.03,)), (300.0, (0.03,))]
    alone = hhr.condense(scene).march(path).answers[-1].outputs()
    beside = hhr.condense(both).march(path).answers[-1].outputs()
    assert beside["depth"] == pytest.approx(alone["depth"], rel=0.05) and beside["depth"] > 1e-3
    wrong = dataclasses.replace(both, outputs=(hhr.WornDepth("depth", 0),))
    with pytest.raises(SceneError, match="contact 0 does not wear"):
        hhr.FullOrderModel(wrong)


def test_gaps_have_what_is_worn():
    """0 where worn surfaces press; open by the depth and the way back when they are drawn apart."""
    full = hhr.FullOrderModel(blocks(load=False))
    pressed, back = full.march([(0.0, (0.0,)), (100.0, (0.02,)), (100.1, (0.0,))]).answers
    closed = pressed.forces() > 0
    np.testing.assert_allclose(pressed.gaps()[closed], 0.0, atol=1e-12)
    assert back.gaps().min() > -1e-12 and back.gaps().max() > pressed.outputs()["depth"] / 2
    with pytest.raises(SceneError, match="without what is worn"):
        hhr.FullOrderModel(
            dataclasses.replace(blocks(load=False), outputs=(hhr.GapAt("gap", 0, (0.5, 1.0)),))
        )


@needs("pages", "plots")
def test_gaps_of_a_model_in_a_file_have_what_is_worn(tmp_path):
    full = hhr.FullOrderModel(blocks(load=False), MPI.COMM_SELF)
    hhr.save_model(tmp_path / "worn.npz", hhr.condense(full, fields=True))
    hhr.scenery_of(full).write(tmp_path / "scenery.npz")
    path = [(0.0, (0.0,)), (100.0, (0.02,)), (100.1, (0.0,))]
    model = hhr.load_model(tmp_path / "worn.npz")
    exact, found = (one.march(path).answers[-1] for one in (full, model))
    np.testing.assert_allclose(found.gaps(), exact.gaps(), rtol=0, atol=1e-12)


@needs("nonmatching")
@pytest.mark.filterwarnings("ignore")  # of the pairing
def test_a_pairing_both_ways_is_refused():
    faces = side(FIRST, 1, True), side(SECOND, 1, False)
    for law in (hhr.ArchardWear(RATE), hhr.SoftContact(stiffness=10.0)):
        both = (hhr.DoublePass(*faces, law=law),)
        with pytest.raises(SceneError, match="goes both ways, and areas"):
            hhr.FullOrderModel(dataclasses.replace(blocks(), contacts=both, outputs=()))


@needs("conformance")
def test_it_keeps_the_contract():
    check_contact_law(hhr.ArchardWear(constant=0.05))


def test_files_keep_what_is_worn(tmp_path):
    model = hhr.condense(blocks(load=False))
    hhr.save_model(tmp_path / "worn.npz", model)
    path = [(0.0, (0.0,)), (100.0, (0.02,)), (250.0, (0.03,))]
    again = hhr.load_model(tmp_path / "worn.npz").march(path).answers[-1]
    assert again.outputs()["depth"] == model.march(path).answers[-1].outputs()["depth"]


@pytest.mark.parametrize("given", [{"constant": -1.0}, {"constant": 1.0, "speed": "v"}])
def test_constants_that_are_none_are_refused(given):
    with pytest.raises(SceneError, match="must be a number that is not negative"):
        hhr.ArchardWear(**given)
