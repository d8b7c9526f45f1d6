"""The command ``hhr answer``: answers of a model to a table of parameters."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

from hhr_dolfinx.command.speaking import resumable, spoken
from hhr_dolfinx.command.words import EXIT_NO_ANSWER, KNOWN_OPTION, PART_OPTION, examples
from hhr_dolfinx.compat import extra
from hhr_dolfinx.group import share

with extra("study", "the command hhr"):
    import click

WRITTEN_TABLES = (".csv", ".parquet")
"""Endings of tables that are written."""


@click.command(
    epilog=examples(
        "hhr answer model.npz questions.csv --out answers.csv",
        "mpirun -n 2 hhr answer model.npz q.parquet",
    )
)
@click.argument("model", type=click.Path(path_type=Path))
@click.argument("table", type=click.Path(path_type=Path))
@click.option(
    "--out", type=click.Path(path_type=Path), help="the answers, .csv or .parquet [answers.csv]"
)
@click.option(
    "--displacement",
    is_flag=True,
    help="a column of the largest displacement, which takes the whole field",
)
@click.option(
    "--estimates/--no-estimates",
    default=True,
    show_default=True,
    help="columns of what is known of errors",
)
@click.option(
    "--forces/--no-forces",
    default=True,
    show_default=True,
    help="a column for each contact condition",
)
@PART_OPTION
@KNOWN_OPTION
@resumable
def answer(
    model: Path,
    table: Path,
    out: Path | None,
    part: tuple[int, int] | None,
    known: tuple[str, ...],
    **columns: bool,
) -> None:
    """Answer a table of parameters, one row each, with outputs and bounds of errors.

    Rows may fail, others go on.

    Answers are kept block by block: a command that was interrupted goes on. Where bodies flow each
    row is one step from rest; paths are for Python, model.march. With --part 3/8 the third of eight
    blocks of rows is answered, into answers.3of8.csv.
    """
    from hhr_dolfinx.command.loading import any_model_of, checked_target
    from hhr_dolfinx.plugins.tables.tables import answer_table, checksum, read_points

    checked_target(out, WRITTEN_TABLES)
    target = out or Path("answers.csv")
    target = (
        target
        if part is None
        else target.with_name(f"{target.stem}.{part[0]}of{part[1]}{target.suffix}")
    )
    if target.exists() and table.exists() and target.samefile(table):
        raise click.UsageError(
            f"{target} holds the questions, which its answers would replace: give another --out"
        )
    console, progress = spoken()
    loaded = any_model_of(model, known)
    rows = read_points(
        table, loaded.parameters, partial(console.print, highlight=False, markup=False)
    )
    rows = rows if part is None else [rows[k] for k in share(len(rows), part[0] - 1, part[1])]
    if loaded.equilibrium is not None:
        console.print(
            "bodies flow: each row is one step from rest, of one second; paths are for Python, "
            "model.march"
        )
    console.print(f"errors of its answers: {loaded.known_error}", highlight=False, markup=False)
    bad = answer_table(
        loaded, rows, target, console, progress("blocks of rows"), **columns, resume=checksum(model)
    )
    sys.exit(EXIT_NO_ANSWER if bad else 0)
