"""Decks for CalculiX and Abaqus: read again they are the same scene."""

import dataclasses
import shutil
import subprocess

import numpy as np
import pytest
from mpi4py import MPI
from needs import needs
from processes import WAIT
from scenes import pair_scene, slope
from shell import AT, DEMO, invoke

import hhr_dolfinx as hhr
from hhr_dolfinx.full_order.discretisation import Discretisation
from hhr_dolfinx.geometries.two_blocks import side
from hhr_dolfinx.plugins.exporters.deck import write_deck


def pressed(hypothesis, simplices):
    """Two blocks, the lower clamped, the upper pressed on its top and its side."""
    dim = 3 if hypothesis == "solid" else 2
    up = dim - 1
    cells = (3,) * dim
    first = (1.0,) + (0.0,) * up, (2.0,) + (1.0,) * up, cells
    second = (1.0,) + (0.0,) * (up - 1) + (1.0,), (2.0,) + (1.0,) * (up - 1) + (2.0,), cells
    inner = side(2, 0, False)
    return pair_scene(
        "pressed", {"p": (0.0, 10.0)}, first, second, ((1000.0, 0.3), (2000.0, 0.2)),
        simplices=simplices,
        hypothesis=hypothesis,
        contacts=(hhr.NodeToSurface(side(1, up, True), side(2, up, False)),),
        displacements=(*hhr.Displacement.clamp(side(1, up, False), dim),
                       *(hhr.Displacement(inner, k) for k in range(dim - 1))),
        loads=(hhr.Pressure(side(2, up, True), slope("p")),
               hhr.Pressure(side(2, 0, True), slope("p", 0.5))),
    )  # fmt: skip


def by_calculix(path, count, dim):
    subprocess.run(
        ["ccx", path.stem], cwd=path.parent, capture_output=True, check=True, timeout=WAIT
    )
    moved, time = np.zeros((count, dim)), 0.0
    for line in path.with_suffix(".dat").read_text().splitlines():
        words = line.split()
        if "displacements" in line:
            time = float(words[-1])
        elif len(words) == 4 and words[0].isdigit() and int(words[0]) <= count:
            moved[int(words[0]) - 1] = [float(word) for word in words[1 : 1 + dim]]
    assert time == 1.0
    return moved


SECOND = needs("second_order")
KINDS = [
    ("plane_strain", True),
    ("plane_strain", False),
    ("axisymmetric", False),
    ("solid", True),
    ("solid", False),
]


# of second order simplices alone: the others have nodes in the middle of faces, which decks have no
# elements for
@pytest.mark.parametrize(
    ("hypothesis", "simplices", "order"),
    [
        *((*kind, 1) for kind in KINDS),
        *(pytest.param(*kind, 2, marks=SECOND) for kind in KINDS if kind[1]),
    ],
)
def test_a_deck_is_the_scene_again_and_calculix_agrees(hypothesis, simplices, order, tmp_path):
    scene = dataclasses.replace(pressed(hypothesis, simplices), order=order)
    model = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    answer = model.solve(5.0)
    path = tmp_path / "deck.inp"
    write_deck(path, Discretisation(scene, MPI.COMM_SELF), 5.0)

    def named(items):
        return tuple(dataclasses.replace(item, tag=f"tag_{item.tag}") for item in items)

    contacts = (hhr.NodeToSurface(*(f"tag_{tag}" for tag in scene.contacts[0].tags)),)
    parts = {what: named(getattr(scene, what)) for what in ("bodies", "displacements", "loads")}
    read = dataclasses.replace(
        scene, geometry=hhr.MeshFile(path), contacts=contacts, order=None, **parts
    )
    again = hhr.FullOrderModel(read, MPI.COMM_SELF)
    orders = [np.lexsort(one.problem.contact_points.round(8).T) for one in (model, again)]
    found = again.solve(5.0).forces()[orders[1]]
    np.testing.assert_allclose(
        found, answer.forces()[orders[0]], atol=1e-10 * answer.forces().max()
    )
    if shutil.which("ccx"):
        dim = model.problem.block_size
        moved, own = (
            by_calculix(path, len(model.problem.points), dim),
            answer.displacement().reshape(-1, dim),
        )
        assert np.linalg.norm(moved - own) < 5e-3 * np.linalg.norm(
            own
        )  # of penalty and of large displacements


def test_a_deck_is_written(tmp_path):
    (tmp_path / "closed.py").write_text(
        "from dataclasses import replace\nimport hhr_dolfinx as hhr\nimport your_scene\n"
        "box = hhr.ParameterSpace(('travel',), (0.05,), (1.0,))\n"
        "scene = replace(your_scene.scene(), openings=(), parameters=box)\n"
    )
    path = tmp_path / "decks" / "closed.inp"
    code, output = invoke("export", tmp_path / "closed.py", "--at", "travel=0.5", "--out", path)
    assert code == 0 and output == f"{path}\n"
    deck = path.read_text().upper()
    assert all(
        word in deck for word in ("*NODE", "*ELEMENT", "*CONTACT PAIR", "*BOUNDARY", "*STEP")
    )
    code, output = invoke("export", DEMO, *AT, "--out", path)
    assert code == 3 and "gaps are added" in output
