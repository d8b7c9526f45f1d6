"""Arrays of models are contiguous in memory, in C or Fortran order, which files, copies and pickles preserve.

Sums over other strides differ in the last digits, and bounds near round-off turn these into visible differences.
"""

from __future__ import annotations

import numpy as np


def lay_out(owner: object) -> None:
    """Copy arrays of a dataclass that are in neither C nor Fortran order to C order; for ``__post_init__``."""
    for name, value in vars(owner).items():
        if isinstance(value, np.ndarray) and not value.flags.forc:
            object.__setattr__(owner, name, np.ascontiguousarray(value))
