"""The naive full order answers as the full order does, by another solver, and refuses what it does
not solve.
"""

import dataclasses

import contract
import flowing
import hertz_half_discs as demo
import pytest
from mpi4py import MPI
from needs import cases_of, needs
from scenes import Twice, pressed_block, pressed_pair
from varying_moduli import BODIES, MATERIALS, MESHES, check_same

import hhr_dolfinx as hhr
from hhr_dolfinx import registry
from hhr_dolfinx.errors import NotSolvableError, SceneError
from hhr_dolfinx.plugins.baselines.naive import NaiveFullOrder


@pytest.mark.parametrize("mu", [0.15, 0.2345, 0.45])
def test_half_discs(hertz, mu):
    check_same(NaiveFullOrder(hertz).solve(mu), hertz.solve(mu), 1e-11)


@pytest.mark.parametrize("hypothesis", cases_of(MESHES))
def test_elasticity_that_depends_on_parameters(hypothesis):
    full = hhr.FullOrderModel(pressed_pair(hypothesis, BODIES, MATERIALS, **MESHES[hypothesis]))
    for point in full.parameters.random(2, 0):
        check_same(NaiveFullOrder(full).solve(point), full.solve(point), 1e-11)


@needs("shapes")
def test_shapes_that_depend_on_parameters():
    scene = contract.blocks(
        ("E1", 0.3), box=contract.MODULI | contract.SHAPE, shapes=(contract.crowned(),)
    )
    full, point = hhr.FullOrderModel(scene), [0.03, 0.05, 2.0, 0.015]
    check_same(NaiveFullOrder(full).solve(point), full.solve(point), 1e-11)


def test_a_pair_listed_twice_is_named():
    scene = pressed_block("plane_strain")
    full = hhr.FullOrderModel(dataclasses.replace(scene, contacts=(Twice(scene.contacts[0]),)))
    with pytest.raises(NotSolvableError, match="list each contact pair once"):
        NaiveFullOrder(full).solve(0.05)


@needs("inelastic", "nonmatching")
def test_inelastic_bodies_are_refused():
    with pytest.raises(SceneError, match="flow"):
        NaiveFullOrder(flowing.flowing_full())


class Doubled(NaiveFullOrder):
    """A baseline whose forces and displacements are twice the exact ones."""

    def _answered(self, *asked):
        found = super()._answered(*asked)
        return found._replace(unknown=2 * found.unknown, multipliers=2 * found.multipliers)


@needs("studies")
def test_errors_and_times_of_each_baseline_are_reported(monkeypatch):
    """A study compares what is registered with the full order, and believes nobody's word."""
    places = {
        "fom_naive": ("hhr_dolfinx.plugins.baselines.naive:NaiveFullOrder", "baselines"),
        "doubled": (f"{__name__}:Doubled", "any"),
    }
    monkeypatch.setattr(registry, "parts", lambda kind: places)
    training = hhr.train(demo.scene(), (7,), held_out=0, comm=MPI.COMM_SELF)
    settings = hhr.StudySettings((7,), recipe=demo.THESIS.as_it_is(), tests=3, queries=6)
    report = hhr.run_study(training, settings).report
    rows = {row["method"]: row for row in report["work_precision"]}
    assert rows["fom_naive"]["dual_full_floored_max"] < 1e-9
    assert rows["doubled"]["dual_full_floored_max"] == pytest.approx(1.0, rel=1e-6)
    for name in places:
        assert report["times"][name]["median"] > 0 and report["ratios"][f"{name}/online"] > 0
