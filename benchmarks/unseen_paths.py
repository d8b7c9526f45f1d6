"""Unseen load paths: errors of condensed models trained on at most 24 paths, and how much faster
they are.

    python benchmarks/unseen_paths.py [--out DIR] [--quick] [--seed N] [--case NAME ...] [--folder
    DIR]

A pellet that yields in a cladding that creeps, as in pellet_cladding_plastic.py. Three cases:

- linear: isotropic hardening of the pellet; the cladding is pressed to a part load at a rate in a
  range of two decades, held for 1e-4 to 1 s, and unloaded in part or completely.
- Chaboche: the same paths, with kinematic hardening of the pellet.
- power: the pellet heats up; its yield stress follows the temperature, a formula of the radius and
  of the power. Power goes up to a level at a rate in a range of two decades, is held for 0.1 to
  1000 s, and goes down.

Each model is trained on 24 paths of a family, ``PathFamily.training``, and compared on 40 others,
points of another Sobol sequence. The error of a path is that of its worst step, relative to the
largest size of the quantity on this path: displacement (L2 norm), contact forces of all nodes,
radial stress and all components of the inelastic strain at all integration points (Euclidean
norms). Times are those of whole marches in turns on one processor, full by the search operator that
is the fastest on the first path. Both have the same steps, whose error in time is not part of the
comparison.
"""

from __future__ import annotations

import dataclasses
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import _demos  # noqa: F401 (before the scenes)
import numpy as np
import pellet_cladding_plastic as pellet
from mpi4py import MPI

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ConvergenceError, TimeStepWarning, UncheckedWarning
from hhr_dolfinx.geometries import pellet_cladding as geometry
from hhr_dolfinx.models.answer import Answer, History
from hhr_dolfinx.models.histories.equilibrium import SEARCHES
from hhr_dolfinx.plugins.inelastic.condense_flow import CorrectionSettings
from hhr_dolfinx.plugins.inelastic.state import state

QUANTITIES = ("displacement", "forces", "sigma_rr", "inelastic_strain")
BARS = {"displacement": 0.01, "forces": 0.05, "sigma_rr": 0.03, "inelastic_strain": 0.03}
"""Errors below which 95 % of the unseen paths should be."""
TRAINING, UNSEEN, QUICK_UNSEEN = 24, 40, 6
TOP = {"P1": 300.0, "power": 1200.0}
"""Largest pressure in MPa, and largest temperature of the axis of the pellet above that of its
surface in K.
"""


def pressed(law: hhr.Law | None = None) -> Callable[..., hhr.Scene]:
    """The scene of the demo, with another law of the pellet."""

    def scene(**mesh: int) -> hhr.Scene:
        base = pellet.scene(**mesh)
        body, cladding = base.bodies
        return dataclasses.replace(
            base, bodies=(dataclasses.replace(body, law=law or body.law), cladding)
        )

    return scene


def heated(**mesh: int) -> hhr.Scene:
    """The pellet heats up, by ``power`` on its axis and not at all on its surface.

    Nothing presses the cladding.
    """
    base = pellet.scene(**mesh)
    warm = "power * (1 - (r / 4.1)**2)"
    soft = hhr.Plasticity(f"120 * (1 - 6e-4 * {warm})", hardening=4e3)
    body, cladding = base.bodies
    return dataclasses.replace(
        base,
        name="pellet_cladding_power",
        bodies=(dataclasses.replace(body, law=soft), cladding),
        parameters=hhr.ParameterSpace(("power", "gap"), (0.0, 4e-3), (TOP["power"], 16e-3)),
        loads=(
            hhr.ThermalExpansion(geometry.PELLET, 1e-5, "power", lambda x: 1 - (x[0] / 4.1) ** 2),
        ),
    )


@dataclasses.dataclass(frozen=True)
class Case:
    """A scene and its paths.

    Attributes:
        scene: makes the scene of a mesh.
        load: parameter that goes up and down.
        seconds: time of the slowest path to the largest load; the fastest one takes a hundredth.
        hold: decades of the shortest and of the longest hold in s.
        gaps: smallest and largest gap in um.
        least: smallest part of the largest load.
        faster: factor by which a condensed march should be faster.
        cells: size of the mesh, as a multiple of the coarsest one.
        modes: tolerance of modes and cubature.
    """

    scene: Callable[..., hhr.Scene]
    load: str
    seconds: float
    hold: tuple[float, float]
    gaps: tuple[float, float]
    least: float
    faster: float
    cells: int
    modes: float

    def mesh(self, quick: bool) -> dict[str, int]:
        """Cells along the sides of pellet and cladding."""
        names = ("radial_cells", "axial_cells", "cladding_radial_cells", "cladding_axial_cells")
        return {
            name: count * (1 if quick else self.cells)
            for name, count in zip(names, (12, 20, 2, 15), strict=True)
        }


