"""Conformance check of a law of a body, see :mod:`hhr_dolfinx.testing`."""

from __future__ import annotations

from typing import Any

import numpy as np

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.plugins.inelastic.law import Law, LawProgram, State, program_of
from hhr_dolfinx.plugins.inelastic.update import Group, Material
from hhr_dolfinx.testing import OF_FUNCTIONS, OTHER_IN_A_FILE, blaming, from_file, require

WRONG = {
    "file": OTHER_IN_A_FILE,
    "idle": "nothing flows under strains of {:g} with young = {:g}: give check_law both in its units",
    "energy": "it gives back {:.3g} of the energy that a path put in: its inelastic strain goes against the stress",
    "tangent": "its stress jumps, so that differences give {:.6g} and its tangent {:.6g}: state it continuously",
    "softens": "its stress falls as strain grows, by {:.3g} of E: leave softening out, it depends on the mesh",
}
"""What the check says of a law: what is wrong, and what to do."""
POINTS = 60


@blaming
def check_law(law: Any, *, young: float = 200.0, poisson: float = 0.3, strain: float = 0.02, dt: float = 0.1) -> None:
    """Check a law of a body, for moduli, strains and a time step at which it flows.

    Along random paths it dissipates, its tangents are derivatives of the stress, and it does not soften.
    """
    if not isinstance(law, Law):
        raise SceneError("a law of a body derives hhr.Law and states a step in UFL")
    program = program_of(law, 4)
    material = Material([Group(np.arange(POINTS), young, poisson, program)], 4)
    old = material.at_rest()
    before = np.zeros((POINTS, 4))
    work = np.zeros(POINTS)
    random = np.random.default_rng(0)
    for _ in range(8):
        path = before + strain / 4 * random.standard_normal(before.shape)
        found = material.update(path, old, dt, tangent=True)
        work += np.einsum("nc,nc->n", found.stress, found.state.inelastic - old.inelastic)
        lost = -float(work.min()) / (young * strain**2)
        require(lost <= 1e-9, WRONG["energy"], lost)
        _check_tangents(material, path, old, dt, found.tangents, young, strain)
        before = path
        old = found.state
    require(old.cumulated.any(), WRONG["idle"], strain, young)
    again: LawProgram = from_file(program)
    same = Material([Group(np.arange(POINTS), young, poisson, again)], 4).update(before, old, dt, tangent=False)
    there = material.update(before, old, dt, tangent=False)
    require(np.array_equal(same.stress, there.stress), WRONG["file"])


def _check_tangents(
    material: Material, path: np.ndarray, old: State, dt: float, tangents: Any, young: float, strain: float
) -> None:
    """Compare tangents with differences, where both sides agree: not where flow begins; and refuse softening."""
    step = 1e-6 * strain
    for place in range(4):
        step_along = step * np.eye(4)[place]
        ends = [material.update(path + way * step_along, old, dt, tangent=False).stress for way in (-1, 0, 1)]
        left = (ends[1] - ends[0]) / step
        right = (ends[2] - ends[1]) / step
        smooth = np.abs(left - right).max(axis=1) <= OF_FUNCTIONS * young
        wrong = np.abs(tangents[:, :, place] - (left + right) / 2)[smooth]
        worst = int(wrong.max(axis=1, initial=0.0).argmax()) if wrong.size else 0
        right_there = not wrong.size or wrong.max() <= 10 * OF_FUNCTIONS * young
        shown = (right[smooth][worst].max(), tangents[smooth][worst, :, place].max()) if wrong.size else (0.0, 0.0)
        require(right_there, WRONG["tangent"], *shown)
    least = float(np.linalg.eigvalsh((tangents + tangents.swapaxes(1, 2)) / 2).min())
    require(least >= -0.05 * young, WRONG["softens"], -least / young)
