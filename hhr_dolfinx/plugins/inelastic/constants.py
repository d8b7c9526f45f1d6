"""Constants of materials that are formulas of the parameters, and the laws and moduli at a
point.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.amplitudes import RANGES
from hhr_dolfinx.body import Body
from hhr_dolfinx.errors import ParameterError, SceneError
from hhr_dolfinx.parameters import described

if TYPE_CHECKING:
    from ufl.core.expr import Expr

    from hhr_dolfinx.formulas import Scalar
    from hhr_dolfinx.parameters import ParameterSpace
    from hhr_dolfinx.plugins.inelastic.law import Law, LawProgram

MUST = {
    "young": "Young's modulus must be positive and finite",
    "poisson": "Poisson's ratio must lie in (-1, 0.5)",
}
"""Conditions on elastic constants, by name."""
MOST_PLACES = 100
"""Places at which constants that vary in space are checked."""


def formulas_of(law: Law | LawProgram | None) -> dict[str, str]:
    """Constants of a law that are formulas of the parameters, by name; empty without a law."""
    formulas: dict[str, str] = {} if law is None else law.formulas
    return formulas


def parameters_of(law: Any) -> set[str]:
    """Names of the parameters on which a law depends; SceneError for a text that is no formula."""
    formulas = formulas_of(law)
    if not formulas:
        return set()
    from hhr_dolfinx.formulas import formula_of

    return {
        name
        for field, text in formulas.items()
        for name in formula_of(text, f"{field} of {law.name}").variables
    }


class LawOfParameters:
    """A law with constants that are formulas of these parameters; SceneError if they are not.

    A formula that names coordinates has a value at each of some places, (n, d). Parameters of these
    names come first.
    """

    def __init__(
        self,
        law: Any,
        names: Sequence[str],
        coordinates: Sequence[str] = (),
        places: np.ndarray | None = None,
    ):
        unknown = parameters_of(law) - set(names) - set(coordinates)
        if unknown:
            raise SceneError(
                f"the law {law.name} names {sorted(unknown)}, and the parameters are "
                f"{tuple(names)}: correct the formula, or add the parameter to the ParameterSpace"
            )
        # imported here, since most laws have no formulas
        from hhr_dolfinx.formulas import Scalar

        self._law = law
        self._names = tuple(names)
        free = [k for k, name in enumerate(coordinates) if name not in names]
        self._places = np.zeros((0, len(free))) if places is None else places[:, free]
        variables = (*self._names, *(coordinates[k] for k in free))
        self._scalars = {field: Scalar(text, variables) for field, text in formulas_of(law).items()}

    def _value(self, scalar: Scalar, point: np.ndarray) -> float | np.ndarray:
        """A number, or one for each place, (n,)."""
        if set(scalar.formula.variables) <= set(self._names):
            return scalar.value(point)
        return scalar.values(np.hstack([np.tile(point, (len(self._places), 1)), self._places]))

    def constants(self, point: np.ndarray) -> dict[str, float | np.ndarray]:
        """Values of the formulas at a point, (P,), by name.

        Raises:
            SceneError: for one that is not finite or in no table.
        """
        values: dict[str, float | np.ndarray] = {}
        for field, scalar in self._scalars.items():
            formula = f"{field} = {scalar.text} of {self._law.name}"
            try:
                values[field] = self._value(scalar, point)
            except ParameterError as error:
                raise SceneError(
                    f"{formula}: {error}, at {described(self._names, point)}. Give the table "
                    "further points, or narrow the box of the parameters"
                ) from None
            if not np.isfinite(values[field]).all():
                raise SceneError(
                    f"{formula} is {values[field]} at {described(self._names, point)}: change the "
                    "formula, or narrow the box of the parameters"
                )
        return values

    def along(self, point: np.ndarray, directions: np.ndarray) -> dict[str, np.ndarray]:
        """Derivatives of the formulas at a point, (P,), along directions, (P, K), by name: (1, K),
        or (places, K).
        """
        from hhr_dolfinx.formulas import IMAGINARY_STEP

        slopes = {}
        for field, scalar in self._scalars.items():
            if set(scalar.formula.variables) <= set(self._names):
                slopes[field] = (scalar.derivative(point)[: point.size] @ directions)[None]
                continue
            rows = np.hstack([np.tile(point, (len(self._places), 1)), self._places]).astype(complex)
            total = np.zeros((len(rows), directions.shape[1]))
            for index, name in enumerate(self._names):
                if name in scalar.formula.variables:
                    rows[:, index] += 1j * IMAGINARY_STEP
                    value = scalar.formula(dict(zip(scalar.names, rows.T, strict=True)))
                    rows[:, index] -= 1j * IMAGINARY_STEP
                    total += np.outer(np.imag(value) / IMAGINARY_STEP, directions[index])
            slopes[field] = total
        return slopes

    def at(self, point: np.ndarray) -> Any:
        """The law with its constants at a point, (P,).

        SceneError for constants outside their limits.
        """
        numbers = self.constants(point)
        if not numbers:
            return self._law
        shown = ", ".join(f"{field} = {self._scalars[field].text}" for field in numbers)
        return self._law.with_numbers(numbers, f" at {described(self._names, point)}, by {shown},")


class ModuliOfParameters:
    """Young's moduli and Poisson's ratios that are formulas of these parameters.

    SceneError if they are not.

    They have the number of their body and ``young`` or ``poisson`` as keys.
    """

    def __init__(self, texts: dict[tuple[int, str], str], names: Sequence[str]):
        # imported here, since most moduli are numbers
        from hhr_dolfinx.formulas import Scalar

        self._names = tuple(names)
        self._scalars = {key: Scalar(text, self._names) for key, text in texts.items()}

    def along(self, point: np.ndarray, directions: np.ndarray) -> dict[tuple[int, str], np.ndarray]:
        """Derivatives of the constants at a point, (P,), along directions, (P, K): (K,) each."""
        return {key: scalar.derivative(point) @ directions for key, scalar in self._scalars.items()}

    def values(self, point: np.ndarray) -> dict[tuple[int, str], float]:
        """Elastic constants at a point, (P,).

        Raises:
            SceneError: for an impossible one.
        """
        values = {}
        for key, scalar in self._scalars.items():
            name = key[1]
            try:
                values[key] = scalar.value(point)
            except ParameterError as error:
                raise SceneError(
                    f"{name} = {scalar.text}: {error}. Give the table further points, or narrow "
                    "the box"
                ) from None
            low, high = RANGES[name]
            if not low < values[key] < high:
                raise SceneError(
                    f"{name} = {scalar.text} is {values[key]:g} at "
                    f"{described(self._names, point)}: {MUST[name]}. Change the formula, or narrow "
                    "the box of the parameters"
                )
        return values


def check_law_over_box(
    law: Law | LawProgram | None,
    space: ParameterSpace,
    what: str,
    coordinates: Sequence[str] = (),
    places: np.ndarray | None = None,
) -> None:
    """Refuse a law whose constants are not valid in the whole box.

    The check takes corners and some hundred points between, and a hundred of the places. A step
    with invalid constants that it missed is refused.

    Args:
        law: law of a body.
        space: box of the parameters.
        what: owner of the law, for messages.
        coordinates: names of coordinates that formulas may have.
        places: coordinates of the points, (n, d); None without any.

    Raises:
        SceneError: for such a law.
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


