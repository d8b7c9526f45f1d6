"""Derivatives of histories of bodies with laws whose contacts have laws on ranges, by
differences.
"""

import numpy as np
import pytest
from mpi4py import MPI
from my_contact_law import Wear
from my_gasket import Gasket
from needs import needs
from stacked_pairs import stacked, with_plugins

import hhr_dolfinx as hhr

pytestmark = needs("inelastic", "friction")

BOX = hhr.ParameterSpace(
    ("push", "slide", "mu", "k1", "k3"), (0.0, -0.2, 0.1, 0.1, 1.0), (0.3, 0.2, 0.8, 5.0, 200.0)
)
PATH = [
    (0.0, (0.001, 0.0)), (1.0, (0.02, 0.0)), (2.0, (0.02, 0.004)), (3.5, (0.015, -0.002)),
    (4.5, (0.002, 0.001)), (5.0, (0.03, 0.002)), (6.0, (0.04, 0.01)),
]  # fmt: skip
CONSTANTS = np.array([0.3, 1.0, 50.0])
STEP = 1e-6
SETTINGS = {
    "search": "tangent",
    "relative_stress": 1e-11,
    "relative_force": 1e-11,
    "floor_stress": 1e-10,
}


@pytest.fixture(autouse=True)
def plugins(monkeypatch):
    with_plugins(monkeypatch)


def bodies(law):
    return hhr.Body(1, 2.0, 0.3, law), hhr.Body(2, 5.0, 0.3)


def path(changes=0.0):
    return [(time, np.append(point, CONSTANTS) + changes) for time, point in PATH]


def answers(full, changes=0.0, **settings):
    return full.march(
        path(changes), hhr.MarchSettings(outside="ignore", **SETTINGS, **settings)
    ).answers


@pytest.mark.parametrize(
    "law",
    [lambda: hhr.Norton(0.5, 3.0), lambda: hhr.Plasticity(0.02, 1.0)],
    ids=["creep", "yields"],
)
@pytest.mark.parametrize(
    "ranges",
    [
        (hhr.Coulomb("mu"), Gasket("k1", "k3"), Wear(0.05)),
        (Wear(0.05), Gasket("k1", "k3"), hhr.Coulomb("mu")),
    ],
    ids=["slides", "wears"],
)
@pytest.mark.filterwarnings("ignore")
def test_gradients_of_all_steps_are_those_of_differences(law, ranges):
    """Along loads and constants of laws of contacts, where contacts slip, wear, and leave in
    between.

    Statuses are the same at both ends, so that differences meet no kink of contacts. Steps are 1e-6
    of the box: errors are those of points that begin to yield within one, and 1e-11 / 1e-6 of
    solutions.
    """
    full = hhr.FullOrderModel(
        stacked(*ranges, cells=2, parameters=BOX, bodies=bodies(law())), MPI.COMM_SELF
    )
    exact = answers(full, gradient=True)
    touching = np.array([answer.active for answer in exact])
    assert (touching[:-1] & ~touching[1:]).any() and any(answer.worn.any() for answer in exact)
    found = np.array([answer.gradient.multipliers for answer in exact])
    widths = np.subtract(BOX.upper, BOX.lower)
    largest = np.abs(found * widths).max()
    for number, width in enumerate(widths):
        ends = [answers(full, sign * STEP * width * np.eye(5)[number]) for sign in (1, -1)]
        for end in ends:
            assert all(
                np.array_equal(one.active, other.active)
                for one, other in zip(end, exact, strict=True)
            )
        expected = np.subtract(*([answer.multipliers for answer in end] for end in ends)) / (
            2 * STEP
        )
        change = found[:, :, number] * width
        assert np.abs(change - expected).max() <= 1e-4 * np.abs(change).max() + 1e-9 * largest
