"""Curved rigid obstacles: gaps and normals by formulas, closed forms of contact, and parameters of
place and size.
"""

import itertools
import warnings
from dataclasses import replace

import numpy as np
import pytest
from needs import needs
from scenes import block_scene
from surfaces import make

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotOfferedError, PairingWarning, SceneError, SceneWarning
from hhr_dolfinx.formulas import Scalar
from hhr_dolfinx.geometries import block
from hhr_dolfinx.plugins.obstacles.rigid import Distances, distances

RNG = np.random.default_rng(0)
POINTS = RNG.normal(size=(40, 3))
PLANE = RNG.normal(size=(40, 2))
LEFT, RIGHT = (block.side(0, upper=upper) for upper in (False, True))
BOTTOM, TOP = (block.side(1, upper=upper) for upper in (False, True))
YOUNG, POISSON = 1.0, 0.3
PLANE_MODULUS = YOUNG / (1 - POISSON**2)


def warped(warp, lower, upper, cells, **others):
    """Geometry of a block whose points are moved by a function of (n, dim)."""

    def build(comm):
        mesh, cells_of, facets = block.block(comm, lower=lower, upper=upper, cells=cells, **others)
        dim = mesh.geometry.dim
        mesh.geometry.x[:, :dim] = warp(mesh.geometry.x[:, :dim].copy())
        return mesh, cells_of, facets

    return build


def graded(points):
    """A block four wide and deep, finer towards the origin."""
    return 4 * np.sinh(0.8 * points) / np.sinh(3.2)


def hertz(contacts, box, **others):
    """An axisymmetric block below z = 0 whose foot is held."""
    return block_scene(
        "hertz",
        box,
        geometry=warped(graded, (0, -4), (4, 0), (32, 32)),
        hypothesis="axisymmetric",
        contacts=contacts,
        displacements=(*hhr.Displacement.clamp(BOTTOM, 2), hhr.Displacement(LEFT, 0)),
        **others,
    )


def cloud(obstacle, points, inside=False):
    """Gaps and normals of points by the geometry of an obstacle of numbers."""
    sizes = np.array([float(size) for size in obstacle._sizes])
    normals, beyond = obstacle._shape.normals(sizes, points)
    assert not beyond.any()
    return obstacle._shape.along(sizes, points, normals), normals


@pytest.mark.parametrize("inside", [False, True])
def test_spheres_circles_and_cylinders_are_exact(inside):
    sign = -1.0 if inside else 1.0
    axis = np.array([1.0, 2.0, -2.0]) / 3
    place = np.array([0.1, -0.2, 0.3])
    across = (POINTS - place) - np.outer((POINTS - place) @ axis, axis)
    for obstacle, points, offsets in (
        (hhr.Sphere(1, tuple(place), 0.7, inside=inside), POINTS, POINTS - place),
        (hhr.Circle(1, tuple(place[:2]), 0.7, inside=inside), PLANE, PLANE - place[:2]),
        (hhr.Cylinder(1, tuple(place), tuple(5 * axis), 0.7, inside=inside), POINTS, across),
    ):
        radii = np.linalg.norm(offsets, axis=1)
        gaps, normals = cloud(obstacle, points)
        assert gaps == pytest.approx(sign * (radii - 0.7), abs=1e-13)
        assert normals == pytest.approx(-sign * offsets / radii[:, None], abs=1e-13)


@pytest.mark.parametrize("angle", [20.0, 45.0, 60.0])
def test_cones_are_exact(angle):
    """Nearest to the side at the foot of the perpendicular, or to the tip.

    At 45 degrees the quadric is linear.
    """
    radius, height = np.hypot(POINTS[:, 0], POINTS[:, 1]), POINTS[:, 2]
    sine, cosine = np.sin(np.deg2rad(angle)), np.cos(np.deg2rad(angle))
    side = radius * cosine - height * sine
    on_side = height * cosine + radius * sine > 0
    assert 0 < on_side.sum() < len(POINTS)
    gaps, normals = cloud(hhr.Cone(1, (0, 0, 0), (0, 0, 3), angle), POINTS)
    assert gaps == pytest.approx(np.where(on_side, side, np.linalg.norm(POINTS, axis=1)), abs=1e-12)
    assert -normals[~on_side] == pytest.approx(
        POINTS[~on_side] / np.linalg.norm(POINTS[~on_side], axis=1)[:, None]
    )
    assert normals[on_side, 2] == pytest.approx(sine)
    gaps, normals = cloud(hhr.Cone(1, (0, 0, 0), (0, 0, 3), angle, inside=True), POINTS[on_side])
    assert gaps == pytest.approx(-side[on_side], abs=1e-12)
    assert normals[:, 2] == pytest.approx(-sine)


