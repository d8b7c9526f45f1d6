"""A data set of six contact problems for reduced models of any kind, and its hidden answers.

Matching and non-matching meshes, friction on paths, plastic and creeping bodies, a shape as
parameter, and a membrane with as many contacts as nodes. Each scene has

- ``problem.npz``: parameters, mesh, places and areas of contacts, and where they are constant K, B,
  and loads and gaps at training and test points, sparse matrices by their CSC arrays;
- ``training.npz``: points or paths, forces, displacements;
- ``test_points.npz``: points or paths whose answers are hidden;

``scripts/plaid_samples.py`` makes samples of PLAID of these files (F. Casenave et al.,
arXiv:2505.02974).
Hidden answers are in a folder beside it, ``hidden``, for ``hhr bench score FILE --answers hidden``.
``checksums.json`` has the SHA-256 of each file. The files can be read without this package.

    python benchmarks/data_set.py [--out DIR] [--quick] [--seed N] [--only SCENE]
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import _demos  # noqa: F401 (before the scenes)
import friction_pellet
import hertz_half_discs
import numpy as np
import obstacles
import pellet_cladding
import pellet_cladding_nonmatching
import pellet_cladding_plastic
import press_fit
from mpi4py import MPI
from parts import cli
from scipy.sparse import csc_matrix, diags

import hhr_dolfinx as hhr
from hhr_dolfinx.files import write_arrays
from hhr_dolfinx.plugins.bench.score import ANSWERS_FORMAT, ANSWERS_VERSION
from hhr_dolfinx.plugins.studies import report
from hhr_dolfinx.warn import ignored

VERSION = 1
PLASTIC_MESH = {
    **pellet_cladding.QUICK_MESH,
    "cladding_axial_cells": 15,
    "cladding_radial_cells": 3,
}
NOTE = f"""Contact problems for reduced models, version {VERSION}.

