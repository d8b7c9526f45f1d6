"""What every model hands out: one kind of answer, one kind of history, whatever the model."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol

import numpy as np

from hhr_dolfinx.compat import drawn
from hhr_dolfinx.contact.active_set import Status, Statuses
from hhr_dolfinx.errors import ConvergenceError, HHRError, NotOfferedError, NotSolvableError
from hhr_dolfinx.models.shown import Shown, counted, line, point_of, table
from hhr_dolfinx.trained import USUAL, Signs

if TYPE_CHECKING:
    from hhr_dolfinx.contact.friction import SlipState
    from hhr_dolfinx.materials.update import State
    from hhr_dolfinx.models.estimates import Estimate, Estimates
    from hhr_dolfinx.models.functionals.functional import Outputs
    from hhr_dolfinx.models.gradient import Gradient

Path = list[tuple[float, np.ndarray]]
"""Times in seconds and parameters, (P,), the first ones at rest."""


class Fields(Protocol):
    """What turns the unknown of a model into fields on the whole mesh."""

    @property
    def full(self) -> Any:
        """The full model, which has the mesh; None if that is not at hand."""

    def displacement(self, answer: Answer) -> np.ndarray:
        """Displacement, lift included, (N,)."""

    def forces(self, answer: Answer) -> np.ndarray:
        """Contact forces on the whole contact surface, (N_lambda,)."""

    def stress(self, answer: Answer) -> np.ndarray:
        """Stress in Kelvin's notation, (places, components)."""

    def plastic_strain(self, answer: Answer) -> np.ndarray:
        """Cumulated plastic strain, (Gauss points,)."""

    def estimate(self, answer: Answer) -> Estimate | None:
        """What is known of the error, None where nothing is."""

    def estimates(self, many: Any) -> Estimates | None:
        """The same of many answers; None where it is made one by one."""


class ModelFields:
    """What fields of models may know besides; what a kind does not know is None.

    Attributes:
        bound: bounds the error of an answer.
        output_bound: estimates the errors of outputs, beside it.
        indicator: estimates the error of an answer, of the recipe.
        flow: completes stress and plastic strain where bodies flow.
        frictional: completes forces and slip of hyper-reduced contact with friction.
        functionals: outputs of the scene.
        unbounded: why nothing is known of errors, where nothing is.
        full: the full model, which has the mesh; None of a copy or from a file, since a mesh belongs to one process.
        exact: whether there is no reduction error at all.
    """

    bound: Any = None
    output_bound: Any = None
    indicator: Any = None
    flow: Any = None
    frictional: Any = None
    functionals: Any = None
    unbounded: str = ""
    full: Any = None
    exact: ClassVar[bool] = False

    @property
    def estimated(self) -> str:
        """Kind of the estimates, see :class:`~hhr_dolfinx.models.estimates.Estimate`; empty where there are none."""
        from hhr_dolfinx.models.estimates import FORCES, STRESS

        if self.bound is not None:
            return self.bound.kind
        known = {"indicator": self.indicator, STRESS: self.flow, FORCES: self.frictional}
        return next((kind for kind, own in known.items() if own is not None), "")

    def estimates(self, many: Any) -> Estimates | None:
        """What is known of the errors of :class:`~models.many.ManyAnswers`; None where that is made one by one."""
        return None


class ElasticFields(ModelFields):
    """What all fields of models have in common in which nothing flows and whose conditions are all there."""

    def forces(self, answer: Answer) -> np.ndarray:
        """The multipliers, (N_lambda,), for the caller to change as he likes."""
        return answer.multipliers.copy()

    def plastic_strain(self, answer: Answer) -> np.ndarray:
        """None."""
        return np.zeros(0)

    def estimate(self, answer: Answer) -> Estimate | None:
        """None is known."""
        return None


class GaussState(NamedTuple):
    """Stress and memory of the material at the Gauss points where a model evaluates its laws.

    Attributes:
        stress: Kelvin's notation, (Gauss points, components).
        state: plastic strain and cumulated plastic strain.
    """

    stress: np.ndarray
    state: State


