"""The physics as UFL states it, held to the numbers that the package runs."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from dolfinx.fem import petsc
from mpi4py import MPI
from needs import needs
from scenes import pressed_block
from scipy.sparse import csr_matrix

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.forms import contact, elasticity
from hhr_dolfinx.full_order.discretisation import Discretisation
from hhr_dolfinx.geometries import two_blocks


def as_csr(matrix):
    indptr, indices, data = matrix.getValuesCSR()
    return csr_matrix((data, indices, indptr), shape=matrix.getSize())


@needs("inelastic")
@pytest.mark.parametrize("simplices", [False, True])
@pytest.mark.parametrize("hypothesis", ["plane_strain", "axisymmetric", "solid"])
def test_stiffness_through_gauss_points_is_the_assembled_one(hypothesis, simplices):
    """Under full integration by one rule, for strains of 4 and of 6 components; what the model assembles too."""
    from hhr_dolfinx.plugins.inelastic.gauss_points import material_at, strain_operator

    scene = pressed_block(hypothesis, simplices=simplices, cells=3)
    built, body = Discretisation(scene, MPI.COMM_SELF), scene.bodies[0]
    operator = strain_operator(built)
    elastic = material_at(scene, built.cell_bodies(), operator).elastic
    stiffness = operator.stiffness(elastic, operator.pattern())
    u, v = ufl.TrialFunction(built.space), ufl.TestFunction(built.space)
    dx = ufl.dx(domain=built.mesh, metadata={"quadrature_degree": built.gauss_degree})
    form = elasticity.stiffness(u, v, body.young, body.poisson, hypothesis, dx)
    matrix = petsc.assemble_matrix(fem.form(form))
    matrix.assemble()
    assert abs(stiffness - as_csr(matrix)).max() < 1e-13 * abs(stiffness).max()
    if hypothesis != "axisymmetric":  # 1 / r has a rule of its own in the model
        assert abs(stiffness - as_csr(built.assemble_stiffness())).max() < 1e-12 * abs(stiffness).max()


def pressed_together(hypothesis, multipliers):
    """Two blocks on meshes that do not match, all of whose common side is covered; in axisymmetry two tubes."""
    slave, master = two_blocks.side(two_blocks.SECOND, 0, False), two_blocks.side(two_blocks.FIRST, 0, True)
    held = [two_blocks.side(two_blocks.FIRST, 0, False), two_blocks.side(two_blocks.SECOND, 0, True)]
    return hhr.Scene(
        name="pressed_together",
        geometry=lambda comm: two_blocks.two_blocks(
            comm, first=((1.0, 0.0), (2.0, 1.0), (2, 3)), second=((2.1, 0.0), (3.0, 1.0), (2, 5))
        ),
        hypothesis=hypothesis,
        bodies=(hhr.Body(two_blocks.FIRST, 3.0, 0.3), hhr.Body(two_blocks.SECOND, 2.0, 0.2)),
        contacts=(hhr.Mortar(slave, master, multipliers=multipliers),),
        parameters=hhr.ParameterSpace(("push",), (0.0,), (0.2,)),
        displacements=(
            *(hhr.Displacement(tag, 1) for tag in held),
            hhr.Displacement(held[0], 0),
            hhr.Displacement(held[1], 0, hhr.Amplitude(slopes={"push": -1.0})),
        ),
    )


@needs("mortar")
@pytest.mark.parametrize("multipliers", ["standard", "dual"])
@pytest.mark.parametrize("hypothesis", ["plane_strain", "axisymmetric"])
def test_slave_rows_of_mortar_are_the_assembled_coupling(hypothesis, multipliers):
    """b(φ_k, ψ_j) over ∫ ψ_j; dual functions ψ_j make it diagonal, as a rule with the nodes for points does."""
    scene = pressed_together(hypothesis, multipliers)
    full = hhr.FullOrderModel(scene)
    problem, built = full.problem, full.discretisation
    rule = {"quadrature_rule": "vertex", "quadrature_degree": 1} if multipliers == "dual" else {"quadrature_degree": 4}
    _, _, tags = scene.geometry(MPI.COMM_SELF)
    measure = ufl.Measure("ds", domain=built.mesh, subdomain_data=tags, metadata=rule)(scene.contacts[0].slave)
    scalars = fem.functionspace(built.mesh, ("Lagrange", 1))
    u, psi = ufl.TrialFunction(built.space), ufl.TestFunction(scalars)
    matrix = petsc.assemble_matrix(fem.form(contact.coupling(u, psi, hypothesis, measure)))
    matrix.assemble()
    area = petsc.assemble_vector(fem.form(contact.tributary_area(ufl.TestFunction(built.space), hypothesis, measure)))
    slaves = problem.contact_slaves
    expected = as_csr(matrix)[slaves].multiply(1 / area.array[2 * slaves][:, None]).toarray()
    columns = (2 * slaves[:, None] + np.arange(2)).ravel()
    assert len(slaves) == 6 and np.abs(expected).max() > 0.5
    assert problem.contact[:, columns].toarray() == pytest.approx(expected[:, columns], abs=1e-13)
    if multipliers == "standard":
        assert problem.contact_areas == pytest.approx(area.array[2 * slaves], rel=1e-13)


def test_unknown_hypothesis():
    line = mesh.create_unit_square(MPI.COMM_SELF, 1, 1)
    with pytest.raises(SceneError, match="unknown hypothesis 'flat', one of plane_strain"):
        elasticity.strain(ufl.TrialFunction(fem.functionspace(line, ("Lagrange", 1, (2,)))), "flat")
