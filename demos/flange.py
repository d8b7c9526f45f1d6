"""Bolted flange from a STEP file, by commands
===========================================

A cover closes a hydraulic line with a bore of 60 mm. One of its four bolts M16 is in this quarter,
in a tapped hole. The solids come from a STEP file; gmsh names them and meshes them by tetrahedra
of second order. Names that begin with *fixed*, *symmetry* and *pressure*, and a flat surface
inside of the bolt, are all that ``hhr start`` needs to write the scene. Parameters: shortening of
the bolt when its nut is turned, and pressure in the line.

.. image:: /pictures/flange_part.png
   :alt: A quarter of a bolted flange: von Mises stress, and contact pressure

The cover bends under the pressure, so that the bolt even loses a tenth of the working load, until
the joint opens and the bolt carries all of it. The model is exact for this mesh: its errors
against full solutions that it has not seen are round-off. A finer mesh changes the force of the
bolt by less than one per cent, and that is the error that counts.

.. image:: /pictures/flange.png
   :alt: Force of the bolt over the working load, for four preloads

Six commands lead from the STEP file to a page for a browser and a unit for a control loop, in one
to three minutes. For a part of your own, name its surfaces in the same way, and edit the one line
that holds the range of the parameters. Look at the contact pressure before you trust the diagram:
it shows where the joint bears, and whether the mesh is fine enough there.

.. code-block:: text

    find u and λ >= 0:   K u + B^T λ = f(p),    B u <= 0,    λ·B u = 0
    at the section of the bolt:   u+ - u- = -δ n

.. code-block:: sh

    python demos/flange.py [--out DIR] [--quick] [--seed N]

    hhr start flange.msh    # the scene, with a preload of the bolt
    hhr check flange.py     # what is held, loaded and in contact
    hhr reduce flange.py --of forces --of displacement --of "force 1"    # checked
    hhr page model.npz      # for a browser
    hhr embed model.npz --out flange.fmu    # for a control loop
"""

# sphinx_gallery_thumbnail_path = "pictures/flange_part.png"

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import gmsh
import numpy as np
from parts.flange_solids import BORE, mesh_step, write_step

import hhr_dolfinx as hhr
from hhr_dolfinx.timing import timed

AREA = np.pi * BORE**2 / 4
"""Area of the cover on which the pressure acts, in mm^2, of the quarter."""
BOLT, FACES = "force 1", "force 0"
"""Outputs of the scene: force under the head, which is that of the bolt, and between the faces, in
N.
"""
BOX = """\
    parameters=hhr.ParameterSpace(("preload", "pressure"), lower=(0.03, 0.0), upper=(0.12, 40.0)),
    parameter_units={"preload": "mm", "pressure": "MPa"},
    units=hhr.Units("mm", "MPa"),"""
"""What replaces the line of the parameters, the only one that is edited: shortening of the bolt,
and pressure, with their units.
"""
PRELOADS = 0.03, 0.06, 0.09, 0.12


def hhr_command(folder: Path, *words: str) -> str:
    """Run a command in a folder, as in a shell; its output.

    Its progress and warnings are shown as they come.
    """
    say(f"hhr {' '.join(words)}")
    command = [sys.executable, "-u", "-m", "hhr_dolfinx.command.main", *words]
    lines = []
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        for line in run.stdout:
            lines.append(line)
            if re.match(r"\d+ s: ", line):
                print(line, end="", file=sys.stderr, flush=True)
    if run.returncode:
        raise SystemExit(f"hhr {' '.join(words)} failed\n{''.join(lines)}")
    return "".join(lines)


def say(text: str) -> None:
    """A line on the error stream, so that nothing is silent for long."""
    print(text, file=sys.stderr, flush=True)


def meshed(out: Path, sizes: tuple[float, float]) -> None:
    """STEP file and mesh."""
    say(f"meshing with cells of {sizes[0]:g} to {sizes[1]:g} mm")
    gmsh.initialize()
    for option in ("General.Terminal", "Geometry.OCCAutoFix"):
        gmsh.option.setNumber(option, 0)
    write_step(out / "flange.step")
    mesh_step(out / "flange.step", out / "flange.msh", *sizes)
    gmsh.finalize()


def scene_file(out: Path) -> str:
    """Scene of the mesh by ``hhr start``, in which the box is edited; what the command says."""
    said = hhr_command(out, "start", "flange.msh", "--force")
    file = out / "flange.py"
    lines = file.read_text().splitlines()
    edited = [BOX if line.strip().startswith("parameters=") else line for line in lines]
    file.write_text("\n".join(edited) + "\n")
    return said


def scene_of(out: Path) -> hhr.Scene:
    """The scene of the file in a folder."""
    from hhr_dolfinx.command.loading import scene_of as loaded

    return loaded(str(out / "flange.py"))


