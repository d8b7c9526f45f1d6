"""Rivals of the literature beside ours, on ten scenes: same training, points, norms, clock.

Each scene is trained once. Models of other authors (``hhr_dolfinx/plugins/rivals``), regressions
and ours learn from these answers, and are asked at the same random points: errors of the
displacement, of forces on the whole surface, of the largest one and of their sum, of the number of
conditions that press, the strongest pull and the deepest overlap. Times of all of them are taken in
turns. The full order is the best one: from the statuses of the nearest training answer if that is
faster. In scenes of other authors each node is a contact (``obstacles.py``).

What to see: condensation keeps all conditions and is exact, or interpolated where moduli vary. HHR
is next. Where thousands of nodes touch, boxes of parameters with the conditions that change are
exact. Cones of few forces keep their sum right, and miss the forces of single nodes; supremizers
make them as dear as condensation. Regressions are right in sums and peaks; where contact ends their
forces pull.

    python benchmarks/rivals.py [--out DIR] [--quick] [--seed N] [--only SCENE] [--method METHOD]
                                [--docs [PAGE]]
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import _demos  # noqa: F401 (before the scenes)
import hertz_half_discs
import numpy as np
import obstacles
import pellet_cladding
import pellet_cladding_nonmatching
import pellet_materials
import sphere_on_block
import your_scene
from mpi4py import MPI
from parts import cli

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import force_floor, slack_residuals
from hhr_dolfinx.errors import HHRError
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.plugins.studies import report
from hhr_dolfinx.plugins.studies.points import time_queries
from hhr_dolfinx.plugins.studies.study import Rival, rivals_of
from hhr_dolfinx.study.training.train import Training
from hhr_dolfinx.timing import timed
from hhr_dolfinx.warn import ignored

PAGE = Path(__file__).resolve().parents[1] / "docs" / "rivals.md"
PRESSING = 1e-3
"""Part of the largest force from which a condition counts as one that presses."""
ROUND_OFF = 1e-9
"""Part of the forces below which their error is round-off, and has no effectivity."""
ERRORS = "displacement", "forces", "largest", "sum", "width", "pull", "overlap"
"""Errors by name: relative ones, and the share of conditions that press or not wrongly."""


class Case(NamedTuple):
    """How a scene is trained, and the recipe of its own model."""

    trained: Callable[[Any], Any]  #: training by a maker of progress bars
    recipe: hhr.Recipe = hhr.Recipe()
    tests: int = 100  #: test points
    #: the scene with cells of twice the size; None if its mesh is a file, or it has none
    coarser: hhr.Scene | None = None


COARSER = {"radial_cells": 30, "axial_cells": 50, "cladding_radial_cells": 4}
"""Cells of the pellet of twice the size."""
COARSER_QUICK = {"radial_cells": 6, "axial_cells": 10, "cladding_radial_cells": 1}


def _of(scene: hhr.Scene, points: Any) -> Callable[[Any], Training]:
    """Training of a scene at points."""
    return lambda progress: hhr.train(
        scene, points, held_out=0, comm=MPI.COMM_SELF, progress=progress
    )


def cases(quick: bool) -> dict[str, Case]:
    """Scenes by name."""
    mesh: dict[str, Any] = pellet_cladding.QUICK_MESH if quick else {}
    grid = (8, 6) if quick else pellet_cladding.GRID
    other = {**mesh, "cladding_axial_cells": 15} if quick else {}
    materials = pellet_materials.scene(**mesh), hhr.Sobol(64 if quick else 512)
    coarser = COARSER_QUICK if quick else COARSER
    unlike = {**coarser, "cladding_axial_cells": 8 if quick else 38}
    count = 12 if quick else 100
    found = {
        "half-discs": Case(
            _of(hertz_half_discs.scene(), [31]),
            coarser=hertz_half_discs.scene(arc_segments=28, flat_segments=7),
        ),
        "leaf spring": Case(_of(your_scene.scene(), hhr.Sobol(24 if quick else 128))),
        "pellet": Case(
            _of(pellet_cladding.scene(**mesh), grid), coarser=pellet_cladding.scene(**coarser)
        ),
        "pellet, 512 Sobol points": Case(
            _of(pellet_cladding.scene(**mesh), hhr.Sobol(48 if quick else 512)),
            tests=200,
            coarser=pellet_cladding.scene(**coarser),
        ),
        "meshes that do not match": Case(
            _of(pellet_cladding_nonmatching.scene(**other), grid),
            coarser=pellet_cladding_nonmatching.scene(**unlike),
        ),
        "sphere": Case(
            _of(sphere_on_block.scene(), sphere_on_block.TRAINING),
            coarser=sphere_on_block.scene(sphere_cells=(10, 5), block_cells=(8, 4)),
        ),
        "six parameters": Case(
            _of(*materials), pellet_materials.RECIPE, coarser=pellet_materials.scene(**coarser)
        ),
        "rope": Case(_obstacle(obstacles.rope, quick)),
        "membrane": Case(_obstacle(obstacles.membrane, quick), tests=40),
        "torsion": Case(_obstacle(obstacles.torsion, quick), tests=40),
    }
    if quick:
        del found["sphere"]
    return {name: case._replace(tests=min(case.tests, count)) for name, case in found.items()}


def _obstacle(made: Callable[..., obstacles.Obstacle], quick: bool) -> Callable[[Any], Any]:
    """Training of a scene of other authors on a grid."""
    size, counts = ((9,), [5, 5]) if quick else ((), [17, 17])
    return lambda progress: obstacles.ObstacleTraining(made(*size), counts, progress)


def rivals(training: Training, case: Case) -> Iterator[Rival]:
    """Ours by default, all of the plug-in, and a coarser mesh."""
    yield Rival("HHR", "default", lambda: training.build(case.recipe, checked=False))
    yield Rival("condensed", "all conditions", training.condense)
    yield from rivals_of(["all"])(training)
    if (coarser := case.coarser) is not None:
        made = partial(hhr.CoarserMesh, training.full_order, coarser)
        yield Rival("coarser mesh", "cells of twice the size", made)


class Exact(NamedTuple):
    """Full answers at test points."""

    points: np.ndarray
    answers: list[Answer]
    floor: float


def errors_of(training: Training, model: Any, exact: Exact) -> dict[str, np.ndarray]:
    """Errors of a model at all points by name, (n,) each; infinite without an answer."""
    found: dict[str, list[float]] = {name: [] for name in ERRORS}
    for point, known in zip(exact.points, exact.answers, strict=True):
        row = dict.fromkeys(ERRORS, np.inf)
        try:
            answer = model.solve(point, outside="ignore", raise_on_failure=False)
        except HHRError:
            answer = None
        if answer is not None and answer.converged:
            row = _row(training.full_order, answer, known, exact.floor)
        for name, value in row.items():
            found[name].append(float(value))
    return {name: np.array(values) for name, values in found.items()}


def _row(full: Any, answer: Answer, known: Answer, floor: float) -> dict[str, float]:
    """Errors of one answer by name."""
    forces, exact = answer.forces(), known.forces()
    problem = full.problem.at(known.parameter)
    theta = full.problem.amplitudes(known.parameter)
    field, right = answer.displacement(), known.displacement()
    overlap, pull = slack_residuals(problem, field - full.problem.lifts @ theta, forces, theta)
    press, should = (one > max(PRESSING * one.max(), floor) for one in (forces, exact))
    return {
        "displacement": np.linalg.norm(field - right) / np.linalg.norm(right),
        "forces": np.linalg.norm(forces - exact) / max(np.linalg.norm(exact), floor),
        "largest": abs(forces.max() - exact.max()) / max(exact.max(), floor),
        "sum": abs(forces.sum() - exact.sum()) / max(exact.sum(), floor),
        "width": np.mean(press != should),
        "pull": pull,
        "overlap": max(overlap, 0.0),
    }


def measured(
    case: Case, methods: Sequence[str], quick: bool, seed: int, progress: Callable[[str], Any]
) -> dict[str, dict[str, Any]]:
    """Rows of a scene by the name of the method, of some methods or of all."""
    training = case.trained(progress)
    full = training.full_order
    points = full.parameters.random(case.tests, seed + 7)
    answers = [full.solve(point) for point in progress("test points")(points)]
    exact = Exact(points, answers, force_floor(full.problem, training.snapshots))
    found: dict[str, dict[str, Any]] = {}
    models: dict[str, Any] = {}
    asked = [rival for rival in rivals(training, case) if not methods or rival.method in methods]
    for rival in progress("rivals")(asked):
        name = f"{rival.method}, {rival.setting}"
        try:
            model, seconds = timed(rival.made)
        except HHRError as error:
            found[name] = {"refused": str(error)}
            continue
        models[name] = model
        errors = errors_of(training, model, exact)
        found[name] = {
            "errors": {kind: _summary(values) for kind, values in errors.items()},
            "unanswered": int(np.isinf(errors["forces"]).sum()),
            "build": seconds,
            **_effectivity(training, model, points),
        }
    fresh = full.parameters.random(20 if quick else 105, seed + 1000)
    queries = {name: lambda point, one=model: one.solve(point) for name, model in models.items()}
    nearest = _from_nearest(training)
    queries |= {
        "full": full.solve,
        "nearest": lambda point: full.solve(point, start=nearest(point)),
    }
    times = {
        name: float(np.median(seconds)) for name, seconds in time_queries(queries, fresh).items()
    }
    best = min(times["full"], times["nearest"])
    for name in models:
        found[name] |= {"seconds": times[name], "times full": best / times[name]}
    return found


def _from_nearest(training: Any) -> Callable[[np.ndarray], np.ndarray]:
    """Statuses of the nearest training answer, by the sides of the box."""
    known = training.snapshots
    space = training.full_order.parameters
    sides = np.subtract(space.upper, space.lower)

    def found(point: np.ndarray) -> np.ndarray:
        off = (((known.points - point) / sides) ** 2).sum(axis=1)
        return known.active[:, off.argmin()]

    return found


def _effectivity(training: Any, model: Any, points: np.ndarray) -> dict[str, dict[str, float]]:
    """Bound of the error of forces over the error, where its norm is sparse and it is no
    round-off.
    """
    if not isinstance(training, obstacles.ObstacleTraining):
        return {}
    ratios = []
    for point in points:
        answer = model.solve(point, outside="ignore", raise_on_failure=False)
        if answer.converged:
            error, bound, size = obstacles.bound_of(training.full_order, answer)
            if error > ROUND_OFF * size:
                ratios.append(bound / error)
    return {"effectivity": _summary(np.array(ratios))} if ratios else {}


def _summary(values: np.ndarray) -> dict[str, float]:
    """Median, 95th percentile and largest of errors."""
    return {
        "median": float(np.median(values)),
        "p95": float(np.percentile(values, 95, method="higher")),
        "worst": float(values.max()),
    }


def table(rows: dict[str, dict[str, Any]]) -> list[dict[str, str]]:
    """Rows of a scene for people, the most exact forces first."""
    met = sorted(
        (name for name in rows if "errors" in rows[name]),
        key=lambda name: rows[name]["errors"]["forces"]["p95"],
    )
    lines = []
    for name in met:
        row = rows[name]
        errors = row["errors"]
        shown = {kind: _percent(errors[kind]["p95"]) for kind in ("displacement", "forces")}
        shown |= {"worst forces": _percent(errors["forces"]["worst"])}
        shown |= {kind: _percent(errors[kind]["p95"]) for kind in ERRORS[2:]}
        lines.append(
            {
                "method": name,
                **shown,
                "us": f"{1e6 * row['seconds']:.0f}",
                "x full": f"{row['times full']:.1f}",
            }
        )
        if "effectivity" in row:
            lines[-1]["bound / error"] = f"{row['effectivity']['median']:.1f}"
        elif any("effectivity" in other for other in rows.values()):
            lines[-1]["bound / error"] = "exact"
    return lines


def _percent(value: float) -> str:
    """A share in per cent; a dash where answers are missing."""
    return f"{100 * value:.2g}" if np.isfinite(value) else "-"


INTRODUCTION = """# Rivals side by side

