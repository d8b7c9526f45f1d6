"""Ranks that are asked for different things, or of which one fails: each case ends on all ranks,
without a hang.
"""

import warnings

import numpy as np
from mpi4py import MPI
from scenes import pressed_pair
from toy_system import Parted

import hhr_dolfinx as hhr

COMM = MPI.COMM_WORLD
LAST = COMM.rank == COMM.size - 1
POINT = np.array([0.03, 0.0, 0.05, 0.005])
OTHER = POINT + LAST * np.array([0.01, 0.0, 0.0, 0.0])
"""Another point on the last rank alone."""


def said(action):
    """Class and message of what an action raises on this rank."""
    try:
        action()
    except BaseException as error:
        return f"{type(error).__name__}: {error}"
    return "nothing"


def on_all(cases):
    """Outcomes of actions by name, of each rank."""
    return {name: COMM.allgather(said(action)) for name, action in cases.items()}


def pair(**changes):
    """Two blocks, whose full model a rank makes in a moment."""
    return pressed_pair(
        "plane_strain", [(10.0 + changes.pop("stiffer", 0.0), 0.3), (8.0, 0.3)], cells=2, **changes
    )


def tables(full):
    """Tables of other lengths than that of the local rows."""
    rows = full.spread
    whole = np.ones((rows.count, 2))
    own = rows.of(whole)
    return {
        "whole tables": lambda: rows.whole(whole),
        "a whole table on one rank": lambda: rows.whole(whole if LAST else own),
        "more columns on one rank": lambda: rows.whole(own[:, : 2 - LAST]),
        "orthonormal": lambda: rows.orthonormal(whole),
        "rows at": lambda: rows.at(whole, np.array([0, 3])),
        "product": lambda: full.problem.stiffness_of_rows @ whole,
    }


def questions(full):
    """Calls that differ on the last rank."""
    path = [(0.0, POINT), (1.0, POINT)]
    return {
        "solve": lambda: full.solve(OTHER),
        "gradient": lambda: full.solve(POINT, gradient=LAST),
        "solve_many": lambda: full.solve_many([POINT, OTHER]),
        "march": lambda: full.march([*path[:1], (1.0, OTHER)]),
        "times": lambda: full.march([(0.0, POINT), (1.0 + LAST, POINT)]),
        "other verbs": lambda: full.march(path) if LAST else full.solve_many([POINT, POINT]),
        "no point": lambda: full.solve([np.nan] * 4 if LAST else POINT),
        "snapshots": lambda: hhr.compute_snapshots(full, [POINT, OTHER]),
        "train": lambda: hhr.train(full.scene, np.array([POINT, OTHER]), held_out=0),
        "train together": lambda: hhr.train(
            full.scene, np.array([POINT, OTHER]), held_out=0, together=True
        ),
        "scenes": lambda: hhr.FullOrderModel(pair(stiffer=float(LAST))),
        "reduce": lambda: hhr.reduce(pair(stiffer=float(LAST)), 0.1),
        "no scene": lambda: hhr.FullOrderModel(None if LAST else full.scene),
    }


class Broken(Parted):
    """A system whose equations fail on the last rank after the first ones."""

    def equations(self, point, theta):
        if LAST and point[0] > 0.04:
            raise ArithmeticError("no equations here")
        return super().equations(point, theta)


def failing(label):
    """A progress bar that fails on the last rank."""

    def bar(items):
        for number, item in enumerate(items):
            if LAST and number:
                raise SystemExit(7)
            yield item

    return bar


def nameless(label):
    """A progress bar that cannot be made on the last rank."""
    if LAST:
        raise OSError("no terminal")
    return iter


def short(label):
    """A progress bar that ends too early on the last rank."""
    return lambda items: iter(list(items)[:1]) if LAST else iter(items)


def failures(full):
    """Code of the user that fails on the last rank."""
    points = POINT + 1e-3 * np.arange(2 * COMM.size)[:, None] * np.array([1.0, 0.0, 0.0, 0.0])
    how = {"held_out": 0}
    cases = {}
    for name, bar in {"exit": failing, "no bar": nameless}.items():
        cases[name] = lambda bar=bar: hhr.train(full.scene, points, progress=bar, **how)
        cases[f"{name} together"] = lambda bar=bar: hhr.train(
            full.scene, points, progress=bar, together=True, **how
        )
    cases["short"] = lambda: hhr.compute_snapshots(full, points, short(""))
    cases["reduce"] = lambda: hhr.reduce(
        full.scene, 0.1, progress=lambda stage, share: 1 / (COMM.rank)
    )
    return cases


def outcomes():
    """Outcomes of all cases."""
    warnings.simplefilter("ignore")
    full = hhr.FullOrderModel(pair())
    found = {
        "tables": on_all(tables(full)),
        "questions": on_all(questions(full)),
        "failures": on_all(failures(full)),
    }
    # none of them has broken the model
    return found | {"after": COMM.allgather(full.solve(POINT).forces().tolist())}
