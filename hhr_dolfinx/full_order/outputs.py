"""Outputs of a scene as arrays: the part that needs the mesh."""

from __future__ import annotations

from dataclasses import fields
from functools import lru_cache, partial
from typing import TYPE_CHECKING

import numpy as np
import ufl
from dolfinx import fem
from scipy.sparse import csc_matrix, csr_matrix, hstack

from hhr_dolfinx import compat
from hhr_dolfinx.contact.problem import ContactProblem, masked, strained
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.forms import elasticity
from hhr_dolfinx.forms.elasticity import strain_vector
from hhr_dolfinx.models.functionals.cells import MovingCells
from hhr_dolfinx.models.functionals.functional import Functional, Functionals
from hhr_dolfinx.models.functionals.kinds import Energy, Mises, MovingMises
from hhr_dolfinx.outputs import ElasticEnergy, ModelProbe, Output, VonMises
from hhr_dolfinx.parameters import Tag
from hhr_dolfinx.shapes import coordinate_names

if TYPE_CHECKING:
    from hhr_dolfinx.body import Body
    from hhr_dolfinx.full_order.discrete_space import DiscreteSpace
    from hhr_dolfinx.full_order.with_laws import BodiesWithLaws
    from hhr_dolfinx.models.histories.equilibrium import FullEquilibrium


SHAPES = 8
"""Number of shapes whose outputs a full model keeps."""


class FullShapeFunctionals:
    """Outputs of a full model with variable shape, prepared on the mesh at a point.

    See :class:`~hhr_dolfinx.models.functionals.functional.ShapeFunctionals`.

    Args:
        discretisation: mesh and forms.
        problem: that of the middle of the box.

    Raises:
        SceneError: for an output that the model does not support.
    """

    def __init__(self, discretisation: DiscreteSpace, problem: ContactProblem):
        self.axes = np.array(problem.reshaped.axes, dtype=np.int64)
        self.parameters = problem.parameters
        self.amplitudes = problem.amplitudes
        self._discretisation = discretisation
        self._base = problem
        self._prepared = lru_cache(maxsize=SHAPES)(self._made)
        self.items = self.at(problem.middle).items

    def at(self, point: np.ndarray) -> Functionals:
        """Outputs for the shape at a point, (P,)."""
        return self._prepared(np.ascontiguousarray(point[self.axes], dtype=float).tobytes())

    def _made(self, key: bytes) -> Functionals:
        """Outputs for values of the parameters of the shape; the other parameters do not change their arrays."""
        point = self._base.middle
        reshaped = self._base.reshaped
        point[self.axes] = np.frombuffer(key)
        with reshaped.at(point):
            return prepared_outputs(self._discretisation, reshaped(point), None, self._base)


def functionals_of(
    discretisation: DiscreteSpace, problem: ContactProblem, equilibrium: FullEquilibrium | None
) -> Functionals | FullShapeFunctionals:
    """All outputs of a scene; the same on all ranks. Collective.

    Raises:
        SceneError: for an output that the model does not support.
    """
    if problem.reshaped is not None:
        return FullShapeFunctionals(discretisation, problem)
    return prepared_outputs(discretisation, problem, equilibrium, problem)


def prepared_outputs(
    discretisation: DiscreteSpace,
    problem: ContactProblem,
    equilibrium: FullEquilibrium | None,
    base: ContactProblem,
) -> Functionals:
    """Outputs on a mesh with its problem, the equilibrium of laws, and the mesh in which places are found."""
    items = [
        output.prepared(probe_of(output, discretisation, problem, equilibrium, base))
        for output in discretisation.scene.outputs
    ]
    found = Functionals(tuple(items), problem.free.size, problem.amplitudes)
    places = 0 if equilibrium is None else equilibrium.places
    found.check(problem.parameters, len(problem.gaps), places)
    return found


def probe_of(
    output: Output,
    discretisation: DiscreteSpace,
    problem: ContactProblem,
    laws: FullEquilibrium | BodiesWithLaws | None,
    base: ContactProblem,
) -> ModelProbe:
    """Interface for one output; arguments as in :func:`prepared_outputs`, or bodies with laws without equilibrium."""
    return ModelProbe(
        scene=discretisation.scene,
        problem=problem,
        base=base,
        contact_rows=problem.whole_contact,
        assembler=discretisation.assembler(output),
        nodes=partial(_nodes, discretisation, problem),
        mises=partial(_mises, discretisation, base, laws),
        energy=partial(_energy, discretisation, problem, laws),
    )


