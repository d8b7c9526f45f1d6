"""Meshes and tags of XDMF files of DOLFINx, meshio, ParaView and others.

Their grids have numbers and no names.

All grids of a file are read, so that tags may be in several of them, and points in another one.
Numbers are in the file itself, in raw files or in HDF5. netCDF4 reads the latter, since the HDF5 of
DOLFINx's wheel has no compression.
"""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from hhr_dolfinx.compat import extra, netcdf_read
from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.geometries.by_meshio import Elements, raw_mesh, whole_numbers
from hhr_dolfinx.geometries.raw_mesh import RawMesh

_TYPES = {
    "polyvertex": "vertex",
    "polyline": "line",
    "interval": "line",
    "edge": "line",
    "edge_3": "line3",
    "triangle": "triangle",
    "tri": "triangle",
    "triangle_6": "triangle6",
    "tri_6": "triangle6",
    "quadrilateral": "quad",
    "quad": "quad",
    "quadrilateral_8": "quad8",
    "quad_8": "quad8",
    "quadrilateral_9": "quad9",
    "quad_9": "quad9",
    "tetrahedron": "tetra",
    "tet": "tetra",
    "tetrahedron_10": "tetra10",
    "tet_10": "tetra10",
    "pyramid": "pyramid",
    "wedge": "wedge",
    "hexahedron": "hexahedron",
    "hex": "hexahedron",
    "hexahedron_20": "hexahedron20",
    "hex_20": "hexahedron20",
    "hexahedron_27": "hexahedron27",
    "hex_27": "hexahedron27",
}
"""Meshio's names of kinds of elements, by their XDMF names in small letters."""
_RAW = {"int": "i", "uint": "u", "char": "i", "uchar": "u", "float": "f"}
Grid = ElementTree.Element


def read_xdmf(path: Path) -> RawMesh:
    """Read the mesh of all grids of a file.

    Raises:
        FileContentError: for a file without a mesh, or with missing numbers.
    """
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise FileContentError(f"mesh file {path} is no XDMF ({error})") from error
    reader = _Numbers(path, root)
    points: list[np.ndarray] = []
    starts: dict[str, int] = {}
    elements: list[Elements] = []
    values: list[str] = []
    for grid in _grids(root):
        values += [
            attribute.get("Name", "")
            for attribute in grid.findall("Attribute")
            if attribute.get("Center", "Node") != "Cell"
        ]
        topology = grid.find("Topology")
        geometry = _geometry(root, grid)
        if topology is None or geometry is None:
            continue
        same = " ".join(
            ElementTree.tostring(geometry, "unicode").split()
        )  # grids may repeat their points
        if same not in starts:
            starts[same] = sum(map(len, points))
            points.append(reader.points(geometry))
        elements += _elements(reader, grid, topology, starts[same], path)
    if not elements:
        raise FileContentError(
            f"mesh file {path} has no grid of triangles, quadrilaterals, tetrahedra or hexahedra"
        )
    width = max(block.shape[1] for block in points)
    coordinates = np.concatenate(
        [np.pad(block, ((0, 0), (0, width - block.shape[1]))) for block in points]
    )
    left_out: dict[str | int, str] = (
        {"values at nodes": ", ".join(dict.fromkeys(values))} if values else {}
    )
    return raw_mesh(coordinates, elements, path, left_out=left_out)


def _grids(root: Grid) -> list[Grid]:
    """Grids with numbers; of a time series the first."""
    later = {
        step
        for grid in root.iter("Grid")
        if grid.get("CollectionType") == "Temporal"
        for step in grid.findall("Grid")[1:]
    }
    return [
        grid
        for grid in root.iter("Grid")
        if grid not in later and grid.get("GridType", "Uniform") == "Uniform"
    ]


def _geometry(root: Grid, grid: Grid) -> Grid | None:
    """Points of a grid, in the grid itself or in one that it refers to."""
    geometry = grid.find("Geometry")
    if geometry is not None:
        return geometry
    holders = [element for element in root.iter("Grid") if element.find("Geometry") is not None]
    pointers = [child.get("xpointer", "") for child in grid if child.tag.endswith("include")]
    names = [name for pointer in pointers for name in re.findall(r"@Name=['\"](.*?)['\"]", pointer)]
    named = [element for element in holders if element.get("Name") in names]
    return (named or holders)[0].find("Geometry") if holders else None


