"""Exact condensation on the contact conditions.

The baseline without reduction error while the stiffness is constant.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.linear.dense import Factorise, LapackCholesky, dense_factors
from hhr_dolfinx.models.condensed import CondensedModel
from hhr_dolfinx.models.eliminations.constant import ConstantElimination
from hhr_dolfinx.models.eliminations.elimination import Responses
from hhr_dolfinx.models.exact import ExactFields, SolvedFields
from hhr_dolfinx.models.full import FullModel, plain_outputs
from hhr_dolfinx.models.starts import KnownStatuses
from hhr_dolfinx.reduction.kinds import kind_of
from hhr_dolfinx.reduction.reductor import CondensationSettings, Reductor, Task

SOLVED_STATUSES = 64
"""Points whose statuses are solved in advance on S, without snapshots."""


@dataclass(frozen=True)
class ExactCondensation(Reductor[Task]):
    """Exact condensation, see :func:`exact_condensation`."""

    field: bool = False
    method: ClassVar[str] = "condensed"
    own_range: ClassVar[bool] = True

    @classmethod
    def usual(cls, settings: CondensationSettings, *, fields: bool | None) -> ExactCondensation:
        """See :meth:`~hhr_dolfinx.reduction.reductor.Reductor.usual`; settings have no effect.

        Args:
            settings: without effect.
            fields: compute displacements with each answer; None for False.
        """
        return cls(bool(fields))

    def not_by_rows(self, task: Task) -> str:
        """One rank must have the kernel of K."""
        return "contact alone holds bodies" if task.full.problem.held_by_contact else ""

    def attempt(self, prepared: Task, level: int) -> tuple[CondensedModel, None]:
        """The model.

        Args:
            prepared: input of the reduction.
            level: not used.
        """
        full = prepared.full
        statuses = prepared.kind.statuses(prepared.snapshots, lambda: _known_statuses(full))
        return exact_condensation(full, statuses, field=self.field), None

    def compare(self, task: Task, model: CondensedModel) -> tuple[None, None]:
        """Nothing: the driver compares the claim of exactness.

        Args:
            task: input of the reduction.
            model: model that was built.
        """
        return None, None


def exact_condensation(
    full: FullModel,
    known: KnownStatuses,
    *,
    field: bool = True,
    factorise: Factorise = dense_factors,
) -> CondensedModel:
    """Eliminate everything but the contact forces exactly; for constant stiffness only.

    The answer is that of the full model, to round-off. Where the full model has no room for the
    columns of K^-1 B^T, or several ranks have parts of them, neither has this one: a displacement
    takes one more solution, for which all ranks ask together.

    Args:
        full: the full model; on one rank where contact alone holds bodies.
        known: statuses of the training points, (S, N_lambda).
        field: compute the displacement with each answer; without it only on request, and
            a query costs less.
        factorise: factors a dense block of S, which is symmetric; not used if contact alone holds
            bodies.

    Raises:
        SceneError: if the stiffness depends on parameters, the statuses are not those of the scene,
            or ranks share bodies that contact alone holds.
        ReductionError: for bodies with laws.
    """
    problem = full.problem
    rows = problem.spread
    floats = problem.held_by_contact
    problem.require_parts("condensation")
    if floats and not rows.all_here:
        raise SceneError(
            "contact alone holds bodies: give a full model on MPI.COMM_SELF, whose motions one "
            "rank knows"
        )
    kind_of(full).require_linear("no condensation is exact")
    if problem.varies:
        raise SceneError(
            f"the stiffness of scene '{full.scene.name}' depends on parameters, and no "
            "condensation is exact then: interpolate it, training.condense()"
        )
    conditions = len(problem.gaps)
    if (
        not isinstance(known, KnownStatuses)
        or known.active.shape[1:] != (conditions,)
        or not known.active.size
    ):
        raise SceneError(
            f"known, a {type(known).__name__}, must hold statuses of the {conditions} conditions "
            "of this scene at one point or more: snapshots.known_statuses()"
        )
    free = rows.whole(full.per_load)
    # only the field gives the motions of bodies that contact alone holds
    has_columns = full.keeps_columns and rows.all_here
    field = (field and has_columns) or floats
    responses = Responses(
        free_primal=free if field else free[:0],
        primal_per_force=full.per_force if field else np.zeros((0, conditions)),
        free_slack=problem.gaps - problem.contact @ free,
        schur=full.schur,
    )
    made = _exact_fields if has_columns or floats else _solved_fields
    fields = made(full, free)
    if floats and problem.kernel is not None:
        eliminated = problem.kernel.exact(problem, responses)
    else:
        eliminated = ConstantElimination(responses, problem.amplitudes, factorise)
    return CondensedModel(
        problem.parameters, eliminated, known, fields, problem.contact_pairs, law=problem.law
    )


def _exact_fields(full: FullModel, free: np.ndarray) -> ExactFields:
    """Fields of a full model that keeps its columns, from K^-1 loads, (N, 1 + T)."""
    problem = full.problem
    return ExactFields(
        amplitudes=problem.amplitudes,
        lifts=problem.lifts,
        per_force=full.per_force,
        per_term=free,
        dimension=problem.block_size,
        floats=problem.held_by_contact,
        stress_of=full.stress_of,
        functionals=plain_outputs(full),
        full=full,
    )


def _solved_fields(full: FullModel, free: np.ndarray) -> SolvedFields:
    """Fields of a full model that keeps no columns, from K^-1 loads, (N, 1 + T)."""
    problem = full.problem
    outputs = plain_outputs(full)
    rows = csr_matrix((0, problem.free.size)) if outputs is None else csr_matrix(outputs.rows)
    read = rows if full.has_room(rows.shape[0]) else rows[:0]
    return SolvedFields(
        amplitudes=problem.amplitudes,
        lifts=problem.lifts,
        per_term=free,
        dimension=problem.block_size,
        measured_per_force=np.ascontiguousarray(-full.pressed(read)),
        response_to_forces=full.pushed_everywhere,
        stress_of=full.stress_of,
        functionals=outputs,
        full=full,
    )


def _known_statuses(full: FullModel) -> KnownStatuses:
    """Statuses at some points of the box, solved on S."""
    from hhr_dolfinx.sampling import Sobol

    problem = full.problem
    nothing = KnownStatuses(problem.middle[None], np.zeros((1, len(problem.gaps)), dtype=bool))
    model = exact_condensation(full, nothing, field=False, factorise=LapackCholesky)
    points = Sobol(SOLVED_STATUSES).points(problem.parameters)
    known = KnownStatuses.solved(
        lambda point, start: model.solve(point, start=start, raise_on_failure=False), points
    )
    return known or nothing
