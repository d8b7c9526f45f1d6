"""The house as docs/architecture.md draws it: who may import what, sizes, types, one clock, and what a scene loads."""

import ast
import doctest
import functools
import graphlib
import importlib
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from bare import SCENE_FOLDERS, WAIT
from needs import OURS, needs, present

ROOT = Path(__file__).parents[2]
FOLDERS = {"hhr_dolfinx": "hhr_dolfinx", "forms": "hhr_dolfinx.forms", "geometries": "hhr_dolfinx.geometries"}

SCRIPTS = [path for folder in ("demos", "benchmarks/thesis") for path in (ROOT / folder).rglob("*.py")]


def modules():
    """All modules of the package by their full names."""
    found = {}
    for folder, package in FOLDERS.items():
        for path in (ROOT / folder).rglob("*.py"):
            parts = path.relative_to(ROOT / folder).with_suffix("").parts
            found[".".join([package, *parts]).removesuffix(".__init__")] = path
    return found


MODULES = modules()


@functools.cache
def all_imports(name, types=False):
    """What a module imports by full names, inside functions too; with what is for type checking only, or without."""
    return tuple(_imports_of(name, types))


def _imports_of(name, types):
    tree = ast.parse(MODULES[name].read_text())
    unseen = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test) and not types
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if id(node) in unseen:
            continue
        if isinstance(node, ast.Import):
            targets = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            inner = [f"{node.module}.{alias.name}" for alias in node.names]
            targets = [target if target in MODULES else node.module for target in inner]
        else:
            continue
        yield from targets


def imports(name):
    """Modules of the package that a module imports, for type checking too."""
    return [target for target in all_imports(name, types=True) if target.split(".")[0] == "hhr_dolfinx"]


def room(name):
    """First part of a module's name behind the package."""
    return name.split(".")[1] if "." in name else "__init__"


def layers_of_the_page():
    """Folders and files of the package in the order of the architecture page."""
    page = (ROOT / "docs/architecture.md").read_text().partition("## Layers")[2].partition("Other packages")[0]
    return [name for line in re.findall(r"^\d+\. .*$", page, re.MULTILINE) for name in re.findall(r"`(\w+)`", line)]


LAYERS = layers_of_the_page()


def packages_of_the_page():
    """Packages of others on the architecture page, each with the rooms that may import it."""
    page = (ROOT / "docs/architecture.md").read_text()
    rows = re.findall(r"^\| ((?:`\w+` ?)+)\|([^|]*)\|$", page, re.MULTILINE)
    return {
        package: set(re.findall(r"`(\w+)`", allowed))
        for packages, allowed in rows
        for package in re.findall(r"`(\w+)`", packages)
    }


PACKAGES = packages_of_the_page()


def all_are_present():
    """True if none of our plug-ins was deleted."""
    page = (ROOT / "docs/plug_ins.md").read_text().partition("## Your own")[0]
    return present(*re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE))


def test_the_page_names_all_layers_once():
    assert sorted(LAYERS) == sorted({room(name) for name in MODULES} - {"__init__"})


def test_a_module_imports_only_what_its_layer_may():
    below = {name: {"compat", *LAYERS[: LAYERS.index(name) + 1]} for name in LAYERS} | {"__init__": {"compat"}}
    found = {name: {room(target) for target in imports(name)} - below[room(name)] for name in MODULES}
    assert not {name: others for name, others in found.items() if others}


def test_a_module_imports_only_the_packages_of_others_that_its_room_may():
    known = {"hhr_dolfinx", "numpy", "scipy", "lazy_loader", *sys.stdlib_module_names}
    allowed = {name: {package for package, rooms in PACKAGES.items() if room(name) in rooms} for name in MODULES}
    found = {name: {item.split(".")[0] for item in all_imports(name)} - known - allowed[name] for name in MODULES}
    assert not {name: others for name, others in found.items() if others}


def test_the_page_allows_no_package_to_a_room_that_does_not_import_it():
    used = {(target.split(".")[0], room(name)) for name in MODULES for target in all_imports(name)}
    # what a plug-in imports that was deleted nobody else may
    rooms = {room(name) for name in MODULES} - (set() if all_are_present() else {"plugins"})
    allowed = {(package, name) for package, places in PACKAGES.items() for name in places if name in rooms}
    assert allowed <= used, allowed - used