def _cells(discretisation: DiscreteSpace, tag: Tag) -> np.ndarray:
    """Cells of a body on all ranks, as a mask in the order of ``cell_nodes``."""
    tags = [body.tag for body in discretisation.scene.bodies]
    if tag not in tags:
        raise SceneError(
            f"the cell tag {tag} is none of the bodies {tags} of scene '{discretisation.scene.name}': name one of them"
        )
    discretisation.check_cells(tag)
    return np.concatenate(discretisation.comm.allgather(discretisation.cell_bodies())) == tags.index(tag)


def _nodes(discretisation: DiscreteSpace, problem: ContactProblem, tag: Tag) -> np.ndarray:
    """Nodes of a body."""
    return np.unique(problem.cell_nodes[_cells(discretisation, tag)])


def _mises(
    discretisation: DiscreteSpace,
    problem: ContactProblem,
    laws: FullEquilibrium | BodiesWithLaws | None,
    output: VonMises,
) -> Functional:
    """Von Mises' stress of the cells of an output."""
    try:
        inside = _cells(discretisation, output.tag)
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
    mean = output.kind == "mean"
    cells = np.flatnonzero(inside)
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
    found = Mises(output.name, output.unit, *matrix, names, *moduli, flat, factors, shares)
    if discretisation.reshaped is None:
        return found
    moving = moving_cells(discretisation, cells, mean_dilatation=discretisation.mean_dilatation[place])
    return MovingMises(**{item.name: getattr(found, item.name) for item in fields(found)}, cells=moving)


def moving_cells(discretisation: DiscreteSpace, cells: np.ndarray, *, mean_dilatation: bool) -> MovingCells:
    """Cells of a mesh with variable shape, as arrays; serial."""
    mesh = discretisation.mesh
    scene = discretisation.scene
    reshaped = discretisation.reshaped
    assert reshaped is not None
    kind = mesh.topology.cell_name()
    space = discretisation.space
    middle = compat.interpolation_points(fem.functionspace(mesh, ("Discontinuous Lagrange", 0)).element)
    points, weights = compat.quadrature(kind, discretisation.gauss_degree)
    # displacement and geometry have the same shape functions, with the same middles
    values, slopes = compat.shape_functions(kind, np.vstack([middle, points]), discretisation.order)
    nodes, cells_here = np.unique(space.dofmap.list[cells], return_inverse=True)
    cells_here = cells_here.reshape(len(cells), -1).astype(np.int64)
    geometry = compat.geometry_dofmap(mesh)[cells]
    of_geometry = np.full(nodes.size, -1)
    of_geometry[cells_here[:, : geometry.shape[1]]] = geometry
    moves = [np.isin(of_geometry, own) for own in reshaped.nodes]
    given = [(shape, mask) for shape, mask in zip(scene.shapes, moves, strict=True) if mask.any()]
    selected = slice(1, None) if mean_dilatation else slice(1, 1)
    return MovingCells(
        shapes=tuple(shape for shape, _ in given),
        moved=tuple(mask for _, mask in given),
        coordinates=coordinate_names(scene.hypothesis),
        parameters=scene.parameters.names,
        middles=reshaped.middles().among(nodes),
        points=reshaped.reference[of_geometry, : mesh.geometry.dim].copy(),
        nodes=nodes.astype(np.int64),
        cells=cells_here,
        values=values[0],
        slopes=slopes[0],
        weights=weights if mean_dilatation else np.zeros(0),
        gauss_values=values[selected],
        gauss_slopes=slopes[selected],
        axisymmetric=scene.hypothesis == "axisymmetric",
    )


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
    first = sum(discretisation.comm.allgather(_own_cells(discretisation))[: discretisation.comm.rank])
    own = cells[(cells >= first) & (cells < first + _own_cells(discretisation))] - first
    return _gathered(discretisation, _tabulated(discretisation, own.astype(np.int32), place))


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
    table = fem.Expression(strain_vector(ufl.TrialFunction(space), hypothesis), middle).eval(mesh, cells)
    strain = table.reshape(len(cells), components, dim * blocks.shape[1])
    if discretisation.mean_dilatation[place]:
        from hhr_dolfinx.full_order.gauss_points import tabulated

        # the trace at each Gauss point is already its mean over the cell
        mean = tabulated(discretisation, cells).gradients[:, 0, :3].sum(axis=1)
        strain[:, :3] += ((mean - strain[:, :3].sum(axis=1)) / 3)[:, None]
    grading = np.ones(len(cells))
    body = discretisation.scene.bodies[place]
    if body.grading is not None:
        from hhr_dolfinx.full_order.gauss_points import grading_of

        factor = grading_of(discretisation, body) + 0 * ufl.SpatialCoordinate(mesh)[0]
        grading = fem.Expression(factor, middle).eval(mesh, cells).reshape(len(cells))
    weight = elasticity.volume_weight(mesh, hypothesis) * ufl.TestFunction(constants) * ufl.dx(mesh)
    volumes = fem.assemble_vector(fem.form(weight)).array[constants.dofmap.list[cells].ravel()]
    nodes = space.dofmap.index_map.local_to_global(blocks.ravel().astype(np.int32)).reshape(blocks.shape)
    dofs = (dim * nodes[:, :, None] + np.arange(dim)).reshape(len(cells), dim * blocks.shape[1])
    return strain, dofs, grading, volumes


