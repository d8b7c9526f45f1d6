"""Scenes whose K comes from other codes: everything that takes S works, or says why not."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import shell_plate
from foreign_formats import FLANK, FLOOR, HIGH, LOW, TOP, foreign_scene, own_block, own_scene
from needs import needs

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotOfferedError, SceneError
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND

pytestmark = needs("nonmatching")

POINT = (10.0, 0.2)


@pytest.fixture(scope="module")
def own():
    return own_block()


@pytest.fixture(scope="module")
def plate(tmp_path_factory):
    """Folder of the plate of shells."""
    return shell_plate.unpacked(tmp_path_factory.mktemp("plate"))


def test_shells_press_as_in_calculix(plate):
    """CalculiX' own contact is a penalty: 1e9 N/mm^3 leaves 1e-5; its forces have seven digits."""
    full = hhr.FullOrderModel(shell_plate.scene(shell_plate.block(plate)))
    for push, force in shell_plate.theirs(plate):
        assert full.outputs((push,))["force"] == pytest.approx(force, rel=1e-4)


def test_nodes_of_a_deck_are_means_of_its_solid(plate):
    """A floor under the middle of the shells touches at the same push: sections stay nearly
    upright.
    """
    block = shell_plate.block(plate)
    middle = (hhr.NodesToGround("BOT", (0.0, 0.0, -1.0), plane=0.2),)
    found = hhr.FullOrderModel(shell_plate.scene(block, contacts=middle))
    side = hhr.FullOrderModel(shell_plate.scene(block))
    assert (
        found.conditions == side.conditions == 60
    )  # one for each section, without those that are held
    assert found.outputs((1.0,))["force"] == pytest.approx(side.outputs((1.0,))["force"], rel=1e-3)


def test_dofs_that_nobody_can_name_are_refused(plate):
    """At the support CalculiX has removed some rows of each section, and does not say which
    ones.
    """
    block = shell_plate.block(plate)
    with pytest.raises(
        SceneError, match=r"contact of scene 'plate' acts on \d+ dofs that K does not have"
    ):
        hhr.FullOrderModel(shell_plate.scene(block, displacements=()))
    with pytest.raises(SceneError, match="a load of scene 'plate' acts on"):
        loads = (hhr.NodalForce("FIX", (1.0, 0.0, 0.0), "push"),)
        hhr.FullOrderModel(
            shell_plate.scene(
                block,
                displacements=(),
                loads=loads,
                contacts=(hhr.NodesToGround("TIP", (0, 0, -1.0), 0.1),),
            )
        )
    moved = (*hhr.Displacement.clamp("FIX", 2), hhr.Displacement("FIX", 2, "push"))
    with pytest.raises(SceneError, match="moves node"):
        hhr.FullOrderModel(shell_plate.scene(block, displacements=moved))


def test_condensed_files_and_gradients(plate, tmp_path):
    full = hhr.FullOrderModel(shell_plate.scene(shell_plate.block(plate)))
    hhr.save_model(tmp_path / "plate.npz", hhr.condense(full))
    model = hhr.load_model(tmp_path / "plate.npz")
    found = model.outputs((1.0,), gradient=True)
    assert found["force"] == pytest.approx(full.outputs((1.0,))["force"], rel=1e-11)
    step = 1e-4
    slope = (full.outputs((1.0 + step,))["force"] - full.outputs((1.0 - step,))["force"]) / (
        2 * step
    )
    assert found.gradient["force"][0] == pytest.approx(slope, rel=1e-8)


@needs("exact_errors")
def test_hyper_reduction_has_a_bound(own):
    training = hhr.train(foreign_scene(own), [4, 3])
    model = training.build()
    answer, exact = (
        model.solve((7.0, 0.1)),
        hhr.FullOrderModel(foreign_scene(own)).solve((7.0, 0.1)),
    )
    off = np.linalg.norm(answer.forces() - exact.forces())
    assert answer.estimate().kind == "bound"
    assert off <= 0.02 * np.linalg.norm(exact.forces())


@needs("friction")
def test_friction_is_that_of_our_scene(own):
    """The same rows and K: equal to round-off of the path."""
    pair = hhr.NodeToSurface(HIGH, LOW, friction=0.3)
    ours = hhr.FullOrderModel(own_scene(contacts=(pair,))).solve(POINT)
    pair = hhr.NodeToSurface(str(HIGH), str(LOW), friction=0.3)
    theirs = hhr.FullOrderModel(foreign_scene(own, contacts=(pair,))).solve(POINT)
    assert np.abs(ours.forces() - theirs.forces()).max() <= 1e-8 * np.abs(ours.forces()).max()
    assert np.abs(ours.forces()[16:]).max() > 0.01  # friction acts


