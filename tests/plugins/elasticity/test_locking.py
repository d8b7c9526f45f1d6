"""Bodies that keep their volume do not lock: limit loads, creep and nearly incompressible tubes by
closed forms.
"""

import dataclasses

import contact_patch_test as patch
import numpy as np
import pytest
from dolfinx import mesh
from needs import needs, present
from scenes import block_scene, pressed_block, slope, with_bodies
from tubes import YOUNG, in_time, lame, lame_displacement, lame_tube, tube

import hhr_dolfinx as hhr
from hhr_dolfinx import compat
from hhr_dolfinx.errors import ConvergenceError, LockingWarning
from hhr_dolfinx.geometries import block
from hhr_dolfinx.linear import sparse as cholesky
from hhr_dolfinx.plugins.elasticity.locking import gauss_degree


@needs("shapes")
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
@pytest.mark.parametrize("order", [1, 2])
def test_rules_of_the_stiffness_have_positive_weights(cell, order):
    """Energies of Gauss points would not be positive otherwise.

    Of degree 3 on tetrahedra one weight is negative.
    """
    from hhr_dolfinx.plugins.shapes.reshaped import stiffness_degree

    degrees = (
        gauss_degree(cell, order),
        *(stiffness_degree(cell, name, order) for name in ("solid", "axisymmetric")),
    )
    assert min(compat.quadrature(cell, degree)[1].min() for degree in degrees) > 0


FAR = hhr.Obstacle(block.side(0, upper=True), (1.0, 0.0), 1e6)
"""A tube beyond its limit load moves by whatever the last iterate says: nothing must hold it."""


FIRST, SECOND = [0.0, 0.4, 0.7, 0.9, 0.95, 0.98, 0.99, 1.01], [0.0, 0.4, 0.7, 0.9, 0.98, 0.99, 1.02]
"""Shares of the limit load on cells of either order."""


def triangles(comm):
    return block.block(comm, lower=(1.0, 0.0), upper=(2.0, 0.25), cells=(8, 2), simplices=True)


@needs("inelastic")
@pytest.mark.filterwarnings("error::hhr_dolfinx.errors.LockingWarning")
@pytest.mark.parametrize(
    ("poisson", "mesh", "order", "shares"),
    [
        (0.3, {"cells": 16}, 1, FIRST),
        (0.49, {"cells": 16}, 1, FIRST),
        *(
            pytest.param(0.3, mesh, 2, SECOND, marks=needs("second_order"))
            for mesh in ({"cells": 8}, {"geometry": triangles})
        ),
    ],
    ids=["quadrilaterals", "nearly incompressible", "second order", "triangles of second order"],
)
def test_a_tube_bears_its_limit_load_and_no_more(poisson, mesh, order, shares):
    """Perfect plasticity in plane strain: p = 2/√3 σ0 ln(b/a); a locked tube bears any pressure."""
    limit = 2 / np.sqrt(3) * np.log(2)
    scene = tube(hhr.Plasticity(1.0), 2.0, poisson=poisson, contacts=(FAR,), order=order, **mesh)
    last = len(shares) - 1
    with pytest.raises(
        ConvergenceError, match=f"step {last} to t = {last} s did not converge"
    ) as caught:
        hhr.FullOrderModel(scene).march(
            [(time, np.array([share * limit])) for time, share in enumerate(shares)]
        )
    done = caught.value.history.answers
    assert done[-1].parameter / limit == pytest.approx(0.99)
    assert done[-1].unknown.max() < 0.02


@needs("inelastic")
@pytest.mark.parametrize("poisson", [0.3, 0.49])
@pytest.mark.parametrize("exponent", [3.0, 5.0, 20.0])
def test_a_tube_creeps_as_fast_as_norton_says(exponent, poisson):
    """u_r grows by C / r, p = (m / √3) K (2 C / √3)^(1/m) (1 - 2^(-2/m)).

    A locked tube is 8 to 76 % too slow.
    """
    rate, resistance = 0.01, 2.0
    power = (2 * rate / np.sqrt(3)) ** (1 / exponent)
    pressure = exponent / np.sqrt(3) * resistance * power * (1 - 2 ** (-2 / exponent))
    full = hhr.FullOrderModel(tube(hhr.Norton(resistance, exponent), pressure, poisson=poisson))
    times = np.concatenate([[0.0, 1e-3], np.geomspace(1e-2, 17.0, 30)])
    path = [(time, np.array([pressure if time else 0.0])) for time in times]
    before, last = full.march(path, hhr.MarchSettings(floor_stress=1e-6)).answers[-2:]
    speed = (last.unknown - before.unknown).reshape(-1, 2)[:, 0] / (last.time - before.time)
    assert last.unknown.max() > 0.16
    assert speed * full.problem.points[:, 0] == pytest.approx(rate, rel=5e-3)


