"""Constants of materials that are formulas of the parameters, and the laws and moduli at a point."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.body import Body
from hhr_dolfinx.errors import ParameterError, SceneError

if TYPE_CHECKING:
    from hhr_dolfinx.formulas import Scalar
    from hhr_dolfinx.parameters import ParameterSpace

MOST_PLACES = 100
"""Places at which constants that vary in space are checked."""


def formulas_of(law: Any) -> dict[str, str]:
    """Constants of a law that are formulas of the parameters, by name; empty without a law."""
    found: dict[str, str] = {} if law is None else law.formulas
    return found


def parameters_of(law: Any) -> set[str]:
    """Names of the parameters on which a law depends; SceneError for a text that is no formula."""
    found = formulas_of(law)
    if not found:
        return set()
    from hhr_dolfinx.formulas import formula_of

    return {name for field, text in found.items() for name in formula_of(text, f"{field} of {law.name}").variables}


class LawOfParameters:
    """A law with constants that are formulas of these parameters; SceneError if they are not.

    A formula that names coordinates has a value at each of some places, (n, d). Parameters of these names come first.
    """

    def __init__(
        self, law: Any, names: Sequence[str], coordinates: Sequence[str] = (), places: np.ndarray | None = None
    ):
        unknown = parameters_of(law) - set(names) - set(coordinates)
        if unknown:
            raise SceneError(
                f"the law {law.name} names {sorted(unknown)}, and the parameters are {tuple(names)}: correct the "
                "formula, or add the parameter to the ParameterSpace"
            )
        # imported here, since most laws have no formulas
        from hhr_dolfinx.formulas import Scalar

        self._law = law
        self._names = tuple(names)
        free = [k for k, name in enumerate(coordinates) if name not in names]
        self._places = np.zeros((0, len(free))) if places is None else places[:, free]
        every = (*self._names, *(coordinates[k] for k in free))
        self._scalars = {field: Scalar(text, every) for field, text in formulas_of(law).items()}

    def _value(self, scalar: Scalar, point: np.ndarray) -> float | np.ndarray:
        """A number, or one for each place, (n,)."""
        if set(scalar.formula.variables) <= set(self._names):
            return scalar.value(point)
        return scalar.values(np.hstack([np.tile(point, (len(self._places), 1)), self._places]))

    def constants(self, point: np.ndarray) -> dict[str, float | np.ndarray]:
        """Values of the formulas at a point, (P,), by name; SceneError for one that is not finite or in no table."""
        found: dict[str, float | np.ndarray] = {}
        for field, scalar in self._scalars.items():
            what = f"{field} = {scalar.text} of {self._law.name}"
            try:
                found[field] = self._value(scalar, point)
            except ParameterError as error:
                raise SceneError(
                    f"{what}: {error}, at {_place(self._names, point)}. Give the table further points, or narrow the "
                    "box of the parameters"
                ) from None
            if not np.isfinite(found[field]).all():
                raise SceneError(
                    f"{what} is {found[field]} at {_place(self._names, point)}: change the formula, or narrow the box "
                    "of the parameters"
                )
        return found

    def along(self, point: np.ndarray, directions: np.ndarray) -> dict[str, np.ndarray]:
        """Derivatives of the formulas at a point, (P,), along directions, (P, K), by name: (1, K), or (places, K)."""
        from hhr_dolfinx.formulas import STEP

        found = {}
        for field, scalar in self._scalars.items():
            if set(scalar.formula.variables) <= set(self._names):
                found[field] = (scalar.derivative(point)[: point.size] @ directions)[None]
                continue
            rows = np.hstack([np.tile(point, (len(self._places), 1)), self._places]).astype(complex)
            total = np.zeros((len(rows), directions.shape[1]))
            for place, name in enumerate(self._names):
                if name in scalar.formula.variables:
                    rows[:, place] += 1j * STEP
                    value = scalar.formula(dict(zip(scalar.names, rows.T, strict=True)))
                    rows[:, place] -= 1j * STEP
                    total += np.outer(np.imag(value) / STEP, directions[place])
            found[field] = total
        return found

    def at(self, point: np.ndarray) -> Any:
        """The law with its constants at a point, (P,); SceneError for constants outside their limits."""
        numbers = self.constants(point)
        if not numbers:
            return self._law
        shown = ", ".join(f"{field} = {self._scalars[field].text}" for field in numbers)
        return self._law.with_numbers(numbers, f" at {_place(self._names, point)}, by {shown},")


class ModuliOfParameters:
    """Young's moduli that are formulas of these parameters, by the number of their body; SceneError if they are not."""

    def __init__(self, texts: dict[int, str], names: Sequence[str]):
        # imported here, since most moduli are numbers
        from hhr_dolfinx.formulas import Scalar

        self._names = tuple(names)
        self._scalars = {number: Scalar(text, self._names) for number, text in texts.items()}

    def along(self, point: np.ndarray, directions: np.ndarray) -> dict[int, np.ndarray]:
        """Derivatives of the moduli at a point, (P,), along directions, (P, K), by number: (K,)."""
        return {number: scalar.derivative(point) @ directions for number, scalar in self._scalars.items()}

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


def check_law_over_box(
    law: Any, space: ParameterSpace, what: str, coordinates: Sequence[str] = (), places: np.ndarray | None = None
) -> None:
    """Raise SceneError unless the constants of a law are valid in the whole box; ``what`` names its owner.

    The check takes corners and some hundred points between, and a hundred of the places, (n, d). A step with invalid
    constants that it missed is refused.
    """
    if not formulas_of(law):
        return
    from hhr_dolfinx.formulas import box_samples

    try:
        few = None if places is None else places[:: max(len(places) // MOST_PLACES, 1)]
        bound = LawOfParameters(law, space.names, coordinates, few)
        for point in box_samples(space):
            bound.at(point)
    except SceneError as error:
        raise SceneError(f"{what}: {error}") from None


def _uneven(body: Body) -> bool:
    """True if more of the elasticity than a common factor depends on parameters or on position."""
    return isinstance(body.poisson, str) or body.grading is not None


class _LawsOfScenes:
    parameters_of = staticmethod(parameters_of)

    def check_body(self, body: Body) -> None:
        """Raise SceneError for elasticity that varies in space, or a ratio that is a formula."""
        if _uneven(body):
            raise SceneError(
                f"body {body.tag} flows, and its Poisson's ratio depends on parameters, or its elasticity on the "
                "place: that is not built in, only young may be a formula. Give it a constant poisson, or a scene for "
                "each of its values, and no grading"
            )

    def check_scene(self, scene: Any) -> None:
        """Raise SceneError for other bodies of such elasticity, and for shapes."""
        others = [body.tag for body in scene.bodies if _uneven(body)]
        if others:
            raise SceneError(
                f"bodies of scene '{scene.name}' flow, and Poisson's ratio of bodies {others} depends on parameters, "
                "or their elasticity on the place: that is not built in, only young may be a formula. Give these a "
                "constant poisson and no grading"
            )
        if scene.shapes:
            raise SceneError(
                f"bodies of scene '{scene.name}' flow, and their shape depends on parameters: not built in"
            )


SCENES = _LawsOfScenes()
