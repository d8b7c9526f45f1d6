"""Fields of answers on their mesh, for ParaView: ``.vtkhdf`` or ``.vtu``, a file for each step of a history."""

from __future__ import annotations

import json
import os
import secrets
from collections.abc import Mapping
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
from dolfinx.plot import vtk_mesh

from hhr_dolfinx import registry
from hhr_dolfinx.compat import extra
from hhr_dolfinx.errors import FileError, SceneError
from hhr_dolfinx.files import make_folder, replacing
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.materials.elasticity import von_mises
from hhr_dolfinx.models.answer import Answer, History

with extra("pictures", "fields for ParaView"):
    import pyvista

ENDINGS = (".vtkhdf", ".vtu")


def write_fields(path: str | Path, full: FullOrderModel, answer: Answer | History) -> list[Path]:
    """Write displacement, contact pressure and gap at nodes, stress and body of cells, and what laws of contacts add.

    Args:
        path: with the ending ``.vtkhdf`` (VTK >= 9.3) or ``.vtu``. Steps of a history have numbers in their names, and
            are listed with their times in a collection next to them, ``.pvd``, or ``.vtkhdf.series``.
        full: the model of the mesh, on one rank; the answers may be those of a reduced model of its scene.
        answer: an answer, or a history.

    Returns:
        The files, the collection first.

    Raises:
        FileError: for another ending, or a VTK that cannot write it.
        SceneError: on several ranks, or for a model without a mesh, such as one from a file.
    """
    path = Path(path)
    if path.suffix not in ENDINGS:
        raise FileError(f"{path}: fields are written as {' or '.join(ENDINGS)}")
    if not hasattr(full, "discretisation"):
        raise SceneError(
            f"fields need a mesh, and a {type(full).__name__} has none: give FullOrderModel(scene) of its scene. The "
            "answer may be that of any model of the scene, one from a file too"
        )
    if full.comm.size > 1:
        raise SceneError("fields are written on one rank: give a full model on MPI.COMM_SELF")
    make_folder(path.parent)
    if not isinstance(answer, History):
        return [_written(path, grid_of(full, answer))]
    steps = list(answer.answers)
    names = [path.with_stem(f"{path.stem}_{k:04d}") for k in range(len(steps))]
    for name, step in zip(names, steps, strict=True):
        _written(name, grid_of(full, step))
    times = {name.name: step.time for name, step in zip(names, steps, strict=True)}
    return [_collection(path, times), *names]


def _collection(path: Path, times: Mapping[str, float]) -> Path:
    """Write the list of the files of steps with their times; ParaView reads no ``.vtkhdf`` from a ``.pvd``."""
    if path.suffix == ".vtu":
        collection = path.with_suffix(".pvd")
        rows = [f'<DataSet timestep="{time:.17g}" file={quoteattr(name)}/>\n' for name, time in times.items()]
        text = f'<VTKFile type="Collection" version="0.1"><Collection>\n{"".join(rows)}</Collection></VTKFile>\n'
    else:
        collection = path.with_name(f"{path.name}.series")
        files = [{"name": name, "time": time} for name, time in times.items()]
        text = json.dumps({"file-series-version": "1.0", "files": files}, indent=1)
    with replacing(collection, text=True) as file:
        file.write(text)
    return collection


def _written(path: Path, grid: pyvista.UnstructuredGrid) -> Path:
    """Write a file at once; VTK only prints its errors, so a missing file reveals them."""
    part = path.with_stem(f".{path.stem}.{secrets.token_hex(8)}")
    try:
        grid.save(part)
        os.replace(part, path)
    except (OSError, ValueError) as error:
        raise FileError(f"{path} cannot be written ({error}): try the ending .vtu, or another folder") from error
    finally:
        part.unlink(missing_ok=True)
    return path


def grid_of(full: FullOrderModel, answer: Answer) -> pyvista.UnstructuredGrid:
    """The mesh with all fields of an answer."""
    problem = full.problem.at(answer.parameter)
    # points are the nodes of the space, in the order of its dofs
    grid = pyvista.UnstructuredGrid(*vtk_mesh(full.discretisation.space))
    theta = problem.amplitudes(answer.parameter)
    displacement = answer.displacement()
    vectors = displacement.reshape(grid.n_points, -1)
    pressure = np.zeros(grid.n_points)
    gap = np.full(grid.n_points, np.nan)
    pressing = problem.pressing
    slaves = problem.contact_slaves[pressing]
    forces = answer.forces()
    if len(forces) != len(problem.contact_areas):
        raise SceneError(
            f"the answer has {len(forces)} forces, and {full.scene.name} {len(problem.contact_areas)} contact "
            "conditions: it is of another scene, or of bodies that slide past their mesh, whose fields are not built in"
        )
    slack = problem.gaps @ theta - problem.contact @ (displacement - problem.lifts @ theta)
    np.add.at(pressure, slaves, (forces / problem.contact_areas)[pressing])
    gap[slaves] = slack[pressing]
    if problem.law.plugin:
        report = registry.facet(problem.law.plugin, "report", f"a file of fields with {problem.law.name}")
        for name, values in report.point_fields(problem, answer, forces).items():
            grid.point_data[name] = values
    grid.point_data["displacement"] = np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))
    grid.point_data["contact_pressure"] = pressure
    grid.point_data["gap"] = gap
    # a model from a file has no stress without the mesh
    found = full.stress_of(displacement, answer.parameter) if full.equilibrium is None else answer.stress()
    stress = found.reshape(grid.n_cells, -1, found.shape[-1]).mean(axis=1)
    grid.cell_data["stress_kelvin"] = stress
    grid.cell_data["von_mises"] = von_mises(stress)
    grid.cell_data["body"] = full.discretisation.cell_bodies()
    return grid
