"""gmsh is one for the whole process: what a user has in it stays, whoever asks for a mesh meanwhile."""

import gmsh
import pytest
from mpi4py import MPI

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
    """Number of cells of a tagged mesh."""
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


def test_a_mesh_that_fails_leaves_the_session(session, monkeypatch):
    before = gmsh.model.list()

    def failing(dim):
        raise RuntimeError("no mesh")

    monkeypatch.setattr(gmsh.model.mesh, "generate", failing)
    with pytest.raises(RuntimeError, match="no mesh"):
        GEOMETRIES["half_discs"]()
    assert gmsh.model.list() == before and gmsh.model.getCurrent() == "mine"
