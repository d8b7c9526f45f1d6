"""A scene of your own, from a mesh file
=====================================

A clamped leaf spring lies between a roller and a stop. The roller is moved down by ``travel``, and
bends the spring onto the stop, which lies ``lowered`` below its drawn place. Bodies and surfaces
have the names that they have in the mesh file. Copy this script, name your own mesh, bodies and
pairs, and you have a scene.

.. image:: /pictures/your_scene.png
   :alt: The bent leaf spring with its stress, and the pressure on both contacts

Contact comes in two steps, first at the roller and then at the stop. The model answers in tens of
microseconds, and each answer has its error, which is round-off here. That is the error of the
reduction, without that of the mesh: linear triangles are too stiff in a thin spring, and the force
on the roller is 8 % above that of displacements of second order.

You learn the three commands that most scenes need. ``hhr check`` solves nothing and shows what is
in the mesh and what faces what; ``hhr study`` trains, compares with the best full order and says
which model to use; ``hhr answer`` fills a table. The study also measures what the mesh does, and
says what to do about it.

.. code-block:: text

    find u and λ >= 0:   K u + B^T λ = f(μ),    B u <= g(μ),    λ·(B u - g) = 0
    with μ = (travel, lowered)

.. code-block:: sh

    python demos/your_scene.py [--out DIR] [--quick] [--seed N]

    hhr check demos/your_scene.py    # what is in the mesh, what faces what, with a picture
    hhr study demos/your_scene.py    # train, validate, save, report, in out/leaf_spring
    hhr answer out/leaf_spring/study.npz questions.csv --out answers.csv
"""

# sphinx_gallery_thumbnail_path = "pictures/your_scene.png"

from pathlib import Path

import hhr_dolfinx as hhr

MESH = Path(__file__).parent / "meshes" / "leaf_spring.msh"
UNITS = hhr.Units("mm", "MPa")


def scene(mesh: Path | str = MESH) -> hhr.Scene:
    """The scene, on a mesh in mm."""
    return hhr.Scene(
        name="leaf_spring",
        geometry=hhr.MeshFile(mesh),
        hypothesis="plane_strain",
        units=UNITS,
        bodies=(
            hhr.Body.of("spring", "steel", UNITS),
            hhr.Body("roller", young=3000.0, poisson=0.35),  # of plastic, as the stop
            hhr.Body("stop", young=3000.0, poisson=0.35),
        ),
        contacts=(
            hhr.NodeToSurface("roller_round", "spring_top"),
            hhr.NodeToSurface("stop_round", "spring_bottom"),
        ),
        displacements=(
            *hhr.Displacement.clamp("clamp", 2),
            *hhr.Displacement.clamp("stop_flat", 2),
            hhr.Displacement("roller_flat", 0),
            hhr.Displacement("roller_flat", 1, hhr.Amplitude(slopes={"travel": -1.0})),
        ),
        openings=(hhr.Opening(1, hhr.Amplitude(slopes={"lowered": 1.0})),),
        parameters=hhr.ParameterSpace(("travel", "lowered"), (0.05, 0.0), (1.0, 0.3)),
        parameter_units={"travel": "mm", "lowered": "mm"},
        outputs=(
            hhr.ContactForce("force on the roller", contact=0, direction=(0.0, 1.0), unit="N/mm"),
            hhr.LargestPressure("pressure on the stop", contact=1, unit="MPa"),
        ),
    )


def from_abaqus() -> hhr.Scene:
    """The same scene on the mesh of an Abaqus deck: hhr check demos/your_scene.py:from_abaqus."""
    return scene(MESH.with_suffix(".inp"))


def SETTINGS() -> "hhr.StudySettings":
    """Training of `hhr train` and measurements of `hhr study`."""
    return hhr.StudySettings(hhr.Sobol(256), queries=200)


def VIEW() -> "hhr.View":
    """Pictures of `hhr study`."""
    return hhr.View(points=((0.9, 0.1),), deformed=True)


def main() -> None:
    """Train, validate, time; save the model, and write everything to the output folder."""
    from parts import cli

    options = cli.parse(cli.demo_parser("your_scene", __doc__))
    built, settings = scene(), SETTINGS().adapted(seed=options.seed, quick=options.quick)
    points = built.parameters.random(20 if options.quick else 200, seed=options.seed + 7)
    study = hhr.study_scene(built, settings, options.out, points=points, progress=options.progress)
    if study is not None:  # ranks but the first have only trained
        study.write(options.out, options.console, VIEW())


if __name__ == "__main__":
    main()
