"""Cells of second order beside linear ones: forces at equal dofs, pressures between curved rings,
reduction errors.

A block is pushed into a rigid bowl; errors of its force are beside hexahedra, or quadrilaterals, of
second order on a finer mesh. Two rings press on each other, on meshes that do not match; Lame's
pressure is the reference. Scenes of the demos are trained and reduced with displacements of either
order.

    python benchmarks/second_order.py [--out DIR] [--quick] [--seed N]
"""

from __future__ import annotations

import dataclasses
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import _demos  # noqa: F401 (before the scenes)
import hertz_half_discs as hertz
import numpy as np
import sphere_on_block as sphere
import your_scene
from mpi4py import MPI

import hhr_dolfinx as hhr
from hhr_dolfinx.compat import NamedMesh
from hhr_dolfinx.contact.rows import ContactRows
from hhr_dolfinx.errors import PairingWarning
from hhr_dolfinx.geometries import block
from hhr_dolfinx.pairings.surface import Surface, nodal_rows

LINES = "x0", "y0"
LAME = 5 / 32
"""Pressure between rings of 1 to 2 and 2 to 3 under a unit one inside: that in a tube of 1 to 3 at
2.
"""
PUSH = 0.05


@dataclass(frozen=True)
class Bowl:
    """A rigid bowl above a flat surface, which it touches at the origin.

    Attributes:
        surface: facet tag.
    """

    surface: int

    @property
    def tags(self) -> tuple[int, ...]:
        """The surface."""
        return (self.surface,)

    def rows(self, surfaces: Sequence[Surface], dofs: int) -> ContactRows:
        """One for each node, averaged where cells are of second order."""
        (surface,) = surfaces
        count, dim = surface.points.shape
        gap = 0.1 * (surface.points[:, : dim - 1] ** 2).sum(axis=1)
        matrix = nodal_rows(
            surface.nodes[:, None], np.tile(np.eye(dim)[-1], (count, 1)), np.ones((count, 1)), dofs
        )
        return surface.averaged(
            ContactRows(matrix, gap, surface.nodes, surface.points, surface.areas)
        )


def bowl(cells: int, order: int, dim: int = 3, *, simplices: bool = True) -> hhr.Scene:
    """A unit block, a quarter of it in space, pushed into the bowl."""
    last = dim - 1
    push = hhr.Displacement(block.side(last, False), last, hhr.Amplitude(slopes={"push": 1.0}))
    lower, upper, counts = (0.0,) * dim, (1.0,) * dim, (cells,) * dim
    return hhr.Scene(
        "bowl",
        lambda comm: block.block(comm, lower=lower, upper=upper, cells=counts, simplices=simplices),
        "solid" if dim == 3 else "plane_strain",
        (hhr.Body(block.SOLID, 1.0, 0.3),),
        (Bowl(block.side(last, True)),),
        hhr.ParameterSpace(("push",), (0.0,), (0.1,)),
        displacements=(
            *(hhr.Displacement(block.side(axis, False), axis) for axis in range(last)),
            push,
        ),
        order=order,
    )


YOUNG, POISSON = 200.0, 0.3
"""Of the rings."""


