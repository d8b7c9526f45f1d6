"""Facet ``report`` of laws of pressures: their memories as fields for viewers."""

from __future__ import annotations

import numpy as np

from hhr_dolfinx.contact.law import ContactLaw
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.plugins.contact_laws.interface import Interface, OverLaws


def rows_of(law: ContactLaw, plugin: str) -> np.ndarray:
    """Conditions of the law of a plug-in, (k,), alone in a scene, beside others or beneath one.

    Args:
        law: contact law of the scene.
        plugin: name of the plug-in.
    """
    if not isinstance(law, Interface):
        return np.zeros(0, dtype=np.int64)
    for part in law.ranges:
        if part.law.plugin == plugin:
            return part.rows
        if isinstance(part.law, OverLaws):
            beneath = rows_of(part.law.under, plugin)
            if beneath.size:
                return part.rows[part.law.normal[beneath]]
    return np.zeros(0, dtype=np.int64)


class FieldsOfMemory:
    """Arrays of the memory of a law at the nodes of the mesh."""

    def __init__(self, plugin: str, *names: str):
        self._plugin = plugin
        self._names = names

    def point_fields(
        self, problem: ContactProblem, answer: Answer, forces: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Arrays at the slave nodes, and 0 at others, (nodes,) each.

        Args:
            problem: contact problem of the full model.
            answer: answer with the memory.
            forces: not read.
        """
        slaves = problem.contact_slaves[rows_of(problem.law, self._plugin)]
        fields = {}
        for name in self._names:
            if name in answer.memory and answer.memory[name].size == slaves.size:
                fields[name] = np.zeros(len(problem.points))
                fields[name][slaves] = answer.memory[name]
        return fields
