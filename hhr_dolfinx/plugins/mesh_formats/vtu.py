"""Unstructured grids of VTK, ``.vtu``, also of version 2: its grids are those of version 1, but
meshio refuses it.
"""

from __future__ import annotations

import re
from pathlib import Path
from tempfile import TemporaryDirectory

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.geometries.by_meshio import read_by_meshio
from hhr_dolfinx.geometries.raw_mesh import RawMesh


def read_vtu(path: Path) -> RawMesh:
    """Read a file, as ParaView and DOLFINx write it.

    Raises:
        FileContentError: for a damaged file, or one compressed by LZ4.
    """
    if b"vtkLZ4DataCompressor" in path.read_bytes()[:1000]:
        raise FileContentError(
            f"{path} is compressed by LZ4: write it by ZLib, in ParaView's options of the writer"
        )
    text, newer = re.subn(
        rb'(<VTKFile\b[^>]*?\bversion=")2\.\d+', rb"\g<1>1.0", path.read_bytes(), count=1
    )
    if not newer:
        return read_by_meshio(path)
    with TemporaryDirectory() as folder:
        copy = Path(folder) / path.name
        copy.write_bytes(text)
        try:
            return read_by_meshio(copy)
        except FileContentError as error:
            raise FileContentError(str(error).replace(str(copy), str(path))) from None
