"""Bolted joint: a model with a known error, a page and a unit
===========================================================

An M10 bolt of steel clamps a flange of aluminium on a base of steel. The solids are read from a
STEP file and cut along their axis, and gmsh meshes the section by triangles of second order
(axisymmetric). Parameters: turn of the nut as a shortening of the bolt, lift of the flange at its
rim, temperature rise, and Young's modulus of the flange.

.. image:: /pictures/bolted_joint.png
   :alt: Section of the bolted joint with its stress, and pressures of both contacts

``hhr.reduce`` builds the model, compares it with forty full solutions that it has not seen, and
prints how it knows its error: contact forces are right to round-off, since the modulus of a whole
body is an exact factor of its stiffness. A lift of 0.02 mm opens four fifths of the joint, while
the clamp force falls by a few per cent only.

You learn the shortest way from a STEP file to something that others can use. The page draws the
joint while sliders move, and the unit (FMI 3.0) answers in any simulation tool. For a joint of
your own change the STEP file, the names of its solids, and the boxes in which its surfaces lie.

.. code-block:: text

    ∫ σ(u) : ε(v) r + λ·B v = l(v),    B u <= g,  λ >= 0,  λ·(B u - g) = 0
    under the head and between the plates;    S(μ) = Σ_c S_c / E_c,  all contact conditions are kept

.. code-block:: sh

    python demos/bolted_joint.py [--out DIR] [--quick] [--seed N]
"""

# sphinx_gallery_thumbnail_path = "pictures/bolted_joint.png"

from pathlib import Path

import gmsh
import numpy as np

import hhr_dolfinx as hhr
from hhr_dolfinx.plugins.exporters.fmu import write_fmu
from hhr_dolfinx.plugins.pages.scenery_of import scenery_of
from hhr_dolfinx.timing import timed

STEP = Path(__file__).parent / "meshes" / "joint.step"
SHANK, HOLE, HEAD, RIM, BASE, FLANGE, TOP = 5.0, 5.5, 9.0, 20.0, -15.0, 8.0, 14.0
"""Radii, and heights of the lower end, of the top of the flange and of the head, in mm.

The plates meet at 0.
"""
SURFACES = {  # body, and box (r, z, r, z) of the lines of its section
    "head": ("bolt", (HOLE, FLANGE, HEAD, FLANGE)), "thread": ("bolt", (0, BASE, SHANK, BASE)),
    "axis": ("bolt", (0, BASE, 0, TOP)), "top": ("flange", (HOLE, FLANGE, RIM, FLANGE)),
    "foot": ("flange", (HOLE, 0, RIM, 0)), "rim": ("flange", (RIM, 0, RIM, FLANGE)),
    "seat": ("base", (HOLE, 0, RIM, 0)), "bottom": ("base", (HOLE, BASE, RIM, BASE)),
}  # fmt: skip
CONTACTS = ("head", "top", "foot", "seat")
BOX = {"turn": (0.005, 0.03), "lift": (0.0, 0.02), "warmer": (0.0, 80.0), "E_flange": (60e3, 80e3)}
UNITS = {"turn": "mm", "lift": "mm", "warmer": "K", "E_flange": "MPa"}


def named_lines(
    sections: dict[str, list], surfaces: dict[str, tuple[str, tuple]]
) -> dict[str, list]:
    """Name sections by gmsh, and lines of their boundaries, each in a box (r, z, r, z) of a body.

    The lines by name.
    """
    for name, faces in sections.items():
        gmsh.model.addPhysicalGroup(2, [tag for _, tag in faces], name=name)
    found = {}
    for name, (body, (r, z, r_end, z_end)) in surfaces.items():
        inside = gmsh.model.getEntitiesInBoundingBox(
            r - 0.01, z - 0.01, -1, r_end + 0.01, z_end + 0.01, 1, dim=1
        )
        found[name] = sorted(
            set(gmsh.model.getBoundary(sections[body], oriented=False)) & set(inside)
        )
        gmsh.model.addPhysicalGroup(1, [tag for _, tag in found[name]], name=name)
    return found


