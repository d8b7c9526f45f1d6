"""Heat through contacts, condensed, beside the coupled full order; a fuel rod over its histories.

Three scenes: blocks in the plane, a fuel rod whose pellet the gap alone cools, blocks in space. The
full order solves heat with a new factor of its conductivity and the conductances, and displacement
with the factor of K that it keeps, one after the other until neither changes. Both answer the same
points in turns, and march through a transient of the same implicit steps. A thousand histories of
forty steps of the rod are then marched through, steady and transient.

    python benchmarks/heat_through_contacts.py [--out DIR] [--quick] [--seed N]
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import _demos  # noqa: F401 (before the scenes)
import numpy as np
from mpi4py import MPI
from parts import cli
from rich.table import Table
from scipy.sparse import csc_matrix, diags
from scipy.sparse.linalg import splu

import hhr_dolfinx as hhr
from hhr_dolfinx.contact.active_set import SchurEqualities, active_set
from hhr_dolfinx.geometries import pellet_cladding as rod
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side
from hhr_dolfinx.plugins.contact_heat.conduction import heat_system
from hhr_dolfinx.plugins.studies import report

ALIKE = 1e-8
"""Forces and heat flows of both over their largest ones must be this close."""
FASTER = 100.0
"""At least so many times as fast as the coupled full order."""
HISTORIES, STEPS, PATIENCE = 1000, 40, 60.0
"""Histories of the rod, their steps, and the seconds that all of them may take."""
SMALL_DIFFERENCE = 5e-3
"""Transients of few modes differ from the full order by so much of the largest value at most."""
START = 20.0
"""Temperature at the start of transients."""
LENGTHS = {"blocks in the plane": 1e-3, "fuel rod": 1.0, "blocks in space": 1e-3}
"""Length of the steps of the transients: bodies take some twenty to warm."""
SETTLED = 1e-12
"""Change over the size at which the full order ends."""


def blocks(dimension: int, cells: int) -> tuple[hhr.Scene, hhr.Heat]:
    """A warm block with a bowed face is pushed on a cold one."""
    last = dimension - 1
    n = (cells,) * dimension
    low, up = np.zeros(dimension), np.eye(dimension)[last]

    def warp(points: np.ndarray, tag: int) -> np.ndarray:
        bow = 0.01 * ((points[:, :last] - 0.5) ** 2).sum(axis=1) * (2 - points[:, last])
        return points + np.outer(bow * (tag == SECOND), up)

    top = side(SECOND, last, True)
    scene = hhr.Scene(
        name="blocks",
        geometry=lambda comm: two_blocks.two_blocks(
            comm, warp=warp, first=(low, low + 1, n), second=(up, up + 1, n)
        ),
        hypothesis="plane_strain" if dimension == 2 else "solid",
        bodies=(hhr.Body(FIRST, 200e3, 0.3), hhr.Body(SECOND, 70e3, 0.33)),
        contacts=(hhr.NodeToNode(side(FIRST, last, True), side(SECOND, last, False), tuple(up)),),
        parameters=hhr.ParameterSpace(("push", "T"), (0.001, 20.0), (0.005, 150.0)),
        displacements=(
            *hhr.Displacement.clamp(side(FIRST, last, False), dimension),
            *(hhr.Displacement(top, axis) for axis in range(last)),
            hhr.Displacement(top, last, hhr.Amplitude(slopes={"push": -1.0})),
        ),
        outputs=(hhr.LargestPressure("peak", 0),),
    )
    heat = hhr.Heat(
        conductivity={FIRST: 50.0, SECOND: 20.0},
        conductance={0: "12 * (p / 100) ** 0.95 + 0.15 / (g + 2e-3)"},
        expansion={FIRST: 1.2e-5, SECOND: 2.3e-5},
        capacity={FIRST: 3.6, SECOND: 2.4},
        temperatures=[
            hhr.FixedTemperature(side(FIRST, last, False), 0.0),
            hhr.FixedTemperature(top, "T"),
        ],
    )
    return scene, heat


def fuel_rod(**mesh: Any) -> tuple[hhr.Scene, hhr.Heat]:
    """Pellet and cladding in mm, MPa, mW and K, over the linear power q in kW/m, the pressure of
    the coolant and the gap as built: the gas between them conducts, and more where they press.
    """
    held = (rod.PELLET_BOTTOM, rod.CLADDING_BOTTOM, rod.CLADDING_TOP)
    scene = hhr.Scene(
        name="fuel_rod_heat",
        geometry=lambda comm: rod.pellet_cladding(comm, gap=0.0, **mesh),
        hypothesis="axisymmetric",
        bodies=(hhr.Body(rod.PELLET, 185e3, 0.3), hhr.Body(rod.CLADDING, 85e3, 0.35)),
        contacts=(hhr.NodeToNode(rod.PELLET_SIDE, rod.CLADDING_INNER, normal=(1.0, 0.0)),),
        parameters=hhr.ParameterSpace(("q", "P", "gap"), (5.0, 5.0, 0.01), (40.0, 16.0, 0.05)),
        displacements=(
            hhr.Displacement(rod.PELLET_AXIS, component=0),
            *(hhr.Displacement(tag, component=1) for tag in held),
        ),
        loads=(hhr.Pressure(rod.CLADDING_OUTER, "P"),),
        openings=(hhr.Opening(0, hhr.Amplitude(slopes={"gap": 1.0})),),
        outputs=(hhr.LargestPressure("peak", 0),),
    )
    heat = hhr.Heat(
        conductivity={rod.PELLET: 3.0, rod.CLADDING: 17.0},
        conductance={0: "0.25 / (g + 5e-3) + 0.4 * p / (p + 10)"},
        expansion={rod.PELLET: 1e-5, rod.CLADDING: 6e-6},
        reference=20.0,
        capacity={rod.PELLET: 3.3, rod.CLADDING: 2.1},
        supplies=[
            hhr.HeatSource(rod.PELLET, "1e3 * q / (pi * 4.1**2)"),
            hhr.Convection(rod.CLADDING_OUTER, 30.0, 300.0),
        ],
    )
    return scene, heat


class CoupledFull:
    """Coupled full order: heat and displacement one after the other."""

    def __init__(self, scene: hhr.Scene, heat: hhr.Heat, model: Any):
        import warnings

        with warnings.catch_warnings():  # of parameters of heat, which this model does not know
            warnings.simplefilter("ignore")
            self.full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
        self.problem = self.full.problem
        self.system = heat_system(self.full, heat, list(heat.conductance), transient=True)
        self.model = model
        self.areas = self.problem.contact_areas
        free = self.problem.free
        self.factor = splu(csc_matrix(self.problem.stiffness[free][:, free]))
        self.rows = self.problem.contact[:, free]
        self.schur = self.rows @ self.factor.solve(self.rows.T.toarray())
        self.equalities = SchurEqualities.symmetric(self.schur)

    def march(self, points: np.ndarray, times: np.ndarray, start: float) -> list[np.ndarray]:
        """Forces, (m,), heat flows, (m,), and temperatures, (n,), after each implicit step."""
        temperature = np.full(len(self.system.lifted), start)
        forces = np.zeros(len(self.areas))
        found = []
        for point, length in zip(points, np.diff(times, prepend=0.0), strict=True):
            stored = self.system.capacity / length
            found.append(self.solve(point, forces, stored, stored @ temperature))
            forces, _, temperature = found[-1]
        return found

    def solve(
        self,
        point: np.ndarray,
        forces: np.ndarray | None = None,
        stored: Any = 0.0,
        before: Any = 0.0,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Forces and heat flows, (m,) each, and temperatures, (n,); of a step with the heat that
        bodies store per rise of the temperature over its length, and that which they had.
        """
        supplies = np.array([one.value(point) for one in self.system.amplitudes])
        theta = self.problem.amplitudes(point)
        forces = np.zeros(len(self.areas)) if forces is None else forces
        slack = self.problem.gaps @ theta
        for count in range(500):
            temperature, flows = self._heated(point, supplies, (forces, slack), (stored, before))
            loads = self.problem.loads @ theta
            loads = loads + self.system.expansion @ temperature + self.system.at_rest
            moved = self.factor.solve(loads[self.problem.free])
            gaps = self.problem.gaps @ theta - self.rows @ moved
            found = active_set(self.equalities, gaps, forces > 0)
            opened = gaps + self.schur @ found.forces
            change = np.abs(found.forces - forces).max() / max(found.forces.max(), 1e-300)
            change = max(change, np.abs(opened - slack).max() / np.abs(gaps).max())
            weight = 1.0 if count < 8 else 0.5  # fewer steps first, then those that settle
            forces = forces + weight * (found.forces - forces)
            slack = slack + weight * (opened - slack)
            if change <= SETTLED:
                return found.forces, flows, temperature
        raise RuntimeError("the coupled full order does not settle")

    def _heated(
        self,
        point: np.ndarray,
        supplies: np.ndarray,
        contact: tuple[np.ndarray, np.ndarray],
        step: tuple[Any, Any],
    ) -> tuple[np.ndarray, np.ndarray]:
        pressed, opened = (np.maximum(part, 0.0) for part in contact)
        pressed = pressed / self.areas
        stored, before = step
        h = self.areas * self.model._conducted(point, pressed, opened)[0]
        system = self.system
        matrix = csc_matrix(system.stiffness + system.jumps.T @ diags(h) @ system.jumps + stored)
        temperature = system.lifted @ supplies
        right = system.loads @ supplies + before - matrix @ temperature
        free = np.setdiff1d(np.arange(len(temperature)), system.fixed)
        temperature[free] += splu(matrix[free][:, free]).solve(right[free])
        return temperature, h * (system.jumps @ temperature)


