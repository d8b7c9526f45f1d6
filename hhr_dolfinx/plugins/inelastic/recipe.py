"""Steps of a recipe for inelastic bodies, and the usual recipe."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hhr_dolfinx.certify.trust import TrustLimits
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.plugins.inelastic.state import states_of
from hhr_dolfinx.reduction.modes import deim, pod
from hhr_dolfinx.reduction.recipe import Deim, Enrich, ForceDeim, LoadNodes, Pod, Recipe, Rid, Truncated
from hhr_dolfinx.snapshots.records import SnapshotSet


def nodes_of_values(problem: ContactProblem, fields: Sequence[np.ndarray], tolerance: float) -> np.ndarray:
    """Nodes of the cells in which DEIM picks values of fields of Gauss points, as many in each cell; none of zeros."""
    if not any(field.any() for field in fields):
        return np.zeros(0, dtype=np.int64)
    values = np.stack(fields, axis=1)
    picked = deim(pod(values, tolerance)[0])
    return problem.cell_nodes[picked // (len(values) // len(problem.cell_nodes))].ravel()


@dataclass(frozen=True)
class StressDeim(Truncated):
    """Nodes of the cells in which DEIM picks Gauss points on a POD of the stress, section 6.2.3."""

    def nodes(self, problem: ContactProblem, snapshots: SnapshotSet, basis: np.ndarray) -> np.ndarray:
        """See :class:`Nodes`; empty for elastic bodies."""
        return nodes_of_values(problem, [item.stress.ravel() for item in states_of(snapshots)], self.tolerance)


@dataclass(frozen=True)
class FlowDeim(Truncated):
    """Nodes of the cells in which DEIM picks Gauss points on a POD of the cumulated plastic strain, section 6.2.3."""

    def nodes(self, problem: ContactProblem, snapshots: SnapshotSet, basis: np.ndarray) -> np.ndarray:
        """See :class:`Nodes`; empty without plastic strain in training."""
        return nodes_of_values(problem, [item.state.cumulated for item in states_of(snapshots)], self.tolerance)


def flowing(**changes: Any) -> Recipe:
    """Recipe for inelastic bodies, section 6.2.3: DEIM of stress and plastic strain too, a larger RID."""
    nodes = (Deim(), ForceDeim(1e-8), StressDeim(1e-9), FlowDeim(1e-6), LoadNodes())
    usual: dict[str, Any] = {
        "nodes": nodes,
        "domain": Rid(3, 8),
        "enrichment": Enrich(1.0),
        "trust": TrustLimits.of_histories(),
    }
    return Recipe(**({"basis": Pod(3e-10)} | usual | changes))
