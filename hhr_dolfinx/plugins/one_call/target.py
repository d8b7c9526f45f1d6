"""Target accuracy of a model, its norms, and the budget of the search.

Errors of answers in these norms.

The errors of an answer, or of the steps k of a history, relative to the exact ones, are

    displacement    max_k |u_k - u~_k|_K / max_k |u_k|_K,  |v|_K = (v^T K v)^1/2, lifts included
    forces          max_k |λ_k - λ~_k|_2 / max_k |λ_k|_2, nodal contact forces
    pressure        max_k max_i |σ_ki - σ~_ki| / max_k max_i σ_ki,  σ = λ / area
    an output       max_k |s_k - s~_k| / max_k |s_k|

If the exact size is less than a thousandth of the largest one known, as for forces when contact is
nearly lost, that thousandth replaces it, as in :mod:`hhr_dolfinx.models.estimates`. For an output
that is a sum, such as a moment, the size is at least a thousandth of the sum of the absolute values
of its terms.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.certify.accuracy import FORCE_FLOOR
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import ParameterError
from hhr_dolfinx.models.answer import Answer, History
from hhr_dolfinx.models.estimates import FALLBACK_ERRORS
from hhr_dolfinx.models.functionals.kinds import Linear
from hhr_dolfinx.parameters import is_number, is_whole

if TYPE_CHECKING:
    from hhr_dolfinx.full_order.full import FullOrderModel
    from hhr_dolfinx.models.model import AnsweringModel


LEAST_ERROR = 1e-12
"""Smallest target.

Exact condensation solves the equations of the full model in another order, and differs by 8e-13.
"""
FULL_ORDER_ROUND_OFF = 1e-10
"""Part of the largest displacement or force by which exact answers may differ: a hundred times the
observed value.
"""
DISPLACEMENT = "displacement"
PRESSURE = "pressure"


@dataclass(frozen=True)
class Budget:
    """Limits of the cost of finding a model; None for no limit.

    Attributes:
        seconds: most seconds; a stage that cannot end by then is not begun, or stopped.
        full_answers: of the full model, points or histories, including those of checks.
        bytes: size of the model in a file.

    Raises:
        ParameterError: for a value that is no positive number.
    """

    seconds: float | None = None
    full_answers: int | None = None
    bytes: float | None = None

    def __post_init__(self) -> None:
        for name in ("seconds", "bytes"):
            value = getattr(self, name)
            if value is not None and not (is_number(value) and value > 0):
                raise ParameterError(
                    f"{name} = {value!r} of a budget must be a positive number, or None for no "
                    "limit"
                )
        if self.full_answers is not None and not is_whole(self.full_answers, 1):
            raise ParameterError(
                f"full_answers = {self.full_answers!r} of a budget must be a positive integer, or "
                "None"
            )


@dataclass(frozen=True)
class Target:
    """Largest relative error of quantities.

    These are ``pressure``, ``forces``, ``displacement``, or outputs by name.
    """

    error: float
    of: tuple[str, ...]

    @classmethod
    def checked(cls, error: float, of: str | Sequence[str], full: FullOrderModel) -> Target:
        """Target for the answers of a full model.

        Args:
            error: largest relative error, 0.01 for one per cent.
            of: quantity of the error, or several.
            full: the full model.

        Raises:
            ParameterError: for an error outside (0, 1) or an unknown quantity.
        """
        if not is_number(error) or not 0 < error < 1:
            raise ParameterError(f"error = {error!r} must lie in (0, 1): 0.01 is one per cent")
        if error < LEAST_ERROR:
            raise ParameterError(
                f"error = {error!r} of a wish is below {LEAST_ERROR:g}, to which answers of the "
                "full model are known themselves: ask for a larger one"
            )
        words = (of,) if isinstance(of, str) else tuple(of) if isinstance(of, Sequence) else ()
        outputs = (
            ()
            if full.functionals is None
            else tuple(functional.name for functional in full.functionals.items)
        )
        unknown = [word for word in words if word not in (*FALLBACK_ERRORS, *outputs)]
        if unknown or not words:
            names = ", ".join(repr(word) for word in (*FALLBACK_ERRORS, *outputs))
            raise ParameterError(
                f"of = {of!r} is no error that is known here: give one or several of {names}"
            )
        if PRESSURE in words and not _pressed(full.problem).any():
            raise ParameterError(
                f"no contact condition of scene '{full.scene.name}' has an area, so that nothing "
                "is known of pressures: ask for of='forces'"
            )
        return cls(float(error), tuple(dict.fromkeys(words)))

    @property
    def needs_fields(self) -> bool:
        """True if it includes displacements."""
        return DISPLACEMENT in self.of

    @property
    def elastic(self) -> bool:
        """True if it includes no output, which might need the stress."""
        return set(self.of) <= set(FALLBACK_ERRORS)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Outputs that it includes."""
        return tuple(word for word in self.of if word not in FALLBACK_ERRORS)

    def ask(self, model: AnsweringModel) -> Callable[[np.ndarray], None]:
        """Query of a point, (P,), that evaluates the quantities of the target, to be timed."""

        def query(point: np.ndarray) -> None:
            answer = model.solve(point, outside="ignore")
            answer.forces()
            if self.needs_fields:
                answer.displacement()
            if self.outputs:
                answer.outputs()

        return query


Exact = Answer | History
"""Answer of the full model to a point, or the history of a path."""


