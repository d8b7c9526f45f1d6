"""Size: seconds and memory from nothing to a model, and of a query, of a sphere on a block from 1e4
dofs on.

Push, squeeze and both Young's moduli vary; contact is condensed exactly, S made of blocks of
columns that are dropped where they have no room (a gigabyte). Each size is a process of its own,
for its peak of memory. ``gap_left`` is how far contact is from closed under the forces of an
answer, by one more solution of the full order, over the largest push: it sees what compressed
factors leave out of S, which the bound has to be larger than. Several ranks share one problem;
``schur_s`` and ``schur_gb`` are from nothing to S, and ``peak_gb`` is that of the largest of them,
and of all sizes so far.

With ``--reduced`` hyper-reduced models are trained and built by the ranks together, each with the
rows of its own dofs; with ``--flow`` the ranks march one history of the indentation, two steps to
half and all of the depth.

    [mpirun -n 2] python benchmarks/scale.py [--out DIR] [--quick] [--seed N] [--from N] [--up-to N]
    [--ratios]
                                             [--reduced | --flow]
"""

from __future__ import annotations

import dataclasses
import multiprocessing
import resource
import time
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import _demos  # noqa: F401 (before the scenes)
import numpy as np
import sphere_on_block as demo
from mpi4py import MPI
from parts import cli

import hhr_dolfinx as hhr
from hhr_dolfinx.linear.sparse import FreeCholesky
from hhr_dolfinx.plugins.studies import report
from hhr_dolfinx.timing import timed

MESHES = (
    (6, 3, 4, 2),
    (8, 4, 6, 3),
    (12, 6, 9, 4),
    (16, 8, 12, 6),
    (20, 10, 15, 7),
    (26, 13, 19, 9),
    (34, 17, 25, 12),
    (44, 22, 33, 16),
    (50, 25, 37, 18),
    (60, 30, 45, 22),
    (68, 46, 54, 36),
)
"""Cells of the sphere along its sides and through its depth, and of the block."""
MODULI = {"sphere": (150e3, 250e3), "block": (50e3, 90e3)}
RATIO = (0.25, 0.35)
"""Of Poisson, of both bodies, where they vary too: S is then interpolated in place of summed."""
QUERIES = 20
COLUMNS = (
    "N",
    "N_lambda",
    "ranks",
    "built_s",
    "schur_s",
    "schur_gb",
    "factor_s",
    "compliance_s",
    "train_s",
    "peak_gb",
    "query_s",
    "bound_s",
    "fields_s",
    "full_s",
)


def scene(sphere: tuple[int, int], block: tuple[int, int], *, ratios: bool = False) -> hhr.Scene:
    """The demo with moduli as parameters, and ratios of Poisson too."""
    plain = demo.scene(sphere_cells=sphere, block_cells=block)
    box = dict(
        zip(
            plain.parameters.names,
            zip(plain.parameters.lower, plain.parameters.upper, strict=True),
            strict=True,
        )
    )
    bodies = []
    for body, (name, young) in zip(plain.bodies, MODULI.items(), strict=True):
        own = {"young": f"E_{name}"} | ({"poisson": f"nu_{name}"} if ratios else {})
        bodies.append(dataclasses.replace(body, **own))
        box |= dict(zip(own.values(), (young, RATIO), strict=False))
    return dataclasses.replace(
        plain,
        bodies=tuple(bodies),
        parameters=hhr.ParameterSpace(tuple(box), *zip(*box.values(), strict=True)),
    )


