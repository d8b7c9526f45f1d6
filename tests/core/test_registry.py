"""Manifests: what is left out, and why.

Each plug-in of ours is registered, and what it registers is there.
"""

import dataclasses
import importlib
import importlib.metadata
import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
import split_interface
from entry_points import Entry
from needs import OURS, needs, present
from processes import python
from scenes import pressed_block, with_bodies
from shell import invoke

import hhr_dolfinx as hhr
from hhr_dolfinx import registry
from hhr_dolfinx.by_name import find
from hhr_dolfinx.errors import FileContentError, HHRError, NotOfferedError, PluginWarning
from hhr_dolfinx.geometries.raw_mesh import RawMesh
from hhr_dolfinx.registry import Bounds, Plugin, Stage, Way
from hhr_dolfinx.study.training.train import Training

ROOT = Path(__file__).parents[2]
FOLDERS = sorted(
    path.parent.name for path in (ROOT / "hhr_dolfinx" / "plugins").glob("*/__init__.py")
)
NAMES = [pytest.param(name, marks=needs(name)) for name in OURS]
"""Our plug-ins, those that were deleted too."""


@pytest.fixture
def registered(monkeypatch):
    """Plug-ins of these entry points."""

    before = importlib.metadata.entry_points

    def found(*entries):
        def listed(**given):
            if not given["group"].startswith("hhr_dolfinx."):
                return before(**given)  # of others, such as the compiler of forms
            return entries if "plug" in given["group"] else importlib.metadata.EntryPoints(())

        monkeypatch.setattr(importlib.metadata, "entry_points", listed)
        registry.installed.cache_clear()
        return registry.installed()

    yield found
    registry.installed.cache_clear()


@pytest.mark.parametrize(
    ("entry", "why"),
    [
        (
            Entry(ImportError, "torn"),
            "'torn' is left out: somewhere:torn cannot be loaded: ImportError: no such",
        ),
        (Entry(SystemExit, "leaves"), "cannot be loaded: SystemExit"),
        (Entry({"name": "b"}, "untyped"), "is a dict and no hhr_dolfinx.registry.Plugin"),
        (Entry(Plugin("lonely", needs=("nobody",))), "'lonely' is left out: it needs nobody"),
        (
            Entry(Plugin("good", commands={"x": "a:b"})),
            "'good' is left out: somewhere:any has the name of another",
        ),
        (
            Entry(Plugin("odd", public={"m": 5})),
            "'any' is left out: somewhere:any cannot be loaded: TypeError",
        ),
        (
            Entry(Plugin("late", public={"n": "g"})),
            "'late' .* registers 'g' among public, which is m:g of .* 'good'",
        ),
        (
            Entry(Plugin("late", parts={"laws": {"L": "n:L"}})),
            "'late' .* 'L' among laws, which is m:L of .* 'good'",
        ),
        (
            Entry(Plugin("late", switches={"n": "s"})),
            "'late' .* 's' among switches, which is m:s of .* 'good'",
        ),
    ],
)
def test_a_plug_in_that_cannot_be_used_is_left_out_with_the_reason(registered, entry, why):
    parts = {"laws": {"m": "L"}}
    good = Entry(Plugin("good", public={"m": "f g"}, parts=parts, switches={"m": "s"}), "good")
    with pytest.warns(PluginWarning, match=why) as caught:
        assert list(registered(good, entry)) == ["good"]
    assert len(caught) == 1


def test_who_needs_one_that_is_left_out_is_left_out_too(registered):
    chain = [Entry(Plugin("c", needs=("b",))), Entry(Plugin("b", needs=("a",))), Entry(Plugin("d"))]
    with pytest.warns(PluginWarning, match=r"'(b|c)' is left out: it needs (a|b)") as caught:
        assert list(registered(*chain)) == ["d"]
    assert len(caught) == 2
    assert list(registered(*chain, Entry(Plugin("a")))) == ["a", "b", "c", "d"]


def test_a_plug_in_of_ours_keeps_its_name_whatever_comes_first(registered):
    """Entry points come in the order of their packages."""
    ours = Entry(Plugin("same", public={"m": "f"}), "ours")
    ours.value = f"{registry.GROUP}.same:PLUGIN"
    with pytest.warns(
        PluginWarning, match="'same' is left out: somewhere:any has the name of another plug-in"
    ):
        assert registered(Entry(Plugin("same", public={"n": "f"})), ours)["same"] is ours.found


def fails(*given):
    raise ZeroDivisionError("of a manifest")


def test_a_wanted_that_raises_counts_as_no():
    for item in (Way("m:a", fails), Bounds("m:a", fails), Stage("m:a", "", fails)):
        with pytest.warns(
            PluginWarning,
            match="m:a is left out: its 'wanted' raised ZeroDivisionError: of a manifest",
        ):
            assert not registry.wants(item, None)


