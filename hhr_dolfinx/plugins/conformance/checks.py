"""Checks of pairings, loads, outputs, systems, laws of contacts and reductors, see
:mod:`hhr_dolfinx.testing`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csc_matrix, hstack

from hhr_dolfinx import registry
from hhr_dolfinx.amplitudes import Amplitude, Amplitudes
from hhr_dolfinx.body import Body
from hhr_dolfinx.contact.law import ContactLaw, PairLaw
from hhr_dolfinx.declared import check_layout
from hhr_dolfinx.errors import (
    ClaimError,
    FileContentError,
    HHRError,
    NotOfferedError,
    PairingWarning,
)
from hhr_dolfinx.full_order.discretisation import Discretisation
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.full_order.system import System
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.loads import Load, Pressure
from hhr_dolfinx.memory import NO_MEMORY, Memory
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.models.model import AnsweringModel, KeptModel
from hhr_dolfinx.online.model_file import load_model, save_model
from hhr_dolfinx.outputs import Output
from hhr_dolfinx.pairings import Pairing
from hhr_dolfinx.pairings.node_to_node import NodeToNode
from hhr_dolfinx.pairings.surface import mean_normal
from hhr_dolfinx.parameters import ParameterSpace, is_number
from hhr_dolfinx.plugins.conformance.draft import NodesBetween
from hhr_dolfinx.plugins.conformance.in_c import compilable, in_c
from hhr_dolfinx.reduction.build import build
from hhr_dolfinx.reduction.kinds import kind_of
from hhr_dolfinx.reduction.recipe import Pod, Recipe, Zone
from hhr_dolfinx.scene import Displacement, Opening, Scene
from hhr_dolfinx.snapshots.records import SnapshotSet, compute_snapshots
from hhr_dolfinx.snapshots.store import SnapshotStore
from hhr_dolfinx.study.condensing import condense
from hhr_dolfinx.testing import (
    BOX,
    FLANK,
    LOWER_BODY,
    LOWER_SURFACE,
    OF_ANSWERS,
    OF_FUNCTIONS,
    OTHER_IN_A_FILE,
    TESTED_ROUND_OFF,
    TESTED_STEP,
    UPPER_BODY,
    UPPER_SURFACE,
    Bounds,
    blaming,
    classes_in,
    from_file,
    require,
)
from hhr_dolfinx.warn import ignored

if TYPE_CHECKING:
    from hhr_dolfinx.loads import Load
    from hhr_dolfinx.models.condensed import CondensedModel
    from hhr_dolfinx.outputs import Output
    from hhr_dolfinx.plugins.contact_laws.interface import Range
    from hhr_dolfinx.plugins.contact_laws.ranges import RangeSolver, RangeStep
    from hhr_dolfinx.reduction.reductor import Reducing, Reductor

Steps = list[tuple[float, np.ndarray]]
"""Times in seconds and parameters of a path."""

MODES_LEFT_OUT = 1e-14
"""Part of the squared answers that the modes of a hyper-reduced model of the whole mesh leave
out.
"""
RESUMED = 1e-13
"""Relative difference of a history that goes on from known steps, whose slack is that of their
displacement again.
"""
FAILED_CHECKS = {
    "file": OTHER_IN_A_FILE,
    "nodes": "rows or `slaves` name nodes that are on none of its surfaces: take `surface.nodes`",
    "rows": (
        "each condition needs a place, (m, 2), an area >= 0 and a row that is not zero, the same "
        "at every call"
    ),
    "gap": (
        "gap {} grows by {:.6g} per unit that surface {} moves outward, and its row says {:.6g}: "
        "correct one"
    ),
    "patch": (
        "forces of the size of `areas` are off a uniform pressure by {:.3g}: correct areas or "
        "rows (patch test)"
    ),
    "partner": (
        "rows see displacements that touching bodies share: pair each slave with the place where "
        "it lies"
    ),
    "force": "it has no force anywhere in the box: check tag, direction and amplitude",
    "sum": (
        "its forces sum up to {} on one mesh and to {} on a finer one: integrate a density, do "
        "not load each node"
    ),
    "derivative": (
        "`derivative` of its amplitude is not what differences give: correct it, or leave it out"
    ),
    "name": "its functional is {} in {!r}, and the output {} in {!r}: hand name and unit on",
    "value": (
        "its values at points of the box are {}: return a finite number that depends on the answer"
    ),
    "condensed": (
        "a condensed model has other values than the full one: declare `uses_forces` and all rows "
        "it reads"
    ),
    "slopes": "its derivatives are {}, and differences of its value give {}: correct `slopes`",
    "schur": (
        "K or S = B K^-1 B^T is not symmetric, or S not that of K: make K by `made`, of a "
        "symmetric matrix"
    ),
    "explicit": (
        "`explicit` is not the derivative of `equations` along {}: differentiate all that depends "
        "on it there"
    ),
    "point": "a point has other equations after another one: make new arrays for each point",
    "parts": "parts() with their weights do not add up to K: return all of them, or None",
    "reduced": "it has no parts() and is reduced all the same: leave `problem` as it is given",
    "answer": "its model {} and is off by {:.3g} at {}: claim less, or refuse the scene",
    "bound": "its model is off by more than its bound at {}: call that an estimate, or correct it",
    "law": "`attached` must return a law of the same plug-in",
    "rows of a law": "`pressing` and `distinct` must return one bool for each condition",
    "within": (
        "`within` must be the law of the conditions that it is given, in their order: take all "
        "arrays there"
    ),
    "range memory": (
        "its memory of {} conditions has other arrays than `layout`: give them the size of the "
        "range"
    ),
    "range size": "`linearised` of {} conditions must return as many values for each of its parts",
    "projection": (
        "`off` must be x - p(x - c s) of one function p: it has two values at one x - c s"
    ),
    "monotone": (
        "its projection moves by more than x - c s, or against it: the force must not fall as the "
        "gap closes"
    ),
    "newton": (
        "`on_forces`, `on_slack` and `right` are not Newton's rows of `off` by differences: off "
        "by {:.2g}"
    ),
    "range slopes": "`slopes` are not the derivatives of `off` along the parameters: off by {:.2g}",
    "carried": (
        "`carried` is not the derivative of the next `shift`, which differences give: off by {:.2g}"
    ),
    "shifted": (
        "`carried` and `shifted` are not the derivatives of the next `off` along the memory, which "
        "differences give: off by {:.2g}"
    ),
    "beyond": (
        "its projection depends on its memory by more than `shift`, which gradients of histories "
        "leave out: state it by `shifted`, or raise NotOfferedError in `carried`"
    ),
    "memory": (
        "`stored`, `restored` and `layout` do not keep its memory: name each array in all of them"
    ),
    "kernel": "functions of its facet `kernel` are not those of a law in C: {}",
    "forces in C": "its functions in C give other forces than Python: off by {:.2g} of the largest",
    "parts of a law": (
        "`parts` must return what its answers depend on: folders of snapshots would mix two laws"
    ),
    "constants": (
        "its answers depend on `{}`, and its `parts` do not: folders of snapshots would mix two "
        "laws"
    ),
    "opened": (
        "bodies overlap by {:.2g} of their motion with `opened` of its memory: that must be all "
        "that their law closes, and `after` must keep it"
    ),
    "equilibrium": (
        "K u + B^T λ is off the loads by {:.2g}, or a time is missing: take "
        "`contact.unknown(forces)`"
    ),
    "no gradient": (
        "a gradient is requested and missing: return it, or refuse it by NotOfferedError"
    ),
    "condensed law": (
        "a condensed model has other histories than the full one: read S and the free slack alone"
    ),
    "known": (
        "a history that goes on from known steps is another one: `going_on` must restore all that "
        "a step reads"
    ),
    "cut": (
        "steps that are cut by a tolerance have no error or no answer: return a finite `difference`"
    ),
    "reduced law": (
        "a hyper-reduced model of the whole mesh has other histories: `within` must leave out no "
        "data"
    ),
    "gradient": (
        "the gradient of its forces is not what differences give: correct it, or refuse gradients"
    ),
}
"""Messages of checks by part: the fault, and the remedy."""


def _require(fits: bool | np.bool_, wrong: str, *given: Any) -> None:
    require(fits, FAILED_CHECKS[wrong], *given)


def pressed_blocks(parameters: Bounds | None = None, *, cells: int = 4, **changes: Any) -> Scene:
    """Blocks of so many cells per axis: the lower one is clamped, the upper one is pressed down and
    slides.

    ``parameters`` are added to :data:`BOX`, and ``changes`` replace parts of the scene.
    """
    box = {**BOX, **(parameters or {})}
    first, second = (((1.0, low), (2.0, low + 1.0), (cells, cells)) for low in (0.0, 1.0))
    clamped = two_blocks.side(LOWER_BODY, 1, False)
    top = two_blocks.side(UPPER_BODY, 1, True)
    imposed = [
        Displacement(top, k, Amplitude(slopes=slope))
        for k, slope in enumerate(({"slide": 1.0}, {"push": -1.0}))
    ]
    defaults: dict[str, Any] = {
        "name": "pressed_blocks",
        "geometry": lambda comm: two_blocks.two_blocks(comm, first=first, second=second),
        "hypothesis": "plane_strain",
        "bodies": (Body(LOWER_BODY, 2.0, 0.3), Body(UPPER_BODY, 5.0, 0.3)),
        "contacts": (NodeToNode(LOWER_SURFACE, UPPER_SURFACE, (0.0, 1.0)),),
        "displacements": (*Displacement.clamp(clamped, 2), *imposed),
        "loads": (Pressure(FLANK, Amplitude(slopes={"load": 1.0})),),
        "openings": (Opening(0, Amplitude(slopes={"gap": 1.0})),),
        "parameters": ParameterSpace(tuple(box), *zip(*box.values(), strict=True)),
    }
    return Scene(**defaults | changes)


@blaming
def check_pairing(pairing: Pairing) -> None:
    """Check a pairing of :data:`LOWER_SURFACE`, :data:`UPPER_SURFACE` or both: rows, gaps, and the
    patch test.

    The patch test needs uniform gaps. A gap to an obstacle may be a given number, which no motion
    changes.
    """
    space = Discretisation(pressed_blocks(contacts=(pairing,)))
    surfaces = [space.surface(tag) for tag in pairing.tags]
    rows = space.contact_rows()[0]
    again = pairing.rows(surfaces, space.size)
    nodes = np.concatenate([surface.nodes for surface in surfaces])
    _require(np.isin([*rows.slaves, *(rows.matrix.indices // 2)], nodes).all(), "nodes")
    right = (
        np.shape(rows.points) == (rows.gap.size, 2)
        and np.min(rows.areas) >= 0
        and np.any(rows.areas)
    )
    right = right and abs(rows.matrix).sum(axis=1).min() > 0
    same = np.array_equal(rows.gap, again.gap) and abs(rows.matrix - again.matrix).max() == 0
    _require(right and same, "rows")
    for index, surface in enumerate(surfaces):
        normal = mean_normal(surface)
        motion = np.zeros((space.size // 2, 2))
        gaps = []
        motion[surface.nodes] = normal
        for step in (-TESTED_STEP, TESTED_STEP):
            shifted = replace(surface, points=surface.points + step * normal)
            with ignored(PairingWarning):
                gaps.append(
                    pairing.rows(
                        [*surfaces[:index], shifted, *surfaces[index + 1 :]], space.size
                    ).gap
                )
        if len(surfaces) > 1 or not np.array_equal(gaps[0], gaps[1]):  # not a given number
            difference = (gaps[1] - gaps[0]) / (2 * TESTED_STEP)
            expected = -(rows.matrix @ motion.ravel())
            worst = int(np.abs(difference - expected).argmax())
            right = abs(difference - expected)[worst] <= OF_FUNCTIONS
            _require(right, "gap", worst, difference[worst], surface.tag, expected[worst])
    if np.ptp(rows.gap) > TESTED_ROUND_OFF:
        return
    pressures = [Pressure(tag, Amplitude(1.0)) for tag in pairing.tags]
    uniform = sum(load.terms(space.assembler(load))[0].columns for load in pressures)
    off = np.abs(rows.matrix.T @ rows.areas + uniform).max() / rows.areas.max()
    _require(off <= TESTED_ROUND_OFF, "patch", off)
    if len(surfaces) == 2 and np.abs(rows.gap).max() <= TESTED_ROUND_OFF:
        coordinates = np.zeros((space.size // 2, 2))
        for surface in surfaces:
            coordinates[surface.nodes] = surface.points
        # x and y times each unit vector: all linear fields are sums of them
        seen = rows.matrix @ np.hstack(
            [np.kron(column[:, None], np.eye(2)) for column in coordinates.T]
        )
        _require(np.abs(seen).max() <= TESTED_ROUND_OFF, "partner")


@blaming
def check_load(load: Load, parameters: Bounds | None = None) -> None:
    """Check forces, amplitudes, derivatives and files of a load.

    The resultant must be the same on two meshes of the blocks.

    Args:
        load: a load on tags of the blocks.
        parameters: ends of parameters by name, added to those of the blocks; None adds none.
    """
    sums = []

    def force(point: np.ndarray) -> np.ndarray:
        return columns @ amplitudes(point)

    for cells in (4, 8):
        scene = pressed_blocks(parameters, cells=cells, loads=(load,))
        space = Discretisation(scene)
        terms = space.load_terms()
        columns = csc_matrix(
            hstack([csc_matrix((space.size, 1)), *(term.columns for term in terms)])
        )
        amplitudes = Amplitudes.collect([term.amplitude for term in terms], scene.parameters)
        points = scene.parameters.random(6, 0)
        sums.append(np.array([force(point).reshape(-1, 2).sum(axis=0) for point in points]))
    size = max(np.abs(force(point)).sum() for point in points)
    _require(size > 0, "force")
    _require(np.abs(sums[1] - sums[0]).max() <= 0.01 * size, "sum", sums[0][0], sums[1][0])
    for point in points:
        acting, slopes = amplitudes.slopes_at(point)
        expected = scene.parameters.differences(force, point, TESTED_STEP)
        _require(_near(columns[:, acting] @ slopes, expected, OF_FUNCTIONS), "derivative")
    for amplitude in amplitudes.nonaffine:
        restored = from_file(amplitude)
        _require(all(np.array_equal(restored(point), amplitude(point)) for point in points), "file")


@blaming
def check_output(output: Output, parameters: Bounds | None = None) -> None:
    """Check value, slopes and unit of an output, in a condensed model and a file too.

    Args:
        output: an output of contact 0 or of the blocks.
        parameters: ends of parameters by name, added to those of the blocks; None adds none.
    """

    def value(model: AnsweringModel, point: np.ndarray) -> float:
        """Value of the output of a model at a point, (P,)."""
        return model.outputs(point)[output.name]

    full = FullOrderModel(pressed_blocks(parameters, outputs=(output,)))
    assert full.functionals is not None
    (functional,) = full.functionals.items
    same = (functional.name, functional.unit) == (output.name, output.unit)
    _require(same, "name", functional.name, functional.unit, output.name, output.unit)
    points = full.parameters.random(12, 0)  # the sixth opens the contact
    space = full.parameters
    values = [value(full, point) for point in points]
    _require(np.isfinite(values).all() and np.ptp(values) > 1e-12, "value", values)
    condensed = condense(full)
    condensed_values = [value(condensed, point) for point in points]
    _require(_near(condensed_values, values, TESTED_ROUND_OFF), "condensed")
    for point in points[:6] if functional.differentiable else ():
        answer = full.outputs(point, gradient=True)
        slopes = cast("dict[str, np.ndarray]", answer.gradient)[output.name]
        expected = space.differences(
            lambda there: np.array([value(full, there)]), point, TESTED_STEP
        )[0]
        # over the box, beside the round-off of values; at kinks there are two slopes
        widths = np.subtract(space.upper, space.lower)
        size = np.abs(values).max()
        right = answer.one_sided or _near(
            [*slopes * widths, size], [*expected * widths, size], OF_ANSWERS
        )
        _require(right, "slopes", slopes, expected)
    restored = _saved(condensed, classes_in(functional))
    _require([value(restored, point) for point in points] == condensed_values, "file")


@blaming
def check_system(system: Callable[..., System], parameters: Bounds | None = None) -> None:
    """Check what makes a System of the blocks, ``Scene(system=...)``.

    Without parts, reductions refuse it by name.

    The blocks are alone, and with an equation and a spring if the plug-ins of these are installed.

    Args:
        system: makes the System, as ``Scene(system=...)``.
        parameters: ends of parameters by name, added to those of the blocks; None adds none.
    """
    _check_system(pressed_blocks(parameters, system=system))
    public = registry.named("public")
    if not {"Equation", "Springs"} <= public.keys():
        return
    equation, springs = (registry.load(public[name]) for name in ("Equation", "Springs"))
    low, left, right = (
        NodesBetween(x, y - 0.1, y + 0.1) for x, y in ((1.0, 0.5), (1.0, 1.5), (2.0, 1.5))
    )
    joined = equation(((left, 0, 1.0), (right, 0, -1.0)), Amplitude(slopes={"slide": 0.1}))
    bedded = pressed_blocks(parameters, system=system, constraints=(joined,))
    _check_system(
        replace(bedded, loads=(*bedded.loads, springs(low, 0, 1.0), springs(left, 0, 1.0)))
    )


def _check_system(scene: Scene) -> None:
    """Check the system of a scene."""

    def respond(point: np.ndarray) -> np.ndarray:  # displacement and slack at fixed forces
        at = full.system.at(point)
        unknown = at.stiffness.solve(at.loads) - at.stiffness.response_to_forces(forces)
        return np.append(unknown, at.gaps - at.problem.contact @ unknown)

    full = FullOrderModel(scene)
    points = full.parameters.random(4, 0)
    random = np.random.default_rng(0)
    prolongation = full.problem.prolongation
    forces = random.standard_normal(full.conditions)
    tried = random.standard_normal(prolongation.free.size) * prolongation.free
    for point in points:
        at = full.system.at(point)
        assembled = full.system.parts()
        schur = at.stiffness.schur
        solved = at.stiffness.solve(tried)
        response = at.problem.contact @ at.stiffness.response_to_forces(np.eye(len(schur)))
        matrix = getattr(at.stiffness, "matrix", schur)  # factors read one half of it
        symmetric = abs(matrix - matrix.T).max() <= TESTED_ROUND_OFF * abs(matrix).max()
        _require(
            symmetric
            and _near(schur, schur.T, TESTED_ROUND_OFF)
            and _near(response, schur, TESTED_ROUND_OFF),
            "schur",
        )
        full.system.at(full.problem.middle)  # another point in between
        again = full.system.at(point)
        same = np.array_equal(at.loads, again.loads) and np.array_equal(
            solved, again.stiffness.solve(tried)
        )
        _require(same, "point")
        unknown = respond(point)[: tried.size]
        residual, slack = full.system.explicit(point, forces, unknown)
        changes = np.stack([at.stiffness.solve(-column) for column in residual.T], axis=1)
        slopes = np.vstack([changes, slack - at.problem.contact @ changes])
        expected = full.parameters.differences(respond, point, TESTED_STEP)
        for index, name in enumerate(full.parameters.names):
            _require(_near(slopes[:, index], expected[:, index], OF_ANSWERS), "explicit", name)
        if assembled is not None:
            weights = [modulus.value(point) for modulus in assembled[0]] or [1.0]
            product = sum(
                weight * (term @ tried) for weight, term in zip(weights, assembled[1], strict=True)
            )
            back = at.stiffness.solve(product * prolongation.free)
            _require(_near(back, prolongation.prolong(tried), TESTED_ROUND_OFF), "parts")
    for reduced in (
        (condense, lambda full: build(full, compute_snapshots(full, points)))
        if assembled is None
        else ()
    ):
        try:
            reduced(full)
        except NotOfferedError:
            continue
        _require(False, "reduced")


@blaming
def check_contact_law(law: PairLaw) -> None:
    """Check a law of interfaces, a :class:`~hhr_dolfinx.contact.law.PairLaw` whose plug-in is
    installed.

    Histories of the full model, of a condensed one and of its file agree, go on from known steps,
    and can be cut. A hyper-reduced model of the whole mesh has the same, and so has a compiled C
    header, with the facet ``kernel`` and a compiler. What the plug-in has no facet for is refused.
    """
    pair = NodeToNode(LOWER_SURFACE, UPPER_SURFACE, (0.0, 1.0), law=law)
    full = FullOrderModel(pressed_blocks(contacts=(pair,)))
    path = _to_and_fro(full.parameters)
    full_law = full.law
    _check_rows(full, law.plugin)
    exact = full.march(path).answers
    _check_steps(full, path, exact)
    _check_constants(pair, full_law, path, exact)
    condensed = condense(full)
    _require(
        _alike(full_law, exact, condensed.march(path).answers, TESTED_ROUND_OFF), "condensed law"
    )
    if compilable(law.plugin):
        _check_in_c(condensed, path)
    _check_resumed(full, path, exact)
    try:
        _require(
            full.march(path, MarchSettings(gradient=True)).answers[-1].gradient is not None,
            "no gradient",
        )
    except NotOfferedError:
        pass
    answers = condensed.march(path, MarchSettings(time_tolerance=0.05)).answers
    _require(all(answer.converged and np.isfinite(answer.time_error) for answer in answers), "cut")
    kept_model = _saved(condensed, classes_in(full_law))
    _require(
        _alike(full_law, condensed.march(path).answers, kept_model.march(path).answers, 0.0), "file"
    )
    _check_reduced(full, path, exact)


def _to_and_fro(parameters: ParameterSpace) -> Steps:
    """Steps through a box of four parameters that go up, turn and come back."""
    low = np.array(parameters.lower)
    width = np.array(parameters.upper) - low
    shares = (
        (0.0, 0.0, 0.0, 0.0),
        (0.6, 0.5, 0.2, 0.0),
        (1.0, 0.9, 0.2, 0.0),
        (0.9, 0.1, 0.5, 0.1),
        (0.2, 0.5, 0.0, 1.0),
    )
    return [(float(k), low + width * share) for k, share in enumerate(shares)]


def _check_steps(full: FullOrderModel, path: Steps, exact: Sequence[Answer]) -> None:
    """Steps are in equilibrium, at their times, without penetration, and a file keeps their
    memory.
    """
    law = full.law
    for (time, _), answer in zip(path[1:], exact, strict=True):
        residuals = kind_of(full).residuals(answer)
        _require(
            residuals.equilibrium <= TESTED_ROUND_OFF and answer.time == time,
            "equilibrium",
            residuals.equilibrium,
        )
        _require(residuals.penetration <= OF_FUNCTIONS, "opened", residuals.penetration)
        stored = law.stored(answer.memory)
        again = law.stored(
            law.restored({name: np.asarray(value) for name, value in stored.items()})
        )
        same = stored.keys() == law.layout.keys() and all(
            np.array_equal(stored[name], again[name]) for name in stored
        )
        _require(same, "memory")


def _check_resumed(full: FullOrderModel, path: Steps, exact: list[Answer]) -> None:
    """A history goes on from known steps, and one that a store has is the same."""
    law = full.law
    _require(
        _alike(law, exact[2:], full.march(path, known=exact[:2]).answers[2:], RESUMED), "known"
    )
    with TemporaryDirectory() as folder:
        stored = [
            compute_snapshots(full, [path], store=SnapshotStore(folder, full)).histories[0]
            for _ in range(2)
        ]
        _require(_alike(law, stored[0].answers, stored[1].answers, 0.0), "memory")


def _check_reduced(full: FullOrderModel, path: Steps, exact: Sequence[Answer]) -> None:
    """A hyper-reduced model of the whole mesh has the history of the full one, if it is offered."""
    all_nodes = Zone(lambda problem: np.arange(len(problem.points)))
    recipe = Recipe.of_paths(basis=Pod(MODES_LEFT_OUT), nodes=(all_nodes,)).as_it_is()
    try:
        reduced = build(full, SnapshotSet.of_histories([full.march(path)]), recipe)
    except NotOfferedError:
        return
    answers = reduced.march(path).answers
    _require(_alike(full.law, exact, answers, 100 * np.sqrt(MODES_LEFT_OUT)), "reduced law")


def _check_rows(full: FullOrderModel, plugin: str) -> None:
    """Check the law of a plug-in on the rows of a model, and its facet ``range`` if it has one."""
    law = full.law
    its_own = law.of(plugin)
    _require(its_own is not None, "law")
    assert its_own is not None
    rows = full.conditions
    _require(law.pressing(rows).shape == law.distinct(rows).shape == (rows,), "rows of a law")
    all_rows = law.within(np.arange(rows))
    _require(_same_parts(law, all_rows), "within")
    _require(bool(its_own.parts()), "parts of a law")
    if "range" in registry.installed()[plugin].facets:
        check_range(full, plugin)


def _check_constants(
    pair: NodeToNode, full_law: ContactLaw, path: Steps, exact: Sequence[Answer]
) -> None:
    """Constants of a law on which answers along a path depend change its parts."""
    law: Any = pair.law
    for constant in fields(law) if is_dataclass(law) else ():
        value = getattr(law, constant.name)
        text = f"1.25 * ({value})" if value in law.texts else None
        if not constant.init or (text is None and not is_number(value)):
            continue
        try:
            changed = replace(law, **{constant.name: text or 1.25 * value})
            full = FullOrderModel(pressed_blocks(contacts=(replace(pair, law=changed),)))
            same = not _same_parts(full_law, full.law) or _alike(
                full_law, exact, full.march(path).answers, OF_FUNCTIONS
            )
        except HHRError:  # no admissible constant
            continue
        _require(same, "constants", constant.name)


def _check_in_c(model: CondensedModel, path: Steps) -> None:
    """C functions of a law give the forces of Python along a path."""
    exact = np.array([answer.multipliers for answer in model.march(path).answers])
    forces = in_c(model, path)
    if isinstance(forces, str):
        _require(False, "kernel", forces)
    else:
        off = float(np.abs(forces - exact).max() / np.abs(exact).max())
        _require(off <= TESTED_ROUND_OFF, "forces in C", off)


def _same_parts(one: ContactLaw, other: ContactLaw) -> bool:
    both = one.parts(), other.parts()
    return len(both[0]) == len(both[1]) and all(
        np.array_equal(*pair) for pair in zip(*both, strict=True)
    )


def check_range(full: FullOrderModel, plugin: str) -> None:
    """Check the facet ``range`` of a law, on all conditions of a model and on a subset.

    Args:
        full: full model whose scene has the law.
        plugin: name of the plug-in of the law.
    """
    from hhr_dolfinx.plugins.contact_laws.interface import Range

    law = full.law
    full_range = next(
        (law_range for law_range in getattr(law, "ranges", ()) if law_range.law.plugin == plugin),
        None,
    )
    full_range = Range(law, np.arange(full.conditions)) if full_range is None else full_range
    nodes = full.problem.contact_slaves[full_range.rows]
    # the ends of the row have half of an area: no other order of the rows left, nor the first ones,
    # have the same
    selected = np.roll(np.flatnonzero(nodes != nodes[0])[::-1], 1)
    subset = Range(full_range.law.within(selected), full_range.rows[selected])
    back = np.argsort(selected)
    again = full_range.law.within(np.sort(selected))
    _require(_same_parts(subset.law.within(back), again), "within")
    contact_at = full.contacts()
    largest = max(
        np.abs(contact_at(point).free_slack).max() for point in full.parameters.random(4, 2)
    )
    afterwards = []
    for tested, chosen in ((full_range, np.arange(full_range.rows.size)), (subset, selected)):
        drawn = np.random.default_rng(3)
        random = np.random.default_rng(6)
        solver = tested.solver()
        stiffness = 1.0 / np.abs(np.diag(full.schur))[tested.rows]
        memory = solver.at_rest()
        _check_size(tested, memory)
        for point in full.parameters.random(4, 5):
            previous = memory if tested.law.remembers else NO_MEMORY
            step = partial(solver.step, previous, seconds=0.7)
            forces, slack = largest * drawn.standard_normal((2, full_range.rows.size))[:, chosen]
            at = stiffness * forces, slack, stiffness
            monotone = not solver.coupling(full.schur, tested.rows, point)
            _check_projection(step(point), at, random, monotone)
            active = step(point).linearised(*at, 1).active
            memory = step(point).after(np.abs(at[0]), at[1], active)
            _check_size(tested, memory)
            _check_kept(tested, solver, memory, point, at)
            _check_derivatives(full, step, point, at)
            if tested.law.remembers:
                _check_carried(solver, point, step(point), at)
            afterwards.append(step(point).linearised(*at, 1).off)
    pairs = zip(afterwards[: len(afterwards) // 2], afterwards[len(afterwards) // 2 :], strict=True)
    _require(
        all(_near(few, complete[selected], TESTED_ROUND_OFF) for complete, few in pairs), "within"
    )


def _check_size(part: Range, memory: Memory) -> None:
    """Arrays of a memory have the sizes of the layout on a range."""
    arrays = {name: np.asarray(value) for name, value in part.law.stored(memory).items()}
    try:
        check_layout(arrays, part.law.layout, {**part.law.sizes, "N_lambda": part.rows.size})
    except FileContentError:
        _require(False, "range memory", part.rows.size)


def _check_kept(
    part: Range, solver: RangeSolver, memory: Memory, point: np.ndarray, at: Iterate
) -> None:
    """A memory that a file restores adds the same to the gaps, and its next increment is the
    same.
    """
    again = part.law.restored(
        {name: np.asarray(value) for name, value in part.law.stored(memory).items()}
    )
    states = []
    for state in (memory, again):
        step = solver.step(state if part.law.remembers else NO_MEMORY, point, 0.7)
        states.append((part.law.opened(state), step.shift, step.linearised(*at, 1).off))
    _require(all(np.array_equal(*pair) for pair in zip(*states, strict=True)), "memory")


Iterate = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Forces, slacks and stiffness of the rows of a range."""


