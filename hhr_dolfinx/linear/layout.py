"""Arrays of models are in C or Fortran order, which files and copies preserve: other sums differ in the last digits."""

from __future__ import annotations

import numpy as np


def lay_out(owner: object) -> None:
    """Copy arrays of a dataclass that are in neither C nor Fortran order to C order; for ``__post_init__``."""
    for name, value in vars(owner).items():
        if isinstance(value, np.ndarray) and not value.flags.forc:
            object.__setattr__(owner, name, np.ascontiguousarray(value))
