"""Answers that know their error: bounds beside errors on random points, and a model that falls back on the full one.

Reduced models of the half-discs, the pellet and the sphere are asked at random points that they have never seen. Each
answer has a bound of its displacement, in energy, and of its contact forces, in the S norm (docs/bounds.md). Beside the
true errors the report has how many exceed their bound (none should), the effectivity, that is bound over error, and
whether bounds rank as errors do. Poor models are asked too: the thesis' recipe, and one of a tenth of the training.

What to see: no error exceeds its bound, and in the median of the usual models the bound is the error to some per
cent; of poor ones it is within a factor of 1.5. The thesis bounds the same by inf-sup constants, in
Euclidean norms: its effectivities there are 3.0 and 4.8 for displacements and 71.5 and 20,600 for forces, in the mean
on the half-discs and the pellet (section 2.6). They are evaluated here too, as printed and with constants that proofs
allow. With a bound as sharp as ours a model that may ask the full one hands out no answer that is off by more than a
hundredth.

    python demos/certified.py [--out DIR] [--quick] [--seed N]
"""

from argparse import Namespace
from collections.abc import Iterator
from typing import Any

import hertz_half_discs
import numpy as np
import pellet_cladding
import sphere_on_block
from mpi4py import MPI
from parts import thesis_bounds as theorems
from scipy.stats import spearmanr

import hhr_dolfinx as hhr
from hhr_dolfinx.study import cli, report
from hhr_dolfinx.study.training import Training
from hhr_dolfinx.timing import timed

TOLERANCE = 0.01
"""Relative error that a model that falls back is allowed."""
EXACT = 1e-9
"""Relative error below which an answer is exact, and its effectivity means nothing."""


def trainings(options: Namespace) -> Iterator[tuple[str, Training]]:
    """Each scene, trained as in its own demo."""
    scenes: dict[str, tuple[hhr.Scene, Any]] = {
        "half-discs": (hertz_half_discs.scene(), [31]),
        "pellet": (pellet_cladding.scene(**pellet_cladding.QUICK_MESH) if options.quick else pellet_cladding.scene(),
                   [8, 6] if options.quick else pellet_cladding.GRID),
    }  # fmt: skip
    if not options.quick:
        scenes["sphere"] = sphere_on_block.scene(), sphere_on_block.SETTINGS.training
    for name, (scene, training) in scenes.items():
        folder = options.out / f"snapshots_{name}"
        yield name, hhr.train(scene, training, folder=folder, comm=MPI.COMM_SELF, progress=options.progress)


def models(training: Training) -> Iterator[tuple[str, Any]]:
    """The usual model, the thesis', and one of a tenth of the training."""
    few = training.snapshots.take(slice(None, None, 10))
    yield "usual", training.build(checked=False)
    yield "thesis", training.build(hhr.Recipe.thesis(1e-8), checked=False)
    yield "a tenth", hhr.build(training.full_order, few, hhr.Recipe().as_it_is())


def compared(training: Training, model: Any, points: np.ndarray) -> dict[str, np.ndarray]:
    """Bounds and errors of displacement and forces at some points, absolute and relative, (n,) each."""
    full, rows = training.full_order, []
    stiffness, schur = full.problem.stiffness, full.schur
    for point in points:
        exact, answer = full.solve(point), model.solve(point, outside="ignore", raise_on_failure=False)
        estimate = answer.estimate()
        if estimate is None:  # the thesis' recipe has no answer everywhere
            continue
        field, forces = exact.displacement(), exact.forces()
        moved, pushed = answer.displacement() - field, answer.forces() - forces
        norms = [np.sqrt(max(value, 0.0)) for value in (
            moved @ (stiffness @ moved), pushed @ schur @ pushed, field @ (stiffness @ field), forces @ schur @ forces,
        )]  # fmt: skip
        rows.append([*estimate[1:5], *norms, np.linalg.norm(pushed)])
    names = ("primal_bound", "dual_bound", "primal_relative", "dual_relative", "primal", "dual", "field", "forces",
             "euclid")  # fmt: skip
    return dict(zip(names, np.array(rows).T, strict=True))


