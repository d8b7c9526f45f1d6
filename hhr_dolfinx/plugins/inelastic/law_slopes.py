"""Exact derivatives of what laws of bodies do in a step, along directions of the strain, the old
state and constants.

A law of UFL is a program: stress and memory a(y; z) with unknowns y of r(y; z) = 0, of z = (strain,
old memory, constants). Along a direction y' = -(∂r/∂y)^-1 ∂r/∂z z' by the implicit function
theorem, and a' = ∂a/∂y y' + ∂a/∂z z', by forward differentiation of the program at the converged
unknowns. Each point is on the side of its kinks, such as yield, that its step took, and reports how
far along a direction the next kink is.

A law that is code has no program. It has differences, which are refused at points whose two sides
differ.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hhr_dolfinx.errors import NotOfferedError, NotSolvableError
from hhr_dolfinx.plugins.inelastic.law import (
    InternalVariables,
    LawNumbers,
    LawProgram,
    compliance_slope,
)
from hhr_dolfinx.plugins.inelastic.local_solver import (
    AFTER,
    LOCAL,
    REST,
    START,
    TRIAL,
    solve_points,
)
from hhr_dolfinx.plugins.inelastic.outside import LawCode
from hhr_dolfinx.plugins.inelastic.update import Group, Material
from hhr_dolfinx.plugins.ufl_programs.forward import Forward
from hhr_dolfinx.plugins.ufl_programs.machine import evaluated

DIFFERENTIATED_AT_ONCE = 20_000
"""Points times directions that are differentiated at once: registers of a program keep three
numbers for each.
"""
CODE_STEP = 1e-5
"""Length of a difference of code, as a part of the box of the parameters and of the largest strain
so far.
"""
BENT = 0.05
"""Second difference of a stress over its first one, above which code has a kink there and no
curvature.
"""
SECOND_DIFFERENCE_ROUND_OFF = 1e-8
"""Part of the largest stress below which its second difference is round-off."""


class Inputs(NamedTuple):
    """Inputs of a step at n points."""

    strain: np.ndarray  #: at its end, (n, c)
    old: InternalVariables  #: before it
    dt: float  #: its duration


class Along(NamedTuple):
    """Derivatives of the inputs of a step along K directions, which are last in each array."""

    strain: np.ndarray  #: (n, c, K)
    old: InternalVariables
    constants: Sequence[np.ndarray]  #: of each group, see :meth:`Material.constants_along`
    lengths: np.ndarray  #: of differences of code, (K,)


class StepSlopes(NamedTuple):
    """Derivatives of the results of a step along K directions."""

    stress: np.ndarray  #: (n, c, K)
    state: InternalVariables  #: K is last in each array
    reach: np.ndarray  #: least distance along each direction to a kink of the law, (n, K)


def slopes_of(material: Material, given: Inputs, along: Along) -> StepSlopes:
    """Derivatives of the step of a material whose constants are numbers.

    Args:
        material: laws at the Gauss points.
        given: inputs of the step.
        along: their derivatives along K directions.

    Raises:
        NotSolvableError: if the equations of a law are singular at a point.
        NotOfferedError: for a law that is code at points whose two sides differ.
    """
    ways = along.strain.shape[2]
    old = along.old
    slopes = StepSlopes(
        np.empty_like(along.strain),
        InternalVariables(np.zeros_like(along.strain), old.cumulated.copy(), old.memory.copy()),
        np.full((len(given.strain), ways), np.inf),
    )
    for group, numbers, constants in zip(
        material.groups, material.given, along.constants, strict=True
    ):
        size = max(DIFFERENTIATED_AT_ONCE // max(ways, 1), 64)
        for first in range(0, group.indices.size, size):
            _set_slopes(group, slice(first, first + size), numbers, given, along, constants, slopes)
    return slopes


def _set_slopes(
    group: Group,
    chosen: slice,
    numbers: LawNumbers,
    given: Inputs,
    along: Along,
    constants: np.ndarray,
    found: StepSlopes,
) -> None:
    """Set the derivatives at some points of a group."""
    points = group.indices[chosen]
    values = Inputs(
        given.strain[points],
        InternalVariables(*(variable[points] for variable in given.old)),
        given.dt,
    )
    changes = constants[:, chosen] if constants.shape[1] > 1 else constants
    ways = Along(
        along.strain[points],
        InternalVariables(*(variable[points] for variable in along.old)),
        [changes],
        along.lengths,
    )
    numbers = numbers.some(chosen)
    if group.law is None:
        found.stress[points] = _of_hooke(group, numbers, values.strain, ways)
        return
    result = (_of_code if isinstance(group.law, LawCode) else _of_program)(
        group.law, numbers, values, ways
    )
    found.stress[points] = result.stress
    found.state.inelastic[points], found.state.cumulated[points] = result.state[:2]
    found.state.memory[points, : result.state.memory.shape[1]] = result.state.memory
    found.reach[points] = result.reach


def _of_hooke(group: Group, numbers: LawNumbers, strain: np.ndarray, along: Along) -> np.ndarray:
    """Derivatives of the stress of an elastic body, (n, c, K)."""
    young = group.young
    assert not isinstance(young, str)  # the material is that of a point
    graded = numbers.grading[:, None] if numbers.grading.size else 1.0
    stress = numbers.stress(strain)
    by_young, by_ratio = along.constants[0]
    slopes = np.einsum("ij,njk->nik", numbers.elastic, along.strain) * np.expand_dims(graded, -1)
    slopes += stress[:, :, None] * (by_young / (young * graded))[:, None]
    if by_ratio.any():
        softer = stress @ compliance_slope(stress.shape[1]) @ numbers.elastic / young
        slopes -= softer[:, :, None] * by_ratio[:, None]
    return slopes


def _of_program(law: LawProgram, numbers: LawNumbers, given: Inputs, along: Along) -> StepSlopes:
    """Derivatives of a law that is a program."""
    strains = law.strains
    points, _, ways = along.strain.shape
    unknowns = len(law.kinds)
    further = law.remembered - strains - 1
    inputs = np.zeros((law.program.inputs, points))
    changes = np.zeros((law.program.inputs, points, ways))
    first = strains + unknowns
    for array, values, old in (
        (inputs, given.strain, given.old),
        (changes, along.strain, along.old),
    ):
        array[:strains] = values.swapaxes(0, 1)
        array[first : first + strains] = old.inelastic.swapaxes(0, 1)
        array[first + strains] = old.cumulated
        array[first + strains + 1 : first + law.remembered] = old.memory.swapaxes(0, 1)[:further]
    inputs[first + law.remembered] = given.dt
    inputs[first + law.remembered + 1 :] = numbers.constants
    changes[first + law.remembered + 1 :] = along.constants[0]
    trial = evaluated(law.program, inputs, TRIAL)
    solved = np.full(points, unknowns > 0)
    if unknowns and len(trial):
        solved = ~(trial[0] <= 0)
    if solved.any():
        inputs[strains:first, solved] = _unknowns(law, numbers, inputs)[:, solved]
    outputs = np.empty((law.remembered, points, ways))
    values = np.empty((law.remembered, points))
    reach = np.full((points, ways), np.inf)
    for which, after in ((solved, AFTER), (~solved, REST)):
        if not which.any():
            continue
        forward = Forward(law.program, inputs[:, which], changes[:, which])
        forward.run(TRIAL)
        if len(trial):
            forward.watch_sign(TRIAL)
        if after == AFTER:
            _solve(law, forward, inputs[strains:first, which])
        forward.run(after)
        results, slopes = forward.outputs(after)
        values[:, which] = results[: law.remembered]
        outputs[:, which] = slopes[: law.remembered]
        reach[which] = forward.reach
    stress = outputs[:strains].swapaxes(0, 1)
    elastic = np.einsum("ij,njk->nik", numbers.compliance, stress)
    if numbers.grading.size:
        elastic /= numbers.grading[:, None, None]
    inelastic = along.strain - elastic
    if not law.elastic:  # C is in proportion to E
        young = numbers.constants[0][:, None]
        by_young, by_ratio = along.constants[0][:2]
        inelastic += numbers.strain(values[:strains].T)[:, :, None] * (by_young / young)[:, None]
        if by_ratio.any():
            softer = (
                values[:strains].T
                @ compliance_slope(strains, plane_stress=law.plane_stress)
                / young
            )
            inelastic -= softer[:, :, None] * by_ratio[:, None]
    memory = outputs[strains + 1 :].swapaxes(0, 1)
    return StepSlopes(stress, InternalVariables(inelastic, outputs[strains], memory), reach)


def _solve(law: LawProgram, forward: Forward, unknowns: np.ndarray) -> None:
    """Set the derivatives of the unknowns, (u, n), for which the residual stays zero."""
    size = len(unknowns)
    strains = law.strains
    forward.run(START)
    forward.run(LOCAL, watch=False)
    values, slopes = forward.outputs(LOCAL)
    matrices = values[size:].reshape(size, size, -1).transpose(2, 0, 1)
    try:
        changes = -np.linalg.solve(matrices, slopes[:size].swapaxes(0, 1))
    except np.linalg.LinAlgError:
        changes = np.full((1, 1, 1), np.nan)
    if not np.isfinite(changes).all():
        raise NotSolvableError(f"the equations of {law.name} are singular at a point of the step")
    forward.set(range(strains, strains + size), unknowns, changes.swapaxes(0, 1))
    forward.run(LOCAL)  # for its kinks, with the derivatives of the unknowns


def _unknowns(law: LawProgram, numbers: LawNumbers, inputs: np.ndarray) -> np.ndarray:
    """Converged unknowns at all points, (u, n): the step is solved again, with them as outputs
    instead of its results.

    Points that have nothing to solve for have numbers without a meaning.
    """
    strains = law.strains
    size = len(law.kinds)
    first = strains + size
    points = inputs.shape[1]
    first_output = int(law.code.output_starts[0, AFTER])
    before = np.ascontiguousarray(inputs[first : first + law.remembered])
    strain = np.ascontiguousarray(inputs[:strains])
    dt = float(inputs[first + law.remembered, 0])
    unknowns = []
    for start in range(0, size, law.remembered):
        registers = np.arange(strains + start, strains + min(start + law.remembered, size))
        outputs = law.code.outputs.copy()
        outputs[first_output : first_output + law.remembered] = registers[0]
        outputs[first_output : first_output + registers.size] = registers
        stress = np.empty((strains, points))
        new = np.empty_like(before)
        unused = np.empty((0, 0, 0)), np.empty(points, dtype=np.int64)
        code = law.code._replace(outputs=outputs)
        solve_points(code, 0, 0, points, strain, before, dt, *numbers.numbers, stress, new, *unused)
        unknowns.append(np.vstack([stress, new[strains:]])[: registers.size])
    return np.vstack(unknowns)


def _of_code(law: LawProgram, numbers: LawNumbers, given: Inputs, along: Along) -> StepSlopes:
    """Derivatives of a law that is code, by central differences.

    NotOfferedError at a kink of any point.
    """
    middle = law.update(given.strain, given.old, given.dt, numbers, tangent=False)
    differences = []
    for way, length in enumerate(along.lengths.tolist()):
        sides = []
        for step in (-length, length):
            constants = numbers.constants + step * along.constants[0][:, :, way]
            young = float(constants[0, 0]) / (
                float(numbers.grading[0]) if numbers.grading.size else 1.0
            )
            perturbed = LawNumbers(
                constants, *law.elasticity(young, float(constants[1, 0])), numbers.grading
            )
            old = InternalVariables(
                *(
                    variable + step * change[..., way]
                    for variable, change in zip(given.old, along.old, strict=True)
                )
            )
            sides.append(
                law.update(
                    given.strain + step * along.strain[:, :, way],
                    old,
                    given.dt,
                    perturbed,
                    tangent=False,
                )
            )
        less, more = (side.stress for side in sides)
        bend = np.abs(less + more - 2 * middle.stress).max(axis=1, initial=0.0)
        least = SECOND_DIFFERENCE_ROUND_OFF * np.abs(middle.stress).max(initial=0.0)
        kinks = bend > np.maximum(BENT * np.abs(more - less).max(axis=1, initial=0.0), least)
        if kinks.any():
            raise NotOfferedError(
                f"{law.name} is code, whose derivatives are differences, and {int(kinks.sum())} "
                f"of {len(kinks)} points have a kink there, as where they begin to yield in a "
                "hold of constant load: state the law in UFL, leave the hold out, or take "
                "differences of histories"
            )
        pairs = [
            (sides[1].stress, sides[0].stress),
            *zip(sides[1].state, sides[0].state, strict=True),
        ]
        differences.append([(high - low) / (2 * length) for high, low in pairs])
    stress, *state = (np.stack(columns, axis=-1) for columns in zip(*differences, strict=True))
    return StepSlopes(
        stress, InternalVariables(*state), np.full((len(stress), len(differences)), np.inf)
    )
