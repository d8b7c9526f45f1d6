"""Answers loaded in proportion: one rule cuts their increments in Python, on pages and in C."""

import dataclasses
import re
from functools import cache

import numpy as np
import pytest
from compiled_models import DONE, STEPPED, at, built, compiled
from mpi4py import MPI
from needs import needs
from pages_in_node import along, in_node
from sheared_blocks import rubbing

import hhr_dolfinx as hhr
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.plugins.contact_laws import increments

BLOCKS = 7
"""Contacts of the blocks below."""
# pages and C used to cut these otherwise: their errors were measured by the forces and the energy
# of increments that the path kept, and those of Python by all that were tried; forces were up to
# 1.4e-4 apart
NEAR = {
    7: (0.04963800609111786, -0.08819317817687988),
    11: (0.0370611846446991, -0.08725740909576417),
    14: (0.04349467754364014, 0.08306531906127931),
    19: (0.02985280277207494, -0.0401470422744751),
}
"""Random blocks, and points at which one of their increments is off by about as much as it may
be.
"""


@cache
def blocks():
    """Two blocks, condensed, and what is drawn of them."""
    full = hhr.FullOrderModel(
        dataclasses.replace(rubbing(0.5, cells=BLOCKS - 1), outputs=()), MPI.COMM_SELF
    )
    return hhr.condense(full), hhr.scenery_of(full)


def random_blocks(seed):
    """The same with a random compliance and random gaps, which each push and shear in a way of its
    own.
    """
    model, scenery = blocks()
    rng = np.random.default_rng(seed)
    given, friction, m = model.eliminated.responses, model.law, model.conditions
    root = rng.normal(size=(m, m))
    schur = root @ root.T / m + 0.3 * np.eye(m)
    slack = np.zeros((m, 3))
    gaps, bent, pressed = rng.random(BLOCKS), rng.normal(size=BLOCKS), rng.random(BLOCKS)
    slack[friction.normal] = np.column_stack([0.015 * gaps, 0.05 * bent, 1 + pressed])
    turned, aside = rng.normal(size=BLOCKS), rng.normal(size=BLOCKS)
    slack[friction.tangential] = np.column_stack(
        [np.zeros(BLOCKS), 0.5 + 0.1 * turned, 0.2 * aside]
    )
    responses = dataclasses.replace(given, schur=schur, free_slack=slack)
    changed = model.changed(eliminated=dataclasses.replace(model.eliminated, responses=responses))
    return changed, dataclasses.replace(scenery, compliance=schur.sum(axis=1))


def close(found, model, point):
    """Whether forces are those of Python to round-off: 1e-8 of the largest, where a cut more or
    less makes 1e-5.
    """
    exact = model.solve(point).multipliers
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-8 * np.abs(exact).max())


@needs("friction")
@in_node
@pytest.mark.parametrize("seed", NEAR)
def test_a_page_cuts_increments_where_python_does(seed):
    model, scenery = random_blocks(seed)
    point = np.array(NEAR[seed])
    (found,) = along(model, scenery, [[0.0, 0.0]], [point])["loaded"]
    shares = np.linspace(0.0, 1.0, increments.PROPORTIONAL + 1)
    settings = MarchSettings(time_tolerance=increments.INCREMENT_TOLERANCE, outside="ignore")
    history = model.follow([(float(share), share * point) for share in shares], settings)
    np.testing.assert_allclose(
        found["path"], [place for _, place in history.solved_path], rtol=0, atol=1e-15
    )
    close(found["forces"], model, point)


@needs("friction")
@compiled
@pytest.mark.parametrize("seed", NEAR)
def test_c_cuts_increments_where_python_does(seed, tmp_path):
    model, _ = random_blocks(seed)
    forces, outputs, point = np.zeros(model.conditions), np.zeros(1), np.array(NEAR[seed])
    assert built(tmp_path, model, STEPPED).begin(*at(point, forces, outputs)) == DONE
    close(forces, model, point)


@needs("friction")
def test_limits_of_cuts_are_those_of_python():
    """C has its own copy of them, for headers and pages."""
    from hhr_dolfinx.plugins.friction import slider
    from hhr_dolfinx.plugins.friction.page import PAGE

    header = PAGE.header.read_text(encoding="utf-8")
    expected = {
        "FEWEST": increments.PROPORTIONAL,
        "CUTS": increments.CUTS,
        "HALVED": MarchSettings().cuts,
        "SETTLED": increments.INCREMENT_TOLERANCE,
        "WORK": slider.WORK,
        "APART": slider.OPEN_GAP,
    }
    for name, value in expected.items():
        assert float(re.search(rf"#define MODEL_{name}(?:_LEAST)? ([\d.e-]+)", header)[1]) == value
