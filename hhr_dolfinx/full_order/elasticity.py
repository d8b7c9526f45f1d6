"""Stiffness and stress of elastic bodies with constant moduli, integrated in full.

What bodies need beyond that a plug-in adds, its tool ``elasticity``: a class ``(scene, cell,
order)`` like :class:`ConstantElasticity`, of a scene, the kind of its cells, and the order of its
displacement.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from petsc4py import PETSc
from scipy.sparse import csc_matrix, csr_matrix
from ufl.core.expr import Expr

from hhr_dolfinx import compat, registry
from hhr_dolfinx.body import Body
from hhr_dolfinx.forms import elasticity
from hhr_dolfinx.full_order.discrete_space import DiscreteSpace
from hhr_dolfinx.parameters import Tag
from hhr_dolfinx.scene import Scene

if TYPE_CHECKING:
    from hhr_dolfinx.formulas import Formula, Modulus

    Vector = Callable[[ufl.Form], np.ndarray]

NEARLY_INCOMPRESSIBLE = 0.45
"""Poisson's ratio above which an elastic body uses the mean dilatation.

Volume is 2 nu / (1 - 2 nu) times as stiff as shape (lambda / mu): 9 at 0.45, 49 at 0.49, 5000 at
0.4999. On a thick tube of eight cells full integration is too stiff by 0.3 % at 0.36, the error of
the mesh, and by 0.9 % at 0.45; beyond, the error has no bound, while that of the mean dilatation
stays at 0.1 %. Ceramics and metals (nu up to 0.44) keep full integration.
"""


class ConstantElasticity:
    """Bodies whose moduli are numbers, or whose stress is a function of the strain, of a scene, on
    cells of a kind.

    Attributes:
        mean_dilatation: True for bodies that use the mean dilatation of their cells.
    """

    def __init__(self, scene: Scene, cell: str, order: int):
        self.mean_dilatation: tuple[bool, ...] = (False,) * len(scene.bodies)
        self._form: fem.Form | None = (
            None  # of bodies with full integration, after the first assembly
        )

    def stiffness_terms(
        self, space: DiscreteSpace
    ) -> tuple[tuple[csr_matrix, ...], tuple[Modulus, ...]]:
        """Local rows of the parts of K, and their moduli; one part and no modulus if K is
        constant.
        """
        return (space.own_rows(self.stiffness(space)),), ()

    def stiffness(self, space: DiscreteSpace) -> PETSc.Mat:
        """K over all dofs, without boundary conditions."""
        matrix = fem_petsc.assemble_matrix(self.form(space))
        matrix.assemble()
        return matrix

    def form(self, space: DiscreteSpace) -> fem.Form:
        """Form of the bodies with full integration.

        Compiled only if used, and once for all shapes of the mesh.
        """
        if self._form is None:
            self._form = compat.jitted(
                fem.form, sum(_form(space, body) for body in self.integrated(space.scene))
            )
        return self._form

    def integrated(self, scene: Scene) -> Sequence[Body]:
        """Bodies with full integration."""
        return scene.bodies

    def springs(self, space: DiscreteSpace) -> np.ndarray | None:
        """Stiffness to ground of each dof, (N,), by loads that resist; None without."""
        return None

    def lifted(self, space: DiscreteSpace, lifts: csc_matrix, free: np.ndarray) -> csc_matrix:
        """Lifts by those that are nonzero on imposed dofs alone, (N, 1 + T).

        Args:
            space: functions on the mesh.
            lifts: the given lifts, (N, 1 + T).
            free: False for imposed dofs, (N,) bool.
        """
        return lifts

    def stress(
        self, space: DiscreteSpace, place: int, field: fem.Function, point: np.ndarray
    ) -> Expr:
        """Stress of a body in UFL at a point of the parameters.

        Its constants are not compiled.

        Args:
            space: functions on the mesh.
            place: index of the body in the scene.
            field: the displacement.
            point: parameters, (P,).
        """
        hypothesis = space.scene.hypothesis
        body = space.scene.bodies[place]
        if (stress_of := space.scene.own_stress(body, space.mesh)) is not None:
            return stress_of(elasticity.strain(field, hypothesis))
        return elasticity.stress(
            field, space.constant(body.young), space.constant(body.poisson), hypothesis
        )

    def stress_in_cells(
        self, space: DiscreteSpace, displacement: np.ndarray, point: np.ndarray
    ) -> np.ndarray:
        """Stress of a displacement in the middle of each cell, Kelvin's notation, (cells, 4), in
        space 6.

        Cells are in the order of ``ContactProblem.cell_nodes``. Bodies with a mean dilatation have
        its pressure, and loads that are strains give no stress. The mesh has its current shape.

        Args:
            space: functions on the mesh.
            displacement: the displacement, (N,).
            point: parameters, (P,), of the moduli.
        """
        scene = space.scene
        mesh = space.mesh
        field = field_of(space, displacement)
        constants = fem.functionspace(mesh, ("Discontinuous Lagrange", 0, (3, 3)))
        points = compat.interpolation_points(constants.element)
        stress = fem.Function(constants)
        for index, body in enumerate(scene.bodies):
            sigma = self.stress(space, index, field, point)
            stress.interpolate(
                compat.jitted(fem.Expression, sigma, points), space.cells_of(body.tag)
            )
        owned = mesh.topology.index_map(mesh.topology.dim).size_local
        values = stress.x.array.reshape(-1, 3, 3)[constants.dofmap.list[:owned].ravel()]
        return _kelvin(space.group.joined(values), mesh.geometry.dim)

    def eigenstress(
        self, space: DiscreteSpace, tag: Tag, strain: Expr, vector: Vector
    ) -> list[tuple[Formula, np.ndarray]]:
        """Nodal forces of an eigenstrain of a body, see :class:`~hhr_dolfinx.loads.Assembler`.

        Args:
            space: functions on the mesh.
            tag: cell tag of the body.
            strain: the eigenstrain, 3x3, in UFL.
            vector: assembles a form that is linear in v, (N,).

        Returns:
            Modulus of each part of the stiffness, and the forces for the modulus 1, (N,).
        """
        elasticity_of_plugin = _of_plugin(space.scene, f"the strain {strain} of body {tag}")(
            space.scene, *space.cells_and_order
        )
        return elasticity_of_plugin.eigenstress(space, tag, strain, vector)


def _form(space: DiscreteSpace, body: Body) -> ufl.Form:
    dx = space.cells(body.tag)
    hypothesis = space.scene.hypothesis
    if (stress_of := space.scene.own_stress(body, space.mesh)) is not None:
        return elasticity.stiffness_of_law(*space.arguments, stress_of, hypothesis, dx)
    moduli = space.constant(body.young), space.constant(body.poisson)
    return elasticity.stiffness(*space.arguments, *moduli, hypothesis, dx)


def field_of(space: DiscreteSpace, displacement: np.ndarray) -> fem.Function:
    """A displacement, (N,), as a function on the mesh.

    Args:
        space: functions on the mesh.
        displacement: the displacement, (N,).
    """
    field = fem.Function(space.space)
    field.x.petsc_vec.array[:] = displacement[space.rows]
    field.x.scatter_forward()
    return field


def _kelvin(tensors: np.ndarray, dim: int) -> np.ndarray:
    """Symmetric tensors (n, 3, 3) as vectors with the same scalar product, (n, 4), in space (n,
    6).
    """
    pairs = [(0, 1)] if dim == 2 else [(0, 1), (0, 2), (1, 2)]
    shear = [np.sqrt(2) * tensors[:, i, j] for i, j in pairs]
    return np.stack([*(tensors[:, k, k] for k in range(3)), *shear], axis=1)


def elasticity_of(space: DiscreteSpace) -> ConstantElasticity:
    """Elasticity of the scene of a space.

    Raises:
        NotOfferedError: for bodies or loads that need a plug-in, which is missing.
    """
    scene = space.scene
    more = [f"body {body.tag}" for body in scene.bodies if not _is_constant(body, scene)]
    more += [
        repr(load)
        for load in scene.loads
        if hasattr(load, "stiffness") or hasattr(load, "eigenstrain_of")
    ]
    return (_of_plugin(scene, more[0]) if more else ConstantElasticity)(
        scene, *space.cells_and_order
    )


def _is_constant(body: Body, scene: Scene) -> bool:
    """True unless a body flows, has a grading, formulas, or is nearly incompressible."""
    if scene.states_stress(body):
        return True
    if body.law is not None or body.grading is not None or body.varies:
        return False
    return scene.hypothesis == "plane_stress" or float(body.poisson) <= NEARLY_INCOMPRESSIBLE


def _of_plugin(scene: Scene, item: str) -> type[ConstantElasticity]:
    request = (
        f"the stiffness of scene '{scene.name}', in which {item} is more than constant elasticity,"
    )
    elasticity_class: type[ConstantElasticity] = registry.tool("elasticity", request)
    return elasticity_class
