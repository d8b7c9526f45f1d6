"""Laws of several plug-ins in one scene, or one without memory: each law on a range of the
conditions.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.contact.law import UNILATERAL, ContactLaw
from hhr_dolfinx.contact.rows import ContactRows, joined
from hhr_dolfinx.declared import Integers
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.memory import NO_MEMORY, Memory
from hhr_dolfinx.plain import Rebuilt
from hhr_dolfinx.plugins.contact_laws.ranges import RangeSolver, RangeStep, UnilateralStep


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
        what = f"{self.law.name} next to laws of other plug-ins, without memory, or hyper-reduced,"
        made: RangeSolver = registry.facet(self.law.plugin, "range", what)(self.law)
        return made


class _UnilateralSolver(RangeSolver):
    def step(self, before: Mapping[str, Any], point: np.ndarray, seconds: float) -> RangeStep:
        return UnilateralStep(self.law)


@dataclass(frozen=True, eq=False)
class Interface(ContactLaw, Rebuilt):
    """Laws on ranges that have each condition once."""

    plugin: ClassVar[str] = "contact_laws"
    floats: ClassVar[bool] = True

    ranges: tuple[Range, ...]

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Conditions without a law, or with two."""
        rows = np.sort(np.concatenate([part.rows for part in self.ranges]))
        if not np.array_equal(rows, np.arange(sizes.get("N_lambda", sizes.get("m", rows.size)))):
            yield "ranges of laws must have each condition once"

    @property
    def name(self) -> str:  # type: ignore[override]
        """Names of the laws."""
        return " and ".join(part.law.name for part in self.ranges if part.law.plugin)

    @property
    def path_dependent(self) -> bool:
        """True if one of the laws remembers; otherwise one increment is the answer to a point."""
        return any(part.law.remembers for part in self.ranges)

    @property
    def reshapes(self) -> bool:  # type: ignore[override]
        """True if all laws hold on shapes that depend on parameters."""
        return all(part.law.reshapes for part in self.ranges if part.law.plugin)

    @property
    def fixed(self) -> np.ndarray:  # type: ignore[override]
        """Parameters that one of the laws keeps constant while loads grow."""
        return np.unique(np.concatenate([part.law.fixed for part in self.ranges])).astype(np.int64)

    @property
    def plugins(self) -> tuple[str, ...]:
        """See :class:`ContactLaw`."""
        return tuple(plugin for part in self.ranges for plugin in part.law.plugins)

    def of(self, plugin: str) -> ContactLaw | None:
        """See :class:`ContactLaw`."""
        return next(
            (part.law.among(part.rows) for part in self.ranges if part.law.plugin == plugin), None
        )

    def pressing(self, count: int) -> np.ndarray:
        """See :class:`ContactLaw`."""
        return self._joined(count, [part.law.pressing(part.rows.size) for part in self.ranges])

    def distinct(self, count: int) -> np.ndarray:
        """See :class:`ContactLaw`."""
        return self._joined(count, [part.law.distinct(part.rows.size) for part in self.ranges])

    def opened(self, memory: Memory) -> np.ndarray:
        """See :class:`ContactLaw`."""
        count = sum(part.rows.size for part in self.ranges)
        return self._joined(count, [part.law.opened(memory) for part in self.ranges])

    def _joined(self, count: int, values: Sequence[Any]) -> np.ndarray:
        """Values of the ranges in the order of all conditions."""
        found = np.zeros(count, dtype=np.result_type(*values))
        for part, own in zip(self.ranges, values, strict=True):
            found[part.rows] = own
        return found

    def within(self, conditions: np.ndarray) -> Interface:
        """See :class:`ContactLaw`."""
        place = np.full(max(int(part.rows.max(initial=0)) for part in self.ranges) + 1, -1)
        place[conditions] = np.arange(conditions.size)
        found = []
        for part in self.ranges:
            kept = np.flatnonzero(place[part.rows] >= 0)
            if kept.size:
                found.append(Range(part.law.within(kept), place[part.rows[kept]]))
        return Interface(tuple(found))

    def kept_with(self, inside: np.ndarray, contact: Any) -> np.ndarray:
        """See :class:`ContactLaw`."""
        kept = [part.law.kept_with(inside[part.rows], contact[part.rows]) for part in self.ranges]
        return self._joined(inside.size, kept)

    def parts(self) -> list[Any]:
        """See :class:`ContactLaw`."""
        return [
            item for part in self.ranges for item in (part.law.name, part.rows, *part.law.parts())
        ]

    def faults_for(self, dimension: int) -> Iterator[str]:
        """See :class:`ContactLaw`."""
        for part in self.ranges:
            yield from part.law.faults_for(dimension)

    def check_path(self, space: Any, points: np.ndarray) -> None:
        """See :class:`ContactLaw`."""
        for part in self.ranges:
            part.law.check_path(space, points)

    @property
    def layout(self) -> dict[str, tuple[str, ...]]:
        """See :class:`ContactLaw`; sizes are those of a range, by its number."""
        return {
            name: (kind, *(f"{size} of range {number}" for size in sizes))
            for number, part in enumerate(self.ranges)
            for name, (kind, *sizes) in part.law.layout.items()
        }

    @property
    def sizes(self) -> dict[str, int]:
        """See :class:`ContactLaw`."""
        return {
            f"{size} of range {number}": value
            for number, part in enumerate(self.ranges)
            for size, value in {"N_lambda": part.rows.size, **part.law.sizes}.items()
        }

    def stored(self, memory: Memory) -> dict[str, Any]:
        """See :class:`ContactLaw`."""
        return {
            name: array for part in self.ranges for name, array in part.law.stored(memory).items()
        }

    def restored(self, arrays: Mapping[str, np.ndarray]) -> Memory:
        """See :class:`ContactLaw`."""
        found = NO_MEMORY
        for part in self.ranges:
            own = {name: arrays[name] for name in part.law.layout}
            found = found | part.law.restored(own)
        return found


