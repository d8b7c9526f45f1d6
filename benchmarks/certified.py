"""Answers that know their error: bounds beside errors on random points, and a model that falls back
on the full one.

Reduced models of the half-discs, the pellet, the sphere, the pellet with its materials as
parameters (six in all), and a condensed one of a press fit with its shape as parameters, are asked
at random points that they have never seen. Each answer has a bound of its displacement, in energy,
of its contact forces, in the S norm and as users read them, nodal forces in the Euclidean norm, and
of the largest error of a pressure (docs/bounds.md); where the shape varies it is an estimate, as
nothing is proved of the interpolation in it. Beside the true errors the report has how many exceed
their bound (none should), the effectivity, that is bound over error, and whether bounds rank as
errors do. Poor models are asked too: the thesis' recipe, and one of a tenth of the training.

What to see: no error exceeds its bound, and in the median of the usual models the bound is the
error to some per cent; of poor ones it is within a factor of 1.5. The thesis bounds the same by
inf-sup constants, in Euclidean norms: its effectivities there are 3.0 and 4.8 for displacements and
71.5 and 20,600 for forces, in the mean on the half-discs and the pellet (section 2.6). They are
evaluated here too, as printed and with constants that proofs allow. With a bound as sharp as ours a
model that may ask the full one hands out no answer that is off by more than a hundredth.

    python benchmarks/certified.py [--out DIR] [--quick] [--seed N]
"""

from argparse import Namespace
from collections.abc import Iterable
from typing import Any, NamedTuple

import _demos  # noqa: F401 (before the scenes)
import hertz_half_discs
import numpy as np
import pellet_cladding
import pellet_materials
import press_fit
import sphere_on_block
import thesis_bounds as theorems
from mpi4py import MPI
from parts import cli
from scipy.stats import spearmanr

import hhr_dolfinx as hhr
from hhr_dolfinx.plugins.studies import report
from hhr_dolfinx.study.training.train import Training
from hhr_dolfinx.timing import timed

TOLERANCE = 0.01
"""Relative error that a model that falls back is allowed."""
EXACT = 1e-9
"""Relative error below which an answer is exact, and its effectivity means nothing."""


class Scene(NamedTuple):
    """A scene as in its own demo, and how it is trained and reduced there.

    Attributes:
        scene, training: see :func:`hhr_dolfinx.train`.
        recipe: of the usual model.
        thesis: whether the thesis' recipe is asked too.
    """

    scene: hhr.Scene
    training: Any
    recipe: hhr.Recipe = hhr.Recipe()
    thesis: bool = True


def scenes(quick: bool) -> dict[str, Scene]:
    """Constant stiffness; then materials, and a shape, as parameters."""
    mesh = pellet_cladding.QUICK_MESH if quick else {}
    found = {
        "half-discs": Scene(hertz_half_discs.scene(), [31]),
        "pellet": Scene(pellet_cladding.scene(**mesh), [8, 6] if quick else pellet_cladding.GRID),
        "materials": Scene(
            pellet_materials.scene(**mesh),
            hhr.Sobol(128 if quick else 512),
            pellet_materials.RECIPE,
            thesis=False,
        ),
    }
    if not quick:
        found["sphere"] = Scene(sphere_on_block.scene(), sphere_on_block.TRAINING)
    # on a coarse mesh: each of a thousand shapes is a mesh to assemble
    shapes = hhr.Sobol(16 if quick else 96)
    found["shape"] = Scene(press_fit.scene(**press_fit.QUICK_MESH), shapes, thesis=False)
    return found


def models(training: Training, how: Scene) -> dict[str, Any]:
    """The usual model, the thesis', and one of a tenth of the training.

    Where shapes vary the condensed one alone.
    """
    if how.scene.shapes:
        return {"usual": training.condense()}
    few = training.snapshots.take(slice(None, None, 10))
    found = {"usual": training.build(how.recipe, checked=False)}
    if how.thesis:
        found["thesis"] = training.build(hhr.Recipe.thesis(1e-8), checked=False)
    return found | {"a tenth": hhr.build(training.full_order, few, how.recipe.as_it_is())}


