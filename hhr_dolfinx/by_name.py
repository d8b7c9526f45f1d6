"""Parts of a scene by name: from this package, from a file, or from another installed package.

A name is one of this package (``half_discs``), a path with a name in the file
(``my_scene.py:scene``), a module with a name in it (``my.package:scene``), or an entry point that
another package has registered in the group ``hhr_dolfinx.<kind>``, such as
``hhr_dolfinx.pairings``. Files and entry points are code and are executed: a file once for all of
its names, and again after a change.
"""

from __future__ import annotations

import difflib
import hashlib
import importlib
import importlib.metadata
import importlib.util
import sys
import traceback
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any

from hhr_dolfinx import registry
from hhr_dolfinx.errors import HHRError, SceneError

_MODULES: Mapping[str, Mapping[str, str]] = {
    "geometries": {
        "geometries.mesh_file": "MeshFile",
        "geometries.block": "block",
        "geometries.coated_block": "coated_block",
        "geometries.hertz_half_discs": "half_discs",
        "geometries.pellet_cladding": "pellet_cladding",
        "geometries.press_fit": "press_fit",
        "geometries.sphere_on_block": "sphere_on_block",
        "geometries.stacked_blocks": "stacked_blocks",
    },
    "pairings": {
        "pairings.obstacle": "Obstacle",
        "pairings.node_to_node": "NodeToNode",
    },
    "laws": {},
    "forms": {
        "forms.elasticity": "stiffness mass traction pressure",
        "forms.volume": "body_force centrifugal eigenstrain",
    },
    "loads": {
        "loads": "Pressure PartialPressure Traction",
    },
    "outputs": {
        "outputs": (
            "ContactForce ContactMoment ContactWidth DisplacementAt GapAt LargestPressure "
            "LinearForm LostContact"
        ),
    },
    "samplings": {"sampling": "Sobol LatinHypercube"},
    "scenes": {},
}
"""Names of the parts of the core, separated by blanks, by kind and by module below
``hhr_dolfinx``.
"""

OWN: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        kind: {name: f"hhr_dolfinx.{module}" for name, module in registry.places_in(modules)}
        for kind, modules in _MODULES.items()
    }
)
"""Places of the parts of the core, by kind and name; manifests have those of plug-ins."""

_LOADED: dict[Path, tuple[int, ModuleType]] = {}
"""Files that were executed, with the time of their last change."""
_FOLDERS: set[Path] = set()
"""Folders of files that were executed, successfully or not."""


def find(kind: str, name: str) -> Any:
    """Find a part of a kind of :data:`OWN` by a name in one of the forms of this module.

    Args:
        kind: kind of the part, such as ``pairings``.
        name: its name.

    Raises:
        SceneError: for an unknown name, a file without it, or a file that cannot be loaded.
    """
    if kind not in OWN:
        raise SceneError(f"there are no {kind!r}: kinds are {', '.join(OWN)}")
    if not isinstance(name, str) or not name.strip():
        raise SceneError(f"the name {name!r} of one of the {kind} must be a text")
    path, _, attribute = name.rpartition(":") if ":" in name else (name, "", "")
    if path.endswith(".py"):
        return _attribute(_file(Path(path)), attribute or kind.removesuffix("s"), path)
    if attribute:
        return _attribute(_module(path), attribute, path)
    if name in OWN[kind]:
        return registry.load(OWN[kind][name])
    if name in (of_plugins := registry.parts(kind)):
        return registry.load(of_plugins[name][0])
    entry_points = importlib.metadata.entry_points(group=f"hhr_dolfinx.{kind}")
    if name in entry_points.names:
        return _entry([point for point in entry_points if point.name == name])
    candidates = sorted({*OWN[kind], *of_plugins, *entry_points.names})
    near = difflib.get_close_matches(name, candidates, n=1)
    hint = f" Is '{near[0]}' meant?" if near else ""
    raise SceneError(
        f"none of the {kind} is called '{name}'{registry.remedy(kind, name)}.{hint} Known are "
        f"{', '.join(candidates) or 'none'}; besides, what a file has ('my_file.py:name'), and "
        f"entry points 'hhr_dolfinx.{kind}' of other packages"
    )


def names(kind: str) -> dict[str, str]:
    """Names of a kind, each with its package or plug-in."""
    owners = {name: "hhr_dolfinx" for name in OWN[kind]} | {
        name: at[1] for name, at in registry.parts(kind).items()
    }
    for point in importlib.metadata.entry_points(group=f"hhr_dolfinx.{kind}"):
        owners.setdefault(point.name, _owner(point))
    return owners


