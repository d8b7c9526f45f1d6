"""Estimated errors of time steps over true ones: inelastic bodies that are bent, pressed, held and
cycled.

Each scene is solved along a path in few steps with ``MarchSettings(time_error=True)``, and along
the same path with each step in many parts, which stands for the truth. Errors are norms of the
difference of stress, displacement or contact forces over the largest norm in the history; the
largest value of a history is compared. An answer states its estimates over the largest norm so far,
which is more where bodies begin to touch.

What to see: the ratio of estimate to truth is a little above 1 for every law, of which nothing but
its steps is used: with rates or without, built in or written by a user. ``cost`` is the time of a
history with an estimate over that without one. With a tolerance of a hundredth, ``cut`` is the
number of steps that the history takes, and ``left`` the largest true error of its stress and
displacement.

    python benchmarks/time_errors.py [--out DIR] [--quick] [--seed N]
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from time import process_time
from typing import ClassVar, NamedTuple

import _demos  # noqa: F401 (before the scripts' common parts)
import numpy as np
import ufl

import hhr_dolfinx as hhr
from hhr_dolfinx.forms.laws import At, Stated, creep
from hhr_dolfinx.geometries import block, two_blocks
from hhr_dolfinx.models.answer import Answer, History
from hhr_dolfinx.models.answer import Path as LoadPath

FIELDS: dict[str, Callable[[Answer], np.ndarray]] = {
    "stress": Answer.stress,
    "displacement": Answer.displacement,
    "forces": Answer.forces,
}
PLAIN, ESTIMATED = hhr.MarchSettings("tangent"), hhr.MarchSettings("tangent", time_error=True)
TOLERANCE = 0.01
PARTS = 32
"""Parts of each step of the history that stands for the truth: its error is a thirty-second of that
of the steps.
"""
PERFECT = hhr.Plasticity(1.0, 0.0)


@dataclass(frozen=True)
class Perzyna(hhr.Law):
    """Viscoplasticity with a threshold, written as a user does: rate of p = (max(σ_eq - σ0, 0) /
    η)^n.
    """

    threshold: float | str
    viscosity: float | str  # in stress times s^(1/n)
    exponent: float | str
    unknowns: ClassVar = {"stress": 1}
    limits: ClassVar = dict.fromkeys(("threshold", "viscosity", "exponent"), (0.0, float("inf")))

    def statement(self, at: At) -> Stated:
        """Backward Euler on the equivalent stress."""
        c = at.constants
        return creep(
            at,
            lambda q: at.dt * (ufl.max_value(q - c.threshold, 0) / c.viscosity) ** c.exponent,
            lambda amount: c.threshold + c.viscosity * (amount / at.dt) ** (1 / c.exponent),
        )


def ramp(steps: int, seconds: float = 1.0) -> LoadPath:
    """Put on evenly."""
    return [(seconds * k / steps, np.array([k / steps])) for k in range(steps + 1)]


def held(steps: int, quick: float = 0.01) -> LoadPath:
    """Put on in one quick step and held for ten seconds, in steps that grow."""
    return [
        (0.0, np.zeros(1)),
        *((quick + time, np.ones(1)) for time in [0.0, *np.logspace(-2, 1, steps)]),
    ]


def cycled(steps: int) -> LoadPath:
    """Put on, taken off and put on again."""
    shares = np.concatenate([np.linspace(0, 1, steps + 1), np.linspace(1, 0, steps + 1)[1:]])
    return [
        (k / steps, np.array([share])) for k, share in enumerate([*shares, *shares[1 : steps + 1]])
    ]


def space() -> hhr.ParameterSpace:
    """The share of the load."""
    return hhr.ParameterSpace(("p",), (0.0,), (1.0,))


def grows(size: float) -> hhr.Amplitude:
    """An amplitude that grows with the share of the load."""
    return hhr.Amplitude(slopes={"p": size})


def one_block(
    law: hhr.Law, size: Sequence[float], cells: tuple[int, int], **others: object
) -> hhr.Scene:
    """A plane block from the origin, with an obstacle to its right."""
    given: dict = {
        "name": "block",
        "geometry": lambda comm: block.block(
            comm, lower=(0.0, 0.0), upper=tuple(size), cells=cells
        ),
        "hypothesis": "plane_strain",
        "bodies": (hhr.Body(block.SOLID, 200.0, 0.3, law),),
        "contacts": (hhr.Obstacle(block.side(0, True), (1, 0), 99.0),),
        "parameters": space(),
    }
    return hhr.Scene(**given | others)


def bending(law: hhr.Law) -> hhr.Scene:
    """A beam held at its left end and pressed on its lid."""
    lid = hhr.Pressure(block.side(1, True), grows(0.03))
    return one_block(
        law,
        (4, 1),
        (12, 4),
        displacements=hhr.Displacement.clamp(block.side(0, False), 2),
        loads=(lid,),
    )


def tube(law: hhr.Law, wall: float = 2.003, pressure: float = 0.9) -> hhr.Scene:
    """A tube with an inner pressure in a rigid wall."""
    return one_block(
        law,
        (2, 0.2),
        (6, 1),
        geometry=lambda comm: block.block(comm, lower=(1.0, 0.0), upper=(2.0, 0.2), cells=(6, 1)),
        hypothesis="axisymmetric",
        contacts=(hhr.Obstacle(block.side(0, True), (1, 0), wall),),
        displacements=tuple(hhr.Displacement(block.side(1, upper), 1) for upper in (False, True)),
        loads=(hhr.Pressure(block.side(0, False), grows(pressure)),),
    )


def load_control(law: hhr.Law) -> hhr.Scene:
    """The tube without a wall, which bulges freely."""
    return tube(law, 99.0, 0.7)


def displacement_control(law: hhr.Law) -> hhr.Scene:
    """A block that sticks to its ends, which are brought together, and rests on a floor."""
    ends = hhr.Displacement.clamp(block.side(1, False), 2), hhr.Displacement(block.side(1, True), 0)
    push = hhr.Displacement(block.side(1, True), 1, grows(-0.02))
    wall = (hhr.Obstacle(block.side(0, True), (1, 0), 1.001),)
    return one_block(law, (1, 1), (5, 5), displacements=(*ends[0], ends[1], push), contacts=wall)


def indentation(law: hhr.Law) -> hhr.Scene:
    """A stiff ball pressed into a block, about an axis."""
    radius, height = 4.0, 0.6

    def warp(points: np.ndarray, tag: int) -> np.ndarray:
        moved = points.copy()
        if tag == two_blocks.SECOND:
            moved[:, 1] += points[:, 0] ** 2 / (2 * radius) * (1 + height - points[:, 1]) / height
        return moved

    first, second = (((0.0, 0.0), (1.0, 1.0), (12, 8)), ((0.0, 1.0), (1.0, 1.0 + height), (12, 3)))
    side = two_blocks.side
    axis = tuple(
        hhr.Displacement(side(tag, 0, False), 0) for tag in (two_blocks.FIRST, two_blocks.SECOND)
    )
    floor = hhr.Displacement(side(two_blocks.FIRST, 1, False), 1)
    push = hhr.Displacement(side(two_blocks.SECOND, 1, True), 1, grows(-0.03))
    return hhr.Scene(
        name="indentation",
        geometry=lambda comm: two_blocks.two_blocks(comm, first=first, second=second, warp=warp),
        hypothesis="axisymmetric",
        bodies=(
            hhr.Body(two_blocks.FIRST, 200.0, 0.3, law),
            hhr.Body(two_blocks.SECOND, 2000.0, 0.3),
        ),
        contacts=(
            hhr.NodeToNode(
                side(two_blocks.FIRST, 1, True), side(two_blocks.SECOND, 1, False), (0.0, 1.0)
            ),
        ),
        parameters=space(),
        displacements=(*axis, floor, push),
    )


class Case(NamedTuple):
    """A scene of a law, and a path."""

    name: str
    scene: Callable[[hhr.Law], hhr.Scene]
    path: LoadPath


CASES = (
    Case("bending", bending, ramp(10)),
    Case("tube in a wall", tube, ramp(10)),
    Case("load control", load_control, ramp(10)),
    Case("displacement control", displacement_control, ramp(10)),
    Case("hold after a quick load", tube, held(10)),
    Case("three cycles", bending, cycled(6)),
)
INDENTATION = Case("indentation in 20 steps", indentation, ramp(20))
LAWS = {
    "Norton": hhr.Norton(2.0, 4.0),
    "Perzyna of a user": Perzyna(0.5, 1.0, 2.0),
    "PlasticityWithCreep": hhr.PlasticityWithCreep(0.8, 5.0, 2.0, 4.0),
}
OTHERS = (
    ("PrimaryCreep", hhr.PrimaryCreep(20.0, 3.0, 0.4), CASES[4]),
    ("PrimaryCreep", hhr.PrimaryCreep(20.0, 3.0, 0.4), Case("bent and held", bending, held(10))),
    ("perfect plasticity", PERFECT, INDENTATION),
    ("perfect plasticity", PERFECT, CASES[2]),
    ("perfect plasticity", PERFECT, CASES[3]),
)


def finer(path: LoadPath, parts: int) -> LoadPath:
    """The path with each step in equal parts."""
    ends = [
        ((1 - share) * one + share * two, (1 - share) * here + share * there)
        for (one, here), (two, there) in pairwise(path)
        for share in np.arange(1, parts + 1) / parts
    ]
    return [path[0], *ends]


def true_errors(history: History, exact: History, parts: int) -> dict[str, float]:
    """Largest errors of a history, over the largest norms in it, by field.

    ``exact`` has each step in parts.
    """
    found = {}
    for name, field in FIELDS.items():
        known = [field(answer) for answer in exact.answers[parts - 1 :: parts]]
        largest = max(np.linalg.norm(values) for values in known)
        wrong = max(
            np.linalg.norm(field(a) - values)
            for a, values in zip(history.answers, known, strict=True)
        )
        found[name] = float(wrong / largest) if largest else 0.0
    return found


def estimated_errors(history: History) -> dict[str, float]:
    """Largest estimates of a history, over the largest norms in it, by field."""
    found = {}
    for name, field in FIELDS.items():
        largest = np.maximum.accumulate(
            [np.linalg.norm(field(answer)) for answer in history.answers]
        )
        estimates = largest * [getattr(answer.time_errors, name) for answer in history.answers]
        found[name] = float(estimates.max() / largest[-1]) if largest[-1] else 0.0
    return found


class Result(NamedTuple):
    """Estimates and true errors of one history by field, its cost, and the same of one with a
    tolerance.
    """

    case: str
    law: str
    estimates: dict[str, float]
    errors: dict[str, float]
    cost: float
    parts: int
    left: dict[str, float]

    def ratio(self, name: str) -> float:
        """Estimate over truth of a field; NaN of one that is not there."""
        return self.estimates[name] / self.errors[name] if self.errors[name] else np.nan


def compared(
    full: hhr.FullOrderModel, path: LoadPath, parts: int = PARTS
) -> tuple[dict[str, float], dict[str, float]]:
    """Estimates and true errors of a path, by field."""
    history = full.march(path, ESTIMATED)
    return estimated_errors(history), true_errors(
        history, full.march(finer(path, parts), PLAIN), parts
    )


def seconds(
    full: hhr.FullOrderModel, path: LoadPath, settings: hhr.MarchSettings, repetitions: int = 5
) -> float:
    """Least time of the processor for a path; other work on the machine only adds to it."""
    turns = []
    for _ in range(repetitions):
        start = process_time()
        full.march(path, settings)
        turns.append(process_time() - start)
    return min(turns)


def measured(case: Case, name: str, law: hhr.Law, parts: int = PARTS) -> Result:
    """Estimates of a history beside its true errors, its cost, and the same path with a
    tolerance.
    """
    full = hhr.FullOrderModel(case.scene(law))
    full.march(case.path[:2], PLAIN)  # compiles the law
    estimates, wrong = compared(full, case.path, parts)
    cost = seconds(full, case.path, ESTIMATED) / seconds(full, case.path, PLAIN)
    cut = full.march(case.path, hhr.MarchSettings("tangent", time_tolerance=TOLERANCE))
    left = true_errors(cut, full.march(finer(case.path, parts), PLAIN), parts)
    return Result(case.name, name, estimates, wrong, cost, sum(cut.parts), left)


HEAD = "| law | scene | stress | displacement | forces | cost | cut | left |"


def row(result: Result) -> str:
    """A line of the table: the true error in per cent and the ratio of the estimate to it, for each
    field.
    """
    cells = [
        f"{100 * result.errors[name]:.2g} %: {result.ratio(name):.2f}"
        if result.errors[name]
        else ""
        for name in FIELDS
    ]
    left = max(result.left[name] for name in ("stress", "displacement"))
    texts = (
        result.law,
        result.case,
        *cells,
        f"{result.cost:.1f}",
        str(result.parts),
        f"{100 * left:.2g} %",
    )
    return f"| {' | '.join(texts)} |"


def main() -> None:
    """Measure all cases, print the table of docs/flow.md, and write ``report.json`` and
    ``table.md``.
    """
    from parts import cli

    from hhr_dolfinx.plugins.studies import report

    options = cli.parse_on_first_rank(cli.demo_parser("time_errors", __doc__))
    cases = [(name, law, case) for name, law in LAWS.items() for case in CASES]
    lines = [HEAD, "|" + "---|" * (HEAD.count("|") - 1)]
    options.console.print("\n".join(lines), highlight=False)
    results = []
    for name, law, case in cases[1:2] if options.quick else [*cases, *OTHERS]:
        results.append(measured(case, name, law, 8 if options.quick else PARTS))
        lines.append(row(results[-1]))
        options.console.print(lines[-1], highlight=False)
    (options.out / "table.md").write_text("\n".join(lines) + "\n")
    rows = [result._asdict() for result in results]
    report.write_report(
        {"scene": "time_errors", "tolerance": TOLERANCE, "rows": rows, **report.environment()},
        options.out,
    )


if __name__ == "__main__":
    main()
