"""What a page holds of a model: numbers by name, and a tree of plain values that says what they are.

A page answers by

    S(μ) = sum_c s_c(μ) sum_k h_k(μ) S_ck,  g(μ) = D(μ) θ(μ) - free motions,  λ >= 0,  g + S λ >= 0,  λ·(g + S λ) = 0

of which a constant stiffness is the case of one term, see :mod:`hhr_dolfinx.models.eliminations.interpolated`. Formulas
of parameters go as lists of operations, which a page works off: nothing in it is executed that came out of a model.
"""

from __future__ import annotations

import ast
import base64
import itertools
import warnings
from collections.abc import Iterable
from contextlib import suppress
from typing import Any

import numpy as np

from hhr_dolfinx.amplitudes import Amplitudes, Coverage
from hhr_dolfinx.contact.friction import Friction
from hhr_dolfinx.errors import ConvergenceError, FarSlidingWarning, NotOfferedError
from hhr_dolfinx.formulas import FUNCTIONS, Scalar
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.condensed import CondensedModel
from hhr_dolfinx.models.displacement import dense
from hhr_dolfinx.models.eliminations.constant import ConstantElimination
from hhr_dolfinx.models.eliminations.interpolated import Compliance, Compliances, InterpolatedFields
from hhr_dolfinx.models.eliminations.interpolation import Interpolant, leja_points
from hhr_dolfinx.models.exact import ExactFields
from hhr_dolfinx.models.functionals.kinds import LOADED, Largest, Linear, Loaded
from hhr_dolfinx.pages.scenery import Scenery
from hhr_dolfinx.sampling import Sobol

FIELD = 1e-3
FIELD_NUMBERS = 500_000
"""Part of the displacements that modes of the picture leave out: a picture shows no more. Most numbers of the modes."""
SEEN = 200
FEW = 40
"""Answers that these modes are made of; loaded in proportion, where a path does not settle."""
FITTED = 512
FORCE_MODES = 20
DEGREE = 6
OFF = 0.03
"""Points to which the picture of a varying model is fitted, modes of forces, highest degree, and how far off it may be
at half of the points by a fit to the other half."""
FLAT = 0.3
"""Part of its width that a contact may rise by to be drawn from above."""
LEVELS = 32767
"""Numbers of a mode of the picture lie on so many levels to either side."""
_OPERATIONS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "^"}


class Packed:
    """Arrays of a model by name, in the kinds of numbers that are kept of them.

    Attributes:
        arrays: little-endian, contiguous.
        kinds: of their numbers, such as ``<f8``.
    """

    def __init__(self) -> None:
        self.arrays: dict[str, np.ndarray] = {}
        self.kinds: dict[str, str] = {}

    def put(self, name: str, array: Any, kind: str = "<f8") -> str:
        """Take an array in; returns its name."""
        self.arrays[name] = np.ascontiguousarray(array, dtype=kind)
        self.kinds[name] = kind
        return name

    def texts(self) -> dict[str, dict[str, Any]]:
        """The same as text, base64."""
        return {
            name: {
                "kind": self.kinds[name],
                "shape": list(array.shape),
                "data": base64.b64encode(array.tobytes()).decode(),
            }
            for name, array in self.arrays.items()
        }


def check_model(model: Any, what: str = "a page", *, rubs: bool = True) -> None:
    """Raise NotOfferedError for a model that ``what``, which may know friction, is not built for; says what to take."""
    if not isinstance(model, CondensedModel) or not isinstance(model.eliminated, ConstantElimination | Compliances):
        raise NotOfferedError(
            f"{what} answers by all contact conditions of bodies that something holds, and {_kind(model)} is not of "
            "that kind: condense the scene, hhr.condense(scene) or hhr train SCENE --model condensed"
        )
    if model.friction is not None and not rubs:
        raise NotOfferedError(f"{what} knows no friction: its increments are solved in Python, and on pages")
    if model.friction is not None and np.bincount(model.friction.owner, minlength=1).max() > 1:
        raise NotOfferedError(f"{what} knows friction in the plane alone: in space its increments are solved in Python")
    if isinstance(model.eliminated, Compliances) and not model.eliminated.symmetric:
        raise NotOfferedError(f"{what} solves with a symmetric S, and that of this model is not")


