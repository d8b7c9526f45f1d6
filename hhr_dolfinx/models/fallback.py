"""A reduced model that asks the full one wherever its own bound is not good enough."""

from __future__ import annotations

from typing import Any

import numpy as np

from hhr_dolfinx.errors import BoundError, OutsideTrainingError, ParameterError, ReductionError
from hhr_dolfinx.models.answer import Answer, Model, WithOutputs
from hhr_dolfinx.parameters import ParameterSpace, is_number

ALIKE = 1e-9
"""Relative difference of gaps and S up to which two models are of one scene: of round-off."""


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
        ParameterError: for a tolerance that is no positive number.
        ReductionError: for what is no full model, or that of another scene.
    """

    def __init__(self, reduced: Any, full: Model, tolerance: float = 0.01):
        if not (is_number(tolerance) and tolerance > 0):
            raise ParameterError(f"tolerance = {tolerance!r} must be a positive number, such as 0.01")
        if getattr(getattr(reduced, "fields", None), "bound", None) is None:
            raise BoundError("answers of this reduced model have no bound, and nothing says when to ask the full one")
        _check_alike(reduced, full)
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
        try:
            answer = self._reduced.solve(mu, start=start, raise_on_failure=False, outside=outside, gradient=gradient)
        except OutsideTrainingError:
            answer = None
        if answer is not None and (estimate := answer.estimate()) is not None:
            if max(estimate.primal_relative, estimate.dual_relative) <= self.tolerance:
                self.asked += 1
                return answer
        exact = self._full.solve(mu, raise_on_failure=raise_on_failure, gradient=gradient)
        self.asked += 1
        if exact.converged:
            self.learned.append(exact)
        return exact

    def solve_many(self, points: Any, **how: Any) -> list[Answer]:
        """Answer many parameters, (n, P), one by one, see :meth:`solve`; they are of two models."""
        return [self.solve(point, **how) for point in self.parameters.points(points)]


def _check_alike(reduced: Any, full: Any) -> None:
    """Raise ReductionError for what is no full model, or that of another scene: box, gaps and S are compared."""
    if not (hasattr(full, "problem") and hasattr(full, "schur")):
        raise ReductionError(f"{full!r} is no full model, whose answers are exact: give FullOrderModel(scene)")
    one, other = reduced.parameters, full.parameters
    if [*one.names, *one.lower, *one.upper] != [*other.names, *other.lower, *other.upper]:
        raise ReductionError(f"the reduced model has the parameters {one}, and the full one {other}")
    for mine, exact in ((reduced.fields.gaps, full.problem.gaps), (reduced.fields.bound.schur, full.schur)):
        if mine.shape != exact.shape or np.abs(mine - exact).max() > ALIKE * np.abs(exact).max():
            raise ReductionError("the full model is that of another scene or mesh: its gaps or its stiffness differ")
