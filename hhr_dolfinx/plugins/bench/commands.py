"""Commands of the data set of contact problems: bench score."""

from __future__ import annotations

import json
from math import isfinite
from pathlib import Path

from hhr_dolfinx.command.console import Table
from hhr_dolfinx.command.loading import checked_target
from hhr_dolfinx.command.speaking import guarded, spoken
from hhr_dolfinx.command.words import examples
from hhr_dolfinx.compat import extra

with extra("study", "the command hhr"):
    import click


@click.group(epilog=examples("hhr bench score mine.npz --answers hidden"))
def bench() -> None:
    """Score answers on the data set of contact problems."""


@bench.command(
    epilog=examples(
        "hhr bench score mine.npz --answers hidden",
        "hhr bench score mine.npz --answers hidden --out score.json",
    )
)
@click.argument("submission", type=click.Path(path_type=Path))
@click.option(
    "--answers",
    type=click.Path(path_type=Path),
    required=True,
    help="folder of the hidden answers at the test points",
)
@click.option("--out", type=click.Path(path_type=Path), help="write the scores, .json")
@guarded
def score(submission: Path, answers: Path, out: Path | None) -> None:
    """Score a SUBMISSION, an .npz with forces at the test points."""
    from hhr_dolfinx.plugins.bench.score import score_submission

    checked_target(out, (".json",))
    scores = score_submission(submission, answers)
    console, _ = spoken()
    names = list(dict.fromkeys(name for row in scores.values() for name in row))
    table = Table("scene", *(name.replace("_", " ") for name in names))
    for scene, row in scores.items():
        table.add_row(scene, *(f"{row[name]:.3g}" if name in row else "" for name in names))
    console.print(table)
    if out is not None:
        finite = {  # JSON has no infinity, the error without an answer
            scene: {name: value if isfinite(value) else None for name, value in row.items()}
            for scene, row in scores.items()
        }
        out.write_text(json.dumps(finite, indent=1) + "\n", encoding="utf-8")
