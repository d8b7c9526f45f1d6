"""The commands ``hhr study`` and ``hhr report``: errors and times of models of a scene, and the
page of them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hhr_dolfinx.command.making import settings_of, training_of, with_training
from hhr_dolfinx.command.speaking import guarded, resumable, spoken
from hhr_dolfinx.command.words import OUT, SCENE, examples
from hhr_dolfinx.compat import extra

with extra("study", "the command hhr"):
    import click


@click.command(
    epilog=examples("hhr study my_scene.py --grid 16,16 --tests 200", "hhr report out/my_scene")
)
@SCENE
@with_training
@click.option(
    "--tests", type=click.IntRange(1), default=200, show_default=True, help="random test points"
)
@click.option(
    "--queries",
    type=click.IntRange(6),
    default=200,
    show_default=True,
    help="timed queries of each method",
)
@click.option(
    "--seed", type=click.IntRange(0), default=1, show_default=True, help="of random points"
)
@click.option(
    "--rivals", default="", help="all, or names with commas, of the table: galerkin,cpg [none]"
)
@OUT
@resumable
def study(
    scene: str, out: Path | None, tests: int, queries: int, seed: int, rivals: str, **how: Any
) -> None:
    """Train, then compare errors and times with the full order and condensation.

    Write report, pictures and model.
    """
    from dataclasses import replace

    from hhr_dolfinx.command.loading import beside, scene_of, value_of
    from hhr_dolfinx.plugins.studies.settings import StudySettings, View
    from hhr_dolfinx.plugins.studies.study import rivals_of, study_scene

    console, progress = spoken()
    chosen = rivals_of([name.strip() for name in rivals.split(",") if name.strip()])
    loaded = scene_of(scene)
    settings = settings_of(scene)
    view = value_of(beside(scene, "VIEW"), scene, "VIEW", View)
    for point in () if view is None else view.points:
        loaded.parameters.point(point)  # refuses it before anything is solved
    training = training_of(how, settings)
    settings = replace(
        settings or StudySettings(training), training=training, seed=seed, queries=queries
    )
    if not any(body.law is not None for body in loaded.bodies):
        settings = replace(settings, tests=tests)
    folder = out or Path("out") / loaded.name
    result = study_scene(loaded, settings, folder, rivals=chosen, progress=progress)
    if result is None:
        return
    middle = tuple(
        (low + high) / 2
        for low, high in zip(loaded.parameters.lower, loaded.parameters.upper, strict=True)
    )
    result.write(folder, console, view or View(points=(middle,)))
    console.print(
        f"errors of its answers: {result.model.known_error}", highlight=False, markup=False
    )


@click.command(epilog=examples("hhr report out/my_scene"))
@click.argument("folder", type=click.Path(path_type=Path))
@guarded
def report(folder: Path) -> None:
    """Make report.html of the report.json and the pictures in a folder: one file that needs nothing
    else.
    """
    from hhr_dolfinx.plugins.studies.page import write_page

    click.echo(write_page(folder))
