"""The contract of a way to reduce; TODO: tests against closed forms of yours."""

from my_reductor import MyReductor

from hhr_dolfinx.testing import check_reductor


def test_it_keeps_the_contract():
    """On the pressed blocks of the package."""
    check_reductor(MyReductor())