def test_profiles_find_the_closest_point():
    """Of a parabola, against roots of its cubic; of a polygon with corners.

    Of a circle, to the error of its spline.
    """
    points = np.column_stack([RNG.uniform(-0.7, 0.7, 60), RNG.uniform(-0.8, 0.8, 60)])
    gaps, normals = cloud(hhr.Profile(1, "0.3 * x**2", between=(-2, 2)), points)
    for (x, y), gap, normal in zip(points, gaps, normals, strict=True):
        # (x - t) + 0.6 t (y - 0.3 t^2) = 0
        roots = np.roots([-0.18, 0.0, 0.6 * y - 1, x])
        roots = np.real(roots[np.abs(np.imag(roots)) < 1e-9])
        distances = np.hypot(x - roots, y - 0.3 * roots**2)
        assert abs(gap) == pytest.approx(distances.min(), abs=1e-10)
        t = roots[distances.argmin()]
        assert np.array([x, y]) + gap * normal == pytest.approx([t, 0.3 * t**2], abs=1e-10)
    square = hhr.Profile(1, [(1, 1), (-1, 1), (-1, -1), (1, -1), (1, 1)], smooth=False)
    gaps, normals = cloud(square, np.array([[2.0, 0.3], [2.0, 3.0], [-1.5, -1.5], [0.5, 0.2]]))
    assert np.abs(gaps) == pytest.approx([1.0, np.hypot(1, 2), np.hypot(0.5, 0.5), 0.5])
    assert np.abs(normals[1]) == pytest.approx(np.array([1, 2]) / np.sqrt(5))
    errors = []
    for count in (20, 40):
        angles = np.linspace(0, 2 * np.pi, count + 1)
        circle = np.column_stack([np.cos(angles), np.sin(angles)])
        circle[-1] = circle[0]
        radii = np.linalg.norm(PLANE, axis=1)
        gaps, _ = cloud(hhr.Profile(1, circle), PLANE)
        assert len(set(np.sign(gaps * (radii - 1)))) == 1
        errors.append(np.abs(np.abs(gaps) - np.abs(radii - 1)).max())
    assert errors[1] < errors[0] / 12  # of fourth order


def octahedron(level=3, flip=False):
    """A sphere of triangles; ``flip`` turns every third one the other way."""
    points = np.vstack([np.eye(3), -np.eye(3)])
    facets = [
        (0, 1, 2),
        (1, 3, 2),
        (3, 4, 2),
        (4, 0, 2),
        (1, 0, 5),
        (3, 1, 5),
        (4, 3, 5),
        (0, 4, 5),
    ]
    points = [tuple(point) for point in points]
    for _ in range(level):
        finer = []
        for a, b, c in facets:
            middles = []
            for one, two in ((a, b), (b, c), (c, a)):
                middle = np.add(points[one], points[two])
                points.append(tuple(middle / np.linalg.norm(middle)))
                middles.append(len(points) - 1)
            x, y, z = middles
            finer += [(a, x, z), (x, b, y), (z, y, c), (x, y, z)]
        facets = finer
    if flip:
        facets = [facet[::-1] if k % 3 == 1 else facet for k, facet in enumerate(facets)]
    return np.array(points), np.array(facets)


def test_a_rigid_mesh_is_the_sphere_that_it_stands_for(tmp_path):
    """To the sag of its facets, of second order.

    Whatever the sides of its triangles, and from a file.
    """
    import meshio

    outside = POINTS[np.linalg.norm(POINTS, axis=1) > 1.1]
    radii = np.linalg.norm(outside, axis=1)
    errors = []
    for level in (2, 3):
        gaps, normals = cloud(hhr.RigidMesh(1, octahedron(level, flip=True)), outside)
        sign = np.sign(gaps[0])
        errors.append(np.abs(sign * gaps - (radii - 1)).max())
        cosines = -sign * np.einsum("md,md->m", normals, outside / radii[:, None])
        assert cosines.min() > np.cos(np.deg2rad(0.6 * 90 / 2**level))
    assert errors[1] < 0.35 * errors[0] < 0.35 * 0.15
    path = tmp_path / "ball.stl"
    points, facets = octahedron()
    meshio.write_points_cells(path, points, [("triangle", facets)])
    assert np.abs(cloud(hhr.RigidMesh(1, path), outside)[0]) == pytest.approx(
        np.abs(gaps), abs=1e-6
    )


