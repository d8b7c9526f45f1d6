"""Data of a model on a page: arrays by name, and a tree of plain values that describes them.

A page solves

    S(μ) = sum_c s_c(μ) sum_k h_k(μ) S_ck,  g(μ) = D(μ) θ(μ) - free motions,  λ >= 0,  g + S λ >= 0,
    λ·(g + S λ) = 0

with one term for constant stiffness, see :mod:`hhr_dolfinx.plugins.moduli.interpolated`. For
inelastic bodies it has the arrays of an increment instead, see
:mod:`hhr_dolfinx.plugins.pages.flowing`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.amplitudes import Amplitudes, Coverage, Limits
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.formulas import Scalar
from hhr_dolfinx.models.condensed import CondensedModel
from hhr_dolfinx.models.displacement import dense
from hhr_dolfinx.models.eliminations.constant import ConstantElimination
from hhr_dolfinx.models.exact import ExactFields
from hhr_dolfinx.models.functionals.functional import Functional, State
from hhr_dolfinx.models.functionals.kinds import UNDER_LOAD, Largest, Linear, Loaded
from hhr_dolfinx.models.model import KeptModel
from hhr_dolfinx.plugins.pages.kernel import kernel_of, kernel_parts
from hhr_dolfinx.plugins.pages.laws import check_law, law_tree, laws_of
from hhr_dolfinx.plugins.pages.layout import encoded
from hhr_dolfinx.plugins.pages.packing import ArrayText, Json, Packed, half, steps_of
from hhr_dolfinx.plugins.pages.pictures import pictures_of
from hhr_dolfinx.plugins.pages.records import kernel_data
from hhr_dolfinx.plugins.pages.scenery import Scenery
from hhr_dolfinx.plugins.pages.stress_outputs import stress_tree

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.floating.elimination import FloatingElimination
    from hhr_dolfinx.plugins.inelastic.condensed_fields import LooseBodies
    from hhr_dolfinx.plugins.pages.added import AddedToPage

DRAWN_FROM_ABOVE = 0.3
"""Height of a contact over its width up to which it is drawn from above."""

_OF_KERNEL = ("amplitudes", "limits", "groups", "schur", "free_slack", "gaps", "reshaped")


def check_model(model: KeptModel, what: str = "a page") -> None:
    """Raise NotOfferedError for a model that ``what`` does not support, with the supported one."""
    if flows(model):
        from hhr_dolfinx.plugins.pages.flowing import check_flow

        check_flow(model, what)
        check_law(model.law, what, flows=True)
        return
    if not isinstance(model, CondensedModel) or not (
        isinstance(model.eliminated, ConstantElimination)
        or model.eliminated.keeps_kernel
        or interpolates(model)
    ):
        raise NotOfferedError(
            f"cannot write {what} of a {type(model).__name__}: only condensed models, which keep "
            "all contact conditions, are supported. Call hhr.condense(scene) or hhr train SCENE "
            "--model condensed"
        )
    if model.eliminated.keeps_kernel and not hasattr(model.eliminated, "responses"):
        raise NotOfferedError(
            f"{what} solves for the motions of bodies that contact alone holds on one S, and here "
            "S depends on parameters: ask in Python, or hold them by a displacement"
        )
    check_law(model.law, what, flows=False)
    eliminated: Any = model.eliminated
    if interpolates(model) and not eliminated.symmetric:
        raise NotOfferedError(f"{what} solves with a symmetric S, and that of this model is not")


def interpolates(model: KeptModel) -> bool:
    """True if S of a model is interpolated, which takes a plug-in that may be missing."""
    if "moduli" not in registry.installed():
        return False
    from hhr_dolfinx.plugins.moduli.interpolated import Compliances

    return isinstance(model, CondensedModel) and isinstance(model.eliminated, Compliances)


def flows(model: KeptModel) -> bool:
    """True for a model with inelastic bodies."""
    return isinstance(model, KeptModel) and model.equilibrium is not None


def packed(
    model: KeptModel, scenery: Scenery, room: int, added: AddedToPage | None = None
) -> tuple[dict[str, Json], dict[str, ArrayText]]:
    """Tree and arrays of a model that passed :func:`check_model`, with its pictures.

    Optional parts use at most ``room`` bytes, those of the other arrays included.

    Args:
        model: condensed model that passed the check.
        scenery: drawn mesh and contact of the scene.
        room: bytes for all arrays, as text.
        added: what a plug-in adds to the page of this model.

    Returns:
        The tree, and each array as text by its name.
    """
    arrays = Packed()
    tree = contact_tree(model, arrays) | {"bound": None}
    if interpolates(model) and not model.law.plugin:  # the bound is that of unilateral contact
        from hhr_dolfinx.plugins.pages.interpolated import bound_tree

        tree["bound"] = bound_tree(model, arrays)
    code = None if added is None else added.code
    tree = _drawn(tree) | {"kernel": _kernel(model, tree, arrays, code)}
    if added is not None:
        tree |= {"kind": added.kind} | added.tree(tree, scenery, arrays, room)
    tree |= pictures_of(model if added is None else added.pictured, scenery, arrays, room)
    return tree, arrays.texts()


def _kernel(
    model: KeptModel, tree: dict[str, Any], arrays: Packed, given: bytes | None
) -> dict[str, Json]:
    """The compiled kernel that a model needs, or the one given, and its data."""
    compiled = given or kernel_of(kernel_parts(tree), laws_of(model.law, "a page"))
    code = np.frombuffer(compiled, dtype=np.uint8)
    data = encoded(kernel_data(tree, arrays.arrays, (tree["lower"], tree["upper"])))
    return data | {"code": arrays.put("kernel", code, "<u1")}


def _drawn(tree: dict[str, Any]) -> dict[str, Json]:
    """The part of a tree that the page itself reads; the rest is data of the kernel."""
    drawn_tree = {key: value for key, value in tree.items() if key not in _OF_KERNEL}
    drawn_tree["outputs"] = [
        {key: output[key] for key in ("name", "unit")} for output in tree["outputs"]
    ]
    of_bound = ("terms", "forced", "factor", "weights")  # of the bound
    drawn_tree["parts"] = (
        [{key: component[key] for key in of_bound} for component in tree["parts"]]
        if tree["bound"]
        else []
    )
    if tree["ranges"]:
        drawn_tree["ranges"] = {"remembers": tree["ranges"]["remembers"]}
    if tree["friction"]:
        drawn_tree["friction"] = {
            key: value for key, value in tree["friction"].items() if key != "laws"
        }
    if tree["flow"]:
        of_groups = ("points", "elastic", "grading")
        groups = [{key: group[key] for key in of_groups} for group in tree["flow"]["groups"]]
        drawn_tree["flow"] = {key: tree["flow"][key] for key in ("parts", "per_mode", "unforeseen")}
        drawn_tree["flow"]["groups"] = groups
    return drawn_tree


def contact_tree(model: Any, arrays: Packed) -> dict[str, Any]:
    """Tree of plain values and names of arrays, to solve for contact forces and outputs.

    The page needs no Python.

    Args:
        model: condensed model.
        arrays: packed arrays, to which those of the tree are added.
    """
    space = model.parameters
    inelastic = flows(model)
    amplitudes = _amplitudes_of(model)
    # round-off of forces is relative to the forces of the same contact
    grouped = not inelastic and model.pairs is not None
    tree: dict[str, Any] = {
        "names": list(space.names),
        "lower": list(map(float, space.lower)),
        "upper": list(map(float, space.upper)),
        "amplitudes": _amplitudes(amplitudes, arrays),
        "limits": [_limit(limit) for limit in amplitudes.limits],
        "m": model.conditions,
        "groups": arrays.put("groups", model.pairs, "<i4") if grouped else None,
        "friction": None,
        "flow": None,
        "floating": None,
        "ranges": None,
        "path": {"fixed": model.law.fixed.tolist()} if model.law.path_dependent else None,
    }
    tree |= law_tree(model.law, model.conditions, arrays)
    if inelastic:
        from hhr_dolfinx.plugins.pages.flowing import flow_tree

        tree |= {"schur": None, "parts": [], "flow": flow_tree(model, arrays)}
        tree["floating"] = (
            None if model.fields.loose is None else _floating(model.fields.loose, arrays)
        )
        tree["path"] = {"fixed": tree["flow"].pop("fixed")}
    else:
        tree |= _eliminated(model.eliminated, arrays)
    tree["outputs"], tree["missing"] = _outputs(model, arrays)
    trained = model.trained.parameters if inelastic and model.trained is not None else model.trained
    tree["trained"] = None if trained is None else [trained.lower.tolist(), trained.upper.tolist()]
    return tree


def _amplitudes_of(model: Any) -> Amplitudes:
    amplitudes: Amplitudes = (
        model.fields.amplitudes if flows(model) else model.eliminated.amplitudes
    )
    return amplitudes


def _limit(limit: Limits) -> dict[str, Json]:
    """Elastic constant and its limits; None for an infinite one, which JSON cannot represent."""
    low, high = limit.ends
    return {
        "steps": steps_of(limit.scalar),
        "low": low,
        "high": high if math.isfinite(high) else None,
    }


def _amplitudes(amplitudes: Amplitudes, arrays: Packed) -> dict[str, Json]:
    nonaffine: list[dict[str, Json]] = []
    for number, amplitude in enumerate(amplitudes.nonaffine):
        if isinstance(amplitude, Coverage):
            coverage: dict[str, Json] = {
                "positions": arrays.put(f"positions{number}", amplitude.positions),
                "extent": amplitude.extent,
            }
            coverage |= {
                "constant": amplitude.constant,
                "slopes": amplitude.slopes.tolist(),
                "degree": amplitude.degree,
            }
            nonaffine.append({"kind": "coverage", **coverage})
        elif isinstance(amplitude, Scalar):
            nonaffine.append({"kind": "formula", "steps": steps_of(amplitude)})
        elif (scalars := getattr(amplitude, "scalars", lambda: None)()) is not None:
            nonaffine += [{"kind": "formula", "steps": steps_of(scalar)} for scalar in scalars]
        else:
            raise NotOfferedError(
                f"a page knows no amplitude of kind {type(amplitude).__name__}, which is no "
                "formula: give the model file"
            )
    return {
        "constant": arrays.put("constant", amplitudes.constant),
        "slopes": arrays.put("slopes", amplitudes.slopes),
        "others": nonaffine,
    }


def _eliminated(eliminated: Any, arrays: Packed) -> dict[str, Json]:
    """S and the free slack; also the rigid motions of bodies without supports."""
    if isinstance(eliminated, ConstantElimination) or eliminated.keeps_kernel:
        responses = eliminated.responses
        return {
            "floating": _floating(eliminated, arrays) if eliminated.keeps_kernel else None,
            "schur": arrays.put("schur", half(responses.schur)),
            "free_slack": arrays.put("free_slack", responses.free_slack),
            "parts": [],
        }
    from hhr_dolfinx.plugins.pages.interpolated import compliances_tree

    return compliances_tree(eliminated, arrays)


def _floating(motions: FloatingElimination | LooseBodies, arrays: Packed) -> dict[str, str]:
    """Contact rows of the motions, B R, and loads along them."""
    return {
        name: arrays.put(f"floating_{name}", getattr(motions, name))
        for name in ("taken", "driving")
    }


def _outputs(model: KeptModel, arrays: Packed) -> tuple[list[dict[str, Json]], list[str]]:
    fields = model.fields
    functionals = () if fields.functionals is None else fields.functionals.items
    outputs: list[dict[str, Json]] = []
    missing = []
    for number, functional in enumerate(functionals):
        # from forces at constant shape, or from displacements with known maps
        has_maps = not functional.count or isinstance(fields, ExactFields) or flows(model)
        if _is_quadratic(model, functional):
            half_of_it = arrays.put(
                f"output{number}_half", half(_second_derivatives(model, functional))
            )
            outputs.append(
                {
                    "name": functional.name,
                    "unit": functional.unit,
                    "kind": "quadratic",
                    "half": half_of_it,
                }
            )
            continue
        if (stressed := stress_tree(model, functional, number, arrays)) is not None:
            outputs.append({"name": functional.name, "unit": functional.unit} | stressed)
            continue
        if (
            np.size(fields.functionals.axes)
            or not isinstance(functional, Linear | Largest | Loaded)
            or not has_maps
        ):
            missing.append(functional.name)
            continue
        described = (
            _linear(model, functional, number, arrays)
            if isinstance(functional, Linear)
            else _of_forces(functional, number, arrays)
        )
        outputs.append({"name": functional.name, "unit": functional.unit} | described)
    return outputs, missing


def _is_quadratic(model: Any, item: Functional) -> bool:
    """True for a quadratic form of forces and θ: of a constant shape, with known maps, and without
    motions.
    """
    fields = model.fields
    has_maps = (
        isinstance(fields, ExactFields) and not flows(model) and not model.eliminated.keeps_kernel
    )
    return (
        has_maps
        and not np.size(fields.functionals.axes)
        and bool(getattr(item, "quadratic", False))
    )


def _second_derivatives(model: KeptModel, item: Functional) -> np.ndarray:
    """Second derivatives of a quadratic form along forces and θ, (m + 1 + T, m + 1 + T).

    Its columns are slopes of the form for unit forces and unit θ.
    """
    fields = model.fields
    m = model.conditions
    rows = item.matrix(fields.functionals.size)
    read = np.hstack(
        [-(rows @ fields.per_force), rows @ fields.per_term + dense(rows @ fields.lifts)]
    )
    derivatives = np.zeros((read.shape[1],) * 2)
    for row, unit in zip(derivatives, np.eye(len(derivatives)), strict=True):
        nothing = np.zeros((0, 1))
        slopes = item.slopes(
            State(unit[:m], read @ unit, model.parameters.middle, unit[m:], nothing.copy)
        )
        row += slopes.measured @ read
        row[m:] += slopes.theta
        np.add.at(row, slopes.conditions, slopes.forces)
    return derivatives


def _linear(model: Any, item: Linear, number: int, arrays: Packed) -> dict[str, Json]:
    """Output as weights of forces and amplitudes, which include those of displacements."""
    fields = model.fields
    inelastic = flows(model)
    of_forces = np.zeros(model.conditions)
    np.add.at(of_forces, item.conditions, item.weights)
    of_terms = np.zeros(_amplitudes_of(model).firsts[-1])
    np.add.at(of_terms, item.terms, item.coefficients)
    described: dict[str, Json] = {}
    if item.count and inelastic:
        from hhr_dolfinx.plugins.pages.flowing import linear_of_flow

        described = {"moved": linear_of_flow(fields, item, number, arrays)}
        if fields.loose is not None:
            of_motions = item.along @ (item.matrix(len(fields.basis)) @ fields.loose.modes)
            described |= {"motions": arrays.put(f"output{number}_motions", of_motions)}
    elif item.count:
        rows = item.matrix(fields.functionals.size)
        if model.eliminated.keeps_kernel:
            of_motions = item.along @ (rows @ model.eliminated.modes)
            described = {"motions": arrays.put(f"output{number}_motions", of_motions)}
        of_forces -= item.along @ (rows @ fields.per_force)
        of_terms += item.along @ (rows @ fields.per_term + dense(rows @ fields.lifts))
    described |= {"forces": arrays.put(f"output{number}_forces", of_forces)}
    return {"kind": "linear", **described, "terms": arrays.put(f"output{number}_terms", of_terms)}


def _of_forces(item: Largest | Loaded, number: int, arrays: Packed) -> dict[str, Json]:
    described: dict[str, Json] = {
        "conditions": arrays.put(f"output{number}_conditions", item.conditions, "<i4")
    }
    described |= {"areas": arrays.put(f"output{number}_areas", item.areas)}
    if isinstance(item, Largest):
        return {"kind": "largest"} | described
    described |= {"counted": arrays.put(f"output{number}_counted", item.counted)}
    return {
        "kind": "loaded",
        "offset": item.offset,
        "factor": item.factor,
        "least": UNDER_LOAD,
        **described,
    }


def drawn(scenery: Scenery) -> tuple[dict[str, Any], dict[str, ArrayText]]:
    """Tree and arrays of a scenery."""
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
        "shares": arrays.put("shares", scenery.shares.ravel()),
        "words": scenery.words,
        "moves": scenery.moves,
    }
    if scenery.points.shape[1] == 3:
        tree["flat"] = arrays.put("flat", _flat(scenery), "<f4")
    return tree, arrays.texts()


def _flat(scenery: Scenery) -> np.ndarray:
    """Contact points projected on two axes if nearly flat, else on the two widest directions, (m,
    2).
    """
    projected = np.zeros((len(scenery.areas), 2))
    for pair in np.unique(scenery.pairs):
        of_pair = scenery.pairs == pair
        offsets = scenery.contact_points[of_pair] - scenery.contact_points[of_pair].mean(axis=0)
        widths = np.ptp(offsets, axis=0)
        if widths.min() < DRAWN_FROM_ABOVE * widths.max():
            projected[of_pair] = np.delete(offsets, widths.argmin(), axis=1)
            continue
        ways = np.linalg.svd(offsets, full_matrices=False)[2][:2]
        # the largest component of each points upwards or to the right
        ways *= np.sign(ways[np.arange(len(ways)), np.abs(ways).argmax(axis=1)])[:, None]
        projected[of_pair, : len(ways)] = offsets @ ways.T
    return projected
