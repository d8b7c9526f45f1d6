"""Contact patch test: which pairing passes a constant pressure between meshes that do not match.

Two stacked blocks are pressed together with Poisson's ratio zero, so that the pressure is uniform
and known. Mortar passes to round-off for any pair of meshes; node-to-surface does not (R. L. Taylor
and P. Papadopoulos, "On a patch test for contact problems in two dimensions", 1991); two passes
give the right stress, but share out multipliers uselessly.

    python benchmarks/contact_patch_test.py [--out DIR] [--quick] [--seed N]
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import _demos  # noqa: F401
import numpy as np
from mpi4py import MPI
from verify import recorded_warnings

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import stacked_blocks as geometry

YOUNG, PUSH = {geometry.LOWER_BLOCK: 3.0, geometry.UPPER_BLOCK: 7.0}, 0.05
PRESSURE = PUSH / sum(1 / young for young in YOUNG.values())


def pair(name: str, *tags: Any, **options: Any) -> Any:
    """A pair of a plug-in, which is asked for when a scene is made."""
    return getattr(hhr, name)(*tags, **options)


mortar, node_to_surface, double_pass = (
    partial(pair, name) for name in ("Mortar", "NodeToSurface", "DoublePass")
)
PAIRINGS = {"node_to_surface": node_to_surface, "double_pass": double_pass, "mortar, dual": mortar}
PAIRINGS["mortar, standard"] = partial(mortar, multipliers="standard")


def scene(
    pairing: Callable[..., Any] = mortar,
    lower: tuple[int, ...] = (3, 3),
    upper: tuple[int, ...] = (5, 4),
    poisson: float = 0.0,
    by_normal: bool = True,
    slave: int = geometry.UPPER_BLOCK,
    **shape: Any,
) -> hhr.Scene:
    """The lower block clamped, the upper pushed down by its top and aside.

    ``shape``: :func:`stacked_blocks`.
    """
    dim, master, turn = (
        len(lower),
        3 - slave,
        geometry.rotation(len(lower), shape.get("angle", 0.0)),
    )
    towards = turn[:, -1] if slave == geometry.LOWER_BLOCK else -turn[:, -1]
    tags = geometry.interface(slave, dim), geometry.interface(master, dim)
    down = {geometry.LOWER_BLOCK: np.zeros(dim), geometry.UPPER_BLOCK: -turn[:, -1]}
    moves = tuple(
        hhr.Displacement(geometry.outer_end(body, dim), k, hhr.Amplitude(slopes={"push": way[k]}))
        for body, way in down.items()
        for k in range(dim)
    )
    aside = hhr.Amplitude(slopes={"side": 1.0})
    return hhr.Scene(
        name="stacked_blocks",
        geometry=lambda comm: geometry.stacked_blocks(comm, lower=lower, upper=upper, **shape),
        hypothesis="plane_strain" if dim == 2 else "solid",
        bodies=tuple(hhr.Body(tag, young, poisson) for tag, young in YOUNG.items()),
        contacts=(pairing(*tags, tuple(towards) if by_normal else None),),
        parameters=hhr.ParameterSpace(("push", "side"), (0.0, 0.0), (0.1, 0.05)),
        displacements=moves,
        loads=(
            hhr.Traction(geometry.side(geometry.UPPER_BLOCK, 0, False), tuple(turn[:, 0]), aside),
        ),
    )


def solve(built: hhr.Scene) -> tuple[np.ndarray, np.ndarray, float]:
    """Positions along the first axis, nodal pressures over the exact one, and the largest relative
    stress error.
    """
    full = hhr.FullOrderModel(built, MPI.COMM_SELF)
    problem, answer = full.problem, full.solve([PUSH, 0.0])
    pressure = answer.forces() / problem.contact_areas / PRESSURE
    error = np.abs(answer.stress()[:, problem.block_size - 1] / -PRESSURE - 1).max()
    return problem.contact_points[:, 0], pressure, float(error)


def main() -> None:
    """Measure all pairings on several meshes, print a table, draw the pressures."""
    from parts import cli

    from hhr_dolfinx.plugins.studies import plots, report

    options = cli.parse_on_first_rank(cli.demo_parser("contact_patch_test", __doc__))
    meshes = {"3 on 5": ((3, 3), (5, 4)), "5 on 3": ((5, 4), (3, 3)), "7 on 8": ((7, 4), (8, 4)),
              "1 on 20": ((1, 2), (20, 6)), "20 on 1": ((20, 6), (1, 2))}  # fmt: skip
    if not options.quick:
        meshes |= {
            "4 x 4 on 6 x 6": ((4, 4, 3), (6, 6, 3)),
            "6 x 6 on 4 x 4": ((6, 6, 3), (4, 4, 3)),
        }
    rows, curves = [], {}
    for mesh, cells in meshes.items():
        for name, pairing in PAIRINGS.items():
            with recorded_warnings() as warned:
                where, pressure, stress = solve(scene(pairing, *cells))
            figures = {"stress": stress, "pressure": float(np.abs(pressure - 1).max())}
            rows.append({"mesh": mesh, "pairing": name, **figures, "warned": warned})
            if mesh == "7 on 8" and name != "double_pass":
                curves[name] = where, pressure
    written = {"scene": "contact_patch_test", "seed": options.seed, "pairings": rows}
    report.write_report({**written, **report.environment()}, options.out)
    cli.print_rows("largest error of stress and pressure", rows, options.console)
    plots.plot_curves(
        curves, options.out / "pressures.png", ("position along the interface", "pressure / exact")
    )


if __name__ == "__main__":
    main()
