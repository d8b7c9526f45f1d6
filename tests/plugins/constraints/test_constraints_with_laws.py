"""Constraints, preload and springs of bodies that yield or creep."""

from dataclasses import replace

import numpy as np
import pytest
from needs import needs
from scenes import block_scene, space
from test_constraints import tied
from test_preload import AREA, LENGTH, YOUNG, column, scene

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import block, two_blocks

LAWS = {"yields": hhr.Plasticity(0.5, 20.0), "creeps": hhr.Norton(6.0, 3.0)}
BOX = {"p": (0.0, 1.0)}


def whole(law, ceiling=2.002):
    """A block of 1 x 2 on a floor, held sideways, pressed on its left and pulled to a ceiling on its right."""
    lower = (block.side(0, upper=False), block.side(1, upper=False))
    return block_scene(
        "whole",
        BOX,
        upper=(1, 2),
        cells=(4, 8),
        bodies=(hhr.Body(block.SOLID, 100.0, 0.3, law),),
        contacts=(hhr.Obstacle(block.side(1, upper=True), (0, 1), ceiling),),
        displacements=tuple(hhr.Displacement(side, axis) for axis, side in enumerate(lower)),
        loads=(hhr.NodalForce(hhr.Nodes(lambda x: np.isclose(x[1], 2) & (x[0] < 0.3)), (0.1, -0.5), "p"),
               hhr.NodalForce(hhr.Nodes(lambda x: np.isclose(x[1], 2) & (x[0] > 0.9)), (0.1, 0.6), "p")),
    )


def halves(law, kind):
    """The same of two blocks with nodes that follow those of the other one."""
    made = tied(cells=((4, 4), (4, 4)), box=BOX)
    bodies = tuple(replace(body, law=law) for body in made.bodies)
    contacts = (replace(whole(law).contacts[0], surface=two_blocks.side(2, 1, upper=True)),)
    return replace(made, bodies=bodies, contacts=contacts, loads=whole(law).loads, constraints=(replace(made.constraints[0], pairing=kind),))


PATH = [(0.0, [0.0]), *((float(k), [p]) for k, p in enumerate((0.3, 0.7, 1.0, 0.5, 0.9), start=1))]


def ordered(full, displacement):
    """Displacements of nodes in an order of their places, one for each place, (places, dim)."""
    points, dim = full.problem.points.round(9), full.problem.block_size
    _, places = np.unique(points[:, ::-1], axis=0, return_index=True)
    return displacement.reshape(-1, dim)[places]


@needs("mortar", "nonmatching", "inelastic")
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("kind", ["Mortar", "NodeToSurface"])
def test_tied_halves_are_one_body(kind, law):
    """On meshes that match, with its displacements, contact forces and plastic strains, and in contact with a wall."""
    one, two = hhr.FullOrderModel(whole(LAWS[law])), hhr.FullOrderModel(halves(LAWS[law], getattr(hhr, kind)))
    for search in ("frozen", "tangent", "elastic"):
        tight = hhr.MarchSettings(search=search, relative_stress=1e-11, floor_stress=1e-11, relative_force=1e-11)
        known, found = one.march(PATH, tight).answers, two.march(PATH, tight).answers
        for here, there in zip(found, known, strict=True):
            u = ordered(one, there.displacement())
            assert ordered(two, here.displacement()) == pytest.approx(u, abs=1e-8 * np.abs(u).max())
            forces, own = (np.sort(answer.forces()) for answer in (there, here))
            assert own == pytest.approx(forces, abs=1e-8 * known[-1].forces().max())
            plastic, own = (np.sort(answer.plastic_strain()) for answer in (there, here))
            assert own == pytest.approx(plastic, abs=1e-8 * plastic.max())
        assert known[-1].forces().max() > 1e-3 and known[-1].plastic_strain().max() > 1e-3
