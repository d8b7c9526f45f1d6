"""The house as docs/architecture.md draws it: imports, sizes, types, clock, what a scene loads.

Figures of README.
"""

import ast
import functools
import graphlib
import importlib
import json
import re
import sys
from pathlib import Path

import figures
import pytest
from mpi4py import MPI
from needs import OURS, needs, present
from processes import SCENE_FOLDERS, python

import hhr_dolfinx as hhr
from hhr_dolfinx import registry

ROOT = Path(__file__).parents[2]
FOLDERS = {
    "hhr_dolfinx": "hhr_dolfinx",
    "forms": "hhr_dolfinx.forms",
    "geometries": "hhr_dolfinx.geometries",
}

SCRIPTS = [
    path for folder in ("demos", "benchmarks/thesis") for path in (ROOT / folder).rglob("*.py")
]
MODULES = {
    ".".join([package, *path.relative_to(ROOT / folder).with_suffix("").parts]).removesuffix(
        ".__init__"
    ): path
    for folder, package in FOLDERS.items()
    for path in (ROOT / folder).rglob("*.py")
}
"""Files of the package by the names of their modules."""


@functools.cache
def all_imports(name, types=False):
    """What a module imports by full names, inside functions too.

    With what is for type checking only, or without.
    """
    tree, found = ast.parse(MODULES[name].read_text()), []
    guards = (
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)
    )
    unseen = set() if types else {inner for node in guards for inner in ast.walk(node)}
    for node in set(ast.walk(tree)) - unseen:
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            inner = [f"{node.module}.{alias.name}" for alias in node.names]
            found += [target if target in MODULES else node.module for target in inner]
    return found


@functools.cache
def walked(path):
    """All nodes of a file, which several tests read."""
    return list(ast.walk(ast.parse(path.read_text())))


def nodes(*kinds, paths=None):
    """Nodes of these kinds in files of the package, each behind its path."""
    return [
        (path, node)
        for path in paths or MODULES.values()
        for node in walked(path)
        if isinstance(node, kinds)
    ]


def imports(name):
    return [
        target for target in all_imports(name, types=True) if target.split(".")[0] == "hhr_dolfinx"
    ]


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


def test_the_page_names_all_layers_once():
    assert sorted(LAYERS) == sorted({room(name) for name in MODULES} - {"__init__"})


def test_a_module_imports_only_what_its_layer_may():
    below = {name: {"compat", *LAYERS[: LAYERS.index(name) + 1]} for name in LAYERS} | {
        "__init__": {"compat"}
    }
    found = {
        name: {room(target) for target in imports(name)} - below[room(name)] for name in MODULES
    }
    assert not {name: others for name, others in found.items() if others}


def test_a_module_imports_only_the_packages_of_others_that_its_room_may():
    known = {"hhr_dolfinx", "numpy", "scipy", "lazy_loader", *sys.stdlib_module_names}
    allowed = {
        name: {package for package, rooms in PACKAGES.items() if room(name) in rooms}
        for name in MODULES
    }
    found = {
        name: {item.split(".")[0] for item in all_imports(name)} - known - allowed[name]
        for name in MODULES
    }
    assert not {name: others for name, others in found.items() if others}


def test_the_page_allows_no_package_to_a_room_that_does_not_import_it():
    used = {(target.split(".")[0], room(name)) for name in MODULES for target in all_imports(name)}
    # what a plug-in imports that was deleted nobody else may
    rooms = {room(name) for name in MODULES} - (set() if present(*OURS) else {"plugins"})
    allowed = {
        (package, name) for package, places in PACKAGES.items() for name in places if name in rooms
    }
    assert allowed <= used, allowed - used


def test_no_circle():
    graph = {name: [target for target in imports(name) if target != name] for name in MODULES}
    list(graphlib.TopologicalSorter(graph).static_order())
    scripts = [path for folder in ("demos", "benchmarks") for path in (ROOT / folder).rglob("*.py")]
    imported = re.compile(r"^(?:from parts )?(?:import|from) (?:parts\.)?(\w+)", re.MULTILINE)
    calls = {path.stem: {*imported.findall(path.read_text())} - {path.stem} for path in scripts}
    assert "coarser" in calls["pellet_cladding_study"] and "extreme_flow" in calls["extreme_cases"]
    list(graphlib.TopologicalSorter(calls).static_order())


