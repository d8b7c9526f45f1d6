"""Published benchmarks of frictionless contact, beside their reference values.

- CGS-1 of NAFEMS (code_aster V6.03.154, SSNP154): a cylinder on a block in plane strain, under its
  own force.
- SSNV104 (code_aster V6.04.104): a ball of E = 20,000 pressed flat by 2 mm, and the same under its
  own force.
- SSNP121 (code_aster V6.03.121): the patch test of two blocks whose meshes do not match.
- Rates of V6.03.150: displacement 2.0 and pressure 0.5 with four-node cells on a curved surface,
  2.5 and 1.0 with cells of second order. Its solution is not published beside its rates; rings that
  are pressed together have one (Lame), and a curved surface too.

What to see: pressures within half a per cent of Hertz where the force is given, mortar exact in the
patch test, and the rates that are asked for. Where the approach is given instead (SSNV104) a ball
is stiffer than the half-space of Hertz, by 4 %: its reference values belong to half-spaces.

    python benchmarks/benchmarks.py [--out DIR] [--quick] [--seed N]
"""

import warnings
from collections.abc import Iterator
from typing import Any

import _demos  # noqa: F401
import numpy as np
from benchmark_meshes import half_round
from mpi4py import MPI
from second_order import ring_errors

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import PairingWarning
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side, two_blocks

Row = dict[str, Any]


def row(benchmark: str, quantity: str, reference: float, found: float, source: str) -> Row:
    """A line of the table."""
    off = found / reference - 1
    return {
        "benchmark": benchmark,
        "quantity": quantity,
        "reference": reference,
        "found": found,
        "off": off,
        "source": source,
    }


def line_contact(quick: bool, order: int = 1) -> Iterator[Row]:
    """CGS-1: steel cylinder of 50 mm on an aluminium block, 35 kN per mm.

    Half of both, the cylinder free to move.
    """
    radius, half_force, fine = 50.0, 17.5e3, order * (0.3 if quick else 0.12)
    name = "CGS-1" if order == 1 else "CGS-1, second order"
    scene = hhr.Scene(
        name="cgs_1",
        geometry=lambda comm: half_round(
            comm, radius=radius, fine=fine, reach=9.0, block=(100.0, 200.0), order=order
        ),
        hypothesis="plane_strain",
        bodies=(hhr.Body("round", 210e3, 0.3), hhr.Body("block", 70e3, 0.3)),
        contacts=(hhr.Mortar("arc", "face", normal=(0.0, -1.0)),),
        displacements=(
            *(hhr.Displacement(tag, 0) for tag in ("axis", "block_axis")),
            hhr.Displacement("base", 1),
        ),
        loads=(hhr.Pressure("top", hhr.Amplitude(slopes={"force": 1.0 / radius})),),
        parameters=hhr.ParameterSpace(("force",), (0.0,), (2 * half_force,)),
        units=hhr.Units("mm", "MPa"),
    )
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    forces, x = full.solve(half_force).forces(), full.problem.contact_points[:, 0]
    modulus = 1 / ((1 - 0.3**2) / 210e3 + (1 - 0.3**2) / 70e3)
    width = np.sqrt(8 * half_force * radius / (np.pi * modulus))
    # of an elliptic pressure: a^2 = 4 times its second moment, p0 = 2 P / (pi a)
    found = 2 * np.sqrt(forces @ x**2 / forces.sum())
    source = "NAFEMS CGS-1, code_aster V6.03.154; Hertz"
    yield row(name, "half width [mm]", 6.2146, found, source)
    yield row(
        name,
        "largest pressure [MPa]",
        3585.4,
        _peak(x, forces, full.problem.contact_areas, width),
        source,
    )
    yield row(name, "force [N/mm]", half_force, forces.sum(), "balance")


def _peak(x: np.ndarray, forces: np.ndarray, areas: np.ndarray, width: float) -> float:
    """Height of the semi-ellipse through the pressures of the inner half of a contact, by least
    squares.
    """
    inner = np.abs(x) < 0.5 * width
    shape = np.sqrt(1 - (x[inner] / width) ** 2) * areas[inner]
    return float(shape @ forces[inner] / (shape @ shape))


