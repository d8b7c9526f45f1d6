"""Reduced models on disk: plain arrays and numbers with a version and a checksum, nothing to execute."""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
from pathlib import Path

import numpy as np

from hhr_dolfinx.contact.condensed import KnownStatuses
from hhr_dolfinx.errors import ModelFileError
from hhr_dolfinx.online.reconstruct import OnlineModel, Reconstruction
from hhr_dolfinx.online.reduced import ReducedModel, ReducedProblem
from hhr_dolfinx.parameters import Amplitudes, Coverage, ParameterSpace

FORMAT, VERSION = "hhr_dolfinx reduced model", 4


def save_model(path: str | Path, reduction: OnlineModel) -> None:
    """Write a model as one ``.npz`` file; an existing file is replaced only by a complete one.

    Raises:
        TypeError: for what is no elastic model: those of bodies that flow have no file yet.
    """
    if not isinstance(reduction, OnlineModel):
        raise TypeError(f"a model file holds what build_reduced_model returns, not a {type(reduction).__name__}")
    model = reduction.model
    parts = {
        "reduced": model.problem,
        "reconstruction": reduction.reconstruction,
        "amplitudes": model.amplitudes,
        "known": model.known,
    }
    arrays = {
        f"{part}.{name}": np.asarray(getattr(value, name))
        for part, value in parts.items()
        for name in value.__dataclass_fields__
        if name != "coverages"
    }
    for k, coverage in enumerate(model.amplitudes.coverages):
        arrays |= {f"coverage{k}.{name}": np.asarray(value) for name, value in vars(coverage).items()}
    space = model.parameters
    header = {
        "format": FORMAT,
        "version": VERSION,
        "parameters": {"names": space.names, "lower": space.lower, "upper": space.upper},
        "dimension": reduction.dimension,
    }
    header["sha256"] = _digest(header, arrays)
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(path.name + ".part")
    with open(temporary, "wb") as file:
        np.savez(file, header=np.array(json.dumps(header)), **arrays)
    os.replace(temporary, path)


def load_model(path: str | Path) -> OnlineModel:
    """Read a model written by :func:`save_model`. Needs neither DOLFINx nor the scene.

    Raises:
        ModelFileError: if the file is missing, no model, of another version, or damaged.
    """
    header, arrays = _read(Path(path))
    groups: dict[str, dict] = {}
    for key, array in arrays.items():
        part, name = key.split(".")
        groups.setdefault(part, {})[name] = array[()] if array.ndim == 0 else array
    space = ParameterSpace(**{key: tuple(value) for key, value in header["parameters"].items()})
    coverages = tuple(Coverage(**groups[part]) for part in sorted(groups) if part.startswith("coverage"))
    model = ReducedModel(
        ReducedProblem(**groups["reduced"]),
        space,
        Amplitudes(**groups["amplitudes"], coverages=coverages),
        KnownStatuses(**groups["known"]),
    )
    return OnlineModel(model, Reconstruction(**groups["reconstruction"]), header["dimension"])


def _read(path):
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        header = json.loads(str(arrays.pop("header")))
        known = header["format"] == FORMAT, header["version"]
    except FileNotFoundError:
        raise ModelFileError(f"there is no model file {path}") from None
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise ModelFileError(f"{path} is damaged or no model file ({error}): build the model again") from error
    if known != (True, VERSION):
        raise ModelFileError(
            f"{path} holds '{header['format']}' version {header['version']}, this release reads version {VERSION}"
        )
    stored = header.pop("sha256", None)
    if stored != _digest(header, arrays):
        raise ModelFileError(f"the checksum of {path} does not match its content: build the model again")
    return header, arrays


def _digest(header, arrays) -> str:
    """Checksum over the header and every array with its name, type and shape."""
    digest = hashlib.sha256(json.dumps(header, sort_keys=True).encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
