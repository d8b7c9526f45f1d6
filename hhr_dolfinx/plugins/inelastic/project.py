"""Stages that inelastic bodies add to the reduction: Gauss points of the RID, tangents."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy import linalg
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx.contact.problem import IndexSets
from hhr_dolfinx.errors import UnstableModelError
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.plugins.inelastic.full_order import FullOrderEquilibrium, equilibrium_of
from hhr_dolfinx.plugins.inelastic.recipe import tangents_of
from hhr_dolfinx.plugins.inelastic.reduced_flow import ReducedFlow
from hhr_dolfinx.plugins.inelastic.reduction import FittedFlow
from hhr_dolfinx.plugins.inelastic.state import rows_of
from hhr_dolfinx.plugins.inelastic.state import state as gauss_of
from hhr_dolfinx.reduction.build import Draft
from hhr_dolfinx.snapshots.records import SnapshotSet


def project_points(draft: Draft) -> None:
    """Gauss points of the RID."""
    shared = draft.shared
    with shared.log.stage("projection", shared.task.announce):
        draft.parts["flow"] = project_flow(equilibrium_of(shared.full), draft.basis, draft.sets)


def complete_flow(draft: Draft) -> None:
    """Completion of stress and plastic strain.

    The fields of training are decomposed once for all attempts.
    """
    shared = draft.shared
    with shared.log.stage("reconstruction", shared.task.announce):
        fitted = shared.once("fields of laws", lambda: FittedFlow.of(shared.snapshots))
        draft.fields = replace(draft.fields, flow=fitted.completion(draft.parts["flow"]))


def check_tangents(draft: Draft) -> None:
    """Smallest tangent margin at training states, if requested.

    1, that of the elastic operator, if all are elastic.

    Raises:
        UnstableModelError: if it is too small.
    """
    shared = draft.shared
    full = equilibrium_of(shared.full)
    step = tangents_of(shared.recipe)
    if step is None:
        return
    with shared.log.stage("training_tangents", shared.task.announce):
        states = shared.once(
            "tangents", lambda: training_tangents(full, shared.snapshots, step.states)
        )
    with shared.log.stage("stability", shared.task.announce):
        margin = min((tangent_margin(draft.model, *state) for state in states), default=1.0)
        if not margin > step.least:
            raise UnstableModelError(
                f"with {draft.layers} layers a projected tangent at a training state has an "
                f"eigenvalue of real part {margin:.2g}: steps would fail or follow a wrong path. "
                "Allow more layers or keep fewer modes"
            )
        draft.further["tangent"] = margin


def project_flow(full: FullOrderEquilibrium, basis: np.ndarray, sets: IndexSets) -> ReducedFlow:
    """Gauss points, laws and modes of the cells that act on A, (6.17).

    Args:
        full: equilibrium of the full model.
        basis: V, (N, ell).
        sets: index sets of the RID.
    """
    problem = full.problem
    operator = full.operator
    mask = np.zeros(problem.free.size, dtype=bool)
    mask[sets.A] = True
    follow = problem.prolongation.map
    mask = problem.prolongation.touched(
        mask
    )  # test functions are non-zero on dofs that follow those of A, too
    # cells of the RID without such a dof act on no test function
    cells = np.flatnonzero(mask[operator.dofs].any(axis=1))
    restricted, columns = operator.restricted(cells)
    inner = np.flatnonzero(mask[columns])
    acting = columns[inner]
    return ReducedFlow(
        operator=restricted,
        material=full.material.restricted(operator.points_of(cells)),
        cells=cells,
        modes=np.ascontiguousarray(basis[columns]),
        lifts=problem.lifts[columns],
        inner=inner,
        follow=None if follow is None else csr_matrix(follow[acting][:, acting]),
        springs=None if full.springs is None else full.springs[acting],
        loads=problem.external[acting],
        contact=csr_matrix(problem.contact[sets.A_lambda][:, acting].T),
        eigenstrains=csc_matrix(
            full.eigenstrains.tocsr()[rows_of(operator.points_of(cells), operator.components)]
        ),
    )


def training_tangents(
    full: FullOrderEquilibrium, snapshots: SnapshotSet, count: int
) -> list[tuple[np.ndarray, csr_matrix]]:
    """Tangents and stiffness at some training states of each history, the last among them.

    Args:
        full: equilibrium of the full model.
        snapshots: training answers.
        count: states of each history.
    """
    states: list[tuple[np.ndarray, csr_matrix]] = []
    for history in snapshots.histories if full.material.flows else ():
        steps = np.unique(np.linspace(0, len(history.answers), count + 1).astype(int)[1:])
        for step in steps[steps > 0] - 1:
            answer = history.answers[step]
            time = history.start
            state = full.material.at_rest()
            if step > 0:
                time = history.answers[step - 1].time
                state = gauss_of(history.answers[step - 1]).state
            strain = full.strain(answer.unknown, full.amplitudes(answer.parameter))
            material = full.material.at(answer.parameter)
            tangents: Any = material.update(
                strain, state, answer.time - time, tangent=True
            ).tangents
            states.append((tangents, full.at(answer.parameter).stiffness(tangents)))
    return states


def tangent_margin(model: ReducedModel, tangents: np.ndarray, stiffness: csr_matrix) -> float:
    """Smallest real part of the eigenvalues of V[A]^T K_T V relative to V^T K_T V.

    1 if the RID is the whole mesh.

    Args:
        model: hyper-reduced model.
        tangents: consistent tangents at all Gauss points of the full model.
        stiffness: its K_T, (N, N).

    Raises:
        UnstableModelError: if the tangent is singular on the basis.
    """
    reduced: Any = model.equilibrium
    r = reduced.problem.motions  # of bodies that contact alone holds: they have no stiffness
    basis = model.fields.basis[:, r:]
    full_tangent = basis.T @ (stiffness @ basis)
    projected = reduced.tangent(tangents[reduced.points])[r:, r:]
    try:
        return float(linalg.eigvals(np.linalg.solve(full_tangent, projected)).real.min())
    except (np.linalg.LinAlgError, ValueError) as error:
        raise UnstableModelError(
            f"the tangent at a training state is singular or not finite on the basis ({error}): "
            "keep fewer modes"
        ) from error
