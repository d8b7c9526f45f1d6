"""Slip, work and wear from rest, which do not depend on the number of increments of a proportional
load.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from needs import needs
from sheared_blocks import lifted, rubbing

import hhr_dolfinx as hhr

OUTPUTS = (hhr.LargestSlip("slip", 0), hhr.DissipatedWork("work", 0), hhr.SlipArea("slides", 0))
END = np.array([0.03, 0.08])


def marched(model, count):
    """Outputs at the end of a straight path from rest in some increments."""
    path = [(k / count, END * k / count) for k in range(count + 1)]
    return model.march(path).answers[-1].outputs()


@pytest.mark.parametrize("condensed", [False, True])
@pytest.mark.parametrize("friction", [0.1, hhr.Tresca(0.004)])
def test_slip_and_work_of_contacts_that_touch_at_rest(friction, condensed):
    """They slide all the way, and a Tresca limit is there from the start: half of the first
    increment would be off by 50 % with one increment, by 3 % with sixteen.
    """
    full = hhr.FullOrderModel(rubbing(friction, outputs=OUTPUTS))
    model = hhr.condense(full) if condensed else full
    known = marched(model, 16)
    for count in (1, 2):
        found = marched(model, count)
        for name in ("slip", "work"):
            assert found[name] == pytest.approx(known[name], rel=1e-9)
    if friction == 0.1:  # slides as a whole: the slip of the last node is its tangential motion
        answer = model.march([(0.0, 0 * END), (1.0, END)]).answers[-1]
        assert found["slip"] == pytest.approx(np.abs(answer.slip.position).max(), rel=1e-12)


@needs("inelastic")
def test_slip_beside_a_law_that_does_not_yield():
    """Steps of bodies with laws start from the same rest as elastic ones."""
    body = hhr.Body(2, 5.0, 0.2, hhr.Plasticity(yield_stress=1e3))
    elastic = hhr.FullOrderModel(rubbing(0.1, cells=4, outputs=OUTPUTS))
    yields = hhr.FullOrderModel(rubbing(0.1, cells=4, outputs=OUTPUTS, bodies=((3.0, 0.3), body)))
    for count in (1, 3):
        known, found = marched(elastic, count), marched(yields, count)
        for name in ("slip", "work", "slides"):
            # elastic histories cut their increments, which changed .4 %
            assert found[name] == pytest.approx(known[name], rel=1e-2)


def test_a_contact_that_closes_slips_half_of_the_increment_while_closed():
    """A gap of .02 under a push of .03: closed at the end and open at rest."""
    raised = partial(lifted, lift=lambda x, y: 0.02 + 0 * x, cells=(4, 4))
    scene = rubbing(0.1, cells=4, outputs=OUTPUTS, geometry=raised)
    answer = hhr.FullOrderModel(scene).march([(0.0, 0 * END), (1.0, END)]).answers[-1]
    moved = np.abs(answer.slip.position)
    assert answer.slip.path == pytest.approx(0.5 * moved, rel=1e-12) and moved.min() > 0.01


def test_tresca_holds_open_contacts_back():
    """Their slip counts where their work does: a body that is lifted and sheared."""
    scene = rubbing(hhr.Tresca(0.004), outputs=OUTPUTS, box={"push": (-0.05, 0.0)})
    path = [(0.0, [0.0, 0.0]), (1.0, [-0.03, 0.1])]
    answer = hhr.FullOrderModel(scene).march(path).answers[-1]
    slipped = answer.slip.work > 0
    assert not answer.slip.pressure.any() and slipped.any()
    assert ((answer.slip.path > 0) == slipped).all()
