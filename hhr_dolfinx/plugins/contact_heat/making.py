"""Models with heat through contacts are made from a scene and its heat."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from hhr_dolfinx.amplitudes import Amplitude, check_formula
from hhr_dolfinx.errors import (
    NotOfferedError,
    PairingWarning,
    ParameterError,
    SceneError,
    SmallStrainWarning,
)
from hhr_dolfinx.formulas import Scalar, box_samples, formula_of
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.loads import Assembler, Term
from hhr_dolfinx.parameters import ParameterSpace, Tag
from hhr_dolfinx.plugins.contact_heat.conduction import (
    HeatSystem,
    eliminated,
    heat_system,
    temperature_space,
)
from hhr_dolfinx.plugins.contact_heat.heat import GAP_NAME, PRESSURE_NAME, Heat
from hhr_dolfinx.plugins.contact_heat.model import HeatAnswer, HeatModel
from hhr_dolfinx.plugins.contact_heat.parts import Conduction, HeatParts
from hhr_dolfinx.study.condensing import condensed
from hhr_dolfinx.warn import ignored, warn

if TYPE_CHECKING:
    from ufl.core.expr import Expr

    from hhr_dolfinx.models.model import AnsweringModel
    from hhr_dolfinx.parameters import PointLike
    from hhr_dolfinx.scene import Scene

CHECKED_POINTS = 16
"""Points of the box at which sizes of heat flows are looked at."""
TRIED_SIZES = (0.0, 1e-9, 1e-6, 1e-3, 1.0, 1e3, 1e6, 1e9)
"""Pressures and gaps at which signs of conductances are checked at first."""
FLOW = "heat_of_condition_"
LEVEL = "level_of_body_"
"""Beginnings of the names of heat flows and of temperatures of bodies, as parameters of loads."""
ROOM = 10.0
"""Ends of these parameters over heat flows and temperatures that contact without resistance has."""
LOST_AREA = 1e-6
"""Part of the area of a contact that may have no condition: round-off."""


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
            parameters, bodies that contact alone holds, outputs of stress, pairings both ways.

    Warns:
        SmallStrainWarning: if strains or rotations are large in a corner of the box.
        PairingWarning: where displacements are imposed on both sides of a contact that conducts.

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
    _check_amplitudes(scene, heat)
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
    conducting = _conducting(scene, conductances)
    _warn_of_lost_areas(full, conducting)
    system = heat_system(full, heat, conducting)
    conduction = eliminated(system)
    shown = ShownTemperature(heat)
    heated = HeatedFullOrder(scene, _augmented(scene, system, conduction, shown), conduction, shown)
    with ignored(SmallStrainWarning):  # heat flows are no parameters of the user
        mechanical = condensed(heated, fields=True)
    model = HeatModel(
        HeatParts(
            scene.parameters,
            mechanical,
            conduction,
            np.array(sorted(conductances), dtype=np.int64),
            tuple(conductances[number] for number in sorted(conductances)),
            problem.contact_areas.copy(),
        )
    )
    full.strains.corners(full, cast("AnsweringModel", _FirstBalance(model)))
    return model


@dataclass(frozen=True)
class _FirstBalance:
    """A model with heat as the check of strains reads one: it looks for no second balance."""

    model: HeatModel

    def solve_many(self, points: Any, *, raise_on_failure: bool, outside: str) -> list[HeatAnswer]:
        """Answers to points of the box, (n, P), see :meth:`HeatModel.solve_many`."""
        return self.model.solve_many(points, both=False, raise_on_failure=raise_on_failure)


def _check(scene: Scene) -> None:
    """Refuse what heat does not have.

    Raises:
        NotOfferedError: with the reason.
        SceneError: for names that it takes.
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
    reserved = [name for name in scene.parameters.names if name.startswith((FLOW, LEVEL))]
    if reserved:
        raise SceneError(f"a parameter is named {reserved[0]!r}, as heat flows are: rename it")
    flows = {f"heat {k}" for k in range(len(scene.contacts))}
    if reserved := [output.name for output in scene.outputs if output.name in flows]:
        raise SceneError(f"an output is named {reserved[0]!r}, as heat flows are: rename it")


def _check_amplitudes(scene: Scene, heat: Heat) -> None:
    """Refuse temperatures and supplies that are not finite somewhere in the box, or name others.

    Raises:
        SceneError: with the name of the item.
    """
    words = ("temperature", "flux", "power", "surroundings")
    for item in (*heat.temperatures, *heat.supplies):
        for word in words:
            if hasattr(item, word):
                what = f"the {word} of {type(item).__name__} on tag {item.tag}"
                check_formula(formula_of(getattr(item, word), what).text, scene.parameters, what)


