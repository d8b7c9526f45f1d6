"""Elastic response of inelastic bodies: computed once, in the middle of the box, scaled elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csc_matrix

from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.plugins.inelastic.condensed_fields import PartFactors
from hhr_dolfinx.plugins.inelastic.full_order import equilibrium_of

if TYPE_CHECKING:
    from hhr_dolfinx.models.answer import Answer
    from hhr_dolfinx.models.full import FullModel


@dataclass(frozen=True)
class ElasticResponse:
    """Elastic response in the middle of the box: columns of K^-1 F and of imposed displacements, parts of the dofs."""

    forced: np.ndarray
    given: np.ndarray
    per_force: np.ndarray
    parts: np.ndarray
    factors: PartFactors

    def correction(self, problem: ContactProblem, answer: Answer) -> np.ndarray:
        """u_p of a full answer, (N,)."""
        theta = problem.amplitudes(answer.parameter)
        scale = self.factors.compliances(answer.parameter)[self.parts]
        elastic = scale * (self.forced @ theta - self.per_force @ answer.multipliers)
        return answer.unknown - elastic - (self.given @ theta - problem.lifts @ theta)


def elastic_response(full: FullModel) -> ElasticResponse:
    """Compute the elastic response in blocks, with the factors of the full model."""
    problem: ContactProblem = full.problem
    parts, factors = parts_of(problem)
    # strains without stress give all bodies the same displacement, however stiff they are
    strained = csc_matrix(problem.loads - problem.external + _eigenforces(full))
    forced = full.stiffness.columns(problem.external)
    imposed = full.stiffness.columns(strained)
    return ElasticResponse(forced, imposed + problem.lifts.toarray(), full.per_force, parts, factors)


def _eigenforces(full: FullModel) -> csc_matrix:
    """Forces on free dofs of strains without stress in the middle of the box, sparse, (N, 1 + T)."""
    equilibrium = equilibrium_of(full)
    problem = full.problem
    elastic = equilibrium.material.moduli_at(problem.middle).elastic
    forces = np.zeros(problem.loads.shape)
    for term in np.flatnonzero(np.diff(equilibrium.eigenstrains.indptr)):
        strain = equilibrium.eigenstrains[:, [term]].toarray().reshape(len(elastic), -1)
        forces[:, term] = equilibrium.operator.internal(np.einsum("nij,nj->ni", elastic, strain))[0] * problem.free
    return csc_matrix(forces)


def parts_of(problem: ContactProblem) -> tuple[np.ndarray, PartFactors]:
    """Part of the stiffness that holds each dof, (N,), and the moduli of the parts.

    Raises:
        ReductionError: if parts with different moduli are connected.
    """
    if not problem.moduli:
        return np.zeros(problem.free.size, dtype=np.int64), PartFactors((), np.ones(1))
    acting = np.array([np.asarray(abs(part).sum(axis=1)).ravel() > 0 for part in problem.stiffness_terms])
    if (acting.sum(axis=0) > 1).any():
        raise ReductionError(
            "bodies that hang together have Young's moduli that vary by themselves, so that K^-1 is no factor times a "
            "constant: give them one formula, or take the hyper-reduced model"
        )
    return acting.argmax(axis=0), PartFactors(tuple(problem.moduli), problem.weights(problem.middle))
