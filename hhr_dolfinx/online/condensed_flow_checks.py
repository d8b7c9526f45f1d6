"""What a file of condensed flow must hold, so that compiled loops may trust it: sizes, indices, possible numbers."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csc_matrix

from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.files import check_layout
from hhr_dolfinx.formulas import Modulus, check_over_box
from hhr_dolfinx.materials.constants import check_law
from hhr_dolfinx.materials.strain import StrainOperator
from hhr_dolfinx.materials.update import Group
from hhr_dolfinx.models.condensed_fields import CondensedFlowFields
from hhr_dolfinx.models.condensed_flow import CondensedFlow, PartFactors
from hhr_dolfinx.models.plastic_fields import PlasticFields
from hhr_dolfinx.models.reconstruct import GappyField
from hhr_dolfinx.online.layout import CONDENSED_FLOW_INDICES as INDICES
from hhr_dolfinx.online.layout import CONDENSED_FLOW_LAYOUT as LAYOUT
from hhr_dolfinx.online.tree import taken_apart
from hhr_dolfinx.online.values import check_amplitudes
from hhr_dolfinx.parameters import ParameterSpace, is_number, is_whole
from hhr_dolfinx.trained import TrainedPaths, TrainedRange

MAY_BE_NONE = {"plastic modes", "strain modes", "strains without stress"}
SAME = 1e-9
"""Relative difference of moduli in the middle of the box that is round-off."""


class Content(NamedTuple):
    """What a file holds: parts of a model without what stands in lists, and these lists."""

    parameters: ParameterSpace
    flow: CondensedFlow
    fields: CondensedFlowFields
    trained: TrainedPaths | None
    amplitudes: list[Any]
    laws: list[Any]
    outputs: list[Any]


def checked(content: Content) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Tree and arrays of content whose arrays are those of the table, and whose numbers are possible.

    Raises:
        FileContentError, SceneError: for other content.
    """
    space, flow, fields, trained = content[:4]
    _check_kinds(content)
    arrays: dict[str, np.ndarray] = {}
    parts = {"parameters": space, "flow": flow, "fields": fields, "trained": trained}
    tree = {name: taken_apart(part, name, arrays) for name, part in parts.items()}
    sizes = _checked_sizes(content, arrays)
    _check_points(flow, fields)
    _check_groups(content)
    _check_moduli(flow, fields.factors, space)
    _check_schur(flow)
    theta = fields.amplitudes
    check_amplitudes(theta.constant, theta.slopes, content.amplitudes, space, sizes["terms"])
    if trained is not None:
        _check_trained(trained, space)
    return tree, arrays


def _checked_sizes(content: Content, arrays: dict[str, np.ndarray]) -> dict[str, int]:
    """All sizes by name, if they agree, and no index lies outside of them."""
    space, flow, fields, trained = content[:4]
    components = 4 if fields.dimension == 2 else 6
    layout = {name: kind for name, kind in LAYOUT.items() if trained is not None or not name.startswith("trained.")}
    layout |= {f"flow.groups.{k}.indices": ("int", f"points of group {k}") for k in range(len(flow.groups))}
    known = {"P": len(space.names), "components": components, "per cell": flow.per_cell, "moduli": 2}
    sizes = check_layout(arrays, layout, known)
    if empty := [name for name, size in sizes.items() if size == 0 and name not in MAY_BE_NONE]:
        raise FileContentError(f"sizes {empty} are zero")
    if sizes["strains"] != sizes["points"] * components:
        raise FileContentError(f"{sizes['strains']} strains are not {components} at each of {sizes['points']} points")
    if sizes["flowed strains"] != sizes["flowed points"] * components:
        raise FileContentError(f"{sizes['flowed strains']} are not {components} at {sizes['flowed points']} points")
    if sizes["gauss points"] != sizes["cells"] * flow.per_cell or sizes["N"] % fields.dimension:
        raise FileContentError(
            f"{sizes['gauss points']} Gauss points are no cells of {flow.per_cell}, or {sizes['N']} dofs no nodes of "
            f"dimension {fields.dimension}"
        )
    strains = sizes["gauss points"] * components, sizes["terms"]
    if fields.flow.strain.size != sizes["N"] or fields.flow.unstressed.shape != strains:
        raise FileContentError(f"strains at all Gauss points are not those of {sizes['N']} dofs, or of {strains} terms")
    for name, of in INDICES.items():
        if not (arrays[name].min() >= 0 and arrays[name].max() < sizes[of]):
            raise FileContentError(f"{name} has indices outside 0 .. {sizes[of] - 1}")
    return sizes


def _check_kinds(content: Content) -> None:
    """Parts of the kinds that they must be, down to where arrays are."""
    space, flow, fields, trained = content[:4]
    right = (
        isinstance(space, ParameterSpace)
        and isinstance(flow, CondensedFlow)
        and isinstance(fields, CondensedFlowFields)
        and isinstance(trained, TrainedPaths | None)
        and isinstance(flow.groups, tuple)
        and all(isinstance(group, Group) and group.law is None for group in flow.groups)
        and isinstance(fields.amplitudes, Amplitudes)
        and fields.amplitudes.nonaffine == ()
        and fields.functionals is None
        and isinstance(fields.flow, PlasticFields)
        and isinstance(fields.flow.plastic, GappyField)
        and isinstance(fields.flow.cumulated, GappyField)
        and isinstance(fields.flow.strain, StrainOperator)
        and isinstance(fields.flow.unstressed, csc_matrix)
        and (trained is None or isinstance(trained.parameters, TrainedRange))
    )
    for factors in (flow.factors, fields.factors) if right else ():
        right = right and isinstance(factors, PartFactors) and isinstance(factors.moduli, tuple)
        right = right and all(isinstance(item, Modulus) for item in factors.moduli)
    if not right:
        raise FileContentError("its parts are of other kinds than those of a model of condensed flow")
    whole = is_whole(flow.per_cell, 1) and is_whole(fields.flow.strain.size, 1)
    if not whole or type(fields.dimension) is not int or fields.dimension not in (2, 3):
        raise FileContentError(
            f"{flow.per_cell!r} Gauss points of a cell, {fields.flow.strain.size!r} dofs and the dimension "
            f"{fields.dimension!r} must be whole numbers, the last one 2 or 3"
        )