def test_a_factor_is_a_modulus(own):
    """Displacements under forces scale with 1 / E; whole blocks are not factored again."""
    box = hhr.ParameterSpace(("push", "E"), (0.01, 0.5), (0.02, 2.0))
    contacts = (hhr.NodesToGround(str(TOP), (0.0, 0.0, 1.0), 1.0),)  # never touches
    loads = (hhr.Traction(str(TOP), (0.0, 0.0, -1.0), "push"),)
    outputs = (hhr.DisplacementAt("moved", (0.666, 0.666, 2.001), 2),)
    changes = {"parameters": box, "contacts": contacts, "loads": loads, "outputs": outputs}
    full = hhr.FullOrderModel(foreign_scene(replace(own, factor="E"), **changes))
    soft, stiff = (full.outputs((0.015, young))["moved"] for young in (0.5, 2.0))
    assert soft == pytest.approx(4 * stiff, rel=1e-12)
    assert full.system.bodies is not None


@needs("moduli")
def test_two_blocks_with_their_own_moduli():
    """Parts of two codes in one scene, of which one has a modulus: our scene with both bodies."""
    lower, upper = hhr.blocks_of_scene(own_scene())
    blocks = replace(lower, name="lower", factor="E / 1000"), replace(upper, name="upper")
    box = hhr.ParameterSpace(("push", "pull", "E"), (1.0, -0.5, 800.0), (20.0, 0.5, 1500.0))
    top = f"upper.{TOP}"
    theirs = hhr.FullOrderModel(
        foreign_scene(
            *blocks,
            parameters=box,
            contacts=(hhr.NodeToSurface(f"upper.{HIGH}", f"lower.{LOW}"),),
            displacements=(
                *hhr.Displacement.clamp(f"lower.{FLOOR}", 3),
                *hhr.Displacement.clamp(f"upper.{FLANK}", 3),
            ),
            loads=(
                hhr.Traction(top, (0.0, 0.0, -1.0), "push"),
                hhr.Traction(top, (0.0, 1.0, 0.0), "pull"),
            ),
        )
    )
    bodies = (hhr.Body(FIRST, "E", 0.3), hhr.Body(SECOND, 2000.0, 0.2))
    ours = hhr.FullOrderModel(own_scene(bodies=bodies, parameters=box))
    for young in (900.0, 1400.0):
        one, other = (np.sort(full.solve((10.0, 0.2, young)).forces()) for full in (theirs, ours))
        assert np.abs(one - other).max() <= 1e-10 * other.max()
    found = hhr.condense(theirs).solve((10.0, 0.2, 900.0)).forces()
    assert np.abs(found - theirs.solve((10.0, 0.2, 900.0)).forces()).max() <= 1e-6 * found.max()


@needs("floating")
def test_a_body_that_contact_alone_holds(own):
    """The upper block, free to fall: the force is that of our scene, and the load itself."""
    held = [(FLANK, 0), (FLANK, 1), *((FLOOR, axis) for axis in range(3))]
    ours = hhr.FullOrderModel(
        own_scene(displacements=tuple(hhr.Displacement(*one) for one in held))
    )
    held = tuple(hhr.Displacement(str(tag), axis) for tag, axis in held)
    theirs = hhr.FullOrderModel(foreign_scene(own, displacements=held))
    assert theirs.problem.kernel is not None and theirs.problem.kernel.motions.shape[1] == 1
    assert theirs.outputs(POINT)["force"] == pytest.approx(4 * POINT[0], rel=1e-10)  # on 2 x 2
    off = np.abs(ours.solve(POINT).forces() - theirs.solve(POINT).forces()).max()
    assert off <= 1e-9 * POINT[0]


def test_pictures_and_fields_have_the_faces(plate, tmp_path):
    full = hhr.FullOrderModel(shell_plate.scene(shell_plate.block(plate)))
    mesh = full.answer_mesh()
    assert mesh.kind == 5 and mesh.cells.shape[1] == 3
    with pytest.raises(NotOfferedError, match="stresses of scene 'plate' are not known"):
        full.stress(full.solve((1.0,)))


@needs("volume_loads")
def test_integrals_over_a_mesh_are_refused(own):
    loads = (hhr.BodyForce("part", (0.0, 0.0, -1.0), "push"),)
    with pytest.raises(NotOfferedError, match="ForeignLoad"):
        hhr.FullOrderModel(foreign_scene(own, loads=loads))


