"""Stress and memory at Gauss points, what answers say of them, and modes of many states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy import linalg

from hhr_dolfinx.errors import HHRError

if TYPE_CHECKING:
    from hhr_dolfinx.certify.accuracy import Solutions
    from hhr_dolfinx.models.answer import Answer
    from hhr_dolfinx.plugins.inelastic.law import InternalVariables


class GaussState(NamedTuple):
    """Stress and memory of the material at the Gauss points where a model evaluates its laws."""

    stress: np.ndarray  #: Kelvin's notation, (Gauss points, components)
    state: (
        InternalVariables  # inelastic strain, its cumulated amount, and further variables of laws
    )


def state(answer: Answer) -> GaussState:
    """Stress and state where the model evaluates its laws: ``answer.state()``.

    Raises:
        HHRError: by a model without inelastic bodies.
    """
    if "gauss" not in answer.memory:
        raise HHRError(
            "nothing flows in this model, so that its answers have no state: give a body a law"
        )
    gauss: GaussState = answer.memory["gauss"]
    return gauss


def plastic_strain(answer: Answer) -> np.ndarray:
    """Cumulated plastic strain at all Gauss points: ``answer.plastic_strain()``.

    Empty for elastic bodies.
    """
    if "gauss" not in answer.memory:
        return np.zeros(0)
    fields: Any = answer.fields
    completion = fields.equilibrium if fields.exact else fields.flow
    field: np.ndarray = completion.plastic_strain(answer)
    return field


def states_of(answers: Solutions) -> list[GaussState]:
    """Stress and state of known answers; empty for elastic bodies."""
    return [memory["gauss"] for memory in answers.states if "gauss" in memory]


def flowed(answers: Solutions) -> bool:
    """True if any of some known answers has inelastic strain."""
    return any(gauss.state.inelastic.any() for gauss in states_of(answers))


def check_answer(answer: Answer) -> None:
    """Evaluate the fields of an answer: the facet ``file``, by which a model file is tried after it
    was read.
    """
    _ = answer.stress(), plastic_strain(answer)


def rows_of(points: np.ndarray, components: int) -> np.ndarray:
    """Rows of some Gauss points in an array with a row for each component at each point.

    Args:
        points: numbers of the points, (n,).
        components: components at each point.
    """
    return (points[:, None] * components + np.arange(components)).ravel()


def deviator(strain: np.ndarray) -> np.ndarray:
    """Deviators of tensors in Kelvin's notation, (n, c, ...)."""
    deviators = strain.copy()
    deviators[:, :3] -= deviators[:, :3].mean(axis=1, keepdims=True)
    return deviators


SMALL_STATE = 1e-3
"""Norm of a state, relative to the largest of any, above which it counts in full; smaller states
count by their size, so that round-off of unloaded bodies does not count.
"""
STACKED_VALUES = 20_000
"""Values of each field that are stacked at once."""


def state_modes(fields: Sequence[np.ndarray], tolerance: float) -> np.ndarray:
    """Orthonormal POD modes of states, (values, modes), each divided by its norm.

    By their sizes, states of little plastic strain, first steps and residual states would be left
    out compared with those of full loads: on the pellet 36 to 60 % of their plastic strain and
    stress.

    Args:
        fields: one for each state, (values,); they may be too long to stack.
        tolerance: part of the squared sum that the modes leave out; by the method of snapshots,
            from 1e-14.
    """
    sizes = np.array([np.linalg.norm(field) for field in fields])
    if not sizes.any():  # as of bodies that only heat strains
        return np.zeros((fields[0].size, 1))
    scale = 1 / np.maximum(sizes, SMALL_STATE * sizes.max())
    spans = [
        slice(start, start + STACKED_VALUES) for start in range(0, fields[0].size, STACKED_VALUES)
    ]

    def stacked(span: slice) -> np.ndarray:
        return np.stack([field[span] for field in fields]) * scale[:, None]

    squares, ways = linalg.eigh(sum(block @ block.T for block in map(stacked, spans)))
    squares = np.maximum(squares[::-1], 0.0)
    ways = ways[:, ::-1]
    left_out = np.append(np.cumsum(squares[::-1])[::-1], 0.0)
    count = max(int(np.argmax(left_out < max(tolerance, 1e-14) * left_out[0])), 1)
    chosen = ways[:, :count] / np.sqrt(squares[:count])
    return np.concatenate([stacked(span).T @ chosen for span in spans])