def asked(
    full: Any, found: dict[str, Any], points: Iterable[np.ndarray]
) -> dict[str, dict[str, np.ndarray]]:
    """Each model, and one that falls back on the full one, at some points: columns by name, (n,)
    each, by model.
    """
    rows: dict[str, list] = {name: [] for name in found}
    safe = {name: hhr.FallbackModel(model, full, TOLERANCE) for name, model in found.items()}
    for point in points:
        exact, seconds = timed(lambda point=point: full.solve(point))
        problem, schur = full.problem.at(point), full.schur
        if full.problem.varies:  # right to a millionth at least, as a norm of errors
            schur = found["usual"].fields.bound.compliances(point).schur
        norms = Norms(problem.stiffness, schur, exact.displacement(), exact.forces())
        for name, model in found.items():
            answer = model.solve(point, outside="ignore", raise_on_failure=False)
            handed, spent = timed(lambda point=point, name=name: safe[name].solve(point))
            estimate = answer.estimate()
            if estimate is None:  # the thesis' recipe has no answer everywhere
                continue
            primal, dual, *sizes = norms.of(answer)
            times = spent, seconds, *norms.of(handed)[:2], float(safe[name].fell_back(handed))
            read = [
                *norms.as_read(answer, problem.contact_areas),
                estimate.forces_euclid,
                estimate.pressure,
            ]
            rows[name].append([*estimate[1:5], primal, dual, *sizes, *read, *times])
    names = (
        "primal_bound",
        "dual_bound",
        "primal_relative",
        "dual_relative",
        "primal",
        "dual",
        "field",
        "forces",
        "forces_euclid",
        "pressure",
        "euclid",
        "peak",
        "forces_euclid_bound",
        "pressure_bound",
        "query",
        "full",
        "handed_primal",
        "handed_dual",
        "fell_back",
    )
    return {name: dict(zip(names, np.array(row).T, strict=True)) for name, row in rows.items()}


class Norms(NamedTuple):
    """What errors are measured by at a point, and the exact answer."""

    stiffness: Any
    schur: np.ndarray
    field: np.ndarray
    forces: np.ndarray

    def of(self, answer: hhr.Answer) -> list[float]:
        """Errors of displacement and forces, in energy and in the S norm, and the sizes of the
        exact ones.
        """
        moved, pushed = answer.displacement() - self.field, answer.forces() - self.forces
        squares = (
            moved @ (self.stiffness @ moved),
            pushed @ self.schur @ pushed,
            self.field @ (self.stiffness @ self.field),
            self.forces @ self.schur @ self.forces,
        )
        return [float(np.sqrt(max(value, 0.0))) for value in squares]

    def as_read(self, answer: hhr.Answer, areas: np.ndarray) -> list[float]:
        """Errors of nodal forces, in the Euclidean norm, and of pressures, the largest.

        Sizes of the exact ones.
        """
        off, per_area = answer.forces() - self.forces, 1 / np.where(areas > 0, areas, np.inf)
        return [
            float(np.linalg.norm(off)),
            float(np.abs(off * per_area).max()),
            float(np.linalg.norm(self.forces)),
            float((self.forces * per_area).max()),
        ]


KINDS = {"primal": "field", "dual": "forces", "forces_euclid": "euclid", "pressure": "peak"}
"""Errors, and the sizes of exact answers in their norms."""


