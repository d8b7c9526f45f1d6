"""Version of this package, from its installation."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("hhr_dolfinx")
except PackageNotFoundError:  # sources that are not installed
    __version__ = "0+unknown"