def test_no_circle():
    graph = {name: [target for target in imports(name) if target != name] for name in MODULES}
    list(graphlib.TopologicalSorter(graph).static_order())
    scripts = [path for folder in ("demos", "benchmarks") for path in (ROOT / folder).rglob("*.py")]
    imported = re.compile(r"^(?:from parts )?(?:import|from) (?:parts\.)?(\w+)", re.MULTILINE)
    calls = {path.stem: {*imported.findall(path.read_text())} - {path.stem} for path in scripts}
    assert "peers" in calls["pellet_cladding_study"] and "extreme_flow" in calls["extreme_cases"]
    list(graphlib.TopologicalSorter(calls).static_order())


FOUND = """
import runpy, setuptools
setuptools.setup = lambda packages: print(*packages)
runpy.run_path("setup.py")
"""


def test_every_folder_is_installed():
    """Packages are found, by setup.py: a folder without an ``__init__`` would be left out."""
    found = subprocess.run([sys.executable, "-c", FOUND], cwd=ROOT, capture_output=True, text=True, check=True)
    folders = {name if path.name == "__init__.py" else name.rpartition(".")[0] for name, path in MODULES.items()}
    assert set(found.stdout.split()) == folders


def test_functions_fit_on_a_screen():
    """Functions of up to 60 lines; a file is as long as its idea."""
    for path in (*MODULES.values(), *SCRIPTS):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef):
                assert node.end_lineno - node.lineno < 60, (path, node.name)


def without_types(path):
    """Names of the public functions and methods of a file that do not say what they take and return."""
    tree = ast.parse(path.read_text())
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef) and not node.name.startswith("_")]
    # a function within a function is no interface
    for node in (item for part in (tree, *classes) for item in part.body):
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            arguments = node.args
            given = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs, arguments.vararg, arguments.kwarg]
            untyped = [a for a in given if a and a.annotation is None and a.arg not in ("self", "cls")]
            if untyped or node.returns is None:
                yield node.name


def test_public_functions_say_their_types():
    found = [(path.name, function) for path in MODULES.values() for function in without_types(path)]
    assert not found


def test_one_class_of_record():
    """What a kind of model knows of its construction are facts of one record."""
    found = [
        (path.name, node.name)
        for path in MODULES.values()
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ClassDef) and node.name.endswith("Record")
    ]
    assert found == [("reductor.py", "Record")]


def test_one_clock():
    clocks = re.compile(r"^\s*(?:import time|from time|import timeit)\b", re.MULTILINE)
    holders = [path.name for path in (*MODULES.values(), *SCRIPTS) if clocks.search(path.read_text())]
    assert holders == ["timing.py"]


