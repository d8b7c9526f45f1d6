"""From UFL to arrays at Gauss points: the strain of a scene, tabulated once, for bodies that flow."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem

from hhr_dolfinx import compat
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.flow.gauss import StrainOperator
from hhr_dolfinx.forms.elasticity import volume_weight
from hhr_dolfinx.forms.plasticity import strain_vector
from hhr_dolfinx.full_order.discretisation import Discretisation

QUADRATURE = 2
"""Degree of the rule: quadrilaterals get 2 x 2 points."""


def strain_operator(discretisation: Discretisation) -> StrainOperator:
    """Strain at the Gauss points of all cells; serial.

    Args:
        discretisation: of the scene.

    Raises:
        SceneError: on several ranks.
    """
    if discretisation.comm.size > 1:
        raise SceneError("materials that flow are solved on one rank: share the parameters out, not the mesh")
    mesh, space, hypothesis = discretisation.mesh, discretisation.space, discretisation.scene.hypothesis
    cells = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)
    points, weights = compat.quadrature(mesh, QUADRATURE)
    table = fem.Expression(strain_vector(ufl.TrialFunction(space), hypothesis), points).eval(mesh, cells)
    measure = volume_weight(mesh, hypothesis) * abs(ufl.JacobianDeterminant(mesh))
    volumes = fem.Expression(measure, points).eval(mesh, cells).reshape(len(cells), len(weights))
    dim, blocks = mesh.geometry.dim, space.dofmap.list[cells]
    dofs = (dim * blocks[:, :, None] + np.arange(dim)).reshape(len(cells), -1).astype(np.int64)
    components = 6 if hypothesis == "solid" else 4
    gradients = np.ascontiguousarray(table.reshape(len(cells), len(weights), components, dofs.shape[1]))
    return StrainOperator(gradients, volumes * weights, dofs, discretisation.size)
