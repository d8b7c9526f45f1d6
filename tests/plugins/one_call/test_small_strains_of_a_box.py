"""The search warns of boxes that leave small strains."""

import pytest
from scenes import squeezed

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SmallStrainWarning


def test_one_call_warns_of_a_box_that_reaches_too_far():
    with pytest.warns(SmallStrainWarning, match=r"at down = 12: a strain of .*narrow it"):
        hhr.reduce(squeezed(12.0), error=0.01, of="forces")
