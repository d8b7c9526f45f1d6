"""What a command file of code_aster says is what its scene has, and what it does not have is a TODO
line.

Two cubes of 10 x 10 x 10 with E = 1000 and nu = 0 have a gap of 0.02 between them. A lid that falls
by d needs the force E 10 (d - 0.02) / 2, which is 150 for d = 0.05; a pressure p on it needs 100 p.
"""

from dataclasses import replace

import numpy as np
import pytest
from needs import needs
from shell import invoke

import hhr_dolfinx as hhr
from hhr_dolfinx.command.loading import scene_of
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.plugins.decks.commands import deck_of
from hhr_dolfinx.plugins.decks.deck import Pair

pytestmark = needs("mesh_formats")


def cube(first, height):
    """Lines of the nodes of a cube, which begins at a height."""
    corners = [(x, y, z) for z in (0, 10) for x, y in ((0, 0), (10, 0), (10, 10), (0, 10))]
    return "".join(f"N{first + k} {x} {y} {z + height}\n" for k, (x, y, z) in enumerate(corners))


def faces(first):
    """The lower and the upper face of a cube."""
    low, high = ([f"N{first + k}" for k in range(start, start + 4)] for start in (0, 4))
    return " ".join(low[::-1]), " ".join(high)


def group(name, item, kind="MA"):
    return f"GROUP_{kind} NOM={name}\n{item}\nFINSF\n"


NAMES = (
    ("LOWER", "M1"),
    ("UPPER", "M2"),
    ("FLOOR", "F1"),
    ("SLOW", "F2"),
    ("SUP", "F3"),
    ("LID", "F4"),
)
BODIES_AND_SIDES = "".join(group(name, item) for name, item in NAMES)
SIDES = [*faces(1), *faces(11)]
CUBES = (
    f"COOR_3D\n{cube(1, 0)}{cube(11, 10.02)}FINSF\nHEXA8\n"
    f"M1 {' '.join(f'N{1 + k}' for k in range(8))}\nM2 "
    f"{' '.join(f'N{11 + k}' for k in range(8))}\nFINSF\nQUAD4\n"
    + "".join(f"F{k} {side}\n" for k, side in enumerate(SIDES, 1))
    + "FINSF\n"
    + BODIES_AND_SIDES
    + group("ALLN", " ".join(f"N{k}" for k in (*range(1, 9), *range(11, 19))), "NO")
    + group("EDGE", "N15 N16", "NO")
    + "FIN\n"
)
PUSH = "DDL_IMPO=_F(GROUP_MA='LID', DZ=-0.05)"
COMM = """
{before}MA = LIRE_MAILLAGE(FORMAT='ASTER')
MO = AFFE_MODELE(MAILLAGE=MA, AFFE=_F(TOUT='OUI', PHENOMENE='MECANIQUE', MODELISATION={model}))
MAT = DEFI_MATERIAU(ELAS=_F(E={young}, NU=0.0, RHO=1.0))
SOFT = DEFI_MATERIAU(ELAS=_F(E=500.0, NU=0.0))
CHM = AFFE_MATERIAU(MAILLAGE=MA, AFFE={bodies})
HOLD = AFFE_CHAR_MECA(MODELE=MO, DDL_IMPO=(_F(GROUP_MA='FLOOR', LIAISON='ENCASTRE'),
                                           _F(GROUP_NO='ALLN', DX=0.0, DY=0.0)))
PUSH = AFFE_CHAR_MECA(MODELE=MO, {push})
CON = DEFI_CONTACT(MODELE=MO, FORMULATION='CONTINUE',
                   ZONE=_F(GROUP_MA_ESCL='SUP', GROUP_MA_MAIT='SLOW'))
L = DEFI_LIST_REEL(DEBUT=0.0, INTERVALLE=_F(JUSQU_A=1.0, NOMBRE=4))
{more}{solver}FIN()
"""
SOLVER = """RES = STAT_NON_LINE(MODELE=MO, CHAM_MATER=CHM,
                   EXCIT=(_F(CHARGE=HOLD), _F(CHARGE=PUSH{function}){charges}),
                   {contact} INCREMENT=_F(LIST_INST=L{end}), COMPORTEMENT=_F(RELATION='ELAS'))
"""
WORDS = {
    "before": "",
    "model": "'3D'",
    "young": "1000.0",
    "bodies": "_F(TOUT='OUI', MATER=MAT)",
    "push": PUSH,
    "more": "",
    "function": "",
    "charges": "",
    "contact": " CONTACT=CON,",
    "end": "",
}


