"""Laws of bodies at single points: closed forms, tangents, failures and false answers of random
steps, and times.

    python benchmarks/laws.py [--points 10000] [--out DIR] [--quick] [--seed N]

Two random steps, one from the state after the other, for each size of strain from 1e-4 to 1e-1, and
for laws with rates each of three durations. A *failure* is a point without an answer; a *false
answer* is a point whose stress is more than 1e-6 of the largest off the one that Newton's method
finds with numpy alone, from the start of the law, until it does not move any more; or is no number,
or whose cumulated strain falls.
"""

from __future__ import annotations

import time
from typing import Any

import _demos  # noqa: F401 (before the parts of demos)
import numpy as np
from points import LAWS, POISSON, YOUNG, Point, at_rest

import hhr_dolfinx as hhr
from hhr_dolfinx.plugins.inelastic.law import LawNumbers, LawProgram, program_of
from hhr_dolfinx.plugins.inelastic.local_solver import (
    AFTER,
    LOCAL,
    SOLVED,
    START,
    TRIAL,
    solve_points,
)
from hhr_dolfinx.plugins.ufl_programs.machine import evaluated

SIZES = (1e-4, 1e-3, 1e-2, 1e-1)
"""Sizes of strain of each component."""
PACES = (1e-3, 1.0, 1e3)
OFF = 1e-6


def stepped(
    program: LawProgram, given: LawNumbers, strain: np.ndarray, old: np.ndarray, dt: float
) -> tuple[Any, ...]:
    """Stress, (c, n), memory, (k, n), tangents, (c, c, n), and results of a step, which raises
    nothing.
    """
    components, points = strain.shape
    stress, new = np.empty_like(strain), np.empty_like(old)
    tangents, result = np.empty((components, components, points)), np.zeros(points, dtype=np.int64)
    solve_points(
        program.code, 0, 0, points, strain, old, dt, *given.numbers, stress, new, tangents, result
    )
    return stress, new, tangents, result


def false_answers(
    program: LawProgram,
    given: LawNumbers,
    strain: np.ndarray,
    old: np.ndarray,
    dt: float,
    found: tuple[Any, ...],
) -> int:
    """Points whose stress is not that of the root nearest to it, by Newton's method with numpy from
    the law's start.
    """
    count = len(program.kinds)
    if not count:
        return 0
    points = strain.shape[1]
    constants = np.broadcast_to(given.constants, (len(given.constants), points))
    rest = np.vstack([old, np.full((1, points), dt), constants])

    def inputs(unknown: np.ndarray) -> np.ndarray:
        return np.vstack([strain, unknown, rest])

    nothing = np.zeros((count, points))
    trial = evaluated(program.program, inputs(nothing), TRIAL)
    active = (trial[0] > 0 if len(trial) else np.ones(points, dtype=bool)) & (found[3] == SOLVED)
    unknown = evaluated(program.program, inputs(nothing), TRIAL, START)
    with np.errstate(all="ignore"):
        for _ in range(200):
            values = evaluated(program.program, inputs(unknown), TRIAL, START, LOCAL)
            slopes = values[count:].reshape(count, count, -1).transpose(2, 0, 1)
            slopes[~np.isfinite(slopes).all(axis=(1, 2))] = np.eye(count)
            step = np.linalg.solve(slopes, values[:count].T[..., None])[..., 0].T
            unknown = np.where(active & np.isfinite(step).all(axis=0), unknown - step, unknown)
    there = evaluated(program.program, inputs(unknown), TRIAL, START, AFTER)[: program.strains]
    off = np.abs(there - found[0]).max(axis=0) > OFF * np.abs(found[0]).max()
    return int((off & active & np.isfinite(there).all(axis=0)).sum())


def tangent_error(
    program: LawProgram,
    given: LawNumbers,
    strain: np.ndarray,
    old: np.ndarray,
    dt: float,
    found: tuple[Any, ...],
) -> float:
    """99 % of the relative differences of tangents from central differences, at 300 points."""
    few = np.flatnonzero(found[3] == SOLVED)[:300]
    if not few.size:
        return 0.0
    change = 1e-6 * np.abs(strain).max()
    slopes = np.empty((program.strains, program.strains, few.size))
    smooth = np.ones(few.size, dtype=bool)
    for place in range(program.strains):
        ends = []
        for way in (-1, 1):
            there = strain[:, few].copy()
            there[place] += way * change
            ends.append(stepped(program, given, there, np.ascontiguousarray(old[:, few]), dt))
        slopes[:, place] = (ends[1][0] - ends[0][0]) / (2 * change)
        smooth &= (ends[0][3] == SOLVED) & (ends[1][3] == SOLVED)
    wrong = np.abs(slopes - found[2][:, :, few]).max(axis=(0, 1)) / np.abs(slopes).max(axis=(0, 1))
    return float(np.quantile(wrong[smooth], 0.99)) if smooth.any() else 0.0


