"""The contract of an output; TODO: tests against closed forms of yours."""

from my_output import MyOutput

from hhr_dolfinx.testing import check_output


def test_it_keeps_the_contract():
    """On the pressed blocks of the package."""
    check_output(MyOutput("mean", 0, "MPa"))
