"""Published benchmarks at small size, and bodies that only contact holds, as the demos have
them.
"""

from functools import partial

import held_by_contact
import numpy as np
import pytest
from mpi4py import MPI
from parts.held_by_contact_study import imbalance

import benchmarks
import hhr_dolfinx as hhr


def test_published_benchmarks():
    """Coarse meshes: cells of 0.3 mm, or of 0.6 of second order, on a half width of 6.2 leave 0.2
    %.
    """
    runs = (
        benchmarks.line_contact,
        partial(benchmarks.line_contact, order=2),
        benchmarks.ball,
        benchmarks.patch,
    )
    found = [row for run in runs for row in run(True)]
    rows = {(row["benchmark"], row["quantity"].split(" [")[0]): row["off"] for row in found}
    for name in ("CGS-1", "CGS-1, second order"):
        assert abs(rows[name, "half width"]) < 0.005 and abs(rows[name, "largest pressure"]) < 0.005
        assert abs(rows[name, "force"]) < 1e-12
    assert abs(rows["SSNV104", "pole pressure, own force"]) < 0.005
    # a ball under a given approach is stiffer than the half-space of the reference
    assert 0.03 < rows["SSNV104", "pole pressure, approach of 2 mm"] < 0.05
    assert abs(rows["SSNP121", "pressure furthest from the reference"]) < 1e-10


def test_orders_on_a_curved_surface():
    """Those of four-node cells in V6.03.150, 2.0 and 0.5.

    The first as meshes of 12 to 24 cells show it.
    """
    errors = np.array([benchmarks.rings(count) for count in (12, 24)])
    orders = np.log2(errors[0] / errors[1])
    assert orders[0] > 1.95 and orders[1] > 0.5


def test_orders_of_cells_of_second_order_on_a_curved_surface():
    """Those of eight-node cells in V6.03.150, 2.5 and 1.0."""
    for found in benchmarks.rates_of_second_order(True):
        assert found["found"] > found["reference"], found


@pytest.mark.parametrize(
    "scene", [held_by_contact.o_ring(0.2), held_by_contact.punch(12)], ids=lambda scene: scene.name
)
@pytest.mark.filterwarnings("ignore:.*no contact resists and no load drives")
def test_bodies_held_by_contact_are_in_balance_and_reduced_well(scene):
    training = hhr.train(scene, hhr.Sobol(64), comm=MPI.COMM_SELF, held_out=20)
    full, model = training.full_order, training.build()
    assert full.problem.kernel.motions.shape[1] == model.problem.motions == 2
    off = []
    for point in full.parameters.random(20, seed=5):
        assert max(imbalance(one, full, point) for one in (full, model)) < 1e-10
        exact = full.solve(point).forces()
        off.append(np.linalg.norm(model.solve(point).forces() - exact) / np.linalg.norm(exact))
    assert np.quantile(off, 0.95) < 0.03
