"""Version of this package, as its installation tells it."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("hhr_dolfinx")
except PackageNotFoundError:  # run from a copy of the sources that was not installed
    __version__ = "0+unknown"
