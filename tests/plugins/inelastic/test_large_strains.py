"""Strains of histories that are not small: warned of once, and no answer."""

import warnings

import numpy as np
import pytest

from hhr_dolfinx.errors import SmallStrainWarning
from hhr_dolfinx.plugins.inelastic.equilibrium import Diverged
from hhr_dolfinx.plugins.inelastic.small_strains import SmallStrains


def strains(largest, count=1000, rest=1e-3):
    """Some strains, one of them by itself."""
    found = np.full((count, 4), rest)
    found[3, 1] = -largest
    return found


@pytest.mark.parametrize("strain, said", [(0.09, False), (0.11, True)])
def test_large_strains_are_said_once(strain, said):
    watch = SmallStrains()
    with warnings.catch_warnings(record=True, action="always") as caught:
        for _ in range(2):
            watch.check(strains(strain, rest=strain))
    assert [item.category for item in caught] == [SmallStrainWarning] * said


def test_what_is_no_small_strain_is_no_answer():
    with pytest.raises(Diverged, match=r"a strain of 1\.1 is no small strain"):
        SmallStrains().check(strains(1.1, rest=1.1))
    with warnings.catch_warnings(action="error"):
        SmallStrains().check(strains(3.0))  # the corner of a punch
    with pytest.raises(Diverged):
        SmallStrains().check(strains(101.0))