def ranged(law: ContactLaw, count: int) -> Interface:
    """A law of so many conditions as ranges."""
    return law if isinstance(law, Interface) else Interface((Range(law, np.arange(count)),))


Attached = tuple[ContactRows, np.ndarray, ContactLaw]
"""Rows, the pair of each, and the law on them, as :meth:`PairLaw.attached` returns them."""


def joint(
    scene: Any,
    laws: Sequence[Mapping[int, Any]],
    found: Sequence[Attached],
    rows: ContactRows,
    pairs: np.ndarray,
) -> Attached:
    """Join what laws by pair, one mapping for each plug-in, have attached to the conditions
    ``rows`` of ``pairs``.

    A law with the facet ``steps`` that no other plug-in stands beside keeps its own solver.

    Raises:
        NotOfferedError: for a law without the facet ``range``.
        SceneError: if two laws remember one name, or one reads a memory that it says it has not.
    """
    if len(found) == 1 and _solves_itself(found[0][2]):
        return found[0]
    return _together(scene, laws, found, rows, pairs)


def _solves_itself(law: ContactLaw) -> bool:
    facets = registry.installed()[law.plugin].facets
    return law.remembers and ("steps" in facets or "range" not in facets)


def _together(
    scene: Any,
    laws: Sequence[Mapping[int, Any]],
    found: Sequence[Attached],
    rows: ContactRows,
    pairs: np.ndarray,
) -> Attached:
    """All laws as ranges, with the unilateral one on the conditions that have none."""
    every = [rows]
    numbers = [pairs]
    ranges: list[Range] = []
    count = pairs.size
    for own, (longer, of_pairs, law) in zip(laws, found, strict=True):
        appended = np.arange(pairs.size, of_pairs.size)
        conditions = np.concatenate([np.flatnonzero(np.isin(pairs, list(own))), appended])
        every.append(longer.take(appended))
        numbers.append(of_pairs[appended])
        shifted = np.where(conditions < pairs.size, conditions, conditions - pairs.size + count)
        ranges.append(Range(law.within(conditions), shifted))
        count += appended.size
    rest = np.flatnonzero(~np.isin(pairs, [place for own in laws for place in own]))
    if rest.size:
        ranges.append(Range(UNILATERAL, rest))
    interface = Interface(tuple(ranges))
    _check_memories(scene, interface)
    return joined(every), np.concatenate(numbers), interface


def _check_memories(scene: Any, law: Interface) -> None:
    owner: dict[str, str] = {}
    for part in law.ranges:
        solver = part.solver()
        names = {*part.law.layout, *solver.at_rest()}
        for name in names:
            if owner.setdefault(name, part.law.plugin) != part.law.plugin:
                raise SceneError(
                    f"contacts of scene '{scene.name}' have {law.name}, of the plug-ins "
                    f"'{owner[name]}' and '{part.law.plugin}', and both remember '{name}': one of "
                    "them must name its memory in another way"
                )
        if not part.law.remembers:
            try:
                solver.step(NO_MEMORY, scene.parameters.middle, np.nan)
            except KeyError as error:
                raise SceneError(
                    f"{type(part.law).__name__} says that it does not remember, and its "
                    f"increments read {error} of its memory: models would leave that out. Leave "
                    "out remembers = False"
                ) from None