def diagram(model: Any, file: Path) -> None:
    """Force of the bolt over the working load, for several preloads."""
    from hhr_dolfinx.plugins.studies.plots import plot_curves

    pressures = np.linspace(0.0, 40.0, 41)
    lines = {}
    for preload in PRELOADS:
        forces = model.solve_many([(preload, p) for p in pressures]).outputs()[BOLT]
        lines[f"bolt shortened by {preload:g} mm"] = pressures * AREA / 1e3, forces / 1e3
    lines["working load alone"] = pressures * AREA / 1e3, pressures * AREA / 1e3
    plot_curves(lines, file, ("working load of one bolt [kN]", "force of the bolt [kN]"))


def errors(model: Any, out: Path, points: np.ndarray) -> dict[str, float]:
    """Errors against full solutions at points, over the largest value, and of the balance of
    forces.
    """
    say("factoring the full model, to compare")
    full = hhr.FullOrderModel(scene_of(out))
    known = []
    for number, point in enumerate(points, start=1):
        say(f"full solution {number} of {len(points)}")
        known.append(full.solve(point))
    found = [model.solve(point) for point in points]
    exact, own = (
        np.array([answer.outputs()[BOLT] for answer in answers]) for answers in (known, found)
    )
    faces = np.array([answer.outputs()[FACES] for answer in found])
    forces = [np.array([answer.forces() for answer in answers]) for answers in (known, found)]
    return {
        "force of the bolt": float(np.abs(own - exact).max() / exact.max()),
        "contact forces": float(np.abs(forces[1] - forces[0]).max() / forces[0].max()),
        "balance of forces": float(np.abs(own - faces - points[:, 1] * AREA).max() / exact.max()),
    }


def main() -> None:
    """Mesh, start, check, reduce, page, unit; then the diagram, a picture and errors."""
    from parts import cli

    from hhr_dolfinx.plugins.studies import report

    options = cli.parse_on_first_rank(cli.demo_parser("flange", __doc__))
    out, console = options.out, options.console
    fine, coarse = (6.0, 18.0) if options.quick else (4.0, 12.0)
    saved = ["--out", "."]
    asked = [word for one in ("forces", "displacement", BOLT) for word in ("--of", one)]
    stages = {
        "STEP file and mesh": lambda: meshed(out, (fine, coarse)),
        "hhr start": lambda: scene_file(out),
        "hhr check": lambda: hhr_command(out, "check", "flange.py"),
        "hhr reduce": lambda: hhr_command(
            out, "reduce", "flange.py", "--error", "1%", *asked, "--seed", str(options.seed), *saved
        ),
        "hhr page": lambda: hhr_command(out, "page", "model.npz", "--out", "flange.html"),
        "hhr embed": lambda: hhr_command(out, "embed", "model.npz", "--out", "flange.fmu"),
    }
    minutes = {}
    for name, stage in stages.items():
        said, seconds = timed(stage)
        minutes[name] = seconds / 60
        console.print(f"--- {name}: {minutes[name]:.2f} minutes", highlight=False)
        if said:
            console.print(said.rstrip(), highlight=False, markup=False, soft_wrap=True)
    minutes["in all"] = sum(minutes.values())
    model = hhr.load_model(out / "model.npz")
    diagram(model, out / "flange.png")
    model.solve((0.06, 20.0)).plot(out / "flange_part.png")
    space = scene_of(out).parameters
    found = errors(model, out, space.random(2 if options.quick else 8, seed=options.seed + 7))
    middle = model.solve(space.middle).outputs()[BOLT]
    (out / "finer").mkdir(exist_ok=True)
    if not options.quick:
        meshed(out / "finer", (0.75 * fine, 0.75 * coarse))
        scene_file(out / "finer")
        say("factoring and solving the full model of the finer mesh")
        finer = hhr.FullOrderModel(scene_of(out / "finer"))
        found["force of the bolt on a finer mesh"] = abs(
            middle / finer.solve(space.middle).outputs()[BOLT] - 1
        )
    rows = [{"what": name, "found": f"{value:.2g} minutes"} for name, value in minutes.items()]
    rows += [{"what": f"error: {name}", "found": f"{value:.1e}"} for name, value in found.items()]
    cli.print_rows("flange", rows, console)
    report.write_report(
        {
            "scene": "flange",
            "seed": options.seed,
            "minutes": minutes,
            "errors": found,
            "bolt force, middle": middle,
            "starts": {name: float(model.solve((name, 0.0)).outputs()[BOLT]) for name in PRELOADS},
            **report.environment(),
        },
        out,
    )
    console.print(f"model, page, unit, diagram and report are in {out}")


if __name__ == "__main__":
    main()
