"""Two cubes on each other, and single cells, in files of meshes and decks.

The pressure between the cubes is a closed form, and so are lengths, areas and volumes.
"""

import meshio
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from scenes import slope, space

import hhr_dolfinx as hhr
from hhr_dolfinx.compat import netcdf4

POINTS = [
    (float(x), float(y), z)
    for z in (0.0, 1.0, 1.01, 2.01)
    for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))
]
CUBES = ((1, 2, 3, 4, 5, 6, 7, 8), (9, 10, 11, 12, 13, 14, 15, 16))
FACES = {11: (1, 2, 3, 4), 12: (5, 6, 7, 8), 13: (9, 10, 11, 12), 14: (13, 14, 15, 16)}
NUMBERS = (1, 2, 11, 12, 13, 14)
NAMES = ("LOWER", "UPPER", "FLOOR", "MASTER", "SLAVE", "LID")


def nodes_of_deck(points, first=1):
    return "*NODE\n" + "".join(
        f"{k}, {', '.join(map(str, place))}\n" for k, place in enumerate(points, first)
    )


DECK = (
    nodes_of_deck(POINTS)
    + "*ELEMENT, TYPE=C3D8, ELSET=LOWER\n1, 1, 2, 3, 4, 5, 6, 7, 8\n"
    + "*ELEMENT, TYPE=C3D8, ELSET=UPPER\n2, 9, 10, 11, 12, 13, 14, 15, 16\n"
    + "*SURFACE, NAME=FLOOR\n1, S1\n*SURFACE, NAME=MASTER\n1, S2\n"
    + "*SURFACE, NAME=SLAVE\n2, S1\n*SURFACE, NAME=LID\n2, S2\n"
)


def written(path, text):
    path.write_text(text)
    return path


def two_cubes(path, names=NUMBERS):
    lower, upper, floor, top, under, lid = names
    held = *hhr.Displacement.clamp(floor, 3), *hhr.Displacement.clamp(lid, 2)
    return hhr.Scene(
        name="two_cubes",
        geometry=hhr.MeshFile(path),
        hypothesis="solid",
        bodies=tuple(hhr.Body(tag, 1e3, 0.0) for tag in (lower, upper) if tag is not None),
        contacts=(hhr.NodeToSurface(under, top),),
        displacements=(*held, hhr.Displacement(lid, 2, slope("down", -1.0))),
        parameters=space(down=(0.0, 0.05)),
        outputs=(hhr.LargestPressure("pressure", contact=0),),
    )


def pressure(path, names=NUMBERS):
    found = hhr.FullOrderModel(two_cubes(path, names), MPI.COMM_SELF).solve({"down": 0.03})
    return found.outputs()["pressure"]


def reasons(path):
    return hhr.MeshFile(path).read().left_out


def by_meshio(path, **arrays):
    blocks = [("hexahedron", np.array(CUBES) - 1), ("quad", np.array([*FACES.values()]) - 1)]
    data = {name: [np.array(values[:2]), np.array(values[2:])] for name, values in arrays.items()}
    meshio.write(
        path,
        meshio.Mesh(np.array(POINTS), blocks, cell_data=data),
        {".msh": "gmsh22"}.get(path.suffix),
    )
    return path


def size_of(found, name, dim, density=1.0):
    """Length, area or volume of what a name stands for, or the integral of a density over it, on
    all ranks.
    """
    mesh, cells, facets = found
    (numbers,) = [own for key, (of, own) in found.physical_groups if key == name and of == dim]
    measure, tags = (ufl.dx, cells) if dim == mesh.topology.dim else (ufl.ds, facets)
    form = fem.form(
        density * fem.Constant(mesh, 1.0) * measure(subdomain_data=tags)(tuple(numbers))
    )
    return mesh.comm.allreduce(fem.assemble_scalar(form))


def write_exodus(path, points, blocks, sides=None, names=(), form="NETCDF3_64BIT_OFFSET"):
    """Blocks by number: type and nodes.

    Sets of sides by number: (element, side), or None for an empty one.
    """
    with netcdf4("a test").Dataset(path, "w", format=form) as data:

        def put(name, values, *axes):
            for axis, size in zip(axes, np.shape(values), strict=True):
                if axis not in data.dimensions:
                    data.createDimension(axis, size)
            found = data.createVariable(name, values.dtype, axes)
            found[:] = values
            return found

        points = np.array(points, dtype=float).T
        for axis, row in zip("xy", points, strict=False):
            if len(points) == 2:
                put(f"coord{axis}", row, "num_nodes")
        if len(points) == 3:
            put("coord", points, "num_dim", "num_nodes")
        for kind, axis, items in (("eb", "num_el_blk", blocks), ("ss", "num_side_sets", sides)):
            if items:
                put(f"{kind}_prop1", np.array(list(items), dtype="i4"), axis)
            if items and names:
                words = np.array([names[number] for number in items], dtype="S33")
                put(f"{kind}_names", words.view("S1").reshape(len(items), 33), axis, "len_string")
        for k, (kind, rows) in enumerate(blocks.values(), start=1):
            put(
                f"connect{k}", np.array(rows, dtype="i4"), f"num_el_in_blk{k}", f"num_nod_per_el{k}"
            ).elem_type = kind
        for k, pairs in enumerate((sides or {}).values(), start=1):
            for what, column in zip(
                ("elem", "side"), () if pairs is None else np.transpose(pairs), strict=False
            ):
                put(f"{what}_ss{k}", column.astype("i4"), f"num_side_ss{k}")
    return path


CORNERS = [
    (float(x), float(y), float(z)) for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))
]
CUBE = (
    "*PART, NAME=Cube\n"
    + nodes_of_deck(CORNERS)
    + "*ELEMENT, TYPE=C3D8\n1, 1, 2, 3, 4, 5, 6, 7, 8\n"
    + (
        "*ELSET, ELSET=Whole\n1\n*NSET, NSET=Bottom, GENERATE\n1, 4, 1\n"
        "*SURFACE, NAME=Top\nWhole, S2\n*END PART\n"
    )
)
# upside down, the axis parallel to x through the middle, and then up: the top of the part is the
# lower side
TURNED = "0., 0., 1.01\n0., 0.5, 1.51, 1., 0.5, 1.51, 180.\n"
PLACED = (
    "*ASSEMBLY, NAME=all\n*INSTANCE, NAME=Low-1, PART=cube\n*END INSTANCE\n"
    + f"*INSTANCE, NAME=Up-1, PART=CUBE\n{TURNED}*END INSTANCE\n"
)


BELOW = ((0, 1), (1, 2), (2, 3), (3, 0))
ABOVE = ((4, 5), (5, 6), (6, 7), (7, 4))
UPRIGHT = ((0, 4), (1, 5), (2, 6), (3, 7))
EDGES_OF_A_CUBE = (*BELOW, *ABOVE, *UPRIGHT)
"""Corners of the edges of C3D20, in the order of the nodes on them by the manual of Abaqus."""
SQUARE = ((0, 0), (2, 0), (2, 1), (0, 1))
SECOND = {
    "CPE8": ([(*p, 0) for p in SQUARE], ((0, 1), (1, 2), (2, 3), (3, 0)), 2),
    "CPS6": ([(0, 0, 0), (2, 0, 0), (0, 2, 0)], ((0, 1), (1, 2), (2, 0)), 2),
    "C3D10": (
        [(0, 0, 0), (2, 0, 0), (0, 2, 0), (0, 0, 3)],
        ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
        2,
    ),
    "C3D20R": (
        [(*p, z) for z in (0, 1) for p in SQUARE],
        EDGES_OF_A_CUBE,
        2,
    ),
}