def test_nodes_that_look_away_have_no_condition():
    """A disc whose whole outside is named lies on a circle, on a floor of two points, and in a
    hole.
    """
    angles = 2 * np.pi * (np.arange(24) + 0.5) / 24
    points = np.column_stack([np.cos(angles), np.sin(angles)])
    surface = make(
        7, points, np.column_stack([np.arange(24), (np.arange(24) + 1) % 24]), np.zeros(2)
    )
    for floor in (hhr.Circle(7, (0, -3), 1.5), hhr.Profile(7, [(-5, -1.5), (5, -1.5)])):
        rows = floor.rows([surface], 48)
        assert 8 <= rows.gap.size <= 12 and (rows.points[:, 1] < 0).all() and rows.gap.min() > 0.45
    assert rows.gap == pytest.approx(1.5 + rows.points[:, 1])
    assert rows.areas.sum() == pytest.approx(np.pi, rel=0.01)
    rows = hhr.Circle(7, (0, 0), 1.2, inside=True).rows([surface], 48)
    assert rows.gap == pytest.approx(np.full(24, 0.2))
    short = hhr.Profile(7, [(-0.3, -1.5), (0.3, -1.5)])
    with pytest.warns(
        PairingWarning, match=r"10 of 24 nodes of surface 7 lie beyond the end of the Profile"
    ):
        assert short.rows([surface], 48).gap.size == 2


@pytest.mark.parametrize("drawn", [False, True])
def test_hertz_by_a_rigid_sphere(drawn):
    """Largest pressure for the force, (6 F E*^2 / (pi^3 R^2))^(1/3), within 1 %, of twelve nodes in
    contact.

    The profile is the parabola x^2 / 2R, which Hertz takes for the sphere.
    """
    sphere = hhr.Circle(TOP, (0.0, "10 - push"), 10.0)
    tool = hhr.Profile(TOP, "r**2 / 20", between=(0, 9), place=(0, "-push")) if drawn else sphere
    full = hhr.FullOrderModel(hertz((tool,), {"push": (0.001, 0.02)}))
    answer = full.solve(0.02)
    force = answer.forces().sum()
    largest = (6 * force * PLANE_MODULUS**2 / np.pi**3 / 100) ** (1 / 3)
    assert (answer.forces() / full.problem.contact_areas).max() == pytest.approx(largest, rel=0.01)
    # of a half-space, which this block of 9 contact radii resembles: stiffer by an eighth
    assert 1 < force / (4 / 3 * PLANE_MODULUS * np.sqrt(10) * 0.02**1.5) < 1.15


def solid_hertz(tool, cells=(14, 14, 12)):
    top, foot = block.side(2, upper=True), block.side(2, upper=False)
    scene = block_scene(
        "solid",
        {"push": (0.01, 0.06)},
        geometry=warped(graded, (0, 0, -4), (4, 4, 0), cells),
        hypothesis="solid",
        contacts=(tool(top),),
        displacements=(
            *hhr.Displacement.clamp(foot, 3),
            hhr.Displacement(LEFT, 0),
            hhr.Displacement(BOTTOM, 1),
        ),
    )
    full = hhr.FullOrderModel(scene)
    answer = full.solve(0.06)
    pressures = answer.forces() / full.problem.contact_areas
    return answer.forces().sum(), pressures, full.problem.contact_points


def test_hertz_in_space():
    """A quarter below a sphere, within 5 %: six nodes lie along the radius of contact."""
    force, pressures, points = solid_hertz(lambda top: hhr.Sphere(top, (0, 0, "10 - push"), 10.0))
    largest = (6 * 4 * force * PLANE_MODULUS**2 / np.pi**3 / 100) ** (1 / 3)
    assert pressures.max() == pytest.approx(largest, rel=0.05)
    assert pressures.argmax() == np.linalg.norm(points, axis=1).argmin()
    x, y = (part.ravel() for part in np.meshgrid(*[np.linspace(-1, 5, 61)] * 2, indexing="ij"))
    numbers = np.arange(61**2).reshape(61, 61)
    quads = np.column_stack([part.ravel() for part in (
        numbers[:-1, :-1], numbers[1:, :-1], numbers[1:, 1:], numbers[:-1, 1:])])  # fmt: skip
    cap = np.column_stack([x, y, 10 - np.sqrt(100 - x**2 - y**2)]), quads
    meshed, *_ = solid_hertz(
        lambda top: hhr.RigidMesh(top, cap, place=(0, 0, "-push")), (10, 10, 8)
    )
    exact, *_ = solid_hertz(lambda top: hhr.Sphere(top, (0, 0, "10 - push"), 10.0), (10, 10, 8))
    assert meshed == pytest.approx(
        exact, rel=0.005
    )  # facets sag by 0.0003, a two-hundredth of the push


def test_a_cylinder_presses_as_its_section():
    """A slice in plane strain, in space below a cylinder and in the plane below a circle."""
    flat = block_scene(
        "flat",
        {"push": (0.01, 0.06)},
        geometry=warped(graded, (0, -4), (4, 0), (14, 12)),
        contacts=(hhr.Circle(TOP, (0, "10 - push"), 10.0),),
        displacements=(*hhr.Displacement.clamp(BOTTOM, 2), hhr.Displacement(LEFT, 0)),
    )

    def slab(points):
        return np.column_stack([graded(points[:, :1]), points[:, 1], graded(points[:, 2:])])

    top, foot = block.side(2, upper=True), block.side(2, upper=False)
    slice_ = block_scene(
        "slice",
        {"push": (0.01, 0.06)},
        geometry=warped(slab, (0, 0, -4), (4, 0.5, 0), (14, 1, 12)),
        hypothesis="solid",
        contacts=(hhr.Cylinder(top, (0, 0, "10 - push"), (0, 1, 0), 10.0),),
        displacements=(
            *hhr.Displacement.clamp(foot, 3),
            hhr.Displacement(LEFT, 0),
            hhr.Displacement(BOTTOM, 1),
            hhr.Displacement(TOP, 1),
        ),
    )
    one, other = (hhr.FullOrderModel(scene).solve(0.06).forces().sum() for scene in (flat, slice_))
    assert other == pytest.approx(0.5 * one, rel=1e-9)


