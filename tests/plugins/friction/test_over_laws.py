"""Friction over another law on one pair: projections alone as a reference, limits, mistakes."""

import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from needs import needs
from projected_forces import Reference
from stacked_pairs import PATH, stacked

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SceneError

pytestmark = [needs("soft_contact", "wear", "gaskets", "no_separation")]
STIFFNESS = 40.0
RATE = 0.05


def rubbing(law, friction=0.3, **others):
    """The stacked blocks, with friction and another law between them."""
    scene = stacked(**others)
    pair = replace(scene.contacts[0], friction=friction, law=law)
    return replace(scene, contacts=(pair, *scene.contacts[1:]))


def friction_of(model):
    return next(part for part in model.law.ranges if part.law.plugin == "friction")


def reference_of(model, law, mu=0.3):
    """The same laws on the S of a condensed model, by projections."""
    part = friction_of(model)
    normal = part.rows[part.law.normal]
    others = (
        {"wearing": normal, "rate": RATE / part.law.area}
        if isinstance(law, hhr.ArchardWear)
        else {"gasket": normal, "constants": (STIFFNESS * part.law.area, 1e-9)}
    )
    rows = part.rows[part.law.tangential]
    return Reference(model.eliminated.responses.schur, normal, rows, mu, **others)


LAWS = {
    "soft": lambda size=STIFFNESS: hhr.SoftContact(stiffness=size),
    "wears": lambda size=RATE: hhr.ArchardWear(size),
    "gasket": lambda size=STIFFNESS: hhr.GasketLayer([(0, 0), (1, size)]),
    "holds": lambda: hhr.NoSeparation(),
}
WITH_REFERENCE = ("soft", "wears", "gasket")


@pytest.mark.parametrize("name", WITH_REFERENCE)
def test_forces_are_those_of_projections(name, tmp_path):
    """Along a path that turns, in full order, condensed and from a file."""
    full = hhr.FullOrderModel(rubbing(LAWS[name]()), MPI.COMM_SELF)
    model = hhr.condense(full)
    hhr.save_model(tmp_path / "model.npz", model)
    histories = [
        each.march(PATH).answers for each in (full, model, hhr.load_model(tmp_path / "model.npz"))
    ]
    reference = reference_of(model, LAWS[name]())
    contact_at = model.contacts()
    slipped = 0
    for number, (time, point) in enumerate(PATH[1:]):
        free = contact_at(np.array(point)).free_slack
        expected, _ = reference.increment(free, time - PATH[number][0])
        for answers in histories:
            found = answers[number]
            assert np.abs(found.multipliers - expected).max() <= 1e-8 * np.abs(expected).max()
            np.testing.assert_allclose(found.slip.position, reference.position, atol=1e-9)
        if name == "wears":
            found = histories[1][number].memory["worn_depth"]
            np.testing.assert_allclose(found, reference.worn, atol=1e-9)
        slipped += histories[1][number].slip.counted()["contacts that slip"]
    assert slipped


@pytest.mark.parametrize("name", WITH_REFERENCE)
def test_without_friction_the_law_beneath_remains(name):
    over = hhr.condense(rubbing(LAWS[name](), friction=0.0)).march(PATH).answers
    alone = hhr.condense(stacked(LAWS[name]())).march(PATH).answers
    for one, other in zip(over, alone, strict=True):
        kept = one.multipliers[: other.multipliers.size]
        np.testing.assert_allclose(kept, other.multipliers, atol=1e-10 * np.abs(kept).max())


@pytest.mark.parametrize(("name", "size"), [("soft", 1e12), ("wears", 0.0), ("gasket", 1e12)])
def test_over_a_law_without_effect_friction_remains(name, size):
    over = hhr.condense(rubbing(LAWS[name](size))).march(PATH).answers
    alone = hhr.condense(stacked(hhr.Coulomb(0.3))).march(PATH).answers
    for one, other in zip(over, alone, strict=True):
        largest = np.abs(other.multipliers).max()
        np.testing.assert_allclose(one.multipliers, other.multipliers, atol=1e-8 * largest)


@pytest.mark.parametrize("name", WITH_REFERENCE)
def test_derivatives_of_paths_are_those_of_differences(name):
    box = hhr.ParameterSpace(("push", "slide"), (-0.01, -0.2), (0.3, 0.2))
    model = hhr.condense(rubbing(LAWS[name](), parameters=box))
    settings = hhr.MarchSettings(gradient=True)

    def ends(moved, settings=None):
        path = [(time, np.add(point, moved)) for time, point in PATH]
        settings = settings or hhr.MarchSettings()
        return model.march(path, settings).answers[-1]

    found = ends(np.zeros(2), settings).gradient.multipliers
    for axis, step in enumerate(1e-7 * np.eye(2)):
        expected = (ends(step).multipliers - ends(-step).multipliers) / 2e-7
        assert found[:, axis] == pytest.approx(expected, rel=1e-4, abs=1e-6)


