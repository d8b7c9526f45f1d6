"""Command files of code_aster, and meshes without physics, become scenes."""

import numpy as np
import pytest
from deck_texts import bar, blocks
from needs import needs
from shell import invoke

import hhr_dolfinx as hhr
from hhr_dolfinx.command.loading import scene_of

COMM = """
DEBUT()
E = 1000.0  # a number by its name
steel = DEFI_MATERIAU(ELAS=_F(E=E, NU=0.0, RHO=2 * 1.0))
mesh = LIRE_MAILLAGE(FORMAT="MED", UNITE=20)
model = AFFE_MODELE(MAILLAGE=mesh, AFFE=_F(TOUT="OUI", PHENOMENE="MECANIQUE", MODELISATION="3D"))
fields = AFFE_MATERIAU(MAILLAGE=mesh, AFFE=(_F(GROUP_MA="LOWER", MATER=steel),
                                            _F(GROUP_MA="UPPER", MATER=(steel,))))
held = AFFE_CHAR_CINE(
    MODELE=model,
    MECA_IMPO=(_F(GROUP_MA="LOWER_Z0", LIAISON="ENCASTRE"), _F(GROUP_NO="UPPER_X0", DX=0.0),
               _F(GROUP_NO="UPPER_Y0", DY=0)),
)
load = AFFE_CHAR_MECA(MODELE=model, {load})
touch = DEFI_CONTACT(MODELE=model, FORMULATION="CONTINUE", FROTTEMENT="COULOMB",
                     ZONE=_F(GROUP_MA_MAIT="LOWER_TOP", GROUP_MA_ESCL="UPPER_BOTTOM", COULOMB=0.3))
{more}
answer = STAT_NON_LINE(MODELE=model, CHAM_MATER=fields, CONTACT=touch,
                       EXCIT=(_F(CHARGE=held), _F(CHARGE=load)), COMPORTEMENT=_F(RELATION="ELAS"))
FIN()
"""


def mesh_of(text):
    """The part of a deck before its materials."""
    return text[: text.index("*MATERIAL")]


def started(folder, load, more="", **blocks_like):
    (folder / "run.inp").write_text(mesh_of(blocks("", **blocks_like)))
    (folder / "run.comm").write_text(COMM.replace("{load}", load).replace("{more}", more))
    code, output = invoke("start", folder / "run.comm")
    return code, output, (scene_of(str(folder / "run.py")) if code == 0 else None)


@needs("floating")
@pytest.mark.parametrize(
    ("load", "name", "pressure"),
    [('PRES_REP=_F(GROUP_MA="UPPER_TOP", PRES=10.0)', "pressure", 10.0),
     ('FORCE_FACE=_F(GROUP_MA="UPPER_TOP", FZ=-10.0)', "force", 10.0),
     ('FORCE_NODALE=_F(GROUP_NO="UPPER_Z1", FZ=-0.5)', "force", 8.0),
     ('DDL_IMPO=_F(GROUP_NO="UPPER_Z1", DZ=-0.02)', "displacement", 10.0),
     ('PESANTEUR=_F(GRAVITE=5.0, DIRECTION=(0, 0, -1))', "weight", 10.0)],
)  # fmt: skip
def test_a_command_file(load, name, pressure, tmp_path):
    code, output, scene = started(tmp_path, load)
    assert code == 0 and "TODO" not in output, output
    assert isinstance(scene.contacts[0], hhr.Mortar) and scene.contacts[0].friction == 0.3
    assert scene.parameters.names[0].startswith(name)
    full = hhr.FullOrderModel(scene)
    answer = full.solve(scene.parameters.middle)
    # friction holds what nu = 0 does not move
    assert full.pressures(answer).sum() == pytest.approx(pressure, rel=1e-6)
    assert "run.comm:14" in (tmp_path / "run.py").read_text()


