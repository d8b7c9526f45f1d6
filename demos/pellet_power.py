"""Power history of a fuel rod: a pellet with a temperature field swells, creeps, and presses its
cladding.

Half a pellet in its cladding, axisymmetric. The temperature is a parabola over the radius, by
power: hot inside, where the pellet creeps, cold outside, where it hardly does. It swells with
burn-up, closes the gap, and presses the cladding, which creeps and yields under the coolant. After
months at power come a ramp, a hold of hours, and a shutdown.

    T(r) = T_s + t q (1 - r²/R²),    dp/dt = (q_eq / K)^n exp(-A (1/T - 1/T0)),    pellet
    yield at σ0 + H p, dp/dt = (q_eq / K)^n below it,    cladding
    ε = ε_e + ε_p + (α (T - T_0) + s b) I,    B u <= g,  λ >= 0,  λ·(B u - g) = 0

What to see: creep of cladding and pellet relaxes the contact within weeks; a ramp adds to it at
once. One small model answers each history, whatever its powers, durations and gap.

    python demos/pellet_power.py [--out DIR] [--quick] [--seed N]
"""

from pathlib import Path
from typing import Any

import numpy as np

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import pellet_cladding as geometry
from hhr_dolfinx.timing import timed

QUICK_MESH = {"radial_cells": 10, "axial_cells": 14, "cladding_radial_cells": 2}
RADIUS, CONDUCTIVITY, ROOM, HOUR, DAY = 4.1, 3.0, 293.0, 3600.0, 86400.0
SURFACE = "(320 + 3 * q)"
"""Temperature of the pellet's surface above that of the room, in K; q in kW/m."""
RISE = f"(1e3 * q / (4 * pi * {CONDUCTIVITY}))"
"""Temperature of its axis above that of its surface, in K."""
HOT = f"{ROOM} + {SURFACE} + {RISE} * (1 - (r / {RADIUS})**2)"
SWELLING = 7e-4
"""Linear strain of swelling per 10 MWd/kg."""
BURNING = 1.3e-4
"""Burn-up in 10 MWd/kg of a day at 1 kW/m, with 0.77 kg of fuel per metre."""
BOX = {"q": (0.0, 42.0), "burnup": (0.0, 4.0), "gap": (0.0, 0.03)}


def scene(**mesh_options: Any) -> hhr.Scene:
    """The scene in mm, MPa, K, s and kW/m; ``mesh_options`` go to
    :func:`geometry.pellet_cladding`.
    """
    fuel = hhr.Arrhenius(2500.0, 4.0, 4e4, HOT, 1600.0)
    tube = hhr.PlasticityWithCreep(350.0, 2000.0, 9e3, 4.0)
    held = (geometry.PELLET_BOTTOM, geometry.CLADDING_BOTTOM, geometry.CLADDING_TOP)
    grown = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    return hhr.Scene(
        name="pellet_power",
        geometry=lambda comm: geometry.pellet_cladding(comm, radius=RADIUS, **mesh_options),
        hypothesis="axisymmetric",
        bodies=(
            hhr.Body(geometry.PELLET, 180e3, 0.3, fuel),
            hhr.Body(geometry.CLADDING, 80e3, 0.35, tube),
        ),
        contacts=(
            hhr.NodeToNode(geometry.PELLET_SIDE, geometry.CLADDING_INNER, normal=(1.0, 0.0)),
        ),
        parameters=hhr.ParameterSpace(tuple(BOX), *zip(*BOX.values(), strict=True)),
        displacements=(
            hhr.Displacement(geometry.PELLET_AXIS, component=0),
            *(hhr.Displacement(tag, component=1) for tag in held),
        ),
        loads=(
            hhr.ThermalExpansion(geometry.PELLET, 1e-5, SURFACE),
            hhr.ThermalExpansion(
                geometry.PELLET, 1e-5, RISE, field=lambda x: 1 - (x[0] / RADIUS) ** 2
            ),
            hhr.Eigenstrain(geometry.PELLET, hhr.Amplitude(slopes={"burnup": SWELLING}), grown),
            hhr.Pressure(geometry.CLADDING_OUTER, 15.0),
        ),
        openings=(hhr.Opening(0, hhr.Amplitude(slopes={"gap": 1.0})),),
        outputs=(hhr.ContactForce("force on the cladding", 0, (1.0, 0.0), unit="N"),),
        units=hhr.Units("mm", "MPa"),
    )


