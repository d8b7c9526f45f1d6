"""The command ``hhr march``: the answers along a path of a scene's file."""

import json

import numpy as np
import pytest
from needs import needs
from shell import invoke

import hhr_dolfinx as hhr
from hhr_dolfinx.command.loading import beside, scene_of

SCENE = """
import hhr_dolfinx as hhr
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side, two_blocks

TOP = side(SECOND, 1, True)
scene = hhr.Scene(
    name="pushed",
    geometry=lambda comm: two_blocks(
        comm, first=((0.0, -1.0), (2.0, 0.0), (4, 2)), second=((0.0, 0.0), (2.0, 1.0), (4, 2))
    ),
    hypothesis="plane_strain",
    bodies=tuple(hhr.Body(tag, 1000.0, 0.0) for tag in (FIRST, SECOND)),
    contacts=(
        hhr.NodeToNode(side(FIRST, 1, True), side(SECOND, 1, False), (0.0, 1.0), friction=0.3),
    ),
    displacements=(
        *hhr.Displacement.clamp(side(FIRST, 1, False), 2),
        hhr.Displacement(TOP, 0, "push"),
        hhr.Displacement(TOP, 1, "press"),
    ),
    parameters=hhr.ParameterSpace(("press", "push"), (-0.02, -0.1), (0.0, 0.1)),
    outputs=(hhr.LargestPressure("largest", 0),),
)
PATHS = hhr.PathFamily(
    "to and fro",
    scene.parameters,
    hhr.ParameterSpace(("far",), (0.01,), (0.03,)),
    {"press": 0.0, "push": 0.0},
    (
        hhr.Leg({"press": -0.01}, 1.0, 2),
        hhr.Leg({"push": "far"}, 1.0, 3),
        hhr.Leg({"push": "-far"}, 2.0, 4),
    ),
)
"""


@pytest.fixture
def scene(tmp_path):
    """A file with a scene and its paths."""
    (tmp_path / "pushed.py").write_text(SCENE)
    return tmp_path / "pushed.py"


@needs("friction")
def test_rows_are_the_answers_of_the_path(scene, tmp_path):
    """The middle of the family without --at.

    A table has what is shown, and the digits that are not.
    """
    code, output = invoke("march", scene, "--out", tmp_path / "steps.csv")
    assert code == 0
    *lines, written = output.splitlines()
    assert written == f"table: {tmp_path / 'steps.csv'}"
    assert lines[0] == "to and fro (far = 0.02)"
    assert lines[1].split()[-1] == "largest"
    assert len({len(line) for line in lines[1:]}) == 1  # columns stand below their names
    rows = np.genfromtxt(tmp_path / "steps.csv", delimiter=",", skip_header=1)
    np.testing.assert_allclose(
        [[float(word) for word in line.split()] for line in lines[2:]], rows, rtol=1e-5
    )
    family = beside(str(scene), "PATHS")
    history = hhr.FullOrderModel(scene_of(str(scene))).march(family.path({"far": 0.02}))
    np.testing.assert_array_equal(rows[:, 0], [answer.time for answer in history.answers])
    np.testing.assert_allclose(
        rows[:, -1], [answer.outputs().values["largest"] for answer in history.answers]
    )


@needs("friction")
def test_a_model_answers_the_same(scene, tmp_path):
    """A condensed model is exact with friction, so its rows are those of the full model at another
    point.
    """
    model = hhr.condense(scene_of(str(scene)))
    hhr.save_model(tmp_path / "model.npz", model)
    _, full = invoke("march", scene, "--at", "far=0.03")
    code, output = invoke("march", scene, "--at", "far=0.03", "--model", tmp_path / "model.npz")
    assert code == 0
    # the model knows no pairs, so that its sum of forces has a name of its own; numbers are the
    # same
    assert [line.split() for line in output.splitlines()[2:]] == [
        line.split() for line in full.splitlines()[2:]
    ]


@needs("friction")
def test_solve_refers_to_the_paths(scene):
    """Its answer is that of one step from rest, which is not that of the steps."""
    code, output = invoke("solve", scene)
    assert code == 0
    assert f"one step from rest: hhr march {scene} follows" in " ".join(output.split())


@needs("plots", "friction")
def test_fields_of_all_steps(scene, tmp_path):
    """A file for each step, which ParaView opens as one."""
    assert invoke("march", scene, "--out", tmp_path / "fields.vtu")[0] == 0
    assert len(list(tmp_path.glob("fields_*.vtu"))) == 9
    assert (tmp_path / "fields.pvd").is_file()


@needs("plots", "friction")
def test_steps_in_vtkhdf_are_a_series(scene, tmp_path):
    """ParaView's reader of .pvd knows XML files alone."""
    code, output = invoke("march", scene, "--out", tmp_path / "fields.vtkhdf")
    assert code == 0 and output.splitlines()[-1] == f"fields: {tmp_path / 'fields.vtkhdf.series'}"
    series = json.loads((tmp_path / "fields.vtkhdf.series").read_text())
    assert series["file-series-version"] == "1.0"
    assert all((tmp_path / step["name"]).is_file() for step in series["files"])
    assert [step["time"] for step in series["files"]] == pytest.approx(
        [0.5, 1, *(1 + k / 3 for k in (1, 2, 3)), 2.5, 3, 3.5, 4]
    )
    assert not (tmp_path / "fields.pvd").exists()


@needs("friction")
@pytest.mark.parametrize(
    ("words", "said"),
    [(["--at", "far=1"], "far = 1 is outside"),
     (["--at", "push=1"], "'push' is no parameter: there are far"),
     (["--out", "steps.txt"], "must end in .csv or .vtkhdf or .vtu"),
     (["--model", "model.npz", "--out", "fields.vtu"], "leave out --model")],
)  # fmt: skip
def test_mistakes(words, said, scene):
    """Sentences that say what to do, before anything is solved."""
    code, output = invoke("march", scene, *words)
    assert code != 0
    assert said in output


def test_a_scene_without_paths(scene):
    """The remedy is named."""
    scene.write_text(SCENE[: SCENE.index("PATHS")])
    code, output = invoke("march", scene)
    assert code == 3
    assert "put PATHS = hhr.PathFamily(...) in its file, or call hhr solve" in output
