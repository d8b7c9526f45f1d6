"""Bad input gets a clear error at the door, with what to do."""

import dataclasses

import hertz_half_discs as demo
import numpy as np
import pytest
from hertz_half_discs import THESIS
from scenes import pressed_block

import hhr_dolfinx as hhr
from hhr_dolfinx.contact.problem import Status, Statuses, outcome
from hhr_dolfinx.errors import ConvergenceError, NotSolvableError, ParameterError, ReductionError, SceneError
from hhr_dolfinx.geometries import block
from hhr_dolfinx.geometries import hertz_half_discs as geometry
from hhr_dolfinx.reduction.rid import reduced_domain


def with_changes(**changes):
    return dataclasses.replace(demo.scene(), **changes)


@pytest.mark.parametrize("mu", [np.nan, np.inf, 0.1, 0.5, -0.3])
def test_parameters_outside_the_box(hertz, hertz_reduction, mu):
    for model in (hertz, hertz_reduction.model):
        with pytest.raises(ParameterError, match=r"mu = .* is outside"):
            model.solve(mu)


@pytest.mark.parametrize("mu", [[0.2, 0.3], [], {"nu": 0.2}, {"mu": 0.2, "nu": 0.2}])
def test_wrong_parameters(hertz_reduction, mu):
    with pytest.raises(ParameterError, match=r"mu|nu"):
        hertz_reduction.model.solve(mu)


def test_parameters_by_number_sequence_and_name(hertz_reduction):
    solve = hertz_reduction.model.solve
    assert np.array_equal(solve(0.2).forces, solve([0.2]).forces)
    assert np.array_equal(solve(0.2).forces, solve({"mu": 0.2}).forces)


def test_surfaces_that_do_not_match():
    """Two blocks, one above the other, with 4 and 5 cells along the contact."""

    def blocks(comm):
        import gmsh

        from hhr_dolfinx.compat import gmsh_to_mesh

        gmsh.initialize()
        gmsh.option.setNumber("General.Terminal", 0)
        for tag, (bottom, cells) in enumerate(((0.0, 4), (1.1, 5)), start=1):
            body = gmsh.model.occ.addRectangle(0, bottom, 0, 1, 1)
            gmsh.model.occ.synchronize()
            curves = [c for _, c in gmsh.model.getBoundary([(2, body)], oriented=False)]
            for curve in curves:
                gmsh.model.mesh.setTransfiniteCurve(curve, cells + 1)
            gmsh.model.addPhysicalGroup(2, [body], tag)
            # rectangle sides: bottom, right, top, left
            gmsh.model.addPhysicalGroup(1, [curves[0]], 10 * tag)
            gmsh.model.addPhysicalGroup(1, [curves[2]], 10 * tag + 1)
        gmsh.model.mesh.generate(2)
        result = gmsh_to_mesh(gmsh.model, comm, gdim=2)
        gmsh.finalize()
        return result

    scene = with_changes(
        geometry=blocks,
        bodies=(hhr.Body(1, 1.0, 0.3), hhr.Body(2, 1.0, 0.3)),
        contacts=(hhr.NodeToNode(11, 20, (0, 1)),),
        displacements=(hhr.Displacement(10, 0), hhr.Displacement(10, 1)),
    )
    with pytest.raises(SceneError, match=r"face each other.*no partner, e\.g\. at \["):
        hhr.FullOrderModel(scene)


@pytest.mark.parametrize(
    "pair",
    [
        hhr.NodeToNode(geometry.UPPER_ARC, geometry.LOWER_ARC, (0, 1)),
        hhr.NodeToNode(geometry.LOWER_ARC, geometry.UPPER_ARC, (0, -1)),
        hhr.Obstacle(geometry.LOWER_ARC, (0, -1), 0.0),
    ],
)
def test_surfaces_that_look_away(pair):
    with pytest.raises(SceneError, match="do not face each other"):
        hhr.FullOrderModel(with_changes(contacts=(pair,)))


