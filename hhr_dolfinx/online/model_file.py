"""Reduced models on disk: plain arrays and numbers with a version and a checksum, nothing to execute.

What a file holds is written down once, in the table :data:`LAYOUT`. A file is accepted only if its arrays are those
of the table, so that a file with a valid checksum and other content is refused where it is read, not where it is
first used.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.sparse import csc_matrix

from hhr_dolfinx.errors import FileContentError, HHRError, ModelFileError
from hhr_dolfinx.files import check_layout, read_arrays, write_arrays
from hhr_dolfinx.models.condensed import KnownStatuses
from hhr_dolfinx.models.reconstruct import OnlineModel, Reconstruction
from hhr_dolfinx.models.reduced import ReducedModel, ReducedProblem
from hhr_dolfinx.parameters import Amplitudes, Coverage, ParameterSpace
from hhr_dolfinx.trained import TrainedRange

FORMAT, VERSION = "hhr_dolfinx reduced model", 6

LAYOUT = {
    "reduced.stiffness": ("float", "ell", "ell"),
    "reduced.contact_test": ("float", "m", "ell"),
    "reduced.contact_trial": ("float", "m", "ell"),
    "reduced.loads": ("float", "ell", "terms"),
    "reduced.gaps": ("float", "m", "terms"),
    "reduced.pairs": ("int", "m"),
    "reconstruction.basis": ("float", "N", "ell"),
    # imposed displacements move few dofs, and most terms none: only what is not zero is kept
    "reconstruction.lifts.rows": ("int", "lifted"),
    "reconstruction.lifts.columns": ("int", "lifted"),
    "reconstruction.lifts.values": ("float", "lifted"),
    "reconstruction.contact_basis": ("float", "N_lambda", "ell"),
    "reconstruction.gaps": ("float", "N_lambda", "terms"),
    "reconstruction.A_lambda": ("int", "m"),
    "reconstruction.force_snapshots": ("float", "N_lambda", "force snapshots"),
    "reconstruction.gap_scale": ("float", "N_lambda"),
    "amplitudes.constant": ("float", "affine terms"),
    "amplitudes.slopes": ("float", "affine terms", "P"),
    "known.points": ("float", "S", "P"),
    "known.active": ("bool", "S", "m"),
    "trained.lower": ("float", "P"),
    "trained.upper": ("float", "P"),
}
"""Arrays of a file by name: kind, then the names of their sizes; the same name is the same size everywhere.

