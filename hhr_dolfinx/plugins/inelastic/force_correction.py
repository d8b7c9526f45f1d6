"""Indicator of the contact forces of histories, and better forces, by one defect correction of each
step.

The laws are evaluated at *all* Gauss points of the mesh, along the displacement of a small model;
their state is carried from step to step. With the resulting plastic strain ε_p held fixed, forces
follow from an elastic contact problem on all conditions,

    slack = s - B K^-1 ∫ G^T C ε_p + S λ >= 0,      λ >= 0,      S = B K^-1 B^T,

with the slack s of the elastic bodies alone. The distance of λ from the forces of the model ranks
their errors, which the residual of the stress does not, and λ is the better answer. It is no bound;
see docs/bounds.md.

Needs neither DOLFINx nor PETSc.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_matrix

from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, Status, active_set
from hhr_dolfinx.errors import NotSolvableError, ReductionError
from hhr_dolfinx.models.answer import History
from hhr_dolfinx.plain import Rebuilt
from hhr_dolfinx.plugins.inelastic.condensed_fields import PartFactors
from hhr_dolfinx.plugins.inelastic.strain import StrainOperator
from hhr_dolfinx.plugins.inelastic.update import Material


class CorrectedForces(NamedTuple):
    """Contact forces of one step, corrected once."""

    forces: np.ndarray  #: on all conditions, (m,)
    #: their distance from those of the model, an indicator of its error, in the unit of force
    error: float
    #: the same over the norm of these forces; infinite if bodies part that touch in the model
    relative: float


@dataclass(frozen=True)
class ForceCorrection(Rebuilt):
    """Arrays of the correction (N dofs, m conditions, T terms of θ, Q parts of the stiffness)."""

    operator: StrainOperator  #: strain at all Gauss points
    material: Material  #: elasticity and laws there
    #: strains without stress for each term of θ, sparse, (Gauss points * components, 1 + T)
    eigenstrains: csc_matrix
    amplitudes: Amplitudes  #: θ as a function of the parameters
    factors: PartFactors  #: moduli of the parts
    parts: np.ndarray  #: part that holds each dof, (N,)
    per_force: np.ndarray  #: K^-1 B^T in the middle of the box, (N, m)
    schur: np.ndarray  #: B K^-1 B^T of each part there, (Q, m, m)
    pressed: np.ndarray  #: B K^-1 F of each part, (Q, m, 1 + T)
    gaps: np.ndarray  #: gaps minus imposed displacements, (m, 1 + T)
    pairs: np.ndarray  #: number of the contact pair of each condition, (m,)

    @property
    def nbytes(self) -> int:
        """Memory of its large arrays."""
        return sum(item.nbytes for item in (self.operator.gradients, self.per_force, self.schur))

    def of(self, history: History) -> list[CorrectedForces]:
        """Corrected forces of each step of a history, by a full or small model of the same scene.

        Raises:
            ReductionError: for a history of another scene.
            NotSolvableError: if a corrected contact problem has no solution.
            ConvergenceError: if a law finds no flow.
        """
        return list(self._steps(history))

    def _steps(self, history: History) -> Iterator[CorrectedForces]:
        state = self.material.at_rest()
        time = history.start
        compliances = self.factors.compliances(
            history.parameter
        )  # elasticity is constant along a history
        elastic = SchurEqualities.symmetric(np.tensordot(compliances, self.schur, 1))
        for answer in history.answers:
            displacement = answer.displacement()
            forces = answer.forces()
            if displacement.shape != self.parts.shape or forces.shape != self.pairs.shape:
                raise ReductionError(
                    f"answers have {displacement.size} dofs and {forces.size} conditions, the "
                    f"correction {self.parts.size} and {self.pairs.size}: give histories of the "
                    "scene that it was made for"
                )
            theta = self.amplitudes(answer.parameter)
            material = self.material.at(answer.parameter)
            strain = self.operator.strain(displacement)
            if self.eigenstrains.nnz:
                strain = strain - (self.eigenstrains @ theta).reshape(strain.shape)
            state = material.update(strain, state, answer.time - time, tangent=False).state
            time = answer.time
            plastic_loads, _ = self.operator.internal(
                np.einsum("nij,nj->ni", material.elastic, state.inelastic)
            )
            slack = self.gaps @ theta - np.tensordot(compliances, self.pressed, 1) @ theta
            slack -= self.per_force.T @ (compliances[self.parts] * plastic_loads)
            # the elastic contact problem of the slack, from the statuses of the answer
            found = active_set(elastic, slack, forces > 0, pairs=self._pairs)
            if found.status is not Status.CONVERGED:
                raise NotSolvableError(
                    f"the corrected contact problem at t = {answer.time:g} s has no solution: "
                    f"{found.status.value}"
                )
            error = float(np.linalg.norm(found.forces - forces))
            size = float(np.linalg.norm(found.forces))
            relative = error / size if size > 0 else (np.inf if error > 0 else 0.0)
            yield CorrectedForces(found.forces, error, relative)

    @cached_property
    def _pairs(self) -> Pairs:
        return Pairs(self.pairs)