def _kind(model: Any) -> str:
    eliminated = getattr(model, "eliminated", None)
    return f"a {type(model).__name__}" + ("" if eliminated is None else f" with {type(eliminated).__name__}")


def packed(model: Any, scenery: Scenery) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """A model that :func:`check_model` has passed as a tree and its arrays, with what a page draws of it.

    Raises:
        NotOfferedError: for an amplitude of a user's own.
    """
    arrays = Packed()
    tree = contact_tree(model, arrays) | _field(model, scenery, arrays)
    return tree, arrays.texts()


def contact_tree(model: Any, arrays: Packed) -> dict[str, Any]:
    """What answers for contact forces and outputs, without Python: a tree of plain values, its arrays by name.

    Raises:
        NotOfferedError: for an amplitude of a user's own.
    """
    space = model.parameters
    tree: dict[str, Any] = {
        "names": list(space.names),
        "lower": list(map(float, space.lower)),
        "upper": list(map(float, space.upper)),
        "amplitudes": _amplitudes(model.eliminated.amplitudes, arrays),
        "m": model.conditions,
        "groups": _groups(model, arrays),
        "friction": None if model.friction is None else _friction(model.friction, arrays),
    }
    tree |= _eliminated(model.eliminated, arrays)
    tree["outputs"], tree["missing"] = _outputs(model, arrays)
    tree["trained"] = None if model.trained is None else [model.trained.lower.tolist(), model.trained.upper.tolist()]
    return tree


def _groups(model: Any, arrays: Packed) -> str | None:
    """Contact of each condition, by which round-off is told from forces."""
    return None if model.pairs is None else arrays.put("groups", model.pairs, "<i4")


def _friction(friction: Friction, arrays: Packed) -> dict[str, Any]:
    """Rows of friction in the plane, and their laws."""
    tree: dict[str, Any] = {
        name: arrays.put(f"friction_{name}", getattr(friction, name), "<i4")
        for name in ("normal", "tangential", "owner", "law", "twice")
    }
    tree["area"] = arrays.put("friction_area", friction.area)
    tree["tangents"] = arrays.put("friction_tangents", friction.tangents)
    tree["fixed"] = friction.fixed.tolist()
    tree["laws"] = [[steps_of(law.coefficient), steps_of(law.limit)] for law in friction.laws]
    return tree


def _amplitudes(amplitudes: Amplitudes, arrays: Packed) -> dict[str, Any]:
    """θ: affine ones, and those that are not."""
    others = []
    for number, item in enumerate(amplitudes.nonaffine):
        if isinstance(item, Coverage):
            own = {"positions": arrays.put(f"positions{number}", item.positions), "extent": item.extent}
            own |= {"constant": item.constant, "slopes": item.slopes.tolist(), "degree": item.degree}
            others.append({"kind": "coverage", **own})
        elif isinstance(item, Scalar):
            others.append({"kind": "formula", "steps": steps_of(item)})
        else:
            raise NotOfferedError(f"a page knows no amplitude of kind {type(item).__name__}: it is one of your own")
    return {
        "constant": arrays.put("constant", amplitudes.constant),
        "slopes": arrays.put("slopes", amplitudes.slopes),
        "others": others,
    }


def steps_of(scalar: Scalar | None) -> list[Any] | None:
    """A formula as operations on a stack: numbers, ``["p", k]`` for parameter k, names of operators and functions."""
    if scalar is None:
        return None
    found: list[Any] = []

    def walk(node: ast.AST) -> None:
        if isinstance(node, ast.Constant):
            found.append(float(node.value))  # type: ignore[arg-type]
        elif isinstance(node, ast.Name):
            found.append(float(np.pi) if node.id == "pi" else ["p", scalar.names.index(node.id)])
        elif isinstance(node, ast.UnaryOp):
            walk(node.operand)
            if isinstance(node.op, ast.USub):
                found.append("neg")
        elif isinstance(node, ast.BinOp):
            walk(node.left)
            walk(node.right)
            found.append(_OPERATIONS[type(node.op)])
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            for argument in node.args:
                walk(argument)
            found.append(node.func.id if node.func.id in FUNCTIONS else ["table", len(node.args)])

    walk(ast.parse(scalar.text.strip(), mode="eval").body)
    return found


