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


def run_calculix(folder, text, asked):
    """Rows of numbers that CalculiX prints for a request in the last step.

    None where it is not installed.
    """
    if shutil.which("ccx") is None:
        return []
    head, end, tail = text.rpartition("*END STEP")
    (folder / "again.inp").write_text(f"{head}{asked}\n{end}{tail}")
    subprocess.run(["ccx", "again"], cwd=folder, check=True, capture_output=True, timeout=WAIT)
    words = [line.split() for line in (folder / "again.dat").read_text().splitlines()]
    return [
        [float(word) for word in row]
        for row in words
        if row and row[0].lstrip("-").replace(".", "")[:1].isdigit()
    ]


def by_calculix(folder, text, nodes):
    """Sum of the reactions at a set of nodes by CalculiX, (3,).

    The test is skipped where it is not installed.
    """
    rows = run_calculix(folder, text, f"*NODE PRINT, NSET={nodes}, TOTALS=ONLY\nRF")
    if not rows:
        pytest.skip("ccx, CalculiX, is not installed")
    return np.array(rows[-1])


def moved_by_calculix(folder, text, nodes, number):
    """Displacement of a node of a set by CalculiX, (3,), at the end of the last step.

    None without CalculiX.
    """
    rows = run_calculix(folder, text, f"*NODE PRINT, NSET={nodes}\nU")
    return next((np.array(row[1:]) for row in reversed(rows) if row[0] == number), None)
