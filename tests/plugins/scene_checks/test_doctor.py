"""What the doctor says of libraries and programs: versions as they are, and what is missing or
lacking by name.
"""

from contextlib import nullcontext
from types import SimpleNamespace

import gmsh
import pytest
from libraries import MED
from petsc4py import PETSc
from processes import python

from hhr_dolfinx import compat
from hhr_dolfinx.linear.factors import gives_back
from hhr_dolfinx.plugins.scene_checks import doctor


def test_versions_are_those_of_the_libraries():
    found = {one.name: one for one in doctor.examined()}
    of = compat.versions()
    assert found["DOLFINx"].version == of["dolfinx"]
    assert found["PETSc"].version == f"{of['petsc']}, SLEPc {of['slepc']}"
    assert found["gmsh"].version == gmsh.GMSH_API_VERSION and ("MED" in found["gmsh"].lacks) != MED
    assert found["MUMPS"].version[0].isdigit()
    assert ("ICNTL(49)" in found["MUMPS"].lacks) == (PETSc.Sys.getVersion() < (3, 23, 0))


def test_what_is_missing_says_who_needs_it(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    found = doctor.program("node", ("node",), "only tests of pages need it")
    assert str(found) == "node      not there: only tests of pages need it"


def test_a_gmsh_that_does_not_load_is_named_with_the_reason(monkeypatch, tmp_path):
    (tmp_path / "gmsh.py").write_text(
        "raise OSError('libGLU.so.1: cannot open shared object file')"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    found = doctor.gmsh()
    assert not found.version and "libGLU.so.1: cannot open shared object file" in found.lacks


def test_it_ends_in_lines_that_a_person_reads():
    words = [
        line.split()[0]
        for line in python("-m", "hhr_dolfinx.plugins.scene_checks.doctor").stdout.splitlines()
    ]
    assert words == [
        "Python",
        "DOLFINx",
        "PETSc",
        "MUMPS",
        "gmsh",
        "compiler",
        "mpirun",
        "node",
        "chromium",
    ]


@pytest.mark.parametrize(("code", "ends"), [(62, nullcontext()), (55, pytest.raises(PETSc.Error))])
def test_only_a_setting_that_petsc_does_not_know_is_left_out(code, ends):
    """62 is a wrong argument, as PETSc 3.22 calls ICNTL(49).

    Whatever else fails, here memory, is raised.
    """

    def refused(number, value):
        assert (number, value) == (49, 1)
        raise PETSc.Error(code)

    with ends:
        assert gives_back(SimpleNamespace(setMumpsIcntl=refused)) is False
