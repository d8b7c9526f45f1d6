"""C functions of a law of interfaces beside Python: a header is compiled, and answers along a
path.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx import registry

if TYPE_CHECKING:
    from hhr_dolfinx.models.condensed import CondensedModel

NEEDED = "exporters"
"""Plug-in that writes headers."""
_PROGRAM = """
#include "checked.h"
int ask(int count, const double *points, double *forces) {
    int status = CHECKED_DONE;
#if CHECKED_PATHS
    checked_path *work = checked_path_new();
    status = checked_rest(work, points);
    for (int k = 1; k < count && !status; k++)
        status = checked_go(work, points + k * CHECKED_PARAMETERS,
                                forces + (k - 1) * CHECKED_CONDITIONS, NULL);
    checked_path_free(work);
#else
    checked_work *work = checked_new();
    for (int k = 1; k < count && !status; k++)
        status = checked_solve(work, points + k * CHECKED_PARAMETERS,
                                forces + (k - 1) * CHECKED_CONDITIONS, NULL);
    checked_free(work);
#endif
    return status;
}
"""


def compilable(plugin: str) -> bool:
    """True if a plug-in of laws brings C functions, and a compiler ``cc`` is there."""
    installed = registry.installed()
    return (
        NEEDED in installed
        and "kernel" in installed[plugin].facets
        and shutil.which("cc") is not None
    )


def in_c(model: CondensedModel, path: Sequence[tuple[float, np.ndarray]]) -> np.ndarray | str:
    """Forces of a compiled header in steps of a second, (steps, m).

    Args:
        model: a condensed model.
        path: times and parameters, the first ones at rest.

    Returns:
        The forces, or the message of a compiler that refuses the header.
    """
    from hhr_dolfinx.plugins.exporters.c_header import write_c_header

    points = np.ascontiguousarray([point for _, point in path], dtype=float)
    forces = np.full((len(path) - 1, model.conditions), np.nan)
    with TemporaryDirectory() as name:
        folder = Path(name)
        write_c_header(folder / "checked.h", model)
        (folder / "checked.c").write_text(_PROGRAM)
        words = ["cc", "-std=c99", "-shared", "-fPIC", "-o", "checked.so", "checked.c", "-lm"]
        done = subprocess.run(words, cwd=folder, capture_output=True, text=True)
        if done.returncode:
            return done.stderr[:500]
        ask = ctypes.CDLL(str(folder / "checked.so")).ask
        status = ask(
            len(points), *(ctypes.c_void_p(array.ctypes.data) for array in (points, forces))
        )
    return f"a step of the path ends with status {status}" if status else forces
