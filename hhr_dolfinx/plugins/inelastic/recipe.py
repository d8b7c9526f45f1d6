"""Steps of a recipe for inelastic bodies, and the usual recipe."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from numbers import Real
from typing import Any

import numpy as np

from hhr_dolfinx.certify.compare import Comparison
from hhr_dolfinx.certify.trust import TrustLimits
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.parameters import is_whole
from hhr_dolfinx.plugins.inelastic.state import states_of
from hhr_dolfinx.reduction.modes import deim, pod
from hhr_dolfinx.reduction.recipe import (
    Deim,
    Enrich,
    ForceDeim,
    LoadNodes,
    Pod,
    Recipe,
    Rid,
    Truncated,
)
from hhr_dolfinx.snapshots.records import SnapshotSet


def nodes_of_values(
    problem: ContactProblem, fields: Sequence[np.ndarray], tolerance: float
) -> np.ndarray:
    """Nodes of the cells in which DEIM picks values of fields of Gauss points.

    Each cell has as many values. Fields of zeros pick none.

    Args:
        problem: contact problem of the full model.
        fields: one field of each state, (values,).
        tolerance: part of the squared sum that the POD leaves out.
    """
    if not any(field.any() for field in fields):
        return np.zeros(0, dtype=np.int64)
    values = np.stack(fields, axis=1)
    picked = deim(pod(values, tolerance)[0])
    return problem.cell_nodes[picked // (len(values) // len(problem.cell_nodes))].ravel()


@dataclass(frozen=True)
class StressDeim(Truncated):
    """Nodes of the cells in which DEIM picks Gauss points on a POD of the stress, section 6.2.3."""

    def nodes(
        self, problem: ContactProblem, snapshots: SnapshotSet, basis: np.ndarray
    ) -> np.ndarray:
        """See :class:`Nodes`; empty for elastic bodies.

        Args:
            problem: contact problem of the full model.
            snapshots: training answers.
            basis: modes of the displacement, (N, ell).
        """
        return nodes_of_values(
            problem, [gauss.stress.ravel() for gauss in states_of(snapshots)], self.tolerance
        )


@dataclass(frozen=True)
class FlowDeim(Truncated):
    """Nodes of the cells in which DEIM picks Gauss points on a POD of the cumulated plastic strain,
    section 6.2.3.
    """

    def nodes(
        self, problem: ContactProblem, snapshots: SnapshotSet, basis: np.ndarray
    ) -> np.ndarray:
        """See :class:`Nodes`; empty without plastic strain in training.

        Args:
            problem: contact problem of the full model.
            snapshots: training answers.
            basis: modes of the displacement, (N, ell).
        """
        return nodes_of_values(
            problem, [gauss.state.cumulated for gauss in states_of(snapshots)], self.tolerance
        )


@dataclass(frozen=True)
class Tangents:
    """Check of the projected tangents at training states of bodies with laws.

    Attributes:
        least: smallest real part allowed for the eigenvalues of V[A]^T K_T V relative to V^T K_T V.
            Of twenty recipes for the pellet all above 0.1 kept within 5 % of the displacement at
            every step; all below -0.2 left it at some step, by up to 26 %, or failed.
        states: training states of each history that are checked.
    """

    least: float = 0.1
    states: int = 4

    def __post_init__(self) -> None:
        if not is_whole(self.states, 1):
            raise ReductionError(
                f"states = {self.states} of Tangents must be a whole number from 1"
            )
        if not (isinstance(self.least, Real) and 0 <= self.least < 1):
            raise ReductionError(
                f"least = {self.least} of Tangents must lie in [0, 1): 1 is an RID of all cells"
            )


STRESS_ERROR = "stress"
PLASTIC_ERROR = "plastic strain"
"""Names of errors of bodies with laws."""


@dataclass(frozen=True)
class FlowLimits(TrustLimits):
    """Limits for inelastic bodies: those of elastic ones, and of the stress.

    Attributes:
        refuse_stress: error of the stress of load paths, on the whole mesh, over its largest norm,
            95th percentile; from 0.5 to 1.4 % in good models, 5 % if few points reconstruct the
            stress of bodies with many stiffnesses.
        refuse_plastic: the same of the cumulated plastic strain; 0.1 to 0.5 % in these models.
        warn_stress, warn_plastic: 95th percentile above which a warning is given.
        warn_estimate: largest estimate of a known step of a load path; other steps are
            distinguished if theirs is three times as large.
    """

    refuse_stress: float = 0.3
    refuse_plastic: float = 0.3
    warn_stress: float = 0.08
    warn_plastic: float = 0.05
    warn_estimate: float = 0.05

    @classmethod
    def of(cls, limits: TrustLimits) -> FlowLimits:
        """Limits of elastic bodies with the usual ones of the stress."""
        if isinstance(limits, FlowLimits):
            return limits
        return cls(**{limit.name: getattr(limits, limit.name) for limit in fields(limits)})

    def judged(
        self, comparison: Comparison
    ) -> Iterator[tuple[str, np.ndarray, float, float, float]]:
        """Errors of stress and plastic strain, too."""
        yield from super().judged(comparison)
        limits = {
            STRESS_ERROR: (self.refuse_stress, self.warn_stress),
            PLASTIC_ERROR: (self.refuse_plastic, self.warn_plastic),
        }
        for name, values in comparison.further.items():
            yield name, values, *limits[name], math.inf


@dataclass(frozen=True)
class FlowingRecipe(Recipe):
    """A recipe that checks tangents too.

    Attributes:
        tangents: check of the tangents of bodies with laws; None for none.
    """

    tangents: Tangents | None = Tangents()

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.tangents, Tangents | None):
            raise ReductionError(
                f"tangents = {self.tangents!r} of a recipe must be {Tangents | None}"
            )

    def as_it_is(self) -> FlowingRecipe:
        """Without this check, too."""
        return replace(
            self,
            trust=None,
            tangents=None,
            domain=replace(self.domain, most_layers=self.domain.layers),
        )


def tangents_of(recipe: Recipe) -> Tangents | None:
    """The check of tangents by a recipe.

    That of one for elastic bodies is the usual one, unless nothing is checked.
    """
    if isinstance(recipe, FlowingRecipe):
        return recipe.tangents
    return None if recipe.trust is None else Tangents()


def flowing(**changes: Any) -> FlowingRecipe:
    """Recipe for inelastic bodies, section 6.2.3: DEIM of stress and plastic strain too, a larger
    RID.
    """
    nodes = (Deim(), ForceDeim(1e-8), StressDeim(1e-9), FlowDeim(1e-6), LoadNodes())
    usual: dict[str, Any] = {
        "nodes": nodes,
        "domain": Rid(3, 8),
        "enrichment": Enrich(1.0),
        "trust": FlowLimits.of_histories(),
    }
    return FlowingRecipe(**({"basis": Pod(3e-10)} | usual | changes))