def _eliminated(eliminated: Any, arrays: Packed) -> dict[str, Any]:
    """S and the free slack."""
    if isinstance(eliminated, ConstantElimination):
        responses = eliminated.responses
        return {
            "schur": arrays.put("schur", _half(responses.schur)),
            "free_slack": arrays.put("free_slack", responses.free_slack),
            "parts": [],
        }
    parts = [_part(part, number, arrays) for number, part in enumerate(eliminated.parts)]
    reshaped = None if eliminated.reshaped is None else _interpolant(eliminated.reshaped, "gaps", arrays)
    return {
        "schur": None, "free_slack": None, "parts": parts,
        "gaps": arrays.put("gaps", eliminated.gaps), "reshaped": reshaped,
    }  # fmt: skip


def _half(matrix: np.ndarray) -> np.ndarray:
    """Lower half by rows of a matrix that is symmetric to round-off, (m (m + 1) / 2,)."""
    return ((matrix + matrix.T) / 2)[np.tril_indices(len(matrix))]


def _part(part: Compliance, number: int, arrays: Packed) -> dict[str, Any]:
    """A connected component."""
    m = part.conditions.size
    modes = part.interpolant.modes.T.reshape(-1, m, m)
    half = np.array([_half(mode) for mode in modes])
    tree = _interpolant(part.interpolant, f"part{number}_", arrays, modes=half)
    return tree | {
        "conditions": arrays.put(f"part{number}_conditions", part.conditions, "<i4"),
        "terms": arrays.put(f"part{number}_terms", part.terms, "<i4"),
        "forced": int(part.forced.size),
        "factor": steps_of(part.factor),
        "columns": arrays.put(f"part{number}_columns", part.columns),
    }


def _interpolant(found: Interpolant, name: str, arrays: Packed, modes: np.ndarray | None = None) -> dict[str, Any]:
    """A polynomial on a sparse grid; its modes one behind another."""
    top = int(found.levels.max(initial=0))
    return {
        "axes": found.axes.tolist(), "lower": found.lower.tolist(), "upper": found.upper.tolist(),
        "nodes": list(leja_points()[: top + 1]),
        "levels": arrays.put(f"{name}levels", found.levels, "<i4"),
        "weights": arrays.put(f"{name}weights", found.weights),
        "modes": arrays.put(f"{name}modes", found.modes.T if modes is None else modes),
    }  # fmt: skip


def _outputs(model: Any, arrays: Packed) -> tuple[list[dict[str, Any]], list[str]]:
    """Outputs that a page reads, and the names of those that it does not."""
    fields = model.fields
    items = () if fields.functionals is None else fields.functionals.items
    found = []
    missing = []
    for number, item in enumerate(items):
        if not _is_read(fields, item):
            missing.append(item.name)
            continue
        own = _linear(model, item, number, arrays) if isinstance(item, Linear) else _of_forces(item, number, arrays)
        found.append({"name": item.name, "unit": item.unit} | own)
    return found, missing


def _is_read(fields: Any, item: Any) -> bool:
    """Whether a page reads an output: of forces on a shape that stays, or of a displacement that forces alone make."""
    if np.size(fields.functionals.axes) or not isinstance(item, Linear | Largest | Loaded):
        return False
    return not item.count or isinstance(fields, ExactFields)


def _linear(model: Any, item: Linear, number: int, arrays: Packed) -> dict[str, Any]:
    """An output as weights of forces and amplitudes: those of displacements are among them."""
    fields = model.fields
    of_forces = np.zeros(model.conditions)
    np.add.at(of_forces, item.conditions, item.weights)
    of_terms = np.zeros(model.eliminated.amplitudes.firsts[-1])
    np.add.at(of_terms, item.terms, item.coefficients)
    if item.count:
        rows = item.matrix(fields.functionals.size)
        of_forces -= item.along @ (rows @ fields.per_force)
        of_terms += item.along @ (rows @ fields.per_term + dense(rows @ fields.lifts))
    own = {"forces": arrays.put(f"output{number}_forces", of_forces)}
    return {"kind": "linear", **own, "terms": arrays.put(f"output{number}_terms", of_terms)}


