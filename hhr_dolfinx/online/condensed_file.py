"""Writing models of condensation, exact or interpolated: trees of plain values, see ``varying_file`` for reading."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hhr_dolfinx.errors import FileContentError, ModelFileError
from hhr_dolfinx.files import write_arrays
from hhr_dolfinx.online.layout import CONDENSED, CONDENSED_VERSION
from hhr_dolfinx.online.tree import taken_apart


def save_condensed(path: str | Path, model: Any) -> None:
    """Write a condensed model, whose ``kept`` names its parts, as one ``.npz`` file; what needs the mesh stays behind.

    Raises:
        ModelFileError: if the model cannot be read back: numbers that are not finite, amplitudes that are no data.
    """
    arrays: dict[str, np.ndarray] = {}
    parts = {name: getattr(model, name) for name in model.kept}
    parts["fields"] = replace(parts["fields"], stress_of=None)
    try:
        tree = {name: taken_apart(part, name, arrays) for name, part in parts.items()}
    except FileContentError as error:
        raise ModelFileError(f"this model cannot be kept in {path}: {error}") from error
    write_arrays(path, {"format": CONDENSED, "version": CONDENSED_VERSION, "tree": tree}, arrays)
