"""Make joint.step: a bolt, a flange and a base, such as a CAD program writes, for the demo of a
bolted joint.

    python demos/meshes/joint.py [--out DIR] [--quick] [--seed N]

``--out demos/meshes`` replaces the file that the demo reads. Nothing is random, and ``--quick``
makes the same.
"""

import sys
from pathlib import Path

import gmsh

sys.path.append(str(Path(__file__).parents[1]))

SHANK, HOLE, HEAD, RIM, BASE, FLANGE, TOP = 5.0, 5.5, 9.0, 20.0, -15.0, 8.0, 14.0
"""Radii, and heights of the lower end, of the top of the flange and of the head, in mm.

The plates meet at 0.
"""


def solids() -> None:
    """Make the three solids in this order.

    The shank widens to the radius of the hole below its head.
    """
    occ = gmsh.model.occ
    shank = occ.addCylinder(0, 0, BASE, 0, 0, FLANGE - BASE, SHANK)
    neck = occ.addCone(0, 0, FLANGE - 1, 0, 0, 1, SHANK, HOLE)
    head = occ.addCylinder(0, 0, FLANGE, 0, 0, TOP - FLANGE, HEAD)
    occ.fuse([(3, shank)], [(3, neck), (3, head)])
    for low, high in ((0.0, FLANGE), (BASE, 0.0)):
        whole, hole = (
            occ.addCylinder(0, 0, low, 0, 0, high - low, radius) for radius in (RIM, HOLE)
        )
        occ.cut([(3, whole)], [(3, hole)])
    occ.synchronize()


def main() -> None:
    """Write the solids and ``report.json``."""
    from parts import cli

    options = cli.parse_on_first_rank(cli.demo_parser("joint", __doc__))
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    solids()
    gmsh.write(str(options.out / "joint.step"))
    volumes = len(gmsh.model.getEntities(3))
    gmsh.finalize()
    cli.write_drawn("joint", {"solids": volumes}, options)


if __name__ == "__main__":
    main()
