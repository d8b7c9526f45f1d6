"""Hybrid hyper-reduction of parametric contact problems with Lagrange multipliers.

The public names stand in ``__init__.pyi``, for type checkers too. They are loaded when they are first used, so that a
reduced model read from a file (``load_model``) needs neither DOLFINx nor gmsh.
"""

import logging

import lazy_loader

from hhr_dolfinx import compat as _compat

# silent unless a user configures logging
logging.getLogger(__name__).addHandler(logging.NullHandler())

_loaded, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    """A public name, whose module is loaded now; where DOLFINx is missing the error says how to get it."""
    try:
        return _loaded(name)
    except ModuleNotFoundError as error:
        raise _compat.explained(error) from error