def mesh_step(step: Path, mesh: Path, fine: float) -> None:
    """Cut the solids of a STEP file by a half-plane through their axis, and mesh the section."""
    occ = gmsh.model.occ
    sections = {}
    for name, solid in zip(("bolt", "flange", "base"), occ.importShapes(str(step)), strict=True):
        plane = occ.addRectangle(0, -100, 0, 100, 200)
        occ.rotate([(2, plane)], 0, 0, 0, 1, 0, 0, np.pi / 2)
        sections[name], _ = occ.intersect([(2, plane)], [solid])
        occ.rotate(sections[name], 0, 0, 0, 1, 0, 0, -np.pi / 2)  # r and z become x and y
    occ.synchronize()
    lines = named_lines(sections, SURFACES)
    for name in CONTACTS:
        gmsh.model.mesh.setSize(
            gmsh.model.getBoundary(lines[name], combined=False, oriented=False), fine
        )
    gmsh.option.setNumber("Mesh.MeshSizeMax", 3 * fine)
    gmsh.model.mesh.generate(2)
    gmsh.model.mesh.setOrder(2)
    gmsh.write(str(mesh))


def scene(mesh: Path) -> hhr.Scene:
    """The scene on a mesh file, in mm and MPa."""
    shortened = hhr.Amplitude(slopes={"turn": -1.0})
    return hhr.Scene(
        name="bolted_joint",
        geometry=hhr.MeshFile(mesh),
        hypothesis="axisymmetric",
        units=hhr.Units("mm", "MPa"),
        bodies=(
            hhr.Body("bolt", 210e3, 0.3),
            hhr.Body("flange", "E_flange", 0.33),
            hhr.Body("base", 210e3, 0.3),
        ),
        contacts=(hhr.Mortar("head", "top"), hhr.Mortar("foot", "seat")),
        displacements=(
            hhr.Displacement("axis", 0),
            hhr.Displacement("thread", 1, shortened),
            hhr.Displacement("bottom", 1),
            hhr.Displacement("rim", 1, hhr.Amplitude(slopes={"lift": 1.0})),
        ),
        loads=tuple(
            hhr.ThermalExpansion(body, expansion, "warmer")
            for body, expansion in (("bolt", 1.2e-5), ("flange", 2.3e-5), ("base", 1.2e-5))
        ),
        parameters=hhr.ParameterSpace(tuple(BOX), *zip(*BOX.values(), strict=True)),
        parameter_units=UNITS,
        outputs=(
            hhr.ContactForce("clamp force", 0, (0.0, 1.0), unit="N"),
            hhr.ContactForce("force in the joint", 1, (0.0, 1.0), unit="N"),
            hhr.LostContact("open share of the joint", 1),
        ),
    )


def main() -> None:
    """Mesh, reduce, ask, and hand on as a page and as a unit."""
    from parts import cli

    from hhr_dolfinx.plugins.one_call.progress import shares_on
    from hhr_dolfinx.plugins.studies import report

    options = cli.parse_on_first_rank(cli.demo_parser("bolted_joint", __doc__))
    out, console = options.out, options.console
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    mesh_step(STEP, out / "joint.msh", fine=1.0 if options.quick else 0.5)
    gmsh.finalize()
    made = scene(out / "joint.msh")
    made.plot(out / "scene.png")
    full = hhr.FullOrderModel(made)
    model, seconds = timed(
        lambda: hhr.reduce(
            full,
            error=0.01,
            of=["forces", "clamp force"],
            seed=options.seed,
            progress=shares_on(console),
        )
    )
    console.print(str(model.reduction))
    points = [
        {"turn": 0.02, "lift": lift, "warmer": 40.0, "E_flange": 70e3} for lift in (0.0, 0.01, 0.02)
    ]
    answers = [model.solve(point) for point in points]
    rows = []
    for point, answer in zip(points, answers, strict=True):
        outputs = answer.outputs()
        values, units = point | outputs.values, UNITS | outputs.units
        rows.append(
            {f"{name} [{units[name] or '-'}]": f"{value:.5g}" for name, value in values.items()}
        )
    cli.print_rows("joint", rows, console)
    answers[1].plot(out / "answer.png")
    hhr.save_model(out / "model.npz", model)
    hhr.write_model_page(out / "bolted_joint.html", model, scenery_of(full))
    write_fmu(out / "bolted_joint.fmu", model)
    found = {
        "scene": made.name,
        "seed": options.seed,
        "sizes": {"N": full.sizes[0], "N_lambda": full.conditions},
        "times": {"reduce": seconds},
        "reduction": model.reduction.described(),
        **report.environment(),
    }
    report.write_report(found, out)
    console.print(f"model, page, unit and pictures are in {out}")


if __name__ == "__main__":
    main()
