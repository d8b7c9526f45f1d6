"""Commands that README, docs and Makefile name: a test runs each of them, on small scenes and files
of these names.
"""

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from mpi4py import MPI
from needs import needs, present
from processes import SCENE_FOLDERS

import hhr_dolfinx as hhr

pytest.importorskip("click")
import deck_entries
from click.testing import CliRunner

from hhr_dolfinx.command.main import hhr as command
from hhr_dolfinx.models.condensed import CondensedModel

ROOT = Path(__file__).parents[2]
PAGES = ("README.md", "docs/tutorial.md", "docs/pages.md", "docs/one_call.md", "docs/files.md")
"""Pages whose commands follow each other in one folder."""
OTHERS = sorted(
    {"CONTRIBUTING.md", *(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md"))}
    - set(PAGES)
)
SCENE = """
import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import block

left, right = block.side(0, upper=False), block.side(0, upper=True)
floor, lid = block.side(1, upper=False), block.side(1, upper=True)
scene = hhr.Scene(
    name="leaf_spring",
    geometry=lambda comm: block.block(comm, lower=(0, 0), upper=(2, 1), cells=(8, 4)),
    hypothesis="plane_strain",
    bodies=(hhr.Body(block.SOLID, young=10.0, poisson=0.3),),
    contacts=(hhr.Obstacle(floor, normal=(0, -1), offset=0.002),),
    parameters=hhr.ParameterSpace(("travel", "lowered"), (0.0, 0.0), (1.0, 0.3)),
    displacements=(hhr.Displacement(left, component=0), hhr.Displacement(left, component=1)),
    loads=(
        hhr.Pressure(lid, hhr.Amplitude(slopes={"travel": 0.1})),
        hhr.Traction(right, (0, 1), hhr.Amplitude(slopes={"lowered": 0.1})),
    ),
    outputs=(hhr.LargestPressure("peak", contact=0),),
)
"""
STEPS = (
    "*BOUNDARY/TOP, 1, 2/*STEP/*STATIC/1., 1./*DLOAD/{lid}/*END STEP/*STEP/*STATIC/1., 1./*DLOAD, "
    "OP=NEW/{lid}"
)
"""Two steps, so that `hhr start` writes a path."""


def lines_of(page):
    """Lines of the code blocks of a page, and the rest of its text."""
    text = (ROOT / page).read_text()
    blocks = re.findall(r"^```[^\n]*\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    lines = [
        line.strip().removeprefix(".venv/bin/") for block in blocks for line in block.splitlines()
    ]
    return lines, re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)


def commands(page):
    """Lines of the code blocks of a page that call the command, or make a table for it."""
    return [line for line in lines_of(page)[0] if re.match(r"hhr |printf ", line)]


def in_text(page):
    """Commands of ``hhr`` within the sentences of a page that name a file.

    Others name their verb alone.
    """
    found = re.findall(r"`(hhr [a-z]+ [^`\n]*)`", lines_of(page)[1])
    return [line for line in found if re.match(r"\w[\w/]*\.\w+$", line.split()[2])]


def test_commands_are_found():
    """Nothing is run where nothing is found."""
    found = {page: commands(page) for page in PAGES}
    assert min(map(len, found.values())) >= 1 and sum(map(len, found.values())) >= 18
    verbs = {
        line.split()[1] for lines in found.values() for line in lines if line.startswith("hhr ")
    }
    assert verbs >= {"check", "solve", "reduce", "page", "embed", "train", "answer", "study"}
    assert len(in_text("docs/how_to.md")) > 8 and len(commands("docs/decks.md")) > 6


def run(line, page):
    """Run a line of a page in this folder.

    Raises:
        AssertionError: if it fails, with all that it printed.
    """
    if line.startswith("printf"):
        subprocess.run(["sh", "-c", line], check=True)
        return
    words = line.partition(" #")[0].split()[1:]
    result = CliRunner().invoke(command, words, prog_name="hhr")
    assert result.exit_code == 0, (page, line, result.output[-2000:], result.exc_info)


@pytest.mark.slow
def test_commands_of_the_docs_run_in_order_in_one_folder(tmp_path, monkeypatch):
    """No model of one command is replaced by that of another, and each is called what the docs call
    it.
    """
    monkeypatch.chdir(tmp_path)
    Path("demos").mkdir()
    for path in ("demos/your_scene.py", "my_scene.py"):
        Path(path).write_text(SCENE)
    folder = Path("out/leaf_spring")
    for page in PAGES:
        if page == "docs/files.md":  # whose model lies where its reader is
            shutil.copy(folder / "model.npz", "model.npz")
        for line in commands(page):
            run(line, page)
            if line.startswith(("hhr reduce", "hhr train", "hhr study")):
                # what reduce has chosen is exact condensation, whatever was made after it
                assert isinstance(hhr.load_model(folder / "model.npz"), CondensedModel), (
                    page,
                    line,
                )
    kinds = {
        "model": CondensedModel,
        "hhr": hhr.ReducedModel,
        "condensed": CondensedModel,
        "study": hhr.ReducedModel,
    }
    assert {name: type(hhr.load_model(folder / f"{name}.npz")) for name in kinds} == kinds
    assert {"spring.fmu", "press.h", "press.fmu", "answers.csv"} <= {
        path.name for path in Path().iterdir()
    }


ELSEWHERE = {
    "hhr serve model.npz --port 4242": (
        "tests/plugins/um_bridge/test_um_bridge.py::test_a_server_of_um_bridge"
    ),
    # files of another code
    "hhr start part.inp --stiffness part.sti --case case.inp": (
        "tests/plugins/foreign/test_calculix.py::test_start_writes_the_scene"
    ),
    # refused for the obstacle of this scene
    "hhr export my_scene.py --at travel=0.9,lowered=0.1 --out deck.inp": (
        "tests/plugins/exporters/test_deck.py::test_a_deck_is_the_scene_again_and_calculix_agrees"
    ),
    "hhr train benchmarks/thesis/pellet_cladding.py --model condensed": (
        "tests/core/test_scripts.py::check_pellet"
    ),
    "hhr page out/pellet_cladding/condensed.npz": "tests/core/test_scripts.py::check_pellet",
    "hhr bench score mine.npz --answers out/data_set/hidden": (
        "tests/plugins/bench/test_score.py::test_the_command_prints_and_writes_scores"
    ),
}
"""Commands that wait for another program, or take long at full size, and the tests that run them or
what they call.
"""
WITH_A_HOLE = re.compile(r"\.\.\.|\bNAME\b|SLURM|[A-Z]{4,}")
"""What stands for other words: such a line is an example of its verb."""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with the files that pages name: scenes, decks, meshes, a model, tables of points."""
    monkeypatch.chdir(tmp_path)
    for name in ("my_scene.py", "scene.py"):
        Path(name).write_text(SCENE)
    deck = deck_entries.cubes(
        "C3D8", 0.0, f"{deck_entries.STIFF}/*FRICTION/0.3, 1.E8", "TYPE=SURFACE TO SURFACE", STEPS
    )[0].text
    for name in ("clamp.inp", "deck.inp", "part.inp"):
        Path(name).write_text(deck)
    full = hhr.FullOrderModel(vars_of("my_scene.py")["scene"], MPI.COMM_SELF)
    hhr.save_model("model.npz", hhr.condense(full, fields=True))
    hhr.scenery_of(full).write("scenery.npz")
    hhr.save_heat_model("warm.npz", warm(full.scene))
    for name in ("questions.csv", "points.csv"):
        Path(name).write_text("travel,lowered\n0.9,0.1\n0.5,0.2\n0.1,0.1\n")
    return tmp_path


def warm(scene):
    """A model with heat: the spring is warm where it is held."""
    fixed = hhr.FixedTemperature(scene.displacements[0].tag, 80.0)
    tag = scene.bodies[0].tag
    heat = hhr.Heat({tag: 50.0}, {}, expansion={tag: 1e-5}, temperatures=[fixed])
    return hhr.condense_heat(scene, heat)


def vars_of(path):
    """What a file of Python defines."""
    namespace = {}
    exec(Path(path).read_text(), namespace)
    return namespace


def named_lines(page):
    """Commands of a page that can be run as they are, each once, in their order."""
    blocks = () if page in PAGES else commands(page)
    lines = [line.partition(" #")[0].strip() for line in (*blocks, *in_text(page))]
    return [
        line
        for line in dict.fromkeys(lines)
        if line not in ELSEWHERE and not WITH_A_HOLE.search(line)
    ]


@pytest.mark.slow
@needs("decks", "constraints", "contact_heat", "exporters", "mortar", "plots", "pages")
@pytest.mark.parametrize("page", [page for page in (*PAGES, *OTHERS) if named_lines(page)])
def test_commands_of_other_pages_run(page, folder):
    if "part.msh" in " ".join(named_lines(page)):
        subprocess.run(["cp", ROOT / "demos/meshes/leaf_spring.msh", "part.msh"], check=True)
        Path("part.inp").unlink()
    for line in named_lines(page):
        if line.startswith("hhr start"):  # whose scene an earlier line may have written
            Path(line.split()[2]).with_suffix(".py").unlink(missing_ok=True)
        run(line, page)


@pytest.mark.parametrize("line", ELSEWHERE)
def test_a_command_of_another_test_is_named_and_its_test_is_there(line):
    assert any(line in (*commands(page), *in_text(page)) for page in (*PAGES, *OTHERS)), line
    file, _, name = ELSEWHERE[line].partition("::")
    if (ROOT / file).exists():  # else it went with its plug-in
        assert f"def {name}" in (ROOT / file).read_text()


TARGETS = {
    "lint": ".ci/run",
    "test": ".ci/run",
    "setup": ".ci/run",
    "slice": ".ci/run",
    "docs": "tests/core/test_site.py::test_the_site_is_built_without_a_warning",
    "pictures": "tests/core/test_gallery.py::test_no_picture_is_stale",
    "quick": "tests/core/test_house.py::test_files_of_make_quick_are_there",
    "test-core": "tests/core/test_without.py::test_the_core_passes_without_plug_ins",
    "slow": "tests/slow_report.json",
    "mutants": "tests/core/test_mutations.py",
    "without": "tests/core/test_without.py::test_the_core_passes_without_plug_ins",
    "same": "tests/core/test_same.py",
    "doctor": "tests/plugins/scene_checks/test_doctor.py",
}
"""Targets of the Makefile that call no script of demos or benchmarks, and what runs them."""


def recipes():
    """Commands of each target of the Makefile."""
    text = (ROOT / "Makefile").read_text()
    found = re.findall(r"^([a-z][\w-]*):[^\n=]*\n((?:\t.*\n?)+)", text, re.MULTILINE)
    return dict(found)


def test_a_test_runs_what_each_target_of_the_makefile_calls():
    scripts = {
        name: re.findall(r"python ((?:demos|benchmarks)/\S+\.py)", text)
        for name, text in recipes().items()
    }
    assert len(scripts) > 40
    assert {name for name, paths in scripts.items() if not paths} == set(TARGETS)
    programs = {
        str(path.relative_to(ROOT))
        for folder in SCENE_FOLDERS
        for path in Path(folder).glob("*.py")
    }
    missing = [path for paths in scripts.values() for path in paths if path not in programs]
    assert missing == []  # those that are there test_scripts.py runs
    for target, holder in TARGETS.items():
        file, _, name = holder.partition("::")
        if file.startswith("tests/plugins/") and not present(file.split("/")[2]):
            continue  # it went with its plug-in
        assert (
            f"make {target}" in (ROOT / file).read_text()
            if file == ".ci/run"
            else (ROOT / file).exists()
        ), holder
        assert not name or f"def {name}(" in (ROOT / file).read_text(), holder


@pytest.mark.parametrize("page", ("README.md", *PAGES[1:], *OTHERS))
def test_targets_and_scripts_that_a_page_names_are_there(page):
    lines, text = lines_of(page)
    said = "\n".join((*lines, *re.findall(r"`([^`\n]+)`", text)))
    assert set(re.findall(r"^(?:.*&& )?make ([a-z][\w-]*)\b", said, re.MULTILINE)) <= set(recipes())
    for script in re.findall(r"python ((?:demos|benchmarks)/[\w/]+\.py)", said):
        assert (ROOT / script).exists(), script


@needs(
    "plots", "decks", "exporters", "one_call", "pages", "paths", "studies", "tables", "um_bridge"
)
def test_verbs_that_pages_name_are_those_of_the_command():
    """And each of them is run by one of the tests above, or by that of ELSEWHERE."""
    pages = [line for page in (*PAGES, *OTHERS) for line in (*commands(page), *in_text(page))]
    named = {
        line.split()[1]
        for line in pages
        if line.startswith("hhr ") and not line.split()[1].startswith("-")
    }
    assert named <= set(command.list_commands(None))
