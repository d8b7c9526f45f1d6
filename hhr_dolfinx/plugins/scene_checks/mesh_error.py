"""Discretisation error of a full-order answer: recovered stresses.

Reduction errors refer to the full order on the same mesh; this is the error of both. Stresses of
cells jump between cells. Their projection on continuous functions of the degree of the
displacement, body by body, is closer to the exact ones, and the difference estimates the error (O.
C. Zienkiewicz and J. Z. Zhu, Int. J. Numer. Methods Eng. 24, 1987). It is an estimate, not a bound.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import ufl
from dolfinx import fem
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import cg
from ufl.core.expr import Expr

from hhr_dolfinx import compat
from hhr_dolfinx.errors import ConvergenceError, NotOfferedError, ParameterError
from hhr_dolfinx.forms import elasticity
from hhr_dolfinx.full_order.elasticity import field_of
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.models.answer import Answer

PROJECTION_RESIDUAL = 1e-8
"""Residual of the projections: masses are well-conditioned, and some twenty steps reach it."""


class MeshError(NamedTuple):
    """Relative discretisation error of an answer.

    Attributes:
        energy: error of the stress over the stress, both in energy.
        peak_pressure: difference between the peak pressure of contact and the recovered stress
            there, over it; NaN without contact.
    """

    energy: float
    peak_pressure: float

    def in_words(self) -> str:
        """One sentence."""
        none = math.isnan(self.peak_pressure)
        peak = "no contact there" if none else f"{self.peak_pressure:.2%} of the peak pressure"
        return (
            f"mesh: off by {self.energy:.2%} of the stress in energy and {peak}, estimated by "
            "recovered stresses"
        )


def mesh_error(full: FullOrderModel, answer: Answer) -> MeshError:
    """Estimate the discretisation error of an answer, (N,) displacement and forces, of any model of
    the scene.

    Args:
        full: the full model of the scene, on one rank.
        answer: of it, or of a reduced model.

    Raises:
        ParameterError: for an invalid answer, or one of another scene.
        NotOfferedError: for bodies with laws, bodies with a user-defined stress, or a model on
            several ranks.
    """
    if not hasattr(full, "discretisation") or not isinstance(answer, Answer):
        raise ParameterError(
            "mesh_error needs the full model of a scene and an answer, mesh_error(full, "
            "full.solve(mu))"
        )
    full.problem.require_parts("an estimate of the error of the mesh")
    discretisation = full.discretisation
    scene = full.scene
    if (
        full.comm.size > 1
        or full.equilibrium is not None
        or any(map(scene.states_stress, scene.bodies))
    ):
        raise NotOfferedError(
            "the error of the mesh is estimated for elastic bodies, on one rank: give a model on "
            "MPI.COMM_SELF, of a scene without user-defined laws"
        )
    point = answer.parameter
    if (
        len(answer.displacement()) != full.problem.free.size
        or len(answer.forces()) != full.conditions
    ):
        raise ParameterError(
            f"the answer is of another scene or mesh than '{scene.name}', of which the full model "
            "is"
        )
    with discretisation.shape.at(point):
        field = field_of(discretisation, answer.displacement())
        energies = np.array(
            [_energies(full, index, field, point) for index in range(len(scene.bodies))]
        )
        bearing = _nodal_forces(full, field, point)
    error, size = energies.sum(axis=0)
    energy = float(np.sqrt(error / (size + error))) if size + error > 0 else 0.0
    return MeshError(energy, _peak_error(full, answer, bearing))


def _nodal_forces(full: FullOrderModel, field: fem.Function, point: np.ndarray) -> np.ndarray:
    """Nodal forces of the stress of all bodies, (N,): the sum of all that acts on the nodes from
    outside.
    """
    discretisation = full.discretisation
    test = ufl.TestFunction(field.function_space)
    weight = elasticity.volume_weight(discretisation.mesh, full.scene.hypothesis)
    virtual = elasticity.strain(test, full.scene.hypothesis)
    total = np.zeros(full.problem.free.size)
    for k, body in enumerate(full.scene.bodies):
        work = weight * ufl.inner(
            discretisation.elasticity.stress(discretisation, k, field, point), virtual
        )
        total += np.real(
            fem.assemble_vector(fem.form(work * discretisation.cells(body.tag))).array
        )[: total.size]
    return total


def _energies(
    full: FullOrderModel, index: int, field: fem.Function, point: np.ndarray
) -> tuple[float, float]:
    """Energies of the error of the stress of a body, by its index, and of the stress."""
    discretisation = full.discretisation
    scene = full.scene
    body = scene.bodies[index]
    mesh = discretisation.mesh
    weight = elasticity.volume_weight(mesh, scene.hypothesis)
    dx = discretisation.cells(body.tag)
    sigma = discretisation.elasticity.stress(discretisation, index, field, point)
    scalars = fem.functionspace(mesh, ("Lagrange", discretisation.order))
    trial = ufl.TrialFunction(scalars)
    test = ufl.TestFunction(scalars)
    mass = csr_matrix(
        fem.assemble_matrix(compat.jitted(fem.form, weight * trial * test * dx)).to_scipy()
    )
    recovered: dict[tuple[int, int], fem.Function] = {}
    for i, j in [
        (0, 0),
        (1, 1),
        (2, 2),
        (0, 1),
        *([(0, 2), (1, 2)] if scene.hypothesis == "solid" else []),
    ]:
        component = fem.Function(scalars)
        component.x.array[:] = _projected(
            mass,
            fem.assemble_vector(compat.jitted(fem.form, weight * sigma[i, j] * test * dx)).array,
        )
        recovered[i, j] = recovered[j, i] = component
    tensor = ufl.as_tensor([[recovered.get((i, j), 0.0) for j in range(3)] for i in range(3)])
    names = scene.parameters.names
    young, poisson = (
        discretisation.constant(_number(value, names, point))
        for value in (body.young, body.poisson)
    )
    if body.grading is not None:  # a factor of the modulus
        weight = weight / body.grading(ufl.SpatialCoordinate(mesh))
    error, size = (
        float(
            np.real(
                fem.assemble_scalar(
                    compat.jitted(fem.form, weight * _energy(stress, young, poisson) * dx)
                )
            )
        )
        for stress in (tensor - sigma, sigma)
    )
    return error, size


def _peak_error(full: FullOrderModel, answer: Answer, bearing: np.ndarray) -> float:
    """Difference between the largest pressure of contact and the mean stress of the cells at its
    node, over it.

    Loads and springs that act on the same facets are in the stress and not in the pressure. They
    are the part of the nodal forces of the stress, (N,), that contact does not bear, and are
    subtracted.

    On a block under a bowl (``bowl`` in benchmarks/second_order.py) it was 0.073, 0.038 and 0.028
    with linear functions and the error of the peak 0.068, 0.044 and 0.038. With quadratic ones it
    was 0.195, 0.056 and 0.022, and the error 0.157, 0.024 and 0.002.
    """
    problem = full.problem.at(answer.parameter)
    rows = np.arange(len(problem.gaps))[problem.pressing]
    rows = rows[problem.contact_areas[rows] > 0]
    pressures = answer.forces()[rows] / problem.contact_areas[rows]
    if not pressures.max(initial=0.0) > 0:
        return float("nan")
    worst = rows[int(pressures.argmax())]
    node = int(problem.contact_slaves[worst])
    dim = problem.block_size
    assert problem.whole_contact is not None
    row = problem.whole_contact[worst]
    of_node = row.indices // dim == node
    normal = np.zeros(3)
    normal[row.indices[of_node] % dim] = row.data[of_node] / np.linalg.norm(row.data[of_node])
    around = (problem.cell_nodes == node).any(axis=1)
    stress = full.stress_of(answer.displacement(), answer.parameter)[around].mean(axis=0)
    peak = float(pressures.max())
    # n·σ n in Kelvin's notation, (4,) or (6,)
    shear = np.sqrt(2) * np.array(
        [normal[0] * normal[1], normal[0] * normal[2], normal[1] * normal[2]]
    )
    along = float(stress @ np.append(normal**2, shear)[: stress.size])
    nodal_forces = np.where(
        problem.free, bearing + problem.whole_contact.T @ answer.forces(), 0.0
    )  # no reactions of supports
    beside = (
        float(nodal_forces[dim * node : dim * node + dim] @ normal[:dim])
        / problem.contact_areas[worst]
    )
    return float(abs(beside - along - peak) / peak)


def _number(value: float | str, names: tuple[str, ...], point: np.ndarray) -> float:
    """A constant at a point of the parameters."""
    if not isinstance(value, str):
        return float(value)
    from hhr_dolfinx.formulas import Scalar

    return float(Scalar(value, names).value(point))


def _energy(stress: Expr, young: fem.Constant, poisson: fem.Constant) -> Expr:
    """σ : C^-1 σ of an isotropic body."""
    return (1 + poisson) / young * ufl.inner(stress, stress) - poisson / young * ufl.tr(stress) ** 2


def _projected(mass: csr_matrix, loads: np.ndarray) -> np.ndarray:
    """Nodal values of a projection on one body, zero outside of it."""
    of_body = mass.diagonal() > 0
    matrix = csr_matrix(mass[of_body][:, of_body])
    values = np.zeros(of_body.size)
    values[of_body], failed = cg(
        matrix, loads[of_body], rtol=PROJECTION_RESIDUAL, M=diags(1 / matrix.diagonal())
    )
    if failed:
        raise ConvergenceError(
            "stresses could not be recovered: cells of the mesh are too flat. Mend them"
        )
    return values
