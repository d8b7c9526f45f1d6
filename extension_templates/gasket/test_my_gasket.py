"""The contract of a law of interfaces; TODO: tests against closed forms of yours."""

from my_gasket import Gasket

from hhr_dolfinx.testing import check_contact_law


def test_it_keeps_the_contract():
    """On the pressed blocks of the package."""
    check_contact_law(Gasket(linear="2.0 + 10.0 * push", cubic=50.0))
