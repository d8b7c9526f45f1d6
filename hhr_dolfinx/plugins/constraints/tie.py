"""Ties of surfaces whose meshes do not match, *TIE of decks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.amplitudes import Amplitude
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.loads import Assembler
from hhr_dolfinx.pairings import Pairing
from hhr_dolfinx.pairings.surface import warn
from hhr_dolfinx.parameters import Tag, check_tag
from hhr_dolfinx.plugins.constraints.elimination import ConstraintEquations
from hhr_dolfinx.plugins.constraints.equations import equations_of
from hhr_dolfinx.plugins.mortar.pairing import Mortar

WIDE = 0.1
"""Part of a cell up to which surfaces of a tie may be apart without a warning: chords of round
surfaces are.
"""


@dataclass(frozen=True)
class Tie:
    """The surface ``slave`` moves with the surface ``master``: each of its nodes follows a mean of
    those of the master.

    The means are those of a pairing: with ``Mortar``, which is the default, a constant stress
    passes exactly (Wohlmuth 2000, see the plug-in ``mortar``); with ``NodeToSurface`` a node
    follows the point of the master in front of it.

    Attributes:
        slave: facet tag of the surface that follows, best the finer one.
        master: facet tag of the other surface.
        pairing: class of the pairing, called with slave and master.
    """

    slave: Tag
    master: Tag
    pairing: Callable[[Tag, Tag], Pairing] = Mortar
    amplitude: Amplitude = field(default=Amplitude(), init=False)

    def __post_init__(self) -> None:
        check_tag("tie", self.slave)
        check_tag("tie", self.master)
        if self.slave == self.master:
            raise SceneError(f"the tie of {self.slave!r} needs two surfaces")
        try:
            self._pairing  # noqa: B018 (faults are reported where the tie is written)
        except TypeError as error:
            raise SceneError(
                f"pairing = {self.pairing!r} of the tie of {self.slave!r} must make a pairing of "
                f"slave and master, such as the class Mortar: {error}"
            ) from error

    @property
    def _pairing(self) -> Pairing:
        return self.pairing(self.slave, self.master)

    def equations(self, assembler: Assembler) -> ConstraintEquations:
        """See :class:`~hhr_dolfinx.plugins.constraints.elimination.Constraint`.

        Raises:
            SceneError: for surfaces that do not face each other.
        """
        pairing = self._pairing
        # on cells of second order all nodes follow the flat parts of facets between them
        surfaces = [replace(assembler.surface(tag), quadratic=None) for tag in pairing.tags]
        dim = surfaces[0].points.shape[1]
        rows = pairing.rows(surfaces, assembler.size)
        # forces act across the gap without a moment
        wide = np.abs(rows.gap).max(initial=0.0)
        if wide > WIDE * surfaces[0].cell_sizes().min():
            warn(
                f"the surfaces of {self!r} are up to {wide:.3g} apart: what they pass on has no "
                "moment across that gap, and turns of a body strain it. Let the surfaces meet"
            )
        count = rows.gap.size
        dofs = dim * rows.slaves[:, None] + np.arange(dim)
        normals = np.asarray(rows.matrix[np.arange(count)[:, None], dofs].toarray())
        if not np.allclose(np.linalg.norm(normals, axis=1), 1.0):
            raise SceneError(
                f"{self!r}: its pairing has other rows than one of a node each: tie by "
                "NodeToSurface"
            )
        entries = rows.matrix.tocoo()
        nodes, components = np.divmod(entries.col, dim)
        weights = csr_matrix(
            (entries.data * normals[entries.row, components], (entries.row, nodes)),
            shape=(count, assembler.size // dim),
        ).tocoo()
        spread = [(weights.data, dim * weights.row + k, dim * weights.col + k) for k in range(dim)]
        return equations_of(spread, dofs.ravel(), assembler.size)