class Answer(NamedTuple):
    """Answer of any model for one parameter; fields on the whole mesh are made when they are asked for.

    Attributes:
        parameter: mu, (P,).
        unknown: the model's own unknown: U0 (N,) of a full model, gamma (ell,) of a reduced one; NaN without an answer.
        multipliers: forces on the model's own contact conditions, those of the RID of a reduced model; NaN likewise.
        active: status of each of these conditions.
        iterations: equality problems solved, or iterations of a step with all its attempts.
        status: why the search stopped.
        cycled: the plain rule of Alg. 1.1 cycled, or met a singular set, and the terminating rule took over.
        fields: what completes the answer.
        time: in seconds; NaN of an answer that belongs to no history.
        gauss: stress and state where the model evaluates its laws; None where nothing flows.
        gradient: derivatives of the unknown and the multipliers along the parameters, if they were asked for.
        time_error: estimated error of the time steps up to here, relative to the largest stress, see
            :mod:`models.histories.time_error`; 0 where no law has rates, NaN of an answer that belongs to no history.
        ends: times between the parts in which the step was solved, if there were several.
        slip: what friction remembers; None without friction.
        undetermined: orthonormal rigid motions, as changes of the unknown, (n, d), that neither loads nor contact
            determine; the answer is the one of least motion. None if there are none.
    """

    parameter: np.ndarray
    unknown: np.ndarray
    multipliers: np.ndarray
    active: np.ndarray
    iterations: int
    status: Status
    cycled: bool
    fields: Fields
    time: float = math.nan
    gauss: GaussState | None = None
    gradient: Gradient | None = None
    time_error: float = math.nan
    ends: tuple[float, ...] = ()
    slip: SlipState | None = None
    undetermined: np.ndarray | None = None

    def facts(self) -> dict[str, str]:
        """See :class:`~hhr_dolfinx.models.shown.Shown`."""
        found = {"parameter": f"at {point_of(self.parameter)}"}
        if not math.isnan(self.time):
            found["time"] = f"t = {self.time:.6g} s"
        found["status"] = f"{self.status.name.lower().replace('_', ' ')} after {counted(self.iterations, 'iteration')}"
        touching = int(np.count_nonzero(self.active))
        found["contact"] = f"{touching} of {counted(len(self.active), 'contact condition')} active"
        return found

    def __repr__(self) -> str:
        return line("Answer", self.facts())

    def _repr_html_(self) -> str:
        return table("Answer", self.facts())

    @property
    def parts(self) -> int:
        """In how many parts the step was solved."""
        return len(self.ends) + 1

    @property
    def converged(self) -> bool:
        """Whether this is a solution."""
        return self.status is Status.CONVERGED

    def displacement(self) -> np.ndarray:
        """Displacement on the whole mesh, lift included, (N,)."""
        return self.fields.displacement(self)

    def forces(self) -> np.ndarray:
        """Nodal contact forces on the whole contact surface, (N_lambda,)."""
        return self.fields.forces(self)

    def pressure(self, full: Any = None) -> np.ndarray:
        """Contact pressure at each condition of the whole surface: nodal forces over tributary areas, (N_lambda,).

        Tangential conditions of friction have tractions. Conditions without an area are NaN.

        Args:
            full: the full model, whose mesh has the areas; an answer of the process that made its model knows it.

        Raises:
            NotOfferedError: by a copy, or a model from a file, without ``full``.
        """
        areas = self._meshed(full, "pressures need the areas of the contact conditions").areas(self.parameter)
        return np.divide(self.forces(), areas, out=np.full(len(areas), np.nan), where=areas > 0)

    def plot(self, path: Any = None, full: Any = None) -> Any:
        """Picture of the contact pressure and of the deformed bodies, as a figure of matplotlib.

        Args:
            path: where to save it besides; None for nowhere.
            full: see :meth:`pressure`.

        Raises:
            NotOfferedError: by a copy, or a model from a file, without ``full``.
            MissingPackageError: without matplotlib.
        """
        return drawn(self, path, self._meshed(full, "a picture needs the mesh"))

    def _meshed(self, full: Any, why: str) -> Any:
        found = self.fields.full if full is None else full
        if found is None:
            raise NotOfferedError(
                f"a model that was copied or read from a file has no mesh, and {why}: give the full model, "
                "full=hhr.FullOrderModel(scene)"
            )
        return found

    def stress(self) -> np.ndarray:
        """Stress on the whole mesh in Kelvin's notation: at Gauss points where bodies flow, else in cell middles."""
        return self.fields.stress(self)

    def plastic_strain(self) -> np.ndarray:
        """Cumulated plastic strain at all Gauss points of the mesh; zero where nothing flows."""
        return self.fields.plastic_strain(self)

    def state(self) -> GaussState:
        """Stress and state where the model evaluates its laws.

        Raises:
            HHRError: of a model in which nothing flows.
        """
        if self.gauss is None:
            raise HHRError("nothing flows in this model, so that its answers have no state: give a body a law")
        return self.gauss

    def estimate(self) -> Estimate | None:
        """What is known of the error of this answer: a bound, or what an indicator says; None where nothing is.

        Outputs that an undetermined motion changes have no bound.
        """
        found = self.fields.estimate(self)
        if found is None or self.undetermined is None:
            return found
        from hhr_dolfinx.models.undetermined import moved_outputs

        moved = moved_outputs(self)
        return found._replace(outputs={name: error for name, error in found.outputs.items() if name not in moved})

    def outputs(self) -> Outputs:
        """Outputs of the scene by name, with derivatives if the answer has a gradient.

        Raises:
            HHRError: if the scene has none.
        """
        from hhr_dolfinx.models.functionals.functional import outputs_of

        return outputs_of(self)