Reduced models of other authors, regressions and ours on the same training answers and the same
random points. `python benchmarks/rivals.py --docs` makes this page; [studies](studies.md#rivals)
says what the methods are, and how to have them on your own scene.

Figures are errors in per cent that 95 % of the points do not exceed, and the worst of the forces;
*width* is the share of conditions that press wrongly or do not, *pull* the strongest tension over
the largest force, *overlap* the deepest one over the gaps. A dash: no answer at some points. Times
are of one answer on one thread, in turns with the full order (of Gaussian processes and coarser
meshes in another run: compare their *x full*, not their *us*); *x full* is by how much the
best full order is slower: it keeps its factors, and starts from the statuses of the nearest
training answer if that is faster. *bound / error*, where the norm of the bound is sparse, is the
median of the [bound of obstacles](bounds_proofs.md#where-every-node-is-a-contact) over the error of
the forces.

**What a Gaussian process gives.** On the pellet, trained on 512 Sobol points, half of its forces
are 1.1 % off or less, 95 % of them 11 %, the worst 58 %; radial functions 2.2, 11 and 48 %; sums of
forces within 3 %. On the grid of 25 x 20 points, which the thesis takes, 95 % are within 34 %.

**A coarser mesh** with cells of twice the size is 4 % off on the pellet, where it answers five to
eight times as fast as the best full order; on meshes that do not match, and where a sphere touches
a few cells, 8 to 26 %.

**Where ours lose.** Radial functions answer in 20 to 70 us where there are some hundred conditions,
on the pellet several times as fast as condensation and HHR; with two parameters their largest force
and sum are right to some per cent, the forces of nodes are not, and where contact ends they pull.
On the leaf spring Nitsche's method with forty nodes is more exact than HHR by default. HHR as the
thesis prints it, without what it leaves to the reader, is behind most of them, and has no answer at
some points of the pellet. Where every node is a contact HHR has no cells to cut; on the membrane
and in torsion condensation of all conditions is slower than the full order, and cones answer
several times as fast as boxes, a few to ten per cent off.
"""


def write_page(scenes: dict[str, dict[str, dict[str, Any]]], page: Path) -> None:
    """Write the page of a report."""
    lines = [INTRODUCTION]
    for name, rows in scenes.items():
        shown = table(rows)
        lines += [f"## {name[0].upper()}{name[1:]}", "", f"| {' | '.join(shown[0])} |"]
        lines.append("|" + "---|" * len(shown[0]))
        lines += [f"| {' | '.join(line.values())} |" for line in shown]
        lines.append("")
        refused = {row["refused"]: [] for row in rows.values() if "refused" in row}
        for method, row in rows.items():
            if "refused" in row:
                refused[row["refused"]].append(method)
        lines += [f"- refused, {'; '.join(who)}: {why}" for why, who in refused.items()]
        lines += [""] if refused else []
    page.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")


def main() -> None:
    """Measure scenes, print their tables, write the report, and the page if asked."""
    parser = cli.demo_parser("rivals", __doc__)
    parser.add_argument("--only", action="append", help="a scene to measure; repeat it [all]")
    parser.add_argument(
        "--docs", type=Path, nargs="?", const=PAGE, help="write the page of the report [docs]"
    )
    parser.add_argument(
        "--method", action="append", help="a method whose rows of the report are measured [all]"
    )
    options = cli.parse_on_first_rank(parser)
    scenes = _known(options.out)
    known = cases(options.quick)
    if wrong := sorted({*(options.only or ())} - known.keys()):
        parser.error(f"no scene is called {', '.join(wrong)}: name one of {', '.join(known)}")
    for name, case in known.items():
        if options.only and name not in options.only:
            continue
        with ignored(Warning):
            rows = measured(
                case, options.method or (), options.quick, options.seed, options.progress
            )
        scenes[name] = {**scenes.get(name, {}), **rows} if options.method else rows
        cli.print_rows(name, table(scenes[name]), options.console)
        report.write_report({"rivals": scenes, **report.environment()}, options.out)
    if options.docs:
        write_page(scenes, options.docs)


def _known(folder: Path) -> dict[str, Any]:
    """Scenes of an earlier run; none without one."""
    file = folder / "report.json"
    if not file.exists():
        return {}
    text = file.read_text(encoding="utf-8")
    # JSON has no infinite errors, those of answers that are missing
    known: dict[str, Any] = json.loads(text, object_hook=_infinite).get("rivals", {})
    return known


def _infinite(values: dict[str, Any]) -> dict[str, Any]:
    """Values by name with infinite ones for null."""
    return {name: np.inf if value is None else value for name, value in values.items()}


if __name__ == "__main__":
    main()
