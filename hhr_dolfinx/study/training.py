"""A full model with the solutions to train and to check reduced models: computed once, built from often."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mpi4py import MPI

from hhr_dolfinx import ranks
from hhr_dolfinx.errors import ParameterError, StudyError
from hhr_dolfinx.full_order.elastic import FullOrderModel
from hhr_dolfinx.parameters import is_whole
from hhr_dolfinx.reduction.offline import HyperReduction, ReductionSettings, build_reduced_model
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.snapshots.held_out import held_out_points
from hhr_dolfinx.snapshots.records import SnapshotSet, spread_snapshots
from hhr_dolfinx.snapshots.store import SnapshotStore
from hhr_dolfinx.timing import StageLog

Progress = Callable[[str], Callable[[Iterable], Iterable]]
"""Maps a label to a wrapper of iterations, for progress bars."""


DEFAULT_RECIPE = ReductionSettings()


def silent(label: str) -> Callable[[Iterable], Iterable]:
    """No progress bars."""
    return iter


@dataclass(frozen=True)
class Training:
    """A full model with the solutions to train and to check reduced models.

    Attributes:
        full_order: the full model, on one rank.
        snapshots: training solutions.
        held_out: solutions for the trust check, or None.
        log: seconds of each stage.
    """

    full_order: FullOrderModel
    snapshots: SnapshotSet
    held_out: SnapshotSet | None
    log: StageLog

    def build(self, recipe: ReductionSettings = DEFAULT_RECIPE, *, checked: bool = True) -> HyperReduction:
        """A reduced model; unchecked it is built as it is, to be measured: no warning, no growth of its RID.

        Only what cannot be solved at all is refused even so: dependent contact rows, a singular K~.
        """
        if checked:
            return build_reduced_model(self.full_order, self.snapshots, recipe, self.held_out)
        as_it_is = replace(recipe, limits=None, most_layers=recipe.layers)
        return build_reduced_model(self.full_order, self.snapshots, as_it_is)


def train(
    scene: Scene,
    counts: Sequence[int],
    *,
    held_out: int = 100,
    seed: int = 1,
    folder: str | Path | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
    progress: Progress = silent,
) -> Training:
    """Build the full model of a scene on each rank and share the training parameters out over the ranks.

    Args:
        scene: the scene.
        counts: training points along each parameter, on a regular grid.
        held_out: number of random parameters for the trust check, a fifth of them where contact grazes; 0 for none.
        seed: seed of these.
        folder: where solutions are kept and found again; None keeps nothing.
        comm: communicator over which the parameters are spread.
        progress: for progress bars.

    Raises:
        StudyError: for counts, a number of solutions, a seed or a folder that are none, before anything is computed.
    """
    log = StageLog()
    with ranks.each_for_itself(comm, "checking what was asked for"):
        if not isinstance(scene, Scene):
            raise StudyError(f"{scene!r} is no scene: give a Scene")
        check_counts(held_out=(held_out, 0), seed=(seed, 0))
        grid = training_grid(scene, counts)
        folder = None if folder is None else checked_folder(folder)
    with ranks.each_for_itself(comm, f"building the full model of scene '{scene.name}'"):
        with log.stage("full_order"):
            full_order = FullOrderModel(scene, MPI.COMM_SELF)
        store = None if folder is None else SnapshotStore(folder, full_order.problem)
    with log.stage("snapshots"):
        snapshots = spread_snapshots(full_order, grid, comm, progress("snapshots"), store)
    kept = None
    if held_out > 0:
        with log.stage("held_out"):
            points = held_out_points(full_order.problem, snapshots, counts, held_out, seed + 2000)
            # forces decide on them, whose last digits may differ between machines
            kept = spread_snapshots(full_order, comm.bcast(points), comm, progress("held out"), store)
    found, asked = comm.allreduce(0 if store is None else store.found), len(snapshots.points) + held_out
    if found:
        log.skip("snapshots", f"{found} of {asked} solutions were read from {folder}: the times cover the others")
    return Training(full_order, snapshots, kept, log)


def training_grid(scene: Scene, counts: Sequence[int]):
    """Training points on a regular grid, (S, P).

    Raises:
        StudyError: if there is not one positive count for each parameter, or one point alone.
    """
    try:
        grid = scene.parameters.grid(counts)
    except ParameterError as error:
        raise StudyError(f"training of scene '{scene.name}': {error}") from None
    if len(grid) < 2:
        raise StudyError(
            f"training of scene '{scene.name}' on {counts!r} points: a reduced model needs at least 2 of them"
        )
    return grid


def check_counts(**asked: tuple[object, int]) -> None:
    """Refuse what is no integer of at least its least value.

    Args:
        asked: by name the value and the least one.

    Raises:
        StudyError: with the name.
    """
    for name, (value, least) in asked.items():
        if not is_whole(value, least):
            raise StudyError(f"{name} = {value!r} must be an integer of at least {least}")


def checked_folder(folder: str | Path) -> Path:
    """A folder to write to, which need not exist.

    Raises:
        StudyError: if it is no path, or it or a part of its path is a file.
    """
    if not isinstance(folder, str | os.PathLike):
        raise StudyError(f"the folder {folder!r} must be a path")
    path = Path(folder)
    try:
        path.exists()
    except (OSError, ValueError) as error:
        raise StudyError(f"the folder {str(path)[:80]!r} cannot be made: {error}. Choose another name") from None
    for part in (path, *path.parents):
        if part.exists():
            if not part.is_dir():
                raise StudyError(
                    f"the folder {path} cannot be made: {part} is a file. Choose another folder or move it"
                )
            break
    return path