def ring(cells, contacts, box, **others):
    """A quarter of a ring 1 <= r <= 2 in plane strain, pressed from inside by 0.05."""

    def warp(points):
        r, angle = points[:, 0], points[:, 1] * np.pi / 2
        return np.column_stack([r * np.cos(angle), r * np.sin(angle)])

    return block_scene(
        "ring",
        box,
        geometry=warped(warp, (1, 0), (2, 1), cells),
        contacts=contacts,
        displacements=(hhr.Displacement(BOTTOM, 1), hhr.Displacement(TOP, 0)),
        **{"loads": (hhr.Pressure(LEFT, 0.05),)} | others,
    )


def lame(gap):
    """Pressure outside of the ring whose outside moves by a gap."""
    lam, mu = YOUNG * POISSON / (1 + POISSON) / (1 - 2 * POISSON), YOUNG / 2 / (1 + POISSON)
    rows = [[2.0, 0.5], [2 * (lam + mu), -2 * mu]]
    a, b = np.linalg.solve(rows, [gap, -0.05])
    return -(2 * (lam + mu) * a - 2 * mu * b / 4)


def test_a_ring_in_a_hole_whose_radius_is_a_parameter():
    """Against Lame, second order in the cells; and that of holes with a fixed radius, to
    round-off.
    """
    box = {"R": (1.995, 2.02)}
    errors = []
    for cells in ((4, 8), (8, 16)):
        full = hhr.FullOrderModel(ring(cells, (hhr.Circle(RIGHT, (0, 0), "R", inside=True),), box))
        errors.append(0.0)
        for radius in (1.995, 2.01):
            pressures = full.solve(radius).forces() / full.problem.contact_areas
            errors[-1] = max(errors[-1], np.abs(pressures / lame(radius - 2) - 1).max())
    assert errors[1] < 0.4 * errors[0] < 0.03
    hole = hhr.Circle(RIGHT, (0, 0), 2.01, inside=True)
    with pytest.warns(SceneWarning, match="have no effect"):
        fixed = hhr.FullOrderModel(ring((8, 16), (hole,), box))
    assert full.solve(2.01).forces() == pytest.approx(fixed.solve(2.0).forces(), abs=1e-12)


@needs("second_order")
def test_cells_of_second_order_average_what_parameters_add():
    """The gaps of all conditions at a point are those of an obstacle there."""
    scene = ring(
        (2, 3),
        (hhr.Circle(RIGHT, ("a", 0), "R", inside=True),),
        {"a": (0.0, 1e-3), "R": (2.0, 2.02)},
        order=2,
    )
    with pytest.warns(PairingWarning, match="sides of surface .* are straight"):
        problem = hhr.FullOrderModel(scene).problem
        still = replace(scene, contacts=(hhr.Circle(RIGHT, (2e-4, 0), 2.013, inside=True),))
        with pytest.warns(SceneWarning, match="have no effect"):
            fixed = hhr.FullOrderModel(still).problem
    gaps = problem.gaps @ problem.amplitudes(np.array([2e-4, 2.013]))
    assert np.ptp(gaps) > 1e-3
    # normals turn by 3e-4 / 2
    assert gaps == pytest.approx(fixed.gaps[:, 0], abs=2e-7)


PARAMETERS = {
    "radius": (hhr.Circle(TOP, (0.0, "R - 0.02"), "R"), {"R": (8.0, 12.0)}),
    "only the radius": (hhr.Circle(TOP, (0.0, 9.98), "R"), {"R": (9.985, 9.995)}),
    "profile": (
        hhr.Profile(TOP, "r**2 / 20", between=(0, 20), place=(0, "-push"), scale="s"),
        {"push": (0.01, 0.02), "s": (0.9, 1.1)},
    ),
}


def fixed(tool, values):
    """The obstacle with numbers in the place of its formulas."""
    from hhr_dolfinx.formulas import Formula

    def number(size):
        return Formula(size)(values) if isinstance(size, str) else size

    if isinstance(tool, hhr.Circle):
        return replace(tool, center=tuple(map(number, tool.center)), radius=number(tool.radius))
    return replace(tool, place=tuple(map(number, tool.place)), scale=number(tool.scale))