def written(folder, mesh=CUBES, solver=SOLVER, text=COMM, **words):
    """Command file beside its mesh."""
    (folder / "run.mail").write_text(mesh)
    words = {**WORDS, **words}
    words["solver"] = solver.format(**words)
    (folder / "run.comm").write_text(text.format(**words))
    return folder / "run.comm"


def left_of(path):
    return [f"{one.keyword}: {one.why}" for one in deck_of(path).left]


def force(path):
    """Force between the bodies along the last axis."""
    code, output = invoke("start", path)
    assert code == 0, output
    scene = scene_of(str(path.with_suffix(".py")))
    axis = tuple(np.eye(2 if scene.hypothesis != "solid" else 3)[-1].tolist())
    full = hhr.FullOrderModel(replace(scene, outputs=(hhr.ContactForce("force", 0, axis),)))
    return abs(full.solve(scene.parameters.middle).outputs()["force"])


def motion(path):
    """The imposed displacement of the lid."""
    (value,) = {one.value for one in deck_of(path).supports if one.value}
    return value


def value_of_load(path):
    (load,) = deck_of(path).loads
    return load.value


CURVE = "F = DEFI_FONCTION(NOM_PARA='INST', VALE=(0.0, 0.0, 1.0, 1.0){more})\n"
MULT = ", FONC_MULT=F"


@pytest.mark.parametrize(
    ("words", "moved"),
    [
        ({"more": CURVE.format(more=""), "end": ", INST_FIN=0.8"}, -0.04),
        ({"more": CURVE.format(more="") + "L = DEFI_LIST_REEL(VALE=(0.0, 0.8))\n"}, -0.04),
        (
            {"more": CURVE.format(more="") + "L = DEFI_LIST_INST(DEFI_LIST=_F(LIST_INST=L))\n"},
            -0.05,
        ),
        (
            {
                "more": (
                    "F = DEFI_FONCTION(NOM_PARA='INST', ABSCISSE=(0.0, 1.0), ORDONNEE=(0.0, 2.0))\n"
                )
            },
            -0.1,
        ),
        ({"more": CURVE.format(more=", PROL_DROITE='CONSTANT'"), "end": ", INST_FIN=2.0"}, -0.05),
        ({"more": CURVE.format(more=", PROL_DROITE='LINEAIRE'"), "end": ", INST_FIN=2.0"}, -0.1),
        ({"more": "F = DEFI_CONSTANTE(VALE=2.0)\n"}, -0.1),
        ({"more": "", "function": ", COEF_MULT=0.5"}, -0.025),
    ],
)
def test_a_function_has_its_value_at_the_end(words, moved, tmp_path):
    """By linear interpolation, and beyond the last point as PROL_DROITE says: U4.31.02 of
    code_aster.
    """
    path = written(tmp_path, **{"function": MULT, **words})
    assert left_of(path) == []
    assert motion(path) == pytest.approx(moved, rel=1e-12)


@pytest.mark.parametrize(
    ("curve", "why"),
    [(CURVE.format(more="").replace("1.0, 1.0)", "0.5, 1.0)"), "that has no value at the end, 1:"),
     (CURVE.format(more=", INTERPOL='LOG'"), "that is not read: a DEFI_FONCTION of INST"),
     (CURVE.format(more="").replace("'INST'", "'X'"), "that is not read: a DEFI_FONCTION of INST"),
     ("F = FORMULE(NOM_PARA='INST', VALE='INST')\n", "that is not read"),
     (CURVE.format(more="") + "L = times()\n", "of a time whose end is not literal")],
)  # fmt: skip
def test_a_function_without_a_known_end_is_left(curve, why, tmp_path):
    """EXCLU, the default of PROL_DROITE, has no value beyond the last point: U4.31.02 of
    code_aster.
    """
    path = written(tmp_path, more=curve, function=MULT)
    assert any(f"a load is multiplied by a function {why}" in line for line in left_of(path))
    assert motion(path) == -0.05


