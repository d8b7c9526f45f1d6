"""Fuel pellet that yields in a cladding that creeps: a history in time, thesis section 6.2.

The pressure on the lowest 0.9 mm of the cladding grows to 450 MPa within a second, in 40 steps. The
parameter is the initial gap in [5, 15] um. Trained on the two ends of it, compared at 10 and 12.5
um and at four random gaps.

    ∫ σ : ε(v) r + λ·B v = l(v),    σ = C (ε(u) - ε_p),    dε_p/dt = f(σ)    at each Gauss point
    (6.1)-(6.4) pellet: σ_eq <= σ_y + H p;  cladding: dp/dt = (σ_eq / K)^n. Reduced, laws are
    evaluated on the RID only (6.17).

What to see: constitutive laws are evaluated on a fifth of the cells, and a history takes a tenth of
the time. Too small a RID converges to a wrong path with the smallest residuals; eigenvalues of the
projected tangents tell beforehand. Condensed flow, which keeps all contact conditions, evaluates
them on few points; the report says which of both to use.

    python benchmarks/thesis/pellet_cladding_plastic.py [--out DIR] [--quick] [--seed N] [--exponent
    5] [--paths]
        [--train 5 7.5 15 --pod 1e-11 --layers 6]
    python benchmarks/thesis/pellet_cladding_plastic.py --family [--out DIR] [--quick]

The last one (20 minutes) trains on 12 paths of a family, in which the cladding is loaded to any
height at any pace, held, unloaded and loaded again, and compares on 20 others. Their steps are cut
where they would be more than 2 % off in time; the report says how far the steps of the full order
are from shorter ones.
"""

import pathlib
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from pellet_cladding import QUICK_MESH, VIEW
from pellet_families import PRESSURE, SPACE

import hhr_dolfinx as hhr
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.geometries import pellet_cladding as geometry
from hhr_dolfinx.models.answer import Path

HEIGHT, NOMINAL = 0.9, 10e-3


def scene(exponent: float = 4.0, **mesh_options: Any) -> hhr.Scene:
    """The scene in mm, MPa and s; the mesh has the nominal gap, and the parameter opens or closes
    it.
    """
    mesh_options = {"cladding_axial_cells": 76, **mesh_options}
    held = (geometry.PELLET_BOTTOM, geometry.CLADDING_BOTTOM, geometry.CLADDING_TOP)
    return hhr.Scene(
        name="pellet_cladding_plastic",
        geometry=lambda comm: geometry.pellet_cladding(comm, gap=NOMINAL, **mesh_options),
        hypothesis="axisymmetric",
        bodies=(
            hhr.Body(geometry.PELLET, 190e3, 0.3, hhr.Plasticity(yield_stress=80.0, hardening=1e3)),
            hhr.Body(geometry.CLADDING, 78e3, 0.34, hhr.Norton(resistance=1e3, exponent=exponent)),
        ),
        contacts=(
            hhr.NodeToSurface(geometry.PELLET_SIDE, geometry.CLADDING_INNER, normal=(1.0, 0.0)),
        ),
        parameters=SPACE,
        displacements=(
            hhr.Displacement(geometry.PELLET_AXIS, 0),
            *(hhr.Displacement(tag, 1) for tag in held),
        ),
        loads=(
            hhr.PartialPressure(
                geometry.CLADDING_OUTER, hhr.Amplitude(slopes={"P1": 1.0}), extent="h1"
            ),
        ),
        openings=(hhr.Opening(contact=0, amplitude=hhr.Amplitude(-NOMINAL, {"gap": 1.0})),),
    )


def path(gap: float, steps: int = 40) -> Path:
    """Times and parameters of the history for a gap in um, the start first."""
    shares = np.arange(steps + 1) / steps
    return history(shares, shares, gap)


def history(
    times: Sequence[float], shares: Sequence[float], gap: float, height: float = HEIGHT
) -> Path:
    """Times and parameters: the pressure as shares of the largest one, a gap in um and a height in
    mm.
    """
    return [
        (float(time), np.array([PRESSURE * share, height, gap * 1e-3]))
        for time, share in zip(times, shares, strict=True)
    ]


def pressed_nodes(problem: ContactProblem) -> np.ndarray:
    """Nodes of the cladding under pressure, which are part of the RID (section 6.2.3)."""
    r, z = problem.points.T
    return np.flatnonzero((r > r.max() * (1 - 1e-9)) & (z <= HEIGHT))


def recipe(tolerance: float = 3e-10, layers: int = 3) -> hhr.Recipe:
    """The recipe of section 6.2.3, with the pressed nodes as zone of interest."""
    nodes = hhr.Recipe.flowing().nodes[:-1]
    return hhr.Recipe.flowing(
        basis=hhr.Pod(tolerance),
        nodes=(*nodes, hhr.Zone(pressed_nodes)),
        domain=hhr.Rid(layers, 8),
    )


def main() -> None:
    """Train, compare, time full and reduced in turns, report."""
    sys.path.append(str(pathlib.Path(__file__).parents[2] / "demos"))
    from parts import cli

    parser = cli.demo_parser("pellet_cladding_plastic", __doc__)
    parser.add_argument(
        "--exponent", type=float, default=4.0, help="exponent of Norton's law (%(default)s)"
    )
    parser.add_argument(
        "--pod",
        type=float,
        default=3e-10,
        help="tolerance of the POD of displacements (%(default)s)",
    )
    parser.add_argument(
        "--layers", type=int, default=3, help="layers of cells to begin with (%(default)s)"
    )
    parser.add_argument(
        "--train", type=float, nargs="+", default=[5.0, 15.0], help="gaps to train on in um"
    )
    parser.add_argument(
        "--paths", action="store_true", help="try 20 paths inside and 40 outside what was trained"
    )
    parser.add_argument(
        "--family", action="store_true", help="train and test on a family of paths, not on gaps"
    )
    options = cli.parse_on_first_rank(parser)
    from pellet_plastic_study import (
        print_family,
        print_gaps,
        settings_of_family,
        settings_of_gaps,
        try_paths,
    )

    if options.family and options.paths:
        parser.error("--paths are told apart by what gaps alone train: leave out --family")
    quick_mesh = {**QUICK_MESH, "cladding_axial_cells": 15, "cladding_radial_cells": 3}
    built, steps = (
        scene(options.exponent, **(quick_mesh if options.quick else {})),
        10 if options.quick else 40,
    )
    settings = (
        settings_of_family(options, steps) if options.family else settings_of_gaps(options, steps)
    )
    study = hhr.study_scene(built, settings, options.out, progress=options.progress)
    if options.paths:
        try_paths(study, options)
    study.write(options.out, options.console, VIEW())
    if options.family:
        print_family(study, options)
        return
    print_gaps(study, options)


if __name__ == "__main__":
    main()
