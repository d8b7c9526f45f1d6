"""Blocks whose elastic constants are impossible at one value of a parameter."""

import contract
import pytest

WHERE = 2.71830
"""Value of the parameter at which the constants are impossible, within 1e-4 of it and nowhere
else.
"""
DIP = f"exp(-((E1 - {WHERE}) / 1e-5) ** 2)"
YOUNG = f"E1 * (1 - 3 * {DIP})"
RATIO = f"0.2 + 0.01 * E1 + 0.5 * {DIP}"
POINT = {"push": 0.04, "load": 0.05, "E1": WHERE}


def scene(young, poisson, **how):
    return contract.blocks((young, poisson), box={"E1": (2.0, 4.0)}, **how)


BODIES = pytest.mark.parametrize("bodies", [(YOUNG, 0.3), ("E1", RATIO)], ids=["modulus", "ratio"])
"""Cases of a test: Young's modulus or Poisson's ratio of one body."""
