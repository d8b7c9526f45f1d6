"""Increments of wear by a solver of its own, the facet ``steps``: an active set on S with a larger
diagonal.

The template of contact laws, ``my_contact_law``, is solved by the facet ``range``. This is the same
backward Euler, slack = free + worn before + (S + rate dt) force, in other operations: a reference
for it, and a law whose plug-in has no facet ``range``.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import my_contact_law
import numpy as np

from hhr_dolfinx.contact.active_set import SchurEqualities, Statuses, active_set
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.models.answer import found_as
from hhr_dolfinx.plugins.contact_laws.steps import LawSteps


class Reached(NamedTuple):
    """Place of a history, with the depth worn off each condition, (m,)."""

    time: float
    point: np.ndarray
    weights: np.ndarray
    active: np.ndarray | None
    worn: np.ndarray


class Solved(NamedTuple):
    """An increment."""

    found: Statuses
    contact: Any
    reached: Reached
    status = property(lambda self: self.found.status)
    iterations = property(lambda self: self.found.iterations)
    cycled = property(lambda self: self.found.cycled)


class WearIncrements:
    """Increments of one history."""

    def __init__(self, model):
        self.model = model
        self.contact_at = model.contacts()
        self.largest = 0.0

    def at_rest(self, time, point, weights):
        """Nothing is worn."""
        return Reached(time, point, weights, None, np.zeros(self.model.own_conditions))

    def going_on(self, answer, weights):
        """Place after a known step."""
        return Reached(answer.time, answer.parameter, weights, answer.active, answer.memory["worn"])

    def increment(self, before, target):
        """Backward Euler for the depth."""
        contact = self.contact_at(target.point)
        worn = self.model.law.rate * (target.time - before.time)
        slack = contact.free_slack + before.worn
        start = slack < 0 if before.active is None else before.active
        found = active_set(SchurEqualities.of(contact.schur + np.diag(worn)), slack, start)
        after = before.worn + worn * found.forces
        return Solved(
            found, contact, Reached(target.time, target.point, target.weights, found.active, after)
        )

    def compare(self, solved):
        """Take in the size of forces."""
        self.largest = max(self.largest, float(np.linalg.norm(solved.found.forces)))

    def difference(self, before, half, second, whole):
        """Of forces, over the largest so far."""
        return float(np.linalg.norm(second.found.forces - whole.found.forces)) / (
            self.largest or 1.0
        )

    def check(self, place):
        """No check."""

    def answer(self, solved):
        """Answer of an increment."""
        unknown = solved.contact.unknown(solved.found.forces)
        answer = found_as(solved.found, solved.reached.point, unknown, self.model.fields)
        return answer._replace(time=solved.reached.time, memory=Memory(worn=solved.reached.worn))

    def advice(self, solved):
        """No advice."""
        return {}


class WearSteps(LawSteps):
    """Facet ``steps``: its own solver, where no other law is in the scene."""

    def increments(self, model, settings):
        """See Steps."""
        if settings.gradient:
            raise NotOfferedError("derivatives of wear are not built in")
        return WearIncrements(model)

    def coupling(self, model, point):
        """Unknown."""
        return np.nan


STEPS = WearSteps()
PLUGIN = replace(my_contact_law.PLUGIN, facets={"steps": "toy_increments:STEPS"})
"""The plug-in of the template, with this facet alone."""
