"""Conformance checks of user-defined parts on two small pressed blocks.

Each holds a part that you wrote to the contract of its seam.

A check takes the part, or a function without arguments that makes it, and raises
:class:`ConformanceError` with one sentence that says what is wrong and what to do. The blocks need
no optional package. Parts refer to them by the tags below, to contact 0, and to the parameters of
:data:`BOX` or to your own, which you give by name with their bounds. No check proves that a part
models what you mean: write your own tests for that.

Checks are those of plug-ins, by their names in ``Plugin.parts["checks"]``; here is what they are
made of.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from functools import wraps
from inspect import signature
from types import FunctionType
from typing import Any, TypeVar

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.errors import ConformanceError
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.plain import as_plain, by_name, restored

LOWER_BODY = two_blocks.FIRST
UPPER_BODY = two_blocks.SECOND
LOWER_SURFACE = two_blocks.side(LOWER_BODY, 1, True)
UPPER_SURFACE = two_blocks.side(UPPER_BODY, 1, False)
FLANK = two_blocks.side(UPPER_BODY, 0, True)
"""Tags of the blocks 1 <= x <= 2 below and above y = 1, of their surfaces there, and of the upper
side at x = 2.
"""
BOX = {"push": (0.005, 0.06), "slide": (-0.02, 0.02), "load": (0.0, 0.1), "gap": (0.0, 0.03)}
"""Bounds of the motion of the top down and aside, of the pressure on the flank, and of the opening
of the contact.
"""
TESTED_STEP = 1e-5
"""Step of differences over the box or the size of a block."""
TESTED_ROUND_OFF = 1e-8
"""Relative error of exact answers, for cond(K) < 1e4."""
OF_FUNCTIONS = 1e-6
"""Relative error of differences of smooth functions."""
OF_ANSWERS = 1e-5
"""Relative error of differences of answers, whose round-off is larger."""
Bounds = Mapping[str, tuple[float, float]]
OTHER_IN_A_FILE = "a copy from a file answers otherwise: keep all that it needs in its fields"
"""What a check says of a part that a file changes."""
T = TypeVar("T")
Check = TypeVar("Check", bound=Callable[..., None])


def blaming(check: Check) -> Check:
    """Make the part, and name it in any error of its code or of a check on it.

    Raises:
        ConformanceError: by the returned check, for any error.
    """

    @wraps(check)
    def checked(part: object, *given: Any, **settings: Any) -> None:
        instance = (
            part() if isinstance(part, FunctionType) and not signature(part).parameters else part
        )
        name = getattr(instance, "__name__", type(instance).__name__)
        try:
            check(instance, *given, **settings)
        except ConformanceError as error:
            raise ConformanceError(f"{name}: {error}") from None
        except Exception as error:  # code of anybody
            raise ConformanceError(f"{name}: {type(error).__name__}: {error}") from error

    return checked  # type: ignore[return-value]


def require(fits: bool | np.bool_, message: str, *given: Any) -> None:
    """Require a condition of a part.

    Args:
        fits: True if the condition holds.
        message: format of the message.
        *given: values of the format.

    Raises:
        ConformanceError: if it does not hold.
    """
    if not fits:
        raise ConformanceError(message.format(*given))


def __getattr__(name: str) -> Any:
    """Check that a plug-in adds, one of its ``checks``."""
    import_paths = registry.parts("checks")
    if name not in import_paths:
        reason = registry.remedy("checks", name) or ", and no installed plug-in adds it"
        raise AttributeError(f"module '{__name__}' has no attribute {name!r}{reason}")
    return registry.load(import_paths[name][0])


def from_file(value: T) -> T:
    """The value as a file would restore it."""
    return restored(*as_plain(value), by_name(classes_in(value)))


def classes_in(value: object) -> set[type]:
    """Classes of a dataclass and of all in it."""
    if is_dataclass(value):
        return {type(value)}.union(
            *(classes_in(getattr(value, attribute.name)) for attribute in fields(value))
        )
    return set().union(*map(classes_in, value)) if isinstance(value, tuple) else set()