RIGID_LINE = """
MA = LIRE_MAILLAGE(FORMAT='ASTER')
MO = AFFE_MODELE(MAILLAGE=MA, AFFE=_F(TOUT='OUI', PHENOMENE='MECANIQUE', MODELISATION='D_PLAN'))
CHMAT = AFFE_MATERIAU(MAILLAGE=MA,
                      AFFE=_F(TOUT='OUI', MATER=DEFI_MATERIAU(ELAS=_F(E=1000.0, NU=0.0))))
LOAD = AFFE_CHAR_MECA(MODELE=MO,
                      DDL_IMPO=(_F(GROUP_MA='BASE', DX=0.0, DY={moved}),
                                _F(GROUP_MA='LEFT', DX=0.0)),
                      PRES_REP=_F(GROUP_MA='TOP', PRES=10.0))
TOUCH = DEFI_CONTACT(MODELE=MO, FROTTEMENT='COULOMB',
                     ZONE=_F(GROUP_MA_MAIT='BASE', GROUP_MA_ESCL='FOOT', COULOMB=0.2))
STAT_NON_LINE(MODELE=MO, CHAM_MATER=CHMAT, EXCIT=_F(CHARGE=LOAD), CONTACT=TOUCH)
"""
LINES = """COOR_2D
N1 0. 0. N2 1. 0. N3 1. 1. N4 0. 1. B1 -1. -0.1 B2 0.5 {y} B3 2. -0.1
FINSF
QUAD4
M1 N1 N2 N3 N4
FINSF
SEG2
F N1 N2 T N3 N4 L N4 N1 A1 B1 B2 A2 B2 B3
FINSF
GROUP_MA FOOT F FINSF
GROUP_MA TOP T FINSF
GROUP_MA LEFT L FINSF
GROUP_MA BASE A1 A2 FINSF
FIN
"""


@needs("floating", "mesh_formats")
@pytest.mark.parametrize("moved", [0.0, 0.05])
def test_a_rigid_line_without_cells_is_an_obstacle(moved, tmp_path):
    """A square falls by 0.1 less the motion of the line, and is shortened by p / E: the line bears
    p.

    SSNV128 of code_aster has such a line, and a mesh of the same name beside its command file.
    """
    (tmp_path / "run.mail").write_text(LINES.replace("{y}", "-0.1"))
    (tmp_path / "run.comm").write_text(RIGID_LINE.replace("{moved}", str(moved)))
    code, output = invoke("start", tmp_path / "run.comm")
    assert code == 0 and "TODO" not in output, output
    scene = scene_of(str(tmp_path / "run.py"))
    assert isinstance(scene.contacts[0], hhr.Obstacle) and scene.contacts[0].friction == 0.2
    full = hhr.FullOrderModel(scene)
    answer = full.solve(scene.parameters.middle)
    assert full.pressures(answer).sum() == pytest.approx(10.0, rel=1e-9)
    assert answer.displacement().reshape(-1, 2)[:, 1].min() == pytest.approx(
        -(0.1 - moved) - 0.01, rel=1e-9
    )


@needs("mesh_formats")
def test_a_curved_rigid_line_ends_in_a_sentence(tmp_path):
    """Its scene would have no contact: the command says so, and its exit code too."""
    (tmp_path / "run.mail").write_text(LINES.replace("{y}", "-0.3"))
    (tmp_path / "run.comm").write_text(RIGID_LINE.replace("{moved}", "0.0"))
    code, output = invoke("start", tmp_path / "run.comm")
    assert code == 3 and "'BASE': it is curved, and has no cells: hhr.Profile" in output
    assert "run.comm states contact, and" in output


def test_nothing_of_a_command_file_is_executed(tmp_path):
    mark = tmp_path / "executed"
    more = (
        f"import pathlib\npathlib.Path({str(mark)!r}).touch()\nfor k in range(3):\n"
        "    MACR(K=k)\nOTHER(A=1)"
    )
    load = 'PRES_REP=_F(GROUP_MA="UPPER_TOP", PRES=10.0), LIAISON_DDL=_F(GROUP_NO="A")'
    load += ', FORCE_FACE=_F(GROUP_MA="X", FX=E())'
    code, output, _ = started(tmp_path, load, more)
    assert code == 0 and not mark.exists()
    for words in ("For: not read", "OTHER: not read", "LIAISON_DDL: no counterpart: hhr.Equation",
                  "FX of FORCE_FACE is not literal"):  # fmt: skip
        assert words in output


