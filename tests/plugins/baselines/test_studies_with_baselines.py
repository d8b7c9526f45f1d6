"""A study compares what is registered as a baseline with the full order, and believes nobody's word."""

import hertz_half_discs as demo
import pytest
from mpi4py import MPI

import hhr_dolfinx as hhr
from hhr_dolfinx import registry
from hhr_dolfinx.plugins.baselines.naive import NaiveFullOrder


class Doubled(NaiveFullOrder):
    """A baseline whose forces and displacements are twice the exact ones."""

    def _answered(self, *asked):
        found = super()._answered(*asked)
        return found._replace(unknown=2 * found.unknown, multipliers=2 * found.multipliers)


def test_errors_and_times_of_each_baseline_are_reported(monkeypatch):
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
