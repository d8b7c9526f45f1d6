"""Random recipes: no reduced model is accepted without a warning and wrong.

Recipes are drawn at random, far beyond what one would choose, and built as a user would on two
scenes, each trained on few and on many points. Of every model that is not refused the forces on the
whole contact surface are measured at 200 parameters that neither training nor the trust check has
seen. What is accepted without a warning must be right to 10 % at 95 % of them and to 30 % at all;
the exit code is 1 if a model is not.

What to see: how many recipes are accepted, warned of and refused, how wrong the worst of the
accepted is, and how many warnings were needless, of models that turn out right to 3 % and 10 %. It
takes a few minutes.

    python benchmarks/random_recipes.py [--out DIR] [--quick] [--seed N] [--recipes N]
"""

import sys
from argparse import Namespace
from collections.abc import Iterator

import _demos  # noqa: F401 (before the scenes)
import hertz_half_discs
import numpy as np
import pellet_cladding
from mpi4py import MPI
from parts import cli
from recipes import judged, recipe, summed_up, warnings_given

import hhr_dolfinx as hhr
from hhr_dolfinx.plugins.studies import report
from hhr_dolfinx.plugins.studies.measure import References
from hhr_dolfinx.study.training.train import Training

MESH = {"radial_cells": 20, "axial_cells": 40, "cladding_radial_cells": 3}
COUNTS = {"half-discs": ([12], [31]), "pellet": ([8, 6], [20, 16])}


def trainings(options: Namespace) -> Iterator[tuple[str, Training]]:
    """Name and training of each scene on few and on many points, one at a time."""
    pellet = pellet_cladding.scene(**(pellet_cladding.QUICK_MESH if options.quick else MESH))
    for name, scene in (("half-discs", hertz_half_discs.scene()), ("pellet", pellet)):
        for counts in COUNTS[name]:
            yield (
                f"{name} {counts}",
                hhr.train(scene, counts, seed=options.seed, comm=MPI.COMM_SELF),
            )


def main() -> int:
    """Draw, build and measure; print the counts, write ``report.json``."""
    parser = cli.demo_parser("random_recipes", __doc__)
    parser.add_argument(
        "--recipes", type=int, default=30, help="for each of the four trainings (%(default)s)"
    )
    options = cli.parse_on_first_rank(parser)
    count, points = (5, 60) if options.quick else (options.recipes, 200)
    rng, rows = np.random.default_rng(options.seed), []
    for name, training in trainings(options):
        unseen = training.full_order.problem.parameters.random(points, options.seed)
        references = References.at(unseen, training.full_order, training.snapshots)
        for _ in options.progress(name)(range(count)):
            rows.append({"training": name, **judged(training, recipe(rng), references)})
    names = list(dict.fromkeys(row["training"] for row in rows))
    counts = [
        {"training": name, **summed_up([row for row in rows if row["training"] == name])}
        for name in names
    ]
    counts.append({"training": "all", **summed_up(rows)})
    given = warnings_given(rows)
    cli.print_rows(f"random recipes, {points} points", counts, options.console)
    options.console.print(f"warnings: {given or 'none'}")
    written = {
        "seed": options.seed,
        "points": points,
        "summary": counts,
        "warnings": given,
        "rows": rows,
    }
    report.write_report({**written, **report.environment()}, options.out)
    return int(counts[-1]["silently_wrong"] > 0)


if __name__ == "__main__":
    sys.exit(main())
