"""A reduced model that asks the full one wherever its own bound is not good enough."""

from __future__ import annotations

from typing import Any

from hhr_dolfinx.errors import BoundError, OutsideTrainingError, ParameterError
from hhr_dolfinx.models.answer import Answer, Model, WithOutputs
from hhr_dolfinx.parameters import ParameterSpace, is_number


class FallbackModel(WithOutputs):
    """Answers by a reduced model, and by the full one where the reduced one may be off by more than is allowed.

    No answer that is handed out is off by more than ``tolerance``, relative to the exact one, in the energy of the
    displacement and in the S norm of the forces, see :mod:`hhr_dolfinx.models.error_bound`.

    Args:
        reduced: a model whose answers have a bound.
        full: the full model of the same scene.
        tolerance: largest relative error of displacement and forces.

    Attributes:
        asked: number of queries.
        learned: answers of the full model, from which a better reduced model may be built.

    Raises:
        BoundError: for a reduced model whose answers have no bound.
        ParameterError: for a tolerance that is no positive number, or models of other boxes.
    """

    def __init__(self, reduced: Any, full: Model, tolerance: float = 0.01):
        if not (is_number(tolerance) and tolerance > 0):
            raise ParameterError(f"tolerance = {tolerance!r} must be a positive number, such as 0.01")
        if getattr(reduced.fields, "bound", None) is None:
            raise BoundError("answers of this reduced model have no bound, and nothing says when to ask the full one")
        if reduced.parameters.names != full.parameters.names:  # type: ignore[attr-defined]
            raise ParameterError("the reduced and the full model have other parameters: they are of two scenes")
        self._reduced, self._full, self.tolerance = reduced, full, float(tolerance)
        self.parameters: ParameterSpace = reduced.parameters
        self.asked, self.learned = 0, list[Answer]()

    @property
    def share(self) -> float:
        """Part of the queries that the full model answered."""
        return len(self.learned) / max(self.asked, 1)

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
        self.asked += 1
        try:
            answer = self._reduced.solve(mu, start=start, raise_on_failure=False, outside=outside, gradient=gradient)
        except OutsideTrainingError:
            answer = None
        if answer is not None and (estimate := answer.estimate()) is not None:
            if max(estimate.primal_relative, estimate.dual_relative) <= self.tolerance:
                return answer
        exact = self._full.solve(mu, raise_on_failure=raise_on_failure, gradient=gradient)
        self.learned.append(exact)
        return exact

    def solve_many(self, points: Any, **how: Any) -> list[Answer]:
        """Answer many parameters, (n, P), one by one, see :meth:`solve`; they are of two models."""
        return [self.solve(point, **how) for point in self.parameters.points(points)]