def _elements(
    reader: _Numbers, grid: Grid, topology: Grid, start: int, path: Path
) -> list[Elements]:
    """Elements of a grid with the numbers in its attributes."""
    name = (topology.get("TopologyType") or topology.get("Type") or "").lower()
    nodes = reader.array(topology)
    blocks: list[tuple[str, np.ndarray]]
    if name == "mixed":
        with extra("mesh", f"the mesh file {path}"):
            from meshio.xdmf.common import translate_mixed_cells
        blocks = [
            (block.type, block.data)
            for block in translate_mixed_cells(nodes.ravel().astype(np.int64))
        ]
    elif name in _TYPES:
        count = int(topology.get("NodesPerElement", 0)) or (
            nodes.shape[1] if nodes.ndim == 2 else 2
        )
        blocks = [(_TYPES[name], nodes.reshape(-1, count).astype(np.int64))]
    else:
        raise FileContentError(
            f"{path}: grid '{grid.get('Name')}' has elements of type '{name}', which is not "
            "understood"
        )
    ends = np.cumsum([len(rows) for _, rows in blocks])
    arrays: list[dict[str, np.ndarray]] = [{} for _ in blocks]
    for attribute in grid.findall("Attribute"):
        if attribute.get("Center") == "Cell":
            values = whole_numbers(reader.array(attribute).ravel())
            if values is not None and values.size == ends[-1]:
                key = attribute.get("Name") or grid.get("Name") or "numbers"
                for block, numbers_of in zip(arrays, np.split(values, ends[:-1]), strict=True):
                    block[key] = numbers_of
    return [
        Elements(type_, rows + start, numbers)
        for (type_, rows), numbers in zip(blocks, arrays, strict=True)
    ]


class _Numbers:
    """Arrays in an XDMF file, or in files that it refers to."""

    def __init__(self, path: Path, root: Grid):
        self._path = path
        self._root = root

    def points(self, geometry: Grid) -> np.ndarray:
        """Coordinates, (n, 2 or 3)."""
        if (geometry.get("GeometryType") or geometry.get("Type") or "XYZ").upper() in (
            "X_Y_Z",
            "X_Y",
        ):
            return np.column_stack(
                [self._item(data_item).ravel() for data_item in geometry.findall("DataItem")]
            )
        coordinates = self.array(geometry).astype(float)
        flat = (geometry.get("GeometryType") or geometry.get("Type") or "XYZ").upper() == "XY"
        return coordinates.reshape(-1, 2 if flat else 3) if coordinates.ndim == 1 else coordinates

    def array(self, owner: Grid) -> np.ndarray:
        """Numbers of an item with one array.

        Raises:
            FileContentError: for an item without an array.
        """
        data_item = owner.find("DataItem")
        if data_item is None:
            raise FileContentError(f"{self._path}: '{owner.tag}' has no DataItem")
        return self._item(data_item)

    def _item(self, item: Grid) -> np.ndarray:
        text = (item.text or "").strip()
        if item.get("Reference"):
            xpath = (text or item.get("Reference", "")).removeprefix("/Xdmf").strip("/")
            target = self._root.find(xpath)
            if target is None:
                raise FileContentError(f"{self._path} refers to {xpath}, which is not in it")
            return self._item(target)
        shape = [int(word) for word in item.get("Dimensions", "").split()] or [-1]
        kind = item.get("Format", "XML").upper()
        odd = {item.get("ItemType", "Uniform"), item.get("Compression", "Raw")} - {"Uniform", "Raw"}
        odd |= {kind} - {"XML", "HDF", "BINARY"}
        if odd:
            raise FileContentError(
                f"{self._path} has a DataItem of type {min(odd)}, which is not understood: write "
                "the mesh anew, by dolfinx.io.XDMFFile or meshio"
            )
        is_integer = item.get("NumberType", item.get("DataType", "Float")).lower() in (
            "int",
            "uint",
            "char",
            "uchar",
        )
        if kind == "XML":
            return np.array(text.split(), dtype=np.int64 if is_integer else float).reshape(shape)
        return (self._hdf(text) if kind == "HDF" else self._raw(item, text)).reshape(shape)

    def _beside(self, name: str) -> Path:
        """Path of a referenced file in the folder of this one."""
        file = self._path.parent / name.strip()
        if not file.is_file():
            raise FileContentError(
                f"{self._path} keeps its numbers in {name.strip()}, which is not in "
                f"{self._path.parent.absolute()}: put it there too, under this name"
            )
        return file

    def _hdf(self, text: str) -> np.ndarray:
        name, _, dataset = text.rpartition(":")
        file = self._beside(name)
        with netcdf_read(file, f"the mesh file {self._path}") as data:
            try:
                return np.asarray(data[dataset.strip()][:])
            except (IndexError, KeyError):
                raise FileContentError(
                    f"{file} has no numbers {dataset}, which {self._path} names"
                ) from None

    def _raw(self, item: Grid, text: str) -> np.ndarray:
        order = {"little": "<", "big": ">"}.get(item.get("Endian", "").lower(), "=")
        kind = _RAW[item.get("NumberType", item.get("DataType", "Float")).lower()]
        precision = (
            1 if "char" in item.get("NumberType", "").lower() else int(item.get("Precision", 4))
        )
        count = int(np.prod([int(word) for word in item.get("Dimensions", "").split()]))
        return np.fromfile(
            self._beside(text), f"{order}{kind}{precision}", count, offset=int(item.get("Seek", 0))
        )
