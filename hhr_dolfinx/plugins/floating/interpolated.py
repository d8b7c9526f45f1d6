"""Rigid motions beside an elimination whose S depends on parameters, such as an interpolated one.

The elimination leaves out the rigid motions R of bodies that contact alone holds: its S is B K^+
B^T with the inverse K^+ of K on displacements orthogonal to R. The motions are then the part R R^T
u of a displacement u.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, ClassVar

import numpy as np

from hhr_dolfinx.contact.kernel import CondensedKernel
from hhr_dolfinx.declared import Floats
from hhr_dolfinx.models.eliminations.elimination import CondensedContact, Elimination
from hhr_dolfinx.plain import Rebuilt
from hhr_dolfinx.plugins.floating.elimination import Floating
from hhr_dolfinx.plugins.floating.statuses import FloatingEqualities


@dataclass(frozen=True, eq=False)
class MotionsBeside(Rebuilt, Elimination):
    """Motions as the only unknowns beside the forces of another elimination (m conditions, r
    motions, 1 + T terms).
    """

    keeps_kernel: ClassVar[bool] = True

    held: Elimination  #: of displacements without the motions; it has no unknowns
    taken: Annotated[Floats, "m", "motions"]  #: change of the slack by the motions, B R, (m, r)
    driving: Annotated[Floats, "motions", "terms"]  #: loads along the motions, (r, 1 + T)

    def __call__(self, point: np.ndarray) -> CondensedContact:
        """Contact problem at a point, (P,)."""
        contact = self.held(point)
        return self._beside(contact, FloatingEqualities(contact.schur, self.taken), point)

    def along_path(self) -> Callable[[np.ndarray], CondensedContact]:
        """See :class:`Elimination`; neighbours of equal stiffness share the equality problems on
        S.
        """
        held_at = self.held.along_path()
        last: list[FloatingEqualities] = []

        def contact_at(point: np.ndarray) -> CondensedContact:
            contact = held_at(point)
            if not last or last[0].schur is not contact.schur:
                last[:] = [FloatingEqualities(contact.schur, self.taken)]
            return self._beside(contact, last[0], point)

        return contact_at

    def _beside(
        self, contact: CondensedContact, equalities: FloatingEqualities, point: np.ndarray
    ) -> CondensedContact:  # fmt: skip
        amplitudes = self.held.amplitudes  # type: ignore[attr-defined]
        count = self.taken.shape[1]

        def changes(forces: np.ndarray, _: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return contact.at_fixed_forces(forces, np.zeros(0))[0], np.zeros((count, point.size))

        def drift(*_: np.ndarray) -> np.ndarray:
            acting, slopes = amplitudes.slopes_at(point)
            return self.driving[:, acting] @ slopes

        modes = np.eye(count)
        kernel: CondensedKernel = Floating(
            equalities, self.driving @ amplitudes(point), modes, drift
        )
        response = partial(_nothing, count)
        return replace(
            contact,
            free=np.zeros(count),
            response_to_forces=response,
            at_fixed_forces=changes,
            kernel=kernel,
        )


def _nothing(count: int, forces: np.ndarray) -> np.ndarray:
    """Forces move none of the motions by themselves."""
    return np.zeros((count, *forces.shape[1:]))