def _check_projection(
    step: RangeStep, at: Iterate, random: np.random.Generator, monotone: bool
) -> None:
    """``off`` is less a projection of x - c s, which of a monotone law does not expand."""
    forces, slack, stiffness = at
    first = step.linearised(*at, 1)
    sizes = {
        np.size(value)
        for value in (
            step.shift,
            first.off,
            first.on_forces,
            first.on_slack,
            first.right,
            first.active,
        )
    }
    _require(sizes == {forces.size}, "range size", forces.size)
    perturbation = np.abs(forces).max() * random.standard_normal(forces.size)
    second = step.linearised(forces + perturbation, slack + perturbation / stiffness, stiffness, 1)
    projected = forces - first.off
    _require(_near(forces + perturbation - second.off, projected, TESTED_ROUND_OFF), "projection")
    if monotone:
        for way in np.diag(perturbation):
            change = projected - (
                forces - step.linearised(forces, slack + way / stiffness, stiffness, 1).off
            )
            _require(change @ way - change @ change >= -TESTED_ROUND_OFF * way @ way, "monotone")


def _check_derivatives(
    full: FullOrderModel, step: Callable[..., RangeStep], point: np.ndarray, at: Iterate
) -> None:
    """Newton's rows span those of differences, since rows of one law may be added to each other.

    And slopes.
    """
    forces, slack, stiffness = at
    size = forces.size
    linear = step(point).linearised(*at, 1)
    on_forces = np.diag(linear.on_forces)
    if linear.coupling is not None:
        np.add.at(
            on_forces, (linear.coupling.rows, linear.coupling.columns), linear.coupling.on_forces
        )
    jacobian = np.hstack(
        [on_forces, linear.of_slack(np.eye(size) / stiffness), linear.right[:, None]]
    )
    unit = TESTED_STEP * np.abs(forces).max() * np.eye(size)

    def off(forces: np.ndarray, slack: np.ndarray) -> np.ndarray:
        """Residual ``off`` for changed forces and slack, (m,) each."""
        return step(point).linearised(forces, slack, stiffness, 1).off

    exact = [
        (off(forces + change, slack) - off(forces - change, slack)) / (2 * change.max())
        for change in unit
    ]
    exact += [
        (off(forces, slack + change / stiffness) - off(forces, slack - change / stiffness))
        / (2 * change.max())
        for change in unit
    ]
    both = np.array(exact).T
    right = both @ np.concatenate([forces, slack * stiffness]) - linear.off
    expected = np.hstack([both, right[:, None]])
    scale = np.append(np.ones(2 * size), np.abs(forces).max())
    combined = np.linalg.lstsq((jacobian / scale).T, (expected / scale).T, rcond=None)[0]
    error = float(np.abs(combined.T @ (jacobian / scale) - expected / scale).max())
    _require(error <= OF_ANSWERS, "newton", error)
    slopes = np.broadcast_to(np.transpose(step(point).slopes(*at)), (point.size, size)).T
    expected = full.parameters.differences(
        lambda there: step(there).linearised(*at, 1).off, point, TESTED_STEP
    )
    error = float(
        np.abs(slopes - expected).max()
        / (np.abs(expected).max() + TESTED_ROUND_OFF * np.abs(forces).max())
    )
    _require(error <= OF_ANSWERS or not np.abs(slopes - expected).any(), "range slopes", error)


