"""Check of the packages that full models need, and of their missing features.

python -m hhr_dolfinx.plugins.scene_checks.doctor
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from hhr_dolfinx import compat

CHECK_SECONDS = 60
"""Longest duration of a command whose version is checked."""


@dataclass(frozen=True)
class Found:
    """A library or a program: its version, empty if it is missing, and missing features with their
    consequences.
    """

    name: str
    version: str
    lacks: str = ""

    def __str__(self) -> str:
        text = f"{self.name:10}{self.version or 'not there'}"
        return text + (f": {self.lacks}" if self.lacks else "")


def solvers() -> list[Found]:
    """Check DOLFINx, PETSc with SLEPc, and MUMPS."""
    try:
        compat.require_dolfinx()
    except ImportError as error:
        return [
            Found("DOLFINx", "", str(error)),
            Found("PETSc", "", "comes with DOLFINx"),
            Found("MUMPS", "", "comes with PETSc"),
        ]
    versions = compat.versions()
    petsc = Found("PETSc", f"{versions['petsc']}, SLEPc {versions['slepc']}")
    return [Found("DOLFINx", versions["dolfinx"]), petsc, mumps()]


_FACTORS = """
import sys
import hhr_dolfinx
from petsc4py import PETSc
from hhr_dolfinx.linear import factors, schur
matrix = PETSc.Mat().createAIJ((1, 1), csr=([0, 1], [0], [1.0]))
pc = PETSc.PC().create()
pc.setOperators(matrix)
pc.setType(PETSc.PC.Type.CHOLESKY)
pc.setFactorSolverType("mumps")
pc.setFactorSetUpSolverType()
factor = pc.getFactorMatrix()
lacks = []
if not factors.gives_back(factor):
    lacks.append("ICNTL(49) of PETSc 3.23, so that compressed factors take more memory")
if schur._library() is None:
    lacks.append("Schur complements, so that condensation asks for columns instead")
print("lacks", "; ".join(lacks))
factor.setMumpsIcntl(4, 2)
pc.setUp()
"""


def mumps() -> Found:
    """Check MUMPS in a separate process: it prints its version on the console, and may be
    missing.
    """
    run = _output_of([sys.executable, "-c", _FACTORS])
    lacks = re.search(r"^lacks (.*)$", run, re.MULTILINE)
    if lacks is None:
        return Found(
            "MUMPS",
            "",
            "large models and several ranks need it: take a PETSc that was built with MUMPS",
        )
    version = re.search(r"MUMPS (\d[\w.]*)", run)
    return Found("MUMPS", version[1] if version else "of unknown version", lacks[1].strip())


_GMSH = """
import hhr_dolfinx
from hhr_dolfinx.geometries.gmsh_model import gmsh, knows_med
print("gmsh", gmsh.GMSH_API_VERSION, knows_med())
"""


def gmsh() -> Found:
    """Check gmsh in a separate process: it fails to load if a system library is missing."""
    run = _output_of([sys.executable, "-c", _GMSH])
    matched = re.search(r"^gmsh (\S+) (\w+)$", run, re.MULTILINE)
    if matched is None:
        last_line = run.strip().splitlines()[-1:] or ["no word"]
        return Found(
            "gmsh", "", f"geometries of this package and most mesh files need it ({last_line[0]})"
        )
    return Found(
        "gmsh",
        matched[1],
        "" if matched[2] == "True" else "MED, so that .med files are refused: write .msh",
    )


def program(name: str, commands: tuple[str, ...], use: str) -> Found:
    """Check a program by the first of some commands that exists.

    Args:
        name: name of the program in the report.
        commands: commands to try, in order.
        use: consequence of a missing program.
    """
    beside = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)])
    for command in filter(None, (shutil.which(candidate, path=beside) for candidate in commands)):
        version = re.search(r"\d+(\.\d+)+", _output_of([command, "--version"]))
        return Found(name, version[0] if version else "of unknown version")
    return Found(name, "", use)


def examined() -> list[Found]:
    """Results of all checks."""
    return [
        *solvers(),
        gmsh(),
        program(
            "compiler", ("cc", "gcc"), "DOLFINx compiles forms with it: install gcc and libc6-dev"
        ),
        program("mpirun", ("mpirun", "mpiexec"), "only runs on several ranks need it"),
        program("node", ("node", "nodejs"), "only tests of pages need it"),
        program(
            "chromium",
            ("chromium", "chromium-browser", "google-chrome"),
            "only tests of pages need it",
        ),
    ]


def _output_of(command: list[str]) -> str:
    """Output of a command, or the error if it does not run."""
    try:
        run = subprocess.run(
            command, capture_output=True, text=True, timeout=CHECK_SECONDS, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error)
    return run.stdout + run.stderr


if __name__ == "__main__":
    print(f"{'Python':10}{sys.version.split()[0]}, {sys.executable}")
    print(*examined(), sep="\n")
