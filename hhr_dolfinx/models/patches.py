"""Contact conditions of a reduced domain for a shape: pairings see the parts of surfaces around the conditions."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from threading import RLock
from typing import Annotated, Any

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.contact.problem import ContactRows
from hhr_dolfinx.declared import Integers
from hhr_dolfinx.errors import PairingWarning, ParameterError, SceneError
from hhr_dolfinx.pairings.projection import shape_functions
from hhr_dolfinx.pairings.surface import Surface, make_surface
from hhr_dolfinx.parameters import Tag

ROUND_OFF = 1e-12
"""Weight of a node in a condition below which it has nothing to do with it."""
_SILENT = RLock()


@dataclass(frozen=True)
class SurfacePatch:
    """A part of a tagged surface, its nodes by number.

    Attributes:
        tag: facet tag.
        facets: nodes of each facet, (f, k), quadrilaterals in tensor order.
        behind: nodes of the far side of the cell behind each facet, (f, r).
        edge: nodes where the surface goes on beyond the patch, (e,).
    """

    tag: Tag
    facets: Annotated[Integers, "facets", "nodes of a facet"]
    behind: Annotated[Integers, "facets", "nodes behind"]
    edge: Annotated[Integers, "edge"]

    @property
    def nodes(self) -> np.ndarray:
        """All nodes whose coordinates are needed."""
        return np.unique(np.concatenate([self.facets.ravel(), self.behind.ravel()]))

    def renumbered(self, numbers: np.ndarray) -> SurfacePatch:
        """The same for new numbers of the nodes, by the old ones."""
        return replace(self, facets=numbers[self.facets], behind=numbers[self.behind], edge=numbers[self.edge])

    def surface(self, points: np.ndarray, weights: np.ndarray) -> Surface:
        """The surface where nodes lie at some points, (n, dim), with weights of the surface measure, (n,)."""
        areas = tributary_areas(self.facets, points, weights)
        return make_surface(self.tag, self.facets, points[self.behind].mean(axis=1), points, weights, areas)


@dataclass(frozen=True)
class ContactPatch:
    """What a contact pair needs for its conditions in a reduced domain.

    Attributes:
        pairing: the pairing, a frozen dataclass.
        surfaces: parts of its surfaces in the order of its tags.
        slaves: slave node of each condition, (m,).
        places: place of each condition among those of the domain, (m,).
    """

    pairing: Any
    surfaces: tuple[SurfacePatch, ...]
    slaves: Annotated[Integers, "conditions"]
    places: Annotated[Integers, "conditions", "< m"]

    @property
    def nodes(self) -> np.ndarray:
        """All nodes whose coordinates are needed."""
        return np.unique(np.concatenate([self.slaves, *(surface.nodes for surface in self.surfaces)]))

    def renumbered(self, numbers: np.ndarray) -> ContactPatch:
        """The same for new numbers of the nodes, by the old ones."""
        surfaces = tuple(surface.renumbered(numbers) for surface in self.surfaces)
        return replace(self, surfaces=surfaces, slaves=numbers[self.slaves])

    def rows(self, points: np.ndarray, weights: np.ndarray, tested: np.ndarray) -> ContactRows:
        """Its conditions where nodes lie at some points, in their order.

        Args:
            points: (n, dim).
            weights: of the surface measure at the nodes, (n,).
            tested: dofs on which all contact forces must be known, (n dim,) bool.

        Raises:
            ParameterError: if a condition is not there, reaches beyond the patch, or others act on tested dofs.
        """
        found, kept = self.found(points, weights)
        others = np.setdiff1d(np.arange(len(found.slaves)), kept)
        if _touch(found.matrix[others], tested):
            raise ParameterError(
                f"for this shape further conditions of the contact {self.pairing} act on the reduced domain than where "
                "it was built: surfaces slide along each other. Narrow the box, or add layers to the domain"
            )
        rows, edge = found.take(kept), np.zeros(len(points), dtype=bool)
        edge[np.concatenate([part.edge for part in self.surfaces])] = True
        if _touch(rows.matrix, np.repeat(edge, points.shape[1])):
            raise ParameterError(
                f"for this shape conditions of the contact {self.pairing} reach beyond the part of the surfaces that "
                "the reduced model knows: surfaces slide along each other. Narrow the box"
            )
        return rows

    def found(self, points: np.ndarray, weights: np.ndarray) -> tuple[ContactRows, np.ndarray]:
        """All conditions that the pairing finds on the patch, and the places of its own among them, (m,).

        Raises:
            ParameterError: if one of its own is not there.
        """
        try:
            with _SILENT, warnings.catch_warnings():
                warnings.simplefilter("ignore", PairingWarning)  # said where the full model was built
                found = self.pairing.rows([part.surface(points, weights) for part in self.surfaces], points.size)
        except SceneError as error:
            raise ParameterError(f"the contact {self.pairing} cannot be evaluated for this shape: {error}") from None
        place = np.full(len(points), -1)
        place[found.slaves] = np.arange(len(found.slaves))
        kept = place[self.slaves]
        if (kept < 0).any():
            raise ParameterError(
                f"{int((kept < 0).sum())} conditions of the contact {self.pairing} are not there for this shape: it "
                "changes which surfaces face each other. Narrow the box"
            )
        return found, kept


def _touch(matrix: csr_matrix, dofs: np.ndarray) -> bool:
    """Whether rows have entries at some dofs, by a mask."""
    return bool((abs(matrix) @ dofs.astype(float) > ROUND_OFF).any())


def tributary_areas(facets: np.ndarray, points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Integrals of the shape functions of facets over the surface at all nodes, (n,).

    They are exact but for quadrilaterals that are no parallelograms, which have 2 x 2 points; weights, (n,), are linear
    along an edge and constant in space.
    """
    corners, at_corners = points[facets], weights[facets]
    if facets.shape[1] == 2:
        length = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
        shares = length[:, None] * (2 * at_corners + at_corners[:, ::-1]) / 6
    elif facets.shape[1] == 3:
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        shares = at_corners * (np.linalg.norm(normals, axis=1) / 6)[:, None]
    else:
        gauss = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3)
        local = np.column_stack([np.tile(gauss, 2), np.repeat(gauss, 2)])
        values, slopes = shape_functions(local, 4)
        along = np.einsum("qkj,fkd->jfqd", slopes, corners)
        shares = at_corners * (np.linalg.norm(np.cross(along[0], along[1]), axis=2) @ values / 4)
    return np.bincount(facets.ravel(), shares.ravel(), len(points))
