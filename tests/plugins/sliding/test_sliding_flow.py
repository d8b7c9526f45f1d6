"""Bodies with laws whose surfaces slide: the full order where nothing slides, and wherever it has
come to.
"""

import dataclasses

import numpy as np
import pytest
from mpi4py import MPI
from needs import needs
from sliding_scenes import (
    HEIGHT,
    OPENINGS,
    PATH,
    PUSH,
    ROUND_TRIP,
    SOFT,
    WEARS,
    YOUNG,
    drawn,
    mirrored,
)

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotOfferedError, SceneError
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND

pytestmark = [
    needs("sliding"), needs("inelastic"), needs("obstacles"), needs("soft_contact"), needs("wear"),
]  # fmt: skip
TIGHT = hhr.MarchSettings(relative_stress=1e-9, floor_stress=1e-9, relative_force=1e-10)
"""Far below what is compared, 1e-6: linearisations stop at the imbalance of one."""


def with_law(scene, law, young=100.0):
    bodies = tuple(hhr.Body(tag, young, 0.3, law) for tag in (FIRST, SECOND))
    return dataclasses.replace(scene, bodies=bodies)


@pytest.mark.parametrize("pairing", [hhr.NodeToSurface, hhr.Mortar])
@pytest.mark.parametrize(
    ("law", "laws"),
    [(hhr.Plasticity(2.0, 20.0), (None, None)), (hhr.Norton(8.0, 3.0), (None, None)),
     (hhr.Plasticity(2.0, 20.0), (WEARS, SOFT))],
    ids=["plastic", "creep", "plastic with laws of pairs"],
)  # fmt: skip
@needs("stress")
def test_where_nothing_slides_it_is_the_full_order(law, laws, pairing):
    """Images do not slide past each other; tools rub where they have no law."""
    scene = with_law(mirrored(pairing, openings=OPENINGS["of the tools"]), law)
    contacts = tuple(
        contact if own is None else dataclasses.replace(contact, friction=None, law=own)
        for contact, own in zip(scene.contacts, (*laws, laws[1]), strict=True)
    )
    outputs = tuple(one for one in scene.outputs if not isinstance(one, hhr.ElasticEnergy))
    scene = dataclasses.replace(scene, contacts=contacts, outputs=outputs)
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    model = hhr.slide(scene, condensed=False)
    ours, exact = (one.march(ROUND_TRIP, TIGHT).answers for one in (model, full))
    for found, wanted in zip(ours, exact, strict=True):
        for name, value in wanted.outputs().items():
            scale = max(abs(answer.outputs()[name]) for answer in exact)
            assert found.outputs()[name] == pytest.approx(value, abs=1e-6 * scale), name
        flowed = wanted.state().state.cumulated
        np.testing.assert_allclose(
            found.state().state.cumulated, flowed, atol=1e-6 * max(flowed.max(), 1e-3)
        )
        assert model.law.restored(model.law.stored(found.memory)).keys() == (
            found.memory.keys() - {"gauss"}
        )
    assert exact[-1].state().state.cumulated.max() > 1e-3


@pytest.mark.parametrize("friction", [None, 0.3])
@pytest.mark.parametrize("law", [hhr.Plasticity(5.0, 100.0), hhr.Norton(20.0, 3.0)])
def test_it_flows_as_if_it_had_stayed(law, friction):
    """A block on a table a million times as stiff relaxes alike wherever it is drawn.

    With friction the table bends nothing, and the block bears f times its pressure.
    """
    scene = drawn(None)
    flat = dataclasses.replace(scene.contacts[0], friction=friction)
    block = hhr.Body(SECOND, YOUNG, 0.3, law)
    outputs = (*scene.outputs, hhr.ContactForce("drags", 0, (1.0, 0.0)))
    scene = dataclasses.replace(
        scene, bodies=(scene.bodies[0], block), contacts=(flat,), outputs=outputs
    )
    model = hhr.slide(scene, condensed=False)
    found = model.march(PATH).answers
    if friction is None:
        stays = [(time, (push, 0.0)) for time, (push, _) in PATH]
        wanted = hhr.FullOrderModel(scene, MPI.COMM_SELF).march(stays).answers
        for one, other in zip(found, wanted, strict=True):
            # pairings settle to a thousandth of a facet
            assert one.outputs()["bears"] == pytest.approx(other.outputs()["bears"], rel=2e-4)
            flowed = other.state().state.cumulated
            np.testing.assert_allclose(
                one.state().state.cumulated, flowed, atol=2e-4 * flowed.max()
            )
    else:
        for answer in found[2:]:
            outputs = answer.outputs()
            assert abs(outputs["drags"]) == pytest.approx(0.3 * outputs["bears"], rel=1e-6)
    elastic = PUSH * YOUNG / HEIGHT * 2.0
    assert 0.1 * elastic < found[-1].outputs()["bears"] < 0.95 * elastic


def test_what_is_not_built_in_is_refused_by_name():
    scene = with_law(drawn(None), hhr.Plasticity(5.0))
    with pytest.raises(SceneError, match="condensed for elastic bodies: take condensed=False"):
        hhr.slide(scene)
    model = hhr.slide(scene, condensed=False)
    with pytest.raises(NotOfferedError, match="derivatives of bodies that slide"):
        model.march(PATH, hhr.MarchSettings(gradient=True))
    with pytest.raises(NotOfferedError, match="cannot be kept in a file"):
        hhr.save_model("nowhere.npz", model)