def _warn_of_lost_areas(full: FullOrderModel, conducting: Sequence[int]) -> None:
    """Warn of contact whose displacement is imposed on both sides: it has no condition, and passes
    no heat on.
    """
    rows, pairs = full.discretisation.contact_rows()
    for pair in conducting:
        whole = rows.areas[pairs == pair].sum()
        kept = full.problem.contact_areas[full.problem.contact_pairs == pair].sum()
        if kept < (1 - LOST_AREA) * whole:
            warn(
                f"displacements are imposed on both sides of {1 - kept / whole:.0%} of contact "
                f"{pair} of scene '{full.scene.name}': no heat passes there. Leave one side free "
                "at the edge",
                PairingWarning,
            )


def _conducting(scene: Scene, conductances: dict[int, Scalar]) -> list[int]:
    """Contacts that conduct at some pressure or gap."""
    points = box_samples(scene.parameters)
    ends = [(p, 0.0) for p in TRIED_SIZES] + [(0.0, g) for g in TRIED_SIZES]
    return [
        number
        for number, scalar in conductances.items()
        if any(
            (scalar.values(np.hstack([points, np.tile(end, (len(points), 1))])) > 0).any()
            for end in ends
        )
    ]


def _conductances(scene: Scene, heat: Heat) -> dict[int, Scalar]:
    """Formulas of the conductances by contact.

    Raises:
        SceneError: for an unknown contact or name, or a conductance that is negative somewhere.
    """
    names = scene.parameters.names
    if reserved := {PRESSURE_NAME, GAP_NAME} & set(names):
        raise SceneError(
            f"a parameter is named {sorted(reserved)[0]!r}, which conductances take for the "
            f"{'pressure' if PRESSURE_NAME in reserved else 'gap'}: rename it"
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
        scalar = Scalar(text, (*names, PRESSURE_NAME, GAP_NAME))
        _check_sign(scalar, scene.parameters, number)
        conductances[number] = scalar
    return conductances


def _check_sign(scalar: Scalar, space: ParameterSpace, number: int) -> None:
    """Refuse a conductance that is negative or not a number, where contact presses or is open."""
    points = box_samples(space)
    states = [(size, 0.0) for size in TRIED_SIZES] + [(0.0, size) for size in TRIED_SIZES]
    for pressure, gap in states:
        ends = np.tile([pressure, gap], (len(points), 1))
        try:
            values = scalar.values(np.hstack([points, ends]))
        except ParameterError as error:
            raise SceneError(
                f"the conductance {scalar.text!r} of contact {number} ends at p = {pressure:g}, g "
                f"= {gap:g}: {error}. Let a table reach far, or write min(p, LARGEST)"
            ) from None
        if not np.isfinite(values).all() or (values < 0).any():
            worst = values[~(np.isfinite(values) & (values >= 0))][0]
            raise SceneError(
                f"the conductance {scalar.text!r} of contact {number} is {worst:g} at p = "
                f"{pressure:g}, g = {gap:g}: it must be a number that is not negative at any "
                "pressure and gap"
            )


class ShownTemperature:
    """Temperatures whose strain stresses leave out, those of the answer that is shown.

    Args:
        heat: heat of the scene.
    """

    def __init__(self, heat: Heat):
        self._heat = heat
        self._lock = threading.Lock()
        self._field: fem.Function | None = None

    @contextmanager
    def of(self, field: fem.Function) -> Iterator[None]:
        """Show temperatures in a block of one thread at a time.

        Args:
            field: temperatures on the mesh whose stresses are requested.
        """
        with self._lock:
            self._field = field
            try:
                yield
            finally:
                self._field = None

    def strain(self, tag: Tag) -> tuple[Amplitude, Expr] | None:
        """Amplitude and strain of a body; None for one that does not expand.

        Args:
            tag: the body.

        Raises:
            NotOfferedError: outside a block, where outputs are prepared.
        """
        if tag not in self._heat.expansion:
            return None
        if self._field is None:
            raise NotOfferedError(
                "outputs read stress or energy of a body that expands by heat through contacts: "
                "leave them out, answer.stress() has the stress"
            )
        excess = self._field - self._heat.reference_of(tag)
        return Amplitude(1.0), self._heat.expansion[tag] * excess * ufl.Identity(3)


@dataclass(frozen=True)
class _GivenTerms:
    """Nodal forces with amplitudes, as a load whose strain stresses leave out."""

    given: Sequence[Term]
    shown: ShownTemperature

    def terms(self, assembler: Assembler) -> list[Term]:
        """These terms."""
        return list(self.given)

    def eigenstrain_of(self, tag: Tag, mesh: ufl.Mesh) -> tuple[Amplitude, Expr] | None:
        """Strain by the temperatures that are shown; None for a body that does not expand.

        Args:
            tag: the body.
            mesh: UFL mesh of the scene.
        """
        return self.shown.strain(tag)

    def __repr__(self) -> str:
        return f"the thermal forces of {len(self.given)} heat flows and supplies"


@dataclass(frozen=True)
class _NoForce:
    """A load without force that names parameters."""

    names: tuple[str, ...]

    def terms(self, assembler: Assembler) -> list[Term]:
        """No force."""
        amplitude = Amplitude(slopes=dict.fromkeys(self.names, 1.0))
        return [Term(amplitude, np.zeros(assembler.size))]


class HeatedFullOrder(FullOrderModel):
    """Full order whose further parameters are heat flows and levels; its stresses leave out the
    thermal strain.

    Args:
        scene: the scene of the user.
        augmented: this scene with the further parameters.
        conduction: temperatures of the scene.
        shown: temperatures of the load of the scene.
    """

    def __init__(
        self, scene: Scene, augmented: Scene, conduction: Conduction, shown: ShownTemperature
    ):
        super().__init__(augmented, MPI.COMM_SELF)
        self._count = len(scene.parameters.names)
        self._conduction = conduction
        self._shown = shown
        self._space, self._node = temperature_space(self.discretisation)

    def stress_of(self, displacement: np.ndarray, mu: PointLike | None = None) -> np.ndarray:
        """Stress in the middle of each cell, see
        :meth:`hhr_dolfinx.full_order.full.FullOrderModel.stress_of`.

        Args:
            displacement: the displacement, (N,).
            mu: parameters, with heat flows and levels, (P + m + b,); None for the middle.
        """
        # flows and levels are answers: the box, which scales claims, does not bound them
        point = self.problem.middle if mu is None else np.asarray(mu, dtype=float)
        field = fem.Function(self._space)
        field.x.array[:] = self._conduction.temperature(point, self._count)[self._node]
        with self._shown.of(field):
            return self.discretisation.stress(displacement, point)


def _augmented(
    scene: Scene, system: HeatSystem, conduction: Conduction, shown: ShownTemperature
) -> Scene:
    """The scene whose further parameters are heat flows and levels; supplies are loads."""
    flows = [f"{FLOW}{k}" for k in range(conduction.per_heat.shape[1])]
    levels = [f"{LEVEL}{k}" for k in range(conduction.levels.shape[1])]
    space = scene.parameters
    added = [*flows, *levels]
    flow, level = _sizes(space, conduction)
    ends = np.repeat([ROOM * flow, ROOM * level], [len(flows), len(levels)])
    wide = ParameterSpace(
        (*space.names, *added),
        (*space.lower, *(-ends)),
        (*space.upper, *ends),
    )
    expansion = system.expansion
    columns = np.hstack([-conduction.per_heat, conduction.levels])
    terms = [Term(Amplitude(1.0), system.at_rest)]
    terms += [
        Term(formula_of(scalar.text, "an amplitude"), expansion @ field)
        for scalar, field in zip(conduction.amplitudes, conduction.temperatures.T, strict=True)
    ]
    terms += [
        Term(Amplitude(slopes={name: 1.0}), expansion @ column)
        for name, column in zip(added, columns.T, strict=True)
    ]
    named = _naming_all(scene)
    return replace(named, parameters=wide, loads=(*named.loads, _GivenTerms(tuple(terms), shown)))


def _sizes(space: ParameterSpace, conduction: Conduction) -> tuple[float, float]:
    """Largest heat flow of a condition and largest temperature where contacts have no resistance,
    at points of the box; 1 where there are none.
    """
    supplies = np.array(
        [conduction.supplies(point) for point in box_samples(space)[:CHECKED_POINTS]]
    )
    temperatures = np.abs(supplies @ conduction.temperatures.T).max(initial=0.0)
    jumps = np.abs(supplies @ (conduction.jumps @ conduction.temperatures).T).max(initial=0.0)
    supplied = np.abs(supplies @ conduction.supplied.T).max(initial=0.0)
    compliance = (conduction.jumps @ conduction.per_heat).diagonal().mean()
    flow = max(float(jumps / compliance) if compliance > 0 else 0.0, float(supplied))
    level = max(float(temperatures), float(supplied * max(compliance, 0.0)))
    return flow or 1.0, level or 1.0


def _naming_all(scene: Scene) -> Scene:
    """The scene with a load of no force that names all parameters, as heat may depend on those that
    nothing else does.
    """
    return replace(scene, loads=(*scene.loads, _NoForce(scene.parameters.names)))