def test_empty_pair():
    """All nodes of the pair are imposed, so it holds no unknown."""
    fixed = tuple(hhr.Displacement(block.side(1, upper=False), k) for k in (0, 1))
    with pytest.raises(SceneError, match="empty"):
        hhr.FullOrderModel(dataclasses.replace(pressed_block("plane_strain"), displacements=fixed))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"contacts": (hhr.Obstacle(99, (0, 1), 0.0),)}, r"facet tags \[99\] are not in the mesh"),
        ({"bodies": (hhr.Body(7, 1.0, 0.3),)}, r"cell tags \[7\]"),
        ({"bodies": (hhr.Body(geometry.LOWER, 1.0, 0.3),)}, r"\[2\] belong to no body"),
        ({"displacements": (hhr.Displacement(geometry.LOWER_FLAT, 2),)}, "component 2"),
        ({"contacts": (hhr.NodeToNode(11, 12, (0, 0)),)}, "normal"),
        ({"contacts": (hhr.NodeToNode(11, 12, (0, 1, 0)),)}, "length 2"),
        (
            {"displacements": (hhr.Displacement(21, 1, hhr.Amplitude(slopes={"height": 1.0})),)},
            r"\['height'\], the scene's parameters are \('mu',\)",
        ),
        (
            {"displacements": (hhr.Displacement(21, 0), hhr.Displacement(21, 0, hhr.Amplitude(1.0)))},
            "different values",
        ),
    ],
)
def test_scenes_that_cannot_be_built(changes, message):
    with pytest.raises(SceneError, match=message):
        hhr.FullOrderModel(with_changes(**changes))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"hypothesis": "plane"}, "plane_strain"),
        ({"contacts": ()}, "without contact"),
        ({"bodies": ()}, "body"),
        ({"name": "two words"}, "identifier"),
    ],
)
def test_scenes_that_contradict_themselves(changes, message):
    with pytest.raises(SceneError, match=message):
        with_changes(**changes)


@pytest.mark.parametrize(("young", "poisson"), [(0.0, 0.3), (-1.0, 0.3), (np.nan, 0.3), (1.0, 0.5), (1.0, np.nan)])
def test_materials_without_positive_energy(young, poisson):
    with pytest.raises(SceneError, match="positive"):
        hhr.Body(1, young, poisson)


@pytest.mark.parametrize(
    ("names", "lower", "upper"),
    [
        ((), (), ()),
        (("a",), (0.0,), (0.0,)),
        (("a",), (1.0,), (0.0,)),
        (("a",), (np.nan,), (1.0,)),
        (("a", "b"), (0,), (1,)),
    ],
)
def test_parameter_boxes_that_are_none(names, lower, upper):
    with pytest.raises(SceneError):
        hhr.ParameterSpace(names, lower, upper)


def test_a_body_that_can_move_freely():
    scene = dataclasses.replace(pressed_block("plane_strain"), displacements=(), loads=())
    with pytest.raises(NotSolvableError, match="can move freely"):
        hhr.FullOrderModel(scene)


@pytest.mark.parametrize("tolerance", [0.0, 1.0, -1.0])
def test_pod_tolerance(hertz, hertz_snapshots, tolerance):
    with pytest.raises(ReductionError, match=r"\(0, 1\)"):
        hhr.build_reduced_model(hertz, hertz_snapshots, hhr.ReductionSettings.thesis(tolerance))


def test_a_snapshot_set_of_one(hertz):
    snapshots = hhr.compute_snapshots(hertz, np.array([[0.3]]))
    with pytest.raises(ReductionError, match="at least 2"):
        hhr.build_reduced_model(hertz, snapshots, THESIS)


def test_a_rid_without_contact(hertz):
    far = int(np.abs(hertz.problem.points[:, 1]).argmax())
    with pytest.raises(ReductionError, match="no contact condition"):
        reduced_domain(hertz.problem, np.array([far]))


def test_a_rid_that_no_load_reaches(hertz, hertz_snapshots):
    settings = hhr.ReductionSettings.thesis(1e-4, zone=lambda problem: [])
    with pytest.raises(ReductionError, match="the zone"):
        hhr.build_reduced_model(hertz, hertz_snapshots, settings)


def test_a_singular_reduced_problem(hertz_reduction, hertz):
    singular = dataclasses.replace(
        hertz_reduction.model.problem, stiffness=np.zeros_like(hertz_reduction.model.problem.stiffness)
    )
    problem = hertz.problem
    with pytest.raises(NotSolvableError, match="singular"):
        hhr.ReducedModel(singular, problem.parameters, problem.amplitudes, hertz_reduction.model.known)


def test_an_unconverged_iterate_is_never_handed_out():
    found = Statuses(np.ones(2), np.ones(2, dtype=bool), 7, Status.CYCLING, True)
    with pytest.raises(ConvergenceError, match=r"\[0\.2\] after 7 iterations: .*P-matrix"):
        outcome(np.ones(3), found, np.array([0.2]), raise_on_failure=True)
    emptied = outcome(np.ones(3), found, np.array([0.2]), raise_on_failure=False)
    assert np.isnan(emptied.primal).all() and np.isnan(emptied.forces).all() and not emptied.converged


def test_meshes_without_sense():
    with pytest.raises(ValueError, match="even"):
        geometry.half_discs(None, arc_segments=7)
    with pytest.raises(ValueError, match="radius"):
        geometry.half_discs(None, radius=-1.0)


def test_loads_and_obstacles_that_are_not_finite():
    for make in (
        lambda: hhr.Amplitude(np.nan),
        lambda: hhr.Amplitude(slopes={"mu": np.inf}),
        lambda: hhr.Obstacle(1, (0, 1), np.nan),
        lambda: hhr.Traction(1, (0, np.nan), hhr.Amplitude(1.0)),
    ):
        with pytest.raises(SceneError, match="finite"):
            make()