def place_of(error: BaseException) -> str:
    """File and line of an error in a file that was loaded here, or in a file next to it.

    Else empty.
    """
    position = ""
    for frame in traceback.extract_tb(error.__traceback__):
        # generated code, such as that of dataclasses, has a name such as <string> and no file
        if not frame.filename.startswith("<") and Path(frame.filename).resolve().parent in _FOLDERS:
            position = f"{Path(frame.filename).name}, line {frame.lineno}"
    return position


def _entry(points: list[importlib.metadata.EntryPoint]) -> Any:
    """Load an entry point; several of the same name must refer to the same object."""
    if len({point.value for point in points}) > 1:
        candidates = " and ".join(f"'{point.value}' of {_owner(point)}" for point in points)
        raise SceneError(f"'{points[0].name}' stands for {candidates}: write which one is meant")
    try:
        return points[0].load()
    except (Exception, SystemExit) as error:
        raise SceneError(
            f"'{points[0].name}' of the package {_owner(points[0])} cannot be loaded: "
            f"{type(error).__name__}: {error}"
        ) from error


def _owner(point: importlib.metadata.EntryPoint) -> str:
    """Name of the package of an entry point."""
    return point.dist.name if point.dist is not None else point.value


def _attribute(module: ModuleType, name: str, path: str) -> Any:
    if not hasattr(module, name):
        public = [attribute for attribute in vars(module) if not attribute.startswith("_")]
        near = difflib.get_close_matches(name, public, n=1)
        hint = f": is '{path}:{near[0]}' meant?" if near else f": name what is meant, '{path}:name'"
        raise SceneError(f"{path} has no '{name}'{hint}")
    return getattr(module, name)


def _module(name: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except HHRError:
        raise
    except (Exception, SystemExit) as error:
        raise SceneError(
            f"the module {name} cannot be loaded: {type(error).__name__}: {error}"
        ) from error


def _file(path: Path) -> ModuleType:
    """Module of a file, which may import other files of its folder."""
    if not path.is_file():
        beside = sorted(
            neighbour.name
            for neighbour in path.absolute().parent.glob("*.py")
            if neighbour.is_file()
        )[:8]
        hint = f", which has {', '.join(beside)}" if beside else ""
        raise SceneError(f"there is no file {path} in {path.absolute().parent}{hint}")
    resolved = path.resolve()
    changed = resolved.stat().st_mtime_ns
    if resolved not in _LOADED or _LOADED[resolved][0] != changed:
        _LOADED[resolved] = changed, _run(path, resolved)
    return _LOADED[resolved][1]


def _run(path: Path, whole: Path) -> ModuleType:
    name = _name_of(whole)
    spec = importlib.util.spec_from_file_location(name, whole)
    assert spec is not None and spec.loader is not None  # the name of the file ends in .py
    module = importlib.util.module_from_spec(spec)
    folder = str(whole.parent)
    _forget_others(whole.parent)
    _FOLDERS.add(whole.parent)
    sys.path.insert(0, folder)
    # dataclasses of the file look up their module by name
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except HHRError:
        raise
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        hint = ""
        if isinstance(error, ImportError) and "relative import" in str(error):
            hint = ". A file is no package: write 'import name' for what lies beside it"
        raise SceneError(
            f"{path}{_line_in(error, whole)}: {type(error).__name__}: {error}{hint}"
        ) from error
    finally:
        sys.path.remove(folder)
    # its functions may import other files of its folder later, with the lowest priority
    if folder not in sys.path:
        sys.path.append(folder)
    return module


def _name_of(whole: Path) -> str:
    """Name for the module of a file: the name of the file, unless a loaded module has it."""
    loaded = sys.modules.get(whole.stem)
    if loaded is None or getattr(loaded, "__file__", None) == str(whole):
        return whole.stem
    return f"{whole.stem}_{hashlib.sha256(bytes(whole)).hexdigest()[:12]}"


def _forget_others(folder: Path) -> None:
    """Unload modules of other folders with the names of files in this folder, so that a file can
    import the latter.
    """
    other_folders = _FOLDERS - {folder}
    for path in folder.glob("*.py"):
        file = getattr(sys.modules.get(path.stem), "__file__", None)
        if file is not None and Path(file).parent in other_folders and Path(file) not in _LOADED:
            del sys.modules[path.stem]


def _line_in(error: BaseException, path: Path) -> str:
    """Line of a file at which an error was raised, for messages."""
    if isinstance(error, SyntaxError) and error.filename and Path(error.filename) == path:
        return "" if error.lineno is None else f", line {error.lineno}"
    lines = [
        frame.lineno
        for frame in traceback.extract_tb(error.__traceback__)
        if Path(frame.filename) == path
    ]
    return f", line {lines[-1]}" if lines else ""
