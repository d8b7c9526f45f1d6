"""Reduced models on disk: plain arrays and numbers with a version and a checksum, nothing to execute.

Each kind of model has a format of its own, by which its file is known: ``reduced_file``, ``local_file`` for sets of
such models, and ``varying_file`` and ``condensed_flow_file`` for condensed models, which keep all contact conditions.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hhr_dolfinx.errors import FileContentError, ModelFileError, ModelFileWarning, SceneError
from hhr_dolfinx.files import read_arrays, write_arrays
from hhr_dolfinx.models.local import LocalModels
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.online.layout import (
    CONDENSED,
    CONDENSED_FLOW,
    CONDENSED_FLOW_VERSION,
    CONDENSED_VERSION,
    FORMAT,
    LOCAL,
    LOCAL_VERSION,
    VERSION,
)
from hhr_dolfinx.online.reduced_file import reduced_of, reduced_parts
from hhr_dolfinx.online.values import refused_if_damaged

if TYPE_CHECKING:
    from hhr_dolfinx.models.condensed_flow_model import CondensedFlowModel
    from hhr_dolfinx.models.varying import VaryingModel

OTHERS = {CONDENSED: CONDENSED_VERSION, CONDENSED_FLOW: CONDENSED_FLOW_VERSION, LOCAL: LOCAL_VERSION}
"""Formats of other models than single reduced ones, with their versions."""


def save_model(path: str | Path, model: ReducedModel | LocalModels | VaryingModel | CondensedFlowModel) -> None:
    """Write what build, condense or a training of local models return as one ``.npz`` file.

    An existing file is replaced only by a complete one. What needs the mesh or is code stays behind: the stress of
    elastic bodies, an indicator, the record of how the model was made. Laws and amplitudes of a user's own must be
    frozen dataclasses of numbers, see :mod:`hhr_dolfinx.plain`.

    Raises:
        TypeError: for what is no reduced model.
        FileError: if the file cannot be written.
        ModelFileError: if the model itself could not be read back: numbers that are not finite, shapes that do
            not fit, laws that are no data.

    Warns:
        ModelFileWarning: if the model has an indicator.
    """
    if not isinstance(model, ReducedModel | LocalModels):
        _save_condensed(path, model)
        return
    models = model.models if isinstance(model, LocalModels) else (model,)
    if any(one.fields.indicator is not None for one in models):
        why = "the indicator stays behind: answers of the model read from it have no estimate"
        warnings.warn(f"{path} holds no code, {why}", ModelFileWarning, stacklevel=2)
    try:
        if isinstance(model, LocalModels):
            from hhr_dolfinx.online.local_file import local_parts

            header, arrays = local_parts(model)
        else:
            own, arrays = reduced_parts(model)
            header = {"format": FORMAT, "version": VERSION, **own}
        write_arrays(path, header, arrays)
    except (FileContentError, SceneError) as error:
        raise ModelFileError(f"this model cannot be kept in {path}: {error}") from error


def _save_condensed(path: str | Path, model: Any) -> None:
    """Write a model that keeps all contact conditions; what it needs is imported here."""
    if hasattr(model, "eliminated"):
        from hhr_dolfinx.online.varying_file import save_condensed

        save_condensed(path, model)
    elif hasattr(model, "flow") and hasattr(model, "equilibrium"):
        from hhr_dolfinx.online.condensed_flow_file import save_condensed_flow

        save_condensed_flow(path, model)
    else:
        raise TypeError(f"a model file holds what build returns, a ReducedModel, not a {type(model).__name__}")


def load_model(
    path: str | Path, known: Iterable[type] = ()
) -> ReducedModel | LocalModels | VaryingModel | CondensedFlowModel:
    """Read a model written by :func:`save_model`. Needs neither DOLFINx nor the scene.

    Args:
        path: the file.
        known: classes of a user's own laws and amplitudes that may come out of the file; none else is looked up.

    Raises:
        ModelFileError: if the file is missing, no model, of another version, or damaged, or holds an unknown class.
        MissingPackageError: for a model of bodies that flow, where what compiles their loops is missing.
    """
    if isinstance(known, type | str) or not isinstance(known, Iterable):
        raise ModelFileError(f"known = {known!r} must be a list of classes, load_model(path, known=[MyLaw])")
    try:
        header, arrays = read_arrays(path, FORMAT, VERSION, OTHERS)
    except FileNotFoundError:
        raise ModelFileError(f"there is no model file {path}") from None
    except FileContentError as error:
        raise ModelFileError(f"{error}: build the model again") from error
    if header["format"] == CONDENSED:
        from hhr_dolfinx.online.varying_file import condensed_of

        return condensed_of(path, header, arrays, known)
    if header["format"] == CONDENSED_FLOW:
        from hhr_dolfinx.online.condensed_flow_file import condensed_flow_of

        return condensed_flow_of(path, header, arrays, known)
    if header["format"] == LOCAL:
        from hhr_dolfinx.online.local_file import local_of

        return local_of(path, header, arrays, known)
    own = {name: value for name, value in header.items() if name not in ("format", "version")}
    with refused_if_damaged(path):
        return reduced_of(own, arrays, known)
