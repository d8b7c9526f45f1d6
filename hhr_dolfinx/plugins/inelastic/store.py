"""Memory of inelastic bodies in files of snapshots: the facet ``store``, see
:mod:`hhr_dolfinx.snapshots.store`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

import numpy as np

from hhr_dolfinx.certify.accuracy import slack_residuals
from hhr_dolfinx.files import MAPPED_BYTES
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.full import FullModel
from hhr_dolfinx.plugins.inelastic.full_order import FullOrderEquilibrium, equilibrium_of
from hhr_dolfinx.plugins.inelastic.state import GaussState, state
from hhr_dolfinx.plugins.inelastic.update import Group
from hhr_dolfinx.snapshots.store import add_to


class StoredGauss:
    """Stress and state at Gauss points in files, see
    :class:`hhr_dolfinx.snapshots.store.StoredLaws`.
    """

    layout: Mapping[str, tuple[str, ...]] = {
        "stress": ("float", "points", "components"),
        "inelastic": ("float", "points", "components"),
        "cumulated": ("float", "points"),
        "memory": ("float", "points", "remembered"),
    }

    def __init__(self, full: FullModel):
        self._equilibrium = equilibrium_of(full)
        material = self._equilibrium.material
        self.sizes = {
            "points": material.gauss_points,
            "components": material.components,
            "remembered": material.remembered,
        }
        self._behaviours: dict[tuple, str] = {}

    def fingerprint(self) -> list[object]:
        """Points, elasticity and behaviour of each body, and eigenstrains."""
        groups = self._equilibrium.material.groups
        of_groups = (
            (group.indices, group.young, group.poisson, group.places, _identity(group))
            for group in groups
        )
        entries = [value for values in of_groups for value in values]
        entries += [group.grading for group in groups if group.grading.size]
        return entries + (
            [self._equilibrium.eigenstrains] if self._equilibrium.eigenstrains.nnz else []
        )

    def query(self, point: np.ndarray) -> list[str]:
        """Digests of the bodies with formulas: constants and modulus at a point, and what the law
        is with them.
        """
        material = self._equilibrium.material
        digests = []
        for body, constants in enumerate(material.constants(point)):
            if constants:
                key = body, *(np.asarray(value).tobytes() for value in constants.values())
                if key not in self._behaviours:
                    digest = hashlib.sha256()
                    add_to(
                        digest,
                        [list(constants.values()), *_identity(material.at(point).groups[body])],
                    )
                    self._behaviours[key] = digest.hexdigest()
                digests.append(self._behaviours[key])
        return digests

    def arrays(self, answer: Answer) -> dict[str, np.ndarray]:
        """Stress and state."""
        gauss = state(answer)
        return {"stress": gauss.stress, **gauss.state._asdict()}

    def memory(self, arrays: Mapping[str, np.ndarray]) -> dict[str, GaussState]:
        """Stress and state."""
        unloaded = self._equilibrium.material.at_rest()
        variables = unloaded._replace(**{name: arrays[name] for name in unloaded._fields})
        return {"gauss": GaussState(arrays["stress"], variables)}

    def residual(self, answer: Answer, forces: float) -> float:
        """Residual of the stress, and of the slack.

        Args:
            answer: stored answer.
            forces: largest norm of forces, a scale.
        """
        equilibrium = self._on_shape(answer)
        problem = equilibrium.problem
        theta = problem.amplitudes(answer.parameter)
        signs = equilibrium.signs(answer)
        _, pull = slack_residuals(problem, answer.unknown, answer.multipliers, theta)
        return max(pull, signs.imbalance / (max(signs.size, forces) or 1.0))

    def size(self, answer: Answer) -> float:
        """Norm of the internal and external forces."""
        return self._on_shape(answer).signs(answer).size

    def _on_shape(self, answer: Answer) -> FullOrderEquilibrium:
        """The equilibrium on the shape of an answer, the only one of which an unknown and a stress
        are on it.
        """
        equilibrium = self._equilibrium
        return equilibrium if equilibrium.shape is None else equilibrium.at(answer.parameter)

    def is_large(self, answer: Answer) -> bool:
        """True if files of this size are mapped."""
        return bool(state(answer).stress.nbytes >= MAPPED_BYTES)


def _identity(group: Group) -> list[object]:
    return [] if group.law is None else group.law.identity
