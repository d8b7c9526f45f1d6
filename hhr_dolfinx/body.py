"""Body: the material of the cells with one tag."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from numbers import Real
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from hhr_dolfinx import registry
from hhr_dolfinx.amplitudes import RANGES, Limits, check_formula
from hhr_dolfinx.declared import KnownArguments
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.parameters import ParameterSpace, Tag, check_tag, is_number
from hhr_dolfinx.units import Units

if TYPE_CHECKING:
    from ufl import SpatialCoordinate
    from ufl.core.expr import Expr


class LawsOfScenes(Protocol):
    """Checks of scenes by a plug-in that reads laws of bodies: its facet ``scene``."""

    def check_body(self, body: Body) -> None:
        """Raise SceneError for a body whose law, elasticity or grading is not built in."""

    def linear_stress(self, law: object) -> Callable[[Expr], Expr] | None:
        """Stress of a law that is linear elasticity, as :attr:`Body.stress`.

        None for any other law.
        """

    def check_hypothesis(self, law: object, hypothesis: str) -> None:
        """Check that a body can have a law under a hypothesis, such as plane strain.

        Args:
            law: the law.
            hypothesis: hypothesis of the scene.

        Raises:
            SceneError: if no body can.
        """

    def parameters_of(self, law: object) -> set[str]:
        """Names of the parameters on which a law depends."""


@dataclass(frozen=True)
class Body(KnownArguments):
    """A body, elastic or of a law that a plug-in reads.

    Attributes:
        tag: cell tag.
        young: Young's modulus E, in the unit of stress of the scene: a number, or a formula of the
            parameters as text, ``"E1"`` or ``"200e3 * (1 - 2e-4 * T)"``, see
            :mod:`hhr_dolfinx.formulas`. In scenes with laws of bodies it may differ between
            histories, but not along one.
        poisson: Poisson's ratio, a number or a formula, as ``young``.
        law: law in addition to elasticity, such as that of plasticity or creep, see :attr:`reader`;
            None for an elastic body.
        grading: factor of the modulus of a graded or layered body, as a function of the
            coordinates, UFL to UFL; None for 1. It multiplies no constant of a law.
        stress: user-defined linear elasticity in UFL, such as that of wood: a function of the
            strain, 3x3, that returns the stress, 3x3, with a symmetric stiffness. ``young`` and
            ``poisson`` are then typical values that do not enter the stiffness. None for Hooke's
            law.

    Example:
        >>> hhr.Body("valve", young="200e3 * (1 - 2e-4 * T)", poisson=0.3).young
        '200e3 * (1 - 2e-4 * T)'
        >>> hhr.Body.of("seat", "steel", hhr.Units("mm", "MPa")).young
        210000.0
    """

    by_place: ClassVar[bool] = True  #: whether places, such as Nodes, hold nodes of it

    tag: Tag
    young: float | str
    poisson: float | str
    law: Any = None
    grading: Callable[[SpatialCoordinate], Expr] | None = None
    stress: Callable[[Expr], Expr] | None = None

    def __post_init__(self):
        check_tag("body", self.tag)
        if self.stress is not None and not callable(self.stress):
            raise SceneError(
                f"body {self.tag}: the stress {self.stress!r} must be a function of the strain, "
                "in UFL"
            )
        if self.stress is not None and (
            self.law is not None or self.grading is not None or self.varies
        ):
            raise SceneError(
                f"body {self.tag} has a user-defined stress, and a law, a grading or formulas "
                "besides: that is not built in, write all of it into the stress"
            )
        for name in RANGES:
            value = getattr(self, name)
            if isinstance(value, str):
                from hhr_dolfinx.formulas import formula_of

                formula_of(value, f"{name} of body {self.tag}")
            elif not isinstance(value, Real):
                raise SceneError(
                    f"body {self.tag}: {name} = {value!r} must be a number, or a formula of the "
                    "parameters as text"
                )
        if self.grading is not None and not callable(self.grading):
            raise SceneError(
                f"body {self.tag}: the grading {self.grading!r} must be a function of the "
                "coordinates"
            )
        if self.law is not None:
            laws_of_scenes(self.plugin).check_body(self)
        if remedy := _remedy_of_constants(self.young, self.poisson):
            raise SceneError(
                f"body {self.tag}: young = {self.young} must be positive and finite, and poisson "
                f"= {self.poisson} in (-1, 0.5). {remedy}"
            )

    @classmethod
    def of(cls, tag: Tag, material: str, units: Units, **more: Any) -> Body:
        """Make a body of a material by name, such as ``steel``, see
        :mod:`hhr_dolfinx.materials.elasticity`.

        Args:
            tag: cell tag.
            material: name of the material.
            units: units of the scene.
            more: further attributes.

        Raises:
            SceneError: for an unknown material.
        """
        from hhr_dolfinx.materials.elasticity import elastic

        try:
            constants = elastic(material)
        except SceneError as error:
            raise SceneError(f"body {tag}: {error}") from None
        return cls(tag, young=units.stress_of(constants.young), poisson=constants.poisson, **more)

    @property
    def plugin(self) -> str:
        """Name of the plug-in that reads the law, empty without one; SceneError if none does."""
        return "" if self.law is None else registry.reader_of(self.law, f"body {self.tag}")

    @property
    def own_stress(self) -> Callable[[Expr], Expr] | None:
        """Linear elasticity that is not Hooke's: :attr:`stress`, or that of a law which is linear.

        None for others.
        """
        if self.law is None:
            return self.stress
        return laws_of_scenes(self.plugin).linear_stress(self.law)

    @property
    def reader(self) -> str:
        """Name of the plug-in that solves for the law, empty for a body that is linearly
        elastic.
        """
        return "" if self.own_stress is not None else self.plugin

    @property
    def varies(self) -> bool:
        """True if the elasticity depends on parameters."""
        return isinstance(self.young, str) or isinstance(self.poisson, str)

    def limits(self, names: tuple[str, ...]) -> tuple[Limits, ...]:
        """Elastic constants that are formulas, bound to the names of the parameters."""
        return tuple(
            Limits(name, text, names)
            for name in RANGES
            if isinstance(text := getattr(self, name), str)
        )

    def check(self, parameters: ParameterSpace, hypothesis: str) -> None:
        """Check the moduli and the law of the body.

        Args:
            parameters: the parameters with their box.
            hypothesis: hypothesis of the scene.

        Raises:
            SceneError: for a modulus or a ratio that is invalid somewhere in the box, or a law that
                the hypothesis does not admit.
        """
        if self.law is not None:
            laws_of_scenes(self.plugin).check_hypothesis(self.law, hypothesis)
        for name, remedy in (
            ("young", "Young's modulus must be positive everywhere in the box: narrow it"),
            ("poisson", "keep Poisson's ratio in (-1, 0.5), or narrow the box"),
        ):
            if isinstance(value := getattr(self, name), str):
                check_formula(value, parameters, f"{name} of body {self.tag}", RANGES[name], remedy)


def laws_of_scenes(reader: str) -> LawsOfScenes:
    """Checks of scenes by the plug-in that reads their laws."""
    facet: LawsOfScenes = registry.facet(reader, "scene", "a scene whose bodies have laws")
    return facet


def _remedy_of_constants(young: float | str, poisson: float | str) -> str:
    """Advice for invalid elastic constants; empty for valid ones."""
    if not isinstance(young, str) and not (is_number(young) and young > 0):
        return "Give E in the unit of stress of the scene, 210e3 for steel in MPa"
    if isinstance(poisson, str) or -1 < poisson < 0.5:
        return ""
    if not poisson >= 0.5:
        return "Give nu as a ratio, 0.3 for steel"
    if poisson > 1:
        return f"Give nu as a ratio and not in percent: {poisson / 100:g}"
    return "Where the volume is kept, as in rubber, take nu = 0.499"
