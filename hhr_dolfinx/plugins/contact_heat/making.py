"""Models with heat through contacts are made from a scene and its heat."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI

from hhr_dolfinx.amplitudes import Amplitude
from hhr_dolfinx.errors import NotOfferedError, SceneError, SmallStrainWarning
from hhr_dolfinx.formulas import Scalar, box_samples, formula_of
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.loads import Assembler, Term
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.plugins.contact_heat.conduction import Conduction, eliminated, heat_system
from hhr_dolfinx.plugins.contact_heat.heat import GAP, PRESSURE, Heat
from hhr_dolfinx.plugins.contact_heat.model import HeatModel
from hhr_dolfinx.plugins.small_strains.cells import LARGE_STRAIN, spread_strain, strain_kinds
from hhr_dolfinx.study.condensing import condensed
from hhr_dolfinx.warn import ignored, warn

if TYPE_CHECKING:
    from hhr_dolfinx.scene import Scene

CHECKED_CORNERS = 16
"""Most corners of the box in which strains are checked, as those of other models."""


def condense_heat(scene: Scene, heat: Heat) -> HeatModel:
    """Build a model of contact and steady heat that keeps all contact conditions, without training.

    Heat is eliminated like displacement, once: what is left are forces and heat flows of the
    contacts. Answers are those of the coupled full order model to round-off.

    Args:
        scene: the scene; its parameters are those of the heat too.
        heat: conductivities, supplies, conductances and expansions.

    Raises:
        SceneError: for unknown tags or names, or a temperature that is not determined.
        NotOfferedError: for laws of bodies and contacts, constraints, moduli or shapes as
            parameters, and bodies that contact alone holds.

    Warns:
        SmallStrainWarning: if strains or rotations are large in a corner of the box.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> from hhr_dolfinx.geometries import block
        >>> heat = hhr.Heat(
        ...     conductivity={block.SOLID: 50.0},
        ...     conductance={},
        ...     expansion={block.SOLID: 1e-5},
        ...     temperatures=[
        ...         hhr.FixedTemperature(block.side(1, upper=False), 20.0),
        ...         hhr.FixedTemperature(block.side(1, upper=True), 80.0),
        ...     ],
        ... )
        >>> model = hhr.condense_heat(scene, heat)
        >>> answer = model.solve({"push": 50.0})
        >>> round(answer.outputs()["peak"], 1), float(answer.temperature().max().round(6))
        (124.5, 80.0)
    """
    _check(scene)
    full = FullOrderModel(_naming_all(scene), MPI.COMM_SELF)
    problem = full.problem
    if problem.kernel is not None:
        raise NotOfferedError(
            f"contact alone holds a body of scene '{scene.name}': heat through contacts is for "
            "bodies that displacements hold, soft springs for instance"
        )
    conductances = _conductances(scene, heat)
    if not (problem.contact_areas > 0).all():
        raise NotOfferedError(
            "contact conditions without an area have no pressure: take another pairing"
        )
    conduction = eliminated(heat_system(full, heat))
    augmented = _augmented(scene, conduction)
    with ignored(SmallStrainWarning):  # heat flows are no parameters of the user
        mechanical = condensed(FullOrderModel(augmented, MPI.COMM_SELF), fields=True)
    areas = problem.contact_areas.copy()
    model = HeatModel(scene.parameters, mechanical, conduction, conductances, areas)
    _check_strains(full, model)
    return model


def _check_strains(full: FullOrderModel, model: HeatModel) -> None:
    """Warn of large strains and rotations in corners of the box."""
    space = model.parameters
    corners = itertools.product(*zip(space.lower, space.upper, strict=True))
    kinds = strain_kinds(full.problem, axisymmetric=full.scene.hypothesis == "axisymmetric")
    worst = 0.0
    for corner in itertools.islice(corners, CHECKED_CORNERS):
        answer = model.solve(corner, both=False, raise_on_failure=False)
        if not answer.converged:
            continue
        moved = answer.displacement()[:, None]
        for kind in kinds:
            size = spread_strain(kind.sizes(moved)[:, 0])
            if size > max(worst, LARGE_STRAIN):
                worst = size
                words = f"at {space.described(answer.parameter)}: {kind.in_words(size)}"
    if worst:
        warn(words, SmallStrainWarning)


def _check(scene: Scene) -> None:
    """Refuse what heat does not have.

    Raises:
        NotOfferedError: with the reason.
    """
    faults = {
        "bodies have laws": any(body.law is not None for body in scene.bodies),
        "contacts have laws": any(law is not None for law in scene.laws),
        "displacements follow others by constraints": bool(scene.constraints),
        "shapes depend on parameters": bool(scene.shapes),
        "K is that of a user's system": scene.system is not None,
        "moduli depend on parameters": any(
            isinstance(value, str) for body in scene.bodies for value in (body.young, body.poisson)
        ),
    }
    for fault, present in faults.items():
        if present:
            raise NotOfferedError(
                f"{fault} in scene '{scene.name}': heat through contacts is for elastic bodies of "
                "constant moduli and shape with unilateral contact"
            )


def _conductances(scene: Scene, heat: Heat) -> dict[int, Scalar]:
    """Formulas of the conductances by contact.

    Raises:
        SceneError: for an unknown contact or name, or a conductance that is negative somewhere.
    """
    names = scene.parameters.names
    if taken := {PRESSURE, GAP} & set(names):
        raise SceneError(
            f"a parameter is named {sorted(taken)[0]!r}, which conductances take for the "
            f"{'pressure' if PRESSURE in taken else 'gap'}: rename it"
        )
    conductances = {}
    for number, value in heat.conductance.items():
        if number not in range(len(scene.contacts)):
            raise SceneError(
                f"the conductance of contact {number!r}: the scene has contacts 0 to "
                f"{len(scene.contacts) - 1}"
            )
        if len(scene.contacts[number].tags) == 1:
            raise SceneError(
                f"contact {number} is with a rigid obstacle, which has no temperature: leave out "
                "its conductance, it lets no heat through"
            )
        text = formula_of(value, f"the conductance of contact {number}").text
        scalar = Scalar(text, (*names, PRESSURE, GAP))
        _check_sign(scalar, scene.parameters, number)
        conductances[number] = scalar
    return conductances


def _check_sign(scalar: Scalar, space: ParameterSpace, number: int) -> None:
    """Refuse a conductance that is negative or not a number, where contact presses or is open."""
    points = box_samples(space)
    sizes = np.array([0.0, 1e-9, 1e-6, 1e-3, 1.0, 1e3, 1e6, 1e9])
    states = [(size, 0.0) for size in sizes] + [(0.0, size) for size in sizes]
    for pressure, gap in states:
        ends = np.tile([pressure, gap], (len(points), 1))
        values = scalar.values(np.hstack([points, ends]))
        if not np.isfinite(values).all() or (values < 0).any():
            worst = values[~(np.isfinite(values) & (values >= 0))][0]
            raise SceneError(
                f"the conductance {scalar.text!r} of contact {number} is {worst:g} at p = "
                f"{pressure:g}, g = {gap:g}: it must be a number that is not negative at any "
                "pressure and gap"
            )


@dataclass(frozen=True)
class _GivenTerms:
    """Nodal forces with amplitudes, as a load."""

    given: Sequence[Term]

    def terms(self, assembler: Assembler) -> list[Term]:
        """These terms."""
        return list(self.given)


@dataclass(frozen=True)
class _NoForce:
    """A load without force that names parameters."""

    names: tuple[str, ...]

    def terms(self, assembler: Assembler) -> list[Term]:
        """No force."""
        amplitude = Amplitude(slopes=dict.fromkeys(self.names, 1.0))
        return [Term(amplitude, np.zeros(assembler.size))]


def _augmented(scene: Scene, conduction: Conduction) -> Scene:
    """The scene whose further parameters are heat flows and levels; supplies are loads."""
    flows = [f"heat_of_condition_{k}" for k in range(conduction.per_heat.shape[1])]
    levels = [f"level_of_body_{k}" for k in range(conduction.levels.shape[1])]
    space = scene.parameters
    added = [*flows, *levels]
    wide = ParameterSpace(
        (*space.names, *added),
        (*space.lower, *(-1.0 for _ in added)),
        (*space.upper, *(1.0 for _ in added)),
    )
    expansion = conduction.expansion
    columns = np.hstack([-conduction.per_heat, conduction.levels])
    terms = [Term(Amplitude(1.0), conduction.at_rest)]
    terms += [
        Term(formula_of(scalar.text, "an amplitude"), expansion @ field)
        for scalar, field in zip(conduction.amplitudes, conduction.temperatures.T, strict=True)
    ]
    terms += [
        Term(Amplitude(slopes={name: 1.0}), expansion @ column)
        for name, column in zip(added, columns.T, strict=True)
    ]
    named = _naming_all(scene)
    return replace(named, parameters=wide, loads=(*named.loads, _GivenTerms(tuple(terms))))


def _naming_all(scene: Scene) -> Scene:
    """The scene with a load of no force that names all parameters, as heat may depend on those that
    nothing else does.
    """
    return replace(scene, loads=(*scene.loads, _NoForce(scene.parameters.names)))
