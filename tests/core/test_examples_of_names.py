"""Examples in docstrings run: those of the public names that users meet first, and all others.

Those of public names use ``hhr``, ``np``, and, if they say so, ``scene`` of the example of Scene.
"""

import ast
import doctest
import importlib
from pathlib import Path

import numpy as np
import pytest
from needs import needs

import hhr_dolfinx as hhr

ROOT = Path(__file__).parents[2]
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
NAMES = {
    "Amplitude": (),
    "ArchardWear": ("wear",),
    "Body": (),
    "CentreOfPressure": ("resultants",),
    "ContactArea": ("resultants",),
    "ContactForce": (),
    "Coulomb": ("friction",),
    "Displacement": (),
    "DisplacementAt": (),
    "Enrich": (),
    "FieldModes": ("nodal_fields",),
    "FullOrderModel": (),
    "LargestPressure": (),
    "MarchSettings": ("friction",),
    "MeshFile": (),
    "Mortar": ("mortar", "friction"),
    "NodeToNode": (),
    "NodeToSurface": ("nonmatching",),
    "NodalField": ("nodal_fields",),
    "Nodes": ("nodal_loads",),
    "Norton": ("inelastic",),
    "Obstacle": ("friction",),
    "Opening": (),
    "ParameterSpace": (),
    "PathFamily": ("paths",),
    "Plasticity": ("inelastic",),
    "Pressure": (),
    "Reaction": ("resultants",),
    "Recipe": (),
    "Rid": (),
    "Scene": (),
    "Shape": ("shapes",),
    "Sobol": (),
    "GasketLayer": ("gaskets",),
    "NoSeparation": ("no_separation",),
    "SoftContact": ("soft_contact",),
    "Springs": ("nodal_loads", "elasticity"),
    "StressAt": ("stress",),
    "ThermalExpansion": ("volume_loads",),
    "ToolMotion": ("rigid_tools", "floating"),
    "Traction": (),
    "Tresca": ("friction",),
    "VonMises": ("stress",),
    "answer_points": ("tables",),
    "drive": ("rigid_tools", "floating"),
    "build": (),
    "condense": (),
    "SlidingHeat": ("contact_heat",),
    "condense_heat": ("contact_heat",),
    "condense_transient_heat": ("contact_heat",),
    "load_model": (),
    "reduce": ("one_call",),
    "save_model": (),
    "train": ("exact_errors",),
    "write_fields": ("plots",),
    "worst": ("worst_case",),
}
"""Public names with the plug-ins that their examples need."""
OTHERS = {
    "formulas": (),
    "reduction.modes": (),
    "plugins.inelastic.cubature": ("inelastic",),
    "plugins.plots.picture": ("plots",),
    "plugins.plots.recovery": ("plots",),
}
"""Modules whose examples are of other names, which they use without a prefix."""


def cases(table):
    return [
        pytest.param(name, marks=needs(*plugins) if plugins else ())
        for name, plugins in table.items()
    ]


def after_examples(name, variables):
    """Variables after the examples in the docstring of a public name."""
    parser = doctest.DocTestParser()
    text = getattr(hhr, name).__doc__
    examples = parser.get_doctest(text, {"hhr": hhr, "np": np, **variables}, name, None, None)
    assert examples.examples, f"{name} has no example in its docstring"
    report = []
    runner = doctest.DocTestRunner(optionflags=OPTIONS)
    assert not runner.run(examples, out=report.append, clear_globs=False).failed, "".join(report)
    return examples.globs


@pytest.fixture(scope="module")
def scene():
    """The scene of the example of Scene, which others refer to."""
    return after_examples("Scene", {})["scene"]


@pytest.mark.parametrize("name", cases(NAMES))
def test_examples_of_public_names(name, scene, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # some write files
    refers = ":class:`~hhr_dolfinx.Scene`:" in getattr(hhr, name).__doc__
    after_examples(name, {"scene": scene} if refers else {})


@pytest.mark.parametrize("module", cases(OTHERS))
def test_examples_of_other_names(module):
    found = doctest.testmod(importlib.import_module(f"hhr_dolfinx.{module}"), extraglobs={"np": np})
    assert found.attempted and not found.failed


def test_no_example_is_left_out():
    """One that nothing runs is wrong after the next change."""
    run = {ROOT / f"hhr_dolfinx/{name.replace('.', '/')}.py" for name in OTHERS}
    left_out = []
    for folder in ("hhr_dolfinx", "forms", "geometries"):
        for path in (ROOT / folder).rglob("*.py"):
            if path in run or ">>>" not in (text := path.read_text()):
                continue
            left_out += [
                (path.name, node.name)
                for node in ast.walk(ast.parse(text))
                if isinstance(node, ast.ClassDef | ast.FunctionDef)
                and ">>>" in (ast.get_docstring(node) or "")
                and node.name not in NAMES
            ]
    assert not left_out
