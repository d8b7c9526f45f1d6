"""A rod whose pellet the gap alone cools: closed form, and the benchmark's full order."""

import dataclasses
import math

import heat_through_contacts as benchmark
import pytest

import hhr_dolfinx as hhr

MESH = {"radial_cells": 24, "axial_cells": 4, "cladding_radial_cells": 4}
RADIUS, THICKNESS = 4.1, 0.57


def test_the_middle_of_a_rod_is_as_hot_as_its_resistances_make_it():
    """Of a parabola, a gap of constant conductance, a tube and convection; a cell of a 24th of the
    radius leaves a thousandth of the parabola.
    """
    scene, heat = benchmark.fuel_rod(**MESH)
    model = hhr.condense_heat(scene, dataclasses.replace(heat, conductance={0: 0.5}))
    answer = model.solve({"q": 20.0, "P": 10.0, "gap": 0.05})
    power = 20e3 / (2 * math.pi)  # mW / mm, over a full turn of one radian
    outer = RADIUS + THICKNESS
    parts = (
        power / outer / 30.0,
        power * math.log(outer / RADIUS) / 17.0,
        power / RADIUS / 0.5,
        power / 2 / 3.0,
    )
    assert answer.temperature().max() == pytest.approx(300.0 + sum(parts), abs=2e-3 * parts[-1])
    assert answer.heat_through(0) == pytest.approx(20e3 * 7.0, rel=2e-4)  # the height


@pytest.mark.slow
@pytest.mark.parametrize("name", ["plane", "rod", "space"])
def test_it_is_the_coupled_full_order(name):
    scene, heat = {
        "plane": lambda: benchmark.blocks(2, 16),
        "rod": lambda: benchmark.fuel_rod(radial_cells=12, axial_cells=20),
        "space": lambda: benchmark.blocks(3, 5),
    }[name]()
    row = benchmark.compared(name, scene, heat, points=5, seed=2)
    assert max(row["off"].values()) <= benchmark.ALIKE