def test_loads_and_contact_that_no_solver_names_do_not_act(tmp_path):
    """The lid alone acts, without friction: U4.51.03 of code_aster, EXCIT and CONTACT.

    Both are named as such.
    """
    more = (
        "MORE = AFFE_CHAR_MECA(MODELE=MO, PRES_REP=_F(GROUP_MA='LID', PRES=3.0), "
        "DDL_IMPO=_F(GROUP_MA='SUP', DZ=-0.04))\n"
        "OTHER = DEFI_CONTACT(MODELE=MO, FROTTEMENT='COULOMB', ZONE=_F(GROUP_MA_ESCL='SLOW', "
        "GROUP_MA_MAIT='SUP', COULOMB=0.4))\n"
    )
    path = written(tmp_path, more=more)
    deck = deck_of(path)
    assert deck.loads == () and len(deck.pairs) == 1 and deck.pairs[0].friction == 0.0
    assert motion(path) == -0.05
    assert left_of(path) == [
        "AFFE_CHAR_MECA: it does not act: no EXCIT of STAT_NON_LINE names it",
        "DEFI_CONTACT: it does not act: STAT_NON_LINE does not name it",
    ]


def test_contact_that_the_solver_does_not_name_does_not_act(tmp_path):
    """Bodies pass through each other, and the scene has the plane out of reach that scenes without
    contact have.
    """
    deck = deck_of(written(tmp_path, contact=""))
    assert [pair.source for pair in deck.pairs] == ["no contact in the file: a plane out of reach"]
    assert not deck.contact_lost and isinstance(deck.pairs[0], Pair)


def test_all_act_in_a_file_without_a_solver(tmp_path):
    path = written(tmp_path, solver="")
    whole = "no MECA_STATIQUE or STAT_NON_LINE names it: it acts whole"
    assert left_of(path) == [f"AFFE_CHAR_MECA: {whole}"] * 2 + [f"DEFI_CONTACT: {whole}"]
    assert motion(path) == -0.05


def test_the_model_and_the_materials_of_the_solver_count(tmp_path):
    """Fields of materials that no solver names do not double the bodies."""
    more = "UNUSED = AFFE_MATERIAU(MAILLAGE=MA, AFFE=_F(TOUT='OUI', MATER=SOFT))\n"
    assert [one.material.young for one in deck_of(written(tmp_path, more=more)).sections] == [
        1000.0,
        1000.0,
    ]


@pytest.mark.parametrize(
    ("before", "moved"),
    [
        ("d = -0.02\ne = d = -0.05\n", -0.05),
        ("d, e = -0.05, 1.0\n", -0.05),
        ("d = -0.02\n(e, d) = [1.0, -0.05]\n", -0.05),
        ("d = -0.1\nd *= 0.5\n", -0.05),
        ("d = -0.02\nd: float = -0.05\n", -0.05),
        ("d = -5 * 10.**-2\n", -0.05),
        ("d = -(+0.05)\n", -0.05),
        ("d = -0.05\ndef f():\n    d = 1.0\n", -0.05),
    ],
)
def test_names_have_the_values_that_they_are_given(before, moved, tmp_path):
    """The owner is Python itself."""
    path = written(tmp_path, before=before, push="DDL_IMPO=_F(GROUP_MA='LID', DZ=d)")
    bound = {}
    exec(before, {}, bound)
    assert motion(path) == pytest.approx(moved, rel=1e-15) and bound["d"] == pytest.approx(
        moved, rel=1e-15
    )


@pytest.mark.parametrize(
    "before",
    [
        "if True:\n    d = -0.05\n",
        "for d in (1.0,):\n    pass\n",
        "d, *e = -0.05, 1.0\n",
        "d, e = pair()\n",
        "d += f()\n",
        "from math import pi as d\n",
        "import d\n",
        "del d\n",
        "with open('x') as d:\n    pass\n",
        "def d():\n    pass\n",
        "print(d := 3.0)\n",
        "try:\n    d = 1.0\nexcept OSError as d:\n    pass\n",
        "def f():\n    global d\n    d = 1.0\nf()\n",
        "match 1:\n    case d:\n        pass\n",
        "d = 0.0 ** -1\n",
        "while False:\n    d = 1.0\n",
        "d.x = 1.0\n",
    ],
)
def test_a_name_that_may_have_changed_has_no_value(before, tmp_path):
    path = written(
        tmp_path, before=f"d = -0.02\n{before}", push="DDL_IMPO=_F(GROUP_MA='LID', DZ=d)"
    )
    assert "AFFE_CHAR_MECA DDL_IMPO: DZ of DDL_IMPO is not literal" in left_of(path)


