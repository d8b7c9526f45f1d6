"""Pairs whose surfaces slide, as they are meshed, and the law on them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.contact.rows import ContactRows, normals_of
from hhr_dolfinx.errors import NotOfferedError, SceneError
from hhr_dolfinx.pairings.surface import CREASE, Surface
from hhr_dolfinx.plugins.contact_laws.interface import Range, ranged
from hhr_dolfinx.plugins.friction.laws import Friction, FrictionLaw
from hhr_dolfinx.plugins.friction.over import require_alone
from hhr_dolfinx.plugins.friction.pair_laws import Coulomb, Tangential
from hhr_dolfinx.plugins.sliding.law import SlidingLaw
from hhr_dolfinx.plugins.sliding.pressures import beside_laws
from hhr_dolfinx.plugins.sliding.repairing import (
    SlidingPair,
    layout,
    no_friction,
    nodes_of,
    renumbered,
)

if TYPE_CHECKING:
    from hhr_dolfinx.contact.law import ContactLaw, PairLaw
    from hhr_dolfinx.parameters import Tag
    from hhr_dolfinx.plugins.sliding.beside import BesideTools
    from hhr_dolfinx.scene import Scene


class DofsOfSurfaces(Protocol):
    """Finite element model with rows of the dofs of surfaces."""

    beside: BesideTools

    @property
    def dofs(self) -> int:
        """Number of dofs of the mesh, N."""

    def surface(self, tag: Tag) -> Surface:
        """Surface of a tag."""

    def laws_on(
        self, laws: dict[int, PairLaw], rows: ContactRows, pairs: np.ndarray
    ) -> tuple[ContactRows, ContactLaw]:
        """Rows with those that laws append, and the law on all of them.

        Args:
            laws: laws by pair.
            rows: conditions of pressures.
            pairs: contact of each, (n,).
        """


def sliding_law(
    scene: Scene,
    sliding: Mapping[int, Any],
    surfaces: DofsOfSurfaces,
    of_others: ContactLaw,
    first: int,
) -> SlidingLaw:
    """The law of the pairs that slide, and of those beside them.

    Args:
        scene: the scene, with the pairs as they are paired again.
        sliding: the pairs that slide, by their number.
        surfaces: finite element model with rows of the dofs of surfaces.
        of_others: law of the pairs that do not slide.
        first: number of conditions of these.

    Raises:
        SceneError: for surfaces that do not face each other as meshed, or laws that exclude each
            other there.
    """
    pairs = dict(_pairs(scene, sliding, surfaces, first))
    laws_of_friction = [
        FrictionLaw.of(
            law if isinstance(law, Tangential) else Coulomb(0.0),
            scene.parameters,
            f"contact {number}",
        )
        for number, law in enumerate(scene.laws)
        if number in pairs
    ]
    fixed = np.array(
        [k for k, name in enumerate(scene.parameters.names) if name in scene.named], dtype=np.int64
    )
    every = tuple(pairs.values())
    dim = every[0].slave.points.shape[1]
    found = of_others.of("friction")
    if isinstance(found, Friction):
        require_alone(found, "sliding by any length beside pairs that do not slide,")
    others = found if isinstance(found, Friction) else no_friction(dim)
    friction = layout(every, laws_of_friction, fixed, dim, others)
    of_slaves = {
        number: law
        for number, law in enumerate(map(_of_pressures, scene.laws))
        if number in pairs and law is not None
    }
    ranges = _on_slaves(of_slaves, pairs, surfaces) if of_slaves else ()
    law = beside_laws(friction, of_others, ranges, first)
    return SlidingLaw(every, law, surfaces.beside)


def _on_slaves(
    laws: dict[int, PairLaw], pairs: Mapping[int, SlidingPair], full: DofsOfSurfaces
) -> tuple[Range, ...]:
    """Laws of the pairs that slide, on their slave nodes, (C,).

    Args:
        laws: laws of plug-ins other than friction, by pair; not empty.
        pairs: the pairs that slide, by their number.
        full: finite element model of the scene.

    Raises:
        SceneError: for a law with rows of its own.
    """
    slaves = [pair.slave for pair in pairs.values()]
    nodes = np.concatenate([slave.nodes for slave in slaves])
    numbers = np.repeat(list(pairs), [slave.nodes.size for slave in slaves])
    points = np.concatenate([slave.points for slave in slaves])
    areas = np.concatenate([slave.areas for slave in slaves])
    rows = ContactRows(
        csr_matrix((nodes.size, full.dofs)), np.zeros(nodes.size), nodes, points, areas
    )
    longer, law = full.laws_on(laws, rows, numbers)
    if longer.gap.size != nodes.size:
        words = " and ".join(law.words for law in laws.values())
        raise SceneError(
            f"{words} adds conditions to those of pressures, and conditions of surfaces that slide "
            "are made again in each increment: laws of pressures alone are built in there"
        )
    return ranged(law, nodes.size).ranges


def _of_pressures(law: PairLaw | None) -> PairLaw | None:
    """The law of the pressures of a pair, alone or beneath friction.

    Raises:
        NotOfferedError: for one that reads the slip.
    """
    under = law.under if isinstance(law, Tangential) else law
    if getattr(under, "along_slip", False):
        raise NotOfferedError(
            "wear along the slip is not built in for pairs that slide by any length"
        )
    return under


def _pairs(
    scene: Scene,
    sliding: Mapping[int, Any],
    surfaces_on: DofsOfSurfaces,
    first: int,
) -> Iterator[tuple[int, SlidingPair]]:
    """The surfaces of each pair that slides, by its number.

    Errors of the pairing if they do not face each other as meshed.
    """
    first_seen: dict[int, tuple[int, np.ndarray]] = {}
    for number, contact in sliding.items():
        pairing = dataclasses.replace(
            contact, friction=None, law=None
        )  # the model has the law, not the rows
        surfaces = [surfaces_on.surface(tag) for tag in contact.tags]
        nodes, points = nodes_of(surfaces)
        slave, master = (renumbered(surface, nodes) for surface in surfaces)
        rows = pairing.rows((slave, master), points.size)
        normals = normals_of(rows.matrix, rows.slaves, points.shape[1])
        for node, normal in zip(nodes[rows.slaves].tolist(), normals, strict=True):
            other_number, before = first_seen.setdefault(node, (number, normal))
            if scene.contacts[other_number].tags[0] != contact.tags[0] and before @ normal > CREASE:
                raise SceneError(
                    f"the slaves of contacts {other_number} and {number} of scene '{scene.name}' "
                    "share nodes, which is not built in where surfaces slide past their mesh: make "
                    "one contact of both, of one tag"
                )
        clearance = _clearance(scene, number, slave, rows)
        opening = _opening(scene, number)
        yield number, SlidingPair(pairing, slave, master, first, nodes.size, clearance, opening)
        first += points.size


def _opening(scene: Scene, place: int) -> np.ndarray:
    """Sum of the openings of a contact, a constant and the slope of each parameter, (1 + P,)."""
    amplitudes = [opening.amplitude for opening in scene.openings if opening.contact == place]
    rows = [
        np.array([amplitude.constant, *amplitude.row(scene.parameters)]) for amplitude in amplitudes
    ]
    return np.sum(rows, axis=0) if rows else np.zeros(1 + len(scene.parameters.names))


def _clearance(scene: Scene, place: int, slave: Surface, rows: ContactRows) -> np.ndarray:
    """Gap of each slave node as meshed if an opening overwrites it, else zeros, (n,)."""
    clearance = np.zeros(slave.nodes.size)
    if scene.overwritten(place):
        if rows.gap.size < clearance.size:
            raise SceneError(
                f"an opening overwrites the gaps of contact {place} of scene '{scene.name}', "
                f"which slides, and {clearance.size - rows.gap.size} of its {clearance.size} slave "
                "nodes face nothing as meshed: the gap that they have there is unknown. Swap slave "
                "and master, or leave out overwrites=True"
            )
        clearance[np.searchsorted(slave.nodes, rows.slaves)] = rows.gap
    return clearance
