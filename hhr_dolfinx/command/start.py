"""Entry point of the command ``hhr``: without the packages of its extra it prints one sentence."""

from __future__ import annotations

import sys

from hhr_dolfinx.errors import MissingPackageError

EXIT_REFUSED = 3
"""Exit code of :mod:`hhr_dolfinx.command.main` for refused input."""


def main() -> None:
    """Run the command."""
    try:
        from hhr_dolfinx.command.main import main as command
    except MissingPackageError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(EXIT_REFUSED)
    command()
