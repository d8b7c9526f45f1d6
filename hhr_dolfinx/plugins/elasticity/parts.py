"""Parts of a stiffness that depends on parameters: K(mu) = sum of moduli(mu) times matrices.

Bodies with constant elasticity make one part with the weight 1. Each other body makes one for its
change of volume and one for its change of shape, or a single one if only its modulus varies.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import reduce
from operator import add
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from petsc4py import PETSc
from scipy.sparse import csr_matrix

from hhr_dolfinx import compat
from hhr_dolfinx.body import Body
from hhr_dolfinx.forms import elasticity
from hhr_dolfinx.formulas import Modulus, Scalar
from hhr_dolfinx.full_order.discrete_space import DiscreteSpace
from hhr_dolfinx.plugins.elasticity.gauss_points import add_stiffness

if TYPE_CHECKING:
    from ufl.core.expr import Expr


def parts_by_modulus(discretisation: DiscreteSpace) -> tuple[list[csr_matrix], tuple[Modulus, ...]]:
    """Local rows of the parts of K, each with its pattern, and their moduli."""
    scene = discretisation.scene
    names = scene.parameters.names
    groups: list[tuple[Modulus, dict[int, tuple[float, float]]]] = []
    constant = {}
    for index, body in enumerate(scene.bodies):
        for stiffness_part in parts_of(body, scene.hypothesis):
            if body.varies:
                groups.append(
                    (
                        Modulus(stiffness_part.factor, stiffness_part.rest, names),
                        {index: stiffness_part.moduli},
                    )
                )
            else:
                factor = float(stiffness_part.factor)
                constant[index] = (
                    factor * stiffness_part.moduli[0],
                    factor * stiffness_part.moduli[1],
                )
    varies = bool(groups)
    if constant:
        groups.append((Modulus("1", "1", names), constant))
    matrices = [
        discretisation.own_rows(_assembled(discretisation, members)) for _, members in groups
    ]
    return matrices, tuple(modulus for modulus, _ in groups) if varies else ()


def with_springs(
    names: tuple[str, ...],
    springs: np.ndarray,
    terms: tuple[csr_matrix, ...],
    moduli: tuple[Modulus, ...],
    first: int = 0,
) -> tuple[tuple[csr_matrix, ...], tuple[Modulus, ...]]:
    """Parts of K and their moduli, with a constant stiffness to ground.

    Args:
        names: names of the parameters.
        springs: stiffness to ground of each dof, (N,).
        terms: local rows of the parts of K, (own, N) each.
        moduli: modulus of each part; empty if K is constant.
        first: first of the local rows.
    """
    first_term = terms[0]
    rows = first + np.repeat(np.arange(first_term.shape[0]), np.diff(first_term.indptr))
    data = np.where(first_term.indices == rows, springs[rows], 0.0)
    if not moduli:
        return (
            csr_matrix(
                (first_term.data + data, first_term.indices, first_term.indptr),
                shape=first_term.shape,
            ),
        ), ()
    grounded = csr_matrix((data, first_term.indices, first_term.indptr), shape=first_term.shape)
    return (*terms, grounded), (*moduli, Modulus("1", "1", names))


class CommonPattern:
    """Union of the entries of several matrices of one mesh, (own, N), with stored zeros.

    Sums are then sums of data.
    """

    def __init__(self, matrices: list[csr_matrix]):
        # boolean entries, whose sums and products keep their order: entries of large matrices are
        # slow to sort
        patterns = [
            csr_matrix(
                (np.ones(matrix.nnz, bool), matrix.indices, matrix.indptr), shape=matrix.shape
            )
            for matrix in matrices
        ]
        union = reduce(add, patterns).astype(np.int32)
        union.data = np.arange(1, union.nnz + 1, dtype=np.int32)  # indices plus one: none is zero
        self._shape = union.shape
        self._indptr = union.indptr
        self._indices = union.indices
        self._places = [union.multiply(matrix).data - 1 for matrix in patterns]

    def filled(self, matrices: list[csr_matrix]) -> tuple[csr_matrix, ...]:
        """Matrices with the patterns of those, in the common one."""
        filled_matrices = []
        for matrix, indices in zip(matrices, self._places, strict=True):
            data = np.zeros(self._indices.size)
            data[indices] = matrix.data
            filled_matrices.append(
                csr_matrix((data, self._indices, self._indptr), shape=self._shape)
            )
        return tuple(filled_matrices)


def empty_matrix(space: DiscreteSpace) -> PETSc.Mat:
    """A matrix that couples the dofs of all cells."""
    return fem_petsc.create_matrix(space._mass_form)


def _assembled(discretisation: DiscreteSpace, members: dict[int, tuple[float, float]]) -> PETSc.Mat:
    """Stiffness of some bodies, weights of their parts by index, in the pattern of the whole
    mesh.
    """
    matrix = empty_matrix(discretisation)
    averaged = {
        index: moduli for index, moduli in members.items() if discretisation.mean_dilatation[index]
    }
    ordinary = [
        _form(discretisation, *weighted)
        for weighted in members.items()
        if weighted[0] not in averaged
    ]
    if ordinary:
        fem_petsc.assemble_matrix(matrix, compat.jitted(fem.form, sum(ordinary)))
    if averaged:
        add_stiffness(discretisation, matrix, averaged)
    matrix.assemble()
    return matrix


def _form(discretisation: DiscreteSpace, place: int, moduli: tuple[float, float]) -> ufl.Form:
    """Form of one body for given weights of its parts."""
    body = discretisation.scene.bodies[place]
    hypothesis = discretisation.scene.hypothesis
    dx = discretisation.cells(body.tag)
    trial, test = discretisation.arguments
    if (stress_of := discretisation.scene.own_stress(body, discretisation.mesh)) is not None:
        return elasticity.stiffness_of_law(trial, test, stress_of, hypothesis, dx)
    volume, shape = elasticity.isotropic_parts(elasticity.strain(trial, hypothesis), hypothesis)
    weights = [discretisation.constant(value) for value in moduli]
    stress = sum(
        weight * stress_part
        for weight, stress_part in zip(weights, (volume, shape), strict=True)
        if float(weight.value)
    )
    measured = elasticity.in_plane(elasticity.strain(test, hypothesis), hypothesis)
    weight = elasticity.volume_weight(discretisation.mesh, hypothesis) * grading_of(
        discretisation, body
    )
    return weight * ufl.inner(stress, measured) * dx


class StiffnessPart(NamedTuple):
    """A part of the stiffness of one body."""

    factor: str  #: see :class:`Modulus`
    rest: str
    moduli: tuple[float, float]  #: weights of the change of volume and of the change of shape


def parts_of(body: Body, hypothesis: str) -> Iterator[StiffnessPart]:
    """Parts of the stiffness of a body.

    Args:
        body: the body.
        hypothesis: hypothesis of the scene.
    """
    factor = body.young if isinstance(body.young, str) else repr(float(body.young))
    volume, shape = elasticity.unit_moduli(str(body.poisson), hypothesis)
    if isinstance(body.poisson, str):
        yield StiffnessPart(factor, volume, (1.0, 0.0))
        yield StiffnessPart(factor, shape, (0.0, 1.0))
    else:
        yield StiffnessPart(
            factor,
            "1",
            (Scalar(volume, ()).value(np.zeros(0)), Scalar(shape, ()).value(np.zeros(0))),
        )


def grading_of(discretisation: DiscreteSpace, body: Body) -> Expr | float:
    """Grading of a body's modulus as a field; 1 without a grading.

    Args:
        discretisation: functions on the mesh of the scene.
        body: the body.
    """
    if body.grading is None or discretisation.scene.states_stress(body):
        return 1.0
    return body.grading(ufl.SpatialCoordinate(discretisation.mesh))
