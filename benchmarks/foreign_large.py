"""A K of CalculiX of 109,395 dofs with 2,112 contact conditions: seconds from the files to the
first answer.

A block of 64 x 32 x 16 C3D8 is clamped at one end, pressed at the other one, above a rigid floor.
CalculiX writes its K and solves one load case. A new process on one core then reads the files,
compares the load case, makes the full model, condenses it and answers. Each phase has its wall and
its CPU time: on a machine with other users only the latter means something.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import _demos  # noqa: F401
import foreign_decks as decks

import hhr_dolfinx as hhr
from hhr_dolfinx.timing import now

CELLS = (64, 32, 16)
"""Cells along the length, the width and the height of the block."""
PATIENCE = 3600.0
"""Seconds after which CalculiX, or our process, is given up."""
BAR = 60.0
"""Seconds of wall up to the first answer that an idle core must not need."""
READS = ("read_stiffness", "read_nodes", "placed", "read_case")
"""Functions of a block that read its files and place K on its nodes."""

Result = TypeVar("Result")
Phase = dict[str, Any]


def of_large(folder: Path) -> dict[str, Any]:
    """Write the decks, run CalculiX, and time a new process on its files.

    Args:
        folder: folder for decks and results.

    Returns:
        Phases with their seconds, their sums, counts, and forces of both models.
    """
    decks.write_runs(decks.block("C3D8", CELLS), folder)
    for job in ("store", "case"):
        decks.run(folder, job, PATIENCE)
    alone = os.environ | {"OMP_NUM_THREADS": "1"}
    words = [sys.executable, "-c", "import foreign_large as own; own.tell()", str(folder)]
    here = Path(__file__).parent
    ran = subprocess.run(
        words, cwd=here, env=alone, stdout=subprocess.PIPE, text=True, timeout=PATIENCE, check=True
    )
    found: dict[str, Any] = json.loads(ran.stdout.splitlines()[-1])
    return found


def timed(phases: list[Phase], name: str, function: Callable[..., Result]) -> Callable[..., Result]:
    """The function, which adds its seconds to the phase with a name."""

    def counted(*given: Any, **named: Any) -> Result:
        start, spent = now(), _cpu()
        result = function(*given, **named)
        phases.append({"phase": name, "wall": now() - start, "cpu": _cpu() - spent})
        return result

    return counted


def _cpu() -> float:
    times = os.times()
    return times.user + times.system


def phases_of(folder: Path, cells: tuple[int, int, int] = CELLS) -> dict[str, Any]:
    """Read, compare, build, condense and answer in this process, each with its seconds.

    Args:
        folder: folder in which CalculiX has run.
        cells: cells of its block.
    """
    from hhr_dolfinx.plugins.foreign import block

    inner: list[Phase] = []
    outer: list[Phase] = []
    for name in (*READS, "compare_case"):
        phase = "compare" if name == "compare_case" else "read"
        setattr(block, name, timed(inner, phase, getattr(block, name)))
    part = decks.block("C3D8", cells)
    scene = decks.scene_of(part, folder)
    full = timed(outer, "full model", hhr.FullOrderModel)(scene)
    model = timed(outer, "condense", hhr.condense)(full)
    answer = timed(outer, "first answer", model.outputs)((part.push,))
    phases = [_summed("read", inner), _summed("compare", inner), *outer]
    for kind in ("wall", "cpu"):  # blocks are read while the full model is made
        phases[2][kind] -= phases[0][kind] + phases[1][kind]
    return {
        "phases": phases,
        "wall": sum(phase["wall"] for phase in phases),
        "cpu": sum(phase["cpu"] for phase in phases),
        "bar": BAR,
        "N": int(full.problem.free.size),
        "N_lambda": full.conditions,
        "force": answer["force"],
        "force of the full model": full.outputs((part.push,))["force"],
    }


def _summed(name: str, phases: list[Phase]) -> Phase:
    own = [phase for phase in phases if phase["phase"] == name]
    return {"phase": name} | {kind: sum(one[kind] for one in own) for kind in ("wall", "cpu")}


def tell() -> None:
    """Print the phases of the folder that the command line names, as one line of JSON."""
    print(json.dumps(phases_of(Path(sys.argv[1]))))