def _of_forces(item: Largest | Loaded, number: int, arrays: Packed) -> dict[str, Any]:
    """The largest pressure, or an area under load."""
    own = {"conditions": arrays.put(f"output{number}_conditions", item.conditions, "<i4")}
    own |= {"areas": arrays.put(f"output{number}_areas", item.areas)}
    if isinstance(item, Largest):
        return {"kind": "largest"} | own
    return {"kind": "loaded", "offset": item.offset, "factor": item.factor, "least": LOADED} | own


def _field(model: Any, scenery: Scenery, arrays: Packed) -> dict[str, Any]:
    """The displacement of the nodes that are drawn, in few modes; none where a model has no map of forces to it."""
    fields = model.fields
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


def _modes(seen: np.ndarray, arrays: Packed) -> tuple[np.ndarray, dict[str, Any]]:
    """Modes of displacements, (n, S), and what a page holds of them: whole numbers and scales."""
    ways, sizes, _ = np.linalg.svd(seen, full_matrices=False)
    left = np.sqrt(np.cumsum(sizes[::-1] ** 2)[::-1])
    count = min(int((left > FIELD * left[0]).sum()), FIELD_NUMBERS // len(seen))
    ways = ways[:, : max(1, count)]
    largest = np.abs(ways).max(axis=0)
    levels = np.round(ways / largest * LEVELS).astype(np.int16)
    return ways, {"modes": arrays.put("field_modes", levels.T, "<i2"), "scales": (largest / LEVELS).tolist()}


def _exact_field(model: Any, scenery: Scenery, arrays: Packed) -> dict[str, Any] | None:
    """Where the stiffness is constant: c = W^T (C θ - K^-1 B^T λ) with modes W of answers over the box."""
    fields = model.fields
    rows = rows_of(model, scenery)
    seen = np.array([answer.displacement()[rows] for answer in _seen(model) if answer.converged]).T
    if not seen.any():
        return None
    ways, tree = _modes(seen, arrays)
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
    ways, tree = _modes(seen, arrays)
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


def drawn(scenery: Scenery) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """A scenery as a tree and its arrays."""
    arrays = Packed()
    kind = "<u2" if len(scenery.points) < 2**16 else "<u4"
    tree = {
        "dim": scenery.points.shape[1],
        "points": arrays.put("points", scenery.points, "<f4"),
        "triangles": arrays.put("triangles", scenery.triangles, kind),
        "lines": arrays.put("lines", scenery.lines, kind),
        "contact_points": arrays.put("contact_points", scenery.contact_points),
        "areas": arrays.put("areas", scenery.areas),
        "pairs": arrays.put("pairs", scenery.pairs, "<i4"),
        "words": scenery.words,
        "moves": scenery.moves,
    }
    if scenery.points.shape[1] == 3:
        tree["flat"] = arrays.put("flat", _flat(scenery), "<f4")
    return tree, arrays.texts()


def _flat(scenery: Scenery) -> np.ndarray:
    """Places of contact along two axes where it hardly leaves their plane, else along its widest directions, (m, 2)."""
    found = np.zeros((len(scenery.areas), 2))
    for pair in np.unique(scenery.pairs):
        own = scenery.pairs == pair
        places = scenery.contact_points[own] - scenery.contact_points[own].mean(axis=0)
        widths = np.ptp(places, axis=0)
        if widths.min() < FLAT * widths.max():
            found[own] = np.delete(places, widths.argmin(), axis=1)
            continue
        ways = np.linalg.svd(places, full_matrices=False)[2][:2]
        # the largest component of each points upwards or to the right
        ways *= np.sign(ways[np.arange(len(ways)), np.abs(ways).argmax(axis=1)])[:, None]
        found[own, : len(ways)] = places @ ways.T
    return found
