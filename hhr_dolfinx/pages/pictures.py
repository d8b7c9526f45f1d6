"""The displacement that a page draws: few modes of answers over the box, and how parameters and forces make them."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Iterable
from contextlib import suppress
from typing import Any

import numpy as np

from hhr_dolfinx.errors import ConvergenceError, FarSlidingWarning
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.displacement import dense
from hhr_dolfinx.models.eliminations.interpolated import InterpolatedFields
from hhr_dolfinx.models.exact import ExactFields
from hhr_dolfinx.pages.packing import FIELD, Packed, modes_of, steps_of
from hhr_dolfinx.pages.scenery import Scenery
from hhr_dolfinx.sampling import Sobol

SEEN = 200
FEW = 40
"""Answers that these modes are made of; loaded in proportion, where a path does not settle."""
FITTED = 512
FORCE_MODES = 20
DEGREE = 6
OFF = 0.03
"""Points to which the picture of a varying model is fitted, modes of forces, highest degree, and how far off it may be
at half of the points by a fit to the other half."""


def field_of(model: Any, scenery: Scenery, arrays: Packed) -> dict[str, Any]:
    """The displacement of the nodes that are drawn, in few modes; none where a model has no map of forces to it."""
    fields = model.fields
    if model.equilibrium is not None:
        from hhr_dolfinx.pages.flowing import flow_field

        return {"field": flow_field(model, scenery, rows_of(model, scenery), arrays)}
    if isinstance(fields, ExactFields) and not fields.floats:
        return {"field": _exact_field(model, scenery, arrays)}
    # with friction a fit would take as many paths as points
    if isinstance(fields, InterpolatedFields) and fields.galerkin is not None and model.friction is None:
        return {"field": fitted_field(model, scenery, arrays)}
    return {"field": None}


def rows_of(model: Any, scenery: Scenery) -> np.ndarray:
    """Dofs of the nodes that are drawn, node by node."""
    dim = model.dimension
    return (scenery.nodes[:, None] * dim + np.arange(dim)).ravel()


def _exact_field(model: Any, scenery: Scenery, arrays: Packed) -> dict[str, Any] | None:
    """Where the stiffness is constant: c = W^T (C θ - K^-1 B^T λ) with modes W of answers over the box."""
    fields = model.fields
    rows = rows_of(model, scenery)
    seen = np.array([answer.displacement()[rows] for answer in _seen(model) if answer.converged]).T
    if not seen.any():
        return None
    ways, tree = modes_of(seen, arrays)
    of_terms = ways.T @ (fields.per_term[rows] + dense(fields.lifts.tocsr()[rows]))
    own = {"terms": arrays.put("field_terms", of_terms, "<f4")}
    own |= {"forces": arrays.put("field_forces", -(ways.T @ fields.per_force[rows]), "<f4")}
    return {"kind": "linear"} | tree | own


def _seen(model: Any) -> Iterable[Answer]:
    """Answers over the box; with friction those along a path through it, whose laws are those of its middle."""
    points = model.parameters.random(SEEN, 0)
    if model.friction is None:
        return model.solve_many(points, raise_on_failure=False)
    points[:, model.friction.fixed] = model.parameters.middle[model.friction.fixed]
    with warnings.catch_warnings(), suppress(ConvergenceError):
        # nobody has asked for this path
        warnings.simplefilter("ignore", FarSlidingWarning)
        return model.march(list(enumerate(points))).answers
    return model.solve_many(points[:FEW], raise_on_failure=False)


def fitted_field(model: Any, scenery: Scenery, arrays: Packed) -> dict[str, Any] | None:
    """Where it varies: c = p(μ) + P(μ) Q^T λ, with modes Q of forces and polynomials that are fitted to some points.

    None where the fit is off by more than a picture may be at points that it has not seen, as where a load ends within
    the box.
    """
    fields = model.fields
    space = model.parameters
    rows = rows_of(model, scenery)
    answers = model.solve_many(Sobol(FITTED).points(space), raise_on_failure=False)
    known = [answer for answer in answers if answer.converged]
    seen = np.array([answer.displacement()[rows] for answer in known]).T
    if len(known) < FITTED // 2 or not seen.any():
        return None
    ways, tree = modes_of(seen, arrays)
    forces = np.array([answer.multipliers for answer in known]).T
    pushes, sizes, _ = np.linalg.svd(forces, full_matrices=False)
    pushes = pushes[:, : min(FORCE_MODES, max(1, int((sizes > FIELD * sizes[0]).sum())))]
    basis = ways.T @ fields.basis[rows]
    lifts = ways.T @ dense(fields.lifts.tocsr()[rows])
    values = []
    for answer in known:
        contact = fields.galerkin(answer.parameter)
        free = basis @ contact.unknown(np.zeros(model.conditions)) + lifts @ fields.amplitudes(answer.parameter)
        values.append(np.column_stack([free, -basis @ contact.pushed(pushes)]))
    points = np.array([answer.parameter for answer in known])
    powers = _powers(points.shape[1], len(known) // 3)
    scaled, axes = _scaled(model, points)
    features = np.prod(scaled[:, None, :] ** powers, axis=2)
    train = slice(0, None, 2)
    flat = np.reshape(values, (len(known), -1))
    fitted = features @ np.linalg.lstsq(features[train], flat[train], rcond=None)[0]
    along = fitted.reshape(len(known), *values[0].shape)
    weights = np.column_stack([np.ones(len(known)), forces.T @ pushes])
    found = np.einsum("skr,sr->ks", along, weights)
    off = np.linalg.norm(ways @ found - seen, axis=0)[1::2] / np.linalg.norm(seen, axis=0)[1::2]
    if np.median(off) > OFF:
        return None
    whole = np.linalg.lstsq(features, flat, rcond=None)[0].reshape(len(powers), *values[0].shape)
    own = {"axes": axes, "powers": powers.tolist(), "pushes": arrays.put("field_pushes", pushes.T, "<f4")}
    return {"kind": "fitted"} | tree | own | {"fit": arrays.put("field_fit", whole, "<f4")}


def _powers(parameters: int, most: int) -> np.ndarray:
    """Exponents of all monomials up to the highest degree of which there are no more than so many, (F, P)."""
    found = np.zeros((1, parameters), dtype=int)
    for degree in range(1, DEGREE + 1):
        every = itertools.combinations_with_replacement(range(parameters), degree)
        more = np.array([np.bincount(places, minlength=parameters) for places in every])
        if len(found) + len(more) > most:
            break
        found = np.vstack([found, more])
    return found


def _scaled(model: Any, points: np.ndarray) -> tuple[np.ndarray, list[dict[str, Any]]]:
    """What monomials are of, about -1 to 1 at some points, (S, P), and how a page makes it of a point.

    Of a parameter that alone makes the modulus of a component its compliance, 1 over the modulus, in which answers are
    nearly linear; of others themselves.
    """
    factors = [part.factor for part in model.eliminated.parts if part.factor is not None]
    alone = {factor.formula.variables[0]: factor for factor in factors if len(factor.formula.variables) == 1}
    columns = []
    axes: list[dict[str, Any]] = []
    for place, name in enumerate(model.parameters.names):
        factor = alone.get(name)
        column = points[:, place] if factor is None else 1 / factor.values(points)
        low = float(column.min())
        high = float(column.max())
        axes.append({"modulus": steps_of(factor), "low": low, "high": high})
        columns.append(2 * (column - low) / (high - low) - 1)
    return np.column_stack(columns), axes
