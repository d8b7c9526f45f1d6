"""Their elements, our contact: a plate of CalculiX' shells pressed on a floor, without a mesh of
ours.

CalculiX wrote the stiffness of its S4 elements (``*FREQUENCY, SOLVER=MATRIXSTORAGE``) and solved
one load case without contact, which is compared before anything else. Contact, the model, its
derivatives and the FMI unit are ours.

    K u + B^T λ = F(μ),    B u <= g,    λ >= 0,    K theirs, B and g of the faces of the deck

What to see: forces on the floor are those of CalculiX' own contact (``theirs.csv``, a penalty of
1e9 N/mm^3) to 1e-4; an answer takes microseconds, one of CalculiX seconds.

    python demos/foreign.py [--out DIR] [--quick] [--seed N]
"""

import csv
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

import hhr_dolfinx as hhr
from hhr_dolfinx.timing import now

FILES = Path(__file__).parent / "meshes/shell_plate.zip"


def plate(folder: Path) -> hhr.Scene:
    """Clamped at one end, pushed at the other one, 0.2 mm above the floor; mm and N."""
    foreign = hhr.ForeignStiffness(
        hhr.ForeignBlock(
            folder / "plate.sti",
            folder / "plate.inp",
            case=folder / "case.inp",
            results=folder / "case.frd",
            name="plate",
        )
    )
    return foreign.scene(
        "shell_plate",
        contacts=(hhr.Obstacle("S1", normal=(0.0, 0.0, -1.0), offset=0.3),),
        displacements=hhr.Displacement.clamp("FIX", 3),
        loads=(
            hhr.NodalForce("TIP", (0.0, 0.0, -1.0), "push"),
            hhr.NodalForce("TIP", (0.0, 1.0, 0.0), "pull"),
        ),
        outputs=(
            hhr.ContactForce("force", contact=0, direction=(0.0, 0.0, 1.0), unit="N"),
            hhr.LargestPressure("peak", contact=0, unit="MPa"),
        ),
        parameters=hhr.ParameterSpace(("push", "pull"), lower=(0.0, -1.0), upper=(2.0, 1.0)),
        units=hhr.Units("mm", "MPa"),
    )


def theirs(folder: Path) -> list[tuple[float, float]]:
    """Force at each pushed node, and on the floor, of CalculiX' own contact."""
    with (folder / "theirs.csv").open(encoding="utf-8") as file:
        return [(float(row["push"]), float(row["force"])) for row in csv.DictReader(file)]


def main() -> None:
    """Compare, print the table, write ``report.json``, the model, a C header and, with a compiler,
    an FMI unit.
    """
    from parts import cli

    from hhr_dolfinx.plugins.exporters.c_header import write_c_header
    from hhr_dolfinx.plugins.studies import report

    options = cli.parse_on_first_rank(cli.demo_parser("foreign", __doc__))
    with zipfile.ZipFile(FILES) as archive:
        archive.extractall(options.out)
    start = now()
    full = hhr.FullOrderModel(plate(options.out))
    model = hhr.condense(full)
    built = now() - start
    cases: list[dict[str, Any]] = []
    for push, force in theirs(options.out):
        ours = model.outputs((push, 0.0))["force"]
        outcome = "right" if abs(ours - force) <= 1e-3 * force else f"off by {ours / force - 1:.1e}"
        cases.append(
            {
                "code": "CalculiX",
                "elements": "S4",
                "outcome": outcome,
                "ours": ours,
                "theirs": force,
            }
        )
    points = full.parameters.random(20 if options.quick else 2000, seed=options.seed)
    start = now()
    model.solve_many(points)
    query = (now() - start) / len(points)
    hhr.save_model(options.out / "plate.npz", model)
    write_c_header(options.out / "plate.h", model)
    sizes = {"N": int(full.problem.free.size), "N_lambda": full.conditions}
    times = {"offline": {"build": built}, "condensed": query}
    found = {
        "scene": "foreign",
        "seed": options.seed,
        "sizes": sizes,
        "times": times,
        "foreign": {"cases": cases},
    }
    report.write_report({**found, **report.environment()}, options.out)
    rows = [
        {name: f"{one[name]:.6g}" for name in ("ours", "theirs")} | {"outcome": one["outcome"]}
        for one in cases
    ]
    cli.print_rows("force on the floor, N", rows, options.console)
    worst = float(np.max([abs(one["ours"] / one["theirs"] - 1) for one in cases]))
    options.console.print(
        f"largest difference {worst:.1e}; {1e6 * query:.0f} us for an answer, built in "
        f"{built:.1f} s"
    )


if __name__ == "__main__":
    main()