def compared(name: str, scene: hhr.Scene, heat: hhr.Heat, points: int, seed: int) -> dict[str, Any]:
    """Differences and times of both, point by point in turns."""
    begin = time.perf_counter()
    model = hhr.condense_heat(scene, heat)
    offline = time.perf_counter() - begin
    full = CoupledFull(scene, heat, model)
    off = {"forces": 0.0, "heat": 0.0}
    times: dict[str, list[float]] = {"condensed": [], "full": []}
    for point in model.parameters.random(points, seed):
        begin = time.perf_counter()
        answer = model.solve(point, both=False)
        times["condensed"].append(time.perf_counter() - begin)
        begin = time.perf_counter()
        forces, flows, _ = full.solve(point)
        times["full"].append(time.perf_counter() - begin)
        sizes = max(forces.max(), 1e-300), np.abs(flows).max()
        off["forces"] = max(off["forces"], np.abs(answer.forces() - forces).max() / sizes[0])
        off["heat"] = max(off["heat"], np.abs(answer.heat - flows).max() / sizes[1])
    middle = {kind: float(np.median(values)) for kind, values in times.items()}
    return {
        "scene": name,
        "dofs": int(full.problem.free.sum()) + len(full.system.lifted),
        "conditions": model.conditions,
        "offline_s": offline,
        "off": off,
        "ms": {kind: 1e3 * value for kind, value in middle.items()},
        "faster": middle["full"] / middle["condensed"],
        "met": max(off.values()) <= ALIKE and middle["full"] >= FASTER * middle["condensed"],
    }


