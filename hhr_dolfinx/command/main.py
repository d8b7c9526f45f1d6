"""The commands of ``hhr``.

Exit codes: 0 all is well; 1 something has no answer, or a check found mistakes; 2 wrong words; 3 a scene, a model or a
file is refused; 130 interrupted.
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx import ranks
from hhr_dolfinx.command.speaking import Command, first_rank, guarded, spoken
from hhr_dolfinx.compat import extra

if TYPE_CHECKING:
    from hhr_dolfinx.models.answer import Answer
    from hhr_dolfinx.scene import Scene


def largest_values(
    answer: Answer, dimension: int, scene: Scene | None, pairs: np.ndarray | None, forces: np.ndarray
) -> dict[str, float]:
    """The largest displacement, the sum of the forces of each contact, and how many conditions touch.

    Args:
        answer: of any model.
        dimension: of the mesh.
        scene: where it is there, else None: a model in a file does not say its units.
        pairs: contact pair of each of the forces, (c,); None where that is not known: the sum is then that of all.
        forces: of pressures, (c,).
    """
    units = None if scene is None else scene.units
    per_depth = scene is not None and scene.hypothesis.startswith("plane")
    length, force = ("", "") if units is None else (units.length, units.force + f"/{units.length}" * per_depth)
    displacement = answer.displacement().reshape(-1, dimension)
    slips = {}
    if answer.slip is not None:
        statuses = answer.slip.statuses
        slips = {"contacts that stick": int((statuses == 1).sum()), "contacts that slip": int((statuses == 2).sum())}
    rows = {_with_unit("largest displacement", length): float(np.linalg.norm(displacement, axis=1).max())}
    several = pairs is not None and np.unique(pairs).size > 1
    if pairs is None or scene is None:
        rows[_with_unit("sum of the forces of all contacts", force)] = float(forces.sum())
    else:
        for number in np.unique(pairs):
            which = f" {number} of {', '.join(map(str, scene.contacts[number].tags))}" if several else ""
            name = f"sum of the forces of contact{which}" if several else "sum of contact forces"
            rows[_with_unit(name, force)] = float(forces[pairs == number].sum())
    return rows | {"conditions that touch": int((forces > 0).sum())} | slips


def _with_unit(name: str, unit: str) -> str:
    """A name with its unit."""
    return f"{name} [{unit}]" if unit else name


with extra("study", "the command hhr"):
    import click

NO_ANSWER = 1
FIELDS = (".vtkhdf", ".vtu")
TABLES = (".csv", ".parquet")
DECKS = (".inp",)
EMBEDDED = (".h", ".fmu")
PAGES = (".html",)
PICTURES = (".png", ".pdf", ".svg")


def _examples(*lines: str) -> str:
    return "\b\n" + "\n".join(f"  {line}" for line in ("Examples:", *lines))


SCENE = click.argument("scene")
OUT = click.option("--out", type=click.Path(path_type=Path), help="folder of the results [out/<scene>]")
AT = click.option("--at", "words", multiple=True, help="value of a parameter, name=value; once for each")
KINDS = {"hhr": "build", "condensed": "condense", "local": "local"}
"""Kinds of models that a training makes, and how."""
TRAINING = (
    click.option("--grid", help="train on a regular grid: counts along the parameters, as 16,16"),
    click.option("--sobol", type=click.IntRange(2), help="train on so many Sobol points"),
    click.option("--greedy", type=float, help="train where a model is worst, up to this error of the forces"),
    click.option("--budget", type=click.IntRange(2), help="most answers of a greedy training"),
)


class _Part(click.ParamType):
    """``3/8``, the third of eight."""

    name = "i/n"

    def convert(self, value: Any, param: Any, ctx: Any) -> tuple[int, int]:
        """Both numbers."""
        words = str(value).split("/")
        if len(words) != 2 or not all(word.isdecimal() for word in words) or not 1 <= int(words[0]) <= int(words[1]):
            self.fail(f"{value!r} is no part: write 3/8, the third of eight", param, ctx)
        return int(words[0]), int(words[1])


PART = click.option("--part", type=_Part(), help="one part of it alone, as 3/8: a job of an array")


def _with(options: Any) -> Callable[[Command], Command]:
    """Several options at once."""

    def decorate(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--verbose", is_flag=True, help="say what goes on, stage by stage")
@click.version_option(package_name="hhr_dolfinx")
def hhr(verbose: bool) -> None:
    """Contact problems for many parameters: reduced models that know their error.

    A SCENE is a Python file in which `scene` is one, or a function that returns one (file.py), or something else in it
    (file.py:name).
    """
    logging.basicConfig(level=logging.INFO if verbose else logging.WARNING, format="%(message)s")


@hhr.command(epilog=_examples("hhr check my_scene.py", "hhr check my_scene.py --at load=3 --picture scene.png"))
@SCENE
@AT
@click.option("--picture", type=click.Path(path_type=Path), help="where to draw it [<scene>_check.png]")
@click.option("--mesh-error", is_flag=True, help="solve once in full, and estimate how far the mesh is off")
@guarded
def check(scene: str, words: tuple[str, ...], picture: Path | None, mesh_error: bool) -> None:
    """Look at a scene without solving it: tags, supports, surfaces, gaps, loads, parameters; with a picture.

    With --mesh-error it is solved once, in full, and the error of the mesh is estimated.
    """
    from hhr_dolfinx.command.loading import checked_target, point_of, scene_of
    from hhr_dolfinx.study.scene.check import check_scene

    checked_target(picture, PICTURES)
    console, _ = spoken()
    made = scene_of(scene)
    picture = picture or Path(f"{made.name}_check.png")
    checked_target(picture, PICTURES)
    point = point_of(words, made.parameters, others=made.parameters.middle) if words else None
    found = check_scene(made, point)
    if mesh_error and not found.mistakes:
        from hhr_dolfinx.study.scene.mesh import look_at_mesh_error

        look_at_mesh_error(found, point)
    for finding in found.findings:
        console.print(f"{finding.level:8} {finding.text}", highlight=False)
    if found.drawable:
        found.draw(picture)
        console.print(f"picture: {picture}")
    sys.exit(NO_ANSWER if found.mistakes else 0)


@hhr.command(epilog=_examples("hhr train my_scene.py --sobol 64", "mpirun -n 4 hhr train my_scene.py --greedy 0.01"))
@SCENE
@_with(TRAINING)
@click.option("--model", "kind", type=click.Choice(list(KINDS)), default="hhr", show_default=True, help="what to build")
@click.option(
    "--together/--side-by-side",
    default=None,
    help="ranks have one full model together, or one each [by the memory that there is]",
)
@PART
@OUT
@guarded
def train(
    scene: str, out: Path | None, kind: str, together: bool | None, part: tuple[int, int] | None, **how: Any
) -> None:
    """Solve the scene for training parameters, build a model, check it, and save it.

    hhr is the hyper-reduced model, model.npz; condensed keeps all contact conditions, condensed.npz; local is a set of
    hyper-reduced models, each for a part of the box, local.npz. Answers are kept in the folder as they are found: a
    command that was interrupted goes on. With --part 3/8 the third of eight parts is solved and kept, and nothing
    built: a job of an array; the same command without it then builds.
    """
    from mpi4py import MPI

    from hhr_dolfinx.command.loading import scene_of
    from hhr_dolfinx.online.model_file import save_model
    from hhr_dolfinx.pages.scenery import NAME
    from hhr_dolfinx.study.scene.scenery import scenery_of
    from hhr_dolfinx.study.training.train import train as trained

    console, progress = spoken()
    if part is not None and together:
        raise click.UsageError("parts of a training are solved side by side: leave --together out")
    with ranks.each_for_itself(MPI.COMM_WORLD, f"reading {scene}"):
        made = scene_of(scene)
    folder = out or Path("out") / made.name
    if part is None and kind == "condensed" and any(law is not None for law in made.friction):
        # contact with friction is condensed without a training
        from hhr_dolfinx.full_order.full import FullOrderModel
        from hhr_dolfinx.study.condensing import condense

        # each rank for itself: where one has nothing to do PETSc waits for it at the end
        full = FullOrderModel(made, MPI.COMM_SELF)
        model = condense(full, fields=True)
    else:
        settings = _settings_of(scene)
        held_out = None if settings is None else settings.held_out
        asked = _training_of(how, settings)
        if part is not None:
            _solve_part(console, made, asked, part, folder / "snapshots", held_out=held_out, progress=progress)
            return
        training = trained(
            made, asked, held_out=held_out, folder=folder / "snapshots", progress=progress, together=together
        )
        full = training.full_order
        if MPI.COMM_WORLD.rank and full.comm.size == 1:
            return
        for item in training.log.skipped:
            if item["stage"] in ("snapshots", "problems side by side"):  # what was there already, and how ranks share
                console.print(item["why"], highlight=False)
        model = getattr(training, KINDS[kind])()
    scenery = scenery_of(full)
    if MPI.COMM_WORLD.rank:  # which has built with the others
        return
    target = folder / f"{'model' if kind == 'hhr' else kind}.npz"
    target.parent.mkdir(parents=True, exist_ok=True)
    save_model(target, model)
    scenery.write(target.parent / NAME)
    problem = full.problem
    console.print(f"{made.name}: {problem.free.size} dofs and {len(problem.gaps)} contacts -> {_described(model)}")
    console.print(f"errors of its answers: {model.known_error}", highlight=False, markup=False)
    console.print(f"model: {target}")


class _Share(click.ParamType):
    """``1%`` or ``0.01``."""

    name = "share"

    def convert(self, value: Any, param: Any, ctx: Any) -> float:
        """The number."""
        text = str(value).strip()
        try:
            number = float(text.removesuffix("%"))
        except ValueError:
            self.fail(f"{value!r} is no error: write 1% or 0.01", param, ctx)
        return number / 100 if text.endswith("%") else number


@hhr.command(
    epilog=_examples(
        "hhr reduce my_scene.py --error 1% --of pressure", "hhr reduce my_scene.py --of forces --seconds 600"
    )
)
@SCENE
@click.option("--error", type=_Share(), default="1%", show_default=True, help="largest relative error of an answer")
@click.option("--of", multiple=True, help="of pressure, forces, displacement or an output; once for each [pressure]")
@click.option("--seconds", type=float, help="most that it may take")
@click.option("--answers", type=click.IntRange(1), help="most answers of the full model")
@click.option("--megabytes", type=float, help="largest model in a file")
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="of random points")
@OUT
@guarded
def reduce(scene: str, out: Path | None, error: float, of: tuple[str, ...], seed: int, **limits: Any) -> None:
    """Find a model of the scene that is as exact as wished, and save it: condensed, hyper-reduced, or local ones.

    Each kind is tried as far as it takes, checked and timed; a table says so, and reduction.json. Where bodies flow the
    file of the scene holds PATHS, a hhr.PathFamily. Full answers are kept: a command that was interrupted goes on.
    """
    from hhr_dolfinx.command.loading import beside, scene_of
    from hhr_dolfinx.study.one_call.search import reduce as reduced
    from hhr_dolfinx.study.one_call.wish import Budget

    console, progress = spoken()
    made = scene_of(scene)
    folder = out or Path("out") / made.name
    size = limits["megabytes"]
    budget = Budget(limits["seconds"], limits["answers"], None if size is None else 1e6 * size)
    wish: Any = {"error": error, "of": of or "pressure", "budget": budget, "paths": beside(scene, "PATHS")}
    model = reduced(made, **wish, folder=folder, seed=seed, progress=progress)
    console.print(str(model.reduction), highlight=False, markup=False)
    console.print(f"errors of its answers: {model.known_error}", highlight=False, markup=False)
    console.print(f"model: {folder / 'model.npz'}")
    sys.exit(0 if model.reduction.met else NO_ANSWER)


def _solve_part(console: Any, scene: Scene, training: Any, part: tuple[int, int], folder: Path, **how: Any) -> None:
    """Solve one part of a training, and say what is there now."""
    from hhr_dolfinx.study.training.parts import train_part

    found = train_part(scene, training, *part, folder, **how)
    if first_rank():
        console.print(
            f"part {part[0]} of {part[1]}: {found.training} training queries and {found.held_out} held out are in "
            f"{folder}, {found.read} answers were there before. The same command without --part then builds a model",
            highlight=False,
        )


def _described(model: Any) -> str:
    """The size of a model, in words."""
    if hasattr(model, "models"):
        sizes = [len(one.problem.stiffness) for one in model.models]
        return f"{len(model)} models of {min(sizes)} to {max(sizes)} modes"
    if hasattr(model.fields, "A_lambda"):
        cells = "" if model.offline is None else f" on {len(model.offline.sets.cells)} cells"
        return f"{len(model.problem.stiffness)} modes and {len(model.fields.A_lambda)} contacts{cells}"
    return f"{model.conditions} contacts, all of them kept"


def _settings_of(scene: str) -> Any:
    """The ``SETTINGS`` beside a scene, or None.

    Raises:
        SceneError: for invalid input.
    """
    from hhr_dolfinx.command.loading import beside
    from hhr_dolfinx.errors import SceneError
    from hhr_dolfinx.study.study import StudySettings

    settings = beside(scene, "SETTINGS")
    if settings is not None and not isinstance(settings, StudySettings):
        raise SceneError(f"SETTINGS beside {scene} must be hhr.StudySettings, and is {type(settings).__name__}")
    return settings


def _training_of(how: dict[str, Any], settings: Any) -> Any:
    """How to train: as asked for, or as the scene's file says, or on 64 Sobol points."""
    from hhr_dolfinx.sampling import Sobol

    given = [name for name in ("grid", "sobol", "greedy") if how[name] is not None]
    if len(given) > 1 or (how["budget"] is not None and given != ["greedy"]):
        raise click.UsageError("give one of --grid, --sobol and --greedy; --budget belongs to --greedy")
    if given == ["grid"]:
        try:
            return [int(word) for word in how["grid"].split(",")]
        except ValueError:
            raise click.UsageError(f"--grid {how['grid']} must be counts, as 16,16") from None
    if given == ["greedy"]:
        from hhr_dolfinx.study.training.greedy import Greedy

        return Greedy(tolerance=how["greedy"], budget=how["budget"] or 200)
    if given == ["sobol"]:
        return Sobol(how["sobol"])
    return Sobol(64) if settings is None else settings.training


