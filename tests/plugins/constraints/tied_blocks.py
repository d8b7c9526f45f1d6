"""A square whose displacements follow others, and two blocks that are tied."""

from scenes import block_scene, space

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import block, two_blocks

RIGHT = block.side(0, upper=True)
LEFT = block.side(0, upper=False)
TOP = block.side(1, upper=True)
BOTTOM = block.side(1, upper=False)


def pressed(constraints=(), displacements=None, loads=None, cells=(4, 4), **more):
    """A unit square on a floor, held sideways, pressed from above by p."""
    held = (hhr.Displacement(LEFT, 0),) if displacements is None else displacements
    return block_scene(
        "pressed",
        {"p": (0.1, 1.0)},
        upper=(1, 1),
        cells=cells,
        hypothesis="plane_strain",
        bodies=(hhr.Body(block.SOLID, 100.0, 0.3),),
        contacts=(hhr.Obstacle(RIGHT, (1, 0), 1.001),),
        displacements=(*held, hhr.Displacement(BOTTOM, 1)),
        loads=(hhr.Pressure(TOP, "p"),) if loads is None else loads,
        constraints=constraints,
        **more,
    )


def tied(dim=2, wall=1.5, cells=((3, 3), (4, 5)), box=None, bodies=None, apart=0.0, **ways):
    """Two blocks one above the other, tied on meshes that do not match, pressed down beside a
    wall.
    """
    side, up = two_blocks.side, dim - 1
    boxes = [
        ([0.0] * dim, [1.0] * dim, (cells[0][0],) * up + cells[0][1:]),
        ([0.0] * up + [1.0 + apart], [1.0] * up + [2.0], (cells[1][0],) * up + cells[1][1:]),
    ]
    held = [hhr.Displacement(side(body, k, upper=False), k) for body in (1, 2) for k in range(up)]
    return hhr.Scene(
        name="tied",
        geometry=lambda comm: two_blocks.two_blocks(comm, first=boxes[0], second=boxes[1]),
        hypothesis="solid" if dim == 3 else "plane_strain",
        bodies=bodies or tuple(hhr.Body(tag, young=100.0, poisson=0.3) for tag in (1, 2)),
        contacts=(hhr.Obstacle(side(2, 0, upper=True), (1.0,) + (0.0,) * up, wall),),
        displacements=(*held, hhr.Displacement(side(1, up, upper=False), up)),
        loads=(hhr.Pressure(side(2, up, upper=True), "p"),),
        parameters=space(**(box or {"p": (0.1, 1.0)})),
        constraints=(hhr.Tie(side(2, up, upper=False), side(1, up, upper=True), **ways),),
    )
