"""The house as docs/architecture.md draws it: imports, sizes, types, clock, what a scene loads; figures of README."""

import ast
import doctest
import functools
import graphlib
import importlib
import json
import re
import sys
from pathlib import Path

import figures
import numpy as np
import pytest
from bare import SCENE_FOLDERS, python
from mpi4py import MPI
from needs import OURS, needs, present

import hhr_dolfinx as hhr

ROOT = Path(__file__).parents[2]
FOLDERS = {"hhr_dolfinx": "hhr_dolfinx", "forms": "hhr_dolfinx.forms", "geometries": "hhr_dolfinx.geometries"}

SCRIPTS = [path for folder in ("demos", "benchmarks/thesis") for path in (ROOT / folder).rglob("*.py")]


def modules():
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
    tree, found = ast.parse(MODULES[name].read_text()), []
    unseen = {
        inner
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test) and not types
        for inner in ast.walk(node)
    }
    for node in set(ast.walk(tree)) - unseen:
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            inner = [f"{node.module}.{alias.name}" for alias in node.names]
            found += [target if target in MODULES else node.module for target in inner]
    return found


def nodes(*kinds, paths=None):
    """Nodes of these kinds in files of the package, each behind its path."""
    trees = ((path, ast.parse(path.read_text())) for path in paths or MODULES.values())
    return [(path, node) for path, tree in trees for node in ast.walk(tree) if isinstance(node, kinds)]


def imports(name):
    return [target for target in all_imports(name, types=True) if target.split(".")[0] == "hhr_dolfinx"]


def room(name):
    return name.split(".")[1] if "." in name else "__init__"


PAGE = (ROOT / "docs/architecture.md").read_text()
BETWEEN = PAGE.partition("## Layers")[2].partition("Other packages")[0]
LAYERS = re.findall(r"`(\w+)`", "\n".join(re.findall(r"^\d+\. .*$", BETWEEN, re.MULTILINE)))
"""Folders and files of the package in the order of the page."""
PACKAGES = {
    package: set(re.findall(r"`(\w+)`", allowed))
    for packages, allowed in re.findall(r"^\| ((?:`\w+` ?)+)\|([^|]*)\|$", PAGE, re.MULTILINE)
    for package in re.findall(r"`(\w+)`", packages)
}
"""Packages of others on the page, each with the rooms that may import it."""


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
    found = python("-c", FOUND, cwd=ROOT)
    folders = {name if path.name == "__init__.py" else name.rpartition(".")[0] for name, path in MODULES.items()}
    assert set(found.stdout.split()) == folders


def test_functions_fit_on_a_screen():
    """Functions of up to 60 lines; a file is as long as its idea."""
    for path, node in nodes(ast.FunctionDef, paths=(*MODULES.values(), *SCRIPTS)):
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
    found = [(path.name, node.name) for path, node in nodes(ast.ClassDef) if node.name.endswith("Record")]
    assert found == [("reductor.py", "Record")]


def test_one_clock():
    clocks = re.compile(r"^\s*(?:import time|from time|import timeit)\b", re.MULTILINE)
    holders = [path.name for path in (*MODULES.values(), *SCRIPTS) if clocks.search(path.read_text())]
    assert holders == ["timing.py"]


def own(room, names):
    return [f"hhr_dolfinx.{room}.{name}" for name in names.split()]


# numba is not among them: DOLFINx loads it by itself where it is there; tests/core/test_extras.py does without
UNNEEDED = {
    "flow": [
        *own("plugins.inelastic", "laws constants update march reduced_flow full_order project study condense_flow"),
        *own("plugins.inelastic", "condensed_step condensed_fields condensed_flow"),
        *own("full_order", "gauss_points"),
    ],
    "meshes that do not match": [
        *own("plugins.nonmatching", "node_to_surface projection"),
        *own("plugins.mortar", "pairing segments"),
        "shapely",
    ],
    "clustering and peers": [
        *own("plugins", "local.clusters local.subspaces theorems.theorems"),
        *("sklearn", "kmedoids"),
    ],
    "pictures": [*own("plugins.studies", "plots"), "matplotlib", "pyvista"],
    "outputs": [
        "hhr_dolfinx.outputs",
        *own("full_order", "outputs"),
        *own("models.functionals", "functional kinds"),
        "hhr_dolfinx.plugins.stress.mesh",
    ],
    "many parameters at once": own("models", "many"),
    "elasticity and shapes that depend on parameters": [
        "hhr_dolfinx.formulas",
        *own("full_order", "varying"),
        *own("plugins.shapes", "shape reshaped"),
        *own("plugins.moduli", "shaped interpolated interpolation condense interpolate interpolate_reduced"),
        *own("models.eliminations", "block"),
        *own("reduction", "starts"),
    ],
    "gradients": [*own("models", "gradient"), *own("plugins.inelastic", "history_gradient")],
    "samplings": ["hhr_dolfinx.sampling"],
    "greedy training": own("plugins.greedy", "greedy indicators"),
    "families of paths": own("plugins.paths", "path_families"),
    "loads on bodies": own("plugins.volume_loads", "loads"),
}
"""What a study of an elastic scene on matching meshes does without; numba is not listed: DOLFINx loads it itself."""
OF_FILES = {*own("models.functionals", "kinds functional"), "hhr_dolfinx.formulas"}
"""What checks a file of condensed flow where it is written, and knows all that such files may hold."""
UNNEEDED_BY_FLOW = {
    what: [name for name in names if name not in OF_FILES]
    for what, names in UNNEEDED.items()
    if what not in ("flow", "meshes that do not match", "loads on bodies")
}
ELASTIC_ALONE = [*own("plugins", "studies.points baselines.naive"), *own("reduction", "exact")]
UNNEEDED_BY_FLOW["what only elastic scenes are compared with"] = ELASTIC_ALONE
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
    python("-c", program, cwd=folder)
    assert (folder / "report.json").exists() and (folder / "study.npz").exists()
    found = set((folder / "modules").read_text().split())
    assert "hhr_dolfinx.reduction.build" in found
    return found


