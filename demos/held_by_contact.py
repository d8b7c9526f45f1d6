"""Bodies that nothing but contact holds: an O-ring in its groove under a lid, and a punch on a block.

The rigid motions of such bodies are unknowns beside the contact forces. A lid is pressed by a force on an O-ring, which
lies in a rigid groove and moves outwards as far as the wall; a punch is pressed and tilted by forces alone.

What to see: forces balance to round-off, in full and in reduced models, though no displacement is imposed on these
bodies; reduced forces are right to a fraction of a per cent at points that were not trained on.

    python demos/held_by_contact.py [--out DIR] [--quick] [--seed N]
"""

import warnings
from typing import Any

import numpy as np
from mpi4py import MPI
from parts.o_ring import o_ring_and_lid

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import summary
from hhr_dolfinx.errors import SceneWarning
from hhr_dolfinx.geometries import stacked_blocks as blocks
from hhr_dolfinx.geometries.two_blocks import side
from hhr_dolfinx.study import cli, report
from hhr_dolfinx.study.measure import References
from hhr_dolfinx.timing import time_queries


def o_ring(fine: float = 0.06) -> hhr.Scene:
    """A ring of rubber, 4 mm thick, in a groove of 20 mm; lid of steel; mm and MPa."""
    return hhr.Scene(
        name="o_ring",
        geometry=lambda comm: o_ring_and_lid(comm, fine=fine),
        hypothesis="axisymmetric",
        bodies=(hhr.Body("ring", 8.0, 0.49), hhr.Body("lid", 210e3, 0.3)),
        contacts=(
            hhr.NodeToSurface("top", "lid_face"),
            hhr.Obstacle("bottom", normal=(0.0, -1.0), offset=0.0),
            hhr.Obstacle("outside", normal=(1.0, 0.0), offset=22.02),
        ),
        displacements=(),
        loads=(hhr.Pressure("lid_top", hhr.Amplitude(slopes={"pressure": 1.0})),),
        openings=(hhr.Opening(2, hhr.Amplitude(slopes={"play": 1.0})),),
        parameters=hhr.ParameterSpace(("pressure", "play"), (0.02, 0.0), (0.3, 0.1)),
        units=hhr.Units("mm", "MPa"),
    )


def punch(cells: int = 24) -> hhr.Scene:
    """A crowned block on another one, pressed down on its top and on its side."""
    upper, counts = blocks.UPPER, (cells, cells // 2)
    return hhr.Scene(
        name="punch",
        geometry=lambda comm: blocks.stacked_blocks(comm, lower=counts, upper=counts, bulge=0.02),
        hypothesis="plane_strain",
        bodies=(hhr.Body(blocks.LOWER, 1000.0, 0.3), hhr.Body(upper, 3000.0, 0.3)),
        contacts=(hhr.NodeToNode(blocks.interface(blocks.LOWER, 2), blocks.interface(upper, 2), (0.0, 1.0)),),
        displacements=hhr.Displacement.clamp(blocks.outer_end(blocks.LOWER, 2), 2),
        loads=(
            hhr.Traction(blocks.outer_end(upper, 2), (0.0, -1.0), hhr.Amplitude(slopes={"force": 1.0})),
            hhr.Traction(side(upper, 0, False), (0.0, -1.0), hhr.Amplitude(slopes={"aside": 1.0})),
        ),
        parameters=hhr.ParameterSpace(("force", "aside"), (2.0, 0.0), (30.0, 0.5)),
    )


def imbalance(model: Any, full: hhr.FullOrderModel, point: np.ndarray) -> float:
    """Largest resultant of forces and loads along the motions that only contact holds, over that of the forces."""
    problem = full.problem
    acting = (problem.contact @ problem.rigid).T
    forces = model.solve(point).forces()
    left = problem.rigid.T @ (problem.loads @ problem.amplitudes(point)) - acting @ forces
    return float(np.abs(left).max() / (np.abs(acting) @ forces).max())


def measured(scene: hhr.Scene, options: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Train, build, compare at random points: for the report, and a line of the table."""
    with warnings.catch_warnings():
        # a punch without friction may slide, and nothing drives it to
        warnings.filterwarnings("ignore", ".*no contact resists and no load drives", SceneWarning)
        training = hhr.train(scene, hhr.Sobol(64 if options.quick else 256), comm=MPI.COMM_SELF,
                             progress=options.progress, folder=options.out / f"snapshots_{scene.name}")  # fmt: skip
        model = training.build()
    full = training.full_order
    points = full.parameters.random(20 if options.quick else 200, options.seed + 7)
    references = References.at(points, full, training.snapshots, options.progress(f"{scene.name}, test points"))
    errors = references.errors(model).summaries()
    fresh = full.parameters.random(15 if options.quick else 105, options.seed + 1000)
    known = training.snapshots.known_statuses()
    times = time_queries({"fom_best": lambda point: full.solve(point, start=known.active[known.nearest(point)]),
                          "online": model.solve}, fresh)  # fmt: skip
    medians = {name: float(np.median(values)) for name, values in times.items()}
    balance = {name: max(imbalance(one, full, point) for point in points)
               for name, one in (("full", full), ("reduced", model))}  # fmt: skip
    hhr.save_model(options.out / f"{scene.name}.npz", model)
    found = {"errors": errors, "times": {name: summary(values) for name, values in times.items()}, "balance": balance,
             "motions": model.problem.motions, "ell_bar": len(model.problem.stiffness),
             "N_lambda_C": len(model.fields.A_lambda)}  # fmt: skip
    forces = errors["dual_full_floored"]
    row = {
        "scene": scene.name,
        "unknowns": len(full.problem.free),
        "contacts": len(full.schur),
        "modes": found["ell_bar"],
        "motions": found["motions"],
        "forces p95": forces["p95"],
        "worst": forces["max"],
        "imbalance, full": balance["full"],
        "reduced": balance["reduced"],
        "x full": medians["fom_best"] / medians["online"],
    }
    return found, row


def main() -> None:
    """Both scenes; print the table, write ``report.json`` and the models."""
    options = cli.parse_on_first_rank(cli.demo_parser("held_by_contact", __doc__))
    found: dict[str, Any] = {"scene": "held_by_contact", "seed": options.seed, "scenes": {}, **report.environment()}
    rows = []
    for scene in (o_ring(0.15), punch(12)) if options.quick else (o_ring(), punch()):
        found["scenes"][scene.name], row = measured(scene, options)
        rows.append(row)
    report.write_report(found, options.out)
    report.print_rows("held by contact alone", rows, options.console)


if __name__ == "__main__":
    main()
