"""Volumetric locking: bodies that are integrated with a mean dilatation, and cells without such a
remedy.

Functions of degree 1 have few fields that keep the volume at every Gauss point. A body whose
deformation keeps its volume, since it has a law or is nearly incompressible, is then far too stiff:
a perfectly plastic tube bears any pressure. Quadrilaterals and hexahedra keep only the volume of
each cell if all its points use the mean dilatation of the cell (B-bar; J. C. Nagtegaal, D. M. Parks
and J. R. Rice, Comput. Methods Appl. Mech. Eng. 4, 1974; T. J. R. Hughes, Int. J. Numer. Methods
Eng. 15, 1980). In triangles and tetrahedra the dilatation is constant already: there is nothing to
average within one cell.
"""

from __future__ import annotations

from hhr_dolfinx.body import Body
from hhr_dolfinx.errors import LockingWarning
from hhr_dolfinx.formulas import Scalar, box_samples
from hhr_dolfinx.full_order.elasticity import NEARLY_INCOMPRESSIBLE
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.warn import warn

SIMPLICES = {"triangle": "quadrilaterals", "tetrahedron": "hexahedra"}
"""Cells that lock, and the cells to use instead."""


def keeps_volume(body: Body, scene: Scene) -> bool:
    """True if a body deforms without change of volume; in plane stress its thickness compensates.

    A body whose Poisson's ratio depends on parameters does if it would anywhere in the parameter
    range.

    Args:
        body: the body.
        scene: its scene.
    """
    if scene.hypothesis == "plane_stress" or scene.states_stress(body):
        return False
    if body.law is not None:
        return True
    if not isinstance(body.poisson, str):
        return body.poisson > NEARLY_INCOMPRESSIBLE
    ratio = Scalar(body.poisson, scene.parameters.names)
    return (
        max(ratio.value(point) for point in box_samples(scene.parameters)) > NEARLY_INCOMPRESSIBLE
    )


def mean_dilatation(scene: Scene, cell: str, order: int = 1) -> tuple[bool, ...]:
    """True for each body that uses the mean dilatation of its cells.

    It warns of bodies that keep their volume on cells that lock. Functions of degree 2 do not lock,
    but their pressures at single nodes alternate in nearly incompressible elastic bodies; it warns
    of that too.

    Args:
        scene: the scene.
        cell: kind of the cells of its mesh.
        order: degree of the displacement.
    """
    bodies = tuple(keeps_volume(body, scene) for body in scene.bodies)
    if order == 1 and cell not in SIMPLICES:
        return bodies
    for body, keeps in zip(scene.bodies, bodies, strict=True):
        reason = (
            "has a law"
            if body.law is not None
            else f"is nearly incompressible, nu = {body.poisson}"
        )
        message = f"body {body.tag} of scene '{scene.name}' {reason}, and its"
        if keeps and order == 1:
            message += (
                f" cells are of the kind {cell}, which lock: the body answers too stiffly, bears "
                "more than its limit load, and its pressures oscillate from cell to cell. Mesh it "
                f"with {SIMPLICES[cell]}, which do not lock here"
            )
            warn(message, LockingWarning)
        elif keeps and body.law is None:
            message += (
                " displacements are of second order: sums and means of contact pressures are "
                "right, and those of single nodes alternate around them. Read resultants and "
                "means, or refine: the errors fall with the square of the cells"
            )
            warn(message, LockingWarning)
    return (False,) * len(bodies)


def gauss_degree(cell: str, order: int) -> int:
    """Degree of the rule for the strain of bodies that have laws or use a mean dilatation.

    Of first order quadrilaterals get 2 x 2 points and hexahedra 2 x 2 x 2; of second order 3 along
    each axis, and triangles 3 points and tetrahedra 4, which integrate the stiffness of straight
    cells exactly.

    Args:
        cell: kind of the cells.
        order: degree of the displacement.
    """
    return 2 if order == 1 or cell in SIMPLICES else 4