def _gathered(discretisation: DiscreteSpace, parts: tuple[np.ndarray, ...]) -> list[np.ndarray]:
    """Arrays of the cells of all ranks, concatenated."""
    return [np.concatenate(part) for part in zip(*discretisation.comm.allgather(parts), strict=True)]


def _energy(
    discretisation: DiscreteSpace,
    problem: ContactProblem,
    laws: FullEquilibrium | BodiesWithLaws | None,
    output: ElasticEnergy,
) -> Functional:
    """Elastic energy by the work of all forces."""
    if laws is not None:
        raise SceneError(
            f"output '{output.name}': bodies of scene '{discretisation.scene.name}' have laws, and the work of forces "
            "is not their elastic energy: leave it out"
        )
    if problem.law.remembers:
        raise SceneError(
            f"output '{output.name}': with {problem.law.name} the work of forces is not elastic energy alone: leave it "
            "out"
        )
    names = problem.parameters.names
    moduli = tuple(f"({modulus.factor}) * ({modulus.rest})" for modulus in problem.moduli) or ("1",)
    stiffness = problem.stiffness_terms if problem.moduli else (problem.own_stiffness,)
    external = problem.external
    moving = discretisation.reshaped is not None  # other terms may act for another shape
    loaded = np.arange(external.shape[1]) if moving else np.flatnonzero(np.diff(external.indptr))
    lifted = np.flatnonzero(np.diff(problem.lifts.tocsc().indptr))
    lifts = problem.lifts.tocsc()[:, lifted]
    pulled = [csc_matrix(problem.from_rows(csr_matrix(strained(part, lifts)))) for part in stiffness]
    blocks = [external[:, loaded], *(masked(csc_matrix(part), problem.free) for part in pulled)]
    entries = hstack([csc_matrix(block) for block in blocks]).T.tocoo()
    own = (entries.tocsr() @ lifts).toarray()
    terms = np.concatenate([loaded, np.tile(lifted, len(stiffness))]).astype(np.int64)
    parts = np.concatenate([np.full(loaded.size, -1), np.repeat(np.arange(len(stiffness)), lifted.size)])
    matrix = terms.size, entries.row.astype(np.int64), entries.col.astype(np.int64), entries.data
    squares = np.array([(lifts.T @ part).toarray() for part in pulled]).reshape(
        len(stiffness), lifted.size, lifted.size
    )
    gap_terms = loaded if moving else np.flatnonzero(problem.gaps.any(axis=0)).astype(np.int64)
    gaps = np.ascontiguousarray(problem.gaps[:, gap_terms])
    rest = terms, parts.astype(np.int64), lifted.astype(np.int64), squares, gap_terms, gaps, own
    return Energy(output.name, output.unit, *matrix, names, moduli, *rest)
