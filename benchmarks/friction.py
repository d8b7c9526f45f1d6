"""Contact with friction beside closed forms: what sticks and what slips, tractions, loops and limit loads.

- Cattaneo (1938) and Mindlin (1949): equal cylinders, and spheres, pressed together and then sheared. The contact
  sticks within c = a (1 - Q / (f P))^(1/2), of spheres to the power of 1/3, and the traction is the difference of two
  Hertzian ones.
- Jaeger (1997) and Ciavarella (1998): any profile in the plane; q = f (p(P) - p(P*)) with P* = P - Q / f, here of a
  flat punch with rounded edges, whose p comes from the solution without friction.
- A pad pulled over a plane (code_aster SSNV503), and a wedge between planes (NAFEMS CGS-4): limits of Coulomb's law.

    python benchmarks/friction.py [--out DIR] [--quick]
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from mpi4py import MPI

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side, two_blocks

Row = dict[str, Any]
FRICTION = 0.3
YOUNG, POISSON = 1000.0, 0.3
RADIUS = 1000.0
"""Far above the width of the contact: surfaces are those of half-planes."""


def row(case: str, quantity: str, reference: float, ours: float) -> Row:
    """A line of the table."""
    return {
        "case": case,
        "quantity": quantity,
        "reference": reference,
        "ours": ours,
        "error": abs(ours / reference - 1),
    }


def graded(position: np.ndarray, grading: float) -> np.ndarray:
    """Map [-1, 1] onto itself, denser towards 0."""
    return np.sinh(grading * position) / np.sinh(grading)


def cylinders(cells: int, *, size: float = 40.0, profile: Any = None, friction: float | None = FRICTION) -> hhr.Scene:
    """Two square blocks of one material; the upper one has a profile, that of a cylinder unless given.

    Args:
        cells: along the contact; half as many behind each surface.
        size: half of a side, and the height of a block.
        profile: height of the lower side of the upper block at x, (n,).
        friction: coefficient.
    """
    height = profile or (lambda x: x**2 / (2 * RADIUS))

    def warp(points: np.ndarray, tag: int) -> np.ndarray:
        x = size * graded(points[:, 0], 5.0)
        y = size * graded(points[:, 1], 5.0)
        if tag == SECOND:
            y = y + height(np.clip(x, -5.0, 5.0)) * (1 - points[:, 1])
        return np.column_stack([x, y])

    boxes = ((-1.0, -1.0), (1.0, 0.0), (cells, cells // 2)), ((-1.0, 0.0), (1.0, 1.0), (cells, cells // 2))
    top = side(SECOND, 1, True)
    moved = {0: "shear", 1: "push"}
    return hhr.Scene(
        name="cattaneo",
        geometry=lambda comm: two_blocks(comm, first=boxes[0], second=boxes[1], warp=warp),
        hypothesis="plane_strain",
        bodies=(hhr.Body(FIRST, YOUNG, POISSON), hhr.Body(SECOND, YOUNG, POISSON)),
        contacts=(hhr.NodeToNode(side(FIRST, 1, True), side(SECOND, 1, False), (0.0, 1.0), friction=friction),),
        displacements=(
            *hhr.Displacement.clamp(side(FIRST, 1, False), 2),
            *(
                hhr.Displacement(top, axis, hhr.Amplitude(slopes={name: (1.0, -1.0)[axis]}))
                for axis, name in moved.items()
            ),
        ),
        parameters=hhr.ParameterSpace(("push", "shear"), (0.0, -0.01), (0.01, 0.01)),
    )


def resultants(model: Any, answer: Any) -> tuple[np.ndarray, np.ndarray]:
    """Pressures and tangential forces on the slave along x of the contacts with friction, (C,) each."""
    friction = model.problem.friction
    forces = answer.multipliers
    shear = np.bincount(friction.owner, -forces[friction.tangential] * friction.tangents[:, 0], friction.normal.size)
    return forces[friction.normal], shear


def cattaneo(cells: int) -> Iterator[Row]:
    """Equal cylinders: width, stick width, traction, and the loop of a cycle."""
    full = hhr.FullOrderModel(cylinders(cells), MPI.COMM_SELF)
    problem = full.problem
    x = problem.contact_points[problem.friction.normal, 0]
    area = problem.friction.area
    push = 0.004
    steps = [(push, 0.0)] + [(push, shear) for shear in np.linspace(0.0, 0.00135, 8)[1:]]
    steps += [(push, shear) for shear in np.linspace(0.00135, -0.00135, 15)[1:]]
    history = full.march([(float(k), point) for k, point in enumerate([(0.0, 0.0), *steps])])
    answer = history.answers[7]
    pressure, shear = resultants(full, answer)
    P, Q = pressure.sum(), abs(shear.sum())
    modulus = YOUNG / (2 * (1 - POISSON**2))
    a = np.sqrt(4 * P * RADIUS / (np.pi * modulus))
    c = a * np.sqrt(1 - Q / (FRICTION * P))
    name = f"Cattaneo, cylinders, {cells} cells"
    yield row(name, "half width a", a, 2 * np.sqrt(pressure @ x**2 / P))
    statuses = problem.friction.statuses(answer.active)
    yield row(name, "half width that sticks", c, area[statuses == 1].sum() / 2)
    peak = 2 * P / (np.pi * a)
    inside = np.sqrt(np.maximum(1 - (x / a) ** 2, 0.0))
    stuck = c / a * np.sqrt(np.maximum(1 - (x / c) ** 2, 0.0))
    closed = FRICTION * peak * (inside - stuck)
    yield row(
        name, "traction, 1 + L2 error", 1.0, 1 + np.linalg.norm(np.abs(shear) / area - closed) / np.linalg.norm(closed)
    )
    yield from loop(full, history.answers[7:], name, 2)


def loop(full: Any, answers: list[Any], name: str, power: int) -> Iterator[Row]:
    """Stick width along the way back: what slips back is half of the change, Mindlin and Deresiewicz (1953)."""
    problem = full.problem
    pressure, shear = resultants(full, answers[0])
    P, first = pressure.sum(), shear.sum()
    widths = []
    for answer in answers[1:]:
        _, shear = resultants(full, answer)
        share = 1 - abs(first - shear.sum()) / (2 * FRICTION * P)
        stuck = problem.friction.area[problem.friction.statuses(answer.active) == 1].sum()
        widths.append((stuck, share ** (1 / power)))
    found, expected = np.array(widths).T
    whole = problem.friction.area[pressure > 0].sum()
    if power == 2:
        yield row(
            name, "width that sticks on the way back, 1 + mean error", 1.0, 1 + np.abs(found / whole - expected).mean()
        )


if __name__ == "__main__":
    for cells in (80, 160, 320):
        for line in cattaneo(cells):
            print(line)
