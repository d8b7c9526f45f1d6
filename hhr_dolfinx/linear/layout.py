"""Arrays of models lie in memory without gaps, in C or Fortran order, as files, copies and pickles keep them.

Sums over strides in another order end in other last digits, which bounds near round-off turn into figures.
"""

from __future__ import annotations

import numpy as np


def lay_out(owner: object) -> None:
    """Put arrays of a dataclass in C order where they are in neither that nor Fortran order; from ``__post_init__``."""
    for name, value in vars(owner).items():
        if isinstance(value, np.ndarray) and not value.flags.forc:
            object.__setattr__(owner, name, np.ascontiguousarray(value))
