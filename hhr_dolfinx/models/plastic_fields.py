"""Stress and plastic strain everywhere, from a displacement and the plastic strain at few Gauss points."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from scipy.sparse import csc_matrix

from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.linear.layout import lay_out
from hhr_dolfinx.materials.strain import StrainOperator
from hhr_dolfinx.models.reconstruct import GappyField

LEAST = 0.05
"""Part of its own value that a fit must leave open at a point before what the others say there is told: below, a point
is fitted by itself, and what it would be without it is round-off over round-off."""


@dataclass(frozen=True, eq=False)
class PlasticFields:
    """What completes the fields of Gauss points.

    Gappy POD (thesis section 6.2.3) completes the plastic strain ε_p alone, from modes Φ a. Displacement and stress
    that balance it are known for each mode: K u = ∫ G^T C Φ, σ = C (ε(u) - Φ). So the stress is exact where nothing has
    flowed, and balances the loads whatever a is. Of the stress itself few points tell too little: elastic part loads,
    which are no combination of what yields, would be wrong as a whole.

    Attributes:
        points: numbers of the Gauss points Z where laws are evaluated, (n,).
        flowed: numbers of the points where anything flowed in training, increasing, (f,).
        plastic: how the plastic strain is completed on these, components of a point side by side.
        cumulated: how the cumulated plastic strain is.
        moved: displacement that each mode of the plastic strain leaves behind, K^-1 ∫ G^T C Φ, (N, k).
        strain: ε(u) at all Gauss points.
        unstressed: strains without stress for each term of θ, sparse, (Gauss points * components, 1 + T).
        moduli: Lamé's λ and 2 μ of each Gauss point in the middle of the box, (Gauss points, 2).
    """

    points: Annotated[Integers, "points", "< gauss points"]
    flowed: Annotated[Integers, "flowed", "< gauss points"]
    plastic: GappyField
    cumulated: GappyField
    moved: Annotated[Floats, "N", "plastic modes"]
    strain: StrainOperator
    unstressed: Annotated[csc_matrix, "components * gauss points", "terms"]
    moduli: Annotated[Floats, "gauss points", "2"]

    def __post_init__(self) -> None:
        """Arrays lie as files keep them."""
        lay_out(self)

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Points that do not increase, moduli that are not positive, strain and modes of other sizes."""
        if not (np.diff(self.flowed) > 0).all() or not np.isin(self.points, self.flowed).all():
            yield "the points that flowed must increase, those where laws are evaluated among them"
        if not (self.moduli[:, 1] > 0).all() or not (3 * self.moduli[:, 0] + self.moduli[:, 1] > 0).all():
            yield "moduli of a Gauss point are not positive"
        components, count = self.strain.components, self.plastic.modes.shape[1]
        found = (*self.plastic.modes.shape, *self.plastic.fit.shape, self.cumulated.modes.shape[0])
        wanted = (self.flowed.size * components, count, count, self.points.size * components, self.flowed.size)
        if found != wanted or self.moved.shape[1] != count or self.cumulated.fit.shape[1] != self.points.size:
            yield f"modes of the plastic strain have sizes {found}, and not {wanted}"
        if self.strain.weights.size != len(self.moduli) or self.strain.size != len(self.moved):
            yield f"strains at all Gauss points are not those of {len(self.moved)} dofs and {len(self.moduli)} points"

    @property
    def gauss_points(self) -> int:
        """Number of Gauss points of the full model."""
        return len(self.moduli)

    def stress(self, elastic: np.ndarray, theta: np.ndarray, plastic: np.ndarray) -> np.ndarray:
        """Stress at all Gauss points if moduli were those in the middle of the box, (Gauss points, components).

        Args:
            elastic: displacement of loads and contact forces, lift included, (N,).
            theta: θ, (1 + T,).
            plastic: plastic strain where laws are evaluated, (n, components).
        """
        shares = self.plastic.fit @ plastic.ravel()
        found = self.strain.strain(elastic + self.moved @ shares)
        if self.unstressed.nnz:
            found -= (self.unstressed @ theta).reshape(found.shape)
        found[self.flowed] -= (self.plastic.modes @ shares).reshape(self.flowed.size, -1)
        volume = self.moduli[:, 0] * found[:, :3].sum(axis=1)
        found *= self.moduli[:, 1:]
        found[:, :3] += volume[:, None]
        return found

    def cumulated_everywhere(self, inside: np.ndarray) -> np.ndarray:
        """Cumulated plastic strain at all Gauss points, never negative, (Gauss points,)."""
        field = np.zeros(self.gauss_points)
        field[self.flowed] = np.maximum(self.cumulated.everywhere(inside), 0.0)
        field[self.points] = inside
        return field

    def unforeseen(self, plastic: np.ndarray) -> np.ndarray:
        """2 μ times the plastic strain at each point less what all the others say of it, (n, components).

        What is left at points to which the modes were fitted, (I - H) ε_p, is far less than what is left elsewhere:
        each point is predicted without itself, by (I - H_ii)^-1.
        """
        left = plastic - (self._shown @ (self.plastic.fit @ plastic.ravel())).reshape(plastic.shape)
        return np.einsum("nij,nj->ni", self._without, left)

    @cached_property
    def _shown(self) -> np.ndarray:
        """The modes of the plastic strain where laws are evaluated, (n components, modes)."""
        rows = np.searchsorted(self.flowed, self.points)
        modes = self.plastic.modes.reshape(self.flowed.size, self.strain.components, -1)
        return modes[rows].reshape(rows.size * self.strain.components, -1)

    @cached_property
    def _without(self) -> np.ndarray:
        """2 μ (I - H_ii)^-1 of each point, (n, components, components); where next to nothing is open, as of LEAST."""
        count, components = self.points.size, self.strain.components
        shown = self._shown.reshape(count, components, -1)
        own = np.einsum("nik,knj->nij", shown, self.plastic.fit.reshape(-1, count, components))
        open_, ways = np.linalg.eigh(np.eye(components) - (own + own.swapaxes(1, 2)) / 2)
        ways *= np.sqrt(self.moduli[self.points, 1, None] / np.maximum(open_, LEAST))[:, None]
        return ways @ ways.swapaxes(1, 2)
