"""Models shared by the tests; the scene is that of the demo."""

import dataclasses
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import hertz_half_discs as demo
import pytest

import hhr_dolfinx as hhr


@pytest.fixture(scope="session")
def hertz():
    """Full-order model of the half-discs."""
    return hhr.FullOrderModel(demo.scene())


@pytest.fixture(scope="session")
def hertz_snapshots(hertz):
    """The 31 training points of the thesis."""
    return hhr.compute_snapshots(hertz, hertz.problem.parameters.grid([31]))


@pytest.fixture(scope="session")
def hertz_reduction(hertz, hertz_snapshots):
    """The thesis' recipe, as it is: its forces outside the RID are up to 22 % wrong, which the trust check says."""
    return hhr.build_reduced_model(hertz, hertz_snapshots, dataclasses.replace(demo.THESIS, limits=None))
