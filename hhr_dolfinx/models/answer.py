"""Answers and histories, which have one form for every kind of model."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from os import PathLike
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.contact.active_set import Status, Statuses
from hhr_dolfinx.contact.kernel import kernels
from hhr_dolfinx.errors import ConvergenceError, NotOfferedError, NotSolvableError
from hhr_dolfinx.memory import NO_MEMORY, Memory
from hhr_dolfinx.models.shown import Shown, counted, line, point_of, table
from hhr_dolfinx.trained import USUAL

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hhr_dolfinx.contact.law import ContactLaw
    from hhr_dolfinx.contact.problem import ContactProblem
    from hhr_dolfinx.models.answer_mesh import AnswerMesh
    from hhr_dolfinx.models.estimates import Estimate, Estimates
    from hhr_dolfinx.models.functionals.functional import AllOutputs, Outputs
    from hhr_dolfinx.models.gradient import Gradient
    from hhr_dolfinx.parameters import ParameterSpace, PointLike, PointsLike

Path = list[tuple[float, np.ndarray]]
"""Times in seconds and parameters, (P,), the first ones at rest."""


Start = str | np.ndarray | Sequence[bool] | None
"""Start of a search: ``nearest``, one bool for each condition of the model, or None for the signs
of the free slack.
"""
CheckedStart = str | np.ndarray | None
"""Start with statuses as an array of bool, one for each condition."""


class Meshed(Protocol):
    """Full model as answers use it, or the mesh that lies beside a model file.

    Pressures and pictures need it.
    """

    @property
    def parameters(self) -> ParameterSpace:
        """Box of the parameters."""

    def areas(self, mu: PointLike) -> np.ndarray:
        """Tributary areas of the contact conditions at a parameter, (N_lambda,)."""

    def answer_mesh(self) -> AnswerMesh:
        """Mesh and contact surface for figures and files.

        Collective over the ranks of a full model.
        """


class Completion(Protocol):
    """Completes the fields of bodies with laws on the whole mesh.

    A model evaluates the laws at some places only.
    """

    kind: ClassVar[str]  #: kind of its estimates, see Estimate
    known_error: ClassVar[str]  #: the same in one line

    @property
    def places(self) -> int:
        """Number of places of the full model."""

    def stress_of(self, answer: Answer) -> np.ndarray:
        """Stress at these places in Kelvin's notation, (places, components)."""

    def estimate(self, answer: Answer) -> Estimate | None:
        """Estimate of the error of an answer; None without one."""


