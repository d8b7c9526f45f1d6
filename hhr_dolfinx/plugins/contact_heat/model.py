"""Condensed models with steady heat through contacts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, ClassVar, cast

import numpy as np

from hhr_dolfinx.errors import ConvergenceError, StabilityWarning
from hhr_dolfinx.models.answer import ListedAnswers
from hhr_dolfinx.models.functionals.functional import Outputs
from hhr_dolfinx.plugins.contact_heat.by_sets import SetResponses, solved
from hhr_dolfinx.plugins.contact_heat.heated import HeatAnswer, HeatedModel, continued
from hhr_dolfinx.plugins.contact_heat.newton import (
    CoupledContact,
    CoupledSolution,
    by_conducting_gaps,
    changes_of,
    scales_of,
)
from hhr_dolfinx.plugins.contact_heat.parts import HeatParts
from hhr_dolfinx.plugins.contact_heat.rows import (
    HeatFields,
    OutputColumn,
    OutputColumns,
)
from hhr_dolfinx.trained import check_outside
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    from hhr_dolfinx.models.answer import Answer
    from hhr_dolfinx.plugins.contact_heat.on_page import HeatOnPage

LEAST_SIZE = 1e-3
"""Part of the sizes of a problem below which heat flows and forces count as none of their own."""
ALIKE_ANSWERS = 1e-8
"""Difference over the size of forces or heat flows up to which two answers are the same: that of
solutions whose last step was 1e-12 is far below.
"""


class HeatModel(HeatedModel):
    """Condensed model of contact and heat: exact to round-off, without training.

    Made by :func:`~hhr_dolfinx.plugins.contact_heat.making.condense_heat`.

    Args:
        parts: its data.
    """

    rows_at_once: ClassVar[int] = 64  #: points of a block of a table
    equilibrium: ClassVar[None] = None  #: of bodies with laws, which heat does not have
    known_error: ClassVar[str] = "round-off: all contact conditions are kept"

    def __init__(self, parts: HeatParts):
        super().__init__(parts)
        self._responses = SetResponses(self._schur, self._per_heat)

    def __reduce__(self) -> tuple[type[HeatModel], tuple[HeatParts]]:
        """Copy and pickle by the data, without caches; stress needs the mesh, and stays out."""
        return type(self), (self.parts,)

    def __repr__(self) -> str:
        return (
            f"<condensed model with heat: {len(self._schur)} contact conditions, "
            f"{len(self.parameters.names)} parameters>"
        )

    def balances(self, point: Any) -> list[HeatAnswer]:
        """The different balances that two starts find: contact without heat, and closed contacts
        that conduct perfectly. Empty where neither finds one.

        Args:
            point: parameter, (P,), or values by name.

        Raises:
            ParameterError: for a point outside the box.
        """
        checked = self.parameters.point(point)
        contact = self._coupled(checked)
        found = [one for one in self._found(contact) if one.converged]
        if len(found) > 1 and _alike(contact, *found[:2]):
            del found[1]
        return [self._answer(checked, contact, one, several=len(found) > 1) for one in found]

    @property
    def fields(self) -> HeatFields:
        """Outputs as columns of tables."""
        functionals = self.mechanical.fields.functionals
        of_scene = () if functionals is None else functionals.items
        items = [OutputColumn(output.name, output.unit) for output in of_scene]
        items += [OutputColumn(name, "") for name in self.flow_outputs]
        return HeatFields(OutputColumns(tuple(items)))

    def on_page(self) -> HeatOnPage:
        """Parts of a page of this model beside contact, see
        :mod:`hhr_dolfinx.plugins.pages.added`.
        """
        from hhr_dolfinx.plugins.contact_heat.on_page import HeatOnPage

        return HeatOnPage(self, partial(self.solve, both=False, raise_on_failure=False))

    @property
    def dimension(self) -> int:
        """Dimension of the mesh."""
        return self.mechanical.dimension

    def columns(self, many: Iterable[HeatAnswer]) -> dict[str, np.ndarray]:
        """Further columns of a table of answers: True where there are several balances, (n,)."""
        return {"several balances": np.array([answer.several for answer in many], dtype=float)}

    def summed_up(self, sums: Mapping[str, float]) -> str:
        """Words on these columns for the last line of a table, from their sums."""
        count = int(sums.get("several balances", 0.0))
        return f", {count} of them of several balances" if count else ""

    def solve(
        self,
        point: Any,
        *,
        both: bool = True,
        raise_on_failure: bool = True,
        outside: str = "refuse",
    ) -> HeatAnswer:
        """Answer to a point, that of contact without heat as the start if that finds a balance.

        Args:
            point: parameter, (P,), or values by name.
            both: look for another balance too, from closed contacts, and warn of it: twice the
                time. Without, that start is tried only where the first one finds none.
            raise_on_failure: raise where no balance is found, or return NaN.
            outside: for tables alone, as nothing is trained: points outside the box are refused.

        Raises:
            ParameterError: for a point outside the box.
            ConvergenceError: where neither start ends in a balance, as heat may have none.

        Warns:
            StabilityWarning: where the two end in different balances: heat through contacts may
                have several, or none (Barber 1978).
        """
        check_outside(outside)
        checked = self.parameters.point(point)
        contact = self._coupled(checked)
        found = self._found(contact, both)
        balanced = [one for one in found if one.converged]
        if not balanced:
            if raise_on_failure:
                raise ConvergenceError(
                    f"contact and heat find no balance at {self.parameters.described(checked)}: "
                    "there may be none, as where heat opens what must be closed to conduct it. "
                    "Give the gap a conductance too, or a smoother one"
                )
            return self._answer(checked, contact, found[0], several=False)
        several = both and len(balanced) > 1 and not _alike(contact, *balanced[:2])
        if several:
            warn(
                f"at {self.parameters.described(checked)} contact and heat have several balances: "
                "this one is that from contact without heat, see model.balances(point)",
                StabilityWarning,
            )
        return self._answer(checked, contact, balanced[0], several=several)

    def solve_many(
        self,
        points: Any,
        *,
        both: bool = True,
        raise_on_failure: bool = True,
        outside: str = "refuse",
    ) -> ListedAnswers:
        """Answers to many points, (n, P), as :meth:`solve` finds them.

        Args:
            points: parameters, (n, P).
            both, raise_on_failure, outside: see :meth:`solve`.
        """
        checked = self.parameters.points(points)
        answers = tuple(
            self.solve(point, both=both, raise_on_failure=raise_on_failure, outside=outside)
            for point in checked
        )
        return ListedAnswers(cast("tuple[Answer, ...]", answers))

    def march(self, points: Any, *, raise_on_failure: bool = True) -> list[HeatAnswer]:
        """Answers along a history, (n, P): each starts from the one before, and stays with its
        balance where there are several, as bodies do that warm slowly.

        Args:
            points: parameters in the order of the history, (n, P).
            raise_on_failure: see :meth:`solve`.
        """
        answers: list[HeatAnswer] = []
        for point in self.parameters.points(points):
            contact = self._coupled(point)
            if answers and answers[-1].converged:
                found = self._solved(contact, answers[-1].forces(), continued(answers[-2:]))
                if found.converged:
                    answers.append(self._answer(point, contact, found, several=False))
                    continue
            answers.append(self.solve(point, both=False, raise_on_failure=raise_on_failure))
        return answers

    def outputs(self, point: Any, *, gradient: bool = False) -> Outputs:
        """Outputs at a point, see :meth:`HeatAnswer.outputs`.

        Args:
            point: parameter, (P,), or values by name.
            gradient: add derivatives along the parameters, at the statuses of the answer.
        """
        answer = self.solve(point)
        if not gradient:
            return answer.outputs()
        contact = self._coupled(answer.parameter)
        along = self._along(answer, self._per_sliding)
        forces, flows = changes_of(contact, answer.solution, along)
        made = self._made_changes(answer, forces)
        changes = np.insert(flows, [self.conditions] * len(made), made, axis=0)
        return replace(answer.outputs(), gradient=self._gradient(answer, changes))

    def _found(self, contact: CoupledContact, both: bool = True) -> list[CoupledSolution]:
        """Solutions from contact without heat, and from closed contacts that conduct perfectly: if
        both are wanted, or the first fails. If neither converges, that by gaps that conduct, less
        and less.
        """
        forces = self._without_heat(contact.slack)
        nothing = np.zeros(self._per_heat.shape[1])
        found = [self._solved(contact, forces, nothing)]
        if found[0].converged and not both:
            return found
        flows = self._perfect @ np.concatenate([contact.jump, contact.supplied])
        closed = self._closed(contact, contact.slack + self._per_heat @ flows)
        pressed = np.maximum(closed, 0.1 * np.abs(closed).max(initial=0.0))
        found.append(self._solved(contact, pressed, flows))
        if not any(one.converged for one in found):
            found.append(by_conducting_gaps(contact, forces, nothing))
        return found

    def _closed(self, contact: CoupledContact, slack: np.ndarray) -> np.ndarray:
        """Forces at which all conditions are closed, with the heat that they make, (m,)."""
        if contact.sliding is None:
            return self._equalities(np.ones(self.conditions, dtype=bool), slack)[0]
        forces: np.ndarray = np.linalg.lstsq(contact.schur, -slack, rcond=None)[0]
        return forces

    def _solved(
        self, contact: CoupledContact, forces: np.ndarray, flows: np.ndarray
    ) -> CoupledSolution:
        return solved(contact, forces, flows, self._responses)

    @cached_property
    def _perfect(self) -> np.ndarray:
        """Heat flows of contacts that conduct perfectly, and levels of bodies, per jump and supply,
        (m + b, m + b); the least ones where temperatures are fixed on both sides.
        """
        bodies = self._levels.shape[1]
        conducts = np.isin(self.pairs, list(self.conductances)).astype(float)
        matrix = np.block(
            [
                [
                    conducts[:, None] * self._compliance * conducts,
                    -conducts[:, None] * self._levels,
                ],
                [self._levels.T * conducts, np.zeros((bodies, bodies))],
            ]
        )
        return np.linalg.pinv(matrix)


def _alike(contact: CoupledContact, first: CoupledSolution, second: CoupledSolution) -> bool:
    """True for two solutions that differ by round-off of the sizes of the problem."""
    sizes = scales_of(contact)
    return all(
        np.abs(one - other).max(initial=0.0)
        <= ALIKE_ANSWERS * max(np.abs(one).max(initial=0.0), LEAST_SIZE * size)
        for one, other, size in (
            (first.forces, second.forces, sizes.force),
            (first.heat, second.heat, sizes.heat),
            (first.levels, second.levels, sizes.level),
        )
    )
