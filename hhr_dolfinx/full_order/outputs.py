"""Outputs of a scene as arrays: the part that needs the mesh."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
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
from hhr_dolfinx.models.functionals.functional import Functional, Functionals
from hhr_dolfinx.models.functionals.kinds import Energy, Mises
from hhr_dolfinx.outputs import ContactOutput, ElasticEnergy, ModelProbe, Output, VonMises
from hhr_dolfinx.parameters import Tag

if TYPE_CHECKING:
    from hhr_dolfinx.body import Body
    from hhr_dolfinx.full_order.discrete_space import DiscreteSpace
    from hhr_dolfinx.full_order.with_laws import BodiesWithLaws
    from hhr_dolfinx.loads import Assembler
    from hhr_dolfinx.models.functionals.functional import ShapeFunctionals
    from hhr_dolfinx.models.histories.equilibrium import FullEquilibrium
    from hhr_dolfinx.outputs import PlacedOutput
    from hhr_dolfinx.scene import Scene


@dataclass(frozen=True)
class Probe:
    """Interface of the finite element model for an output; calls are collective.

    Attributes:
        scene: the scene.
        problem: the contact problem.
        base: the problem on the mesh in which outputs find points and boxes: that of the middle of the box if a shape
            depends on parameters, so that an output keeps its nodes and cells; otherwise ``problem``.
        contact_rows: B with the columns of imposed dofs, (N_lambda, N).
        assembler: interface of loads.
        nodes: numbers of the nodes of a body, by its cell tag; refuses unknown tags.
        mises: von Mises' stress of the cells of a body within a box, given by its corners or None.
        energy: elastic energy.
    """

    scene: Scene
    problem: ContactProblem
    base: ContactProblem
    contact_rows: csr_matrix
    assembler: Assembler
    nodes: Callable[[Tag], np.ndarray]
    mises: Callable[[VonMises], Functional]
    energy: Callable[[ElasticEnergy], Functional]

    @property
    def dimension(self) -> int:
        """Components of a displacement."""
        return self.problem.block_size

    def conditions(self, output: ContactOutput) -> np.ndarray:
        """Numbers of the conditions of pressures of the contact of an output."""
        contacts = len(self.scene.contacts)
        if output.contact >= contacts:
            raise SceneError(
                f"output '{output.name}' names contact {output.contact}, and the scene has {contacts}, counted from 0"
            )
        found = self.problem.pressing_of(output.contact)
        if not found.size:
            raise SceneError(
                f"output '{output.name}' names contact {output.contact}, of which no condition moves: name another"
            )
        return found

    def loaded(self, output: ContactOutput) -> tuple[np.ndarray, np.ndarray]:
        """Conditions of a contact with a positive area, and their areas."""
        conditions = self.conditions(output)
        conditions = conditions[self.problem.contact_areas[conditions] > 0]
        if not conditions.size:
            raise SceneError(f"output '{output.name}': no condition of contact {output.contact} has an area")
        return conditions, self.problem.contact_areas[conditions]

    def at_place(self, output: PlacedOutput, points: np.ndarray) -> np.ndarray:
        """Numbers of the points, (n, dim), of ``base`` nearest to the place of an output; several if they coincide.

        Raises:
            SceneError: for a place farther from all of them than the length of a cell.
        """
        dim = self.dimension
        place = np.array(output.place, dtype=float)
        if place.size != dim:
            raise SceneError(f"output '{output.name}': the place {output.place} must have {dim} coordinates")
        distances = np.linalg.norm(points - place, axis=1)
        nearest = int(distances.argmin())
        size = self._cell_size(points[nearest])
        if distances[nearest] > size:
            raise SceneError(
                f"output '{output.name}': the place {output.place} is {distances[nearest]:.4g} away from the nearest "
                f"point at {points[nearest].tolist()}, and a cell there is {size:.4g} long: move it"
            )
        return np.flatnonzero(distances <= distances[nearest] + 1e-6 * size)

    def _cell_size(self, point: np.ndarray) -> float:
        """Length of the largest cell at the node nearest to a point."""
        cells = self.base.cell_nodes
        nodes = self.base.points
        nearest = np.linalg.norm(nodes - point, axis=1).argmin()
        at_node = cells[(cells == nearest).any(axis=1)]
        return float(np.linalg.norm(np.ptp(nodes[at_node], axis=1), axis=1).max(initial=0.0))

    def terms(self, entries: np.ndarray) -> np.ndarray:
        """Terms of θ with entries, (1 + T,)."""
        return np.flatnonzero(entries)

    def nodal_forces(self, output: ContactOutput) -> tuple[np.ndarray, np.ndarray, csr_matrix]:
        """Conditions of a contact, positions of its first surface's nodes, and the forces on them.

        These are -B^T λ on the body of the first surface, the slave, including friction: (c,), (n, dim), sparse
        (c, n dim).
        """
        self.conditions(output)
        conditions = np.flatnonzero(self.problem.contact_pairs == output.contact)
        surface = self.assembler.surface(self.scene.contacts[output.contact].tags[0])
        dofs = (surface.nodes[:, None] * self.dimension + np.arange(self.dimension)).ravel()
        return conditions, surface.points, csr_matrix(-self.contact_rows[conditions][:, dofs])


if TYPE_CHECKING:

    def _is_model_probe(probe: Probe) -> ModelProbe:
        """Hold the class to the interface that outputs are written for."""
        return probe


def functionals_of(
    discretisation: DiscreteSpace, problem: ContactProblem, equilibrium: FullEquilibrium | None
) -> Functionals | ShapeFunctionals:
    """All outputs of a scene; the same on all ranks. Collective.

    Raises:
        SceneError: for an output that the model does not support.
    """
    if problem.reshaped is not None:
        return problem.reshaped.outputs(problem)
    probes = [probe_of(output, discretisation, problem, equilibrium) for output in discretisation.scene.outputs]
    return prepared_outputs(probes, 0 if equilibrium is None else equilibrium.places)


def prepared_outputs(probes: Sequence[Probe], gauss_points: int = 0) -> Functionals:
    """Outputs of a scene by the probe of each, and the number of Gauss points of laws."""
    scene = probes[0].scene
    problem = probes[0].problem
    items = [output.prepared(probe) for output, probe in zip(scene.outputs, probes, strict=True)]
    found = Functionals(tuple(items), problem.free.size, problem.amplitudes)
    found.check(problem.parameters, len(problem.gaps), gauss_points)
    return found


def probe_of(
    output: Output,
    discretisation: DiscreteSpace,
    problem: ContactProblem,
    laws: FullEquilibrium | BodiesWithLaws | None,
    base: ContactProblem | None = None,
) -> Probe:
    """Interface for one output: the equilibrium of laws, or bodies with laws; ``base`` is ``problem`` unless given."""
    base = base or problem
    return Probe(
        scene=discretisation.scene,
        problem=problem,
        base=base,
        contact_rows=problem.whole_contact,
        assembler=discretisation.assembler(output),
        nodes=partial(_nodes, discretisation, problem),
        mises=partial(mises_of, discretisation, base, laws),
        energy=partial(energy_of, discretisation, problem, laws),
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


def cells_of(discretisation: DiscreteSpace, problem: ContactProblem, output: VonMises) -> np.ndarray:
    """Numbers of the cells of a body within the box of an output."""
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
    return np.flatnonzero(inside)


def mises_of(
    discretisation: DiscreteSpace,
    problem: ContactProblem,
    laws: FullEquilibrium | BodiesWithLaws | None,
    output: VonMises,
) -> Functional:
    """Von Mises' stress of the cells of an output."""
    cells = cells_of(discretisation, problem, output)
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
    return Mises(output.name, output.unit, *matrix, names, *moduli, flat, factors, shares)


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


def energy_of(
    discretisation: DiscreteSpace,
    problem: ContactProblem,
    laws: FullEquilibrium | BodiesWithLaws | None,
    output: ElasticEnergy,
    *,
    every: bool = False,
) -> Functional:
    """Elastic energy by the work of all forces: of those that act, or of every term of θ."""
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
    loaded = np.arange(external.shape[1]) if every else np.flatnonzero(np.diff(external.indptr))
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
    gap_terms = loaded if every else np.flatnonzero(problem.gaps.any(axis=0)).astype(np.int64)
    gaps = np.ascontiguousarray(problem.gaps[:, gap_terms])
    rest = terms, parts.astype(np.int64), lifted.astype(np.int64), squares, gap_terms, gaps, own
    return Energy(output.name, output.unit, *matrix, names, moduli, *rest)
