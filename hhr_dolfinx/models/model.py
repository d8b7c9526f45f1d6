"""Common base of all models.

It checks points, starts and training range, and raises or warns on failures.

Each kind of model implements ``_answered`` for a checked point. Models of bodies with laws have an
``equilibrium``, which answers paths.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Self, Unpack

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.contact.kernel import kernels
from hhr_dolfinx.contact.law import UNILATERAL, ContactLaw
from hhr_dolfinx.errors import (
    NotOfferedError,
    NotSolvableError,
    OutsideTrainingError,
    ParameterError,
    UndeterminedWarning,
)
from hhr_dolfinx.models.answer import (
    Answer,
    CheckedStart,
    History,
    Path,
    SeveralAnswers,
    Start,
    one_by_one,
    outcome,
    unanswered,
)
from hhr_dolfinx.models.histories.equilibrium import (
    DEFAULT_MARCH,
    Equilibrium,
    Histories,
    MarchSettings,
    StepOptions,
)
from hhr_dolfinx.models.histories.path import checked_path
from hhr_dolfinx.models.histories.steps import steps_of
from hhr_dolfinx.models.shown import SHOWN_NUMBERS, Shown, counted
from hhr_dolfinx.plain import Remade, rebuilt
from hhr_dolfinx.trained import USUAL, Trained, TrainedRange, check_outside
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    from hhr_dolfinx.models.eliminations.elimination import CondensedContact
    from hhr_dolfinx.models.functionals.functional import Outputs
    from hhr_dolfinx.parameters import ParameterSpace, PointLike, PointsLike


ROWS_AT_ONCE = 1000
"""Most rows of a table answered at once by models that solve them one by one."""
NEAREST = "nearest"
"""Default start of the search."""


def checked_start(start: Start, conditions: int) -> CheckedStart:
    """Check the start of a search: ``nearest``, None, or statuses.

    Args:
        start: start of a search, as a user gives it.
        conditions: number of conditions of the model, m.

    Raises:
        ParameterError: for another word, or statuses that are not bool or not one for each
            condition.
    """
    if start is None or (isinstance(start, str) and start == NEAREST):
        return start
    try:
        statuses = np.array(start)  # a copy: answers may share it
    except ValueError:  # rows of several lengths
        statuses = np.array(repr(start))
    if statuses.dtype != bool or statuses.shape != (conditions,):
        shown = repr(start) if statuses.ndim == 0 else f"{statuses.dtype} of shape {statuses.shape}"
        raise ParameterError(
            f"start = {shown} is unknown: 'nearest', None for a cold start, or statuses "
            f"({conditions},) bool"
        )
    return statuses


NOTHING: Mapping[str, float] = MappingProxyType({})
"""Parameters of a query that has none, which is refused."""


def warn_undetermined(parameters: ParameterSpace, answer: Answer) -> None:
    """Warn of rigid motions of an answer that contact does not determine.

    Args:
        parameters: the box, for the names.
        answer: answer with undetermined motions.
    """
    warn(
        f"neither loads nor contact determine how far {kernels().undetermined_motions(answer)} at "
        f"{parameters.described(answer.parameter)}: the answer is that of least motion, and "
        "nothing bounds outputs that read it. For one answer hold the body by a displacement, or "
        "load it",
        UndeterminedWarning,
    )


class AnsweringModel(Shown):
    """Base of all kinds of models.

    Each implements its solution, and may override methods by faster ones.

    Attributes:
        parameters: the box of the parameters.
        fields: completes the answers.
        equilibrium: answers paths of bodies with laws; None in elastic models.
        law: law of the contact conditions of the model.
        advice: remedy for each status, for the messages.
        usual_outside: default policy outside the training range, ``warn`` or ``ignore``.
        instead: model to keep in a file instead of this one, for messages.
        reduction: record of ``hhr.reduce``; None of other models, of copies and from files.
    """

    parameters: ParameterSpace
    fields: Any  #: ModelFields of the kind of model
    equilibrium: Equilibrium | None = None
    law: ContactLaw = UNILATERAL
    advice: Mapping[Status, str] = MappingProxyType({})
    reduction: Any = None
    usual_outside: ClassVar[str] = "warn"
    instead: ClassVar[str] = (
        "it needs the mesh and its factors. Keep a reduced or a condensed model, training.build()"
    )

    def facts(self) -> dict[str, str]:
        """See :class:`~hhr_dolfinx.models.shown.Shown`."""
        names = self.parameters.names
        solved = self.own_conditions
        conditions = self.conditions
        contact = (
            counted(conditions, "contact condition")
            if solved == conditions
            else f"{solved} of {conditions} contact conditions"
        )
        unknowns = self.sizes[0]
        return {
            "parameters": f"{counted(len(names), 'parameter')} "
            f"({', '.join(names[:SHOWN_NUMBERS])})",
            **({"unknowns": counted(unknowns, "unknown")} if unknowns else {}),
            "contact": contact,
            "errors": "exact"
            if self.fields.exact
            else f"errors: {self.fields.estimated or 'unknown'}",
        }

    @property
    def dimension(self) -> int:
        """Components of the displacement at a node."""
        return self.fields.dimension

    @property
    def estimating(self) -> AnsweringModel:
        """Model whose error estimates its answers carry.

        It is the model itself, but for models that combine others.
        """
        return self

    def columns(self, many: Iterable[Answer]) -> dict[str, np.ndarray]:
        """Further columns of a table of n answers by head, (n,) each; usually none.

        The heads are the same without any answer.
        """
        return {}

    def summed_up(self, sums: Mapping[str, float]) -> str:
        """Words on these columns for the last line of a table, from their sums; usually none."""
        return ""

    @property
    def conditions(self) -> int:
        """Number of conditions on the whole contact surface, N_lambda."""
        return self.fields.conditions

    @property
    def own_conditions(self) -> int:
        """Number of conditions that it solves for, whose forces an answer has as multipliers."""
        return self.conditions

    @property
    def sizes(self) -> tuple[int, int]:
        """Numbers of unknowns and of conditions of an answer."""
        return 0, self.own_conditions

    @property
    def rows_at_once(self) -> int:
        """Rows of a table to answer at once.

        More are not faster, and are lost if a run is killed.
        """
        return ROWS_AT_ONCE

    @property
    def by_paths(self) -> bool:
        """True if answers are made along paths: bodies have laws, or a contact remembers."""
        return self.equilibrium is not None or self.law.remembers

    @property
    def histories(self) -> Histories[AnsweringModel]:
        """Solver of paths: equilibrium of bodies with laws, or the law of contact conditions."""
        return self.equilibrium or steps_of(self.law)

    @property
    def known_error(self) -> str:
        """One line on the errors of answers of this model, or the reason why they have none."""
        from hhr_dolfinx.models.estimates import known_error

        description = known_error(self.fields)
        return self.histories.known_error(description)

    def solve(
        self,
        mu: PointLike = NOTHING,
        *,
        start: Start = NEAREST,
        raise_on_failure: bool = True,
        outside: str = USUAL,
        gradient: bool = False,
        **step: Unpack[StepOptions],
    ) -> Answer:
        """Answer one parameter, see :meth:`~hhr_dolfinx.models.answer.Model.solve`.

        Models of bodies with laws make one step from rest; ``start`` is checked, but not used.

        Args:
            mu: number, sequence or mapping by name.
            start: start of the search, or statuses, (m,) bool.
            raise_on_failure: raise instead of returning NaN and a status.
            outside: policy outside the training range.
            gradient: compute the derivatives along the parameters.
            **step: further arguments of a step, see :meth:`Equilibrium.one_step`. With friction
                ``converged=True`` refines the path.

        Raises:
            ParameterError: if ``mu`` or ``start`` is invalid, or parameters are given as keywords.
            NotOfferedError: for arguments of a step if all bodies are elastic.
            OutsideTrainingError, NotSolvableError, ConvergenceError: see there.
        """
        if mu is NOTHING or (step and not step.keys().isdisjoint(self.parameters.names)):
            example = ", ".join(
                f"{name!r}: {step.get(name, '...')}" for name in self.parameters.names
            )
            raise ParameterError(
                f"parameters are one argument, a mapping by their names: solve({{{example}}})"
            )
        if self.shared:
            arguments = {"start": start, "outside": outside, "gradient": gradient, **step}
            self.agree("solve", lambda: self.parameters.point(mu)[None], **arguments)
        point = self.parameters.point(mu)
        outside = self._checked_outside(outside)
        checked = NEAREST if start is NEAREST else self._checked_start(start)
        if self.by_paths:
            return self.histories.one_step(self, point, raise_on_failure, outside, gradient, **step)
        if step:
            raise NotOfferedError(
                f"solve has no argument {', '.join(step)} here: all bodies are elastic and without "
                "friction"
            )
        self.check_range(point, outside)
        try:
            answer = self._answered(point, checked, outside, gradient)
        except OutsideTrainingError:  # refuse it whatever fails; one of several models may raise it
            raise
        except (NotSolvableError, ParameterError):
            # a singular stiffness, or a shape at which surfaces slide off the known ones
            if raise_on_failure:
                raise
            return self.unanswered(point)
        if answer.status is not Status.CONVERGED:
            return outcome(answer, raise_on_failure, self.advice)
        if answer.undetermined is not None:
            self.warn_undetermined(answer)
        return answer

    @property
    def shared(self) -> bool:
        """True if several ranks have it together; then :meth:`agree` compares their calls."""
        return False

    def agree(self, call: str, points: Callable[[], np.ndarray], **how: Any) -> None:
        """Compare the calls of ranks that have a model together; here each has its own.

        Args:
            call: name of the method.
            points: returns its points, (n, P).
            **how: further arguments of the call.
        """

    def check_range(self, point: np.ndarray, outside: str) -> None:
        """Warn of, or refuse, a point, (P,), outside the training range; here the whole box.

        Args:
            point: parameter, (P,).
            outside: ``warn``, ``refuse`` or ``ignore``.
        """

    def contacts(self) -> Callable[[np.ndarray], CondensedContact]:
        """Elimination along one path: the contact problem of each point, (P,).

        The problem has no primal unknown.

        Raises:
            NotOfferedError: if the model has no condensed contact problem.
        """
        raise NotOfferedError(
            f"{type(self).__name__} knows no contact problem of a point for itself"
        )

    def pressures(self, answer: Answer) -> np.ndarray:
        """Forces of an answer along the contact normals, (c,).

        Their sum is the total contact force.
        """
        forces = answer.forces()
        law: ContactLaw = self.law if self.fields.interface is None else self.fields.interface.whole
        return forces[law.pressing(len(forces))]

    def follow(self, path: Path, settings: MarchSettings, **how: Any) -> History:
        """History along a checked path.

        Args:
            path: times and parameters.
            settings: settings of the solution.
            **how: see :class:`~hhr_dolfinx.models.histories.equilibrium.Histories`.
        """
        return self.histories.march(self, path, settings, **how)

    def answering(self, history: History) -> AnsweringModel:
        """The model that answered a history: itself, or one of those that it uses."""
        return self

    def unanswered(self, point: np.ndarray, status: Status = Status.UNDEFINED) -> Answer:
        """An answer of NaN to a checked point, (P,).

        Args:
            point: checked parameter, (P,).
            status: reason why there is no answer.
        """
        return unanswered(point, self.sizes, self.fields, status)

    def increments(self, settings: MarchSettings) -> Any:
        """Solver of the increments of a law that remembers."""
        return steps_of(self.law).increments(self, settings)

    def coupling(self, mu: PointLike) -> float:
        """Strength of the coupling of contact conditions by their law.

        Below one, each increment has one answer. From one on there may be several, and the search
        finds one of them. Zero for unilateral contact. NaN if unknown, as for bodies with rigid
        motions or laws, or an unsymmetric S.
        """
        return steps_of(self.law).coupling(self, self.parameters.point(mu))

    def uniqueness(self, mu: PointLike) -> str:
        """Uniqueness of increments at a parameter, by :meth:`coupling`.

        Returns:
            ``one answer``, which is proved; ``several answers possible``, of which one is found,
            and the estimate refers to it; or ``unknown`` if the coupling is unknown.
        """
        coupling = self.coupling(mu)
        if np.isnan(coupling):
            return "unknown"
        return "one answer" if coupling < 1 else "several answers possible"

    def _answered(
        self, point: np.ndarray, start: CheckedStart, outside: str, gradient: bool
    ) -> Answer:
        """Answer to a checked point, (P,), converged or not."""
        raise NotImplementedError

    def warn_undetermined(self, answer: Answer) -> None:
        """Warn of rigid motions of an answer that contact does not determine."""
        warn_undetermined(self.parameters, answer)

    def _checked_outside(self, outside: str) -> str:
        """Policy outside the training range: the given one, or the default of this kind."""
        if isinstance(outside, str) and outside == USUAL:
            return self.usual_outside
        check_outside(outside)
        return outside

    def _checked_start(self, start: Start) -> CheckedStart:
        return checked_start(start, self.own_conditions)

    def solve_many(
        self, points: PointsLike, *, raise_on_failure: bool = True, outside: str = USUAL
    ) -> SeveralAnswers:
        """Answer many parameters, (n, P), one by one.

        Models of bodies with laws make one step from rest for each.

        Args:
            points: parameters, (n, P).
            raise_on_failure: raise at the first point without a solution.
            outside: see :meth:`solve`.
        """
        return one_by_one(self, points, raise_on_failure, self._checked_outside(outside))

    def march(self, path: Path, settings: MarchSettings = DEFAULT_MARCH) -> History:
        """Answer a path, from rest if bodies have laws.

        See :meth:`~hhr_dolfinx.models.answer.Model.march`.

        Args:
            path: times in seconds and parameters, the first ones at rest.
            settings: settings of the solution.
        """
        checked = checked_path(self.parameters, path)
        return self.follow(checked, settings)

    def outputs(self, mu: PointLike = NOTHING, *, gradient: bool = False, **how: Any) -> Outputs:
        """Outputs of the scene at one parameter.

        Args:
            mu: number, sequence or mapping by name.
            gradient: compute the derivatives along the parameters.
            **how: further arguments of :meth:`solve`.

        Raises:
            HHRError: if the scene has none; for others see :meth:`solve`.
        """
        return self.solve(mu, gradient=gradient, **how).outputs()


class KeptModel(AnsweringModel):
    """A model of plain data: it can be copied, pickled, changed, and kept in a file."""

    #: arguments that a file keeps, attributes of the same names, see :mod:`hhr_dolfinx.plain`
    kept: ClassVar[tuple[str, ...]]
    has_own_sizes: ClassVar[bool] = True
    handed_on: ClassVar[
        tuple[str, ...]
    ] = ()  #: further arguments that copies and changed models have
    trained: Trained | None = None  #: training range; None if it is unknown
    #: record of the construction; None of a copy or from a file, and for models without
    #: approximation
    offline: Any = None

    def check_range(self, point: np.ndarray, outside: str) -> None:
        """See :class:`AnsweringModel`.

        Args:
            point: parameter, (P,).
            outside: ``warn``, ``refuse`` or ``ignore``.
        """
        if self._limit is not None:
            self._limit.check(point, outside)

    @cached_property
    def _limit(self) -> TrainedRange | None:
        """The training range; None if it is the whole box."""
        trained = self.trained
        return (
            trained
            if isinstance(trained, TrainedRange) and not trained.covers(self.parameters)
            else None
        )

    def _arguments(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in (*self.kept, *self.handed_on)}

    def __reduce__(self) -> Remade[Self]:
        """Copy and pickle by the arguments; the record of the construction is left out."""
        return rebuilt, (type(self), self._arguments())

    def changed(self, **parts: Any) -> Self:
        """Model with some arguments replaced, by their names."""
        model = type(self)(**(self._arguments() | parts))
        model.offline = parts.get("offline", self.offline)
        return model

    @classmethod
    def from_file(cls, **parts: Any) -> Self:
        """Rebuild the model from a file."""
        return cls(**parts)

    def without_fields(self) -> Self:
        """Model of forces and outputs alone, whose file is small; itself if it has no arrays that
        only displacements need.
        """
        return self

    @property
    def members(self) -> tuple[KeptModel, ...]:
        """Models that answer for this one; itself if there are no others."""
        return (self,)

    def for_file(self) -> Self:
        """The model without its indicator, which is code."""
        if self.fields.indicator is None:
            return self
        reason = "its indicator was left out, as a file holds no code"
        return self.changed(fields=replace(self.fields, indicator=None, unbounded=reason))

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Faults of a model whose parts are valid, given the sizes that they share."""
        if "terms" not in sizes:
            yield "no array of its fields declares the size of θ: Annotated[Floats, ..., 'terms']"
            return
        yield from self.fields.amplitudes.faults_for(self.parameters, sizes["terms"])
        # 1 for matrices without a mesh, whose dofs are no nodes
        if self.fields.dimension not in (1, 2, 3) or sizes.get("N", 0) % self.fields.dimension:
            yield (
                f"{sizes.get('N')} dofs are no nodes of dimension {self.fields.dimension}, which "
                "must be 1, 2 or 3"
            )
        if empty := [name for name in ("N_lambda", "m", "ell") if sizes.get(name, 1) == 0]:
            yield f"sizes {empty} are zero"
        if isinstance(self.law, ContactLaw):
            yield from self.law.faults_for(self.fields.dimension)
        else:
            yield f"its law is a {type(self.law).__name__}, and no law of contact conditions"
        if self.trained is not None and self.trained.names != tuple(self.parameters.names):
            yield (
                f"it was trained on {self.trained.names}, and its parameters are "
                f"{self.parameters.names}"
            )
        if self.fields.functionals is not None:
            count = 0 if self.fields.flow is None else self.fields.flow.places
            self.fields.functionals.check(self.parameters, self.conditions, count)


def with_fields(model: KeptModel, fields: bool | str) -> KeptModel:
    """The model with the fields that are requested.

    Args:
        model: the model.
        fields: ``all`` or True, ``none`` or False, or ``surface`` for those on the outside of
            bodies in space.

    Raises:
        NotOfferedError: for ``surface`` without the plug-in that draws them.
    """
    if fields == "surface":
        made: KeptModel = registry.tool("surface", "fields on the outside of bodies")(model)
        return made
    return model if fields in (True, "all") else model.without_fields()
