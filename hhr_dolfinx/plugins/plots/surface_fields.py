"""Models of forces and of displacements on the outside of bodies: what pictures in space show.

K^-1 B^T of all nodes takes nearly all of a file; the outside has a quarter of them and less.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, cast

import numpy as np

from hhr_dolfinx.declared import Floats, Integers, Singles
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.exact import ExactFields, SolvedFields

if TYPE_CHECKING:
    from hhr_dolfinx.models.answer_mesh import AnswerMesh
    from hhr_dolfinx.models.condensed import CondensedModel
    from hhr_dolfinx.models.model import KeptModel

FACET_NODES = 3
"""Nodes on the outside from which a cell may have a facet there."""


@dataclass(frozen=True)
class SurfaceFields(SolvedFields):
    """Fields of exact condensation on the outside of bodies.

    Parts without a comment are those of :class:`~hhr_dolfinx.models.exact.SolvedFields`.
    """

    #: dofs of the nodes of all cells with a facet on the outside
    dofs: Annotated[Integers, "seen", "< N"] = field(kw_only=True)
    #: rows of K^-1 B^T of these dofs
    per_force_seen: Annotated[Floats, "seen", "m"] = field(kw_only=True)

    def on_surface(self, answer: Answer) -> np.ndarray:
        """Displacement on the outside, lift included, (N,); NaN elsewhere."""
        theta = self.amplitudes(answer.parameter)
        values = np.full(len(self.per_term), np.nan)
        values[self.dofs] = self.per_term[self.dofs] @ theta
        values[self.dofs] -= self.per_force_seen @ answer.multipliers
        lift: np.ndarray = self.lifts @ theta
        return values + lift


@dataclass(frozen=True)
class SingleSurfaceFields(SurfaceFields):
    """The same with rows of single precision."""

    #: see :class:`SurfaceFields`
    per_force_seen: Annotated[Singles, "seen", "m"] = field(kw_only=True)


def displacement_seen(answer: Answer) -> np.ndarray:
    """Displacement of an answer for pictures, (N,); NaN where its model has none.

    Raises:
        NotOfferedError: for a model without displacements.
    """
    fields = answer.fields
    return fields.on_surface(answer) if isinstance(fields, SurfaceFields) else answer.displacement()


def with_surface_fields(model: KeptModel, *, single: bool = False) -> KeptModel:
    """A model with displacements on the outside of bodies in space alone, for a smaller file.

    Pictures, files of fields and pages are those of the whole model; ``answer.displacement()`` is
    refused. Other models, also those of bodies in the plane, are returned as they are, as are those
    whose fields take little room.

    Args:
        model: model in the process that made it, which has the mesh.
        single: round the rows of these displacements to single precision, by which files halve:
            each entry is off by 6e-8 of itself at most. Forces and outputs stay as they are.

    Raises:
        NotOfferedError: for a copy, or a model from a file, which have no mesh.
    """
    fields = model.fields
    base = model.without_fields()
    if not isinstance(fields, ExactFields) or base is model or fields.dimension != 3:
        return model
    if fields.full is None:
        raise NotOfferedError(
            "a model that was copied or read from a file does not know the outside of its bodies: "
            "ask the model where it was made"
        )
    rest = cast("SolvedFields", base.fields)
    nodes = nodes_seen(fields.full.answer_mesh())
    dofs = (3 * nodes[:, None] + np.arange(3)).ravel()
    per_term = rest.per_term.copy()
    per_term[dofs] = fields.per_term[dofs]
    rows = fields.per_force[dofs]
    kind = SingleSurfaceFields if single else SurfaceFields
    seen = kind(
        amplitudes=rest.amplitudes,
        lifts=rest.lifts,
        per_term=per_term,
        dimension=rest.dimension,
        measured_per_force=rest.measured_per_force,
        functionals=rest.functionals,
        dofs=dofs,
        per_force_seen=rows.astype(np.float32) if single else rows,
    )
    return cast("CondensedModel", base).changed(fields=seen)


def nodes_seen(mesh: AnswerMesh) -> np.ndarray:
    """Nodes of all cells with a facet on the outside of their body, in ascending order, (k,)."""
    # facets need statuses of contacts, which read these fields
    from hhr_dolfinx.plugins.plots.facets import outer_facets

    chosen = []
    for body in range(int(mesh.bodies.max()) + 1):
        outside = np.zeros(len(mesh.points), dtype=bool)
        outside[outer_facets(mesh, body, split=False)] = True
        cells = mesh.cells[mesh.bodies == body]
        chosen.append(np.unique(cells[outside[cells].sum(axis=1) >= FACET_NODES]))
    return np.unique(np.concatenate(chosen))
