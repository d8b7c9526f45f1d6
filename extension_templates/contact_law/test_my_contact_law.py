"""The contract of a law of interfaces; TODO: tests against closed forms of yours."""

from my_contact_law import Wear

from hhr_dolfinx.testing import check_contact_law


def test_it_keeps_the_contract():
    """On the pressed blocks of the package."""
    check_contact_law(Wear(constant=0.05))
