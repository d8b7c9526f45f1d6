"""Contact and answers of steady and of transient models with heat through contacts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from typing import TYPE_CHECKING, Any, ClassVar, cast

import numpy as np

from hhr_dolfinx.contact.active_set import Status, active_set
from hhr_dolfinx.errors import HHRError, SceneError
from hhr_dolfinx.formulas import IMAGINARY_STEP, Formula
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.eliminations.elimination import differentiated
from hhr_dolfinx.models.functionals.functional import Outputs
from hhr_dolfinx.plugins.contact_heat.heat import GAP_NAME, PRESSURE_NAME
from hhr_dolfinx.plugins.contact_heat.newton import CoupledChanges, CoupledContact, CoupledSolution
from hhr_dolfinx.plugins.contact_heat.parts import HeatParts
from hhr_dolfinx.plugins.contact_heat.sliding import FrictionSources, PerHeat

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hhr_dolfinx.models.eliminations.constant import ConstantElimination


class HeatedModel:
    """Condensed contact under heat flows of the contacts and levels, and their conductances.

    Args:
        parts: its data.

    Attributes:
        parameters: the box of the parameters.
        mechanical: condensed model of the scene whose further parameters are heat flows, heat of
            conditions that slide, and levels.
        conduction: temperatures per heat flow and supply.
        conductances: formulas by contact; their last two names are the pressure and the gap.
        pairs: contact of each condition, (m,).
    """

    instead: ClassVar[str] = "take hhr.save_heat_model(path, model)"

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
        count = len(self.parameters.names)
        m = len(self._schur)
        flows = conduction.per_heat.shape[1]
        of_slack = self._free_slack[:, : len(self._amplitudes.slopes)] @ self._amplitudes.slopes
        per_parameter, per_flow, per_friction, per_level = np.split(
            of_slack, [count, count + m, count + flows], axis=1
        )
        self._per_heat = np.hstack([per_flow, per_level])
        self._per_parameter = per_parameter
        fallen = conduction.jumps[:m] @ conduction.per_heat
        levels = conduction.jumps @ conduction.levels
        self._jumps = conduction.jumps[:m] @ conduction.temperatures
        self._compliance = fallen[:, :m]
        self._levels = levels[:m]
        self._sliding = FrictionSources(parts.sliding, self.pairs)
        self._per_sliding = PerHeat(per_friction, -fallen[:, m:], -levels[m:].T)

    @property
    def conditions(self) -> int:
        """Number of contact conditions."""
        return len(self._schur)

    @property
    def sliding(self) -> list[int]:
        """Numbers of the contacts whose surfaces slide."""
        return self.parts.sliding.contacts.tolist()

    @property
    def sliding_conditions(self) -> np.ndarray:
        """Numbers of their conditions, (g,)."""
        return self._sliding.conditions

    @property
    def flow_outputs(self) -> list[str]:
        """Names of the outputs of heat, after those of the scene."""
        through = [f"heat {k}" for k in self.conductances]
        return through + [f"friction heat {k}" for k in self.sliding]

    @property
    def coupling(self) -> dict[str, np.ndarray]:
        """Matrices of contact and heat by name, for other languages (m conditions, b bodies)."""
        return {
            "areas": self._areas,
            "compliances": np.diag(self._schur),
            "per_heat": self._per_heat,
            "compliance": self._compliance,
            "levels": self._levels,
            "jumps": self._jumps,
            "supplied": self.conduction.supplied,
            "slack_by_friction": self._per_sliding.slack,
            "jump_by_friction": self._per_sliding.jump,
            "supplied_by_friction": self._per_sliding.supplied,
        }

    def header_in_c(self, name: str) -> tuple[str, dict[str, Any]]:
        """Text of a C header, and its names and ends, see
        :func:`hhr_dolfinx.plugins.exporters.c_header.c_header`.

        Args:
            name: identifier in C that the names of the header begin with.
        """
        from hhr_dolfinx.plugins.contact_heat.c_code import HeatData, heat_header

        data = HeatData(self.parts, self.pairs, self.flow_outputs, self.coupling)
        return heat_header(data, name)

    @property
    def contacts(self) -> set[int]:
        """Numbers of the contacts that have conditions, or a conductance."""
        return set(self.pairs.tolist()) | set(self.conductances)

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
        heat = self._per_heat.shape[1] + self._sliding.conditions.size
        return np.concatenate([point, np.zeros(heat)])

    def _slack_without_flows(self, point: np.ndarray) -> np.ndarray:
        """Slack without forces, heat flows and levels, (m,): amplitudes of a thousand of them are
        zero, and none of these is not affine.
        """
        amplitudes = self._amplitudes
        slack: np.ndarray = self._still + self._per_parameter @ point
        whole = self._without_flows(point)
        for first, amplitude in zip(amplitudes.firsts, amplitudes.nonaffine, strict=False):
            columns, weights = amplitude(whole)
            slack += self._free_slack[:, first + np.array(columns, dtype=int)] @ np.array(weights)
        return slack

    @cached_property
    def _still(self) -> np.ndarray:
        """Slack of affine amplitudes at the parameter zero, (m,)."""
        constant = self._amplitudes.constant
        still: np.ndarray = self._free_slack[:, : constant.size] @ constant
        return still

    def _coupled(self, point: np.ndarray) -> CoupledContact:
        return self._sliding.added(self._still_contact(point), self._per_sliding, point)

    def _still_contact(self, point: np.ndarray) -> CoupledContact:
        """The problem without the heat of surfaces that slide."""
        supplies = self.conduction.supplies(point)
        return CoupledContact(
            slack=self._slack_without_flows(point),
            schur=self._schur,
            compliances=np.diag(self._schur),
            per_heat=self._per_heat,
            jump=self._jumps @ supplies,
            compliance=self._compliance,
            levels=self._levels,
            supplied=self.conduction.supplied @ supplies,
            areas=self._areas,
            conductance=lambda pressures, gaps: self._conducted(point, pressures, gaps),
        )

    def _gradient(self, answer: HeatAnswer, changes: np.ndarray) -> dict[str, np.ndarray]:
        """Derivatives of all outputs along the parameters of the user, (P,) each, by those of heat
        flows, heat of conditions that slide and levels, (m + g + b, P).
        """
        count = len(self.parameters.names)
        gradient = {
            f"heat {contact}": changes[: self.conditions][self.pairs == contact].sum(axis=0)
            for contact in self.conductances
        }
        made = np.zeros((self.conditions, count))
        made[self._sliding.conditions] = changes[self.conditions :][: self._sliding.conditions.size]
        gradient |= {
            f"friction heat {contact}": made[self.pairs == contact].sum(axis=0)
            for contact in self.sliding
        }
        if self.mechanical.fields.functionals is None:
            return gradient
        contact = self.mechanical.eliminated(answer.heated)
        along = differentiated(contact, answer.mechanical).outputs().gradient
        assert along is not None
        of_scene = {name: of[:count] + of[count:] @ changes for name, of in along.items()}
        return {**of_scene, **gradient}

    def _along(self, answer: HeatAnswer, per_sliding: PerHeat) -> CoupledChanges:
        """Derivatives of the problem of an answer along the parameters of the user, at constant
        forces, heat flows and levels.
        """
        point = answer.parameter
        acting, slopes = self._amplitudes.slopes_at(self._without_flows(point))
        supplies = self._supply_slopes(point)
        made = self._made_along(answer)
        slack = self._free_slack[:, acting] @ slopes[:, : len(self.parameters.names)]
        return CoupledChanges(
            slack=slack + per_sliding.slack @ made,
            jump=self._jumps @ supplies + per_sliding.jump @ made,
            supplied=self.conduction.supplied @ supplies + self._per_sliding.supplied @ made,
            conductance=self._conducted_changes(point, answer.forces() / self._areas, answer.gaps),
        )

    def _made_along(self, answer: HeatAnswer) -> np.ndarray:
        """Derivatives of the heat of conditions that slide, at constant forces, (g, P)."""
        forces = answer.solution.forces[self._sliding.conditions]
        found: np.ndarray = forces[:, None] * self._sliding.derivatives(answer.parameter)
        return found

    def _made_changes(self, answer: HeatAnswer, forces: np.ndarray) -> np.ndarray:
        """Derivatives of this heat, (g, P), by those of forces, (m, P)."""
        factors = self._sliding.factors(answer.parameter)
        return self._made_along(answer) + factors[:, None] * forces[self._sliding.conditions]

    def _supply_slopes(self, point: np.ndarray) -> np.ndarray:
        """Derivatives of supplies and fixed temperatures along the parameters, (t, P)."""
        found = np.array([one.derivative(point) for one in self.conduction.amplitudes])
        return found.reshape(-1, len(self.parameters.names))

    def _conducted_changes(
        self, point: np.ndarray, pressures: np.ndarray, gaps: np.ndarray
    ) -> np.ndarray:
        """Derivatives of the conductances along the parameters, (m, P)."""
        changes = np.zeros((pressures.size, point.size))
        for rows, formula, values in self._formulas(point, pressures, gaps):
            for place, name in enumerate(self.parameters.names):
                if name in formula.variables:
                    changes[rows, place] = derivative(formula, values, name)
        return changes

    def _conducted(
        self, point: np.ndarray, pressures: np.ndarray, gaps: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Conductances of all conditions and their derivatives along pressure and gap."""
        found = np.zeros((3, pressures.size))
        for rows, formula, values in self._formulas(point, pressures, gaps):
            found[0, rows] = np.real(np.asarray(formula(values)))
            for place, name in enumerate((PRESSURE_NAME, GAP_NAME), start=1):
                if name in formula.variables:
                    found[place, rows] = derivative(formula, values, name)
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

    def _without_heat(self, slack: np.ndarray) -> np.ndarray:
        """Forces of contact alone, at the temperatures without heat flows, (m,)."""
        forces = active_set(self._equalities, slack, slack < 0).forces
        return np.maximum(np.nan_to_num(forces), 0.0)

    def _answer(
        self, point: np.ndarray, contact: CoupledContact, found: CoupledSolution, several: bool
    ) -> HeatAnswer:
        jump = contact.jump_at(found.forces, np.concatenate([found.heat, found.levels]))
        self._check_sign(point, contact, found)
        made = np.zeros(self.conditions)
        rows = self._sliding.conditions
        made[rows] = self._sliding.factors(point) * found.forces[rows]
        for array in (found.heat, found.levels, jump, made):
            array.flags.writeable = False
        return HeatAnswer(point, jump, made, several, found, self)

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