@pytest.mark.parametrize("name", PARAMETERS)
def test_all_models_have_the_answers_of_fixed_obstacles(name, tmp_path):
    """Within 0.6 % of the largest force, since normals turn by half a degree.

    Derivatives are those of differences.
    """
    tool, box = PARAMETERS[name]
    scene = hertz((tool,), box)
    training = hhr.train(scene, hhr.Sobol(12), held_out=20)
    full = training.full_order
    models = [full, hhr.condense(full), training.build()]
    for number, model in enumerate(models[1:]):
        hhr.save_model(tmp_path / f"{number}.npz", model)
        models.append(hhr.load_model(tmp_path / f"{number}.npz"))
    ends = np.array([scene.parameters.lower, scene.parameters.upper])
    for share in (0.1, 0.8):
        point = ends[0] + share * (ends[1] - ends[0])
        values = dict(zip(scene.parameters.names, point.tolist(), strict=True))
        alone = hhr.FullOrderModel(hertz((fixed(tool, values),), {"idle": (0.0, 1.0)}, loads=(
            hhr.Pressure(RIGHT, hhr.Amplitude(slopes={"idle": 1e-9})),)))  # fmt: skip
        forces = alone.solve(0.0).forces()
        largest = forces.max()
        assert largest > 0
        for model in models:
            assert model.solve(point).forces() == pytest.approx(forces, abs=6e-3 * largest)
        for model in models:
            answer = model.solve(point, gradient=True)
            step = 1e-6 * (ends[1] - ends[0])
            for place in range(point.size):
                there = np.eye(point.size)[place] * step
                moved = [model.solve(point + sign * there).multipliers for sign in (1, -1)]
                slope = (moved[0] - moved[1]) / (2 * step[place])
                assert answer.gradient.multipliers[:, place] == pytest.approx(
                    slope, abs=1e-5 * np.abs(slope).max()
                )


def test_terms_of_gaps_stand_beside_all_others():
    """Loads, lifts and openings, affine and by formulas: in the middle answers are those of a fixed
    one.

    The foot rises by a formula, and a second obstacle is a plane.
    """
    box = {"push": (0.005, 0.015), "p": (0.0, 1.0)}
    others = {
        "loads": (
            hhr.Pressure(RIGHT, "1e-3 * p**2"),
            hhr.Pressure(RIGHT, hhr.Amplitude(slopes={"p": 1e-3})),
        ),
        "openings": (
            hhr.Opening(0, hhr.Amplitude(slopes={"p": 1e-3})),
            hhr.Opening(1, hhr.Amplitude(slopes={"p": -2e-3})),
        ),
    }
    foot = (
        hhr.Displacement(BOTTOM, 0),
        hhr.Displacement(BOTTOM, 1, "2e-3 * p**2"),
        hhr.Displacement(LEFT, 0),
    )
    wall = hhr.Obstacle(RIGHT, (1, 0), 4.002)
    made = [
        replace(
            hertz((hhr.Circle(TOP, (0.0, place), 10.0), wall), box, **others), displacements=foot
        )
        for place in ("10 - push", 9.99)
    ]
    training = hhr.train(made[0], hhr.Sobol(12), held_out=20)
    full = training.full_order
    with pytest.warns(SceneWarning, match="have no effect"):
        fixed = hhr.FullOrderModel(made[1])
    for point in ((0.01, 0.3), (0.01, 0.9)):
        forces = fixed.solve(point).forces()
        assert (forces > 0).sum() > 5
        for model in (full, hhr.condense(full), training.build()):
            assert model.solve(point).forces() == pytest.approx(forces, abs=1e-6 * forces.max())


def test_a_displacement_by_a_formula_beside_a_tool_that_moves_by_a_formula():
    """On the imposed foot the displacement is the formula itself, also hyper-reduced under a
    partial pressure.
    """
    foot = (hhr.Displacement(BOTTOM, 0), hhr.Displacement(BOTTOM, 1, "-2e-3 * p**2"))
    tool = hhr.Circle(TOP, (0.5, "2 - push"), "1 - 0.01 * p")
    scene = block_scene(
        "tool",
        {"push": (0.01, 0.03), "p": (0.2, 1.0)},
        cells=(6, 4),
        contacts=(tool,),
        displacements=foot,
        loads=(hhr.PartialPressure(RIGHT, hhr.Amplitude(0.01), "p"),),
    )
    training = hhr.train(scene, hhr.Sobol(16))
    full = training.full_order
    low = 2 * np.flatnonzero(np.isclose(full.problem.points[:, 1], 0.0)) + 1
    model = training.build(hhr.Recipe().as_it_is())
    for mu in scene.parameters.random(3, seed=1):
        field = model.solve(mu).displacement()
        assert field[low] == pytest.approx(np.full(low.size, -2e-3 * mu[1] ** 2), rel=1e-12)
        assert field == pytest.approx(full.solve(mu).displacement(), abs=1e-8 * np.abs(field).max())