def test_plug_ins_declare_what_they_import_of_each_other():
    """Needed or optional ones, without a circle; types alone are no import.

    `make without` deletes what needs one.
    """
    ours = "hhr_dolfinx.plugins."
    imported = {}
    for name in (name for name in MODULES if name.startswith(ours)):
        owner = name.split(".")[2]
        named = {target.split(".")[2] for target in all_imports(name) if target.startswith(ours)}
        imported.setdefault(owner, set()).update(named - {owner})
    declared = {
        name: {*plugin.needs, *plugin.optional} for name, plugin in registry.installed().items()
    }
    assert not {
        name: others - declared[name]
        for name, others in imported.items()
        if others - declared[name]
    }
    unused = {
        name: set(registry.installed()[name].optional) - others for name, others in imported.items()
    }
    assert not {name: others for name, others in unused.items() if others}
    list(graphlib.TopologicalSorter(declared).static_order())


FOUND = """
import runpy, setuptools
setuptools.setup = lambda packages: print(*packages)
runpy.run_path("setup.py")
"""


def test_every_folder_is_installed():
    """Packages are found, by setup.py: a folder without an ``__init__`` would be left out."""
    found = python("-c", FOUND, cwd=ROOT)
    folders = {
        name if path.name == "__init__.py" else name.rpartition(".")[0]
        for name, path in MODULES.items()
    }
    assert set(found.stdout.split()) == folders


def test_functions_fit_on_a_screen():
    """Functions of up to 60 lines and a docstring; a file is as long as its idea."""
    for path, node in nodes(ast.FunctionDef, paths=(*MODULES.values(), *SCRIPTS)):
        first = node.body[0]
        documented = ast.get_docstring(node) is not None
        docstring = first.end_lineno - first.lineno + 1 if documented else 0
        assert node.end_lineno - node.lineno - docstring < 60, (path, node.name)


def test_public_functions_say_their_types():
    """What they take and return; a function within a function is no interface."""
    found = []
    for path in MODULES.values():
        tree = ast.parse(path.read_text())
        classes = [
            node
            for node in tree.body
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
        ]
        for node in (item for part in (tree, *classes) for item in part.body):
            if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
                given = [
                    item for item in ast.iter_child_nodes(node.args) if isinstance(item, ast.arg)
                ]
                if node.returns is None or any(
                    a.annotation is None and a.arg not in ("self", "cls") for a in given
                ):
                    found.append((path.name, node.name))
    assert not found


def test_one_class_of_record():
    """What a kind of model knows of its construction are facts of one record."""
    found = [
        (path.name, node.name) for path, node in nodes(ast.ClassDef) if node.name.endswith("Record")
    ]
    assert found == [("reductor.py", "Record")]


def test_one_clock():
    clocks = re.compile(r"^\s*(?:import time|from time|import timeit)\b", re.MULTILINE)
    holders = [
        path.name for path in (*MODULES.values(), *SCRIPTS) if clocks.search(path.read_text())
    ]
    assert holders == ["timing.py"]


def own(names):
    return {f"hhr_dolfinx.{name}" for name in names.split()}


# numba is not among them: DOLFINx loads it by itself where it is there; tests/core/test_extras.py
# does without
OF_NEITHER = {"kmedoids", "matplotlib", "pyvista", "sklearn"} | own(
    "full_order.outputs models.eliminations.block models.gradient models.many outputs "
    "plugins.studies.plots reduction.starts sampling"
)
"""Outputs, gradients, many parameters at once, stiffness that varies, samplings and pictures."""
UNNEEDED = {
    "elastic": OF_NEITHER
    | {"shapely"}
    | own(
        "formulas plugins.elasticity.gauss_points plugins.elasticity.parts "
        "models.functionals.functional models.functionals.kinds"
    ),
    "inelastic": OF_NEITHER
    | own("plugins.inelastic.history_gradient plugins.studies.points reduction.exact"),
}
"""What a study of a scene does without: an elastic one on matching meshes, and one that flows."""
OF_BOTH = {"scene_checks", "exact_errors", "small_strains", "studies", "theorems"}
PLUGINS = {
    "elastic": OF_BOTH | {"baselines"},
    "inelastic": OF_BOTH
    | {"elasticity", "inelastic", "mortar", "nonmatching", "paths", "ufl_programs", "volume_loads"},
}
"""All plug-ins of which such a study loads more than the manifest."""

