"""The command ``hhr march``: the answers along a path of ``PATHS``."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hhr_dolfinx.command.answering import FIELDS, largest_values
from hhr_dolfinx.command.speaking import first_rank, guarded
from hhr_dolfinx.command.words import AT, KNOWN_OPTION, examples
from hhr_dolfinx.compat import extra

if TYPE_CHECKING:
    from hhr_dolfinx.models.answer import Answer
    from hhr_dolfinx.plugins.paths.path_families import PathFamily

with extra("study", "the command hhr"):
    import click

COLUMN_WIDTH = 12
"""Characters of a column of a printed path."""


@click.command(
    epilog=examples(
        "hhr march my_scene.py", "hhr march my_scene.py --at load=450 --out out/steps.csv"
    )
)
@click.argument("scene")
@AT
@click.option(
    "--model",
    type=click.Path(path_type=Path),
    help="answer by this reduced model (.npz), not in full",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="a table (.csv), or fields for ParaView (.vtkhdf or .vtu)",
)
@KNOWN_OPTION
@guarded
def march(
    scene: str, words: tuple[str, ...], model: Path | None, out: Path | None, known: tuple[str, ...]
) -> None:
    """Follow load steps, PATHS in the file of a SCENE, and show the answer at each of them.

    Answers of bodies with laws and of contacts with friction depend on the path. PATHS is a
    hhr.PathFamily, whose box has a path for each of its points: without --at it is the middle of
    that box. hhr start writes PATHS of the steps of a deck.
    """
    from hhr_dolfinx.command.loading import checked_target, model_of, point_of, scene_of
    from hhr_dolfinx.files import replacing
    from hhr_dolfinx.full_order.full import FullOrderModel
    from hhr_dolfinx.registry import tool

    checked_target(out, (".csv", *FIELDS))
    in_fields = out is not None and out.suffix in FIELDS
    if in_fields and model is not None:
        raise click.UsageError(
            "fields need a mesh, which a model in a file has not: leave out --model"
        )
    write_fields = tool("fields", "--out, files of fields,") if in_fields else None
    family = family_of(scene)
    path = family.path(point_of(words, family.own, others=family.own.middle))
    answering: Any = FullOrderModel(scene_of(scene)) if model is None else model_of(model, known)
    rows: list[dict[str, float]] = []

    def show(answer: Answer) -> None:
        rows.append(row_of(answering, answer))
        if first_rank():
            if len(rows) == 1:
                click.echo(
                    f"{path.name}\n{'  '.join(name.rjust(COLUMN_WIDTH) for name in rows[0])}"
                )
            click.echo(
                "  ".join(
                    f"{value:{max(len(name), COLUMN_WIDTH)}.6g}" for name, value in rows[-1].items()
                )
            )

    if model is None:
        history = answering.march(
            path, keep=show
        )  # full answers may take long: each is shown when it is there
    else:
        history = answering.march(path)
        for answer in history.answers:
            show(answer)
    if write_fields is not None:
        collection, *_ = write_fields(out, answering, history)
        click.echo(f"fields: {collection}")
    elif out is not None and first_rank():
        with replacing(out, text=True) as file:
            csv.writer(file).writerows([list(rows[0]), *(row.values() for row in rows)])
        click.echo(f"table: {out}")


def family_of(scene: str) -> PathFamily:
    """``PATHS`` of the file of a scene.

    Args:
        scene: the file.

    Raises:
        SceneError: if there is no such family, or if it is something else.
    """
    from hhr_dolfinx.command.loading import beside, value_of
    from hhr_dolfinx.errors import SceneError
    from hhr_dolfinx.plugins.paths.path_families import PathFamily

    family = value_of(beside(scene, "PATHS"), scene, "PATHS", PathFamily)
    if family is None:
        raise SceneError(
            f"{scene} has no PATHS: put PATHS = hhr.PathFamily(...) in its file, or call hhr solve"
        )
    return family


def row_of(model: Any, answer: Answer) -> dict[str, float]:
    """Time, parameters, largest values and outputs of a step.

    Args:
        model: the model.
        answer: its answer to the step.
    """
    row = {
        "time [s]": answer.time,
        **dict(zip(model.parameters.names, answer.parameter.tolist(), strict=True)),
    }
    scene = getattr(model, "scene", None)  # a model in a file has none
    problem = None if scene is None else model.problem
    row |= largest_values(answer, model.dimension, scene, problem, model.pressures(answer))
    return row | (answer.outputs().values if model.fields.functionals is not None else {})
