"""A column below a plate that is cut in its middle, as a bolt is."""

import numpy as np
from cubes_in_files import EDGES_OF_A_CUBE

import hhr_dolfinx as hhr

AREA, LENGTH, YOUNG = 1.0, 3.0, 1000.0


def column(path, order=1, slope=0.0):
    """A column of 1 x 1 x 3 with 1 x 1 x 3 cells whose nodes in the middle are a set, CUT."""
    shift = lambda x, z: z + (slope * (x - 0.5) if 0.9 < z < 2.1 else 0.0)  # noqa: E731
    step = 1.0 / order
    axes = [
        np.arange(0, 1 + step / 2, step),
        np.arange(0, 1 + step / 2, step),
        np.arange(0, LENGTH + step / 2, step),
    ]
    number, rows = {}, ["*NODE"]
    for place in ((x, y, z) for z in axes[2] for y in axes[1] for x in axes[0]):
        if sum(abs(c - round(c)) > 1e-9 for c in place) < 2:  # corners and middles of edges
            number[tuple(np.round(place, 6))] = len(number) + 1
            rows.append(f"{len(number)}, {place[0]}, {place[1]}, {shift(place[0], place[2])}")
    corners = [
        (0, 0, 0),
        (1, 0, 0),
        (1, 1, 0),
        (0, 1, 0),
        (0, 0, 1),
        (1, 0, 1),
        (1, 1, 1),
        (0, 1, 1),
    ]
    rows.append(f"*ELEMENT, TYPE=C3D{8 if order == 1 else 20}, ELSET=BOLT")
    for k in range(3):
        own = [np.add(c, (0.0, 0.0, k)) for c in corners]
        own += [(own[a] + own[b]) / 2 for a, b in EDGES_OF_A_CUBE] if order == 2 else []
        rows.append(", ".join(map(str, [k + 1, *(number[tuple(np.round(p, 6))] for p in own)])))
    cut = [n for place, n in number.items() if place[2] == 1.0]
    rows += ["*NSET, NSET=CUT", ", ".join(map(str, cut))]
    for name, face, cell in (("FOOT", 1, 1), ("HEAD", 2, 3), ("LEFT", 6, None), ("FRONT", 3, None)):
        rows += [f"*SURFACE, NAME={name}"] + [
            f"{n}, S{face}" for n in ([cell] if cell else (1, 2, 3))
        ]
    path.write_text("\n".join(rows) + "\n")
    return path


def scene(path, constraints=(), loads=(), gap=0.0, ways=("p", 0.1, 1.0), sections=("CUT",)):
    """The column held at its foot, its sides sliding, below a plate at its head that is ``gap``
    away; no friction.
    """
    sides = hhr.Displacement("LEFT", 0), hhr.Displacement("FRONT", 1), hhr.Displacement("FOOT", 2)
    name, low, high = ways
    return hhr.Scene(
        name="bolt",
        geometry=hhr.CutMesh(path, sections=sections),
        hypothesis="solid",
        bodies=(hhr.Body("BOLT", young=YOUNG, poisson=0.3),),
        contacts=(hhr.Obstacle("HEAD", normal=(0, 0, 1), offset=LENGTH + gap),),
        displacements=sides,
        loads=loads,
        constraints=constraints,
        parameters=hhr.ParameterSpace((name,), (low,), (high,)),
        outputs=(
            hhr.ContactForce("plate", contact=0, direction=(0.0, 0.0, 1.0)),
            hhr.DisplacementAt("head", (0.0, 0.0, LENGTH), 2),
        ),
    )