def relative(errors: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Errors over the sizes of exact answers, (n,) each.

    Where bodies only graze each other a size is round-off.
    """
    return errors / np.maximum(sizes, EXACT * sizes.max())


def judged(found: dict[str, np.ndarray]) -> dict[str, float]:
    """How many errors exceed their bound, effectivities, and the rank correlation of bounds and
    errors.
    """
    row: dict[str, Any] = {"answers": len(found["dual"])}
    for kind, size in KINDS.items():
        bound, error = found[f"{kind}_bound"], found[kind]
        off = error > EXACT * found[size]
        row |= {f"{kind} exceeded": int((error > bound).sum()), f"{kind} off": int(off.sum())}
        for share in (50, 95, 100):
            row[f"{kind} {share} %"] = (
                float(np.percentile(bound[off] / error[off], share)) if off.any() else np.nan
            )
        row[f"{kind} rank"] = (
            float(spearmanr(bound[off], error[off]).statistic) if off.sum() > 2 else np.nan
        )
        row[f"{kind} worst error"] = float(relative(error, found[size]).max())
    return row


def fallen_back(found: dict[str, np.ndarray]) -> dict[str, float]:
    """What a model that falls back hands out: how often it fell back, its worst error, and what a
    query costs.
    """
    means = {name: float(found[name].mean()) for name in ("query", "full")}
    worst = max(
        relative(found[f"handed_{kind}"], found[KINDS[kind]]).max() for kind in ("primal", "dual")
    )
    return {"share": float(found["fell_back"].mean()), "worst error": float(worst), **means}


def told(row: dict[str, Any], fell: dict[str, Any], kind: str) -> dict[str, Any]:
    """What the report says of the estimates of one model."""
    every = {
        name: {
            key: row[f"{name} {share} %"]
            for key, share in (("median", 50), ("p95", 95), ("max", 100))
        }
        for name in KINDS
    }
    off = {name: every[name] for name in ("primal", "dual")}
    read = {name: {"effectivity": every[name], "violated": row[f"{name} exceeded"]}
            for name in ("forces_euclid", "pressure")}  # fmt: skip
    return {
        "kind": kind,
        "n": row["answers"],
        "effectivity": off,
        "spearman": {name: row[f"{name} rank"] for name in off},
        "violated": row["primal exceeded"] + row["dual exceeded"],
        **read,
        "cost": row["estimate"] / row["solve"],
        "fallback": {
            "target": TOLERANCE,
            "share": fell["share"],
            "worst": fell["worst error"],
            "query_s": fell["query"],
            "full_s": fell["full"],
        },
    }


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
            axis.loglog(
                values[kind][off] / scale,
                values[f"{kind}_bound"][off] / scale,
                ".",
                markersize=3,
                label=name,
            )
        ends = np.array(axis.get_xlim())
        axis.loglog(ends, ends, "k-", linewidth=0.8)
        axis.set(xlabel=f"relative error, {kind}", ylabel="bound")
    axes[0].legend(fontsize=7)
    figure.savefig(options.out / "bounds.png", dpi=150)


def main() -> None:
    """Build, ask, compare; print the tables, write ``report.json`` and pictures."""
    options = cli.parse_on_first_rank(cli.demo_parser("certified", __doc__))
    count, rows, falls, drawn = 50 if options.quick else 1000, [], [], {}
    theirs, constants, scenes_told = [], {}, {}
    for scene, how in scenes(options.quick).items():
        folder = options.out / f"snapshots_{scene}"
        training = hhr.train(
            how.scene, how.training, folder=folder, comm=MPI.COMM_SELF, progress=options.progress
        )
        points = training.full_order.parameters.random(count, options.seed + 11)
        found = models(training, how)
        for name, columns in asked(
            training.full_order, found, options.progress(scene)(points)
        ).items():
            drawn[f"{scene}, {name}"] = columns
            label = {"scene": scene, "model": name}
            rows.append({**label, **judged(columns), **costs(found[name], points[0])})
            falls.append({**label, **fallen_back(columns)})
            own = {"estimates": told(rows[-1], falls[-1], found[name].fields.bound.kind)}
            scenes_told.setdefault(scene, {"models": {}})["models"][name] = own
        scenes_told[scene] |= scenes_told[scene]["models"]["usual"]
        if scene in theorems.THESIS:
            found_rows, constants[scene] = theorems.thesis_bounds(scene, training, points, options)
            theirs += found_rows
    draw(drawn, options)
    found_all = {
        "scenes": scenes_told,
        "bounds": rows,
        "thesis_bounds": theirs,
        "thesis_constants": constants,
    }
    report.write_report({"points": count, **found_all, **report.environment()}, options.out)
    for kind in KINDS:
        shown = [
            {key: row[key] for key in row if key in ("scene", "model") or key.startswith(kind)}
            for row in rows
        ]
        cli.print_rows(f"bounds, {kind}: bound over error", shown, options.console)
    cli.print_rows("the thesis' own: right over left side", theorems.shown(theirs), options.console)
    cli.print_rows(
        "seconds",
        [
            {key: row[key] for key in ("scene", "model", "solve", "forces", "estimate")}
            for row in rows
        ],
        options.console,
    )
    cli.print_rows(f"never off by more than {TOLERANCE:g}", falls, options.console)


if __name__ == "__main__":
    main()
