"""What files hold of models of condensed flow: a tree of plain values, and lists of laws, amplitudes and outputs.

Nearly all of it completes fields on the whole mesh. The fuel pellet of ``demos/pellet_cladding_plastic.py`` (13,708
dofs, 101 conditions, 155 terms, trained on two histories of 40 steps) takes 77 MB: 21 MB are modes of the plastic
strain, 17 MB K^-1 F, 11 MB K^-1 B^T, 7 MB strains of all cells, and 4 MB all that a step needs. It is read in 0.3 s.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hhr_dolfinx.amplitudes import Amplitudes, Coverage
from hhr_dolfinx.errors import FileContentError, ModelFileError, SceneError
from hhr_dolfinx.files import write_arrays
from hhr_dolfinx.formulas import Modulus, Scalar
from hhr_dolfinx.materials.laws import Norton, Plasticity
from hhr_dolfinx.materials.strain import StrainOperator
from hhr_dolfinx.materials.update import Group
from hhr_dolfinx.models.condensed_fields import CondensedFlowFields
from hhr_dolfinx.models.condensed_flow import CondensedFlow, PartFactors
from hhr_dolfinx.models.condensed_flow_model import CondensedFlowModel
from hhr_dolfinx.models.functional_kinds import KINDS as FUNCTIONALS
from hhr_dolfinx.models.functionals import Functionals
from hhr_dolfinx.models.plastic_fields import PlasticFields
from hhr_dolfinx.models.reconstruct import GappyField
from hhr_dolfinx.online.condensed_flow_checks import Content, checked
from hhr_dolfinx.online.layout import CONDENSED_FLOW, CONDENSED_FLOW_VERSION, VALUES
from hhr_dolfinx.online.layout import CONDENSED_FLOW_GIVEN as GIVEN
from hhr_dolfinx.online.tree import put_together
from hhr_dolfinx.online.values import refused_if_damaged, values_of, values_taken_apart
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.plain import by_name
from hhr_dolfinx.trained import TrainedPaths, TrainedRange

KINDS = (
    Amplitudes, CondensedFlow, CondensedFlowFields, GappyField, Group, Modulus, ParameterSpace, PartFactors,
    PlasticFields, StrainOperator, TrainedPaths, TrainedRange,
)  # fmt: skip
"""Classes that may come out of the tree; those of lists are others."""
VALUE_KINDS = (Coverage, Scalar, Plasticity, Norton, *FUNCTIONALS)


def save_condensed_flow(path: str | Path, model: Any) -> None:
    """Write a model of condensed flow as one ``.npz`` file.

    Raises:
        TypeError: for another model.
        ModelFileError: if the model cannot be read back: numbers that are not finite, shapes that do not fit, laws,
            amplitudes or outputs of a user's own that are no data.
    """
    if not isinstance(model, CondensedFlowModel):
        raise TypeError(f"a model file holds what build or condense return, not a {type(model).__name__}")
    flow, fields = model.flow, model.fields
    outputs = [] if fields.functionals is None else list(fields.functionals.items)
    laws = [group.law for group in flow.groups]
    lists: tuple[list[Any], ...] = (list(fields.amplitudes.nonaffine), laws, outputs)
    plain = replace(fields, amplitudes=replace(fields.amplitudes, nonaffine=()), functionals=None)
    lawless = tuple(replace(group, law=None) for group in flow.groups)
    content = Content(model.parameters, replace(flow, groups=lawless), plain, model.trained, *lists)
    header: dict[str, Any] = {"format": CONDENSED_FLOW, "version": CONDENSED_FLOW_VERSION}
    try:
        header["tree"], arrays = checked(content)
        _leave_out_zeros(arrays)
        for what, items in zip(VALUES, lists, strict=True):
            header[what], own = values_taken_apart(what, items)
            arrays |= own
    except (FileContentError, SceneError) as error:
        raise ModelFileError(f"this model cannot be kept in {path}: {error}") from error
    write_arrays(path, header, arrays)


def condensed_flow_of(
    path: str | Path, header: dict[str, Any], arrays: dict[str, np.ndarray], known: Iterable[type]
) -> CondensedFlowModel:
    """The model of a file written by :func:`save_condensed_flow`.

    Args:
        path: of the file, for messages.
        header, arrays: its content.
        known: classes of a user's own laws, amplitudes and outputs that may come out of it.

    Raises:
        ModelFileError: if it is damaged, or holds an unknown class.
    """
    kinds = by_name([*VALUE_KINDS, *known])
    with refused_if_damaged(path):
        if header.keys() != {"format", "version", "tree", *VALUES}:
            raise FileContentError(f"its header has the keys {sorted(header)}")
        if not all(isinstance(header[what], list) for what in VALUES):
            raise FileContentError(f"the {', '.join(VALUES)} in its header must be lists")
        lists = [values_of(what, header[what], arrays, kinds) for what in VALUES]
        try:
            return _tried(_model(_content(header["tree"], arrays, lists)))
        except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
            raise FileContentError(str(error)) from error


def _content(tree: Any, arrays: dict[str, np.ndarray], lists: list[list[Any]]) -> Content:
    """What a file holds, checked; its arrays must be those of the table and no others."""
    names = ("parameters", "flow", "fields", "trained")
    if not isinstance(tree, dict) or tree.keys() != set(names):
        raise FileContentError(f"its tree must hold {', '.join(names)}")
    _put_zeros_back(arrays)
    parts = [put_together(tree[name], arrays, by_name(KINDS)) for name in names]
    content = Content(*parts, *lists)
    _, used = checked(content)
    if used.keys() != arrays.keys():
        raise FileContentError(f"arrays {sorted(arrays.keys() ^ used.keys())[:5]} are unknown or missing")
    return content


def _model(content: Content) -> CondensedFlowModel:
    """The model of checked content; what stands twice is made once."""
    flow, fields = content.flow, content.fields
    laws = zip(flow.groups, content.laws, strict=True)
    flow = replace(flow, groups=tuple(replace(group, law=law) for group, law in laws))
    theta = replace(fields.amplitudes, nonaffine=tuple(content.amplitudes))
    completion = replace(fields.flow, points=flow.points)
    fields = replace(fields, amplitudes=theta, factors=flow.factors, flow=completion)
    if content.outputs:
        functionals = Functionals(tuple(content.outputs), len(fields.basis), theta)
        functionals.check(content.parameters, len(flow.gaps), completion.gauss_points)
        fields = replace(fields, functionals=functionals)
    return CondensedFlowModel(flow, content.parameters, fields, content.trained)


def _tried(model: CondensedFlowModel) -> CondensedFlowModel:
    """The model, if it can be asked in the middle of its box; a single step from rest there may be too long for it."""
    middle = np.mean([model.parameters.lower, model.parameters.upper], axis=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        answer = model.solve(middle, outside="ignore", raise_on_failure=False)
        if answer.converged:
            _ = answer.displacement(), answer.stress(), answer.plastic_strain()
        if model.fields.functionals is not None:
            answer.outputs()
    return model


def _leave_out_zeros(arrays: dict[str, np.ndarray]) -> None:
    """Of arrays that are mostly zero keep places, row by row, and values; those of zeros with a sign too."""
    for name in GIVEN:
        flat = arrays.pop(name).ravel()
        places = np.flatnonzero((flat != 0) | np.signbit(flat))
        arrays[f"{name}.places"], arrays[f"{name}.values"] = places, flat[places]


def _put_zeros_back(arrays: dict[str, np.ndarray]) -> None:
    """The arrays of :func:`_leave_out_zeros`, each of the shape of one that is kept whole."""
    names = {*GIVEN.values(), *(f"{name}.{part}" for name in GIVEN for part in ("places", "values"))}
    if names - arrays.keys() or GIVEN.keys() & arrays.keys():
        raise FileContentError(f"arrays {sorted(names - arrays.keys())} are missing")
    for name, like in GIVEN.items():
        places, values, shape = arrays.pop(f"{name}.places"), arrays.pop(f"{name}.values"), arrays[like].shape
        if places.ndim != 1 or places.shape != values.shape or places.dtype.kind != "i" or values.dtype.kind != "f":
            raise FileContentError(f"{name} must have places and values, one for each")
        inside = not places.size or (places[0] >= 0 and places[-1] < math.prod(shape) and (np.diff(places) > 0).all())
        if not inside:
            raise FileContentError(f"{name} has places outside of it, or twice")
        whole = np.zeros(shape)
        whole.ravel()[places] = values
        arrays[name] = whole
