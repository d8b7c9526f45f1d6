"""The contract of a contact pairing; TODO: tests against closed forms of yours."""

from my_pairing import MyPairing

from hhr_dolfinx.testing import LOWER_SURFACE, check_pairing


def test_it_keeps_the_contract():
    """On the pressed blocks of the package."""
    check_pairing(MyPairing(LOWER_SURFACE, 1.05))
