"""The search warns of boxes that leave small strains."""

import pytest

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SmallStrainWarning
from hhr_dolfinx.geometries import block


def squeezed(deepest):
    """A soft block, squeezed on a rigid floor that is half a length below it."""
    side = block.side
    return hhr.Scene(
        name="squeezed",
        geometry=lambda comm: block.block(comm, lower=(0.0, 0.0), upper=(10.0, 10.0), cells=(4, 4)),
        hypothesis="plane_strain",
        bodies=(hhr.Body(block.SOLID, young=3.0, poisson=0.3),),
        contacts=(hhr.Obstacle(side(1, False), (0.0, -1.0), 0.5),),
        parameters=hhr.ParameterSpace(("down",), (0.0,), (deepest,)),
        displacements=(
            hhr.Displacement(side(1, True), 0),
            hhr.Displacement(side(1, True), 1, hhr.Amplitude(slopes={"down": -1.0})),
        ),
        outputs=(hhr.ContactForce("force", 0, (0.0, 1.0)),),
    )


def test_one_call_warns_of_a_box_that_reaches_too_far():
    with pytest.warns(SmallStrainWarning, match=r"at down = 12: a strain of .*narrow it"):
        hhr.reduce(squeezed(12.0), error=0.01, of="forces")