def ball(quick: bool) -> Iterator[Row]:
    """SSNV104: one of two equal balls, that is a ball on a rigid plane.

    Pressed by 2 mm, and by its own force.
    """
    radius, young, poisson, fine = 50.0, 20e3, 0.3, 0.4 if quick else 0.15
    scene = hhr.Scene(
        name="ssnv104",
        geometry=lambda comm: half_round(comm, radius=radius, fine=fine, reach=13.0),
        hypothesis="axisymmetric",
        bodies=(hhr.Body("round", young, poisson),),
        contacts=(hhr.Obstacle("arc", normal=(0.0, -1.0), offset=0.0),),
        displacements=(
            hhr.Displacement("axis", 0),
            hhr.Displacement("top", 1, hhr.Amplitude(slopes={"push": -1.0})),
        ),
        parameters=hhr.ParameterSpace(("push",), (0.0,), (2.0,)),
        units=hhr.Units("mm", "MPa"),
    )
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    forces, r = full.solve(2.0).forces(), full.problem.contact_points[:, 0]
    force, modulus = forces.sum(), young / (1 - poisson**2)
    width = (3 * force * radius / (4 * modulus)) ** (1 / 3)
    pole = _peak(r, forces, full.problem.contact_areas, width)
    source = "code_aster V6.04.104"
    yield row(
        "SSNV104",
        "pole pressure, approach of 2 mm [MPa]",
        2798.3,
        pole,
        f"{source}; Hertz for half-spaces",
    )
    yield row(
        "SSNV104",
        "pole pressure, own force [MPa]",
        3 * force / (2 * np.pi * width**2),
        pole,
        f"{source}; Hertz",
    )


def patch(quick: bool) -> Iterator[Row]:
    """SSNP121: two blocks of height 1 with 3 and 5 cells along the contact, shortened by 0.1 of 2.

    Nu = 0.
    """
    scene = hhr.Scene(
        name="ssnp121",
        geometry=lambda comm: two_blocks(
            comm, first=((0, 0), (1, 1), (3, 3)), second=((0, 1), (1, 2), (5, 4))
        ),
        hypothesis="plane_strain",
        bodies=tuple(hhr.Body(tag, 2e6, 0.0) for tag in (FIRST, SECOND)),
        contacts=(hhr.Mortar(side(SECOND, 1, False), side(FIRST, 1, True)),),
        displacements=(
            *(hhr.Displacement(side(body, 0, False), 0) for body in (FIRST, SECOND)),
            hhr.Displacement(side(FIRST, 1, False), 1),
            hhr.Displacement(side(SECOND, 1, True), 1, hhr.Amplitude(slopes={"push": -1.0})),
        ),
        parameters=hhr.ParameterSpace(("push",), (0.0,), (0.1,)),
    )
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    pressure = full.solve(0.1).forces() / full.problem.contact_areas
    worst = pressure[np.abs(pressure - 1e5).argmax()]
    yield row(
        "SSNP121",
        "pressure furthest from the reference [Pa]",
        1e5,
        float(worst),
        "code_aster V6.03.121",
    )


INNER, OUTER, CONTACT, PRESSED = 1.0, 2.0, 1.5, 1.0
"""Radii of two rings, and the pressure inside."""