STUDIES = {
    "elastic": """
import hertz_half_discs as demo
scene = demo.scene(arc_segments=28, flat_segments=7)
settings = demo.SETTINGS().adapted(seed=1, quick=True)
""",
    "inelastic": """
import pellet_cladding_plastic as demo
mesh = {"radial_cells": 6, "axial_cells": 10, "cladding_radial_cells": 2, "cladding_axial_cells": 7}
scene, paths = demo.scene(**mesh), {gap: demo.path(gap, 4) for gap in (5.0, 8.0, 10.0, 15.0)}
settings = hhr.StudySettings(
    [paths[5.0], paths[15.0]], held_out=[paths[8.0]], tests={"10": paths[10.0]}, repetitions=1
)
""",
}


@pytest.mark.parametrize(
    "study", ["elastic", pytest.param("inelastic", marks=(pytest.mark.slow, needs("inelastic")))]
)
@needs("studies")
def test_a_scene_loads_what_it_names(study, tmp_path):
    """In a whole study, report and model file included, pictures not."""
    program = (
        f"import sys; sys.path[:0] = {SCENE_FOLDERS!r}\n"
        "from pathlib import Path\nimport hhr_dolfinx as hhr\nfrom rich.console import "
        f"Console\n{STUDIES[study]}\nstudy = hhr.study_scene(scene, settings, "
        "Path('.'))\nstudy.write(Path('.'), Console(quiet=True))\nprint(*sys.modules, sep='\\n', "
        "file=open('modules', 'w'))\n"
    )
    python("-c", program, cwd=tmp_path)
    assert (tmp_path / "report.json").exists() and (tmp_path / "study.npz").exists()
    found = set((tmp_path / "modules").read_text().split())
    assert "hhr_dolfinx.reduction.build" in found and found & UNNEEDED[study] == set()
    assert set(re.findall(r"hhr_dolfinx\.plugins\.(\w+)\.", "\n".join(found))) <= PLUGINS[study]


def test_what_is_not_loaded_exists():
    """A module that was renamed would be absent for the wrong reason."""
    ours = {name for names in UNNEEDED.values() for name in names if name.startswith("hhr_dolfinx")}
    assert {name for name in ours if ".plugins." not in name or present(name.split(".")[2])} <= set(
        MODULES
    )


def test_values_are_assigned_one_by_one():
    of_tuples = (item for item in nodes(ast.Assign) if isinstance(item[1].value, ast.Tuple))
    found = [
        (path.name, node.lineno)
        for path, node in of_tuples
        if isinstance(node.targets[0], ast.Tuple)
    ]
    assert len(found) < 20, found


def test_models_do_not_ask_for_attributes():
    for path, node in nodes(
        ast.Call, paths=[path for name, path in MODULES.items() if room(name) == "models"]
    ):
        called = getattr(node.func, "id", "")
        fixed = called == "getattr" and isinstance(node.args[1], ast.Constant)
        assert called != "hasattr" and not fixed, (path.name, node.lineno)


def test_one_solve():
    paths = [
        path
        for name, path in MODULES.items()
        if room(name) in ("models", "full_order", "baselines")
    ]
    parts = (
        (node.name, item) for _, node in nodes(ast.ClassDef, paths=paths) for item in node.body
    )
    solves = (
        (name, item.args.args) for name, item in parts if getattr(item, "name", "") == "solve"
    )
    assert sorted(name for name, given in solves if "mu" in [a.arg for a in given]) == [
        "AnsweringModel",
        "Model",
    ]


