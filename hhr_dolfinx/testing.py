"""Conformance checks: each holds a part that you wrote to the contract of its seam, on two small pressed blocks.

A check takes the part, or a function without arguments that makes it, and raises :class:`ConformanceError` with one
sentence that says what is wrong and what to do. The blocks need no optional package. Parts refer to them by the tags
below, to contact 0, and to the parameters of :data:`BOX` or to your own, which you give by name with their bounds. Seeds
are fixed. A check does not prove that a part models what you mean: write tests of your own for that.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FunctionType
from typing import Any

import numpy as np
from scipy.sparse import hstack

from hhr_dolfinx.amplitudes import Amplitude, Amplitudes
from hhr_dolfinx.body import Body
from hhr_dolfinx.contact.problem import ContactRows
from hhr_dolfinx.errors import ConformanceError, HHRError, NotOfferedError, PairingWarning
from hhr_dolfinx.full_order.discretisation import Discretisation
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.loads import Pressure, checked_terms, parted
from hhr_dolfinx.materials.elasticity import lame_parameters
from hhr_dolfinx.materials.update import Group, Material, flow_of
from hhr_dolfinx.online.model_file import load_model, save_model
from hhr_dolfinx.pairings.node_to_node import NodeToNode
from hhr_dolfinx.pairings.surface import Surface, mean_normal
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.plain import as_plain, by_name, restored
from hhr_dolfinx.reduction.build import build
from hhr_dolfinx.reduction.exact import exact_condensation
from hhr_dolfinx.scene import Displacement, Scene
from hhr_dolfinx.snapshots.records import compute_snapshots
from hhr_dolfinx.study.condensing import condense
from hhr_dolfinx.warn import ignored

LOWER_BODY, UPPER_BODY = two_blocks.FIRST, two_blocks.SECOND
"""Cell tags of the blocks 1 <= x <= 2 with 0 <= y <= 1 and 1 <= y <= 2."""
LOWER_SURFACE, UPPER_SURFACE = two_blocks.side(LOWER_BODY, 1, True), two_blocks.side(UPPER_BODY, 1, False)
"""Facet tags of the surfaces that touch, at y = 1."""
FLANK = two_blocks.side(UPPER_BODY, 0, True)
"""Facet tag of the side x = 2 of the upper block, on which the pressure ``load`` acts."""
BOX = {"push": (0.005, 0.06), "slide": (-0.02, 0.02), "load": (0.0, 0.1)}
"""Parameters with bounds: the motion of the top down and aside, and the pressure on the flank."""
ROUND_OFF = 1e-8
"""Relative error of what is exact; cond(K) of the blocks is below 1e4."""
OF_FUNCTIONS, OF_ANSWERS = 1e-6, 1e-5
"""Relative errors of differences: of smooth functions, and of answers, whose round-off is larger."""
STEP = 1e-5
"""Step of differences over the box, or over the size of a block."""
Bounds = Mapping[str, tuple[float, float]]


def pressed_blocks(parameters: Bounds | None = None, *, cells: int = 4, **changes: Any) -> Scene:
    """Two blocks in contact: the lower one is clamped, the upper one is pushed down, slid, and pressed from the side.

    Args:
        parameters: your own parameters with their bounds, beside :data:`BOX`.
        cells: cells along each axis of a block.
        changes: parts of the scene instead of these.
    """
    box = {**BOX, **(parameters or {})}
    first, second = (((1.0, low), (2.0, low + 1.0), (cells, cells)) for low in (0.0, 1.0))
    clamped, top = two_blocks.side(LOWER_BODY, 1, False), two_blocks.side(UPPER_BODY, 1, True)
    motions = Amplitude(slopes={"slide": 1.0}), Amplitude(slopes={"push": -1.0})
    given: dict[str, Any] = {
        "name": "pressed_blocks",
        "geometry": lambda comm: two_blocks.two_blocks(comm, first=first, second=second),
        "hypothesis": "plane_strain",
        "bodies": (Body(LOWER_BODY, 2.0, 0.3), Body(UPPER_BODY, 5.0, 0.3)),
        "contacts": (NodeToNode(LOWER_SURFACE, UPPER_SURFACE, (0.0, 1.0)),),
        "displacements": (
            *Displacement.clamp(clamped, 2),
            *(Displacement(top, k, motion) for k, motion in enumerate(motions)),
        ),
        "loads": (Pressure(FLANK, Amplitude(slopes={"load": 1.0})),),
        "parameters": ParameterSpace(tuple(box), *zip(*box.values(), strict=True)),
    }
    return Scene(**given | changes)


def check_pairing(pairing: Any) -> None:
    """Check a pairing of :data:`LOWER_SURFACE`, :data:`UPPER_SURFACE` or both.

    Rows reach nodes of its surfaces only. Gaps change by -B u if a surface moves along its normal. Where gaps are
    uniform, forces of the size of the areas are those of a uniform pressure: the patch test. Where surfaces touch, rows
    do not see displacements that both bodies share.
    """
    pairing = _made(pairing)
    with _blamed(pairing, "its rows"):
        space = Discretisation(pressed_blocks(contacts=(pairing,)))
        surfaces = [space.surface(tag) for tag in pairing.tags]
        rows, _ = space.contact_rows()
        _check_rows(pairing, rows, pairing.rows(surfaces, space.size), surfaces)
        for place in range(len(surfaces)):
            _check_shift(pairing, rows, surfaces, place)
        if np.ptp(rows.gap) > ROUND_OFF:
            return
        pressures = [Pressure(tag, Amplitude(1.0)) for tag in pairing.tags]
        uniform = sum(checked_terms(load, space.assembler(load))[0].columns for load in pressures).toarray().ravel()
        off = np.abs(rows.matrix.T @ rows.areas + uniform).max() / rows.areas.max()
        _require(off <= ROUND_OFF, pairing, f"it fails the patch test by {off:.3g}: forces of the size of `areas` are "
                 "not those of a uniform pressure; correct areas or rows")  # fmt: skip
        if len(surfaces) == 2 and np.abs(rows.gap).max() <= ROUND_OFF:
            places = np.zeros((space.size // 2, 2))
            for surface in surfaces:
                places[surface.nodes] = surface.points
            # x and y times each unit vector: all linear fields are sums of them
            seen = np.abs(rows.matrix @ np.hstack([np.kron(column[:, None], np.eye(2)) for column in places.T])).max()
            _require(seen <= ROUND_OFF, pairing, "its rows see displacements that both bodies share where surfaces "
                     "touch: pair each slave with the place of the master where it lies")  # fmt: skip


def _check_rows(pairing: Any, rows: ContactRows, again: ContactRows, surfaces: list[Surface]) -> None:
    """Check the parts of rows in the plane, and that they are made alike twice."""
    nodes = np.concatenate([surface.nodes for surface in surfaces])
    reached = np.isin(rows.slaves, nodes).all() and np.isin(rows.matrix.indices // 2, nodes).all()
    _require(reached, pairing, "rows or `slaves` name nodes that are on none of its surfaces: take `surface.nodes`")
    _require(np.shape(rows.points) == (rows.gap.size, 2) and np.min(rows.areas) >= 0 and np.any(rows.areas), pairing,
             "each condition needs a place, (m, 2), and an area >= 0, and some area must be positive")  # fmt: skip
    _require(abs(rows.matrix).sum(axis=1).min() > 0, pairing, "a row is zero: leave out conditions that reach no node")
    same = rows.gap.shape == again.gap.shape and np.array_equal(rows.gap, again.gap)
    _require(same and abs(rows.matrix - again.matrix).max() == 0, pairing,
             "a second call makes other rows: they may depend on its fields and on the surfaces only")  # fmt: skip


def _check_shift(pairing: Any, rows: ContactRows, surfaces: list[Surface], place: int) -> None:
    """Compare gaps with rows while one surface moves along its normal."""
    surface, normal, ends = surfaces[place], mean_normal(surfaces[place]), []
    for step in (-STEP, STEP):
        moved = replace(surface, points=surface.points + step * normal)
        with ignored(PairingWarning):
            given = [*surfaces[:place], moved, *surfaces[place + 1 :]]
            ends.append(pairing.rows(given, rows.matrix.shape[1]).gap)
    _require(ends[0].shape == ends[1].shape == rows.gap.shape, pairing,
             f"the number of conditions changes if surface {surface.tag} moves by {STEP:g}: allow for that")  # fmt: skip
    motion = np.zeros((rows.matrix.shape[1] // 2, 2))
    motion[surface.nodes] = normal
    found, expected = (ends[1] - ends[0]) / (2 * STEP), -(rows.matrix @ motion.ravel())
    worst = int(np.abs(found - expected).argmax())
    _require(abs(found - expected)[worst] <= OF_FUNCTIONS, pairing,
             f"gap {worst} grows by {found[worst]:.6g} per unit that surface {surface.tag} moves outward, and its row "
             f"says {expected[worst]:.6g}: make them of one condition, B u <= gap")  # fmt: skip


def check_law(law: Any, *, young: float = 200.0, poisson: float = 0.3, strain: float = 0.02, dt: float = 0.1) -> None:
    """Check a law of an inelastic body, for moduli, strains and a time step at which it flows.

    Flow dissipates and does not reverse the stress, 0 <= 3 mu dp <= q, along random paths. Its slope is its derivative
    and lies in 0 to 1 / (3 mu). Arrays are answered as single points. Without stress nothing flows. A law that declares
    ``rated = False`` does not depend on dt and returns to its surface or below, where nothing flows further. A copy
    from a file answers with the same bits.
    """
    law, random = _made(law), np.random.default_rng(0)
    mu = lame_parameters(young, poisson)[1]
    with _blamed(law, "a step along a random path"):
        material = Material([Group(np.arange(60), young, poisson, law)], 4)
        state, path = material.at_rest(), np.zeros((60, 4))
        for _ in range(8):
            path = path + strain / 4 * random.standard_normal(path.shape)
            state = material.update(path, state, dt, tangent=False).state  # refuses flow that does not dissipate
        _require(state.cumulated.any(), law, f"it does not flow under strains of {strain:g} and young = {young:g}: "
                 "give check_law both in its units, so that it flows")  # fmt: skip
        trial, old = 2 * mu * strain * 10 ** random.uniform(-1, 0.5, 60), state.cumulated
        for array in (trial, old):
            array.setflags(write=False)
        amount, slope = flow_of(law, trial, old, mu, dt)
        alone = np.hstack([flow_of(law, trial[k : k + 1], old[k : k + 1], mu, dt) for k in range(60)])
        _require(np.allclose(alone, (amount, slope), rtol=1e-12, atol=0), law,
                 "its flow at one point depends on other points: compute each entry of the arrays by itself")  # fmt: skip
        idle = flow_of(law, np.zeros(60), old, mu, dt)[0]
        _require(not idle.any(), law, "it flows without stress: return 0 where the trial stress is 0")
        _check_slopes(law, trial, old, mu, dt)
        if not getattr(law, "rated", True):
            _require(np.array_equal(amount, flow_of(law, trial, old, mu, 7 * dt)[0]), law,
                     "it declares rated = False and depends on dt: leave that declaration out")  # fmt: skip
            further = flow_of(law, trial - 3 * mu * amount, old + amount, mu, dt)[0]
            _require((3 * mu * further <= ROUND_OFF * trial).all(), law, "its stress ends above its surface, and "
                     "flows further in a second return: solve for the surface at the end of the step")  # fmt: skip
    with _blamed(law, "a file of it"):
        kept = flow_of(_from_file(law), trial, old, mu, dt)
    _require(np.array_equal(kept, (amount, slope)), law, OTHERWISE)


def _check_slopes(law: Any, trial: np.ndarray, old: np.ndarray, mu: float, dt: float) -> None:
    """Compare slopes with differences where both ends flow, or none does."""
    slope = flow_of(law, trial, old, mu, dt)[1]
    low, high = (flow_of(law, trial * (1 + step), old, mu, dt)[0] for step in (-STEP, STEP))
    found = (high - low) / (2 * STEP * trial)
    wrong = np.where((low > 0) == (high > 0), np.abs(slope - found), 0.0)
    worst = int(wrong.argmax())
    _require(wrong[worst] <= OF_FUNCTIONS * np.abs(found).max(), law,
             f"its slope is {slope[worst]:.6g} at the trial stress {trial[worst]:.6g}, and differences give "
             f"{found[worst]:.6g}: return the derivative of the flow by the trial stress")  # fmt: skip
    _require(slope.min() >= 0 and 3 * mu * slope.max() <= 1 + ROUND_OFF, law,
             "its slope is outside 0 to 1 / (3 mu), so that stress falls as strain grows: leave softening out")  # fmt: skip


def check_load(load: Any, parameters: Bounds | None = None) -> None:
    """Check a load on tags of the blocks.

    Columns and amplitudes fit each other. There is a force somewhere in the box, whose sum on two meshes is the same to
    a hundredth. Derivatives of amplitudes agree with differences, and amplitudes survive a file.
    """
    load, sums = _made(load), []
    with _blamed(load, "its terms"):
        for cells in (4, 8):
            scene = pressed_blocks(parameters, cells=cells, loads=(load,))
            terms = [term for part in parted(Discretisation(scene).load_terms()) for term in part]
            amplitudes = Amplitudes.collect([term.amplitude for term in terms], scene.parameters)
            points = scene.parameters.random(6, 0)
            columns = hstack([term.columns for term in terms]).tocsc()
            forces = np.stack([columns @ _dense(amplitudes, point)[1:] for point in points])
            sums.append(forces.reshape(len(points), -1, 2).sum(axis=1))
    size = np.abs(forces).sum(axis=1).max()
    _require(size > 0, load, "it has no force anywhere in the box: check tag, direction and amplitude")
    _require(np.abs(sums[1] - sums[0]).max() <= 0.01 * size, load, f"its forces sum up to {sums[0][0]} on one mesh and "
             f"to {sums[1][0]} on a finer one: integrate a density, do not give each node a force")  # fmt: skip
    for point in points:
        acting, found = amplitudes.slopes_at(point)
        slopes = np.zeros((amplitudes.firsts[-1], point.size))
        slopes[acting] = found
        expected = scene.parameters.differences(lambda moved: _dense(amplitudes, moved), point, STEP)
        _require(_near(slopes, expected, OF_FUNCTIONS), load,
                 "`derivative` of its amplitude is not what differences give: correct it, or leave it out")  # fmt: skip
    for amplitude in amplitudes.nonaffine:
        with _blamed(load, "a file of its amplitude"):
            kept = _from_file(amplitude)
        same = all(np.array_equal(kept(point), amplitude(point)) for point in points)
        _require(same, load, OTHERWISE)


def check_output(output: Any, parameters: Bounds | None = None) -> None:
    """Check an output of contact 0 or of the blocks.

    Its functional has its name and unit. Its value is finite, depends on the point, and is that of a condensed model
    too, before and after a file. Derivatives, if it has any, agree with differences.
    """
    output = _made(output)

    def value(model: Any, point: np.ndarray) -> float:
        return model.outputs(point)[output.name]

    with _blamed(output, "its value or slopes"):
        full = FullOrderModel(pressed_blocks(parameters, outputs=(output,)))
        (item,) = full.functionals.items
        _require((item.name, item.unit) == (output.name, output.unit), output, f"its functional is '{item.name}' in "
                 f"'{item.unit}', not '{output.name}' in '{output.unit}': hand name and unit on")  # fmt: skip
        points = full.parameters.random(5, 0)
        values = [value(full, point) for point in points]
        _require(np.isfinite(values).all() and np.ptp(values) > 0, output,
                 f"its values at five points are {values}: return a finite number that depends on the answer")  # fmt: skip
        condensed = exact_condensation(full, compute_snapshots(full, points).known_statuses())
        found = [value(condensed, point) for point in points]
        _require(_near(found, values, ROUND_OFF), output, "a condensed model has other values than the full one: "
                 "declare `uses_forces` and all rows, and read nothing else")  # fmt: skip
        for point in points if item.differentiable else ():
            answer = full.outputs(point, gradient=True)
            slopes = full.parameters.differences(lambda moved: np.array([value(full, moved)]), point, STEP)[0]
            right = answer.one_sided or _near(answer.gradient[output.name], slopes, OF_ANSWERS)  # kinks have two slopes
            _require(right, output, f"its derivatives along the parameters are {answer.gradient[output.name]}, and "
                     f"differences give {slopes}: correct `slopes`")  # fmt: skip
    with _blamed(output, "a file of a model with it"):
        kept = _saved(condensed, _classes(item))
        _require([value(kept, point) for point in points] == found, output, OTHERWISE)


def check_system(system: Callable[..., Any], parameters: Bounds | None = None) -> None:
    """Check what makes a System of the blocks, ``Scene(system=...)``.

    S is symmetric and that of K. Equations of a point do not depend on points before. ``explicit`` agrees with
    differences of ``equations``. ``parts()`` add up to K, or are None: reductions then refuse the system by name.
    """
    with _blamed(system, "its equations"):
        full = FullOrderModel(pressed_blocks(parameters, system=system))
        points, random = full.parameters.random(4, 0), np.random.default_rng(0)
        forces, tried = random.standard_normal(full.conditions), random.standard_normal(full.problem.free.size)
        tried *= full.problem.free
        for point in points:
            at = full.system.at(point)
            schur, solved = at.stiffness.schur, at.stiffness.solve(tried)
            own = at.problem.contact @ at.stiffness.response_to_forces(np.eye(len(schur)))
            _require(_near(schur, schur.T, ROUND_OFF) and _near(own, schur, ROUND_OFF), system,
                     "S = B K^-1 B^T is not symmetric or not that of its K: make K by `made`, symmetric")  # fmt: skip
            _check_explicit(system, full, point, forces)  # asks for other points
            again = full.system.at(point)
            same = np.array_equal(at.loads, again.loads) and np.array_equal(solved, again.stiffness.solve(tried))
            _require(same, system, "a point has other equations after another one: make new arrays for each point")
            if (parts := full.system.parts()) is not None:
                weights = [modulus.value(point) for modulus in parts[0]] or [1.0]
                product = sum(weight * (part @ tried) for weight, part in zip(weights, parts[1], strict=True))
                _require(_near(at.stiffness.solve(product * full.problem.free), tried, ROUND_OFF), system,
                         "parts() with their weights do not add up to K: return all of them, or None")  # fmt: skip
    for reduced in (condense, lambda full: build(full, compute_snapshots(full, points))) if parts is None else ():
        try:
            reduced(full)
        except NotOfferedError:
            continue
        _require(False, system, "it has no parts() and is reduced all the same: leave `problem` as it is given")


def _check_explicit(system: Any, full: Any, point: np.ndarray, forces: np.ndarray) -> None:
    """Compare derivatives of displacement and slack at fixed forces with differences."""

    def solved(moved: np.ndarray) -> np.ndarray:
        at = full.system.at(moved)
        unknown = at.stiffness.solve(at.loads) - at.stiffness.response_to_forces(forces)
        return np.append(unknown, at.gaps - at.problem.contact @ unknown)

    expected = full.parameters.differences(solved, point, STEP)
    at, unknown = full.system.at(point), solved(point)[: full.problem.free.size]
    left, slack = full.system.explicit(point, forces, unknown)
    changes = np.stack([at.stiffness.solve(-column) for column in left.T], axis=1)
    found = np.vstack([changes, slack - at.problem.contact @ changes])
    for place, name in enumerate(full.parameters.names):
        _require(_near(found[:, place], expected[:, place], OF_ANSWERS), system, "`explicit` is not the derivative of "
                 f"`equations` along '{name}': differentiate all that depends on it there")  # fmt: skip


def check_reductor(reductor: Any, known: Iterable[type] = (), *, tolerance: float = 0.05) -> None:
    """Check a way to reduce, on blocks of constant stiffness and on blocks whose modulus is a parameter.

    Its model agrees with full answers that were held out: to round-off if it calls itself exact, within its bounds if it
    has any. Gradients agree with differences. From a file it answers with the same bits. It may refuse files, gradients
    and the varying modulus, with an error of the package.

    Args:
        reductor: the object with ``reduced``.
        known: your classes that its files hold, see :func:`hhr_dolfinx.load_model`.
        tolerance: relative error of forces and displacement that you promise if it is not exact.
    """
    reductor = _made(reductor)
    bodies = Body(LOWER_BODY, "young", 0.3), Body(UPPER_BODY, 5.0, 0.3)
    for scene in (pressed_blocks(), pressed_blocks({"young": (1.0, 4.0)}, bodies=bodies)):
        full = FullOrderModel(scene)
        sets = [compute_snapshots(full, full.parameters.random(count, seed)) for count, seed in ((24, 0), (4, 1))]
        with _blamed(reductor, "its model"):
            try:
                model = build(full, sets[0], reductor, sets[1])
            except HHRError:
                if full.problem.varies:
                    continue  # refused by name
                raise
            _check_answers(reductor, full, model, tolerance)
            _check_gradient(reductor, model)
        with _blamed(reductor, "a file of its model"):
            try:
                kept = _saved(model, known)
            except NotOfferedError:
                continue
            pairs = [[one.solve(point, outside="ignore") for one in (model, kept)] for point in sets[1].points]
        same = all(np.array_equal(getattr(one, name), getattr(other, name))
                   for one, other in pairs for name in ("multipliers", "unknown"))  # fmt: skip
        _require(same, reductor, OTHERWISE)


def _check_answers(reductor: Any, full: Any, model: Any, tolerance: float) -> None:
    """Compare answers and bounds at points of the box that were not trained on."""
    pairs = [(full.solve(point), model.solve(point, outside="ignore")) for point in full.parameters.random(8, 1)]
    forces, fields = ([[getattr(one, name)() for one in pair] for pair in pairs] for name in ("forces", "displacement"))
    sizes = [max(np.linalg.norm(there) for there, _ in every) for every in (forces, fields)]
    limit = ROUND_OFF if model.fields.exact else tolerance
    claim = "calls itself exact" if model.fields.exact else f"promises {tolerance:g}"
    for (there, here), *both in zip(pairs, forces, fields, strict=True):
        off = [found - exact for exact, found in both]
        error = max(np.linalg.norm(part) / size for part, size in zip(off, sizes, strict=True))
        place = full.parameters.described(there.parameter)
        _require(error <= limit, reductor, f"its model {claim} and is off by {error:.3g} at {place}: claim less, or "
                 "refuse the scene")  # fmt: skip
        if (bound := here.estimate()) is not None and bound.kind == "bound":
            energy = np.sqrt(max(off[1] @ (full.problem.at(there.parameter).stiffness @ off[1]), 0.0))
            slack = ROUND_OFF * sizes[0]
            held = np.linalg.norm(off[0]) <= bound.forces_euclid + slack and energy <= bound.primal + slack
            _require(held, reductor, f"its error at {place} is larger than its bound: call that an estimate")


def _check_gradient(reductor: Any, model: Any) -> None:
    """Compare derivatives of the forces of a model with differences."""
    for point in model.parameters.random(3, 1):
        try:
            answer = model.solve(point, gradient=True, outside="ignore")
        except NotOfferedError:
            return
        expected = model.parameters.differences(lambda at: model.solve(at, outside="ignore").multipliers, point, STEP)
        _require(answer.gradient.one_sided or _near(answer.gradient.multipliers, expected, OF_ANSWERS), reductor,
                 "the gradient of its forces is not what differences give: correct it, or refuse gradients")  # fmt: skip


OTHERWISE = "it answers otherwise when it comes from a file: keep all that it needs in its fields"


def _require(fits: Any, part: Any, wrong: str) -> None:
    if not fits:
        raise ConformanceError(f"{_name(part)}: {wrong}")


def _name(part: Any) -> str:
    return getattr(part, "__name__", type(part).__name__)


@contextmanager
def _blamed(part: Any, what: str) -> Iterator[None]:
    """Name the part if its code, or a check of the package on it, raises anything."""
    try:
        yield
    except ConformanceError:
        raise
    except Exception as error:  # code of anybody
        raise ConformanceError(f"{_name(part)}: {what} raised {type(error).__name__}: {error}") from error


def _made(part: Any) -> Any:
    return part() if isinstance(part, FunctionType) else part


def _near(found: Any, expected: Any, tolerance: float) -> bool:
    """True if arrays agree relative to the largest entry."""
    return bool(np.abs(np.subtract(found, expected)).max() <= tolerance * np.abs(expected).max() + 1e-14)


def _dense(amplitudes: Amplitudes, point: np.ndarray) -> np.ndarray:
    theta, values = amplitudes(point), np.zeros(amplitudes.firsts[-1])
    values[theta.terms] = theta.values
    return values


def _classes(value: Any) -> set[type]:
    """Classes of a dataclass and of all in it."""
    if isinstance(value, tuple):
        return set().union(*map(_classes, value))
    inner = [_classes(getattr(value, item.name)) for item in fields(value)] if is_dataclass(value) else []
    return {type(value)}.union(*inner) if inner else set()


def _from_file(value: Any) -> Any:
    """The value as a file would restore it."""
    tree, arrays = as_plain(value)
    return restored(json.loads(json.dumps(tree)), arrays, by_name(_classes(value)))


def _saved(model: Any, known: Iterable[type]) -> Any:
    """The model as its file restores it."""
    with TemporaryDirectory() as folder:
        save_model(Path(folder) / "model.npz", model)
        return load_model(Path(folder) / "model.npz", list(known))
