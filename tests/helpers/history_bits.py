"""All bits of answers, for histories that are compared between processes: light to import where
DOLFINx is missing.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np


def of_answer(answer, outputs=()):
    """All that an answer hands out, as bytes, and outputs by these names."""
    parts = [
        answer.unknown,
        answer.multipliers,
        answer.active,
        answer.displacement(),
        answer.forces(),
        answer.stress(),
        answer.plastic_strain(),
        *answer.state().state,
    ]
    if answer.gradient is not None:
        parts += [answer.gradient.unknown, answer.gradient.multipliers]
    values = [answer.outputs()[name].hex() for name in outputs]
    return [*(part.tobytes() for part in parts), *values]


def bits(history, outputs=()):
    """The same of all steps."""
    return [of_answer(answer, outputs) for answer in history.answers]


def handed_out(answer):
    """What an answer hands out, as arrays."""
    parts = answer.unknown, answer.multipliers, answer.displacement(), answer.forces()
    return *parts, *((answer.plastic_strain(), answer.stress()) if "gauss" in answer.memory else ())


def flat(history):
    """The same of all steps, each in one row."""
    return np.array(
        [
            np.concatenate([part.ravel() for part in handed_out(answer)])
            for answer in history.answers
        ]
    )


MARCH = """
import sys
missing = ["dolfinx_solver", "dolfinx", "ufl", "basix", "gmsh", "petsc4py", "slepc4py", "mpi4py",
           "rich", "matplotlib"]
sys.modules.update(dict.fromkeys(missing))
import numpy as np, hhr_dolfinx as hhr
from history_bits import flat
model, path = hhr.load_model(sys.argv[1]), np.load(sys.argv[2])
np.save(sys.argv[3], flat(model.march(list(zip(path[:, 0], path[:, 1:])))))
"""


def marched_elsewhere(file, path, folder):
    """Answers of a history, flat, by a process in which nothing of the full model can be
    imported.
    """
    np.save(folder / "path.npy", np.array([[time, *point] for time, point in path]))
    command = [
        sys.executable,
        "-c",
        MARCH,
        *(str(name) for name in (file, folder / "path.npy", folder / "out.npy")),
    ]
    run = subprocess.run(
        command, capture_output=True, text=True, timeout=1800, cwd=Path(__file__).parent
    )
    assert run.returncode == 0, run.stderr[-2000:]
    return np.load(folder / "out.npy")