@dataclass(frozen=True, eq=False)
class HeatAnswer:
    """Answer with heat through contacts.

    Attributes:
        parameter: the parameter, (P,).
        jump: temperature of the first surface less that of the second, (m,).
        friction_heat: power of the friction of each condition whose surfaces slide, (m,).
        several: True if another start has another answer.
        solution: forces, slacks, heat flows and levels.
    """

    parameter: np.ndarray
    jump: np.ndarray
    friction_heat: np.ndarray
    several: bool
    solution: CoupledSolution
    _model: HeatedModel

    @cached_property
    def mechanical(self) -> Answer:
        """Answer of the contact problem under these temperatures, with all that such answers have:
        displacement, pressure, picture.
        """
        return self._model.mechanical_answer(self)

    @property
    def status(self) -> Status:
        """Why the search stopped."""
        return Status.CONVERGED if self.converged else Status.ITERATION_LIMIT

    @property
    def iterations(self) -> int:
        """Steps of Newton's method."""
        return self.solution.steps

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
        """The parameter followed by heat flows, heat of conditions that slide and levels: a point
        of ``model.mechanical``, (P + m + g + b,).
        """
        return np.concatenate([self.parameter, self.flows, self.levels])

    @property
    def flows(self) -> np.ndarray:
        """Heat flows, and heat of conditions that slide, (m + g,)."""
        return np.concatenate([self.heat, self.friction_heat[self._model.sliding_conditions]])

    def forces(self) -> np.ndarray:
        """Contact forces, (m,), see :meth:`hhr_dolfinx.models.answer.Answer.forces`."""
        return self.solution.forces.copy()

    @property
    def levels(self) -> np.ndarray:
        """Temperatures of bodies that contact alone feeds, above those of their supplies, (b,); of
        a transient model amplitudes of modes.
        """
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
        """Outputs of the scene by name, ``heat 0``, ``heat 1``, the flow of each contact, and
        ``friction heat 0``, that of each which slides.
        """
        flows = {f"heat {k}": self.heat_through(k) for k in self._model.conductances}
        for k in self._model.sliding:
            made = self.friction_heat[self._model.pairs == k]
            flows[f"friction heat {k}"] = float(made.sum())
        units = dict.fromkeys(flows, "")
        if self._model.mechanical.fields.functionals is None:
            return Outputs(flows, units)
        of_scene = self.mechanical.outputs()
        return Outputs(of_scene.values | flows, of_scene.units | units)


def continued(answers: Sequence[HeatAnswer], *, levels: bool = True) -> np.ndarray:
    """Heat flows and levels to start from after one or two answers: those of the last, continued
    along a line where contacts stay as they are, (m + b,).

    Args:
        answers: one answer, or two, the last of which is a balance.
        levels: False for heat flows alone, (m,).
    """
    first = answers[0].solution
    last = answers[-1].solution
    flows = [
        np.concatenate([one.heat, one.levels]) if levels else one.heat for one in (first, last)
    ]
    if first.converged and np.array_equal(first.forces > 0, last.forces > 0):
        return 2 * flows[1] - flows[0]
    return flows[1]


def derivative(formula: Formula, values: dict[str, Any], name: str) -> np.ndarray:
    """Derivative of a formula along one of its names, exact to round-off.

    Args:
        formula: the formula.
        values: numbers and arrays, (k,), by name.
        name: the name.
    """
    changed = formula(values | {name: values[name] + 1j * IMAGINARY_STEP})
    return np.imag(np.asarray(changed)) / IMAGINARY_STEP