# numba is not among them: DOLFINx loads it by itself where it is there; tests/core/test_extras.py does without
UNNEEDED = {
    "flow": [
        "hhr_dolfinx.plugins.inelastic.laws",
        "hhr_dolfinx.plugins.inelastic.constants",
        "hhr_dolfinx.plugins.inelastic.update",
        "hhr_dolfinx.plugins.inelastic.march",
        "hhr_dolfinx.plugins.inelastic.reduced_flow",
        "hhr_dolfinx.plugins.inelastic.full_order",
        "hhr_dolfinx.full_order.gauss_points",
        "hhr_dolfinx.plugins.inelastic.project",
        "hhr_dolfinx.plugins.inelastic.study",
        "hhr_dolfinx.plugins.inelastic.condense_flow",
        "hhr_dolfinx.plugins.inelastic.condensed_step",
        "hhr_dolfinx.plugins.inelastic.condensed_fields",
        "hhr_dolfinx.plugins.inelastic.condensed_flow",
    ],
    "meshes that do not match": [
        "hhr_dolfinx.pairings.node_to_surface",
        "hhr_dolfinx.pairings.mortar",
        "hhr_dolfinx.pairings.segments",
        "hhr_dolfinx.pairings.projection",
        "shapely",
    ],
    "clustering and peers": [
        "sklearn",
        "kmedoids",
        "hhr_dolfinx.plugins.local.clusters",
        "hhr_dolfinx.reduction.subspaces",
        "hhr_dolfinx.plugins.theorems.theorems",
    ],
    "pictures": [
        "hhr_dolfinx.plugins.studies.plots",
        "matplotlib",
        "pyvista",
    ],
    "outputs": [
        "hhr_dolfinx.outputs",
        "hhr_dolfinx.full_order.outputs",
        "hhr_dolfinx.models.functionals.functional",
        "hhr_dolfinx.models.functionals.kinds",
    ],
    "many parameters at once": [
        "hhr_dolfinx.models.many",
    ],
    "elasticity and shapes that depend on parameters": [
        "hhr_dolfinx.formulas",
        "hhr_dolfinx.shapes",
        "hhr_dolfinx.full_order.varying",
        "hhr_dolfinx.full_order.reshaped",
        "hhr_dolfinx.plugins.moduli.shaped",
        "hhr_dolfinx.models.eliminations.block",
        "hhr_dolfinx.plugins.moduli.interpolated",
        "hhr_dolfinx.plugins.moduli.interpolation",
        "hhr_dolfinx.plugins.moduli.condense",
        "hhr_dolfinx.plugins.moduli.interpolate",
        "hhr_dolfinx.plugins.moduli.interpolate_reduced",
        "hhr_dolfinx.reduction.starts",
    ],
    "loads on bodies": [
        "hhr_dolfinx.volume_loads",
        "hhr_dolfinx.forms.volume",
    ],
    "gradients": [
        "hhr_dolfinx.models.gradient",
        "hhr_dolfinx.plugins.inelastic.history_gradient",
    ],
    "samplings": [
        "hhr_dolfinx.sampling",
    ],
    "greedy training": [
        "hhr_dolfinx.plugins.greedy.greedy",
        "hhr_dolfinx.plugins.greedy.indicators",
    ],
    "families of paths": [
        "hhr_dolfinx.plugins.paths.path_families",
    ],
}
"""What a study of an elastic scene on matching meshes does without; numba is not listed: DOLFINx loads it itself."""
OF_FILES = {
    "hhr_dolfinx.models.functionals.kinds",
    "hhr_dolfinx.models.functionals.functional",
    "hhr_dolfinx.shapes",
    "hhr_dolfinx.formulas",
}
"""What checks a file of condensed flow where it is written, and knows all that such files may hold."""
UNNEEDED_BY_FLOW = {
    **{
        name: [item for item in UNNEEDED[name] if item not in OF_FILES]
        for name in UNNEEDED
        if name not in ("flow", "meshes that do not match", "loads on bodies")
    },
    "what only elastic scenes are compared with": [
        "hhr_dolfinx.plugins.studies.points",
        "hhr_dolfinx.plugins.baselines.naive",
        "hhr_dolfinx.reduction.exact",
    ],
}
"""What a study of a scene that flows does without."""

ELASTIC = """
import hertz_half_discs as demo
scene, settings = demo.scene(arc_segments=28, flat_segments=7), demo.SETTINGS.adapted(seed=1, quick=True)
"""
FLOWING = """
import pellet_cladding_plastic as demo
mesh = {"radial_cells": 6, "axial_cells": 10, "cladding_radial_cells": 2, "cladding_axial_cells": 7}
scene, paths = demo.scene(**mesh), {gap: demo.path(gap, 4) for gap in (5.0, 8.0, 10.0, 15.0)}
settings = hhr.StudySettings([paths[5.0], paths[15.0]], held_out=[paths[8.0]], tests={"10": paths[10.0]}, repetitions=1)
"""


def modules_of_a_study(program, folder):
    """Modules loaded by a whole study, report and model file included, pictures not."""
    program = (
        f"import sys; sys.path[:0] = {SCENE_FOLDERS!r}\n"
        f"from pathlib import Path\nimport hhr_dolfinx as hhr\nfrom rich.console import Console\n{program}\n"
        "study = hhr.study_scene(scene, settings, Path('.'))\n"
        "study.write(Path('.'), Console(quiet=True))\n"
        "print(*sys.modules, sep='\\n', file=open('modules', 'w'))\n"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=folder, timeout=WAIT)
    assert run.returncode == 0, run.stderr[-3000:]
    assert (folder / "report.json").exists() and (folder / "study.npz").exists()
    found = set((folder / "modules").read_text().split())
    assert "hhr_dolfinx.reduction.build" in found
    return found


@pytest.mark.parametrize(
    ("program", "unneeded"),
    [(ELASTIC, UNNEEDED), pytest.param(FLOWING, UNNEEDED_BY_FLOW, marks=(pytest.mark.slow, needs("inelastic")))],
    ids=["elastic", "inelastic"],
)
@needs("studies")
def test_a_scene_loads_what_it_names(program, unneeded, tmp_path):
    found = modules_of_a_study(program, tmp_path)
    assert not {what: found & set(names) for what, names in unneeded.items() if found & set(names)}


