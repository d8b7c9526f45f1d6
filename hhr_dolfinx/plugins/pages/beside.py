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
from scipy.sparse import csr_matrix

from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.models.answer_mesh import AnswerMesh
from hhr_dolfinx.models.condensed import CondensedModel

if TYPE_CHECKING:
    from hhr_dolfinx.models.model import KeptModel
    from hhr_dolfinx.parameters import ParameterSpace, PointLike
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
    def parameters(self) -> ParameterSpace:
        """Box of the parameters of the model."""
        return self.loaded().parameters

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
        covers_mesh = strains is not None and len(strains.bodies) == len(mesh.all_cells)
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
            if strains is not None and covers_mesh
            else None,
        )

    def contact_names(self) -> list[str]:
        """Name of each contact, from the tags of its surfaces."""
        return list(self._scenery.words["contacts"])

    def parameter_units(self) -> dict[str, str]:
        """Units of the parameters by name, of those that have one."""
        return dict(self._scenery.words.get("units", {}))

    def contact_gaps(self, point: np.ndarray) -> tuple[csr_matrix, np.ndarray]:
        """Contact rows, (N_lambda, N), and gaps of undeformed bodies at a point, (N_lambda,).

        Args:
            point: point of the box, (P,).

        Raises:
            NotOfferedError: with a scenery of an earlier release, which has none.
        """
        mesh = self._scenery.mesh
        if mesh is None or mesh.contact_rows is None or mesh.gap_terms is None:
            reason = f"the scenery beside {self.model} is of an earlier release"
            raise NotOfferedError(f"{reason}: {self._remedy}")
        theta = self.loaded().fields.amplitudes.dense(point)
        if theta.size != mesh.gap_terms.shape[1]:
            reason = f"the scenery beside {self.model} and the model are of two scenes"
            raise NotOfferedError(f"{reason}: {self._remedy}")
        return mesh.contact_rows, mesh.gap_terms @ theta

    def deviators(
        self, displacement: np.ndarray, point: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray | None, np.ndarray, np.ndarray] | None:
        """Deviators of the stress on the triangles that pages draw; None without them.

        Args:
            displacement: on the whole mesh, (N,).
            point: point of the box, (P,).

        Returns:
            Nodes, (t, 3), areas, (t,), bodies, (t,), and tensors in Kelvin's notation,
            (t, components), of the triangles; of all cells in the plane, with None for areas.
        """
        from hhr_dolfinx.plugins.pages.stress import Stress

        scenery = self._scenery
        strains = scenery.strains
        mesh = scenery.mesh
        if strains is None or mesh is None:
            return None
        stress = Stress(strains, mesh.parameters, point)
        tensors = stress.deviators(stress.rows @ displacement, point)
        if len(tensors) == len(mesh.all_cells):
            return mesh.all_cells, None, mesh.cell_bodies, tensors
        edges = scenery.points[scenery.triangles[:, 1:]] - scenery.points[scenery.triangles[:, :1]]
        gram = edges @ edges.transpose(0, 2, 1)
        areas = np.sqrt(np.maximum(np.linalg.det(gram), 0.0)) / 2
        nodes = scenery.nodes[scenery.triangles]
        return nodes, areas, strains.bodies[strains.cells], tensors[strains.cells]


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