def test_a_wanted_that_raises_ends_no_condensation(registered):
    full = hhr.FullOrderModel(pressed_block("plane_strain", cells=2))
    way, bounds, stage = Way("m:Way", fails), Bounds("m:bounds", fails), Stage("m:stage", "", fails)
    registered(Entry(Plugin("a", reductors={"w": way}, bounds=(bounds,), stages=(stage,))))
    with pytest.warns(
        PluginWarning,
        match="m:Way is left out: its 'wanted' raised ZeroDivisionError: of a manifest",
    ):
        model = hhr.condense(full)
    assert model.solve(0.05).forces().sum() > 0
    with pytest.warns(PluginWarning, match="m:(bounds|stage) is left out") as caught:
        hhr.build(full, hhr.compute_snapshots(full, [[0.0], [0.05], [0.1]]))
    assert {str(item.message)[2:8] for item in caught} >= {"bounds", "stage "}


def test_a_command_that_cannot_be_loaded_ends_no_other(registered):
    registered(Entry(Plugin("a", commands={"torn": "no_such_module:torn", "odd": "json:dumps"})))
    code, output = invoke("--help")
    assert code == 0 and output.count("(cannot be loaded") == 2 and "solve" in output
    for name, why in (
        ("torn", "ModuleNotFoundError: No module named 'no_such_module'"),
        ("odd", "is a function and no"),
    ):
        code, output = invoke(name, "--option", "word")
        assert code == 3 and f"hhr {name} cannot be loaded from" in output and why in output, output


def test_a_training_option_that_cannot_be_loaded_is_left_out(registered):
    registered(Entry(Plugin("a", trainings={"torn": "no_such_module:torn", "there": "json:dumps"})))
    with pytest.warns(
        PluginWarning, match="'torn' of no_such_module:torn is left out: ModuleNotFoundError"
    ):
        assert list(registry.loadable("trainings")) == ["there"]


def test_templates_may_be_imported_before_the_package():
    """Models asked for manifests as they were imported: a plug-in that imports them was left out as
    half loaded.
    """
    template = ROOT / "extension_templates" / "reductor"
    source = f"""
import importlib.metadata, sys, warnings
warnings.simplefilter("error")
sys.path.insert(0, {str(template)!r})
point = importlib.metadata.EntryPoint("my_reductor", "my_reductor:PLUGIN", {registry.GROUP!r})
before = importlib.metadata.entry_points
importlib.metadata.entry_points = lambda **given: (*before(**given), point) if given else before()
import my_reductor
from hhr_dolfinx import registry
assert registry.installed()["my_reductor"] is my_reductor.PLUGIN
"""
    python("-c", source)


@pytest.fixture
def without(registered):
    """No plug-in at all."""
    registered()


