"""Models with heat through contacts are made from a scene and its heat."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from mpi4py import MPI
from scipy.sparse import csc_matrix

from hhr_dolfinx.amplitudes import check_formula
from hhr_dolfinx.errors import (
    NotOfferedError,
    PairingWarning,
    ParameterError,
    SceneError,
    SmallStrainWarning,
    StabilityWarning,
)
from hhr_dolfinx.formulas import Scalar, box_samples, coordinate_names, formula_of
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.models.answer import ListedAnswers
from hhr_dolfinx.parameters import ParameterSpace, is_number
from hhr_dolfinx.plugins.contact_heat.conduction import (
    HeatSystem,
    eliminated,
    heat_system,
    sliding_conditions,
)
from hhr_dolfinx.plugins.contact_heat.heat import GAP_NAME, PRESSURE_NAME, Heat
from hhr_dolfinx.plugins.contact_heat.heated import HeatAnswer
from hhr_dolfinx.plugins.contact_heat.model import HeatModel
from hhr_dolfinx.plugins.contact_heat.modes import transient_heat
from hhr_dolfinx.plugins.contact_heat.parts import (
    Conduction,
    HeatParts,
    SlidingParts,
    TransientParts,
)
from hhr_dolfinx.plugins.contact_heat.sliding import FrictionSources
from hhr_dolfinx.plugins.contact_heat.thermal_loads import (
    FLOW,
    LEVEL,
    HeatedFullOrder,
    ShownTemperature,
    augmented,
    naming_all,
)
from hhr_dolfinx.plugins.contact_heat.transient import TransientHeatModel
from hhr_dolfinx.study.condensing import condensed
from hhr_dolfinx.warn import ignored, warn

if TYPE_CHECKING:
    from hhr_dolfinx.models.model import AnsweringModel
    from hhr_dolfinx.scene import Scene

TRIED_SIZES = (0.0, 1e-9, 1e-6, 1e-3, 1.0, 1e3, 1e6, 1e9)
"""Pressures and gaps at which signs of conductances are checked at first."""
FINEST_TOLERANCE = 1e-6
"""Least tolerance of a step, above round-off of the directions that modes are made of."""
STEP_TOLERANCE = 1e-3
"""Error of one step of transient heat where nothing is said."""
LONG_STEP = 10.0
"""Length of a step over the slowest decay, after which temperatures are nearly steady."""
FLOW_OUTPUTS = ("heat", "friction heat")
"""Beginnings of the names of outputs of heat, before the number of a contact."""
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
    prepared = _prepared(scene, heat)
    model = HeatModel(prepared.parts(eliminated(prepared.system)))
    full = prepared.full
    full.strains.corners(full, cast("AnsweringModel", _FirstBalance(model)))
    return model


def condense_transient_heat(
    scene: Scene, heat: Heat, tolerance: float = STEP_TOLERANCE, *, shortest: float = 0.0
) -> TransientHeatModel:
    """Build a model of contact and transient heat, without training: bodies warm in time, and
    displacement follows without inertia.

    Temperatures are the steady ones and modes that decay to them: Ritz vectors of temperatures
    after one step, of all lengths from the fastest decay of the mesh to the slowest.

    Args:
        scene: the scene; its parameters are those of the heat too.
        heat: conductivities, capacities, supplies, conductances and expansions. A body may be
            without a determined temperature, as it has that of its start.
        tolerance: error of what one step changes, over that change, see
            :attr:`TransientHeatModel.step_error`; 1e-6 at least. 0 keeps all modes, which are the
            full order model with the same steps, and takes memory for each of them and node.
        shortest: shortest step of the histories; 0 for any. Modes that only shorter steps need are
            left out, and a march of such steps warns.

    Raises:
        SceneError: for unknown tags or names, a body without a capacity, a tolerance that is
            neither 0 nor between 1e-6 and 1, or a shortest step that is negative.
        NotOfferedError: see :func:`condense_heat`.

    Warns:
        StabilityWarning: where the tolerance is not met.
        SmallStrainWarning: if strains or rotations are large in a corner of the box, after a step
            of ten times the slowest decay; what bodies store that are warmed for longer is not
            checked.
        PairingWarning: where displacements are imposed on both sides of a contact that conducts.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> from hhr_dolfinx.geometries import block
        >>> heat = hhr.Heat(
        ...     conductivity={block.SOLID: 50.0},
        ...     conductance={},
        ...     expansion={block.SOLID: 1e-5},
        ...     temperatures=[hhr.FixedTemperature(block.side(1, upper=True), 80.0)],
        ...     capacity={block.SOLID: 4.0},
        ... )
        >>> model = hhr.condense_transient_heat(scene, heat)
        >>> answers = model.march({"push": 50.0}, times=[0.001, 0.01, 0.1], start=20.0)
        >>> [float(answer.temperature().mean().round(1)) for answer in answers]
        [32.4, 44.3, 70.7]
    """
    if not is_number(tolerance) or not (tolerance == 0 or FINEST_TOLERANCE <= tolerance < 1):
        raise SceneError(
            f"the tolerance {tolerance!r} of a step must be between {FINEST_TOLERANCE:g} and 1, or "
            "0 for all modes"
        )
    if not is_number(shortest) or shortest < 0:
        raise SceneError(f"the shortest step {shortest!r} must be positive, or 0 for any length")
    prepared = _prepared(scene, heat, transient=True)
    found = transient_heat(prepared.system, tolerance, shortest)
    if found.step_error > tolerance:
        warn(
            f"modes of scene '{scene.name}' miss {found.step_error:.1e} of what a step changes, "
            f"and the tolerance is {tolerance:g}: tolerance=0 has all modes",
            StabilityWarning,
        )
    model = TransientHeatModel(
        TransientParts(
            prepared.parts(found.conduction),
            found.rates,
            found.grown,
            found.drained,
            csc_matrix(prepared.system.capacity),
            found.step_error,
            shortest if tolerance else 0.0,
            tuple(body.tag for body in scene.bodies),
            _owners(prepared.full),
        )
    )
    full = prepared.full
    full.strains.corners(full, cast("AnsweringModel", _LongStep(model, heat)))
    return model


def _owners(full: FullOrderModel) -> np.ndarray:
    """Number of the body of each node in the scene; the last one of a node of several."""
    problem = full.problem
    owners = np.zeros(len(problem.points), dtype=np.int64)
    numbers = full.discretisation.cell_bodies()
    for number in range(len(full.scene.bodies)):
        owners[np.unique(problem.cell_nodes[numbers == number])] = number
    return owners


@dataclass(frozen=True)
class _Prepared:
    """A scene whose heat is assembled."""

    scene: Scene
    heat: Heat
    full: FullOrderModel
    conductances: dict[int, Scalar]
    system: HeatSystem

    def parts(self, conduction: Conduction) -> HeatParts:
        """Parts of a model.

        Args:
            conduction: heat of the scene, eliminated.
        """
        scene = self.scene
        shown = ShownTemperature(self.heat)
        wide = augmented(scene, self.system, conduction, shown)
        heated = HeatedFullOrder(scene, wide, conduction, shown)
        with ignored(SmallStrainWarning):  # heat flows are no parameters of the user
            mechanical = condensed(heated, fields=True)
        return HeatParts(
            scene.parameters,
            mechanical,
            conduction,
            np.array(sorted(self.conductances), dtype=np.int64),
            tuple(self.conductances[number] for number in sorted(self.conductances)),
            self.full.problem.contact_areas.copy(),
            self.sliding(),
        )

    def sliding(self) -> SlidingParts:
        """Contacts that make heat as they slide."""
        conditions = sliding_conditions(self.full, self.heat)
        places = self.full.problem.contact_points[conditions]
        contacts = sorted(self.heat.sliding)
        names = (
            *self.scene.parameters.names,
            *coordinate_names(self.scene.hypothesis)[: places.shape[1]],
        )
        factors = tuple(Scalar(self.heat.sliding[k].factor, names) for k in contacts)
        parts = SlidingParts(np.array(contacts, dtype=np.int64), factors, conditions, places)
        sources = FrictionSources(parts, self.full.problem.contact_pairs)
        for point in box_samples(self.scene.parameters):
            sources.factors(point)  # which refuses negative ones
        return parts


def _prepared(scene: Scene, heat: Heat, *, transient: bool = False) -> _Prepared:
    """Check a scene, and assemble its heat."""
    _check(scene)
    _check_sliding(scene, heat)
    _check_amplitudes(scene, heat)
    full = FullOrderModel(naming_all(scene), MPI.COMM_SELF)
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
    system = heat_system(full, heat, conducting, transient=transient)
    return _Prepared(scene, heat, full, conductances, system)


@dataclass(frozen=True)
class _LongStep:
    """A transient model as the check of strains reads one: after a step that is longer than its
    slowest decay, from the temperature without thermal strain of the first body that expands.
    """

    model: TransientHeatModel
    heat: Heat

    def solve_many(self, points: Any, *, raise_on_failure: bool, outside: str) -> list[HeatAnswer]:
        """Answers to points of the box, (n, P), each after one step."""
        decaying = self.model.rates[self.model.rates > 0]
        long = LONG_STEP / decaying.min() if decaying.size else 1.0
        start = next((self.heat.reference_of(tag) for tag in self.heat.expansion), 0.0)
        return [
            self.model.march(point, [long], start, raise_on_failure=raise_on_failure)[0]
            for point in points
        ]


@dataclass(frozen=True)
class _FirstBalance:
    """A model with heat as the check of strains reads one: it looks for no second balance."""

    model: HeatModel

    def solve_many(self, points: Any, *, raise_on_failure: bool, outside: str) -> ListedAnswers:
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
    flows = {f"{heat} {k}" for k in range(len(scene.contacts)) for heat in FLOW_OUTPUTS}
    if reserved := [output.name for output in scene.outputs if output.name in flows]:
        raise SceneError(f"an output is named {reserved[0]!r}, as heat flows are: rename it")


def _check_sliding(scene: Scene, heat: Heat) -> None:
    """Refuse unknown contacts that slide, and parameters with the name of a coordinate.

    Raises:
        SceneError: with the contact or name.
    """
    unknown = set(heat.sliding) - set(range(len(scene.contacts)))
    if unknown:
        raise SceneError(
            f"contact {min(unknown)} slides: the scene has contacts 0 to {len(scene.contacts) - 1}"
        )
    names = set(scene.parameters.names)
    coordinates = set(coordinate_names(scene.hypothesis))
    for number, item in heat.sliding.items():
        for word in ("friction", "speed"):
            formula = formula_of(getattr(item, word), word)
            if foreign := set(formula.variables) - names - coordinates:
                raise SceneError(
                    f"the {word} {formula.text!r} of contact {number}, which slides, names "
                    f"{sorted(foreign)}: it may name the parameters {sorted(names)} and the "
                    f"coordinates {sorted(coordinates)}, and neither pressure nor gap"
                )
    shared = coordinates & names
    if heat.sliding and shared:
        raise SceneError(
            f"a parameter is named {sorted(shared)[0]!r}, which speeds take for a coordinate: "
            "rename it"
        )


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
