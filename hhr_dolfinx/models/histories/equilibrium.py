"""Equilibrium of bodies with laws, and settings of histories.

Warnings of time steps that are too long are here too: one for each history, or one for a whole
training.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from numbers import Real
from typing import TYPE_CHECKING, Any, Protocol, TypedDict, TypeVar, Unpack

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.errors import ParameterError, TimeStepWarning
from hhr_dolfinx.parameters import is_number, is_whole
from hhr_dolfinx.trained import OUTSIDE
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    from hhr_dolfinx.models.answer import Answer, History, Model, Path
    from hhr_dolfinx.models.functionals.functional import Functional


class StressOutput(Protocol):
    """An output of the stress of some cells."""

    @property
    def name(self) -> str:
        """Its name."""

    @property
    def unit(self) -> str:
        """Its unit, as text."""

    @property
    def kind(self) -> str:
        """``mean`` for the mean over the volume, otherwise the largest value."""


class LawsAtPlaces(Protocol):
    """Laws at the Gauss points of a mesh."""

    @property
    def places(self) -> int:
        """Number of these places."""

    def mises(self, output: StressOutput, cells: np.ndarray) -> Functional:
        """Von Mises' stress of an output in some cells.

        Args:
            output: the output.
            cells: numbers of the cells.
        """


Answering = TypeVar("Answering", bound="Model", contravariant=True)
"""Kind of models that histories are of."""


class Following(TypedDict, total=False):
    """Further arguments of a history."""

    known: Sequence[Answer]  #: answers to the first steps, solved before
    keep: Callable[[Answer], None]  #: called with each new answer
    watch: Callable[[Answer], None] | None  #: called with the answer of each increment
    weights: np.ndarray | None  #: derivatives of the parameters at each time, (times, P)


class StepOptions(TypedDict, total=False):
    """Further arguments of a step from rest to a point."""

    duration: float  #: of the step in seconds, for laws of bodies with rates
    converged: bool  #: refine the path, for laws of contacts


class Histories(Protocol[Answering]):
    """Answers along paths: a law of contacts, or the equilibrium of bodies with laws."""

    def march(
        self,
        model: Answering,
        path: Path,
        settings: MarchSettings,
        *,
        known: Sequence[Answer] = (),
        keep: Callable[[Answer], None] = ...,
    ) -> History:
        """History of a model along a checked path.

        Args:
            model: model that answers.
            path: times and parameters.
            settings: settings of the solution.
            known: answers to the first steps, solved before.
            keep: called with each new answer.
        """

    def one_step(
        self,
        model: Answering,
        point: np.ndarray,
        raise_on_failure: bool,
        outside: str,
        gradient: bool,
        **step: Unpack[StepOptions],
    ) -> Answer:
        """Answer of a model to a point, from rest.

        Args:
            model: model that answers.
            point: checked parameter, (P,).
            raise_on_failure: raise instead of returning NaN and a status.
            outside: policy outside the training range.
            gradient: compute the derivatives along the parameters.
            **step: further arguments of ``solve`` of the model.
        """

    def known_error(self, known: str) -> str:
        """Line on the errors of answers, from that of unilateral contact of elastic bodies."""


class Equilibrium(Histories[Answering], Protocol[Answering]):
    """Equilibrium of bodies with laws, of a full or a small model.

    The plug-in that reads the laws makes it.
    """

    @property
    def reader(self) -> str:
        """Name of the plug-in, whose facets do the rest, see :func:`facet_of`."""


class FullEquilibrium(Equilibrium, LawsAtPlaces, Protocol):
    """Equilibrium on the whole mesh."""

    def stress(self, answer: Answer) -> np.ndarray:
        """Stress in Kelvin's notation where laws are evaluated, (places, components)."""


def facet_of(equilibrium: Equilibrium, word: str, what: str) -> Any:
    """Facet of the plug-in that made an equilibrium, see :func:`hhr_dolfinx.registry.facet`.

    Args:
        equilibrium: the equilibrium.
        word: name of the facet.
        what: purpose of the facet, for the message.

    Raises:
        NotOfferedError: if the plug-in does not have it.
    """
    return registry.facet(equilibrium.reader, word, what)


ACCEPTED = 0.05
"""Estimated time error above which a history without a time tolerance raises a warning."""
_COLLECTED: ContextVar[list[float] | None] = ContextVar("time errors of a training", default=None)


def warn_of_time_error(estimate: float, tolerance: float | None) -> None:
    """Warn of a large time error.

    Not if a tolerance was given, or if :func:`told_once` collects the warnings.

    Args:
        estimate: estimated time error.
        tolerance: tolerance of the history; None without one.
    """
    collected = _COLLECTED.get()
    if collected is not None:
        collected.append(estimate)
    elif tolerance is None and estimate > ACCEPTED:
        warn(f"the time steps of this history {_said(estimate)}", TimeStepWarning)