def powers(space: hhr.ParameterSpace) -> hhr.PathFamily:
    """Up, months at power in ever longer steps while the pellet burns, a ramp, a hold of hours, and
    a shutdown.
    """
    own = hhr.ParameterSpace(
        ("base", "top", "log_days", "log_hours", "gap"),
        (15.0, 28.0, 1.5, -0.5, 0.0),
        (25.0, 40.0, 3.0, 1.5, 0.02),
    )
    start = {"q": 0.0, "burnup": 0.0, "gap": "gap"}
    burn = tuple(
        hhr.Leg(
            {"burnup": f"{share} * 10**log_days * base * {BURNING}"},
            f"{step} * 10**log_days * {DAY}",
            8,
        )
        for share, step in ((0.01, 0.01), (0.1, 0.09), (1.0, 0.9))
    )
    hold = tuple(hhr.Leg({}, f"{share} * 10**log_hours * {HOUR}", 5) for share in (0.02, 0.2, 0.78))
    ramp = hhr.Leg({"q": "top"}, 2 * HOUR, 10)
    legs = (
        hhr.Leg({"q": "base"}, 10 * HOUR, 12),
        *burn,
        ramp,
        *hold,
        hhr.Leg({"q": 0.0}, HOUR, 10),
    )
    return hhr.PathFamily("burn, ramp, shut down", space, own, start, legs)


def forces_of(history: Any) -> np.ndarray:
    """Force between pellet and cladding along a history, in N."""
    return np.array([abs(answer.outputs()["force on the cladding"]) for answer in history.answers])


def drawn(model: Any, family: hhr.PathFamily, file: Path) -> None:
    """The force over the steps of histories that differ in the power of the ramp only."""
    from hhr_dolfinx.plugins.studies.plots import plot_curves

    lines = {}
    for top in (28.0, 34.0, 40.0):
        found = forces_of(model.march(family.path((20.0, top, 2.6, 1.0, 0.01)))) / 1e3
        lines[f"ramp to {top:g} kW/m"] = np.arange(1, found.size + 1), found
    plot_curves(
        lines,
        file,
        ("increment: power up, 400 days, ramp, 10 hours, shutdown", "force on the cladding [kN]"),
    )


def main() -> None:
    """Train on few histories, compare with the full order on others, draw."""
    from parts import cli

    options = cli.parse_on_first_rank(cli.demo_parser("pellet_power", __doc__))
    made = scene(**(QUICK_MESH if options.quick else {}))
    family = powers(made.parameters)
    (path, *held_out) = family.paths(hhr.Sobol(2 if options.quick else 9, seed=options.seed + 1))
    training = hhr.train(made, family.training(6 if options.quick else 24), held_out=held_out,
                         progress=options.progress)  # fmt: skip
    model, condensing = timed(training.condense)
    hhr.save_model(options.out / "model.npz", model)
    model.march(path)  # the first march of an installation compiles
    full, seconds = timed(lambda: training.full_order.march(path))
    small, quick = timed(lambda: model.march(path))
    forces = [forces_of(history) for history in (full, small)]
    rows = {
        "history": path.name,
        "largest force [N]": forces[0].max(),
        "largest error of the small model [N]": np.abs(forces[1] - forces[0]).max(),
        "cumulated inelastic strain": full.answers[-1].plastic_strain().max(),
        "full order [s]": seconds,
        "small model [s]": quick,
        "times as fast": seconds / quick,
    }
    drawn(model, family, options.out / "power.png")
    assert all(np.isfinite(value) for value in rows.values() if not isinstance(value, str))
    cli.report_of_histories(made.name, "power", rows, condensing, options)


if __name__ == "__main__":
    main()
