"""Von Mises' stress from the mesh: strains of cells and moduli."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import ufl
from dolfinx import fem
from ufl.domain import extract_domains

from hhr_dolfinx import compat
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.forms import elasticity
from hhr_dolfinx.forms.elasticity import strain_vector
from hhr_dolfinx.full_order.outputs import cells_of_body
from hhr_dolfinx.models.functionals.functional import Functional
from hhr_dolfinx.plugins.stress.kinds import Mises

if TYPE_CHECKING:
    from hhr_dolfinx.body import Body
    from hhr_dolfinx.full_order.discrete_space import DiscreteSpace
    from hhr_dolfinx.outputs import ModelProbe


def _cells_of(discretisation: DiscreteSpace, problem: ContactProblem, output: Any) -> np.ndarray:
    """Numbers of the cells of a body within the box of an output."""
    try:
        inside = cells_of_body(discretisation, output.tag)
    except SceneError as error:
        raise SceneError(f"output '{output.name}': {error}") from None
    if output.where is not None:
        middles = problem.points[problem.cell_nodes].mean(axis=1)
        if any(len(corner) != middles.shape[1] for corner in output.where):
            raise SceneError(
                f"output '{output.name}': where = {output.where} must have {middles.shape[1]} coordinates, as the mesh"
            )
        within = (middles >= np.array(output.where[0])) & (middles <= np.array(output.where[1]))
        if not (inside & within.all(axis=1)).any():
            low = middles[inside].min(axis=0).tolist()
            high = middles[inside].max(axis=0).tolist()
            raise SceneError(
                f"output '{output.name}': no cell of body {output.tag} has its middle in {output.where}; they lie "
                f"between {low} and {high}: enlarge the box"
            )
        inside &= within.all(axis=1)
    return np.flatnonzero(inside)


def mises_of(probe: ModelProbe, output: Any) -> Functional:
    """Stress of the cells of an output, a ``VonMises``."""
    discretisation = probe.discretisation
    laws = probe.laws
    cells = _cells_of(discretisation, probe.base, output)
    mean = output.kind == "mean"
    if laws is not None:
        return laws.mises(output, cells)
    place = next(k for k, body in enumerate(discretisation.scene.bodies) if body.tag == output.tag)
    if discretisation.scene.bodies[place].stress is not None:
        raise SceneError(f"output '{output.name}': body {output.tag!r} has a stress of its own: ask answer.stress()")
    strain, dofs, factors, volumes = strains_of_cells(discretisation, cells, place)
    count, components, _ = strain.shape
    rows = np.broadcast_to(np.arange(count * components).reshape(count, components, 1), strain.shape)
    columns = np.broadcast_to(dofs[:, None], strain.shape)
    used = strain != 0
    matrix = count * components, rows[used].astype(np.int64), columns[used].astype(np.int64), strain[used]
    body = discretisation.scene.bodies[place]
    scene = discretisation.scene
    moduli = moduli_of(body, scene.hypothesis)
    flat = scene.hypothesis == "plane_stress"
    shares = volumes / volumes.sum() if mean else np.zeros(0)
    names = scene.parameters.names
    return probe.on_cells(Mises(output.name, output.unit, *matrix, names, *moduli, flat, factors, shares), cells)


def moduli_of(body: Body, hypothesis: str) -> tuple[str, str]:
    """λ' and μ' of a body as expressions of the parameters, see :func:`elasticity.isotropic_parts`."""
    young = _text(body.young)
    volume, shape = elasticity.unit_moduli(_text(body.poisson), hypothesis)
    return f"({young}) * ({volume})", f"({young}) * ({shape})"


def _text(value: float | str) -> str:
    """A number or an expression as an expression, without loss of digits."""
    return value if isinstance(value, str) else repr(float(value))


def _own_cells(discretisation: DiscreteSpace) -> int:
    """Number of the cells of this rank."""
    return discretisation.mesh.topology.index_map(discretisation.mesh.topology.dim).size_local


def strains_of_cells(discretisation: DiscreteSpace, cells: np.ndarray, place: int) -> list[np.ndarray]:
    """Strain in the middles of cells of a body, its dofs, the factor of the modulus, and the volumes. Collective.

    (c, components, k), (c, k), (c,), (c,); the strain has the mean dilatation of the cells if the body uses it.

    Args:
        discretisation: the mesh.
        cells: increasing, in the order of ``cell_nodes``, (c,).
        place: index of the body in the scene.
    """
    first = sum(discretisation.group.gathered(_own_cells(discretisation))[: discretisation.group.number])
    own = cells[(cells >= first) & (cells < first + _own_cells(discretisation))] - first
    parts = discretisation.group.gathered(_tabulated(discretisation, own.astype(np.int32), place))
    return [np.concatenate(part) for part in zip(*parts, strict=True)]


def _tabulated(discretisation: DiscreteSpace, cells: np.ndarray, place: int) -> tuple[np.ndarray, ...]:
    """The same arrays for some cells of this rank."""
    mesh = discretisation.mesh
    space = discretisation.space
    hypothesis = discretisation.scene.hypothesis
    constants = fem.functionspace(mesh, ("Discontinuous Lagrange", 0))
    middle = compat.interpolation_points(constants.element)
    dim = mesh.geometry.dim
    components = 6 if hypothesis == "solid" else 4
    blocks = space.dofmap.list[cells]
    table = compat.jitted(fem.Expression, strain_vector(ufl.TrialFunction(space), hypothesis), middle).eval(mesh, cells)
    strain = table.reshape(len(cells), components, dim * blocks.shape[1])
    if discretisation.mean_dilatation[place]:
        from hhr_dolfinx.plugins.elasticity.gauss_points import tabulated

        # the trace at each Gauss point is already its mean over the cell
        mean = tabulated(discretisation, cells).gradients[:, 0, :3].sum(axis=1)
        strain[:, :3] += ((mean - strain[:, :3].sum(axis=1)) / 3)[:, None]
    grading = np.ones(len(cells))
    body = discretisation.scene.bodies[place]
    if body.grading is not None:
        from hhr_dolfinx.plugins.elasticity.parts import grading_of

        factor = ufl.as_ufl(grading_of(discretisation, body))
        if extract_domains(factor):
            grading = compat.jitted(fem.Expression, factor, middle).eval(mesh, cells).reshape(len(cells))
        else:  # a grading that is a number has no mesh
            grading *= float(factor)
    weight = elasticity.volume_weight(mesh, hypothesis) * ufl.TestFunction(constants) * ufl.dx(mesh)
    volumes = fem.assemble_vector(compat.jitted(fem.form, weight)).array[constants.dofmap.list[cells].ravel()]
    nodes = space.dofmap.index_map.local_to_global(blocks.ravel().astype(np.int32)).reshape(blocks.shape)
    dofs = (dim * nodes[:, :, None] + np.arange(dim)).reshape(len(cells), dim * blocks.shape[1])
    return strain, dofs, grading, volumes
