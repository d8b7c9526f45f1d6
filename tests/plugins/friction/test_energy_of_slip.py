"""The elastic energy where contacts slip, and bear forces at a slack that is not zero."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from needs import needs

import hhr_dolfinx as hhr


def made():
    from hhr_dolfinx.plugins.conformance.draft import ChosenSwitch, composed, switches

    known = switches()
    draft = composed(ChosenSwitch(name, known[name]) for name in ("friction", "energy"))
    return hhr.FullOrderModel(draft.scene(), MPI.COMM_SELF), draft.path()


@needs("conformance", "stress")
def test_energy_along_a_path_with_friction():
    """Half u K u, by the stiffness, and its derivatives beside central differences, whose error is
    1e-6 of a range.
    """
    full, path = made()
    condensed = hhr.condense(full)
    stiffness = full.problem.stiffness
    slipped = set()
    for model in (full, condensed):
        for answer in model.march(path).answers:
            field = answer.displacement()
            wanted = 0.5 * float(field @ (stiffness @ field))
            assert answer.outputs()["energy"] == pytest.approx(wanted, rel=1e-9, abs=1e-14)
            slipped |= set(answer.slip.statuses.tolist())
    assert slipped == {0, 1, 2}

    def energy(moved):
        return condensed.march(moved).answers[-1].outputs()["energy"]

    history = condensed.march(path, hhr.MarchSettings(gradient=True))
    gradient = history.answers[-1].outputs().gradient["energy"]
    box = full.parameters
    for k, width in enumerate(np.diag(np.subtract(box.upper, box.lower))):
        step = 1e-5 * width
        ends = [
            energy([(time, point + sign * step) for time, point in path]) for sign in (1.0, -1.0)
        ]
        expected = np.subtract(*ends) / 2e-5
        assert gradient[k] * width[k] == pytest.approx(expected, abs=1e-5 * energy(path)), (
            box.names[k]
        )
