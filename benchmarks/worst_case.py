"""The worst pressure over the whole box of the parameters, proven, beside what others need for it.

Blocks on a floor in the plane and in space, with two to six parameters; the sphere of the demos.
Each is proven to 1 % and checked by its certificate; random points show that no
value exceeds what is proven. Small blocks are solved as mixed-integer programs too, statuses as
binary variables with big M, by HiGHS in SciPy, up to a minute each.

    python benchmarks/worst_case.py [--out DIR] [--quick] [--seed N] [--only NAME]
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import _demos  # noqa: F401 (before the scenes)
import numpy as np
import sphere_on_block
from parts import cli
from rich.table import Table
from scipy.optimize import Bounds, LinearConstraint, milp

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import block
from hhr_dolfinx.plugins.studies import report
from hhr_dolfinx.plugins.worst_case.affine import candidates_of, contact_of

SECONDS = 60.0
"""Longest time of a proof, and of a mixed-integer program."""
MOST_EXACT = 20
"""Most conditions of a certificate that is proven in rational numbers too."""
POINTS = 20_000
"""Random points of each scene, whose largest value is not beyond what is proven."""
LARGE = 10.0
"""Big M over the largest forces and slacks of a sample of the box."""

PLANE = {"push": 100.0, "pull": 20.0, "shear": 30.0, "out": 10.0}
SPACE = {"push": 40.0, "pull": 30.0, "side": 20.0, "out": 40.0, "shear": 10.0, "slide": 10.0}
"""Parameters, each from 0 to its value in MPa: pressure on the lid, tractions on side and lid."""


def on_a_floor(dim: int, cells: tuple[int, ...], count: int) -> hhr.Scene:
    """A block above a floor, clamped at one end.

    Args:
        dim: 2 or 3.
        cells: cells along each axis.
        count: number of parameters.
    """
    box = dict(list((PLANE if dim == 2 else SPACE).items())[:count])
    end, lid = block.side(0, upper=True), block.side(dim - 1, upper=True)
    up = tuple(float(axis == dim - 1) for axis in range(dim))
    along, across = np.eye(dim)[0], np.eye(dim)[min(1, dim - 2)]
    grow = {name: hhr.Amplitude(slopes={name: 1.0}) for name in box}
    ways = {"pull": (end, up), "out": (end, along), "shear": (lid, along)}
    ways |= {"side": (end, across), "slide": (lid, across)}
    tractions = tuple(
        hhr.Traction(surface, tuple(way), grow[name])
        for name, (surface, way) in ways.items()
        if name in box
    )
    return hhr.Scene(
        name="block_on_a_floor",
        geometry=partial(block.block, lower=(0.0,) * dim, upper=(2.0, 1.0, 1.0)[:dim], cells=cells),
        hypothesis="plane_strain" if dim == 2 else "solid",
        bodies=(hhr.Body(block.SOLID, young=210e3, poisson=0.3),),
        contacts=(
            hhr.Obstacle(block.side(dim - 1, upper=False), tuple(-x for x in up), offset=1e-4),
        ),
        parameters=hhr.ParameterSpace(tuple(box), (0.0,) * count, tuple(box.values())),
        displacements=tuple(hhr.Displacement(block.side(0, upper=False), k) for k in range(dim)),
        loads=(hhr.Pressure(lid, grow["push"]), *tractions),
        outputs=(hhr.LargestPressure("peak", contact=0, unit="MPa"),),
    )


def sphere() -> hhr.Scene:
    """The demo's sphere on a block, with its peak."""
    return replace(
        sphere_on_block.scene(), outputs=(hhr.LargestPressure("peak", contact=0, unit="MPa"),)
    )


def by_integers(model: Any, name: str, seconds: float, gap: float = 0.01) -> tuple[float, float]:
    """The largest value by a mixed-integer program for each candidate, and the time of all.

    NaN if time was over.

    Args:
        model: the condensed model.
        name: of the output.
        seconds: longest time.
        gap: relative difference of the value and its bound at which a program ends.
    """
    contact = contact_of(model)
    outputs = candidates_of(model, name, contact)
    m, count = contact.slopes.shape
    sample = model.solve_many(model.parameters.random(200, seed=1))
    forces = np.array([answer.multipliers for answer in sample])
    ends = np.array([contact.free_slack(t) for t in np.random.default_rng(1).random((200, count))])
    most_force = LARGE * np.abs(forces).max()
    most_slack = LARGE * np.abs(ends).max()
    eye, none, rest = np.eye(m), np.zeros((m, m)), np.zeros((m, count))
    scaled = contact.schur * most_force / most_slack
    free, slopes = contact.free / most_slack, contact.slopes / most_slack
    rules = [
        LinearConstraint(np.hstack([slopes, scaled, -eye, none]), -free, -free),
        LinearConstraint(np.hstack([rest, eye, none, -eye]), -np.inf, 0.0),
        LinearConstraint(np.hstack([rest, none, eye, eye]), -np.inf, 1.0),
    ]
    size = count + 3 * m
    whole = np.concatenate([np.zeros(count + 2 * m), np.ones(m)])
    start, best = time.perf_counter(), -np.inf
    for k in range(len(outputs.constant)):
        left = seconds - (time.perf_counter() - start)
        if left <= 0:
            return np.nan, seconds
        cost = np.concatenate([outputs.slopes[k], outputs.weights[k] * most_force, np.zeros(2 * m)])
        options = {"time_limit": left, "mip_rel_gap": gap}
        box = Bounds(np.zeros(size), np.ones(size))
        found = milp(-cost, constraints=rules, bounds=box, integrality=whole, options=options)
        if not found.success:
            return np.nan, seconds
        best = max(best, outputs.constant[k] - found.fun)
    return best, time.perf_counter() - start


