"""The plate of shells of CalculiX in demos/meshes, in a folder of its own."""

import csv
import zipfile
from pathlib import Path

import hhr_dolfinx as hhr

ARCHIVE = Path(__file__).parents[3] / "demos/meshes/shell_plate.zip"


def unpacked(folder: Path) -> Path:
    with zipfile.ZipFile(ARCHIVE) as archive:
        archive.extractall(folder)
    return folder


def block(folder: Path, **changes):
    given = {"case": folder / "case.inp", "results": folder / "case.frd", "name": "plate"}
    return hhr.ForeignBlock(folder / "plate.sti", folder / "plate.inp", **(given | changes))


def scene(made, **changes):
    """Clamped at one end, pushed at the other one, above a floor 0.2 below its lower side."""
    given = {
        "contacts": (hhr.Obstacle("S1", (0.0, 0.0, -1.0), 0.3),),
        "displacements": hhr.Displacement.clamp("FIX", 3),
        "loads": (hhr.NodalForce("TIP", (0.0, 0.0, -1.0), "push"),),
        "outputs": (hhr.ContactForce("force", 0, direction=(0.0, 0.0, 1.0)),),
        "parameters": hhr.ParameterSpace(("push",), (0.0,), (2.0,)),
    }
    return hhr.ForeignStiffness(made).scene("plate", **(given | changes))


def theirs(folder: Path):
    """Push at each of six nodes, and the force on the floor, of CalculiX' own contact."""
    with (folder / "theirs.csv").open() as file:
        return [(float(row["push"]), float(row["force"])) for row in csv.DictReader(file)]
