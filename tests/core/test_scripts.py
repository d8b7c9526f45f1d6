"""Scripts of demos and benchmarks: all names that they import exist, and each of them runs at its
smallest size.
"""

import ast
import importlib.util
import json
import os
import re
import shutil
import zipfile
from pathlib import Path

import pytest
from needs import needs, present
from processes import SCRIPT_FOLDERS, python

ROOT = Path(__file__).parents[2]
FILES = sorted(path for folder in SCRIPT_FOLDERS for path in Path(folder).glob("*.py"))
FILES += sorted(path for path in (ROOT / "demos").glob("*/*.py") if path.stem != "__init__")
PROGRAMS = {path.stem: path for path in FILES if "__main__" in path.read_text()}
TWICE = [path for path in FILES if "__main__" in path.read_text() and path not in PROGRAMS.values()]
PROGRAMS |= {
    f"{path.parent.name}_{path.stem}": path for path in TWICE
}  # a demo and a benchmark may share a name
NEEDED = {"calculix": "ccx"}
"""Programs without which a script has nothing to do."""


def missing_names(path):
    """Names that a file imports from the package, inside of functions too, and that are not
    there.
    """
    for node in ast.walk(ast.parse(path.read_text())):
        if (
            isinstance(node, ast.ImportFrom)
            and node.module
            and node.module.startswith("hhr_dolfinx")
        ):
            plugin = re.match(r"hhr_dolfinx\.plugins\.(\w+)", node.module)
            if plugin and not present(plugin[1]):
                continue
            module = importlib.import_module(node.module)
            for name in (alias.name for alias in node.names):
                inner = hasattr(module, "__path__") and importlib.util.find_spec(
                    f"{node.module}.{name}"
                )
                if not (hasattr(module, name) or inner):
                    yield f"{path.name}:{node.lineno}: {node.module}.{name}"


def test_all_names_that_scripts_import_exist():
    """An import inside of a function would fail at the end of an hour of work otherwise."""
    assert len(FILES) > 50
    assert [name for path in FILES for name in missing_names(path)] == []


def test_an_import_inside_of_a_function_is_seen(tmp_path):
    (tmp_path / "one.py").write_text(
        "def f():\n    from hhr_dolfinx.timing import timed, plot_fields\n"
    )
    assert list(missing_names(tmp_path / "one.py")) == ["one.py:2: hhr_dolfinx.timing.plot_fields"]


def check_friction(reports, folder):
    """Both models keep all conditions: what remains is round-off, and interpolation between walls,
    measured as 3e-7.

    Errors of an increment whose force is small are over a thousandth of the largest force: 1e-3
    bounds them.
    """
    report = reports["report"]
    assert {"scene", "seed", "versions", "machine"} <= set(report)
    assert report["sizes"]["N"] > 1000 and report["sizes"]["N_lambda"] > 100
    times, friction = report["times"], report["friction"]
    ratio = times["fom_best"]["median"] / times["online"]["median"]
    assert (
        report["ratios"]["fom_best/online"] == pytest.approx(ratio, rel=0.5)
        and times["offline"] > 0
    )
    assert {"increments", "iterations", "fallbacks", "mu_kappa", "reference"} <= set(friction)
    assert set(friction["errors"]) == {"normal", "tangential", "slip"}
    for error in friction["errors"].values():
        assert set(error) == {"median", "p95", "max", "n"} and error["n"] == friction["increments"]
        assert error["max"] < 1e-3


def check_pellet(reports, folder):
    report = reports["report"]
    assert (
        report["errors"]["dual_full_floored"]["max"] < 0.05 and report["errors"]["unconverged"] == 0
    )
    methods = {row["method"] for row in report["work_precision"]}
    assert {
        "HHR",
        "condensed",
        "cone-projected greedy",
        "NNMF",
        "coarser mesh",
        "fom_best",
        "fom_naive",
    } <= methods
    assert report["thesis_size"]["ell_bar"] <= 60 and report["thesis_size"]["N_lambda_C"] <= 40


def check_plastic(reports, folder):
    report = reports["report"]
    assert report["stability"]["tangent"] > 0 and report["errors"]["primal_euclid"]["max"] < 0.05
    for name in (
        "fields.vtu",
        "fields.png",
        "pressures.png",
        "contact_force.png",
        "iterations_of_a_step.png",
    ):
        assert (folder / name).stat().st_size > 5000


def check_nonmatching(reports, folder):
    report = reports["report"]
    assert report["errors"]["unconverged"] == 0 and report["point"]["here"]["primal_l2"] < 0.01


