"""Parts of the memory of a law that outputs read."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.plugins.contact_laws.fields import rows_of

if TYPE_CHECKING:
    from hhr_dolfinx.outputs import ModelProbe, OfContact


def places_in_memory(
    probe: ModelProbe, output: OfContact, plugin: str, remedy: str
) -> tuple[np.ndarray, np.ndarray]:
    """Conditions of the contact of an output, and their places in the memory of a law, (c,) each.

    Args:
        probe: interface of the model.
        output: the output.
        plugin: plug-in of the law.
        remedy: what is missing without it, for the message.

    Raises:
        SceneError: for a contact without the law.
    """
    rows = rows_of(probe.problem.law, plugin)
    conditions = probe.conditions(output)
    if not np.isin(conditions, rows).all():
        raise SceneError(f"output '{output.name}': contact {output.contact} {remedy}")
    order = np.argsort(rows)
    return conditions, order[np.searchsorted(rows, conditions, sorter=order)]