def _check_carried(solver: RangeSolver, point: np.ndarray, step: RangeStep, at: Iterate) -> None:
    """The next shift changes with forces and slacks as ``carried`` says, and the memory acts by its
    shift alone; or by more, as ``shifted`` says.
    """
    forces, slack, stiffness = at
    active = step.linearised(*at, 1).active
    random = np.random.default_rng(4)
    ways = [
        TESTED_STEP * np.abs(value).max() * random.standard_normal((value.size, 1))
        for value in (forces, slack)
    ]

    def following(sign: float) -> RangeStep:
        memory = step.after(forces + sign * ways[0][:, 0], slack + sign * ways[1][:, 0], active)
        return solver.step(memory, point, 0.7)

    try:
        carried = step.carried(np.zeros((forces.size, 1)), ways[0], ways[1], active)
    except NotOfferedError:  # gradients of its histories are refused
        return
    ones = np.ones((forces.size, 1))
    if not np.array_equal(step.shifted(ones), ones):
        half = forces, 0.5 * slack, stiffness
        after = following(0.0)
        linear = after.linearised(*half, 1)
        found = linear.of_slack(after.shifted(carried))[:, 0]
        ends = [following(sign).linearised(*half, 1).off for sign in (1.0, -1.0)]
        expected = 0.5 * (ends[0] - ends[1])
        error = float(np.abs(found - expected).max() / (np.abs(expected).max() or 1.0))
        return _require(error <= OF_FUNCTIONS, "shifted", error)
    # a memory may act beside the shift by steps alone, as one of statuses does
    ends = [following(sign).linearised(*at, 1).off for sign in (1.0, -1.0)]
    at_rest = solver.step(solver.at_rest(), point, 0.7).linearised(*at, 1).off
    by_shift = _near(step.linearised(*at, 1).off, at_rest, TESTED_ROUND_OFF)
    _require(by_shift or np.array_equal(ends[0], ends[1]), "beyond")
    step.linearised(*at, 1)
    expected = 0.5 * (following(1.0).shift - following(-1.0).shift)
    error = float(np.abs(carried[:, 0] - expected).max() / (np.abs(expected).max() or 1.0))
    _require(error <= OF_FUNCTIONS, "carried", error)


