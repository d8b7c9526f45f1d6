"""Conversion of command-line words to scenes, models and points; errors are one sentence."""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hhr_dolfinx.by_name import find
from hhr_dolfinx.errors import FileError, ParameterError, SceneError
from hhr_dolfinx.files import replacing
from hhr_dolfinx.parameters import ParameterSpace

if TYPE_CHECKING:
    from hhr_dolfinx.scene import Scene


def scene_of(name: str) -> Scene:
    """The scene of ``file.py``, ``file.py:name`` or an entry point: a Scene, or a function that
    returns one.
    """
    from hhr_dolfinx.scene import Scene

    found = find("scenes", name)
    if inspect.isfunction(found):
        if needed := _needed(found):
            raise SceneError(
                f"{name}: the function needs {', '.join(needed)}; give them defaults, or name "
                "another one"
            )
        found = found()
    if not isinstance(found, Scene):
        raise SceneError(f"{name} is {type(found).__name__} and no Scene: name one, 'file.py:name'")
    return found


def _needed(function: Any) -> list[str]:
    """Names of the arguments without a default."""
    arguments = inspect.signature(function).parameters.values()
    several = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    return [
        item.name for item in arguments if item.default is item.empty and item.kind not in several
    ]


def beside(name: str, attribute: str) -> Any:
    """Another attribute of a scene's file, such as ``SETTINGS`` or ``VIEW``.

    None without it or without a file.
    """
    path = name.rpartition(":")[0] if ":" in name else name
    if not path.endswith(".py"):
        return None
    try:
        return find("scenes", f"{path}:{attribute}")
    except SceneError:
        return None


def value_of(found: Any, name: str, attribute: str, kind: type) -> Any:
    """``SETTINGS`` or ``VIEW`` as found :func:`beside` a scene, a value or a function that makes
    it, or None.

    Raises:
        SceneError: if it is of another class, or the function needs arguments.
    """
    if inspect.isfunction(found):
        if needed := _needed(found):
            raise SceneError(
                f"{attribute} beside {name} needs {', '.join(needed)}; give them defaults"
            )
        found = found()
    if found is not None and not isinstance(found, kind):
        what = f"the class {found.__name__}" if isinstance(found, type) else type(found).__name__
        raise SceneError(f"{attribute} beside {name} must be hhr.{kind.__name__}, and is {what}")
    return found


def point_of(words: Iterable[str], space: ParameterSpace, others: Any = None) -> dict[str, float]:
    """A point from ``name=value`` words, one or several in each, separated by commas.

    ParameterError for wrong ones.

    ``others`` are values of the parameters that are not named, (P,); None if all must be.
    """
    found: dict[str, float] = {}
    for word in (part.strip() for given in words for part in given.split(",") if part.strip()):
        name, equals, text = (piece.strip() for piece in word.partition("="))
        try:
            value = float(text)
        except ValueError:
            value = None
        if not equals or value is None:
            raise ParameterError(
                f"'{word}' gives no parameter a number: write --at {space.names[0]}=0.5, with a "
                "decimal point"
            )
        if name not in space.names or name in found:
            raise ParameterError(
                f"'{name}' is {'there twice' if name in found else 'no parameter'}: there are "
                f"{', '.join(space.names)}"
            )
        found[name] = value
    missing = [name for name in space.names if name not in found]
    if others is not None:
        found |= {
            name: float(value)
            for name, value in zip(space.names, others, strict=True)
            if name in missing
        }
    elif missing:
        ends = zip(space.names, space.lower, space.upper, strict=True)
        bounds = ", ".join(
            f"{name} in [{low:g}, {high:g}]" for name, low, high in ends if name in missing
        )
        raise ParameterError(
            f"no value is given for {bounds}: add --at "
            f"{','.join(f'{name}=...' for name in missing)}"
        )
    return found


def is_model(name: str) -> bool:
    """True for the name of a model in a file, or of a folder, which is refused with a message when
    it is read.
    """
    return Path(name).suffix == ".npz" or Path(name).is_dir()


def model_of(path: str | Path, known: Iterable[str] = ()) -> Any:
    """The model of a file, with user-defined classes, each of ``file.py:name`` or an entry
    point.
    """
    from hhr_dolfinx.online.model_file import load_model

    classes = [find("laws", name) for name in known]
    for name, found in zip(known, classes, strict=True):
        if not isinstance(found, type):
            raise SceneError(
                f"--known {name} is {type(found).__name__} and no class: name one, --known "
                "law.py:MyLaw"
            )
    return load_model(path, known=classes)


def checked_target(path: Path | None, endings: tuple[str, ...]) -> None:
    """Refuse with a FileError, before anything is computed, a file that could not be written
    afterwards.
    """
    if path is None:
        return
    if path.suffix not in endings:
        raise FileError(f"{path} must end in {' or '.join(endings)}")
    if path.is_dir():
        raise FileError(f"{path} is a folder: choose another name")
    with suppress(_Enough), replacing(path):
        raise _Enough  # an existing file is not replaced


class _Enough(Exception):
    """Signal that the file can be written."""
