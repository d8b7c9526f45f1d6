"""Von Mises' stress from the mesh: strains of cells and moduli."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np
import ufl
from dolfinx import fem
from scipy.sparse import csr_matrix
from ufl.domain import extract_domains

from hhr_dolfinx import compat
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.forms import elasticity
from hhr_dolfinx.full_order.outputs import cells_of_body
from hhr_dolfinx.models.functionals.functional import Functional, State
from hhr_dolfinx.models.functionals.kinds import Linear
from hhr_dolfinx.models.histories.equilibrium import StressOutput
from hhr_dolfinx.outputs import no_rows
from hhr_dolfinx.plugins.stress.energy import text_of
from hhr_dolfinx.plugins.stress.kinds import (
    COMPONENTS,
    PRINCIPAL,
    PRINCIPAL_VALUES,
    FlowStressValue,
    Mises,
    StrainedMises,
    StressValue,
)

if TYPE_CHECKING:
    from hhr_dolfinx.body import Body
    from hhr_dolfinx.full_order.discrete_space import DiscreteSpace
    from hhr_dolfinx.outputs import ModelProbe, NamedOutput
    from hhr_dolfinx.parameters import Tag
    from hhr_dolfinx.scene import Scene


class StressInCells(StressOutput, Protocol):
    """An output of the stress in some cells of a body."""

    @property
    def tag(self) -> Tag:
        """Cell tag of the body."""

    @property
    def where(self) -> tuple[Sequence[float], Sequence[float]] | None:
        """Corners of a box with the middles of the cells; None for all cells."""


def _cells_of(
    discretisation: DiscreteSpace, problem: ContactProblem, output: StressInCells
) -> np.ndarray:
    """Numbers of the cells of a body within the box of an output."""
    try:
        selected = cells_of_body(discretisation, output.tag)
    except SceneError as error:
        raise SceneError(f"output '{output.name}': {error}") from None
    if output.where is not None:
        middles = problem.points[problem.cell_nodes].mean(axis=1)
        if any(len(corner) != middles.shape[1] for corner in output.where):
            raise SceneError(
                f"output '{output.name}': where = {output.where} must have {middles.shape[1]} "
                "coordinates, as the mesh"
            )
        within = (middles >= np.array(output.where[0])) & (middles <= np.array(output.where[1]))
        if not (selected & within.all(axis=1)).any():
            low = middles[selected].min(axis=0).tolist()
            high = middles[selected].max(axis=0).tolist()
            raise SceneError(
                f"output '{output.name}': no cell of body {output.tag} has its middle in "
                f"{output.where}; they lie between {low} and {high}: enlarge the box"
            )
        selected &= within.all(axis=1)
    return np.flatnonzero(selected)


def mises_of(probe: ModelProbe, output: StressInCells) -> Functional:
    """Von Mises' stress of the cells of an output.

    Args:
        probe: interface of the model.
        output: the output.
    """
    discretisation = probe.discretisation
    laws = probe.laws
    cells = _cells_of(discretisation, probe.base, output)
    mean = output.kind == "mean"
    if laws is not None:
        return laws.mises(output, cells)
    index = next(k for k, body in enumerate(discretisation.scene.bodies) if body.tag == output.tag)
    strain, dofs, factors, volumes = strains_of_cells(discretisation, cells, index)
    count, components, _ = strain.shape
    rows = np.broadcast_to(
        np.arange(count * components).reshape(count, components, 1), strain.shape
    )
    columns = np.broadcast_to(dofs[:, None], strain.shape)
    used = strain != 0
    matrix = (
        count * components,
        rows[used].astype(np.int64),
        columns[used].astype(np.int64),
        strain[used],
    )
    body = discretisation.scene.bodies[index]
    scene = discretisation.scene
    moduli = moduli_of(body, scene)
    flat = scene.hypothesis == "plane_stress"
    shares = volumes / volumes.sum() if mean else np.zeros(0)
    names = scene.parameters.names
    fields = output.name, output.unit, *matrix, names, *moduli, flat, factors, shares
    amplitudes, eigenstrains = _at_rest(discretisation, cells, index, output)
    if flat or scene.states_stress(body) or _deviates(eigenstrains):
        functional = (
            StrainedMises(*fields, amplitudes, eigenstrains.reshape(count * components, -1))
            if amplitudes
            else Mises(*fields)
        )
    else:  # a change of volume has no part in it
        functional = Mises(*fields)
    return probe.on_cells(functional, cells)


def stress_at(probe: ModelProbe, output: NamedOutput, name: str, tag: Tag) -> Functional:
    """Stress of a body at the place of an output, a ``StressAt``.

    Args:
        probe: interface of the model.
        output: the output.
        name: of the component or principal value.
        tag: cell tag of the body.

    Raises:
        SceneError: for a component that the hypothesis does not have, or a point off the body.
    """
    scene = probe.scene
    component = _component(output, name, scene.hypothesis)
    cells = _cells_at(probe, output, tag)
    if probe.laws is not None:
        operator = getattr(probe.laws, "operator", None)
        if operator is None:
            raise SceneError(
                f"output '{output.name}': the plug-in that reads the laws of scene '{scene.name}' "
                "does not tell where it evaluates them: leave it out"
            )
        points = operator.points_of(cells).astype(np.int64)
        weights = operator.weights.ravel()[points]
        arrays = points, weights / weights.sum(), component
        return FlowStressValue(output.name, output.unit, *no_rows(), *arrays)
    discretisation = probe.discretisation
    place = next(k for k, body in enumerate(scene.bodies) if body.tag == tag)
    strain, dofs, factors, volumes = strains_of_cells(discretisation, cells, place)
    count, components, _ = strain.shape
    numbers = np.arange(count * components).reshape(count, components, 1)
    rows = np.broadcast_to(numbers, strain.shape)
    columns = np.broadcast_to(dofs[:, None], strain.shape)
    used = strain != 0
    matrix = rows[used].astype(np.int64), columns[used].astype(np.int64), strain[used]
    amplitudes, rest = _at_rest(discretisation, cells, place, output)
    moduli = moduli_of(scene.bodies[place], scene)
    flat = scene.hypothesis == "plane_stress"
    value = StressValue(
        output.name,
        output.unit,
        count * components,
        *matrix,
        scene.parameters.names,
        *moduli,
        flat,
        factors,
        volumes / volumes.sum(),
        amplitudes,
        rest.reshape(count * components, -1),
        component,
    )
    varies = amplitudes or any(formula.formula.variables for formula in value._moduli)
    if varies or component >= PRINCIPAL or scene.shapes:
        return probe.on_cells(value, cells)
    nothing = np.zeros(0)
    still = np.zeros(count * components)
    state = State(nothing, still, probe.problem.middle, nothing, nothing.copy)
    row = value.slopes(state).measured @ value.matrix(probe.problem.free.size)
    return Linear.of(output.name, output.unit, row=csr_matrix(row[None]))


def _component(output: NamedOutput, name: str, hypothesis: str) -> int:
    """Number of the component, see :func:`~.kinds.component_of`."""
    if name in PRINCIPAL_VALUES:
        return PRINCIPAL + PRINCIPAL_VALUES.index(name)
    names = COMPONENTS.get(hypothesis, COMPONENTS["plane"])
    if name not in names:
        raise SceneError(
            f"output '{output.name}': a stress in {hypothesis.replace('_', ' ')} has no component "
            f"{name!r}: name one of {', '.join((*names, *PRINCIPAL_VALUES))}"
        )
    return names.index(name)


def _cells_at(probe: ModelProbe, output: NamedOutput, tag: Tag) -> np.ndarray:
    """Numbers of the cells of the body whose middles are nearest to the point, increasing."""
    try:
        inside = np.flatnonzero(cells_of_body(probe.discretisation, tag))
    except SceneError as error:
        raise SceneError(f"output '{output.name}': {error}") from None
    middles = probe.base.points[probe.base.cell_nodes[inside]].mean(axis=1)
    return inside[probe.at_place(output, middles)]


def moduli_of(body: Body, scene: Scene) -> tuple[str, str]:
    """λ' and μ' of a body as expressions of the parameters, see :func:`elasticity.isotropic_parts`.

    Where elasticity is not Hooke's, those that leave the stress of :func:`strains_of_cells` as it
    is.

    Args:
        body: the body.
        scene: its scene.
    """
    if scene.states_stress(body):
        return "0", "0.5"
    young = _text(body.young)
    volume, shape = elasticity.unit_moduli(_text(body.poisson), scene.hypothesis)
    return f"({young}) * ({volume})", f"({young}) * ({shape})"


def _text(value: float | str) -> str:
    """A number or an expression as an expression, without loss of digits."""
    return value if isinstance(value, str) else repr(float(value))


def _own_cells(discretisation: DiscreteSpace) -> int:
    """Number of the cells of this rank."""
    return discretisation.mesh.topology.index_map(discretisation.mesh.topology.dim).size_local


def strains_of_cells(
    discretisation: DiscreteSpace, cells: np.ndarray, place: int
) -> list[np.ndarray]:
    """Strain in the middles of cells of a body, its dofs, the factor of the modulus, and the
    volumes. Collective.

    (c, components, k), (c, k), (c,), (c,); the strain has the mean dilatation of the cells if the
    body uses it. Where the elasticity is not Hooke's it is the stress, whose factor is 1.

    Args:
        discretisation: the mesh.
        cells: increasing, in the order of ``cell_nodes``, (c,).
        place: index of the body in the scene.
    """
    local_cells = _of_rank(discretisation, cells).astype(np.int32)
    arrays_of_ranks = discretisation.group.gathered(_tabulated(discretisation, local_cells, place))
    return [np.concatenate(arrays) for arrays in zip(*arrays_of_ranks, strict=True)]


def _at_rest(
    discretisation: DiscreteSpace, cells: np.ndarray, place: int, output: NamedOutput | StressOutput
) -> tuple[tuple[str, ...], np.ndarray]:
    """Strains that cause no stress: amplitudes as formulas, (e,), and what the rows measure, (c,
    components, e).
    """
    mesh = discretisation.mesh
    scene = discretisation.scene
    body = scene.bodies[place]
    loads = [load for load in scene.loads if hasattr(load, "eigenstrain_of")]
    eigenstrains = [
        strain_of_load
        for load in loads
        if (strain_of_load := load.eigenstrain_of(body.tag, mesh)) is not None
    ]
    stress_of = scene.own_stress(body, mesh) or (lambda strain: strain)
    local_cells = _of_rank(discretisation, cells).astype(np.int32)
    middle = compat.interpolation_points(
        fem.functionspace(mesh, ("Discontinuous Lagrange", 0)).element
    )
    unit = discretisation.constant(1.0)  # a strain that is a number has no mesh
    tables = [np.zeros((len(local_cells), 6 if scene.hypothesis == "solid" else 4, 0))]
    for _, strain in eigenstrains:
        measured = elasticity.kelvin(stress_of(unit * strain), scene.hypothesis)
        table = compat.jitted(fem.Expression, measured, middle).eval(mesh, local_cells)
        tables.append(table.reshape(len(local_cells), -1, 1))
    measured_strains = np.concatenate(discretisation.group.gathered(np.concatenate(tables, axis=2)))
    return tuple(text_of(amplitude, output) for amplitude, _ in eigenstrains), measured_strains


def _deviates(tensors: np.ndarray) -> bool:
    """True unless all tensors, (c, components, e), are the same in all directions."""
    return bool((tensors[:, :2] != tensors[:, 2:3]).any() or tensors[:, 3:].any())


def _of_rank(discretisation: DiscreteSpace, cells: np.ndarray) -> np.ndarray:
    """Local numbers of the cells of this rank among some increasing cells."""
    first = sum(
        discretisation.group.gathered(_own_cells(discretisation))[: discretisation.group.number]
    )
    return cells[(cells >= first) & (cells < first + _own_cells(discretisation))] - first


def _tabulated(
    discretisation: DiscreteSpace, cells: np.ndarray, place: int
) -> tuple[np.ndarray, ...]:
    """Arrays of :func:`strains_of_cells` for some cells of this rank."""
    mesh = discretisation.mesh
    space = discretisation.space
    hypothesis = discretisation.scene.hypothesis
    constants = fem.functionspace(mesh, ("Discontinuous Lagrange", 0))
    middle = compat.interpolation_points(constants.element)
    dim = mesh.geometry.dim
    components = 6 if hypothesis == "solid" else 4
    blocks = space.dofmap.list[cells]
    body = discretisation.scene.bodies[place]
    measured = elasticity.strain(ufl.TrialFunction(space), hypothesis)
    if (stress_of := discretisation.scene.own_stress(body, mesh)) is not None:
        measured = stress_of(measured)
    table = compat.jitted(fem.Expression, elasticity.kelvin(measured, hypothesis), middle).eval(
        mesh, cells
    )
    strain = table.reshape(len(cells), components, dim * blocks.shape[1])
    if discretisation.mean_dilatation[place]:
        from hhr_dolfinx.plugins.elasticity.gauss_points import tabulated

        # the trace at each Gauss point is already its mean over the cell
        mean = tabulated(discretisation, cells).gradients[:, 0, :3].sum(axis=1)
        strain[:, :3] += ((mean - strain[:, :3].sum(axis=1)) / 3)[:, None]
    grading = np.ones(len(cells))
    if body.grading is not None:
        from hhr_dolfinx.plugins.elasticity.parts import grading_of

        factor = ufl.as_ufl(grading_of(discretisation, body))
        if extract_domains(factor):
            grading = (
                compat.jitted(fem.Expression, factor, middle).eval(mesh, cells).reshape(len(cells))
            )
        else:  # a grading that is a number has no mesh
            grading *= float(factor)
    weight = elasticity.volume_weight(mesh, hypothesis) * ufl.TestFunction(constants) * ufl.dx(mesh)
    volumes = fem.assemble_vector(compat.jitted(fem.form, weight)).array[
        constants.dofmap.list[cells].ravel()
    ]
    nodes = space.dofmap.index_map.local_to_global(blocks.ravel().astype(np.int32)).reshape(
        blocks.shape
    )
    dofs = (dim * nodes[:, :, None] + np.arange(dim)).reshape(len(cells), dim * blocks.shape[1])
    return strain, dofs, grading, volumes
