"""Errors of any approximation against the full order at many points; no point is dropped."""

from __future__ import annotations

import warnings
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hhr_dolfinx.certify.accuracy import Residuals, contact_residuals, energy_minimum, force_floor
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import ConvergenceError, NotSolvableError, OutsideTrainingWarning
from hhr_dolfinx.models.answer import Model
from hhr_dolfinx.snapshots.lost import Lost
from hhr_dolfinx.snapshots.records import Progress, SnapshotSet, compute_snapshots
from hhr_dolfinx.study.measure import Errors, answer_errors, conditions_inside

NAMES = ("primal_l2", "primal_energy", "primal_euclid", "energy_minimum",
         "dual_rid", "dual_rid_floored", "dual_full", "dual_full_floored")  # fmt: skip


@dataclass(frozen=True)
class References:
    """Full-order solutions at test points, beside which approximations are measured.

    Attributes:
        problem: the full problem.
        solutions: of the full model.
        floor: force norm below which a relative error means nothing.
    """

    problem: ContactProblem
    solutions: SnapshotSet
    floor: float

    @classmethod
    def at(cls, points: np.ndarray, full_order: Any, training: SnapshotSet, progress: Progress = iter) -> References:
        """Solve the full model at test points, (n, P); the floor is that of its training solutions.

        Points without an answer are left out, with a warning.
        """
        lost = Lost()
        solutions = compute_snapshots(full_order, points, progress, lost=lost)
        lost.warn(len(points), 1, "test points")
        return cls(full_order.problem, solutions, force_floor(full_order.problem, training))

    def errors(self, model: Model) -> Errors:
        """Errors of any model with ``solve(mu)`` on the whole mesh at every point, see :func:`answer_errors`."""
        rows: list[dict[str, float] | None] = []
        residuals, solutions, problem, false_contact = [], self.solutions, self.problem, 0
        inside = conditions_inside(model)
        for point, homogeneous, forces in zip(
            solutions.points, solutions.displacements.T, solutions.forces.T, strict=True
        ):
            try:
                with warnings.catch_warnings():
                    # a study asks on purpose; what it finds is what the report is for
                    warnings.simplefilter("ignore", OutsideTrainingWarning)
                    found = model.solve(point)
                    answer = found.displacement(), found.forces()
            except (ConvergenceError, NotSolvableError):
                rows.append(None)
                continue
            theta = problem.theta(point)
            exact = homogeneous + problem.lifts @ theta, forces
            there = problem.at(point)
            energies = [energy_minimum(there, field, theta) for field in (answer[0], exact[0])]
            # local models have a RID each
            row = answer_errors(there, answer, exact, self.floor, conditions_inside(found.fields))
            rows.append({**row, "energy_minimum": abs(energies[0] - energies[1])})
            residuals.append(asdict(contact_residuals(there, *answer, theta)))
            false_contact += bool(((answer[1] > self.floor) & (forces == 0)).any())
        answered = np.array([row is not None for row in rows])
        names = [name for name in NAMES if inside is not None or not name.startswith("dual_rid")]
        values = {name: np.array([np.inf if row is None else row[name] for row in rows]) for name in names}
        kkt = {name: max((row[name] for row in residuals), default=np.inf) for name in Residuals.__dataclass_fields__}
        counts = {"points_with_false_contact": false_contact, "unconverged": int((~answered).sum())}
        return Errors(values, answered, kkt, counts)