@pytest.mark.parametrize("radius", [1.99, "1.99 + 0 * push"])
def test_a_tool_moves_by_a_formula_into_an_imposed_node(radius):
    """Over the corner of a held side the tool hangs 0.01 and goes down by 0.03: 0.02 deep."""
    scene = block_scene(
        "corner", {"push": (0.0, 0.03)}, contacts=(hhr.Circle(TOP, (0.0, "3 - push"), radius),),
        displacements=hhr.Displacement.clamp(LEFT, 2),
    )  # fmt: skip
    with pytest.warns(
        SceneWarning,
        match=r"at 1 places .* penetrate, most \(0\.02\) at \[.*\] for {'push': 0\.03}",
    ):
        hhr.FullOrderModel(scene)


def test_gaps_are_exact_along_the_normals_of_the_middle():
    """x + g n is on the obstacle at every point, and derivatives are those of differences."""
    top = block.side(2, upper=True)
    box = {"a": (0.0, 0.3), "b": (0.9, 1.1)}
    tools = (
        (
            hhr.Sphere(top, ("a", 0.5, "2 + a"), "b"),
            lambda x, a, b: np.linalg.norm(x - [a, 0.5, 2 + a], axis=1) - b,
        ),
        (
            hhr.Cylinder(top, ("a", 0, "2 + a"), ("a", 1, 0), "b"),
            lambda x, a, b: (
                np.linalg.norm(np.cross(x - [a, 0, 2 + a], [a, 1, 0]), axis=1) / np.hypot(a, 1) - b
            ),
        ),
        (
            hhr.Cone(top, ("a + 0.3", 0.5, 1.1), ("0.1*a", 0, 1), "60 * b"),
            lambda x, a, b: (
                np.arccos(
                    (x - [a + 0.3, 0.5, 1.1])
                    @ [0.1 * a, 0, 1]
                    / np.hypot(0.1 * a, 1)
                    / np.linalg.norm(x - [a + 0.3, 0.5, 1.1], axis=1)
                )
                - np.deg2rad(60 * b)
            ),
        ),
    )
    for tool, level in tools:
        scene = block_scene(
            "gaps", box, lower=(0, 0, 0), upper=(1, 1, 1), cells=(3, 3, 2), hypothesis="solid",
            contacts=(tool,), displacements=hhr.Displacement.clamp(block.side(2, upper=False), 3),
        )  # fmt: skip
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PairingWarning)
            problem = hhr.FullOrderModel(scene).problem
        normals = np.column_stack(
            [
                np.asarray(
                    problem.contact[np.arange(len(problem.gaps)), 3 * problem.contact_slaves + k]
                ).ravel()
                for k in range(3)
            ]
        )
        for point in itertools.product((0.02, 0.29), (0.91, 1.09)):
            gaps = problem.gaps @ problem.amplitudes(np.array(point))
            hit = gaps < 5
            assert hit.sum() > 12
            ends = problem.contact_points[hit] + gaps[hit, None] * normals[hit]
            assert level(ends, *point) == pytest.approx(np.zeros(hit.sum()), abs=1e-10), tool
            terms, slopes = problem.amplitudes.slopes_at(np.array(point))
            found = problem.gaps[:, terms] @ slopes
            step = 1e-6
            for place in range(2):
                moved = [
                    problem.gaps @ problem.amplitudes(np.array(point) + s * step * np.eye(2)[place])
                    for s in (1, -1)
                ]
                assert found[:, place] == pytest.approx(
                    (moved[0] - moved[1]) / (2 * step), abs=1e-7
                )


