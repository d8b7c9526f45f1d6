"""The law of surfaces that slide, on rows of all their dofs: contact of bodies with laws, in each
linearisation of a step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, Status, Statuses
from hhr_dolfinx.contact.law import ContactLaw, StepContact
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.models.answer import Answer, HasLaw
from hhr_dolfinx.plugins.contact_laws.increments import IncrementEnd
from hhr_dolfinx.plugins.contact_laws.steps import LawSteps
from hhr_dolfinx.plugins.friction.laws import SLIP, Friction
from hhr_dolfinx.plugins.friction.slider import SlidingState
from hhr_dolfinx.plugins.sliding.beside import BesideTools
from hhr_dolfinx.plugins.sliding.repairing import PairedSolution, PairedSurfaces, SlidingPair

PLACE = "surface_displacement"
"""Name of the memory of the displacement of surfaces, from which the next step slips."""


@dataclass(frozen=True, eq=False)
class SlidingLaw(ContactLaw):
    """Contact of pairs that slide, and of those beside them, by forces on all dofs of surfaces."""

    plugin: ClassVar[str] = "sliding"
    name: ClassVar[str] = "surfaces that slide"

    pairs: tuple[SlidingPair, ...]
    friction: Friction  #: of all contacts, and laws of pressures
    beside: BesideTools

    @property
    def fixed(self) -> np.ndarray:  # type: ignore[override]
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return self.friction.fixed

    @property
    def plugins(self) -> tuple[str, ...]:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return (self.plugin, *self.friction.plugins)

    def of(self, plugin: str) -> ContactLaw | None:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return self if plugin == self.plugin else self.friction.of(plugin)

    def pressing(self, count: int) -> np.ndarray:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`: all but tangential rows of the pairs
        that do not slide.
        """
        return self._all_but(self.friction.tangential, count)

    def distinct(self, count: int) -> np.ndarray:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return self._all_but(self.friction.twice, count)

    def _all_but(self, rows: np.ndarray, count: int) -> np.ndarray:
        mask = np.ones(count, dtype=bool)
        mask[rows[rows < self.pairs[0].first]] = False
        return mask

    def within(self, conditions: np.ndarray) -> ContactLaw:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`.

        Raises:
            NotOfferedError: always: surfaces are paired as a whole.
        """
        raise NotOfferedError(
            "surfaces that slide are paired as a whole: no part of their conditions has a law"
        )

    def parts(self) -> list[str | np.ndarray]:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        places = [surface.points for pair in self.pairs for surface in (pair.slave, pair.master)]
        return [*self.friction.parts(), *places]

    @property
    def layout(self) -> dict[str, tuple[str, ...]]:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return {**self.friction.layout, PLACE: ("float", "N_lambda")}

    @property
    def sizes(self) -> dict[str, int]:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return self.friction.sizes

    def stored(self, memory: Memory) -> dict[str, np.ndarray]:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return {**self.friction.stored(memory), PLACE: memory[PLACE]}

    def restored(self, arrays: Mapping[str, np.ndarray]) -> Memory:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        of_friction = {name: arrays[name] for name in self.friction.layout}
        return self.friction.restored(of_friction) | {PLACE: arrays[PLACE]}


NO_SLOPES = (
    "derivatives of bodies that slide past their mesh are not built in: pairings change along a "
    "path. Take differences of answers"
)
"""Why there are none."""


def no_slopes(*given: Any) -> None:
    """Facet ``flow_slopes``: refuse derivatives of bodies with laws.

    Args:
        *given: not read.

    Raises:
        NotOfferedError: always.
    """
    raise NotOfferedError(NO_SLOPES)


class _SlidingStep:
    """Contact of the linearisations of one step, each on pairings of its own."""

    def __init__(self, surfaces: PairedSurfaces, before: SlidingState, target: IncrementEnd):
        self._surfaces = surfaces
        self._before = before
        self._target = target
        self._last: PairedSolution | None = None

    def solved(
        self,
        equalities: SchurEqualities,
        free_slack: np.ndarray,
        active: np.ndarray,
        pairs: Pairs | None,
    ) -> Statuses:
        """See :class:`~hhr_dolfinx.contact.law.StepContact`.

        Args:
            equalities: equality problems on S of the linearisation.
            free_slack: slack without contact forces, (m,).
            active: not read: pairings have conditions of their own.
            pairs: not read: one problem has all pairs.
        """
        whole = equalities.whole()
        self._last = solved = self._surfaces.solved(whole, free_slack, self._before, self._target)
        found = solved.found
        if found.status is Status.CONVERGED:  # else no start for the next one
            self._before = self._before._replace(forces=found.forces, active=found.active)
        return Statuses(
            solved.surface_forces,
            self._surfaces.active(found, solved.surface_forces),
            found.iterations,
            found.status,
            found.sweeps > 0,
        )

    def changes(
        self, equalities: SchurEqualities, found: Statuses, slack: np.ndarray
    ) -> np.ndarray:
        """See :class:`~hhr_dolfinx.contact.law.StepContact`.

        Args:
            equalities, found, slack: not read.

        Raises:
            NotOfferedError: always.
        """
        raise NotOfferedError(NO_SLOPES)

    def memory(self, unknown: np.ndarray) -> Memory:
        """See :class:`~hhr_dolfinx.contact.law.StepContact`."""
        assert self._last is not None
        return _memory(self._last.slip, self._last.laws, self._last.displacement)


def _memory(slip: Any, laws: Memory, displacement: np.ndarray) -> Memory:
    return Memory(slip=slip, **{PLACE: displacement}) | laws


class _SlidingSteps(LawSteps):
    """Facet ``steps``, for bodies with laws."""

    def step_contact(
        self, model: Any, before: Answer, point: np.ndarray, time: float, last: Any = None
    ) -> StepContact:
        """Contact on the S of each linearisation.

        See :class:`~hhr_dolfinx.models.histories.steps.Steps`.

        Args:
            model: model with the law.
            before: answer at the start of the step.
            point: parameter, (P,).
            time: time at the end of the step in seconds.
            last: not read.
        """
        law: SlidingLaw = model.law
        surfaces = PairedSurfaces(law.pairs, law.friction, model.parameters)
        nothing = np.zeros(0)
        state = SlidingState(
            before.parameter,
            before.time,
            np.zeros(surfaces.rows),
            None,
            nothing,
            before.memory[SLIP],
            nothing,
            nothing,
            nothing,
            before.memory[PLACE],
            before.multipliers,
            before.memory,
        )
        return _SlidingStep(surfaces, state, IncrementEnd(time, point, nothing))

    def at_rest(self, model: HasLaw, gaps: np.ndarray, point: np.ndarray) -> Memory:
        """Undeformed bodies without slip.

        Args:
            model: model with the law.
            gaps: gaps of its rows, (M,).
            point: parameter at rest, (P,).
        """
        law: Any = model.law
        surfaces = PairedSurfaces(law.pairs, law.friction, model.parameters)
        rest = surfaces.at_rest(0.0, point, np.zeros(0), gaps)
        return _memory(rest.slip, rest.laws, np.zeros(gaps.size))

    def watch(self, model: HasLaw) -> Callable[[Answer], None]:
        """Of the distance that bodies slide along curved tools."""
        law: Any = model.law
        beside: BesideTools = law.beside
        last = law.pairs[-1]
        along = last.first + last.nodes * last.slave.points.shape[1]
        largest = 0.0

        def check(answer: Answer) -> None:
            nonlocal largest
            forces = answer.multipliers
            largest = max(largest, float(np.linalg.norm(forces)))
            motion = answer.memory[PLACE][along:].reshape(beside.conditions.size, -1)
            beside.check(forces, motion, largest, model.parameters.described(answer.parameter))

        return check if beside.conditions.size else lambda answer: None


SLIDING_STEPS = _SlidingSteps()
"""The facet, without state."""