def test_beside_a_pair_with_friction_alone():
    """Both share one law of friction; outputs read the memories of their pairs."""
    wears = hhr.ArchardWear(RATE)
    scene = rubbing(wears, floor=hhr.Coulomb(0.1))
    outputs = hhr.WornVolume("worn", 0), hhr.LargestSlip("slip", 0), hhr.LargestSlip("below", 1)
    model = hhr.condense(replace(scene, outputs=outputs))
    last = model.march(PATH).answers[-1]
    found = last.outputs()
    assert found["worn"] > 0 and found["slip"] > 0
    with pytest.raises(SceneError, match="does not wear"):
        hhr.condense(replace(scene, outputs=(hhr.WornVolume("worn", 1),)))
    alone = hhr.condense(rubbing(wears, floor=hhr.Coulomb(0.0))).march(PATH).answers[-1]
    assert last.memory["worn_depth"].size == alone.memory["worn_depth"].size


def test_two_memories_of_one_name_have_a_remedy():
    both = rubbing(hhr.ArchardWear(RATE), floor=hhr.ArchardWear(RATE))
    with pytest.raises(SceneError, match=r"friction=0\.0"):
        hhr.condense(both)
    mended = replace(both.contacts[1], friction=0.0)
    scene = replace(both, contacts=(both.contacts[0], mended, both.contacts[2]))
    assert hhr.condense(scene).march(PATH).answers[-1].memory["worn_depth"].max() > 0


def test_other_combinations_are_refused():
    with pytest.raises(SceneError, match="one of its pressures, and one of friction"):
        hhr.condense(rubbing(hhr.Coulomb(0.1)))


@needs("conformance", "exporters")
@pytest.mark.parametrize("tresca", [False, True])
@pytest.mark.parametrize("name", LAWS)
def test_c_has_the_forces_of_python(name, tresca):
    """In steps of a second along a path that turns, beside pairs with friction alone."""
    from hhr_dolfinx.plugins.conformance.in_c import compilable, in_c

    if not compilable("wear"):
        pytest.skip("no compiler is there")
    friction = hhr.Tresca(0.01) if tresca else 0.3
    model = hhr.condense(rubbing(LAWS[name](), friction=friction, wall=hhr.Coulomb(0.1)))
    path = [(float(k), point) for k, (_, point) in enumerate(PATH)]
    exact = np.array([answer.multipliers for answer in model.march(path).answers])
    found = in_c(model, path)
    assert not isinstance(found, str), found
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-10 * np.abs(exact).max())


@pytest.mark.parametrize("name", ["soft", "wears"])
def test_hyper_reduced(name):
    """Forces on paths that were not trained, relative to the largest."""
    scene = rubbing(LAWS[name]())
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    random = np.random.default_rng(0)
    points = random.uniform(scene.parameters.lower, scene.parameters.upper, (10, 4, 2))
    paths = [
        [(0.0, (0.0, 0.0)), *((k + 1.0, tuple(point)) for k, point in enumerate(path))]
        for path in points
    ]
    model = hhr.build(full, hhr.compute_snapshots(full, paths[:8]), hhr.Recipe.of_paths())
    for path in paths[8:]:
        for one, other in zip(full.march(path).answers, model.march(path).answers, strict=True):
            largest = np.abs(one.forces()).max()
            np.testing.assert_allclose(other.forces(), one.forces(), atol=0.02 * largest)


