"""Condensed models with heat through contacts, and their answers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from hhr_dolfinx.contact.active_set import active_set
from hhr_dolfinx.errors import ConvergenceError, HHRError, SceneError, StabilityWarning
from hhr_dolfinx.formulas import IMAGINARY_STEP, Formula
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.eliminations.elimination import differentiated
from hhr_dolfinx.models.functionals.functional import Outputs
from hhr_dolfinx.plugins.contact_heat.by_sets import SetResponses, solved_by_sets
from hhr_dolfinx.plugins.contact_heat.heat import GAP_NAME, PRESSURE_NAME
from hhr_dolfinx.plugins.contact_heat.newton import (
    CoupledChanges,
    CoupledContact,
    CoupledSolution,
    by_conducting_gaps,
    changes_of,
    scales_of,
    solved,
)
from hhr_dolfinx.plugins.contact_heat.parts import HeatParts
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hhr_dolfinx.models.eliminations.constant import ConstantElimination

LEAST_SIZE = 1e-3
"""Part of the sizes of a problem below which heat flows and forces count as none of their own."""
ALIKE_ANSWERS = 1e-8
"""Difference over the size of forces or heat flows up to which two answers are the same: that of
solutions whose last step was 1e-12 is far below.
"""


@dataclass(frozen=True, eq=False)
class HeatAnswer:
    """Answer with heat through contacts.

    Attributes:
        parameter: the parameter, (P,).
        jump: temperature of the first surface less that of the second, (m,).
        several: True if another start has another answer.
        solution: forces, slacks, heat flows and levels.
    """

    parameter: np.ndarray
    jump: np.ndarray
    several: bool
    solution: CoupledSolution
    _model: HeatModel

    @cached_property
    def mechanical(self) -> Answer:
        """Answer of the contact problem under these temperatures, with all that such answers have:
        displacement, pressure, picture.
        """
        return self._model.mechanical_answer(self)

    @property
    def converged(self) -> bool:
        """True if contact and heat are in balance."""
        return self.solution.converged

    @property
    def heat(self) -> np.ndarray:
        """Heat flow of each condition from the first surface of its contact to the second, (m,): a
        power, per unit depth in the plane and of the whole turn in axisymmetry.
        """
        return self.solution.heat

    @property
    def heated(self) -> np.ndarray:
        """The parameter followed by heat flows and levels: a point of ``model.mechanical``,
        (P + m + b,).
        """
        return np.concatenate([self.parameter, self.heat, self.levels])

    def forces(self) -> np.ndarray:
        """Contact forces, (m,), see :meth:`hhr_dolfinx.models.answer.Answer.forces`."""
        return self.solution.forces.copy()

    @property
    def levels(self) -> np.ndarray:
        """Temperatures of bodies that contact alone feeds, above those of their supplies, (b,)."""
        return self.solution.levels

    @property
    def gaps(self) -> np.ndarray:
        """Gap of each condition, (m,); 0 where it is closed."""
        return np.maximum(self.solution.slack, 0.0)

    def displacement(self) -> np.ndarray:
        """Displacement on the whole mesh, (N,)."""
        return self.mechanical.displacement()

    def temperature(self) -> np.ndarray:
        """Temperature at the nodes of the mesh, (n,)."""
        return self._model.conduction.temperature(self.heated, self.parameter.size)

    def stress(self) -> np.ndarray:
        """Stress in the middle of each cell, without that of the free expansion, Kelvin's notation,
        (cells, components), see :meth:`hhr_dolfinx.models.answer.Answer.stress`.
        """
        return self.mechanical.stress()

    def plot(self, path: str | PathLike[str] | None = None, scale: float | None = None) -> Figure:
        """Picture of the deformed bodies with their stress, and of the pressure on the contacts.

        Args:
            path: file to save the figure to; None does not save it.
            scale: factor of the displacements; None chooses a power of ten.

        Raises:
            NotOfferedError: without a plug-in that draws.
            MissingPackageError: without matplotlib, in space without PyVista.
        """
        figure = self.mechanical.plot(scale=scale)
        figure.suptitle(f"at {self._model.parameters.described(self.parameter)}")
        if path is not None:
            figure.savefig(path)
        return figure

    def heat_through(self, contact: int) -> float:
        """Heat flow through a contact from its first surface to the second.

        Args:
            contact: number of the contact in the scene.

        Raises:
            SceneError: for a number that no contact has.
        """
        if isinstance(contact, bool) or contact not in self._model.contacts:
            raise SceneError(
                f"the scene has contacts {sorted(self._model.contacts)}, and no {contact!r}"
            )
        return float(self.heat[self._model.pairs == contact].sum())

    def outputs(self) -> Outputs:
        """Outputs of the scene by name, and ``heat 0``, ``heat 1``, the flow of each contact."""
        flows = {f"heat {k}": self.heat_through(k) for k in self._model.conductances}
        units = dict.fromkeys(flows, "")
        if self._model.mechanical.fields.functionals is None:
            return Outputs(flows, units)
        of_scene = self.mechanical.outputs()
        return Outputs(of_scene.values | flows, of_scene.units | units)


class HeatModel:
    """Condensed model of contact and heat: exact to round-off, without training.

    Made by :func:`~hhr_dolfinx.plugins.contact_heat.making.condense_heat`.

    Args:
        parts: its data.

    Attributes:
        parameters: the box of the parameters.
        mechanical: condensed model of the scene with heat flows and levels as further parameters.
        conduction: temperatures per heat flow and supply.
        conductances: formulas by contact; their last two names are the pressure and the gap.
        pairs: contact of each condition, (m,).
    """

    def __init__(self, parts: HeatParts):
        self.parts = parts
        self.parameters = parts.parameters
        self.mechanical = parts.mechanical
        self.conduction = parts.conduction
        numbers = parts.contacts.tolist()
        self.conductances = dict(zip(numbers, parts.conductances, strict=True))
        self._areas = parts.areas
        mechanical = parts.mechanical
        conduction = parts.conduction
        self.pairs = np.zeros(len(parts.areas), dtype=np.int64)
        if mechanical.pairs is not None:
            self.pairs = mechanical.pairs
        eliminated = cast("ConstantElimination", mechanical.eliminated)
        self._schur = eliminated.responses.schur
        self._free_slack = eliminated.responses.free_slack
        self._equalities = eliminated.equalities
        self._amplitudes = eliminated.amplitudes
        slopes = self._amplitudes.slopes[:, len(self.parameters.names) :]
        self._per_heat = self._free_slack[:, : len(slopes)] @ slopes
        self._jumps = conduction.jumps @ conduction.temperatures
        self._compliance = conduction.jumps @ conduction.per_heat
        self._levels = conduction.jumps @ conduction.levels
        self._responses = SetResponses(self._schur, self._per_heat)

    def __repr__(self) -> str:
        return (
            f"<condensed model with heat: {len(self._schur)} contact conditions, "
            f"{len(self.parameters.names)} parameters>"
        )

    @property
    def conditions(self) -> int:
        """Number of contact conditions."""
        return len(self._schur)

    @property
    def contacts(self) -> set[int]:
        """Numbers of the contacts that have conditions."""
        return set(self.pairs.tolist())

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

    def solve(self, point: Any, *, both: bool = True, raise_on_failure: bool = True) -> HeatAnswer:
        """Answer to a point, that of contact without heat as the start if that finds a balance.

        Args:
            point: parameter, (P,), or values by name.
            both: look for another balance too, from closed contacts, and warn of it: twice the
                time. Without, that start is tried only where the first one finds none.
            raise_on_failure: raise where no balance is found, or return NaN.

        Raises:
            ParameterError: for a point outside the box.
            ConvergenceError: where neither start ends in a balance, as heat may have none.

        Warns:
            StabilityWarning: where the two end in different balances: heat through contacts may
                have several, or none (Barber 1978).
        """
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
        self, points: Any, *, both: bool = True, raise_on_failure: bool = True
    ) -> list[HeatAnswer]:
        """Answers to many points, (n, P), as :meth:`solve` finds them.

        Args:
            points: parameters, (n, P).
            both, raise_on_failure: see :meth:`solve`.
        """
        checked = self.parameters.points(points)
        more = {"both": both, "raise_on_failure": raise_on_failure}
        return [self.solve(point, **more) for point in checked]

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
                before = answers[-1]
                flows = np.concatenate([before.heat, before.levels])
                found = self._from(contact, before.forces(), flows)
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
        return replace(answer.outputs(), gradient=self._gradient(answer) if gradient else None)

    def _gradient(self, answer: HeatAnswer) -> dict[str, np.ndarray]:
        """Derivatives of all outputs along the parameters of the user, (P,) each."""
        count = len(self.parameters.names)
        changes = self._changes(answer)
        gradient = {
            f"heat {contact}": changes[: self.conditions][self.pairs == contact].sum(axis=0)
            for contact in self.conductances
        }
        if self.mechanical.fields.functionals is None:
            return gradient
        contact = self.mechanical.eliminated(answer.heated)
        along = differentiated(contact, answer.mechanical).outputs().gradient
        assert along is not None
        of_scene = {name: of[:count] + of[count:] @ changes for name, of in along.items()}
        return {**of_scene, **gradient}

    def _changes(self, answer: HeatAnswer) -> np.ndarray:
        """Derivatives of heat flows and levels along the parameters of the user, (m + b, P)."""
        count = len(self.parameters.names)
        point = answer.parameter
        acting, slopes = self._amplitudes.slopes_at(self._without_flows(point))
        supplies = np.array([one.derivative(point) for one in self.conduction.amplitudes])
        supplies = supplies.reshape(-1, count)
        contact = self._coupled(point)
        pressed = answer.forces() / self._areas
        along = CoupledChanges(
            slack=self._free_slack[:, acting] @ slopes[:, :count],
            jump=self._jumps @ supplies,
            supplied=self.conduction.supplied @ supplies,
            conductance=self._conducted_changes(point, pressed, answer.gaps),
        )
        return changes_of(contact, answer.solution, along)

    def _conducted_changes(
        self, point: np.ndarray, pressures: np.ndarray, gaps: np.ndarray
    ) -> np.ndarray:
        """Derivatives of the conductances along the parameters, (m, P)."""
        changes = np.zeros((pressures.size, point.size))
        for rows, formula, values in self._formulas(point, pressures, gaps):
            for place, name in enumerate(self.parameters.names):
                if name in formula.variables:
                    changes[rows, place] = _derivative(formula, values, name)
        return changes

    def mechanical_answer(self, answer: HeatAnswer) -> Answer:
        """Answer of the contact problem under the heat flows of an answer.

        Args:
            answer: an answer of this model.

        Raises:
            HHRError: for an answer that is no balance.
        """
        if not answer.converged:
            raise HHRError("contact and heat found no balance: there is no answer to read")
        contact = self.mechanical.eliminated(answer.heated)
        return self.mechanical.from_contact(contact, answer.heated, raise_on_failure=True)

    def _without_flows(self, point: np.ndarray) -> np.ndarray:
        """The point of the mechanical model without heat flows and levels, (P + m + b,)."""
        return np.concatenate([point, np.zeros(self._per_heat.shape[1])])

    def _coupled(self, point: np.ndarray) -> CoupledContact:
        supplies = self.conduction.supplies(point)
        return CoupledContact(
            slack=self._free_slack @ self._amplitudes(self._without_flows(point)),
            schur=self._schur,
            per_heat=self._per_heat,
            jump=self._jumps @ supplies,
            compliance=self._compliance,
            levels=self._levels,
            supplied=self.conduction.supplied @ supplies,
            areas=self._areas,
            conductance=lambda pressures, gaps: self._conducted(point, pressures, gaps),
        )

    def _conducted(
        self, point: np.ndarray, pressures: np.ndarray, gaps: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Conductances of all conditions and their derivatives along pressure and gap."""
        found = np.zeros((3, pressures.size))
        for rows, formula, values in self._formulas(point, pressures, gaps):
            found[0, rows] = np.real(np.asarray(formula(values)))
            for place, name in enumerate((PRESSURE_NAME, GAP_NAME), start=1):
                found[place, rows] = _derivative(formula, values, name)
        return found[0], found[1], found[2]

    def _formulas(
        self, point: np.ndarray, pressures: np.ndarray, gaps: np.ndarray
    ) -> Iterator[tuple[np.ndarray, Formula, dict[str, Any]]]:
        """Conditions of each contact that conducts, (m,) bool, its formula and what that names."""
        values = dict(zip(self.parameters.names, point.tolist(), strict=True))
        for contact, scalar in self.conductances.items():
            rows = self.pairs == contact
            at = {PRESSURE_NAME: pressures[rows], GAP_NAME: gaps[rows]}
            yield rows, scalar.formula, values | at

    def _found(self, contact: CoupledContact, both: bool = True) -> list[CoupledSolution]:
        """Solutions from contact without heat, and from closed contacts that conduct perfectly: if
        both are wanted, or the first fails. If neither converges, that by gaps that conduct, less
        and less.
        """
        forces = self._without_heat(contact.slack)
        nothing = np.zeros(self._per_heat.shape[1])
        found = [self._from(contact, forces, nothing)]
        if found[0].converged and not both:
            return found
        flows = self._perfect @ np.concatenate([contact.jump, contact.supplied])
        every = np.ones(self.conditions, dtype=bool)
        closed, _ = self._equalities(every, contact.slack + self._per_heat @ flows)
        pressed = np.maximum(closed, 0.1 * np.abs(closed).max(initial=0.0))
        found.append(self._from(contact, pressed, flows))
        if not any(one.converged for one in found):
            found.append(by_conducting_gaps(contact, forces, nothing))
        return found

    def _from(
        self, contact: CoupledContact, forces: np.ndarray, flows: np.ndarray
    ) -> CoupledSolution:
        """Solution from forces and flows: with forces eliminated, or coupled where that fails."""
        found = solved_by_sets(contact, self._responses, forces > 0, flows)
        return solved(contact, forces, flows) if found is None else found

    def _without_heat(self, slack: np.ndarray) -> np.ndarray:
        """Forces of contact alone, at the temperatures without heat flows, (m,)."""
        forces = active_set(self._equalities, slack, slack < 0).forces
        return np.maximum(np.nan_to_num(forces), 0.0)

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

    def _answer(
        self, point: np.ndarray, contact: CoupledContact, found: CoupledSolution, several: bool
    ) -> HeatAnswer:
        jump = contact.jump - contact.compliance @ found.heat + contact.levels @ found.levels
        self._check_sign(point, contact, found)
        for array in (found.heat, found.levels, jump):
            array.flags.writeable = False
        return HeatAnswer(point, jump, several, found, self)

    def _check_sign(
        self, point: np.ndarray, contact: CoupledContact, found: CoupledSolution
    ) -> None:
        """Refuse an answer in which a conductance is negative, or no number."""
        if not found.converged:
            return
        pressed = found.forces / contact.areas
        opened = np.maximum(found.slack, 0.0)
        conducted = contact.conductance(pressed, opened)[0]
        wrong = np.flatnonzero(~(conducted >= 0))
        if wrong.size:
            row = wrong[0]
            raise SceneError(
                f"the conductance of contact {self.pairs[row]} is {conducted[row]:g} at p = "
                f"{pressed[row]:g}, g = {opened[row]:g}, at {self.parameters.described(point)}: it "
                "must be a number that is not negative"
            )


def _derivative(formula: Formula, values: dict[str, Any], name: str) -> np.ndarray:
    """Derivative of a formula along one of its names, exact to round-off."""
    changed = formula(values | {name: values[name] + 1j * IMAGINARY_STEP})
    return np.imag(np.asarray(changed)) / IMAGINARY_STEP


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