def in_time(
    name: str, scene: hhr.Scene, heat: hhr.Heat, path: np.ndarray, length: float
) -> dict[str, Any]:
    """Differences and times of a transient, all of its steps by one and by the other, twice."""
    begin = time.perf_counter()
    model = hhr.condense_transient_heat(scene, heat, shortest=length)
    offline = time.perf_counter() - begin
    full = CoupledFull(scene, heat, model)
    times = length * np.arange(1, len(path) + 1)
    taken: dict[str, list[float]] = {"condensed": [], "full": []}
    for _ in range(2):
        begin = time.perf_counter()
        answers = model.march(path, times, START)
        taken["condensed"].append((time.perf_counter() - begin) / len(path))
        begin = time.perf_counter()
        expected = full.march(path, times, START)
        taken["full"].append((time.perf_counter() - begin) / len(path))
    largest = [max(np.abs(one[part]).max() for one in expected) for part in (0, 1)]
    rise = max(np.abs(one[2] - START).max() for one in expected)
    pairs = list(zip(answers, expected, strict=True))
    off = {
        "forces": max(np.abs(one.forces() - other[0]).max() for one, other in pairs) / largest[0],
        "heat": max(np.abs(one.heat - other[1]).max() for one, other in pairs) / largest[1],
        "temperature": max(np.abs(one.temperature() - other[2]).max() for one, other in pairs)
        / rise,
    }
    quickest = {kind: min(values) for kind, values in taken.items()}
    faster = quickest["full"] / quickest["condensed"]
    return {
        "scene": name,
        "steps": len(path),
        "modes": len(model.rates),
        "offline_s": offline,
        "off": off,
        "ms": {kind: 1e3 * value for kind, value in quickest.items()},
        "faster": faster,
        "met": max(off.values()) <= SMALL_DIFFERENCE and faster >= FASTER,
    }


