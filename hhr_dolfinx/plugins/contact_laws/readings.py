"""Parts of the memory of a law that outputs read."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.errors import SceneError

if TYPE_CHECKING:
    from hhr_dolfinx.outputs import ModelProbe, OfContact


def places_in_memory(
    probe: ModelProbe, output: OfContact, plugin: str, remedy: str
) -> tuple[np.ndarray, np.ndarray]:
    """Conditions of the contact of an output, and their places in the memory of a law, (c,) each.

    Args:
        probe: interface of the model.
        output: the output.
        plugin: plug-in of the law, whose law on the conditions has ``rows``.
        remedy: what is missing without it, for the message.

    Raises:
        SceneError: for a contact without the law.
    """
    law: Any = probe.problem.law.of(plugin)
    conditions = probe.conditions(output)
    if law is None or not np.isin(conditions, law.rows).all():
        raise SceneError(f"output '{output.name}': contact {output.contact} {remedy}")
    order = np.argsort(law.rows)
    return conditions, order[np.searchsorted(law.rows, conditions, sorter=order)]
