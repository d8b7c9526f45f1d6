"""Motions of rigid tools as outputs."""

from __future__ import annotations

from dataclasses import dataclass

from scipy.sparse import csr_matrix

from hhr_dolfinx.amplitudes import Amplitude
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.models.functionals.functional import Functional
from hhr_dolfinx.models.functionals.kinds import Linear
from hhr_dolfinx.outputs import ModelProbe, NamedOutput
from hhr_dolfinx.parameters import is_whole
from hhr_dolfinx.plugins.constraints.couplings import CoupledForce
from hhr_dolfinx.plugins.rigid_tools.drive import components_of
from hhr_dolfinx.plugins.rigid_tools.mesh import tools_of


@dataclass(frozen=True)
class ToolMotion(NamedOutput):
    """Motion of a rigid tool of :func:`~hhr_dolfinx.drive` at its reference point.

    Attributes:
        component: 0 to 2 of the displacement, then turns, in rad, as those of ``hhr.drive``.
        tool: name of the tool.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> from dataclasses import replace
        >>> from hhr_dolfinx.geometries import block
        >>> above = hhr.Obstacle(block.side(1, upper=True), normal=(0, 1), offset=1.0)
        >>> foot = hhr.Displacement.clamp(block.side(1, upper=False), 2)
        >>> sinks = hhr.ToolMotion("sinks", component=1, unit="mm")
        >>> pressed = replace(scene, contacts=(above,), displacements=foot, loads=())
        >>> driven = hhr.drive(pressed, 0, at=(0.5, 1.0), force={1: "-push", 2: 0.0})
        >>> model = hhr.condense(replace(driven, outputs=(sinks,)))
        >>> round(1e3 * model.outputs({"push": 50.0})["sinks"], 2)
        -0.18
    """

    component: int
    tool: str = "tool"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not is_whole(self.component, 0) or not isinstance(self.tool, str):
            raise SceneError(
                f"output '{self.name}': the component {self.component!r} must be a number from 0, "
                f"and the tool {self.tool!r} a name"
            )

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`~hhr_dolfinx.outputs.Output`.

        Args:
            probe: interface of the model.

        Raises:
            SceneError: for a tool that the scene does not have, or a component that it does not
                have.
        """
        known = tools_of(probe.scene.geometry)
        if self.tool not in known:
            has = ", ".join(known) or "none"
            raise SceneError(
                f"output '{self.name}': the scene has no tool '{self.tool}', but {has}: name one "
                "that hhr.drive has made"
            )
        components = components_of(probe.scene.hypothesis, probe.dimension)
        if self.component not in components:
            raise SceneError(
                f"output '{self.name}': component {self.component} of tool '{self.tool}' does not "
                f"exist: name one of {components}"
            )
        point = None if probe.scene.hypothesis == "axisymmetric" else known[self.tool]
        unit_force = CoupledForce(self.tool, self.component, Amplitude(1.0), point)
        (term,) = unit_force.terms(probe.assembler)
        return Linear.of(self.name, self.unit, row=csr_matrix(term.columns.T))
