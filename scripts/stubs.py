"""Writes hhr_dolfinx/__init__.pyi, the public names of the core and of our plug-ins, for type checkers.

python scripts/stubs.py
"""

import importlib
from pathlib import Path

import hhr_dolfinx
from hhr_dolfinx.registry import places_in

ROOT = Path(hhr_dolfinx.__file__).parent


def stub() -> str:
    """The file."""
    places = dict(places_in({f"hhr_dolfinx.{module}": own for module, own in hhr_dolfinx.PUBLIC.items()}))
    for folder in (ROOT / "plugins").iterdir():
        if (folder / "__init__.py").exists():
            places |= places_in(importlib.import_module(f"hhr_dolfinx.plugins.{folder.name}").PLUGIN.public)
    named = sorted((place.partition(":")[0].removeprefix("hhr_dolfinx"), name) for name, place in places.items())
    lines = [f"from {module} import {name} as {name}" for module, name in named]
    return "\n".join(['"""Public names for type checkers; written by scripts/stubs.py."""', "", *lines, ""])


if __name__ == "__main__":
    (ROOT / "__init__.pyi").write_text(stub())
