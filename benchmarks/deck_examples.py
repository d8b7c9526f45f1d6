"""Decks of the makes of the contact examples for CalculiX, written anew: a valve on its seat, an
eye bar, tubes.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from deck_entries import CCX, Answer, Entry, hertz, node
from deck_writer import Writer, at, both


def valve() -> str:
    """The head of a valve on a conical seat of 45 degrees, rubbing, under a pressure of 20.

    r + z = 17 in contact.
    """

    def head(points: np.ndarray) -> np.ndarray:
        high = points[:, 1]
        return np.stack([points[:, 0] * (15 - np.maximum(high - 2, 0)), high, 0 * high], axis=1)

    def seat(points: np.ndarray) -> np.ndarray:
        out, along = points[:, :1], points[:, 1]
        outer = np.stack(
            [np.minimum(18, 24 - 12 * along), np.minimum(1 + 10 * along, 6), 0 * along], axis=1
        )
        return (1 - out) * np.stack(
            [16 - 4 * along, 1 + 4 * along, 0 * along], axis=1
        ) + out * outer

    deck = Writer()
    low = deck.box("EALL", "CAX6", (16, 10), (0, 0), (1, 4), head)
    up = deck.box("EALL", "CAX6", (5, 14), (0, 0), (1, 1), seat)
    deck.nset("X0", low.nodes(at(0, 0)))
    deck.nset("VSY2", up.nodes(both(at(0, 1), lambda points: points[:, 1] > 0.499)))
    deck.nset("VSR5", up.nodes(both(at(0, 1), lambda points: points[:, 1] < 0.501)))
    deck.surface("PRESS", low.faces(at(1, 0)))
    deck.surface("VC", low.faces(both(at(0, 1), lambda points: points[:, 1] > 1.999)))
    deck.surface("VSC", up.faces(at(0, 0)))
    deck.material()
    deck.section()
    deck.pair("VC", "VSC", "LINEAR/1.E7, .1, .01", more="*FRICTION/.3, 1.E6")
    deck.add(
        "*BOUNDARY/X0, 1, 1, 0/VSY2, 2, 2, 0/VSR5, 1, 1, 0/*STEP, NLGEOM, INC=200/*STATIC/.1, "
        "1./*DSLOAD/PRESS, P, 20"
    )
    deck.add("*NODE PRINT, NSET=NALL/U/*END STEP")
    return deck.text


def eyebar(thick: float = 1.0, push: float = 0.05) -> str:
    """Half of an eye, radius 10, with a hollow pin of radius 9.5, so thick, that is pulled.

    Plane strain.
    """

    def eye(points: np.ndarray) -> np.ndarray:
        out, turn = points[:, :1], points[:, 1]
        angle = np.radians(turn)
        bore = np.stack([10 * np.cos(angle), 10 * np.sin(angle), 0 * angle], axis=1)
        left = np.clip((turn - 90) / 45, 0, 1), np.clip((180 - turn) / 45, 0, 1)
        bar = np.stack([-20 * left[0], 20 * left[1], 0 * angle], axis=1)
        return (1 - out) * bore + out * np.where(turn[:, None] <= 90, 2 * bore, bar)

    def pin(points: np.ndarray) -> np.ndarray:
        radius, angle = points[:, 0], np.radians(points[:, 1])
        return np.stack([0.5 + radius * np.cos(angle), radius * np.sin(angle), 0 * angle], axis=1)

    deck = Writer()
    bar = deck.box("EEYE", "CPE4", (10, 64), (0, 0), (1, 180), eye)
    bolt = deck.box("EPIN", "CPE4", (6, 60), (4, 0), (9.5, 180), pin)
    deck.nset("FIX", bar.nodes(both(at(0, 1), lambda points: points[:, 1] >= 135)))
    deck.nset(
        "SYM", [one for box in (bar, bolt) for angle in (0, 180) for one in box.nodes(at(1, angle))]
    )
    deck.nset("CONTROL", bolt.nodes(at(0, 4)))
    deck.surface("SEYE", bar.faces(at(0, 0)))
    deck.surface("SPIN", bolt.faces(at(0, 9.5)))
    deck.material()
    deck.section("EPIN", more=f"{thick}")
    deck.section("EEYE", more="1")
    deck.pair("SEYE", "SPIN", "LINEAR/1.E7, .1, .01", "NODE TO SURFACE")
    deck.add(
        "*BOUNDARY/FIX, 1, 1, 0/SYM, 2, 2, 0/*STEP, NLGEOM, INC=200/*STATIC/.1, "
        f"1./*BOUNDARY/CONTROL, 1, 1, {push}"
    )
    deck.add("*NODE PRINT, NSET=NALL/U/*END STEP")
    return deck.text


def tubes(turn: float = 0.003) -> str:
    """Half of a tube in another one along x, 150 of 500 in it, whose end is turned about y by a
    kinematic coupling.
    """

    def bend(points: np.ndarray) -> np.ndarray:
        angle = np.radians(points[:, 1])
        return np.stack(
            [points[:, 0], points[:, 2] * np.sin(angle), points[:, 2] * np.cos(angle)], axis=1
        )

    deck = Writer()
    control = deck.node(850.0, 0.0, 0.0)
    outer = deck.box("EALL", "C3D20", (10, 8, 1), (0, 0, 45), (500, 180, 50), bend)
    inner = deck.box("EALL", "C3D20", (10, 8, 1), (350, 0, 40), (850, 180, 45), bend)
    deck.nset("CONTROL", [control])
    deck.nset("FIX", outer.nodes(at(0, 0)))
    deck.nset(
        "YSYM",
        [one for box in (outer, inner) for angle in (0, 180) for one in box.nodes(at(1, angle))],
    )
    deck.surface("IND", outer.faces(at(2, 45)))
    deck.surface("DEP", inner.faces(at(2, 45)))
    deck.surface("LOAD", inner.faces(at(0, 850)))
    deck.material(70000.0, 0.34)
    deck.section()
    deck.add("*BOUNDARY/FIX, 1, 3/YSYM, 2")
    deck.pair("DEP", "IND", "LINEAR/100000.")
    deck.add(f"*COUPLING, REF NODE={control}, SURFACE=LOAD, CONSTRAINT NAME=C1/*KINEMATIC/1/3")
    deck.add(f"*BOUNDARY/CONTROL, 1, 2/*STEP/*STATIC/.1, 1./*BOUNDARY/CONTROL, 5, 5, {turn}")
    deck.add("*NODE PRINT, NSET=NALL/U/*END STEP")
    return deck.text


def ball_ratio(answer: Answer) -> float:
    """Largest pressure over that of Hertz for a ball of radius 50 by its force."""
    hertz = (6 * answer.row("sum of") * (210e3 / 1.82) ** 2 / (np.pi**3 * 50**2)) ** (1 / 3)
    return answer.row("largest pressure 0") / float(hertz)


def cubes_without_freedom(gap: float = -0.1) -> str:
    """A cube of side 10 in one of side 20 by .1, whose nodes are all imposed: a penalty alone has
    forces.
    """
    deck = Writer()
    large = deck.box("EALL", "C3D8", (1, 1, 1), (0, 0, 0), (20, 20, 20))
    small = deck.box("EALL", "C3D8", (1, 1, 1), (20, 5, 5), (30, 15, 15))
    deck.nset("NGW", large.numbers)
    deck.nset("NKW", small.numbers)
    deck.surface("CGW", large.faces(at(0, 20)))
    deck.surface("CKW", small.faces(at(0, 20)))
    deck.material(70000.0, 0.34)
    deck.section()
    deck.pair("CKW", "CGW", "LINEAR/1.E4")
    deck.add(
        f"*BOUNDARY/NGW, 1, 3/NKW, 2, 3/*STEP, NLGEOM/*STATIC/1., 1./*BOUNDARY/NKW, 1, 1, {gap}"
    )
    deck.add("*NODE PRINT, NSET=NALL/U/*END STEP")
    return deck.text


PIN = "CPE4, node to surface"
ENTRIES = (
    Entry(
        "Hertz_axi (examples)",
        "CAX4",
        partial(hertz, "CAX4", push=0.2),
        "pressure over that of Hertz",
        ball_ratio,
        1.0,
    ),
    Entry(
        "Penalty (examples)",
        "C3D8, all imposed",
        cubes_without_freedom,
        "",
        node((20, 5, 5), 0),
        "imposed",
    ),
    Entry(
        "Valve (examples)",
        "CAX6, friction",
        valve,
        "lift of the middle",
        node((0, 0, 0), 1),
        0.0200378,
        CCX,
    ),
    Entry(
        "Eyebar (examples)",
        PIN,
        eyebar,
        "displacement of the crown",
        node((10, 0, 0), 0),
        0.04028123,
        CCX,
    ),
    Entry(
        "Eyebar, thick pin (examples)",
        PIN,
        partial(eyebar, 2.0),
        "",
        node((10, 0, 0), 0),
        "has one thickness",
    ),
    Entry(
        "Tubes (examples)",
        "C3D20, coupling",
        tubes,
        "displacement of the end",
        node((850, 0, 45), 2),
        -1.177473,
        CCX,
    ),
)