def _check_points(flow: CondensedFlow, fields: CondensedFlowFields) -> None:
    """Points of their own, with weights, the same for the step and for the fields."""
    if np.unique(flow.points).size < flow.points.size:
        raise FileContentError("flow.points has a number twice")
    if not np.array_equal(flow.points, fields.flow.points):
        raise FileContentError("the points of the step and those from which fields are completed are not the same")
    known = fields.flow
    if not (np.diff(known.flowed) > 0).all() or not np.isin(known.points, known.flowed).all():
        raise FileContentError("the points that flowed must increase, those where laws are evaluated among them")
    if not (known.moduli[:, 1] > 0).all() or not (3 * known.moduli[:, 0] + known.moduli[:, 1] > 0).all():
        raise FileContentError("moduli of a Gauss point are not positive")


def _check_groups(content: Content) -> None:
    """Groups one behind another, since compiled loops know them by their ends; elasticity that is some; laws."""
    groups, laws = content.flow.groups, content.laws
    indices = np.concatenate([np.zeros(0, dtype=np.int64), *(group.indices for group in groups)])
    if not np.array_equal(indices, np.arange(content.flow.points.size)):
        raise FileContentError(
            f"the groups must hold the points 0 .. {content.flow.points.size - 1} once and one behind another"
        )
    for group in groups:
        stiff = isinstance(group.young, str) or (is_number(group.young) and group.young > 0)
        if not (stiff and is_number(group.poisson) and -1 < group.poisson < 0.5):
            raise FileContentError(f"young = {group.young!r} and poisson = {group.poisson!r} are no constants")
    if len(laws) != len(groups) or not all(law is None or callable(getattr(law, "flow", None)) for law in laws):
        raise FileContentError(f"{len(laws)} laws for {len(groups)} groups: each must have a flow, or be none")
    for number, law in enumerate(laws):
        check_law(law, content.parameters, f"law {number}")


def _check_moduli(flow: CondensedFlow, again: PartFactors, space: ParameterSpace) -> None:
    """Moduli of the parts: formulas of the parameters, those of the groups on them, with the values of the middle."""
    moduli, middle = flow.factors.moduli, np.mean([space.lower, space.upper], axis=0)
    if again.moduli != moduli or not np.array_equal(again.middle, flow.factors.middle):
        raise FileContentError("the moduli of the step and those of the fields are not the same")
    for modulus in moduli:
        if modulus.names != space.names or modulus.rest != "1":
            raise FileContentError(f"the modulus {modulus.factor[:60]!r} is no formula of {space.names}")
        remedy = "Young's modulus must be positive"
        check_over_box(modulus.factor_scalar, space, "young", 0.0, math.inf, remedy)
    values = np.array([modulus.value(middle) for modulus in moduli]) if moduli else np.ones(1)
    given = flow.factors.middle
    if given.shape != values.shape or not np.allclose(given, values, rtol=SAME, atol=0.0):
        raise FileContentError(f"the moduli are {values} in the middle of the box, and the arrays are made for {given}")
    factors = [modulus.factor for modulus in moduli] or ["1"]
    for group in flow.groups:
        own = group.young if isinstance(group.young, str) else "1"
        if {factors[part] for part in np.unique(flow.parts[group.indices])} != {own}:
            raise FileContentError(f"points with young = {group.young} are not on the part of this modulus")


def _check_schur(flow: CondensedFlow) -> None:
    """S of each part symmetric, none of their diagonals negative, that of all positive."""
    diagonals = np.einsum("qmm->qm", flow.schur)
    if not np.array_equal(flow.schur, flow.schur.transpose(0, 2, 1)):
        raise FileContentError("flow.schur is not symmetric")
    if (diagonals < 0).any() or not (diagonals.sum(axis=0) > 0).all():
        raise FileContentError("flow.schur is not positive definite: a condition has no compliance of its own")


def _check_trained(trained: TrainedPaths, space: ParameterSpace) -> None:
    """A range of the parameters, and rates and steps that are some."""
    if trained.parameters.names != tuple(space.names):
        raise FileContentError(f"it was trained on {trained.parameters.names}, and its parameters are {space.names}")
    ends = [(trained.parameters.lower, trained.parameters.upper), (trained.slowest, trained.fastest)]
    if not all((low <= high).all() for low, high in ends):
        raise FileContentError("the trained range ends below its start")
    steps = trained.steps
    pair = isinstance(steps, tuple) and len(steps) == 2 and all(is_number(step) for step in steps)
    if not pair or not 0 < steps[0] <= steps[1]:
        raise FileContentError(f"trained steps take {steps!r} s, which is no range")
    signs = trained.imbalance, trained.depth, trained.stress, trained.estimate, trained.begun, trained.onset
    if not all(is_number(sign) and sign >= 0 for sign in signs) or not isinstance(trained.rated, bool):
        raise FileContentError(f"the imbalance, the depth, the stress and the estimates of the training are {signs!r}")