def rings(size: float, order: int, *, quadrilaterals: bool = False) -> hhr.Scene:
    """Quarters of two rings, 1 to 2 and 2 to 3, whose meshes do not match where they press on each
    other.
    """
    from hhr_dolfinx.geometries.gmsh_model import gmsh, mesh_of

    def ring(inner: float, outer: float) -> int:
        occ = gmsh.model.occ
        whole, hole = (occ.addDisk(0, 0, 0, radius, radius) for radius in (outer, inner))
        cut = occ.cut([(2, whole)], [(2, hole)])[0]
        return occ.intersect(cut, [(2, occ.addRectangle(0, 0, 0, 4, 4))])[0][0][1]

    def make() -> None:
        made = ring(1, 2), ring(2, 3)
        gmsh.model.occ.synchronize()
        for name, tag, spacing in zip(("inner", "outer"), made, (size, 1.3 * size), strict=True):
            gmsh.model.addPhysicalGroup(2, [tag], name=name)
            for _, curve in gmsh.model.getBoundary([(2, tag)], oriented=False):
                low_x, low_y, _, high_x, high_y, _ = gmsh.model.getBoundingBox(1, curve)
                flat = {high_x - low_x: "x0", high_y - low_y: "y0"}
                word = flat[min(flat)] if min(flat) < 1e-3 else f"r{round(high_x)}"
                gmsh.model.addPhysicalGroup(1, [curve], name=f"{name} {word}")
                length = gmsh.model.occ.getMass(1, curve)
                if quadrilaterals and word[0] == "r":  # as many along both arcs
                    length = np.pi / 2 * (1.5 if name == "inner" else 2.5)
                count = max(2, round(length / spacing))
                gmsh.model.mesh.setTransfiniteCurve(curve, 1 + count)
            if quadrilaterals:
                gmsh.model.mesh.setTransfiniteSurface(tag)
                gmsh.model.mesh.setRecombine(2, tag)
        gmsh.model.mesh.generate(2)
        gmsh.model.mesh.setOrder(order)

    held = (
        hhr.Displacement(f"{body} {line}", "xy".index(line[0]))
        for body in ("inner", "outer")
        for line in LINES
    )
    return hhr.Scene(
        "rings",
        lambda comm: mesh_of(make, comm, 2),
        "plane_strain",
        (hhr.Body("inner", YOUNG, POISSON), hhr.Body("outer", YOUNG, POISSON)),
        (hhr.Mortar("inner r2", "outer r2"),),
        hhr.ParameterSpace(("p",), (0.1,), (1.0,)),
        displacements=tuple(held),
        loads=(hhr.Pressure("inner r1", hhr.Amplitude(slopes={"p": 1.0})),),
    )