def measured(
    cells: tuple[int, int, int, int], ratios: bool, comm: MPI.Comm = MPI.COMM_SELF
) -> dict[str, float]:
    """One row of the report, of processes that do nothing else."""
    from hhr_dolfinx.plugins.moduli.components import ComponentSolver

    spent = {"factor_s": 0.0, "compliance_s": 0.0}
    _watch(FreeCholesky, "__init__", "factor_s", spent)
    _watch(ComponentSolver, "__call__", "compliance_s", spent)
    start = time.perf_counter()
    own = hhr.FullOrderModel(scene(cells[:2], cells[2:], ratios=ratios), comm)
    built = time.perf_counter() - start
    assert np.isfinite(own.schur).all()
    schur = {"schur_s": time.perf_counter() - start, "schur_gb": _peak(comm)}
    full = own.gathered()
    model = hhr.condense(full, fields=True)
    made = time.perf_counter() - start
    points = full.parameters.random(QUERIES, 0)
    answers, forces = timed(lambda: [model.solve(point) for point in points])
    estimates, bounds = timed(lambda: [answer.estimate() for answer in answers])
    fields, completed = timed(lambda: [answer.displacement() for answer in answers[:3]])
    known, whole = timed(lambda: [full.solve(point) for point in points[:3]])
    sizes = {"N": len(full.problem.free), "N_lambda": full.conditions, "ranks": comm.size}
    times = {"built_s": built, "train_s": made, "peak_gb": _peak(comm)} | schur
    times |= {"query_s": forces / QUERIES, "bound_s": bounds / QUERIES}
    times |= {"fields_s": completed / 3, "full_s": whole / 3}
    errors = {
        "bound_of_forces": max(estimate.forces_euclid_relative for estimate in estimates),
        "bound_of_pressure": max(estimate.pressure_relative for estimate in estimates),
        "gap_left": max(gap_left(full, answer) for answer in known),
        "error_of_fields": max(
            _off(field, exact.displacement()) for field, exact in zip(fields, known, strict=True)
        ),
    }
    return sizes | {"columns_kept": full.keeps_columns} | spent | times | errors


SNAPSHOTS = 32
REDUCED = (
    "N",
    "N_lambda",
    "ranks",
    "modes",
    "conditions",
    "solved_s",
    "solved_gb",
    "basis_s",
    "rid_s",
    "enrichment_s",
    "projection_s",
    "bound_s",
    "train_s",
    "peak_gb",
    "query_s",
    "bound_of_forces",
)


def reduced(
    cells: tuple[int, int, int, int], ratios: bool, comm: MPI.Comm = MPI.COMM_SELF
) -> dict[str, float]:
    """One row of the report for a hyper-reduced model."""
    start = time.perf_counter()
    made = scene(cells[:2], cells[2:], ratios=ratios)
    training = hhr.train(made, hhr.Sobol(SNAPSHOTS), held_out=0, comm=comm, together=True)
    times = {"solved_s": time.perf_counter() - start, "solved_gb": _peak(comm)}
    model = training.build(checked=False)
    times |= {"train_s": time.perf_counter() - start, "peak_gb": _peak(comm)}
    stages = model.offline.log.times
    times |= {
        f"{name}_s": stages[name] for name in ("basis", "rid", "enrichment", "projection", "bound")
    }
    points = model.parameters.random(QUERIES, 0)
    answers, forces = timed(lambda: [model.solve(point, outside="ignore") for point in points])
    bound = max(answer.estimate().forces_euclid_relative for answer in answers)
    full = training.full_order
    sizes = {"N": len(full.problem.free), "N_lambda": full.conditions, "ranks": comm.size}
    sizes |= {"modes": len(model.problem.stiffness), "conditions": len(model.problem.gaps)}
    return sizes | times | {"query_s": forces / QUERIES, "bound_of_forces": bound}


BLOCKS = (10, 14, 19, 25, 34, 42)
"""Cells of the block of the indentation along a side."""
FLOWING = ("N", "N_lambda", "ranks", "built_s", "history_s", "iterations", "peak_gb")


def flowing(cells: int, _: bool, comm: MPI.Comm = MPI.COMM_SELF) -> dict[str, float]:
    """One row of the report for a history, the second one, as of a training: the first compiles
    what has to be.
    """
    import indentation

    full, built = timed(lambda: hhr.FullOrderModel(indentation.scene(cells), comm))
    low, high = np.array([full.parameters.lower, full.parameters.upper])
    middle = (low + high) / 2
    path = [
        (float(k), np.array([depth * high[0], *middle[1:]]))
        for k, depth in enumerate((0.0, 0.5, 1.0))
    ]
    full.march(path)
    comm.Barrier()
    history, seconds = timed(lambda: full.march(path))
    iterations = sum(answer.iterations for answer in history.answers)
    sizes = {"N": len(full.problem.free), "N_lambda": full.conditions, "ranks": comm.size}
    return sizes | {
        "built_s": built,
        "history_s": seconds,
        "iterations": iterations,
        "peak_gb": _peak(comm),
    }


