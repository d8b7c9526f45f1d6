"""Indentation: a steel sphere pressed into a block that yields, in space, loaded and unloaded.

One quarter of a sphere of radius 10 mm is pushed up to 0.03 mm into a block and drawn off again; mortar contact. Yield
stress and hardening of the block are parameters. What is read off is the curve of force over depth, the imprint that
stays, and how the surface rises beside it.

What to see: small loads are Hertz's (1882), the deepest are fully plastic, where the mean pressure tends to three times
the yield stress (Tabor 1951; K. L. Johnson, Contact Mechanics, 1985, section 6.3). A curve with noise leads back to the
constants of the block, by gradients of whole histories and by thousands of them.

    python demos/indentation.py [--out DIR] [--quick] [--seed N]
"""

from typing import Any

import numpy as np
from scipy.optimize import least_squares

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import sphere_on_block as geometry
from hhr_dolfinx.models.answer import History, Path
from hhr_dolfinx.study import cli, report

RADIUS, WIDTH, SPHERE_E, BLOCK_E, POISSON = 10.0, 0.4, 210e3, 70e3, 0.3
BOX = {"depth": (0.0, 0.03), "sy": (100.0, 300.0), "H": (1000.0, 10e3), "E": (60e3, 80e3)}
"""Ranges of the parameters, in mm and MPa; the last is one only where a scene asks for it."""
RINGS = (0.5, 0.8, 1.1)
"""Distances from the pole in mm at which the rise of the surface is read off."""
CELLS, QUICK_CELLS, DEPTH, NOISE = 19, 10, 0.025, 0.01
# the elastic operator has its factors and all columns of the contact already, and takes few more iterations than
# tangents, which in space cost as much as ten iterations each
MARCH = hhr.MarchSettings(search="elastic")


def scene(cells: int = CELLS, young: float | str = BLOCK_E) -> hhr.Scene:
    """The scene in mm, MPa and N.

    Args:
        cells: of the block along a side, see :func:`geometry.indentation_cells`.
        young: Young's modulus of the block, a number or "E" for one more parameter.
    """
    names = [name for name in BOX if name == young or name != "E"]
    held = [hhr.Displacement(tag, axis) for axis, tags in geometry.SYMMETRY.items() for tag in tags]
    push = hhr.Displacement(geometry.SPHERE_TOP, 2, hhr.Amplitude(slopes={"depth": -1.0}))
    return hhr.Scene(
        name="indentation",
        geometry=lambda comm: geometry.sphere_on_block(
            comm, radius=RADIUS, width=WIDTH, depth=WIDTH, **geometry.indentation_cells(cells)
        ),
        hypothesis="solid",
        bodies=(
            hhr.Body(geometry.SPHERE, SPHERE_E, POISSON),
            hhr.Body(geometry.BLOCK, young, POISSON, hhr.Plasticity("sy", hardening="H")),
        ),
        contacts=(hhr.Mortar(geometry.BLOCK_TOP, geometry.SPHERE_BOTTOM, normal=(0.0, 0.0, 1.0)),),
        parameters=hhr.ParameterSpace(names, *zip(*(BOX[name] for name in names), strict=True)),
        displacements=(*held, hhr.Displacement(geometry.BLOCK_BOTTOM, 2), push),
        outputs=(
            hhr.ContactForce("force", 0, direction=(0.0, 0.0, -1.0), unit="N"),
            hhr.DisplacementAt("pole", (0.0, 0.0, 0.0), 2, geometry.BLOCK, unit="mm"),
            *(hhr.DisplacementAt(f"rise at {r}", (r, 0.0, 0.0), 2, geometry.BLOCK, unit="mm") for r in RINGS),
        ),
    )


def path(depth: float, *constants: float, loading: int = 16, unloading: int = 8) -> Path:
    """Down to a depth in mm and back, in small steps where contact changes fast.

    Args:
        depth: the largest.
        constants: (sy, H), and E where it is a parameter, in MPa.
        loading, unloading: steps.
    """
    down = (np.arange(loading + 1) / loading) ** 1.5
    up = 1 - (np.arange(1, unloading + 1) / unloading) ** 1.5
    shares = np.concatenate([down, up])
    return [(k / loading, np.array([depth * share, *constants])) for k, share in enumerate(shares)]


