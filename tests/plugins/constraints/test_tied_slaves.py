"""Two bodies that a tie makes one, on a common base: their corner nodes have one condition."""

import gmsh
import numpy as np
import pytest
from needs import MORTAR, NODE_TO_SURFACE, needs

import hhr_dolfinx as hhr


def mesh(path, cells):
    """Blocks of 1 x 1 side by side on a base of 2 x 1, with surfaces low, up, l and r.

    Cells along x of each.
    """
    gmsh.initialize()
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        made = {"left": (0, 0, 1), "right": (1, 0, 1), "base": (0, -1, 2)}
        tags = {
            name: gmsh.model.occ.addRectangle(x, y, 0, wide, 1)
            for name, (x, y, wide) in made.items()
        }
        gmsh.model.occ.synchronize()
        for (name, tag), count in zip(tags.items(), cells, strict=True):
            gmsh.model.addPhysicalGroup(2, [tag], name=name)
            middle = gmsh.model.occ.getCenterOfMass(2, tag)
            for _, line in gmsh.model.getBoundary([(2, tag)], oriented=False):
                off = np.subtract(gmsh.model.occ.getCenterOfMass(1, line), middle)
                upright = abs(off[1]) < 0.1
                gmsh.model.mesh.setTransfiniteCurve(line, (3 if upright else count) + 1)
                side = ("r" if off[0] > 0 else "l") if upright else ("up" if off[1] > 0 else "low")
                gmsh.model.addPhysicalGroup(1, [line], name=f"{name}_{side}")
            gmsh.model.mesh.setTransfiniteSurface(tag)
            gmsh.model.mesh.setRecombine(2, tag)
        gmsh.model.mesh.generate(2)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()


@needs("constraints", "mortar", "nonmatching", "floating", "shared_nodes")
@pytest.mark.parametrize(
    ("pairing", "cells"),
    [
        pytest.param(*MORTAR.values, (4, 5, 6), id="Mortar"),
        pytest.param(*NODE_TO_SURFACE.values, (4, 4, 8), id="nodes"),
    ],
)
def test_slaves_that_a_tie_makes_one_have_one_condition(pairing, cells, tmp_path):
    """Patch test: pressed by 10, each block bears 10 at the arms 0.5 and 1.5, on nodes of its
    own.
    """
    mesh(tmp_path / "tied.msh", cells)
    press = hhr.Amplitude(slopes={"press": 1.0})
    scene = hhr.Scene(
        name="tied",
        hypothesis="plane_strain",
        geometry=hhr.MeshFile(str(tmp_path / "tied.msh")),
        bodies=tuple(hhr.Body(name, young=1e3, poisson=0.0) for name in ("left", "right", "base")),
        contacts=tuple(pairing(f"{name}_low", "base_up") for name in ("left", "right")),
        constraints=(hhr.Tie("right_l", "left_r"),),
        displacements=(*hhr.Displacement.clamp("base_low", 2), hhr.Displacement("left_l", 0)),
        loads=tuple(hhr.Pressure(f"{name}_up", press) for name in ("left", "right")),
        parameters=hhr.ParameterSpace(("press",), (0.0,), (20.0,)),
        outputs=tuple(
            output
            for k in (0, 1)
            for output in (
                hhr.ContactForce(f"force {k}", k, (0.0, 1.0)),
                hhr.ContactMoment(f"moment {k}", k, (0.0, 0.0)),
                hhr.ContactWidth(f"width {k}", k),
            )
        ),
    )
    full = hhr.FullOrderModel(scene)
    answer = full.solve({"press": 10.0})
    assert full.conditions == cells[0] + cells[1] + 1
    assert answer.pressure() == pytest.approx(np.full(full.conditions, 10.0), rel=1e-9)
    halves = {
        f"{name} {k}": value
        for k, arm in enumerate((0.5, 1.5))
        for name, value in (("force", 10.0), ("moment", 10.0 * arm), ("width", 1.0))
    }
    assert dict(answer.outputs().items()) == pytest.approx(halves, rel=1e-9)