@pytest.mark.parametrize(
    ("program", "unneeded"),
    [
        (ELASTIC, UNNEEDED),
        pytest.param(FLOWING, UNNEEDED_BY_FLOW, marks=(pytest.mark.slow, needs("inelastic", "nonmatching"))),
    ],
    ids=["elastic", "inelastic"],
)
@needs("studies")
def test_a_scene_loads_what_it_names(program, unneeded, tmp_path):
    found = modules_of_a_study(program, tmp_path)
    assert not {what: found & set(names) for what, names in unneeded.items() if found & set(names)}


def test_what_is_not_loaded_exists():
    """A module that was renamed would be absent for the wrong reason."""
    names = {name for listed in (UNNEEDED, UNNEEDED_BY_FLOW) for of in listed.values() for name in of}
    ours = {name for name in names if name.startswith("hhr_dolfinx")}
    assert {name for name in ours if ".plugins." not in name or present(name.split(".")[2])} <= set(MODULES)


@pytest.mark.parametrize("name", ["reduction.modes", pytest.param("plugins.paths.path_families", marks=needs("paths"))])
def test_examples_in_docstrings(name):
    found = doctest.testmod(importlib.import_module(f"hhr_dolfinx.{name}"), extraglobs={"np": np})
    assert found.attempted and not found.failed


def test_values_are_assigned_one_by_one():
    found = [
        (path.name, node.lineno)
        for path, node in nodes(ast.Assign)
        if isinstance(node.value, ast.Tuple) and isinstance(node.targets[0], ast.Tuple)
    ]
    assert len(found) < 20, found


def test_models_do_not_ask_for_attributes():
    for path, node in nodes(ast.Call, paths=[path for name, path in MODULES.items() if room(name) == "models"]):
        called = getattr(node.func, "id", "")
        fixed = called == "getattr" and isinstance(node.args[1], ast.Constant)
        assert called != "hasattr" and not fixed, (path.name, node.lineno)


def test_one_solve():
    paths = [path for name, path in MODULES.items() if room(name) in ("models", "full_order", "baselines")]
    found = [
        node.name
        for _, node in nodes(ast.ClassDef, paths=paths)
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
    assert len(named) > 20 and all((ROOT / "tests" / f"{name}.py").exists() for name in named)


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


README = figures.README.read_text()
KEPT = json.loads(figures.FILE.read_text())
DOCS = sorted((figures.ROOT / "docs").glob("*.md"))
QUOTED = re.compile(r"\d[\d.,]* ?(?:ms|us|µs|%|times)(?![\w-])|\d+ queries")
"""A time of an answer, a ratio, an error, or a break-even."""


def test_the_table_of_readme_is_that_of_the_file():
    assert figures.with_table(README, KEPT) == README
    assert KEPT


def test_a_changed_figure_is_seen():
    name = next(iter(KEPT))
    changed = KEPT | {name: KEPT[name] | {"N": KEPT[name]["N"] + 1}}
    assert figures.with_table(README, changed) != README


def test_readme_quotes_no_figure_outside_of_the_table():
    """Options of commands in its blocks of code, such as a tolerance, are no figures."""
    before, rest = README.split(figures.BEGIN)
    text = re.sub(r"```.*?```", "", before + rest.split(figures.END)[1], flags=re.DOTALL)
    text = re.sub(r"`[^`]*`", "", text)
    assert QUOTED.findall(text) == []
    found = QUOTED.findall("69 ms, 208 times, 0.10 / 0.21 %, 47 queries")
    assert found == ["69 ms", "208 times", "0.21 %", "47 queries"]


def test_scripts_of_the_table_are_there_and_make_runs_them():
    makefile = (figures.ROOT / "Makefile").read_text()
    assert set(KEPT) <= set(figures.SOURCES)
    for source in figures.SOURCES.values():
        assert (figures.ROOT / source.script).exists()
        assert re.search(rf"^{source.target}: setup\n\t.venv/bin/python {source.script}", makefile, re.MULTILINE)


@pytest.mark.slow
def test_sizes_in_the_file_are_those_of_the_scenes():
    """Sizes are counted again where that takes seconds; times and errors are those of the day that the file names."""
    for name in {"hertz_half_discs", *(["fretting"] if present("friction") else [])} & set(KEPT):
        problem = hhr.FullOrderModel(importlib.import_module(name).scene(), MPI.COMM_SELF).problem
        assert (problem.free.size, problem.contact.shape[0]) == (KEPT[name]["N"], KEPT[name]["N_lambda"]), name


@pytest.mark.parametrize("page", [figures.README, *DOCS], ids=lambda page: page.stem)
def test_no_page_quotes_what_no_longer_holds(page):
    stale = "69 ms|47 queries|0.33 ms|times the full order, 208|refused by local models|3700 tests"
    assert not re.search(stale, page.read_text())
