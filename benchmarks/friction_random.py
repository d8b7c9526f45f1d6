"""Increments with friction on random S, plane and in space, held against their conditions in words.

Regular, nearly singular and singular S, coefficients from none to 8, limits, and Tresca's law.
Nothing of the solver is used to judge what it finds: not its statuses, not its projections.

    python benchmarks/friction_random.py [--out DIR] [--quick] [--seed N] [--count N]
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import _demos  # noqa: F401
import numpy as np

from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.plugins.friction.laws import Friction
from hhr_dolfinx.plugins.friction.sliding_set import SlidingContact, SlidingIncrement

NONE = np.zeros(0)
WRONG = 1e-8
"""Violation that singular systems of S of low rank leave: 2e-10 was measured."""


def layout(contacts: int, directions: int, smooth: int = 0) -> tuple[Friction, int]:
    """Contacts with friction, their tangential rows behind, and some without.

    How many rows there are.
    """
    count = contacts * (1 + directions) + smooth
    owner = np.repeat(np.arange(contacts), directions)
    rows = np.arange(smooth + contacts, count)
    tangents = np.tile(np.eye(directions + 1)[:directions], (contacts, 1))
    law = np.zeros(contacts, dtype=np.int64)
    return Friction(
        np.arange(contacts),
        np.ones(contacts),
        np.ones(contacts),
        law,
        rows,
        owner,
        tangents,
        (),
        law[:0],
        law[:0],
        law[:0],
    ), count


def violation(schur, friction, given, forces):
    """How far forces are from the conditions of contact and of Coulomb's law, each in its own
    size.
    """
    slack = given.slack + schur @ forces
    force, length = np.abs(forces).max() + 1e-300, np.abs(given.slack).max() + 1e-300
    worst = 0.0
    for row in np.flatnonzero(friction.pressing(len(schur))):
        worst = max(
            worst,
            -forces[row] / force,
            -slack[row] / length,
            min(forces[row] / force, slack[row] / length),
        )
    for contact, normal in enumerate(friction.normal):
        rows = friction.tangential[friction.owner == contact]
        bound = given.limit[contact]
        if np.isfinite(given.coefficient[contact]):
            bound = min(bound, given.coefficient[contact] * max(forces[normal], 0.0))
        size, slip = np.linalg.norm(forces[rows]), np.linalg.norm(slack[rows])
        # what slips is opposed by all that friction bears: its power is the bound times the slip
        power = abs(forces[rows] @ slack[rows] + bound * slip) / (force * length) if slip else 0.0
        worst = max(worst, (size - bound) / force, power)
    return worst


def random_problem(rng):
    """Any problem: definite, nearly singular or singular S, friction from none to 8, limits,
    Tresca's law.
    """
    contacts, directions, smooth = rng.integers(1, 12), rng.integers(1, 3), rng.integers(0, 3)
    friction, m = layout(contacts, directions, smooth)
    rank = m if rng.random() < 0.8 else max(1, m - rng.integers(0, 4))
    root = rng.normal(size=(m, rank + rng.integers(0, 4) * (rank == m)))
    schur = (root @ root.T + (m * np.eye(m) if rng.random() < 0.3 else 0.0)) * 10.0 ** rng.integers(
        -9, 3
    )
    wanted = rng.normal(size=m) * 10.0 ** rng.uniform(-3, 3)
    coefficient = rng.random(contacts) * rng.choice([0.0, 0.1, 0.5, 2.0, 8.0])
    limit = np.where(
        rng.random(contacts) < 0.2, rng.random(contacts) * np.abs(wanted).max(), np.inf
    )
    coefficient[(rng.random(contacts) < 0.3) & np.isfinite(limit)] = np.inf
    return schur, friction, SlidingIncrement(schur @ wanted, coefficient, limit, NONE)


def tried(count: int, rng: np.random.Generator) -> dict[str, Any]:
    """How so many problems ended."""
    ended: Counter[str] = Counter()
    iterations = []
    worst = 0.0
    for _ in range(count):
        schur, friction, given = random_problem(rng)
        found = SlidingContact(schur, friction).increment(given, np.zeros(len(schur)))
        iterations.append(found.iterations)
        if found.status is Status.CONVERGED:
            off = violation(schur, friction, given, found.forces)
            worst = max(worst, off)
            ended["solved" if off < WRONG else "wrong"] += 1
        else:
            ended[found.status.name] += 1
    told = {"mean": float(np.mean(iterations)), "max": max(iterations)}
    return {"problems": count, "ended": dict(ended), "largest violation": worst, "iterations": told}


def main() -> None:
    """Try, report."""
    from parts import cli

    from hhr_dolfinx.plugins.studies import report

    parser = cli.demo_parser("friction_random", __doc__)
    parser.add_argument("--count", type=int, default=20_000, help="how many problems (%(default)s)")
    options = cli.parse_on_first_rank(parser)
    found = tried(500 if options.quick else options.count, np.random.default_rng(options.seed))
    report.write_report(
        {"scene": "friction_random", "friction": found, **report.environment()}, options.out
    )
    options.console.print(found)


if __name__ == "__main__":
    main()