PUNCH = 99
"""Facet tag below the punch."""


def punched(per_unit, thickness=None):
    """A rigid smooth punch, 1 wide, on half of a block 4 x 2 of perfect plasticity, plane strain or
    one cell thick.
    """
    layer = () if thickness is None else (0.0, thickness)
    cells = (4 * per_unit, 2 * per_unit, *(1 for _ in layer[1:]))

    def geometry(comm):
        box = {"lower": (0.0, 0.0, *layer[:1]), "upper": (4.0, 2.0, *layer[1:])}
        built, cell_tags, tags = block.block(comm, **box, cells=cells)
        middles = mesh.compute_midpoints(built, built.topology.dim - 1, tags.indices)
        below = (tags.values == block.side(1, upper=True)) & (middles[:, 0] < 1.0)
        values = np.where(below, PUNCH, tags.values).astype(np.int32)
        return built, cell_tags, mesh.meshtags(built, built.topology.dim - 1, tags.indices, values)

    held = [(0, False, 0), (0, True, 0), (1, False, 0), (1, False, 1)]
    held += [(2, upper, 2) for upper in (False, True) if layer]
    return block_scene(
        "punched",
        {"push": (0.0, 0.2)},
        geometry=geometry,
        hypothesis="solid" if layer else "plane_strain",
        bodies=(hhr.Body(block.SOLID, YOUNG, 0.3, hhr.Plasticity(1.0)),),
        contacts=(hhr.Obstacle(PUNCH, (0.0, 1.0, *layer[:1]), 2.0),),
        displacements=tuple(
            hhr.Displacement(block.side(axis, upper), component) for axis, upper, component in held
        ),
        openings=(hhr.Opening(0, slope("push", -1.0)),),
    )


def pushed(full, depth, steps):
    return full.march([(k, np.array([depth * k / steps])) for k in range(steps + 1)])


@needs("inelastic")
def test_a_punch_reaches_the_load_of_prandtl():
    """(2 + π) σ0 / √3 however deep, where the force of cells that lock grows.

    The error is of first order.
    """
    prandtl, plateaus = (2 + np.pi) / np.sqrt(3), []
    for per_unit in (8, 16):
        forces = [
            answer.forces().sum()
            for answer in pushed(hhr.FullOrderModel(punched(per_unit)), 0.1, 20).answers
        ]
        plateaus.append(forces[-1])
        assert forces[-1] == pytest.approx(prandtl, rel=0.05)
        # the last tenth of the way; 0.5 % when locked
        assert forces[-1] - forces[-3] < 5e-4 * forces[-1]
    assert 2 * plateaus[1] - plateaus[0] == pytest.approx(prandtl, rel=5e-3)


@needs("inelastic")
def test_hexahedra_in_plane_strain_are_the_quadrilaterals():
    """One layer held on both sides: the same history."""
    plane, space = (hhr.FullOrderModel(punched(4, thickness)) for thickness in (None, 0.5))
    for ours, theirs in zip(
        pushed(space, 0.1, 6).answers, pushed(plane, 0.1, 6).answers, strict=True
    ):
        # both to a residual of 1e-5
        assert ours.forces().sum() / 0.5 == pytest.approx(theirs.forces().sum(), rel=1e-3)
        assert ours.plastic_strain().max() == pytest.approx(theirs.plastic_strain().max(), rel=2e-2)


def distorted(dim):
    cells = ((4, 3), (7, 3)) if dim == 2 else ((2, 2, 2), (3, 3, 2))
    return patch.scene(
        hhr.NodeToSurface, *cells, poisson=0.3, angle=1.0, bulge=0.04, by_normal=dim == 2
    )


def answers(scene, pressure):
    elastic = hhr.FullOrderModel(scene)
    yield elastic, elastic.solve(pressure)
    if present("inelastic"):
        full = in_time(scene)
        yield full, full.march([(0.0, np.zeros(1)), (1.0, np.array([pressure]))]).answers[-1]