def check_sphere(reports, folder):
    report = reports["report"]
    assert (
        report["errors"]["dual_full_floored"]["median"] < 0.02
        and report["ratios"]["fom_best/online"] > 10
    )
    assert abs(report["hertz"][2]["peak"]) < 0.1


def check_extreme_cases(reports, folder):
    """No silent wrong answer: each case is right, warned of or refused, and these are what they
    are.
    """
    rows = reports["extreme_cases"]
    assert {row["outcome"] for row in rows} <= {"right", "warned", "refused"} and all(
        row["why"] for row in rows
    )
    full, known, reduced = (
        {row["case"]: row["outcome"] for row in rows if row["model"] == model}
        for model in ("full", "known answer", "reduced")
    )
    # the second is a fluid: locked, it seemed to bear the pressure
    refused = {
        "H < 0",
        "Norton K times 1e-3",
        "tube beyond its limit load",
    }
    assert {name: outcome for name, outcome in full.items() if outcome != "right"} == dict.fromkeys(
        refused, "refused"
    )
    warned = {"overlap of the sag of facets", "Norton tube of triangles"}
    assert {
        name: outcome for name, outcome in known.items() if outcome != "right"
    } == dict.fromkeys(warned, "warned")
    assert len(known) == 7
    stiff = (
        "pellet 1e-6 times as stiff",
        "pellet 1e6 times as stiff",
        "far obstacle at 1e8",
        "stresses in GPa",
    )
    for name in (*stiff, "press fit, contact never opens", "three shrink-fitted rings"):
        assert reduced[name] == "right", name
    untrained = [name for name in reduced if name.startswith("not trained: ")]
    assert len(untrained) == 4 and {
        reduced[name] for name in (*untrained, "half-discs, thesis recipe")
    } == {"warned"}
    assert any(
        "no training solution has contact" in row["why"]
        for row in rows
        if row["model"] == "reduced"
    )
    cases = reports["report"]["cases"]
    assert [(row["case"], row["outcome"]) for row in cases] == [
        (row["case"], row["outcome"]) for row in rows
    ]


def check_preload(reports, folder):
    """A preload that creeps, with friction, from a cold start in which nothing flows: small models
    are near.
    """
    found = reports["report"]["preload"]
    assert found["largest error of the small model [N]"] < 0.002 * found["preload, cold [N]"]
    assert 0.3 < found["after two campaigns, cold [N]"] / found["preload, cold [N]"] < 0.99


def check_power(reports, folder):
    found = reports["report"]["power"]
    assert found["largest error of the small model [N]"] < 0.01 * found["largest force [N]"]
    assert found["cumulated inelastic strain"] > 1e-3


def check_foreign(reports, folder):
    """Each force is that of the other code, and each falsified file is refused or named."""
    outcomes = {row["outcome"].partition(":")[0] for row in reports["report"]["foreign"]["cases"]}
    assert outcomes <= {"right", "refused", "named"} and "right" in outcomes


def check_flange(reports, folder):
    """Ten minutes in all; the reduction is exact, and the faces bear what the bolt has over the
    pressure.
    """
    report = reports["report"]
    assert report["minutes"]["in all"] < 10
    found = report["errors"]
    assert found["force of the bolt"] < 1e-6 and found["contact forces"] < 1e-6
    assert found["balance of forces"] < 1e-5
    forces = [report["starts"][name] for name in ("0.03", "0.06", "0.12")]
    assert (
        forces[1:] == pytest.approx([2 * forces[0], 4 * forces[0]], rel=1e-3)
        and 12e3 < forces[0] < 20e3
    )
    assert "modelDescription.xml" in zipfile.ZipFile(folder / "flange.fmu").namelist()
    assert (folder / "flange.html").stat().st_size > 1e5 and (
        folder / "flange.png"
    ).stat().st_size > 5000


def check_compose(reports, folder):
    """All that can be compared is right, of the empty scene and of two pairs.

    Two hypotheses exclude each other.
    """
    rows = reports["report"]["compose"]
    assert {row["outcome"] for row in rows} == {"works", "none", "excluded"}
    assert {tuple(row["capabilities"]) for row in rows if row["outcome"] == "excluded"} == {
        ("axisymmetric", "solid")
    }
    assert {row["verb"] for row in rows} >= {"full", "condense", "HHR", "page", "C", "gradient"}
    changes = [row["neutral"] for row in rows if row["neutral"] is not None]
    assert len(changes) == 2 and max(changes) < 1e-6


