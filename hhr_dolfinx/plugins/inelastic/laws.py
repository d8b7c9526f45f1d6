"""Laws of bodies that users choose: their constants and limits.

:mod:`hhr_dolfinx.forms.laws` states them in UFL.

A constant may be a text, a formula of the parameters of the scene such as ``"sy * (1 - 4e-4 *
T)"``. A step of a history has the constants of the parameter at its end. For a user-defined law see
:mod:`hhr_dolfinx.plugins.inelastic.law`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.plugins.inelastic.law import (
    AT_LEAST_ONE,
    NOT_NEGATIVE,
    NUMBER,
    POSITIVE,
    TENSOR,
    Law,
)

if TYPE_CHECKING:
    from ufl.core.expr import Expr

    from hhr_dolfinx.forms.laws import At, Stated

_AMOUNT = {"amount": NUMBER}
_STRESS = {"stress": NUMBER}
_YIELD = {"yield_stress": POSITIVE, "hardening": NOT_NEGATIVE}
_CONE = (0.0, 3**0.5)
_CREEP = {"resistance": POSITIVE, "exponent": AT_LEAST_ONE}
Frame = tuple[tuple[float, float, float], ...]
AXES: Frame = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
"""Unit vectors, as rows; those of the mesh."""


class _Stated(Law):
    """A law of :mod:`hhr_dolfinx.forms.laws`, by the name of its function."""

    stated: ClassVar[str]
    passed: ClassVar[tuple[str, ...]] = ()  #: fields that are further arguments of the function

    def statement(self, at: At) -> Stated:
        """See :class:`Law`."""
        from hhr_dolfinx.forms import laws

        stated: Stated = getattr(laws, self.stated)(at, **self.settings())
        return stated

    def settings(self) -> dict[str, object]:
        """Further arguments of the function."""
        return {name: getattr(self, name) for name in self.passed}


class _Framed(_Stated):
    """A law in a frame of the material."""

    frame: Frame
    passed: ClassVar = ("frame",)

    def __post_init__(self) -> None:
        """Refuse a frame that is not three orthogonal unit vectors, as rows, with a SceneError."""
        super().__post_init__()
        try:
            rows = np.array(self.frame, dtype=float)
            right = rows.shape == (3, 3) and bool(np.abs(rows @ rows.T - np.eye(3)).max() < 1e-9)
        except (TypeError, ValueError):
            right = False
        if not right:
            raise SceneError(
                f"the frame {self.frame!r} must be three orthogonal unit vectors, as rows"
            )


@dataclass(frozen=True)
class Plasticity(_Stated):
    """Plasticity with linear isotropic hardening, thesis (6.23)-(6.26): yield at σ0 + H p.

    Attributes:
        yield_stress: σ0, in the unit of stress of the scene.
        hardening: H >= 0.

    Example:
        >>> law = hhr.Plasticity(250.0, hardening=1e3)
        >>> law.yield_stress + law.hardening * 0.02
        270.0
        >>> hhr.Plasticity("table(T, 20, 300, 600, 180)", hardening="H").yield_stress
        'table(T, 20, 300, 600, 180)'
    """

    yield_stress: float | str
    hardening: float | str = 0.0
    limits: ClassVar = _YIELD
    stated: ClassVar = "plasticity"


@dataclass(frozen=True)
class Voce(_Stated):
    """Plasticity that saturates, σ0 + H p + Q (1 - exp(-b p)).

    Attributes:
        yield_stress, saturation: σ0 and Q, stresses.
        rate: b, the saturation rate: per cumulated strain p, not per time, without a unit; p = 1/b
            gains 63 % of Q.
        hardening: H, a stress.
    """

    yield_stress: float | str
    saturation: float | str
    rate: float | str
    hardening: float | str = 0.0
    unknowns: ClassVar = _AMOUNT
    limits: ClassVar = {**_YIELD, "saturation": NOT_NEGATIVE, "rate": POSITIVE}
    stated: ClassVar = "voce"


@dataclass(frozen=True)
class TabulatedHardening(_Stated):
    """Plasticity by a table of the yield stress over p, linear beyond its last point.

    Attributes:
        points: (p, σ) with growing p from 0 and stresses that do not fall.
    """

    points: tuple[tuple[float, float], ...]
    unknowns: ClassVar = _AMOUNT
    stated: ClassVar = "tabulated"
    passed: ClassVar = ("points",)

    def __post_init__(self) -> None:
        try:
            strains, heights = np.array(self.points, dtype=float).reshape(len(self.points), 2).T
        except (TypeError, ValueError):
            raise SceneError(f"the table {self.points} needs pairs of p and a stress") from None
        begins = (
            len(strains) > 1
            and strains[0] == 0
            and heights[0] > 0
            and np.isfinite([strains, heights]).all()
        )
        if not begins or (np.diff(strains) <= 0).any() or (np.diff(heights) < 0).any():
            raise SceneError(
                f"the table {self.points} needs finite (p, stress), p growing from 0, and a "
                "stress that is positive and does not fall: softening has no answer that does not "
                "depend on the mesh"
            )


@dataclass(frozen=True)
class Chaboche(_Stated):
    """Kinematic hardening by back stresses and Voce's isotropic hardening.

    With one back stress Armstrong-Frederick.

    Attributes:
        yield_stress, saturation, rate: σ0, Q and b of σ0 + Q (1 - exp(-b p)); b is per strain, see
            :class:`Voce`.
        backs: modulus C, a stress, and recall γ of each back stress; it saturates at C / γ in a
            pull.
    """

    yield_stress: float | str
    backs: tuple[tuple[float | str, float | str], ...]
    saturation: float | str = 0.0
    rate: float | str = 1.0
    unknowns: ClassVar = _AMOUNT
    stated: ClassVar = "chaboche"

    def __post_init__(self) -> None:
        pairs = isinstance(self.backs, tuple) and all(
            isinstance(b, tuple) and len(b) == 2 for b in self.backs
        )
        if not pairs:
            raise SceneError(
                f"backs = {self.backs!r} of Chaboche must hold pairs of modulus and recall: "
                "((60e3, 600.0),)"
            )
        super().__post_init__()

    @property
    def memory(self) -> Mapping[str, int]:  # type: ignore[override]
        """See :class:`Law`."""
        return {f"back_{k + 1}": TENSOR for k in range(len(self.backs))}

    @property
    def limits(self) -> Mapping[str, tuple[float, float]]:  # type: ignore[override]
        """See :class:`Law`."""
        each = {
            f"{name}_{k + 1}": NOT_NEGATIVE
            for k in range(len(self.backs))
            for name in ("modulus", "recall")
        }
        return {**each, "yield_stress": POSITIVE, "saturation": NOT_NEGATIVE, "rate": POSITIVE}

    def constants(self) -> dict[str, float | str]:
        """See :class:`Law`."""
        pairs = {
            f"{name}_{k + 1}": value
            for k, back in enumerate(self.backs)
            for name, value in zip(("modulus", "recall"), back, strict=True)
        }
        return super().constants() | pairs

    def settings(self) -> dict[str, object]:
        """Number of back stresses, see :class:`_Stated`."""
        return {"backs": len(self.backs)}


@dataclass(frozen=True)
class Norton(_Stated):
    """Norton's creep without threshold, thesis (6.28): rate of p = (σ_eq / K)^m, implicit Euler.

    The thesis prints the exponent as n - 1.

    Attributes:
        resistance: K, in stress times s^(1/m).
        exponent: m >= 1.

    Example:
        >>> law = hhr.Norton(resistance=900.0, exponent=5.0)
        >>> round((90.0 / law.resistance) ** law.exponent, 8)
        1e-05
        >>> hhr.Body("rod", young=200e3, poisson=0.3, law=law).law
        Norton(resistance=900.0, exponent=5.0)
    """

    resistance: float | str
    exponent: float | str
    unknowns: ClassVar = _STRESS
    limits: ClassVar = _CREEP
    stated: ClassVar = "norton"


@dataclass(frozen=True)
class Arrhenius(_Stated):
    """Norton's creep that a temperature quickens: rate of p = (σ_eq / K)^m exp(-Q/R (1/T - 1/T0)).

    Attributes:
        resistance, exponent: K and m at T0.
        activation: Q/R in K.
        temperature: T in K.
        reference: T0 in K.
    """

    resistance: float | str
    exponent: float | str
    activation: float | str
    temperature: float | str
    reference: float | str
    unknowns: ClassVar = _STRESS
    limits: ClassVar = {
        **_CREEP,
        "activation": NOT_NEGATIVE,
        "temperature": POSITIVE,
        "reference": POSITIVE,
    }
    stated: ClassVar = "arrhenius"


@dataclass(frozen=True)
class PrimaryCreep(_Stated):
    """Creep that slows as it goes, by strain hardening: p = (σ_eq / K)^n t^m at constant stress.

    Attributes:
        resistance: K, in stress times s^(m/n).
        exponent: n >= 1.
        time_exponent: m, of at most 1.
    """

    resistance: float | str
    exponent: float | str
    time_exponent: float | str
    unknowns: ClassVar = _STRESS
    limits: ClassVar = {**_CREEP, "time_exponent": (0.0, math.nextafter(1.0, 2.0))}
    stated: ClassVar = "primary_creep"


@dataclass(frozen=True)
class PlasticityWithCreep(_Stated):
    """Norton's creep, and yield at σ0 + H p_p of the plastic part alone.

    Attributes:
        yield_stress, hardening: σ0 and H.
        resistance, exponent: K and m, see :class:`Norton`.
    """

    yield_stress: float | str
    hardening: float | str
    resistance: float | str
    exponent: float | str
    memory: ClassVar = {"yielded": NUMBER}
    unknowns: ClassVar = _STRESS
    limits: ClassVar = {**_YIELD, **_CREEP}
    stated: ClassVar = "plasticity_with_creep"


@dataclass(frozen=True)
class DruckerPrager(_Stated):
    """Yield of soil, concrete and powder: √(s:s/2) + η σ_m = k + H p, with tension positive.

    Attributes:
        cohesion: k, a stress.
        friction: η; of an angle of friction φ and the compressive cone 6 sin φ / (√3 (3 - sin φ)),
            below √3.
        dilatancy: ψ, between 0 and η, which is associated; above it flow would create energy.
        hardening: H, a stress.
    """

    cohesion: float | str
    friction: float | str
    dilatancy: float | str
    hardening: float | str = 0.0
    limits: ClassVar = {
        "cohesion": POSITIVE,
        "friction": _CONE,
        "dilatancy": _CONE,
        "hardening": NOT_NEGATIVE,
    }
    stated: ClassVar = "drucker_prager"

    def __post_init__(self) -> None:
        """Refuse a dilatancy above the friction with a SceneError.

        The statement refuses that of formulas.
        """
        super().__post_init__()
        if self._checked and float(self.dilatancy) > float(self.friction):
            raise SceneError(
                f"the dilatancy {self.dilatancy} of DruckerPrager is above its friction "
                f"{self.friction}, so that flow would create energy: give a dilatancy of at most "
                "the friction"
            )

    @property
    def _checked(self) -> bool:
        """True if friction and dilatancy are numbers, and not formulas."""
        return not {"friction", "dilatancy"} & set(self.formulas)

    def statement(self, at: At) -> Stated:
        """See :class:`Law`."""
        stated = super().statement(at)
        return stated._replace(limit=None, reason="") if self._checked else stated


@dataclass(frozen=True)
class Hill(_Framed):
    """Orthotropic yield in a frame, with linear hardening.

    F = G = H = 1/2 and L = M = N = 3/2 are von Mises'.

    Attributes:
        yield_stress, hardening: σ0 and its slope over p.
        f, g, h, l, m, n: Hill's constants.
        frame: unit vectors of the material; in the plane the third one is (0, 0, 1).
    """

    yield_stress: float | str
    hardening: float | str
    f: float | str
    g: float | str
    h: float | str
    l: float | str
    m: float | str
    n: float | str
    frame: Frame = AXES
    unknowns: ClassVar = {"ratio": NUMBER}
    limits: ClassVar = {**_YIELD, **dict.fromkeys("fghlmn", POSITIVE)}
    stated: ClassVar = "hill"


@dataclass(frozen=True)
class Orthotropic(_Framed):
    """Orthotropic elasticity, as of wood and composites; E and ν of the body are typical values.

    Attributes:
        young_1, young_2, young_3: moduli along the frame.
        poisson_12, poisson_13, poisson_23: ν_ij, the contraction along j of a pull along i.
        shear_12, shear_13, shear_23: shear moduli.
        frame: unit vectors of the material; in the plane the third one is (0, 0, 1).
    """

    young_1: float | str
    young_2: float | str
    young_3: float | str
    poisson_12: float | str
    poisson_13: float | str
    poisson_23: float | str
    shear_12: float | str
    shear_13: float | str
    shear_23: float | str
    frame: Frame = AXES
    limits: ClassVar = dict.fromkeys(
        ("young_1", "young_2", "young_3", "shear_12", "shear_13", "shear_23"), POSITIVE
    )
    elastic: ClassVar[bool] = True
    stated: ClassVar = "orthotropic"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.formulas:
            one, two, three, first, second, third, *_ = map(float, self.constants().values())
            stiff = np.diag([1 / one, 1 / two, 1 / three])
            stiff[0, 1:] = -first / one, -second / one
            stiff[1, 2] = -third / two
            if not (np.linalg.eigvalsh(stiff, UPLO="U") > 0).all():
                raise SceneError(
                    "the ratios of Orthotropic are impossible: strains would have negative energies"
                )

    def linear_stress(self, strain: Expr) -> Expr:
        """Stress as a function of the strain, both (3, 3), in UFL."""
        from hhr_dolfinx.forms.elasticity import kelvin, of_kelvin
        from hhr_dolfinx.forms.laws import At, orthotropic

        none = SimpleNamespace()
        at = At(kelvin(strain, "solid"), none, none, 0.0, SimpleNamespace(**self.constants()))
        return of_kelvin(orthotropic(at, self.frame).stress)

    @classmethod
    def transverse(
        cls,
        along: float,
        across: float,
        ratio_along: float,
        ratio_across: float,
        shear: float,
        frame: Frame = AXES,
    ) -> Orthotropic:
        """Elasticity that is isotropic across the first axis.

        Args:
            along: modulus along the first axis.
            across: modulus across it.
            ratio_along: contraction across of a pull along it.
            ratio_across: contraction across of a pull across.
            shear: shear modulus along it.
            frame: unit vectors of the material as rows.
        """
        plane = across / (2 * (1 + ratio_across))
        return cls(
            along,
            across,
            across,
            ratio_along,
            ratio_along,
            ratio_across,
            shear,
            shear,
            plane,
            frame,
        )


@dataclass(frozen=True)
class Lemaitre(_Stated):
    """Plasticity with isotropic damage, until the stress would fall: softening depends on the mesh,
    and is refused.

    Attributes:
        yield_stress, hardening: σ0 and H of the effective stress.
        strength: S, an energy per volume.
        power: s.
    """

    yield_stress: float | str
    hardening: float | str
    strength: float | str
    power: float | str = 1.0
    memory: ClassVar = {"plastic": TENSOR, "damage": NUMBER, "hardened": NUMBER}
    unknowns: ClassVar = _AMOUNT
    limits: ClassVar = {**_YIELD, "strength": POSITIVE, "power": POSITIVE}
    stated: ClassVar = "lemaitre"


@dataclass(frozen=True)
class Elasticity(Law):
    """Hooke's law."""

    def statement(self, at: At) -> Stated:
        """See :class:`Law`."""
        from hhr_dolfinx.forms.laws import Stated, hooke

        return Stated(hooke(at.strain, at.constants))