def family(space: hhr.ParameterSpace, case: Case) -> hhr.PathFamily:
    """Up to a part of the largest load, a hold whose steps grow like decades, and down again."""
    load = case.load
    names = ("gap", "top", "log_rate", "log_hold", "back")
    narrow, wide = case.gaps
    short, long = case.hold
    least = case.least
    own = hhr.ParameterSpace(names, (narrow, least, 0.0, short, 0.0), (wide, 1.0, 2.0, long, 1.0))
    start = {load: 0.0, "h1": pellet.HEIGHT, "gap": "gap * 1e-3"}
    start = {name: start[name] for name in space.names}
    top = f"{TOP[load]} * top"
    most = f"{case.seconds} * 10**-log_rate"
    holds = tuple(hhr.Leg({}, f"{share} * 10**log_hold", 4) for share in (0.01, 0.09, 0.9))
    up = hhr.Leg({load: top}, f"top * {most}", "20 * top")
    down = hhr.Leg({load: f"{top} * (1 - back)"}, f"top * back * {most}", "20 * top * back")
    return hhr.PathFamily(f"{load} up, held, down", space, own, start, (up, *holds, down))


PRESSED = {
    "load": "P1",
    "seconds": 1.0,
    "hold": (-4.0, 0.0),
    "gaps": (5.0, 15.0),
    "least": 0.4,
    "faster": 50.0,
}
POWER = {
    "load": "power",
    "seconds": 100.0,
    "hold": (-1.0, 3.0),
    "gaps": (4.0, 10.0),
    "least": 0.5,
    "faster": 30.0,
    "cells": 4,
}
CASES: dict[str, Case] = {
    "linear": Case(pressed(), cells=4, modes=2e-3, **PRESSED),
    "Chaboche": Case(
        pressed(hhr.Chaboche(80.0, ((2e4, 200.0), (1e3, 0.0)))), cells=5, modes=3e-3, **PRESSED
    ),
    "power": Case(heated, modes=1e-3, **POWER),
}


def inelastic(answer: Answer) -> np.ndarray:
    """Inelastic strain at all integration points, all components."""
    known = state(answer).state.inelastic
    fields: Any = answer.fields
    if fields.exact:
        return known.ravel()
    found = np.zeros((fields.flow.places, known.shape[1]))
    found[fields.flow.flowed] = fields.flow.plastic.everywhere(known.ravel()).reshape(
        -1, known.shape[1]
    )
    return found.ravel()


def quantities(answer: Answer) -> tuple[np.ndarray, ...]:
    """What is compared, in the order of ``QUANTITIES``."""
    return answer.displacement(), answer.forces(), answer.stress()[:, 0], inelastic(answer)


def worst_steps(full: hhr.FullOrderModel, found: History, exact: History) -> np.ndarray:
    """Largest error of each quantity over the steps of a path, relative to its largest size on the
    path, (4,).
    """
    mass = full.problem.mass
    wrong, sizes = np.zeros(len(QUANTITIES)), np.zeros(len(QUANTITIES))
    for here, there in zip(found.answers, exact.answers, strict=True):
        known = quantities(there)
        off = [one - other for one, other in zip(quantities(here), known, strict=True)]
        for largest, values in ((wrong, off), (sizes, known)):
            norms = [np.sqrt(values[0] @ (mass @ values[0])), *map(np.linalg.norm, values[1:])]
            np.maximum(largest, norms, out=largest)
    return np.divide(wrong, sizes, out=np.where(wrong > 0, np.inf, 0.0), where=sizes > 0)


def marched(model: Any, path: Any, settings: hhr.MarchSettings) -> tuple[History | None, float]:
    """A history, None if it does not converge, and its seconds on the processor."""
    start = time.process_time()
    try:
        history = model.march(path, settings)
    except ConvergenceError:
        history = None
    return history, time.process_time() - start