def check_thesis(reports, folder):
    """Each figure and table has a row, and closed forms among them are what they are on any
    mesh.
    """
    rows = reports["report"]["thesis"].values()
    numbered = {
        "figure": {1: 15, 2: 13, 3: 14, 4: 10, 5: 15, 6: 6},
        "table": {3: 3, 4: 4, 5: 1, 6: 1},
    }
    there = set().union(*(numbers_of(row["number"]) for row in rows))
    for kind, chapters in numbered.items():
        for chapter, last in chapters.items():
            items = {(kind, chapter, number) for number in range(1, last + 1)}
            assert items <= there, sorted(items - there)
    found = {row["number"]: row for row in rows}
    assert found["figure 1.14"]["as_printed"].startswith("N = 1356, N_lambda = 55")
    assert "beta_HR = 1.0000, beta_h on the RID = 1.0000" in found["theorem 10"]["as_printed"]
    ratios = re.findall(r"\((\S+) to", found["theorem 1"]["ours"])
    assert len(ratios) == 2 and all(float(ratio) >= 1 for ratio in ratios)
    assert all(row["printed"] for row in rows)


def numbers_of(text):
    """Figures and tables that the number of a row names: ``figures 3.6 to 3.8`` are three."""
    found, kind = set(), ""
    pattern = r"(figure|table)s?|(\d)\.(\d+)[a-c]?(?: to \d\.(\d+))?"
    for word, chapter, first, last in re.findall(pattern, text):
        kind = word or kind
        if chapter:
            numbers = range(int(first), int(last or first) + 1)
            found |= {(kind, int(chapter), number) for number in numbers}
    return found


def check_data_set(reports, folder):
    """All scenes have their files, with sums of each, and hidden answers apart."""
    sums = json.loads((folder / "data/checksums.json").read_text())
    scenes = reports["report"]["data_set"]
    assert len(scenes) == 6
    for scene in scenes:
        assert {f"{scene}/{name}.npz" for name in ("problem", "training", "test_points")} <= set(
            sums
        )
        assert (folder / "hidden" / f"{scene}.npz").exists()


def check_submissions(reports, folder):
    """Exact methods have no error; the nearest answer loses to some method on each scene."""
    scores = reports["report"]["scores"]
    assert scores["condensed_by_boxes_uncertain_ones"]["membrane"]["forces_worst"] < 1e-9
    for scene in ("matching", "nonmatching", "membrane"):
        errors = {name: row[scene]["forces_p95"] for name, row in scores.items() if scene in row}
        assert len(errors) > 10 and min(errors.values()) < errors["nearest_answer"]


def check_rivals(reports, folder):
    """All methods have a row on each scene, and condensation is exact where K is constant."""
    scenes = reports["report"]["rivals"]
    assert len(scenes) == 9  # the sphere is not quick
    for rows in scenes.values():
        assert len(rows) >= 24 and all("refused" in row or "errors" in row for row in rows.values())
    exact = {"condensed, all conditions": ("half-discs", "pellet", "rope", "membrane")}
    exact["condensed by boxes, uncertain ones"] = "half-discs", "rope", "membrane"
    for method, names in exact.items():
        for name in names:
            errors = scenes[name][method]["errors"]
            assert max(row["worst"] for row in errors.values()) < 1e-7
    for row in scenes["rope"].values():  # bounds are none where they are below the error
        assert row.get("effectivity", {"median": 1.0})["median"] >= 1