@pytest.mark.parametrize(
    "change", ["groups[0] = 'SUP'", "groups.append('SUP')", "other[0] = 'SUP'", "del groups[0]"]
)
def test_a_list_that_may_have_changed_has_no_value(change, tmp_path):
    before = f"groups = ['LID']\nother = groups\n{change}\n"
    path = written(tmp_path, before=before, push="DDL_IMPO=_F(GROUP_MA=groups, DZ=-0.05)")
    assert "AFFE_CHAR_MECA DDL_IMPO: GROUP_MA of DDL_IMPO is not literal" in left_of(path)


def test_words_that_are_not_literal_are_left(tmp_path):
    """Parts of lists, unpacked words, and charges with other names."""
    path = written(
        tmp_path,
        push="DDL_IMPO=(_F(GROUP_MA=('LID', name), DZ=-0.05), other, _F(**more))",
        charges=", _F(CHARGE=ALSO)",
    )
    assert left_of(path) == [
        "AFFE_CHAR_MECA: DDL_IMPO of AFFE_CHAR_MECA is not literal",
        "AFFE_CHAR_MECA DDL_IMPO: GROUP_MA of DDL_IMPO is not literal",
        "AFFE_CHAR_MECA DDL_IMPO: **: it is not read",
        "STAT_NON_LINE EXCIT: CHARGE of EXCIT is not literal",
    ]


@pytest.mark.parametrize("young", ["10.**3", "+1000.0", "2e3 / 2", "500 * 2"])
def test_powers_and_signs_are_read(young, tmp_path):
    assert {one.material.young for one in deck_of(written(tmp_path, young=young)).sections} == {
        1000.0
    }


@pytest.mark.parametrize("direction", ["(0, 0, -1)", "(0.0, 0.0, -2.0)", "(0.0, 0.0, -0.1)"])
def test_gravity_has_the_direction_alone(direction, tmp_path):
    """g rho V = 0.1 * 1000 for any length of DIRECTION, which code_aster normalises: U4.44.01,
    PESANTEUR.
    """
    push = f"PESANTEUR=_F(GRAVITE=0.1, DIRECTION={direction})"
    deck = deck_of(written(tmp_path, push=push))
    assert [(one.value, "(0.0, 0.0, -1.0)" in one.text) for one in deck.loads] == [(0.1, True)] * 2


def test_gravity_without_a_direction_or_a_density_is_left(tmp_path):
    push = "PESANTEUR=_F(GRAVITE=0.1, DIRECTION=({}, 0.0, 0.0))"
    lines = left_of(written(tmp_path, push=push.format(0.0)))
    assert any("DIRECTION of PESANTEUR is zero" in line for line in lines)
    lines = left_of(written(tmp_path, push=push.format(1.0), bodies="_F(TOUT='OUI', MATER=SOFT)"))
    assert any("the material of body 'LOWER' has no RHO" in line for line in lines)


def test_a_later_material_replaces_that_of_all(tmp_path):
    """Cubes of 1000 and 500 in series: 100 * 0.03 / (10 / 1000 + 10 / 500) = 100.

    U1.03.00, rule of surcharge.
    """
    path = written(tmp_path, bodies="(_F(TOUT='OUI', MATER=MAT), _F(GROUP_MA='UPPER', MATER=SOFT))")
    deck = deck_of(path)
    assert {one.tag: one.material.young for one in deck.sections} == {
        "LOWER": 1000.0,
        "UPPER": 500.0,
    }
    assert force(path) == pytest.approx(100.0, rel=1e-8)
    deck = deck_of(
        written(tmp_path, bodies="(_F(GROUP_MA='UPPER', MATER=SOFT), _F(TOUT='OUI', MATER=MAT))")
    )
    assert {one.tag: one.material.young for one in deck.sections} == {
        "LOWER": 1000.0,
        "UPPER": 1000.0,
    }