@hhr.command(epilog=_examples("hhr solve my_scene.py --at load=3", "hhr solve out/my_scene/model.npz --at load=3"))
@click.argument("what")
@AT
@click.option("--duration", type=float, help="where bodies flow: seconds of the one step from rest [1]")
@click.option("--out", type=click.Path(path_type=Path), help="write fields there, for ParaView (.vtkhdf or .vtu)")
@guarded
def solve(what: str, words: tuple[str, ...], duration: float | None, out: Path | None) -> None:
    """Answer one parameter, by a SCENE in full or by a reduced model from a file (.npz).

    Where bodies flow, which depends on the path, the answer is that of one step from rest.
    """
    from hhr_dolfinx.command.loading import checked_target, is_model, point_of, scene_of

    if out is not None and is_model(what):
        raise click.UsageError("--out needs a mesh, which a model in a file has not: solve the scene")
    checked_target(out, FIELDS)
    model: Any
    if is_model(what):
        from hhr_dolfinx.online.model_file import load_model

        model = load_model(what)
    else:
        from hhr_dolfinx.full_order.full import FullOrderModel

        model = FullOrderModel(scene_of(what))
    point = point_of(words, model.parameters)
    step = {}
    if model.flows:
        step = {"duration": 1.0 if duration is None else duration}
    elif duration is not None:
        raise click.UsageError("nothing flows: leave out --duration")
    answer = model.solve(point, **step)
    if not is_model(what):
        from hhr_dolfinx.certify.strains import check_small_strains
        from hhr_dolfinx.snapshots.records import SnapshotSet

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
    if first_rank():
        for name, value in rows.items():
            click.echo(f"{name}: {value:.6g}")
    if out is not None:
        from hhr_dolfinx.study.report.fields import write_fields

        write_fields(out, model, answer)


