"""A law of interfaces of a user's own, in one file: contacts wear, which opens their gaps.

The depth worn off a contact grows by a constant times its pressure, each second: slack = free + worn + S λ, by backward
Euler an active set on S with a larger diagonal. What wears is no output here, as Archard's depth of friction is: it
gives contact forces back.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np

from hhr_dolfinx.contact.active_set import SchurEqualities, Statuses, active_set
from hhr_dolfinx.contact.law import ContactLaw, PairLaw
from hhr_dolfinx.declared import Floats
from hhr_dolfinx.errors import NotOfferedError, SceneError
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.models.answer import found_as
from hhr_dolfinx.models.histories.steps import Steps
from hhr_dolfinx.parameters import is_number
from hhr_dolfinx.registry import Plugin


@dataclass(frozen=True, eq=False)
class Wearing(ContactLaw):
    """Depth per force and second of each condition, (m,); zero where nothing wears."""

    plugin: ClassVar[str] = "toy_wear"
    name: ClassVar[str] = "wear"
    remembers: ClassVar[bool] = True
    fixed: ClassVar[np.ndarray] = np.zeros(0, dtype=np.int64)

    rate: Annotated[Floats, "m"]

    def within(self, conditions):
        return replace(self, rate=self.rate[conditions])

    def parts(self):
        return [self.rate]

    def opened(self, memory):
        return memory["worn"]

    @property
    def layout(self):
        return {"worn": ("float", "N_lambda")}

    def stored(self, memory):
        return {"worn": memory["worn"]}

    def restored(self, arrays):
        return Memory(worn=arrays["worn"])


@dataclass(frozen=True)
class Wear(PairLaw):
    """Wear of a pair, by its constant: depth per pressure and second."""

    plugin: ClassVar[str] = "toy_wear"
    remembers: ClassVar[bool] = True
    texts: ClassVar[tuple[str, ...]] = ()

    constant: float

    @property
    def words(self):
        return f"wear {self.constant}"

    def check(self, scene, what):
        if not is_number(self.constant) or self.constant < 0:
            raise SceneError(f"wear of {what} must be a number, not negative")

    @classmethod
    def attached(cls, laws, scene, rows, pairs, free, lifts, mesh):
        constants = np.array([laws[k].constant if k in laws else 0.0 for k in range(len(scene.contacts))])
        return rows, pairs, Wearing(constants[pairs] / rows.areas)


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
        return Reached(time, point, weights, None, np.zeros(self.model.own_conditions))

    def going_on(self, answer, weights):
        return Reached(answer.time, answer.parameter, weights, answer.active, answer.memory["worn"])

    def increment(self, before, target):
        contact = self.contact_at(target.point)
        worn = self.model.law.rate * (target.time - before.time)
        slack = contact.free_slack + before.worn
        start = slack < 0 if before.active is None else before.active
        found = active_set(SchurEqualities.of(contact.schur + np.diag(worn)), slack, start)
        after = before.worn + worn * found.forces
        return Solved(found, contact, Reached(target.time, target.point, target.weights, found.active, after))

    def compare(self, solved):
        self.largest = max(self.largest, float(np.linalg.norm(solved.found.forces)))

    def difference(self, before, half, second, whole):
        return float(np.linalg.norm(second.found.forces - whole.found.forces)) / (self.largest or 1.0)

    def check(self, place):
        pass

    def answer(self, solved):
        unknown = solved.contact.unknown(solved.found.forces)
        answer = found_as(solved.found, solved.reached.point, unknown, self.model.fields)
        return answer._replace(time=solved.reached.time, memory=Memory(worn=solved.reached.worn))

    def advice(self, solved):
        return {}


class WearSteps(Steps):
    """Facet ``steps``, the only one: all other readers of laws refuse it."""

    def increments(self, model, settings):
        if settings.gradient:
            raise NotOfferedError("derivatives of wear are not built in")
        return WearIncrements(model)

    def coupling(self, model, point):
        return np.nan


STEPS = WearSteps()
PLUGIN = Plugin(
    name="toy_wear",
    classes={"toy_wear": "Wearing"},
    memory=("worn",),
    facets={"steps": "toy_wear:STEPS"},
)