def test_a_part_without_a_name_that_keeps_its_material_is_refused(tmp_path):
    mesh = CUBES.replace(group("LOWER", "M1"), group("LOWER", "M1 M2"))
    path = written(
        tmp_path, mesh, bodies="(_F(GROUP_MA='LOWER', MATER=MAT), _F(GROUP_MA='UPPER', MATER=SOFT))"
    )
    with pytest.raises(
        SceneError, match="a later group replaces the material of a part of its cells"
    ):
        deck_of(path)


@pytest.mark.parametrize(
    ("push", "value"),
    [("PRES_REP=(_F(GROUP_MA='LID', PRES=1.0), _F(GROUP_MA='LID', PRES=2.0))", 2.0),
     ("FORCE_FACE=(_F(GROUP_MA='LID', FZ=-1.0), _F(GROUP_MA='LID', FZ=-2.0))", -2.0),
     ("FORCE_NODALE=(_F(GROUP_NO='EDGE', FZ=-1.0), _F(GROUP_NO='EDGE', FZ=-2.0))", -2.0)],
)  # fmt: skip
def test_the_last_load_of_a_keyword_on_a_group_counts(push, value, tmp_path):
    """Rule of surcharge, U1.03.00 of code_aster."""
    path = written(tmp_path, push=push)
    assert left_of(path) == [] and value_of_load(path) == value


def test_the_last_displacement_of_a_keyword_on_a_group_counts(tmp_path):
    path = written(
        tmp_path, push="DDL_IMPO=(_F(GROUP_MA='LID', DZ=-0.03), _F(GROUP_MA='LID', DZ=-0.05))"
    )
    assert left_of(path) == [] and motion(path) == -0.05


def test_what_a_later_group_replaces_in_part_is_left(tmp_path):
    """Sets are not split: the line says so before a solver does."""
    path = written(
        tmp_path, push="DDL_IMPO=(_F(GROUP_MA='LID', DZ=-0.03), _F(GROUP_NO='EDGE', DZ=-0.05))"
    )
    assert any(
        "nodes of it have another displacement by run.comm:" in line for line in left_of(path)
    )
    path = written(
        tmp_path, push="FORCE_NODALE=(_F(GROUP_NO='ALLN', FZ=-0.03), _F(GROUP_NO='EDGE', FZ=-0.05))"
    )
    assert any("replaces a part of it, and here both act" in line for line in left_of(path))
    path = written(
        tmp_path, push="FORCE_FACE=(_F(GROUP_MA='LID', FZ=-0.03), _F(GROUP_MA='LID', FX=-0.05))"
    )
    assert any("replaces a part of it, and here both act" in line for line in left_of(path))


def test_loads_of_different_commands_add_up(tmp_path):
    more = "ALSO = AFFE_CHAR_MECA(MODELE=MO, PRES_REP=_F(GROUP_MA='LID', PRES=2.0))\n"
    push = "PRES_REP=_F(GROUP_MA='LID', PRES=1.0)"
    path = written(tmp_path, push=push, more=more, charges=", _F(CHARGE=ALSO)")
    assert left_of(path) == [] and [one.value for one in deck_of(path).loads] == [1.0, 2.0]


@pytest.mark.parametrize(
    ("words", "kept"),
    [
        ("ORIE_PEAU=_F(GROUP_MA_PEAU='SUP')", True),
        ("ORIE_PEAU_3D=_F(GROUP_MA='SUP')", True),
        ("ECHELLE=0.001", False),
        ("TRANSLATION=(0.0, 0.0, 1.0)", False),
        ("ROTATION=_F(ANGLE=90.0)", False),
        ("SYMETRIE=_F(POINT=(0, 0))", False),
        ("MODI_BASE=_F(VECT_X=(1, 0))", False),
        ("ABSC_CURV=_F(TOUT='OUI')", False),
        ("DEFORME=_F(OPTION='TRAN')", False),
    ],
)
def test_a_mesh_that_a_command_changes_is_left(words, kept, tmp_path):
    before = f"MA = MODI_MAILLAGE(reuse=MA, MAILLAGE=MA, {words})\n"
    lines = left_of(written(tmp_path, more=before))
    name = words.partition("=")[0]
    assert (lines == []) == kept
    assert kept or (
        lines[0].startswith(f"MODI_MAILLAGE: {name}") and "it changes the mesh" in lines[0]
    )