@needs("friction")
@pytest.mark.parametrize("section", [False, True])
def test_friction_on_a_cone(section):
    """A collar pushed onto a cone slips everywhere: friction over contact force along the axis is
    mu / (tan + mu).
    """
    angle, mu = 30.0, 0.2
    slope = np.tan(np.deg2rad(angle))
    box = {"push": (0.0, 0.02)}
    push = hhr.Amplitude(slopes={"push": -1.0})
    outputs = (hhr.ContactForce("contact", 0, (0, 1)), hhr.FrictionForce("friction", 0, (0, 1)))
    if section:  # r grows with -z
        scene = block_scene(
            "collar",
            box,
            cells=(6, 6),
            hypothesis="axisymmetric",
            geometry=warped(
                lambda x: np.column_stack(
                    [1 + x[:, 0] - slope * (x[:, 1] - 1) * (1 - x[:, 0]), x[:, 1]]
                ),
                (0, 0),
                (1, 1),
                (6, 6),
            ),
            contacts=(hhr.Profile(LEFT, [(1 + 2 * slope, -1.0), (1 - slope, 2.0)], friction=mu),),
            displacements=(hhr.Displacement(TOP, 1, push),),
            outputs=outputs,
        )
    else:
        top = block.side(2, upper=True)

        def warp(points):
            r = 1 + points[:, 0] - slope * (points[:, 2] - 1) * (1 - points[:, 0])
            return np.column_stack(
                [r * np.cos(points[:, 1]), r * np.sin(points[:, 1]), points[:, 2]]
            )

        scene = block_scene(
            "collar",
            box,
            hypothesis="solid",
            geometry=warped(warp, (0, 0, 0), (1, np.pi / 2, 1), (3, 5, 3)),
            contacts=(hhr.Cone(LEFT, (0, 0, 1 + 1 / slope), (0, 0, -1), angle, friction=mu),),
            displacements=(
                hhr.Displacement(top, 2, push),
                hhr.Displacement(BOTTOM, 1),
                hhr.Displacement(TOP, 0),
            ),
            outputs=tuple(replace(output, direction=(0, 0, 1)) for output in outputs),
        )
    history = hhr.FullOrderModel(scene).march([(0.0, 0.0), (1.0, 0.02)])
    found = history.answers[-1].outputs()
    assert found["contact"] > 0
    assert found["friction"] / found["contact"] == pytest.approx(mu / (slope + mu), rel=1e-6)
    assert not (hhr.FullOrderModel(scene).problem.gaps[:, 0] > 1e-12).any()


@needs("pages")
def test_pages_know_round_tools_and_refuse_drawn_ones_that_turn(tmp_path):
    drawn = hhr.Profile(TOP, "5 - 0.001 * x**2", between=(-20, 20), place=("R", 0.0))
    for place, tool in enumerate(
        (hhr.Circle(TOP, (0.0, 9.98), "R"), hhr.Circle(TOP, (0.0, "R - 0.02"), "R"), drawn)
    ):
        box = {"R": (9.97, 9.99) if place < 2 else (0.0, 0.01)}
        full = hhr.FullOrderModel(hertz((tool,), box))
        model = hhr.condense(full)
        path = tmp_path / f"{place}.html"
        if place < 2:
            hhr.write_model_page(path, model, hhr.scenery_of(full))
            assert path.stat().st_size > 1000
        else:
            with pytest.raises(
                NotOfferedError, match="a page knows no amplitude of kind Distances"
            ):
                hhr.write_model_page(path, model, hhr.scenery_of(full))


SIZES = {
    "sphere": (hhr.Sphere, 3, ("a", "0.2*b", "-0.1", "0.7+0.1*c")),
    "circle": (hhr.Circle, 2, ("a", "b-0.1", "0.7*(1+0.1*c)")),
    "cylinder": (hhr.Cylinder, 3, ("a", "b", "0.1", "1", "0.3", "-0.2", "0.6+0.1*c")),
    "turning cylinder": (hhr.Cylinder, 3, ("a", "b", "0.1", "1+0.1*c", "0.3", "-0.2", "0.6")),
    "cone": (hhr.Cone, 3, ("a", "b", "-0.1*c", "0.1", "0.2", "1", "30")),
}


@pytest.mark.parametrize("inside", [False, True])
@pytest.mark.parametrize("name", SIZES)
def test_formulas_of_gaps_are_the_gaps(name, inside):
    """To round-off at random points of the box, also where normals miss the obstacle, or pass
    through a tip.
    """
    kind, dim, sizes = SIZES[name]
    rng = np.random.default_rng(1)
    names = ("a", "b", "c")
    place, axis = sizes[:dim], sizes[dim:-1]
    shape = kind(1, *((place, axis) if axis else (place,)), sizes[-1], inside=inside)._shape
    points = rng.uniform(-1.5, 1.5, (40, dim))
    middle = np.array([float(Scalar(text, names).value(np.zeros(3))) for text in sizes])
    normals = shape.normals(middle, points)[0] + rng.normal(0.0, 0.3, points.shape)
    offsets = points - middle[:dim]
    before = np.flatnonzero(offsets @ middle[dim : 2 * dim] < 0)[:4] if axis else np.arange(4)
    normals[before] = -offsets[before]
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    gaps = Distances(
        shape, sizes, names, points, normals, distances(shape, middle, points, normals)
    )
    scalars = gaps.scalars()
    missed = 0
    for point in (np.zeros(3), *rng.uniform(-0.3, 0.3, (6, 3))):
        exact = np.array(gaps(point)[1])
        missed += np.count_nonzero(exact + gaps.still > 20.0)
        assert [scalar.value(point) for scalar in scalars] == pytest.approx(exact, abs=1e-11)
    assert missed > 0 and any(
        isinstance(scalar.derivative(np.zeros(3)), np.ndarray) for scalar in scalars
    )


