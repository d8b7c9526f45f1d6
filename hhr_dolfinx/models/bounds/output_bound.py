"""Bounds of the errors of outputs.

Any forces λ' >= 0 and the field u' in equilibrium with them are off by |λ' - Λ|_S = |u' - U|_K <= ε, see
:mod:`hhr_dolfinx.models.bounds.error_bound`; λ' are those of the contact problem on S, solved from the statuses of the
answer, so that ε is round-off. As u' - U = -K^-1 B^T (λ' - Λ), an output J is a function of forces alone there, and
with J', its value at (u', λ'),

    |J - J(U, Λ)| <= |J - J'| + L ε,       L a Lipschitz constant of J' as a function of λ' in the S norm.

The first part is known. It is the residual of the answer tested by the adjoint solution, for J = l·u that is
z·(loads θ - K û - B^T λ') with K z = l. Of an output l·u + w·λ, L = |w - B z|_{S^-1}; of a largest value L is the
largest of those it is taken of. An output of very many rows, such as von Mises' stress of a whole body, would need all
of them for J': its error is bounded by what it changes at most per energy of the displacement and per S norm of the
forces, times their bounds.

An output that jumps, such as the area under load, has no such constant, and no bound.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from scipy.linalg import solve_triangular

from hhr_dolfinx.declared import Floats
from hhr_dolfinx.models.bounds.error_bound import ROUND_OFF, ErrorBound
from hhr_dolfinx.models.estimates import Estimate
from hhr_dolfinx.models.functionals.functional import Functional, Functionals, State

if TYPE_CHECKING:
    from hhr_dolfinx.models.answer import Answer

MOST_ENTRIES = 4_000_000
"""Rows of an output times contact conditions up to which it is read at the field that is nearer, too: 32 MB."""
UNKNOWN = -1.0
"""In the place of a Lipschitz constant that does not exist, or is not needed."""


class OutputErrors(Mapping[str, float]):
    """Bounds by the names of outputs, evaluated when one is first read: most who ask for an estimate read none.

    Args:
        evaluated: makes them.
    """

    def __init__(self, evaluated: Callable[[], dict[str, float]]):
        self._evaluated = evaluated

    @cached_property
    def _values(self) -> dict[str, float]:
        return self._evaluated()

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        return repr(self._values)

    def __reduce__(self) -> tuple:
        """Copy and pickle as what they are."""
        return dict, (self._values,)


def is_read_nearer(item: Functional, conditions: int) -> bool:
    """Whether an output is read at the field that is nearer, too, given the number of contact conditions."""
    return item.affine or item.count * conditions <= MOST_ENTRIES


@dataclass(frozen=True)
class OutputBound:
    """Arrays of the bounds of n outputs where the stiffness is constant (m conditions, 1 + T terms).

    Attributes:
        steepness: Lipschitz constants of each output per energy norm of the displacement, and per S norm of the
            forces, (n, 2). Of those that are read at the nearer field the second is that of J', and the first not
            needed; affine ones need neither. :data:`UNKNOWN` in their place; both are of an output without a bound.
        free: rows of the outputs that are read at the nearer field, times the displacement without contact forces,
            (K', 1 + T).
        pressed: the same rows times K^-1 B^T, (K', m).
        least: a thousandth of the largest absolute value in training of each output, over which a relative error is
            taken at least, (n,).
    """

    steepness: Annotated[Floats, "outputs", "2"]
    free: Annotated[Floats, "output rows", "terms"]
    pressed: Annotated[Floats, "output rows", "N_lambda"]
    least: Annotated[Floats, "outputs"]

    def knows(self, number: int, item: Functional) -> bool:
        """Whether an output has a bound."""
        per_energy, per_force = self.steepness[number].tolist()
        if is_read_nearer(item, self.pressed.shape[1]):
            return item.affine or per_force != UNKNOWN
        return per_energy != UNKNOWN

    def least_of(self, functionals: Any, name: str) -> float:
        """The least size of an output by its name."""
        return float(self.least[[item.name for item in functionals.items].index(name)])

    def fits(self, functionals: Any) -> bool:
        """Whether these may be bounds of some outputs: sizes, and constants that are not negative."""
        rows = sum(item.count for item in functionals.items if is_read_nearer(item, self.pressed.shape[1]))
        known = (self.steepness >= 0) | (self.steepness == UNKNOWN)
        count = len(functionals.items)
        positive = bool(known.all() and (self.least >= 0).all())
        return (
            self.steepness.shape == (count, 2) and self.least.shape == (count,) and positive and len(self.free) == rows
        )

    def errors(self, fields: Any, answer: Answer, forces: np.ndarray, estimate: Estimate) -> OutputErrors:
        """Bounds at an answer.

        Args:
            fields: what completes it, a :class:`~hhr_dolfinx.models.reconstruct.Reconstruction` with a bound.
            answer: one that converged.
            forces: as they are handed out, (m,).
            estimate: bounds of displacement and forces.
        """
        return OutputErrors(lambda: self._evaluated(fields, answer, forces, estimate))

    def _evaluated(self, fields: Any, answer: Answer, forces: np.ndarray, estimate: Estimate) -> dict[str, float]:
        """Bounds by name."""
        bound: ErrorBound = fields.bound
        functionals: Functionals = fields.functionals
        given = fields.amplitudes(answer.parameter)
        theta = np.zeros(self.free.shape[1])
        theta[given.terms] = given.values
        pushing = np.maximum(forces, 0.0)[None]
        free_slack = (bound.free_slack @ given)[None]
        found, _, left = bound.response.settled(pushing, free_slack, pushing @ bound.schur)
        better = found[0]
        off = float(left[0])
        size = math.sqrt(max(better @ (bound.schur @ better), 0.0))
        own = fields.measured(answer, theta)
        free = self.free @ theta
        near = free - self.pressed @ better
        nothing = np.zeros_like(better)
        rows = self._rows(functionals)

        def state(pushed: np.ndarray, moved: np.ndarray) -> State:
            return State(pushed, moved, answer.parameter, theta, answer.stress)

        affine = [(k, state(better, near[rows[k]])) for k, item in enumerate(functionals.items) if item.affine]
        slopes = self._slopes(functionals, affine, rows, bound.lower)
        errors: dict[str, float] = {}
        for k, (item, place) in enumerate(zip(functionals.items, functionals.places, strict=True)):
            per_energy, per_force = self.steepness[k].tolist()
            if not self.knows(k, item):
                continue
            if k not in rows:
                errors[item.name] = per_energy * estimate.primal + per_force * estimate.dual
                continue
            steep = slopes.get(k, per_force)
            value = item.value(state(forces, own[place]))
            nearer = item.value(state(better, near[rows[k]]))
            sizes = abs(value) + abs(nearer) + abs(item.value(state(nothing, free[rows[k]]))) + steep * size
            errors[item.name] = abs(value - nearer) + steep * off + ROUND_OFF * sizes
        return errors

    def _rows(self, functionals: Functionals) -> dict[int, slice]:
        """Rows of each output that is read at the nearer field, among those of all of them, by its place."""
        rows = {}
        first = 0
        for k, item in enumerate(functionals.items):
            if is_read_nearer(item, self.pressed.shape[1]):
                rows[k] = slice(first, first + item.count)
                first += item.count
        return rows

    def _slopes(
        self, functionals: Functionals, affine: list[tuple[int, State]], rows: dict[int, slice], lower: np.ndarray
    ) -> dict[int, float]:
        """Lipschitz constants of affine outputs at some states, as functions of forces, in the S norm, by place."""
        along = np.zeros((len(lower), len(affine)))
        for column, (k, state) in zip(along.T, affine, strict=True):
            slopes = functionals.items[k].slopes(state)
            np.add.at(column, slopes.conditions, slopes.forces)
            column -= self.pressed[rows[k]].T @ slopes.measured
        sizes = np.linalg.norm(solve_triangular(lower, along, lower=True, check_finite=False), axis=0)
        return {k: float(size) for (k, _), size in zip(affine, sizes, strict=True)}