@pytest.mark.parametrize(
    ("change", "why"),
    [(("E=E,", "E=young(),"), "run.comm:7 AFFE_MATERIAU: the material has no literal ELAS"),
     (('GROUP_MA="LOWER", M', 'GROUP_MA="BASE", M'), "the mesh has no body of ('BASE',)"),
     (("DEBUT()", "DEBUT("), "is no command file")],
)  # fmt: skip
def test_mistakes_in_command_files(change, why, tmp_path, monkeypatch):
    assert change[0] in COMM
    monkeypatch.setattr("test_other_files.COMM", COMM.replace(*change))
    code, output, _ = started(tmp_path, 'PRES_REP=_F(GROUP_MA="UPPER_TOP", PRES=10.0)')
    assert code == 3 and why in output
    (tmp_path / "run.inp").unlink()
    code, output = invoke("start", tmp_path / "run.comm")
    assert code == 3 and "--mesh part.med" in output


@needs("floating")
def test_a_mesh_without_physics(tmp_path):
    """Two blocks: surfaces that face each other, a support below and a pressure of 1 above, which
    passes through.
    """
    (tmp_path / "part.inp").write_text(mesh_of(blocks("", gap=0.001)))
    code, output = invoke("start", tmp_path / "part.inp")
    assert code == 0 and "TODO part.inp materials, support and pressure: a proposal" in output
    scene = scene_of(str(tmp_path / "part.py"))
    assert set(scene.contacts[0].tags) in [{"UPPER_BOTTOM", "LOWER_TOP"}, {"UPPER_Z0", "LOWER_Z1"}]
    found = hhr.FullOrderModel(scene)
    answer = found.solve(scene.parameters.middle)
    assert found.pressures(answer).sum() == pytest.approx(1.0, rel=1e-9)
    assert np.isclose(scene.bodies[0].young, 210e3)


def test_a_mesh_that_does_not_say_what_touches(tmp_path):
    """One bar: a plane out of reach stands for the contact that is to be chosen, and the scene
    runs.
    """
    (tmp_path / "part.inp").write_text(mesh_of(bar("")))
    code, output = invoke("start", tmp_path / "part.inp")
    assert (
        code == 0 and "TODO part.inp contact: no surfaces of two bodies face each other" in output
    )
    code, output = invoke("check", tmp_path / "part.py", "--picture", tmp_path / "part.png")
    assert code == 0 and "mistake" not in output, output


STATED = {
    "part.feb": (
        """<febio_spec version="4.0"><Material>
<material id="1" name="steel" type="Mooney-Rivlin"><c1>1000</c1></material></Material>
<Mesh><Nodes>{nodes}</Nodes>
<Elements type="hex8" name="Part1"><elem id="1">1,2,3,4,5,6,7,8</elem></Elements></Mesh>
<Boundary>
<bc name="Lid" node_set="Lid" type="prescribed displacement"><dof>z</dof>
<value lc="1">-0.05</value></bc></Boundary>
<Contact>
<contact name="C" type="sliding-elastic"><fric_coeff>0</fric_coeff></contact>
</Contact></febio_spec>""",
        '<node id="{}">{},{},{}</node>',
        ["part.feb:2 <material", "part.feb:6 <bc", "part.feb:9 <contact"],
    ),
    "part.k": (
        (
            "*KEYWORD\n*MAT_ELASTIC\n1,7.8e-9,1000.,0.\n*NODE\n{nodes}\n"
            "*ELEMENT_SOLID\n1,1,1,2,3,4,5,6,7,8\n*BOUNDARY_SPC_SET\n1,0,1,1,1\n"
            "*CONTACT_AUTOMATIC_SURFACE_TO_SURFACE\n1,2\n*END\n"
        ),
        "{},{},{},{}\n",
        ["part.k:2 *MAT_ELASTIC", "*BOUNDARY_SPC_SET", "*CONTACT_AUTOMATIC"],
    ),
    "part.mdpa": (
        "Begin Properties 1\nYOUNG_MODULUS 1000.0\nEnd Properties\nBegin Nodes\n{nodes}\nEnd "
        "Nodes\nBegin Elements SmallDisplacementElement3D8N\n1 1 1 2 3 4 5 6 7 8\nEnd "
        "Elements\nBegin NodalData DISPLACEMENT_Z\n5 1 -0.05\nEnd NodalData\n",
        "{} {} {} {}\n",
        ["part.mdpa:2 YOUNG_MODULUS 1000.0", "NodalData DISPLACEMENT_Z"],
    ),
    "part.bdf": (
        (
            "BEGIN BULK\nMAT1,1,1000.,,0.\n{nodes}\nCHEXA,1,1,1,2,3,4,5,6,+\n+,7,8\n"
            "SPC1,1,123,1\nENDDATA\n"
        ),
        "GRID,{},,{},{},{}\n",
        ["part.bdf:2 MAT1", "SPC1"],
    ),
}


