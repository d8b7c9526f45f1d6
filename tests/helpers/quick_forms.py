"""Forms of the fast tests are compiled without optimisation: most run once, on some cells."""

import json
import os
from pathlib import Path

FOLDER = Path(__file__).parents[2] / ".pytest_cache" / "quick_forms"
OPTIONS = {"cffi_extra_compile_args": ["-O0", "-g0"]}


def compile_quickly(config):
    """Give DOLFINx options of its compiler, in processes of tests too.

    By a folder of settings, which other programs of the tests see too. Nothing is done for slow
    tests, which measure times, or where a user has options of their own.
    """
    if "not slow" not in config.option.markexpr or "XDG_CONFIG_HOME" in os.environ:
        return
    own = Path.home() / ".config" / "dolfinx" / "dolfinx_jit_options.json"
    if own.exists():
        return
    file = FOLDER / "dolfinx" / own.name
    text = json.dumps(OPTIONS)
    if not file.exists() or file.read_text() != text:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    os.environ["XDG_CONFIG_HOME"] = str(FOLDER)
