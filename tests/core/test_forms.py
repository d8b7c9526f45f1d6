"""The physics as UFL states it, held to the numbers that the package runs.

Numbers of materials compile nothing.

Elasticity of a user's own in UFL: that of Hooke gives the same answers, an orthotropic one its
closed form.
"""

import dataclasses
from unittest.mock import Mock

import ffcx.codegeneration.jit
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from dolfinx.fem import petsc
from mpi4py import MPI
from needs import needs
from scenes import (
    check_like,
    largest_difference,
    pair_scene,
    pressed_block,
    pressed_pair,
    slope,
    with_bodies,
)
from scipy.sparse import csr_matrix
from toy_law import Bingham

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.forms import contact, elasticity
from hhr_dolfinx.full_order.discretisation import Discretisation
from hhr_dolfinx.geometries import block, two_blocks


def as_csr(matrix):
    indptr, indices, data = matrix.getValuesCSR()
    return csr_matrix((data, indices, indptr), shape=matrix.getSize())


@needs("inelastic")
@pytest.mark.parametrize("simplices", [False, True])
@pytest.mark.parametrize("hypothesis", ["plane_strain", "axisymmetric", "solid"])
def test_stiffness_through_gauss_points_is_the_assembled_one(hypothesis, simplices):
    """Under full integration by one rule, for strains of 4 and of 6 components.

    What the model assembles too.
    """
    from hhr_dolfinx.plugins.elasticity.gauss_points import degree_of
    from hhr_dolfinx.plugins.inelastic.gauss_points import material_at, strain_operator

    scene = pressed_block(hypothesis, simplices=simplices, cells=3)
    built, body = Discretisation(scene, MPI.COMM_SELF), scene.bodies[0]
    operator = strain_operator(built)
    stiffness = operator.stiffness(
        material_at(built, built.cell_bodies(), operator).elastic, operator.pattern()
    )
    u, v = ufl.TrialFunction(built.space), ufl.TestFunction(built.space)
    dx = ufl.dx(domain=built.mesh, metadata={"quadrature_degree": degree_of(built)})
    matrix = petsc.assemble_matrix(
        fem.form(elasticity.stiffness(u, v, body.young, body.poisson, hypothesis, dx))
    )
    matrix.assemble()
    assert abs(stiffness - as_csr(matrix)).max() < 1e-13 * abs(stiffness).max()
    if hypothesis != "axisymmetric":  # 1 / r has a rule of its own in the model
        assert (
            abs(stiffness - as_csr(built.elasticity.stiffness(built))).max()
            < 1e-12 * abs(stiffness).max()
        )


def pressed_together(hypothesis, multipliers):
    """Two blocks on meshes that do not match, all of whose common side is covered.

    In axisymmetry two tubes.
    """
    slave, master = (
        two_blocks.side(two_blocks.SECOND, 0, False),
        two_blocks.side(two_blocks.FIRST, 0, True),
    )
    held = [
        two_blocks.side(two_blocks.FIRST, 0, False),
        two_blocks.side(two_blocks.SECOND, 0, True),
    ]
    along = [hhr.Displacement(tag, 1) for tag in held]
    return pair_scene(
        "pressed_together",
        {"push": (0.0, 0.2)},
        ((1.0, 0.0), (2.0, 1.0), (2, 3)),
        ((2.1, 0.0), (3.0, 1.0), (2, 5)),
        ((3.0, 0.3), (2.0, 0.2)),
        hypothesis=hypothesis,
        contacts=(hhr.Mortar(slave, master, multipliers=multipliers),),
        displacements=(
            *along,
            hhr.Displacement(held[0], 0),
            hhr.Displacement(held[1], 0, slope("push", -1.0)),
        ),
    )


@needs("mortar")
@pytest.mark.parametrize("multipliers", ["standard", "dual"])
@pytest.mark.parametrize("hypothesis", ["plane_strain", "axisymmetric"])
def test_slave_rows_of_mortar_are_the_assembled_coupling(hypothesis, multipliers):
    """b(φ_k, ψ_j) over ∫ ψ_j; dual functions ψ_j make it diagonal, as a rule with the nodes for
    points does.
    """
    scene = pressed_together(hypothesis, multipliers)
    full = hhr.FullOrderModel(scene)
    problem, built = full.problem, full.discretisation
    rule = (
        {"quadrature_rule": "vertex", "quadrature_degree": 1}
        if multipliers == "dual"
        else {"quadrature_degree": 4}
    )
    _, _, tags = scene.geometry(MPI.COMM_SELF)
    measure = ufl.Measure("ds", domain=built.mesh, subdomain_data=tags, metadata=rule)(
        scene.contacts[0].slave
    )
    u, psi = (
        ufl.TrialFunction(built.space),
        ufl.TestFunction(fem.functionspace(built.mesh, ("Lagrange", 1))),
    )
    matrix = petsc.assemble_matrix(fem.form(contact.coupling(u, psi, hypothesis, measure)))
    matrix.assemble()
    area = petsc.assemble_vector(
        fem.form(contact.tributary_area(ufl.TestFunction(built.space), hypothesis, measure))
    )
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