def test_what_is_not_loaded_exists():
    """A module that was renamed would be absent for the wrong reason."""
    for names in (*UNNEEDED.values(), *UNNEEDED_BY_FLOW.values()):
        own = {name for name in names if name.startswith("hhr_dolfinx")}
        assert {name for name in own if ".plugins." not in name or present(name.split(".")[2])} <= set(MODULES)


@pytest.mark.parametrize(
    "name",
    [
        "hhr_dolfinx.reduction.modes",
        pytest.param("hhr_dolfinx.plugins.paths.path_families", marks=needs("paths")),
    ],
)
def test_examples_in_docstrings(name):
    found = doctest.testmod(importlib.import_module(name), extraglobs={"np": np})
    assert found.attempted and not found.failed


def test_values_are_assigned_one_by_one():
    """But for swaps and what belongs together, such as the two columns of a matrix."""
    found = [
        (path.name, node.lineno)
        for path in MODULES.values()
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Tuple) and isinstance(node.targets[0], ast.Tuple)
    ]
    assert len(found) < 20, found


def test_models_do_not_ask_for_attributes():
    """What fields and models may have is declared; ``hasattr`` and ``getattr`` by a fixed name say that it is not."""
    found = [
        (path.name, node.lineno)
        for name, path in MODULES.items()
        if room(name) == "models"
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and (node.func.id == "hasattr" or (node.func.id == "getattr" and isinstance(node.args[1], ast.Constant)))
    ]
    assert not found


def test_one_solve():
    """Points, starts, ranges and failures are looked at in one place; the other one is the contract itself."""
    found = [
        node.name
        for name, path in MODULES.items()
        if room(name) in ("models", "full_order", "baselines")
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.ClassDef)
        for item in node.body
        if isinstance(item, ast.FunctionDef) and item.name == "solve" and "mu" in [arg.arg for arg in item.args.args]
    ]
    assert sorted(found) == ["AnsweringModel", "Model"]


def test_pages_name_what_is_there():
    """Modules and what is in them, where a page names them: ``models.local.Choice`` or ``models/local.py``."""
    texts = {name.removeprefix("hhr_dolfinx."): path.read_text() for name, path in MODULES.items()}
    missing = []
    for page in [*(ROOT / "docs").glob("*.md"), ROOT / "README.md"]:
        for said in set(re.findall(r"`([\w./]+)`", page.read_text())):
            parts = said.removeprefix("hhr_dolfinx.").removesuffix(".py").replace("/", ".").split(".")
            places = [".".join(parts[:k]) for k in range(1, len(parts) + 1)]
            folder = said.endswith("/") or len(parts) < 2
            deleted = parts[0] == "plugins" and parts[1:] and not present(parts[1])
            if folder or deleted or parts[0] not in LAYERS or said == "models.thesis":  # the latter a key of reports
                continue
            known = [place for place in places if place in texts]
            rest = parts[known[-1].count(".") + 1 :] if known else parts[1:]
            if not known or (rest and not re.search(rf"\b{rest[0]}\b", texts[known[-1]])):
                missing.append((page.name, said))
    assert not missing


def test_files_of_make_quick_are_there():
    text = (ROOT / "Makefile").read_text().partition("QUICK = ")[2].partition("\n\n")[0]
    core, _, others = text.replace("\\", "").partition("QUICK_PLUGINS = ")
    named = [f"core/test_{name}" for name in core.split()]
    named += [f"plugins/{name}" for name in others.split() if present(name.partition("/")[0])]
    assert len(named) > 25 and all((ROOT / "tests" / f"{name}.py").exists() for name in named)


def test_slow_cases_are_those_of_tests_that_are_there():
    """A name that is not would leave a dear case in the tests of every day, or out of all."""
    tests = ROOT / "tests"
    texts = {path.name: path.read_text() for path in tests.rglob("test_*.py")}
    marks = re.findall(r"\bneeds\(([^)]*)\)", "".join(texts.values()))
    known = {*OURS, *re.findall(r'"(\w+)"', "".join(marks))}
    assert {"one_call", "friction"} <= known
    lines = [line for line in (tests / "slow_cases.txt").read_text().splitlines() if not line.startswith("#")]
    for line in filter(None, lines):
        file, _, name = line.partition("::")
        if file in texts or present(*known):  # else it went with its plug-in
            assert f"def {name.partition('[')[0]}(" in texts[file], line
