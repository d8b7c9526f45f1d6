"""Commands that evaluate parameters, one of them or a table."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx import ranks
from hhr_dolfinx.command.speaking import first_rank, guarded, spoken
from hhr_dolfinx.command.words import AT, KNOWN, NO_ANSWER, PART, examples
from hhr_dolfinx.compat import extra

if TYPE_CHECKING:
    from hhr_dolfinx.models.answer import Answer
    from hhr_dolfinx.scene import Scene

with extra("study", "the command hhr"):
    import click

FIELDS = (".vtkhdf", ".vtu")
TABLES = (".csv", ".parquet")


def largest_values(
    answer: Answer, dimension: int, scene: Scene | None, pairs: np.ndarray | None, forces: np.ndarray
) -> dict[str, float]:
    """The largest displacement, the sum of the forces of each contact, and the number of active contacts.

    Args:
        answer: of any model.
        dimension: of the mesh.
        scene: the scene if it is known, else None: a model in a file has no units.
        pairs: contact pair of each of the forces, (c,); None if they are unknown: the sum is then that of all.
        forces: of pressures, (c,).
    """
    length = force = ""
    if scene is not None and scene.units is not None:
        length = scene.units.length
        force = scene.units.force_in(scene.hypothesis)
    displacement = answer.displacement().reshape(-1, dimension)
    rows = {_with_unit("largest displacement", length): float(np.linalg.norm(displacement, axis=1).max())}
    several = pairs is not None and np.unique(pairs).size > 1
    if pairs is None or scene is None:
        rows[_with_unit("sum of the forces of all contacts", force)] = float(forces.sum())
    else:
        for number in np.unique(pairs):
            which = f" {number} of {', '.join(map(str, scene.contacts[number].tags))}" if several else ""
            name = f"sum of the forces of contact{which}" if several else "sum of contact forces"
            rows[_with_unit(name, force)] = float(forces[pairs == number].sum())
    return rows | {"active contacts": int((forces > 0).sum())} | answer.memory.counted()


def _with_unit(name: str, unit: str) -> str:
    """A name with its unit."""
    return f"{name} [{unit}]" if unit else name


@click.command(epilog=examples("hhr solve my_scene.py --at load=3", "hhr solve out/my_scene/model.npz --at load=3"))
@click.argument("what")
@AT
@click.option("--duration", type=float, help="for laws of bodies with rates: seconds of the one step from rest [1]")
@click.option("--out", type=click.Path(path_type=Path), help="write fields there, for ParaView (.vtkhdf or .vtu)")
@KNOWN
@guarded
def solve(what: str, words: tuple[str, ...], duration: float | None, out: Path | None, known: tuple[str, ...]) -> None:
    """Answer one parameter, by a SCENE in full or by a reduced model from a file (.npz).

    Where bodies have laws, so that answers depend on the path, the answer is that of one step from rest.
    """
    from hhr_dolfinx.command.loading import checked_target, is_model, model_of, point_of, scene_of

    if out is not None and is_model(what):
        raise click.UsageError("--out needs a mesh, which a model in a file has not: solve the scene")
    checked_target(out, FIELDS)
    model: Any
    if is_model(what):
        model = model_of(what, known)
    else:
        from hhr_dolfinx.full_order.full import FullOrderModel

        model = FullOrderModel(scene_of(what))
    point = point_of(words, model.parameters)
    step = {}
    if model.equilibrium is not None:
        step = {"duration": 1.0 if duration is None else duration}
    elif duration is not None:
        raise click.UsageError("all bodies are elastic: leave out --duration")
    if is_model(what):
        answer = model.solve(point, **step)
    else:
        from hhr_dolfinx.certify.strains import check_small_strains
        from hhr_dolfinx.snapshots.records import SnapshotSet

        with model.strains.paused():
            answer = model.solve(point, **step)
        check_small_strains(model, SnapshotSet.of_answers([answer]))
    rows = {"seconds of one step from rest": step["duration"]} if step else {}
    scene = None if is_model(what) else model.scene
    pairs = None if is_model(what) else model.problem.contact_pairs[model.problem.pressing]
    rows |= largest_values(answer, model.dimension, scene, pairs, model.pressures(answer))
    outputs = answer.outputs() if model.fields.functionals is not None else None
    if outputs is not None:
        heads = {name: f"{name} [{unit}]" if unit else name for name, unit in outputs.units.items()}
        rows |= {heads[name]: value for name, value in outputs.values.items()}
    estimate = answer.estimate() if is_model(what) else None
    if estimate is not None:
        rows |= estimate.shown()
    unique = model.uniqueness(point) if model.law.remembers and not step else ""
    if first_rank():
        for name, value in rows.items():
            click.echo(f"{name}: {value:.6g}")
        if unique:
            click.echo(f"answers with {model.law.name}: {unique}")
    if out is not None:
        from hhr_dolfinx.study.report.fields import write_fields

        write_fields(out, model, answer)


@click.command(
    epilog=examples(
        "hhr answer model.npz questions.csv --out answers.csv", "mpirun -n 2 hhr answer model.npz q.parquet"
    )
)
@click.argument("model", type=click.Path(path_type=Path))
@click.argument("table", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), help="the answers, .csv or .parquet [answers.csv]")
@click.option("--displacement", is_flag=True, help="a column of the largest displacement, which takes the whole field")
@click.option("--estimates/--no-estimates", default=True, show_default=True, help="columns of what is known of errors")
@click.option("--forces/--no-forces", default=True, show_default=True, help="a column for each contact condition")
@PART
@KNOWN
@guarded
def answer(
    model: Path, table: Path, out: Path | None, part: tuple[int, int] | None, known: tuple[str, ...], **columns: bool
) -> None:
    """Answer a table of parameters, one row each, with outputs and bounds of errors. Rows may fail, others go on.

    Answers are kept block by block: a command that was interrupted goes on. Where bodies have laws each row is one step
    from rest; paths are for Python, model.march. With --part 3/8 the third of eight blocks of rows is answered, into
    answers.3of8.csv.
    """
    from hhr_dolfinx.command.loading import checked_target, model_of
    from hhr_dolfinx.online.tables import answer_table, checksum, read_points

    checked_target(out, TABLES)
    target = out or Path("answers.csv")
    target = target if part is None else target.with_name(f"{target.stem}.{part[0]}of{part[1]}{target.suffix}")
    if target.exists() and table.exists() and target.samefile(table):
        raise click.UsageError(f"{target} holds the questions, which its answers would replace: give another --out")
    console, progress = spoken()
    loaded = model_of(model, known)
    rows = read_points(table, loaded.parameters)
    rows = rows if part is None else [rows[k] for k in ranks.share(len(rows), part[0] - 1, part[1])]
    if loaded.equilibrium is not None:
        console.print("bodies have laws: each row is one step from rest, of 1 s; paths are for Python, model.march")
    console.print(f"errors of its answers: {loaded.known_error}", highlight=False, markup=False)
    bad = answer_table(loaded, rows, target, console, progress("answers"), **columns, resume=checksum(model))
    sys.exit(NO_ANSWER if bad else 0)
