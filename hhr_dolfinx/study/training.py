"""A full model with the solutions to train and to check reduced models: computed once, built from often."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mpi4py import MPI

from hhr_dolfinx import ranks
from hhr_dolfinx.full_order.elastic import FullOrderModel
from hhr_dolfinx.reduction.offline import HyperReduction, ReductionSettings, build_reduced_model
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.snapshots.solutions import SnapshotSet, spread_snapshots
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
    folder: Path | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
    progress: Progress = silent,
) -> Training:
    """Build the full model of a scene on each rank and share the training parameters out over the ranks.

    Args:
        scene: the scene.
        counts: training points along each parameter, on a regular grid.
        held_out: number of random parameters for the trust check; 0 for none.
        seed: seed of these.
        folder: where solutions are kept and found again; None keeps nothing.
        comm: communicator over which the parameters are spread.
        progress: for progress bars.
    """
    log = StageLog()
    with ranks.each_for_itself(comm, f"building the full model of scene '{scene.name}'"):
        with log.stage("full_order"):
            full_order = FullOrderModel(scene, MPI.COMM_SELF)
        store = None if folder is None else SnapshotStore(folder, full_order.problem)
    space = scene.parameters
    with log.stage("snapshots"):
        snapshots = spread_snapshots(full_order, space.grid(counts), comm, progress("snapshots"), store)
    kept = None
    if held_out > 0:
        with log.stage("held_out"):
            kept = spread_snapshots(full_order, space.random(held_out, seed + 2000), comm, progress("held out"), store)
    found, asked = comm.allreduce(0 if store is None else store.found), len(snapshots.points) + held_out
    if found:
        log.skip("snapshots", f"{found} of {asked} solutions were read from {folder}: the times cover the others")
    return Training(full_order, snapshots, kept, log)