@hhr.command(epilog=_examples("hhr study my_scene.py --grid 16,16 --tests 200", "hhr report out/my_scene"))
@SCENE
@_with(TRAINING)
@click.option("--tests", type=click.IntRange(1), default=200, show_default=True, help="random test points")
@click.option("--queries", type=click.IntRange(6), default=200, show_default=True, help="timed queries of each method")
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="of random points")
@OUT
@guarded
def study(scene: str, out: Path | None, tests: int, queries: int, seed: int, **how: Any) -> None:
    """Train, then measure errors and times beside the full order and condensation; report, pictures and model."""
    from dataclasses import replace

    from hhr_dolfinx.command.loading import beside, scene_of
    from hhr_dolfinx.study.report.view import View
    from hhr_dolfinx.study.study import StudySettings, study_scene

    console, progress = spoken()
    made = scene_of(scene)
    settings = _settings_of(scene)
    given = _training_of(how, settings)
    settings = replace(settings or StudySettings(given), training=given, seed=seed, queries=queries)
    if not any(body.law is not None for body in made.bodies):
        settings = replace(settings, tests=tests)
    folder = out or Path("out") / made.name
    found = study_scene(made, settings, folder, progress=progress)
    if found is None:
        return
    middle = tuple((low + high) / 2 for low, high in zip(made.parameters.lower, made.parameters.upper, strict=True))
    found.write(folder, console, beside(scene, "VIEW") or View(points=(middle,)))
    console.print(f"errors of its answers: {found.model.known_error}", highlight=False, markup=False)


