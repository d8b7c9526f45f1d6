"""gmsh's optimisers of curved cells, as a script: ``python high_order.py mesh.npz HighOrder``.

Gmsh ends the whole process if its optimiser misses its target (``std::runtime_error``, 4.15), so
that it must not run in the process of a user. The file has ``points``, (n, 3), nodes of ``cells``,
(c, K), and of ``held`` facets, (f, k), whose nodes do not move, and gmsh's numbers of both kinds of
elements, ``kinds``, (2,). New points are written to it.
"""

import sys

import numpy as np


def optimise(path: str, how: str) -> None:
    """Move the nodes of a mesh in a file by an optimiser of gmsh.

    Args:
        path: file of the mesh, which gets the new points.
        how: the optimiser, ``HighOrder`` or ``HighOrderElastic``.
    """
    import gmsh

    with np.load(path) as file:
        points, cells, held, kinds = (file[name] for name in ("points", "cells", "held", "kinds"))
    gmsh.initialize([], False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.AbortOnError", 2)
    gmsh.option.setNumber("Mesh.HighOrderFixBoundaryNodes", 1)
    dim = gmsh.model.mesh.getElementProperties(int(kinds[0]))[1]
    gmsh.model.addDiscreteEntity(dim - 1, 1)
    gmsh.model.addDiscreteEntity(dim, 1, [1])
    fixed = np.unique(held)
    for entity_dim, nodes in ((dim - 1, fixed), (dim, np.setdiff1d(cells, fixed))):
        gmsh.model.mesh.addNodes(entity_dim, 1, nodes + 1, points[nodes].ravel())
    gmsh.model.mesh.addElementsByType(1, int(kinds[1]), [], (held + 1).ravel())
    gmsh.model.mesh.addElementsByType(1, int(kinds[0]), [], (cells + 1).ravel())
    gmsh.model.mesh.optimize(how)
    # gmsh numbers nodes and elements anew, and keeps their order in elements
    numbers, coordinates, _ = gmsh.model.mesh.getNodes()
    at = np.zeros((int(numbers.max()) + 1, 3))
    at[numbers.astype(np.int64)] = coordinates.reshape(-1, 3)
    points[cells] = at[gmsh.model.mesh.getElements(dim)[2][0].astype(np.int64).reshape(cells.shape)]
    gmsh.finalize()
    with open(path, "wb") as out:
        np.savez(out, points=points)


if __name__ == "__main__":
    optimise(*sys.argv[1:])