@pytest.fixture
def none_compiled(monkeypatch):
    """Raise where a form is compiled that is in no cache."""

    forbidden = Mock(side_effect=AssertionError("a form was compiled"))
    return lambda: monkeypatch.setattr(ffcx.codegeneration.jit, "_compile_objects", forbidden)


@needs("plots")
@pytest.mark.parametrize("hypothesis", ["plane_strain", "plane_stress", "axisymmetric", "solid"])
def test_new_moduli_compile_nothing(hypothesis, none_compiled):
    """Build, stress and error of the mesh.

    Twice the moduli have twice the stiffness and the stress of a field.
    """
    rng = np.random.default_rng()
    young, poisson = rng.uniform(1.0, 2.0, 2), rng.uniform(0.2, 0.4, 2)

    def built(factor, ratios):
        bodies = [(float(factor * e), float(nu)) for e, nu in zip(young, ratios, strict=True)]
        full = hhr.FullOrderModel(pressed_pair(hypothesis, bodies, cells=2))
        answer = full.solve(full.parameters.middle)
        displacement = np.sin(
            np.arange(full.problem.free.size)
        )  # one that does not depend on the moduli
        assert 0 < hhr.mesh_error(full, answer).energy < 1
        return full.problem.stiffness.toarray(), full.stress_of(displacement, answer.parameter)

    built(1.0, poisson)
    none_compiled()
    once, twice = built(1.0, 0.9 * poisson), built(2.0, 0.9 * poisson)
    for one, other in zip(once, twice, strict=True):
        assert largest_difference(other, 2 * one) <= 1e-14  # products of numbers in another order


@needs("plots", "elasticity")
def test_new_parameters_compile_nothing(none_compiled):
    """The error of the mesh at other parameters of a formula; it scales with no modulus."""
    scene = pressed_pair(
        "plane_strain", (("E", "0.25 + 0.05 * E"), (2.0, 0.25)), {"E": (0.5, 2.0)}, cells=2
    )
    full = hhr.FullOrderModel(scene)
    points = full.parameters.random(2, 1)
    hhr.mesh_error(full, full.solve(points[0]))
    none_compiled()
    assert 0 < hhr.mesh_error(full, full.solve(points[1])).energy < 1


# ---------------------------------------------------------------- elasticity of a user's own


LAMBDA, SHEAR = 3.0 * 0.3 / 1.3 / 0.4, 3.0 / 2.6
"""Of E = 3 and nu = 0.3, as the block has."""


def hooke(strain):
    return LAMBDA * ufl.tr(strain) * ufl.Identity(3) + 2 * SHEAR * strain


@pytest.mark.parametrize("hypothesis", ["plane_strain", "plane_stress", "axisymmetric", "solid"])
def test_hookes_law_written_out(hypothesis):
    scene = pressed_block(hypothesis)
    one, two = (
        hhr.FullOrderModel(item, MPI.COMM_SELF).solve(0.05)
        for item in (scene, with_bodies(scene, stress=hooke))
    )
    check_like(two, one, displacement=1e-12, stress=1e-11)


def test_layers_across_the_load_are_as_stiff_as_they_are():
    """Without coupling of the axes a column in plane strain has the pressure E_y times its
    shortening.
    """

    def layered(strain):
        rows = [[(30.0, 7.0, 1.0)[i] if i == j else 2.0 for j in range(3)] for i in range(3)]
        return ufl.elem_mult(ufl.as_tensor(rows), strain)

    scene = with_bodies(pressed_block("plane_strain"), stress=layered)
    training = hhr.train(scene, [8], comm=MPI.COMM_SELF, held_out=20)
    full, model = training.full_order, training.build()
    for exact in (full.solve(0.05), model.solve(0.05)):
        # the gap of 0.02 closes first; the block is 2 high and 1.5 wide in this scene
        stress = exact.stress()[:, 1]
        assert np.ptp(stress) < 1e-9 * abs(stress).max()
        assert exact.forces().sum() == pytest.approx(-stress.mean() * 1.5, rel=1e-9)
    strain = -full.solve(0.05).stress()[:, 1].mean() / 7.0
    y, moved = full.problem.points[:, 1], full.solve(0.05).displacement().reshape(-1, 2)[:, 1]
    shorter = moved[y == y.min()].mean() - moved[y == y.max()].mean()
    assert strain == pytest.approx(shorter / np.ptp(y), rel=1e-9)