@dataclass(repr=False)
class History(Shown):
    """A solved history; what converged before a failure is kept in the error's ``history``.

    Attributes:
        start: time at rest, in seconds.
        parameter: the parameter there, (P,).
        answers: one per step asked for, the start not among them.
        signs: of each step, by which a reduced model tells that it left what it was trained on.
        cuts: steps that were solved in parts.
        time_tolerance: by which steps were cut, if that was asked for.
    """

    start: float
    parameter: np.ndarray
    answers: list[Answer] = field(default_factory=list)
    signs: list[Signs] = field(default_factory=list)
    cuts: int = 0
    time_tolerance: float | None = None

    def facts(self) -> dict[str, str]:
        """See :class:`~hhr_dolfinx.models.shown.Shown`."""
        end = self.answers[-1].time if self.answers else self.start
        return {
            "steps": counted(len(self.answers), "step"),
            "time": f"t = {self.start:.6g} to {end:.6g} s",
            "iterations": counted(sum(self.iterations), "iteration"),
        }

    @property
    def time_error(self) -> np.ndarray:
        """Estimated error of the time steps up to the end of each, relative to the largest stress, (steps,).

        The largest one counts; what a body still knows of it later may be underestimated.
        """
        return np.array([answer.time_error for answer in self.answers])

    @property
    def parts(self) -> list[int]:
        """In how many parts each step was solved."""
        return [answer.parts for answer in self.answers]

    @property
    def path(self) -> Path:
        """Times and parameters, the start first: what was asked for."""
        return [(self.start, self.parameter), *((answer.time, answer.parameter) for answer in self.answers)]

    @property
    def solved_path(self) -> Path:
        """The path with all parts of its steps: another model that marches along it has the same time errors."""
        found = self.path[:1]
        for answer in self.answers:
            time, point = found[-1]
            shares = [(end - time) / (answer.time - time) for end in answer.ends]
            between = [point + share * (answer.parameter - point) for share in shares]
            found += [*zip(answer.ends, between, strict=True), (answer.time, answer.parameter)]
        return found

    def thinned(self, times: Sequence[float]) -> History:
        """The same history with the answers at some of its times alone."""
        kept = set(times)
        places = [place for place, answer in enumerate(self.answers) if answer.time in kept]
        answers = [self.answers[place] for place in places]
        return replace(self, answers=answers, signs=[self.signs[place] for place in places if self.signs])

    @property
    def iterations(self) -> list[int]:
        """Iterations of each step, those of its parts summed; a failed attempt counts as the most allowed."""
        return [answer.iterations for answer in self.answers]


class SeveralAnswers(Shown):
    """Answers to several parameters, in their order; ``answers[k]`` is one of them, like any :class:`Answer`.

    Attributes:
        points: parameters, (n, P).
        status: why each search stopped.
        iterations: equality problems solved for each, or iterations of a step, (n,).
    """

    points: np.ndarray
    status: list[Status]
    iterations: np.ndarray

    def facts(self) -> dict[str, str]:
        """See :class:`~hhr_dolfinx.models.shown.Shown`."""
        return {
            "answers": counted(len(self), "answer"),
            "converged": f"{int(self.converged.sum())} converged",
            "parameters": counted(self.points.shape[1], "parameter") if len(self) else "no point",
        }

    def __len__(self) -> int:
        return len(self.points)

    def __getitem__(self, k: int) -> Answer:
        """One of them; several by :meth:`take`."""
        raise NotImplementedError

    def __iter__(self) -> Iterator[Answer]:
        return (self[k] for k in range(len(self)))

    @property
    def converged(self) -> np.ndarray:
        """Which of them are solutions, (n,) bool."""
        return np.array([status is Status.CONVERGED for status in self.status], dtype=bool)

    def take(self, rows: np.ndarray) -> SeveralAnswers:
        """Those of some rows, by numbers or a mask."""
        return ListedAnswers(tuple(self[k] for k in np.arange(len(self))[rows].tolist()))

    def forces(self) -> np.ndarray:
        """Contact forces on the whole surface, (n, N_lambda); NaN without an answer."""
        return np.array([answer.forces() for answer in self])

    def estimates(self) -> Estimates | None:
        """What is known of the errors, as :meth:`Answer.estimate`; None where nothing is."""
        from hhr_dolfinx.models.estimates import Estimates

        return Estimates.of([answer.estimate() for answer in self])

    def outputs(self) -> dict[str, np.ndarray]:
        """Outputs of the scene by name, (n,) each; NaN without an answer.

        Raises:
            HHRError: if the scene has none.
        """
        found = [answer.outputs() for answer in self]
        return {name: np.array([outputs[name] for outputs in found]) for name in found[0].keys()}


