"""What files hold of bodies that flow: all Gauss points of a RID, or few with weights, and how fields are completed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.models.reconstruct import FlowFields, GappyField
from hhr_dolfinx.online.layout import PRODUCTS, Content

if TYPE_CHECKING:
    from hhr_dolfinx.materials.update import Material
    from hhr_dolfinx.models.cubature_flow import CubatureFlow
    from hhr_dolfinx.models.reduced_flow import ReducedFlow
    from hhr_dolfinx.parameters import ParameterSpace


def part_of_flow(names: Iterable[str]) -> str:
    """The part of arrays of these names that is of bodies that flow: "flow", "cubature", or "" where none does."""
    parts = {name.split(".")[0] for name in names}
    return "flow" if "flow" in parts else "cubature" if "cubature" in parts else ""


def flow_taken_apart(flow: ReducedFlow | CubatureFlow, fields: FlowFields, space: ParameterSpace) -> dict[str, Any]:
    """Arrays of bodies that flow by name; moduli that are formulas, whose texts stand elsewhere, are of the middle."""
    groups = flow.material.moduli_at(np.mean([space.lower, space.upper], axis=0)).groups
    operator: Any = getattr(flow, "operator", None)
    part, shape = ("cubature", flow.points.shape) if operator is None else ("flow", operator.weights.shape)
    own = vars(flow) if operator is None else vars(flow) | vars(operator)
    values: dict[str, Any] = {f"{part}.{name}": item for name, item in own.items()}
    numbers = np.empty(flow.points.size, dtype=np.int64)
    for number, group in enumerate(groups):
        numbers[group.indices] = number
    values[f"{part}.group"] = numbers.reshape(shape)
    values |= {f"{part}.{name}": [getattr(group, name) for group in groups] for name in ("young", "poisson")}
    nothing = GappyField(np.zeros((fields.gauss_points, 0)), np.zeros((0, numbers.size)))
    completed = {"stress": fields.stress, "cumulated": fields.cumulated or nothing}
    for name, field in completed.items():
        values |= {f"completion.{name}_{key}": item for key, item in vars(field).items()}
    return values


def check_flow(content: Content) -> None:
    """Sizes of Gauss points that are products of others, and material that is one; adds the number of all cells."""
    from hhr_dolfinx.materials.constants import check_law

    arrays, sizes, laws = content.arrays, content.sizes, content.laws
    kind = part_of_flow(arrays)
    if kind == "cubature":
        sizes["per cell"] = int(arrays["cubature.per_cell"])
        if sizes["per cell"] < 1:
            raise FileContentError(f"a cell has {sizes['per cell']} Gauss points")
        sizes["strains"] = sizes["points"] * sizes["components"]
    sizes["all cells"] = sizes["gauss points"] // sizes["per cell"]
    for name, factors in PRODUCTS[kind].items():
        if sizes[name] != math.prod(sizes[factor] for factor in factors):
            raise FileContentError(f"{sizes[name]} {name} are not {' times '.join(factors)}")
    if sizes["components"] != (4 if content.dimension == 2 else 6):
        raise FileContentError(f"a strain has {sizes['components']} components in dimension {content.dimension}")
    young, poisson = arrays[f"{kind}.young"], arrays[f"{kind}.poisson"]
    if not ((young > 0) & (poisson > -1) & (poisson < 0.5)).all():
        raise FileContentError(f"Young's moduli {young} and Poisson's ratios {poisson} are none")
    if kind == "flow" and not (arrays["flow.weights"] > 0).all():
        raise FileContentError(f"a Gauss point has the weight {arrays['flow.weights'].min()}, not positive")
    unique = "flow.inner" if kind == "flow" else "cubature.points"
    if np.unique(arrays[unique]).size < arrays[unique].size:
        raise FileContentError(f"{unique} has a number twice")
    steps = arrays.get("paths.steps", np.ones(2))
    if not 0 < steps[0] <= steps[1]:
        raise FileContentError(f"trained steps take {steps[0]:g} to {steps[1]:g} s, which is no range")
    if len(laws) != sizes["groups"] or not all(law is None or callable(getattr(law, "flow", None)) for law in laws):
        raise FileContentError(f"{len(laws)} laws for {sizes['groups']} groups: each must have a flow, or be none")
    for number, law in enumerate(laws):
        check_law(law, content.space, f"law {number}")


def flow_of(flow: dict, completion: dict, content: Content) -> tuple[ReducedFlow | CubatureFlow, FlowFields]:
    """The parts of bodies that flow; what compiles loops for them is imported here."""
    from hhr_dolfinx.materials.update import Group, Material

    sizes, number = content.sizes, flow.pop("group").ravel()
    constants = zip(flow.pop("young").tolist(), flow.pop("poisson").tolist(), content.laws, strict=True)
    groups = [Group(np.flatnonzero(number == k), *item) for k, item in enumerate(constants)]
    part = _points_of(flow, Material(groups, sizes["components"], content.space.names), sizes)
    stress, cumulated = (
        GappyField(completion[f"{name}_modes"], completion[f"{name}_fit"]) for name in ("stress", "cumulated")
    )
    return part, FlowFields(part.points, stress, cumulated if sizes["strain modes"] else None, sizes["gauss points"])


def _points_of(flow: dict, material: Material, sizes: Mapping[str, int]) -> ReducedFlow | CubatureFlow:
    """All Gauss points of a RID, or those of a cubature."""
    if "trial" in flow:
        from hhr_dolfinx.models.cubature_flow import CubatureFlow

        return CubatureFlow(**flow, material=material)
    from hhr_dolfinx.materials.strain import StrainOperator
    from hhr_dolfinx.models.reduced_flow import ReducedFlow

    operator = StrainOperator(flow.pop("gradients"), flow.pop("weights"), flow.pop("dofs"), sizes["n"])
    return ReducedFlow(operator, material, **flow)
