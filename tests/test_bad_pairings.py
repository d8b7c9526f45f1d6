"""Bad non-matching contact pairs get a clear error or warning with the place."""

import dataclasses

import contact_patch_test as patch
import numpy as np
import pytest
from scenes import check_contact_conditions
from test_pairings import shrink_fit

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import PairingWarning, SceneError
from hhr_dolfinx.geometries import two_blocks


@pytest.mark.parametrize("pairing", [hhr.NodeToSurface, hhr.Mortar, hhr.DoublePass])
@pytest.mark.parametrize("by_normal", [True, False])
def test_non_matching_surfaces_that_never_face_each_other(pairing, by_normal):
    """Both bodies' undersides, and blocks that stand beside each other."""
    scene = patch.scene(pairing, by_normal=by_normal)
    tags = (two_blocks.side(2, 1, False), two_blocks.side(1, 1, False))
    backs = pairing(*tags, (0.0, -1.0) if by_normal else None)
    with pytest.raises(SceneError, match=r"face each other.*\[0\.5"):
        hhr.FullOrderModel(dataclasses.replace(scene, contacts=(backs,)))
    with pytest.raises(SceneError, match=r"never face each other.*\[[0-9.]+, 1\.0\]"):
        hhr.FullOrderModel(patch.scene(pairing, by_normal=by_normal, shift=2.5))


@pytest.mark.parametrize("pairing", [hhr.NodeToSurface, hhr.Mortar])
def test_slave_nodes_beyond_the_edge_are_named_and_left_out(pairing):
    """Upper block moved by 0.3: nodes at x = 1.1 and 1.3 hang over; a mortar row needs some cover only."""
    with pytest.warns(PairingWarning, match=r"beyond the edge.*\[1\.[13]"):
        problem = hhr.FullOrderModel(patch.scene(pairing, shift=0.3)).problem
    assert problem.contact_points[:, 0].max() <= (1.0 if pairing is hhr.NodeToSurface else 1.1 + 1e-12)
    assert problem.contact_points[:, 0].min() == pytest.approx(0.3)


def test_one_slave_node_is_a_scene():
    """All but one node of the slave surface hang over the edge."""
    with pytest.warns(PairingWarning):
        full_order = hhr.FullOrderModel(patch.scene(hhr.NodeToSurface, (3, 3), (1, 1), poisson=0.3, shift=0.9))
    solution = full_order.solve([0.05, 0.0])
    assert full_order.problem.contact.shape[0] == 1 and solution.forces[0] > 0
    check_contact_conditions(full_order.problem, solution.primal, solution.forces, [0.05, 0.0])


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        (0.0, r"facets of contact surface 220 have no area, e\.g\. at \["),
        (np.nan, "2 cells of the mesh have coordinates that are not finite"),
    ],
)
def test_facets_without_area(broken, message):
    def collapse(points, body):
        points = points.copy()
        at = (body == 2) & np.isclose(points[:, 1], 1.0) & np.isclose(points[:, 0], 0.2)
        points[at, 0] = broken
        return points

    scene = patch.scene(hhr.NodeToSurface)
    boxes = {"first": ((0.0, 0.0), (1.0, 1.0), (3, 3)), "second": ((0.0, 1.0), (1.0, 2.0), (5, 4))}
    geometry = lambda comm: two_blocks.two_blocks(comm, **boxes, warp=collapse)  # noqa: E731
    with pytest.raises(SceneError, match=message):
        hhr.FullOrderModel(dataclasses.replace(scene, geometry=geometry))


@pytest.mark.parametrize("pairing", [hhr.NodeToSurface, hhr.Mortar])
def test_an_overlap_larger_than_a_cell_is_named(pairing):
    with pytest.warns(PairingWarning, match=r"overlap at surface 210 exceeds a cell.*\(0\.4\) at \[1\.[56]"):
        hhr.FullOrderModel(shrink_fit(pairing, 4, interference=0.4))


@pytest.mark.parametrize("pairing", [hhr.NodeToSurface, hhr.Mortar])
@pytest.mark.parametrize("normal", [(0.0, 0.0), (np.nan, 1.0), (0.0, 0.0, 1.0)])
def test_impossible_normals(pairing, normal):
    scene = patch.scene(pairing)
    pair = pairing(*scene.contacts[0].tags, normal)
    with pytest.raises(SceneError, match="must be a non-zero vector of length 2"):
        hhr.FullOrderModel(dataclasses.replace(scene, contacts=(pair,)))


def test_unknown_multipliers_and_missing_tags():
    with pytest.raises(SceneError, match="multipliers 'triple' are unknown, one of dual, standard"):
        hhr.Mortar(1, 2, multipliers="triple")
    scene = patch.scene(hhr.NodeToSurface)
    with pytest.raises(SceneError, match=r"facet tags \[99\] are not in the mesh"):
        hhr.FullOrderModel(dataclasses.replace(scene, contacts=(hhr.NodeToSurface(99, 121),)))


def test_a_double_pass_that_says_everything_twice_keeps_one():
    """Rows of the second pass on matching meshes are those of the first: left out, not refused."""
    problem = hhr.FullOrderModel(patch.scene(hhr.DoublePass, (6, 3), (6, 3))).problem
    assert problem.contact.shape[0] == 7


def test_a_double_pass_with_poor_inf_sup_warns():
    with pytest.warns(PairingWarning, match=r"inf-sup constant of [0-9.e-]+ relative to its norm"):
        full_order = hhr.FullOrderModel(patch.scene(hhr.DoublePass, (30, 3), (31, 3)))
    rows = full_order.problem.contact.toarray()
    assert np.linalg.matrix_rank(rows) == len(rows), "still solvable"
