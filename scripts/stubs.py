"""Writes hhr_dolfinx/__init__.pyi, the public names of the core and of our plug-ins, for type checkers.

python scripts/stubs.py
"""

import importlib
from pathlib import Path

import hhr_dolfinx

ROOT = Path(hhr_dolfinx.__file__).parent


def stub() -> str:
    """The file."""
    names = {(module, name) for module, own in hhr_dolfinx.PUBLIC.items() for name in own.split()}
    for folder in (ROOT / "plugins").iterdir():
        if (folder / "__init__.py").exists():
            plugin = importlib.import_module(f"hhr_dolfinx.plugins.{folder.name}").PLUGIN
            names |= {
                (module.removeprefix("hhr_dolfinx."), name)
                for module, own in plugin.public.items()
                for name in own.split()
            }
    lines = [f"from .{module} import {name} as {name}" for module, name in sorted(names)]
    return "\n".join(['"""Public names for type checkers; written by scripts/stubs.py."""', "", *lines, ""])


if __name__ == "__main__":
    (ROOT / "__init__.pyi").write_text(stub())
