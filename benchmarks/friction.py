"""Contact with friction beside closed forms: what sticks and what slips, tractions, loops and limit
loads.

- Cattaneo (1938) and Mindlin (1949): equal cylinders, and spheres, pressed together and then
  sheared. The contact sticks within c = a (1 - Q / (f P))^(1/2), of spheres to the power of 1/3,
  and the traction is the difference of two Hertzian ones.
- Jaeger (1997) and Ciavarella (1998): any profile in the plane; q = f (p(P) - p(P*)) with P* = P -
  Q / f, here of a flat punch with rounded edges, whose p comes from the solution without friction.
- A pad pulled over a plane (code_aster SSNV503), and a wedge between planes (NAFEMS CGS-4): limits
  of Coulomb's law.

    python benchmarks/friction.py [--out DIR] [--quick] [--seed N]
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import _demos  # noqa: F401
import fretting
import numpy as np
from mpi4py import MPI

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import block
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side, two_blocks

Row = dict[str, Any]
FRICTION, YOUNG, POISSON, RADIUS = 0.3, fretting.YOUNG, fretting.POISSON, fretting.RADIUS


def row(case: str, quantity: str, reference: float, ours: float) -> Row:
    """A line of the table."""
    return {
        "case": case,
        "quantity": quantity,
        "reference": reference,
        "ours": ours,
        "error": abs(ours / reference - 1),
    }


def resultants(model: Any, answer: Any) -> tuple[np.ndarray, np.ndarray]:
    """Pressures and tangential forces on the slave along x of the contacts with friction, (C,)
    each.
    """
    friction = model.problem.law
    forces = answer.multipliers
    shear = np.bincount(
        friction.owner, -forces[friction.tangential] * friction.tangents[:, 0], friction.normal.size
    )
    return forces[friction.normal], shear


def cattaneo(cells: int) -> Iterator[Row]:
    """Equal cylinders: width, stick width, traction, and the loop of a cycle."""
    full = hhr.FullOrderModel(fretting.scene(cells, friction=FRICTION), MPI.COMM_SELF)
    problem = full.problem
    x = problem.contact_points[problem.law.normal, 0]
    area = problem.law.area
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
    statuses = answer.slip.statuses
    yield row(name, "half width that sticks", c, area[statuses == 1].sum() / 2)
    yield traction(name, 2 * P / (np.pi * a), a, c, np.abs(x), np.abs(shear) / area)
    yield loop(full, history.answers[7:], name)


def loop(full: Any, answers: list[Any], name: str) -> Row:
    """Stick width along the way back: what slips back is half of the change, Mindlin and
    Deresiewicz (1953).
    """
    problem = full.problem
    pressure, shear = resultants(full, answers[0])
    P, first = pressure.sum(), shear.sum()
    widths = []
    for answer in answers[1:]:
        _, shear = resultants(full, answer)
        share = 1 - abs(first - shear.sum()) / (2 * FRICTION * P)
        stuck = problem.law.area[answer.slip.statuses == 1].sum()
        widths.append((stuck, share**0.5))
    found, expected = np.array(widths).T
    whole = problem.law.area[pressure > 0].sum()
    off = np.abs(found / whole - expected).mean()
    return row(name, "width that sticks on the way back, 1 + mean error by the whole", 1.0, 1 + off)


def mindlin(cells: int) -> Iterator[Row]:
    """Equal spheres, half of both: radius, stick radius and traction.

    Poisson's ratio is 0: only then does all that slips do so along the force, as the closed form
    takes for granted.
    """
    size = 14.0
    shape = (2 * cells, cells, cells // 2)

    def warp(points: np.ndarray, tag: int) -> np.ndarray:
        x, y, z = (size * fretting.even_within(column, 2.0 / size) for column in points.T)
        if tag == SECOND:
            near = np.minimum(x**2 + y**2, 9.0)
            z = z + near / (2 * RADIUS) * (1 - points[:, 2])
        return np.column_stack([x, y, z])

    boxes = ((-1.0, 0.0, -1.0), (1.0, 1.0, 0.0), shape), ((-1.0, 0.0, 0.0), (1.0, 1.0, 1.0), shape)
    top, slope = side(SECOND, 2, True), {0: ("shear", 1.0), 2: ("push", -1.0)}
    scene = hhr.Scene(
        name="mindlin",
        geometry=lambda comm: two_blocks(comm, first=boxes[0], second=boxes[1], warp=warp),
        hypothesis="solid",
        bodies=(hhr.Body(FIRST, YOUNG, 0.0), hhr.Body(SECOND, YOUNG, 0.0)),
        contacts=(
            hhr.NodeToNode(
                side(FIRST, 2, True), side(SECOND, 2, False), (0.0, 0.0, 1.0), friction=FRICTION
            ),
        ),
        displacements=(
            *hhr.Displacement.clamp(side(FIRST, 2, False), 3),
            *(hhr.Displacement(side(body, 1, False), 1) for body in (FIRST, SECOND)),
            *(
                hhr.Displacement(top, axis, hhr.Amplitude(slopes={name: sign}))
                for axis, (name, sign) in slope.items()
            ),
            hhr.Displacement(top, 1),
        ),
        parameters=hhr.ParameterSpace(("push", "shear"), (0.0, -0.01), (0.01, 0.01)),
    )
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    push, most = 0.0022, 0.00056
    steps = [(push, shear) for shear in np.linspace(0.0, most, 8)]
    history = full.march([(float(k), point) for k, point in enumerate([(0.0, 0.0), *steps])])
    answer = history.answers[-1]
    friction = full.problem.law
    pressure, shear = resultants(full, answer)
    points = full.problem.contact_points[friction.normal]
    r = np.hypot(points[:, 0], points[:, 1])
    P, Q = 2 * pressure.sum(), 2 * abs(shear.sum())
    a = (3 * P * RADIUS * 2 / (4 * YOUNG)) ** (1 / 3)
    c = a * (1 - Q / (FRICTION * P)) ** (1 / 3)
    name = f"Mindlin, spheres, {cells} cells"
    # of a Hertzian pressure the mean of r^2 is 2 a^2 / 5
    yield row(name, "radius a", a, np.sqrt(2.5 * pressure @ r**2 / pressure.sum()))
    stuck = friction.area[answer.slip.statuses == 1].sum()
    yield row(name, "radius that sticks", c, np.sqrt(2 * stuck / np.pi))
    yield traction(name, 3 * P / (2 * np.pi * a**2), a, c, r, np.abs(shear) / friction.area)


def traction(name: str, peak: float, a: float, c: float, r: np.ndarray, found: np.ndarray) -> Row:
    """Largest difference of tractions within nine tenths of the contact, but for the kink where
    slip begins.
    """
    outer, inner = (np.sqrt(np.maximum(1 - (r / radius) ** 2, 0.0)) for radius in (a, c))
    closed = FRICTION * peak * (outer - c / a * inner)
    clear = (r < 0.9 * a) & (np.abs(r - c) > 0.1 * a)
    worst = np.abs(found - closed)[clear].max() / closed.max()
    return row(name, "traction, 1 + largest error by its peak", 1.0, 1 + worst)


def rounded_punch(cells: int) -> Iterator[Row]:
    """A flat punch with rounded edges: traction beside the difference of two pressures without
    friction.
    """

    def profile(x: np.ndarray) -> np.ndarray:
        return np.maximum(np.abs(x) - 1.0, 0.0) ** 2 / (2 * RADIUS)

    full = hhr.FullOrderModel(fretting.scene(cells, profile, FRICTION), MPI.COMM_SELF)
    smooth = hhr.FullOrderModel(fretting.scene(cells, profile, None), MPI.COMM_SELF)
    push, most = 0.004, 0.0014
    steps = [(push, shear) for shear in np.linspace(0.0, most, 8)]
    answer = full.march(
        [(float(k), point) for k, point in enumerate([(0.0, 0.0), *steps])]
    ).answers[-1]
    pressure, shear = resultants(full, answer)
    wanted = pressure.sum() - abs(shear.sum()) / FRICTION
    low, high = 0.0, push
    for _ in range(50):
        middle = 0.5 * (low + high)
        part = smooth.solve({"push": middle, "shear": 0.0}).forces()
        low, high = (middle, high) if part.sum() < wanted else (low, middle)
    closed = FRICTION * (pressure - part)
    off = np.linalg.norm(np.abs(shear) - closed) / np.linalg.norm(closed)
    yield row(
        f"Ciavarella, rounded punch, {cells} cells", "tangential forces, 1 + L2 error", 1.0, 1 + off
    )


def plate(cells: int) -> hhr.Scene:
    """SSNV128: a square plate on a rigid plane, pressed from above and from its side; half of
    it.
    """
    return hhr.Scene(
        name="ssnv128",
        geometry=lambda comm: block.block(
            comm, lower=(0.0, 0.0), upper=(0.04, 0.04), cells=(cells, cells)
        ),
        hypothesis="plane_strain",
        bodies=(hhr.Body(block.SOLID, 1.3e11, 0.2),),
        contacts=(hhr.Obstacle(block.side(1, False), (0.0, -1.0), 0.0, friction=1.0),),
        displacements=(hhr.Displacement(block.side(0, True), 0),),
        loads=(
            hhr.Pressure(block.side(1, True), hhr.Amplitude(slopes={"load": 5e7})),
            hhr.Pressure(block.side(0, False), hhr.Amplitude(slopes={"load": 15e7})),
        ),
        parameters=hhr.ParameterSpace(("load",), (0.0,), (1.0,)),
    )


def raous(cells: int) -> Iterator[Row]:
    """Displacements of the bottom of that plate."""
    full = hhr.FullOrderModel(plate(cells), MPI.COMM_SELF)
    moved = full.solve(1.0).displacement().reshape(-1, 2)[:, 0]
    points = full.problem.points
    bottom = np.flatnonzero(points[:, 1] < 1e-9)
    bottom = bottom[np.argsort(points[bottom, 0])]
    # the first is that of the corner; the places of the others, multiples of 1.25 mm, were found by
    # their values
    for place, reference in ((0.0, 2.86), (1.25, 2.72), (5.0, 2.28), (7.5, 1.98), (11.25, 1.50)):
        ours = 1e5 * float(np.interp(1e-3 * place, points[bottom, 0], moved[bottom]))
        yield row(
            "SSNV128, plate on a plane", f"displacement at {place} mm [1e-5 m]", reference, ours
        )


def pulled(angle: float, name: str, reference: float) -> Row:
    """A block that weighs on a plane and is pulled along it, down to up by its angle, until it
    slips.
    """
    normal = (float(np.sin(angle)), -float(np.cos(angle)))

    def geometry(comm: Any) -> Any:
        mesh, *tags = block.block(comm, lower=(0.0, 0.0), upper=(2.0, 1.0), cells=(12, 6))
        x = mesh.geometry.x
        x[:, 1] += np.tan(angle) * x[:, 0] * (1 - x[:, 1])
        return mesh, *tags

    scene = hhr.Scene(
        name="pad",
        geometry=geometry,
        hypothesis="plane_strain",
        bodies=(hhr.Body(block.SOLID, YOUNG, POISSON),),
        contacts=(hhr.Obstacle(block.side(1, False), normal, 0.0, friction=FRICTION),),
        displacements=(
            hhr.Displacement(block.side(1, True), 0, hhr.Amplitude(slopes={"pull": 1.0})),
        ),
        loads=(hhr.Pressure(block.side(1, True), hhr.Amplitude(slopes={"weight": 1.0})),),
        parameters=hhr.ParameterSpace(("weight", "pull"), (0.0, 0.0), (1.0, 0.1)),
        outputs=(hhr.ContactForce("along", 0, (1.0, 0.0)), hhr.ContactForce("up", 0, (0.0, 1.0))),
    )
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    path = [
        (0.0, (0.0, 0.0)),
        (1.0, (1.0, 0.0)),
        *((1.0 + k, (1.0, 0.02 * k)) for k in range(1, 6)),
    ]
    outputs = full.march(path).answers[-1].outputs()
    return row(name, "force along over weight", reference, -outputs["along"] / outputs["up"])


def references(quick: bool) -> Iterator[Row]:
    """All cases."""
    for cells in (80, 160) if quick else (80, 160, 320):
        yield from cattaneo(cells)
    for cells in (12,) if quick else (12, 18, 24):
        yield from mindlin(cells)
    for cells in (160,) if quick else (160, 320):
        yield from rounded_punch(cells)
    yield from raous(32 if quick else 64)
    yield pulled(0.0, "SSNV503, pad on a plane", FRICTION)
    yield pulled(float(np.arctan(0.1)), "CGS-4, wedge", (FRICTION + 0.1) / (1 - 0.1 * FRICTION))


def main() -> None:
    """Run all cases, print and write the table."""
    from parts import cli

    from hhr_dolfinx.plugins.studies import report

    options = cli.parse_on_first_rank(cli.demo_parser("friction", __doc__))
    rows = list(references(options.quick))
    report.write_report(
        {"scene": "friction", "friction": {"reference": rows}, **report.environment()}, options.out
    )
    told = [
        {**line, "reference": f"{line['reference']:.5g}", "ours": f"{line['ours']:.5g}"}
        for line in rows
    ]
    cli.print_rows("friction beside references", told, options.console)


if __name__ == "__main__":
    main()
