"""Laws of several plug-ins in one scene, or one without memory: each law on a range of the
conditions.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.contact.law import UNILATERAL, ContactLaw
from hhr_dolfinx.contact.rows import ContactRows, joined
from hhr_dolfinx.declared import Integers
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.memory import NO_MEMORY, Memory
from hhr_dolfinx.plain import Rebuilt
from hhr_dolfinx.plugins.contact_laws.ranges import RangeSolver, RangeStep, UnilateralStep

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

    from hhr_dolfinx.contact.law import PairLaw
    from hhr_dolfinx.parameters import ParameterSpace
    from hhr_dolfinx.scene import Scene


@dataclass(frozen=True, eq=False)
class Range(Rebuilt):
    """A law on some conditions, in its own order; sizes of the law are those of the range."""

    has_own_sizes: ClassVar[bool] = True

    law: ContactLaw
    rows: Annotated[Integers, "m"]  #: their numbers among all conditions, (k,)

    def solver(self) -> RangeSolver:
        """Facet ``range`` of the law; NotOfferedError without one."""
        if not self.law.plugin:
            return _UnilateralSolver(self.rows.size)
        capability = (
            f"{self.law.name} next to laws of other plug-ins, without memory, or hyper-reduced,"
        )
        solver: RangeSolver = registry.facet(self.law.plugin, "range", capability)(self.law)
        return solver


class _UnilateralSolver(RangeSolver):
    def step(self, before: Memory, point: np.ndarray, seconds: float) -> RangeStep:
        """Unilateral increment, see :class:`RangeSolver`.

        Args:
            before: memory at the start, which is not read.
            point: parameter, (P,).
            seconds: duration of the increment.
        """
        return UnilateralStep(self.law)


@dataclass(frozen=True, eq=False)
class Interface(ContactLaw, Rebuilt):
    """Laws on ranges that have each condition once."""

    plugin: ClassVar[str] = "contact_laws"
    floats: ClassVar[bool] = True

    ranges: tuple[Range, ...]

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Conditions without a law, or with two."""
        rows = np.sort(np.concatenate([law_range.rows for law_range in self.ranges]))
        if not np.array_equal(rows, np.arange(sizes.get("N_lambda", sizes.get("m", rows.size)))):
            yield "ranges of laws must have each condition once"

    @property
    def name(self) -> str:  # type: ignore[override]
        """Names of the laws."""
        return " and ".join(law_range.law.name for law_range in self.ranges if law_range.law.plugin)

    @property
    def path_dependent(self) -> bool:
        """True if one of the laws remembers; otherwise one increment is the answer to a point."""
        return any(law_range.law.remembers for law_range in self.ranges)

    @property
    def reshapes(self) -> bool:  # type: ignore[override]
        """True if all laws hold on shapes that depend on parameters."""
        return all(law_range.law.reshapes for law_range in self.ranges if law_range.law.plugin)

    @property
    def fixed(self) -> np.ndarray:  # type: ignore[override]
        """Parameters that one of the laws keeps constant while loads grow."""
        return np.unique(np.concatenate([law_range.law.fixed for law_range in self.ranges])).astype(
            np.int64
        )

    @property
    def plugins(self) -> tuple[str, ...]:
        """See :class:`ContactLaw`."""
        return tuple(plugin for law_range in self.ranges for plugin in law_range.law.plugins)

    def of(self, plugin: str) -> ContactLaw | None:
        """See :class:`ContactLaw`."""
        placed = (law_range.law.among(law_range.rows).of(plugin) for law_range in self.ranges)
        return next((law for law in placed if law is not None), None)

    def pressing(self, count: int) -> np.ndarray:
        """See :class:`ContactLaw`."""
        return self._joined(
            count, [law_range.law.pressing(law_range.rows.size) for law_range in self.ranges]
        )

    def pulling(self, count: int) -> np.ndarray:
        """See :class:`ContactLaw`."""
        return self._joined(
            count, [law_range.law.pulling(law_range.rows.size) for law_range in self.ranges]
        )

    def distinct(self, count: int) -> np.ndarray:
        """See :class:`ContactLaw`."""
        return self._joined(
            count, [law_range.law.distinct(law_range.rows.size) for law_range in self.ranges]
        )

    def opened(self, memory: Memory) -> np.ndarray:
        """See :class:`ContactLaw`."""
        count = sum(law_range.rows.size for law_range in self.ranges)
        return self._joined(count, [law_range.law.opened(memory) for law_range in self.ranges])

    def _joined(self, count: int, values: Sequence[np.ndarray | float]) -> np.ndarray:
        """Values of the ranges in the order of all conditions."""
        array = np.zeros(count, dtype=np.result_type(*values))
        for law_range, value in zip(self.ranges, values, strict=True):
            array[law_range.rows] = value
        return array

    def within(self, conditions: np.ndarray) -> Interface:
        """See :class:`ContactLaw`."""
        index = np.full(
            max(int(law_range.rows.max(initial=0)) for law_range in self.ranges) + 1, -1
        )
        index[conditions] = np.arange(conditions.size)
        ranges = []
        for law_range in self.ranges:
            local = np.flatnonzero(index[law_range.rows] >= 0)
            if local.size:
                ranges.append(Range(law_range.law.within(local), index[law_range.rows[local]]))
        return Interface(tuple(ranges))

    def kept_with(self, inside: np.ndarray, contact: csr_matrix) -> np.ndarray:
        """See :class:`ContactLaw`.

        Args:
            inside: conditions in the RID, (m,) bool.
            contact: rows of B, (m, N).
        """
        masks = [
            law_range.law.kept_with(inside[law_range.rows], contact[law_range.rows])
            for law_range in self.ranges
        ]
        return self._joined(inside.size, masks)

    def parts(self) -> list[str | np.ndarray]:
        """See :class:`ContactLaw`."""
        return [
            entry
            for law_range in self.ranges
            for entry in (law_range.law.name, law_range.rows, *law_range.law.parts())
        ]

    def faults_for(self, dimension: int) -> Iterator[str]:
        """See :class:`ContactLaw`."""
        for law_range in self.ranges:
            yield from law_range.law.faults_for(dimension)

    def check_path(self, space: ParameterSpace, points: np.ndarray) -> None:
        """See :class:`ContactLaw`.

        Args:
            space: box of the parameters.
            points: parameters of the path, (steps, P).
        """
        for law_range in self.ranges:
            law_range.law.check_path(space, points)

    @property
    def layout(self) -> dict[str, tuple[str, ...]]:
        """See :class:`ContactLaw`; sizes are those of a range, by its number."""
        return {
            name: (kind, *(f"{size} of range {number}" for size in sizes))
            for number, law_range in enumerate(self.ranges)
            for name, (kind, *sizes) in law_range.law.layout.items()
        }

    @property
    def sizes(self) -> dict[str, int]:
        """See :class:`ContactLaw`."""
        return {
            f"{size} of range {number}": value
            for number, law_range in enumerate(self.ranges)
            for size, value in {"N_lambda": law_range.rows.size, **law_range.law.sizes}.items()
        }

    def stored(self, memory: Memory) -> dict[str, np.ndarray]:
        """See :class:`ContactLaw`."""
        return {
            name: array
            for law_range in self.ranges
            for name, array in law_range.law.stored(memory).items()
        }

    def restored(self, arrays: Mapping[str, np.ndarray]) -> Memory:
        """See :class:`ContactLaw`."""
        memory = NO_MEMORY
        for law_range in self.ranges:
            of_range = {name: arrays[name] for name in law_range.law.layout}
            memory = memory | law_range.law.restored(of_range)
        return memory


