"""Outputs of a scene as arrays: the part that needs the mesh."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.models.functionals.functional import Functional, Functionals
from hhr_dolfinx.outputs import ContactOutput, ModelProbe, Output
from hhr_dolfinx.parameters import Tag

if TYPE_CHECKING:
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
        discretisation: mesh and forms, for outputs that read cells.
        laws: bodies with laws, or their equilibrium; None for elastic bodies.
    """

    scene: Scene
    problem: ContactProblem
    base: ContactProblem
    contact_rows: csr_matrix
    assembler: Assembler
    nodes: Callable[[Tag], np.ndarray]
    discretisation: DiscreteSpace
    laws: FullEquilibrium | BodiesWithLaws | None

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

    def on_cells(self, found: Functional, cells: np.ndarray) -> Functional:
        """The functional of an output whose rows are strains of cells."""
        return found

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
        nodes=lambda tag: np.unique(problem.cell_nodes[cells_of_body(discretisation, tag)]),
        discretisation=discretisation,
        laws=laws,
    )


def cells_of_body(discretisation: DiscreteSpace, tag: Tag) -> np.ndarray:
    """Cells of a body on all ranks, as a mask in the order of ``cell_nodes``."""
    tags = [body.tag for body in discretisation.scene.bodies]
    if tag not in tags:
        raise SceneError(
            f"the cell tag {tag} is none of the bodies {tags} of scene '{discretisation.scene.name}': name one of them"
        )
    discretisation.check_cells(tag)
    return np.concatenate(discretisation.comm.allgather(discretisation.cell_bodies())) == tags.index(tag)
