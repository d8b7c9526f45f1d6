"""Completion of stress and plastic strain of hyper-reduced inelastic models, gappy POD, thesis
section 6.2.3.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar

import numpy as np

from hhr_dolfinx.declared import Floats, Integers, Size
from hhr_dolfinx.linear.dense import lay_out
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.estimates import STRESS_INDICATOR, Estimate
from hhr_dolfinx.plugins.inelastic.state import state
from hhr_dolfinx.plugins.inelastic.trained import share_of_stress

KNOWN_ERROR = (
    "indicator of the stress: the part of it that no training explains; without a proof, silent "
    "on forces"
)
"""Estimates of inelastic models in one line."""
KNOWN_PART_ROUND_OFF = 1e-8
"""Norm of a mode on the known values, relative to the largest of the modes, below which its
amplitude is round-off: the root of the machine's precision. One of round-off, 5e-14 there, was
multiplied to errors of 6e8.
"""


@dataclass(frozen=True, eq=False)
class GappyField:
    """A field of the Gauss points from its values in the RID (gappy POD, section 6.2.3)."""

    modes: Annotated[
        Floats, "values", "modes"
    ]  #: POD modes of training states, (values everywhere, modes)
    fit: Annotated[Floats, "modes", "known values"]  #: amplitudes of the modes per value in the RID

    def __post_init__(self) -> None:
        """Copy arrays to the order of files."""
        lay_out(self)

    @classmethod
    def fitted(cls, modes: np.ndarray, inside: np.ndarray) -> GappyField:
        """Field from modes and the numbers of the values in the RID.

        Modes that these do not show have no amplitude.

        Args:
            modes: POD modes, (values, modes).
            inside: numbers of the values in the RID.
        """
        return cls(modes, np.linalg.pinv(modes[inside], rcond=KNOWN_PART_ROUND_OFF))

    def everywhere(self, inside: np.ndarray) -> np.ndarray:
        """The field everywhere, fitted to its values in the RID by least squares."""
        return self.modes @ (self.fit @ inside)


@dataclass(frozen=True, eq=False)
class FlowFields:
    """Reconstruction of stress and plastic strain of inelastic bodies."""

    kind: ClassVar[str] = STRESS_INDICATOR
    known_error: ClassVar[str] = KNOWN_ERROR

    points: Annotated[
        Integers, "points", "< gauss points"
    ]  #: numbers of the Gauss points of the RID in the full model
    stress: GappyField  #: reconstruction of the stress, with adjacent components of each point
    cumulated: (
        GappyField | None
    )  #: reconstruction of the cumulated plastic strain; None if it was zero in training
    gauss_points: Annotated[Size, "gauss points"]  #: number of Gauss points of the full model

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Modes of other points."""
        values = len(self.stress.modes)
        evaluated = self.stress.fit.shape[1]
        components = values // max(self.gauss_points, 1)
        if (values, evaluated) != (components * self.gauss_points, components * self.points.size):
            yield (
                f"{values} values of the stress, {evaluated} of them known, are not the same for "
                "each Gauss point"
            )
        if self.cumulated is not None:
            sizes_of_modes = len(self.cumulated.modes), self.cumulated.fit.shape[1]
            if sizes_of_modes != (self.gauss_points, self.points.size):
                yield f"{sizes_of_modes} plastic strains are not one for each Gauss point"

    @property
    def places(self) -> int:
        """Number of Gauss points of the full model."""
        return self.gauss_points

    def stress_of(self, answer: Answer) -> np.ndarray:
        """Stress of an answer at all Gauss points, of laws in the RID, (Gauss points,
        components).
        """
        evaluated = state(answer).stress
        field = self.stress.everywhere(evaluated.ravel()).reshape(
            self.gauss_points, evaluated.shape[1]
        )
        field[self.points] = evaluated
        return field

    def plastic_strain(self, answer: Answer) -> np.ndarray:
        """Cumulated plastic strain of an answer at all Gauss points, never negative, (Gauss
        points,).
        """
        evaluated = state(answer).state.cumulated
        field = np.zeros(self.gauss_points)
        if self.cumulated is not None:
            field = np.maximum(self.cumulated.everywhere(evaluated), 0.0)
        field[self.points] = evaluated
        return field

    def estimate(self, answer: Answer) -> Estimate:
        """Indicator of the error, the part of the stress that the training does not represent.

        See docs/history_indicator.md.
        """
        return Estimate.indicated(
            share_of_stress(*self.unexplained(state(answer).stress)), STRESS_INDICATOR
        )

    @cached_property
    def _products(self) -> np.ndarray:
        """Gram matrix of the modes of the stress on the values at evaluated points, (modes,
        modes).
        """
        components = len(self.stress.modes) // self.gauss_points
        shown = self.stress.modes.reshape(self.gauss_points, components, -1)[self.points]
        shown = shown.reshape(self.points.size * components, -1)
        return shown.T @ shown

    def unexplained(self, inside: np.ndarray) -> tuple[float, float]:
        """|σ - Φ fit σ| and |σ| of the stress at evaluated points.

        Values below 1e-8 of the stress are round-off.
        """
        stress = inside.ravel()
        amplitudes = self.stress.fit @ stress
        size = float(stress @ stress)
        return math.sqrt(
            max(size - float(amplitudes @ (self._products @ amplitudes)), 0.0)
        ), math.sqrt(size)
