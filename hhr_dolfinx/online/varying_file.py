"""Files of condensed models, and the parts of reduced ones whose stiffness or shape depends on parameters: trees."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hhr_dolfinx.amplitudes import Amplitudes, Coverage
from hhr_dolfinx.errors import FileContentError, HHRError, ModelFileError, NotOfferedError
from hhr_dolfinx.formulas import Formula, Modulus, Scalar, check_over_box
from hhr_dolfinx.linear.dense import LapackLU
from hhr_dolfinx.models.block_elimination import BlockReduction
from hhr_dolfinx.models.cells import CellRule
from hhr_dolfinx.models.condensed import CondensedModel, KnownStatuses
from hhr_dolfinx.models.elimination import ConstantElimination, Responses
from hhr_dolfinx.models.error_bound import ErrorBound
from hhr_dolfinx.models.exact import ExactFields
from hhr_dolfinx.models.floating import FloatingResponses
from hhr_dolfinx.models.functional_kinds import KINDS as FUNCTIONALS
from hhr_dolfinx.models.functionals import Functionals
from hhr_dolfinx.models.interpolated import Compliance, Compliances, InterpolatedFields, PrimalModes
from hhr_dolfinx.models.interpolation import Interpolant
from hhr_dolfinx.models.moving_cells import MovingCells
from hhr_dolfinx.models.patches import ContactPatch, SurfacePatch
from hhr_dolfinx.models.projected import ReducedProblem, ReducedTerms
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.models.reshaped import InterpolatedProblem, ReshapedReduction
from hhr_dolfinx.models.shaped import FixedCells, RidAssembly, RidBody, RidShape
from hhr_dolfinx.models.shaped_functionals import ReshapedFunctionals, Zone
from hhr_dolfinx.models.starts import LinearStarts
from hhr_dolfinx.models.varying_bound import PartEnergy, VaryingBound
from hhr_dolfinx.online.tree import put_together, taken_apart
from hhr_dolfinx.pairings.mortar import Mortar
from hhr_dolfinx.pairings.node_to_node import NodeToNode
from hhr_dolfinx.pairings.node_to_surface import DoublePass, NodeToSurface
from hhr_dolfinx.pairings.obstacle import Obstacle
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.plain import by_name
from hhr_dolfinx.shapes import Shape

KINDS = (
    Amplitudes, BlockReduction, Compliance, Compliances, Coverage, Formula, InterpolatedFields, InterpolatedProblem,
    Interpolant, KnownStatuses, LinearStarts, Modulus, ParameterSpace, PrimalModes, ReducedProblem, ReducedTerms,
    ReshapedReduction, Scalar, Functionals, *FUNCTIONALS, FixedCells, RidAssembly, RidBody, RidShape, Shape, CellRule,
    ContactPatch, SurfacePatch, Mortar, NodeToNode, NodeToSurface, DoublePass, Obstacle,
    MovingCells, ReshapedFunctionals, Zone, VaryingBound, PartEnergy, ExactFields, FloatingResponses,
    ConstantElimination, Responses,
)  # fmt: skip
"""Classes that may come out of a file."""

PREFIX = "varying"


def _made_of(parts: dict[str, Any]) -> CondensedModel:
    """The model of the parts of a file."""
    if parts.keys() != set(CondensedModel.kept):
        raise FileContentError(f"parts {sorted(parts)[:10]} make no condensed model")
    if isinstance(parts["eliminated"], ConstantElimination):
        parts["eliminated"] = replace(parts["eliminated"], factorise=LapackLU)
    return CondensedModel(**parts)


def condensed_of(
    path: str | Path, header: dict, arrays: Mapping[str, np.ndarray], known: Iterable[type]
) -> CondensedModel:
    """The model of a file written by :func:`save_condensed`.

    Args:
        path: of the file, for messages.
        header, arrays: its content.
        known: classes of a user's own amplitudes that may come out of it.

    Raises:
        ModelFileError: if it is damaged.
    """
    try:
        kinds = by_name([*KINDS, *known])
        model = _made_of({name: put_together(part, arrays, kinds) for name, part in header["tree"].items()})
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # a model that cannot answer in the middle of its box is none
            answer = model.solve(np.mean([model.parameters.lower, model.parameters.upper], axis=0), gradient=True)
            with suppress(NotOfferedError):  # of a model of forces alone
                answer.displacement()
                answer.estimate()
            if model.fields.functionals is not None:
                answer.outputs()
    except (HHRError, KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise ModelFileError(f"{path} is damaged or no model file ({error}): build the model again") from error
    return model


def varying_parts(model: ReducedModel) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What a reduced model has beside the arrays of its table: a tree for the header, and arrays by path."""
    arrays: dict[str, np.ndarray] = {}
    problem = model.problem
    parts: dict[str, Any] = {
        "terms": problem.terms,
        "reshaped": problem.reshaped,
        "compliances": model.compliances,
        "known": model.known,
        "contact": model.fields.reshaped_contact,
        "bound": None if isinstance(model.fields.bound, ErrorBound) else model.fields.bound,
        "outputs": None if problem.reshaped is None else model.fields.functionals,
    }
    if model.flow is not None:
        parts["young"] = [group.young if isinstance(group.young, str) else None for group in model.flow.material.groups]
    tree = {name: taken_apart(part, f"{PREFIX}.{name}", arrays) for name, part in parts.items()}
    return tree, arrays


