"""Reduced and condensed models on disk.

Files have plain arrays and numbers, a version and a checksum, and nothing to execute.

One format holds all kinds of models: a tree of values in the header, and arrays by their paths in
this tree, see :mod:`hhr_dolfinx.plain`. The declarations of the fields of a class are the checks of
a file.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.errors import (
    FileContentError,
    HHRError,
    MissingPackageError,
    ModelFileError,
    ModelFileWarning,
    NotOfferedError,
    SceneError,
)
from hhr_dolfinx.files import format_of, read_arrays, write_arrays
from hhr_dolfinx.models.histories.equilibrium import facet_of
from hhr_dolfinx.models.model import KeptModel
from hhr_dolfinx.plain import add_kind, as_plain, by_name, restored
from hhr_dolfinx.warn import ignored, warn

MODEL_FORMAT = "hhr_dolfinx model"
"""Content of a file, in its header."""
MODEL_VERSION = 8
"""Version of this format, in the header too."""
MODEL_NAMES = ("model", "hhr", "condensed", "local", "study")
"""Names under which commands leave models in a folder."""
TABLE_ENDINGS = (".csv", ".parquet")
"""Endings of tables, which users give instead of a model by mistake."""

MODULES = {
    "amplitudes": "Amplitudes Coverage Limits",
    "contact.law": "Unilateral",
    "formulas": "Formula Modulus Scalar",
    "models.condensed": "CondensedModel",
    "models.eliminations.block": "BlockElimination",
    "models.eliminations.constant": "ConstantElimination",
    "models.eliminations.elimination": "Responses",
    "models.eliminations.projected": "ReducedProblem ReducedTerms",
    "models.exact": "ExactFields SolvedFields",
    "models.functionals.functional": "Functionals",
    "models.functionals.kinds": "Largest Linear Loaded LoadedShare",
    "models.reconstruct": "Reconstruction",
    "models.reduced": "ReducedModel",
    "models.starts": "KnownStatuses LinearStarts",
    "pairings.node_to_node": "NodeToNode",
    "pairings.obstacle": "Obstacle",
    "pairings.surface": "Surface",
    "parameters": "ParameterSpace",
    "trained": "TrainedRange",
}
"""Classes of the core that a file may contain, by their modules.

