"""Models on free meshes in space, whose rows have close eigenvalues.

Gmsh, which is one for the whole process.
"""

from pathlib import Path
from unittest.mock import Mock

import gmsh
import numpy as np
import pytest
from mpi4py import MPI
from needs import needs
from scenes import THESIS, largest_difference, slope, space

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.geometries.gmsh_model import entities_of, mesh_of
from hhr_dolfinx.geometries.hertz_half_discs import half_discs
from hhr_dolfinx.geometries.pellet_cladding import pellet_cladding

FLANGE, HEAD = 1, 2
FOOT, FLANGE_TOP, HEAD_UNDER, HEAD_TOP = 11, 12, 13, 14
PAIRINGS = {
    "mortar": lambda: hhr.Mortar(HEAD_UNDER, FLANGE_TOP),
    "mortar, standard multipliers": lambda: hhr.Mortar(
        HEAD_UNDER, FLANGE_TOP, multipliers="standard"
    ),
    "node to surface": lambda: hhr.NodeToSurface(HEAD_UNDER, FLANGE_TOP),
    "double pass": lambda: hhr.DoublePass(HEAD_UNDER, FLANGE_TOP),
    "node to node": lambda: hhr.NodeToNode(HEAD_UNDER, FLANGE_TOP, (0.0, 0.0, -1.0)),
    "obstacle": lambda: hhr.Obstacle(HEAD_UNDER, (0.0, 0.0, -1.0), 0.0),
}
CASES = [
    pytest.param(name, marks=() if name in ("node to node", "obstacle") else needs("nonmatching"))
    for name in PAIRINGS
]


def head_on_flange(size, *, alike=False):
    """A bolt's head, a cylinder, on a flange of tetrahedra that are not structured, or on one with
    the same nodes.
    """

    def make():
        occ = gmsh.model.occ
        flange = (
            occ.addCylinder(0, 0, -2, 0, 0, 2, 8) if alike else occ.addBox(-9, -9, -2, 18, 18, 2)
        )
        head = occ.addCylinder(0, 0, 0, 0, 0, 2, 8)
        occ.synchronize()
        gmsh.model.addPhysicalGroup(3, [flange], FLANGE)
        gmsh.model.addPhysicalGroup(3, [head], HEAD)
        faces = (
            (flange, -2, FOOT),
            (flange, 0, FLANGE_TOP),
            (head, 0, HEAD_UNDER),
            (head, 2, HEAD_TOP),
        )
        for entity, height, tag in faces:
            gmsh.model.addPhysicalGroup(2, [face_at(entity, height)], tag)
        if alike:
            gmsh.model.mesh.setPeriodic(
                2, [face_at(head, 0)], [face_at(flange, 0)], np.eye(4).ravel().tolist()
            )
        gmsh.model.mesh.generate(3)

    return lambda comm: mesh_of(make, comm, 3, {"Mesh.MeshSizeMin": size, "Mesh.MeshSizeMax": size})


def face_at(entity, height):
    for _, face in gmsh.model.getBoundary([(3, entity)], oriented=False):
        low, high = np.reshape(gmsh.model.getBoundingBox(2, face), (2, 3))[:, 2]
        if max(abs(low - height), abs(high - height)) < 1e-3:
            return face
    raise AssertionError(f"no face at {height}")


def bolted(pairing, size, young=200.0):
    """The head's top is pushed down and the other side of it pulled aside, so that it tilts and
    part of it lifts.
    """
    box = {"push": (1e-2, 2e-2), "aside": (0.0, 0.6)} | (
        {"E": (100.0, 300.0)} if young == "E" else {}
    )
    held = *hhr.Displacement.clamp(FOOT, 3), *hhr.Displacement.clamp(HEAD_TOP, 2)
    return hhr.Scene(
        name="bolted",
        geometry=head_on_flange(size, alike=pairing == "node to node"),
        hypothesis="solid",
        bodies=(hhr.Body(FLANGE, young, 0.33), hhr.Body(HEAD, 210.0, 0.3)),
        contacts=(PAIRINGS[pairing](),),
        displacements=(*held, hhr.Displacement(HEAD_TOP, 2, slope("push", -1.0))),
        loads=(hhr.Traction(HEAD_UNDER, (1.0, 0.0, 0.0), slope("aside")),),
        parameters=space(**box),
    )


FINE = pytest.param("fine", marks=(pytest.mark.slow, needs("moduli")))