def rings(cells: int) -> tuple[float, float]:
    """Errors in L2 of displacement and pressure of two rings with ``cells`` and 4/3 as many cells
    around a quarter.
    """
    young, poisson = 100.0, 0.3

    def bent(points: np.ndarray, tag: int) -> np.ndarray:
        r, angle = points[:, 0], points[:, 1] * np.pi / 2
        return np.column_stack([r * np.cos(angle), r * np.sin(angle)])

    scene = hhr.Scene(
        name="rings",
        geometry=lambda comm: two_blocks(
            comm,
            warp=bent,
            first=((INNER, 0), (CONTACT, 1), (cells // 3, cells)),
            second=((CONTACT, 0), (OUTER, 1), (cells // 3, 4 * cells // 3)),
        ),
        hypothesis="plane_strain",
        bodies=tuple(hhr.Body(tag, young, poisson) for tag in (FIRST, SECOND)),
        contacts=(hhr.Mortar(side(FIRST, 0, True), side(SECOND, 0, False)),),
        displacements=tuple(
            hhr.Displacement(side(body, 1, upper), 0 if upper else 1)
            for body in (FIRST, SECOND)
            for upper in (False, True)
        ),
        loads=(hhr.Pressure(side(FIRST, 0, False), hhr.Amplitude(slopes={"p": 1.0})),),
        parameters=hhr.ParameterSpace(("p",), (0.0,), (2 * PRESSED,)),
    )
    with warnings.catch_warnings():
        # the gap between polygons on one circle is one of the mesh: that is what the test is about
        warnings.simplefilter("ignore", PairingWarning)
        full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    answer, points = full.solve(PRESSED), full.problem.points
    # Lame, of one ring without a joint, since both are of one material
    share = PRESSED * INNER**2 / (OUTER**2 - INNER**2)
    r = np.linalg.norm(points, axis=1)
    radial = (1 + poisson) / young * share * ((1 - 2 * poisson) * r + OUTER**2 / r)
    exact = (points * (radial / r)[:, None]).ravel()
    wrong = answer.displacement() - exact
    pressure = answer.forces() / full.problem.contact_areas
    off = pressure - share * (OUTER**2 / CONTACT**2 - 1)
    return float(np.sqrt(wrong @ (full.problem.mass @ wrong))), float(
        np.sqrt(full.problem.contact_areas @ off**2)
    )


def rates(quick: bool) -> Iterator[Row]:
    """V6.03.150: orders of convergence on a curved surface, by four meshes each twice as fine."""
    counts = (12, 24, 48) if quick else (12, 24, 48, 96)
    errors = np.array([rings(count) for count in counts])
    orders = np.polyfit(np.log(1 / np.array(counts)), np.log(errors), 1)[0]
    for name, least, order in zip(("displacement", "pressure"), (2.0, 0.5), orders, strict=True):
        yield row(
            "V6.03.150",
            f"order of convergence, {name}: at least",
            least,
            float(order),
            "code_aster V6.03.150, E",
        )


def rates_of_second_order(quick: bool) -> Iterator[Row]:
    """V6.03.150 with curved cells of second order, three meshes each twice as fine."""
    sizes = (0.4, 0.2) if quick else (0.4, 0.2, 0.1, 0.05)
    for cells in ("triangles", "quadrilaterals"):
        errors = [ring_errors(size, 2, quadrilaterals=cells == "quadrilaterals") for size in sizes]
        for name, least in (("displacement", 2.5), ("pressure", 1.0)):
            order = np.polyfit(np.log(sizes), np.log([found[name] for found in errors]), 1)[0]
            what = f"order of convergence, {name}, {cells} of second order: at least"
            yield row("V6.03.150", what, least, float(order), "code_aster V6.03.150, E")


def told(found: Row) -> dict[str, str]:
    """A line as text: six digits, and the difference in per cent."""
    return {
        name: f"{value:+.2e} %"
        if name == "off"
        else f"{value:.6g}"
        if isinstance(value, float)
        else value
        for name, value in (found | {"off": 100 * found["off"]}).items()
    }


def main() -> None:
    """Run all of them, print and write the table."""
    from parts import cli

    from hhr_dolfinx.plugins.studies import report

    options = cli.parse_on_first_rank(cli.demo_parser("benchmarks", __doc__))
    runs = (
        line_contact,
        lambda quick: line_contact(quick, 2),
        ball,
        patch,
        rates,
        rates_of_second_order,
    )
    rows = [found for run in runs for found in run(options.quick)]
    report.write_report(
        {"scene": "benchmarks", "benchmarks": rows, **report.environment()}, options.out
    )
    cli.print_rows("published benchmarks", [told(found) for found in rows], options.console)


if __name__ == "__main__":
    main()
