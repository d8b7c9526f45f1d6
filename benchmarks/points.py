"""One material point under given strains and stresses, and the laws that tests drive with it."""

import numpy as np

import hhr_dolfinx as hhr
from hhr_dolfinx.plugins.inelastic.law import InternalVariables, program_of

YOUNG, POISSON = 210e3, 0.3
SHEAR = YOUNG / 2 / (1 + POISSON)
WOOD = (12e3, 1e3, 0.6e3, 0.4, 0.4, 0.5, 700.0, 600.0, 60.0)
TURNED = ((0.6, 0.8, 0.0), (-0.8, 0.6, 0.0), (0.0, 0.0, 1.0))
LAWS = {
    "linear": hhr.Plasticity(250.0, 2000.0),
    "perfect": hhr.Plasticity(250.0),
    "Voce": hhr.Voce(250.0, 200.0, 20.0),
    "table": hhr.TabulatedHardening(((0.0, 250.0), (0.01, 300.0), (0.1, 350.0), (1.0, 360.0))),
    "Armstrong-Frederick": hhr.Chaboche(200.0, ((60e3, 600.0),)),
    "Chaboche": hhr.Chaboche(200.0, ((60e3, 600.0), (20e3, 100.0)), 100.0, 10.0),
    "Norton": hhr.Norton(400.0, 8.0),
    "Norton 20": hhr.Norton(400.0, 20.0),
    "Arrhenius": hhr.Arrhenius(400.0, 8.0, 2e4, 900.0, 950.0),
    "primary": hhr.PrimaryCreep(400.0, 5.0, 0.3),
    "plasticity with creep": hhr.PlasticityWithCreep(250.0, 2000.0, 400.0, 8.0),
    "Drucker-Prager": hhr.DruckerPrager(100.0, 0.3, 0.1, 1000.0),
    "Hill": hhr.Hill(250.0, 2000.0, 0.6, 0.4, 0.5, 1.5, 1.6, 1.4, TURNED),
    "orthotropic": hhr.Orthotropic(*WOOD, frame=TURNED),
    "Lemaitre": hhr.Lemaitre(250.0, 20e3, 5.0),
    "stiffness": hhr.ChangingStiffness(hhr.Chaboche(200.0, ((60e3, 600.0),)), 150e3),
    "heated": hhr.Heated(hhr.Chaboche(200.0, ((60e3, 600.0),)), 1e-5, 300.0, 20.0),
}
"""Laws of the package, in MPa."""


def at_rest(program, points=1):
    """State of a law at rest."""
    own = program.remembered - program.strains - 1
    return InternalVariables(
        np.zeros((points, program.strains)), np.zeros(points), np.zeros((points, own))
    )


class Point:
    """A point of a law, at rest; ``given`` components have strains, all others stresses."""

    def __init__(self, law, components=6, young=YOUNG, poisson=POISSON, **kind):
        self.program = program_of(law, components, **kind)
        self.given = self.program.given(young, poisson)
        self.strain, self.state = np.zeros(components), at_rest(self.program)

    def after(self, strain, dt=1.0, tangent=True):
        """Update at a strain, (c,), which changes nothing."""
        return self.program.update(np.array([strain]), self.state, dt, self.given, tangent=tangent)

    def step(self, strains, dt=1.0, stresses=None):
        """Stress after a step to strains by component, with no stress elsewhere, or stresses by
        component.
        """
        size = len(self.strain)
        wanted = np.zeros(size)
        for place, value in (stresses or {}).items():
            wanted[place] = value
        free = np.array([k for k in range(size) if k not in strains], dtype=int)
        trial = self.strain.copy()
        for place, value in strains.items():
            trial[place] = value
        for _ in range(60):
            found = self.after(trial, dt)
            left = (wanted - found.stress[0])[free]
            change = (
                np.linalg.solve(found.tangents[0][np.ix_(free, free)], left) if free.size else left
            )
            if np.abs(change).max(initial=0.0) < 1e-13:
                break
            trial[free] += change
        else:
            raise AssertionError("the stresses were not found")
        self.strain, self.state = trial, found.state
        return found.stress[0]