def rising(model: Any) -> np.ndarray:
    """A path of parameters from the lower end of the box to the upper one and back, (steps, P)."""
    low, high = np.array(model.parameters.lower), np.array(model.parameters.upper)
    part = np.interp(np.arange(STEPS), (0, STEPS // 4, STEPS - 10, STEPS - 1), (0, 1, 1, 0))
    return low + part[:, None] * (high - low)


def marched(model: Any, histories: int, seed: int, *times: Any) -> dict[str, Any]:
    """Histories of the rod: power up, held and down, each with a pressure and a gap of its own."""
    rng = np.random.default_rng(seed)
    low, high = np.array(model.parameters.lower), np.array(model.parameters.upper)
    begin = time.perf_counter()
    hottest = 0.0
    for _ in range(histories):
        peak, pressure, gap = low + rng.uniform(size=3) * (high - low)
        power = np.interp(np.arange(STEPS), (0, STEPS // 2, STEPS - 10, STEPS - 1),
                          (low[0], peak, peak, low[0]))  # fmt: skip
        path = np.column_stack([power, np.full(STEPS, pressure), np.full(STEPS, gap)])
        answers = model.march(path, *times)
        hottest = max(hottest, float(answers[STEPS // 2].temperature().max()))
    seconds = time.perf_counter() - begin
    limit = PATIENCE * histories / HISTORIES
    return {"histories": histories, "seconds": seconds, "hottest": hottest, "met": seconds <= limit}


def table(
    title: str, own: dict[str, Callable[[dict[str, Any]], str]], rows: list[dict[str, Any]]
) -> Table:
    """Rows with columns of their own, differences and times."""
    columns = {
        "scene": lambda row: row["scene"],
        **own,
        "offline": lambda row: f"{row['offline_s']:.1f} s",
        "forces off": lambda row: f"{row['off']['forces']:.0e}",
        "ms": lambda row: f"{row['ms']['condensed']:.2f}",
        "full, ms": lambda row: f"{row['ms']['full']:.0f}",
        "x": lambda row: f"{row['faster']:.0f}",
    }
    found = Table(*columns, title=title)
    for row in rows:
        found.add_row(*(column(row) for column in columns.values()))
    return found


def main() -> None:
    """Compare, march, write and print."""
    options = cli.parse(cli.demo_parser("heat_through_contacts", __doc__))
    quick = options.quick
    mesh = {"radial_cells": 12, "axial_cells": 20, "cladding_radial_cells": 2} if quick else {}
    scenes = {
        "blocks in the plane": blocks(2, 12 if quick else 64),
        "fuel rod": fuel_rod(**mesh),
        "blocks in space": blocks(3, 4 if quick else 12),
    }
    points = 3 if quick else 10
    rows = [
        compared(name, *scene, points=points, seed=options.seed) for name, scene in scenes.items()
    ]
    transients = [
        in_time(name, *scene, path=rising(scene[0]), length=LENGTHS[name])
        for name, scene in scenes.items()
    ]
    told = marched(hhr.condense_heat(*scenes["fuel rod"]), 20 if quick else HISTORIES, options.seed)
    seconds = np.arange(1.0, STEPS + 1)
    later = marched(
        hhr.condense_transient_heat(*scenes["fuel rod"], shortest=LENGTHS["fuel rod"]),
        20 if quick else HISTORIES,
        options.seed,
        seconds,
        START,
    )
    steady = {
        "dofs": lambda row: str(row["dofs"]),
        "m": lambda row: str(row["conditions"]),
        "heat off": lambda row: f"{row['off']['heat']:.0e}",
    }
    in_steps = {
        "modes": lambda row: str(row["modes"]),
        "T off": lambda row: f"{row['off']['temperature']:.0e}",
    }
    title = "Heat through contacts, condensed, beside the coupled full order"
    options.console.print(table(title, steady, rows))
    options.console.print(table(f"Transients of {STEPS} steps, per step", in_steps, transients))
    for kind, many in (("steady", told), ("transient", later)):
        options.console.print(
            f"{many['histories']} {kind} histories of {STEPS} steps of the rod: "
            f"{many['seconds']:.1f} s, hottest {many['hottest']:.0f} degrees"
        )
    known = {"scene": "heat_through_contacts", **report.environment()}
    report.write_report(
        {
            **known,
            "heat": rows,
            "transients": transients,
            "histories": told,
            "transient_histories": later,
        },
        options.out,
    )


if __name__ == "__main__":
    main()