def steps_of(exact: Exact) -> Sequence[Answer]:
    """One answer, or those of all steps."""
    return exact.answers if isinstance(exact, History) else (exact,)


class TargetErrors:
    """Errors of models in the norms of a target, against answers of the full model."""

    def __init__(self, target: Target, full: FullOrderModel):
        self.target = target
        self._problem = full.problem
        self._pressed = _pressed(full.problem)
        self._floors = dict.fromkeys(target.of, 0.0)
        self._last: tuple[np.ndarray, ContactProblem] | None = None
        functionals = () if full.functionals is None else full.functionals.items
        self._sums = {
            functional.name: functional
            for functional in functionals
            if isinstance(functional, Linear)
        }

    def know(self, exact: Sequence[Exact]) -> None:
        """Update smallest denominators from exact answers.

        They are a thousandth of the largest value.
        """
        for name in self.target.of:
            sizes = [self._largest(name, answer) for query in exact for answer in steps_of(query)]
            self._floors[name] = max(self._floors[name], FORCE_FLOOR * max(sizes, default=0.0))

    def of(self, found: Sequence[Answer], exact: Exact) -> np.ndarray:
        """Errors of the answers of a model to one query, in the order of the target.

        Infinite if one is missing.

        Args:
            found: answers of the model along the query.
            exact: exact answer, or history.
        """
        steps = steps_of(exact)
        if len(found) != len(steps) or not all(answer.converged for answer in found):
            return np.full(len(self.target.of), math.inf)
        return np.array([self._relative(name, found, steps) for name in self.target.of])

    def forces_off(self, worst: np.ndarray) -> bool:
        """True if contact forces may miss the target, by the largest errors of each norm."""
        errors = dict(zip(self.target.of, worst.tolist(), strict=True))
        seen = [errors[name] for name in ("forces", PRESSURE) if name in errors]
        return not seen or max(seen) > self.target.error

    def _relative(self, name: str, found: Sequence[Answer], exact: Sequence[Answer]) -> float:
        error = 0.0
        size = self._floors[name]
        for answer, reference in zip(found, exact, strict=True):
            exact_value = self._read(name, reference)
            error = max(error, self._size(name, reference, self._read(name, answer) - exact_value))
            size = max(size, self._size(name, reference, exact_value))
        if not math.isfinite(error):
            return math.inf
        relative = error / size if size > 0 else math.inf if error > 0 else 0.0
        if name in FALLBACK_ERRORS or relative <= self.target.error:
            return relative
        # an output that vanishes up to round-off, as a closed gap does, has no size to compare with
        return (
            0.0
            if error <= max(self._round_off(name, reference) for reference in exact)
            else relative
        )

    def _round_off(self, name: str, answer: Answer) -> float:
        """Change of an output of an exact answer by round-off of displacements and forces.

        Round-off is relative to the largest of these.
        """
        dice = np.random.default_rng(0)
        value = answer.outputs()[name]

        def disturbed(values: np.ndarray) -> np.ndarray:
            size = FULL_ORDER_ROUND_OFF * float(np.abs(values).max(initial=0.0))
            return values + size * dice.choice([-1.0, 1.0], values.shape)

        changes = []
        for _ in range(3):
            changed = answer._replace(
                unknown=disturbed(answer.unknown), multipliers=disturbed(answer.multipliers)
            )
            changes.append(abs(changed.outputs()[name] - value))
        return max(changes)

    def _read(self, name: str, answer: Answer) -> np.ndarray:
        """Quantity of the target, for one answer."""
        if name == DISPLACEMENT:
            return answer.displacement()
        if name not in FALLBACK_ERRORS:
            return np.array(answer.outputs()[name])
        forces = answer.forces()
        if name != PRESSURE:
            return forces
        # with variable shapes, the areas at the point of the answer
        problem = self._problem if self._problem.reshaped is None else self._at(answer.parameter)
        return forces[self._pressed] / problem.contact_areas[self._pressed]

    def _size(self, name: str, answer: Answer, values: np.ndarray) -> float:
        if name == DISPLACEMENT:
            stiffness = self._at(answer.parameter).stiffness
            return math.sqrt(max(values @ (stiffness @ values), 0.0))
        return (
            float(np.linalg.norm(values))
            if name == "forces"
            else float(np.abs(values).max(initial=0.0))
        )

    def _at(self, point: np.ndarray) -> ContactProblem:
        """The problem at a point; the last one is kept for further queries there."""
        if not self._problem.varies:
            return self._problem
        if self._last is None or not np.array_equal(self._last[0], point):
            self._last = point, self._problem.at(point)
        return self._last[1]

    def _largest(self, name: str, answer: Answer) -> float:
        """Size of an exact answer.

        For an output that is a sum, with absolute values of its terms.
        """
        size = self._size(name, answer, self._read(name, answer))
        total = self._sums.get(name)
        if total is None:
            return size
        sizes = abs(total.matrix(self._problem.free.size)) @ np.abs(answer.displacement())
        return max(
            size,
            float(np.abs(total.weights) @ np.abs(answer.forces()[total.conditions]) + sizes.sum()),
        )


def _pressed(problem: ContactProblem) -> np.ndarray:
    """Conditions with a pressure, (N_lambda,) bool: those along a normal that have an area."""
    return (problem.contact_areas > 0) & problem.pressing
