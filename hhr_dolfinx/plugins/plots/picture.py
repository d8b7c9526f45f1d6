"""Contents of a picture of an answer: positions, colours, pressures, statuses and names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from textwrap import fill
from typing import TYPE_CHECKING, cast

import numpy as np

from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.materials.elasticity import von_mises
from hhr_dolfinx.models.answer import Answer, Meshed
from hhr_dolfinx.models.answer_mesh import AnswerMesh
from hhr_dolfinx.models.shown import SHOWN_NUMBERS
from hhr_dolfinx.plugins.plots.contact_fields import (
    OPEN,
    contact_gaps,
    is_full,
    statuses,
)
from hhr_dolfinx.plugins.plots.deformed import Deformed, DrawnContact, deformed
from hhr_dolfinx.plugins.plots.recovery import stress_samples
from hhr_dolfinx.plugins.plots.surface_fields import displacement_seen

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.pages.beside import MeshBeside

LETTERS = 9
"""Letters of a title per inch."""
FIRM_SPACE = "\N{NO-BREAK SPACE}"
BAR = 35
"""Length over width of bars of colours."""
COLOURS = "viridis"
PEAK = 99.7
"""Percentile of values that bounds the colours if the largest is far above: stress at corners."""
FAR_ABOVE = 1.5


def colour_limits(values: np.ndarray) -> tuple[float, float, str]:
    """Ends of the colours of values from zero on, and ``max`` if some values lie above.

    >>> colour_limits(np.array([0.0, 1.0, 2.0]))
    (0.0, 2.0, 'neither')
    """
    values = values[np.isfinite(values)]
    largest = float(values.max(initial=0.0))
    high = float(np.percentile(values, PEAK)) if values.size else 0.0
    if 0 < FAR_ABOVE * high < largest:
        return 0.0, high, "max"
    return 0.0, largest or 1.0, "neither"


def in_unit(unit: str) -> str:
    """End of a label: the unit in brackets, or nothing.

    >>> in_unit("MPa")
    ' [MPa]'
    """
    return f" [{unit}]" if unit else ""


def wrapped(title: str, width: float) -> str:
    """A title in lines of a figure, broken between parameters only.

    Args:
        title: name of the scene and parameters, separated by commas.
        width: of the figure in inches.

    >>> print(wrapped("lid at push = 1 mm, pull = 2 mm", 2.5))
    lid at push = 1 mm,
    pull = 2 mm
    """
    firm = ", ".join(part.replace(" ", FIRM_SPACE) for part in title.split(", "))
    return fill(firm, int(LETTERS * width)).replace(FIRM_SPACE, " ")


def contact_names(meshed: Meshed) -> list[str]:
    """Name of each contact: the tags of its surfaces, which are names where the mesh has them."""
    if is_full(meshed):
        return [" and ".join(map(str, contact.tags)) for contact in meshed.scene.contacts]
    beside = cast("MeshBeside", meshed)
    return list(beside.contact_names())


def mesh_at(meshed: Meshed, parameter: np.ndarray) -> AnswerMesh:
    """Mesh with the shape of bodies at a parameter, (P,).

    Args:
        meshed: the full model, or the mesh beside a model file.
        parameter: parameters, (P,).
    """
    mesh = meshed.answer_mesh()
    if is_full(meshed) and meshed.problem.reshaped is not None:
        problem = meshed.problem.at(parameter)
        return replace(mesh, points=problem.points, contact_points=problem.contact_points)
    return mesh


def _units_of_parameters(meshed: Meshed) -> Mapping[str, str]:
    """Units of the parameters by name."""
    if is_full(meshed):
        return meshed.scene.parameter_units
    beside = cast("MeshBeside", meshed)
    return dict(beside.parameter_units())


@dataclass(frozen=True, eq=False)
class Picture:
    """Contents of a picture of an answer.

    Attributes:
        answer: the answer.
        mesh: the mesh.
        deformed: positions of the nodes, and the factor of displacements.
        values: colours at the nodes for each body, (n,) each, NaN elsewhere: von Mises' stress, or
            the length of the displacement if stress is unknown.
        label: name of the colours with their unit.
        pressures: of the conditions, (m,), in the unit of stress; NaN without an area.
        statuses: of the conditions, (m,), see :func:`~.contact_fields.statuses`.
        contact_names: name of each contact.
        units: units of the parameters by name, of those that have one.
    """

    answer: Answer
    mesh: AnswerMesh
    deformed: Deformed
    values: list[np.ndarray]
    label: str
    pressures: np.ndarray
    statuses: np.ndarray
    contact_names: list[str]
    units: Mapping[str, str]

    @classmethod
    def of(cls, answer: Answer, meshed: Meshed, scale: float | None = None) -> Picture:
        """Contents of a picture.

        Args:
            answer: answer of any model of the scene.
            meshed: the full model, or the mesh beside a model file.
            scale: factor of displacements; None chooses a power of ten.

        Raises:
            NotOfferedError: for an answer of another scene.
        """
        mesh = mesh_at(meshed, answer.parameter)
        pressures = answer.pressure(meshed)
        # nodes within bodies are not drawn
        field = np.nan_to_num(mesh.nodal(displacement_seen(answer)))
        states = statuses(answer, meshed)
        contact = None
        try:
            rows, undeformed = contact_gaps(meshed, answer.parameter)
            contact = DrawnContact(rows, undeformed, mesh.pressing, states > OPEN)
        except NotOfferedError:  # a file of an earlier release, whose surfaces stay as they are
            pass
        positions = deformed(mesh, field, scale, contact)
        values, label = _colours(meshed, answer, mesh, field)
        names = contact_names(meshed)
        units = _units_of_parameters(meshed)
        return cls(answer, mesh, positions, values, label, pressures, states, names, units)

    @property
    def title(self) -> str:
        """Name of the scene, and the parameters with their units."""
        names = self.mesh.parameters
        units = [self.units.get(name, "") for name in names]
        rows = zip(names, self.answer.parameter, units, strict=True)
        shown = [f"{name} = {value:.6g} {unit}".strip() for name, value, unit in rows]
        dots = ["..."] if len(shown) > SHOWN_NUMBERS else []
        return f"{self.mesh.name} at {', '.join([*shown[:SHOWN_NUMBERS], *dots])}"

    @property
    def largest_pressure(self) -> float:
        """Largest pressure of all contacts; 1 without any."""
        conditions = np.concatenate(self.with_area)
        return float(self.pressures[conditions].max(initial=0.0)) or 1.0

    @property
    def bodies(self) -> int:
        """Number of bodies."""
        return len(self.values)

    @property
    def with_area(self) -> list[np.ndarray]:
        """Numbers of the conditions of pressures of each contact that have an area."""
        finite = np.isfinite(self.pressures)
        return [conditions[finite[conditions]] for conditions in self.mesh.contacts]

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return ("r", "z") if self.mesh.axisymmetric else ("x", "y", "z")

    @property
    def scale_words(self) -> str:
        """Title that states the factor of displacements."""
        factor = self.deformed.factor
        return "" if factor == 1 else f"displacements {factor:g} times as large"


def _colours(
    meshed: Meshed,
    answer: Answer,
    mesh: AnswerMesh,
    field: np.ndarray,
) -> tuple[list[np.ndarray], str]:
    """Von Mises' stress at the nodes of each body, or lengths of displacements, and the label."""
    count = int(mesh.bodies.max()) + 1
    samples = stress_samples(meshed, answer)
    if samples is None:
        lengths = np.linalg.norm(field, axis=1)
        return [lengths] * count, f"displacement{in_unit(mesh.length)}"
    size = len(mesh.points)
    values = [von_mises(samples.at_nodes(body, size)) for body in range(count)]
    filled = [_filled(mesh, body, stress) for body, stress in enumerate(values)]
    return filled, f"von Mises stress{in_unit(mesh.stress)}"


def _filled(mesh: AnswerMesh, body: int, values: np.ndarray) -> np.ndarray:
    """Values at the nodes of a body; nodes without one, as within edges, take means of cells."""
    cells = mesh.cells[mesh.bodies == body]
    nodes = np.unique(cells)
    if np.isfinite(values[nodes]).all():
        return values
    finite = np.isfinite(values[cells])
    means = np.where(finite, values[cells], 0.0).sum(axis=1) / np.maximum(finite.sum(axis=1), 1)
    sums = np.zeros(len(values))
    counts = np.zeros(len(values))
    for column in cells[finite.any(axis=1)].T:
        np.add.at(sums, column, means[finite.any(axis=1)])
        np.add.at(counts, column, 1.0)
    with np.errstate(invalid="ignore"):
        return np.where(np.isfinite(values), values, sums / counts)
