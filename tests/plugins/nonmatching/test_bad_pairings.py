"""Bad non-matching contact pairs get a clear error or warning with the place."""

import dataclasses
from contextlib import nullcontext

import contact_patch_test as patch
import numpy as np
import pytest
from needs import MORTAR, needs
from nonmatching_blocks import outsides, shrink_fit
from scenes import check_contact_conditions, pair_scene, slope

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import PairingWarning, SceneError
from hhr_dolfinx.geometries import two_blocks


def with_contact(pairing, *given):
    """The model of two blocks that lie on each other, with another pair."""
    return hhr.FullOrderModel(
        dataclasses.replace(patch.scene(pairing), contacts=(pairing(*given),))
    )


@pytest.mark.parametrize("pairing", [hhr.NodeToSurface, MORTAR, hhr.DoublePass])
@pytest.mark.parametrize("by_normal", [True, False])
def test_non_matching_surfaces_that_never_face_each_other(pairing, by_normal):
    """Both bodies' undersides, and blocks that stand beside each other."""
    tags = (two_blocks.side(2, 1, False), two_blocks.side(1, 1, False))
    with pytest.raises(SceneError, match=r"face each other.*\[0\.5"):
        with_contact(pairing, *tags, (0.0, -1.0) if by_normal else None)
    with pytest.raises(SceneError, match=r"never face each other.*\[[0-9.]+, 1\.0\]"):
        hhr.FullOrderModel(patch.scene(pairing, by_normal=by_normal, shift=2.5))


@pytest.mark.parametrize("pairing", [hhr.NodeToSurface, MORTAR])
def test_slave_nodes_beyond_the_edge_are_named_and_left_out(pairing):
    """Upper block moved by 0.3: nodes at x = 1.1 and 1.3 hang over.

    A mortar row needs some cover only.
    """
    with pytest.warns(PairingWarning, match=r"beyond the edge.*\[1\.[13]"):
        problem = hhr.FullOrderModel(patch.scene(pairing, shift=0.3)).problem
    assert problem.contact_points[:, 0].max() <= (
        1.0 if pairing is hhr.NodeToSurface else 1.1 + 1e-12
    )
    assert problem.contact_points[:, 0].min() == pytest.approx(0.3)


def test_one_slave_node_is_a_scene():
    """All but one node of the slave surface hang over the edge."""
    with pytest.warns(PairingWarning):
        full_order = hhr.FullOrderModel(
            patch.scene(hhr.NodeToSurface, (3, 3), (1, 1), poisson=0.3, shift=0.9)
        )
    solution = full_order.solve([0.05, 0.0])
    assert full_order.problem.contact.shape[0] == 1 and solution.forces()[0] > 0
    check_contact_conditions(
        full_order.problem, solution.displacement(), solution.forces(), [0.05, 0.0]
    )


@pytest.mark.parametrize("pairing", [hhr.NodeToSurface, MORTAR])
def test_an_overlap_larger_than_a_cell_is_named(pairing):
    with pytest.warns(
        PairingWarning, match=r"overlap at surface 210 exceeds a cell.*\(0\.4\) at \[1\.[56]"
    ):
        hhr.FullOrderModel(shrink_fit(pairing, 4, interference=0.4))


@needs("mortar")
@pytest.mark.parametrize("pairing", [hhr.NodeToSurface, hhr.DoublePass, MORTAR])
def test_normals_tags_and_multipliers_that_are_none(pairing):
    tags = patch.scene(pairing).contacts[0].tags
    for normal in ((0.0, 0.0), (np.nan, 1.0), (0.0, 0.0, 1.0), "down"):
        with pytest.raises(SceneError, match="must have 2 numbers, which are not all zero"):
            with_contact(pairing, *tags, normal)
    with pytest.raises(SceneError, match="multipliers 'triple' are unknown, one of dual, standard"):
        hhr.Mortar(1, 2, multipliers="triple")


def test_a_double_pass_with_poor_inf_sup_warns():
    with pytest.warns(PairingWarning, match=r"inf-sup constant of [0-9.e-]+ relative to its norm"):
        full_order = hhr.FullOrderModel(patch.scene(hhr.DoublePass, (30, 3), (31, 3)))
    rows = full_order.problem.contact.toarray()
    assert np.linalg.matrix_rank(rows) == len(rows), "still solvable"


