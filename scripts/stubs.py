"""Writes what the core knows of our plug-ins: public names for type checkers, and all names for
messages.

These are hhr_dolfinx/__init__.pyi and hhr_dolfinx/plug_ins.json, which names the plug-in of what is
not there.

python scripts/stubs.py
"""

import importlib
import json
from pathlib import Path

import hhr_dolfinx
from hhr_dolfinx.registry import OURS, Plugin, owned, places_in

ROOT = Path(hhr_dolfinx.__file__).parent


def manifests() -> list[Plugin]:
    """Manifests of the plug-ins that are there."""
    folders = sorted(path.parent.name for path in (ROOT / "plugins").glob("*/__init__.py"))
    return [importlib.import_module(f"hhr_dolfinx.plugins.{name}").PLUGIN for name in folders]


def names() -> dict[str, dict[str, str]]:
    """Plug-in of each name, by kind and name."""
    known: dict[str, dict[str, str]] = {}
    for plugin in manifests():
        for what, name in owned(plugin):
            known.setdefault(what, {})[name] = plugin.name
    return {what: dict(sorted(own.items())) for what, own in sorted(known.items())}


def stub() -> str:
    """The file."""
    places = dict(
        places_in({f"hhr_dolfinx.{module}": own for module, own in hhr_dolfinx.PUBLIC.items()})
    )
    for plugin in manifests():
        places |= places_in(plugin.public)
    named = sorted(
        (place.partition(":")[0].removeprefix("hhr_dolfinx"), name)
        for name, place in places.items()
    )
    lines = [f"from {module} import {name} as {name}" for module, name in named]
    return "\n".join(
        ['"""Public names for type checkers; written by scripts/stubs.py."""', "", *lines, ""]
    )


if __name__ == "__main__":
    (ROOT / "__init__.pyi").write_text(stub())
    OURS.write_text(json.dumps(names(), indent=1) + "\n", encoding="utf-8")