@contextmanager
def told_once(what: str = "") -> Iterator[None]:
    """Collect the time errors of histories in a block and warn once at its end, as ``what``.

    Never without a name.
    """
    collected = _COLLECTED.get()
    if collected is not None:  # the outermost block warns
        yield
        return
    estimates: list[float] = []
    token = _COLLECTED.set(estimates)
    try:
        yield
    finally:
        _COLLECTED.reset(token)
    large = [estimate for estimate in estimates if estimate > ACCEPTED]
    if what and large:
        text = f"the time steps of {len(large)} of {len(estimates)} {what} {_said(max(large))}"
        warn(text, TimeStepWarning)


def _said(estimate: float) -> str:
    return (
        f"make errors of {100 * estimate:.2g} % of the largest stress or displacement by "
        f"estimate, and {100 * ACCEPTED:g} % is much: take more of them where loads are put on or "
        "held, or MarchSettings(time_tolerance=0.01)"
    )


SEARCHES = ("tangent", "frozen", "elastic")
LEAST_TOLERANCE = 1e-5
"""Time tolerance below which the residual left in a step counts as much as its duration."""


@dataclass(frozen=True)
class MarchSettings:
    """Settings of the solution of histories.

    Attributes:
        search: operator of the linearisation. ``tangent`` is renewed in each iteration. ``frozen``
            is the elastic one until a step takes many iterations, then the tangent at the start of
            a step until another step does. ``elastic`` never changes. The latter two have
            Anderson's acceleration.
        relative_stress: ε_r of (6.19). Instead of R_σ (6.18), the error of the last prediction, the
            criterion uses the change by the next one, H : ε(δ).
        floor_stress: ε_a of (6.19) as a fraction of the largest root mean square of the stress so
            far, without a unit.
        relative_force: residual over the size of the forces; the stress criterion alone only
            measures the change of iterates.
        iterations: most iterations of a step before it is cut.
        cuts: how often a step that does not converge may be halved.
        time_tolerance: largest estimated error of the time steps, see :attr:`Answer.time_error`. A
            step of the path is solved in as many parts as that takes, and answered at its end. None
            does not cut steps.
        outside: policy for a step outside the training range of a reduced model: ``warn``,
            ``refuse`` or ``ignore``.
        gradient: compute derivatives of each answer along the parameters, each shifted by the same
            at all times, as a constant of the whole history.
        limit: with friction, derivatives of the limit of small increments, in which a contact
            sticks where it closes, instead of those of the increments themselves, in which it
            sticks to where it was at the start of one.
        time_error: estimate the error of the time steps of inelastic bodies by a second solution in
            half steps, which takes twice the time of the history; with a time tolerance there is an
            estimate in any case.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> from dataclasses import replace
        >>> floor = replace(scene.contacts[0], friction=0.3)
        >>> model = hhr.condense(replace(scene, contacts=(floor,)))
        >>> path = [(0.0, {"push": 0.0}), (1.0, {"push": 25.0}), (2.0, {"push": 50.0})]
        >>> history = model.march(path, hhr.MarchSettings(gradient=True))
        >>> history.answers[-1].outputs().gradient["peak"].round(1)
        array([1.6])
    """

    search: str = "frozen"
    relative_stress: float = 1e-5
    floor_stress: float = 5e-3
    relative_force: float = 1e-5
    iterations: int = 60
    cuts: int = 6
    outside: str = "warn"
    gradient: bool = False
    limit: bool = False
    time_tolerance: float | None = None
    time_error: bool = False

    def __post_init__(self):
        for name, choices in (("search", SEARCHES), ("outside", OUTSIDE)):
            if getattr(self, name) not in choices:
                raise ParameterError(
                    f"{name} '{getattr(self, name)}' is unknown, one of {', '.join(choices)}"
                )
        for name in ("relative_stress", "floor_stress", "relative_force"):
            if not (isinstance(getattr(self, name), Real) and 0 < getattr(self, name) < 1):
                raise ParameterError(f"{name} = {getattr(self, name)} must be a fraction in (0, 1)")
        for name in ("gradient", "limit", "time_error"):
            if not isinstance(getattr(self, name), bool):
                raise ParameterError(f"{name} = {getattr(self, name)!r} must be True or False")
        if not (is_whole(self.iterations, 1) and is_whole(self.cuts, 0)):
            raise ParameterError(
                f"iterations = {self.iterations} must be a whole number from 1, and cuts = "
                f"{self.cuts} one from 0"
            )

        tolerance = self.time_tolerance
        if not (tolerance is None or (is_number(tolerance) and LEAST_TOLERANCE <= tolerance < 1)):
            raise ParameterError(
                f"time_tolerance = {tolerance!r} must be a fraction from {LEAST_TOLERANCE:g} to "
                "1, as 0.01 is, or None"
            )
        if self.gradient and tolerance is not None:
            raise ParameterError(
                f"steps cut by a time_tolerance of {tolerance:g} have no gradient: march along "
                "the path in more steps, without a tolerance, until History.time_error is small "
                "enough"
            )


DEFAULT_MARCH = MarchSettings()
