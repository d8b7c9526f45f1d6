"""Facet ``report`` of friction: fields for viewers."""

from __future__ import annotations

import numpy as np

from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.plugins.friction.laws import SLIP, Friction


class _Report:
    """See :func:`hhr_dolfinx.plugins.plots.fields.grid_of`."""

    def point_fields(
        self, problem: ContactProblem, answer: Answer, forces: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Friction at the nodes of the mesh: traction on slaves (nodes, 3), length slipped, and
        status.

        The status is 0 if contact is open or without friction, 1 if it sticks, 2 if it slips.

        Args:
            problem: contact problem of the full model.
            answer: answer with a memory of slip.
            forces: forces of all conditions, (M,).
        """
        friction = problem.law.of("friction")
        assert isinstance(friction, Friction)
        if SLIP not in answer.memory:
            return {}
        count = len(problem.points)
        slaves = problem.contact_slaves[friction.normal]
        traction = np.zeros((count, 3))
        areas = problem.contact_areas[friction.tangential]
        # the multiplier is minus the force on the slave, see plugins.friction.laws
        along = -friction.tangents * (forces[friction.tangential] / areas)[:, None]
        np.add.at(traction[:, : along.shape[1]], slaves[friction.owner], along)
        slip = np.zeros(count)
        slip[slaves] = answer.memory[SLIP].path
        status = np.zeros(count)
        status[slaves] = answer.memory[SLIP].statuses
        return {"friction_traction": traction, "slip": slip, "stick_slip": status}


REPORT = _Report()