def test_a_nearly_incompressible_tube():
    """nu = 0.4999: displacements to 0.1 % at every node; 24 cells of full integration miss 90 %."""
    A, C = lame(1.0, 0.0)
    for model, answer in answers(lame_tube(32, 9.0, poisson=0.4999), 1.0):
        displacement, points = answer.displacement(), model.problem.points
        exact = lame_displacement(A, C, points[:, 0], 0.4999)
        assert displacement.reshape(-1, 2)[:, 0] == pytest.approx(exact, rel=1e-3)
        middles = points[model.problem.cell_nodes].mean(axis=1)[:, 0]
        # sigma_r, sigma_theta and sigma_z, whose size is 5/3 at the bore: pressures are constant in
        # each cell
        exact = np.stack(
            [A - C / middles**2, A + C / middles**2, 2 * 0.4999 * A + 0 * middles], axis=1
        )
        assert model.stress_of(displacement)[:, [0, 2, 1]] == pytest.approx(exact, abs=5e-3)


@needs("inelastic", "nonmatching")
@pytest.mark.parametrize("dim", [2, 3])
def test_stresses_of_cells_have_the_pressure_of_their_points(dim):
    """One for all Gauss points of a cell, and that of its middle, on distorted cells.

    round-off times 5000.
    """
    full = in_time(with_bodies(distorted(dim), poisson=0.4999))
    # any field will do
    displacement = np.sin(3 * full.problem.points + 1).ravel()
    material, operator = full.equilibrium.material, full.equilibrium.operator
    points = material.update(operator.strain(displacement), material.at_rest(), 1.0, tangent=False)
    pressures = points.stress[:, :3].sum(axis=1).reshape(-1, operator.per_cell)
    middles = full.stress_of(displacement)[:, :3].sum(axis=1)
    assert pressures == pytest.approx(
        np.tile(middles[:, None], pressures.shape[1]), abs=1e-11 * np.abs(middles).max()
    )


def test_a_nearly_incompressible_shrink_fit():
    """Pressed 1 % into a rigid ring without pressure inside: contact pressure to 0.1 %."""
    pressure = -0.02 / lame_displacement(*lame(0.0, 1.0), 2.0, 0.4999)
    for model, answer in answers(lame_tube(32, -0.02, poisson=0.4999), 0.0):
        assert answer.forces() / model.problem.contact_areas == pytest.approx(pressure, rel=1e-3)


@needs("inelastic", "nonmatching")
@pytest.mark.parametrize("dim", [2, 3])
def test_linear_fields_keep_their_strain_on_distorted_cells(dim):
    """The mean of a constant is that constant: patch tests hold whatever the shape of the cells."""
    scene = distorted(dim)
    full = hhr.FullOrderModel(with_bodies(scene, law=hhr.Plasticity(1.0)))
    gradient = np.random.default_rng(0).standard_normal((dim, dim))
    strain = np.zeros((3, 3))
    strain[:dim, :dim] = (gradient + gradient.T) / 2
    kelvin = [
        *np.diag(strain),
        *(2**0.5 * strain[pair] for pair in [(0, 1), (0, 2), (1, 2)][: 2 * dim - 3]),
    ]
    operator = full.equilibrium.operator
    found = operator.strain((full.problem.points @ gradient.T).ravel())
    assert found == pytest.approx(np.tile(kelvin, (len(found), 1)), abs=1e-12)
    # and it is not the strain of the points that the operator holds
    wavy = np.sin(3 * full.problem.points).ravel()
    mean = operator.strain(wavy)
    difference = mean - in_time(scene).equilibrium.operator.strain(wavy)
    assert np.ptp(mean[:, :3].sum(axis=1).reshape(-1, operator.per_cell), axis=1).max() < 1e-12
    assert np.abs(difference[:, 0]).max() > 1e-3
    assert difference[:, 1:3] == pytest.approx(difference[:, :1] * [1, 1], abs=1e-12)


