"""Measurements of a model, at single points or along histories: errors against the full model, and
times.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from hhr_dolfinx.amplitudes import Theta
from hhr_dolfinx.certify.accuracy import (
    Residuals,
    contact_residuals,
    energy_minimum,
    force_floor,
    norm,
    of_size,
    relative_error,
    summary,
)
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import ConvergenceError, NotSolvableError, OutsideTrainingWarning
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.models.answer import History, Model, ModelFields
from hhr_dolfinx.models.reconstruct import Reconstruction
from hhr_dolfinx.snapshots.records import Lost, Progress, SnapshotSet, compute_snapshots
from hhr_dolfinx.warn import ignored

Report = dict[str, Any]
"""A report, or a part of one: plain values by their keys, see docs/studies.md."""


@dataclass(frozen=True)
class MeasuredErrors:
    """Errors by name at every point or history, (n,) each, infinite without an answer, and where
    there is one, (n,).

    ``residuals`` is the ``kkt`` part of a report, ``counts`` has other counts by name.
    """

    values: dict[str, np.ndarray]
    answered: np.ndarray
    residuals: dict[str, float]
    counts: Mapping[str, int] = field(default_factory=dict)

    @property
    def unanswered(self) -> int:
        """Number of points without an answer."""
        return int((~self.answered).sum())

    def summaries(self) -> Report:
        """The ``errors`` part of a report."""
        return {name: summary(values) for name, values in self.values.items()} | dict(self.counts)


@dataclass(frozen=True)
class Row:
    """A method of the work-precision table with a setting.

    Seconds of its answers, (n,), and their errors.
    """

    method: str
    setting: str
    seconds: np.ndarray
    errors: MeasuredErrors

    def as_report(self) -> Report:
        """Row of ``work_precision``: medians, and the tails."""
        row = {
            "method": self.method,
            "setting": self.setting,
            "online_s": float(np.median(self.seconds)),
            "unconverged": self.errors.unanswered,
        }
        for name in ("primal_l2", "dual_full_floored"):
            figures = summary(self.errors.values[name])
            row |= {
                name: figures["median"],
                f"{name}_p95": figures["p95"],
                f"{name}_max": figures["max"],
            }
        return row


@dataclass(frozen=True)
class Measurement:
    """Measurements of the model under study, and a function that measures others in the same
    way.
    """

    own: Row  #: errors and seconds of the model under study
    others: Sequence[Row]  #: those of other methods on the same queries in turns
    beside: Callable[
        [str, str, Model], Row
    ]  #: measures another model, given its method, its setting and the model
    report: (
        Report  # parts that only this kind of measurement has, ``times`` and ``ratios`` among them
    )
    skipped: Sequence[dict[str, str]] = ()  #: items left out, with reasons
    #: further data for pictures: the full and the reduced history at the last test; empty for
    #: points
    drawn: tuple[History, ...] = ()
    #: rows of the work-precision table of methods that were refused, each with the reason
    refused: Sequence[Report] = ()
    #: small models under their names in the advice, ``hhr`` and ``condensed``
    models: Mapping[str, Model] = field(default_factory=dict)


def conditions_inside(model: Model | ModelFields) -> np.ndarray | None:
    """Contact conditions in the RID of a model, or of the fields of an answer, if it has one."""
    fields = getattr(model, "fields", model)
    return fields.A_lambda if isinstance(fields, Reconstruction) else None


Pair = tuple[np.ndarray, np.ndarray]
"""Displacement (N,) and contact forces (N_lambda,) on the whole mesh."""


def answer_errors(
    problem: ContactProblem,
    answer: Pair,
    exact: Pair,
    theta: Theta,
    floor: float,
    inside: np.ndarray | None = None,
) -> dict[str, float]:
    """Relative errors of displacement and forces against exact ones.

    ``*_floored`` divides by at least ``floor``, since a relative error is not meaningful near
    grazing contact. ``dual_full`` covers the whole contact surface, ``dual_rid`` the conditions
    ``inside`` the RID.

    Args:
        problem: contact problem at the point.
        answer: displacement, (N,), and forces, (N_lambda,).
        exact: those of the full model.
        theta: amplitudes θ of the load terms at the point.
        floor: least denominator of relative errors of forces.
        inside: conditions inside the RID; None without a RID.

    Returns:
        Errors by name.
    """
    size = max(problem.doubled_energy(exact[0] - problem.lifts @ theta, theta), 0.0) ** 0.5
    errors = {
        "primal_l2": relative_error(answer[0], exact[0], problem.mass),
        "primal_energy": of_size(norm(answer[0] - exact[0], problem.stiffness), size),
        "primal_euclid": relative_error(answer[0], exact[0]),
    }
    subsets: Report = {} if inside is None else {"dual_rid": inside}
    for name, rows in (subsets | {"dual_full": slice(None)}).items():
        errors[name] = relative_error(answer[1][rows], exact[1][rows])
        errors[f"{name}_floored"] = relative_error(answer[1][rows], exact[1][rows], floor=floor)
    return errors


@dataclass(frozen=True)
class References:
    """Full-order solutions of a problem at test points, with which approximations are compared.

    ``floor`` is the force norm below which a relative error is not meaningful.
    """

    problem: ContactProblem
    solutions: SnapshotSet
    floor: float

    @classmethod
    def at(
        cls,
        points: np.ndarray,
        full_order: FullOrderModel,
        training: SnapshotSet,
        progress: Progress = iter,
    ) -> References:
        """Solve the full model at test points, (n, P); the floor is that of its training solutions.

        Points without an answer are left out, with a warning.

        Args:
            points: test points, (n, P).
            full_order: the full model.
            training: training solutions.
            progress: wraps an iterable for a progress bar.
        """
        lost = Lost()
        solutions = compute_snapshots(full_order, points, progress, lost=lost)
        lost.warn(len(points), 1, "test points")
        return cls(full_order.problem, solutions, force_floor(full_order.problem, training))

    def errors(self, model: Model) -> MeasuredErrors:
        """Errors of any model with ``solve(mu)`` on the whole mesh at every point, see
        :func:`answer_errors`.
        """
        rows: list[dict[str, float] | None] = []
        residuals = []
        solutions = self.solutions
        problem = self.problem
        false_contact = 0
        conditions = conditions_inside(model)
        for point, homogeneous, forces in zip(
            solutions.points, solutions.displacements.T, solutions.forces.T, strict=True
        ):
            try:
                # a study leaves the training range on purpose and reports the result
                with ignored(OutsideTrainingWarning):
                    solution = model.solve(point)
                    answer = solution.displacement(), solution.forces()
            except (ConvergenceError, NotSolvableError):
                rows.append(None)
                continue
            theta = problem.theta(point)
            exact = homogeneous + problem.lifts @ theta, forces
            problem_at = problem.at(point)
            energies = [energy_minimum(problem_at, field, theta) for field in (answer[0], exact[0])]
            # each local model has a different RID
            row = answer_errors(
                problem_at, answer, exact, theta, self.floor, conditions_inside(solution.fields)
            )
            rows.append({**row, "energy_minimum": abs(energies[0] - energies[1])})
            residuals.append(asdict(contact_residuals(problem_at, *answer, theta)))
            false_contact += bool(((answer[1] > self.floor) & (forces == 0)).any())
        answered = np.array([row is not None for row in rows])
        norms = ("dual_full",) if conditions is None else ("dual_rid", "dual_full")
        names = ["primal_l2", "primal_energy", "primal_euclid", "energy_minimum"]
        names += [name for norm in norms for name in (norm, f"{norm}_floored")]
        values = {
            name: np.array([np.inf if row is None else row[name] for row in rows]) for name in names
        }
        kkt = {
            name: max((row[name] for row in residuals), default=np.inf)
            for name in Residuals.__dataclass_fields__
        }
        counts = {"points_with_false_contact": false_contact, "unconverged": int((~answered).sum())}
        return MeasuredErrors(values, answered, kkt, counts)
