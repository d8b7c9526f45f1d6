"""Extreme paths of all laws of bodies, for ``extreme_cases.py``, condensed: the small pellet of
``extreme_flow.py``.
"""

import functools
from collections.abc import Iterator

import numpy as np
from extreme_flow import VALUES, Family, paced, shares, with_laws
from verify import HistoryCase

import hhr_dolfinx as hhr
from hhr_dolfinx.plugins.inelastic.condense_flow import CorrectionSettings

WARM = "400 + 2 * P1"
"""A temperature in K that goes with the load: it jumps where the load does."""
NORTON = hhr.Norton(1e3, 4.0)
LAWS = {
    "Chaboche": (hhr.Chaboche(60.0, ((2e4, 200.0), (1e3, 0.0)), 20.0, 50.0), NORTON),
    "perfect, Norton 20": (hhr.Plasticity(80.0), hhr.Norton(1e3, 20.0)),
    "table": (hhr.TabulatedHardening(((0.0, 80.0), (1e-3, 90.0), (1e-2, 100.0))), NORTON),
    "cone": (hhr.DruckerPrager(80.0, 0.3, 0.1, 500.0), NORTON),
    "Hill": (hhr.Hill(80.0, 100.0, 0.7, 0.3, 0.5, 1.5, 1.8, 1.2), NORTON),
    "creep below yield": (
        hhr.PlasticityWithCreep(80.0, 500.0, 2e3, 6.0),
        hhr.Voce(120.0, 50.0, 100.0, 500.0),
    ),
    "primary creep": (hhr.Plasticity(80.0, 1e3), hhr.PrimaryCreep(2e3, 4.0, 0.3)),
    "Arrhenius": (hhr.Plasticity(80.0, 1e3), hhr.Arrhenius(1e3, 6.0, 1e4, WARM, 700.0)),
    "damage": (hhr.Lemaitre(80.0, 4e3, 1.0), NORTON),
    "heat and stiffness": (
        hhr.ChangingStiffness(
            hhr.Heated(hhr.Plasticity(80.0, 1e3), 1e-6, WARM, 400.0), "2e5 * (1 - 5e-4 * P1)"
        ),
        NORTON,
    ),
}
"""Of pellet and cladding, in MPa."""
UP = np.linspace(0, 1, 11)
PATHS: dict[str, Family] = {
    "reversed": shares(
        [*0.8 * UP, *np.linspace(0.7, 0.1, 7), *np.linspace(0.2, 1.0, 9), 0.5, 0.9, 0.4]
    ),
    "contact lost and found": shares([*UP, *UP[-2::-1], *UP[1:]], 200.0),
    "100 times slower": paced(100.0),
    "100 times faster": paced(0.01),
    "4 steps": shares([0.0, 0.5, 1.0, 0.5, 1.0], 200.0),
}


def law_cases() -> Iterator[HistoryCase]:
    """Each law along each path."""
    case = functools.partial(HistoryCase, values=VALUES, recipe=CorrectionSettings())
    for law, (pellet, cladding) in LAWS.items():
        for path, family in PATHS.items():
            yield case(f"{law}, {path}", functools.partial(with_laws, pellet, cladding), family)