CUBES = """*NODE
1,0,0,0
2,1,0,0
3,1,1,0
4,0,1,0
5,0,0,1
6,1,0,1
7,1,1,1
8,0,1,1
11,0,0,1.01
12,1,0,1.01
13,1,1,1.01
14,0,1,1.01
15,0,0,2.01
16,1,0,2.01
17,1,1,2.01
18,0,1,2.01
*ELEMENT,TYPE=C3D8,ELSET=LOW
1,1,2,3,4,5,6,7,8
*ELEMENT,TYPE=C3D8,ELSET=HIGH
2,11,12,13,14,15,16,17,18
*MATERIAL,NAME=M
*ELASTIC
1000,0
*SOLID SECTION,ELSET=LOW,MATERIAL=M
*SOLID SECTION,ELSET=HIGH,MATERIAL=M
*SURFACE,NAME=MASTER
1,S2
*SURFACE,NAME=SLAVE
2,S1
*SURFACE INTERACTION,NAME=I
*SURFACE BEHAVIOR,PRESSURE-OVERCLOSURE=LINEAR
2000.
*FRICTION
.3,2e7
*CONTACT PAIR,INTERACTION=I,TYPE=SURFACE TO SURFACE
SLAVE,MASTER
*NSET,NSET=TOP
15,16,17,18
*NSET,NSET=ALL
1,2,3,4,5,6,7,8,11,12,13,14,15,16,17,18
*BOUNDARY
ALL,2,2
1,1,3
2,1,3
3,1,3
4,1,3
*STEP
*STATIC
1.,1.
*BOUNDARY
TOP,1,1
TOP,3,3,-.05
*END STEP
*STEP
*STATIC
.1,1.,1e-6,.1
*BOUNDARY
TOP,1,1,.01
TOP,3,3,-.05
*NODE PRINT,NSET=TOP,TOTALS=ONLY
RF
*END STEP
"""


@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX is not installed")
def test_soft_cubes_that_stick_are_those_of_calculix(tmp_path):
    """A cube that is pressed on another and drawn aside: forces on its top, with the contact of
    CalculiX, whose sticking nodes have a spring of 2e7. What slips loses the edge of the other cube
    there.
    """
    from hhr_dolfinx.geometries import two_blocks

    (tmp_path / "cubes.inp").write_text(CUBES)
    subprocess.run(["ccx", "cubes"], cwd=tmp_path, capture_output=True, timeout=300, check=True)
    theirs = [float(word) for word in (tmp_path / "cubes.dat").read_text().split()[-3:]]
    lower, upper = two_blocks.FIRST, two_blocks.SECOND
    bottom, top = two_blocks.side(upper, 2, False), two_blocks.side(upper, 2, True)
    ground, lid = two_blocks.side(lower, 2, False), two_blocks.side(lower, 2, True)
    motions = ("aside", None, "down")
    boxes = ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (1, 1, 1)), ((0.0, 0.0, 1.01), (1.0, 1.0, 2.01))
    scene = hhr.Scene(
        name="cubes",
        geometry=lambda comm: two_blocks.two_blocks(
            comm, first=boxes[0], second=(*boxes[1], (1, 1, 1))
        ),
        hypothesis="solid",
        bodies=(hhr.Body(lower, 1000.0, 0.0), hhr.Body(upper, 1000.0, 0.0)),
        contacts=(
            hhr.NodeToNode(
                bottom,
                lid,
                (0.0, 0.0, -1.0),
                friction=0.3,
                law=hhr.SoftContact(stiffness=2000.0),
            ),
        ),
        displacements=(
            *hhr.Displacement.clamp(ground, 3),
            *(
                hhr.Displacement(top, k, hhr.Amplitude(slopes={name: 1.0} if name else {}))
                for k, name in enumerate(motions)
            ),
        ),
        outputs=(hhr.Reaction("x", top, (1, 0, 0)), hhr.Reaction("z", top, (0, 0, 1))),
        parameters=hhr.ParameterSpace(("aside", "down"), (0.0, -0.1), (0.02, 0.0)),
    )
    path = [(0.0, (0.0, 0.0)), (1.0, (0.0, -0.05)), (2.0, (0.01, -0.05))]
    answer = hhr.condense(scene).march(path).answers[-1]
    found = answer.outputs()
    assert [found["x"], found["z"]] == pytest.approx([theirs[0], theirs[2]], rel=2e-3)
    assert answer.slip.counted()["contacts that slip"] == 0


@needs("plots")
@pytest.mark.parametrize(("name", "field"), [
    ("soft", "overclosure"), ("wears", "worn_depth"), ("gasket", "largest_closure"),
    ("holds", "held"),
])  # fmt: skip
def test_fields_for_viewers(name, field, tmp_path):
    """Memories of the laws at the slave nodes, alone and beneath friction."""
    pyvista = pytest.importorskip("pyvista")
    for friction in (None, 0.3):
        full = hhr.FullOrderModel(rubbing(LAWS[name](), friction=friction), MPI.COMM_SELF)
        answer = full.march(PATH[:2]).answers[-1]
        target = tmp_path / f"{name}{friction}.vtu"
        hhr.write_fields(target, full, answer)
        written = pyvista.read(target).point_data[field]
        known = answer.memory[field]
        slaves = full.problem.contact_slaves[: known.size]
        np.testing.assert_allclose(written[slaves], known)
        assert np.count_nonzero(written) == np.count_nonzero(known) > 0