def _alike(
    law: ContactLaw, one: Sequence[Answer], other: Sequence[Answer], tolerance: float
) -> bool:
    """True if answers have the same forces and memories, relative to the largest of each over all
    of them.
    """
    arrays = [
        [{"forces": a.forces(), **law.stored(a.memory)} for a in answers]
        for answers in (one, other)
    ]
    for name in arrays[0][0]:
        pair = [
            np.array([np.asarray(stored[name], float) for stored in answers]) for answers in arrays
        ]
        if np.abs(pair[0] - pair[1]).max(initial=0.0) > tolerance * np.abs(pair[0]).max(
            initial=0.0
        ):
            return False
    return True


@blaming
def check_reductor(
    reductor: Reductor | Reducing, known: Iterable[type] = (), *, tolerance: float = 0.05
) -> None:
    """Check a reductor on blocks of constant stiffness, and with a modulus as parameter.

    Its model agrees with full answers that were held out: to round-off if it calls itself exact,
    else to ``tolerance``, and within its bounds if it has any. It may refuse files, gradients and
    the varying modulus, with an error of the package.

    Args:
        reductor: the reductor.
        known: your classes that its files hold, see :func:`hhr_dolfinx.load_model`.
        tolerance: largest relative error of forces and displacements.
    """
    bodies = Body(LOWER_BODY, "young", 0.3), Body(UPPER_BODY, 5.0, 0.3)
    for scene in (pressed_blocks(), pressed_blocks({"young": (1.0, 4.0)}, bodies=bodies)):
        full = FullOrderModel(scene)
        sets = [
            compute_snapshots(full, full.parameters.random(count, seed))
            for count, seed in ((24, 0), (4, 1))
        ]
        try:
            model = build(full, sets[0], reductor, sets[1])
        except HHRError as error:
            if full.problem.varies and not isinstance(error, ClaimError):
                continue
            raise
        _check_answers(full, model, tolerance)
        try:
            restored = _saved(model, known)
        except NotOfferedError:
            continue
        pairs = [
            [solver.solve(point, outside="ignore") for solver in (model, restored)]
            for point in sets[1].points
        ]
        arrays = [[np.append(answer.forces(), answer.unknown) for answer in pair] for pair in pairs]
        _require(all(np.array_equal(first, second) for first, second in arrays), "file")