Made by benchmarks/data_set.py of hhr_dolfinx (LGPL-3.0-or-later); docs/data_set.md says what the
files have and how to score answers.
"""


class Made(NamedTuple):
    """A scene, and its points or paths.

    Attributes:
        full: the full model.
        training: points, (S, P), or paths, (S, steps + 1, 1 + P), the time first.
        tests: the same of the test points.
    """

    full: Any
    training: np.ndarray
    tests: np.ndarray


def of_points(scene: hhr.Scene, training: Any, count: int, seed: int) -> Made:
    """A scene of single points."""
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    space = full.parameters
    points = space.grid(training) if isinstance(training, list) else training.points(space)
    return Made(full, np.asarray(points), space.random(count, seed))


def matching(quick: bool, seed: int) -> Made:
    """Two half-discs, thesis section 1.5.1."""
    return of_points(hertz_half_discs.scene(), [31], 10 if quick else 100, seed)


def nonmatching(quick: bool, seed: int) -> Made:
    """Pellet and cladding, thesis section 5.4."""
    mesh = {**pellet_cladding.QUICK_MESH, "cladding_axial_cells": 15}
    scene = pellet_cladding_nonmatching.scene(**mesh)
    return of_points(scene, [5, 4] if quick else [15, 12], 10 if quick else 100, seed)


def friction(quick: bool, seed: int) -> Made:
    """The pellet with friction on paths between random pressures and heights."""
    full = hhr.FullOrderModel(friction_pellet.scene(**pellet_cladding.QUICK_MESH), MPI.COMM_SELF)
    random = np.random.default_rng(seed)
    training = friction_pellet.training_paths(full.parameters, 2 if quick else 16, random)
    tests = [
        friction_pellet.path(full.parameters, random, friction_pellet.legs(random))
        for _ in range(2 if quick else 20)
    ]
    return Made(full, _rows(training), _rows(tests))


def plastic(quick: bool, seed: int) -> Made:
    """A plastic pellet in a creeping cladding, thesis chapter 6, at gaps in um."""
    full = hhr.FullOrderModel(pellet_cladding_plastic.scene(**PLASTIC_MESH), MPI.COMM_SELF)
    low, high = (1e3 * box[-1] for box in (full.parameters.lower, full.parameters.upper))
    steps = 8 if quick else 40
    gaps = np.linspace(low, high, 2 if quick else 9)
    asked = np.random.default_rng(seed).uniform(low, high, 2 if quick else 20)
    paths = [[pellet_cladding_plastic.path(gap, steps) for gap in some] for some in (gaps, asked)]
    return Made(full, *(_rows(some) for some in paths))


def shape(quick: bool, seed: int) -> Made:
    """A hub shrunk on a shaft, in space, whose shape is a parameter."""
    scene = press_fit.scene(**press_fit.QUICK_MESH)
    return of_points(scene, hhr.Sobol(8 if quick else 128), 6 if quick else 100, seed)


def membrane(quick: bool, seed: int) -> Made:
    """A membrane above a bowl: 5,041 nodes, each a contact."""
    full = obstacles.ObstacleModel(obstacles.membrane(*([11] if quick else [])))
    space = full.parameters
    return Made(full, space.grid([5, 5] if quick else [17, 17]), space.random(50, seed))


SCENES: dict[str, Callable[[bool, int], Made]] = {
    "matching": matching,
    "nonmatching": nonmatching,
    "friction": friction,
    "plastic": plastic,
    "shape": shape,
    "membrane": membrane,
}


def _rows(paths: list) -> np.ndarray:
    """Paths as arrays, the time first, (n, steps + 1, 1 + P)."""
    return np.array([[[time, *point] for time, point in path] for path in paths])


def answers_of(full: Any, asked: np.ndarray, progress: Any) -> tuple[np.ndarray, np.ndarray]:
    """Forces, (n, m), and displacements, (n, N); of paths of all steps, (n, steps, ...)."""
    forces, fields = [], []
    for entry in progress(asked):
        if entry.ndim == 1:
            answers = [full.solve(entry)]
        else:
            answers = full.march([(row[0], row[1:]) for row in entry]).answers
        forces.append([answer.forces() for answer in answers])
        fields.append([answer.displacement() for answer in answers])
    shown = slice(None) if asked.ndim == 3 else 0
    return np.array(forces)[:, shown], np.array(fields, dtype=np.float32)[:, shown]


def matrices(made: Made) -> dict[str, np.ndarray]:
    """K, B, and loads and gaps at all points, where they are constant; else nothing."""
    problem = made.full.problem
    if made.training.ndim == 3 or problem.varies or problem.reshaped is not None:
        return {}
    # imposed dofs have rows of the identity
    free = diags(problem.free.astype(float))
    stiffness = free @ problem.own_stiffness @ free + diags((~problem.free).astype(float))
    found = _csc("stiffness", stiffness) | _csc("contact", problem.contact)
    for name, points in (("training", made.training), ("test", made.tests)):
        thetas = [problem.amplitudes(point) for point in points]
        found[f"{name}_loads"] = np.array([problem.loads @ theta for theta in thetas])
        found[f"{name}_gaps"] = np.array([problem.gaps @ theta for theta in thetas])
        found[f"{name}_lifts"] = np.array([problem.lifts @ theta for theta in thetas])
    return found


def _csc(name: str, matrix: Any) -> dict[str, np.ndarray]:
    """Arrays of a sparse matrix."""
    columns = csc_matrix(matrix)
    return {
        f"{name}_data": columns.data,
        f"{name}_indices": columns.indices,
        f"{name}_indptr": columns.indptr,
        f"{name}_shape": np.array(columns.shape),
    }


def write_scene(name: str, made: Made, folder: Path, hidden: Path, progress: Any) -> dict[str, Any]:
    """Write the files of a scene, and its hidden answers; a row of the report."""
    problem = made.full.problem
    header = {"version": VERSION, "scene": name, "parameters": list(made.full.parameters.names)}
    known = matrices(made)
    forces, fields = answers_of(made.full, made.training, progress(f"{name}, training"))
    exact, exact_fields = answers_of(made.full, made.tests, progress(f"{name}, test points"))
    folder.mkdir(parents=True, exist_ok=True)
    mesh = {
        "lower": np.array(made.full.parameters.lower),
        "upper": np.array(made.full.parameters.upper),
        "points": problem.points,
        "cells": problem.cell_nodes,
        "contact_points": problem.contact_points,
        "contact_areas": problem.contact_areas,
    }
    for file, kind, arrays in (
        ("problem", "problem", mesh | known),
        ("training", "answers", {"asked": made.training, "forces": forces, "fields": fields}),
        ("test_points", "points", {"asked": made.tests}),
    ):
        write_arrays(folder / f"{file}.npz", {"format": f"contact {kind}", **header}, arrays)
    secret: dict[str, np.ndarray] = {"forces": exact, "fields": exact_fields}
    largest = np.linalg.norm(forces, axis=-1).max()
    secret["floor"] = np.array(1e-3 * largest)
    if known:
        free = [made.full.stiffness.solve(loads) for loads in known["test_loads"]]
        secret["slack"] = known["test_gaps"] - np.array(free) @ problem.contact.T
        parts = ("data", "indices", "indptr", "shape")
        for matrix in ("stiffness", "contact"):
            secret |= {f"{matrix}_{part}": known[f"{matrix}_{part}"] for part in parts}
    hidden.mkdir(parents=True, exist_ok=True)
    said = {"format": ANSWERS_FORMAT, "scene": name, "version": ANSWERS_VERSION}
    write_arrays(hidden / f"{name}.npz", said, secret)
    return {
        "N": len(problem.free),
        "N_lambda": len(problem.gaps),
        "training": list(made.training.shape),
        "tests": list(made.tests.shape),
    }


def checksums(folder: Path) -> dict[str, str]:
    """SHA-256 of all files of a folder by their path."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "checksums.json"
    }


def main() -> None:
    """Make scenes, write their files and checksums, and the report."""
    parser = cli.demo_parser("data_set", __doc__)
    parser.add_argument("--only", action="append", choices=list(SCENES), help="scenes [all]")
    options = cli.parse_on_first_rank(parser)
    folder, hidden = options.out / "data", options.out / "hidden"
    rows = {}
    for name in options.only or SCENES:
        with ignored(Warning):
            made = SCENES[name](options.quick, options.seed)
            rows[name] = write_scene(name, made, folder / name, hidden, options.progress)
    (folder / "README.txt").write_text(NOTE, encoding="utf-8")
    (folder / "checksums.json").write_text(json.dumps(checksums(folder), indent=1) + "\n")
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    shown = [
        {"scene": name} | {key: str(value) for key, value in row.items()}
        for name, row in rows.items()
    ]
    cli.print_rows(f"data set, {size / 1e6:.0f} MB", shown, options.console)
    found = {"scene": "data_set", "seed": options.seed, "data_set": rows, "bytes": size}
    report.write_report(found | report.environment(), options.out)


if __name__ == "__main__":
    main()
