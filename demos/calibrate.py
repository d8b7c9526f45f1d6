"""Two moduli from a force-depth curve: a sphere pressed into a coated block, calibrated with
gradients and by MCMC.

The stiffness of coating and substrate are parameters. Forces measured at twelve depths (here
synthetic, by the full order, with noise) lead back to both: by least squares with the gradients of
the model, and as a posterior by a random walk on the model, which takes as many answers as the full
order could give in hours.

    min over E of  Σ_k (F(d_k; E) - F_k)² / s_k²,    dF/dE from the active set: S_AA λ' = -s' - S' λ

    python demos/calibrate.py [--out DIR] [--quick] [--seed N]
"""

from typing import Any

import numpy as np
from parts import cli
from scipy.optimize import least_squares

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import coated_block as geometry
from hhr_dolfinx.plugins.studies.report import write_report
from hhr_dolfinx.timing import timed

LOWER, UPPER, TRUE = np.array([150e3, 60e3]), np.array([500e3, 160e3]), np.array([320e3, 95e3])
DEPTHS, NOISE = np.linspace(1e-3, 12e-3, 12), 0.01
QUICK_MESH = {"cells": (20, 10), "layers": 4}


def scene(**mesh_options: Any) -> hhr.Scene:
    """The scene in mm, MPa and N."""
    space = hhr.ParameterSpace(
        ("depth", "E_coating", "E_substrate"), (5e-4, *LOWER), (15e-3, *UPPER)
    )
    return hhr.Scene(
        name="calibrate",
        geometry=lambda comm: geometry.coated_block(comm, **mesh_options),
        hypothesis="axisymmetric",
        bodies=(
            hhr.Body(geometry.SPHERE, 210e3, 0.3),
            hhr.Body(geometry.COATING, "E_coating", 0.25),
            hhr.Body(geometry.BLOCK, "E_substrate", 0.3),
        ),
        contacts=(
            hhr.NodeToNode(geometry.SPHERE_BOTTOM, geometry.COATING_TOP, normal=(0.0, -1.0)),
        ),
        parameters=space,
        displacements=(
            *(hhr.Displacement(tag, 0) for tag in geometry.AXIS),
            hhr.Displacement(geometry.BLOCK_BOTTOM, 1),
            hhr.Displacement(geometry.SPHERE_TOP, 1, hhr.Amplitude(slopes={"depth": -1.0})),
        ),
        outputs=(hhr.ContactForce("force", contact=0, direction=(0.0, 1.0), unit="N"),),
    )


def forces(model: Any, moduli: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Forces at all depths, (12,), and their derivatives by the moduli, (12, 2)."""
    found = [model.outputs((depth, *moduli), gradient=True) for depth in DEPTHS]
    return np.array([item.values["force"] for item in found]), np.array(
        [item.gradient["force"][1:] for item in found]
    )


def fitted(model: Any, data: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Moduli by least squares with the gradients of the model, each in parts of its start."""
    sizes = NOISE * data
    found = least_squares(
        lambda x: (forces(model, x * start)[0] - data) / sizes,
        np.ones(2),
        jac=lambda x: forces(model, x * start)[1] * start / sizes[:, None],
        bounds=(LOWER / start, UPPER / start),
    )
    return found.x * start


def posterior(model: Any, data: np.ndarray, start: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Samples of a random walk (Metropolis) with even priors in the box, (count, 2)."""
    random, sizes = np.random.default_rng(seed), NOISE * data
    jacobian = forces(model, start)[1] / sizes[:, None]
    # steps as the posterior would be if the model were linear (Roberts, Gelman and Gilks 1997: 2.4
    # / sqrt(2))
    steps = 1.7 * np.linalg.cholesky(np.linalg.inv(jacobian.T @ jacobian))

    def misfit(moduli: np.ndarray) -> float:
        points = np.column_stack([DEPTHS, np.tile(moduli, (DEPTHS.size, 1))])
        found = model.solve_many(points).outputs()["force"]
        return 0.5 * float(np.sum(((found - data) / sizes) ** 2))

    here, value, samples = start, misfit(start), np.empty((count, 2))
    for k in range(count):
        there = here + steps @ random.standard_normal(2)
        if (LOWER < there).all() and (there < UPPER).all():
            other = misfit(there)
            if np.log(random.uniform()) < value - other:
                here, value = there, other
        samples[k] = here
    return samples


def main() -> None:
    """Calibrate on exact and on noisy data, and sample the posterior."""
    options = cli.parse(cli.demo_parser("calibrate", __doc__))
    built = scene(**(QUICK_MESH if options.quick else {}))
    training, trained = timed(lambda: hhr.train(built, hhr.Sobol(32), held_out=20))
    model, condensed = timed(training.condense)
    full = training.full_order
    exact = np.array([full.outputs((depth, *TRUE)).values["force"] for depth in DEPTHS])
    noisy = exact * (1 + NOISE * np.random.default_rng(options.seed).standard_normal(exact.size))
    clean, moduli = (fitted(model, data, (LOWER + UPPER) / 2) for data in (exact, noisy))
    count = 1000 if options.quick else 10_000
    samples, seconds = timed(lambda: posterior(model, noisy, moduli, count, options.seed))
    _, by_full = timed(lambda: [full.solve((depth, *TRUE)) for depth in DEPTHS])
    report = {
        "scene": "calibrate",
        "offline_s": trained + condensed,
        "error_without_noise": (clean / TRUE - 1).tolist(),
        "error_with_noise": (moduli / TRUE - 1).tolist(),
        "posterior_mean": samples.mean(axis=0).tolist(),
        "posterior_deviation": samples.std(axis=0).tolist(),
        "samples": len(samples),
        "answers": len(samples) * DEPTHS.size,
        "mcmc_s": seconds,
        "mcmc_full_order_s": by_full * count,
    }
    write_report(report, options.out)
    for name, value in report.items():
        options.console.print(f"{name}: {value}")


if __name__ == "__main__":
    main()
