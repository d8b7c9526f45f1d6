"""Elastic response of inelastic bodies, computed once, in the middle of the box, and modes of their
corrections.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg
from scipy.sparse import csc_matrix

from hhr_dolfinx.contact.kernel import Kernel
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.full import FullModel
from hhr_dolfinx.plugins.inelastic.condensed_fields import LooseBodies, PartFactors
from hhr_dolfinx.plugins.inelastic.full_order import equilibrium_of

SMALL_CORRECTION = 1e-3
"""Size of a correction, relative to the largest, above which its weight is the root of its size."""


@dataclass(frozen=True)
class ElasticResponse:
    """Elastic response in the middle of the box: columns of K^-1 F and of imposed displacements,
    parts of the dofs.

    Where contact alone holds bodies, it has none of their motions, and S is B K^+ B^T.
    """

    forced: np.ndarray
    given: np.ndarray
    per_force: np.ndarray
    parts: np.ndarray
    factors: PartFactors

    def condensed(self, problem: ContactProblem) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """S and B K^-1 F of each part, (Q, m, m) and (Q, m, 1 + T), and gaps minus imposed motion,
        (m, 1 + T).
        """
        masks = [
            (self.parts == number)[:, None] for number in range(max(len(self.factors.moduli), 1))
        ]
        schur = np.array([problem.contact @ np.where(mask, self.per_force, 0.0) for mask in masks])
        pressed = np.array([problem.contact @ np.where(mask, self.forced, 0.0) for mask in masks])
        return (
            (schur + schur.transpose(0, 2, 1)) / 2,
            pressed,
            problem.gaps - problem.contact @ self.given,
        )

    def correction(self, problem: ContactProblem, answer: Answer) -> np.ndarray:
        """u_p of a full answer, (N,).

        Args:
            problem: contact problem of the full model.
            answer: answer of the full model.
        """
        theta = problem.amplitudes(answer.parameter)
        scale = self.factors.compliances(answer.parameter)[self.parts]
        elastic = scale * (self.forced @ theta - self.per_force @ answer.multipliers)
        correction = answer.unknown - elastic - (self.given @ theta - problem.lifts @ theta)
        return (
            correction
            if problem.kernel is None
            else problem.kernel.without(problem.spread, correction)
        )

    def loose(self, problem: ContactProblem) -> LooseBodies | None:
        """Bodies that contact alone holds; None without any."""
        if problem.kernel is None or not problem.held_by_contact:
            return None
        motions = problem.kernel.motions
        return LooseBodies(
            problem.kernel.contact_of_motions, (problem.external.T @ motions).T, motions
        )


def elastic_response(full: FullModel) -> ElasticResponse:
    """Compute the elastic response in blocks, with the factors of the full model."""
    problem: ContactProblem = full.problem
    component_of_dof, factors = parts_of(problem)
    # strains without stress give all bodies the same displacement, however stiff they are
    strained = csc_matrix(problem.loads - problem.external + _eigenforces(full))
    forced = full.stiffness.columns(problem.external)
    imposed = full.stiffness.columns(strained)
    per_force = full.per_force
    if problem.kernel is not None and problem.held_by_contact:
        forced, per_force, imposed = _without_motions(
            full, problem.kernel, forced, per_force, imposed
        )
    return ElasticResponse(
        forced, imposed + problem.lifts.toarray(), per_force, component_of_dof, factors
    )


def _without_motions(
    full: FullModel, kernel: Kernel, forced: np.ndarray, per_force: np.ndarray, imposed: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Responses of pinned bodies, (N, k) each, made those by K^+, which does not depend on pins.

    The part of forces that would accelerate the bodies is removed, as are the motions in
    displacements. Imposed displacements and strains without stress do no work along motions.
    """
    problem: ContactProblem = full.problem
    motions = kernel.motions
    drawn = full.stiffness.columns(
        csc_matrix(problem.prolongation.restrict(motions) * problem.free[:, None])
    )
    forced = forced - drawn @ (problem.external.T @ motions).T
    per_force = per_force - drawn @ kernel.contact_of_motions.T
    return tuple(
        kernel.without(problem.spread, response) for response in (forced, per_force, imposed)
    )


def _eigenforces(full: FullModel) -> csc_matrix:
    """Forces on free dofs of strains without stress in the middle of the box, sparse, (N, 1 +
    T).
    """
    equilibrium = equilibrium_of(full)
    problem = full.problem
    elastic = equilibrium.material.moduli_at(problem.middle).elastic
    forces = np.zeros(problem.loads.shape)
    for term in np.flatnonzero(np.diff(equilibrium.eigenstrains.indptr)):
        strain = equilibrium.eigenstrains[:, [term]].toarray().reshape(len(elastic), -1)
        forces[:, term] = equilibrium.internal(np.einsum("nij,nj->ni", elastic, strain))[0]
    return csc_matrix(forces)


