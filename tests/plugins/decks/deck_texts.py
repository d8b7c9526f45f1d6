"""Small decks of bars and stacked blocks of cubes, as CalculiX and Abaqus read them."""

import numpy as np
from shell import invoke

STEEL = "*MATERIAL, NAME=STEEL\n*ELASTIC\n1000., {poisson}\n{more}"


def _mesh(first, low, high, cells):
    axes = [np.linspace(a, b, n + 1).tolist() for a, b, n in zip(low, high, cells, strict=True)]
    points = [(x, y, z) for z in axes[2] for y in axes[1] for x in axes[0]]
    number = np.arange(first, first + len(points)).reshape([n + 1 for n in cells[::-1]])
    corners = ((0, 0), (1, 0), (1, 1), (0, 1))
    elements = [
        [int(number[k + c, j + b, i + a]) for c in (0, 1) for a, b in corners]
        for k in range(cells[2])
        for j in range(cells[1])
        for i in range(cells[0])
    ]
    return dict(zip(number.ravel().tolist(), points, strict=True)), elements


def block_lines(name, first, low, high, cells):
    """Lines of one body, with sets NAME_X0, NAME_X1, ... of its sides, and surfaces NAME_TOP and
    NAME_BOTTOM.
    """
    points, elements = _mesh(first, low, high, cells)
    lines = ["*NODE, NSET=ALL", *(f"{k}, {x!r}, {y!r}, {z!r}" for k, (x, y, z) in points.items())]
    lines += [f"*ELEMENT, TYPE=C3D8, ELSET={name}"]
    lines += [f"{first + k}, {', '.join(map(str, nodes))}" for k, nodes in enumerate(elements)]
    for axis in range(3):
        for end, value in enumerate((low[axis], high[axis])):
            lines.append(f"*NSET, NSET={name}_{'XYZ'[axis]}{end}")
            lines += [str(k) for k, place in points.items() if abs(place[axis] - value) < 1e-9]
    layer = cells[0] * cells[1]
    for surface, face, start in (("BOTTOM", 1, 0), ("TOP", 2, len(elements) - layer)):
        lines.append(f"*SURFACE, NAME={name}_{surface}")
        lines += [f"{first + start + k}, S{face}" for k in range(layer)]
    return lines


def bar(step, more="", poisson=0.3, cells=(4, 1, 1)):
    """A bar of 4 x 1 x 1 on rollers at x, y and z = 0; ``more`` are lines of its material."""
    lines = block_lines("BAR", 1, (0.0, 0.0, 0.0), (4.0, 1.0, 1.0), cells)
    lines += [STEEL.format(poisson=poisson, more=more), "*SOLID SECTION, ELSET=BAR, MATERIAL=STEEL"]
    lines += [
        "*BOUNDARY",
        "BAR_X0, 1",
        "BAR_Y0, 2",
        "bar_z0, 3",
        "*STEP",
        "*STATIC",
        "1., 1.",
        step,
        "*END STEP",
    ]
    return "\n".join(lines) + "\n"


def blocks(
    step,
    pair="UPPER_BOTTOM, LOWER_TOP",
    upper=(3, 3, 1),
    gap=0.0,
    interaction="",
    before="",
    kind="",
):
    """Two unit cubes on each other, on rollers at x, y and z = 0.

    ``kind`` is the TYPE of their pair.
    """
    lines = block_lines("LOWER", 1, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (2, 2, 1))
    lines += block_lines("UPPER", 1001, (0.0, 0.0, 1.0 + gap), (1.0, 1.0, 2.0 + gap), upper)
    lines += [STEEL.format(poisson=0.0, more=""), *(f"*SOLID SECTION, ELSET={name}, MATERIAL=STEEL"
                                                     for name in ("LOWER", "UPPER"))]  # fmt: skip
    lines += [
        "*SURFACE INTERACTION, NAME=TOUCH",
        *filter(None, [interaction]),
        "*CONTACT PAIR, INTERACTION=TOUCH" + f", TYPE={kind}" * bool(kind),
        pair,
    ]
    lines += ["*BOUNDARY", "LOWER_Z0, 1, 3", "UPPER_X0, 1", "UPPER_Y0, 2", *filter(None, [before])]
    return "\n".join([*lines, "*STEP", "*STATIC", step, "*END STEP"]) + "\n"


def started_file(folder, text):
    """Name of the scene file of a deck's text, and what the command printed."""
    (folder / "deck.inp").write_text(text)
    code, output = invoke("start", folder / "deck.inp")
    assert code == 0, output
    return str(folder / "deck.py"), output