def judged(found: dict[str, np.ndarray], schur: np.ndarray) -> dict[str, float]:
    """How many errors exceed their bound, effectivities, and the rank correlation of bounds and errors."""
    row: dict[str, float] = {"answers": len(found["dual"])}
    for kind, size in (("primal", "field"), ("dual", "forces")):
        bound, error = found[f"{kind}_bound"], found[kind]
        off = error > EXACT * found[size]
        row |= {f"{kind} exceeded": int((error > bound).sum()), f"{kind} off": int(off.sum())}
        for share in (50, 95, 100):
            row[f"{kind} {share} %"] = float(np.percentile(bound[off] / error[off], share)) if off.any() else np.nan
        row[f"{kind} rank"] = float(spearmanr(bound[off], error[off]).statistic) if off.sum() > 2 else np.nan
        row[f"{kind} worst error"] = float((error / np.where(found[size] > 0, found[size], np.inf)).max())
    off = found["dual"] > EXACT * found["forces"]
    euclid = found["dual_bound"] / np.sqrt(np.linalg.eigvalsh(schur)[0])
    row["euclid 50 %"] = float(np.median(euclid[off] / found["euclid"][off])) if off.any() else np.nan
    return row


def fallen_back(training: Training, model: Any, points: np.ndarray) -> dict[str, float]:
    """What a model that falls back hands out: its worst error, how often it fell back, and what a query costs."""
    full = training.full_order
    safe = hhr.FallbackModel(model, full, TOLERANCE)
    answers, seconds = timed(lambda: safe.solve_many(points))
    reference, exact = timed(lambda: [full.solve(point) for point in points])
    worst = 0.0
    for answer, other in zip(answers, reference, strict=True):
        for value, size, product in (
            (answer.displacement() - other.displacement(), other.displacement(), full.problem.stiffness),
            (answer.forces() - other.forces(), other.forces(), full.schur),
        ):
            if size.any():
                worst = max(worst, float(np.sqrt(value @ (product @ value) / (size @ (product @ size)))))
    count = len(points)
    return {"share": safe.share, "worst error": worst, "query": seconds / count, "full": exact / count}


def costs(model: Any, point: np.ndarray, count: int = 200) -> dict[str, float]:
    """Seconds of an answer, of its forces, and of its estimate with them."""

    def repeated(ask: Any) -> float:
        return min(timed(lambda: [ask() for _ in range(count)])[1] for _ in range(3)) / count

    how = {"outside": "ignore", "raise_on_failure": False}
    answer = model.solve(point, **how)
    return {"solve": repeated(lambda: model.solve(point, **how)), "forces": repeated(answer.forces),
            "estimate": repeated(answer.estimate)}  # fmt: skip


def draw(found: dict[str, dict[str, np.ndarray]], options: Namespace) -> None:
    """Bounds over errors, all of them above the diagonal."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4.2), layout="constrained")
    axes = figure.subplots(1, 2)
    for axis, kind, size in zip(axes, ("primal", "dual"), ("field", "forces"), strict=True):
        for name, values in found.items():
            off = values[kind] > EXACT * values[size]
            scale = values[size][off]
            axis.loglog(values[kind][off] / scale, values[f"{kind}_bound"][off] / scale, ".", markersize=3, label=name)
        ends = np.array(axis.get_xlim())
        axis.loglog(ends, ends, "k-", linewidth=0.8)
        axis.set(xlabel=f"relative error, {kind}", ylabel="bound")
    axes[0].legend(fontsize=7)
    figure.savefig(options.out / "bounds.png", dpi=150)


def main() -> None:
    """Build, ask, compare; print the tables, write ``report.json`` and pictures."""
    options = cli.parse_on_first_rank(cli.demo_parser("certified", __doc__))
    count, rows, falls, drawn = 50 if options.quick else 1000, [], [], {}
    theirs, constants = [], {}
    for scene, training in trainings(options):
        points = training.full_order.parameters.random(count, options.seed + 11)
        for name, model in models(training):
            found = compared(training, model, options.progress(f"{scene}, {name}")(points))
            drawn[f"{scene}, {name}"] = found
            label = {"scene": scene, "model": name}
            rows.append({**label, **judged(found, training.full_order.schur), **costs(model, points[0])})
            falls.append({**label, **fallen_back(training, model, points)})
        if scene in theorems.THESIS:
            found_rows, constants[scene] = theorems.thesis_bounds(scene, training, points, options)
            theirs += found_rows
    draw(drawn, options)
    found_all = {"bounds": rows, "thesis_bounds": theirs, "thesis_constants": constants, "fallback": falls}
    report.write_report({"points": count, **found_all, **report.environment()}, options.out)
    for kind in ("primal", "dual"):
        shown = [{key: row[key] for key in row if key in ("scene", "model") or key.startswith(kind)} for row in rows]
        report.print_rows(f"bounds, {kind}: bound over error", shown, options.console)
    report.print_rows("the thesis' own: right over left side", theorems.shown(theirs), options.console)
    report.print_rows("seconds", [{key: row[key] for key in ("scene", "model", "solve", "forces", "estimate")}
                                  for row in rows], options.console)  # fmt: skip
    report.print_rows(f"never off by more than {TOLERANCE:g}", falls, options.console)


if __name__ == "__main__":
    main()