def measured(
    name: str, scene: hhr.Scene, *, integers: bool, points: int, seed: int
) -> dict[str, Any]:
    """A row of the report."""
    model = hhr.condense(scene)
    start = time.process_time()
    found = hhr.worst(model, "peak", 0.01, seconds=SECONDS)
    took = time.process_time() - start
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "proof.npz"
        found.save(path)
        start = time.process_time()
        hhr.check_certificate(path)
        checked = time.process_time() - start
        exactly: dict[str, float] = {}
        if model.conditions <= MOST_EXACT:
            start = time.process_time()
            hhr.check_certificate(path, exact=True)
            exactly["exact_check_cpu_seconds"] = time.process_time() - start
        size = path.stat().st_size
    values = [
        outputs["peak"]
        for outputs in (
            answer.outputs() for answer in model.solve_many(model.parameters.random(points, seed))
        )
    ]
    row = {
        "scene": name,
        "conditions": model.conditions,
        "parameters": len(model.parameters.names),
        "found": found.value,
        "proven": found.proven,
        "difference": found.difference,
        "problems": found.problems,
        "boxes": found.boxes,
        "cpu_seconds": took,
        "check_cpu_seconds": checked,
        **exactly,
        "certificate_bytes": size,
        "largest_of_random": max(values),
        "above": int(np.sum(np.array(values) > found.proven * (1 + 1e-9))),
    }
    if integers:
        row["integers"], row["integers_seconds"] = by_integers(model, "peak", SECONDS)
    return row


def _integers(row: dict[str, Any]) -> str:
    """Value and seconds of the integer programs, if they were tried."""
    if "integers" not in row:
        return ""
    return f"{row['integers']:.5g} in {row['integers_seconds']:.1f} s"


def cases(quick: bool) -> list[tuple[str, Callable[[], hhr.Scene], bool]]:
    """Names, scenes, and whether integer programs are tried."""
    plane = [
        (f"plane, {n} cells, {count} parameters", partial(on_a_floor, 2, (n, n // 2), count), small)
        for n, count, small in ((10, 2, True), (20, 2, True), (40, 2, True), (40, 4, False))
    ]
    space = [
        (f"space, {count} parameters", partial(on_a_floor, 3, (16, 8, 4), count), False)
        for count in (2, 3, 4, 5, 6)
    ]
    return (
        plane[:2] + space[:1] if quick else [*plane, *space, ("sphere on a block", sphere, False)]
    )


def main() -> None:
    """Run all cases and write ``report.json``."""
    parser = cli.demo_parser("worst_case", __doc__)
    parser.add_argument("--only", default="", help="cases whose name has this text")
    options = cli.parse_on_first_rank(parser)
    points = POINTS // 20 if options.quick else POINTS
    rows = [
        measured(name, scene(), integers=small, points=points, seed=options.seed)
        for name, scene, small in cases(options.quick)
        if options.only in name
    ]
    table = Table(
        "case",
        "conditions",
        "proven to",
        "problems",
        "CPU, s",
        "checked, s",
        "in fractions, s",
        "above",
        "HiGHS",
    )
    for row in rows:
        table.add_row(
            row["scene"],
            str(row["conditions"]),
            f"{row['difference']:.2%}",
            str(row["problems"]),
            f"{row['cpu_seconds']:.2f}",
            f"{row['check_cpu_seconds']:.2f}",
            f"{row['exact_check_cpu_seconds']:.1f}" if "exact_check_cpu_seconds" in row else "",
            f"{row['above']} of {points}",
            f"{row['integers']:.5g} in {row['integers_seconds']:.1f} s"
            if "integers" in row
            else "",
        )
    options.console.print(table)
    report.write_report({"scene": "worst_case", "worst": rows, **report.environment()}, options.out)


if __name__ == "__main__":
    main()
