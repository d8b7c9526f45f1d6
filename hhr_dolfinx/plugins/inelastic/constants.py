"""Constants of materials that are formulas of the parameters, and the laws and moduli at a point.

A field of a law is a formula if it holds a text and its class declares that it may be a number, as ``float`` or
``float | str``. A field declared ``str`` alone is a setting of the law and stays as it is; so does one whose type
cannot be determined. Model files keep a formula only if ``float | str`` is declared.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from numbers import Real
from types import UnionType
from typing import TYPE_CHECKING, Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from hhr_dolfinx.errors import ParameterError, SceneError

if TYPE_CHECKING:
    from hhr_dolfinx.parameters import ParameterSpace
    from hhr_dolfinx.plugins.inelastic.laws import Flow


def formulas_of(law: Any) -> dict[str, str]:
    """Fields of a law that are formulas of the parameters, by name; empty for an object that is no dataclass."""
    if not dataclasses.is_dataclass(law) or isinstance(law, type):
        return {}
    fields = {item.name: getattr(law, item.name, None) for item in dataclasses.fields(law) if item.init}
    texts = {name: value for name, value in fields.items() if isinstance(value, str)}
    hints = _hints(type(law)) if texts else {}
    return {name: text for name, text in texts.items() if _may_be_number(hints.get(name))}


def parameters_of(law: Any) -> set[str]:
    """Names of the parameters on which a law depends; SceneError for a text that is no formula."""
    found = formulas_of(law)
    if not found:
        return set()
    from hhr_dolfinx.formulas import formula_of

    kind = type(law).__name__
    return {name for field, text in found.items() for name in formula_of(text, f"{field} of {kind}").variables}


class LawOfParameters:
    """A law, a frozen dataclass, with constants that are formulas of these parameters; SceneError if they are not."""

    def __init__(self, law: Any, names: Sequence[str]):
        unknown = parameters_of(law) - set(names)
        if unknown:
            raise SceneError(
                f"the law {law} names {sorted(unknown)}, and the parameters are {tuple(names)}: correct the formula, "
                "or add the parameter to the ParameterSpace"
            )
        self._formulas = formulas_of(law)
        self._law = law
        self._names = tuple(names)
        if self._formulas:
            # imported here, since most laws have no formulas
            from hhr_dolfinx.formulas import Scalar

            self._scalars = {field: Scalar(text, self._names) for field, text in self._formulas.items()}

    def constants(self, point: np.ndarray) -> dict[str, float]:
        """Values of the formulas at a point, (P,), by name; SceneError for one that is not finite or in no table."""
        found = {}
        for field, text in self._formulas.items():
            what = f"{field} = {text} of {type(self._law).__name__}"
            try:
                found[field] = self._scalars[field].value(point)
            except ParameterError as error:
                raise SceneError(
                    f"{what}: {error}, at {_place(self._names, point)}. Give the table further points, or narrow the "
                    "box of the parameters"
                ) from None
            except TypeError:  # the value is complex, such as the root of a negative number
                found[field] = math.nan
            if not math.isfinite(found[field]):
                raise SceneError(
                    f"{what} is {found[field]} at {_place(self._names, point)}: change the formula, or narrow the box "
                    "of the parameters"
                )
        return found

    def at(self, point: np.ndarray) -> Flow:
        """The law with its constants at a point, (P,), a new object; SceneError for constants that it refuses."""
        numbers = self.constants(point)
        try:
            return dataclasses.replace(self._law, **numbers) if numbers else self._law
        except Exception as error:  # a user-defined class may raise anything
            shown = ", ".join(f"{field} = {self._formulas[field]} = {value:g}" for field, value in numbers.items())
            raise SceneError(
                f"{type(self._law).__name__} refuses {shown} at {_place(self._names, point)} ({error}): change the "
                "formula, or narrow the box of the parameters"
            ) from error


class ModuliOfParameters:
    """Young's moduli that are formulas of these parameters, by the number of their body; SceneError if they are not."""

    def __init__(self, texts: dict[int, str], names: Sequence[str]):
        # imported here, since most moduli are numbers
        from hhr_dolfinx.formulas import Scalar

        self._names = tuple(names)
        self._scalars = {number: Scalar(text, self._names) for number, text in texts.items()}

    def values(self, point: np.ndarray) -> dict[int, float]:
        """The moduli at a point, (P,), by number; SceneError for one that is not positive and finite."""
        found = {}
        for number, scalar in self._scalars.items():
            try:
                found[number] = scalar.value(point)
            except ParameterError as error:
                raise SceneError(
                    f"young = {scalar.text}: {error}. Give the table further points, or narrow the box"
                ) from None
            if not 0 < found[number] < math.inf:
                raise SceneError(
                    f"young = {scalar.text} is {found[number]:g} at {_place(self._names, point)}: Young's modulus must "
                    "be positive and finite. Change the formula, or narrow the box of the parameters"
                )
        return found


def _place(names: Sequence[str], point: np.ndarray) -> str:
    return ", ".join(f"{name} = {value:g}" for name, value in zip(names, point, strict=True))


def law_at(law: Any, names: Sequence[str], point: np.ndarray) -> Flow:
    """A law with the values of its formulas at a point, (P,), see :class:`LawOfParameters`."""
    return LawOfParameters(law, names).at(point)


def check_law(law: Any, space: ParameterSpace, what: str) -> None:
    """Raise SceneError unless the constants of a law are valid in the whole box; ``what`` names its owner.

    The check takes corners and some hundred points between. A step with invalid constants that it missed is refused.
    """
    if not formulas_of(law):
        return
    from hhr_dolfinx.formulas import box_samples

    try:
        bound = LawOfParameters(law, space.names)
        for point in box_samples(space):
            bound.at(point)
    except SceneError as error:
        raise SceneError(f"{what}: {error}") from None


def _hints(kind: type) -> dict[str, Any]:
    """Declared types of the fields of a class; empty if they cannot be resolved."""
    try:
        return get_type_hints(kind)
    except Exception:  # annotations with names that are imported for type checking only
        return {}


def _may_be_number(hint: Any) -> bool:
    """True if a declared type admits a float."""
    if get_origin(hint) in (Union, UnionType):
        return any(_may_be_number(item) for item in get_args(hint))
    return hint in (float, Real)