class _LawsOfScenes:
    parameters_of = staticmethod(parameters_of)

    def check_body(self, body: Body) -> None:
        """Raise SceneError for elastic constants that are formulas beside a law that states the
        elasticity.

        A grading multiplies a linear stress. Of a law with a memory it would have to say what else
        it changes.
        """
        law = body.law
        if not getattr(law, "elastic", False):
            return
        named = [name for name in RANGES if isinstance(getattr(body, name), str)]
        if named:
            raise SceneError(
                f"body {body.tag} has the elasticity of its law {law.name}: its "
                f"{' and '.join(named)} must be a number, since it does not enter"
            )
        if body.grading is not None and (law.memory or law.unknowns):
            raise SceneError(
                f"body {body.tag} has a grading, and {law.name} states elasticity and flow of its "
                "own: whether strengths grow with the moduli is not stated. Write it into the "
                "law, and leave the grading out"
            )

    def linear_stress(self, law: Law) -> Callable[[Expr], Expr] | None:
        """Stress of a law that states it as a function of the strain, both (3, 3), in UFL.

        None for any other law.
        """
        stress: Callable[[Expr], Expr] | None = getattr(law, "linear_stress", None)
        return stress

    def check_hypothesis(self, law: Law, hypothesis: str) -> None:
        """Refuse a law in a frame that turns the axis across the plane.

        Args:
            law: law of a body.
            hypothesis: hypothesis of the scene.

        Raises:
            SceneError: for such a frame.
        """
        if hypothesis != "solid" and hasattr(law, "frame"):
            from hhr_dolfinx.forms.laws import rotation

            rotation(law.frame, 4)


SCENES = _LawsOfScenes()
