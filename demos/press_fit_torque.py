"""Hub shrunk on a hollow shaft, in space: the torque that friction bears until all of it slips.

The hub ends in a flange that is clamped, the shaft is turned at its other end. Parameters are the
turn, the interference, the coefficient of friction, how much warmer the hub is, its Young's
modulus, and the thickness of its wall, which moves the mesh. A design is loaded as it is built:
shrunk, heated, then turned.

    S(μ) x >= -g,  |τ| <= f λ        at each contact; S of 1,400 rows, interpolated between walls,
    exact in E M = 2 π R² L f p                 with Lame's p of long rings, for what slips as a
    whole

What to see: shrinking alone slides the fit along its axis, so that it yields from the first turn
on, most where it is turned, and slip turns from along to around until torque grows no more. It is
above what Lame's pressure says, since flange and shaft go on where the fit ends. The full order
makes S once for a design, and solves increments as the condensed model does.

    python demos/press_fit_torque.py [--out DIR] [--quick] [--seed N]
"""

from typing import Any

import numpy as np

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side, two_blocks

HUB, SHAFT = FIRST, SECOND
BORE_OF_HUB, FREE_BORE = side(HUB, 0, False), 1
"""Facet tags of what lies on the shaft, and of the flange's."""
RADIUS, BORE, LENGTH, FLANGE, OVERHANG, WALL = 20.0, 8.0, 15.0, 10.0, 5.0, 10.0
SHAFT_E, POISSON, EXPANSION = 210e3, 0.3, 1.2e-5
RHO = "sqrt(x**2 + y**2)"
SCALE = f"({RADIUS} + ({RHO} - {RADIUS}) * wall / {WALL}) / {RHO}"
NAMES = ("twist", "interference", "friction", "warmer", "E_hub", "wall")
LOWER, UPPER = (0.0, 0.01, 0.05, 0.0, 70e3, 8.0), (2e-3, 0.03, 0.3, 30.0, 210e3, 14.0)


def geometry(comm: Any, around: int = 32, along: int = 14, radial: int = 6) -> Any:
    """Rings of hexahedra whose facets lie on each other: ``along`` cells on the length of the
    fit.
    """
    from dolfinx import mesh as dmesh  # behind hhr_dolfinx, which finds it

    def warp(points: np.ndarray, _: int) -> np.ndarray:
        angle = 2 * np.pi * points[:, 1]
        return np.column_stack(
            [points[:, 0] * np.cos(angle), points[:, 0] * np.sin(angle), points[:, 2]]
        )

    cell = LENGTH / along
    flange, over = round(FLANGE / cell), round(OVERHANG / cell)
    hub = (
        (RADIUS, 0.0, -flange * cell),
        (RADIUS + WALL, 1.0, LENGTH),
        (radial, around, along + flange),
    )
    shaft = (BORE, 0.0, 0.0), (RADIUS, 1.0, LENGTH + over * cell), (radial, around, along + over)
    mesh, cells, facets = two_blocks(comm, first=hub, second=shaft, warp=warp, closed=1)
    values = facets.values.copy()
    beyond = dmesh.compute_midpoints(mesh, 2, facets.indices)[:, 2] < 0
    values[beyond & (values == BORE_OF_HUB)] = FREE_BORE
    return mesh, cells, dmesh.meshtags(mesh, 2, facets.indices, values)


def scene(**mesh: int) -> hhr.Scene:
    """The scene in mm, MPa and kelvins."""
    end, twist = side(SHAFT, 2, True), hhr.Amplitude(slopes={"twist": 1.0})
    return hhr.Scene(
        name="press_fit_torque",
        geometry=lambda comm: geometry(comm, **mesh),
        hypothesis="solid",
        bodies=(hhr.Body(HUB, "E_hub", POISSON), hhr.Body(SHAFT, SHAFT_E, POISSON)),
        contacts=(hhr.Mortar(BORE_OF_HUB, side(SHAFT, 0, True), friction="friction"),),
        parameters=hhr.ParameterSpace(NAMES, LOWER, UPPER),
        displacements=(
            *hhr.Displacement.clamp(side(HUB, 2, False), 3),
            hhr.Displacement(end, 0, twist, "-y"),
            hhr.Displacement(end, 1, twist, "x"),
            hhr.Displacement(end, 2),
        ),
        loads=(hhr.ThermalExpansion(HUB, EXPANSION, "warmer"),),
        openings=(hhr.Opening(0, hhr.Amplitude(slopes={"interference": -1.0})),),
        shapes=(hhr.Shape(HUB, (f"x * {SCALE}", f"y * {SCALE}", "z")),),
        outputs=(
            hhr.ContactMoment("torque", 0, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), unit="N mm"),
            hhr.LargestSlip("largest slip", 0, unit="mm"),
            hhr.SlipArea("slipping", 0, unit="mm2"),
        ),
    )


def main() -> None:
    """Condense, compare designs with the full order, study a thousand, draw."""
    from parts import cli

    from hhr_dolfinx.plugins.studies import report

    parser = cli.demo_parser("press_fit_torque", __doc__)
    parser.add_argument(
        "--designs", type=int, default=5, help="designs that the full order answers (%(default)s)"
    )
    parser.add_argument(
        "--cases", type=int, default=1000, help="designs of the study (%(default)s)"
    )
    options = cli.parse_on_first_rank(parser)
    from parts import press_fit_torque_study

    mesh = {"around": 12, "along": 6, "radial": 2} if options.quick else {}
    found = press_fit_torque_study.study(scene(**mesh), options)
    report.write_report(
        {"scene": "press_fit_torque", "seed": options.seed, **found, **report.environment()},
        options.out,
    )
    torque, times = found["friction"]["torque"], found["times"]
    options.console.print(
        f"torque at slip of {torque['designs']} designs: errors {torque['mean']:.1e} in the mean, "
        f"{torque['max']:.1e} at most; an increment {times['fom_best']['median']:.2f} s, "
        f"condensed {times['online']['median']:.3f} s, {found['ratios']['fom_best/online']:.0f} "
        "times"
    )


if __name__ == "__main__":
    main()
