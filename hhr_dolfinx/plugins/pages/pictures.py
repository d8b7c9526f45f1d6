"""Pictures of bodies on a page: few modes of answers over the box, and maps from parameters and
forces to them.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix, vstack

from hhr_dolfinx.errors import (
    ConvergenceError,
    FarSlidingWarning,
    NotSolvableError,
    UndeterminedWarning,
)
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.displacement import dense
from hhr_dolfinx.models.exact import ExactFields
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.plugins.pages.packing import (
    BASE64,
    FIELD,
    LEVELS,
    MODE_BYTES,
    Json,
    Packed,
    kept_levels,
    modes_of,
    packed_levels,
    steps_of,
)
from hhr_dolfinx.plugins.pages.scenery import Scenery
from hhr_dolfinx.plugins.pages.stress import (
    FALSE,
    HELD_OUT_STRIDE,
    STRESS_LEVELS,
    STRESS_MODES_ERROR,
    Stress,
)
from hhr_dolfinx.sampling import Sobol
from hhr_dolfinx.warn import ignored

if TYPE_CHECKING:
    from hhr_dolfinx.models.model import KeptModel

SEEN = 200
"""Answers from which these modes are computed."""
FEW = 40
"""Their number with proportional loading, if a path does not converge."""
MOST_CORNERS = 64
"""Most corners of the box among the points of these answers."""
FITTED = 512
FORCE_MODES = 20
DEGREE = 6
PATH_TRIES = 20
OFF = 0.03
"""Points to which the picture of a model with varying stiffness is fitted, modes of forces, highest
degree, and largest median error at half of the points of a fit to the other half; most paths of
bodies that friction holds.
"""


@dataclass(frozen=True, eq=False)
class Drawn:
    """Drawn quantity, linear in the displacement: name of its arrays, and its sparse matrix, (k,
    N).

    Its modes have a relative truncation error up to ``left``, quantisation levels on each side of
    zero, and at most ``room`` bytes; all arrays of a page have at most ``most``, None if they are
    limited elsewhere.
    """

    name: str
    rows: csr_matrix
    left: float = FIELD
    levels: int = LEVELS
    room: int = MODE_BYTES
    most: int | None = None

    def modes(self, seen: np.ndarray) -> np.ndarray | None:
        """Modes of answers, (k, S); None if they fit badly, see :func:`modes_of`."""
        return modes_of(
            seen, self.left, int(self.room / (BASE64 * (1 if self.levels < 128 else 2)))
        )


class Picture(NamedTuple):
    """Data of a drawn quantity for a page, drawn values of the held-out answers, (k, S), and their
    indices, (S,).
    """

    tree: dict[str, Json]
    values: np.ndarray
    apart: np.ndarray


class Split:
    """Partition of answers into those that modes are computed from, and held-out ones.

    The last answers are those at corners of the box, which are both.
    """

    def __init__(self, answers: Iterable[Answer], corners: int):
        all_answers = list(answers)
        first = len(all_answers) - corners
        self.answers = [answer for answer in all_answers if answer.converged]
        self._others = sum(answer.converged for answer in all_answers[:first])

    def held(self, every: int) -> tuple[np.ndarray, np.ndarray]:
        """Indices of answers for modes, and of held-out ones, which are one of ``every``."""
        count = len(self.answers)
        held = np.arange(every - 1, self._others, every)
        return np.delete(np.arange(count), held), np.append(held, np.arange(self._others, count))


def pictures_of(model: Any, scenery: Scenery, arrays: Packed, room: int) -> dict[str, Json]:
    """Displacement of the drawn nodes, and stress of the cells, in few modes.

    Their arrays are added.

    Neither for a model without a map from forces to displacements; no stress if the ``room`` for
    all arrays is used up.

    Args:
        model: condensed model.
        scenery: drawn mesh and contact of the scene.
        arrays: packed arrays, to which those of the tree are added.
        room: bytes for all arrays, as text.
    """
    if model.equilibrium is not None:
        from hhr_dolfinx.plugins.pages.flow_stress import flow_stress
        from hhr_dolfinx.plugins.pages.flowing import flow_field, walked

        histories = list(walked(model))
        displacement = flow_field(model, histories, scenery, rows_of(model, scenery), arrays)
        of_cells = displacement and flow_stress(model, scenery, histories, arrays, room)
        return {"field": displacement, "stress": of_cells}
    pictures: dict[str, Json] = {"field": None, "stress": None}
    split, maps = _answers(model)
    if not split.held(HELD_OUT_STRIDE)[1].size:
        return pictures
    rows = rows_of(model, scenery)
    entries = np.ones(rows.size), (np.arange(rows.size), rows)
    chosen = csr_matrix(entries, shape=(rows.size, model.fields.lifts.shape[0]))
    strains = scenery.strains
    stress = (
        None
        if strains is None
        else Stress(strains, model.parameters.names, model.parameters.middle)
    )
    rows_read = chosen if stress is None else csr_matrix(vstack([chosen, stress.rows]))
    seen = np.array(
        [rows_read @ answer.displacement() for answer in split.answers]
    ).T  # computes each displacement once
    field = maps(Drawn("field", chosen, most=room), split, seen[: rows.size], arrays)
    if field is None:
        return pictures
    pictures["field"] = field.tree
    if stress is not None:
        drawn = Drawn(
            "stress",
            stress.rows,
            STRESS_MODES_ERROR,
            STRESS_LEVELS,
            min(MODE_BYTES, room - arrays.size - stress.size),
        )
        pictures["stress"] = _stress(
            partial(maps, drawn, split), stress, split, seen[rows.size :], arrays
        )
    return pictures


def _answers(
    model: KeptModel,
) -> tuple[Split, Callable[[Drawn, Split, np.ndarray, Packed], Picture | None]]:
    """Answers for pictures, and the function that computes a picture.

    No answers for a model without maps of forces.
    """
    fields = model.fields
    if isinstance(fields, ExactFields) and model.law.remembers:
        return Split(_walked(model), 0), partial(_exact, model)
    count = len(model.parameters.names)
    ends = np.random.default_rng(0).integers(
        0, 2, (MOST_CORNERS, count)
    )  # a random choice if there are many corners
    if 2**count <= MOST_CORNERS:
        ends = np.arange(2**count)[:, None] >> np.arange(count) & 1
    corners = np.where(ends, model.parameters.upper, model.parameters.lower)
    if isinstance(fields, ExactFields):
        points = np.vstack([model.parameters.random(SEEN, 0), corners])
        return Split(model.solve_many(points, raise_on_failure=False), len(corners)), partial(
            _exact, model
        )
    if (
        getattr(fields, "galerkin", None) is not None
    ):  # S is interpolated, by a plug-in that may be missing
        # with friction each point is the end of a path, and maps are fitted elsewhere
        points = Sobol(FEW if model.law.remembers else FITTED).points(model.parameters)
        corners = corners[:0] if model.law.remembers else corners
        with ignored(FarSlidingWarning):  # a warning of these points does not concern the user
            answers = list(model.solve_many(np.vstack([points, corners]), raise_on_failure=False))
        return Split(answers, len(corners)), partial(_fitted, model)
    return Split([], 0), partial(_exact, model)


def _stress(
    maps: Callable[[np.ndarray, Packed], Picture | None],
    stress: Stress,
    known: Split,
    seen: np.ndarray,
    arrays: Packed,
) -> dict[str, Json] | None:
    """Stress of the cells and its error.

    None if the error of the largest value is too large, or without room.
    """
    tried = Packed()
    picture = maps(seen, tried)
    if picture is None:
        return None
    points = np.array([known.answers[index].parameter for index in picture.apart])
    off = stress.off(points, seen[:, picture.apart], picture.values)
    if off["largest"] > FALSE:
        return None
    picture_tree = picture.tree | stress.tree(tried) | {"off": off}
    arrays.take(tried)
    return picture_tree


def rows_of(model: KeptModel, scenery: Scenery) -> np.ndarray:
    """Dofs of the drawn nodes, node by node.

    Args:
        model: condensed model.
        scenery: drawn mesh and contact of the scene.
    """
    dim = model.dimension
    return (scenery.nodes[:, None] * dim + np.arange(dim)).ravel()


def _exact(
    model: Any, drawn: Drawn, known: Split, seen: np.ndarray, arrays: Packed
) -> Picture | None:
    """Picture for constant stiffness: c = W^T (C θ - K^-1 B^T λ + R q) with modes W of answers over
    the box.
    """
    fields = model.fields
    inner, apart = known.held(HELD_OUT_STRIDE)
    ways = drawn.modes(seen[:, inner])
    if ways is None:
        return None
    of_terms = ways.T @ (drawn.rows @ fields.per_term + dense(drawn.rows @ fields.lifts))
    tree = {"kind": "linear"} | packed_levels(f"{drawn.name}_modes", ways.T, arrays, drawn.levels)
    tree["terms"] = arrays.put(f"{drawn.name}_terms", of_terms, "<f4")
    tree["forces"] = arrays.put(
        f"{drawn.name}_forces", -(ways.T @ (drawn.rows @ fields.per_force)), "<f4"
    )
    if fields.floats:
        tree["motions"] = arrays.put(
            f"{drawn.name}_motions", ways.T @ (drawn.rows @ model.eliminated.modes), "<f4"
        )
    return Picture(tree, kept_levels(tree, arrays).T @ (ways.T @ seen[:, apart]), apart)


def _walked(model: KeptModel) -> Iterable[Answer]:
    """Answers with friction along a path through the box, with the laws at its middle."""
    points = model.parameters.random(SEEN, 0)
    points[:, model.law.fixed] = model.parameters.middle[model.law.fixed]
    # warnings of this path do not concern the user
    with ignored(FarSlidingWarning), ignored(UndeterminedWarning), suppress(ConvergenceError):
        return (
            _borne(model, points)
            if model.fields.floats
            else model.march(list(enumerate(points))).answers
        )
    return model.solve_many(points[:FEW], raise_on_failure=False)


def _borne(model: KeptModel, points: np.ndarray) -> list[Answer]:
    """Answers of bodies that contact alone holds, along paths that begin anew after loads that it
    does not bear.
    """
    answers: list[Answer] = []
    for _ in range(PATH_TRIES):
        try:
            return answers + model.march(list(enumerate(points)), MarchSettings(cuts=0)).answers
        except (ConvergenceError, NotSolvableError) as error:
            before: Any = error
            answers += before.history.answers
            points = points[len(before.history.answers) + 1 :]
        if len(points) < 2:
            break
    return answers


def _fitted(
    model: KeptModel, drawn: Drawn, known: Split, seen: np.ndarray, arrays: Packed
) -> Picture | None:
    """Picture for varying stiffness: c = p(μ) + P(μ) Q^T λ, with modes Q of forces and fitted
    polynomials p, P.

    None if the error of the fit at held-out points is too large, as for a load that ends within the
    box.
    """
    answers = known.answers
    alone = not model.law.remembers
    ways = drawn.modes(seen) if len(answers) >= (FITTED if alone else FEW) // 2 else None
    if ways is None:
        return None
    forces = np.array([answer.multipliers for answer in answers]).T
    pushes, sizes, _ = np.linalg.svd(forces, full_matrices=False)
    pushes = pushes[:, : min(FORCE_MODES, max(1, int((sizes > FIELD * sizes[0]).sum())))]
    queries = np.array([answer.parameter for answer in answers])
    points = queries if alone else Sobol(FITTED).points(model.parameters)
    values = _maps_at(model, drawn, ways, pushes, points)
    monomials = Monomials(model, points)
    features = monomials.at(points)
    flat = values.reshape(len(points), -1)
    # elastic: fit to one half, error at the other; with friction: fit to all points, error at the
    # answers
    inner, apart = known.held(2) if alone else (np.arange(len(points)), np.arange(len(answers)))
    fitted = monomials.at(queries) @ np.linalg.lstsq(features[inner], flat[inner], rcond=None)[0]
    along = fitted.reshape(len(answers), *values.shape[1:])
    weights = np.column_stack([np.ones(len(answers)), forces.T @ pushes])
    coefficients = np.einsum("skr,sr->ks", along, weights)[:, apart]
    tried = Packed()
    tree = {"kind": "fitted"} | packed_levels(f"{drawn.name}_modes", ways.T, tried, drawn.levels)
    approximated = kept_levels(tree, tried).T @ coefficients
    sizes = np.linalg.norm(seen[:, apart], axis=0)
    off = np.linalg.norm(approximated - seen[:, apart], axis=0)[sizes > 0] / sizes[sizes > 0]
    if np.median(off) > OFF:
        return None
    polynomials = np.linalg.lstsq(features, flat, rcond=None)[0].reshape(-1, *values.shape[1:])
    tree |= monomials.tree | {"pushes": tried.put(f"{drawn.name}_pushes", pushes.T, "<f4")}
    tree |= {"fit": tried.put(f"{drawn.name}_fit", polynomials, "<f4")}
    if drawn.most is not None and arrays.size + tried.size > drawn.most:
        return None
    arrays.take(tried)
    return Picture(tree, approximated, apart)


def _maps_at(
    model: KeptModel, drawn: Drawn, ways: np.ndarray, pushes: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """p(μ) and P(μ) at some points, (S, P): (S, k, 1 + R)."""
    fields = model.fields
    basis = ways.T @ (drawn.rows @ fields.basis)
    lifts = ways.T @ dense(drawn.rows @ fields.lifts)
    values = []
    for point in points:
        contact = fields.galerkin(point)
        free = basis @ contact.unknown(np.zeros(model.conditions)) + lifts @ fields.amplitudes(
            point
        )
        values.append(np.column_stack([free, -basis @ contact.response_to_forces(pushes)]))
    return np.array(values)


class Monomials:
    """Monomials of parameters scaled to [-1, 1] at some points, (S, P).

    At most a third as many as points.

    A modulus of one parameter replaces it by the compliance, in which answers are nearly linear.
    """

    def __init__(self, model: Any, points: np.ndarray):
        factors = [
            component.factor for component in model.eliminated.parts if component.factor is not None
        ]
        alone = {
            factor.formula.variables[0]: factor
            for factor in factors
            if len(factor.formula.variables) == 1
        }
        self._factors = [alone.get(name) for name in model.parameters.names]
        still = (
            np.ptp(self._columns(points), axis=0) == 0
        )  # a modulus that names a parameter but is constant
        self._factors = [
            None if constant else factor
            for constant, factor in zip(still, self._factors, strict=True)
        ]
        columns = self._columns(points)
        self._low = columns.min(axis=0)
        self._high = columns.max(axis=0)
        self._powers = _powers(points.shape[1], len(points) // 3)

    def _columns(self, points: np.ndarray) -> np.ndarray:
        pairs = zip(points.T, self._factors, strict=True)
        return np.column_stack(
            [values if factor is None else 1 / factor.values(points) for values, factor in pairs]
        )

    def at(self, points: np.ndarray) -> np.ndarray:
        """Monomials at other points, (S, P): (S, F)."""
        scaled = 2 * (self._columns(points) - self._low) / (self._high - self._low) - 1
        return np.prod(scaled[:, None, :] ** self._powers, axis=2)

    @property
    def tree(self) -> dict[str, Json]:
        """Data to evaluate the monomials on a page."""
        ends = zip(self._factors, self._low.tolist(), self._high.tolist(), strict=True)
        axes = [
            {"modulus": steps_of(factor), "low": low, "high": high} for factor, low, high in ends
        ]
        return {"axes": axes, "powers": self._powers.tolist()}


def _powers(parameters: int, most: int) -> np.ndarray:
    """Exponents of all monomials up to the highest degree with at most ``most`` of them, (F, P)."""
    powers = np.zeros((1, parameters), dtype=int)
    for degree in range(1, DEGREE + 1):
        products = itertools.combinations_with_replacement(range(parameters), degree)
        more = np.array([np.bincount(factors, minlength=parameters) for factors in products])
        if len(powers) + len(more) > most:
            break
        powers = np.vstack([powers, more])
    return powers