SHAPE = ("x", "y + push * y * (1 - y) * x")
"""Of the lower block, whose surfaces stay where they are."""
OTHERS = {
    "modulus": (lambda body: dataclasses.replace(body, young="2 + 10 * push"), {}),
    "ratio": (lambda body: dataclasses.replace(body, poisson="0.2 + push"), {}),
    "grading": (lambda body: dataclasses.replace(body, grading=lambda x: 1 + 0.1 * x[0]), {}),
    "shape": (lambda body: body, {"shapes": lambda: (hhr.Shape(two_blocks.FIRST, SHAPE),)}),
    "heat": (
        lambda body: body,
        {"loads": lambda: (hhr.ThermalExpansion(two_blocks.SECOND, 1e-2, slope("load")),)},
    ),
    "yield": (lambda body: dataclasses.replace(body, law=hhr.Plasticity(0.05, 0.3)), {}),
    "yield and heat": (
        lambda body: dataclasses.replace(body, law=hhr.Plasticity(0.05, 0.3)),
        {"loads": lambda: (hhr.ThermalExpansion(two_blocks.SECOND, 1e-2, slope("load")),)},
    ),
}


@needs("inelastic", "moduli", "shapes", "volume_loads")
@pytest.mark.parametrize(
    ("hypothesis", "other"),
    [
        *((flat, name) for flat in ("plane_strain", "plane_stress") for name in OTHERS),
        ("axisymmetric", "yield and heat"),
    ],
)
def test_hookes_law_written_out_beside_what_other_bodies_have(hypothesis, other):
    """The upper body says its elasticity itself.

    round-off, times what a step of plasticity leaves to Newton.
    """
    changed, parts = OTHERS[other]
    moduli = {
        "stress": lambda strain: (
            5 * (0.3 / 1.3 / 0.4 * ufl.tr(strain) * ufl.Identity(3) + strain / 1.3)
        )
    }
    found = []
    for own in ({}, moduli):
        bodies = (
            changed(hhr.Body(two_blocks.FIRST, 3.0, 0.3)),
            hhr.Body(two_blocks.SECOND, 5.0, 0.3, **own),
        )
        given = {name: made() for name, made in parts.items()}
        full = hhr.FullOrderModel(pressed_pair(hypothesis, bodies, **given), MPI.COMM_SELF)
        found.append(
            full.solve(
                full.parameters.point({"push": 0.05, "slide": 0.01, "load": 0.1, "gap": 0.001})
            )
        )
    one, two = found
    assert one.forces().max() > 0.01
    check_like(two, one, displacement=1e-9, stress=1e-9, forces=1e-9)


MONOCLINIC = np.array(
    [
        *(
            [4.0, 1.0, 1.0, 0.0, 0.5, 0.3],
            [1.0, 3.0, 1.0, 0.0, 0.4, 0.2],
            [1.0, 1.0, 5.0, 0.0, 0.6, 0.1],
        ),
        *(
            [0.0, 0.0, 0.0, 2.0, 0.0, 0.0],
            [0.5, 0.4, 0.6, 0.0, 3.0, 0.3],
            [0.3, 0.2, 0.1, 0.0, 0.3, 2.0],
        ),
    ]
)
"""A stiffness in Kelvin's notation: pulled in the plane, a body shears across it."""


def test_plane_stress_of_any_linear_law_has_no_stress_across():
    """A column that nothing holds sideways has one over the entry of its compliance for a modulus.

    round-off.
    """

    def coupled(strain):
        return elasticity.of_kelvin(
            ufl.as_matrix(MONOCLINIC.tolist()) * elasticity.kelvin(strain, "solid")
        )

    scene = with_bodies(pressed_block("plane_stress"), stress=coupled)
    answer = hhr.FullOrderModel(scene, MPI.COMM_SELF).solve(0.05)
    stress = answer.stress()
    assert np.abs(stress[:, [0, 2, 3]]).max() < 1e-12
    strain = (0.05 - 0.01) / 2.0
    assert stress[:, 1] == pytest.approx(-strain / np.linalg.inv(MONOCLINIC)[1, 1], rel=1e-10)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"stress": 3.0}, "the stress 3.0 must be a function of the strain"),
        pytest.param(
            {"law": Bingham(1.0, 1.0)}, "a user-defined stress, and a law", marks=needs("inelastic")
        ),
        ({"grading": lambda x: 1 + x[0]}, "a user-defined stress, and a law, a grading"),
        ({"young": "push + 1"}, "a user-defined stress, and a law, a grading or formulas"),
    ],
)
def test_what_is_not_built_in_is_refused(change, message):
    with pytest.raises(SceneError, match=message):
        hhr.Body(block.SOLID, **({"young": 1.0, "poisson": 0.3, "stress": hooke} | change))
