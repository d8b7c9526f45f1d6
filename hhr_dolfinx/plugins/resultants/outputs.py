"""Outputs of contacts: contact area and centre of pressure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.models.functionals.functional import Functional
from hhr_dolfinx.outputs import ContactWidth, ModelProbe, OfContact, no_rows
from hhr_dolfinx.parameters import is_whole
from hhr_dolfinx.plugins.resultants.kinds import Centre


@dataclass(frozen=True)
class ContactArea(ContactWidth):
    """Area of a contact that is under load: a width per unit depth in the plane.

    Nodes with less than a thousandth of the largest pressure do not count; the area changes by
    steps of a cell. In axisymmetry it is the area of the whole turn. ``ContactWidth`` is the same.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> from dataclasses import replace
        >>> width = hhr.ContactArea("width", contact=0, unit="mm")
        >>> model = hhr.condense(replace(scene, outputs=(width,)))
        >>> round(model.outputs({"push": 50.0})["width"], 3)
        1.625
    """


@dataclass(frozen=True)
class CentreOfPressure(OfContact):
    """Coordinate of the centre of the pressures of a contact, Σ p A x / Σ p A; NaN without any.

    Positions are those of the nodes before they move, in the unit of length.

    Attributes:
        component: 0, 1 or 2. In axisymmetry 1 alone: the centre lies on the axis.

    Raises:
        SceneError: for another component.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> from dataclasses import replace
        >>> centre = hhr.CentreOfPressure("centre", contact=0, component=0, unit="mm")
        >>> model = hhr.condense(replace(scene, outputs=(centre,)))
        >>> round(model.outputs({"push": 50.0})["centre"], 2)
        1.34
    """

    component: int

    def __post_init__(self) -> None:
        super().__post_init__()
        if not is_whole(self.component, 0) or self.component > 2:
            message = f"output '{self.name}': the component {self.component!r}"
            raise SceneError(f"{message} must be 0, 1 or 2")

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`~hhr_dolfinx.outputs.Output`.

        Args:
            probe: interface of the model.

        Raises:
            SceneError: for a component that the mesh does not have, or the radius in axisymmetry.
        """
        if self.component >= probe.dimension:
            message = f"output '{self.name}': the mesh has {probe.dimension} components"
            raise SceneError(f"{message}, none is {self.component}")
        if probe.scene.hypothesis == "axisymmetric" and self.component == 0:
            raise SceneError(
                f"output '{self.name}': forces around the whole turn balance across the axis, and "
                "their centre lies on it: take component 1, along the axis"
            )
        conditions = probe.conditions(self)
        shares = probe.problem.shares_of(self.contact)[conditions]
        positions = np.ascontiguousarray(probe.problem.contact_points[conditions, self.component])
        numbers = conditions.astype(np.int64), shares, positions
        return Centre(self.name, self.unit, *no_rows(), *numbers)
