"""What is optional: a scene without it, how to get it, and where compiled functions are kept."""

import re
import tomllib
from pathlib import Path

import pytest
from needs import present
from processes import SCENE_FOLDERS, python

from hhr_dolfinx import compat
from hhr_dolfinx.errors import HHRError, MissingPackageError

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]
MODULE = {"scikit-learn": "sklearn"}


def packages(requirements):
    names = (re.match(r"[\w-]+", requirement)[0] for requirement in requirements)
    return {MODULE.get(name, name) for name in names}


OPTIONAL = {
    name: packages(EXTRAS[name])
    for name in EXTRAS
    if name not in ("all", "solver", "test", "docs", "ci")
}

BLOCKED = f"""
import sys
sys.path[:0] = {SCENE_FOLDERS!r}
for name in {sorted(set.union(*OPTIONAL.values()))!r}:
    sys.modules[name] = None
import hhr_dolfinx as hhr
from scenes import pressed_block, pressed_pair
"""

ELASTIC = """
training = hhr.train(pressed_block("plane_strain"), [8], held_out=20)
reduction = training.build()
hhr.save_model("block.npz", reduction)
answer = hhr.load_model("block.npz").solve({"push": 0.05})
# E / (1 - nu^2) (push - gap) / 2 on a width of 1.5
print(answer.status.name, f"{answer.forces().sum() / (3.0 / 0.91 * 0.04 / 2 * 1.5) - 1:.1e}")
print(*sys.modules, sep="\\n", file=open("modules", "w"))
"""
if present("tables"):
    ELASTIC += "assert callable(hhr.answer_points)\n"

NEEDED = {
    "mesh": "import hhr_dolfinx.geometries.hertz_half_discs",
    "flow": "hhr.FullOrderModel(pressed_block('plane_strain', poisson=0.4999))",
    "study": "import hhr_dolfinx.command.console",
    "tables": "hhr.read_points('table.parquet', hhr.ParameterSpace(('mu',), (0.0,), (1.0,)))",
    "pictures": "import hhr_dolfinx.plugins.plots.fields",
    "local": (
        "from hhr_dolfinx.plugins.local_models.clusters import medoids; "
        "medoids([[0.0, 1.0], [1.0, 0.0]], 1)"
    ),
    "rivals": (
        "from hhr_dolfinx.plugins.rivals.factors import nonnegative_factors; "
        "nonnegative_factors(None, 1)"
    ),
    "mortar": "from hhr_dolfinx.geometries.two_blocks import side\n"
    "mortar = hhr.Mortar(side(1, 2, True), side(2, 2, False))\n"
    "hhr.FullOrderModel(pressed_pair('solid', ((1.0, 0.3), (1.0, 0.3)), cells=1, "
    "matching=False, contacts=(mortar,)))",
}


def run(program, folder, code=0):
    """A program in a Python that has none of the optional packages."""
    return python("-c", BLOCKED + program, code=code, cwd=folder)


def test_an_elastic_scene_needs_none_of_the_extras_and_all_that_is_required(tmp_path):
    """From the training to the model read back from its file."""
    status, error = run(ELASTIC, tmp_path).stdout.split()
    assert status == "CONVERGED" and abs(float(error)) < 1e-9
    assert packages(PROJECT["dependencies"]) <= set((tmp_path / "modules").read_text().split())


def test_everything_optional_has_its_extra():
    assert OPTIONAL.keys() == NEEDED.keys()
    (everything,) = EXTRAS["all"]
    assert set(re.search(r"\[(.*)\]", everything)[1].split(",")) == OPTIONAL.keys()


OF_PLUGINS = {"local": "local_models", "mortar": "mortar", "pictures": "plots", "tables": "tables"}
"""Extras of plug-ins alone."""


@pytest.mark.parametrize(
    "name", [name for name in NEEDED if name not in OF_PLUGINS or present(OF_PLUGINS[name])]
)
def test_where_an_extra_is_needed_the_error_names_it(name, tmp_path):
    last = run(NEEDED[name], tmp_path, code=1).stderr.strip().splitlines()[-1]
    assert (
        last.startswith("hhr_dolfinx.errors.MissingPackageError")
        and f"pip install hhr_dolfinx[{name}]" in last
    )
    assert any(f"the package {package}" in last for package in OPTIONAL[name])


def test_a_missing_package_is_an_error_of_ours_and_an_import_error():
    with pytest.raises(
        MissingPackageError, match=r"a dream needs the package no_such_thing.*hhr_dolfinx\[dreams\]"
    ):
        with compat.extra("dreams", "a dream"):
            import no_such_thing  # noqa: F401
    assert issubclass(MissingPackageError, HHRError) and issubclass(
        MissingPackageError, ImportError
    )


def test_a_package_that_is_there_and_broken_speaks_for_itself():
    with pytest.raises(ImportError, match="libGL") as caught, compat.extra("mesh", "this geometry"):
        raise ImportError("libGL.so.1: cannot open shared object file")
    assert caught.type is ImportError
