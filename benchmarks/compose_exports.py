"""Pages in node and C headers in a compiler: their answers along a path, beside those of Python."""

from __future__ import annotations

import ctypes
import json
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import MissingPackageError

Forces = list[np.ndarray]
"""Forces of all contact conditions at each step of a path."""
LIMIT = 100
"""Seconds after which node or a compiler is held to hang."""
STEPS = hhr.MarchSettings(relative_force=1e-11, iterations=200, outside="ignore")
"""Settings of histories of inelastic bodies whose steps are those of pages and headers."""
PROGRAM = """
const fs = require("fs"), hhr = require(process.argv[1]);
const { page, path, scripts } = JSON.parse(fs.readFileSync(0, "utf8"));
for (const script of scripts) require(script);
const own = page.match(/<script id="data" type="application.json">([^]*?)<.script>/)[1];
const data = JSON.parse(own);
hhr.Model.of(data.tree, hhr.decoded(data.arrays)).then((model) => {
  const found = [];
  const steps = data.tree.path ? new hhr.Steps(model) : null;
  let state = steps && steps.rest(path[0]);
  for (const point of path.slice(1)) {
    state = steps ? steps.reached(state, point) : model.solve(point);
    found.push([...state.forces]);
  }
  console.log(JSON.stringify(found));
});
"""
"""Program of node that answers along a path by the scripts and the data of a page."""
POINTS = """
#include "press.h"
int ask(int count, const double *points, double *forces, double *outputs) {
    press_work *work = press_new();
    int status = PRESS_DONE;
    for (int k = 1; k < count && !status; k++)
        status = press_solve(work, points + k * PRESS_PARAMETERS,
                             forces + (k - 1) * PRESS_CONDITIONS, outputs);
    press_free(work);
    return status;
}
"""
INCREMENTS = """
#include "press.h"
int ask(int count, const double *points, double *forces, double *outputs) {
    press_path *path = press_path_new();
    int status = press_rest(path, points);
    for (int k = 1; k < count && !status; k++)
        status = press_go(path, points + k * PRESS_PARAMETERS, forces + (k - 1) * PRESS_CONDITIONS,
                          outputs);
    press_path_free(path);
    return status;
}
"""
"""Programs in C that answer point by point, and along a path."""
WORDS = ["-std=c99", "-O0", "-shared", "-fPIC"]


def program(name: str) -> str:
    """Path of a program.

    Raises:
        MissingPackageError: if it is not installed.
    """
    found = shutil.which(name)
    if found is None:
        raise MissingPackageError(f"{name} is not on the PATH: install it, or leave its verb out")
    return found


def run(words: list[str], **how: Any) -> str:
    """Output of a program.

    Raises:
        RuntimeError: if it fails, with the end of what it says.
    """
    done = subprocess.run(words, capture_output=True, text=True, timeout=LIMIT, **how)
    if done.returncode:
        raise RuntimeError(f"{Path(words[0]).name}: {done.stderr[-400:]}")
    return done.stdout


def expected(model: Any, path: list, remembers: bool) -> Forces:
    """Forces of all contact conditions in Python, increment by increment or point by point."""
    if not remembers:
        return [model.solve(point, outside="ignore").forces() for _, point in path[1:]]
    settings = STEPS if model.equilibrium is not None else hhr.MarchSettings(outside="ignore")
    return [answer.multipliers for answer in model.march(path, settings).answers]


def page(model: Any, full: Any, path: list, remembers: bool) -> tuple[Forces, Forces]:
    """Forces of a page in node, and of Python."""
    from hhr_dolfinx.plugins.pages import page as pages
    from hhr_dolfinx.plugins.pages.scenery_of import scenery_of

    pages.check_for_page(model)
    with tempfile.TemporaryDirectory() as folder:
        written = hhr.write_model_page(Path(folder) / "model.html", model, scenery_of(full))
        text = written.read_text(encoding="utf-8")
    here = Path(pages.__file__).parent
    given = {
        "page": text,
        "path": [np.asarray(point).tolist() for _, point in path],
        "scripts": [str(here / "steps.js")],
    }
    words = [program("node"), "-e", PROGRAM, str(here / "model.js")]
    found = json.loads(run(words, input=json.dumps(given)))
    return [np.array(one, dtype=float) for one in found], expected(model, path, remembers)


def header(model: Any, path: list, remembers: bool) -> tuple[Forces, Forces]:
    """Forces of a compiled C header, and of Python."""
    from hhr_dolfinx.plugins.exporters.c_header import write_c_header

    points = np.ascontiguousarray([point for _, point in path], dtype=float)
    forces = np.full((len(path) - 1, model.conditions), np.nan)
    outputs = np.zeros(64)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_c_header(folder / "press.h", model)
        (folder / "press.c").write_text(INCREMENTS if remembers else POINTS)
        words = [program("cc"), *WORDS, "-o", "press.so", "press.c", "-lm"]
        run(words, cwd=folder)
        asked = ctypes.CDLL(str(folder / "press.so")).ask
        arrays = [ctypes.c_void_p(one.ctypes.data) for one in (points, forces, outputs)]
        status = asked(len(points), *arrays)
    if status:
        raise RuntimeError(f"the compiled header ends with status {status}")
    return list(forces), expected(model, path, remembers)
