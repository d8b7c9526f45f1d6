"""Increments of elastic bodies whose surfaces are paired again, see :mod:`.repairing`."""

from __future__ import annotations

from typing import Any

import numpy as np

from hhr_dolfinx.memory import Memory
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.plugins.friction.slider import IncrementEnd, Slider, SlidingState, SolvedSliding
from hhr_dolfinx.plugins.sliding.repairing import PairedSurfaces


class RepairingSlider(Slider):
    """Solves increments of a model with ``pairs``, whose base has rows of all dofs of its surfaces.

    ``exactly`` pairs increments until their positions converge.
    """

    def __init__(self, model: Any, *, exactly: bool = False):
        super().__init__(model)
        self.surfaces = PairedSurfaces(model.pairs, model.law, model.parameters, exactly)
        self._far_along = False

    def at_rest(self, time: float, point: np.ndarray, weights: np.ndarray) -> SlidingState:
        """Undeformed bodies as meshed, without slip.

        Args:
            time: start of the path, in s.
            point: parameters, (P,).
            weights: weights of the state.
        """
        return self.surfaces.at_rest(time, point, weights, self._contact_at(point).free_slack)

    def increment(self, before: SlidingState, target: IncrementEnd) -> SolvedSliding:
        """Solve one increment; it may not converge.

        Args:
            before: state at the start of the increment.
            target: its end.
        """
        contact = self._contact_at(target.point)
        solved = self.surfaces.solved(contact.schur, contact.free_slack, before, target)
        changes = before.changes, before.closing
        reached = self._reached(target, solved.found, solved.slip, changes)
        return SolvedSliding(solved.found, solved.kept_in(reached), contact, None)

    def check(self, place: SlidingState) -> None:
        """Check the distance that bodies have slid past tools, whose rows are not made again."""
        super().check(place)
        beside = self.model.beside
        if beside.conditions.size and not self._far_along:
            assert place.displacement is not None and place.surface_forces is not None
            motion = place.displacement[self.surfaces.dofs.stop :].reshape(
                -1, self.surfaces.dim - 1
            )
            words = self.model.parameters.described(place.point)
            self._far_along = beside.check(place.surface_forces, motion, self.largest, words)

    def elastic_energy(self, solved: SolvedSliding) -> float:
        """See :class:`Slider`."""
        surface_forces = solved.reached.surface_forces
        return 0.5 * float(surface_forces @ (solved.contact.schur @ surface_forces))

    def answer(self, solved: SolvedSliding) -> Answer:
        """Answer of an increment.

        Its forces are those of the pairs that do not slide, and on all dofs of surfaces.
        """
        solution, reached, contact, _ = solved
        forces = reached.surface_forces
        assert forces is not None
        outcome = (
            solution.iterations,
            solution.status,
            solution.sweeps > 0,
            self.model.fields,
            reached.time,
        )
        active = self.surfaces.active(solution, forces)
        return Answer(
            reached.point,
            contact.unknown(forces),
            forces,
            active,
            *outcome,
            memory=Memory(slip=reached.slip) | reached.laws,
        )
