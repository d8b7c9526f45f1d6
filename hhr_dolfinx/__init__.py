"""Hybrid hyper-reduction of parametric contact problems with Lagrange multipliers.

The public names are in ``__init__.pyi``, for type checkers too. They are imported at first use, so that a reduced model
from a file (``load_model``) needs neither DOLFINx nor gmsh.
"""

import logging

import lazy_loader

from hhr_dolfinx import compat as _compat

# silent unless a user configures logging
logging.getLogger(__name__).addHandler(logging.NullHandler())

_loaded, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    """Import the module of a public name; if DOLFINx is missing, the error explains how to install it."""
    try:
        return _loaded(name)
    except ModuleNotFoundError as error:
        raise _compat.explained(error) from error
