"""Mesh of a full model for figures and files of fields."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from dolfinx.plot import vtk_mesh

from hhr_dolfinx.models.answer_mesh import AnswerMesh

if TYPE_CHECKING:
    from hhr_dolfinx.contact.problem import ContactProblem
    from hhr_dolfinx.full_order.discrete_space import DiscreteSpace


def answer_mesh_of(discretisation: DiscreteSpace, problem: ContactProblem) -> AnswerMesh:
    """Mesh of a full model with its contact problem, on each of its ranks. Collective.

    Args:
        discretisation: finite element model of the scene.
        problem: its contact problem.
    """
    scene = discretisation.scene
    space = discretisation.space
    cells, kinds, _ = vtk_mesh(space)
    # columns of the dofmap in the order of VTK, by the first cell of the rank; none of a rank
    # without cells
    width = problem.cell_nodes.shape[1]
    order = [np.flatnonzero(space.dofmap.list[0] == node)[0] for node in cells[1 : 1 + width]]
    described = next(
        entry for entry in discretisation.group.gathered((order, kinds[:1].tolist())) if entry[1]
    )
    return AnswerMesh(
        points=problem.points,
        cells=problem.cell_nodes[:, described[0]],
        kind=int(described[1][0]),
        bodies=discretisation.group.joined(discretisation.cell_bodies()),
        contact_points=problem.contact_points,
        slaves=problem.contact_slaves,
        contacts=tuple(problem.pressing_of(index) for index in range(len(scene.contacts))),
        name=scene.name,
        axisymmetric=scene.hypothesis == "axisymmetric",
        parameters=tuple(scene.parameters.names),
        length="" if scene.units is None else scene.units.length,
        stress="" if scene.units is None else scene.units.stress,
    )
