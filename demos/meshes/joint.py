"""STEP file of a bolt, a flange and a base, such as a CAD program writes, for the demo of a bolted joint.

python demos/meshes/joint.py
"""

from pathlib import Path

import gmsh

SHANK, HOLE, HEAD, RIM, BASE, FLANGE, TOP = 5.0, 5.5, 9.0, 20.0, -15.0, 8.0, 14.0
"""Radii, and heights of the lower end, of the top of the flange and of the head, in mm; the plates meet at 0."""


def solids() -> None:
    """Make the three solids in this order; the shank widens to the radius of the hole below its head."""
    occ = gmsh.model.occ
    shank = occ.addCylinder(0, 0, BASE, 0, 0, FLANGE - BASE, SHANK)
    neck = occ.addCone(0, 0, FLANGE - 1, 0, 0, 1, SHANK, HOLE)
    head = occ.addCylinder(0, 0, FLANGE, 0, 0, TOP - FLANGE, HEAD)
    occ.fuse([(3, shank)], [(3, neck), (3, head)])
    for low, high in ((0.0, FLANGE), (BASE, 0.0)):
        whole, hole = (occ.addCylinder(0, 0, low, 0, 0, high - low, radius) for radius in (RIM, HOLE))
        occ.cut([(3, whole)], [(3, hole)])
    occ.synchronize()


def main() -> None:
    """Write the file beside this one."""
    gmsh.initialize()
    solids()
    gmsh.write(str(Path(__file__).with_suffix(".step")))
    gmsh.finalize()


if __name__ == "__main__":
    main()
