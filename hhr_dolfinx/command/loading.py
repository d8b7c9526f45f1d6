"""Conversion of command-line words to scenes, models and points; errors are one sentence."""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from hhr_dolfinx import registry
from hhr_dolfinx.by_name import find
from hhr_dolfinx.errors import FileError, ParameterError, SceneError
from hhr_dolfinx.files import format_of, replacing
from hhr_dolfinx.parameters import ParameterSpace

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np

    from hhr_dolfinx.scene import Scene

T = TypeVar("T")


def scene_of(name: str) -> Scene:
    """The scene of ``file.py``, ``file.py:name`` or an entry point: a Scene, or a function that
    returns one.

    Raises:
        SceneError: if the name stands for something else, or the function needs arguments.
    """
    from hhr_dolfinx.scene import Scene

    scene = find("scenes", name)
    if inspect.isfunction(scene):
        if needed := _needed(scene):
            raise SceneError(
                f"{name}: the function needs {', '.join(needed)}; give them defaults, or name "
                "another one"
            )
        scene = scene()
    if not isinstance(scene, Scene):
        raise SceneError(f"{name} is {type(scene).__name__} and no Scene: name one, 'file.py:name'")
    return scene


def _needed(function: Callable[..., object]) -> list[str]:
    """Names of the arguments without a default."""
    arguments = inspect.signature(function).parameters.values()
    several = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    return [
        argument.name
        for argument in arguments
        if argument.default is argument.empty and argument.kind not in several
    ]


def beside(name: str, attribute: str) -> Any:
    """Another attribute of a scene's file, such as ``SETTINGS`` or ``VIEW``.

    None without it or without a file.

    Args:
        name: name of the scene on the command line.
        attribute: name of the attribute.
    """
    path = name.rpartition(":")[0] if ":" in name else name
    if not path.endswith(".py"):
        return None
    try:
        return find("scenes", f"{path}:{attribute}")
    except SceneError:
        return None


def value_of(
    found: T | Callable[[], T] | None, name: str, attribute: str, kind: type[T]
) -> T | None:
    """``SETTINGS`` or ``VIEW`` as found :func:`beside` a scene, a value or a function that makes
    it, or None.

    Args:
        found: the attribute of the file.
        name: name of the scene, for the message.
        attribute: name of the attribute, for the message.
        kind: class of the value.

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
        described = (
            f"the class {found.__name__}" if isinstance(found, type) else type(found).__name__
        )
        raise SceneError(
            f"{attribute} beside {name} must be hhr.{kind.__name__}, and is {described}"
        )
    return found


def point_of(
    words: Iterable[str], space: ParameterSpace, others: np.ndarray | None = None
) -> dict[str, float]:
    """Point of the parameters from ``name=value`` words.

    Args:
        words: one or several ``name=value`` in each, separated by commas.
        space: the parameters.
        others: values of the parameters that are not named, (P,); None if all must be named.

    Returns:
        Values by name.

    Raises:
        ParameterError: for invalid words, and for parameters without a value.
    """
    values: dict[str, float] = {}
    for word in (
        word_part.strip()
        for argument in words
        for word_part in argument.split(",")
        if word_part.strip()
    ):
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
        if name not in space.names or name in values:
            raise ParameterError(
                f"'{name}' is {'there twice' if name in values else 'no parameter'}: there are "
                f"{', '.join(space.names)}"
            )
        values[name] = value
    missing = [name for name in space.names if name not in values]
    if others is not None:
        values |= {
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
    return values


def is_model(name: str) -> bool:
    """True for the name of a model in a file, or of a folder, which is refused with a message when
    it is read.
    """
    return Path(name).suffix == ".npz" or Path(name).is_dir()


def model_of(path: str | Path, known: Iterable[str] = ()) -> Any:
    """Model of a file.

    Args:
        path: the file.
        known: user-defined classes in the file, each ``file.py:name`` or an entry point.

    Raises:
        SceneError: if one of the names is no class.
    """
    from hhr_dolfinx.online.model_file import load_model

    classes = [find("laws", name) for name in known]
    for name, loaded in zip(known, classes, strict=True):
        if not isinstance(loaded, type):
            raise SceneError(
                f"--known {name} is {type(loaded).__name__} and no class: name one, --known "
                "law.py:MyLaw"
            )
    return load_model(path, known=classes)


def any_model_of(path: str | Path, known: Iterable[str] = ()) -> Any:
    """Model of a file, of a format of a plug-in too.

    Args:
        path: the file.
        known: see :func:`model_of`.

    Raises:
        SceneError: see :func:`model_of`.
    """
    place = registry.named("formats").get(format_of(path))
    return model_of(path, known) if place is None else registry.load(place)(path)


def checked_target(path: Path | None, endings: tuple[str, ...]) -> None:
    """Refuse a file that could not be written later, before anything is computed.

    Args:
        path: the file; None for none.
        endings: admissible endings of its name.

    Raises:
        FileError: if the file could not be written.
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
