"""The contract of a system; TODO: tests against closed forms of yours."""

from dataclasses import dataclass, replace

from my_system import MySystem

from hhr_dolfinx import FullOrderModel
from hhr_dolfinx.errors import ConformanceError, SceneError
from hhr_dolfinx.formulas import Modulus
from hhr_dolfinx.testing import check_system, pressed_blocks

K = {"k": (0.0, 20.0)}


def test_it_keeps_the_contract():
    """On the pressed blocks of the package, alone and with an equation and a spring."""
    check_system(MySystem("k"), K)


@dataclass(frozen=True)
class Lying(MySystem):
    """Its parts have half of the foundation of its equations."""

    def __call__(self, *given):
        """See MySystem."""
        system = super().__call__(*given)
        (one, k), matrices = system.parts()
        half = one, Modulus(f"{self.parameter} / 2", "1", k.names)
        system.parts = lambda: (half, matrices)
        return system


@dataclass(frozen=True)
class Slanted(MySystem):
    """K is of no energy: one entry is without its mirror image."""

    def __call__(self, *given):
        """See MySystem."""
        system = super().__call__(*given)
        parts = system.problem.stiffness_terms
        slanted = parts[1].copy()
        slanted.data[1] += 1.0
        system.problem = replace(system.problem, stiffness_terms=(parts[0], slanted))
        return system


def test_a_lie_is_refused():
    """When a scene is solved, and by the check."""
    for system, why in ((Lying("k"), "differ from their sum"), (Slanted("k"), "is not symmetric")):
        for error, ask in (
            (SceneError, lambda system: FullOrderModel(pressed_blocks(K, system=system))),
            (ConformanceError, lambda system: check_system(system, K)),
        ):
            try:
                ask(system)
            except error as said:
                assert why in str(said), said
            else:
                raise AssertionError(f"{system} was believed")
