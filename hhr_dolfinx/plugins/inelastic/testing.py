"""Conformance check of a law of a body, see :mod:`hhr_dolfinx.testing`."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.plugins.inelastic.law import InternalVariables, Law, LawProgram, program_of
from hhr_dolfinx.plugins.inelastic.local_solver import AFTER, REST
from hhr_dolfinx.plugins.inelastic.update import Group, Material
from hhr_dolfinx.testing import OF_FUNCTIONS, OTHER_IN_A_FILE, blaming, from_file, require

LAW_FAULTS = {
    "formula": "its constants {} are formulas: give check_law numbers for them",
    "file": OTHER_IN_A_FILE,
    "idle": (
        "nothing flows under strains of {:g} with young = {:g}: give check_law both in its units"
    ),
    "energy": (
        "it gives back {:.3g} of the energy that a path put in: its inelastic strain goes against "
        "the stress"
    ),
    "tangent": (
        "its stress jumps, so that differences give {:.6g} and its tangent {:.6g}: state it "
        "continuously"
    ),
    "softens": (
        "its stress falls as strain grows, by {:.3g} of E: leave softening out, it depends on the "
        "mesh"
    ),
    "symmetric": (
        "its elastic C is unsymmetric by {:.3g} of E, so closed paths gain energy: derive an "
        "energy twice"
    ),
    "rest": (
        "its tangent without strain is no number: take ufl.conditional where a root or a quotient "
        "is at 0"
    ),
    "path": (
        "its stress depends on the path, by {:.3g}, and its `cumulated` never grows: return it in "
        "the memory"
    ),
}
"""Messages of the check of a law: the fault and the remedy."""
TESTED_PATHS = 60
"""Random closed paths of strains, each at a Gauss point."""
LEGS = 200
"""Steps of a leg of a path whose work is summed."""
WORK_SUM_ERROR = 1e-3
"""Error of this sum by the trapezoidal rule, over E times a strain squared."""


@blaming
def check_law(
    law: Law, *, young: float = 200.0, poisson: float = 0.3, strain: float = 0.02, dt: float = 0.1
) -> None:
    """Check a law of a body with numbers as constants, along random paths of strains in the plane.

    An inelastic law must dissipate: σ:Δε_in is not negative, or, if it does not unload along its
    elasticity at rest, as a gasket, the work from rest is not. An elastic one must have symmetric
    tangents and forget its path. Of both, tangents are derivatives of the stress, whose symmetric
    part has no eigenvalue below -0.05 E. A file answers the same. Paths start without stress: heat,
    which is constant, has strained the points before.

    Args:
        law: of small strains, or a function without arguments that makes it; wrong ones raise
            ConformanceError.
        young, poisson: E, in the unit of stress of the law, and ν of the body.
        strain: size of the steps times 4, at which an inelastic law flows.
        dt: length of a step in seconds.
    """
    if not isinstance(law, Law):
        raise SceneError("a law of a body derives hhr.Law and states a step in UFL")
    require(not law.formulas, LAW_FAULTS["formula"], law.formulas)
    program = program_of(law, 4)
    material = Material([Group(np.arange(TESTED_PATHS), young, poisson, program)], 4)
    before, compliance, start = _unloaded(material, dt)
    _check_symmetry(np.linalg.pinv(compliance), young)
    old, inelastic, flows = start, before, _flows(program)
    work = np.zeros(TESTED_PATHS)
    random = np.random.default_rng(0)
    paths = [before]
    linear = np.ones(TESTED_PATHS, dtype=bool)
    for _ in range(8):
        path = before + strain / 4 * random.standard_normal(before.shape)
        update = material.update(path, old, dt, tangent=True)
        paths.append(path)
        if flows:  # the inelastic strain is that of its elasticity, not of the body's
            last, inelastic = inelastic, path - np.einsum("nij,nj->ni", compliance, update.stress)
            work += np.einsum("nc,nc->n", update.stress, inelastic - last)
            lost = -work / (young * strain**2)
            linear &= _unloads_by(compliance, material, paths, update.state, dt)
            if lost.max() > 1e-9 and not linear[lost > 1e-9].any():
                lost = (
                    -_least_work(material, [*paths, paths[0]], start, dt) / (young * strain**2)
                    - WORK_SUM_ERROR
                )
            require(float(lost.max()) <= 1e-9, LAW_FAULTS["energy"], float(lost.max()))
        else:
            _check_symmetry(np.asarray(update.tangents), young)
            difference = np.abs(
                material.update(path, start, dt, tangent=False).stress - update.stress
            ).max()
            require(difference <= 1e-9 * young * strain, LAW_FAULTS["path"], difference)
        _check_tangents(material, path, old, dt, update.tangents, young, strain)
        before = path
        old = update.state
    require(not flows or old.cumulated.any(), LAW_FAULTS["idle"], strain, young)
    again: LawProgram = from_file(program)
    same = Material([Group(np.arange(TESTED_PATHS), young, poisson, again)], 4).update(
        before, old, dt, tangent=False
    )
    expected = material.update(before, old, dt, tangent=False)
    require(np.array_equal(same.stress, expected.stress), LAW_FAULTS["file"])


def _unloads_by(
    compliance: np.ndarray,
    material: Material,
    paths: Sequence[np.ndarray],
    state: InternalVariables,
    dt: float,
) -> np.ndarray:
    """True at points that unload along the elasticity at rest, so that ε - C^-1 σ is their
    inelastic strain.
    """
    change = 1e-6 * (paths[-1] - paths[-2])
    unloads = np.zeros(TESTED_PATHS, dtype=bool)
    for way in (-1, 1):  # one of them unloads
        perturbed = paths[-1] + way * change
        slopes = compliance @ np.asarray(
            material.update(perturbed, state, 1e-9 * dt, tangent=True).tangents
        )
        unloads |= (
            np.abs(slopes @ compliance - compliance).max(axis=(1, 2))
            <= 1e-4 * np.abs(compliance).max()
        )
    return unloads


def _least_work(
    material: Material, paths: Sequence[np.ndarray], state: InternalVariables, dt: float
) -> np.ndarray:
    """Smallest work ∫ σ:dε of each point on a path from rest, after any of its legs, by the
    trapezoidal rule.
    """
    total = least = np.zeros(TESTED_PATHS)
    last = np.zeros_like(paths[0])
    for begin, end in pairwise(paths):
        for share in np.linspace(0, 1, LEGS + 1)[1:]:
            update = material.update(begin + share * (end - begin), state, dt / LEGS, tangent=False)
            total = total + np.einsum("nc,nc->n", (last + update.stress) / 2, end - begin) / LEGS
            last = update.stress
            state = update.state
        least = np.minimum(least, total)
    return least


def _flows(program: LawProgram) -> bool:
    """True if a step may change the cumulated strain: its output is another register than its
    input.
    """
    unknowns = len(program.kinds)
    first = program.program.output_ends[(AFTER if unknowns else REST) - 1]
    return bool(program.program.outputs[first + program.strains] != 2 * program.strains + unknowns)


def _unloaded(material: Material, dt: float) -> tuple[np.ndarray, np.ndarray, InternalVariables]:
    """Strains without stress, which are those of heat, with C^-1 and state there, in a step too
    short for creep.
    """
    strain = np.zeros((TESTED_PATHS, 4))
    for _ in range(3):
        update = material.update(strain, material.at_rest(), 1e-9 * dt, tangent=True)
        tangents = np.asarray(update.tangents)
        require(np.isfinite(tangents).all(), LAW_FAULTS["rest"])
        compliance = np.linalg.pinv(tangents)
        strain = strain - np.einsum("nij,nj->ni", compliance, update.stress)
    return strain, compliance, update.state


def _check_symmetry(tangents: np.ndarray, young: float) -> None:
    """Elastic tangents, (points, 4, 4), must be second derivatives of an energy."""
    most = float(np.abs(tangents - tangents.swapaxes(1, 2)).max()) / young
    require(most <= OF_FUNCTIONS, LAW_FAULTS["symmetric"], most)


def _check_tangents(
    material: Material,
    path: np.ndarray,
    old: InternalVariables,
    dt: float,
    tangents: Any,
    young: float,
    strain: float,
) -> None:
    """Compare tangents with differences, where both sides agree: not where flow begins.

    And refuse softening.
    """
    step = 1e-6 * strain
    for component in range(4):
        step_along = step * np.eye(4)[component]
        ends = [
            material.update(path + way * step_along, old, dt, tangent=False).stress
            for way in (-1, 0, 1)
        ]
        backward = (ends[1] - ends[0]) / step
        forward = (ends[2] - ends[1]) / step
        smooth = np.abs(backward - forward).max(axis=1) <= OF_FUNCTIONS * young
        slopes = tangents[:, :, component]
        wrong = np.where(smooth, np.abs(slopes - (backward + forward) / 2).max(axis=1), 0.0)
        worst = wrong.argmax()
        fits = wrong[worst] <= 10 * OF_FUNCTIONS * young
        require(fits, LAW_FAULTS["tangent"], forward[worst].max(), slopes[worst].max())
    least = float(np.linalg.eigvalsh((tangents + tangents.swapaxes(1, 2)) / 2).min())
    require(least >= -0.05 * young, LAW_FAULTS["softens"], -least / young)
