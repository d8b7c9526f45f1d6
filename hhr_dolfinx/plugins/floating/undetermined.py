"""Answers with rigid motions that neither loads nor contact determine, see :mod:`.statuses`."""

from __future__ import annotations

from typing import Any

import numpy as np

SAME = 1e-9
"""Part of the largest value below which a change counts as round-off."""


def undetermined_outputs(answer: Any) -> set[str]:
    """Names of the outputs that an undetermined motion of an answer changes."""
    fields: Any = answer.fields
    if fields.functionals is None:
        return set()
    functionals = fields.functionals.at(answer.parameter)
    amplitudes = fields.functionals.amplitudes
    given = amplitudes(answer.parameter)
    theta = np.zeros(amplitudes.firsts[-1])
    theta[given.terms] = given.values
    before = fields.measured(answer, theta)
    found: set[str] = set()
    for motion in answer.undetermined.T:
        change = np.abs(fields.measured(answer._replace(unknown=answer.unknown + motion), theta) - before)
        least = SAME * max(change.max(initial=0.0), np.abs(before).max(initial=0.0))
        pairs = zip(functionals.items, functionals.places, strict=True)
        found |= {item.name for item, place in pairs if change[place].max(initial=0.0) > least}
    return found


def undetermined_motions(answer: Any) -> str:
    """Description of the undetermined motions of an answer: the nodes of the mesh that move, and how."""
    before = answer.displacement()
    words = []
    for motion in answer.undetermined.T:
        change = answer._replace(unknown=answer.unknown + motion).displacement() - before
        field = change.reshape(-1, answer.fields.dimension)
        sizes = np.linalg.norm(field, axis=1)
        moving = np.flatnonzero(sizes > SAME * sizes.max())
        way = field[moving].mean(axis=0)
        shifted = np.abs(field[moving] - way).max() <= 1e-6 * sizes.max()
        how = f"moves along {np.round(way / np.linalg.norm(way), 3).tolist()}" if shifted else "turns"
        words.append(f"the body of nodes {moving[0]} to {moving[-1]} {how}")
    return ", ".join(words)