@needs("mesh_formats")
@pytest.mark.parametrize("name", STATED)
def test_physics_of_other_files_is_named_line_by_line(name, tmp_path):
    """What a file states is not silently replaced by steel; the formats are those of their
    manuals.
    """
    text, node, wanted = STATED[name]
    square = ((0, 0), (1, 0), (1, 1), (0, 1))
    nodes = "".join(
        node.format(4 * z + k, x, y, z) for z in (0, 1) for k, (x, y) in enumerate(square, 1)
    )
    (tmp_path / name).write_text(text.replace("{nodes}", nodes.rstrip()))
    code, output = invoke("start", tmp_path / name)
    assert code == 0 and "which is not that of the file" in output, output
    for words in wanted:
        assert words in output and "the file states" in output
    assert output.count(f"TODO {name}:") == len(wanted)


@pytest.mark.parametrize(
    ("kind", "hypothesis"),
    [("CAX4", "axisymmetric"), ("CPS4", "plane_stress"), ("CPE4", "plane_strain")],
)
def test_the_hypothesis_of_a_mesh_is_that_of_its_elements(kind, hypothesis, tmp_path):
    """Manuals of CalculiX and Abaqus: CAX is axisymmetric, CPS plane stress, whether or not a
    material is there.
    """
    nodes = "*NODE\n1, 1., 0.\n2, 2., 0.\n3, 2., 1.\n4, 1., 1.\n"
    (tmp_path / "part.inp").write_text(f"{nodes}*ELEMENT, TYPE={kind}, ELSET=BODY\n7, 1, 2, 3, 4\n")
    code, output = invoke("start", tmp_path / "part.inp")
    assert code == 0 and scene_of(str(tmp_path / "part.py")).hypothesis == hypothesis, output


FEBIO = """<febio_spec version="4.0">
<Material>
<material id="1" name="steel" type="isotropic elastic"><E>1000</E><v>0</v></material></Material>
<Mesh>
{mesh}
<Surface name="Foot"><quad4 id="1">11,14,13,12</quad4></Surface>
<Surface name="Roof"><quad4 id="1">5,6,7,8</quad4></Surface>
<NodeSet name="Floor">1,2,3,4</NodeSet><NodeSet name="Lid">15,16,17,18</NodeSet>
<SurfacePair name="Touch"><primary>Foot</primary><secondary>Roof</secondary></SurfacePair>
</Mesh>
<MeshDomains><SolidDomain name="Part1" mat="steel"/><SolidDomain name="Part2" mat="steel"/>
</MeshDomains>
<Boundary>
<bc node_set="Floor" type="zero displacement"><x_dof>1</x_dof><y_dof>1</y_dof><z_dof>1</z_dof></bc>
<bc node_set="Lid" type="prescribed displacement"><dof>z</dof><value lc="1">-0.1</value></bc>
<bc node_set="Lid" type="zero displacement"><x_dof>1</x_dof><y_dof>1</y_dof></bc>
</Boundary>
<Contact>
<contact surface_pair="Touch" type="sliding-elastic"><penalty>100</penalty>
<fric_coeff>0.1</fric_coeff>{more}</contact>
</Contact>
<LoadData>
<load_controller id="1" type="loadcurve"><points><point>0,0</point><point>1,0.5</point></points>
</load_controller></LoadData>
</febio_spec>"""


CONTROL = "<Control><time_steps>{}</time_steps><step_size>{}</step_size></Control>"
UNIT_TIME = CONTROL.format(10, 0.1)


def febio(folder, *changes, more="", control=UNIT_TIME):
    """Scene of two cubes of 10, .02 apart, and what ``hhr start`` says.

    Texts of the file are exchanged in pairs.
    """
    mesh = ""
    for part, z, first in ((1, 0.0, 1), (2, 10.02, 11)):
        square = ((0, 0), (10, 0), (10, 10), (0, 10))
        places = [(x, y, z + 10 * up) for up in (0, 1) for x, y in square]
        rows = "".join(
            f'<node id="{first + k}">{x},{y},{h}</node>' for k, (x, y, h) in enumerate(places)
        )
        corners = ",".join(str(first + k) for k in range(8))
        cell = f'<elem id="{part}">{corners}</elem>'
        mesh += f'<Nodes>{rows}</Nodes><Elements type="hex8" name="Part{part}">{cell}</Elements>'
    text = (
        FEBIO.replace("{mesh}", mesh)
        .replace("{more}", more)
        .replace("<Material>", control + "<Material>")
    )
    for old, new in zip(changes[::2], changes[1::2], strict=True):
        assert old in text
        text = text.replace(old, new)
    (folder / "part.feb").write_text(text)
    code, output = invoke("start", folder / "part.feb", "--force")
    assert code == 0, output
    return scene_of(str(folder / "part.py")), output