A module is imported when a file needs it.
"""
PLACES = {
    name: f"hhr_dolfinx.{module}:{name}"
    for module, names in MODULES.items()
    for name in names.split()
}
"""Their places by name."""


class Kinds(dict[str, type]):
    """Classes that a file may contain, loaded when they are needed.

    They are those of the core, those of plug-ins, and user-defined ones.
    """

    def __init__(self, known: Iterable[type] = ()):
        super().__init__()
        self._places = registry.named("classes") | PLACES
        for kind in by_name(known).values():
            if kind.__name__ in self._places:
                add_kind(self, registry.load(self._places[kind.__name__]))
            add_kind(self, kind)

    def __missing__(self, name: str) -> type:
        self[name] = kind = registry.load(self._places[name])
        return kind

    def __contains__(self, name: object) -> bool:
        return super().__contains__(name) or name in self._places


def save_model(path: str | Path, model: KeptModel) -> None:
    """Write a model as one ``.npz`` file.

    The model is the result of build, condense or a training of local models. An existing file is
    replaced only by a complete one. The file omits the parts that need the mesh or are code: the
    stress of elastic bodies, an indicator, the record of how the model was made. User-defined laws
    and amplitudes must be frozen dataclasses of numbers, see :mod:`hhr_dolfinx.plain`.

    Args:
        path: the file.
        model: the model.

    Raises:
        NotOfferedError: for a model that needs a mesh, or an object that is no model.
        FileError: if the file cannot be written.
        ModelFileError: if the model could not be read back: non-finite numbers, inconsistent
            shapes, or laws that are not data.

    Warns:
        ModelFileWarning: if the model has an indicator.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> hhr.save_model("pad.npz", hhr.condense(scene))
        >>> round(hhr.load_model("pad.npz").outputs({"push": 50.0})["peak"], 1)
        56.5
    """
    if not isinstance(model, KeptModel):
        reason = getattr(model, "instead", "it is no model, give what build or condense returns")
        raise NotOfferedError(f"a {type(model).__name__} cannot be kept in a file: {reason}")
    plain = model.for_file()
    if plain is not model:
        reason = "the indicator is left out: answers of the model read from it have no estimate"
        warn(f"{path} holds no code, {reason}", ModelFileWarning)
    try:
        tree, arrays = as_plain(plain, Kinds())
        write_arrays(
            path, {"format": MODEL_FORMAT, "version": MODEL_VERSION, "model": tree}, arrays
        )
    except (FileContentError, SceneError) as error:
        raise ModelFileError(f"this model cannot be kept in {path}: {error}") from error


def load_model(path: str | Path, known: Iterable[type] = ()) -> KeptModel:
    """Read a model written by :func:`save_model`.

    Needs, and loads, neither DOLFINx nor PETSc nor MPI.

    Args:
        path: the file.
        known: user-defined classes of laws, amplitudes and outputs that the file may contain; no
            others are looked up.

    Raises:
        ModelFileError: if the file is missing, no model, of another version, or damaged, or holds
            an unknown class.
        MissingPackageError: if a package that its classes need is missing, such as the compiler of
            their loops.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> hhr.save_model("pad.npz", hhr.condense(scene))
        >>> model = hhr.load_model("pad.npz")
        >>> model
        <CondensedModel: 1 parameter (push), 8 contact conditions, exact>
        >>> model.solve({"push": 50.0}).forces().shape
        (8,)
    """
    if isinstance(known, type | str) or not isinstance(known, Iterable):
        raise ModelFileError(
            f"known = {known!r} must be a list of classes, load_model(path, known=[MyLaw])"
        )
    kinds = Kinds(known)
    if Path(path).suffix == ".py":
        raise ModelFileError(
            f"{path} is a program, as scenes are, and no model: make one, hhr reduce {path}"
        )
    if Path(path).is_dir():
        raise ModelFileError(f"{path} is a folder, and a model is a file{_meant(Path(path))}")
    try:
        header, arrays = read_arrays(path, MODEL_FORMAT, MODEL_VERSION)
    except FileNotFoundError:
        raise ModelFileError(f"there is no model file {path}{_meant(Path(path).parent)}") from None
    except FileContentError as error:
        if Path(path).suffix in TABLE_ENDINGS:
            raise ModelFileError(
                f"{path} is a table and no model: the model comes first, MODEL TABLE"
            ) from error
        place = registry.named("formats").get(format_of(path))
        if place is not None:
            reader = place.partition(":")[2]
            raise ModelFileError(f"{path} is read by hhr.{reader}(path)") from error
        raise ModelFileError(f"{error}: build the model again") from error
    try:
        if header.keys() != {"format", "version", "model"}:
            raise FileContentError(f"its header has the keys {sorted(header)}")
        beside = registry.offered("mesh_beside")
        of_the_mesh = (
            {} if beside is None else {"full": beside(Path(path).absolute(), lambda: model)}
        )
        model: KeptModel = restored(header["model"], arrays, kinds, of_the_mesh)
        if not isinstance(model, KeptModel):
            raise FileContentError(f"a {type(model).__name__} is no model")
        check_answers(model)
    except ModelFileError as error:  # a class is missing in ``known``: the file itself is right
        raise ModelFileError(f"{path} cannot be read: {error}") from error
    except MissingPackageError:
        raise
    except (HHRError, MemoryError) as error:
        raise ModelFileError(
            f"{path} is damaged or no model file ({error}): build the model again"
        ) from error
    return model


def _meant(folder: Path) -> str:
    try:
        near = sorted(
            path
            for pattern in ("*.npz", "*/*.npz")
            for path in folder.glob(pattern)
            if path.stem in MODEL_NAMES
        )
    except OSError:
        return ""
    return f": did you mean {' or '.join(map(str, near[:4]))}?" if near else ""


def check_answers(model: KeptModel) -> None:
    """Solve a model in the middle of its box.

    Histories may have no answer there.

    Raises:
        FileContentError: if the model fails there.
    """
    with ignored(Warning), np.errstate(all="ignore"):
        for member in model.members:
            try:
                _try(member, member.parameters.middle)
            except HHRError:
                raise
            except Exception as error:  # user-defined classes may raise anything
                reason = f"{type(error).__name__}: {error}"
                raise FileContentError(
                    f"its parts do not go together, or a class of a plug-in fails: {reason}"
                ) from error


def _try(model: KeptModel, point: np.ndarray) -> None:
    answer = model.solve(point, outside="ignore", raise_on_failure=False)
    with suppress(NotOfferedError):  # a model of forces alone
        if answer.converged and not np.isfinite(answer.displacement()).all():
            raise FileContentError("its displacement in the middle of the box is not finite")
        answer.forces()
        answer.estimate()
    if answer.converged and model.equilibrium is not None:
        facet_of(model.equilibrium, "file", "a model file")(answer)
    if model.fields.functionals is not None:
        with suppress(NotOfferedError):  # outputs of displacements for a model of forces alone
            answer.outputs()
    if model.equilibrium is None:
        with suppress(HHRError):  # the answer may have a kink there, and no gradient
            model.solve(point, gradient=True, outside="ignore", raise_on_failure=False)
