"""A mesh file whose outside is a surface with a name."""

from __future__ import annotations

from dataclasses import dataclass, replace

from hhr_dolfinx.geometries.cells import outer_faces
from hhr_dolfinx.geometries.mesh_file import MeshFile
from hhr_dolfinx.geometries.raw_mesh import RawMesh

OUTSIDE = "outside of all bodies"


@dataclass(frozen=True)
class WithOutside(MeshFile):
    """A mesh file with a surface :data:`OUTSIDE`: a scene needs a contact pair, and a file may name no surface."""

    def read(self) -> RawMesh:
        """See :meth:`~hhr_dolfinx.geometries.mesh_file.MeshFile.read`."""
        raw = super().read()
        return replace(raw, surfaces={**raw.surfaces, OUTSIDE: outer_faces(raw.kind, raw.cells)})
