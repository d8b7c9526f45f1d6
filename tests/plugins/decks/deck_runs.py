"""Decks through `hhr start`, solved, and through CalculiX."""

import shutil
import subprocess

import numpy as np
import pytest
from shell import invoke

import hhr_dolfinx as hhr
from hhr_dolfinx.command.loading import scene_of

WAIT = 60.0  # seconds for a small deck


def started(folder, text, name="deck.inp", code=0):
    """The scene of a deck's text, and what the command printed."""
    (folder / name).write_text(text)
    ended, output = invoke("start", folder / name)
    assert ended == code, output
    return scene_of(str(folder / name.replace("inp", "py"))), output


def solved(scene, duration=None):
    """Model and answer in the middle of the box."""
    full = hhr.FullOrderModel(scene)
    more = {} if duration is None else {"duration": duration}
    return full, full.solve(scene.parameters.middle, **more)


def end(full, answer, place=(4.0, 0.0, 0.0)):
    """Displacement of the node at a place."""
    node = np.linalg.norm(full.problem.points - place, axis=1).argmin()
    return answer.displacement().reshape(-1, 3)[node]


def by_calculix(folder, text, nodes):
    """Sum of the reactions at a set of nodes by CalculiX, (3,); the test is skipped where it is not installed."""
    if shutil.which("ccx") is None:
        pytest.skip("ccx, CalculiX, is not installed")
    asked = f"*NODE PRINT, NSET={nodes}, TOTALS=ONLY\nRF\n*END STEP"
    (folder / "again.inp").write_text(text.replace("*END STEP", asked))
    subprocess.run(["ccx", "again"], cwd=folder, check=True, capture_output=True, timeout=WAIT)
    rows = [line.split() for line in (folder / "again.dat").read_text().splitlines()]
    return np.array([row for row in rows if len(row) == 3][-1], dtype=float)
