"""Manifests: what is left out, and why; each plug-in of ours is registered, and what it registers is there."""

import importlib
import importlib.metadata
import tomllib
from pathlib import Path

import numpy as np
import pytest
from needs import present
from scenes import pressed_block

import hhr_dolfinx as hhr
from hhr_dolfinx import registry
from hhr_dolfinx.errors import FileContentError, NotOfferedError, PluginWarning, SceneError
from hhr_dolfinx.geometries.raw_mesh import RawMesh
from hhr_dolfinx.registry import Plugin

ROOT = Path(__file__).parents[2]
FOLDERS = sorted(path.parent.name for path in (ROOT / "hhr_dolfinx" / "plugins").glob("*/__init__.py"))


class Entry:
    """An entry point."""

    def __init__(self, found, name="any"):
        self.found, self.name, self.value = found, name, f"somewhere:{name}"

    def load(self):
        if isinstance(self.found, type):
            raise self.found("no such module")
        return self.found


@pytest.fixture
def registered(monkeypatch):
    """Plug-ins of these entry points."""

    def found(*entries):
        monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: entries)
        registry.installed.cache_clear()
        return registry.installed()

    yield found
    registry.installed.cache_clear()


@pytest.mark.parametrize(
    ("entry", "why"),
    [
        (Entry(ImportError, "torn"), "'torn' is left out: somewhere:torn cannot be loaded: ImportError: no such"),
        (Entry(SystemExit, "leaves"), "cannot be loaded: SystemExit"),
        (Entry({"name": "b"}, "untyped"), "is a dict and no hhr_dolfinx.registry.Plugin"),
        (Entry(Plugin("lonely", needs=("nobody",))), "'lonely' is left out: it needs nobody"),
        (Entry(Plugin("good", commands={"x": "a:b"})), "'good' is left out: somewhere:any has the name of another"),
    ],
)
def test_a_plug_in_that_cannot_be_used_is_left_out_with_the_reason(registered, entry, why):
    good = Entry(Plugin("good"), "good")
    with pytest.warns(PluginWarning, match=why) as caught:
        assert list(registered(good, entry)) == ["good"]
    assert len(caught) == 1


def test_who_needs_one_that_is_left_out_is_left_out_too(registered):
    chain = [Entry(Plugin("c", needs=("b",))), Entry(Plugin("b", needs=("a",))), Entry(Plugin("d"))]
    with pytest.warns(PluginWarning, match=r"'(b|c)' is left out: it needs (a|b)") as caught:
        assert list(registered(*chain)) == ["d"]
    assert len(caught) == 2
    assert list(registered(*chain, Entry(Plugin("a")))) == ["a", "b", "c", "d"]


def test_a_name_that_two_plug_ins_register_is_refused(registered):
    registered(Entry(Plugin("a", public={"m": "f g"})), Entry(Plugin("b", public={"n": "g"})))
    with pytest.raises(SceneError, match="'g' among their public: m:g and n:g"):
        registry.named("public")


def test_a_tool_that_no_plug_in_has_is_named(registered):
    registered(Entry(Plugin("a", tools={"writing": "json:dumps"})))
    assert registry.tool("writing", "a note")([1]) == "[1]"
    scene = pressed_block("plane_strain", cells=2)
    for what, drawn in (("a scene", scene), ("an answer", hhr.FullOrderModel(scene).solve({"push": 0.05}))):
        with pytest.raises(
            NotOfferedError, match=f"a figure of {what} needs a plug-in with the tool 'drawing', and none"
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


def test_the_reader_of_a_plug_in_is_asked_for_files_of_its_ending(registered, monkeypatch, tmp_path):
    """Before those of the core, whatever the file begins with; errors list the endings of all readers."""
    monkeypatch.setattr(registry, "read_by_a_test", read_by_a_test, raising=False)
    place = "hhr_dolfinx.registry:read_by_a_test"
    registered(Entry(Plugin("a", readers={".tri": place, ".three": place})))
    path = tmp_path / "mesh.TRI"
    path.write_text("*NODE -2.0 0.5")
    found = hhr.MeshFile(path).read()
    assert found.bodies.keys() == {"*NODE"} and found.points[0].tolist() == [-2.0, 0.5]
    for text, name in (("*NODE a b", "mesh.three"), ("nothing", "mesh.dat")):
        (tmp_path / name).write_text(text)
        with pytest.raises(FileContentError, match=rf"{name} .* in another format: .*\.cgns, \.tri, \.three$"):
            hhr.MeshFile(tmp_path / name).read()
    registered(Entry(Plugin("a", readers={".tri": place})), Entry(Plugin("b", readers={".tri": "json:load"})))
    with pytest.raises(SceneError, match=r"two plug-ins register '\.tri' among their readers"):
        hhr.MeshFile(path).read()


def test_our_plug_ins_register_as_those_of_others_do():
    entries = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"][registry.GROUP]
    assert entries == {name: f"hhr_dolfinx.plugins.{name}:PLUGIN" for name in FOLDERS}
    assert present(*FOLDERS)


@pytest.mark.parametrize("name", FOLDERS)
def test_what_a_plug_in_registers_is_there(name):
    plugin = registry.installed()[name]
    assert plugin.name == name and set(plugin.needs) <= set(FOLDERS)
    for what in ("public", "classes", "commands"):
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