@hhr.command(
    epilog=_examples(
        "hhr answer model.npz questions.csv --out answers.csv", "mpirun -n 2 hhr answer model.npz q.parquet"
    )
)
@click.argument("model", type=click.Path(path_type=Path))
@click.argument("table", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), help="the answers, .csv or .parquet [answers.csv]")
@click.option("--displacement", is_flag=True, help="a column of the largest displacement, which takes the whole field")
@click.option("--estimates/--no-estimates", default=True, show_default=True, help="columns of what is known of errors")
@PART
@guarded
def answer(
    model: Path, table: Path, out: Path | None, displacement: bool, estimates: bool, part: tuple[int, int] | None
) -> None:
    """Answer a table of parameters, one row each, with outputs and bounds of errors. Rows may fail, others go on.

    Answers are kept block by block: a command that was interrupted goes on. Where bodies flow each row is one step from
    rest; paths are for Python, model.march. With --part 3/8 the third of eight blocks of rows is answered, into
    answers.3of8.csv.
    """
    from hhr_dolfinx.command.loading import checked_target
    from hhr_dolfinx.online.model_file import load_model
    from hhr_dolfinx.online.tables import answer_table, checksum, read_points

    checked_target(out, TABLES)
    target = out or Path("answers.csv")
    target = target if part is None else target.with_name(f"{target.stem}.{part[0]}of{part[1]}{target.suffix}")
    if target.exists() and table.exists() and target.samefile(table):
        raise click.UsageError(f"{target} holds the questions, which its answers would replace: give another --out")
    console, progress = spoken()
    loaded: Any = load_model(model)
    rows = read_points(table, loaded.parameters)
    rows = rows if part is None else [rows[k] for k in ranks.share(len(rows), part[0] - 1, part[1])]
    if loaded.flows:
        console.print("bodies flow: each row is one step from rest, of one second; paths are for Python, model.march")
    console.print(f"errors of its answers: {loaded.known_error}", highlight=False, markup=False)
    how: dict[str, Any] = {"displacement": displacement, "estimates": estimates, "resume": checksum(model)}
    bad = answer_table(loaded, rows, target, console, progress("answers"), **how)
    sys.exit(NO_ANSWER if bad else 0)


