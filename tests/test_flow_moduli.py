"""Young's modulus as a parameter where bodies flow: histories, files, derivatives, reduced models."""

import dataclasses
import warnings

import flowing
import numpy as np
import pellet_cladding_plastic as demo
import pytest

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import relative_error
from hhr_dolfinx.errors import ParameterError, SceneError
from hhr_dolfinx.reduction.flow import training_tangents
from hhr_dolfinx.snapshots.store import SnapshotStore

TIGHT = hhr.MarchSettings("tangent", relative_stress=1e-10, floor_stress=1e-9, relative_force=1e-12, outside="ignore")
QUIET = hhr.MarchSettings(outside="ignore")
SPACE = hhr.ParameterSpace(
    ("P1", "h1", "gap", "E", "w"), (0.0, 0.5, 4e-3, 150e3, 0.8), (460.0, 1.5, 16e-3, 230e3, 1.2)
)
NOMINAL = 190e3, 78e3


def pellet(young=("E", "78e3 * w"), space=SPACE, **others):
    """The small flowing scene with other moduli."""
    base = demo.scene(**flowing.SMALL_MESH)
    bodies = tuple(dataclasses.replace(body, young=own) for body, own in zip(base.bodies, young, strict=True))
    return dataclasses.replace(base, bodies=bodies, parameters=space, **others)


def path(gap=10.0, young=200e3, w=1.1, steps=flowing.STEPS):
    return [(time, np.append(point, (young, w))) for time, point in demo.path(gap, steps)]


def apart(one, other):
    """Largest relative distance of two histories in displacements, forces and stress."""
    pairs = zip(one.answers, other.answers, strict=True)
    parts = [(a.displacement(), b.displacement()) for a, b in pairs]
    parts += [(a.forces(), b.forces()) for a, b in zip(one.answers, other.answers, strict=True)]
    parts += [(a.stress(), b.stress()) for a, b in zip(one.answers, other.answers, strict=True)]
    return max(np.linalg.norm(a - b) / max(np.linalg.norm(b), 1e-30) for a, b in parts if np.any(a) or np.any(b))


@pytest.fixture(scope="module")
def full():
    return hhr.FullOrderModel(pellet())


def test_a_history_is_that_of_the_scene_with_the_number(full):
    """With factors of the middle of the box alone, since each body has a modulus of its own."""
    assert full.equilibrium._only_part is not None
    with pytest.warns(hhr.errors.SceneWarning, match="E"):
        numbers = hhr.FullOrderModel(pellet((200e3, 78e3 * 1.1)))
    for settings in (QUIET, hhr.MarchSettings("elastic", outside="ignore", iterations=300)):
        assert apart(full.march(path(), settings), numbers.march(path(), settings)) < 1e-10
    assert apart(full.march(path(young=160e3)), numbers.march(path())) > 1e-3
    assert apart(full.march(path()), numbers.march(path())) < 1e-10