def force(scene):
    return hhr.FullOrderModel(scene).solve(scene.parameters.middle).forces().sum()


@needs("mesh_formats")
@pytest.mark.parametrize("more", ["", "<tension>1</tension>"])
def test_physics_of_a_file_of_febio(more, tmp_path):
    """Two cubes of 10, .02 apart, closed by half of .1: the force is E .03 / 20 times 100.

    Manual of FEBio 4.
    """
    scene, output = febio(tmp_path, more=more)
    assert ("TODO" in output) == bool(more) == ("<tension>" in output), output
    assert scene.contacts[0].slave == "Foot" and scene.contacts[0].friction == 0.1
    assert force(scene) == pytest.approx(150.0, rel=1e-9)


def curve(points, interpolate="LINEAR", extend="CONSTANT"):
    rows = "".join(f"<pt>{time},{value}</pt>" for time, value in points)
    words = f"<interpolate>{interpolate}</interpolate><extend>{extend}</extend>"
    return f'<load_controller id="1" type="loadcurve">{words}<points>{rows}</points>'


OLD_CURVE = (
    '<load_controller id="1" type="loadcurve">'
    "<points><point>0,0</point><point>1,0.5</point></points>"
)
LINE = ((0, 0), (1, 1))
WAVE = ((0, 0), (1, 1), (2, 0), (3, 2))


@needs("mesh_formats")
@pytest.mark.parametrize(
    ("end", "points", "words", "value"),
    [
        (0.8, LINE, (), 0.8),
        (1.0, ((0, 0), (1, 1), (2, 0)), (), 1.0),
        (1.0, ((0, 0), (0.5, 0.4)), ("LINEAR", "EXTRAPOLATE"), 0.8),
        (1.0, ((0, 0), (0.5, 0.4)), ("LINEAR", "CONSTANT"), 0.4),
        (1.0, ((0.5, 0.25), (2, 4)), (), 0.25 + 3.75 / 3),
        (2.25, LINE, ("LINEAR", "REPEAT"), 0.25),
        (2.0, LINE, ("LINEAR", "REPEAT"), 1.0),
        (2.25, LINE, ("LINEAR", "REPEAT OFFSET"), 2.25),
        (0.8, LINE, ("STEP",), 1.0),
        (0.25, LINE, ("SMOOTH STEP",), 0.25**3 * (10 - 15 * 0.25 + 6 * 0.25**2)),
        (0.75, LINE, ("SMOOTH",), 0.75),
        (0.5, ((0, 0), (1, 1), (2, 0)), ("SMOOTH",), 0.75),  # 2 t - t^2
        # mean of 3/4 and 1/8, of parabolas through points 0 to 2 and 1 to 3
        (1.5, WAVE, ("SMOOTH",), 0.4375),
        (2.5, WAVE, ("smooth",), 0.625),  # parabola through the last three points
    ],
)
def test_a_load_curve_has_its_value_at_the_end_of_the_computation(
    end, points, words, value, tmp_path
):
    """Manual of FEBio 4, section LoadData, and FECore/PointCurve.cpp: time_steps times step_size is
    the end.
    """
    control = CONTROL.format(10, end / 10)
    scene, output = febio(tmp_path, OLD_CURVE, curve(points, *words), control=control)
    assert "TODO" not in output, output
    moved = scene.parameters.middle[scene.parameters.names.index("displacement")]
    assert moved == pytest.approx(-0.1 * value, rel=1e-9)


@needs("mesh_formats")
def test_the_force_at_the_end_of_a_load_curve(tmp_path):
    """A curve from 0 to 1 that ends at .9: .09 less .02 is closed, which is E .07 / 20 times
    100.
    """
    scene, _ = febio(tmp_path, OLD_CURVE, curve(LINE), control=CONTROL.format(9, 0.1))
    assert force(scene) == pytest.approx(350.0, rel=1e-9)


