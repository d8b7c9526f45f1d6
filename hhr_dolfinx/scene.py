"""Scene: geometry, materials, contact pairs, loads and parameter space; the one thing a user writes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.forms import elasticity
from hhr_dolfinx.pairings import Pairing
from hhr_dolfinx.parameters import Amplitude, ParameterSpace

if TYPE_CHECKING:
    from hhr_dolfinx.forms.plasticity import Flow


@dataclass(frozen=True)
class Body:
    """A body, elastic or with a flow.

    Attributes:
        tag: cell tag.
        young: Young's modulus E, in the unit of stress of the scene.
        poisson: Poisson's ratio.
        law: how it flows, a :class:`~hhr_dolfinx.forms.plasticity.Flow`; None for an elastic body.
    """

    tag: int
    young: float
    poisson: float
    law: Flow | None = None

    def __post_init__(self):
        """Refuse constants for which the elastic energy is not positive, and laws that are none."""
        if self.law is not None and (isinstance(self.law, type) or not callable(getattr(self.law, "flow", None))):
            raise SceneError(f"body {self.tag}: the law {self.law!r} must be an object with a method flow")
        if not self.young > 0 or not -1 < self.poisson < 0.5:
            raise SceneError(f"body {self.tag}: E = {self.young} must be positive and nu = {self.poisson} in (-1, 0.5)")


@dataclass(frozen=True)
class Displacement:
    """Imposed displacement of one component on tagged facets: ``u[component] = amplitude(mu)``."""

    tag: int
    component: int
    amplitude: Amplitude = Amplitude()


@dataclass(frozen=True)
class Traction:
    """Surface force ``amplitude(mu) * direction`` per area on tagged facets."""

    tag: int
    direction: tuple[float, ...]
    amplitude: Amplitude

    def __post_init__(self):
        """Refuse a direction that is not finite."""
        if not all(math.isfinite(value) for value in self.direction):
            raise SceneError(f"the traction {self.direction} on tag {self.tag} must be finite")

    def form(self, v, hypothesis: str, ds):
        """Its linear form for the amplitude 1."""
        return elasticity.traction(v, self.direction, hypothesis, ds)


@dataclass(frozen=True)
class Pressure:
    """Pressure ``amplitude(mu)`` against the outer normal of tagged facets."""

    tag: int
    amplitude: Amplitude

    def form(self, v, hypothesis: str, ds):
        """Its linear form for the amplitude 1."""
        return elasticity.pressure(v, hypothesis, ds)


@dataclass(frozen=True)
class PartialPressure:
    """Pressure on the part of a straight line with coordinate up to a parameter, in two dimensions.

    Integrated exactly over the partly covered edge, and evaluated online from three terms.

    Attributes:
        tag: facet tag of the line, which runs along an axis.
        amplitude: the pressure.
        extent: name of the parameter up to which it acts.
        axis: coordinate along the line.
    """

    tag: int
    amplitude: Amplitude
    extent: str
    axis: int = 1


@dataclass(frozen=True)
class Opening:
    """An initial gap that depends on parameters: ``amplitude(mu)`` is added to all gaps of a contact pair.

    Attributes:
        contact: place of the pair in ``Scene.contacts``.
        amplitude: the gap added.
    """

    contact: int
    amplitude: Amplitude


@dataclass(frozen=True)
class Scene:
    """All that defines one parametric contact problem.

    Attributes:
        name: used for files and for the prefix of PETSc options, ``hhr_<name>_``.
        geometry: function of a communicator that returns ``(mesh, cell_tags, facet_tags)``.
        hypothesis: ``plane_strain``, ``plane_stress``, ``axisymmetric`` or ``solid``.
        bodies: one per cell tag.
        contacts: contact pairs, each a :class:`~hhr_dolfinx.pairings.Pairing`.
        displacements: imposed displacements.
        loads: surface loads, :class:`Traction`, :class:`Pressure`, :class:`PartialPressure`, or your own with a
            ``tag``, an ``amplitude`` and its linear ``form(v, hypothesis, ds)``.
        parameters: the box of the parameters.
        openings: initial gaps that depend on parameters.
    """

    name: str
    geometry: Callable[[Any], tuple]
    hypothesis: str
    bodies: tuple[Body, ...]
    contacts: tuple[Pairing, ...]
    parameters: ParameterSpace
    displacements: tuple[Displacement, ...] = ()
    loads: tuple[Any, ...] = ()
    openings: tuple[Opening, ...] = ()

    def __post_init__(self):
        """Refuse what no geometry could make right."""
        if self.hypothesis not in elasticity.HYPOTHESES:
            raise SceneError(f"unknown hypothesis '{self.hypothesis}', one of {', '.join(elasticity.HYPOTHESES)}")
        if not self.name.isidentifier():
            raise SceneError(f"scene name '{self.name}' must be an identifier: it prefixes PETSc options")
        if not self.bodies:
            raise SceneError("a scene needs at least one body")
        for opening in self.openings:
            if not 0 <= opening.contact < len(self.contacts):
                raise SceneError(f"an opening names contact {opening.contact}, of {len(self.contacts)} counted from 0")
        if not self.contacts:
            raise SceneError("a scene without contact pairs is a linear problem: nothing to hyper-reduce")
