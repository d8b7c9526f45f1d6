"""gmsh is one for the whole process: what a user has in it stays, whoever asks for a mesh meanwhile."""

from pathlib import Path

import gmsh
import numpy as np
import pytest
from mpi4py import MPI

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.geometries.gmsh_model import entities_of
from hhr_dolfinx.geometries.hertz_half_discs import half_discs
from hhr_dolfinx.geometries.pellet_cladding import pellet_cladding

GEOMETRIES = {
    "half_discs": lambda: half_discs(MPI.COMM_SELF, arc_segments=8, flat_segments=2),
    "pellet": lambda: pellet_cladding(MPI.COMM_SELF, radial_cells=2, axial_cells=2, cladding_radial_cells=1),
}


@pytest.fixture
def session():
    """A session of gmsh with two models of a user, one of them with a name of ours."""
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 1)
    gmsh.option.setNumber("Mesh.Algorithm", 6)
    for name in ("mine", "half_discs"):
        gmsh.model.add(name)
        gmsh.model.occ.addPoint(1.0, 2.0, 3.0)
        gmsh.model.occ.synchronize()
    gmsh.model.setCurrent("mine")
    yield
    gmsh.finalize()


def cells(tagged):
    mesh = tagged[0]
    return mesh.topology.index_map(mesh.topology.dim).size_global


@pytest.mark.parametrize("name", GEOMETRIES)
def test_a_session_of_the_user_stays(name, session):
    before = gmsh.model.list()
    count = cells(GEOMETRIES[name]())
    assert gmsh.isInitialized() and gmsh.model.list() == before and gmsh.model.getCurrent() == "mine"
    for model in ("half_discs", "mine"):
        gmsh.model.setCurrent(model)
        assert len(gmsh.model.getEntities()) == 1
    assert gmsh.option.getNumber("General.Terminal") == 1 and gmsh.option.getNumber("Mesh.Algorithm") == 6
    gmsh.finalize()
    assert cells(GEOMETRIES[name]()) == count and not gmsh.isInitialized()
    gmsh.initialize()


MESHING = {"Mesh.RecombineAll": 1, "Mesh.ElementOrder": 2, "Mesh.MeshSizeMax": 0.1, "Mesh.SubdivisionAlgorithm": 1}


@pytest.mark.parametrize("option", MESHING)
@pytest.mark.parametrize("name", GEOMETRIES)
def test_options_of_a_session_make_no_other_mesh(name, option, session, capfd):
    """What is meshed is the mesh of a process without a session, to the last bit; the options stay the user's."""
    before = gmsh.option.getNumber("General.AbortOnError")
    gmsh.option.setNumber(option, MESHING[option])
    found = GEOMETRIES[name]()[0].geometry.x
    assert gmsh.option.getNumber(option) == MESHING[option] and gmsh.option.getNumber("General.AbortOnError") == before
    assert ".opt" not in capfd.readouterr().out
    gmsh.finalize()
    alone = GEOMETRIES[name]()[0].geometry.x
    gmsh.initialize()
    assert np.array_equal(found, alone)


def test_errors_of_gmsh_raise_in_a_session_of_the_user(session):
    with pytest.raises(Exception, match="nowhere"):
        entities_of(Path("nowhere.msh"))


@pytest.mark.parametrize("name", GEOMETRIES)
def test_a_session_that_meshes_nothing_is_refused(name, session, monkeypatch):
    """As gmsh 4.13 is behind a mesh that failed: `generate` returns, and there are no cells."""
    monkeypatch.setattr(gmsh.model.mesh, "generate", lambda dim: None)
    with pytest.raises(SceneError, match=r"gmsh\.finalize"):
        GEOMETRIES[name]()


def test_a_mesh_that_fails_leaves_the_session(session, monkeypatch):
    before = gmsh.model.list()

    def failing(dim):
        raise RuntimeError("no mesh")

    monkeypatch.setattr(gmsh.model.mesh, "generate", failing)
    with pytest.raises(RuntimeError, match="no mesh"):
        GEOMETRIES["half_discs"]()
    assert gmsh.model.list() == before and gmsh.model.getCurrent() == "mine"
