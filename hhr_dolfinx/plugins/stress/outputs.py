"""Outputs of stress and energy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.models.functionals.functional import Functional
from hhr_dolfinx.outputs import ModelProbe, NamedOutput
from hhr_dolfinx.parameters import Tag, as_tuple, check_tag, is_number
from hhr_dolfinx.plugins.stress.kinds import COMPONENTS, PRINCIPAL_VALUES


@dataclass(frozen=True)
class VonMises(NamedOutput):
    """Von Mises equivalent stress of a body: in the middles of its cells, or where laws of bodies
    are evaluated.

    Attributes:
        tag: cell tag of the body.
        kind: ``max``, or ``mean`` over the volume.
        where: two corners of a box, for the cells whose middle lies inside; None for the whole
            body.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> from dataclasses import replace
        >>> from hhr_dolfinx.geometries import block
        >>> mean = hhr.VonMises("mean", block.SOLID, kind="mean", unit="MPa")
        >>> model = hhr.condense(replace(scene, outputs=(mean,)))
        >>> round(model.outputs({"push": 50.0})["mean"], 1)
        41.8
    """

    tag: Tag
    kind: str = "max"
    where: tuple[Sequence[float], Sequence[float]] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_tag(f"body of output '{self.name}'", self.tag)
        if self.kind not in ("max", "mean"):
            raise SceneError(
                f"output '{self.name}': the kind {self.kind!r} must be 'max' or 'mean'"
            )
        if self.where is not None:
            corners = as_tuple(f"where of output '{self.name}'", self.where)
            box = [
                as_tuple(f"a corner of where of output '{self.name}'", corner) for corner in corners
            ]
            if len(box) != 2 or not all(is_number(value) for corner in box for value in corner):
                raise SceneError(
                    f"output '{self.name}': where = {self.where!r} must be two corners, (lower, "
                    "upper)"
                )
            object.__setattr__(self, "where", tuple(box))

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`hhr_dolfinx.outputs.Output`."""
        from hhr_dolfinx.plugins.stress.mesh import mises_of

        return mises_of(probe, self)


@dataclass(frozen=True)
class ElasticEnergy(NamedOutput):
    """Elastic energy of all bodies, ∫ σ : C^-1 σ / 2, with the elasticity C of each.

    Per unit depth in the plane.

    Strains that cause no stress, thermal and plastic ones, have no part in it. Springs have none
    either: theirs is k u² / 2 each. Elastic bodies take the work of all forces, which is that
    energy in equilibrium, under any law of contact; in a reduced model it has the errors of forces
    and displacement. Bodies with laws take the stress where laws are evaluated, with C of E, ν and
    the grading; along their histories it has no derivatives. Laws that change C are refused. The
    energy of a user-defined system is all that its stiffness stores.
    """

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`hhr_dolfinx.outputs.Output`."""
        from hhr_dolfinx.plugins.stress.energy import energy_of

        return energy_of(probe, self)


@dataclass(frozen=True)
class StressAt(NamedOutput):
    """Component or principal value of the stress of a body at a point, in the unit of stress.

    It is that of the cell whose middle is nearest to the point, or the mean of several that are
    equally near, weighted by their volumes, as around a node. For bodies with laws it is the mean
    over the points of these cells where the laws are evaluated.

    Attributes:
        place: coordinates of the point, in the unit of length.
        component: ``xx``, ``yy``, ``zz``, ``xy``, ``xz``, ``yz``; in axisymmetry ``rr``, ``zz``,
            ``tt`` for the hoop stress, ``rz``; or ``principal_1``, the largest principal value, to
            ``principal_3``, the smallest. Tension is positive.
        tag: cell tag of the body.

    Raises:
        SceneError: for an unknown component.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> from dataclasses import replace
        >>> from hhr_dolfinx.geometries import block
        >>> bending = hhr.StressAt("bending", (0.0, 1.0), "xx", tag=block.SOLID, unit="MPa")
        >>> model = hhr.condense(replace(scene, outputs=(bending,)))
        >>> round(model.outputs({"push": 50.0})["bending"], 1)
        27.0
    """

    vectors: ClassVar[tuple[str, ...]] = ("place",)

    place: tuple[float, ...]
    component: str
    tag: Tag

    def __post_init__(self) -> None:
        super().__post_init__()
        check_tag(f"body of output '{self.name}'", self.tag)
        known = {*PRINCIPAL_VALUES, *(name for names in COMPONENTS.values() for name in names)}
        if self.component not in known:
            raise SceneError(
                f"output '{self.name}': the component {self.component!r} must be one of "
                f"{', '.join(sorted(known))}"
            )

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`hhr_dolfinx.outputs.Output`.

        Args:
            probe: interface of the model.

        Raises:
            SceneError: for a component that the hypothesis does not have, a point off the body, or
                a plug-in of laws that does not tell where it evaluates them.
        """
        from hhr_dolfinx.plugins.stress.mesh import stress_at

        return stress_at(probe, self, self.component, self.tag)