def test_pages_name_what_is_there():
    """Modules and what is in them, where a page names them: ``models.local.Choice`` or
    ``models/local.py``.
    """
    texts = {name.removeprefix("hhr_dolfinx."): path.read_text() for name, path in MODULES.items()}
    missing = []
    for page in [*(ROOT / "docs").glob("*.md"), ROOT / "README.md"]:
        for said in set(re.findall(r"`([\w./]+)`", page.read_text())):
            parts = (
                said.removeprefix("hhr_dolfinx.").removesuffix(".py").replace("/", ".").split(".")
            )
            places = [".".join(parts[:k]) for k in range(1, len(parts) + 1)]
            folder = said.endswith("/") or len(parts) < 2
            deleted = parts[0] == "plugins" and parts[1:] and not present(parts[1])
            if (
                folder or deleted or parts[0] not in LAYERS or said == "models.thesis"
            ):  # the latter a key of reports
                continue
            known = [place for place in places if place in texts]
            rest = parts[known[-1].count(".") + 1 :] if known else parts[1:]
            if not known or (rest and not re.search(rf"\b{rest[0]}\b", texts[known[-1]])):
                missing.append((page.name, said))
    assert not missing


def other_tests(name, text, tests):
    """Names of tests that the text of a module imports, also in a program for another process.

    There a test may import itself.
    """
    statements = re.findall(r"(?:^|[\"';])\s*(?:from|import) ([^\n\"']*)", text, re.MULTILINE)
    return tests & {word for line in statements for word in re.findall(r"\w+", line)} - {name}


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("from test_a import scene", {"test_a"}),
        ("def f():\n    import numpy, test_a as other", {"test_a"}),
        ('PROGRAM = """\nimport test_a\n"""', {"test_a"}),
        ('f("import sys; import test_a, test_b")', {"test_a"}),
        ("import test_b\nfrom scenes import block\n# as in test_a", set()),
    ],
    ids=["a name", "in a function", "in a program", "in a line of a program", "none"],
)
def test_an_import_of_another_test_is_seen(text, found):
    assert other_tests("test_b", text, {"test_a", "test_b"}) == found


def test_no_test_imports_another():
    """What two of them share lies in a module whose name says what it holds."""
    files = sorted((ROOT / "tests").rglob("*.py"))
    tests = {path.stem for path in files if path.stem.startswith("test_")}
    assert len(tests) > 40
    found = {path.stem: other_tests(path.stem, path.read_text(), tests) for path in files}
    assert not {name: others for name, others in found.items() if others}


def test_each_plug_in_has_a_folder_of_tests():
    """Of its name, with a test at least; and no other folder has one."""
    folders = {path.parent.name for path in (ROOT / "tests/plugins").glob("*/*.py")}
    tested = {path.parent.name for path in (ROOT / "tests/plugins").glob("*/test_*.py")}
    own = {path.parent.name for path in (ROOT / "hhr_dolfinx/plugins").glob("*/__init__.py")}
    assert folders == tested == own


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
    lines = [
        line
        for line in (tests / "slow_cases.txt").read_text().splitlines()
        if not line.startswith("#")
    ]
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
    """A changed figure is seen."""
    assert figures.with_table(README, KEPT) == README
    name, row = next(iter(KEPT.items()))
    assert figures.with_table(README, KEPT | {name: row | {"N": row["N"] + 1}}) != README


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
        assert re.search(
            rf"^{source.target}: setup\n\t.venv/bin/python {source.script}", makefile, re.MULTILINE
        )


@pytest.mark.slow
def test_sizes_in_the_file_are_those_of_the_scenes():
    """Sizes are counted again where that takes seconds.

    Times and errors are those of the day that the file names.
    """
    for name in {"hertz_half_discs", *(["fretting"] if present("friction") else [])} & set(KEPT):
        problem = hhr.FullOrderModel(importlib.import_module(name).scene(), MPI.COMM_SELF).problem
        assert (problem.free.size, problem.contact.shape[0]) == (
            KEPT[name]["N"],
            KEPT[name]["N_lambda"],
        ), name


@pytest.mark.parametrize("page", [figures.README, *DOCS], ids=lambda page: page.stem)
def test_no_page_quotes_what_no_longer_holds(page):
    stale = (
        r"(?<![\d.])69 ms|47 queries|(?<!\d)0\.33 ms|times the full order, 208|"
        "refused by local models|3700 tests"
    )
    assert not re.search(stale, page.read_text())
