"""Fields of hyper-reduced models whose shape depends on parameters: their surface is interpolated
between shapes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.reconstruct import Reconstruction
from hhr_dolfinx.plugins.moduli.interpolation import Interpolant, unstacked
from hhr_dolfinx.plugins.shapes.functionals import ReshapedFunctionals


@dataclass(frozen=True, kw_only=True)
class ReshapedReconstruction(Reconstruction):
    """Reconstruction with gaps and rows of contact of each shape.

    Its own are those in the middle of the box. Files name the kind of
    ``functionals``, since those of one shape are another.
    """

    surface: Interpolant  #: of ``gaps`` and ``contact_basis``, concatenated
    functionals: ReshapedFunctionals | None = None  # type: ignore[assignment]

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """See :class:`Reconstruction`; also a surface of another size."""
        yield from super().faults(sizes)
        if len(self.surface.modes) != self.gaps.size + self.contact_basis.size:
            yield "gaps and rows of contact on other shapes are those of another surface"

    def surface_at(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`Reconstruction`."""
        return self._split(self.surface.value(point))

    def _split(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        gaps, contact_basis = unstacked(values, (self.gaps.shape, self.contact_basis.shape))
        return gaps, contact_basis

    def slack_changes(self, answer: Answer, changes: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """See :class:`Reconstruction`."""
        slack_changes = super().slack_changes(answer, changes, rows)
        theta = self.amplitudes(answer.parameter)
        slopes = self.surface.modes @ self.surface.slopes_along_modes(answer.parameter)
        for axis, column in zip(self.surface.axes, slopes.T, strict=True):
            gaps, contact_basis = self._split(column)
            slack_changes[:, axis] += gaps[rows] @ theta - contact_basis[rows] @ answer.unknown
        return slack_changes
