"""Mesh of a model in a file, from the scenery beside it: for pressures, figures and files of
fields.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.models.answer_mesh import AnswerMesh
from hhr_dolfinx.models.condensed import CondensedModel

if TYPE_CHECKING:
    from hhr_dolfinx.models.model import KeptModel
    from hhr_dolfinx.parameters import PointLike
    from hhr_dolfinx.plugins.pages.scenery import Scenery, Strains


@dataclass(frozen=True, eq=False)
class MeshBeside:
    """Scenery beside a model file, read when it is used.

    See :class:`~hhr_dolfinx.models.answer.Meshed`.
    """

    model: Path
    loaded: Callable[[], KeptModel]  #: the model of this file, to compare

    @cached_property
    def _scenery(self) -> Scenery:
        """The scenery; NotOfferedError if there is none, it is of another scene, or the shape of
        its mesh varies.
        """
        from hhr_dolfinx.plugins.pages.scenery import SCENERY_FILE, Scenery

        try:
            scenery = Scenery.read(self.model.with_name(SCENERY_FILE))
        except FileNotFoundError:
            raise NotOfferedError(
                f"there is no {SCENERY_FILE} beside {self.model}, and a model in a file "
                f"has no mesh: "
                f"{self._remedy}"
            ) from None
        if scenery.moves:
            raise NotOfferedError(
                f"shapes of bodies are parameters, and the {SCENERY_FILE} beside "
                f"{self.model} has those "
                f"in the middle of the box alone: {FULL}"
            )
        # the answers of others do not have S of the whole surface: the numbers of their forces and
        # dofs are compared
        if isinstance(model := self.loaded(), CondensedModel):
            from hhr_dolfinx.plugins.pages.page import check_alike

            check_alike(model, scenery)
        return scenery

    @property
    def _remedy(self) -> str:
        return (
            f"{FULL}; hhr.scenery_of(full).write({str(self.model.with_name('scenery.npz'))!r}) "
            "makes the file"
        )

    def areas(self, mu: PointLike) -> np.ndarray:
        """Tributary areas of the contact conditions, (N_lambda,)."""
        return self._scenery.areas

    def answer_mesh(self) -> AnswerMesh:
        """Mesh and contact surface.

        Raises:
            NotOfferedError: without a scenery, or with one of an earlier release, which has drawn
                triangles alone.
        """
        scenery = self._scenery
        mesh = scenery.mesh
        if mesh is None:
            raise NotOfferedError(
                f"the scenery beside {self.model} is of an earlier release: {self._remedy}"
            )
        strains = scenery.strains
        whole = strains is not None and len(strains.bodies) == len(mesh.all_cells)
        return AnswerMesh(
            points=mesh.all_points,
            cells=mesh.all_cells,
            kind=mesh.kind,
            bodies=mesh.cell_bodies,
            contact_points=scenery.contact_points,
            slaves=mesh.slaves,
            contacts=contacts_of(scenery),
            name=scenery.words["scene"],
            axisymmetric=scenery.words.get("hypothesis") == "axisymmetric",
            parameters=mesh.parameters,
            length=scenery.words.get("length", ""),
            stress=scenery.words.get("stress", ""),
            von_mises=partial(_von_mises, strains, mesh.parameters)
            if strains is not None and whole
            else None,
        )


FULL = (
    "name the scene, --scene FILE.py, or in Python give the full model, "
    "full=hhr.FullOrderModel(scene)"
)
"""End of refusals."""


def contacts_of(scenery: Scenery) -> tuple[np.ndarray, ...]:
    """Numbers of the conditions of pressures of each contact; a condition may be of several."""
    assert scenery.mesh is not None
    conditions, pairs, shares = scenery.shares.T
    pressing = np.flatnonzero(scenery.mesh.pressing)
    single = ~np.isin(np.arange(len(scenery.pairs)), conditions)
    return tuple(
        np.intersect1d(
            pressing,
            np.append(
                np.flatnonzero(single & (scenery.pairs == contact)),
                conditions[(pairs == contact) & (shares > 0)].astype(np.int64),
            ),
        )
        for contact in range(len(scenery.words["contacts"]))
    )


def _von_mises(
    strains: Strains, names: tuple[str, ...], displacement: np.ndarray, point: np.ndarray
) -> np.ndarray:
    """Von Mises' stress of each cell of strains, (c,)."""
    from hhr_dolfinx.plugins.pages.stress import Stress

    stress = Stress(strains, names, point)
    return stress.mises(stress.rows @ displacement, point)
