"""Fields of answers on their mesh, for ParaView: ``.vtkhdf`` or ``.vtu``, a file for each step of a
history.
"""

from __future__ import annotations

import json
import os
import secrets
from collections.abc import Mapping
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.compat import extra
from hhr_dolfinx.errors import FileError, NotOfferedError, SceneError
from hhr_dolfinx.files import make_folder, replacing
from hhr_dolfinx.materials.elasticity import von_mises
from hhr_dolfinx.models.answer import Answer, History, Meshed
from hhr_dolfinx.models.answer_mesh import AnswerMesh
from hhr_dolfinx.models.model import AnsweringModel
from hhr_dolfinx.plugins.plots.contact_fields import gaps, is_full, statuses
from hhr_dolfinx.plugins.plots.recovery import stress_of_cells
from hhr_dolfinx.plugins.plots.surface_fields import displacement_seen

with extra("pictures", "fields for ParaView"):
    import pyvista

FIELD_ENDINGS = (".vtkhdf", ".vtu")
"""Endings of files of fields, as VTK reads them."""


def write_fields(path: str | Path, full: AnsweringModel, answer: Answer | History) -> list[Path]:
    """Write displacement, contact pressure and gap at nodes, stress and body of cells, and what
    laws of contacts add.

    Of a model from a file with the mesh beside it, ``scenery.npz``, what laws of contacts add and
    stress tensors of elastic bodies are left out; von Mises' stress of elastic bodies is there in
    the plane. The status of nodes is 0 open, 1 closed, 2 sliding.

    Args:
        path: with the ending ``.vtkhdf`` (VTK >= 9.3) or ``.vtu``. Steps of a history have numbers
            in their names, and are listed with their times in a collection next to them, ``.pvd``,
            or ``.vtkhdf.series``.
        full: the full model, on one rank, or any model that has its mesh, in memory or beside its
            file; the answers may be those of another model of its scene.
        answer: an answer, or a history.

    Returns:
        The files, the collection first.

    Raises:
        FileError: for another ending, or a VTK that cannot write it.
        SceneError: on several ranks, or for a model without a mesh, such as a copy.
        NotOfferedError: for a model from a file without the mesh beside it.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> full = hhr.FullOrderModel(scene)
        >>> answer = full.solve({"push": 50.0})
        >>> [path.name for path in hhr.write_fields("pad.vtu", full, answer)]
        ['pad.vtu']
    """
    path = Path(path)
    if path.suffix not in FIELD_ENDINGS:
        raise FileError(f"{path}: fields are written as {' or '.join(FIELD_ENDINGS)}")
    meshed = full.fields.full if isinstance(full, AnsweringModel) else None
    if meshed is None:
        raise SceneError(
            f"fields need a mesh, and a {type(full).__name__} has none: give "
            "FullOrderModel(scene) of its scene. The answer may be that of any model of the "
            "scene, one from a file too"
        )
    if is_full(meshed) and meshed.comm.size > 1:
        raise SceneError("fields are written on one rank: give a full model on MPI.COMM_SELF")
    meshed.answer_mesh()  # refuses before a folder is made
    make_folder(path.parent)
    if not isinstance(answer, History):
        return [_written(path, grid_of(meshed, answer))]
    steps = list(answer.answers)
    names = [path.with_stem(f"{path.stem}_{k:04d}") for k in range(len(steps))]
    for name, step in zip(names, steps, strict=True):
        _written(name, grid_of(meshed, step))
    times = {name.name: step.time for name, step in zip(names, steps, strict=True)}
    return [_collection(path, times), *names]


def _collection(path: Path, times: Mapping[str, float]) -> Path:
    """Write the list of the files of steps with their times.

    ParaView reads no ``.vtkhdf`` from a ``.pvd``.
    """
    if path.suffix == ".vtu":
        collection = path.with_suffix(".pvd")
        rows = [
            f'<DataSet timestep="{time:.17g}" file={quoteattr(name)}/>\n'
            for name, time in times.items()
        ]
        text = (
            f'<VTKFile type="Collection" version="0.1"><Collection>\n{"".join(rows)}'
            "</Collection></VTKFile>\n"
        )
    else:
        collection = path.with_name(f"{path.name}.series")
        files = [{"name": name, "time": time} for name, time in times.items()]
        text = json.dumps({"file-series-version": "1.0", "files": files}, indent=1)
    with replacing(collection, text=True) as file:
        file.write(text)
    return collection


