"""Errors of any approximation against the full order at many points; no point is dropped."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import ConvergenceError, NotSolvableError
from hhr_dolfinx.snapshots.accuracy import energy_minimum, force_floor, relative_error, summary
from hhr_dolfinx.snapshots.solutions import SnapshotSet, compute_snapshots
from hhr_dolfinx.study.training import Training, silent


@dataclass(frozen=True)
class PointErrors:
    """Errors at every point, in the order of the points.

    Attributes:
        values: errors by name, (n,) each; infinite where there is no answer.
        false_contact: points with forces where the full order has none.
        unanswered: points without an answer.
    """

    values: dict[str, np.ndarray]
    false_contact: int
    unanswered: int

    def summaries(self) -> dict:
        """The ``errors`` part of a report."""
        counts = {"points_with_false_contact": self.false_contact, "unconverged": self.unanswered}
        return {**{name: summary(values) for name, values in self.values.items()}, **counts}


@dataclass(frozen=True)
class Yardstick:
    """What approximations are measured against.

    Attributes:
        problem: the full problem.
        references: full-order solutions at the test points.
        floor: force norm below which a relative error means nothing.
    """

    problem: ContactProblem
    references: SnapshotSet
    floor: float

    @classmethod
    def at(cls, points: np.ndarray, training: Training, progress=silent) -> Yardstick:
        """Solve the full model at test points, (n, P)."""
        problem = training.full_order.problem
        references = compute_snapshots(training.full_order, points, progress("references"))
        return cls(problem, references, force_floor(problem, training.snapshots))

    def errors(self, approximation, inside: np.ndarray | None = None) -> PointErrors:
        """Errors of an approximation.

        ``*_floored`` divides by at least 1e-3 of the largest training force norm, since a relative error means
        nothing near grazing contact. ``dual_full`` looks at the whole contact surface, ``dual_rid`` at the RID.

        Args:
            approximation: with ``solve_everywhere(mu)``, whose displacement (N,) and forces (N_lambda,) are compared.
            inside: conditions of its RID, if it has one.
        """
        rows, false_contact, references = [], 0, self.references
        for point, homogeneous, forces in zip(
            references.points, references.displacements.T, references.forces.T, strict=True
        ):
            try:
                answer = approximation.solve_everywhere(point)
            except (ConvergenceError, NotSolvableError):
                rows.append(None)
                continue
            exact = homogeneous + self.problem.lift(point), forces
            rows.append(self._row(answer, exact, point, inside))
            false_contact += bool(((answer[1] > self.floor) & (forces == 0)).any())
        names = next((row.keys() for row in rows if row is not None), ("primal_l2", "dual_full_floored"))
        values = {name: np.array([np.inf if row is None else row[name] for row in rows]) for name in names}
        return PointErrors(values, false_contact, sum(row is None for row in rows))

    def _row(self, answer, exact, point, inside) -> dict[str, float]:
        problem, floor, theta = self.problem, self.floor, self.problem.theta(point)
        energies = [energy_minimum(problem, field, theta) for field in (answer[0], exact[0])]
        row = {
            "primal_l2": relative_error(answer[0], exact[0], problem.mass),
            "primal_energy": relative_error(answer[0], exact[0], problem.stiffness),
            "primal_euclid": relative_error(answer[0], exact[0]),
            "energy_minimum": abs(energies[0] - energies[1]),
            "dual_full": relative_error(answer[1], exact[1]),
            "dual_full_floored": relative_error(answer[1], exact[1], floor=floor),
        }
        if inside is None:
            return row
        ours, theirs = answer[1][inside], exact[1][inside]
        return row | {
            "dual_rid": relative_error(ours, theirs),
            "dual_rid_floored": relative_error(ours, theirs, floor=floor),
        }