@dataclass(frozen=True)
class LinearStress(Law):
    """User-defined linear elasticity of a body beside others with laws: the stress as a function of
    the strain.
    """

    stress_of: Callable[[Expr], Expr]  #: both (3, 3), in UFL
    elastic: ClassVar[bool] = True

    def statement(self, at: At) -> Stated:
        """See :class:`Law`; nothing outside of the strain of the hypothesis is strained."""
        from hhr_dolfinx.forms.elasticity import kelvin, of_kelvin
        from hhr_dolfinx.forms.laws import Stated

        stress = self.stress_of(of_kelvin(at.strain))
        return Stated(kelvin(stress, "solid" if len(at.strain) > 4 else "plane_strain"))

    def in_plane_stress(self) -> Law:
        """See :class:`Law`; strains that shear across the plane are those without a stress too."""
        from hhr_dolfinx.forms.elasticity import SHEARS_ACROSS, without_stress

        return super(
            LinearStress, LinearStress(without_stress(self.stress_of, SHEARS_ACROSS))
        ).in_plane_stress()


@dataclass(frozen=True)
class _Around(Law):
    """Base of laws around another one, ``law``, or elasticity, with constants and a memory of their
    own.
    """

    law: Law | None
    remembers: ClassVar[tuple[str, int]]  #: name and size of its memory
    bounded: ClassVar[Mapping[str, tuple[float, float]]] = {}  #: limits of its constants
    stated: ClassVar[str]

    def __post_init__(self) -> None:
        if not (self.law is None or isinstance(self.law, Law)):
            raise SceneError(
                f"{self.law!r} is no law: give hhr.{self.name} a law, or None for elasticity"
            )
        super().__post_init__()

    def in_plane_stress(self) -> Law:
        """Around the other law in plane stress, whose strain across then holds what that law makes
        of it alone.
        """
        return replace(self, law=self._inner.in_plane_stress())

    @property
    def _inner(self) -> Law:
        return Elasticity() if self.law is None else self.law

    @property
    def memory(self) -> Mapping[str, int]:  # type: ignore[override]
        """See :class:`Law`."""
        return {**self._inner.memory, self._kept: self.remembers[1]}

    @property
    def unknowns(self) -> Mapping[str, int]:  # type: ignore[override]
        """See :class:`Law`."""
        return self._inner.unknowns

    @property
    def limits(self) -> Mapping[str, tuple[float, float]]:  # type: ignore[override]
        """See :class:`Law`."""
        return {
            **self._inner.limits,
            **{self._own[name]: ends for name, ends in self.bounded.items()},
        }

    @property
    def elastic(self) -> bool:  # type: ignore[override]
        """See :class:`Law`."""
        return self._inner.elastic

    @property
    def _own(self) -> dict[str, str]:
        """Names of its constants by field: others than those of the law, which may have one of the
        same name.
        """
        inner_constants = self._inner.constants()
        return {
            constant.name: _unused(constant.name, inner_constants)
            for constant in fields(self)
            if constant.name != "law"
        }

    @property
    def _kept(self) -> str:
        return _unused(self.remembers[0], self._inner.memory)

    def constants(self) -> dict[str, float | str]:
        """See :class:`Law`."""
        return self._inner.constants() | {
            name: getattr(self, field) for field, name in self._own.items()
        }

    def statement(self, at: At) -> Stated:
        """See :class:`Law`."""
        from hhr_dolfinx.forms import laws

        stated: Stated = getattr(laws, self.stated)(
            at, self._inner.statement, tuple(self._own.values()), self._kept
        )
        return stated


@dataclass(frozen=True)
class Heated(_Around):
    """Another law, of the strain without α (T - T0) 1.

    Attributes:
        law: the other law; None for elasticity.
        expansion: α in 1/K.
        temperature, reference: T and T0.
    """

    expansion: float | str
    temperature: float | str
    reference: float | str = 0.0
    remembers: ClassVar = ("swelling", NUMBER)
    stated: ClassVar = "heated"


@dataclass(frozen=True)
class ChangingStiffness(_Around):
    """Another law with a separate E, which may change along a path, as with temperature.

    Attributes:
        law: the other law; None for elasticity.
        modulus: this E, a number or a formula; that of the body is a typical value.
    """

    modulus: float | str
    remembers: ClassVar = ("unloaded", TENSOR)
    bounded: ClassVar = {"modulus": POSITIVE}
    stated: ClassVar = "changing_stiffness"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.elastic:
            raise SceneError(
                f"{self._inner.name} states its elasticity, whose moduli are constant numbers"
            )


def _unused(name: str, known: Mapping[str, object]) -> str:
    """A name that is not known, with ``_of_outer`` as often as necessary."""
    while name in known:
        name += "_of_outer"
    return name