CHECKS = {
    "bolt_preload": check_preload,
    "data_set": check_data_set,
    "data_set_rivals": check_submissions,
    "demos_foreign": check_foreign,
    "foreign": check_foreign,
    "compose": check_compose,
    "extreme_cases": check_extreme_cases,
    "flange": check_flange,
    "fretting": check_friction,
    "pellet_cladding": check_pellet,
    "pellet_cladding_nonmatching": check_nonmatching,
    "pellet_cladding_plastic": check_plastic,
    "pellet_power": check_power,
    "press_fit_torque": check_friction,
    "rivals": check_rivals,
    "side_by_side": check_thesis,
    "sphere_on_block": check_sphere,
}
"""What reports must hold besides, and the folder where they lie."""
OF_PLUGINS = {
    "benchmarks": ("mortar", "second_order"),
    "bolt_preload": ("friction", "inelastic", "mortar", "volume_loads"),
    "calculix": ("exporters", "mortar", "second_order"),
    "calibrate": ("moduli",),
    "certified": ("fallback", "moduli", "mortar", "shapes", "theorems", "volume_loads"),
    "compose": ("conformance", "exporters", "friction", "moduli", "pages", "volume_loads"),
    "contact_patch_test": ("mortar",),
    "data_set": ("friction", "inelastic", "moduli", "mortar", "nonmatching", "shapes"),
    "data_set_rivals": ("bench", "nonmatching", "rivals", "tables"),
    "contract": (
        "baselines",
        "fallback",
        "friction",
        "inelastic",
        "local_models",
        "moduli",
        "shapes",
        "sliding",
        "tables",
    ),
    "extreme_cases": ("baselines", "inelastic", "mortar"),
    "demos_foreign": ("exporters", "foreign"),
    "foreign": ("foreign", "nonmatching"),
    "flange": (
        "constraints",
        "decks",
        "exporters",
        "mortar",
        "one_call",
        "pages",
        "nodal_loads",
        "second_order",
    ),
    "fretting": ("friction",),
    "friction": ("friction",),
    "friction_flow": ("friction", "inelastic", "nonmatching"),
    "friction_pellet": ("friction", "moduli"),
    "friction_random": ("friction",),
    "fuel_rod": ("moduli", "volume_loads"),
    "greedy_training": ("greedy", "moduli"),
    "history_indicator": ("inelastic", "nonmatching"),
    "indentation": ("inelastic", "mortar"),
    "local_models": ("greedy", "local_models", "moduli", "theorems"),
    "one_call": ("friction", "inelastic", "moduli", "mortar", "one_call", "shapes", "volume_loads"),
    "pellet_cladding": ("rivals",),
    "pellet_cladding_nonmatching": ("nonmatching",),
    "pellet_power": ("inelastic", "volume_loads"),
    "pellet_cladding_plastic": ("inelastic", "nonmatching"),
    "pellet_materials": ("moduli",),
    "press_fit": ("moduli", "mortar", "shapes", "volume_loads"),
    "press_fit_torque": ("friction", "mortar", "shapes", "volume_loads"),
    "random_recipes": ("baselines",),
    "rivals": ("local_models", "moduli", "nonmatching", "rivals"),
    "scale": ("moduli", "mortar"),
    "second_order": ("mortar", "second_order"),
    "side_by_side": (
        "greedy",
        "inelastic",
        "local_models",
        "moduli",
        "nonmatching",
        "rivals",
        "theorems",
    ),
    "sliding_punch": ("sliding", "friction"),
    "sphere_on_block": ("mortar",),
}
"""Plug-ins that scripts need, besides that of studies."""


ALSO = {"figures": ("--only", "hertz_half_discs")}
"""Options of a script that would run all others."""
OF_DEMO = "bolted_joint", "hertz_half_discs"
"""Those that test_demo.py runs as small."""


def test_all_scripts_have_one_interface():
    """``--out``, ``--quick``, ``--seed``, as `demo_parser` adds them, and a report."""
    assert [name for name, path in PROGRAMS.items() if "demo_parser(" not in path.read_text()] == []
    missing = [
        name
        for name, path in PROGRAMS.items()
        if "[--out DIR] [--quick] [--seed N]" not in path.read_text()
    ]
    assert missing == []


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=needs("studies", *OF_PLUGINS.get(name, ())))
        for name in sorted(set(PROGRAMS) - set(OF_DEMO))
    ],
)
def test_a_script_runs_at_its_smallest(name, tmp_path):
    if name in NEEDED and shutil.which(NEEDED[name]) is None:
        pytest.skip(f"{name} compares with {NEEDED[name]}, which is not on the PATH")
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    given = ["--quick", "--seed", "1", "--out", tmp_path, *ALSO.get(name, ())]
    python(PROGRAMS[name], *given, cwd=tmp_path, env=environment)
    reports = {path.stem: json.loads(path.read_text()) for path in tmp_path.glob("*.json")}
    assert reports["report"] and all(reports.values())
    if name in CHECKS:
        CHECKS[name](reports, tmp_path)


@needs("studies")
@pytest.mark.parametrize(("name", "ending"), [("leaf_spring", ".msh"), ("joint", ".step")])
def test_the_file_that_a_demo_reads_is_made_by_its_script(name, ending, tmp_path):
    """Under the name that the demo reads.

    With the cells of that file if it is not asked to be quick.
    """
    python(PROGRAMS[name], "--out", tmp_path)
    made, kept = (folder / f"{name}{ending}" for folder in (tmp_path, ROOT / "demos/meshes"))
    assert made.stat().st_size == pytest.approx(kept.stat().st_size, rel=0.02)
