"""What a look at a scene finds: nothing wrong with scenes that are right, exact numbers, and
pictures.
"""

from __future__ import annotations

import importlib
import re
import warnings
from dataclasses import replace
from functools import partial
from unittest.mock import Mock

import hertz_half_discs
import numpy as np
import pytest
import ufl
import your_scene
from needs import needs
from scenes import lying, pressed_block, slope

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ParameterError
from hhr_dolfinx.geometries import block, stacked_blocks
from hhr_dolfinx.pairings.surface import Surface, make_surface
from hhr_dolfinx.plugins.scene_checks.check import check_scene, sag_of
from hhr_dolfinx.plugins.scene_checks.drawing import figure_of_scene
from hhr_dolfinx.plugins.scene_checks.findings import MISTAKE, NOTE, OK, SceneCheck
from hhr_dolfinx.plugins.scene_checks.mesh import depth_inside, worst_cell


@pytest.fixture(autouse=True)
def nothing_is_solved(monkeypatch):
    """A look at a scene must be cheap: no factors, sparse or dense, and no active set."""
    refuse = Mock(side_effect=AssertionError("a look at a scene solves nothing"))
    monkeypatch.setattr("hhr_dolfinx.linear.sparse.FreeCholesky.__init__", refuse)
    monkeypatch.setattr("hhr_dolfinx.full_order.full.FreeCholesky", refuse)
    monkeypatch.setattr("hhr_dolfinx.models.eliminations.elimination.active_set", refuse)
    monkeypatch.setattr("scipy.sparse.linalg.splu", refuse)


def texts(found: SceneCheck, *levels: str) -> list[str]:
    return [finding.text for finding in found.findings if finding.level in levels]


