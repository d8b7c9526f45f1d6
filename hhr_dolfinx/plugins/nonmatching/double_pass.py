"""Node-to-surface contact in two passes, thesis section 5.1."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from scipy import linalg
from scipy.sparse import csr_matrix

from hhr_dolfinx.contact.law import LAW, PairLaw
from hhr_dolfinx.contact.rows import ContactRows, joined
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.pairings.surface import Surface, unit, warn
from hhr_dolfinx.parameters import Tag
from hhr_dolfinx.plugins.nonmatching.node_to_surface import NodeToSurface

SPANNED_ROW = 1e-8
"""Fraction of a row not spanned by the rows before it, below which the row is dependent on them."""
POOR_INF_SUP = 0.02
"""Inf-sup constant of a double pass relative to the norm of B below which pressures oscillate
visibly.
"""


@dataclass(frozen=True)
class DoublePass:
    """Node-to-surface contact both ways, without redundant conditions (section 5.1).

    Two passes can over-constrain: both give the same row for nodes that face each other, and other
    rows may be dependent (El-Abbasi and Bathe 2001). Rows of the second pass in the span of the
    rows before them are dropped, so that B has full rank. A warning reports an inf-sup constant
    that is still poor.

    Attributes:
        first: facet tag of one surface; all of its conditions are kept.
        second: facet tag of the other.
        normal: from the first to the second surface, or None; see :class:`NodeToSurface`.
        friction: coefficient of Coulomb's law, a number or a formula, or its law; None without. A
            plug-in reads it.
        law: any law of a plug-in in addition to unilateral contact, such as ``Coulomb(0.3)``; None
            without.
    """

    both_ways: ClassVar[bool] = True

    first: Tag
    second: Tag
    normal: tuple[float, ...] | None = None
    friction: PairLaw | str | float | None = field(default=None, metadata=LAW)
    law: PairLaw | None = field(default=None, metadata=LAW)

    @property
    def tags(self) -> tuple[Tag, ...]:
        """Both surfaces."""
        return (self.first, self.second)

    def rows(self, surfaces: Sequence[Surface], dofs: int) -> ContactRows:
        """Rows of both passes without duplicates.

        Args:
            surfaces: the first and the second surface.
            dofs: number of dofs.

        Raises:
            SceneError: if the surfaces do not face each other in either pass.
        """
        first, second = surfaces
        if self.normal is not None:
            unit(self.normal, first.points.shape[1])  # refuses what is no vector
        back = None if self.normal is None else tuple(-np.asarray(self.normal, dtype=float))
        passes = []
        refusals = []
        for pairing, pair in (
            (NodeToSurface(self.first, self.second, self.normal), (first, second)),
            (NodeToSurface(self.second, self.first, back), (second, first)),
        ):
            try:
                passes.append(pairing.rows(pair, dofs))
            except (
                SceneError
            ) as refusal:  # a coarse surface may have no node in front of a small one
                refusals.append(refusal)
        if not passes:
            raise refusals[0]
        if refusals:
            warn(
                f"only one pass of surfaces {self.tags} has conditions; of the other: {refusals[0]}"
            )
            return passes[0]
        first_rows, two = passes
        independent, beta = _independent(first_rows.matrix, two.matrix)
        if beta < POOR_INF_SUP:
            warn(
                f"the double pass of surfaces {self.tags} has an inf-sup constant of {beta:.1e} "
                "relative to its norm: pressures will oscillate. Use Mortar, or NodeToSurface "
                "with the finer surface as slave"
            )
        return joined([first_rows, two.take(independent)])


def _independent(one: csr_matrix, two: csr_matrix) -> tuple[np.ndarray, float]:
    """Rows of the second pass that add conditions, and the inf-sup constant of all rows over the
    norm of B.
    """
    columns = np.union1d(one.indices, two.indices)
    first = one[:, columns].toarray()
    second = two[:, columns].toarray()
    basis, _ = linalg.qr(first.T, mode="economic")
    remaining = second - (second @ basis) @ basis.T
    _, triangle, order = linalg.qr(remaining.T, mode="economic", pivoting=True)
    size = np.abs(np.diag(triangle))
    independent = np.sort(
        order[: int((size > SPANNED_ROW * np.linalg.norm(second, axis=1).max()).sum())]
    )
    values = linalg.svdvals(np.vstack([first, second[independent]]))
    return independent, float(values[-1] / values[0])
