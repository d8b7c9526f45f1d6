"""Mortar contact: patch test, standard and dual multipliers, a sphere beside Hertz, interfaces that
several contacts state.
"""

import dataclasses

import contact_patch_test as patch
import numpy as np
import pytest
import sphere_on_block as sphere
import split_interface
from mpi4py import MPI
from needs import mortar, needs
from scenes import check_closed, check_contact_conditions

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import PairingWarning
from hhr_dolfinx.reduction.projection import reduced_domain

STANDARD = patch.PAIRINGS["mortar, standard"]
MESHES = [
    ((3, 3), (5, 4), False),
    ((7, 4), (8, 4), True),
    ((1, 2), (20, 6), False),
    ((20, 6), (1, 2), True),
    ((2, 2, 2), (3, 3, 3), False),
    ((3, 2, 2), (4, 5, 2), True),
    ((6, 6, 2), (1, 1, 2), False),
]


@pytest.mark.parametrize("pairing", [mortar, STANDARD])
@pytest.mark.parametrize(("lower", "upper", "simplices"), MESHES)
def test_mortar_passes_the_patch_test(pairing, lower, upper, simplices):
    """Round-off times cond(K): at most 1e-11 was seen."""
    _, pressure, stress = patch.solve(patch.scene(pairing, lower, upper, simplices=simplices))
    assert pressure == pytest.approx(1.0, abs=1e-10)
    assert stress < 1e-10


def test_standard_multipliers_give_the_node_to_node_pressure_where_all_nodes_touch():
    """Their gaps are averages over neighbours, so that nodal answers differ only where contact
    begins.
    """
    nodal, standard = (
        hhr.FullOrderModel(patch.scene(pairing, (6, 4), (6, 4), poisson=0.3)).solve(
            [patch.PUSH, 0.0]
        )
        for pairing in (hhr.NodeToNode, STANDARD)
    )
    assert nodal.active.all() and standard.active.all()
    assert standard.displacement() == pytest.approx(nodal.displacement(), abs=1e-10)


def test_hertz_sphere():
    """Contact radius and peak pressure within 5 % of Hertz on a coarser mesh than the demo's."""
    full_order = hhr.FullOrderModel(sphere.scene(sphere_cells=(16, 7), block_cells=(12, 6)))
    solution = full_order.solve([0.2, 0.0])
    check_contact_conditions(
        full_order.problem, solution.displacement(), solution.forces(), [0.2, 0.0], relative=1e-9
    )
    row = sphere.beside_hertz(full_order, 0.2)
    assert abs(row["radius"]) < 0.05 and abs(row["peak"]) < 0.05


def test_overlapping_rows_grow_to_the_whole_surface():
    """Standard multipliers, each row of which touches its neighbours' slaves, leave no place to
    cut; dual ones do.
    """
    standard, dual = (
        hhr.FullOrderModel(
            patch.scene(patch.PAIRINGS[f"mortar, {kind}"], (12, 4), (16, 4)), MPI.COMM_SELF
        ).problem
        for kind in ("standard", "dual")
    )
    asked = standard.contact_slaves[[8]]
    sets = reduced_domain(standard, asked)
    check_closed(standard, asked, sets)
    assert len(sets.A_lambda) == standard.contact.shape[0]
    assert 1 <= len(reduced_domain(dual, dual.contact_slaves[[8]]).A_lambda) < 6


@pytest.mark.parametrize("order", [1, 2])
@needs("second_order", "shared_nodes")
def test_mortar_passes_the_patch_test_on_both_halves(order):
    halves = [
        mortar(*tags) for tags in zip(split_interface.UPPER, split_interface.LOWER, strict=True)
    ]
    full = hhr.FullOrderModel(split_interface.scene(halves, (6, 8), order=order))
    answer = full.solve({"press": 10.0})
    assert answer.pressure() == pytest.approx(np.full(full.conditions, 10.0), rel=1e-10)
    assert dict(answer.outputs().items()) == pytest.approx(split_interface.HALVES, abs=1e-10)


@needs("shared_nodes")
def test_two_masters_of_one_slave():
    """A slave on a master of two tags: nodes next to the joint touch both, and have one condition
    each.
    """
    halves = [mortar(split_interface.UPPER[0], tag) for tag in split_interface.LOWER]
    scene = split_interface.scene(halves, (6, 7))
    joined = hhr.FullOrderModel(split_interface.scene(halves[:1], (6, 7), split=False))

    def geometry(comm):
        mesh, cells, facets = split_interface.geometry(comm, (6, 7), True)
        values = np.where(
            facets.values == split_interface.UPPER[1], split_interface.UPPER[0], facets.values
        )
        return mesh, cells, split_interface.dmesh.meshtags(mesh, 1, facets.indices, values)

    with pytest.warns(
        PairingWarning, match="beyond the edge"
    ):  # each half of the master, which has the other half
        full = hhr.FullOrderModel(dataclasses.replace(scene, geometry=geometry))
    answer = full.solve({"press": 10.0})
    assert full.conditions == joined.conditions == 8
    assert answer.pressure() == pytest.approx(np.full(8, 10.0), rel=1e-10)
    found = answer.outputs()
    assert [found[f"force {k}"] for k in (0, 1)] == pytest.approx([10.0, 10.0])
    assert [found[f"width {k}"] for k in (0, 1)] == pytest.approx([1.0, 1.0])
