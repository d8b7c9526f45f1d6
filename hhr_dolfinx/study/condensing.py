"""Condensation without training: contact forces need no snapshots."""

from __future__ import annotations

from mpi4py import MPI

from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.models.condensed import CondensedModel
from hhr_dolfinx.reduction.kinds import kind_of
from hhr_dolfinx.reduction.reductor import CondensationSettings, Task, condensing, made
from hhr_dolfinx.scene import Scene


def condense(
    scene: Scene | FullOrderModel,
    settings: CondensationSettings = None,
    *,
    fields: bool | None = None,
) -> CondensedModel:
    """Build a model that keeps all contact conditions and eliminates the rest, without snapshots.

    For constant stiffness it answers as the full model does, to round-off. If moduli or the shape
    depend on parameters, S and the free slack are interpolated between few of them, each a
    factorisation. Displacements then come from Galerkin's method on responses to forces and loads
    at some of these.

    Args:
        scene: the scene, or its full model on one rank.
        settings: a ``GridSettings`` with the targets of interpolation. None takes the defaults, or
            those of the bound if it is small. Without effect for constant stiffness.
        fields: whether answers have displacements if these are not exact at no cost; None if an
            output of the scene needs one. Without them answers have forces and their outputs, and
            no bound.

    Raises:
        NotOfferedError: if moduli or shapes are parameters and no installed plug-in interpolates.
        ReductionError: for bodies with laws, which are condensed from histories:
            ``train(...).condense()``; or for bodies with rigid motions and variable moduli or
            shapes.
        SceneError: for an invalid scene, or one that cannot be built.

    Warns:
        StabilityWarning: if a grid spent its budget before it converged.
        SmallStrainWarning: if strains or rotations are large in a corner of the box.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> model = hhr.condense(scene)
        >>> outputs = model.outputs({"push": 50.0}, gradient=True)
        >>> round(outputs["peak"], 1), outputs.gradient["peak"].round(2)
        (56.5, array([1.06]))
    """
    full = scene if isinstance(scene, FullOrderModel) else FullOrderModel(scene, MPI.COMM_SELF)
    model = condensed(full, settings, fields=fields)
    return kind_of(full).with_corners(model)


def condensed(
    full: FullOrderModel,
    settings: CondensationSettings = None,
    *,
    fields: bool | None = None,
) -> CondensedModel:
    """See :func:`condense`; without the check of strains.

    Args:
        full: the full model.
        settings, fields: see :func:`condense`.

    Raises:
        NotOfferedError, ReductionError: see :func:`condense`.
    """
    full.problem.require_parts("condensation")
    kind_of(full).require_linear(
        "a condensation of these is made of histories, hhr.train(scene, paths).condense()"
    )
    if fields is None:
        fields = full.functionals is not None and any(
            functional.count for functional in full.functionals.items
        )
    if not isinstance(fields, bool):
        raise ReductionError(f"fields = {fields!r} of a condensation must be True, False, or None")
    return made(condensing(full).usual(settings, fields=fields), Task(full))
