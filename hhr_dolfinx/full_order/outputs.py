"""Outputs of a scene as arrays: the part that needs the mesh."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.models.functionals.functional import AllOutputs, Functionals
from hhr_dolfinx.outputs import ModelProbe, Output
from hhr_dolfinx.parameters import Tag

if TYPE_CHECKING:
    from hhr_dolfinx.full_order.discrete_space import DiscreteSpace
    from hhr_dolfinx.models.histories.equilibrium import FullEquilibrium, LawsAtPlaces


def functionals_of(
    discretisation: DiscreteSpace, problem: ContactProblem, equilibrium: FullEquilibrium | None
) -> AllOutputs:
    """All outputs of a scene on all ranks. Collective.

    Args:
        discretisation: functions on the mesh of the scene.
        problem: its contact problem.
        equilibrium: equilibrium of bodies with laws; None without any.

    Raises:
        SceneError: for an output that the model does not support.
    """
    probes = [
        probe_of(output, discretisation, problem, equilibrium)
        for output in discretisation.scene.outputs
    ]
    return prepared_outputs(probes)


def prepared_outputs(probes: Sequence[ModelProbe]) -> Functionals:
    """Outputs of a scene by the probe of each."""
    scene = probes[0].scene
    problem = probes[0].problem
    functionals = [
        output.prepared(probe) for output, probe in zip(scene.outputs, probes, strict=True)
    ]
    outputs = Functionals(tuple(functionals), problem.free.size, problem.amplitudes)
    laws = probes[0].laws
    outputs.check(problem.parameters, len(problem.gaps), 0 if laws is None else laws.places)
    return outputs


def probe_of(
    output: Output,
    discretisation: DiscreteSpace,
    problem: ContactProblem,
    laws: LawsAtPlaces | None,
    base: ContactProblem | None = None,
) -> ModelProbe:
    """Interface through which one output reads the model.

    Args:
        output: the output.
        discretisation: functions on the mesh of the scene.
        problem: the contact problem.
        laws: equilibrium of bodies with laws, or their laws; None without any.
        base: problem with the points and cells of the mesh; ``problem`` if it is None.
    """
    return ModelProbe(
        scene=discretisation.scene,
        problem=problem,
        base=base or problem,
        contact_rows=problem.whole_contact,
        assembler=discretisation.assembler(output),
        nodes=lambda tag: np.unique(problem.cell_nodes[cells_of_body(discretisation, tag)]),
        discretisation=discretisation,
        laws=laws,
    )


def cells_of_body(discretisation: DiscreteSpace, tag: Tag) -> np.ndarray:
    """Cells of a body on all ranks, as a mask in the order of ``cell_nodes``.

    Args:
        discretisation: functions on the mesh of the scene.
        tag: cell tag of the body.

    Returns:
        A mask, (cells,) bool.

    Raises:
        SceneError: if no body has the tag.
    """
    scene = discretisation.scene
    tags = [body.tag for body in scene.bodies]
    if tag not in tags:
        raise SceneError(
            f"the cell tag {tag} is not among the bodies {tags} of scene '{scene.name}': name one "
            "of them"
        )
    discretisation.check_cells(tag)
    return discretisation.group.joined(discretisation.cell_bodies()) == tags.index(tag)