def _check_answers(full: FullOrderModel, model: AnsweringModel, tolerance: float) -> None:
    """Compare answers, bounds and gradients of the forces at points that were not trained on."""

    def forces(point: np.ndarray) -> np.ndarray:
        return model.solve(point, outside="ignore").multipliers

    pairs = [
        (full.solve(point), model.solve(point, outside="ignore"))
        for point in full.parameters.random(8, 1)
    ]
    both = [[(answer.forces(), answer.displacement()) for answer in pair] for pair in pairs]
    sizes = [max(np.linalg.norm(reference[k]) for reference, _ in both) for k in (0, 1)]
    limit = TESTED_ROUND_OFF if model.fields.exact else tolerance
    claim = "calls itself exact" if model.fields.exact else f"promises {tolerance:g}"
    for (reference, approximate), (exact, reduced) in zip(pairs, both, strict=True):
        off = [reduced[k] - exact[k] for k in (0, 1)]
        error = max(float(np.linalg.norm(off[k]) / sizes[k]) for k in (0, 1))
        location = full.parameters.described(reference.parameter)
        _require(error <= limit, "answer", claim, error, location)
        if (bound := approximate.estimate()) is not None and bound.kind == "bound":
            energy = np.sqrt(
                max(off[1] @ (full.problem.at(reference.parameter).stiffness @ off[1]), 0.0)
            )
            held = np.linalg.norm(off[0]) <= bound.forces_euclid + TESTED_ROUND_OFF * sizes[0]
            _require(
                held and energy <= bound.primal + TESTED_ROUND_OFF * sizes[0], "bound", location
            )
        try:
            gradient = model.solve(reference.parameter, gradient=True, outside="ignore").gradient
        except NotOfferedError:
            continue
        assert gradient is not None
        expected = full.parameters.differences(forces, reference.parameter, TESTED_STEP)
        _require(
            gradient.one_sided or _near(gradient.multipliers, expected, OF_ANSWERS), "gradient"
        )


def _near(found: ArrayLike, expected: ArrayLike, tolerance: float) -> bool:
    """True if arrays agree relative to the largest entry."""
    return bool(
        np.abs(np.subtract(found, expected)).max() <= tolerance * np.abs(expected).max() + 1e-14
    )


def _saved(model: KeptModel, known: Iterable[type]) -> KeptModel:
    """The model as its file restores it."""
    with TemporaryDirectory() as folder:
        save_model(Path(folder) / "model.npz", model)
        return load_model(Path(folder) / "model.npz", list(known))
