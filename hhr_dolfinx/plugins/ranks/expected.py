"""Estimates of memory and time of a full model, before anything is factored."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.linear.sparse import MOST_LAST, low_rank_of
from hhr_dolfinx.models.full import RESPONSE_BYTES

MEASURED_DOFS = 280_221
UNCOMPRESSED = ((2.6, 1.3), (89.0, 2.1), (0.035, 1.15))
COMPRESSED = ((2.6, 1.57), (27.0, 1.47), (0.053, 1.2))
"""Measured cost of a full model in space, on hexahedra, by MUMPS on one core: GB and seconds of the
factors, and seconds of a column of K^-1 B^T, with the powers of the dofs by which they grow. First
whole factors, then compressed ones: 19.3 GB with a million dofs and blocks of 1e-10, times with
blocks of 1e-8. Tetrahedra take less, cells of second order more.
"""
LAST = 1.35
"""Time of factors that eliminate contact last, which then need no columns, relative to others: 1.3
to 1.5.
"""


class Expected(NamedTuple):
    """Memory and time of a full model in space on one core."""

    gigabytes: float
    seconds: float  #: until the first answer
    keeps_columns: bool  #: K^-1 B^T is kept; without it a displacement takes one more solution


def expected_in_space(contact: csr_matrix) -> Expected:
    """Memory and time of a full model with these contact conditions, (N_lambda, N), in space."""
    conditions, dofs = contact.shape
    columns = 8e-9 * dofs * conditions
    factor, factor_s, column_s = (
        value * (dofs / MEASURED_DOFS) ** power
        for value, power in (COMPRESSED if low_rank_of(3, dofs) else UNCOMPRESSED)
    )
    memory = factor + 16e-9 * conditions**2
    seconds = factor_s + conditions * column_s
    keeps = columns <= 1e-9 * RESPONSE_BYTES
    last = np.unique(contact.indices).size
    if keeps:
        memory += columns
    elif last <= MOST_LAST:
        memory += 24e-9 * last**2
        seconds = LAST * factor_s
    return Expected(memory, seconds, keeps)
