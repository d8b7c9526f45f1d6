"""Commands of README and docs: all of them run, in order, in one folder, on a small scene of the same names."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

import hhr_dolfinx as hhr

pytest.importorskip("click")
from click.testing import CliRunner

from hhr_dolfinx.command.main import hhr as command
from hhr_dolfinx.models.condensed import CondensedModel

ROOT = Path(__file__).parents[2]
PAGES = ("README.md", "docs/tutorial.md", "docs/pages.md", "docs/one_call.md", "docs/files.md")
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


def commands(page):
    """Lines of the code blocks of a page that call the command, or make a table for it."""
    blocks = re.findall(r"^```[^\n]*\n(.*?)^```", (ROOT / page).read_text(), re.DOTALL | re.MULTILINE)
    lines = [line.strip() for text in blocks for line in text.splitlines()]
    return [line.removeprefix(".venv/bin/") for line in lines if re.match(r"(\.venv/bin/)?hhr |printf ", line)]


def test_commands_are_found():
    """Nothing is run where nothing is found."""
    found = {page: commands(page) for page in PAGES}
    assert min(map(len, found.values())) >= 1 and sum(map(len, found.values())) >= 18
    verbs = {line.split()[1] for lines in found.values() for line in lines if line.startswith("hhr ")}
    assert verbs >= {"check", "solve", "reduce", "page", "embed", "train", "answer", "study"}


@pytest.mark.slow
def test_commands_of_the_docs_run_in_order_in_one_folder(tmp_path, monkeypatch):
    """No model of one command is replaced by that of another, and each is called what the docs call it."""
    monkeypatch.chdir(tmp_path)
    Path("demos").mkdir()
    for path in ("demos/your_scene.py", "my_scene.py"):
        Path(path).write_text(SCENE)
    folder = Path("out/leaf_spring")
    for page in PAGES:
        if page == "docs/files.md":  # whose model lies where its reader is
            shutil.copy(folder / "model.npz", "model.npz")
        for line in commands(page):
            if line.startswith("printf"):
                subprocess.run(["sh", "-c", line], check=True)
                continue
            result = CliRunner().invoke(command, line.partition(" #")[0].split()[1:], prog_name="hhr")
            assert result.exit_code == 0, (page, line, result.output[-2000:], result.exc_info)
            if line.startswith(("hhr reduce", "hhr train", "hhr study")):
                # what reduce has chosen is exact condensation, whatever was made after it
                assert isinstance(hhr.load_model(folder / "model.npz"), CondensedModel), (page, line)
    kinds = {"model": CondensedModel, "hhr": hhr.ReducedModel, "condensed": CondensedModel, "study": hhr.ReducedModel}
    assert {name: type(hhr.load_model(folder / f"{name}.npz")) for name in kinds} == kinds
    assert {"spring.fmu", "press.h", "press.fmu", "answers.csv"} <= {path.name for path in Path().iterdir()}
