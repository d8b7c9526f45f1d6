"""Bodies beyond constant elasticity: the tool ``elasticity``."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from petsc4py import PETSc
from scipy.sparse import csc_matrix, csr_matrix
from ufl.core.expr import Expr

from hhr_dolfinx.body import Body
from hhr_dolfinx.forms import elasticity, volume
from hhr_dolfinx.formulas import Formula, Modulus, Scalar
from hhr_dolfinx.full_order.discrete_space import DiscreteSpace
from hhr_dolfinx.full_order.elasticity import ConstantElasticity
from hhr_dolfinx.materials.elasticity import lame_parameters
from hhr_dolfinx.parameters import Tag
from hhr_dolfinx.plugins.elasticity.eigenstrains import cell_means, eigenstrain_at, eigenstress
from hhr_dolfinx.plugins.elasticity.gauss_points import add_stiffness
from hhr_dolfinx.plugins.elasticity.lifts import rigid_lifts
from hhr_dolfinx.plugins.elasticity.locking import mean_dilatation
from hhr_dolfinx.plugins.elasticity.parts import (
    CommonPattern,
    empty_matrix,
    parts_by_modulus,
    with_springs,
)
from hhr_dolfinx.scene import Scene


class VaryingElasticity(ConstantElasticity):
    """See :class:`~hhr_dolfinx.full_order.elasticity.ConstantElasticity`."""

    def __init__(self, scene: Scene, cell: str, order: int):
        super().__init__(scene, cell, order)
        self.mean_dilatation = mean_dilatation(scene, cell, order)
        self._pattern: CommonPattern | None = (
            None  # of the parts of K, after the first assembly of a mesh that moves
        )

    def stiffness_terms(
        self, space: DiscreteSpace
    ) -> tuple[tuple[csr_matrix, ...], tuple[Modulus, ...]]:
        """See :class:`ConstantElasticity`."""
        scene = space.scene
        if any(body.varies or body.grading is not None for body in scene.bodies):
            matrices, moduli = parts_by_modulus(space)
            pattern = self._pattern or CommonPattern(matrices)
            if scene.shapes:  # matrices are assembled again
                self._pattern = pattern
            terms = pattern.filled(matrices)
        else:
            terms, moduli = super().stiffness_terms(space)
        # a user-defined system knows no springs: they are added to its K
        springs = None if scene.system is not None else self.springs(space)
        if springs is None:
            return terms, moduli
        return with_springs(scene.parameters.names, springs, terms, moduli, space.rows.start)

    def stiffness(self, space: DiscreteSpace) -> PETSc.Mat:
        """See :class:`ConstantElasticity`."""
        if not any(self.mean_dilatation):
            return super().stiffness(space)
        # the mass couples the dofs of all cells, including those without a stiffness form
        matrix = empty_matrix(space)
        if not all(self.mean_dilatation):
            fem_petsc.assemble_matrix(matrix, self.form(space))
        bodies = zip(space.scene.bodies, self.mean_dilatation, strict=True)
        constants = {
            index: lame_parameters(float(body.young), float(body.poisson))
            for index, (body, mean) in enumerate(bodies)
            if mean
        }
        add_stiffness(space, matrix, constants)
        matrix.assemble()
        return matrix

    def integrated(self, scene: Scene) -> Sequence[Body]:
        """See :class:`ConstantElasticity`."""
        return [
            body for body, mean in zip(scene.bodies, self.mean_dilatation, strict=True) if not mean
        ]

    def springs(self, space: DiscreteSpace) -> np.ndarray | None:
        """See :class:`ConstantElasticity`."""
        resisting = [load for load in space.scene.loads if hasattr(load, "stiffness")]
        if not resisting:
            return None
        return np.sum([load.stiffness(space.assembler(load)) for load in resisting], axis=0)

    def lifted(self, space: DiscreteSpace, lifts: csc_matrix, free: np.ndarray) -> csc_matrix:
        """Replace lifts by rigid motions of whole bodies if K depends on parameters.

        Inelastic bodies, bodies with a variable shape, and bodies that constraints join keep their
        lifts.

        Args:
            space: functions on the mesh of the scene.
            lifts: lifts that are nonzero on imposed dofs alone, (N, 1 + T).
            free: False for imposed dofs, (N,) bool.
        """
        scene = space.scene
        if (
            scene.shapes
            or scene.reader
            or scene.constraints
            or not any(body.varies for body in scene.bodies)
        ):
            return lifts
        return rigid_lifts(scene.hypothesis, lifts, free, space._points(), space._cell_nodes())

    def stress(
        self, space: DiscreteSpace, place: int, field: fem.Function, point: np.ndarray
    ) -> Expr:
        """See :class:`ConstantElasticity`.

        A strain that is a load, times the grading, is subtracted from the graded strain.

        Args:
            space: functions on the mesh of the scene.
            place: index of the body in the scene.
            field: the displacement.
            point: parameters, (P,).
        """
        scene = space.scene
        hypothesis = scene.hypothesis
        body = scene.bodies[place]
        eigenstrain = eigenstrain_at(space, place, point)
        if (stress_of := scene.own_stress(body, space.mesh)) is not None:
            strain = elasticity.strain(field, hypothesis)
            return stress_of(strain if eigenstrain is None else strain - eigenstrain)
        moduli: list[float | str] = [body.young, body.poisson]
        if body.varies:
            moduli = [Scalar(str(text), scene.parameters.names).value(point) for text in moduli]
        young, poisson = map(space.constant, moduli)
        strain = elasticity.strain(field, hypothesis, poisson)
        if space.mean_dilatation[place]:
            dilatation = cell_means(space, ufl.tr(elasticity.strain(field, hypothesis)))
            strain = volume.with_mean(strain, dilatation)
        if body.grading is not None:
            strain = body.grading(ufl.SpatialCoordinate(space.mesh)) * strain
        if eigenstrain is not None:
            strain = strain - eigenstrain
            if hypothesis == "plane_stress":
                strain = volume.without_third_stress(strain, poisson)
        shear = young / (2 * (1 + poisson))
        lam = young * poisson / ((1 + poisson) * (1 - 2 * poisson))
        return lam * ufl.tr(strain) * ufl.Identity(3) + 2 * shear * strain

    def eigenstress(
        self, space: DiscreteSpace, tag: Tag, strain: Expr, vector: Callable[[ufl.Form], np.ndarray]
    ) -> list[tuple[Formula, np.ndarray]]:
        """See :class:`ConstantElasticity`.

        Args:
            space: functions on the mesh of the scene.
            tag: cell tag of the body.
            strain: the eigenstrain, 3x3, in UFL.
            vector: assembles a form that is linear in v, (N,).
        """
        return eigenstress(space, tag, strain, vector)
