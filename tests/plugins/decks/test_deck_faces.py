"""A deck with a contact pair for each face of a flat interface, as FreeCAD and PrePoMax write
them.
"""

import itertools

import numpy as np
import pytest
from needs import needs
from shell import invoke

import hhr_dolfinx as hhr
from hhr_dolfinx.command.loading import scene_of


def faces(above):
    """Two bars of C3D8, 20 x 10 x 10, nu = 0, on each other.

    Two cells below and some ``above``, two pairs.
    """
    lines = ["*NODE, NSET=NALL"]
    places = {}
    for body, low, count in ((0, 0.0, 2), (100, 10.0, above)):
        for k, j, i in itertools.product((0, 1), (0, 1), range(count + 1)):
            places[body + 1 + i + (count + 1) * (j + 2 * k)] = (
                20.0 * i / count,
                10.0 * j,
                low + 10.0 * k,
            )
    lines += [f"{node}, {x}, {y}, {z}" for node, (x, y, z) in places.items()]
    for body, name, first, count in ((0, "LOWER", 1, 2), (100, "UPPER", 3, above)):
        lines.append(f"*ELEMENT, TYPE=C3D8, ELSET={name}")
        for i in range(count):
            ring = [(i, 0), (i + 1, 0), (i + 1, 1), (i, 1)]
            corners = [body + 1 + a + (count + 1) * (b + 2 * k) for k in (0, 1) for a, b in ring]
            lines.append(", ".join(map(str, [first + i, *corners])))
    for name, axis in (("FLOOR", 2), ("XS", 0), ("YS", 1)):
        lines += [
            f"*NSET, NSET={name}",
            ", ".join(str(node) for node, at in places.items() if at[axis] == 0.0),
        ]
    for k in (1, 2):
        lines += [
            f"*SURFACE, NAME=IND{k}, TYPE=ELEMENT",
            f"{k},S2",
            f"*SURFACE, NAME=DEP{k}, TYPE=ELEMENT",
        ]
        lines += [f"{3 + (k - 1) * above // 2 + i},S1" for i in range(above // 2)]
    lines += ["*MATERIAL, NAME=M", "*ELASTIC", "1000., 0."]
    lines += [f"*SOLID SECTION, ELSET={name}, MATERIAL=M" for name in ("LOWER", "UPPER")]
    lines += ["*SURFACE INTERACTION, NAME=I"]
    for k in (1, 2):
        lines += ["*CONTACT PAIR, INTERACTION=I, TYPE=SURFACE TO SURFACE", f"DEP{k}, IND{k}"]
    lines += ["*BOUNDARY", "FLOOR,3,3", "XS,1,1", "YS,2,2", "*STEP", "*STATIC", "*DLOAD"]
    return "\n".join([*lines, *(f"{3 + i},P2,10." for i in range(above)), "*END STEP", ""])


@needs("decks", "mortar", "floating", "shared_nodes")
@pytest.mark.parametrize("above", [2, 4])
def test_a_pair_for_each_face_is_one_interface(above, tmp_path):
    """The pressure is 10 and the force 2000 in all, as CalculiX 2.20 prints for both meshes."""
    (tmp_path / "faces.inp").write_text(faces(above))
    code, output = invoke("start", tmp_path / "faces.inp")
    assert code == 0, output
    full = hhr.FullOrderModel(scene_of(str(tmp_path / "faces.py")))
    answer = full.solve(full.parameters.middle)
    assert full.conditions == 2 * (above + 1)
    assert answer.pressure() == pytest.approx(np.full(full.conditions, 10.0), rel=1e-9)
    sums = [answer.forces() @ full.problem.shares_of(k) for k in (0, 1)]
    assert sums == pytest.approx([1000.0, 1000.0], rel=1e-9)