DEMOS = {
    "hertz_half_discs": (),
    "pellet_cladding": (),
    "pellet_materials": (),
    "fuel_rod": ("volume_loads",),
    "sphere_on_block": ("mortar",),
    "contact_patch_test": ("mortar",),
    "your_scene": ("nonmatching",),
    "pellet_cladding_plastic": ("inelastic", "nonmatching"),
    "indentation": ("inelastic", "mortar"),
}
"""Demos of all hypotheses, with bodies that flow, moduli by formulas, and loads of all kinds."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=needs(*plugins)) for name, plugins in DEMOS.items()]
)
def test_scenes_of_the_demos_are_fine(name, tmp_path):
    """Neither mistakes nor notes; and their pictures are drawn without a warning."""
    scene = importlib.import_module(name).scene()
    found = check_scene(scene)
    assert texts(found, NOTE, MISTAKE) == []
    said = texts(found, OK)
    assert sum(text.startswith("body ") for text in said) == len(scene.bodies)
    assert sum(text.startswith("contact ") for text in said) == len(scene.contacts)
    path = tmp_path / "picture.png"
    with warnings.catch_warnings(action="error"):
        figure_of_scene(found).savefig(path)
    assert path.stat().st_size > 10_000


@needs("nonmatching")
def test_the_deck_with_a_set_of_all_nodes_is_fine():
    assert texts(check_scene(your_scene.from_abaqus()), NOTE, MISTAKE) == []


@pytest.mark.parametrize("hypothesis", ["plane_strain", "plane_stress", "axisymmetric", "solid"])
def test_gaps_are_those_of_the_scene(hypothesis):
    found = check_scene(pressed_block(hypothesis, gap=0.01))
    assert texts(found, NOTE, MISTAKE) == []
    (said,) = [text for text in texts(found, OK) if text.startswith("contact 0")]
    assert "gaps from 0.01 to 0.01, facets are flat" in said


@needs("nonmatching")
def test_openings_count_at_the_point_that_is_asked_for():
    """The middle of the box without one; points beyond it are refused."""
    scene = your_scene.scene()
    for point, gap in ((None, 0.35), ({"travel": 0.5, "lowered": 0.0}, 0.2), ((0.05, 0.3), 0.5)):
        said = next(
            text for text in texts(check_scene(scene, point), OK) if text.startswith("contact 1")
        )
        assert float(re.search(r"gaps from (\S+) to", said)[1]) == pytest.approx(gap, abs=1e-9)
    with pytest.raises(ParameterError, match=r"travel = 5 is outside"):
        check_scene(scene, (5.0, 0.0))


def arc(radius: float, count: int) -> Surface:
    """Half a circle of straight facets."""
    angles = np.linspace(0, np.pi, count + 1)
    points = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    facets = np.column_stack([np.arange(count), np.arange(1, count + 1)])
    ones = np.ones(count + 1)
    return make_surface("arc", facets, np.zeros((count, 2)), points, ones, 10 * radius * ones)


@pytest.mark.parametrize("radius", [0.01, 1.0, 300.0])
def test_the_sag_of_an_arc_is_that_of_a_circle(radius):
    """R (1 - cos of half the angle of a facet), which is h^2 / (8 R) up to higher powers of h /
    R.
    """
    assert sag_of(arc(radius, 60)) == pytest.approx(radius * (1 - np.cos(np.pi / 120)), rel=1e-3)


def test_a_flat_side_has_no_sag():
    """Round-off of normals counts for nothing beside a gap."""
    points = np.column_stack([np.linspace(0, 1, 11), np.zeros(11)])
    facets = np.column_stack([np.arange(10), np.arange(1, 11)])
    surface = make_surface("flat", facets, points[:-1] - [0, 0.1], points, np.ones(11), np.ones(11))
    assert sag_of(surface) < 1e-7


CELLS = {
    "unit square": ([[0, 0], [1, 0], [0, 1], [1, 1]], 1.0),
    "stretched rectangle": ([[0, 0], [1000, 0], [0, 1], [1000, 1]], 1.0),
    "sheared square": ([[0, 0], [1, 0], [1, 1], [2, 1]], np.sqrt(0.5)),
    "equilateral triangle": ([[0, 0], [1, 0], [0.5, np.sqrt(0.75)]], np.sqrt(0.75)),
    "right triangle": ([[0, 0], [1, 0], [0, 1]], np.sqrt(0.5)),
    "sliver": ([[0, 0], [1, 0], [0.5, 0.01]], 0.02 / np.sqrt(0.25 + 1e-4) / 2),
    "corner of a cube": ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], 0.5),
    "regular tetrahedron": ([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], np.sqrt(0.5)),
    "brick": ([[x, 5 * y, 70 * z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], 1.0),
}


@pytest.mark.parametrize("name", CELLS)
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e3])
def test_quality_of_known_cells(name, scale):
    """By hand: the volume at the worst corner over the edges that meet there, whatever the size."""
    corners, quality = CELLS[name]
    found, where = worst_cell(scale * np.array([corners], dtype=float))
    assert found == pytest.approx(quality, rel=1e-9)
    assert where == pytest.approx(scale * np.mean(corners, axis=0))


def test_a_body_of_slivers_is_told_of():
    flat = partial(block.block, lower=(0.0, 0.0), upper=(100.0, 2.0), cells=(4, 4), simplices=True)
    (note,) = texts(check_scene(replace(pressed_block("plane_strain"), geometry=flat)), NOTE)
    assert re.search(
        r"body 1 has bad cells, .* at \[.*\] with a quality of 0.02 of 1: .*Mesh it more evenly",
        note,
    )


RESULTANTS = {
    "traction": (lambda top: hhr.Traction(top, (2.0, -3.0), 1.0), [2.0 * 1.5, -3.0 * 1.5]),
    "pressure": (lambda top: hhr.Pressure(top, 7.0), [0.0, -1.5]),
    "weight": (lambda top: hhr.BodyForce(block.SOLID, (0.0, -0.5), 1.0), [0.0, -0.5 * 3.0]),
    "turning": (lambda top: hhr.Centrifugal(block.SOLID, 1.0), [3.0 * 0.75, 3.0 * 1.0]),
    "expansion": (lambda top: hhr.ThermalExpansion(block.SOLID, 1e-5, 100.0), [0.0, 0.0]),
}


OF_BODIES = [
    pytest.param(name, marks=needs("volume_loads")) for name in ("weight", "turning", "expansion")
]


@needs("elasticity")
@pytest.mark.parametrize("name", ["traction", "pressure", *OF_BODIES])
def test_resultants_of_a_block(name):
    """1.5 wide and 2 high: the amplitude is 1, whatever the load says."""
    make, wanted = RESULTANTS[name]
    found = check_scene(
        replace(pressed_block("plane_strain"), loads=(make(block.side(1, upper=True)),))
    )
    (said,) = [text for text in texts(found, OK) if "resultant" in text]
    values = [float(value) for value in re.search(r"resultant \[(.*)\]", said)[1].split(",")]
    assert values == pytest.approx(wanted, rel=1e-5, abs=1e-12)


@needs("volume_loads", "elasticity")
def test_a_load_that_reaches_nothing_is_a_mistake():
    load = hhr.ThermalExpansion(
        block.SOLID, 1e-5, 100.0, field=lambda x: ufl.conditional(x[0] > 100.0, 1.0, 0.0)
    )
    (mistake,) = texts(check_scene(replace(pressed_block("plane_strain"), loads=(load,))), MISTAKE)
    assert "ThermalExpansion on 1 reaches nothing" in mistake


@needs("floating")
def test_bodies_held_by_contact_are_named_with_their_motions():
    """The block that lies on the other may slide, which nothing drives."""
    notes = texts(check_scene(lying(bulge=0.0)), NOTE)
    held = re.compile(
        "body 2 .*held by contact alone: without contact it moves along axis 0, moves along "
        "axis 1, turns"
    )
    assert any(map(held.search, notes))
    assert all("body 1" not in note for note in notes)


def test_a_body_that_nothing_holds_and_that_touches_another_one():
    """The only contact is with a floor."""
    floor = hhr.Obstacle(stacked_blocks.interface(stacked_blocks.LOWER_BLOCK, 2), (0.0, 1.0), 10.0)
    found = check_scene(lying(bulge=0.0, contacts=(floor,)))
    assert any(re.search(r"body 2 .* can move freely", text) for text in texts(found, MISTAKE))
    assert any(
        re.search(r"bodies 1 and 2 touch at 9 nodes, .*no contact pair", text)
        for text in texts(found, NOTE)
    )


@needs("floating", "nonmatching")
def test_idle_parameters_and_names():
    scene = your_scene.scene()
    wider = hhr.ParameterSpace(("travel", "lowered", "heat"), (0.05, 0.0, 0.0), (1.0, 0.3, 1.0))
    kept = tuple(item for item in scene.displacements if item.tag != "stop_flat")
    notes = texts(check_scene(replace(scene, parameters=wider, displacements=kept)), NOTE)
    assert any("('heat',)" in note for note in notes)
    assert "the mesh has surfaces that nothing names: stop_flat" in notes


@needs("nonmatching")
def test_nothing_is_said_twice():
    """A pair is looked at by itself, and with all others."""
    pairs = ("roller_round", "spring_top"), ("spring_bottom", "stop_round")
    contacts = tuple(hhr.NodeToSurface(*pair) for pair in pairs)
    found = check_scene(replace(your_scene.scene(), contacts=contacts)).findings
    assert len(found) == len(set(found))


@pytest.mark.parametrize("depth", [0.0, 0.02, 0.3])
def test_depths_of_nodes_inside_another_body(depth):
    """Half-discs moved into each other: the deepest node is as deep as they are moved beyond their
    gap of 0.1.
    """

    def geometry(comm):
        made = hertz_half_discs.scene().geometry(comm)
        mesh, cells, _ = made
        upper = np.unique(mesh.geometry.dofmap[cells.find(2)])
        lower = mesh.geometry.x[np.unique(mesh.geometry.dofmap[cells.find(1)]), 1]
        away = mesh.geometry.x[upper, 1].mean() - lower.mean()
        mesh.geometry.x[upper, 1] -= np.sign(away) * (0.1 + depth)
        return made

    with warnings.catch_warnings(action="ignore"):
        found = check_scene(replace(hertz_half_discs.scene(), geometry=geometry))
    first, second = found.pairs[0][0]
    count, deepest = depth_inside(found, first, second)
    assert (count > 0) == (depth > 0)
    assert deepest == pytest.approx(depth, rel=0.05, abs=1e-9)


@needs("nonmatching")
def test_where_there_is_no_mesh_nothing_is_drawn():
    found = check_scene(replace(your_scene.scene(), geometry=hhr.MeshFile("nowhere.msh")))
    assert len(found.mistakes) == len(found.findings) == 1
    assert found.discretisation is None


def test_loads_are_drawn_as_the_forces_that_they_are():
    """At the parameter looked at: a pressure pushes against the outer normal, all of it in the
    resultant.
    """
    pressed = pressed_block("plane_strain")
    lifted = hhr.Traction(block.side(1, upper=True), (0.0, 1.0), slope("push"))
    scene = replace(pressed, loads=(hhr.Pressure(block.side(0, upper=True), 2.0), lifted))
    (_, right), (name, up) = check_scene(scene, 0.1).forces
    assert name == f"Traction on {block.side(1, upper=True)}"
    height = 2.0  # of pressed_block
    assert right.sum(axis=0) == pytest.approx([-2.0 * height, 0.0]) and (right[:, 1] == 0).all()
    assert (up[:, 0] == 0).all() and up[:, 1].min() >= 0 and 0 < up.sum() < 1


@needs("nonmatching", "volume_loads")
def test_a_picture_of_a_mistake_is_drawn(tmp_path):
    """Of a displacement of an axis that is not there, and of loads on surfaces and on bodies, in
    space too.
    """
    scene = your_scene.scene()
    wrong = replace(
        scene,
        displacements=(*scene.displacements, hhr.Displacement("spring_top", 2)),
        loads=(hhr.Pressure("spring_top", 1.0), hhr.BodyForce("spring", (0.0, -1.0), 1.0)),
    )
    found = check_scene(wrong)
    assert len(found.mistakes) == 1
    figure_of_scene(found).savefig(tmp_path / "plane.png")
    pressed = pressed_block("solid")
    space = replace(
        pressed, loads=(hhr.Pressure(block.side(0, upper=True), 1.0),), units=hhr.Units("mm", "MPa")
    )
    figure_of_scene(check_scene(space)).savefig(tmp_path / "space.png")
    assert min((tmp_path / name).stat().st_size for name in ("plane.png", "space.png")) > 10_000


@pytest.mark.parametrize(
    ("unit", "warned"), [("m", True), ("mm", False), ("um", True), ("turns", False), ("", False)]
)
def test_a_unit_of_a_parameter_is_compared_with_those_of_the_scene(unit, warned):
    """A travel in m would be taken as one in mm."""
    scene = replace(pressed_block("plane_strain"), units=hhr.Units("mm", "MPa"))
    name = scene.parameters.names[0]
    notes = texts(check_scene(replace(scene, parameter_units={name: unit})), NOTE)
    assert (
        any(
            f"parameter {name} is said to be in {unit}, and numbers of the scene are in mm" in one
            for one in notes
        )
        == warned
    )


@needs("nodal_loads", "elasticity")
def test_a_spring_to_a_still_ground_is_no_idle_load():
    """A load whose amplitude is 0 does nothing, but a spring resists."""
    scene = pressed_block("plane_strain")
    springs = hhr.Springs(block.side(0, upper=True), 0, 2.0)
    found = check_scene(replace(scene, loads=(*scene.loads, springs)))
    assert not any("does nothing" in text for text in texts(found, OK, NOTE, MISTAKE))
    assert (
        f"Springs on {block.side(0, upper=True)}: a spring to a ground that does not move"
        in texts(found, OK)
    )


@needs("mortar")
def test_glued_bodies_are_drawn(tmp_path):
    """The surfaces of the pair lie within the bodies, which share their nodes: they have no facets
    to draw.
    """
    rows = [f"{1 + k}, {k % 2}., {k // 2}." for k in range(6)]
    rows += [
        "*ELEMENT, TYPE=CPE4, ELSET=LOW",
        "1, 1, 2, 4, 3",
        "*ELEMENT, TYPE=CPE4, ELSET=UP",
        "2, 3, 4, 6, 5",
    ]
    rows += [
        "*SURFACE, NAME=ROOF",
        "1, S3",
        "*SURFACE, NAME=FOOT",
        "2, S1",
        "*SURFACE, NAME=FLOOR",
        "1, S1",
    ]
    (tmp_path / "glued.inp").write_text("\n".join(["*NODE", *rows]) + "\n")
    scene = hhr.Scene(
        name="glued",
        geometry=hhr.MeshFile(tmp_path / "glued.inp"),
        hypothesis="plane_strain",
        bodies=(hhr.Body("LOW", 1000.0, 0.3), hhr.Body("UP", 1000.0, 0.3)),
        contacts=(hhr.Mortar("ROOF", "FOOT"),),
        displacements=hhr.Displacement.clamp("FLOOR", 2),
        parameters=hhr.ParameterSpace(("p",), (0.0,), (1.0,)),
    )
    found = check_scene(scene)
    assert any("has facets inside the mesh" in text for text in texts(found, MISTAKE))
    figure_of_scene(found)