def measured(law: hhr.Law, points: int, seed: int) -> dict[str, Any]:
    """Results of a law."""
    components = 6
    program = program_of(law, components)
    given, random = program.given(YOUNG, POISSON), np.random.default_rng(seed)
    report: dict[str, Any] = {
        "failures": 0,
        "false_answers": 0,
        "tangent": 0.0,
        "ms_per_10000": 0.0,
    }
    rest = np.vstack([part.reshape(points, -1).T for part in at_rest(program, points)])
    for size in SIZES:
        for dt in PACES if program.rated else (1.0,):
            steps = np.cumsum(size * random.normal(size=(2, components, points)), axis=0)
            first = stepped(program, given, steps[0], rest, dt)
            first[1][:, first[3] != SOLVED] = 0.0  # at rest
            start = time.perf_counter()
            second = stepped(program, given, steps[1], first[1], dt)
            report["ms_per_10000"] = max(
                report["ms_per_10000"], 1e7 * (time.perf_counter() - start) / points
            )
            for strain, old, found in ((steps[0], rest, first), (steps[1], first[1], second)):
                solved = found[3] == SOLVED
                report["failures"] += int((~solved).sum())
                grown = found[1][components] >= old[components]
                report["false_answers"] += int(
                    (solved & ~(grown & np.isfinite(found[0]).all(axis=0))).sum()
                )
                report["false_answers"] += false_answers(program, given, strain, old, dt, found)
            error = tangent_error(program, given, steps[1], first[1], dt, second)
            report["tangent"] = max(report["tangent"], error)
    if program.reason:
        report["named"] = program.reason
    return report


def closed_forms() -> dict[str, float]:
    """Relative errors of laws where their answer is known."""

    def pulled(name: str, strain: float, dt: float = 1.0, steps: int = 1) -> tuple[Point, float]:
        point = Point(LAWS[name])
        for share in np.linspace(0, 1, steps + 1)[1:]:
            stress = point.step({0: strain * share}, dt)[0]
        return point, stress

    found = {}
    curves = {
        "linear": lambda p: 250 + 2000 * p,
        "perfect": lambda p: 250.0,
        "Voce": lambda p: 250 + 200 * (1 - np.exp(-20 * p)),
        "table": lambda p: float(np.interp(p, [0, 0.01, 0.1, 1], [250, 300, 350, 360])),
    }
    for name, curve in curves.items():
        point, stress = pulled(name, 0.03)
        found[name] = abs(stress / curve(point.state.inelastic[0, 0]) - 1)
    point, stress = pulled("Armstrong-Frederick", 0.02, steps=4000)
    found["Armstrong-Frederick"] = abs(
        stress / (200 + 100 * (1 - np.exp(-600 * point.state.inelastic[0, 0]))) - 1
    )
    creep = {
        "Norton": 1000 * (300 / 400) ** 8,
        "Arrhenius": 1000 * (3 / 4) ** 8 * np.exp(-2e4 * (1 / 900 - 1 / 950)),
        "primary": (300 / 400) ** 5 * 1000**0.3,
    }
    for name, strain in creep.items():
        point = Point(LAWS[name])
        for _ in range(10):
            point.step({}, 100.0, {0: 300.0})
        found[name] = abs(point.state.inelastic[0, 0] / strain - 1)
    point = Point(hhr.DruckerPrager(100.0, 0.3, 0.1))
    point.step({}, stresses=dict.fromkeys(range(3), -50.0))
    stress = point.step({0: -0.01}, stresses={1: -50.0, 2: -50.0})[0]
    found["Drucker-Prager"] = abs((-50 - stress) / ((100 + 15) / (1 / np.sqrt(3) - 0.1)) - 1)
    stress = Point(hhr.Hill(250.0, 0.0, 0.6, 0.4, 0.5, 1.5, 1.6, 1.4)).step({0: 0.01})[0]
    found["Hill"] = abs(stress / (250 / np.sqrt(0.9)) - 1)
    return {name: float(error) for name, error in found.items()}


def main() -> None:
    """Print a line for each law, and write ``report.json``."""
    from parts import cli

    from hhr_dolfinx.plugins.studies import report

    parser = cli.demo_parser("laws", __doc__)
    parser.add_argument(
        "--points", type=int, default=None, help="points of each random step (10000, quick 200)"
    )
    options = cli.parse_on_first_rank(parser)
    points = options.points or (200 if options.quick else 10_000)
    known, laws = closed_forms(), {}
    for name, law in LAWS.items():
        laws[name] = {"closed_form": known.get(name), **measured(law, points, options.seed)}
        shown = (
            f"{key} {value:.2g}" if isinstance(value, float) else f"{key} {value}"
            for key, value in laws[name].items()
        )
        options.console.print(f"{name}: {', '.join(shown)}", highlight=False)
    scene = {"scene": "laws", "seed": options.seed, "points": points}
    report.write_report({**scene, "laws": laws, **report.environment()}, options.out)


if __name__ == "__main__":
    main()
