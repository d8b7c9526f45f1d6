"""Stages of the hyper-reduction that moduli which are parameters add."""

from __future__ import annotations

from hhr_dolfinx.reduction.build import Draft
from hhr_dolfinx.reduction.interpolate_reduced import interpolated_reduction
from hhr_dolfinx.reduction.starts import linear_starts


def interpolate(draft: Draft) -> None:
    """K~^-1, interpolated between few parameters; statuses start along derivatives."""
    with draft.shared.log.stage("online_arrays", draft.shared.task.announce):
        _interpolate(draft)


def _interpolate(draft: Draft) -> None:
    """See :func:`interpolate`."""
    model = draft.model
    log = draft.shared.log
    if model.problem.motions:
        log.skip("interpolation", "contact alone holds bodies: K~ is factored for each query")
        return
    if model.law.remembers:
        log.skip("interpolation", f"contact with {model.law.name}: K~ is factored once for all increments of a path")
        return
    compliances, _ = interpolated_reduction(model.problem, model.fields.amplitudes, model.parameters)
    if compliances is None:
        log.skip("interpolation", "K~^-1 is no smooth function of the parameters: it is factored for each query")
        return
    assert model.known is not None  # true for elastic bodies
    known = linear_starts(compliances, model.known.points, model.problem.pairs)
    draft.model = model.changed(compliances=compliances, known=known)
