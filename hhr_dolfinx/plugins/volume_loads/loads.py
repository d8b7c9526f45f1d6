"""Forces per volume, rotation, temperature, swelling."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import ufl

from hhr_dolfinx.amplitudes import Amplitude, check_amplitude
from hhr_dolfinx.declared import KnownArguments
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.forms import volume
from hhr_dolfinx.formulas import Formula, formula_of
from hhr_dolfinx.loads import Assembler, Term
from hhr_dolfinx.parameters import Tag, as_tuple, check_tag, is_number

if TYPE_CHECKING:
    from ufl.core.expr import Expr

ISOTROPIC = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
"""Isotropic strain of 1 along each axis."""


@dataclass(frozen=True)
class BodyForce(KnownArguments):
    """Force ``amplitude(mu) * direction`` per volume of a body, such as its weight.

    Attributes:
        tag: cell tag of the body.
        direction: constant vector, (dim,); in axisymmetry its first component is radial.
        amplitude: number, :class:`Amplitude`, or a formula of the parameters as text, ``"9.81 *
            rho"``.
    """

    tag: Tag
    direction: tuple[float, ...]
    amplitude: Amplitude | Formula

    def __post_init__(self) -> None:
        check_tag("body force", self.tag)
        name = f"the body force on tag {self.tag}"
        object.__setattr__(self, "direction", _vector(f"the direction of {name}", self.direction))
        if not any(self.direction):
            raise SceneError(f"the direction {self.direction} of {name} must not be zero")
        check_amplitude(self, name, formulas=True)

    def terms(self, assembler: Assembler) -> list[Term]:
        """One vector."""
        _check_length(
            f"the direction of the body force on tag {self.tag}", self.direction, assembler
        )
        form = volume.body_force(
            assembler.test, self.direction, assembler.hypothesis, assembler.dx(self.tag)
        )
        return [Term(self.amplitude, assembler.vector(form))]


@dataclass(frozen=True)
class Centrifugal(KnownArguments):
    """Force ``amplitude(mu) * d`` per volume of a rotating body, with the vector d from the axis.

    Attributes:
        tag: cell tag of the body.
        amplitude: density times the square of the angular velocity, ``"rho * omega**2"``.
        axis_point: a point of the axis, (dim,); None for the origin. In axisymmetry the axis is
            that of the scene.
        axis_direction: direction of the axis in space, (3,); None in axisymmetry, and in the plane,
            for its normal.
    """

    tag: Tag
    amplitude: Amplitude | Formula
    axis_point: tuple[float, ...] | None = None
    axis_direction: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        check_tag("centrifugal force", self.tag)
        for name in ("axis_point", "axis_direction"):
            if getattr(self, name) is not None:
                vector = _vector(
                    f"{name} of the centrifugal force on tag {self.tag}", getattr(self, name)
                )
                object.__setattr__(self, name, vector)
        if self.axis_direction is not None and not any(self.axis_direction):
            raise SceneError(
                f"axis_direction of the centrifugal force on tag {self.tag} must not be zero"
            )
        check_amplitude(self, f"the centrifugal force on tag {self.tag}", formulas=True)

    def terms(self, assembler: Assembler) -> list[Term]:
        """One vector."""
        point, axis = self._axis(assembler)
        form = volume.centrifugal(
            assembler.test, point, axis, assembler.hypothesis, assembler.dx(self.tag)
        )
        return [Term(self.amplitude, assembler.vector(form))]

    def _axis(self, assembler: Assembler) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """A point of the axis and its unit vector within the mesh, (dim,) each."""
        name = f"the centrifugal force on tag {self.tag}"
        hypothesis = assembler.hypothesis
        point = (0.0,) * assembler.test.ufl_shape[0] if self.axis_point is None else self.axis_point
        _check_length(f"axis_point of {name}", point, assembler)
        if hypothesis == "solid":
            if self.axis_direction is None or len(self.axis_direction) != 3:
                raise SceneError(
                    f"{name} needs an axis_direction of 3 components, and has {self.axis_direction}"
                )
            return point, tuple(
                (np.array(self.axis_direction) / np.linalg.norm(self.axis_direction)).tolist()
            )
        if self.axis_direction is not None:
            raise SceneError(
                f"{name}: the axis of a scene in {hypothesis} is known: leave out "
                f"{self.axis_direction}"
            )
        if hypothesis == "axisymmetric" and point[0] != 0:
            raise SceneError(
                f"{name}: the axis of an axisymmetric scene is at r = 0: leave out the point "
                f"{point}"
            )
        return point, (0.0, 1.0) if hypothesis == "axisymmetric" else (0.0, 0.0)


@dataclass(frozen=True)
class Eigenstrain(KnownArguments):
    """A strain that causes no stress by itself, such as swelling.

    It is ``amplitude(mu) * field(x) * strain``.

    The stress is σ = C (ε - ε0), and laws of bodies use ε - ε0. The nodal forces depend on
    parameters if moduli do.

    Attributes:
        tag: cell tag of the body.
        amplitude: number, :class:`Amplitude`, or a formula of the parameters as text.
        strain: symmetric 3x3 tensor in the axes of the scene, (r, z, θ) in axisymmetry, with the
            third axis also in the plane; a number for the same strain along each axis.
        field: function of the UFL coordinates that returns a UFL scalar; None for 1.
    """

    tag: Tag
    amplitude: Amplitude | Formula
    strain: tuple[tuple[float, ...], ...] = ISOTROPIC
    field: Callable[[ufl.SpatialCoordinate], Expr] | None = None

    def __post_init__(self) -> None:
        check_tag("eigenstrain", self.tag)
        name = f"the eigenstrain of body {self.tag}"
        object.__setattr__(self, "strain", _symmetric(name, self.strain))
        _check_field(name, self.field)
        check_amplitude(self, name, formulas=True)

    def terms(self, assembler: Assembler) -> list[Term]:
        """One vector for each part of the stiffness of the body.

        Raises:
            SceneError: for shear out of the plane.
        """
        if assembler.hypothesis != "solid" and (self.strain[0][2] or self.strain[1][2]):
            raise SceneError(
                f"the eigenstrain {self.strain} of body {self.tag} shears out of the plane, which "
                f"a scene in {assembler.hypothesis} does not: set these components to zero"
            )
        strain = volume.eigenstrain(self.strain, self.field, assembler.dx(self.tag).ufl_domain())
        return [_times(self.amplitude, *term) for term in assembler.eigenstress(self.tag, strain)]

    def eigenstrain_of(
        self, tag: Tag, mesh: ufl.Mesh
    ) -> tuple[Amplitude | Formula, ufl.core.expr.Expr] | None:
        """Amplitude, and strain for amplitude 1, which stresses subtract.

        Args:
            tag: tag of the body.
            mesh: the mesh.

        Returns:
            Amplitude and a UFL tensor, (3, 3); None for another body.
        """
        return (
            (self.amplitude, volume.eigenstrain(self.strain, self.field, mesh))
            if tag == self.tag
            else None
        )


@dataclass(frozen=True)
class ThermalExpansion(KnownArguments):
    """The isotropic strain ``expansion(mu) * temperature(mu) * field(x)`` of a heated body.

    Attributes:
        tag: cell tag of the body.
        expansion: coefficient of linear expansion: number, :class:`Amplitude`, or formula of the
            parameters as text. A coefficient that depends on temperature is a table, ``"table(T, 0,
            1e-5, 500, 1.2e-5)"``.
        temperature: temperature above the stress-free one: number, :class:`Amplitude`, or formula
            as text.
        field: distribution of the temperature, a function of the UFL coordinates that returns a UFL
            scalar, or an ``hhr.NodalField``; None for 1.

    Example:
        >>> heat = hhr.ThermalExpansion("pellet", expansion=1e-5, temperature="T - 20")
        >>> round(float(heat.amplitude({"T": 120.0})), 6)
        0.001
    """

    tag: Tag
    expansion: Formula
    temperature: Formula
    field: Callable[[ufl.SpatialCoordinate], Expr] | None = None

    def __post_init__(self) -> None:
        check_tag("thermal expansion", self.tag)
        for name in ("expansion", "temperature"):
            label = f"{name} of the thermal expansion of body {self.tag}"
            object.__setattr__(self, name, _formula(getattr(self, name), label))
        _check_field(f"the thermal expansion of body {self.tag}", self.field)

    @cached_property
    def amplitude(self) -> Amplitude | Formula:
        """Strain for the field 1."""
        return self.expansion.times(self.temperature)

    @cached_property
    def _eigenstrain(self) -> Eigenstrain:
        return Eigenstrain(self.tag, self.amplitude, field=self.field)

    def terms(self, assembler: Assembler) -> list[Term]:
        """Terms of the eigenstrain, see :meth:`Eigenstrain.terms`."""
        return self._eigenstrain.terms(assembler)

    def eigenstrain_of(
        self, tag: Tag, mesh: ufl.Mesh
    ) -> tuple[Amplitude | Formula, ufl.core.expr.Expr] | None:
        """Amplitude and strain for amplitude 1, see :meth:`Eigenstrain.eigenstrain_of`.

        Args:
            tag: tag of the body.
            mesh: the mesh.
        """
        return self._eigenstrain.eigenstrain_of(tag, mesh)


def _times(amplitude: Amplitude | Formula, modulus: Formula, forces: np.ndarray) -> Term:
    """Term of nodal forces for the modulus 1, (N,).

    With a constant modulus an affine amplitude stays affine.
    """
    if not modulus.variables:
        return Term(amplitude, float(modulus({})) * forces)
    return Term(modulus.times(_formula(amplitude, "an amplitude")), forces)


def _formula(value: Amplitude | Formula | str | float, what: str) -> Formula:
    """A number, a text or an affine amplitude as a formula."""
    if not isinstance(value, Amplitude):
        return formula_of(value, what)
    terms = [
        repr(float(value.constant)),
        *(f"({float(slope)!r}) * {name}" for name, slope in value.slopes.items()),
    ]
    formula = formula_of(" + ".join(terms), what)
    if set(formula.variables) != set(value.slopes):
        raise SceneError(
            f"{what} multiplies a modulus, and names {sorted(value.slopes)}: in a formula names "
            "of parameters are words"
        )
    return formula


def _vector(what: str, value: Sequence[float]) -> tuple[float, ...]:
    """A tuple of finite numbers."""
    vector = as_tuple(what, value)
    if not all(is_number(component) for component in vector):
        raise SceneError(f"{what} = {value!r} must hold finite numbers")
    return tuple(float(component) for component in vector)


def _check_length(what: str, vector: tuple[float, ...], assembler: Assembler) -> None:
    (dim,) = assembler.test.ufl_shape
    if len(vector) != dim:
        raise SceneError(f"{what}, {vector}, must have {dim} components, as the mesh")


def _symmetric(what: str, value: Any) -> tuple[tuple[float, ...], ...]:
    """A symmetric 3x3 tensor, isotropic for a number."""
    try:
        tensor = float(value) * np.eye(3) if is_number(value) else np.array(value, dtype=float)
    except (TypeError, ValueError):
        tensor = np.zeros(0)
    if (
        tensor.shape != (3, 3)
        or not np.isfinite(tensor).all()
        or not (tensor == tensor.T).all()
        or not tensor.any()
    ):
        raise SceneError(
            f"the strain {value!r} of {what} must be a symmetric 3x3 tensor of finite numbers "
            "that is not zero, or a number for the same strain along each axis"
        )
    return tuple(tuple(row) for row in tensor.tolist())


def _check_field(what: str, field: Callable[[ufl.SpatialCoordinate], Expr] | None) -> None:
    if field is not None and not callable(field):
        raise SceneError(
            f"the field {field!r} of {what} must be a function of the coordinates, or None for 1"
        )
