"""The command reduce."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from hhr_dolfinx.command.speaking import resumable, spoken
from hhr_dolfinx.command.words import EXIT_NO_ANSWER, FIELDS, OUT, SCENE, examples
from hhr_dolfinx.compat import extra

with extra("study", "the command hhr"):
    import click


class ShareArgument(click.ParamType):
    """``1%`` or ``0.01``."""

    name = "share"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """A share of 1, from a number or a percentage.

        Args:
            value: the text, such as 1% or 0.01.
            param: the option, for the message.
            ctx: the command, for the message.
        """
        text = str(value).strip()
        try:
            number = float(text.removesuffix("%"))
        except ValueError:
            self.fail(f"{value!r} is no error: write 1% or 0.01", param, ctx)
        return number / 100 if text.endswith("%") else number


@click.command(
    epilog=examples(
        "hhr reduce my_scene.py --error 1% --of pressure",
        "hhr reduce my_scene.py --of forces --seconds 600",
    )
)
@SCENE
@click.option(
    "--error",
    type=ShareArgument(),
    default="1%",
    show_default=True,
    help="largest relative error of an answer",
)
@click.option(
    "--of",
    multiple=True,
    help="of pressure, forces, displacement or an output; once for each [pressure]",
)
@click.option("--seconds", type=float, help="most that it may take")
@click.option("--answers", type=click.IntRange(1), help="most answers of the full model")
@click.option("--megabytes", type=float, help="largest model in a file")
@FIELDS
@click.option(
    "--seed", type=click.IntRange(0), default=1, show_default=True, help="of random points"
)
@OUT
@resumable
def reduce(
    scene: str,
    out: Path | None,
    error: float,
    of: tuple[str, ...],
    seed: int,
    fields: str,
    **limits: Any,
) -> None:
    """Build the cheapest model with the requested accuracy, and save it: condensed, hyper-reduced,
    or local ones.

    Each kind is tried as far as it takes, checked and timed; a table says so, and reduction.json.
    Where bodies flow the file of the scene holds PATHS, a hhr.PathFamily. Full answers are kept: a
    command that was interrupted goes on.
    """
    from hhr_dolfinx.command.loading import beside, scene_of
    from hhr_dolfinx.errors import StudyError
    from hhr_dolfinx.plugins.one_call.progress import shares_on
    from hhr_dolfinx.plugins.one_call.search import RECORD_FILE
    from hhr_dolfinx.plugins.one_call.search import reduce as reduced
    from hhr_dolfinx.plugins.one_call.target import Budget

    console, _ = spoken()
    progress = shares_on(console)
    built_scene = scene_of(scene)
    folder = out or Path("out") / built_scene.name
    size = limits["megabytes"]
    budget = Budget(limits["seconds"], limits["answers"], None if size is None else 1e6 * size)
    request: Any = {
        "error": error,
        "of": of or "pressure",
        "budget": budget,
        "paths": beside(scene, "PATHS"),
        "fields": {"all": True, "none": False}.get(fields, fields),
    }
    try:
        model = reduced(built_scene, **request, folder=folder, seed=seed, progress=progress)
    except StudyError as error:
        if tried := vars(error).get("reduction"):  # its reasons are those of the error
            console.print(tried.table, highlight=False, markup=False)
            console.print(f"what was tried: {folder / RECORD_FILE}", highlight=False)
        raise
    console.print(str(model.reduction), highlight=False, markup=False)
    console.print(f"errors of its answers: {model.known_error}", highlight=False, markup=False)
    console.print(f"model: {folder / 'model.npz'}")
    sys.exit(0 if model.reduction.met else EXIT_NO_ANSWER)
