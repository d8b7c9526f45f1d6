"""The contract of a load; TODO: tests against closed forms of yours."""

from my_load import MyLoad

from hhr_dolfinx.testing import FLANK, check_load


def test_it_keeps_the_contract():
    """On the pressed blocks of the package."""
    check_load(MyLoad(FLANK, "wind"), {"wind": (0.0, 2.0)})