def check_areas(scene: Scene, laws: Iterable[int]) -> None:
    """Refuse laws of pressures on pairings both ways, whose tributary areas overlap.

    Args:
        scene: the scene.
        laws: numbers of the contacts with such a law.

    Raises:
        SceneError: for a pairing both ways.
    """
    for contact in laws:
        if getattr(scene.contacts[contact], "both_ways", False):
            raise SceneError(
                f"contact {contact} of scene '{scene.name}' goes both ways, and areas of its "
                "conditions overlap, by which its law divides: take hhr.Mortar or hhr.NodeToSurface"
            )


def ranged(law: ContactLaw, count: int) -> Interface:
    """A law of some conditions as laws on ranges.

    Args:
        law: law of the conditions.
        count: number of conditions.
    """
    return law if isinstance(law, Interface) else Interface((Range(law, np.arange(count)),))


Attached = tuple[ContactRows, np.ndarray, ContactLaw]
"""Rows, the pair of each, and the law on them, as :meth:`PairLaw.attached` returns them."""


def joint(
    scene: Scene,
    laws: Sequence[Mapping[int, PairLaw]],
    found: Sequence[Attached],
    rows: ContactRows,
    pairs: np.ndarray,
) -> Attached:
    """Join the laws that plug-ins have attached to the conditions.

    A law with the facet ``steps`` that no other plug-in stands beside keeps its own solver.

    Args:
        scene: scene of the contacts.
        laws: laws by pair, one mapping for each plug-in.
        found: rows, pair of each and law on them, of each plug-in.
        rows: conditions of the pressures.
        pairs: contact pair of each of them, (n,).

    Raises:
        NotOfferedError: for a law without the facet ``range``.
        SceneError: if two laws remember one name, or one reads a memory that it says it has not.
    """
    if len(found) == 1 and _solves_itself(found[0][2]):
        return found[0]
    return _together(scene, laws, found, rows, pairs)