def force_rows(dim: int, cells: Sequence[int], fine: int) -> list[dict[str, Any]]:
    """Errors of the force in a bowl at equal dofs, and seconds from nothing to an answer."""
    exact = _pushed(bowl(fine, 2, dim, simplices=False))[1]
    rows = []
    for simplices in (True, False):
        for count in cells:
            for order in (1, 2):
                dofs, force, seconds = _pushed(
                    bowl(count // order, order, dim, simplices=simplices)
                )
                kind = {2: ("quadrilaterals", "triangles"), 3: ("hexahedra", "tetrahedra")}[dim][
                    simplices
                ]
                rows.append(
                    {
                        "cells": kind,
                        "order": order,
                        "N": dofs,
                        "force": force / exact - 1,
                        "seconds": seconds,
                    }
                )
    return rows


def _pushed(scene: hhr.Scene) -> tuple[int, float, float]:
    """Dofs, contact force and seconds of one answer."""
    start = time.perf_counter()
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    force = float(full.solve({"push": PUSH}).forces().sum())
    return len(full.problem.free), force, time.perf_counter() - start


def ring_errors(size: float, order: int, *, quadrilaterals: bool = False) -> dict[str, float]:
    """Errors of two rings: of the pressure the largest, the mean and that in L2, of the
    displacement that in L2.

    Both rings are of one material, so that Lame's solution of a tube from 1 to 3 holds for them.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PairingWarning)  # gaps between polygons on one circle
        full = hhr.FullOrderModel(rings(size, order, quadrilaterals=quadrilaterals), MPI.COMM_SELF)
    answer = full.solve({"p": 1.0})
    areas = full.problem.contact_areas
    off = answer.forces() / areas / LAME - 1
    points = full.problem.points
    r = np.linalg.norm(points, axis=1)
    radial = (1 + POISSON) / YOUNG / 8 * ((1 - 2 * POISSON) * r + 9 / r)
    exact = (points * (radial / r)[:, None]).ravel()
    wrong = answer.displacement() - exact
    mass = full.problem.mass
    return {
        "largest": float(np.abs(off).max()),
        "mean": float(np.abs(off) @ areas / areas.sum()),
        "pressure": float(np.sqrt(areas @ off**2 / areas.sum())),
        "displacement": float(np.sqrt((wrong @ (mass @ wrong)) / (exact @ (mass @ exact)))),
    }


def ring_rows(sizes: Sequence[float]) -> list[dict[str, Any]]:
    """These errors on meshes of either order."""
    return [
        {"cells": cells, "order": order, "size": size}
        | ring_errors(size, order, quadrilaterals=cells == "quadrilaterals")
        for cells in ("triangles", "quadrilaterals")
        for order in (1, 2)
        for size in sizes
    ]


SCENES: dict[str, Callable[[], hhr.Scene]] = {
    "hertz_half_discs": hertz.scene,
    "sphere_on_block": lambda: sphere.scene(**sphere.QUICK_MESH),
    "your_scene": your_scene.scene,
}


FINER: dict[str, Callable[[], hhr.Scene]] = {
    "hertz_half_discs": lambda: hertz.scene(arc_segments=112, flat_segments=28),
    "sphere_on_block": lambda: sphere.scene(
        sphere_cells=(20, 10), block_cells=(16, 8), grading=2.5
    ),
    "your_scene": lambda: refined(your_scene.scene()),
}


def refined(scene: hhr.Scene) -> hhr.Scene:
    """A scene on a mesh whose triangles are cut in four: as many dofs as of second order on the
    mesh itself.
    """
    from dolfinx import mesh

    def made(comm: Any) -> Any:
        read: Any = scene.geometry(comm)
        whole, cell_tags, facet_tags = read
        whole.topology.create_entities(1)
        both = mesh.RefinementOption.parent_cell_and_facet
        finer, cell, facet = mesh.refine(whole, option=both)
        for dim in (1, 2):
            finer.topology.create_entities(dim)
        finer.topology.create_connectivity(1, 2)
        cells = mesh.transfer_meshtag(cell_tags, finer, cell)
        facets = mesh.transfer_meshtag(facet_tags, finer, cell, facet)
        return NamedMesh(finer, cells, facets, read.physical_groups)

    return dataclasses.replace(scene, geometry=made)


def reduction_rows(names: Sequence[str], seed: int) -> list[dict[str, Any]]:
    """95th percentiles of the errors of reduced models on answers held out: of either order, and at
    equal dofs.
    """
    rows = []
    for name in names:
        for mesh, order in (("as it is", 1), ("as it is", 2), ("twice as fine", 1)):
            scene = FINER[name]() if mesh == "twice as fine" else SCENES[name]()
            scene = dataclasses.replace(scene, order=order)
            training = hhr.train(scene, hhr.Sobol(64, seed=seed), held_out=40, comm=MPI.COMM_SELF)
            model = training.build()
            compared = model.offline.comparison
            high = {
                what: float(np.quantile(getattr(compared, what), 0.95))
                for what in ("primal", "dual")
            }
            sizes = {
                "N": len(training.full_order.problem.free),
                "modes": len(model.problem.stiffness),
            }
            sizes["conditions"] = training.full_order.conditions
            rows.append({"scene": name, "mesh": mesh, "order": order, **sizes, **high})
    return rows


def main() -> None:
    """Compare, print, report."""
    from parts import cli

    from hhr_dolfinx.plugins.studies import report

    options = cli.parse_on_first_rank(cli.demo_parser("second_order", __doc__))
    quick = options.quick
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # chords of coarse rings, and small trainings
        found = {
            "force": [
                *force_rows(2, (16,) if quick else (16, 32, 64), 32 if quick else 64),
                *force_rows(3, (8,) if quick else (8, 12, 16, 20), 8 if quick else 12),
            ],
            "rings": ring_rows((0.4, 0.2) if quick else (0.4, 0.2, 0.1, 0.05)),
            "reduction": reduction_rows(
                ("hertz_half_discs",) if quick else tuple(SCENES), options.seed
            ),
        }
    for name, rows in found.items():
        shown = [
            {
                key: value if isinstance(value, str | int) else f"{value:.2g}"
                for key, value in row.items()
            }
            for row in rows
        ]
        cli.print_rows(name, shown, options.console)
    report.write_report({"scene": "second_order", **found, **report.environment()}, options.out)


if __name__ == "__main__":
    main()
