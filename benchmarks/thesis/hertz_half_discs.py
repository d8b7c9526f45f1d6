"""Two half-discs pressed together: hyper-reduced contact with one parameter.

Two elastic half-discs of radius 1 m face each other across a gap of 0.1 m. Their flat edges are
moved towards each other by mu in [0.15, 0.45] m (thesis sections 1.5.1, 2.6.2 and 3.5.1; after
Benaceur, Ern and Ehrlacher 2020). The model is trained on 31 values of mu and compared with the
full order on 101.

    find u and λ >= 0:  ∫ σ(u) : ε(v) + Σ λ_j (B v)_j = 0 for all v,    B u <= g(μ),    λ·(B u - g)
    = 0    (1.21) reduced, u = V γ:   K~ γ + B~^T λ = f~ θ(μ),    B~ γ <= g~ θ(μ)    on the cells
    around few nodes (the RID)    (1.61)

What to see: eight modes and seven contact nodes, the thesis' recipe, answer what 1356 unknowns and
55 contact pairs did in a tenth of the time of the best full-order solver. Where they look, forces
are right to one in a thousand; on the whole surface they are up to 22 % wrong where a single node
of them touches. The default recipe takes two more layers of cells and more nodes, and answers to
round-off in the same time.

    python benchmarks/thesis/hertz_half_discs.py [--out DIR] [--quick] [--seed N]
"""

import sys
from pathlib import Path
from typing import Any

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import hertz_half_discs as geometry

THESIS = hhr.Recipe.thesis(1e-8)
"""The thesis' own recipe: it needs no enrichment here."""
SIZES = [
    (f"eps {eps:.0e}", hhr.Recipe.thesis(eps)) for eps in (1e-4, 1e-5, 1e-6, 1e-7, 1e-9, 1e-10)
]


def SETTINGS() -> "hhr.StudySettings":
    """Training and measurements of a study."""
    return hhr.StudySettings([31], variants=SIZES, models={"thesis": THESIS}, queries=400)


def VIEW() -> "hhr.View":
    """Pictures of a study; no point is a training value."""
    return hhr.View(points=((0.168,), (0.255,), (0.435,), (0.345,)), label="x [m]", deformed=True)


def scene(**mesh_options: Any) -> hhr.Scene:
    """The scene; ``mesh_options`` go to :func:`geometry.half_discs`. Units: m, Pa."""
    towards = {geometry.LOWER_FLAT: 0.5, geometry.UPPER_FLAT: -0.5}
    return hhr.Scene(
        name="hertz_half_discs",
        geometry=lambda comm: geometry.half_discs(comm, **mesh_options),
        hypothesis="plane_strain",
        bodies=tuple(
            hhr.Body(tag, young=15.0, poisson=0.35) for tag in (geometry.LOWER, geometry.UPPER)
        ),
        contacts=(hhr.NodeToNode(geometry.LOWER_ARC, geometry.UPPER_ARC, normal=(0.0, 1.0)),),
        parameters=hhr.ParameterSpace(("mu",), (0.15,), (0.45,)),
        parameter_units={"mu": "m"},
        displacements=tuple(
            hhr.Displacement(tag, component, amplitude)
            for tag, slope in towards.items()
            for component, amplitude in (
                (0, hhr.Amplitude()),
                (1, hhr.Amplitude(slopes={"mu": slope})),
            )
        ),
    )


def main() -> None:
    """Train, validate, time, and write everything to the output folder."""
    sys.path.append(str(Path(__file__).parents[2] / "demos"))
    from parts import cli

    options = cli.parse(cli.demo_parser("hertz_half_discs", __doc__))
    built, settings = scene(), SETTINGS().adapted(seed=options.seed, quick=options.quick)
    points = built.parameters.grid([11 if options.quick else 101])
    study = hhr.study_scene(built, settings, options.out, points=points, progress=options.progress)
    if study is not None:  # ranks but the first have only trained
        study.write(options.out, options.console, VIEW())


if __name__ == "__main__":
    main()
