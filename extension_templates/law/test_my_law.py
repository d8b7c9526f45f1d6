"""The contract of a law of inelastic bodies; TODO: tests against closed forms of yours."""

from my_law import MyLaw

from hhr_dolfinx.testing import check_law


def test_it_keeps_the_contract():
    """On the pressed blocks of the package."""
    check_law(MyLaw(viscosity=20.0), young=200.0, strain=0.02, dt=0.1)
