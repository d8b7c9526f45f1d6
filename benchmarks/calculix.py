"""One answer beside CalculiX, on tetrahedra of second order: seconds from nothing, and how far
displacements differ.

A block is pressed on a wider one by a displacement of its top; meshes do not match. CalculiX reads
the deck that the scene writes, contact by penalty, surface to surface, with large displacements:
both leave some parts of a thousand.

    python benchmarks/calculix.py [--out DIR] [--quick] [--seed N] [--cells N] [--patience SECONDS]
"""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

import _demos  # noqa: F401
import numpy as np
from mpi4py import MPI
from parts import cli

import hhr_dolfinx as hhr
from hhr_dolfinx.full_order.discretisation import Discretisation
from hhr_dolfinx.geometries.two_blocks import side, two_blocks
from hhr_dolfinx.plugins.exporters.deck import write_deck
from hhr_dolfinx.plugins.studies import report

WIDE, PRESSED = 1, 2
PUSH = 0.01


def scene(cells: int) -> hhr.Scene:
    """A quarter of both blocks, cells along the side of the upper one."""
    along = 3 * cells // 4
    lower = ((0.0, 0.0, 0.0), (2.0, 2.0, 1.0), (2 * along, 2 * along, along))
    upper = ((0.0, 0.0, 1.0), (1.0, 1.0, 2.0), (cells, cells, cells))
    top = side(PRESSED, 2, True)
    held = [
        hhr.Displacement(side(body, axis, False), axis)
        for body in (WIDE, PRESSED)
        for axis in (0, 1)
    ]
    push = hhr.Displacement(top, 2, hhr.Amplitude(slopes={"push": -1.0}))
    return hhr.Scene(
        "pressed_blocks",
        lambda comm: two_blocks(comm, first=lower, second=upper, simplices=True),
        "solid",
        (hhr.Body(WIDE, 70e3, 0.3), hhr.Body(PRESSED, 210e3, 0.3)),
        (hhr.Mortar(side(PRESSED, 2, False), side(WIDE, 2, True)),),
        hhr.ParameterSpace(("push",), (0.0,), (2 * PUSH,)),
        displacements=(*held, *hhr.Displacement.clamp(side(WIDE, 2, False), 3), push),
        order=2,
    )


def ours(given: hhr.Scene) -> tuple[np.ndarray, dict[str, float]]:
    """Displacements of the nodes, (n, 3), and what they took."""
    start = time.perf_counter()
    full = hhr.FullOrderModel(given, MPI.COMM_SELF)
    answer = full.solve(PUSH)
    moved = answer.displacement().reshape(-1, 3)
    first = time.perf_counter() - start
    start = time.perf_counter()
    full.solve(0.9 * PUSH).displacement()
    sizes = {"N": moved.size, "N_lambda": full.conditions}
    times = {"seconds": first, "next_s": time.perf_counter() - start}
    return moved, sizes | times | {"force": float(answer.forces().sum())}


def by_calculix(deck: Path, count: int, patience: float) -> tuple[np.ndarray | None, float]:
    """Displacements of the nodes, (count, 3), None where it did not end in time, and seconds."""
    start = time.perf_counter()
    one_core = os.environ | {"OMP_NUM_THREADS": "1", "CCX_NPROC_EQUATION_SOLVER": "1"}
    try:
        subprocess.run(
            ["ccx", deck.stem],
            cwd=deck.parent,
            capture_output=True,
            check=True,
            timeout=patience,
            env=one_core,
        )
    except subprocess.TimeoutExpired:
        return None, time.perf_counter() - start
    spent = time.perf_counter() - start
    moved = np.zeros((count, 3))
    for line in deck.with_suffix(".dat").read_text().splitlines():
        words = line.split()
        if len(words) == 4 and words[0].isdigit():  # of increments the last one stays
            moved[int(words[0]) - 1] = [float(word) for word in words[1:]]
    return moved, spent


def compared(cells: int, folder: Path, patience: float) -> dict[str, Any]:
    """Both, and how far they differ."""
    given = scene(cells)
    own, found = ours(given)
    folder.mkdir(parents=True, exist_ok=True)
    deck = folder / "pressed_blocks.inp"
    write_deck(deck, Discretisation(given, MPI.COMM_SELF), PUSH)
    moved, spent = by_calculix(deck, len(own), patience)
    found |= {"calculix_s": spent, "calculix_ended": moved is not None}
    if moved is not None:
        found["difference"] = float(np.linalg.norm(moved - own) / np.linalg.norm(own))
    return found


def main() -> None:
    """Compare, print, report."""
    parser = cli.demo_parser("calculix", __doc__)
    parser.add_argument("--cells", type=int, default=12, help="along the upper block [12]")
    parser.add_argument(
        "--patience", type=float, default=3600.0, help="seconds that CalculiX may take [3600]"
    )
    options = cli.parse_on_first_rank(parser)
    if shutil.which("ccx") is None:
        raise SystemExit("there is no ccx on the PATH: install CalculiX, on Debian calculix-ccx")
    found = compared(4 if options.quick else options.cells, options.out, options.patience)
    options.console.print(", ".join(f"{name} {value:.4g}" for name, value in found.items()))
    report.write_report(
        {"scene": "calculix", "calculix": found, **report.environment()}, options.out
    )


if __name__ == "__main__":
    main()
