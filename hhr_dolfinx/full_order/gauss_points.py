"""From UFL to arrays at Gauss points: the strain of bodies with a mean dilatation, or of bodies with laws.

Eigenstrains ε0, such as thermal ones, are subtracted from the strain, σ = C (ε - ε0): F is ∫ C ε0 : ε(v), and
stresses exclude ε0. Laws of bodies use ε - ε0 at Gauss points, so that internal forces contain a part that otherwise
belongs to F.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc
from ufl.core.expr import Expr

from hhr_dolfinx import compat
from hhr_dolfinx.amplitudes import Amplitude
from hhr_dolfinx.body import Body
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.forms import elasticity, volume
from hhr_dolfinx.forms.elasticity import strain_vector, volume_weight
from hhr_dolfinx.formulas import Formula, Scalar
from hhr_dolfinx.parameters import Tag

if TYPE_CHECKING:
    from hhr_dolfinx.full_order.discrete_space import DiscreteSpace


class CellStrains(NamedTuple):
    """Strain ε = G u at the Gauss points of some cells, Kelvin's notation."""

    gradients: np.ndarray  # matrix G of each cell, (cells, per_cell, components, dofs of a cell)
    weights: np.ndarray  # quadrature weight times volume of each Gauss point, (cells, per_cell)
    dofs: np.ndarray  # local number of each dof of a cell, (cells, dofs of a cell)

    @property
    def per_cell(self) -> int:
        """Gauss points of a cell."""
        return self.weights.shape[1]

    @property
    def components(self) -> int:
        """Components of a strain."""
        return self.gradients.shape[2]

    def element_stiffness(self, tangents: np.ndarray) -> np.ndarray:
        """Element stiffness matrices, (cells, d, d), for tangents H, (gauss_points, components, components)."""
        cells, per_cell, components, d = self.gradients.shape
        moduli = tangents.reshape(cells, per_cell, components, components)
        flux = moduli @ (self.weights[:, :, None, None] * self.gradients)
        rows = per_cell * components
        return self.gradients.reshape(cells, rows, d).transpose(0, 2, 1) @ flux.reshape(cells, rows, d)


def add_stiffness(discretisation: DiscreteSpace, matrix: PETSc.Mat, moduli: dict[int, tuple[float, float]]) -> None:
    """Add the stiffness of bodies with a mean dilatation, by index: λ and μ of each; on each rank that of its cells."""
    bodies = discretisation.cell_bodies()
    cells = np.flatnonzero(np.isin(bodies, list(moduli)))
    operator = tabulated(discretisation, cells)
    of_point = np.repeat(bodies[cells], operator.per_cell)
    identity = np.eye(operator.components)
    unit = np.zeros(operator.components)
    unit[:3] = 1.0
    elastic = np.empty((of_point.size, *identity.shape))
    for place, (lam, mu) in moduli.items():
        elastic[of_point == place] = lam * np.outer(unit, unit) + 2 * mu * identity
    elastic *= gradings(discretisation, moduli, cells).reshape(-1, 1, 1)
    dofs = operator.dofs.astype(PETSc.IntType)
    elements = operator.element_stiffness(elastic).reshape(len(cells), dofs.shape[1] ** 2)
    matrix.setValuesLocalRCV(dofs, dofs, elements, addv=PETSc.InsertMode.ADD)


def gradings(discretisation: DiscreteSpace, places: Iterable[int], cells: np.ndarray) -> np.ndarray:
    """Grading of the moduli of bodies, by their indices, at the Gauss points of cells, (cells, per_cell)."""
    mesh = discretisation.mesh
    bodies = discretisation.cell_bodies()[cells]
    points, weights = compat.quadrature(mesh.topology.cell_name(), discretisation.gauss_degree)
    found = np.ones((len(cells), len(weights)))
    for place in places:
        grading = discretisation.scene.bodies[place].grading
        own = np.flatnonzero(bodies == place)
        if grading is not None:
            # a grading that is a number has no mesh
            plain = abs(ufl.JacobianDeterminant(mesh))
            parts = (grading(ufl.SpatialCoordinate(mesh)) * plain, plain)
            graded, size = (
                compat.jitted(fem.Expression, part, points).eval(mesh, cells[own].astype(np.int32)) for part in parts
            )
            found[own] = (graded / size).reshape(len(own), len(weights))
    return found


def tabulated(discretisation: DiscreteSpace, cells: np.ndarray) -> CellStrains:
    """Strain at the Gauss points of some cells of this rank, with local numbers of the dofs; collective."""
    compat.require_numba()
    mesh = discretisation.mesh
    space = discretisation.space
    hypothesis = discretisation.scene.hypothesis
    cells = cells.astype(np.int32)
    points, weights = compat.quadrature(mesh.topology.cell_name(), discretisation.gauss_degree)
    table = compat.jitted(fem.Expression, strain_vector(ufl.TrialFunction(space), hypothesis), points).eval(mesh, cells)
    measure = volume_weight(mesh, hypothesis) * abs(ufl.JacobianDeterminant(mesh))
    volumes = weights * compat.jitted(fem.Expression, measure, points).eval(mesh, cells).reshape(
        len(cells), len(weights)
    )
    dim = mesh.geometry.dim
    blocks = space.dofmap.list[cells]
    # all sizes are given, since a rank may have no such cell
    of_cell = dim * blocks.shape[1]
    components = 6 if hypothesis == "solid" else 4
    dofs = (dim * blocks[:, :, None] + np.arange(dim)).reshape(len(cells), of_cell).astype(np.int64)
    gradients = np.ascontiguousarray(table.reshape(len(cells), len(weights), components, of_cell))
    mean = np.flatnonzero(np.array(discretisation.mean_dilatation)[discretisation.cell_bodies()[cells]])
    gradients[mean] = _with_mean_dilatation(gradients[mean], volumes[mean])
    return CellStrains(gradients, volumes, dofs)