@hhr.command(epilog=_examples("hhr page out/my_scene/condensed.npz", "hhr page model.npz --scene my_scene.py"))
@click.argument("model", type=click.Path(path_type=Path))
@click.option("--scene", help="what the model was made of, where no scenery.npz lies beside it")
@click.option("--out", type=click.Path(path_type=Path), help="the page [<model>.html]")
@guarded
def page(model: Path, scene: str | None, out: Path | None) -> None:
    """Write one HTML page that answers as a condensed model does, in any browser, without Python and without a network.

    Contact pressures and their error, outputs and their derivatives, displacement of the mesh: sliders for all
    parameters. What it draws comes from scenery.npz, which train and reduce leave beside the model.
    """
    from hhr_dolfinx.command.loading import checked_target
    from hhr_dolfinx.online.model_file import load_model
    from hhr_dolfinx.pages.arrays import check_model
    from hhr_dolfinx.pages.page import write_model_page

    checked_target(out, PAGES)
    loaded = load_model(model)
    target = out or model.with_suffix(".html")
    checked_target(target, PAGES)
    with _naming_condensed(model):
        check_model(loaded)  # before a scene is asked for
        click.echo(write_model_page(target, loaded, _scenery_of(model, scene)))


@hhr.command(epilog=_examples("hhr embed model.npz --out press.h", "hhr embed model.npz --out press.fmu"))
@click.argument("model", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), required=True, help="the header, .h, or the unit, .fmu")
@guarded
def embed(model: Path, out: Path) -> None:
    """Write a condensed model as a header of C, or as a unit for co-simulation (FMI 3.0).

    The header holds the numbers of the model and solves the contact problem, without a library. Parameters are inputs
    of a unit, outputs of the scene its outputs; it is compiled here, for this machine, and holds its sources. With
    friction in the plane a step is an increment from where the unit is.
    """
    from hhr_dolfinx.command.loading import checked_target
    from hhr_dolfinx.online.model_file import load_model

    checked_target(out, EMBEDDED)
    loaded = load_model(model)
    if out.suffix == ".h":
        from hhr_dolfinx.doors.c_header import write_c_header as write
    else:
        from hhr_dolfinx.doors.fmu import write_fmu as write
    with _naming_condensed(model):
        click.echo(write(out, loaded))