def test_mistakes():
    def refused(tool, match, box=None):
        with pytest.raises(SceneError, match=match):
            hhr.FullOrderModel(hertz((tool,), box or {"R": (-1.0, 2.0)}))

    refused(hhr.Circle(TOP, (0, 5), "R"), r"is -1 at R = -1: it must be in \(0, inf\)")
    refused(hhr.Circle(TOP, (0, 5), 0.0), r"it must be in \(0, inf\)")
    refused(hhr.Circle(TOP, (0, "5 - lift"), 1.0), "names \\['lift'\\], the parameters are")
    refused(hhr.Sphere(TOP, (0, 0, 5), 1.0), "an obstacle in 3 dimensions, the mesh has 2")
    refused(hhr.Circle(TOP, (0, -50), 2.0), "does not look at the obstacle")
    refused(hhr.Profile(TOP, [(20, 1), (30, 1)]), "or lies beyond its end")
    for make_it, match in (
        (lambda: hhr.Circle(TOP, (0, 0, 1), 1.0), "must have 2 components"),
        (lambda: hhr.Sphere(TOP), "must have 3 components"),
        (lambda: hhr.Circle(TOP, (0, None), 1.0), "must be a finite number"),
        (lambda: hhr.Cone(TOP, (0, 0, 0), (0, 0, 0), 20.0), "and an axis a length"),
        (lambda: hhr.Profile(TOP, [(0, 0)]), "two or more distinct points"),
        (lambda: hhr.Profile(TOP, "x**2"), "its ends increase"),
        (
            lambda: hhr.RigidMesh(TOP, "nowhere.stl"),
            "the mesh file nowhere.stl of a RigidMesh cannot be read",
        ),
        (lambda: hhr.RigidMesh(TOP, ([(0, 0, 0)], [])), "with triangles"),
    ):
        with pytest.raises(SceneError, match=match):
            make_it()
    strip = np.array(
        [
            (
                np.cos(a) * (2 + s * np.cos(a / 2)),
                np.sin(a) * (2 + s * np.cos(a / 2)),
                s * np.sin(a / 2),
            )
            for a in np.linspace(0, 2 * np.pi, 12, endpoint=False)
            for s in (-1, 1)
        ]
    )
    quads = [(2 * k, 2 * k + 1, 2 * k + 3, 2 * k + 2) for k in range(11)] + [(22, 23, 0, 1)]
    with pytest.raises(SceneError, match="no consistent sides"):
        hhr.RigidMesh(TOP, (strip, quads))


def test_normals_that_turn_are_said():
    tool = hhr.Circle(TOP, ("a", 1.001), 1.0)
    with pytest.warns(PairingWarning, match=r"turns by up to \d\d degrees over the box"):
        hhr.FullOrderModel(hertz((tool,), {"a": (0.0, 0.4)}))


@needs("conformance")
def test_they_conform():
    """Rows, and gaps that close as bodies move, of a surface of the scene of conformance."""
    from hhr_dolfinx.plugins.conformance.checks import LOWER_SURFACE, check_pairing

    for tool in (
        hhr.Circle(LOWER_SURFACE, (0.5, 300.0), 298.0),
        hhr.Profile(LOWER_SURFACE, [(-9, 2.0), (9, 2.0)]),
        hhr.Profile(LOWER_SURFACE, "2 + 0.001 * x**2", between=(-9, 9)),
    ):
        check_pairing(tool)


@pytest.mark.parametrize(
    "curve, between, why",
    [
        ("x", (1.0,), "its ends increase"),
        ("x", ("a", "b"), "its ends increase"),
        ("x", 5, "its ends increase"),
        ("x", (0.0, np.inf), "its ends increase"),
        ("log(x)", (-1.0, 2.0), "not finite at x = -1: move its ends"),
    ],
)
def test_ends_of_a_profile(curve, between, why):
    with pytest.raises(SceneError, match=why):
        hhr.Profile(1, curve=curve, between=between)


@pytest.mark.parametrize("first, said", [(0.45, True), (0.49, False)])
def test_a_punch_that_moves_to_other_nodes_is_said(first, said):
    """Conditions are those of the middle of the box: a punch of 0.4 that moves by 0.2 meets nodes
    that have none.
    """
    punch = hhr.Profile(
        block.side(1, upper=True),
        curve=[(-0.2, 1.0), (0.2, 1.0)],
        smooth=False,
        place=("x", "-0.01"),
    )
    scene = block_scene(
        "punch",
        {"x": (first, 1 - first)},
        cells=(20, 4),
        contacts=(punch,),
        displacements=hhr.Displacement.clamp(block.side(1, upper=False), 2),
    )
    with pytest.warns(PairingWarning) as found:
        hhr.FullOrderModel(scene)
    assert any("elsewhere in the box" in str(one.message) for one in found) is said


@pytest.mark.parametrize("mesh", [None, 5, (np.eye(3).tolist() * 2, [[0, 1, 2, 3, 4]])])
def test_a_rigid_mesh_of_something_else(mesh):
    with pytest.raises(SceneError, match="must be a file or"):
        hhr.RigidMesh(1, mesh=mesh)