def _with_mean_dilatation(gradients: np.ndarray, volumes: np.ndarray) -> np.ndarray:
    """B-bar: replace the trace of the strain, see :class:`CellStrains`, by its mean over the volume of the cell."""
    trace = gradients[:, :, :3].sum(axis=2)
    shares = volumes / volumes.sum(axis=1, keepdims=True)
    mean = np.einsum("cq,cqk->ck", shares, trace)
    changed = gradients.copy()
    changed[:, :, :3] += (mean[:, None] - trace)[:, :, None] / 3
    return changed


def eigenstress(
    discretisation: DiscreteSpace, tag: Tag, strain: Expr, vector: Callable[[ufl.Form], np.ndarray]
) -> list[tuple[Formula, np.ndarray]]:
    """Nodal forces that produce an eigenstrain of a free body, 3x3.

    Each part of its stiffness gives its modulus, an expression of the parameters, and forces for the modulus 1, (N,).
    For bodies with laws these are zero: a single zero vector makes the amplitude of the strain a term of θ.

    Raises:
        SceneError: if no body has the tag.
    """
    scene = discretisation.scene
    tags = [body.tag for body in scene.bodies]
    if tag not in tags:
        raise SceneError(
            f"an eigenstrain is that of cell tag {tag}, and the bodies of scene '{scene.name}' have the tags {tags}"
        )
    place = tags.index(tag)
    body = scene.bodies[place]
    if scene.reader:
        return [(Formula("1"), np.zeros(discretisation.size))]
    hypothesis = scene.hypothesis
    dx = discretisation.cells(tag)
    if body.stress is not None:
        own = elasticity.law_in(body.stress, hypothesis)(strain)
        work = ufl.inner(own, elasticity.strain(discretisation.arguments[1], hypothesis))
        return [(Formula("1"), vector(elasticity.volume_weight(discretisation.mesh, hypothesis) * work * dx))]
    if discretisation.mean_dilatation[place]:  # the strain at the points at which the body evaluates its strain
        dx = dx(degree=discretisation.gauss_degree)
    measured = elasticity.in_plane(elasticity.strain(discretisation.arguments[1], hypothesis), hypothesis)
    weight = elasticity.volume_weight(discretisation.mesh, hypothesis)
    # the product of two means is not the mean of the product, which the form needs
    graded = averaged(discretisation, place, _graded(discretisation, place, strain))
    stresses = elasticity.isotropic_parts(graded, hypothesis)
    found = []
    for part in parts_of(body, hypothesis):
        moduli = map(discretisation.constant, part.moduli)
        stress = sum(modulus * item for modulus, item in zip(moduli, stresses, strict=True) if float(modulus.value))
        forces = vector(weight * ufl.inner(stress, measured) * dx)
        found.append((Formula(part.factor).times(Formula(part.rest)), forces))
    return found


def eigenstrain_at(discretisation: DiscreteSpace, place: int, point: np.ndarray) -> Expr | None:
    """Eigenstrain of a body at a point of the parameters, (P,), times its grading; None without eigenstrains."""
    scene = discretisation.scene
    tag = scene.bodies[place].tag
    total = None
    for load in scene.loads:
        if hasattr(load, "eigenstrain_of") and (found := load.eigenstrain_of(tag, discretisation.mesh)) is not None:
            amplitude, strain = found
            names = scene.parameters.names
            if isinstance(amplitude, Amplitude):
                slopes = (slope * point[names.index(name)] for name, slope in amplitude.slopes.items())
                value = discretisation.constant(amplitude.constant + sum(slopes))
            else:
                value = discretisation.constant(Scalar(amplitude.text, names).value(point))
            total = value * strain if total is None else total + value * strain
    return None if total is None else _graded(discretisation, place, total)


def _graded(discretisation: DiscreteSpace, place: int, strain: Expr) -> Expr:
    """A strain of a body times its grading."""
    return grading_of(discretisation, discretisation.scene.bodies[place]) * averaged(discretisation, place, strain)


def averaged(discretisation: DiscreteSpace, place: int, strain: Expr) -> Expr:
    """A strain with the mean change of volume of each cell, if the body uses the mean dilatation."""
    if not discretisation.mean_dilatation[place]:
        return strain
    return volume.with_mean(strain, discretisation.cell_means(ufl.tr(strain)))


class Part(NamedTuple):
    """A part of the stiffness of one body."""

    factor: str  # see :class:`Modulus`
    rest: str
    moduli: tuple[float, float]  # weights of the change of volume and of the change of shape


def parts_of(body: Body, hypothesis: str) -> Iterator[Part]:
    """Parts of the stiffness of a body."""
    factor = body.young if isinstance(body.young, str) else repr(float(body.young))
    volume, shape = elasticity.unit_moduli(str(body.poisson), hypothesis)
    if isinstance(body.poisson, str):
        yield Part(factor, volume, (1.0, 0.0))
        yield Part(factor, shape, (0.0, 1.0))
    else:
        yield Part(factor, "1", (Scalar(volume, ()).value(np.zeros(0)), Scalar(shape, ()).value(np.zeros(0))))


def grading_of(discretisation: DiscreteSpace, body: Body) -> object:
    """Grading of a body's modulus as a field; 1 without a grading."""
    return 1.0 if body.grading is None else body.grading(ufl.SpatialCoordinate(discretisation.mesh))