@hhr.command(epilog=_examples("hhr dakota model.npz params.in results.out"))
@click.argument("model", type=click.Path(path_type=Path))
@click.argument("parameters", type=click.Path(path_type=Path))
@click.argument("results", type=click.Path(path_type=Path))
@guarded
def dakota(model: Path, parameters: Path, results: Path) -> None:
    """Answer one evaluation of Dakota: analysis_drivers = 'hhr dakota model.npz' of its fork interface.

    Its variables are parameters, its functions outputs of the scene, by their names; analytic gradients are exact.
    """
    from hhr_dolfinx.doors.dakota import answer_dakota
    from hhr_dolfinx.online.model_file import load_model

    answer_dakota(load_model(model), parameters, results)


@contextmanager
def _naming_condensed(model: Path) -> Iterator[None]:
    """Of a model that is refused, say where a condensed one lies."""
    from hhr_dolfinx.errors import NotOfferedError

    other = model.with_name("condensed.npz")
    try:
        yield
    except NotOfferedError as error:
        if model.name == other.name or not other.exists():
            raise
        raise NotOfferedError(f"{error}. A condensed model lies beside it: {other}") from error


def _scenery_of(model: Path, scene: str | None) -> Any:
    """What lies beside a model, or is made of its scene.

    Raises:
        FileError: where there is neither.
    """
    from hhr_dolfinx.errors import FileError
    from hhr_dolfinx.pages.scenery import NAME, Scenery

    if scene is not None:
        from mpi4py import MPI

        from hhr_dolfinx.command.loading import scene_of
        from hhr_dolfinx.full_order.full import FullOrderModel
        from hhr_dolfinx.study.scene.scenery import scenery_of

        return scenery_of(FullOrderModel(scene_of(scene), MPI.COMM_SELF))
    try:
        return Scenery.read(model.with_name(NAME))
    except FileNotFoundError:
        raise FileError(
            f"there is no {NAME} beside {model}, and a model in a file knows no mesh: name its scene, --scene FILE.py"
        ) from None


@hhr.command(epilog=_examples("hhr report out/my_scene"))
@click.argument("folder", type=click.Path(path_type=Path))
@guarded
def report(folder: Path) -> None:
    """Make report.html of the report.json and the pictures in a folder: one file that needs nothing else."""
    from hhr_dolfinx.study.report.page import write_page

    click.echo(write_page(folder))


@hhr.command(epilog=_examples("hhr export my_scene.py --at load=3 --out my_scene.inp"))
@SCENE
@AT
@click.option("--out", type=click.Path(path_type=Path), required=True, help="the deck, .inp")
@guarded
def export(scene: str, words: tuple[str, ...], out: Path) -> None:
    """Write the problem of one parameter as a deck for CalculiX or Abaqus, to check it there."""
    from mpi4py import MPI

    from hhr_dolfinx.command.loading import checked_target, point_of, scene_of
    from hhr_dolfinx.full_order.deck import write_deck
    from hhr_dolfinx.full_order.discretisation import Discretisation

    checked_target(out, DECKS)
    made = scene_of(scene)
    write_deck(out, Discretisation(made, MPI.COMM_SELF), point_of(words, made.parameters))
    click.echo(out)


@hhr.command("list", epilog=_examples("hhr list", "hhr list pairings"))
@click.argument("kind", required=False)
@guarded
def list_(kind: str | None) -> None:
    """Show what scenes may name: geometries, pairings, laws, loads, outputs, samplings, materials, other packages."""
    from hhr_dolfinx.materials.elasticity import MATERIALS
    from hhr_dolfinx.plugins import OWN, names

    kinds = [*OWN, "materials"]
    if kind is not None and kind not in kinds:
        raise click.UsageError(f"there are no {kind}: kinds are {', '.join(kinds)}")
    for one in [kind] if kind else kinds:
        click.echo(f"{one}:")
        if one == "materials":
            for name, found in MATERIALS.items():
                click.echo(f"  {name}: E = {found.young / 1e9:g} GPa, nu = {found.poisson:g} ({found.source})")
        else:
            for name, source in sorted(names(one).items()):
                click.echo(f"  {name} ({source})")


def main() -> None:
    """What the installed command runs."""
    # a reader that has seen enough, `hhr list | head`, is no crash, which PETSc would make of it
    os.environ["PETSC_OPTIONS"] = f"{os.environ.get('PETSC_OPTIONS', '')} -no_signal_handler"
    hhr(prog_name="hhr")


if __name__ == "__main__":
    main()