def expected_dofs(mesh: Any) -> int:
    """Dofs of the sphere and the block, by their cells; of the indentation by those of its
    block.
    """
    if isinstance(mesh, int):
        import indentation

        block = indentation.geometry.indentation_cells(mesh)
        mesh = (*block["sphere_cells"], *block["block_cells"])
    return 3 * sum((side + 1) ** 2 * (depth + 1) for side, depth in (mesh[:2], mesh[2:]))


def _peak(comm: MPI.Comm) -> float:
    """Memory that the largest rank has taken so far, in GB."""
    return comm.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, MPI.MAX) * 1024 / 1e9


def gap_left(full: hhr.FullOrderModel, answer: Any) -> float:
    """Largest gap of a condition that bears a force, over the largest push."""
    problem = full.problem
    slack = problem.gaps @ problem.amplitudes(answer.parameter) - problem.contact @ answer.unknown
    return float(np.abs(slack[answer.active]).max() / full.parameters.upper[0])


def _off(field: np.ndarray, exact: np.ndarray) -> float:
    return float(np.abs(field - exact).max() / np.abs(exact).max())


def _watch(owner: type, name: str, stage: str, spent: dict[str, float]) -> None:
    """Add up what a method takes."""
    plain = getattr(owner, name)

    def watched(*given: Any, **how: Any) -> Any:
        found, seconds = timed(lambda: plain(*given, **how))
        spent[stage] += seconds
        return found

    setattr(owner, name, watched)


def slopes(rows: list[dict[str, float]], named: tuple[str, ...] = COLUMNS[3:]) -> dict[str, float]:
    """Powers of N by which the larger half of the sizes grow, by least squares of logarithms."""
    later = rows[len(rows) // 2 :] if len(rows) > 3 else rows
    sizes = np.log([row["N"] for row in later])
    return {
        name: float(np.polyfit(sizes, np.log([row[name] for row in later]), 1)[0]) for name in named
    }


KINDS: dict[str, tuple[Any, tuple[str, ...], tuple[Any, ...]]] = {
    "scale": (measured, COLUMNS, MESHES),
    "reduced": (reduced, REDUCED, MESHES),
    "flow": (flowing, FLOWING, BLOCKS),
}
"""What makes a row of the report, what of it is told, and meshes."""


def main() -> None:
    """Measure sizes up to a number of dofs, and report."""
    parser = cli.demo_parser("scale", __doc__)
    parser.add_argument(
        "--up-to", type=float, default=1e5, metavar="N", help="largest number of dofs [1e5]"
    )
    parser.add_argument(
        "--from", type=float, default=0.0, metavar="N", dest="least", help="smallest number [0]"
    )
    parser.add_argument("--ratios", action="store_true", help="vary ratios of Poisson too")
    parser.add_argument(
        "--reduced", action="store_true", help="hyper-reduced models in place of condensed ones"
    )
    parser.add_argument(
        "--flow", action="store_true", help="histories of bodies that flow, by the full order"
    )
    options = cli.parse(parser)
    kind = "flow" if options.flow else "reduced" if options.reduced else "scale"
    measure, columns, meshes = KINDS[kind]
    rows: list[dict[str, float]] = []
    for cells in meshes[:2] if options.quick else meshes:
        if not options.least <= expected_dofs(cells) <= options.up_to:
            continue
        if MPI.COMM_WORLD.size > 1:
            rows.append(measure(cells, options.ratios, MPI.COMM_WORLD))
        else:
            with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as alone:
                rows.append(alone.submit(measure, cells, options.ratios).result())
        told = ", ".join(f"{name} {rows[-1][name]:.3g}" for name in columns)
        options.console.print(
            told + ("" if rows[-1].get("columns_kept", True) else ", columns dropped")
        )
    found = {
        "scene": "scale",
        kind: rows,
        "slopes": slopes(rows, columns[3:]) if len(rows) > 1 else {},
    }
    if found["slopes"]:
        grown = ", ".join(f"{name} {value:.2g}" for name, value in found["slopes"].items())
        options.console.print(f"powers of N: {grown}")
    if MPI.COMM_WORLD.rank == 0:
        report.write_report(found | report.environment(), options.out)


if __name__ == "__main__":
    main()
