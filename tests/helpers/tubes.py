"""The thick tube under inner pressure, and elastic models that are solved in time as those of
inelastic bodies are.
"""

from scenes import block_scene, slope

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import block

YOUNG, POISSON = 200.0, 0.3


def tube(law, pressure, cells=24, poisson=0.3, **others):
    """Tube 1 <= r <= 2 held axially, with inner pressure up to the given one.

    ``others`` replace parts of the scene.
    """
    given = {
        "hypothesis": "axisymmetric",
        "bodies": (hhr.Body(block.SOLID, YOUNG, poisson, law),),
        "contacts": (hhr.Obstacle(block.side(0, upper=True), (1, 0), 9.0),),
        "displacements": tuple(
            hhr.Displacement(block.side(1, upper=upper), 1) for upper in (False, True)
        ),
        "loads": (hhr.Pressure(block.side(0, upper=False), slope("p")),),
    }
    box = {"p": (0.0, pressure)}
    return block_scene(
        "tube", box, lower=(1, 0), upper=(2, 0.2), cells=(cells, 1), **given | others
    )


def in_time(scene):
    """A model in which nothing flows, solved through its Gauss points and in time steps all the
    same.
    """
    from hhr_dolfinx.plugins.inelastic.full_order import bodies_of

    full = hhr.FullOrderModel(scene)
    gauss = bodies_of(scene)
    full._factor(gauss.discretisation, gauss.stiffness, gauss.moduli)
    full.equilibrium = gauss.equilibrium(full)
    return full


def lame_tube(cells, gap, poisson=0.3):
    """Tube 1 <= r <= 2 under inner pressure in [0, 1], held axially, with a rigid wall at 2 +
    gap.
    """
    return tube(
        None,
        1.0,
        cells,
        poisson,
        contacts=(hhr.Obstacle(block.side(0, upper=True), (1, 0), 2 + gap),),
    )


def lame(inner, outer):
    """A and C of sigma_r = A - C / r^2 and sigma_theta = A + C / r^2 under pressures at r = 1 and
    2.
    """
    return (inner - 4 * outer) / 3, 4 * (inner - outer) / 3


def lame_displacement(A, C, r, poisson=0.3):
    """u_r in plane strain."""
    return (1 + poisson) / YOUNG * ((1 - 2 * poisson) * A * r + C / r)
