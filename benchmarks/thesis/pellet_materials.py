"""Pellet and cladding with their materials as parameters: six in all, as calibration and
uncertainty studies vary them.

The scene of ``pellet_cladding.py`` with the pressure P1, its height h1, and Young's modulus and
Poisson's ratio of both bodies. For a new material the full order factors its stiffness anew. Two
ways to answer are measured side by side: the hyper-reduced model, and condensation interpolated
between few Poisson's ratios, of which Young's moduli are factors.

    K(μ) = Σ_q w_q(E, ν) K_q,    λ solves  S(μ) λ + s(μ) >= 0,  λ >= 0,    S = B K^-1 B^T = Σ_c
    S_c(ν) / E_c S_c is interpolated over ν alone: Young's modulus of a whole body is a factor.

What to see: interpolated condensation keeps all contact conditions and is the most accurate; it
pays after some fifteen queries. The hyper-reduced model, trained on 512 Sobol points, comes close.

    python benchmarks/thesis/pellet_materials.py [--out DIR] [--quick] [--seed N]
"""

import dataclasses
import sys
from pathlib import Path
from typing import Any

import pellet_cladding as base

import hhr_dolfinx as hhr

NAMES = ("P1", "h1", "E1", "nu1", "E2", "nu2")
LOWER, UPPER = (5.0, 0.6, 100e3, 0.2, 60e3, 0.25), (200.0, 6.0, 250e3, 0.4, 100e3, 0.4)
RECIPE = hhr.Recipe(basis=hhr.Pod(1e-10, relative=True, by_body=True))
VARIANTS = [("one basis for both", hhr.Recipe(basis=hhr.Pod(1e-10, relative=True))),
            ("larger", hhr.Recipe(basis=hhr.Pod(1e-11, relative=True, by_body=True)))]  # fmt: skip


def VIEW() -> "hhr.View":
    """Pictures of a study."""
    return base.VIEW(((30.0, 5.25, 190e3, 0.3, 78e3, 0.34), (170.0, 3.2, 110e3, 0.22, 95e3, 0.39)))


def scene(**mesh_options: Any) -> hhr.Scene:
    """The scene in mm and MPa."""
    constant = base.scene(**mesh_options)
    pellet, cladding = constant.bodies
    bodies = (
        dataclasses.replace(pellet, young="E1", poisson="nu1"),
        dataclasses.replace(cladding, young="E2", poisson="nu2"),
    )
    space = hhr.ParameterSpace(NAMES, LOWER, UPPER)
    return dataclasses.replace(constant, name="pellet_materials", bodies=bodies, parameters=space)


def main() -> None:
    """Train on Sobol points, measure, report."""
    sys.path.append(str(Path(__file__).parents[2] / "demos"))
    from parts import cli

    options = cli.parse(cli.demo_parser("pellet_materials", __doc__))
    mesh, count = (base.QUICK_MESH, 128) if options.quick else ({}, 512)
    settings = hhr.StudySettings(
        hhr.Sobol(count), recipe=RECIPE, variants=VARIANTS, queries=100, naive=False
    )
    settings = settings.adapted(seed=options.seed, quick=options.quick)
    study = hhr.study_scene(scene(**mesh), settings, options.out, progress=options.progress)
    if study is not None:
        study.write(options.out, options.console, VIEW())


if __name__ == "__main__":
    main()
