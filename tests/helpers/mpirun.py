"""Programs on several ranks."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from processes import WAIT

PATIENT = {"MPIR_CVAR_ENABLE_HEAVY_YIELD": "1", "OMPI_MCA_mpi_yield_when_idle": "1"}
"""Ranks that wait for others sleep (MPICH, Open MPI): where there are more of them than cores,
waiting by turning round takes the time of those that are waited for.
"""


def launch(ranks, arguments, cwd=None):
    """Output of a Python program on some ranks, which must end well."""
    run = run_program(ranks, arguments, cwd)
    assert run.returncode == 0, run.stdout[-2000:] + run.stderr[-3000:]
    return run.stdout


def run_program(ranks, arguments, cwd=None, limit=WAIT):
    """A Python program on some ranks, ended after ``limit`` seconds."""
    beside = str(Path(sys.executable).parent)
    mpirun = shutil.which("mpirun", path=os.pathsep.join([beside, os.environ["PATH"]]))
    if mpirun is None:
        pytest.skip("no mpirun beside this Python or on the PATH")
    # Open MPI refuses root and more ranks than cores unless told otherwise; MPICH ignores these
    allow = dict.fromkeys(
        ("OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "OMP_NUM_THREADS"), "1"
    )
    allow |= {
        "OMPI_MCA_rmaps_base_oversubscribe": "1",
        "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
    }
    environment = os.environ | allow | PATIENT | {"COLUMNS": "200"}
    command = [mpirun, "-n", str(ranks), sys.executable, *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, env=environment, timeout=limit, cwd=cwd
    )