def parts_of(problem: ContactProblem) -> tuple[np.ndarray, PartFactors]:
    """Part of the stiffness of each dof, (N,), and the moduli of the parts.

    Raises:
        ReductionError: if parts are connected, and for moduli that are no factors.
    """
    if problem.reshaped is not None:
        raise ReductionError(
            "shapes of the scene are parameters, with which K^-1 and all strains of inelastic "
            "bodies change: give the shapes numbers, or take the full model"
        )
    if not problem.moduli:
        return np.zeros(problem.free.size, dtype=np.int64), PartFactors((), np.ones(1))
    if any(modulus.rest != "1" for modulus in problem.moduli):
        raise ReductionError(
            "Poisson's ratio of a body is a formula, by which volume and shape change apart, so "
            "that K^-1 is no factor times a constant: give it a number, or take the hyper-reduced "
            "model"
        )
    acting = np.array(
        [
            np.asarray(abs(stiffness_term).sum(axis=1)).ravel() > 0
            for stiffness_term in problem.stiffness_terms
        ]
    )
    acting = problem.prolongation.touched(acting.T).T
    if (acting.sum(axis=0) > 1).any():
        raise ReductionError(
            "connected bodies have Young's moduli that vary independently, so that K^-1 "
            "is no factor times a constant: give them one formula, or take the hyper-reduced model"
        )
    return acting.argmax(axis=0), PartFactors(
        tuple(problem.moduli), problem.weights(problem.middle)
    )


def correction_modes(
    problem: ContactProblem,
    corrections: np.ndarray,
    elastic: ElasticResponse,
    left_out: float,
    most: int | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Modes of corrections, orthonormal in energy, and the energy norm of each state.

    They leave out a part of the summed norm of all corrections, unless there would be more than
    ``most``. Each counts by the root of its size. By their sizes, corrections of training part
    loads were left out compared with those of full loads, and the remaining stress was 75 to 90 %
    wrong on a cantilever, 12 to 25 % on the pellet; by the root 2 to 3 and 1 %, with twice as many
    modes. With equal weights there were three times as many. If moduli vary, each part has separate
    modes: a mode across parts would have no definite energy.

    Args:
        problem: contact problem of the full model.
        corrections: corrections, (N, S).
        elastic: elastic response, for the part of each dof.
        left_out: part of their summed norm to leave out.
        most: largest number of modes; None for no limit.

    Returns:
        Modes, (N, ell), and norms, (S,).
    """
    sizes = np.sqrt(
        np.maximum(np.einsum("ns,ns->s", corrections, problem.stiffness @ corrections), 0.0)
    )
    weights = 1 / np.sqrt(
        np.maximum(sizes, SMALL_CORRECTION * sizes.max(initial=0.0)) + np.finfo(float).tiny
    )
    modes_and_values = []
    for number in np.unique(elastic.parts):
        weighted = np.where((elastic.parts == number)[:, None], corrections * weights, 0.0)
        modes_and_values.append(
            _energy_modes(problem, weighted, left_out * np.linalg.norm(sizes * weights))
        )
    values = np.concatenate([value for _, value in modes_and_values])
    modes = np.concatenate([columns for columns, _ in modes_and_values], axis=1)
    modes = modes[:, np.argsort(-values)[:most]]
    for _ in range(2):  # orthonormal in energy, to round-off
        lower = np.linalg.cholesky(modes.T @ (problem.stiffness @ modes))
        modes = linalg.solve_triangular(lower, modes.T, lower=True).T
    return np.ascontiguousarray(modes), sizes


def _energy_modes(
    problem: ContactProblem, columns: np.ndarray, left_out: float
) -> tuple[np.ndarray, np.ndarray]:
    """POD modes in energy that leave out a given norm, and their singular values."""
    squares, weights = linalg.eigh(columns.T @ (problem.stiffness @ columns))
    squares = np.maximum(squares[::-1], 0.0)
    weights = weights[:, ::-1]
    left_out_squares = np.append(np.cumsum(squares[::-1])[::-1], 0.0)
    noise = np.finfo(float).eps * len(squares) * (squares[0] if squares.size else 0.0)
    count = min(int(np.argmax(left_out_squares <= left_out**2)), int((squares > noise).sum()))
    values = np.sqrt(squares[:count])
    return columns @ (weights[:, :count] / np.where(values > 0, values, 1.0)), values
