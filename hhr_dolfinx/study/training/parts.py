"""One part of the answers of a training, kept in a folder: the work of one job of an array.

Parts share only the folder. The training itself then finds their answers there, and solves the missing ones: held-out
points with grazing contact, which depend on all training answers.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from mpi4py import MPI

from hhr_dolfinx.errors import NotOfferedError, StudyError
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.group import group_of, share
from hhr_dolfinx.models.histories.equilibrium import DEFAULT_MARCH, MarchSettings
from hhr_dolfinx.parameters import is_whole
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.snapshots.records import Lost, spread_snapshots, uniform_points
from hhr_dolfinx.snapshots.store import SnapshotStore
from hhr_dolfinx.study.training.train import Progress, checked_folder, checked_training, chooses_itself, silent


class PartSolved(NamedTuple):
    """Numbers of the training queries of a part, of those held out, and of answers that existed already."""

    training: int
    held_out: int
    read: int


def train_part(
    scene: Scene,
    training: object,
    number: int,
    parts: int,
    folder: str | Path,
    *,
    held_out: object = None,
    seed: int = 1,
    comm: MPI.Comm = MPI.COMM_WORLD,
    march: MarchSettings = DEFAULT_MARCH,
    progress: Progress = silent,
) -> PartSolved:
    """Solve one of several parts of a training, and keep its answers in a folder that all parts share.

    After all parts, ``train(scene, training, folder=folder)`` with the same arguments reads them.

    Args:
        scene, training, held_out, seed, comm, march, progress: see :func:`~hhr_dolfinx.study.training.train.train`.
        number, parts: number of this part, from 1 on, and of all parts.
        folder: keeps the answers.

    Raises:
        StudyError: for a part that does not exist, and for an invalid training.
        NotOfferedError: for a greedy training, whose choices each need all answers before.
    """
    with group_of(comm).each("checking what to train on"):
        if not (is_whole(parts, 1) and is_whole(number, 1) and number <= parts):
            raise StudyError(f"part {number!r} of {parts!r}: give numbers from 1 on, such as part 3 of 8")
        queries, apart = checked_training(scene, training, held_out, seed)
        if chooses_itself(queries):
            raise NotOfferedError(
                "a greedy training chooses each point from all answers before it, and has no parts: give a grid, "
                "Sobol(512) or a list of paths, or run it on several ranks"
            )
        target = checked_folder(folder)
    with group_of(comm).each(f"building the full model of scene '{scene.name}'"):
        full = FullOrderModel(scene, MPI.COMM_SELF)
        store = SnapshotStore(target, full)
    others = apart if isinstance(apart, list) else uniform_points(full.parameters, apart, seed)
    counts = []
    for label, given in (("snapshots", queries), ("held out", others)):
        mine = [given[k] for k in share(len(given), number - 1, parts)]
        counts.append(len(mine))
        if mine:
            lost = Lost()
            spread_snapshots(full, mine, comm, progress(label), store, march, lost)
            lost.warn(len(mine), 1, f"queries of part {number} of {parts}")
    return PartSolved(counts[0], counts[1], group_of(comm).total(store.found))