class OverLaws:
    """Base of a law that reads the forces of others on its rows, so that ranges solve it."""

    under: Interface  #: laws of some of its rows
    normal: np.ndarray  #: these rows, (C,)


def _solves_itself(law: ContactLaw) -> bool:
    facets = registry.installed()[law.plugin].facets
    layered = isinstance(law, OverLaws)
    return law.remembers and not layered and ("steps" in facets or "range" not in facets)


def _together(
    scene: Scene,
    laws: Sequence[Mapping[int, PairLaw]],
    found: Sequence[Attached],
    rows: ContactRows,
    pairs: np.ndarray,
) -> Attached:
    """All laws as ranges, with the unilateral one on the conditions that have none."""
    blocks = [rows]
    numbers = [pairs]
    ranges: list[Range] = []
    count = pairs.size
    for by_pair, (longer, of_pairs, law) in zip(laws, found, strict=True):
        appended = np.arange(pairs.size, of_pairs.size)
        conditions = np.concatenate([np.flatnonzero(np.isin(pairs, list(by_pair))), appended])
        blocks.append(longer.take(appended))
        numbers.append(of_pairs[appended])
        shifted = np.where(conditions < pairs.size, conditions, conditions - pairs.size + count)
        ranges.append(Range(law.within(conditions), shifted))
        count += appended.size
    unilateral = np.flatnonzero(~np.isin(pairs, [pair for by_pair in laws for pair in by_pair]))
    if unilateral.size:
        ranges.append(Range(UNILATERAL, unilateral))
    interface = Interface(tuple(ranges))
    _check_memories(scene, interface)
    return joined(blocks), np.concatenate(numbers), interface


def _remedy(law: Interface, name: str) -> str:
    """How to keep two memories of one name apart."""
    over = [part.law for part in law.ranges if isinstance(part.law, OverLaws)]
    if any(name in law_over.under.layout for law_over in over):
        return "give the pairs without friction friction=0.0, so that one law has all of them"
    return "one of them must name its memory in another way"


def _check_memories(scene: Scene, law: Interface) -> None:
    owner: dict[str, str] = {}
    for law_range in law.ranges:
        solver = law_range.solver()
        names = {*law_range.law.layout, *solver.at_rest()}
        for name in names:
            if owner.setdefault(name, law_range.law.plugin) != law_range.law.plugin:
                raise SceneError(
                    f"contacts of scene '{scene.name}' have {law.name}, of the plug-ins "
                    f"'{owner[name]}' and '{law_range.law.plugin}', and both remember '{name}': "
                    f"{_remedy(law, name)}"
                )
        if not law_range.law.remembers:
            try:
                solver.step(NO_MEMORY, scene.parameters.middle, np.nan)
            except KeyError as error:
                raise SceneError(
                    f"{type(law_range.law).__name__} says that it does not remember, and its "
                    f"increments read {error} of its memory: models would leave that out. Leave "
                    "out remembers = False"
                ) from None
