"""Reduction and condensation on free meshes in space, whose contact rows have eigenvalues close to each other."""

import gmsh
import numpy as np
import pytest
from needs import needs
from scenes import THESIS, largest_difference

import hhr_dolfinx as hhr
from hhr_dolfinx.certify import constants
from hhr_dolfinx.certify.constants import FullConstants
from hhr_dolfinx.geometries.gmsh_model import mesh_of

FLANGE, HEAD = 1, 2
FOOT, FLANGE_TOP, HEAD_UNDER, HEAD_TOP = 11, 12, 13, 14
PAIRINGS = {
    "mortar": lambda: hhr.Mortar(HEAD_UNDER, FLANGE_TOP),
    "mortar, standard multipliers": lambda: hhr.Mortar(HEAD_UNDER, FLANGE_TOP, multipliers="standard"),
    "node to surface": lambda: hhr.NodeToSurface(HEAD_UNDER, FLANGE_TOP),
    "double pass": lambda: hhr.DoublePass(HEAD_UNDER, FLANGE_TOP),
    "node to node": lambda: hhr.NodeToNode(HEAD_UNDER, FLANGE_TOP, (0.0, 0.0, -1.0)),
    "obstacle": lambda: hhr.Obstacle(HEAD_UNDER, (0.0, 0.0, -1.0), 0.0),
}
CASES = [pytest.param(name, marks=needs("mortar") if "mortar" in name else ()) for name in PAIRINGS]


def head_on_flange(size, *, alike=False):
    """A bolt's head, a cylinder, on a flange of tetrahedra that are not structured, or on one with the same nodes."""

    def make():
        occ = gmsh.model.occ
        flange = occ.addCylinder(0, 0, -2, 0, 0, 2, 8) if alike else occ.addBox(-9, -9, -2, 18, 18, 2)
        head = occ.addCylinder(0, 0, 0, 0, 0, 2, 8)
        occ.synchronize()
        for body, entity in ((FLANGE, flange), (HEAD, head)):
            gmsh.model.addPhysicalGroup(3, [entity], body)
        faces = (flange, -2, FOOT), (flange, 0, FLANGE_TOP), (head, 0, HEAD_UNDER), (head, 2, HEAD_TOP)
        for entity, height, tag in faces:
            gmsh.model.addPhysicalGroup(2, [face_at(entity, height)], tag)
        if alike:
            gmsh.model.mesh.setPeriodic(2, [face_at(head, 0)], [face_at(flange, 0)], np.eye(4).ravel().tolist())
        gmsh.model.mesh.generate(3)

    return lambda comm: mesh_of(make, comm, 3, {"Mesh.MeshSizeMin": size, "Mesh.MeshSizeMax": size})


def face_at(entity, height):
    """The flat face of a body at a height."""
    for _, face in gmsh.model.getBoundary([(3, entity)], oriented=False):
        low, high = np.reshape(gmsh.model.getBoundingBox(2, face), (2, 3))[:, 2]
        if max(abs(low - height), abs(high - height)) < 1e-3:
            return face
    raise AssertionError(f"no face at {height}")


def bolted(pairing, size, young=200.0):
    """The head's top is pushed down and the other side of it pulled aside, so that it tilts and part of it lifts."""
    top = hhr.Displacement(HEAD_TOP, 2, hhr.Amplitude(slopes={"push": -1.0}))
    box = {"push": (1e-2, 2e-2), "aside": (0.0, 0.6)} | ({"E": (100.0, 300.0)} if young == "E" else {})
    return hhr.Scene(
        name="bolted",
        geometry=head_on_flange(size, alike=pairing == "node to node"),
        hypothesis="solid",
        bodies=(hhr.Body(FLANGE, young, 0.33), hhr.Body(HEAD, 210.0, 0.3)),
        contacts=(PAIRINGS[pairing](),),
        displacements=(*hhr.Displacement.clamp(FOOT, 3), *(hhr.Displacement(HEAD_TOP, axis) for axis in (0, 1)), top),
        loads=(hhr.Traction(HEAD_UNDER, (1.0, 0.0, 0.0), hhr.Amplitude(slopes={"aside": 1.0})),),
        parameters=hhr.ParameterSpace(tuple(box), *zip(*box.values(), strict=True)),
    )


def check(pairing, size, young, conditions, forces):
    """Build and condense; both have the forces of the full order at points that are in no training.

    Condensation is exact where one body has one factor: 1e-10 is round-off of the sums of conditions of large meshes.
    """
    training = hhr.train(bolted(pairing, size, young), hhr.Sobol(24, seed=1), held_out=6)
    full = training.full_order
    assert conditions[0] <= full.conditions <= conditions[1]
    rows = full.problem.contact[full.problem.distinct].toarray()
    beta = FullConstants.of(full).euclidean
    # the root of an eigenvalue of B B^T, whose round-off is that of the square
    assert beta == pytest.approx(np.linalg.svd(rows, compute_uv=False)[-1], rel=1e-10)
    reduced, condensed = training.build(), training.condense()
    for point in hhr.Sobol(4, seed=7).points(full.parameters):
        exact = full.solve(point)
        assert exact.active.any()
        assert largest_difference(reduced.solve(point).forces(), exact.forces()) < forces
        assert largest_difference(condensed.solve(point).forces(), exact.forces()) < 1e-10


@pytest.mark.parametrize("pairing", CASES)
@pytest.mark.filterwarnings("ignore::hhr_dolfinx.errors.PairingWarning")
@pytest.mark.filterwarnings("ignore:kappa:hhr_dolfinx.errors.StabilityWarning")
def test_models_of_a_free_mesh(pairing):
    """172 conditions; forces of reduction were 5e-5 off at most on finer meshes, where some nodes lift.

    A double pass has nearly as many conditions on a coarser mesh, with rows that nearly depend on each other.
    """
    check(pairing, 1.7 if pairing == "double pass" else 1.3, 200.0, (150, 200), 1e-3)


@needs("moduli")
@pytest.mark.slow
@pytest.mark.parametrize("pairing", CASES)
@pytest.mark.filterwarnings("ignore::hhr_dolfinx.errors.PairingWarning")
@pytest.mark.filterwarnings("ignore:kappa:hhr_dolfinx.errors.StabilityWarning")
def test_models_of_a_fine_free_mesh(pairing):
    """400 to 1000 conditions, and a modulus that varies: a node at the edge of contact was 1 % of the largest off."""
    check(pairing, 0.8, "E", (350, 1000), 0.05)


def clustered(size, width):
    """Eigenvalues of which half lie within a small width from 1 on, and the others up to 2."""
    rng = np.random.default_rng(0)
    values = 1 + width * np.sort(rng.random(size))
    values[size // 2 :] += rng.random(size - size // 2)
    return values


def test_a_constant_that_only_reports_may_be_unknown(hertz, hertz_snapshots, monkeypatch, caplog):
    """Without beta_h a model is built that answers alike, and its report has no number there."""
    monkeypatch.setattr(constants, "_KNOWN", {})
    monkeypatch.setattr(constants, "DENSE", 0)
    monkeypatch.setattr(constants, "extreme_eigenvalue", lambda prepared: None)
    model = hhr.build(hertz, hertz_snapshots, THESIS.as_it_is())
    assert np.isnan(model.offline.stability.euclidean.beta_h) and "beta_h" in caplog.text
    assert model.solve(hertz_snapshots.points[5]).converged
