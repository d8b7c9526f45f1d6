"""What a page holds of a model: numbers by name, and a tree of plain values that says what they are.

A page answers by

    S(μ) = sum_c s_c(μ) sum_k h_k(μ) S_ck,  g(μ) = D(μ) θ(μ) - free motions,  λ >= 0,  g + S λ >= 0,  λ·(g + S λ) = 0

of which a constant stiffness is the case of one term, see :mod:`hhr_dolfinx.models.eliminations.interpolated`. Formulas
of parameters go as lists of operations, which a page works off: nothing in it is executed that came out of a model.
"""

from __future__ import annotations

import ast
import base64
from typing import Any

import numpy as np

from hhr_dolfinx.amplitudes import Amplitudes, Coverage
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.formulas import FUNCTIONS, Scalar
from hhr_dolfinx.models.condensed import CondensedModel
from hhr_dolfinx.models.displacement import dense
from hhr_dolfinx.models.eliminations.constant import ConstantElimination
from hhr_dolfinx.models.eliminations.interpolated import Compliance, Compliances
from hhr_dolfinx.models.eliminations.interpolation import Interpolant, leja_points
from hhr_dolfinx.models.exact import ExactFields
from hhr_dolfinx.models.functionals.kinds import LOADED, Largest, Linear, Loaded
from hhr_dolfinx.pages.scenery import Scenery

FIELD = 1e-3
FIELD_NUMBERS = 500_000
"""Part of the displacements that modes of the picture leave out: a picture shows no more. Most numbers of the modes."""
SEEN = 200
"""Answers that these modes are made of."""
LEVELS = 32767
"""Numbers of a mode of the picture lie on so many levels to either side."""
_OPERATIONS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "^"}


class Packed:
    """Arrays of a page as text, and where each begins is not asked: they are decoded one by one.

    Attributes:
        texts: base64 of little-endian numbers, by name.
    """

    def __init__(self) -> None:
        self.texts: dict[str, dict[str, Any]] = {}

    def put(self, name: str, array: Any, kind: str = "<f8") -> str:
        """Take an array in; returns its name."""
        plain = np.ascontiguousarray(array, dtype=kind)
        self.texts[name] = {
            "kind": kind,
            "shape": list(plain.shape),
            "data": base64.b64encode(plain.tobytes()).decode(),
        }
        return name


def check_model(model: Any) -> None:
    """Raise NotOfferedError for a model that no page is built for, with what to take instead."""
    if not isinstance(model, CondensedModel) or not isinstance(model.eliminated, ConstantElimination | Compliances):
        raise NotOfferedError(
            f"a page answers by all contact conditions, and {_kind(model)} is not of that kind: condense the scene, "
            "hhr.condense(scene) or hhr train SCENE --model condensed"
        )
    if model.friction is not None:
        raise NotOfferedError("a page knows no friction yet: its increments are solved in Python alone")
    if isinstance(model.eliminated, Compliances) and not model.eliminated.symmetric:
        raise NotOfferedError("a page solves with a symmetric S, and that of this model is not")


def _kind(model: Any) -> str:
    eliminated = getattr(model, "eliminated", None)
    return f"a {type(model).__name__}" + ("" if eliminated is None else f" with {type(eliminated).__name__}")


def packed(model: Any, scenery: Scenery) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """A model as a tree and its arrays.

    Raises:
        NotOfferedError: for a model that no page is built for.
    """
    check_model(model)
    arrays = Packed()
    space = model.parameters
    tree: dict[str, Any] = {
        "names": list(space.names),
        "lower": list(map(float, space.lower)),
        "upper": list(map(float, space.upper)),
        "amplitudes": _amplitudes(model.eliminated.amplitudes, arrays),
        "m": model.conditions,
        "groups": _groups(model, arrays),
    }
    tree |= _eliminated(model.eliminated, arrays)
    tree |= _field(model, scenery, arrays)
    tree["outputs"], tree["missing"] = _outputs(model, arrays)
    tree["trained"] = None if model.trained is None else [model.trained.lower.tolist(), model.trained.upper.tolist()]
    return tree, arrays.texts


def _groups(model: Any, arrays: Packed) -> str | None:
    """Contact of each condition, by which round-off is told from forces."""
    return None if model.pairs is None else arrays.put("groups", model.pairs, "<i4")


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
            "schur": arrays.put("schur", _half(responses.schur)) if _symmetric(responses.schur) else None,
            "schur_whole": None if _symmetric(responses.schur) else arrays.put("schur", responses.schur),
            "free_slack": arrays.put("free_slack", responses.free_slack),
            "parts": [],
        }
    parts = [_part(part, number, arrays) for number, part in enumerate(eliminated.parts)]
    reshaped = None if eliminated.reshaped is None else _interpolant(eliminated.reshaped, "gaps", arrays)
    return {
        "schur": None, "schur_whole": None, "free_slack": None, "parts": parts,
        "gaps": arrays.put("gaps", eliminated.gaps), "reshaped": reshaped,
    }  # fmt: skip


def _symmetric(schur: np.ndarray) -> bool:
    return bool(np.abs(schur - schur.T).max() <= 1e-12 * np.abs(schur).max())


def _half(matrix: np.ndarray) -> np.ndarray:
    """Lower half by rows, (m (m + 1) / 2,)."""
    return matrix[np.tril_indices(len(matrix))]


def _part(part: Compliance, number: int, arrays: Packed) -> dict[str, Any]:
    """A connected component."""
    m = part.conditions.size
    modes = part.interpolant.modes.T.reshape(-1, m, m)
    half = np.array([_half((mode + mode.T) / 2) for mode in modes])
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
    """The displacement of the nodes that are drawn, in few modes; none where a model has no map of forces to it.

    u = W c,  c = W^T (C θ - K^-1 B^T λ) on these nodes, W from answers over the box.
    """
    fields = model.fields
    if not isinstance(fields, ExactFields) or fields.floats:
        return {"field": None}
    dim = fields.dimension
    rows = (scenery.nodes[:, None] * dim + np.arange(dim)).ravel()
    answers = model.solve_many(model.parameters.random(SEEN, 0), raise_on_failure=False)
    seen = np.array([answer.displacement()[rows] for answer in answers if answer.converged]).T
    ways, sizes, _ = np.linalg.svd(seen, full_matrices=False)
    left = np.sqrt(np.cumsum(sizes[::-1] ** 2)[::-1])
    count = min(int((left > FIELD * left[0]).sum()), FIELD_NUMBERS // len(rows))
    ways = ways[:, : max(1, count)]
    largest = np.abs(ways).max(axis=0)
    levels = np.round(ways / largest * LEVELS).astype(np.int16)
    of_terms = ways.T @ (fields.per_term[rows] + dense(fields.lifts.tocsr()[rows]))
    return {
        "field": {
            "modes": arrays.put("field_modes", levels.T, "<i2"),
            "scales": (largest / LEVELS).tolist(),
            "terms": arrays.put("field_terms", of_terms, "<f4"),
            "forces": arrays.put("field_forces", -(ways.T @ fields.per_force[rows]), "<f4"),
            "left": float(left[ways.shape[1]] / left[0]) if ways.shape[1] < len(left) else 0.0,
        }
    }


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
    }
    return tree, arrays.texts
