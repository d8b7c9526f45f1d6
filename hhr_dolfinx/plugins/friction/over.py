"""Friction over laws of the pressures: a pair that rubs, and is soft, wears or has a gasket.

The largest tangential force is that of the pressure which the law beneath gives.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.contact.law import UNILATERAL, ContactLaw, MeshArrays, PairLaw, check_attached
from hhr_dolfinx.errors import NotOfferedError, SceneError
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.plugins.contact_laws.interface import Interface, OverLaws, Range
from hhr_dolfinx.plugins.contact_laws.layers import SolverOfRanges
from hhr_dolfinx.plugins.friction.laws import SLIP, Friction, places_of
from hhr_dolfinx.plugins.friction.range import FrictionRange, FrictionStep

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix

    from hhr_dolfinx.contact.rows import ContactRows
    from hhr_dolfinx.parameters import ParameterSpace
    from hhr_dolfinx.plugins.contact_laws.range_increments import RangeState
    from hhr_dolfinx.scene import Scene


class FrictionWithPressureLaws(Friction):
    """Friction of contacts and laws of their pressures, as one law of a scene."""

    pressures: Range  #: laws of the pressures, and their rows

    @property
    def laws_of_pressures(self) -> Interface:
        """Laws of the pressures, in their order."""
        law = self.pressures.law
        assert isinstance(law, Interface)
        return law

    @property
    def plugins(self) -> tuple[str, ...]:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return (*super().plugins, *self.laws_of_pressures.plugins)

    def of(self, plugin: str) -> ContactLaw | None:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        if plugin == self.plugin:
            return self
        rows = self.pressures.rows
        placed = (
            part.law.among(rows[part.rows]).of(plugin) for part in self.laws_of_pressures.ranges
        )
        return next((law for law in placed if law is not None), None)

    def parts(self) -> list[str | np.ndarray]:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return [*super().parts(), *self.laws_of_pressures.parts()]

    @property
    def layout(self) -> dict[str, tuple[str, ...]]:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return {**super().layout, **self.laws_of_pressures.layout}

    @property
    def sizes(self) -> dict[str, int]:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return {**super().sizes, **self.laws_of_pressures.sizes}

    def stored(self, memory: Memory) -> dict[str, np.ndarray]:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return {**super().stored(memory), **self.laws_of_pressures.stored(memory)}

    def restored(self, arrays: Mapping[str, np.ndarray]) -> Memory:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return super().restored(arrays) | self.laws_of_pressures.restored(arrays)


@dataclass(frozen=True)
class FrictionOver(FrictionWithPressureLaws, OverLaws):
    """Friction, and the laws of the pressures of its contacts, (C,)."""

    under: Interface

    @property
    def pressures(self) -> Range:  # type: ignore[override]
        """The laws of the pressures, and their rows."""
        return Range(self.under, self.normal)

    @classmethod
    def of_laws(cls, friction: Friction, under: Interface) -> FrictionOver:
        """Friction over laws of the pressures.

        Args:
            friction: friction of the conditions.
            under: laws of its contacts, in their order.
        """
        known = {each.name: getattr(friction, each.name) for each in fields(Friction)}
        return cls(**known, under=under)

    @property
    def name(self) -> str:  # type: ignore[override]
        """Names of the laws."""
        return f"{Friction.name} over {self.under.name}"

    @property
    def reshapes(self) -> bool:  # type: ignore[override]
        """True if all laws hold on shapes that depend on parameters."""
        return super().reshapes and self.under.reshapes

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Faults of friction, and conditions without a law of their pressure.

        Args:
            sizes: sizes of the model.
        """
        yield from super().faults(sizes)
        yield from self.under.faults({"N_lambda": self.normal.size})

    def opened(self, memory: Memory) -> np.ndarray:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        opened = np.zeros(self.normal.size + self.tangential.size)
        opened[self.normal] = self.under.opened(memory)
        return opened

    def pulling(self, count: int) -> np.ndarray:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`: as the laws beneath say."""
        mask = np.zeros(count, dtype=bool)
        mask[self.normal] = self.under.pulling(self.normal.size)
        return mask

    def limited(
        self, forces: np.ndarray, changes: np.ndarray, fitted: np.ndarray, point: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pressures as their laws admit them, and tangential forces up to their bound.

        Args:
            forces: forces of all rows, (M,).
            changes: derivatives of the forces, (M, P), or none.
            fitted: rows whose forces are fitted, (M,) bool.
            point: parameter, (P,).
        """
        forces = forces.copy()
        changes = changes.copy()
        touching = np.zeros(forces.size, dtype=bool)
        for part in self.under.ranges:
            rows = self.normal[part.rows]
            forces[rows], changes[rows], touching[rows] = part.law.limited(
                forces[rows], changes[rows], fitted[rows], point
            )
        forces, changes, active = super().limited(forces, changes, fitted, point)
        active[self.normal] = touching[self.normal]
        return forces, changes, active

    def distinct(self, count: int) -> np.ndarray:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        mask = super().distinct(count)
        mask[self.normal] &= self.under.distinct(self.normal.size)
        return mask

    def faults_for(self, dimension: int) -> Iterator[str]:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        yield from super().faults_for(dimension)
        yield from self.under.faults_for(dimension)

    def check_path(self, space: ParameterSpace, points: np.ndarray) -> None:
        """Of friction, and of the laws beneath.

        Args:
            space: box of the parameters.
            points: parameters of the path, (steps, P).
        """
        super().check_path(space, points)
        self.under.check_path(space, points)

    def within(self, conditions: np.ndarray) -> FrictionOver:
        """Friction and laws of some conditions, (m,), in their order there.

        Raises:
            ValueError: if a contact lacks some of its rows.
        """
        kept = np.flatnonzero(np.isin(self.normal, conditions))
        return self.of_laws(super().within(conditions), self.under.within(kept))


class FrictionOverRange(FrictionRange):
    """Friction over laws of the pressures, of the conditions of a range."""

    def __init__(self, law: FrictionOver):
        super().__init__(law)
        self._under = SolverOfRanges(law.under)

    def compliance(self, diagonal: np.ndarray) -> np.ndarray:
        """Of friction and of the laws beneath.

        Args:
            diagonal: diagonal of S, (k,).
        """
        compliance = super().compliance(diagonal)
        compliance[self.law.normal] += self._under.compliance(diagonal[self.law.normal])
        return compliance

    def coupling(self, schur: np.ndarray, rows: np.ndarray, point: np.ndarray) -> float:
        """Of friction and of the laws beneath.

        Args:
            schur: S, (M, M).
            rows: numbers of the rows among all conditions, (k,).
            point: parameter, (P,).
        """
        beneath = self._under.coupling(schur, rows[self.law.normal], point)
        return super().coupling(schur, rows, point) + beneath

    def at_rest(self) -> Memory:
        """No slip, no contact, and memories of the laws beneath at rest."""
        return super().at_rest() | self._under.at_rest()

    def memory_at_rest(self, gaps: np.ndarray, point: np.ndarray) -> Memory:
        """No slip; contacts that touch stick.

        Args:
            gaps: gaps of the rows, (k,).
            point: parameter at rest, (P,).
        """
        under = self._under.memory_at_rest(gaps[self.law.normal], point)
        return super().memory_at_rest(gaps, point) | under

    def step(self, before: Memory, point: np.ndarray, seconds: float) -> FrictionStep:
        """One increment.

        Args:
            before: memory at its start.
            point: parameter at its end, (P,).
            seconds: its duration.
        """
        under = self._under.step(before, point, seconds)
        return FrictionStep(self.law, before[SLIP], point, under)

    def difference(
        self, off: float, ends: Sequence[RangeState], rows: np.ndarray, largest: float
    ) -> float:
        """Largest error of friction and of the laws beneath.

        Args:
            off: error of the forces, relative to ``largest``.
            ends: states at the start, after the first half, after the second, and after the whole
                step.
            rows: numbers of the rows among all conditions, (k,).
            largest: largest norm of the forces so far.
        """
        of_friction = super().difference(off, ends, rows, largest)
        of_pressures = self._under.difference(off, ends, rows[self.law.normal], largest)
        return max(of_friction, of_pressures)

    def check(self, memory: Memory, place: str) -> None:
        """Check the sliding distance, and the memories beneath.

        Args:
            memory: memory at the end of a step.
            place: description of the point, for messages.
        """
        super().check(memory, place)
        self._under.check(memory, place)


def solver_of(law: Friction) -> FrictionRange:
    """Facet ``range``: friction alone, or over laws of the pressures.

    Args:
        law: friction of the conditions.
    """
    return FrictionOverRange(law) if isinstance(law, FrictionOver) else FrictionRange(law)


def over_laws(
    friction: Friction,
    under: Mapping[int, PairLaw],
    scene: Scene,
    rows: ContactRows,
    pairs: np.ndarray,
    free: np.ndarray,
    lifts: csc_matrix,
    mesh: MeshArrays,
) -> Friction:
    """Friction, over the laws of the pressures of its pairs if there are any.

    Args:
        friction: friction of the conditions.
        under: laws of the pressures by pair.
        scene: scene of the contacts.
        rows: conditions of the pressures.
        pairs: contact pair of each of them, (n,).
        free: dofs that are not imposed, (N,) bool.
        lifts: imposed displacements, (N, 1 + T).
        mesh: nodes and cells.

    Raises:
        SceneError: for a law that appends conditions of its own.
    """
    of_plugins: dict[str, dict[int, PairLaw]] = {}
    for pair, law in under.items():
        of_plugins.setdefault(law.plugin, {})[pair] = law
    if not of_plugins:
        return friction
    ranges = []
    for by_pair in of_plugins.values():
        first = next(iter(by_pair.values()))
        _, of_pairs, law_of_rows = first.attached(by_pair, scene, rows, pairs, free, lifts, mesh)
        check_attached(first, law_of_rows)
        if of_pairs.size != pairs.size:
            raise SceneError(
                f"friction over {first.words} is not built in: that law appends conditions of its "
                "own"
            )
        conditions = np.flatnonzero(np.isin(pairs, list(by_pair)))
        ranges.append(Range(law_of_rows.within(conditions), places_of(conditions, friction.normal)))
    bare = np.setdiff1d(
        np.arange(friction.normal.size), np.concatenate([part.rows for part in ranges])
    )
    if bare.size:
        ranges.append(Range(UNILATERAL, bare))
    return FrictionOver.of_laws(friction, Interface(tuple(ranges)))


def require_alone(law: Friction, what: str) -> None:
    """Refuse friction over laws of the pressures.

    Args:
        law: friction of the conditions.
        what: description of the request for the message.

    Raises:
        NotOfferedError: for friction over other laws.
    """
    if isinstance(law, FrictionOver):
        raise NotOfferedError(f"{what} of {law.name} is not built in: ask in Python")