@needs("exact_errors", "theorems")
@pytest.mark.parametrize("pairing", PAIRINGS)
@pytest.mark.parametrize("mesh", ["coarse", FINE])
@pytest.mark.filterwarnings("ignore::hhr_dolfinx.errors.PairingWarning")
@pytest.mark.filterwarnings("ignore:kappa:hhr_dolfinx.errors.StabilityWarning")
def test_models_of_a_free_mesh(pairing, mesh):
    """Condensation is exact; forces of reduction were 5e-5 off, and 1 % at the edge of contact
    where moduli vary.
    """
    if mesh == "fine":
        size, young, conditions, forces = (
            1.1 if pairing == "double pass" else 0.8,
            "E",
            (350, 1000),
            0.05,
        )
    else:
        size, young, conditions, forces = (
            1.7 if pairing == "double pass" else 1.3,
            200.0,
            (150, 200),
            1e-3,
        )
    training = hhr.train(bolted(pairing, size, young), hhr.Sobol(24, seed=1), held_out=6)
    full = training.full_order
    assert conditions[0] <= full.conditions <= conditions[1]
    rows = full.problem.contact[full.problem.distinct].toarray()
    from hhr_dolfinx.plugins.theorems.full_constants import FullConstants

    # the root of an eigenvalue of B B^T, whose round-off is that of the square
    beta = FullConstants.of(full).euclidean
    assert beta == pytest.approx(np.linalg.svd(rows, compute_uv=False)[-1], rel=1e-10)
    reduced, condensed = training.build(), training.condense()
    for point in hhr.Sobol(4, seed=7).points(full.parameters):
        exact = full.solve(point)
        assert exact.active.any()
        assert largest_difference(reduced.solve(point).forces(), exact.forces()) < forces
        assert largest_difference(condensed.solve(point).forces(), exact.forces()) < 1e-10


@needs("theorems")
def test_a_constant_that_only_reports_may_be_unknown(hertz, hertz_snapshots, monkeypatch, caplog):
    """Without beta_h a model is built that answers alike, and its report has no number there."""
    from hhr_dolfinx.plugins.theorems import full_constants as constants

    monkeypatch.setattr(constants, "_KNOWN", {})
    monkeypatch.setattr(constants, "DENSE", 0)
    monkeypatch.setattr(constants, "extreme_eigenvalue", lambda prepared: None)
    model = hhr.build(hertz, hertz_snapshots, THESIS.as_it_is())
    assert np.isnan(model.offline.stability.euclidean.beta_h) and "beta_h" in caplog.text
    assert model.solve(hertz_snapshots.points[5]).converged


GEOMETRIES = {
    "half_discs": lambda: half_discs(MPI.COMM_SELF, arc_segments=8, flat_segments=2),
    "pellet": lambda: pellet_cladding(
        MPI.COMM_SELF, radial_cells=2, axial_cells=2, cladding_radial_cells=1
    ),
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
    assert (
        gmsh.isInitialized() and gmsh.model.list() == before and gmsh.model.getCurrent() == "mine"
    )
    for model in ("half_discs", "mine"):
        gmsh.model.setCurrent(model)
        assert len(gmsh.model.getEntities()) == 1
    assert (
        gmsh.option.getNumber("General.Terminal") == 1
        and gmsh.option.getNumber("Mesh.Algorithm") == 6
    )
    gmsh.finalize()
    assert cells(GEOMETRIES[name]()) == count and not gmsh.isInitialized()
    gmsh.initialize()


MESHING = {
    "Mesh.RecombineAll": 1,
    "Mesh.ElementOrder": 2,
    "Mesh.MeshSizeMax": 0.1,
    "Mesh.SubdivisionAlgorithm": 1,
}


@pytest.mark.parametrize("option", MESHING)
@pytest.mark.parametrize("name", GEOMETRIES)
def test_options_of_a_session_make_no_other_mesh(name, option, session, capfd):
    """What is meshed is the mesh of a process without a session, to the last bit.

    The options stay the user's.
    """
    before = gmsh.option.getNumber("General.AbortOnError")
    gmsh.option.setNumber(option, MESHING[option])
    found = GEOMETRIES[name]()[0].geometry.x
    assert (
        gmsh.option.getNumber(option) == MESHING[option]
        and gmsh.option.getNumber("General.AbortOnError") == before
    )
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
    monkeypatch.setattr(gmsh.model.mesh, "generate", Mock(side_effect=RuntimeError("no mesh")))
    with pytest.raises(RuntimeError, match="no mesh"):
        GEOMETRIES["half_discs"]()
    assert gmsh.model.list() == before and gmsh.model.getCurrent() == "mine"
