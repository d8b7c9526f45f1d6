"""Geometries, pairings, laws and scenes by name: of a package that is really installed, and of
files.
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from needs import needs, present
from processes import python

import hhr_dolfinx as hhr
from hhr_dolfinx import by_name
from hhr_dolfinx.by_name import OWN, find, names, place_of
from hhr_dolfinx.errors import HHRError, SceneError

PACKAGE = Path(__file__).parents[1] / "external_package"
USE = """
import json, sys
from dataclasses import replace
import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.by_name import find, names

def said(kind, name):
    try:
        find(kind, name)
    except SceneError as error:
        return str(error)

flat, flowing = find("scenes", "slab_on_ramp")(), find("scenes", "flowing_slab")
Ramp = find("pairings", "Ramp")
ramp = Ramp(flat.contacts[0].surface, 0.01, 0.1)
steep = replace(flat, geometry=find("geometries", "slab"), contacts=(ramp,))
steps = [(0.0, [0.0]), (1.0, [0.05]), (50.0, [0.05])] if sys.argv[1:] == ["inelastic"] else []
relaxed = hhr.FullOrderModel(flowing()).march(steps).answers if steps else []
held = hhr.FullOrderModel(steep).solve(0.05)
print(json.dumps({
    "names": {kind: names(kind) for kind in ("geometries", "pairings", "laws", "scenes")},
    "force": hhr.FullOrderModel(flat).solve(0.05).forces().sum(),
    "relaxed": [step.forces().sum() for step in relaxed],
    "touching": int((held.forces() > 0).sum()), "nodes": len(held.forces()),
    "same": find("pairings", "contact_toys.parts:Ramp") is Ramp is type(flat.contacts[0])
            and (not steps or find("laws", "Newtonian") is type(flowing().bodies[0].law)),
    "broken": said("pairings", "Broken"), "near": said("pairings", "Ram"),
    "scene": said("scenes", "slab_on_rmp"),
    "near module": said("pairings", "contact_toys.parts:Rampe"),
    "no module": said("pairings", "contact_toy:Ramp"),
}))
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Environment in which the package is installed, from its sources and without an index."""
    pytest.importorskip("setuptools")
    folder = tmp_path_factory.mktemp("external")
    # a build leaves its own folders beside the sources
    sources = shutil.copytree(PACKAGE, folder / "sources")
    command = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-deps",
        "--no-build-isolation",
        "--no-index",
    ]
    if subprocess.run([*command[:3], "--version"], capture_output=True).returncode:
        pytest.skip("no pip beside this Python")
    subprocess.run(
        [*command, "--target", folder / "there", sources], check=True, capture_output=True
    )
    assert list((folder / "there").glob("contact_toys-*.dist-info"))
    return os.environ | {"PYTHONPATH": str(folder / "there"), "OMP_NUM_THREADS": "1"}


def hhr_command(installed, cwd, *words):
    """What a command says, which must end well."""
    return python("-m", "hhr_dolfinx.command.main", *words, env=installed, cwd=cwd).stdout


@pytest.fixture(scope="module")
def used(installed):
    return json.loads(
        python("-c", USE, *(["inelastic"] if present("inelastic") else []), env=installed).stdout
    )


def test_an_installed_package_is_listed_beside_our_own(used):
    assert used["names"]["geometries"] == {**names("geometries"), "slab": "contact-toys"}
    others = {"Ramp": "contact-toys", "Broken": "contact-toys"}
    others |= {"Slope": "contact_toys"} if present("pages") else {}  # which its plug-in needs
    assert used["names"]["pairings"] == {**names("pairings"), **others}
    assert used["names"]["laws"] == {**names("laws"), "Newtonian": "contact-toys"}
    assert used["names"]["scenes"] == dict.fromkeys(
        ("slab_on_ramp", "flowing_slab"), "contact-toys"
    )
    assert "slab" not in names("geometries")


def test_a_scene_of_installed_parts_is_solved(used):
    # uniaxial: E times strain times width
    assert used["force"] == pytest.approx(3.0 * (0.05 - 0.01) * 3.0, rel=1e-10)
    assert 0 < used["touching"] < used["nodes"]
    if present("inelastic"):
        *_, first, last = used["relaxed"]
        assert 0 < last < first < used["force"]


def test_what_is_wrong_with_an_installed_name_is_said(used):
    assert used["same"]
    assert "'Broken' of the package contact-toys cannot be loaded: AttributeError" in used["broken"]
    assert "Is 'Ramp' meant?" in used["near"] and "NodeToNode" in used["near"]
    assert "Is 'slab_on_ramp' meant?" in used["scene"]
    assert "is 'contact_toys.parts:Ramp' meant?" in used["near module"]
    assert "contact_toy cannot be loaded: ModuleNotFoundError" in used["no module"]


@needs("inelastic")
def test_a_plug_in_of_another_package_registers_as_ours_do(installed, tmp_path):
    """Its public names, parts of scenes, classes of files, commands, and what it keeps beside a
    model.
    """
    program = (
        "import hhr_dolfinx as hhr; from hhr_dolfinx.by_name import find, names\n"
        "from hhr_dolfinx.online.model_file import Kinds\n"
        "from contact_toys.laws import Newtonian; from contact_toys.parts import Ramp\n"
        "assert hhr.Newtonian is Newtonian and Kinds()['Ramp'] is Ramp and 'Newtonian' in "
        "hhr.__all__\nassert find('pairings', 'Slope') is Ramp and names('pairings')['Slope'] == "
        "'contact_toys'\nfrom pathlib import Path; from types import SimpleNamespace; from "
        "hhr_dolfinx import registry\n(write,) = map(registry.load, "
        "registry.installed()['contact_toys'].companions)\n"
        "write(SimpleNamespace(comm=SimpleNamespace(rank=0), "
        "scene=SimpleNamespace(name='slab')), Path())\n"
    )
    python("-c", program, env=installed, cwd=tmp_path)
    assert hhr_command(installed, tmp_path, "slabs") == "a slab is 3.0 wide\n"
    assert (tmp_path / "note.txt").read_text() == "slab"


@needs("plots")
def test_the_command_knows_installed_scenes(installed, tmp_path):
    assert "  slab_on_ramp (contact-toys)" in hhr_command(installed, tmp_path, "list").splitlines()
    assert "contact 0 of 20: 7 conditions" in hhr_command(
        installed, tmp_path, "check", "slab_on_ramp"
    )
    assert (tmp_path / "slab_on_ramp_check.png").stat().st_size > 1000
    solved = hhr_command(installed, tmp_path, "solve", "slab_on_ramp", "--at", "push=0.05")
    assert "\nsum of contact forces [per unit depth]: 0.36\n" in solved
    forces = []
    for duration in ("1", "50") if present("inelastic") else ():
        flowing = hhr_command(
            installed,
            tmp_path,
            "solve",
            "flowing_slab",
            "--at",
            "push=0.05",
            "--duration",
            duration,
        )
        lines = dict(line.split(": ") for line in flowing.splitlines())
        assert lines["seconds of one step from rest"] == duration
        forces.append(float(lines["sum of contact forces [per unit depth]"]))
    assert not forces or 0 < forces[1] < forces[0]


def test_our_own_names_are_found_and_have_their_kind():
    for kind, own in OWN.items():
        for name in own:
            assert callable(find(kind, name)), (kind, name)
    assert find("pairings", "Obstacle") is hhr.Obstacle


@pytest.mark.parametrize(
    ("kind", "name", "said"),
    [
        ("pairing", "Obstacle", "there are no 'pairing'"),
        ("pairings", "Obstacl", "Is 'Obstacle' meant"),
        ("pairings", "", "must be a text"),
        ("pairings", 3, "must be a text"),
        ("pairings", " ", "must be a text"),
        ("scenes", "nothing", "Known are none"),
        ("scenes", ":x", "cannot be loaded"),
        ("scenes", "json:dump_it", "json has no 'dump_it'"),
        ("scenes", "..:x", "cannot be loaded"),
        ("scenes", "no_such_module:x", "cannot be loaded: ModuleNotFoundError"),
    ],
)
def test_names_that_are_none_are_refused(kind, name, said):
    with pytest.raises(SceneError, match=said):
        find(kind, name)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a = 1\nb = 1 / 0\n", "odd name.py, line 2: ZeroDivisionError: division by zero"),
        ("a = 1\n\ndef f(:\n", "odd name.py, line 3: SyntaxError"),
        ("import beside_it\n", "odd name.py, line 1: SyntaxError.*beside_it.py, line 2"),
        ("import sys\nsys.exit(5)\n", "odd name.py, line 2: SystemExit: 5"),
        ("import no_such_module\n", "odd name.py, line 1: ModuleNotFoundError"),
        ("\nfrom . import beside_it\n", "odd name.py, line 2: ImportError.*write 'import name'"),
        (
            "import hhr_dolfinx as hhr\nhhr.Body(1, 1.0)\n",
            "odd name.py, line 2: TypeError.*poisson",
        ),
        ("import hhr_dolfinx as hhr\nhhr.ParameterSpace(('a',), (1.0,), (0.0,))\n", "a"),
        ("a = '\0'\n", "null bytes"),
        ("scen = 3\n", "is '.*odd name.py:scen' meant?"),
        ("", "has no 'scene'"),
    ],
)
def test_mistakes_in_a_file_are_told_by_line(text, said, tmp_path, monkeypatch):
    (tmp_path / "odd name.py").write_text(text)
    (tmp_path / "beside_it.py").write_text("a = 1\nb = = 2\n")
    monkeypatch.chdir(tmp_path)
    for path in (
        "odd name.py",
        tmp_path / "odd name.py",
        Path("..") / tmp_path.name / "odd name.py",
    ):
        with pytest.raises(HHRError, match=said):
            find("scenes", str(path))


def test_files_that_are_none_are_refused(tmp_path):
    (tmp_path / "here.py").write_text("")
    (tmp_path / "folder.py").mkdir()
    for name in ("there.py", "folder.py"):
        with pytest.raises(SceneError, match=r"there is no file .*, which has here.py$"):
            find("scenes", str(tmp_path / name))
    with pytest.raises(SceneError, match="there is no file"):
        find("scenes", str(tmp_path / "no folder" / "a.py"))


def test_a_file_runs_once_and_again_when_it_has_changed(tmp_path, capsys):
    path = tmp_path / "printing.py"
    path.write_text("print('it runs')\nscene = 1\nother = 2\n")
    assert (find("scenes", str(path)), find("scenes", f"{path}:other")) == (1, 2)
    assert capsys.readouterr().out == "it runs\n"
    path.write_text("scene = 3\n")
    os.utime(path, ns=(0, path.stat().st_mtime_ns + 10**9))
    assert find("scenes", str(path)) == 3


def test_two_files_of_one_name_are_two(tmp_path):
    law = (
        "from __future__ import annotations\nfrom dataclasses import dataclass\nfrom typing "
        "import ClassVar\nfrom sizes_of_it import WIDTH\n@dataclass(frozen=True)\nclass law:\n    "
        "kind: ClassVar[int] = WIDTH\n    a: float = WIDTH\ndef late():\n    import late_of_it\n  "
        "  return late_of_it.NAME\n"
    )
    for folder, width in (("one", 1), ("two", 2)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "sizes_of_it.py").write_text(f"WIDTH = {width}\n")
        (tmp_path / folder / "my_law.py").write_text(law)
    (tmp_path / "two" / "late_of_it.py").write_text("NAME = 'late'\n")
    one, two = (find("laws", str(tmp_path / folder / "my_law.py")) for folder in ("one", "two"))
    assert (one().a, two().a, one.kind, two.kind) == (1, 2, 1, 2) and one is not two
    assert all(sys.modules[law.__module__].law is law for law in (one, two))
    assert find("laws", f"{tmp_path}/two/my_law.py:late")() == "late"


def test_code_made_from_text_is_nobodys_file(tmp_path, monkeypatch):
    """Beside the scene <string> would lie in its folder: dataclasses raise from there."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene_here.py").write_text(
        "import hhr_dolfinx as hhr\n\nhold = lambda: hhr.Displacement(1, -1)\ndef divided():\n    "
        "return 1 / 0\n"
    )
    for make, error, place in (
        (find("scenes", "scene_here.py:hold"), SceneError, "scene_here.py, line 3"),
        (find("scenes", "scene_here.py:divided"), ZeroDivisionError, "scene_here.py, line 5"),
        (lambda: hhr.Displacement(1, -1), SceneError, ""),
        (lambda: np.zeros(3).reshape(2, 2), ValueError, ""),
    ):
        with pytest.raises(error) as caught:
            make()
        assert place_of(caught.value) == place