OF_OURS = json.loads(registry.OURS.read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", NAMES)
def test_the_core_knows_the_plug_in_of_each_name(name):
    for what, item in registry.owned(registry.installed()[name]):
        assert OF_OURS[what][item] == name, "run scripts/stubs.py"


@pytest.mark.usefixtures("without")
@pytest.mark.parametrize(("name", "plugin"), OF_OURS["public"].items())
def test_a_public_name_of_a_plug_in_that_is_not_there_names_it(name, plugin, monkeypatch):
    monkeypatch.delitem(vars(hhr), name, raising=False)
    with pytest.raises(
        AttributeError,
        match=f"no '{name}': it belongs to the plug-in '{plugin}', which is not inst",
    ):
        getattr(hhr, name)


@pytest.mark.usefixtures("without")
def test_what_a_scene_needs_of_a_plug_in_that_is_not_there_is_named(tmp_path):
    def said(plugin):
        return pytest.raises(
            (HHRError, AttributeError), match=f"plug-in '{plugin}', which is not installed"
        )

    scene = pressed_block("plane_strain", cells=2)
    with said("friction"):
        dataclasses.replace(scene, contacts=(dataclasses.replace(scene.contacts[0], friction=0.3),))
    with said("inelastic"):
        registry.reader_of(object(), "a body")
    with said("inelastic"):
        find("laws", "Plasticity")
    with said("plots"):
        scene.plot()
    with said("friction"):
        _ = hhr.Recipe.with_friction
    with said("shapes"):
        registry.tool("shapes", "a shape")
    with said("local_models"):
        _ = Training(None, None, None, None).local
    (tmp_path / "mesh.med").write_bytes(b"HDF")
    with said("mesh_formats"):
        hhr.MeshFile(tmp_path / "mesh.med").read()
    with said("floating"):
        hhr.FullOrderModel(dataclasses.replace(scene, displacements=()))
    for beyond in ({"poisson": 0.49}, {"young": "1 + push"}, {"grading": lambda x: 1 + x[0]}):
        with said("elasticity"):
            hhr.FullOrderModel(with_bodies(scene, **beyond))
    halves = [
        hhr.NodeToNode(*tags, (0, -1))
        for tags in zip(split_interface.UPPER, split_interface.LOWER, strict=True)
    ]
    with said("shared_nodes"):
        hhr.FullOrderModel(split_interface.scene(halves))
    assert hhr.FullOrderModel(split_interface.scene(halves[:1], outputs=())).conditions == 5


@pytest.mark.usefixtures("without")
@pytest.mark.parametrize(("name", "plugin"), OF_OURS["commands"].items())
def test_a_command_of_a_plug_in_that_is_not_there_names_it(name, plugin):
    code, output = invoke(name, "--help")
    assert (
        code == 2
        and f"no command '{name}': it belongs to the plug-in '{plugin}', which is not inst"
        in output
    )


def test_a_tool_that_no_plug_in_has_is_named(registered):
    registered(Entry(Plugin("a", tools={"writing": "json:dumps"})))
    assert registry.tool("writing", "a note")([1]) == "[1]"
    scene = pressed_block("plane_strain", cells=2)
    for what, drawn in (
        ("a scene", scene),
        ("an answer", hhr.FullOrderModel(scene).solve({"push": 0.05})),
    ):
        with pytest.raises(
            NotOfferedError,
            match=f"a figure of {what} needs a plug-in with the tool 'drawing', and none",
        ):
            drawn.plot()


def test_the_tool_of_a_plug_in_draws(registered, monkeypatch):
    """It gets what is drawn, and for an answer the full model, whose mesh it needs."""
    monkeypatch.setattr(registry, "drawn_by_a_test", lambda *given: given, raising=False)
    registered(Entry(Plugin("a", tools={"drawing": "hhr_dolfinx.registry:drawn_by_a_test"})))
    scene = pressed_block("plane_strain", cells=2)
    full = hhr.FullOrderModel(scene)
    answer = full.solve({"push": 0.05})
    assert scene.plot("a.png") == (scene, "a.png")
    found, path, mesh = answer.plot("b.png")
    assert found is answer and path == "b.png" and mesh is full


def read_by_a_test(path):
    """A triangle whose first corner is in the file, by the name of its body."""
    name, *place = path.read_text().split()
    points = np.array([[float(word) for word in place], [1.0, 0.0], [0.0, 1.0]])
    return RawMesh(points, "triangle", np.array([[0, 1, 2]]), {name: np.array([0])})


def test_the_reader_of_a_plug_in_is_asked_for_files_of_its_ending(
    registered, monkeypatch, tmp_path
):
    """Before those of the core, whatever the file begins with.

    Errors list the endings of all readers.
    """
    monkeypatch.setattr(registry, "read_by_a_test", read_by_a_test, raising=False)
    place = "hhr_dolfinx.registry:read_by_a_test"
    registered(Entry(Plugin("a", readers={".tri": place, ".three": place})))
    path = tmp_path / "mesh.TRI"
    path.write_text("*NODE -2.0 0.5")
    found = hhr.MeshFile(path).read()
    assert found.bodies.keys() == {"*NODE"} and found.points[0].tolist() == [-2.0, 0.5]
    for text, name in (("*NODE a b", "mesh.three"), ("nothing", "mesh.dat")):
        (tmp_path / name).write_text(text)
        with pytest.raises(
            FileContentError, match=rf"{name} .* in another format: .*\.cgns, \.tri, \.three$"
        ):
            hhr.MeshFile(tmp_path / name).read()
    with pytest.warns(
        PluginWarning, match=r"'b' is left out: it registers '\.tri' among readers, which is"
    ):
        registered(
            Entry(Plugin("a", readers={".tri": place})),
            Entry(Plugin("b", readers={".tri": "json:load"})),
        )
    assert hhr.MeshFile(path).read().bodies.keys() == {"*NODE"}


def test_our_plug_ins_register_as_those_of_others_do():
    entries = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"][
        registry.GROUP
    ]
    assert entries == {name: f"hhr_dolfinx.plugins.{name}:PLUGIN" for name in FOLDERS}
    assert present(*FOLDERS) and set(FOLDERS) <= set(OURS)


@pytest.mark.parametrize("name", NAMES)
def test_what_a_plug_in_registers_is_there(name):
    plugin = registry.installed()[name]
    assert plugin.name == name and set(plugin.needs) <= set(FOLDERS)
    for what in ("public", "classes", "commands", "switches"):
        for key, place in registry.places_in(getattr(plugin, what)):
            found = registry.load(place)
            assert (found.name if what == "commands" else found.__name__) == key
            assert what != "public" or getattr(hhr, key) is found
    parts = (place for named in plugin.parts.values() for _, place in registry.places_in(named))
    assert all(
        callable(registry.load(place))
        for place in (*parts, *plugin.companions, *plugin.tools.values(), *plugin.readers.values())
    )


def test_the_stub_for_type_checkers_has_all_public_names():
    spec = importlib.util.spec_from_file_location("stubs", ROOT / "scripts" / "stubs.py")
    stubs = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(stubs)
    written = set((ROOT / "hhr_dolfinx" / "__init__.pyi").read_text().splitlines())
    made = set(stubs.stub().splitlines())
    # the stub names plug-ins that may have been deleted
    assert made <= written
    assert all(".plugins." in line for line in written - made)


def test_the_core_names_no_plug_in():
    named = ROOT / "hhr_dolfinx" / "plugins"
    for path in (ROOT / "hhr_dolfinx").rglob("*.py"):
        if named not in path.parents:
            assert "hhr_dolfinx.plugins." not in path.read_text(encoding="utf-8"), path
