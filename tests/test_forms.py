"""The physics as UFL states it, held to the numbers that the package runs."""

from types import SimpleNamespace

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from dolfinx.fem import petsc
from mpi4py import MPI
from scenes import pressed_block
from scipy.sparse import csr_matrix
from test_plastic import LAWS, POISSON, YOUNG, material, some_states

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.forms import contact, elasticity
from hhr_dolfinx.full_order.discretisation import Discretisation
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.materials.elasticity import lame_parameters
from hhr_dolfinx.plugins.inelastic import return_mapping
from hhr_dolfinx.plugins.inelastic.gauss_points import material_at, strain_operator

SHEAR = lame_parameters(YOUNG, POISSON)[1]
DT = 0.1


class Stated:
    """Stress, residual of the flow and their derivatives as UFL, evaluated at one Gauss point after the other."""

    def __init__(self, law, components):
        self._line = mesh.create_interval(MPI.COMM_SELF, 1, [0.0, 1.0])
        given = [np.zeros(components), np.zeros(components), 0.0, 0.0]
        self._given = [fem.Constant(self._line, value) for value in given]
        total, plastic, cumulated, flow = self._given
        total, flow = ufl.variable(total), ufl.variable(flow)
        stress = return_mapping.stress_after(total, plastic, flow, YOUNG, POISSON)
        trial = return_mapping.equivalent(return_mapping.trial_deviator(total, plastic, SHEAR))
        if isinstance(law, hhr.Plasticity):
            residual = return_mapping.plasticity(flow, trial, cumulated, SHEAR, law)
        else:
            residual = return_mapping.norton(flow, trial, SHEAR, DT, law)
        stated = {"stress": stress, "trial": trial, "residual": residual}
        stated |= {f"{name}_by_strain": ufl.diff(stated[name], total) for name in ("stress", "residual")}
        stated |= {f"{name}_by_flow": ufl.diff(stated[name], flow) for name in ("stress", "residual")}
        one = fem.Constant(self._line, 1.0)  # a derivative that is a number has no mesh to be evaluated on
        self._expressions = {name: fem.Expression(one * form, np.array([[0.5]])) for name, form in stated.items()}

    def __call__(self, *values):
        for constant, value in zip(self._given, values, strict=True):
            constant.value = value
        cell = np.zeros(1, dtype=np.int32)
        # one row of values, of the shape of the expression or flat, as the version of DOLFINx has it
        found = {
            name: np.reshape(item.eval(self._line, cell), item.ufl_expression.ufl_shape)
            for name, item in self._expressions.items()
        }
        return SimpleNamespace(**found)


@pytest.mark.parametrize("components", [4, 6])
@pytest.mark.parametrize("name", ["plasticity", "perfect plasticity", "norton 4", "norton 20"])
def test_flow_stress_and_tangent_are_those_of_ufl(name, components):
    """The flow solves the residual, the stress is that of the flow, the tangent follows from the derivatives of both.

    To round-off; the residual is measured by how far a step of Newton's method would still move the flow.
    """
    law, count = LAWS[name], 12
    strain, old = some_states(5, count, components)
    update = material(law, count, components).update(strain, old, DT, tangent=True)
    flow = update.state.cumulated - old.cumulated
    stated, flowing = Stated(law, components), 0
    for k in range(count):
        here = stated(strain[k], old.plastic[k], old.cumulated[k], 0.0)
        flow, slope = (part[0] for part in law.flow(here.trial.reshape(1), old.cumulated[k : k + 1], SHEAR, DT))
        here = stated(strain[k], old.plastic[k], old.cumulated[k], flow)
        tangent = here.stress_by_strain
        if flow > 0:
            flowing += 1
            assert abs(here.residual / here.residual_by_flow) < 1e-12 * here.trial / (3 * SHEAR)
            by_strain = -here.residual_by_strain / here.residual_by_flow
            tangent = tangent + np.outer(here.stress_by_flow, by_strain)
            # the trial stress grows by 3 mu along the deviator of a unit length in strain
            assert np.linalg.norm(by_strain) == pytest.approx(slope * np.sqrt(6) * SHEAR, rel=1e-9)
        else:
            assert here.residual <= 0 and slope == 0
        assert update.state.cumulated[k] == pytest.approx(old.cumulated[k] + flow, rel=1e-12)
        assert update.stress[k] == pytest.approx(here.stress, abs=1e-13 * YOUNG)
        assert update.tangents[k] == pytest.approx(tangent, abs=1e-11 * YOUNG)
    assert 0 < flowing < count or isinstance(law, hhr.Norton)


def as_csr(matrix):
    indptr, indices, data = matrix.getValuesCSR()
    return csr_matrix((data, indices, indptr), shape=matrix.getSize())


@pytest.mark.parametrize("simplices", [False, True])
@pytest.mark.parametrize("hypothesis", ["plane_strain", "axisymmetric", "solid"])
def test_stiffness_through_gauss_points_is_the_assembled_one(hypothesis, simplices):
    """Under full integration by one rule, for strains of 4 and of 6 components; what the model assembles too."""
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
