"""Gaps and statuses of all contact conditions: ``answer.gaps()``, ``answer.statuses()``."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, TypeGuard, cast

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.models.answer import Answer, Meshed
from hhr_dolfinx.models.functionals.kinds import UNDER_LOAD
from hhr_dolfinx.plugins.plots.surface_fields import displacement_seen

if TYPE_CHECKING:
    from hhr_dolfinx.full_order.full import FullOrderModel
    from hhr_dolfinx.plugins.friction.laws import Friction
    from hhr_dolfinx.plugins.pages.beside import MeshBeside

NO_PRESSURE = -1
OPEN = 0
CLOSED = 1
SLIDING = 2
"""Statuses of contact conditions. A closed condition has no friction, or sticks."""
STATUS_NAMES = {OPEN: "open", CLOSED: "closed", SLIDING: "sliding"}
FRICTION = "slip"
"""Name of the memory of friction in an answer."""

PAIRED_AGAIN = "facing_share"
"""Memory of answers whose surfaces are paired again: their conditions are dofs of surfaces."""


class ContactGaps(NamedTuple):
    """Contact rows B with imposed dofs, (N_lambda, N), and undeformed gaps, (N_lambda,)."""

    rows: csr_matrix
    undeformed: np.ndarray


def is_full(meshed: Meshed) -> TypeGuard[FullOrderModel]:
    """True for a full model, which has more than arrays of its mesh."""
    return hasattr(meshed, "discretisation")


def contact_gaps(meshed: Meshed, parameter: np.ndarray) -> ContactGaps:
    """Rows and gaps of undeformed bodies at a parameter, (P,).

    Args:
        meshed: the full model, or the mesh beside a model file.
        parameter: point of the box, (P,), in the units of the parameters.

    Raises:
        NotOfferedError: if the file beside the model has no contact rows, as in earlier releases.
    """
    if not is_full(meshed):
        beside = cast("MeshBeside", meshed)
        return ContactGaps(*beside.contact_gaps(parameter))
    problem = meshed.problem.at(parameter)
    theta = problem.amplitudes(parameter)
    rows = problem.contact if problem.whole_contact is None else problem.whole_contact
    return ContactGaps(rows, problem.gaps @ theta + rows @ (problem.lifts @ theta))


def gaps(answer: Answer, full: Meshed | None = None) -> np.ndarray:
    """Gap of each contact condition of an answer, in the order of ``answer.pressure()``.

    Args:
        answer: answer of any model.
        full: the full model; not needed in the process that built the model, nor by a model from a
            file if the commands left the mesh beside it, ``scenery.npz``.

    Returns:
        Gaps, (N_lambda,), in the unit of length: zero in contact, positive if open, NaN for
        conditions other than those of pressures, such as those of friction.

    Raises:
        NotOfferedError: without a mesh, or if bodies slide past their mesh.
    """
    if PAIRED_AGAIN in answer.memory:
        raise NotOfferedError(
            "gaps of bodies that slide past their mesh are those of the last pairing, which "
            "answers do not keep: pressures of the slave nodes are in answer.slip"
        )
    meshed = answer._meshed(full, "gaps need the contact rows")
    mesh = meshed.answer_mesh()
    rows, undeformed = contact_gaps(meshed, answer.parameter)
    field = displacement_seen(answer)
    mesh.nodal(field)
    if rows.shape[0] != len(answer.forces()):
        raise NotOfferedError(
            f"the answer has {len(answer.forces())} forces, and {mesh.name} {rows.shape[0]} "
            "contact conditions: it is of another scene, or of bodies that slide past their mesh"
        )
    values = np.full(rows.shape[0], np.nan)
    pressing = mesh.pressing
    gap = undeformed - rows @ field
    law = meshed.problem.law if is_full(meshed) else cast("MeshBeside", meshed).loaded().law
    opened = np.asarray(law.opened(answer.memory) if answer.memory else 0.0)
    if np.ndim(opened) == 0 or opened.shape == gap.shape:  # of a RID part of it is not known
        gap = gap + opened
    values[pressing] = gap[pressing]
    return values


def statuses(answer: Answer, full: Meshed | None = None) -> np.ndarray:
    """Status of each contact condition of an answer, in the order of ``answer.pressure()``.

    A model that keeps all conditions reports those of its search. In a hyper-reduced model a
    condition is closed if its pressure exceeds a thousandth of the largest one: smaller completed
    forces are noise.

    Args:
        answer: answer of any model.
        full: see :func:`gaps`.

    Returns:
        Whole numbers, (N_lambda,): 0 open, 1 closed, which sticks if it has friction, 2 sliding,
        and -1 for conditions other than those of pressures.

    Raises:
        NotOfferedError: without a mesh, or if bodies slide past their mesh.
    """
    if PAIRED_AGAIN in answer.memory:
        raise NotOfferedError(
            "conditions of bodies that slide past their mesh are dofs of surfaces: statuses of the "
            "slave nodes are answer.slip.statuses"
        )
    meshed = answer._meshed(full, "statuses need the contact conditions")
    pressing = meshed.answer_mesh().pressing
    forces = answer.forces()
    values = np.full(len(forces), NO_PRESSURE)
    if len(answer.active) == len(forces):
        closed = np.asarray(answer.active, dtype=bool)[pressing]
    else:
        areas = meshed.areas(answer.parameter)[pressing]
        sizes = np.where(areas > 0, areas, 1.0)
        pressures = forces[pressing] / sizes
        closed = pressures > UNDER_LOAD * pressures.max(initial=0.0)
    values[pressing] = np.where(closed, CLOSED, OPEN)
    if answer.memory.get(FRICTION) is not None:
        with_friction, of_friction = _statuses_of_friction(meshed, answer)
        values[with_friction] = of_friction
    return values


def _statuses_of_friction(meshed: Meshed, answer: Answer) -> tuple[np.ndarray, np.ndarray]:
    """Conditions of pressures with friction and their statuses; none if they are unknown."""
    statuses = np.asarray(answer.memory[FRICTION].statuses)
    pressing = meshed.answer_mesh().pressing
    if is_full(meshed):
        law = cast("Friction", meshed.problem.law.of("friction"))
        return law.normal, statuses
    if statuses.size == pressing.size:
        return pressing, statuses
    nothing = np.zeros(0, dtype=np.int64)
    return nothing, nothing