class InterfaceCompletion(Protocol):
    """Completes contact forces on the whole surface from those of a RID, for contacts with laws."""

    @property
    def within(self) -> np.ndarray:
        """Conditions of the RID, (m,)."""

    @property
    def whole(self) -> ContactLaw:
        """Law of the whole contact surface."""

    @property
    def inside(self) -> ContactLaw:
        """Law of the RID, with the row numbers of the RID."""

    def forces(self, inside: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Forces on all conditions from those of the RID, (N_lambda,).

        Args:
            inside: forces on the conditions of the RID, (m,).
            point: parameter, (P,).
        """

    def completed(
        self, inside: np.ndarray, active: np.ndarray, point: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Forces, (N_lambda,), and statuses, (N_lambda,) bool, of all conditions.

        Args:
            inside: forces on the conditions of the RID, (m,).
            active: statuses of these, (m,) bool.
            point: parameter, (P,).
        """

    def force_changes(
        self, inside: np.ndarray, changes: np.ndarray, point: np.ndarray
    ) -> np.ndarray:
        """Derivatives of :meth:`forces`, (N_lambda, P).

        Args:
            inside: forces on the conditions of the RID, (m,).
            changes: derivatives of these, (m, P).
            point: parameter, (P,).
        """

    def indicated(
        self, inside: np.ndarray, slack: np.ndarray, scale: np.ndarray, memory: Memory
    ) -> float:
        """Estimated relative error of forces.

        Args:
            inside: forces on the conditions of the RID, (m,).
            slack: slack of all conditions, (N_lambda,).
            scale: length by which the gap of each condition is measured, (N_lambda,).
            memory: memory of the answer.
        """

    def differences(self, problem: ContactProblem) -> str:
        """Difference of the problem of a full model to the one of the training, in words.

        Empty if there is none.
        """


class ModelFields:
    """Completes answers: fields on the whole mesh from the unknown of a model.

    Parts that a model lacks are None.
    """

    bound: Any = None  #: bounds the error of an answer
    output_bound: Any = None  #: estimates the errors of outputs
    indicator: Callable[[Answer], float] | None = (
        None  #: estimates the error of an answer; the recipe chooses it
    )
    flow: Completion | None = None  #: completes the fields of bodies with laws
    #: completes forces and memory of a law of interfaces in hyper-reduced models
    interface: InterfaceCompletion | None = None
    functionals: AllOutputs | None = None  #: outputs of the scene
    unbounded: str = ""  #: reason why errors are not estimated, for models without an estimate
    exact: ClassVar[bool] = False  #: whether the model has no reduction error

    @property
    def full(self) -> Meshed | None:
        """The full model, which has the mesh, or the file of the mesh beside that of the model.

        None of a copy.
        """
        return None

    @property
    def estimated(self) -> str:
        """Kind of the estimates, see :class:`~hhr_dolfinx.models.estimates.Estimate`.

        Empty where there are none.
        """
        from hhr_dolfinx.models.estimates import FORCES_INDICATOR

        if self.bound is not None:
            return self.bound.kind
        of_laws = "" if self.flow is None else self.flow.kind
        estimators = {
            "indicator": self.indicator,
            of_laws: self.flow,
            FORCES_INDICATOR: self.interface,
        }
        return next((kind for kind, estimator in estimators.items() if estimator is not None), "")

    def displacement(self, answer: Answer) -> np.ndarray:
        """Displacement, lift included, (N,).

        Raises:
            NotImplementedError: in this base class.
        """
        raise NotImplementedError

    def forces(self, answer: Answer) -> np.ndarray:
        """Contact forces on the whole contact surface, (N_lambda,).

        Raises:
            NotImplementedError: in this base class.
        """
        raise NotImplementedError

    def stress(self, answer: Answer) -> np.ndarray:
        """Stress in Kelvin's notation, (places, components).

        Raises:
            NotImplementedError: in this base class.
        """
        raise NotImplementedError

    def estimate(self, answer: Answer) -> Estimate | None:
        """Error estimate of an answer; None if the model has none."""
        return None

    def without_columns(self) -> ModelFields:
        """Fields without arrays that displacements alone need; the same if there are none."""
        return self

    def estimates(self, many: Any) -> Estimates | None:
        """Error estimates of :class:`~models.many.ManyAnswers`.

        None if they are computed one by one.
        """
        return None


class ElasticFields(ModelFields):
    """Fields of elastic models that keep all contact conditions."""

    def forces(self, answer: Answer) -> np.ndarray:
        """The multipliers, (N_lambda,); a copy, which the caller may change."""
        return answer.multipliers.copy()


class Answer(NamedTuple):
    """Answer of any model for one parameter; fields on the whole mesh are computed on request.

    Attributes:
        parameter: mu, (P,).
        unknown: unknown of the model: U0 (N,) of a full model, gamma (ell,) of a reduced one; NaN
            without a solution.
        multipliers: forces on the conditions of the model (of the RID in a reduced model); NaN
            without a solution.
        active: status of each of these conditions.
        iterations: equality problems solved, or iterations of a step with all its attempts.
        status: why the search stopped.
        cycled: the plain rule of Alg. 1.1 cycled, or met a singular set, and the terminating rule
            took over.
        fields: what completes the answer.
        time: in seconds; NaN of an answer that belongs to no history.
        gradient: derivatives of the unknown and the multipliers along the parameters, if they were
            requested.
        time_error: estimated error of the time steps up to here: of stress or displacement,
            whichever is larger, over its largest norm so far; of contact forces in elastic
            histories with friction. NaN without an estimate, see :class:`MarchSettings`; 0 in
            elastic histories without friction.
        ends: times between the parts in which the step was solved, if there were several.
        memory: what laws carry to the next step, by names that are attributes of the answer too:
            ``answer.slip``.
        undetermined: orthonormal rigid motions, as changes of the unknown, (n, d), that neither
            loads nor contact determine; the answer has the least motion along them. None if there
            are none.
        note: path that the answer belongs to, and how far it has converged, if it depends on a path
            that was chosen.
    """

    parameter: np.ndarray
    unknown: np.ndarray
    multipliers: np.ndarray
    active: np.ndarray
    iterations: int
    status: Status
    cycled: bool
    fields: ModelFields
    time: float = math.nan
    gradient: Gradient | None = None
    time_error: float = math.nan
    ends: tuple[float, ...] = ()
    memory: Memory = NO_MEMORY
    undetermined: np.ndarray | None = None
    note: str = ""

    def __getattr__(self, name: str) -> Any:
        """Part of the memory, None if another law has one of this name.

        Or a method that a plug-in adds.
        """
        if name in self.memory:
            return self.memory[name]
        if (import_path := registry.asked_of_answers().get(name)) is not None:
            return partial(registry.loaded(import_path), self)
        if name.startswith("_") or name not in registry.memories():
            raise AttributeError(
                f"an answer has no {name!r}; it remembers {', '.join(self.memory) or 'nothing'}"
            )
        return None

    def remembering(self, **parts: Any) -> Answer:
        """Answer with further parts of its memory, by name."""
        return self._replace(memory=self.memory | parts)

    def facts(self) -> dict[str, str]:
        """See :class:`~hhr_dolfinx.models.shown.Shown`."""
        facts = {"parameter": f"at {point_of(self.parameter, names_of(self))}"}
        if not math.isnan(self.time):
            facts["time"] = f"t = {self.time:.6g} s"
        facts["status"] = (
            f"{self.status.name.lower().replace('_', ' ')} after "
            f"{counted(self.iterations, 'iteration')}"
        )
        if self.note:
            facts["path"] = f"of {self.note}"
        touching = int(np.count_nonzero(self.active))
        facts["contact"] = f"{touching} of {counted(len(self.active), 'contact condition')} active"
        return facts

    def __repr__(self) -> str:
        return line("Answer", self.facts())

    def __str__(self) -> str:
        """Line of ``repr``, and one for each output of the scene with its unit."""
        has_outputs = self.converged and self.fields.functionals is not None
        return f"{self!r}\n{self.outputs()}" if has_outputs else repr(self)

    def _repr_html_(self) -> str:
        return table("Answer", self.facts())

    @property
    def parts(self) -> int:
        """Number of parts in which the step was solved."""
        return len(self.ends) + 1

    @property
    def converged(self) -> bool:
        """True if the answer is a solution."""
        return self.status is Status.CONVERGED

    def displacement(self) -> np.ndarray:
        """Displacement on the whole mesh, lift included, (N,)."""
        return self.fields.displacement(self)

    def forces(self) -> np.ndarray:
        """Nodal contact forces on the whole contact surface, one number of each condition,
        (N_lambda,).

        Conditions of pressures have λ >= 0, and the force on the slave is -λ n with its outward
        normal n. Tangential conditions of friction follow these, and their force on the slave is -τ
        t, see ``model.law``. The unit is a force, per unit depth in the plane and of the whole turn
        in axisymmetry.
        """
        return self.fields.forces(self)

    def pressure(self, full: Meshed | None = None) -> np.ndarray:
        """Contact pressure at each condition of the whole surface, (N_lambda,).

        Nodal forces over tributary areas, with the signs of :meth:`forces`. Tangential conditions
        have shear stresses. Conditions without an area are NaN.

        Args:
            full: the full model, whose mesh has the areas; not needed in the process that built the
                model, nor by a model from a file if the commands left the mesh beside it,
                ``scenery.npz``.

        Raises:
            NotOfferedError: by a copy, or a model from a file without mesh, without ``full``; or if
                no condition has an area.
        """
        areas = self._meshed(full, "pressures need the areas of the contact conditions").areas(
            self.parameter
        )
        forces = self.forces()
        if forces.shape != areas.shape or not (areas > 0).any():
            raise NotOfferedError(
                "the forces of this answer are no forces of contact conditions with areas: it is "
                "of another scene, or of bodies that slide past their mesh. Pressures of the "
                "slave nodes are answer.slip.pressure over the areas in model.law.of('friction')"
            )
        return np.divide(forces, areas, out=np.full(len(areas), np.nan), where=areas > 0)

    def plot(
        self,
        path: str | PathLike[str] | None = None,
        full: Meshed | None = None,
        scale: float | None = None,
    ) -> Figure:
        """Picture of the deformed bodies with their stress, and of pressure on contact surfaces.

        Closed surfaces are drawn closed. ``answer.to_pyvista()`` has the data for a notebook.

        Args:
            path: file to save the figure to; None does not save it.
            full: see :meth:`pressure`.
            scale: factor of the displacements; None chooses a power of ten.

        Returns:
            A figure of matplotlib.

        Raises:
            NotOfferedError: by a copy, or a model from a file without mesh, without ``full``; or
                without a plug-in that draws.
            MissingPackageError: without matplotlib, in space without PyVista.
        """
        draw = registry.tool("drawing", "a figure of an answer")
        chosen = {} if scale is None else {"scale": scale}
        return draw(self, path, self._meshed(full, "a picture needs the mesh"), **chosen)

    def _meshed(self, full: Meshed | None, why: str) -> Meshed:
        meshed = self.fields.full if full is None else full
        if meshed is None:
            raise NotOfferedError(
                f"a model that was copied or read from a file has no mesh, and {why}: give the "
                "full model, full=hhr.FullOrderModel(scene)"
            )
        return meshed

    def stress(self) -> np.ndarray:
        """Stress on the whole mesh in Kelvin's notation, (places, components).

        At cell midpoints, or where laws of bodies are evaluated. Components are xx, yy, zz, √2 xy
        in the plane, rr, zz, θθ, √2 rz in axisymmetry, and xx, yy, zz, √2 xy, √2 xz, √2 yz in
        space.
        """
        return self.fields.stress(self)

    def estimate(self) -> Estimate | None:
        """Error estimate of this answer, by a bound or an indicator; None if the model has neither.

        Outputs that an undetermined motion changes have no bound.
        """
        estimate = self.fields.estimate(self)
        if estimate is None or self.undetermined is None:
            return estimate
        open_ = kernels().undetermined_outputs(self)
        return estimate._replace(
            outputs={name: error for name, error in estimate.outputs.items() if name not in open_}
        )

    def outputs(self) -> Outputs:
        """Outputs of the scene by name, with derivatives if the answer has a gradient.

        Raises:
            HHRError: if the scene has none.
        """
        from hhr_dolfinx.models.functionals.functional import outputs_of

        return outputs_of(self)


def names_of(answer: Answer) -> tuple[str, ...]:
    """Names of the parameters of an answer; none of a copy of a model, which has no mesh."""
    full = answer.fields.full
    return () if full is None else tuple(full.parameters.names)


@dataclass(repr=False)
class History(Shown):
    """A solved history; after a failure, the ``history`` of the error has the steps that converged.

    Attributes:
        start: time at rest, in seconds.
        parameter: the parameter there, (P,).
        answers: one per step of the path, without the start.
        signs: one per step; a reduced model detects from them that it left its training.
        cuts: number of steps that were solved in parts.
        time_tolerance: tolerance by which steps were cut, if it was given.
    """

    start: float
    parameter: np.ndarray
    answers: list[Answer] = field(default_factory=list)
    signs: list[Any] = field(default_factory=list)
    cuts: int = 0
    time_tolerance: float | None = None

    def facts(self) -> dict[str, str]:
        """See :class:`~hhr_dolfinx.models.shown.Shown`."""
        end = self.answers[-1].time if self.answers else self.start
        estimates = self.time_error[np.isfinite(self.time_error)]
        return {
            "steps": counted(len(self.answers), "step"),
            "time": f"t = {self.start:.6g} to {end:.6g} s",
            "iterations": counted(sum(self.iterations), "iteration"),
            # without an estimate the answers do not say whether the steps are short enough
            "time error": f"time error {estimates.max():.2g}"
            if estimates.size
            else "time error not estimated",
        }

    @property
    def time_error(self) -> np.ndarray:
        """Estimated error of the time steps up to the end of each, (steps,).

        See :attr:`Answer.time_error`.
        """
        return np.array([answer.time_error for answer in self.answers])

    @property
    def parts(self) -> list[int]:
        """Number of parts in which each step was solved."""
        return [answer.parts for answer in self.answers]

    @property
    def path(self) -> Path:
        """Times and parameters of the path as it was given, the start first."""
        return [
            (self.start, self.parameter),
            *((answer.time, answer.parameter) for answer in self.answers),
        ]

    @property
    def solved_path(self) -> Path:
        """The path with all parts of its steps.

        Another model that marches along it has the same time errors.
        """
        path = self.path[:1]
        for answer in self.answers:
            time, point = path[-1]
            shares = [(end - time) / (answer.time - time) for end in answer.ends]
            between = [point + share * (answer.parameter - point) for share in shares]
            path += [*zip(answer.ends, between, strict=True), (answer.time, answer.parameter)]
        return path

    def plot(
        self,
        path: str | PathLike[str] | None = None,
        y: str | Sequence[str] | None = None,
        x: str = "time",
    ) -> Figure:
        """Outputs over time, a parameter or another output, as loops of hysteresis are drawn.

        Args:
            path: file to save the figure to; None does not save it.
            y: names of outputs; None for all outputs of the scene.
            x: ``time``, or the name of a parameter or output.

        Returns:
            A figure of matplotlib.

        Raises:
            ParameterError: for an unknown name.
            NotOfferedError: without a plug-in that draws.
        """
        draw = registry.tool("curves", "a figure of a history")
        return draw(self, path, y, x)

    def thinned(self, times: Sequence[float]) -> History:
        """History with the answers at some of its times alone."""
        selected = set(times)
        indices = [index for index, answer in enumerate(self.answers) if answer.time in selected]
        answers = [self.answers[index] for index in indices]
        return replace(
            self, answers=answers, signs=[self.signs[index] for index in indices if self.signs]
        )

    @property
    def iterations(self) -> list[int]:
        """Iterations of each step, summed over its parts.

        A failed attempt counts as the most allowed.
        """
        return [answer.iterations for answer in self.answers]


class SeveralAnswers(Shown):
    """Answers to several parameters, in their order.

    ``answers[k]`` is one of them, like any :class:`Answer`.
    """

    points: np.ndarray  #: parameters, (n, P)
    status: list[Status]  #: why each search stopped
    iterations: np.ndarray  #: equality problems solved for each, or iterations of a step, (n,)

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
        """Answer to one point; :meth:`take` gives several."""
        raise NotImplementedError

    def __iter__(self) -> Iterator[Answer]:
        return (self[k] for k in range(len(self)))

    @property
    def converged(self) -> np.ndarray:
        """True for each answer that is a solution, (n,) bool."""
        return np.array([status is Status.CONVERGED for status in self.status], dtype=bool)

    def take(self, rows: np.ndarray) -> SeveralAnswers:
        """Answers of some rows, given by numbers or a mask."""
        return ListedAnswers(tuple(self[k] for k in np.arange(len(self))[rows].tolist()))

    def forces(self) -> np.ndarray:
        """Contact forces on the whole surface, (n, N_lambda); NaN without a solution."""
        return np.array([answer.forces() for answer in self])

    def estimates(self) -> Estimates | None:
        """Error estimates, as :meth:`Answer.estimate`; None if the model has none."""
        from hhr_dolfinx.models.estimates import Estimates

        return Estimates.of([answer.estimate() for answer in self])

    def outputs(self) -> dict[str, np.ndarray]:
        """Outputs of the scene by name, (n,) each; NaN without a solution.

        Raises:
            HHRError: if the scene has none.
        """
        singles = [answer.outputs() for answer in self]
        return {
            name: np.array([outputs[name] for outputs in singles]) for name in singles[0].keys()
        }


@dataclass(frozen=True, repr=False)
class ListedAnswers(SeveralAnswers):
    """Answers found one by one.

    Each has all of its attributes: memory of laws, fields of a local model.
    """

    answers: tuple[Answer, ...]  #: one or more

    def __getitem__(self, k: int) -> Answer:
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


class HasLaw(Protocol):
    """A model, or the equilibrium of its bodies, of contact conditions with a law."""

    @property
    def parameters(self) -> ParameterSpace:
        """Box of the parameters."""

    @property
    def law(self) -> ContactLaw:
        """Law of its contact conditions."""

    @property
    def conditions(self) -> int:
        """Number of contact conditions."""


class Model(HasLaw, Protocol):
    """Interface of all models: full, reduced, condensed, baseline.

    Studies, checks and users rely on it.
    """

    def solve(
        self,
        mu: PointLike,
        *,
        start: Start = "nearest",
        raise_on_failure: bool = True,
        outside: str = USUAL,
        gradient: bool = False,
    ) -> Answer:
        """Answer one parameter.

        Args:
            mu: number, sequence or mapping by name.
            start: statuses to start from, one bool for each condition of the model; ``nearest`` for
                those of the nearest training parameter, None for those of the free slack.
            raise_on_failure: raise instead of returning an answer with NaN and a status.
            outside: policy for a parameter of the box outside the training range: ``warn``,
                ``refuse`` or ``ignore``; ``usual`` warns, except in models that fall back on the
                full one, for which no point is outside.
            gradient: compute the derivatives along the parameters, see
                :class:`~models.gradient.Gradient`.

        Raises:
            ParameterError: if ``mu`` is not finite or outside the box, or ``start`` is invalid.
            OutsideTrainingError: if it is outside the training range and ``outside`` is ``refuse``.
            ConvergenceError: if the statuses do not converge.
            NotSolvableError: if contact rows are dependent.

        Warns:
            OutsideTrainingWarning: if it is outside the training range and ``outside`` does not say
            otherwise.
        """

    def march(self, path: Path, settings: Any = ...) -> History:
        """Answer a load path from its state at rest.

        Args:
            path: times in seconds and parameters, the first ones at rest; parameters are linear
                between them.
            settings: a :class:`~hhr_dolfinx.models.histories.equilibrium.MarchSettings`.

        Raises:
            ParameterError: if the path is invalid, or leaves the box.
            ConvergenceError, OutsideTrainingError: its attribute ``history`` has the steps before.
        """


def one_by_one(
    model: Model, table: PointsLike, raise_on_failure: bool, outside: str
) -> ListedAnswers:
    """Answers of a model that has no faster way, point by point.

    Args:
        model: a model, see :class:`~hhr_dolfinx.models.model.AnsweringModel`.
        table: parameters, (n, P).
        raise_on_failure: raise at the first point without a solution.
        outside: see :meth:`Model.solve`.
    """
    points = model.parameters.points(table)
    return ListedAnswers(
        tuple(
            model.solve(point, raise_on_failure=raise_on_failure, outside=outside)
            for point in points
        )
    )


def outcome(
    answer: Answer, raise_on_failure: bool, advice: Mapping[Status, str] = MappingProxyType({})
) -> Answer:
    """The answer if it converged; otherwise an answer of NaN, or an error.

    No iterate passes for a solution.

    Args:
        answer: answer of a search, converged or not.
        raise_on_failure: raise instead of returning NaN.
        advice: remedy for each status, for the message.

    Raises:
        NotSolvableError: for a singular or unrestrained problem, or one that is not finite.
        ConvergenceError: if the search did not converge.
    """
    if answer.status is Status.CONVERGED:
        return answer
    if raise_on_failure:
        unsolvable = answer.status in (Status.SINGULAR, Status.NOT_FINITE, Status.ADRIFT)
        kind = NotSolvableError if unsolvable else ConvergenceError
        reason = ": ".join(
            [answer.status.value, *([advice[answer.status]] if answer.status in advice else [])]
        )
        point = np.ravel(answer.parameter).tolist()
        raise kind(f"no solution at {point} after {answer.iterations} iterations: {reason}")
    nothing = np.full_like(answer.unknown, np.nan), np.full_like(answer.multipliers, np.nan)
    return answer._replace(unknown=nothing[0], multipliers=nothing[1])


def unanswered(
    parameter: np.ndarray,
    sizes: tuple[int, int],
    fields: ModelFields,
    status: Status = Status.UNDEFINED,
) -> Answer:
    """An answer of NaN.

    Args:
        parameter: mu, (P,).
        sizes: numbers of unknowns and of conditions of the model.
        fields: fields of the model.
        status: reason why there is no answer.
    """
    unknowns, conditions = sizes
    nothing = (
        np.full(unknowns, np.nan),
        np.full(conditions, np.nan),
        np.zeros(conditions, dtype=bool),
    )
    return Answer(parameter, *nothing, 0, status, False, fields)


def found_as(
    statuses: Statuses, parameter: np.ndarray, unknown: np.ndarray, fields: ModelFields
) -> Answer:
    """Answer from the result of the active set and the unknown under its forces.

    Args:
        statuses: result of the active set.
        parameter: mu, (P,).
        unknown: unknown of the model under these forces.
        fields: fields of the model.
    """
    return Answer(
        parameter,
        unknown,
        statuses.forces,
        statuses.active,
        statuses.iterations,
        statuses.status,
        statuses.cycled,
        fields,
    )