@dataclass(frozen=True, repr=False)
class ListedAnswers(SeveralAnswers):
    """Answers found one by one, each with all that it has: a state where bodies flow, fields of a model of its own.

    Attributes:
        answers: one or more.
    """

    answers: tuple[Answer, ...]

    def __getitem__(self, k: int) -> Answer:
        """The answer to a point."""
        return self.answers[k]

    @property
    def points(self) -> np.ndarray:  # type: ignore[override]
        """Parameters, (n, P)."""
        return np.array([answer.parameter for answer in self.answers])

    @property
    def status(self) -> list[Status]:  # type: ignore[override]
        """Why each search stopped."""
        return [answer.status for answer in self.answers]

    @property
    def iterations(self) -> np.ndarray:  # type: ignore[override]
        """Iterations of each, (n,)."""
        return np.array([answer.iterations for answer in self.answers])


class Model(Protocol):
    """What a study, a check or a user asks of any model: full, reduced, condensed, or a rival."""

    def solve(
        self,
        mu: Any,
        *,
        start: Any = "nearest",
        raise_on_failure: bool = True,
        outside: str = USUAL,
        gradient: bool = False,
    ) -> Answer:
        """Answer one parameter.

        Args:
            mu: number, sequence or mapping by name.
            start: statuses to start from, one bool for each condition of the model; ``nearest`` for those of the
                nearest known parameter, None for those of the free slack.
            raise_on_failure: raise instead of returning an answer with NaN and a status.
            outside: what happens to a parameter of the box that lies outside what was trained: ``warn``, ``refuse`` or
                ``ignore``; ``usual`` warns, but where a model falls back on the full one, which nothing is outside of.
            gradient: whether derivatives along the parameters are wanted, see :class:`~models.gradient.Gradient`.

        Raises:
            ParameterError: if ``mu`` is not finite or outside the box, or ``start`` is invalid.
            OutsideTrainingError: if it is outside what was trained, and that is to be refused.
            ConvergenceError: if the statuses do not settle.
            NotSolvableError: if contact rows are dependent.

        Warns:
            OutsideTrainingWarning: if it is outside what was trained, unless told otherwise.
        """

    def march(self, path: Any, settings: Any = ...) -> History:
        """Answer a history from rest.

        Args:
            path: times in seconds and parameters, the first ones at rest; parameters are linear between them.
            settings: a :class:`~hhr_dolfinx.models.histories.equilibrium.MarchSettings`.

        Raises:
            ParameterError: if the path is invalid, or leaves the box.
            ConvergenceError, OutsideTrainingError: with an attribute ``history`` that holds the steps before.
        """


def one_by_one(model: Any, table: Any, how: dict[str, Any]) -> ListedAnswers:
    """Answers of a model that has no faster way."""
    return ListedAnswers(tuple(model.solve(point, **how) for point in model.parameters.points(table)))


def outcome(answer: Answer, raise_on_failure: bool, advice: Mapping[Status, str] = MappingProxyType({})) -> Answer:
    """An answer, or one that is emptied, so that nobody mistakes an iterate for a solution."""
    if answer.status is Status.CONVERGED:
        return answer
    if raise_on_failure:
        unsolvable = answer.status in (Status.SINGULAR, Status.NOT_FINITE, Status.ADRIFT)
        kind = NotSolvableError if unsolvable else ConvergenceError
        why = ": ".join([answer.status.value, *([advice[answer.status]] if answer.status in advice else [])])
        place = np.ravel(answer.parameter).tolist()
        raise kind(f"no solution at {place} after {answer.iterations} iterations: {why}")
    nothing = np.full_like(answer.unknown, np.nan), np.full_like(answer.multipliers, np.nan)
    return answer._replace(unknown=nothing[0], multipliers=nothing[1])


def unanswered(
    parameter: np.ndarray, sizes: tuple[int, int], fields: Fields, status: Status = Status.UNDEFINED
) -> Answer:
    """An answer of NaN, for a model with so many unknowns and conditions of its own."""
    unknowns, conditions = sizes
    nothing = np.full(unknowns, np.nan), np.full(conditions, np.nan), np.zeros(conditions, dtype=bool)
    return Answer(parameter, *nothing, 0, status, False, fields)


def found_as(found: Statuses, parameter: np.ndarray, unknown: np.ndarray, fields: Fields) -> Answer:
    """What the active set found, with the unknown that belongs to its forces."""
    return Answer(parameter, unknown, found.forces, found.active, found.iterations, found.status, found.cycled, fields)
