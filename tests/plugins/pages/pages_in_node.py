"""Pages and their scripts in node, jsdom and Chromium: how they are run, and what they say beside
Python.
"""

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from processes import WAIT

from hhr_dolfinx.plugins.pages import page

MODEL = Path(page.__file__).with_name("model.js")
NODE = shutil.which("node")
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
in_node = pytest.mark.skipif(NODE is None, reason="node is not there")
LOADED = """
const fs = require("fs"), hhr = global.hhr = require(process.argv[1]);
for (const part of ["bound", "steps", "flow"])
  require(process.argv[1].replace("model.js", part + ".js"));
const { page, path, points } = JSON.parse(fs.readFileSync(0, "utf8"));
const json = page.match(/<script id="data" type="application.json">([^]*?)<.script>/)[1];
const data = JSON.parse(json);
const loaded = hhr.Model.of(data.tree, hhr.decoded(data.arrays)), found = [];
loaded.then((model) => {
"""
"""Beginning of a program of node with the scripts and the data of a page; ENDED is its end."""
ENDED = "}).catch((error) => { console.error(error); process.exit(1); });"


def node(program, *files, **asked):
    """What a program prints that is given files of scripts and, where it reads one, an object."""
    words = [NODE, "-e", program, *map(str, files)]
    done = subprocess.run(
        words, input=json.dumps(asked), capture_output=True, text=True, timeout=WAIT
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def along(model, scenery, path, points=()):
    """What a page with friction finds along a path, and at points that are loaded in proportion."""
    given = {"path": np.array(path, float).tolist(), "points": np.array(points, float).tolist()}
    return node(ALONG, MODEL, page=page.page_text(model, scenery), **given)


def data_of(text):
    """Tree and arrays of a page, and that they end no script."""
    data = re.search(r'application/json">(.*?)</script>', text, re.DOTALL)[1]
    assert "<" not in data
    return json.loads(data)


def tree_of(model, scenery):
    """What a page knows of its model."""
    return data_of(page.page_text(model, scenery))["tree"]


def drawn_field(answer, scenery):
    """Displacement of the nodes that a page draws, one node after the other."""
    return answer.displacement().reshape(-1, scenery.points.shape[1])[scenery.nodes].ravel()


def check_field(found, answer, scenery, least=0.0, share=0.03):
    """A page draws by few modes."""
    exact = drawn_field(answer, scenery)
    assert np.linalg.norm(found["field"] - exact) < share * max(np.linalg.norm(exact), least)


def dumped(target, address, folder):
    """A page with an address as a browser has it in the end."""
    words = [
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-background-networking",
        "--no-first-run",
    ]
    words += [
        "--enable-unsafe-swiftshader",
        f"--user-data-dir={folder / 'profile'}",
        "--virtual-time-budget=3000",
    ]
    words += ["--dump-dom", f"{target.as_uri()}#{address}"]
    return subprocess.run(
        [CHROMIUM, *words], capture_output=True, text=True, timeout=WAIT, check=True
    ).stdout


ALONG = (
    LOADED
    + """
const sliding = new hhr.Steps(model);
let state = sliding.rest(path[0]);
for (const point of path.slice(1)) {
  state = sliding.reached(state, point);
  const names = ["forces", "position", "path", "work", "wear", "statuses"];
  const plain = Object.fromEntries(names.map((name) => [name, [...state[name]]]));
  found.push({ ...plain, outputs: model.outputs(state), field: [...model.displacement(state)] });
}
const begun = points.map((point) => sliding.begun(point));
const told = (states) =>
  ({ forces: [...states.at(-1).forces], path: states.map(({ point }) => point) });
console.log(JSON.stringify({ found, loaded: begun.map(told) }));
"""
    + ENDED
)


def check_increment(found, answer, largest, off=1e-10):
    """What a page or C finds in an increment with friction, beside Python.

    Forces are ``off`` at most.
    """
    np.testing.assert_allclose(found["forces"], answer.multipliers, rtol=0, atol=off * largest)
    for kind in {"position", "path", "work", "wear"} & found.keys():
        known = getattr(answer.slip, kind)
        np.testing.assert_allclose(
            found[kind], known, rtol=1e-8, atol=off * max(np.abs(known).max(), 1e-6)
        )
    assert list(found["statuses"]) == answer.slip.statuses.tolist()
    np.testing.assert_allclose(
        found["outputs"], list(answer.outputs().values.values()), rtol=1e-8, atol=1e-11
    )


PLACES = ("/usr/share/nodejs", "/usr/lib/node_modules", "/usr/local/lib/node_modules")
"""Where Debian and npm put packages for all users."""
PATHS = os.pathsep.join([*filter(None, [os.environ.get("NODE_PATH")]), *PLACES])


def in_jsdom(*words, asked=""):
    """A run of node that finds jsdom."""
    env = os.environ | {"NODE_PATH": PATHS}
    return subprocess.run(
        [NODE, *words], input=asked, capture_output=True, text=True, timeout=WAIT, env=env
    )


THERE = NODE is not None and in_jsdom("-e", "require.resolve('jsdom')").returncode == 0


def shown(text, address, *acts):
    """What a page shows at an address, and after each act of a user: see page_in_jsdom.js."""
    asked = json.dumps({"page": text, "address": address, "acts": acts})
    done = in_jsdom(Path(__file__).with_name("page_in_jsdom.js"), asked=asked)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["errors"] == []
    return told["found"]


def said(value):
    """A number as a page shows it."""
    return float(f"{value:.6g}")


def rows_of(view):
    """Numbers of the table by name."""
    return {row[0]: row[1] for row in view["table"][1:] if len(row) > 1}
