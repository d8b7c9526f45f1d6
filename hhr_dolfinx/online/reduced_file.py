"""What files hold of reduced models: the arrays of a table, lists of values, and what varies with the parameters.

What a file holds is written down once, in the table :data:`LAYOUT`: the same parts for elastic bodies and for bodies
that flow, those of flow only where bodies do. A file is accepted only if its arrays are those of the table, so that a
file with a valid checksum and other content is refused where it is read, not where it is first used.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix

from hhr_dolfinx.amplitudes import Amplitudes, Coverage
from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.files import check_layout
from hhr_dolfinx.linear.dense import LapackLU
from hhr_dolfinx.models.condensed import KnownStatuses
from hhr_dolfinx.models.error_bound import ErrorBound
from hhr_dolfinx.models.projected import ReducedProblem
from hhr_dolfinx.models.reconstruct import Reconstruction
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.online.flow_parts import check_flow, flow_of, flow_taken_apart, part_of_flow
from hhr_dolfinx.online.layout import (
    CONE,
    FIXED,
    FLOATING,
    INDICES,
    LAYOUT,
    MAY_BE_NONE,
    MOTIONS,
    ONTO,
    PACKED,
    SLOPES,
    TYPES,
    VALUES,
    Content,
)
from hhr_dolfinx.online.values import check_amplitudes, values_of, values_taken_apart
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.plain import by_name
from hhr_dolfinx.trained import TrainedPaths, TrainedRange

_KNOWN = ("points", "active", "margins", "slopes")


def reduced_parts(model: ReducedModel) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """A model as what JSON can hold, without format and version, and arrays by name, as :func:`reduced_of` takes them.

    Raises:
        FileContentError, SceneError: if the model itself could not be read back: numbers that are not finite, shapes
            that do not fit, laws that are no data.
    """
    laws = [group.law for group in model.flow.material.groups] if model.flow is not None else []
    functionals = model.fields.functionals
    outputs = [] if functionals is None or functionals.axes.size else list(functionals.items)
    lists: tuple[list[Any], ...] = (list(model.fields.amplitudes.nonaffine), laws, outputs)
    values = dict(zip(VALUES, lists, strict=True))
    space = model.parameters
    box = {"names": space.names, "lower": [float(x) for x in space.lower], "upper": [float(x) for x in space.upper]}
    # an indicator is code, and no file holds code
    why = (
        model.fields.unbounded
        if model.fields.indicator is None
        else "its indicator stayed behind, a file holds no code"
    )
    header: dict[str, Any] = {"parameters": box, "dimension": int(model.dimension), "unbounded": why}
    fields = _taken_apart(model)
    kinds = _kinds(fields, (), {type(item) for items in values.values() for item in items if item is not None})
    layout = _layout(fields)
    arrays = {name: np.asarray(fields[name], dtype=TYPES[kind[0]]) for name, kind in layout.items()}
    for what, items in values.items():
        header[what], own = values_taken_apart(what, items)
        arrays |= own
    _checked(header, arrays, kinds)
    if model.problem.terms is not None or model.problem.reshaped is not None:
        from hhr_dolfinx.online.varying_file import varying_parts

        header["varying"], others = varying_parts(model)
        arrays |= others
    return header, arrays


def reduced_of(header: Mapping[str, Any], arrays: Mapping[str, np.ndarray], known: Iterable[type]) -> ReducedModel:
    """The model of what :func:`reduced_parts` returned, or of what a file says of one.

    Args:
        header, arrays: see there.
        known: classes of a user's own laws and amplitudes that may come out of it.

    Raises:
        HHRError: if they are none of a model; :func:`~hhr_dolfinx.online.values.refused_if_damaged` names the file.
    """
    varying = header.get("varying")
    own = {name: value for name, value in header.items() if name != "varying"}
    others = {name: array for name, array in arrays.items() if name.startswith("varying.")}
    table = {name: array for name, array in arrays.items() if name not in others}
    if own.get("outputs"):
        from hhr_dolfinx.models.functional_kinds import KINDS

        known = [*known, *KINDS]
    kinds = _kinds(table, own.get("amplitudes"), known)
    model = _model(_checked(own, table, kinds))
    if varying is None:
        if model.fields.force_snapshots is None and model.fields.bound is None:
            raise FileContentError("neither training forces nor a bound say what forces outside the RID are")
        return model
    from hhr_dolfinx.online.varying_file import with_varying_parts

    return with_varying_parts(model, varying, others, known)


def _kinds(names: Iterable[str], amplitudes: object, own: Iterable[type]) -> dict[str, type]:
    """Classes of values that a file may hold, by name: those of this package that it may need, and a user's.

    Laws are for bodies that flow, formulas for ``amplitudes`` of a file that are some.
    """
    kinds: list[type] = [Coverage]
    if isinstance(amplitudes, list) and any(
        isinstance(item, dict) and item.get("kind") == "Scalar" for item in amplitudes
    ):
        from hhr_dolfinx.formulas import Scalar

        kinds.append(Scalar)
    if part_of_flow(names):
        from hhr_dolfinx.materials.laws import Norton, Plasticity

        kinds += [Plasticity, Norton]
    return by_name([*kinds, *own])


def _layout(names: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """The part of the table that belongs to a model: elastic or flowing, with a training or not."""
    flows, trained = part_of_flow(names), "trained.lower" in names
    parts = {"reduced", "fields", "amplitudes", *((flows, "completion") if flows else ("known",))}
    parts |= {"trained", *(("paths",) if flows else ())} if trained else set()
    parts |= {"bound"} if "bound.schur" in names else set()
    parts |= {"response"} if "response.loaded" in names else set()
    parts |= {"output_bound"} if "output_bound.steepness" in names else set()
    left_out = {CONE, MOTIONS, ONTO, *SLOPES} - set(names)
    left_out |= FIXED if FLOATING & set(names) else FLOATING
    return {name: kind for name, kind in LAYOUT.items() if name.split(".")[0] in parts and name not in left_out}


def _taken_apart(model: ReducedModel) -> dict[str, Any]:
    """Everything that the table may ask for, by name."""
    parts = {"reduced": model.problem, "fields": model.fields, "amplitudes": model.fields.amplitudes}
    values = {f"{part}.{name}": item for part, value in parts.items() for name, item in vars(value).items()}
    if model.fields.force_snapshots is None:
        del values[CONE]
    if not model.problem.motions:
        del values[MOTIONS]
    if model.known is not None:
        values |= {f"known.{name}": item for name, item in vars(model.known).items() if name in _KNOWN}
    for part in ("bound", "output_bound"):
        # bounds of a stiffness that varies are a tree of their own
        if (held := getattr(model.fields, part)) is not None and not hasattr(held, "compliances"):
            values |= {f"{part}.{name}": item for name, item in vars(held).items()}
    if (response := model.fields.response) is not None:
        values |= {f"response.{name}": item for name, item in vars(response).items() if item is not None}
    if model.trained is not None:
        range_ = getattr(model.trained, "parameters", model.trained)
        values |= {f"trained.{name}": item for name, item in vars(range_).items()}
        values |= {f"paths.{name}": item for name, item in vars(model.trained).items()}
    if model.flow is not None and model.fields.flow is not None:
        values |= flow_taken_apart(model.flow, model.fields.flow, model.parameters)
    for name in PACKED.keys() & values.keys():
        entries = coo_matrix(values[name])
        values |= {f"{name}.rows": entries.row, f"{name}.columns": entries.col, f"{name}.values": entries.data}
    return values


def _checked(header: dict, arrays: Mapping[str, np.ndarray], kinds: Mapping[str, type]) -> Content:
    """The content of a file, if it is that of a model."""
    _check_header(header)
    space, arrays = ParameterSpace(**header["parameters"]), dict(arrays)
    amplitudes, laws, outputs = (values_of(what, header[what], arrays, kinds) for what in VALUES)
    layout = _layout(arrays)
    sizes = check_layout(arrays, layout, {"P": len(space.names), "ends": 2})
    empty = [name for name, size in sizes.items() if size == 0 and name not in MAY_BE_NONE]
    if empty:
        raise FileContentError(f"sizes {empty} are zero")
    # compiled loops multiply indices, for which four bytes may be too few
    arrays = {name: arrays[name].astype(TYPES[kind[0]], copy=False) for name, kind in layout.items()}
    own = amplitudes, laws, outputs, header["unbounded"]
    content = Content(space, header["dimension"], arrays, sizes, *own)
    if part_of_flow(arrays):
        check_flow(content)
    elif content.laws:
        raise FileContentError("it has laws of flow, and nothing flows")
    for name in INDICES.keys() & layout.keys():
        array, size = arrays[name], sizes[INDICES[name]]
        if array.size and not (array.min() >= 0 and array.max() < size):
            raise FileContentError(f"{name} has indices outside 0 .. {size - 1}")
    _check_contact(content)
    if MOTIONS in arrays:
        _check_motions(arrays, sizes)
    if "bound.schur" in arrays:
        _check_bound(arrays, sizes)
    _check_columns(arrays, sizes)
    return content


def _check_header(header: dict) -> None:
    if header.keys() != {"parameters", "dimension", "unbounded", *VALUES}:
        raise FileContentError(f"its header has the keys {sorted(header)}")
    if type(header["dimension"]) is not int or header["dimension"] not in (2, 3):
        raise FileContentError(f"the dimension must be 2 or 3, not {repr(header['dimension'])[:40]}")
    if not all(isinstance(header[what], list) for what in VALUES):
        raise FileContentError(f"the {', '.join(VALUES)} in its header must be lists")
    if not isinstance(header["unbounded"], str):
        raise FileContentError("why there is no bound must be a text")
    box = header["parameters"]
    if not isinstance(box, dict) or box.keys() != {"names", "lower", "upper"}:
        raise FileContentError("the parameters must have names, lower and upper")


def _check_contact(content: Content) -> None:
    """Independent conditions; gaps that are measured; amplitudes that begin with 1 and are as many as the loads."""
    arrays, sizes = content.arrays, content.sizes
    if np.unique(arrays["fields.A_lambda"]).size < sizes["m"] or sizes["m"] > sizes["ell"]:
        raise FileContentError(f"{sizes['m']} contact conditions on {sizes['ell']} modes are dependent")
    if sizes["N"] % content.dimension:
        raise FileContentError(f"{sizes['N']} dofs are no nodes of dimension {content.dimension}")
    if not (arrays["fields.gap_scale"] > 0).all():
        raise FileContentError(f"gap_scale has the entry {arrays['fields.gap_scale'].min()}, not positive")
    if "trained.lower" in arrays and not (arrays["trained.lower"] <= arrays["trained.upper"]).all():
        raise FileContentError("the trained range ends below its start")
    affine = arrays["amplitudes.constant"], arrays["amplitudes.slopes"]
    check_amplitudes(*affine, content.amplitudes, content.space, sizes["terms"])


def _check_motions(arrays: Mapping[str, np.ndarray], sizes: Mapping[str, int]) -> None:
    """Some modes, the first ones, on which K~ is zero."""
    count, stiffness = int(arrays[MOTIONS]), arrays["reduced.stiffness"]
    if not 0 < count < sizes["ell"] or stiffness[:, :count].any() or stiffness[:count].any():
        raise FileContentError(f"{count} of {sizes['ell']} modes are no rigid motions")


def _check_columns(arrays: Mapping[str, np.ndarray], sizes: Mapping[str, int]) -> None:
    """Columns of the displacement that have coordinates, gamma or those of all forces, and are those of the bound."""
    coordinates, kept, rows = sizes["ell"], sizes["ell"], 0
    if "response.loaded" in arrays:
        if CONE in arrays or "bound.schur" not in arrays:
            raise FileContentError("its displacement is made of forces everywhere, and nothing completes them")
        rows, kept = sizes["field rows"] - sizes["N_lambda"], sizes["kept columns"] if ONTO in arrays else 0
        coordinates = (kept or sizes["N_lambda"]) + sizes.get("motions", 0)
    found = sizes["columns"], sizes.get("kept columns", kept), rows
    if found != (coordinates, kept, 0):
        raise FileContentError(f"columns of its displacement {found} are not those of its bound {coordinates, kept, 0}")


def _check_bound(arrays: Mapping[str, np.ndarray], sizes: Mapping[str, int]) -> None:
    """Directions that go on where others end, and a factor of S that is one."""
    areas, least = arrays["bound.areas"], arrays["bound.least"]
    if not ((areas >= 0).all() and (least >= 0).all() and len(least) == 3):
        raise FileContentError("areas, or three least sizes of forces, in its bound are negative or missing")
    schur, lower = arrays["bound.schur"], arrays["bound.lower"]
    if "bound.taken" in arrays:
        from hhr_dolfinx.models.floating_bound import definite

        if sizes["motions"] != int(arrays.get(MOTIONS, 0)) or not arrays["bound.taken"].any(axis=0).all():
            raise FileContentError(f"its bound has {sizes['motions']} motions of other bodies")
        schur = definite(schur, arrays["bound.taken"])
    else:
        _check_ranks(sizes)
    off = np.abs(lower @ lower.T - schur).max() / np.abs(schur).max(initial=1e-300)
    if not (off <= 1e-10 and (lower.diagonal() > 0).all() and not np.triu(lower, 1).any()):
        raise FileContentError("the factor of S in its bound is none")


def _check_ranks(sizes: Mapping[str, int]) -> None:
    """Directions that go on where others end."""
    ranks = [sizes[name] for name in ("N_lambda", "field rows", "load rows", "lift rows")]
    if ranks[: 3 if ranks[3] == 0 else 4] != sorted(ranks[: 3 if ranks[3] == 0 else 4]):
        raise FileContentError(f"directions of unit energy in its bound are not one more than another: {ranks}")


def _model(content: Content) -> ReducedModel:
    """The model of checked arrays."""
    parts: dict[str, dict[str, Any]] = {}
    for key, array in content.arrays.items():
        part, name = key.split(".", 1)
        parts.setdefault(part, {})[name] = array.item() if array.ndim == 0 else array
    for key, (form, *shape) in PACKED.items():
        part, name = key.split(".", 1)
        if part in parts:
            rows, columns, values = (parts[part].pop(f"{name}.{item}") for item in ("rows", "columns", "values"))
            entries = coo_matrix((values, (rows, columns)), shape=[content.sizes[label] for label in shape])
            parts[part][name] = entries.toarray(order=form) if form in "CF" else entries.asformat(form)
    theta = Amplitudes(**parts["amplitudes"], nonaffine=tuple(content.amplitudes))
    trained: TrainedRange | TrainedPaths | None = None
    if "trained" in parts:
        trained = range_ = TrainedRange(content.space.names, **parts["trained"])
        if "paths" in parts:
            steps = tuple(parts["paths"].pop("steps").tolist())
            trained = TrainedPaths(range_, steps=steps, **parts["paths"])
    kind = part_of_flow(content.arrays)
    flow, completion = flow_of(parts[kind], parts["completion"], content) if kind else (None, None)
    given = {"force_snapshots": None} | parts["fields"]
    given |= {"dimension": content.dimension, "unbounded": content.unbounded}
    fields = Reconstruction(theta, **given, flow=completion)
    if "bound" in parts:
        fields = replace(fields, **_bound_of(parts))
    if content.outputs:
        from hhr_dolfinx.models.functionals import Functionals

        functionals = Functionals(tuple(content.outputs), content.sizes["N"], theta)
        functionals.check(content.space, content.sizes["N_lambda"], content.sizes.get("gauss points", 0))
        fields = replace(fields, functionals=functionals)
    if "output_bound" in parts:
        from hhr_dolfinx.models.output_bound import OutputBound

        own = OutputBound(**parts["output_bound"])
        if fields.bound is None or fields.functionals is None or not own.fits(fields.functionals):
            raise FileContentError("its bounds of outputs are not those of its outputs")
        fields = replace(fields, output_bound=own)
    known = _starts_of(parts["known"]) if "known" in parts else None
    problem = ReducedProblem(**parts["reduced"])
    return ReducedModel(problem, content.space, fields, trained, known=known, flow=flow, factorise=LapackLU)


def _bound_of(parts: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """The bound, and what makes the displacement of forces where a file has it, as fields of a reconstruction."""
    if "taken" not in parts["bound"] and "response" not in parts:
        return {"bound": ErrorBound(**parts["bound"])}
    if "taken" in parts["bound"]:
        from hhr_dolfinx.models.floating_bound import FloatingBound, FloatingResponse

        return {"bound": FloatingBound(**parts["bound"]), "response": FloatingResponse(**parts["response"])}
    from hhr_dolfinx.models.field_response import FieldResponse, ResponseBound

    return {"bound": ResponseBound(**parts["bound"]), "response": FieldResponse(**parts["response"])}


def _starts_of(parts: dict[str, Any]) -> KnownStatuses:
    """Known statuses, with derivatives where a file has them."""
    if "slopes" not in parts:
        return KnownStatuses(**parts)
    from hhr_dolfinx.models.starts import LinearStarts

    return LinearStarts(**parts)
