"""A tie that ends in a contact pair: patch tests, whose pressure is 10 everywhere, so that each
half bears 10.
"""

import dataclasses
import warnings

import numpy as np
import pytest
import split_interface
from needs import needs

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SceneWarning
from hhr_dolfinx.models.starts import KnownStatuses

POINT = {"press": 10.0}
RIGHT = split_interface.half(10.0, 10.0, 1.5)
"""Outputs of the contact of the right half in closed form."""


def outputs(answer):
    return dict(answer.outputs().items())


def expected(sign):
    signs = {"force": sign, "moment": sign}
    return {f"{name} 0": signs.get(name, 1.0) * value for name, value in RIGHT.items()}


def to_node(slave, master, friction=None):
    return hhr.NodeToNode(slave, master, (0, -1 if slave == 62 else 1), friction=friction)


@pytest.mark.parametrize("cells", [(6, 8), (8, 8), (8, 6)])
@pytest.mark.parametrize("tie", [(61, 51), (51, 61)])
@pytest.mark.parametrize("pair", [(62, 52), (52, 62)])
def test_the_contact_beside_a_tie_bears_its_half(pair, tie, cells):
    """The multiplier functions of the pair have the sum 1 (Wohlmuth 2000), so that a constant
    pressure passes.
    """
    full = hhr.FullOrderModel(
        split_interface.scene((hhr.Mortar(*pair),), cells, constraints=(hhr.Tie(*tie),))
    )
    answer = full.solve(POINT)
    assert answer.pressure() == pytest.approx(np.full(full.conditions, 10.0), rel=1e-9)
    assert outputs(answer) == pytest.approx(expected(1.0 if pair[0] == 62 else -1.0), abs=1e-9)
    assert full.problem.contact_areas.sum() == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize(
    "pairing", [hhr.NodeToSurface, to_node, pytest.param(hhr.Mortar, marks=needs("friction"))]
)
def test_other_pairings_and_friction_beside_a_tie(pairing):
    """Nothing slides, so that friction changes nothing: the closed form of the patch test holds."""
    friction = {"friction": 0.3} if pairing is hhr.Mortar else {}
    scene = split_interface.scene((pairing(62, 52, **friction),), constraints=(hhr.Tie(61, 51),))
    assert outputs(hhr.FullOrderModel(scene).solve(POINT)) == pytest.approx(expected(1.0), abs=1e-9)


def test_a_gap_beside_a_tie_counts_where_nothing_is_tied():
    """A gap of a tenth of the height stays open.

    One of 1e-6, of a lift of 2e-2, changes 10 in the fourth digit.
    """
    scene = split_interface.scene((hhr.Mortar(62, 52),), constraints=(hhr.Tie(61, 51),))
    wide, narrow = (
        hhr.FullOrderModel(dataclasses.replace(scene, openings=(hhr.Opening(0, gap),)))
        .solve(POINT)
        .forces()
        for gap in (0.1, 1e-6)
    )
    assert wide == pytest.approx(np.zeros(4), abs=1e-12) and narrow.sum() == pytest.approx(
        10.0, rel=1e-3
    )


def test_the_condensed_model_beside_a_tie():
    full = hhr.FullOrderModel(
        split_interface.scene((hhr.Mortar(62, 52),), constraints=(hhr.Tie(61, 51),))
    )
    known = KnownStatuses(full.problem.middle[None], np.zeros((1, full.conditions), dtype=bool))
    model = hhr.exact_condensation(full, known)
    assert outputs(model.solve(POINT)) == pytest.approx(expected(1.0), abs=1e-9)


def test_a_pair_that_is_tied_as_a_whole_is_named():
    """The surfaces of the right half are tied, and in contact too: the tie bears all of it."""
    pairs = (hhr.Mortar(61, 51), hhr.Mortar(62, 52))
    scene = dataclasses.replace(
        split_interface.scene(pairs, constraints=(hhr.Tie(62, 52),)), outputs=()
    )
    with pytest.warns(
        SceneWarning, match=r"5 nodes of contact 1 of \(62, 52\) with the area 1 are tied"
    ):
        full = hhr.FullOrderModel(scene)
    answer = full.solve(POINT)
    assert answer.pressure() == pytest.approx(np.full(4, 10.0), rel=1e-9)
    assert answer.forces().sum() == pytest.approx(10.0, rel=1e-9)
    with warnings.catch_warnings():
        warnings.simplefilter("error", SceneWarning)
        hhr.FullOrderModel(split_interface.scene(pairs[:1], constraints=(hhr.Tie(62, 52),)))
