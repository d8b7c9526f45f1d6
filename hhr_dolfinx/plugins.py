"""What a scene is made of, found by name: in this package, in a user's file, or in another installed package.

A name is one of this package (``half_discs``), a path and what the file calls it (``my_scene.py:scene``), a module and
what it calls it (``my.package:scene``), or an entry point that another package has registered in the group
``hhr_dolfinx.<kind>``, such as ``hhr_dolfinx.pairings``. Files and entry points are code, and are run as such.
"""

from __future__ import annotations

import difflib
import importlib
import importlib.metadata
import importlib.util
import sys
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any

from hhr_dolfinx.errors import HHRError, SceneError

OWN: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "geometries": {
            name: f"hhr_dolfinx.geometries.{module}:{name}"
            for name, module in {
                "MeshFile": "mesh_file", "block": "block", "coated_block": "coated_block",
                "half_discs": "hertz_half_discs", "pellet_cladding": "pellet_cladding", "press_fit": "press_fit",
                "sphere_on_block": "sphere_on_block", "stacked_blocks": "stacked_blocks",
            }.items()
        },
        "pairings": {
            name: f"hhr_dolfinx.pairings.{module}:{name}"
            for name, module in {
                "Obstacle": "obstacle", "NodeToNode": "node_to_node", "NodeToSurface": "node_to_surface",
                "DoublePass": "node_to_surface", "Mortar": "mortar",
            }.items()
        },
        "laws": {name: f"hhr_dolfinx.materials.laws:{name}" for name in ("Plasticity", "Norton")},
        "forms": {
            name: f"hhr_dolfinx.forms.{module}:{name}"
            for name, module in {
                "stiffness": "elasticity", "mass": "elasticity", "traction": "elasticity", "pressure": "elasticity",
                "body_force": "volume", "centrifugal": "volume", "eigenstrain": "volume",
            }.items()
        },
        "scenes": {},
    }
)  # fmt: skip
"""What this package has, by kind and name."""


def find(kind: str, name: str) -> Any:
    """What a name stands for.

    Args:
        kind: ``geometries``, ``pairings``, ``laws``, ``forms`` or ``scenes``.
        name: see the head of this file.

    Raises:
        SceneError: for a name that is nowhere, a file without it, or one that cannot be loaded.
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
        module, _, own = OWN[kind][name].partition(":")
        return getattr(importlib.import_module(module), own)
    others = {point.name: point for point in importlib.metadata.entry_points(group=f"hhr_dolfinx.{kind}")}
    if name in others:
        try:
            return others[name].load()
        except Exception as error:
            raise SceneError(
                f"'{name}' of the package {_owner(others[name])} cannot be loaded: {type(error).__name__}: {error}"
            ) from error
    known = sorted({*OWN[kind], *others})
    near = difflib.get_close_matches(name, known, n=1)
    hint = f" Is '{near[0]}' meant?" if near else ""
    raise SceneError(
        f"none of the {kind} is called '{name}': there are {', '.join(known) or 'none'}, a file and a name in it "
        f"('my_file.py:name'), or entry points 'hhr_dolfinx.{kind}' of other packages.{hint}"
    )


def names(kind: str) -> dict[str, str]:
    """Names of a kind, and where each comes from."""
    found = {name: "hhr_dolfinx" for name in OWN[kind]}
    for point in importlib.metadata.entry_points(group=f"hhr_dolfinx.{kind}"):
        found.setdefault(point.name, _owner(point))
    return found


def _owner(point: importlib.metadata.EntryPoint) -> str:
    """Name of the package that has an entry point."""
    return point.dist.name if point.dist is not None else point.value


def _attribute(module: ModuleType, name: str, path: str) -> Any:
    if not hasattr(module, name):
        public = [item for item in vars(module) if not item.startswith("_")]
        near = difflib.get_close_matches(name, public, n=1)
        hint = f": is '{path}:{near[0]}' meant?" if near else f": name what is meant, '{path}:name'"
        raise SceneError(f"{path} has no '{name}'{hint}")
    return getattr(module, name)


def _module(name: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except HHRError:
        raise
    except Exception as error:
        raise SceneError(f"the module {name} cannot be loaded: {type(error).__name__}: {error}") from error


def _file(path: Path) -> ModuleType:
    """The module of a file, which may import what lies beside it."""
    if not path.is_file():
        beside = sorted(item.name for item in path.absolute().parent.glob("*.py"))[:8]
        hint = f", which has {', '.join(beside)}" if beside else ""
        raise SceneError(f"there is no file {path} in {path.absolute().parent}{hint}")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None  # of a file whose name ends in .py
    module = importlib.util.module_from_spec(spec)
    folder = str(path.absolute().parent)
    sys.path.insert(0, folder)
    # dataclasses of the file look for their module by its name
    sys.modules.setdefault(path.stem, module)
    try:
        spec.loader.exec_module(module)
    except HHRError:
        raise
    except Exception as error:
        line = _line_in(error, path)
        raise SceneError(f"{path}{line}: {type(error).__name__}: {error}") from error
    finally:
        sys.path.remove(folder)
    return module


def _line_in(error: BaseException, path: Path) -> str:
    """The line of a file at which an error was raised, for messages."""
    if isinstance(error, SyntaxError):
        return f", line {error.lineno}"
    trace, line = error.__traceback__, ""
    while trace is not None:
        if Path(trace.tb_frame.f_code.co_filename) == path:
            line = f", line {trace.tb_lineno}"
        trace = trace.tb_next
    return line
