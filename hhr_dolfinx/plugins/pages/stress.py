"""Von Mises' stress on a page: strains in few modes, moduli as formulas, and the error."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, diags, kron

from hhr_dolfinx.formulas import Scalar
from hhr_dolfinx.materials.elasticity import von_mises
from hhr_dolfinx.plugins.pages.packing import BASE64, DRAWN_ROUND_OFF, Json, Packed, steps_of
from hhr_dolfinx.plugins.pages.scenery import Strains

STRESS_MODES_ERROR = 3e-3
"""Relative truncation error of the stress."""
STRESS_LEVELS = 127
"""Quantisation levels of the modes of the stress: in a colour scale finer ones look the same."""
FALSE = 0.05
"""Allowed relative error of the largest stress."""
HELD_OUT_STRIDE = 4
"""One of so many answers is held out of the modes, to measure their error."""


class Stress:
    """Von Mises' stress from strains of the drawn cells, as a page computes it.

    Attributes:
        rows: map from displacements to strains times μ' at the middle of the box, (n c, N): modes
            are then as accurate for stiff bodies as for soft ones. The third component is left out:
            it is zero in plane stress, else strains are deviators, which have no trace.
    """

    def __init__(self, strains: Strains, names: tuple[str, ...], middle: np.ndarray):
        self._strains = strains
        self._moduli = [[Scalar(text, names) for text in pair] for pair in strains.moduli]
        self._middle = np.array([shape.value(middle) for _, shape in self._moduli])
        projection = np.eye(strains.components)
        if not strains.plane_stress:
            projection[:3, :3] -= 1 / 3
        scale = diags(self._middle[strains.bodies])
        self.rows = csr_matrix(kron(scale, np.delete(projection, 2, axis=0)) @ strains.rows)

    @property
    def size(self) -> int:
        """Bytes of its arrays as text."""
        return int(BASE64 * (4 * len(self._strains.cells) + len(self._strains.bodies)))

    def mises(self, values: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Von Mises' stress of values of the rows, (n c,), at a point, (P,): (c,)."""
        return von_mises(self.deviators(values, point))

    def deviators(self, values: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Deviators of the stress of cells, in plane stress the stress itself; Kelvin's notation.

        Args:
            values: products of the rows with a displacement, (n c,).
            point: point of the box, (P,).

        Returns:
            Tensors, (c, components).
        """
        bodies = self._strains.bodies
        moduli = np.array([[modulus.value(point) for modulus in pair] for pair in self._moduli])
        volume, shape = (moduli / self._middle[:, None])[bodies].T
        strain = values.reshape(len(bodies), -1)
        stress = 2 * shape[:, None] * strain
        if self._strains.plane_stress:
            stress[:, :2] += (volume * strain[:, :2].sum(axis=1))[:, None]
        return with_third(stress, plane_stress=self._strains.plane_stress)

    def tree(self, arrays: Packed) -> dict[str, Json]:
        """Data of the stress for a page."""
        strains = self._strains
        return {
            "components": strains.components - 1,
            "plane_stress": strains.plane_stress,
            "cells": arrays.put("stress_cells", strains.cells, "<i4"),
            "bodies": arrays.put("stress_bodies", strains.bodies, "<u1"),
            "moduli": [[steps_of(volume), steps_of(shape)] for volume, shape in self._moduli],
            "middle": self._middle.tolist(),
        }

    def off(self, points: np.ndarray, exact: np.ndarray, found: np.ndarray) -> dict[str, float]:
        """Errors of drawn values at some points, see :func:`far_off`.

        Args:
            points: parameters, (S, P).
            exact: values of answers, (n c, S).
            found: drawn values, (n c, S).
        """
        mises_of_answers, drawn = (
            np.array([self.mises(*pair) for pair in zip(values.T, points, strict=True)])
            for values in (exact, found)
        )
        return far_off(mises_of_answers, drawn)


def mises_of(stress: np.ndarray, *, plane_stress: bool = False) -> np.ndarray:
    """Von Mises' stress of cells from components without the third, (c, k): (c,).

    Args:
        stress: components without the third, (c, k).
        plane_stress: True if the third one is zero.
    """
    return von_mises(with_third(stress, plane_stress=plane_stress))


def with_third(stress: np.ndarray, *, plane_stress: bool = False) -> np.ndarray:
    """Stress of cells with the third component, which is left out, (c, k): (c, k + 1).

    The third is zero in plane stress; else the components are of deviators, which have no trace.

    Args:
        stress: components without the third, (c, k).
        plane_stress: True if the third one is zero.
    """
    third = 0.0 if plane_stress else -stress[:, 0] - stress[:, 1]
    return np.insert(stress, 2, third, axis=1)


def far_off(
    exact: np.ndarray, found: np.ndarray, scales: np.ndarray | None = None
) -> dict[str, float]:
    """Largest errors of the drawn von Mises' stress, by ``cells`` and ``largest``.

    They are the error in any cell, and of the largest value. Errors are relative to some scales,
    (S,), by default to the largest stress of each answer. Answers that are round-off do not count.

    Args:
        exact: stress of answers, (S, c).
        found: drawn stress, (S, c).
        scales: size of each answer, (S,); None for its largest stress.
    """
    largest = exact.max(axis=1, initial=0.0)
    scales = largest if scales is None else scales
    counted = scales > DRAWN_ROUND_OFF * scales.max(initial=0.0)
    cells = np.abs(found - exact).max(axis=1, initial=0.0)[counted] / scales[counted]
    peaks = np.abs(found.max(axis=1, initial=0.0) - largest)[counted] / scales[counted]
    return {"cells": float(cells.max(initial=0.0)), "largest": float(peaks.max(initial=0.0))}
