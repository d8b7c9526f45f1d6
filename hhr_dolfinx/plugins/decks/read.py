"""Contents of a file, by its reader."""

from __future__ import annotations

from pathlib import Path

from hhr_dolfinx.geometries.mesh_file import MeshFile
from hhr_dolfinx.plugins.decks.deck import Deck


def read(path: Path, mesh: Path | None = None) -> Deck:
    """Read a deck, a command file of code_aster with its mesh, or a mesh without physics.

    Raises:
        FileContentError: for a file that cannot be read, with the line.
        SceneError: for a deck from which no scene can be made, with the line.
    """
    from hhr_dolfinx.plugins.decks.inp import read_inp

    raw = MeshFile(path).read()
    return read_inp(path, raw)