@needs("mesh_formats")
def test_steps_of_febio_add_their_times(tmp_path):
    """FEModelBuilder.cpp of FEBio: the first step takes over the Control outside of it, others have
    theirs.
    """
    steps = f'<Step><step id="1"/><step id="2">{CONTROL.format(1, 0.5)}</step></Step></febio_spec>'
    changes = OLD_CURVE, curve(((0, 0), (2, 1))), "</febio_spec>", steps
    scene, output = febio(tmp_path, *changes, control=CONTROL.format(1, 0.7))
    assert scene.parameters.middle[0] == pytest.approx(-0.06, rel=1e-9)
    assert output.count("TODO") == 2  # the steps


@needs("mesh_formats")
@pytest.mark.parametrize(
    ("changes", "todo"),
    [
        ((OLD_CURVE, '<load_controller id="1" type="math"><math>0.8*t</math>'), "is of type math"),
        ((OLD_CURVE, OLD_CURVE.replace('id="1"', 'id="2"')), "the file has no load_controller 1"),
        (
            (OLD_CURVE, curve(((0, 0), (0.5, 1), (3, 2)), "CUBIC SPLINE")),
            "interpolate CUBIC SPLINE",
        ),
        ((OLD_CURVE, curve(WAVE, "STEP")), "interpolate STEP"),  # jumps at the end
        ((OLD_CURVE, curve(((1, 0), (0, 1)))), "the points of load_controller 1 are not read"),
        (("<fric_coeff>0.1", '<fric_coeff lc="7">0.1'), "the file has no load_controller 7"),
        (
            ("<fric_coeff>0.1", '<fric_coeff type="math">X'),
            "<fric_coeff>: the file states it, and it is not read: X",
        ),
        (("<contact ", '<contact active="0" '), '<contact active="0">'),
        (
            ("</febio_spec>", '<Loads from="loads.feb"/></febio_spec>'),
            '<Loads from="loads.feb">: this section',
        ),
        (
            ("</febio_spec>", "<Include>loads.feb</Include></febio_spec>"),
            '<Include from="loads.feb">: this section',
        ),
        (("<E>1000", '<E lc="3">1000'), "the file states a material"),
        (("<time_steps>10", "<time_steps>ten"), "<Control>: the file does not say when"),
    ],
)
def test_what_is_not_read_of_a_file_of_febio_is_a_todo_line(changes, todo, tmp_path):
    _, output = febio(tmp_path, *changes)
    assert "TODO part.feb" in output and todo in output, output


@needs("mesh_formats")
def test_contact_in_a_step_of_febio_is_lost_with_a_word(tmp_path):
    """A scene without the contact of its file has other answers: ``hhr start`` ends with its code
    for that.
    """
    febio(tmp_path)
    text = (tmp_path / "part.feb").read_text()
    text = text.replace("<Contact>", '<Step><step id="1"><Contact>').replace(
        "</Contact>", "</Contact></step></Step>"
    )
    (tmp_path / "part.feb").write_text(text)
    code, output = invoke("start", tmp_path / "part.feb", "--force")
    assert code == 3 and "states contact" in output, output


@needs("mesh_formats")
def test_load_curves_of_materials_and_friction(tmp_path):
    """All numbers of FEBio may have a curve: E is 2 * 1000 and the friction 2 * .1 at the end,
    which is t = 1.
    """
    more = (
        '<load_controller id="2" type="loadcurve">'
        "<points><pt>0,1</pt><pt>1,2</pt></points></load_controller>"
    )
    changes = (
        "<E>",
        '<E lc="2">',
        "<fric_coeff>",
        '<fric_coeff lc="2">',
        "</LoadData>",
        f"{more}</LoadData>",
    )
    scene, output = febio(tmp_path, *changes)
    assert "TODO" not in output and scene.contacts[0].friction == 0.2
    assert force(scene) == pytest.approx(300.0, rel=1e-9)


@needs("mesh_formats")
def test_node_sets_of_febio_are_ranges_too(tmp_path):
    """Manual of FEBio 4, section Mesh: ranges have both ends, and a step."""
    scene, output = febio(tmp_path, ">1,2,3,4<", ">1:4<", ">15,16,17,18<", ">15, 16:18:2, 17<")
    assert "TODO" not in output and force(scene) == pytest.approx(150.0, rel=1e-9)