def pressures(full: hhr.FullOrderModel, history: History) -> list[dict[str, float]]:
    """Radius and mean pressure of a history without E among its parameters, by Tabor's numbers.

    The radius is that of an even pressure with the second moment of the one found, 2 F = a^2 / integral of p r^2:
    E* a / (sy R) is 2.5 where the block begins to yield, and from 30 on the mean pressure is some 2.8 to 3 sy.
    """
    distance = np.hypot(*full.problem.contact_points[:, :2].T)
    modulus = 1 / sum((1 - POISSON**2) / young for young in (SPHERE_E, BLOCK_E))
    rows = []
    for answer in history.answers:
        forces, (depth, yield_stress, hardening) = answer.forces(), answer.parameter
        if forces.sum() > 0:
            radius = np.sqrt(2 * forces @ distance**2 / forces.sum())
            rows.append({"depth": depth, "sy": yield_stress, "H": hardening, "force": 4 * forces.sum(),
                         "E* a / (sy R)": modulus * radius / (yield_stress * RADIUS),
                         "mean pressure / sy": 4 * forces.sum() / (np.pi * radius**2 * yield_stress)})  # fmt: skip
    return rows


def curve(model: Any, constants: np.ndarray, depth: float = DEPTH, gradient: bool = False) -> tuple[np.ndarray, ...]:
    """Forces along the path in N, (24,), and with ``gradient`` their derivatives by the constants, (24, constants)."""
    settings = hhr.MarchSettings(search=MARCH.search, gradient=gradient)
    found = [answer.outputs() for answer in model.march(path(depth, *constants), settings).answers]
    forces = np.array([item.values["force"] for item in found])
    return (forces, np.array([item.gradient["force"][1:] for item in found])) if gradient else (forces,)


def measured(model: Any, constants: np.ndarray, seed: int, depth: float = DEPTH) -> np.ndarray:
    """A curve with noise of a hundredth of its largest force, (24,)."""
    (forces,) = curve(model, constants, depth)
    return forces + NOISE * forces.max() * np.random.default_rng(seed).standard_normal(forces.size)


def fitted(model: Any, data: np.ndarray, start: np.ndarray, depth: float = DEPTH) -> np.ndarray:
    """Constants by least squares with the gradients of histories, each in parts of its range."""
    lower, upper = np.array(model.parameters.lower)[1:], np.array(model.parameters.upper)[1:]
    size, sides = NOISE * data.max(), upper - lower
    found = least_squares(
        lambda x: (curve(model, lower + x * sides, depth)[0] - data) / size,
        (start - lower) / sides,
        jac=lambda x: curve(model, lower + x * sides, depth, gradient=True)[1] * sides / size,
        bounds=(0.0, 1.0),
        xtol=1e-6,
    )
    return lower + found.x * sides


def posterior(
    model: Any, data: np.ndarray, start: np.ndarray, count: int, seed: int, depth: float = DEPTH
) -> np.ndarray:
    """Samples of a random walk (Metropolis) with even priors in the box, one history each, (count, constants)."""
    lower, upper = np.array(model.parameters.lower)[1:], np.array(model.parameters.upper)[1:]
    random, size = np.random.default_rng(seed), NOISE * data.max()
    forces, slopes = curve(model, start, depth, gradient=True)
    # steps as the posterior would be if the model were linear (Roberts, Gelman and Gilks 1997), and no prior wider
    # than the box: hardening hides behind the noise where the yield stress is free
    precision = slopes.T @ slopes / size**2 + np.diag(12 / (upper - lower) ** 2)
    steps = 2.4 / np.sqrt(start.size) * np.linalg.cholesky(np.linalg.inv(precision))
    here, value, samples = start, 0.5 * np.sum(((forces - data) / size) ** 2), np.empty((count, start.size))
    for k in range(count):
        there = here + steps @ random.standard_normal(start.size)
        if (lower < there).all() and (there < upper).all():
            other = 0.5 * np.sum(((curve(model, there, depth)[0] - data) / size) ** 2)
            if np.log(random.uniform()) < value - other:
                here, value = there, other
        samples[k] = here
    return samples


def main() -> None:
    """Indent soft and hard blocks in full, and compare with Tabor."""
    options = cli.parse_on_first_rank(cli.demo_parser("indentation", __doc__))
    full = hhr.FullOrderModel(scene(QUICK_CELLS if options.quick else CELLS))
    rows, imprints = [], []
    for constants in ((100.0, 0.0), (300.0, 0.0), (100.0, 3000.0)):
        history = full.march(path(DEPTH, *constants), MARCH)
        rows += pressures(full, history)[3:16:4]
        values = history.answers[-1].outputs().values
        imprints.append({"sy": constants[0], "H": constants[1], **values, "iterations": sum(history.iterations)})
    report.write_report({"scene": "indentation", "tabor": rows, "imprints": imprints}, options.out)
    report.print_rows("beside Tabor", rows, options.console)
    report.print_rows("after unloading", imprints, options.console)


if __name__ == "__main__":
    main()
