"""Submissions to the data set: models of other authors, regressions and ours, and their scores.

Each model learns from the training answers of a scene of single points, as ``data_set.py`` makes
it, and answers its test points. It writes a submission for each method, ``submissions/METHOD.npz``,
as anybody's program would, and scores it by hidden answers, which it makes if they are not there.

    python benchmarks/data_set_rivals.py [--out DIR] [--quick] [--seed N] [--only SCENE]
"""

from __future__ import annotations

import re
from typing import Any

import _demos  # noqa: F401 (before the scenes)
import data_set
import numpy as np
import obstacles
from parts import cli

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import HHRError, NotOfferedError
from hhr_dolfinx.plugins.studies import report
from hhr_dolfinx.plugins.studies.points import time_queries
from hhr_dolfinx.plugins.studies.study import Rival, rivals_of
from hhr_dolfinx.snapshots.records import SnapshotSet
from hhr_dolfinx.timing import timed
from hhr_dolfinx.warn import ignored

SCENES = "matching", "nonmatching", "membrane"
"""Scenes of elastic bodies at single points, whose stiffness is constant."""


class Learnt:
    """Training answers of a scene, as rivals read them."""

    def __init__(self, made: data_set.Made, progress: Any):
        self.full_order = made.full
        answers = [made.full.solve(point) for point in progress("training")(made.training)]
        self.snapshots = SnapshotSet.of_answers(answers)

    def build(self, *recipe: Any, **how: Any) -> Any:
        """A hyper-reduced model.

        Raises:
            NotOfferedError: for matrices without cells.
        """
        if isinstance(self.full_order, obstacles.ObstacleModel):
            raise NotOfferedError("HHR cuts cells out of a mesh: these matrices have none")
        return hhr.build(self.full_order, self.snapshots, *recipe)

    def local(self, **how: Any) -> Any:
        """Refuse: sets of local models choose their own training.

        Raises:
            NotOfferedError: always.
        """
        raise NotOfferedError("local models are not built here")


class Nearest:
    """Answers by the nearest training answer."""

    def __init__(self, learnt: Learnt):
        self._known = learnt.snapshots
        self._sides = np.ptp(learnt.snapshots.points, axis=0)

    def solve(self, point: np.ndarray, **how: Any) -> Any:
        """The answer of forces alone."""
        off = (((self._known.points - point) / self._sides) ** 2).sum(axis=1)
        return _Plain(self._known.forces[:, off.argmin()])


class _Plain:
    """An answer of forces alone."""

    converged = True

    def __init__(self, forces: np.ndarray):
        self._forces = forces

    def forces(self) -> np.ndarray:
        return self._forces


def entries_of(model: Any, made: data_set.Made, hours: float, name: str) -> dict[str, np.ndarray]:
    """Arrays of a submission of a model to a scene."""
    rows = []
    for point in made.tests:
        try:
            answer = model.solve(point, outside="ignore", raise_on_failure=False)
            rows.append(answer.forces() if answer.converged else np.full(rows_of(made), np.nan))
        except HHRError:
            rows.append(np.full(rows_of(made), np.nan))
    fresh = made.full.parameters.random(25, 99)
    queries = {"model": lambda point: model.solve(point, outside="ignore", raise_on_failure=False)}
    seconds = np.median(time_queries(queries, fresh)["model"])
    return {
        f"{name}/forces": np.array(rows),
        f"{name}/offline_hours": np.array(hours / 3600),
        f"{name}/online_us": np.array(1e6 * seconds),
    }


def rows_of(made: data_set.Made) -> int:
    """Number of contact conditions."""
    return len(made.full.problem.gaps)


def main() -> None:
    """Write and score a submission for each method, and print the table."""
    parser = cli.demo_parser("data_set_rivals", __doc__)
    parser.add_argument("--only", action="append", choices=SCENES, help="scenes [all]")
    options = cli.parse_on_first_rank(parser)
    submissions: dict[str, dict[str, np.ndarray]] = {}
    for name in options.only or SCENES:
        with ignored(Warning):
            made = data_set.SCENES[name](options.quick, options.seed)
            hidden = options.out / "hidden"
            if not (hidden / f"{name}.npz").exists():
                data_set.write_scene(
                    name, made, options.out / "data" / name, hidden, options.progress
                )
            learnt, seconds = timed(lambda made=made: Learnt(made, options.progress))
            own = [
                Rival("nearest answer", "", Nearest(learnt)),
                Rival("HHR", "default", learnt.build),
            ]
            for rival in [*own, *rivals_of(["all"])(learnt)]:
                method = re.sub(r"\W+", "_", f"{rival.method} {rival.setting}").strip("_")
                try:
                    model, more = timed(rival.made)
                except HHRError:
                    continue
                entries = entries_of(model, made, seconds + more, name)
                submissions.setdefault(method, {}).update(entries)
    folder = options.out / "submissions"
    folder.mkdir(parents=True, exist_ok=True)
    scores = {}
    for method, entries in submissions.items():
        np.savez(folder / f"{method}.npz", **entries)
        scores[method] = hhr.score_submission(folder / f"{method}.npz", options.out / "hidden")
    rows = [
        {"scene": scene, "method": method, **{key: f"{value:.2g}" for key, value in row.items()}}
        for scene in options.only or SCENES
        for method, row in sorted(
            ((method, found[scene]) for method, found in scores.items() if scene in found),
            key=lambda pair: pair[1]["forces_p95"],
        )
    ]
    cli.print_rows("submissions", rows, options.console)
    found = {"scene": "data_set_rivals", "scores": scores, **report.environment()}
    report.write_report(found, options.out)


if __name__ == "__main__":
    main()