PLANE = (
    "COOR_2D\nN1 0 0\nN2 1 0\nN3 1 1\nN4 0 1\nN5 0 1\nN6 1 1\nN7 1 2\nN8 0 2\nFINSF\n"
    "QUAD4\nM1 N1 N2 N3 N4\nM2 N5 N6 N7 N8\nFINSF\nSEG2\nF1 N1 N2\nF2 N3 N4\nF3 N5 N6\nF4 N7 "
    "N8\nFINSF\n"
    + BODIES_AND_SIDES
    + group("RIM", "N7", "NO")
    + group("ALLN", "N1 N4 N5 N8", "NO")
    + "FIN\n"
)
IN_PLANE = COMM.replace(
    "_F(GROUP_NO='ALLN', DX=0.0, DY=0.0)", "_F(GROUP_NO='ALLN', DX=0.0)"
).replace("_F(GROUP_MA='FLOOR', LIAISON='ENCASTRE')", "_F(GROUP_MA='FLOOR', DY=0.0)")
RING = "FORCE_NODALE=_F(GROUP_NO='RIM', FY=-1.0)"


@pytest.mark.parametrize(
    ("model", "hypothesis"),
    [
        ("('AXIS',)", "axisymmetric"),
        ("['AXIS']", "axisymmetric"),
        ("'AXIS_SI'", "axisymmetric"),
        ("'C_PLAN_SI'", "plane_stress"),
        ("'D_PLAN_SI'", "plane_strain"),
        ("'C_PLAN'", "plane_stress"),
    ],
)
def test_a_model_has_its_hypothesis(model, hypothesis, tmp_path):
    """U3.14.01 of code_aster: _SI are the same models with fewer points of integration."""
    path = written(tmp_path, PLANE, text=IN_PLANE, model=model, push=RING)
    assert left_of(path) == [] and deck_of(path).hypothesis == hypothesis


@pytest.mark.parametrize("model", ["'AXIS_INCO_UPG'", "name", "'COQUE_AXIS'"])
def test_an_unknown_model_of_a_plane_mesh_is_refused(model, tmp_path):
    with pytest.raises(SceneError, match="AFFE_MODELE has no MODELISATION that is read"):
        deck_of(written(tmp_path, PLANE, text=IN_PLANE, model=model, push=RING))


def test_an_unknown_model_in_space_is_left(tmp_path):
    (line,) = left_of(written(tmp_path, model="'3D_INCO_UPG'"))
    assert line.startswith(
        "AFFE_MODELE AFFE: MODELISATION=3D_INCO_UPG: no counterpart: cells are solids"
    )
    assert left_of(written(tmp_path, model="'3D_SI'")) == []


def test_two_models_are_left(tmp_path):
    model = "'AXIS'), _F(GROUP_MA='UPPER', MODELISATION='C_PLAN'"
    text = IN_PLANE.replace("AFFE=_F(TOUT", "AFFE=(_F(TOUT").replace(
        "MODELISATION={model}))", "MODELISATION={model})))"
    )
    path = written(tmp_path, PLANE, text=text, model=model, push=RING)
    assert left_of(path) == ["_F: all cells are axisymmetric"]


def test_a_force_on_a_ring_is_that_of_a_radian(tmp_path):
    """FORCE_NODALE in axisymmetry is per radian, U4.44.01 of code_aster.

    hhr.NodalForce is that of the whole ring.
    """
    path = written(tmp_path, PLANE, text=IN_PLANE, model="'AXIS'", push=RING)
    assert value_of_load(path) == pytest.approx(-2 * np.pi, rel=1e-15)
    assert (
        value_of_load(written(tmp_path, PLANE, text=IN_PLANE, model="'D_PLAN'", push=RING)) == -1.0
    )


def test_contact_bears_the_force_on_a_ring(tmp_path):
    """A force of -1 per radian at a rim is -2 pi by equilibrium."""
    path = written(tmp_path, PLANE, text=IN_PLANE, model="'AXIS'", push=RING)
    assert force(path) == pytest.approx(2 * np.pi, rel=1e-8)
