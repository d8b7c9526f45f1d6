"""One interface that two contacts state: the answer is that of one contact of the whole, by every
pairing.
"""

import dataclasses

import numpy as np
import pytest
import split_interface
from needs import DOUBLE_PASS, MORTAR, NODE_TO_SURFACE, needs, node_to_surface

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SceneError

POINT = {"press": 10.0}
pytestmark = needs("nonmatching")


def answers(pairing, cells, **options):
    """Full models and answers of the interface as two contacts, and as one."""
    halves = [
        pairing(*tags, **options)
        for tags in zip(split_interface.UPPER, split_interface.LOWER, strict=True)
    ]
    scenes = (
        split_interface.scene(halves, cells),
        split_interface.scene(halves[:1], cells, split=False),
    )
    full = [hhr.FullOrderModel(scene) for scene in scenes]
    return full, [model.solve(POINT) for model in full]


@pytest.mark.parametrize("cells", [(8, 8), (6, 8), (6, 10)])
@pytest.mark.parametrize("pairing", [MORTAR, NODE_TO_SURFACE, DOUBLE_PASS])
def test_two_contacts_are_one_interface(pairing, cells):
    """Pressures at all nodes are those of one contact, and both forces and moments add up to
    its.
    """
    (halves, whole), (found, expected) = answers(pairing, cells)
    if pairing is not DOUBLE_PASS.values[0] or cells == (
        8,
        8,
    ):  # rows of a second pass depend on the first one's
        assert halves.conditions == whole.conditions
        assert np.sort(found.pressure()) == pytest.approx(np.sort(expected.pressure()), rel=1e-10)
    parts, one = found.outputs(), expected.outputs()
    for name in ("force", "moment", "width"):
        assert parts[f"{name} 0"] + parts[f"{name} 1"] == pytest.approx(one[f"{name} 0"], rel=1e-9)


@needs("sliding")
def test_surfaces_that_slide_far_refuse_it():
    halves = [
        node_to_surface(*tags)
        for tags in zip(split_interface.UPPER, split_interface.LOWER, strict=True)
    ]
    held = split_interface.scene(halves, outputs=())
    above = hhr.Displacement(split_interface.side(split_interface.SECOND, 1, upper=True), 0)
    held = dataclasses.replace(
        held, displacements=(*held.displacements[:2], held.displacements[3], above)
    )
    with pytest.raises(SceneError, match=r"the slaves of contacts 0 and 1 .* share nodes"):
        hhr.slide(held)