def _written(path: Path, grid: pyvista.UnstructuredGrid) -> Path:
    """Write a file at once; VTK only prints its errors, so a missing file reveals them."""
    temporary = path.with_stem(f".{path.stem}.{secrets.token_hex(8)}")
    try:
        grid.save(temporary)
        os.replace(temporary, path)
    except (OSError, ValueError) as error:
        raise FileError(
            f"{path} cannot be written ({error}): try the ending .vtu, or another folder"
        ) from error
    finally:
        temporary.unlink(missing_ok=True)
    return path


def grid_of(meshed: Meshed, answer: Answer) -> pyvista.UnstructuredGrid:
    """Mesh with all fields of an answer that are available.

    Args:
        meshed: the full model, or the mesh beside a model file.
        answer: answer of any model of its scene.

    Raises:
        SceneError: if the answer has another number of contact conditions.
    """
    mesh = meshed.answer_mesh()
    # points are the nodes of the space, in the order of its dofs
    vectors = mesh.nodal(displacement_seen(answer))
    padding = ((0, 0), (0, 3 - vectors.shape[1]))
    cells = np.insert(mesh.cells, 0, mesh.cells.shape[1], axis=1)
    kinds = np.full(len(cells), mesh.kind, dtype=np.uint8)
    grid = pyvista.UnstructuredGrid(cells.ravel(), kinds, np.pad(mesh.points, padding))
    pressure = np.zeros(grid.n_points)
    forces = answer.forces()
    areas = meshed.areas(answer.parameter)
    if len(forces) != len(areas):
        raise SceneError(
            f"the answer has {len(forces)} forces, and {mesh.name} {len(areas)} contact "
            "conditions: it is of another scene, or of bodies that slide past their mesh, whose "
            "fields are not built in"
        )
    pressing = mesh.pressing
    np.add.at(pressure, mesh.slaves[pressing], forces[pressing] / areas[pressing])
    grid.point_data["displacement"] = np.pad(vectors, padding)
    grid.point_data["contact_pressure"] = pressure
    _add_contact(grid, meshed, answer, mesh)
    _add_stress(grid, meshed, answer, mesh)
    grid.cell_data["body"] = mesh.bodies
    return _where_known(grid, vectors, mesh)


def _where_known(
    grid: pyvista.UnstructuredGrid, vectors: np.ndarray, mesh: AnswerMesh
) -> pyvista.UnstructuredGrid:
    """Cells of a grid in which displacements, (n, dim), are known: those of the outside, or all."""
    known = np.isfinite(vectors).all(axis=1)[mesh.cells].all(axis=1)
    return grid if known.all() else grid.extract_cells(np.flatnonzero(known))


def _add_contact(
    grid: pyvista.UnstructuredGrid, meshed: Meshed, answer: Answer, mesh: AnswerMesh
) -> None:
    """Gaps and statuses at nodes, and what laws of contacts add."""
    pressing = mesh.pressing
    try:
        fields = {"gap": gaps(answer, meshed), "status": statuses(answer, meshed)}
    except NotOfferedError:  # a file of an earlier release has no gaps
        if is_full(meshed):
            raise
        fields = {}
    for name, values in fields.items():
        of_nodes = np.full(grid.n_points, np.nan)
        of_nodes[mesh.slaves[pressing]] = values[pressing]
        grid.point_data[name] = of_nodes
    if not is_full(meshed):
        return
    problem = meshed.problem.at(answer.parameter)
    for plugin in problem.law.plugins:
        report = registry.facet(plugin, "report", f"a file of fields with {problem.law.name}")
        for name, values in report.point_fields(problem, answer, answer.forces()).items():
            grid.point_data[name] = values


def _add_stress(
    grid: pyvista.UnstructuredGrid, meshed: Meshed, answer: Answer, mesh: AnswerMesh
) -> None:
    """Stress of cells, and von Mises' stress.

    Without a full model what the files beside a model have of them.
    """
    if not is_full(meshed) and mesh.von_mises is not None:
        grid.cell_data["von_mises"] = mesh.von_mises(answer.displacement(), answer.parameter)
        return
    stress = stress_of_cells(meshed, answer)
    if stress is None:
        return
    grid.cell_data["stress_kelvin"] = stress
    grid.cell_data["von_mises"] = von_mises(stress)
