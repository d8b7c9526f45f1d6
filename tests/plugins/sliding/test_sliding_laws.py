"""Laws of pressures on surfaces that slide: closed forms of what is drawn far, and the full order
where nothing is.
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

pytestmark = [needs("sliding"), needs("obstacles"), needs("soft_contact"), needs("wear")]


@pytest.mark.parametrize("pairing", [hhr.NodeToSurface, hhr.Mortar])
def test_a_soft_layer_goes_along(pairing):
    """Springs in series, H / E of the block and 1 / k of the layer, wherever it has come to."""
    stiffness = 800.0
    model = hhr.slide(drawn(hhr.SoftContact(stiffness=stiffness), pairing))
    pressure = PUSH / (HEIGHT / YOUNG + 1.0 / stiffness)
    for answer in model.march(PATH).answers:
        # the table is not rigid: 1e-6 of the block
        np.testing.assert_allclose(model.pressures(answer), pressure * AREAS, rtol=1e-5)
        assert answer.memory["overclosure"] == pytest.approx(pressure / stiffness, rel=1e-5)


AREAS = np.array([0.25, 0.5, 0.5, 0.5, 0.25])
"""Of the nodes of its lower side."""


@pytest.mark.parametrize("condensed", [True, False])
def test_what_wears_stays_on_the_slave(condensed, tmp_path):
    """Backward Euler of dw/dt = k p with p H / E = push - w, at every node, wherever it is."""
    rate = 1e-4
    model = hhr.slide(drawn(hhr.ArchardWear(constant=rate)), condensed=condensed)
    if condensed:
        hhr.save_model(tmp_path / "model.npz", model)
        model = hhr.load_model(tmp_path / "model.npz")
    history = model.march(PATH)
    compliance, worn = HEIGHT / YOUNG, 0.0
    for answer in history.answers:
        pressure = (PUSH - worn) / (compliance + rate)
        worn += rate * pressure
        assert answer.memory["worn_depth"] == pytest.approx(worn, rel=1e-5)
        assert answer.outputs()["bears"] == pytest.approx(2.0 * pressure, rel=1e-5)
    assert worn > 0.25 * PUSH


TABLE = hhr.SoftContact(table=((0.0, 0.0), (0.01, 1.0), (0.02, 4.0)))


@pytest.mark.parametrize("pairing", [hhr.NodeToSurface, hhr.Mortar])
@pytest.mark.parametrize(
    "laws",
    [
        (SOFT, None), (WEARS, None), (None, WEARS), (TABLE, WEARS), (WEARS, SOFT), (None, TABLE),
        (hhr.Tresca(0.5), SOFT),
    ],
)  # fmt: skip
@needs("stress")
def test_laws_where_nothing_slides_are_those_of_the_full_order(laws, pairing):
    """Images do not slide past each other; both tools rub where they have no law."""
    scene = mirrored(pairing, openings=OPENINGS["of the tools"])
    contacts = tuple(
        contact if law is None else dataclasses.replace(contact, friction=None, law=law)
        for contact, law in zip(scene.contacts, (*laws, laws[1]), strict=True)
    )
    scene = dataclasses.replace(scene, contacts=contacts)
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    ours, exact = (one.march(ROUND_TRIP).answers for one in (hhr.slide(scene), full))
    for found, wanted in zip(ours, exact, strict=True):
        for name, value in wanted.outputs().items():
            scale = max(abs(answer.outputs()[name]) for answer in exact)
            assert found.outputs()[name] == pytest.approx(value, abs=1e-9 * scale), name
        np.testing.assert_allclose(found.displacement(), wanted.displacement(), atol=1e-10)
        for name in {"worn_depth", "overclosure"} & set(wanted.memory):
            expected = np.sort(wanted.memory[name])
            np.testing.assert_allclose(
                np.sort(found.memory[name]), expected, atol=1e-10 * max(1e-3, expected.max())
            )
    assert {"worn_depth", "overclosure"} & set(exact[-1].memory)


@pytest.mark.parametrize("pairing", [hhr.NodeToSurface, hhr.Mortar])
def test_past_the_edge_the_part_that_faces_bears(pairing):
    """Nodes of the slave are partly on the table: k h and Tresca's limit times what is on it.

    The layer is so soft that the block is rigid beside it. ``NodeToSurface`` pairs whole nodes, at
    whose edges it is compared.
    """
    stiffness, path = 1e-3, [(0.0, (0.0, 0.0)), (1.0, (PUSH, 0.0))]
    outputs = (
        hhr.ContactForce("bears", 0, (0.0, 1.0)),
        hhr.ContactArea("area", 0),
        hhr.LargestPressure("peak", 0),
    )
    overlaps = (1.7, 1.5, 1.3, 0.9, 0.35) if pairing is hhr.Mortar else (1.75, 1.25, 0.75)
    pressure = stiffness * PUSH
    path += [(2.0 + k, (PUSH, 11.0 - overlap)) for k, overlap in enumerate(overlaps)]
    soft = hhr.slide(
        dataclasses.replace(drawn(hhr.SoftContact(stiffness), pairing), outputs=outputs)
    )
    rough = hhr.slide(dataclasses.replace(drawn(hhr.Tresca(0.1), pairing), outputs=outputs))
    answers = zip(soft.march(path).answers[1:], rough.march(path).answers[1:], strict=True)
    for overlap, (answer, limited) in zip(overlaps, answers, strict=True):
        found = answer.outputs()
        assert found["bears"] == pytest.approx(pressure * overlap, rel=1e-4)
        assert found["area"] == pytest.approx(overlap, rel=1e-4)
        assert found["peak"] == pytest.approx(pressure, rel=1e-4)
        # nodes off the table have a bound of their whole area, and bear nothing
        bound = limited.slip.bound * (limited.slip.pressure > 0)
        # friction shears the block, whose edge moves by .015
        assert bound.sum() == pytest.approx(0.1 * overlap, abs=0.1 * 0.02)


@needs("plots")
def test_gaps_and_statuses_are_refused():
    """Conditions of its model are dofs of surfaces, whose slacks were returned as gaps."""
    answer = hhr.slide(drawn(None)).march(PATH[:2]).answers[-1]
    with pytest.raises(NotOfferedError, match="gaps of bodies that slide past their mesh"):
        answer.gaps()
    with pytest.raises(NotOfferedError, match=r"statuses of the slave nodes are answer\.slip"):
        answer.statuses()


def test_two_of_one_plug_in_are_refused_where_one_slides():
    """Memory has the conditions of one range."""
    scene = mirrored(hhr.NodeToSurface, openings=OPENINGS["of the tools"])
    pair, tool, other = scene.contacts
    worn = tuple(dataclasses.replace(one, friction=None, law=WEARS) for one in (pair, tool))
    with pytest.raises(SceneError, match="pairs that slide and others have laws of the plug-in"):
        hhr.slide(dataclasses.replace(scene, contacts=(*worn, other)))