def compared(
    full: hhr.FullOrderModel, model: Any, paths: list[Any]
) -> tuple[np.ndarray, np.ndarray]:
    """Errors of each path, (n, 4), and seconds of the fastest full march and of a condensed one,
    (n, 2).
    """
    ways = {
        search: hhr.MarchSettings(
            search, iterations=200 if search == "elastic" else 60, outside="ignore"
        )
        for search in SEARCHES
    }
    for one in (full, model):  # compilation and reading at the first step belong to no path
        marched(one, paths[0][:3], hhr.MarchSettings(outside="ignore"))
    errors, times = [], []
    for path in paths:
        taken, small, exact = {}, [], None
        for search, settings in ways.items():
            found, seconds = marched(model, path, hhr.MarchSettings(outside="ignore"))
            small.append(seconds)
            known, seconds = marched(full, path, settings)
            if known is not None:
                taken[search], exact = seconds, exact or known
        errors.append(
            worst_steps(full, found, exact) if found and exact else np.full(len(QUANTITIES), np.inf)
        )
        times.append((min(taken.values(), default=np.nan), float(np.median(small))))
        if len(times) == 1:
            fastest = min(taken, key=taken.__getitem__)
            ways = {fastest: ways[fastest]}
        print(".", end="\n" if len(times) == len(paths) else "", file=sys.stderr, flush=True)
    return np.array(errors), np.array(times)


def measured(name: str, quick: bool, folder: Path | None, seed: int) -> dict[str, Any]:
    """Results of a case."""
    case = CASES[name]
    scene = case.scene(**case.mesh(quick))
    paths = family(scene.parameters, case)
    start = time.perf_counter()
    training = hhr.train(
        scene,
        paths.training(
            TRAINING, least_part=1.0
        ),  # the level of the load is a parameter of the family
        held_out=[],
        comm=MPI.COMM_SELF,
        folder=None if folder is None else folder / f"{name}{'_quick' * quick}",
    )
    solved = time.perf_counter()
    model = training.condense(
        CorrectionSettings(modes=case.modes, cubature=case.modes, stability=0.1, attempts=1)
    )
    built = time.perf_counter()
    unseen = paths.paths(hhr.Sobol(QUICK_UNSEEN if quick else UNSEEN, seed=seed))
    errors, times = compared(training.full_order, model, unseen)
    ratios = times[:, 0] / times[:, 1]
    return {
        **{
            quantity: {
                "p95": float(np.quantile(column, 0.95)),
                "max": float(column.max()),
                "median": float(np.median(column)),
            }
            for quantity, column in zip(QUANTITIES, errors.T, strict=True)
        },
        "speedup": float(np.median(ratios)),
        "least_speedup": float(ratios.min()),
        "training": TRAINING,
        "unseen": len(unseen),
        "full_seconds": float(np.median(times[:, 0])),
        "condensed_seconds": float(np.median(times[:, 1])),
        "training_seconds": solved - start,
        "condensation_seconds": built - solved,
        "dofs": int(training.full_order.problem.free.size),
        "modes": len(model.flow.per_mode),
        "points": int(model.flow.points.size),
    }


def show(name: str, found: dict[str, Any]) -> None:
    """Print the results of a case beside the bars."""
    print(
        f"{name}: trained on {found['training']} paths, compared on {found['unseen']}; "
        f"{found['dofs']} dofs, {found['modes']} modes, {found['points']} points"
    )
    for quantity, bar in BARS.items():
        p95, largest, median = (100 * found[quantity][key] for key in ("p95", "max", "median"))
        verdict = "" if p95 <= 100 * bar else ", MISSED"
        print(
            f"  {quantity:17} p95 {p95:5.2f} %  max {largest:5.2f} %  median {median:5.2f} %  "
            f"(bar {bar:.0%}{verdict})"
        )
    print(
        f"  a march takes {1e3 * found['condensed_seconds']:.0f} ms, in full "
        f"{found['full_seconds']:.2f} s: {found['speedup']:.0f} times faster, "
        f"{found['least_speedup']:.0f} at least (bar {CASES[name].faster:.0f}); training "
        f"{found['training_seconds']:.0f} s, condensation {found['condensation_seconds']:.0f} s"
    )


def main() -> None:
    """Measure the cases and print a table."""
    from parts import cli

    from hhr_dolfinx.plugins.studies import report

    parser = cli.demo_parser("unseen_paths", __doc__)
    # that of the figures in docs/flow.md
    parser.set_defaults(seed=11)
    parser.add_argument(
        "--case", action="append", choices=CASES, help="this case alone; may be given again"
    )
    parser.add_argument("--folder", type=Path, help="folder that keeps full histories")
    options = cli.parse_on_first_rank(parser)
    for kind in (TimeStepWarning, UncheckedWarning):  # unseen paths are compared here
        warnings.simplefilter("ignore", kind)
    cases = {}
    for name in options.case or CASES:
        cases[name] = measured(name, options.quick, options.folder, options.seed)
        show(name, cases[name])
        written = {"scene": "unseen_paths", "seed": options.seed, "paths": cases}
        report.write_report({**written, **report.environment()}, options.out)


if __name__ == "__main__":
    main()