def test_a_file_does_not_take_the_place_of_a_module(tmp_path):
    (tmp_path / "json.py").write_text("scene = 'mine'\n")
    assert find("scenes", str(tmp_path / "json.py")) == "mine"
    assert sys.modules["json"] is json
    with pytest.raises(AttributeError):
        _ = json.scene


class Entries(list):
    names = property(lambda self: {point.name for point in self})


def test_entry_points_of_two_packages_may_share_a_name_for_one_thing_only(monkeypatch):
    leave = Mock(side_effect=SystemExit(3))
    given = (
        ("Twice", "a:X", int),
        ("Twice", "b:X", float),
        ("Same", "a:Y", dict),
        ("Same", "a:Y", dict),
    )
    given = *given, ("Leaves", "a:Z", leave), ("Mortar", "a:M", list)
    points = Entries(
        SimpleNamespace(name=name, value=value, load=load, dist=None) for name, value, load in given
    )
    monkeypatch.setattr(by_name.importlib.metadata, "entry_points", lambda group: points)
    with pytest.raises(SceneError, match="'Twice' stands for 'a:X' of a:X and 'b:X' of b:X"):
        find("pairings", "Twice")
    with pytest.raises(SceneError, match=r"'Leaves' .* cannot be loaded: SystemExit: 3"):
        find("pairings", "Leaves")
    assert find("pairings", "Same") == {} and find("pairings", "Obstacle") is hhr.Obstacle
    assert names("pairings")["Obstacle"] == "hhr_dolfinx"
