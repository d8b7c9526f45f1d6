"""Contact patch test: which pairing passes a constant pressure between meshes that do not match.

Two stacked blocks are pressed together with Poisson's ratio zero, so that the pressure is uniform and known.
Mortar passes to round-off for any pair of meshes; node-to-surface does not, which is a known defect of the method
(R. L. Taylor and P. Papadopoulos, "On a patch test for contact problems in two dimensions", 1991) and shown here. Two
passes give the right stress, with multipliers shared out between both sides in no useful way.

    python demos/contact_patch_test.py [--out DIR] [--quick] [--seed N]
"""

import json
import warnings

import numpy as np
from mpi4py import MPI
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import two_blocks as geometry
from hhr_dolfinx.study.cli import demo_parser

YOUNG = {geometry.FIRST: 3.0, geometry.SECOND: 7.0}
PUSH = 0.05
PRESSURE = PUSH / sum(1 / young for young in YOUNG.values())
"""Of two blocks of height 1 with nu = 0 under PUSH."""


def standard_mortar(*args):
    """Mortar with standard multipliers."""
    return hhr.Mortar(*args, multipliers="standard")


PAIRINGS = {
    "node_to_surface": hhr.NodeToSurface,
    "double_pass": hhr.DoublePass,
    "mortar, dual": hhr.Mortar,
    "mortar, standard": standard_mortar,
}


def rotation(dim, angle):
    """Matrix of a turn by an angle, in space about the diagonal."""
    return Rotation.from_rotvec(angle * (np.array([0, 0, 1.0]) if dim == 2 else np.ones(3) / 3**0.5)).as_matrix()[
        :dim, :dim
    ]


def scene(pairing=hhr.Mortar, lower=(3, 3), upper=(5, 4), *, poisson=0.0, angle=0.0, bulge=0.0, simplices=False,
          by_normal=True, slave=geometry.SECOND, shift=0.0):  # fmt: skip
    """Two stacked blocks of edge 1, the lower clamped, the upper pushed down by its top and pushed aside.

    Args:
        pairing: makes a pairing of slave, master and normal.
        lower, upper: cells of the blocks along each axis.
        poisson: Poisson's ratio of both.
        angle: turns the whole scene.
        bulge: height of the curved gap between the blocks, at their sides.
        simplices: triangles or tetrahedra.
        by_normal: give the pairing its normal, or None.
        slave: body that carries the multipliers.
        shift: moves the upper block sideways, beyond the edge of the lower.
    """
    dim, up = len(lower), len(lower) - 1
    turn, axis = rotation(dim, angle), np.eye(dim)[up]
    towards = turn @ (axis if slave == geometry.FIRST else -axis)
    tags = {body: geometry.side(body, up, body == geometry.FIRST) for body in (geometry.FIRST, geometry.SECOND)}
    master = geometry.FIRST if slave == geometry.SECOND else geometry.SECOND
    pair = pairing(tags[slave], tags[master], tuple(towards) if by_normal else None)

    def warp(points, body):
        points = points.copy()
        if body == geometry.SECOND:
            points[:, 0] += shift
            away = np.sum((points[:, :up] - 0.5) ** 2, axis=1)
            points[:, up] += 4 * bulge * away * (2 - points[:, up])
        return points @ turn.T

    ends = (geometry.side(geometry.FIRST, up, False), geometry.side(geometry.SECOND, up, True))
    moves = (np.zeros(dim), -(turn @ axis))
    boxes = [((0.0,) * up + (float(k),), (1.0,) * up + (k + 1.0,), cells) for k, cells in enumerate((lower, upper))]
    return hhr.Scene(
        name="stacked_blocks",
        geometry=lambda comm: geometry.two_blocks(
            comm, first=boxes[0], second=boxes[1], simplices=simplices, warp=warp
        ),
        hypothesis="plane_strain" if dim == 2 else "solid",
        bodies=tuple(hhr.Body(tag, young, poisson) for tag, young in YOUNG.items()),
        contacts=(pair,),
        parameters=hhr.ParameterSpace(("push", "side"), (0.0, 0.0), (0.1, 0.05)),
        displacements=tuple(
            hhr.Displacement(tag, k, hhr.Amplitude(slopes={"push": move[k]}))
            for tag, move in zip(ends, moves, strict=True)
            for k in range(dim)
        ),
        loads=(
            hhr.Traction(
                geometry.side(geometry.SECOND, 0, False),
                tuple(turn @ np.eye(dim)[0]),
                hhr.Amplitude(slopes={"side": 1.0}),
            ),
        ),
    )


def solve(built):
    """Positions along the first axis, nodal pressures over the exact one, and the largest relative stress error."""
    full_order = hhr.FullOrderModel(built, MPI.COMM_SELF)
    problem, solution = full_order.problem, full_order.solve([PUSH, 0.0])
    up = problem.block_size - 1
    stress = full_order.discretisation.stress(solution.primal)[:, up, up] / -PRESSURE
    pressure = solution.forces / problem.contact_areas / PRESSURE
    return problem.contact_points[:, 0], pressure, float(np.abs(stress - 1).max())


def main() -> None:
    """Measure all pairings on several meshes, print a table, draw the pressures."""
    options = demo_parser("contact_patch_test", __doc__.splitlines()[0]).parse_args()
    meshes = {"3 on 5": ((3, 3), (5, 4)), "5 on 3": ((5, 4), (3, 3)), "7 on 8": ((7, 4), (8, 4))}
    meshes |= {"1 on 20": ((1, 2), (20, 6)), "20 on 1": ((20, 6), (1, 2))}
    if not options.quick:
        meshes |= {"4 x 4 on 6 x 6": ((4, 4, 3), (6, 6, 3)), "6 x 6 on 4 x 4": ((6, 6, 3), (4, 4, 3))}
    table, rows = Table("master on slave", *PAIRINGS, title="largest error of the stress"), []
    for label, (lower, upper) in meshes.items():
        errors = []
        for name, pairing in PAIRINGS.items():
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                _, pressure, error = solve(scene(pairing, lower, upper))
            errors.append(error)
            row = {"mesh": label, "pairing": name, "stress": error, "pressure": float(np.abs(pressure - 1).max())}
            rows.append({**row, "warned": [str(item.message) for item in caught]})
        table.add_row(label, *(f"{error:.1e}" for error in errors))
    console = Console()
    console.print(table)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "contact_patch_test.json").write_text(json.dumps(rows, indent=2))
    picture(options.out / "pressures.png")
    console.print(f"figures and picture are in {options.out}")


def picture(path) -> None:
    """Nodal pressures along the interface of 7 on 8 cells."""
    from hhr_dolfinx.study import plots

    single = {name: pairing for name, pairing in PAIRINGS.items() if name != "double_pass"}
    curves = {name: solve(scene(pairing, (7, 4), (8, 4)))[:2] for name, pairing in single.items()}
    plots.plot_curves(curves, "position along the interface", "nodal pressure / exact pressure", path)


if __name__ == "__main__":
    main()