A field that is added to a part needs one line here.
"""

INDICES = {
    "reconstruction.lifts.rows": "N",
    "reconstruction.lifts.columns": "terms",
    "reconstruction.A_lambda": "N_lambda",
}
"""Arrays of indices: each must be at least 0 and below the size of this name."""

_COVERAGE = {
    "positions": ("float", "nodes"),
    "extent": ("int",),
    "constant": ("float",),
    "slopes": ("float", "P"),
}
_PARTS = {
    "reduced": ReducedProblem,
    "reconstruction": Reconstruction,
    "amplitudes": Amplitudes,
    "known": KnownStatuses,
}
_TYPES = {"float": np.float64, "int": np.int64, "bool": np.bool_}
_MAY_BE_NONE = {"lifted", "force snapshots"}


def save_model(path: str | Path, reduction: OnlineModel) -> None:
    """Write a model as one ``.npz`` file; an existing file is replaced only by a complete one.

    Raises:
        TypeError: for what is no elastic model: those of bodies that flow have no file yet.
        FileError: if the file cannot be written.
        ModelFileError: if the model itself could not be read back: numbers that are not finite, shapes that do
            not fit.
    """
    if not isinstance(reduction, OnlineModel):
        raise TypeError(f"a model file holds what build_reduced_model returns, not a {type(reduction).__name__}")
    model = reduction.model
    parts = {
        "reduced": model.problem,
        "reconstruction": reduction.reconstruction,
        "amplitudes": model.amplitudes,
        "known": model.known,
        "trained": model.trained or TrainedRange.of(model.known.points, model.parameters),
    }
    fields = {f"{part}.{name}": getattr(value, name) for part, value in parts.items() for name in vars(value)}
    fields |= {f"reconstruction.lifts.{name}": value for name, value in _packed(fields["reconstruction.lifts"]).items()}
    for k, coverage in enumerate(model.amplitudes.nonaffine):
        if not isinstance(coverage, Coverage):
            raise ModelFileError(
                f"a file holds affine amplitudes and partial pressures only, not {coverage!r}: keep the snapshots, and "
                "build the model where it is needed"
            )
        fields |= {f"coverage{k}.{name}": value for name, value in vars(coverage).items()}
    layout = _layout(len(model.amplitudes.nonaffine))
    arrays = {name: np.asarray(fields[name], dtype=_TYPES[kind[0]]) for name, kind in layout.items()}
    space = model.parameters
    header = {
        "format": FORMAT,
        "version": VERSION,
        "parameters": {
            "names": list(space.names),
            "lower": [float(value) for value in space.lower],
            "upper": [float(value) for value in space.upper],
        },
        "dimension": int(reduction.dimension),
    }
    try:
        header["sizes"] = check_layout(arrays, layout, {"P": len(space.names)})
        _check(header, arrays)
        write_arrays(path, header, arrays)
    except FileContentError as error:
        raise ModelFileError(f"this model cannot be kept in {path}: {error}") from error


def load_model(path: str | Path) -> OnlineModel:
    """Read a model written by :func:`save_model`. Needs neither DOLFINx nor the scene.

    Raises:
        ModelFileError: if the file is missing, no model, of another version, or damaged.
    """
    try:
        header, arrays = read_arrays(path, FORMAT, VERSION)
    except FileNotFoundError:
        raise ModelFileError(f"there is no model file {path}") from None
    except FileContentError as error:
        raise ModelFileError(f"{error}: build the model again") from error
    try:
        sizes = _check(header, arrays)
        return _model(header, arrays, sizes)
    except (HHRError, MemoryError) as error:
        raise ModelFileError(f"{path} is damaged or no model file ({error}): build the model again") from error


def _layout(coverages: int) -> dict[str, tuple[str, ...]]:
    """Table of a file with some pressures on a part of a line."""
    more = {
        f"coverage{k}.{name}": tuple(f"nodes{k}" if item == "nodes" else item for item in kind)
        for k in range(coverages)
        for name, kind in _COVERAGE.items()
    }
    return LAYOUT | more


def _check(header: dict, arrays: dict[str, np.ndarray]) -> dict[str, int]:
    """Check that header and arrays are those of a model; returns all sizes by name.

    Raises:
        FileContentError: with what is wrong.
    """
    _check_header(header)
    coverages = sum(name.startswith("coverage") and name.endswith(".extent") for name in arrays)
    layout = _layout(coverages)
    sizes = check_layout(arrays, layout, header["sizes"])
    named = {label for _, *dimensions in layout.values() for label in dimensions}
    if header["sizes"].keys() != named or sizes["P"] != len(header["parameters"]["names"]):
        raise FileContentError("the sizes in its header are not those of its arrays and parameters")
    empty = [name for name, size in sizes.items() if size == 0 and name not in _MAY_BE_NONE]
    if empty:
        raise FileContentError(f"sizes {empty} are zero")
    for name, bound in INDICES.items():
        _check_indices(name, arrays[name], sizes[bound])
    if np.unique(arrays["reconstruction.A_lambda"]).size < sizes["m"] or sizes["m"] > sizes["ell"]:
        raise FileContentError(f"{sizes['m']} contact conditions on {sizes['ell']} modes are dependent")
    if sizes["N"] % header["dimension"]:
        raise FileContentError(f"{sizes['N']} dofs are no nodes of dimension {header['dimension']}")
    if not (arrays["reconstruction.gap_scale"] > 0).all():
        raise FileContentError(f"gap_scale has the entry {arrays['reconstruction.gap_scale'].min()}, not positive")
    if not (arrays["trained.lower"] <= arrays["trained.upper"]).all():
        raise FileContentError("the trained range ends below its start")
    if arrays["amplitudes.constant"][0] != 1 or arrays["amplitudes.slopes"][0].any():
        raise FileContentError("the first amplitude must be the constant 1")
    _check_coverages(arrays, sizes, coverages)
    return sizes


def _check_header(header):
    if header.keys() != {"format", "version", "parameters", "dimension", "sizes"}:
        raise FileContentError(f"its header has the keys {sorted(header)}")
    sizes = header["sizes"]
    if not isinstance(sizes, dict) or not all(type(size) is int for size in sizes.values()):
        raise FileContentError("the sizes in its header must be integers")
    if type(header["dimension"]) is not int or header["dimension"] not in (2, 3):
        raise FileContentError(f"the dimension must be 2 or 3, not {repr(header['dimension'])[:40]}")
    box, kinds = header["parameters"], {"names": str, "lower": float, "upper": float}
    if not isinstance(box, dict) or box.keys() != kinds.keys():
        raise FileContentError(f"the parameters must have {list(kinds)}")
    for key, kind in kinds.items():
        if not isinstance(box[key], list) or not all(type(item) is kind for item in box[key]):
            raise FileContentError(f"{key} of the parameters must be a list of {kind.__name__}")
    if len(set(box["names"])) < len(box["names"]):
        raise FileContentError(f"two parameters of {box['names']} have one name")


def _check_coverages(arrays, sizes, coverages):
    """Terms of partial pressures follow the affine ones, each on a line that goes up."""
    terms = sizes["affine terms"]
    for k in range(coverages):
        _check_indices(f"coverage{k}.extent", arrays[f"coverage{k}.extent"], sizes["P"])
        positions = arrays[f"coverage{k}.positions"]
        if positions.size < 2 or not all(low < high for low, high in pairwise(positions.tolist())):
            raise FileContentError(f"coverage{k}.positions must be at least two and increase")
        terms += 2 * positions.size - 1
    if terms != sizes["terms"]:
        raise FileContentError(f"the amplitudes are {terms}, the terms of the loads {sizes['terms']}")


def _check_indices(name, array, size):
    if array.size and not (array.min() >= 0 and array.max() < size):
        raise FileContentError(f"{name} has indices outside 0 .. {size - 1}")


def _model(header: dict, arrays: dict[str, np.ndarray], sizes: dict[str, int]) -> OnlineModel:
    """The model of checked arrays."""
    groups: dict[str, dict] = {}
    for key, array in arrays.items():
        part, name = key.split(".", 1)
        groups.setdefault(part, {})[name] = array.item() if array.ndim == 0 else array
    fields = groups["reconstruction"]
    rows, columns, values = (fields.pop(f"lifts.{name}") for name in ("rows", "columns", "values"))
    fields["lifts"] = csc_matrix((values, (rows, columns)), shape=(sizes["N"], sizes["terms"]))
    count = sum(part.startswith("coverage") for part in groups)
    coverages = tuple(Coverage(**groups[f"coverage{k}"]) for k in range(count))
    groups["amplitudes"]["nonaffine"] = coverages
    parts = {part: kind(**groups[part]) for part, kind in _PARTS.items()}
    space = ParameterSpace(**{key: tuple(values) for key, values in header["parameters"].items()})
    trained = TrainedRange(space.names, **groups["trained"])
    model = ReducedModel(parts["reduced"], space, parts["amplitudes"], parts["known"], trained=trained)
    return OnlineModel(model, parts["reconstruction"], header["dimension"])


def _packed(matrix: csc_matrix) -> dict[str, np.ndarray]:
    """Entries of a sparse matrix."""
    entries = matrix.tocoo()
    return {"rows": entries.row, "columns": entries.col, "values": entries.data}