def with_varying_parts(
    model: ReducedModel, tree: Any, arrays: Mapping[str, np.ndarray], known: Iterable[type]
) -> ReducedModel:
    """A reduced model with what :func:`varying_parts` returned.

    Raises:
        FileContentError: for a tree that is none, or does not suit the model.
    """
    kinds = by_name([*KINDS, *known])
    names = {"terms", "reshaped", "compliances", "known", "contact", "bound", "outputs"}
    flowing = {"young"} if model.flow is not None else set()
    if not isinstance(tree, dict) or tree.keys() != names | flowing:
        raise FileContentError("what varies in the model is no tree")
    parts = {name: put_together(tree[name], arrays, kinds) for name in tree}
    if model.flow is not None:
        return _with_moduli(model, parts)
    fits = (
        isinstance(parts["terms"], ReducedTerms | None)
        and isinstance(parts["reshaped"], RidAssembly | None)
        and isinstance(parts["compliances"], Compliances | None)
        and isinstance(parts["known"], KnownStatuses)
        and isinstance(parts["contact"], Interpolant | None)
        and isinstance(parts["bound"], VaryingBound | None)
        and isinstance(parts["outputs"], ReshapedFunctionals | None)
    )
    if not fits:
        raise FileContentError("what varies in the model is of other kinds")
    if parts["bound"] is None and model.fields.force_snapshots is None:
        raise FileContentError("neither training forces nor a bound say what forces outside the RID are")
    try:
        problem = replace(model.problem, terms=parts["terms"], reshaped=parts["reshaped"])
        outputs = {} if parts["outputs"] is None else {"functionals": parts["outputs"]}
        fields = replace(model.fields, reshaped_contact=parts["contact"], bound=parts["bound"], **outputs)
        given = {"compliances": parts["compliances"], "known": parts["known"]}
        whole = model.changed(problem=problem, fields=fields, **given)
        middle = np.mean([model.parameters.lower, model.parameters.upper], axis=0)
        whole.solve(middle, outside="ignore", raise_on_failure=False).estimate()
    except (IndexError, TypeError, ValueError, AttributeError) as error:
        raise FileContentError(f"what varies does not suit the model: {error}") from error
    return whole


def _with_moduli(model: ReducedModel, parts: dict[str, Any]) -> ReducedModel:
    """A model of bodies that flow with the parts of its stiffness, and the formulas of the moduli of its groups."""
    from hhr_dolfinx.materials.update import Material

    assert model.flow is not None
    terms, young, names = parts["terms"], parts["young"], model.parameters.names
    material, problem = model.flow.material, model.problem
    alone = all(parts[name] is None for name in parts.keys() - {"terms", "young"})
    texts = isinstance(young, list | tuple) and all(isinstance(text, str | None) for text in young)
    if not (isinstance(terms, ReducedTerms) and alone and texts and len(young) == len(material.groups)):
        raise FileContentError("what varies in the model is of other kinds")
    shapes = problem.stiffness.shape, problem.loads.shape, problem.loads.shape
    arrays, count = (terms.stiffness, terms.lifts, terms.forces), len(terms.moduli)
    wanted = [(count, *shapes[0]), (count, *shapes[1]), shapes[2]]
    if [np.shape(item) for item in arrays] != wanted or not all(np.isfinite(item).all() for item in arrays):
        raise FileContentError(f"parts of the stiffness must be finite and have the shapes {wanted}")
    formulas = {text for text in young if text is not None}
    kinds = all(isinstance(item, Modulus) and item.names == names and item.rest == "1" for item in terms.moduli)
    if not kinds or not formulas or {item.factor for item in terms.moduli} - {"1"} != formulas:
        raise FileContentError("the parts of the stiffness are not those of the moduli of its bodies")
    for text in formulas:
        check_over_box(
            Scalar(text, names), model.parameters, "young", 0.0, math.inf, "Young's modulus must be positive"
        )
    middle = np.mean([model.parameters.lower, model.parameters.upper], axis=0)
    there = np.tensordot(terms.weights(middle), terms.stiffness, 1)
    if not np.abs(there - problem.stiffness).max() <= 1e-9 * np.abs(problem.stiffness).max():
        raise FileContentError("the parts of the stiffness do not make that of the middle of the box")
    groups = [replace(group, young=text or group.young) for group, text in zip(material.groups, young, strict=True)]
    flow = replace(model.flow, material=Material(groups, material.components, names))
    return model.changed(problem=replace(problem, terms=terms), flow=flow)
