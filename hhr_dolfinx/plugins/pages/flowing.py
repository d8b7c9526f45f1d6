"""Data of a condensed inelastic model on a page: arrays of an increment, laws as programs, and
pictures of an answer.

The kernel solves histories like :mod:`hhr_dolfinx.plugins.inelastic.condensed_flow`: the same
residual, the same contact problem for each correction, and Newton's method on both. With
friction, each contact problem is an increment of it, see
:mod:`hhr_dolfinx.plugins.friction.rubbing_flow`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.errors import ConvergenceError, NotOfferedError
from hhr_dolfinx.formulas import Scalar, formula_of
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.functionals.kinds import Linear
from hhr_dolfinx.plugins.inelastic.condensed_fields import CondensedFlowFields
from hhr_dolfinx.plugins.inelastic.condensed_flow import CondensedFlow, CondensedFlowModel
from hhr_dolfinx.plugins.inelastic.constants import parameters_of
from hhr_dolfinx.plugins.inelastic.law import LawProgram
from hhr_dolfinx.plugins.inelastic.trained import TrainedPaths
from hhr_dolfinx.plugins.inelastic.update import Group, Material
from hhr_dolfinx.plugins.pages.packing import Json, Packed, half, modes_of, packed_levels, steps_of
from hhr_dolfinx.plugins.pages.scenery import Scenery
from hhr_dolfinx.warn import ignored

if TYPE_CHECKING:
    from hhr_dolfinx.models.model import KeptModel

WALKS = 16
WALK = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 0.6, 0.3, 0.0)
"""Number of histories from which modes of pictures are computed, and their load factors:
proportional loading to a random point and back.
"""

GRADING = "grading_of_its_elasticity"
"""Name of the grading of a body in the formula of its modulus; no parameter has it."""
EXACT = 100_000
"""Most strains of contact forces that are stored with all digits: single precision changed forces
by 8e-9, measured once.
"""


def check_flow(model: KeptModel, what: str = "a page") -> None:
    """Refuse models that are not condensed models of inelastic bodies.

    Args:
        model: model to check.
        what: name of the output in the message.

    Raises:
        NotOfferedError: for any other model.
    """
    if not isinstance(model, CondensedFlowModel):
        raise NotOfferedError(
            f"{what} marches with condensed flow, and a {type(model).__name__} is not of that "
            "kind: hhr.train(scene, paths).condense(), or hhr reduce SCENE with PATHS beside the "
            "scene"
        )


def flow_tree(model: CondensedFlowModel, arrays: Packed) -> dict[str, Json]:
    """Arrays of an increment.

    Args:
        model: condensed model of inelastic bodies.
        arrays: packed arrays, to which those of the tree are added.
    """
    flow = model.flow
    names = model.parameters.names
    material = Material(flow.groups, flow.components, names).moduli_at(model.parameters.middle)
    exact = ("per_mode", "forced", "given", "moved", "modal", "coupled", "pressed", "gaps")
    tree: dict[str, Any] = {name: arrays.put(f"flow_{name}", getattr(flow, name)) for name in exact}
    kind = "<f8" if flow.per_force.size <= EXACT else "<f4"
    tree["per_force"] = arrays.put("flow_per_force", flow.per_force, kind)
    tree["weights"] = arrays.put("flow_weights", _weights(flow, material.elastic))
    tree |= {
        name: arrays.put(f"flow_{name}", getattr(flow, name), "<i4")
        for name in ("parts", "mode_parts")
    }
    tree["schur"] = arrays.put("flow_schur", np.array([half(schur) for schur in flow.schur]))
    tree["moduli"] = [steps_of(modulus.factor_scalar) for modulus in flow.factors.moduli]
    tree["middle"] = flow.factors.middle.tolist()
    elasticity = [group.elasticity(flow.components) for group in material.groups]
    tree["groups"] = [
        _group(k, *pair, names, arrays)
        for k, pair in enumerate(zip(flow.groups, elasticity, strict=True))
    ]
    tree["fixed"] = fixed(model)
    # for PlasticFields.unforeseen of the answer shown, to a few digits: the residual of the fit to
    # all points is orthogonal to the modes, so their orthonormal directions suffice
    plastic = model.fields.flow
    tree["unforeseen"] = packed_levels("flow_shown", np.linalg.qr(plastic.shown)[0].T, arrays)
    tree["unforeseen"]["without"] = arrays.put("flow_without", plastic.without, "<f4")
    return tree


def _weights(flow: CondensedFlow, elastic: np.ndarray) -> np.ndarray:
    """Weight of each point, (n,): the factor from the stress of ``per_mode`` by C, (n, c, c), to
    ``tested``.
    """
    shape = len(flow.per_mode), flow.components, -1
    stress: np.ndarray = np.einsum("nij,ljn->lin", elastic, flow.per_mode.reshape(shape))
    squares = (stress**2).sum(axis=(0, 1))
    return np.asarray(
        (stress * flow.tested.reshape(shape)).sum(axis=(0, 1)) / np.where(squares > 0, squares, 1.0)
    )


def _group(
    number: int,
    group: Group,
    elasticity: tuple[np.ndarray, np.ndarray],
    names: tuple[str, ...],
    arrays: Packed,
) -> dict[str, Json]:
    """Points of a body: C and C^-1 in the middle of the box, formulas of E, ν and law constants,
    and its program.

    C and C^-1 are those for the grading 1, by which E is multiplied in its formula.
    """
    law = group.law
    free = [k for k, name in enumerate(group.coordinates) if name not in names]
    all_names = (*names, *(group.coordinates[k] for k in free))
    coordinates = group.places[:, free]
    young = group.young
    if group.grading.size:
        all_names = (*all_names, GRADING)
        coordinates = np.hstack(
            [coordinates.reshape(len(group.indices), len(free)), group.grading[:, None]]
        )
        young = f"({young}) * {GRADING}"
    values = (young, group.poisson, *(() if law is None else law.values))
    return {
        "points": len(group.indices),
        "elastic": arrays.put(f"elastic{number}", elasticity[0]),
        "compliance": arrays.put(f"compliance{number}", elasticity[1]),
        "constants": [
            steps_of(Scalar(value, all_names)) if isinstance(value, str) else [float(value)]
            for value in values
        ],
        "places": arrays.put(f"law{number}_places", coordinates) if coordinates.shape[1] else None,
        "grading": arrays.put(f"grading{number}", group.grading) if group.grading.size else None,
        "rated": law is not None and law.rated,
        "law": None if law is None else _program(f"law{number}", law, arrays),
    }


def _program(name: str, law: LawProgram, arrays: Packed) -> dict[str, Json]:
    """Arrays and sizes of the program of a law."""
    program = law.program
    integers = {
        key: getattr(program, key) for key in ("rows", "ends", "outputs", "output_ends")
    } | {"kinds": law.kinds}
    tree: dict[str, Json] = {
        key: arrays.put(f"{name}_{key}", values, "<i4") for key, values in integers.items()
    }
    numbers = {"numbers": program.numbers, "low": law.low, "high": law.high}
    tree |= {key: arrays.put(f"{name}_{key}", values) for key, values in numbers.items()}
    sizes = zip(("strains", "unknowns", "memory", "constants"), law.coded[1], strict=False)
    return tree | {
        "sizes": dict(sizes),
        "registers": program.registers,
        "limited": bool(law.reason),
    }


def fixed(model: CondensedFlowModel) -> list[int]:
    """Indices of parameters that are constant in a history: of moduli, of law constants that no
    load depends on, and of laws of contacts.
    """
    names = model.parameters.names
    moduli = {
        name
        for modulus in model.flow.factors.moduli
        for name in formula_of(modulus.factor, "young").variables
    }
    constants = {name for group in model.flow.groups for name in parameters_of(group.law)}
    loads = {names[index] for index in _axes(model.fields.amplitudes, names)}
    of_friction = (
        {names[index] for index in model.law.fixed.tolist()} if model.law.plugin else set()
    )
    return [
        index
        for index, name in enumerate(names)
        if name in moduli | (constants - loads) | of_friction
    ]


def _axes(amplitudes: Amplitudes, names: tuple[str, ...]) -> Iterator[int]:
    """Indices of the parameters on which loads depend."""
    yield from np.flatnonzero(amplitudes.slopes.any(axis=0)).tolist()
    for amplitude in amplitudes.nonaffine:
        if isinstance(amplitude, Scalar):
            yield from (names.index(name) for name in amplitude.formula.variables)
        else:
            yield from range(len(names))


def linear_of_flow(
    fields: CondensedFlowFields, item: Linear, number: int, arrays: Packed
) -> dict[str, str]:
    """Weights of an output that reads displacements.

    They are those of corrections and loads, and by part those of forces and loads.

    Args:
        fields: maps of the model to displacements.
        item: output, linear in displacements.
        number: number of the output, part of the names of arrays.
        arrays: packed arrays, to which those of the tree are added.
    """
    rows = csr_matrix(item.along @ item.matrix(len(fields.basis)))
    rows_by_component = [
        csr_matrix(rows.multiply(fields.parts == component))
        for component in range(fields.factors.middle.size)
    ]
    weights = {
        "modes": rows @ fields.basis,
        "given": rows @ fields.given,
        "pushed": np.vstack([block @ fields.per_force for block in rows_by_component]),
        "forced": np.vstack([block @ fields.forced for block in rows_by_component]),
    }
    return {
        name: arrays.put(f"output{number}_{name}", np.ravel(values))
        for name, values in weights.items()
    }


def flow_field(
    model: CondensedFlowModel,
    histories: Sequence[Sequence[Answer]],
    scenery: Scenery,
    rows: np.ndarray,
    arrays: Packed,
) -> dict[str, Json] | None:
    """Displacement of the drawn dofs in modes of some histories, and data of plastic strain.

    None if all displacements are zero, or if few modes do not represent them.

    Args:
        model: condensed model of inelastic bodies.
        histories: answers along each path.
        scenery: drawn mesh and contact of the scene.
        rows: drawn dofs, see :func:`rows_of`, (n,).
        arrays: packed arrays, to which those of the tree are added.
    """
    fields = model.fields
    seen = np.array([answer.displacement()[rows] for along in histories for answer in along]).T
    ways = modes_of(seen)
    if ways is None:
        return None
    tree = packed_levels("field_modes", ways.T, arrays)
    maps = {"modes_of_flow": ways.T @ fields.basis[rows], "given": ways.T @ fields.given[rows]}
    components_of_rows = fields.parts[rows]
    ways_by_component = [
        (ways * (components_of_rows == component)[:, None]).T
        for component in range(fields.factors.middle.size)
    ]
    maps["pushed"] = np.array([block @ fields.per_force[rows] for block in ways_by_component])
    maps["forced"] = np.array([block @ fields.forced[rows] for block in ways_by_component])
    if fields.loose is not None:
        maps["motions"] = ways.T @ fields.loose.modes[rows]
    named = {name: arrays.put(f"field_{name}", values, "<f4") for name, values in maps.items()}
    return {"kind": "flow"} | tree | named | _plastic(fields, scenery, arrays)


def walked(model: CondensedFlowModel) -> Iterator[list[Answer]]:
    """Answers of histories with proportional loading to random points of the training range,
    without warnings.
    """
    space = model.parameters
    unloaded = np.clip(0.0, space.lower, space.upper)
    still = fixed(model)
    points = space.random(WALKS, 0)
    if isinstance(model.trained, TrainedPaths):
        trained = model.trained.parameters
        points = np.clip(points, trained.lower, trained.upper)
    for point in points:
        start = unloaded.copy()
        start[still] = point[still]
        path = [(float(time), start + share * (point - start)) for time, share in enumerate(WALK)]
        with ignored(Warning), suppress(ConvergenceError):
            yield model.march(path).answers


def _plastic(fields: CondensedFlowFields, scenery: Scenery, arrays: Packed) -> dict[str, Json]:
    """Cumulated plastic strain of drawn nodes, as the mean over the Gauss points around each, in
    its modes.
    """
    flow = fields.flow
    cells = flow.strain.dofs // fields.dimension
    points = np.arange(flow.places).reshape(len(cells), -1)
    nodes = np.repeat(cells[:, :: fields.dimension], points.shape[1], axis=1)
    around = np.tile(points, (1, cells.shape[1] // fields.dimension))
    count = len(fields.basis) // fields.dimension
    mean = csr_matrix(
        coo_matrix((np.ones(nodes.size), (nodes.ravel(), around.ravel())), (count, flow.places))
    )
    mean = csr_matrix(mean.multiply(1 / np.maximum(mean.sum(axis=1), 1)))[scenery.nodes][
        :, flow.flowed
    ]
    strained = packed_levels("field_strained", (mean @ flow.cumulated.modes).T, arrays)
    return {"strained": strained | {"fit": arrays.put("field_fit", flow.cumulated.fit, "<f4")}}
