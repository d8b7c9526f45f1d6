"""Our own block in space, its K in the formats of other codes, and the scene of such a K."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from scipy.io import hb_write, mmwrite
from scipy.sparse import block_diag, coo_matrix, csr_matrix, save_npz, tril
from scipy.sparse.linalg import splu

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side, two_blocks
from hhr_dolfinx.plugins.foreign.dof_table import write_dofs
from hhr_dolfinx.plugins.foreign.plain import write_npz

LOW, HIGH = side(FIRST, 2, True), side(SECOND, 2, False)
TOP, FLOOR, FLANK = side(SECOND, 2, True), side(FIRST, 2, False), side(SECOND, 0, True)
BOX = hhr.ParameterSpace(("push", "pull"), (1.0, -0.5), (20.0, 0.5))


def geometry(comm):
    """Mesh of two blocks, 0.001 apart."""
    first = ((0.0, 0.0, 0.0), (2.0, 2.0, 1.0), (3, 3, 2))
    second = ((0.0, 0.0, 1.001), (2.0, 2.0, 2.001), (3, 3, 2))
    return two_blocks(comm, first=first, second=second)


def own_scene(**changes):
    """Two blocks with a gap of 0.001, the upper one held at its flank and pushed on its top."""
    given = dict(
        name="own",
        geometry=geometry,
        hypothesis="solid",
        bodies=(hhr.Body(FIRST, 1000.0, 0.3), hhr.Body(SECOND, 2000.0, 0.2)),
        contacts=(hhr.NodeToSurface(HIGH, LOW),),
        displacements=(*hhr.Displacement.clamp(FLOOR, 3), *hhr.Displacement.clamp(FLANK, 3)),
        loads=(
            hhr.Traction(TOP, (0.0, 0.0, -1.0), "push"),
            hhr.Traction(TOP, (0.0, 1.0, 0.0), "pull"),
        ),
        outputs=(hhr.ContactForce("force", 0, direction=(0.0, 0.0, 1.0)),),
        parameters=BOX,
    )
    return hhr.Scene(**(given | changes))


def own_block():
    """Both blocks of K as one, which their case moves by forces on each of them."""
    lower, upper = hhr.blocks_of_scene(own_scene())
    parts = [one.stiffness for one in (lower, upper)]
    matrix = hhr.ForeignMatrix(
        csr_matrix(block_diag([one.matrix for one in parts])),
        np.concatenate([one.nodes for one in parts]),
        np.concatenate([one.directions for one in parts]),
        "ours",
    )
    first = len(lower.nodes.labels)
    surfaces = lower.nodes.surfaces | {
        tag: faces.shifted(first) for tag, faces in upper.nodes.surfaces.items()
    }
    nodes = hhr.ForeignNodes(
        np.concatenate([lower.nodes.labels, upper.nodes.labels]),
        np.vstack([lower.nodes.points, upper.nodes.points]),
        surfaces,
    )
    case = hhr.SolvedCase(
        lower.case.forces | upper.case.forces,
        lower.case.displacements | upper.case.displacements,
        lower.case.held | upper.case.held,
        lower.case.tolerance,
    )
    return hhr.ForeignBlock(matrix, nodes, case=case, name="part")


def foreign_scene(*blocks, prefix="", **changes):
    """The same scene of blocks of K, whose surfaces have the numbers of ours."""
    high, low, floor, flank, top = (f"{prefix}{tag}" for tag in (HIGH, LOW, FLOOR, FLANK, TOP))
    given = dict(
        contacts=(hhr.NodeToSurface(high, low),),
        displacements=(*hhr.Displacement.clamp(floor, 3), *hhr.Displacement.clamp(flank, 3)),
        loads=(
            hhr.Traction(top, (0.0, 0.0, -1.0), "push"),
            hhr.Traction(top, (0.0, 1.0, 0.0), "pull"),
        ),
        outputs=(hhr.ContactForce("force", 0, direction=(0.0, 0.0, 1.0)),),
        parameters=BOX,
    )
    return hhr.ForeignStiffness(*blocks).scene("foreign", **(given | changes))


def _entries(found, half):
    entries = coo_matrix(tril(found.matrix)) if half else coo_matrix(found.matrix)
    kept = entries.data != 0
    return entries.row[kept], entries.col[kept], entries.data[kept]


def write_sti(found, folder: Path) -> Path:
    """As CalculiX: column and row of the upper half."""
    lines = [
        f"{c + 1} {r + 1} {v:20.16e}\n" for r, c, v in zip(*_entries(found, True), strict=True)
    ]
    (folder / "k.sti").write_text("".join(lines))
    write_dofs(folder / "k.dof", found.nodes, found.directions)
    return folder / "k.sti"


def write_matrix_input(found, folder: Path, half=True) -> Path:
    """As Abaqus: names of row and column."""
    n, d = found.nodes, found.directions
    rows = zip(*_entries(found, half), strict=True)
    text = "".join(f"{n[r]},{d[r]}, {n[c]},{d[c]}, {v:.17e}\n" for r, c, v in rows)
    (folder / "k.mtx").write_text(text)
    return folder / "k.mtx"


def write_labels(found, folder: Path) -> Path:
    """As Abaqus, both halves."""
    return write_matrix_input(found, folder, half=False)


def write_coordinate(found, folder: Path) -> Path:
    """As Abaqus: numbers of row and column, both halves."""
    text = "".join(
        f"{r + 1} {c + 1} {v:.17e}\n" for r, c, v in zip(*_entries(found, False), strict=True)
    )
    (folder / "k.mtx").write_text(text)
    write_dofs(folder / "k.dof", found.nodes, found.directions)
    return folder / "k.mtx"


def write_market(found, folder: Path) -> Path:
    """By SciPy, one half; the table as a mapping file of Ansys."""
    with (folder / "k.mmf").open("wb") as file:
        mmwrite(file, coo_matrix(found.matrix), symmetry="symmetric", precision=17)
    words = ("", "UX", "UY", "UZ", "ROTX", "ROTY", "ROTZ")
    rows = enumerate(zip(found.nodes, found.directions, strict=True), start=1)
    lines = [
        " Matrix Eqn    Node    DOF\n",
        *(f"{row:10d} {n:10d}  {words[d]}\n" for row, (n, d) in rows),
    ]
    (folder / "k.mapping").write_text("".join(lines))
    return folder / "k.mmf"


def write_boeing(found, folder: Path) -> Path:
    """By SciPy, whole."""
    hb_write(folder / "k.hb", found.matrix.tocsc())
    write_dofs(folder / "k.dof", found.nodes, found.directions)
    return folder / "k.hb"


def write_boeing_half(found, folder: Path) -> Path:
    """As Ansys: one half, RSA."""
    path = write_boeing(
        type(found)(tril(found.matrix).tocsr(), found.nodes, found.directions, ""), folder
    )
    path.write_text(path.read_text().replace("RUA", "RSA", 1))
    return path


def write_own_npz(found, folder: Path) -> Path:
    """By the package itself."""
    write_npz(folder / "k.npz", found)
    return folder / "k.npz"


def write_scipy_npz(found, folder: Path) -> Path:
    """By SciPy, with a table of dofs."""
    save_npz(folder / "k.npz", found.matrix)
    write_dofs(folder / "k.dof", found.nodes, found.directions)
    return folder / "k.npz"


def write_dmig(found, folder: Path) -> Path:
    """As Nastran, large fields with 16 characters: nine digits; free fields have all."""
    n, d = found.nodes, found.directions
    lines = ["DMIG,KAAX,0,6,2,0\n"]
    for r, c, v in zip(*_entries(found, True), strict=True):
        lines.append(f"DMIG,KAAX,{n[c]},{d[c]},,{n[r]},{d[r]},{v:.17e}\n".replace("e", "D"))
    (folder / "k.pch").write_text("".join(lines))
    return folder / "k.pch"


def write_op4(found, folder: Path) -> Path:
    """As Nastran, binary, sparse columns of single entries."""

    def record(*parts):
        body = b"".join(parts)
        return struct.pack("<i", len(body)) + body + struct.pack("<i", len(body))

    matrix = found.matrix.tocsc()
    size = matrix.shape[0]
    text = record(struct.pack("<4i", size, -size, 6, 2), b"KGG     ")
    for column in range(size):
        own = slice(matrix.indptr[column], matrix.indptr[column + 1])
        pairs = zip(matrix.indices[own], matrix.data[own], strict=True)
        body = b"".join(struct.pack("<2id", 3, row + 1, value) for row, value in pairs)
        text += record(struct.pack("<3i", column + 1, 0, len(body) // 4), body)
    (folder / "k.op4").write_bytes(text + record(struct.pack("<3id", size + 1, 1, 2, 1.0)))
    write_dofs(folder / "k.dof", found.nodes, found.directions)
    return folder / "k.op4"


def write_superelement(found, folder: Path) -> Path:
    """As Abaqus and CalculiX: *USER ELEMENT with a node for each dof, and the lower half row by
    row.
    """
    size = len(found.nodes)
    lines = [
        "**\n",
        "** SUBSTRUCTURE\n",
        f"*USER ELEMENT,NODES={size},LINEAR\n",
        "** ELEMENT NODES\n",
    ]
    lines += [f"**{node:10d},\n" for node in found.nodes]
    lines += [f"{found.directions[0]:10d}\n"]
    lines += [f"{k:10d},{d:10d}\n" for k, d in enumerate(found.directions[1:], start=2)]
    lines += ["*MATRIX,TYPE=STIFFNESS\n"]
    whole = found.matrix.toarray()
    lines += ["".join(f"{value:.17e},\n" for value in whole[row, : row + 1]) for row in range(size)]
    (folder / "s.mtx").write_text("".join(lines))
    return folder / "s.mtx"


WRITERS = (
    write_sti,
    write_matrix_input,
    write_labels,
    write_coordinate,
    write_market,
    write_boeing,
    write_boeing_half,
    write_own_npz,
    write_scipy_npz,
    write_dmig,
    write_op4,
)


def condensed(found, kept):
    """K condensed to some rows."""
    rest = np.setdiff1d(np.arange(len(found.nodes)), kept)
    inner = found.matrix[rest][:, rest].tocsc()
    coupling = found.matrix[rest][:, kept].toarray()
    block = found.matrix[kept][:, kept].toarray() - coupling.T @ splu(inner).solve(coupling)
    matrix = coo_matrix((block + block.T) / 2).tocsr()
    return type(found)(
        matrix, found.nodes[kept], found.directions[kept], "condensed", superelement=True
    )
