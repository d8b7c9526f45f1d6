"""Submissions to the data set: models of other authors, regressions and ours, and their scores.

Each model learns from the training answers of a scene, as ``data_set.py`` makes it, and answers its
test points or paths. It writes a submission for each method, ``submissions/METHOD.npz``, as
anybody's program would, and scores it by hidden answers, which it makes if they are not there.

Models of other authors are for elastic bodies at single points. On paths, and where the shape is a
parameter, regressions learn forces alone: of a step from its time and point, the point before, and
the least and the largest parameters so far.

    python benchmarks/data_set_rivals.py [--out DIR] [--quick] [--seed N] [--only SCENE] [--docs]
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import _demos  # noqa: F401 (before the scenes)
import data_set
import numpy as np
import obstacles
from mpi4py import MPI
from parts import cli

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import HHRError, NotOfferedError
from hhr_dolfinx.plugins.rivals.regression import REGRESSIONS, Coefficients, Fit
from hhr_dolfinx.plugins.studies import report
from hhr_dolfinx.plugins.studies.points import time_queries
from hhr_dolfinx.plugins.studies.study import Rival, rivals_of
from hhr_dolfinx.snapshots.records import SnapshotSet
from hhr_dolfinx.timing import timed
from hhr_dolfinx.warn import ignored

PAGE = Path(__file__).resolve().parents[1] / "docs" / "data_set.md"
ELASTIC_SCENES = "matching", "nonmatching", "membrane"
"""Scenes of elastic bodies at single points, whose stiffness is constant."""
ALONG_PATHS = "radial functions", "neural network"
"""Regressions of what is read of paths, some thirty numbers: processes with a length for each take
hours, and polynomials have too many terms.
"""
SAID_TWICE = 1e-9
"""Part of the largest spread below which numbers that are read are those of others."""
TIMED_ANSWERS = 25
"""Answers of which the median time is taken."""


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


class Forces(NamedTuple):
    """Answers of a scene as a method knows them that reads nothing else: what was asked and forces,
    (n, ...) each.
    """

    asked: np.ndarray
    forces: np.ndarray


Asked = Callable[[np.ndarray], np.ndarray]
"""Forces, (m,), of a point, (P,); or (steps, m), of a path, (steps + 1, 1 + P)."""


def nearest(known: Forces) -> Asked:
    """The nearest training answer, by the ranges of all numbers that are asked."""
    sides = np.ptp(known.asked, axis=0)
    sides = np.where(sides > 0, sides, 1.0)

    def forces(entry: np.ndarray) -> np.ndarray:
        off = np.square((known.asked - entry) / sides).reshape(len(known.asked), -1).sum(axis=1)
        found: np.ndarray = known.forces[off.argmin()]
        return found

    return forces


def read(asked: np.ndarray) -> np.ndarray:
    """What regressions read of points, (n, P), or of all steps of paths, (n steps, q)."""
    if asked.ndim == 2:
        return asked
    points = asked[:, :, 1:]
    rows = (
        asked[:, 1:],
        points[:, :-1],
        np.minimum.accumulate(points, axis=1)[:, 1:],
        np.maximum.accumulate(points, axis=1)[:, 1:],
    )
    return np.concatenate(rows, axis=2).reshape(-1, 1 + 4 * points.shape[2])


def regression(fit: Fit, known: Forces) -> Asked:
    """POD of forces, and a regression of their coefficients."""
    rows = read(known.asked)
    low = rows.min(axis=0)
    sides = np.ptp(rows, axis=0)
    sides = np.where(sides > 0, sides, 1.0)
    middle = ((rows - low) / sides).mean(axis=0)
    # what several numbers of a path say together is said once
    ways, sizes, _ = np.linalg.svd(((rows - low) / sides - middle).T, full_matrices=False)
    ways = ways[:, sizes > SAID_TWICE * sizes[0]]

    def scaled(asked: np.ndarray) -> np.ndarray:
        found: np.ndarray = 2 * ((asked - low) / sides - middle) @ ways
        return found

    coefficients = Coefficients.of(known.forces.reshape(len(rows), -1).T)
    predict = fit(scaled(rows), coefficients.values)

    def forces(entry: np.ndarray) -> np.ndarray:
        values = predict(scaled(read(entry[None])))
        found = np.array([coefficients.modes @ coefficients.rebuilt(row) for row in values])
        return found[0] if entry.ndim == 1 else found

    return forces


def answered(model: Any) -> Asked:
    """Forces of a model of this package; NaN where it has no answer."""

    def forces(entry: np.ndarray) -> np.ndarray:
        nothing = np.array(np.nan)
        try:
            if entry.ndim == 2:
                history = model.march([(row[0], row[1:]) for row in entry])
                return np.array([answer.forces() for answer in history.answers])
            answer = model.solve(entry, outside="ignore", raise_on_failure=False)
        except HHRError:
            return nothing
        found: np.ndarray = answer.forces() if answer.converged else nothing
        return found

    return forces


def methods(
    name: str, made: data_set.Made, forces: np.ndarray, progress: Any
) -> Iterator[tuple[str, float, Callable[[], Asked]]]:
    """Methods of a scene: names, seconds of training answers, and what makes an answering one."""
    known = Forces(made.training, forces)
    if name in ELASTIC_SCENES:
        learnt, seconds = timed(lambda: Learnt(made, progress))
        own = Rival("HHR", "default", learnt.build)
        for rival in [own, *rivals_of(["all"])(learnt)]:
            made_by = partial(lambda one: answered(one.made()), rival)
            yield f"{rival.method} {rival.setting}", seconds, made_by
    else:
        asked: Any = made.training
        if asked.ndim == 3:
            asked = [[(row[0], row[1:]) for row in path] for path in asked]
        train = partial(hhr.train, made.full.scene, asked, held_out=0, comm=MPI.COMM_SELF)
        trained, seconds = timed(train)
        yield "condensed", seconds, lambda: answered(trained.condense())
        yield "HHR default", seconds, lambda: answered(trained.build(checked=False))
        for method in REGRESSIONS if made.training.ndim == 2 else ALONG_PATHS:
            setting, fit = REGRESSIONS[method]
            yield f"{method} {setting}", seconds, partial(regression, fit, known)
    yield "nearest answer", seconds, lambda: nearest(known)


def entries_of(forces: Asked, made: data_set.Made, hours: float, name: str) -> dict[str, Any]:
    """Arrays of a submission of a method to a scene."""
    shape = (made.tests.shape[1] - 1,) * (made.tests.ndim - 2) + (len(made.full.problem.gaps),)
    rows = [np.broadcast_to(forces(entry), shape) for entry in made.tests]
    asked = made.tests[np.arange(TIMED_ANSWERS) % len(made.tests)]
    seconds = np.median(time_queries({"model": forces}, asked)["model"])
    return {
        f"{name}/forces": np.array(rows),
        f"{name}/offline_hours": np.array(hours / 3600),
        f"{name}/online_us": np.array(1e6 * seconds / np.prod(shape[:-1])),
    }


def submitted(name: str, options: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    """Submissions to a scene by the names of their methods."""
    made = data_set.SCENES[name](options.quick, options.seed)
    folder, hidden = options.out / "data" / name, options.out / "hidden"
    if not (hidden / f"{name}.npz").exists():
        data_set.write_scene(name, made, folder, hidden, options.progress)
    forces = np.load(folder / "training.npz")["forces"]
    for method, seconds, maker in methods(name, made, forces, options.progress):
        try:
            asked, more = timed(maker)
        except HHRError:
            continue
        yield re.sub(r"\W+", "_", method).strip("_"), entries_of(asked, made, seconds + more, name)


def write_tables(scores: dict[str, dict[str, dict[str, float]]], page: Path) -> None:
    """Write the tables at the end of a page."""
    lines = []
    for name in data_set.SCENES:
        rows = [(method, found[name]) for method, found in scores.items() if name in found]
        overlaps = any("overlap_p95" in row for _, row in rows)
        columns = ["forces p95", "worst", *(["overlap p95"] if overlaps else []), "us"]
        lines += [f"| `{name}` | {' | '.join(columns)} |", "|" + "---|" * (len(columns) + 1)]
        for method, row in sorted(rows, key=lambda pair: pair[1]["forces_p95"]):
            keys = ["forces_p95", "forces_worst", *(["overlap_p95"] if overlaps else [])]
            figures = [f"{row[key]:.1e}" for key in keys] + [f"{row['online_us']:.0f}"]
            lines.append(f"| {method.replace('_', ' ')} | {' | '.join(figures)} |")
        lines.append("")
    text = page.read_text(encoding="utf-8").partition("\n| `matching` | forces p95")[0]
    page.write_text(text + "\n" + "\n".join(lines).rstrip() + "\n", encoding="utf-8")


def main() -> None:
    """Write and score a submission for each method, and print the table."""
    parser = cli.demo_parser("data_set_rivals", __doc__)
    parser.add_argument(
        "--only", action="append", choices=list(data_set.SCENES), help="scenes [all]"
    )
    parser.add_argument("--docs", action="store_true", help="write the tables of the documentation")
    options = cli.parse_on_first_rank(parser)
    if options.docs and (options.only or options.quick):
        parser.error("the documentation has all scenes as they are: leave out --only and --quick")
    scenes = options.only or list(data_set.SCENES)
    submissions: dict[str, dict[str, np.ndarray]] = {}
    for name in scenes:
        with ignored(Warning):
            for method, entries in submitted(name, options):
                submissions.setdefault(method, {}).update(entries)
    folder = options.out / "submissions"
    folder.mkdir(parents=True, exist_ok=True)
    scores = {}
    for method, entries in submissions.items():
        np.savez(folder / f"{method}.npz", **entries)
        scores[method] = hhr.score_submission(folder / f"{method}.npz", options.out / "hidden")
    rows = [
        {"scene": scene, "method": method, **{key: f"{value:.2g}" for key, value in row.items()}}
        for scene in scenes
        for method, row in sorted(
            ((method, found[scene]) for method, found in scores.items() if scene in found),
            key=lambda pair: pair[1]["forces_p95"],
        )
    ]
    cli.print_rows("submissions", rows, options.console)
    found = {"scene": "data_set_rivals", "scores": scores, **report.environment()}
    report.write_report(found, options.out)
    if options.docs:
        write_tables(scores, PAGE)


if __name__ == "__main__":
    main()
