"""The command ``hhr train``: a model of a scene."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, Unpack

from hhr_dolfinx import registry
from hhr_dolfinx.command.speaking import P, T, first_rank, resumable, spoken
from hhr_dolfinx.command.words import FIELDS, OUT, PART_OPTION, SCENE, examples
from hhr_dolfinx.compat import extra
from hhr_dolfinx.group import group_of

if TYPE_CHECKING:
    from rich.console import Console

    from hhr_dolfinx.full_order.full import FullOrderModel
    from hhr_dolfinx.models.model import KeptModel
    from hhr_dolfinx.scene import Scene
    from hhr_dolfinx.study.training.train import HeldOut, Progress, Training, TrainingLike

with extra("study", "the command hhr"):
    import click


class TrainOptions(TypedDict):
    """Further arguments of a training, see :func:`~hhr_dolfinx.study.training.train.train`."""

    held_out: HeldOut
    progress: Progress


MODEL_KINDS = {
    "hhr": "build",
    "condensed": "condense",
    **{name: name for name in registry.named("kinds")},
}
"""Kinds of models made by a training, and their functions."""
TRAINING_OPTIONS = (
    click.option("--grid", help="train on a regular grid: counts along the parameters, as 16,16"),
    click.option("--sobol", type=click.IntRange(2), help="train on so many Sobol points"),
    *(option for way in registry.loadable("trainings").values() for option in way.options),
)
"""Options of all commands that train a model."""


def with_training(command: Callable[P, T]) -> Callable[P, T]:
    """Add the options of a training to a command."""
    for option in reversed(TRAINING_OPTIONS):
        command = option(command)
    return command


@click.command(
    epilog=examples(
        "hhr train my_scene.py --sobol 64", "mpirun -n 4 hhr train my_scene.py --greedy 0.01"
    )
)
@SCENE
@with_training
@click.option(
    "--model",
    "kind",
    type=click.Choice(list(MODEL_KINDS)),
    default="hhr",
    show_default=True,
    help="what to build",
)
@click.option(
    "--together/--side-by-side",
    default=None,
    help="ranks have one full model together, or one each [by the memory that there is]",
)
@FIELDS
@PART_OPTION
@OUT
@resumable
def train(
    scene: str,
    out: Path | None,
    kind: str,
    together: bool | None,
    part: tuple[int, int] | None,
    fields: str,
    **how: Any,
) -> None:
    """Solve the scene for training parameters, build a model, check it, and save it.

    hhr is the hyper-reduced model, hhr.npz; condensed keeps all contact conditions, condensed.npz;
    local is a set of hyper-reduced models, each for a part of the box, local.npz. Answers are kept
    in the folder as they are found: a command that was interrupted goes on. With --part 3/8 the
    third of eight parts is solved and kept, and nothing built: a job of an array; the same command
    without it then builds.
    """
    from mpi4py import MPI

    from hhr_dolfinx.command.loading import scene_of
    from hhr_dolfinx.models.model import with_fields
    from hhr_dolfinx.online.model_file import save_model
    from hhr_dolfinx.registry import write_companions
    from hhr_dolfinx.study.training.train import train as trained

    console, progress = spoken()
    if part is not None and together:
        raise click.UsageError("parts of a training are solved side by side: leave --together out")
    with group_of(MPI.COMM_WORLD).each(f"reading {scene}"):
        loaded = scene_of(scene)
    folder = out or Path("out") / loaded.name
    if part is None and kind == "condensed" and loaded.remembers:
        full, model = _condensed(loaded)
    else:
        settings = settings_of(scene)
        sampling = training_of(how, settings)
        options: TrainOptions = {
            "held_out": None if settings is None else settings.held_out,
            "progress": progress,
        }
        if part is not None:
            _solve_part(console, loaded, sampling, part, folder / "snapshots", **options)
            return
        training = trained(
            loaded, sampling, folder=folder / "snapshots", together=together, **options
        )
        full = training.full_order
        if MPI.COMM_WORLD.rank and full.comm.size == 1:
            return
        _say_what_is_reused(console, training)
        model = getattr(training, MODEL_KINDS[kind])()
    target = folder / f"{kind}.npz"
    target.parent.mkdir(parents=True, exist_ok=True)
    write_companions(full, folder)
    if MPI.COMM_WORLD.rank:  # it took part in the build
        return
    save_model(target, with_fields(model, fields))
    problem = full.problem
    console.print(
        f"{loaded.name}: {problem.free.size} dofs and {len(problem.gaps)} contacts -> {model!r}"
    )
    console.print(f"errors of its answers: {model.known_error}", highlight=False, markup=False)
    console.print(f"model: {target}")


def _condensed(scene: Scene) -> tuple[FullOrderModel, KeptModel]:
    """The full model and the condensed one of a law that remembers, without a training."""
    from mpi4py import MPI

    from hhr_dolfinx.full_order.full import FullOrderModel
    from hhr_dolfinx.study.condensing import condense

    # each rank alone: PETSc waits at the end for ranks without work
    full = FullOrderModel(scene, MPI.COMM_SELF)
    return full, condense(full, fields=True)


def _say_what_is_reused(console: Console, training: Training) -> None:
    """Print reused snapshots and shares of processes."""
    for item in training.log.skipped:
        if item["stage"] in ("snapshots", "problems side by side"):
            console.print(item["why"], highlight=False)


def _solve_part(
    console: Console,
    scene: Scene,
    training: TrainingLike,
    part: tuple[int, int],
    folder: Path,
    **how: Unpack[TrainOptions],
) -> None:
    from hhr_dolfinx.study.training.train import train_part

    solved = train_part(scene, training, *part, folder, **how)
    if first_rank():
        console.print(
            f"part {part[0]} of {part[1]}: {solved.training} training queries and "
            f"{solved.held_out} held out are in {folder}, {solved.read} answers were there before. "
            "The same command without --part then builds a model",
            highlight=False,
        )


def settings_of(scene: str) -> Any:
    """The ``SETTINGS`` in the file of a scene, of the class that a plug-in has, or None.

    Raises:
        NotOfferedError: if there are some, and no plug-in has the class.
        SceneError: if they are of another class.
    """
    from hhr_dolfinx.command.loading import beside, value_of
    from hhr_dolfinx.errors import NotOfferedError

    if (stated := beside(scene, "SETTINGS")) is None:
        return None
    if (kind := registry.offered("settings")) is None:
        remedy = registry.remedy("tools", "settings")
        raise NotOfferedError(f"no installed plug-in reads the SETTINGS beside {scene}{remedy}")
    return value_of(stated, scene, "SETTINGS", kind)


def training_of(how: dict[str, Any], settings: Any) -> TrainingLike:
    """Training by the options, else by the scene's file, else by 64 Sobol points.

    Args:
        how: values of the options by name, None for those that are not given.
        settings: ``SETTINGS`` of the scene's file; None without any.

    Raises:
        UsageError: for several trainings, or an invalid grid.
    """
    from hhr_dolfinx.sampling import Sobol

    chosen = registry.loadable("trainings")
    of_plugins = [
        name for name, way in chosen.items() if any(how[option] is not None for option in way.names)
    ]
    options = [name for name in ("grid", "sobol") if how[name] is not None] + of_plugins
    if len(options) > 1:
        raise click.UsageError(
            f"give one of {', '.join(f'--{name}' for name in ('grid', 'sobol', *chosen))}"
        )
    if options == ["grid"]:
        try:
            return [int(word) for word in how["grid"].split(",")]
        except ValueError:
            raise click.UsageError(f"--grid {how['grid']} must be counts, as 16,16") from None
    if of_plugins:
        return chosen[of_plugins[0]].training(how)
    if options == ["sobol"]:
        return Sobol(how["sobol"])
    return Sobol(64) if settings is None else settings.training