def strips(pairing, cells, gap):
    """Two strips above each other, held at their ends, with all of their long sides in one surface
    each.
    """
    up, dim = len(cells) - 1, len(cells)
    finer = (*(count + 3 for count in cells[:-1]), cells[-1])

    corners = [((0.0,) * up + (low,), (1.0,) * up + (low + 0.02,)) for low in (0.0, 0.02 + gap)]
    boxes = [(*pair, count) for pair, count in zip(corners, (cells, finer), strict=True)]
    kept = [
        two_blocks.side(body, axis, upper)
        for axis in range(up)
        for body in (1, 2)
        for upper in (False, True)
    ]
    ends = kept[:4]
    return pair_scene(
        "strips",
        {"p": (0.0, 1.0)},
        *boxes,
        ((1e5, 0.3),) * 2,
        geometry=outsides(*boxes, kept),
        hypothesis="plane_strain" if dim == 2 else "solid",
        contacts=(pairing(2, 1),),
        displacements=tuple(hhr.Displacement(tag, axis) for tag in ends for axis in range(dim)),
        loads=(hhr.Pressure(1, slope("p")),),
    )


@pytest.mark.filterwarnings(
    "ignore::hhr_dolfinx.errors.PairingWarning", "ignore::hhr_dolfinx.errors.SceneWarning"
)
@pytest.mark.parametrize("pairing", [hhr.NodeToSurface, MORTAR, hhr.DoublePass])
@pytest.mark.parametrize("cells", [(20, 1), (20, 2), (6, 5, 1)])
@pytest.mark.parametrize("gap", [0.01, -0.005])
def test_back_sides_never_meet(pairing, cells, gap):
    """Strips that look at each other through both; front sides that overlap meet.

    Without load 250 kN were seen.
    """
    full_order = hhr.FullOrderModel(strips(pairing, cells, gap))
    assert full_order.problem.gaps[:, 0] == pytest.approx(gap, abs=1e-12)
    forces = full_order.solve(0.0).forces()
    assert forces.any() == (gap < 0)


@pytest.mark.parametrize("pairing", [hhr.NodeToSurface, MORTAR])
def test_back_sides_alone_are_refused(pairing):
    """The outer sides of two blocks that touch, which lie two heights behind each other.

    Cells are 1/3 and 1/4 high.
    """
    with pytest.raises(
        SceneError, match=r"never face each other: one lies behind the other by up to 2, .*Opening"
    ):
        with_contact(pairing, *(patch.geometry.outer_end(body, 2) for body in (2, 1)))


@pytest.mark.parametrize("pairing", [hhr.NodeToSurface, MORTAR])
@pytest.mark.parametrize("counts", [(12, 17), (20, 23)])
def test_a_gap_below_the_sag_of_its_facets(pairing, counts):
    """Off Lamé by 7 to 34 % at interferences of one and two sags, which is told.

    By up to 5 % at ten, which is not.
    """
    sag = (np.pi / 2 / counts[0]) ** 2 / 8
    for over, warned in ((1.0, True), (0.5, True), (0.1, False)):
        message = r"gap of surfaces 220 and 121 is .* on average.*off the curved .*finer"
        with pytest.warns(PairingWarning, match=message) if warned else nullcontext():
            full_order = hhr.FullOrderModel(rings(pairing, counts, sag / over))
        pressure = full_order.solve(0.0).forces().sum() / full_order.problem.contact_areas.sum()
        off = abs(pressure / pressure_of_rings(sag / over) - 1)
        assert off > 0.06 if warned else off < 0.07


def rings(pairing, counts, interference):
    """Quarter rings of radii 0.5 to 1 and 1 to 1.6 that overlap, with ``counts`` cells along the
    arc.
    """

    def bend(points, _):
        return np.column_stack(
            [points[:, 1] * np.cos(points[:, 0]), points[:, 1] * np.sin(points[:, 0])]
        )

    ends = [
        (two_blocks.side(body, 0, upper), int(not upper))
        for body in (1, 2)
        for upper in (False, True)
    ]
    return pair_scene(
        "rings",
        {"p": (0.0, 1.0)},
        ((0, 0.5), (np.pi / 2, 1.0), (counts[0], 6)),
        ((0, 1.0 - interference), (np.pi / 2, 1.6), (counts[1], 6)),
        ((1.0, 0.3),) * 2,
        warp=bend,
        contacts=(pairing(two_blocks.side(2, 1, False), two_blocks.side(1, 1, True)),),
        displacements=tuple(hhr.Displacement(*end) for end in ends),
        loads=(hhr.Pressure(two_blocks.side(2, 1, True), slope("p", 1e-9)),),
    )


def pressure_of_rings(interference):
    """Lamé's pressure between rings of one material, E = 1 and nu = 0.3, in plane strain."""
    a, b, c = 0.5, 1.0, 1.6
    return (
        interference
        / b
        / (1 - 0.3**2)
        / ((b**2 + a**2) / (b**2 - a**2) + (c**2 + b**2) / (c**2 - b**2))
    )