def test_load_vectors_of_other_codes(own, tmp_path):
    """The vector of a traction as a file is that traction."""
    scene = foreign_scene(own)
    full = hhr.FullOrderModel(scene)
    forces = full.discretisation.load_terms()[0].columns.toarray().ravel()
    lines = [
        f"{dof // 3 + 1}, {dof % 3 + 1}, {value:.17e}\n"
        for dof, value in enumerate(forces)
        if value
    ]
    (tmp_path / "load.mtx").write_text("** LOAD\n" + "".join(lines))
    loads = (hhr.ForeignLoad(tmp_path / "load.mtx", "push"), *scene.loads[1:])
    found = hhr.FullOrderModel(foreign_scene(own, loads=loads)).solve(POINT)
    assert np.array_equal(found.forces(), full.solve(POINT).forces())
    with pytest.raises(SceneError, match=r"acts on dof 99999\.1"):
        hhr.FullOrderModel(foreign_scene(own, loads=(hhr.ForeignLoad({(99999, 1): 1.0}, "push"),)))


WITHOUT = """
import sys
for name in ("dolfinx", "petsc4py", "mpi4py", "slepc4py", "ufl", "basix"):
    sys.modules[name] = None
import hhr_dolfinx as hhr
block = hhr.ForeignBlock("plate.sti", "plate.inp", case="case.inp", results="case.frd")
foreign = hhr.ForeignStiffness(block)
model = foreign.condense(
    hhr.ParameterSpace(("push",), (0.0,), (2.0,)),
    (hhr.NodesToGround("TIP", (0.0, 0.0, -1.0), 0.2),),
    displacements=[("FIX", axis) for axis in range(3)],
    loads=[hhr.ForeignLoad("load.txt", "push")],
)
print(model.outputs((1.0,))["force 0 z"])
"""


def test_condensed_without_dolfinx(plate):
    """By SciPy alone; the load of each node of the deck is shared by its two nodes of K."""
    from hhr_dolfinx.plugins.foreign.nodes import read_nodes

    nodes = read_nodes(plate / "plate.inp", plate / "case.frd")
    tip = nodes.labels[nodes.sets["TIP"]]
    (plate / "load.txt").write_text("".join(f"{label} 3 -0.5\n" for label in tip))
    said = subprocess.run(
        [sys.executable, "-c", WITHOUT], cwd=plate, capture_output=True, text=True, check=True
    )
    block = shell_plate.block(plate)
    contacts = (hhr.NodesToGround("TIP", (0.0, 0.0, -1.0), 0.2),)
    full = hhr.FullOrderModel(shell_plate.scene(block, contacts=contacts))
    assert float(said.stdout) == pytest.approx(full.outputs((1.0,))["force"], rel=1e-10)


def test_imposed_motions_of_a_block_with_a_modulus(own):
    """A flank is moved while the modulus varies: our scene, whose bodies have the same factor."""
    box = hhr.ParameterSpace(("push", "E"), (0.001, 0.5), (0.02, 2.0))
    given = {"parameters": box, "loads": ()}
    held = (
        *hhr.Displacement.clamp(FLOOR, 3),
        hhr.Displacement(FLANK, 0),
        hhr.Displacement(FLANK, 1),
    )
    moved = (*held, hhr.Displacement(FLANK, 2, hhr.Amplitude(slopes={"push": -1.0})))
    bodies = (hhr.Body(FIRST, "1000 * E", 0.3), hhr.Body(SECOND, "2000 * E", 0.2))
    ours = hhr.FullOrderModel(own_scene(**given, displacements=moved, bodies=bodies)).solve(
        (0.01, 1.7)
    )
    theirs = foreign_scene(replace(own, factor="E"), **given, displacements=moved)
    found = hhr.FullOrderModel(theirs).solve((0.01, 1.7)).forces()
    assert np.abs(found - ours.forces()).max() <= 1e-9 * ours.forces().max()


@needs("plots")
def test_a_picture_has_the_surface_and_the_pressure(tmp_path):
    """K knows no stress: bodies have the colours of the displacement."""
    pytest.importorskip("pyvista")
    full = hhr.FullOrderModel(foreign_scene(own_block()))
    answer = full.solve(full.parameters.middle)
    figure = answer.plot(tmp_path / "block.png")
    titles = " ".join(axes.get_title() for axes in figure.axes)
    closed = np.count_nonzero(answer.forces() > 0)
    assert closed and f"contact: {closed} of" in titles
    assert (tmp_path / "block.png").stat().st_size > 10_000
