"""Models with heat in files: plain arrays and numbers, with a version and a checksum."""

from __future__ import annotations

from pathlib import Path

from hhr_dolfinx.errors import FileContentError, HHRError, ModelFileError, NotOfferedError
from hhr_dolfinx.files import read_arrays, write_arrays
from hhr_dolfinx.online.model_file import Kinds
from hhr_dolfinx.plain import as_plain, restored
from hhr_dolfinx.plugins.contact_heat.model import HeatModel
from hhr_dolfinx.plugins.contact_heat.parts import HeatParts, TransientParts
from hhr_dolfinx.plugins.contact_heat.transient import TransientHeatModel

HEAT_FORMAT = "hhr_dolfinx heat model"
"""Content of a file, in its header."""
HEAT_VERSION = 1
"""Version of this format."""


def save_heat_model(path: str | Path, model: HeatModel | TransientHeatModel) -> None:
    """Write a model with heat as one ``.npz`` file; stress needs the mesh, and stays out.

    Args:
        path: the file.
        model: the model.

    Raises:
        NotOfferedError: for another object.
        FileError: if the file cannot be written.
    """
    if not isinstance(model, (HeatModel, TransientHeatModel)):
        raise NotOfferedError(
            f"a {type(model).__name__} is no model with heat: hhr.save_model keeps other ones"
        )
    parts = model.parts if isinstance(model, HeatModel) else model.transient
    tree, arrays = as_plain(parts, Kinds())
    write_arrays(path, {"format": HEAT_FORMAT, "version": HEAT_VERSION, "model": tree}, arrays)


def load_heat_model(path: str | Path) -> HeatModel | TransientHeatModel:
    """Read a model with heat; needs neither DOLFINx nor PETSc nor MPI.

    Args:
        path: the file.

    Raises:
        ModelFileError: if the file is missing, damaged, of another version or no such model.
    """
    try:
        header, arrays = read_arrays(path, HEAT_FORMAT, HEAT_VERSION)
        parts = restored(header["model"], arrays, Kinds())
        if isinstance(parts, TransientParts):
            return TransientHeatModel(parts)
        if not isinstance(parts, HeatParts):
            raise FileContentError(f"a {type(parts).__name__} is no model with heat")
        return HeatModel(parts)
    except FileNotFoundError:
        raise ModelFileError(f"there is no model file {path}") from None
    except ModelFileError:
        raise
    except (HHRError, MemoryError, KeyError, ValueError) as error:
        raise ModelFileError(f"{path} is damaged or no model with heat ({error})") from error
