"""Elements of 8 and 20 nodes, and contact at single nodes, against figures of CalculiX 2.20."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from deck_entries import ENTRIES
from deck_runs import started
from deck_writer import Writer, at, both
from needs import needs

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SceneError

pytestmark = needs("constraints")
TWENTY = (hhr.Serendipity(),)


def block(kind, ends):
    """Two layers of cells, clamped at x = 0, with forces at two nodes."""
    dim = len(ends)
    deck = Writer()
    made = deck.box("EALL", kind, (2 * ends[0], 2, 2)[:dim], (0.0,) * dim, ends)
    deck.nset("LEFT", made.nodes(at(0, 0)))
    upper = [at(axis, end) for axis, end in enumerate(ends)][1:]
    deck.nset("END", made.nodes(both(at(0, ends[0]), *upper)))
    deck.nset("MIDDLE", made.nodes(both(at(0, ends[0] / 2), *upper)))
    deck.material()
    deck.section()
    deck.add(
        f"*BOUNDARY/LEFT, 1, {dim}/*STEP/*STATIC/*CLOAD/END, {dim}, 100./END, 2, 40./MIDDLE, "
        f"{dim}, -300."
    )
    deck.add("*NODE PRINT, NSET=NALL/U/*END STEP")
    return deck.text


def displacement(scene, place):
    full = hhr.FullOrderModel(scene)
    node = np.linalg.norm(full.problem.points - place, axis=1).argmin()
    return (
        full.solve(scene.parameters.middle)
        .displacement()
        .reshape(len(full.problem.points), -1)[node]
    )


@pytest.mark.parametrize(
    ("kind", "ends", "moved"),
    [
        ("C3D20", (3, 1, 1.2), (-0.01120635, 0.02264986, 0.007117875)),
        ("CPE8", (4, 1), (-0.01428824, 0.05196055)),
    ],
)
def test_a_block_under_forces_at_nodes(kind, ends, moved, tmp_path):
    """The loaded end moves as in CalculiX, to all of its digits.

    Elements with more nodes are 0.2 to 30 % off.
    """
    scene, _ = started(tmp_path, block(kind, ends))
    assert scene.constraints == TWENTY
    assert displacement(scene, ends) == pytest.approx(moved, rel=1e-6)
    assert np.abs(displacement(replace(scene, constraints=()), ends) / moved - 1).max() > 0.002


def test_a_moment_on_a_distributing_coupling(tmp_path):
    """CalculiX counts nodes by the functions of its elements.

    With those in the middle of faces they move 2 % off.
    """
    text = block("C3D20", (3, 1, 1.2)).partition("*CLOAD")[0]
    faces = "*SURFACE, NAME=HEAD\n" + "".join(f"{cell}, S4\n" for cell in (21, 22, 23, 24))
    coupling = (
        "*NODE\n990, 4., 0.3, 0.9\n"
        f"{faces}*COUPLING, REF NODE=990, SURFACE=HEAD, CONSTRAINT NAME=C\n"
    )
    text = text.replace("*STEP", f"{coupling}*DISTRIBUTING\n1, 6\n*STEP")
    text += "*CLOAD\n990, 3, -300.\n990, 4, 200.\n*NODE PRINT, NSET=NALL\nU\n*END STEP\n"
    scene, output = started(tmp_path, text)
    assert "TODO" not in output and [load.by_area for load in scene.loads] == ["edges"] * 2
    moved = (0.04407712, -0.02901337, -0.1176438)
    assert displacement(scene, (3, 1, 1.2)) == pytest.approx(moved, rel=1e-6)
    plain = tuple(replace(load, by_area=True) for load in scene.loads)
    assert np.abs(displacement(replace(scene, loads=plain), (3, 1, 1.2)) / moved - 1).max() > 0.01
    with pytest.raises(SceneError, match="by_area = 'corners' of the CoupledForce"):
        replace(scene.loads[0], by_area="corners")


def test_membranes_on_sides_of_cells(tmp_path):
    """They are left out, and the cells keep their 20 nodes."""
    text = block("C3D20", (3, 1, 1.2))
    side = "*ELEMENT, TYPE=M3D4, ELSET=SKIN\n900, 1, 4, 5, 2\n*MATERIAL"
    scene, _ = started(tmp_path, text.replace("*MATERIAL", side, 1))
    assert scene.constraints == TWENTY


def test_elements_with_fewer_integration_points_keep_27_nodes(tmp_path):
    scene, _ = started(tmp_path, block("C3D20R", (3, 1, 1.2)))
    assert not scene.constraints


@needs("floating", "friction")
def test_a_body_that_contact_holds(tmp_path):
    """A cube on another one, pressed and pulled at a corner.

    CalculiX has a penalty, and 27 nodes are 0.6 % off.
    """
    entry = next(one for one in ENTRIES if one.source == "contact5")
    scene, _ = started(tmp_path, entry.write())
    assert scene.constraints == TWENTY
    assert displacement(scene, (0, 0, 2))[2] == pytest.approx(entry.reference, rel=1.5e-3)


def leaves(cells, push):
    """A quarter of a leaf spring, whose lower leaves are shorter and press by their ends."""
    deck = Writer()
    made = [
        deck.box(
            "EALL", "C3D20", (count, 1, 1), (0, 0, 5 * row), (50 * (row + 1), 20, 5 * (row + 1))
        )
        for row, count in enumerate(cells)
    ]
    for row, (low, up) in enumerate(pairwise(made), 1):
        deck.surface(f"TOP{row}", low.faces(at(2, 5 * row)))
        deck.surface(f"BOT{row}", up.faces(at(2, 5 * row)))
    for axis in (0, 1):
        deck.nset(f"SYM{axis}", [node for leaf in made for node in leaf.nodes(at(axis, 0))])
    deck.nset("SUPPORT", made[-1].nodes(both(at(0, 50 * len(cells)), at(2, 5 * (len(cells) - 1)))))
    deck.material()
    deck.section()
    deck.add("*BOUNDARY/SYM0, 1/SYM1, 2/SUPPORT, 3/*SURFACE INTERACTION, NAME=LEAF")
    deck.add("*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR/1000000, .00001, 1")
    pairs = "/".join(f"TOP{row}, BOT{row}" for row in range(1, len(cells)))
    deck.add(f"*CONTACT PAIR, INTERACTION=LEAF, TYPE=NODE TO SURFACE/{pairs}")
    deck.add(f"*STEP/*STATIC/.01, 1/*BOUNDARY/SYM0, 3, 3, {push}")
    deck.add("*NODE PRINT, NSET=SUPPORT, TOTALS=ONLY/RF/*END STEP")
    return deck.text


@needs("nonmatching", "stress")
@pytest.mark.parametrize(("cells", "force"), [((2, 3), 23.89021), ((1, 2, 4), 10.19377)])
def test_a_leaf_spring_with_contact_at_nodes(cells, force, tmp_path):
    """The force on the support, from the energy.

    Its penalty makes CalculiX 0.02 % stiffer, and means are 2 % off.
    """
    scene, _ = started(tmp_path, leaves(cells, 0.1))
    pairs = tuple(
        hhr.NodeToSurface(pair.slave, pair.master, at_nodes=True) for pair in scene.contacts
    )
    energy = (hhr.ElasticEnergy("energy"),)
    found = replace(scene, contacts=pairs, constraints=TWENTY, outputs=energy)
    given = hhr.FullOrderModel(found).solve(scene.parameters.middle).outputs()["energy"]
    assert 2 * given / 0.1 == pytest.approx(force, rel=5e-4)
    means = replace(found, contacts=scene.contacts)
    softer = hhr.FullOrderModel(means).solve(scene.parameters.middle).outputs()["energy"]
    assert 2 * softer / 0.1 < 0.98 * force


def test_a_constant_pressure_passes(tmp_path):
    """A cube without Poisson's ratio, pressed on a plane by 1 %: conditions at its nodes are
    independent.
    """
    deck = Writer()
    cube = deck.box("EALL", "C3D20", (2, 2, 2), (0, 0, 0), (1, 1, 1))
    for axis, name in enumerate("XYZ"):
        deck.nset(f"{name}0", cube.nodes(at(axis, 0)))
    deck.nset("LID", cube.nodes(at(2, 1)))
    (tmp_path / "cube.inp").write_text(deck.text)
    scene = hhr.Scene(
        "cube",
        hhr.MeshFile(tmp_path / "cube.inp"),
        "solid",
        (hhr.Body("EALL", 210e3, 0.0),),
        (hhr.Obstacle("Z0", (0.0, 0.0, -1.0), 0.0),),
        hhr.ParameterSpace(("push",), (0.0,), (0.02,)),
        displacements=(
            hhr.Displacement("X0", 0),
            hhr.Displacement("Y0", 1),
            hhr.Displacement("LID", 2, hhr.Amplitude(slopes={"push": -1.0})),
        ),
        constraints=TWENTY,
    )
    full = hhr.FullOrderModel(scene)
    answer = full.solve(0.01)
    assert answer.forces().size == 21
    assert answer.forces() / full.problem.contact_areas == pytest.approx(
        np.full(21, 2100.0), rel=1e-9
    )


def test_cells_without_nodes_in_the_middle(tmp_path):
    scene, _ = started(tmp_path, block("C3D8", (2, 1, 1)))
    with pytest.raises(SceneError, match="quadrilaterals or hexahedra of second order"):
        hhr.FullOrderModel(replace(scene, constraints=TWENTY))


def stacked(folder, contact, constraints, more):
    """Two cubes whose meshes do not match, the upper one pressed down by 0.002 along z and held
    along x and y.
    """
    deck = Writer()
    low = deck.box("LOW", "C3D20", (2, 2, 2), (0, 0, 0), (1, 1, 1))
    up = deck.box("UP", "C3D20", (3, 3, 3), (0, 0, 1), (1, 1, 2))
    deck.surface("LTOP", low.faces(at(2, 1)))
    deck.surface("UBOT", up.faces(at(2, 1)))
    deck.nset("FLOOR", low.nodes(at(2, 0)))
    deck.nset("LID", up.nodes(at(2, 2)))
    (folder / "two.inp").write_text(deck.text)
    push = hhr.Displacement("LID", 2, hhr.Amplitude(slopes={"push": -1.0}))
    held = (*hhr.Displacement.clamp("FLOOR", 3), *hhr.Displacement.clamp("LID", 3)[:2], push)
    scene = hhr.Scene(
        "two",
        hhr.MeshFile(folder / "two.inp"),
        "solid",
        (hhr.Body("LOW", 1e5, 0.3), hhr.Body("UP", 1e5, 0.3)),
        (contact,),
        hhr.ParameterSpace(("push",), (0.0,), (0.004,)),
        displacements=(*held, *more),
        outputs=(hhr.ContactForce("force", 0, (0.0, 0.0, 1.0)),),
        constraints=constraints,
    )
    full = hhr.FullOrderModel(scene)
    return full, full.solve(0.002)


NODES = hhr.NodeToSurface("UBOT", "LTOP", at_nodes=True)


@needs("nonmatching", "mortar")
@pytest.mark.parametrize("pair", [hhr.Mortar("UBOT", "LTOP"), NODES])
def test_conditions_do_not_depend_on_the_order_of_constraints(pair, tmp_path):
    """Another constraint may determine a node in the middle of a face: conditions count for edges
    all the same.
    """
    mean = hhr.MeanMotion("UBOT", 0)
    found = [stacked(tmp_path, pair, order, ())[1] for order in ((*TWENTY, mean), (mean, *TWENTY))]
    forces = [answer.outputs()["force"] for answer in found]
    assert found[0].forces().size == found[1].forces().size == 40
    assert forces[0] == pytest.approx(forces[1], rel=1e-9)


@needs("mortar")
def test_surfaces_that_are_held_along_an_axis(tmp_path):
    """By symmetry it does not matter which.

    Nodes in the middle of faces follow no others along an axis held.
    """
    pair = hhr.Mortar("UBOT", "LTOP")
    held = [tuple(hhr.Displacement(name, axis) for name in ("UBOT", "LTOP")) for axis in (0, 1)]
    found = [stacked(tmp_path, pair, TWENTY, more)[1] for more in held]
    assert found[0].forces().size == found[1].forces().size == 40
    assert found[0].outputs()["force"] == pytest.approx(found[1].outputs()["force"], rel=1e-8)


@needs("nonmatching")
def test_areas_at_nodes_are_those_of_the_surface(tmp_path):
    full, answer = stacked(tmp_path, NODES, TWENTY, ())
    assert answer.forces().size == 40
    assert full.problem.contact_areas.sum() == pytest.approx(1.0, rel=1e-12)
