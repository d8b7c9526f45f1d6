"""A reduced model that asks the full one where its own bound is not good enough, and may grow by what it learns."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from hhr_dolfinx.errors import BoundError, HHRError, OutsideTrainingError, ParameterError, ReductionError
from hhr_dolfinx.models.answer import Answer, Model, WithOutputs
from hhr_dolfinx.parameters import ParameterSpace, is_number, is_whole

_log = logging.getLogger(__name__)

ALIKE = 1e-5
"""Relative difference of gaps and S up to which two models are of one scene: S may be interpolated."""

Rebuild = Callable[[Sequence[Answer]], Any]
"""Builds a reduced model from all that was learned, answers of the full model, besides what it was trained on."""


class Growth(NamedTuple):
    """One attempt to build a better reduced model.

    Attributes:
        asked: queries before it.
        fallen: how many of them the full model answered.
        learned: answers of the full model at hand for it.
        refused: why the reduced model stayed as it was; nothing if the new one took its place.
    """

    asked: int
    fallen: int
    learned: int
    refused: str = ""


class FallbackModel(WithOutputs):
    """Answers by a reduced model, and by the full one where the reduced one may be off by more than is allowed.

    No answer that is handed out is off by more than ``tolerance``, relative to the exact one, in the energy of the
    displacement and in the S norm of the forces, see :mod:`hhr_dolfinx.models.error_bound`; where answers have no bound
    but an ``estimate``, by that. With ``rebuild`` it grows:
    after every so many answers of the full model that it had not seen a reduced model is built from all of them, within
    the query that is one too many, and takes the place of the old one. If it cannot be built the old one stays, and the
    next attempt has more to build from. Not for several threads at once.

    Args:
        reduced: a model whose answers have a bound.
        full: the full model of the same scene.
        tolerance: largest relative error of displacement and forces.
        rebuild: builds a reduced model from :attr:`learned`, as ``Training.safe_model`` has one; None keeps the reduced
            model as it is.
        every: new answers of the full model after which it is built again.

    Attributes:
        reduced: the reduced model as it is now.
        full: the full model.
        asked: number of queries.
        fallen: how many of them the full model answered.
        learned: answers of the full model, each point once, from which a better reduced model may be built.
        growth: attempts to build one.

    Raises:
        BoundError: for a reduced model whose answers have no bound.
        ParameterError: for a tolerance that is no positive number, or ``every`` that is no number of answers.
        ReductionError: for what is no full model, or that of another scene.
    """

    def __init__(
        self, reduced: Any, full: Model, tolerance: float = 0.01, *, rebuild: Rebuild | None = None, every: int = 20
    ):
        check_allowance(tolerance, every, "every")
        _check_alike(reduced, full)
        self.reduced, self.full, self.tolerance = reduced, full, float(tolerance)
        self.parameters: ParameterSpace = reduced.parameters
        self.asked, self.fallen, self.learned = 0, 0, list[Answer]()
        self.growth: list[Growth] = []
        self._rebuild, self._every, self._known = rebuild, every, set[bytes]()

    @property
    def share(self) -> float:
        """Part of the queries that the full model answered."""
        return self.fallen / max(self.asked, 1)

    def fell_back(self, answer: Answer) -> bool:
        """Whether the full model gave an answer."""
        return answer.fields is self.full

    def solve(
        self,
        mu: Any,
        *,
        start: Any = "nearest",
        raise_on_failure: bool = True,
        outside: str = "ignore",
        gradient: bool = False,
    ) -> Answer:
        """Answer one parameter, see :meth:`Model.solve`.

        A bound says more than the door: what lies outside the training is asked of the full model only if it is
        refused there, or where its bound is too large. ``start`` holds for the reduced model.
        """
        try:
            answer = self.reduced.solve(mu, start=start, raise_on_failure=False, outside=outside, gradient=gradient)
        except OutsideTrainingError:
            answer = None
        if answer is not None and (estimate := answer.estimate()) is not None:
            # of a NaN neither is true
            if estimate.primal_relative <= self.tolerance and estimate.dual_relative <= self.tolerance:
                self.asked += 1
                return answer
        exact = self.full.solve(mu, raise_on_failure=raise_on_failure, gradient=gradient)
        self.asked += 1
        self.fallen += 1
        if exact.converged:
            self._learn(exact)
        return exact

    def solve_many(self, points: Any, **how: Any) -> list[Answer]:
        """Answer many parameters, (n, P), one by one, see :meth:`solve`; they are of two models."""
        return [self.solve(point, **how) for point in self.parameters.points(points)]

    def _learn(self, exact: Answer) -> None:
        """Keep an answer, unless its point is known, and grow if it is time to."""
        key = np.asarray(exact.parameter, dtype=float).tobytes()
        if key in self._known:
            return
        self._known.add(key)
        self.learned.append(exact)
        if self._rebuild is not None and len(self.learned) % self._every == 0:
            self._grow()

    def _grow(self) -> None:
        """Put a reduced model of all that was learned in the place of the old one, if there is one."""
        assert self._rebuild is not None
        why = ""
        try:
            reduced = self._rebuild(tuple(self.learned))
            _check_alike(reduced, self.full)
            self.reduced = reduced
        except HHRError as error:
            why = str(error)
        self.growth.append(Growth(self.asked, self.fallen, len(self.learned), why))
        told = f"the reduced model stays as it is: {why}" if why else "the reduced model was built again"
        _log.info("%d of %d queries fell back, %d learned: %s", self.fallen, self.asked, len(self.learned), told)


def check_allowance(tolerance: Any, every: Any, name: str) -> None:
    """Raise ParameterError for a tolerance that is none, or a number of answers, called ``name``, that is none."""
    if not (is_number(tolerance) and tolerance > 0):
        raise ParameterError(f"tolerance = {tolerance!r} must be a positive number, such as 0.01")
    if not is_whole(every, 1):
        raise ParameterError(f"{name} = {every!r} must be a number of answers, such as 20")


def _remedy(full: Any) -> str:
    """Whose model is wrong, and which one is needed."""
    name = getattr(getattr(full, "scene", None), "name", "unknown")
    return f". It is of scene '{name}': give the FullOrderModel of the scene that was trained, or train this one"


def _check_alike(reduced: Any, full: Any) -> None:
    """Check that a reduced model has a bound, and a full one is that of its scene: box, gaps, S and an answer.

    Raises:
        BoundError: for a reduced model whose answers have no bound.
        ReductionError: for what is no full model, or that of another scene.
    """
    if getattr(getattr(reduced, "fields", None), "bound", None) is None:
        held = getattr(getattr(full, "problem", None), "rigid", None) is not None
        why = ", since contact alone holds bodies" if held else ""
        raise BoundError(f"answers of this reduced model have no bound{why}, and nothing says when to ask the full one")
    if not (hasattr(full, "problem") and hasattr(full, "schur")):
        raise ReductionError(f"{full!r} is no full model, whose answers are exact: give FullOrderModel(scene)")
    one, other = reduced.parameters, full.parameters
    if [*one.names, *one.lower, *one.upper] != [*other.names, *other.lower, *other.upper]:
        raise ReductionError(f"the reduced model has the parameters {one}, and the full one {other}")
    for mine, exact in ((reduced.fields.gaps, full.problem.gaps), (reduced.fields.bound.schur, full.schur)):
        if mine.shape != exact.shape or np.abs(mine - exact).max() > ALIKE * np.abs(exact).max():
            raise ReductionError(
                f"the full model is that of another scene or mesh: its gaps or its stiffness differ{_remedy(full)}"
            )
    point = one.random(1, seed=1)[0]
    answer, problem = full.solve(point, raise_on_failure=False), full.problem.at(point)
    if answer.converged:
        slack = problem.gaps @ problem.theta(point) - problem.contact @ answer.unknown
        found = reduced.fields.bound.at(point[None], reduced.fields.amplitudes(point)).slack(answer.forces()[None])[0]
        if problem.rigid is not None:  # motions of whole bodies are no part of S
            slack = slack + full.rigid_taken @ np.linalg.lstsq(full.rigid_taken, found - slack, rcond=None)[0]
        if np.abs(found - slack).max() > ALIKE * max(np.abs(found).max(), np.abs(problem.gaps).max()):
            raise ReductionError(
                f"the full model is that of another scene: its loads or its materials differ{_remedy(full)}"
            )