@needs("nonmatching")
def test_ordinary_bodies_keep_full_integration():
    """Up to nu = 0.45 elastic bodies have the stiffness they always had, beside others too."""
    scene = distorted(2)
    other = dataclasses.replace(scene.bodies[1], poisson=0.4999)
    beside = dataclasses.replace(scene, bodies=(scene.bodies[0], other))
    before, after = (hhr.FullOrderModel(item) for item in (scene, beside))
    assert before.discretisation.mean_dilatation == (False, False)
    assert after.discretisation.mean_dilatation == (False, True)
    cells = before.problem.cell_nodes[before.discretisation.cell_bodies() == 0]
    dofs = (2 * np.unique(cells)[:, None] + np.arange(2)).ravel()
    kept, still = (model.problem.stiffness[dofs][:, dofs] for model in (before, after))
    assert abs(kept - still).max() < 1e-14 * abs(kept).max()


@needs("inelastic")
@pytest.mark.parametrize("hypothesis", ["plane_strain", "axisymmetric", "solid"])
def test_the_elastic_model_and_that_in_time_have_one_stiffness(hypothesis):
    scene = pressed_block(hypothesis, poisson=0.4999, cells=3)
    ours, theirs = hhr.FullOrderModel(scene).problem.stiffness, in_time(scene).problem.stiffness
    assert abs(ours - theirs).max() < 1e-14 * abs(theirs).max()


@pytest.mark.parametrize("hypothesis, cell, remedy", [
    ("plane_strain", "triangle", "quadrilaterals"), ("solid", "tetrahedron", "hexahedra"),
])  # fmt: skip
def test_cells_that_lock_are_named(hypothesis, cell, remedy):
    scene = pressed_block(hypothesis, simplices=True, cells=2)
    if present("inelastic"):
        with pytest.warns(
            LockingWarning, match=rf"body 1 .* has a law.* {cell}.* Mesh it with {remedy}"
        ):
            hhr.FullOrderModel(with_bodies(scene, law=hhr.Plasticity(1.0)))
    with pytest.warns(
        LockingWarning, match=rf"body 1 .* nu = 0\.46.* {cell}.* Mesh it with {remedy}"
    ):
        hhr.FullOrderModel(with_bodies(scene, poisson=0.46))


def test_what_does_not_lock_is_not_warned_of():
    """Moderate ratios, and plane stress, where the thickness gives way.

    Warnings are errors in these tests.
    """
    hhr.FullOrderModel(pressed_block("plane_strain", simplices=True, poisson=0.44))
    free = hhr.FullOrderModel(pressed_block("plane_stress", poisson=0.4999))
    assert free.discretisation.mean_dilatation == (False,)
    hhr.FullOrderModel(pressed_block("plane_stress", simplices=True, poisson=0.4999))


@needs("inelastic")
def test_blocks_of_mumps_are_the_columns_of_petsc(monkeypatch):
    """Both factorisations, in several blocks and for a single column, against one solve after the
    other.
    """
    full = in_time(pressed_block("solid", cells=4))
    problem, factors = full.problem, full.store.first
    assert factors._factors._ksp.getPC().getFactorSolverType() == "mumps"
    monkeypatch.setattr(cholesky, "RIGHT_SIDES", 7)  # 25 columns
    own = cholesky.FreeCholesky(
        problem.stiffness, problem.free, slice(0, len(problem.free)), "block", "nd", full.comm
    )
    expected = np.stack([own.solve(row).copy() for row in problem.contact.toarray()], axis=1)
    size = np.abs(expected).max()
    for solver in (own, factors):
        assert solver.solve_columns(problem.contact.T) == pytest.approx(expected, abs=1e-12 * size)
        assert solver.solve_columns(problem.contact[:1].T)[:, 0] == pytest.approx(
            expected[:, 0], abs=1e-12 * size
        )


@needs("inelastic")
def test_a_history_in_space_without_mumps(monkeypatch):
    """Where PETSc was built without it: the same history by PETSc's own Cholesky."""
    scene = punched(3, thickness=0.5)
    first = hhr.FullOrderModel(scene)
    monkeypatch.setattr("hhr_dolfinx.full_order.full.ordering_of", lambda block_size, plane: plane)
    second = hhr.FullOrderModel(scene)
    made = (model.store.first._factors._ksp.getPC() for model in (first, second))
    assert [factors.getFactorSolverType() for factors in made] == ["mumps", "petsc"]
    for ours, theirs in zip(
        pushed(first, 0.05, 5).answers, pushed(second, 0.05, 5).answers, strict=True
    ):
        # round-off, where the tangents are nearly singular
        assert ours.unknown == pytest.approx(theirs.unknown, abs=1e-8)
        assert np.array_equal(ours.active, theirs.active)
