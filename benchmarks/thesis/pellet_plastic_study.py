"""A family of paths, and paths inside and outside of what was trained: studies of the pellet that
yields.
"""

import argparse
from collections.abc import Iterator
from typing import Any

import numpy as np
from paths import summarise_paths, try_path
from pellet_cladding_plastic import history, path, recipe
from pellet_families import families
from thesis_output import print_beside

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import force_floor
from hhr_dolfinx.command.console import Table
from hhr_dolfinx.plugins.inelastic.condense_flow import CorrectionSettings
from hhr_dolfinx.plugins.studies.study import Study

OF_FAMILIES = (
    "largest_displacement",
    "primal_l2",
    "resultant",
    "dual_full_floored",
    "largest_forces",
)
"""Errors that a study of a family of paths is summed up by."""


def settings_of_family(options: argparse.Namespace, steps: int) -> hhr.StudySettings:
    """Trained on 12 paths of a family and tested on 20, of which few if it has to be quick."""
    family, (trained, tested) = families(steps)["combined"], (4, 4) if options.quick else (12, 20)
    return hhr.StudySettings(
        family.paths(hhr.Sobol(trained)),
        recipe(options.pod, options.layers),
        tests=family.paths(hhr.Sobol(tested, seed=2)),
        held_out=family.paths(hhr.Sobol(2, seed=3)),
        seed=options.seed,
        # as they are drawn, holds are up to 23 % off in the stress by their steps alone
        march=hhr.MarchSettings(time_tolerance=0.1 if options.quick else 0.02),
        repetitions=1,
        # forces within a tenth at any step are what a family of such width asks for
        correction=CorrectionSettings(modes=6e-4, cubature=3e-4, dual=0.1),
    )


def try_paths(study: Study, options: argparse.Namespace) -> None:
    """What both models do on 20 random paths inside what was trained and 40 outside."""
    from pellet_cladding_paths import path_cases

    full = study.training.full_order
    floor = force_floor(full.problem, study.training.snapshots)
    cases = options.progress("paths")(list(path_cases(history, options.seed)))
    models = study.measured.models
    tried = [try_path(full, models, case, floor, study.settings.march) for case in cases]
    for name, model in models.items():
        # figures at the top of a report are those of the model under study
        place = study.report if model is study.model else study.report["models"][name]
        place["paths"] = summarise_paths(row[name] for row in tried)
        for line in path_lines(place["paths"]):
            options.console.print(f"paths, {name}: {line}")


def path_lines(paths: dict[str, Any]) -> Iterator[str]:
    """Worst errors on paths inside and outside of what was trained, and warnings, in words."""
    inside, outside = paths["inside"], paths["outside"]
    if inside:
        errors = ", ".join(f"{name} {row['max']:.1%}" for name, row in inside.items())
        yield (
            f"paths inside what was trained, worst errors: {errors}; {paths['false_alarms']} "
            "false alarms"
        )
    silent = ", ".join(f"{name} {value:.1%}" for name, value in outside["silent_worst"].items())
    yield (
        f"paths outside: {outside['warned']} of {outside['n']} warned of; worst errors without a "
        f"warning: {silent}"
    )


def print_family(study: Study, options: argparse.Namespace) -> None:
    """Print the 95th percentiles of errors over the paths of a family, and what was refused."""
    table = Table(
        "model", *OF_FAMILIES, title="95 % of the paths of the family are better than, in %"
    )
    for name, item in study.report["models"].items():
        cells = [f"refused: {item['refused']}"[:160]] if "refused" in item else [
            f"{100 * item['errors'][key]['p95']:.2g}" for key in OF_FAMILIES
        ]  # fmt: skip
        table.add_row(name, *cells)
    options.console.print(table)


NAMES = ("primal_euclid", "dual_rid", "stress_rr", "plastic_strain")
THESIS = {"10 um": (0.0089, 0.067, 0.046, 0.022), "12.5 um": (0.028, 0.025, 0.025, 0.0061)}
"""Table 6.1: errors by name at two gaps."""


def settings_of_gaps(options: argparse.Namespace, steps: int) -> hhr.StudySettings:
    """Trained on some gaps, tested on the two of the thesis and on random ones."""
    drawn = np.random.default_rng(options.seed).uniform(5, 15, 1 if options.quick else 4)
    tests = [10.0, 12.5, *np.sort(drawn).round(3)]
    return hhr.StudySettings(
        [path(gap, steps) for gap in options.train],
        recipe(options.pod, options.layers),
        tests={gap: path(gap, steps) for gap in tests},
        held_out=[path(8.0, steps)],
        seed=options.seed,
        correction=CorrectionSettings(modes=3e-4, cubature=1.5e-4),
    )


def print_gaps(study: Study, options: argparse.Namespace) -> None:
    """Print errors at the last step beside those of the thesis."""
    rows = {f"{row['value']:g} um": {name: row[name] for name in study.measured.own.errors.values}
            for row in study.report["histories"]}  # fmt: skip
    theirs = {label: dict(zip(NAMES, row, strict=True)) for label, row in THESIS.items()}
    print_beside("errors at the last step", rows, theirs, options.console)
