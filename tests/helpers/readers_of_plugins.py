"""What plug-ins do with a model, for tests of those that they refuse: each is a function of a full
model and a folder.
"""

from mpi4py import MPI
from scenes import pressed_pair
from toy_system import Foundation

import hhr_dolfinx as hhr


def scene(**others):
    given = {"outputs": (hhr.ContactForce("force", 0, (0.0, 1.0)),), "system": Foundation} | others
    return pressed_pair(
        "plane_strain", ((3.0, 0.3), (4.0, 0.3)), {"k": (0.0, 20.0)}, cells=4, **given
    )


def training():
    return hhr.train(scene(), hhr.Sobol(8), held_out=2, comm=MPI.COMM_SELF)


def deck(full, path):
    from hhr_dolfinx.plugins.exporters.deck import write_deck

    write_deck(path / "deck.inp", full.discretisation, full.parameters.middle)


def naive(full):
    from hhr_dolfinx.plugins.baselines.naive import NaiveFullOrder

    return NaiveFullOrder(full)


OF_PLUGINS = {
    "local": lambda full, path: training().local(),
    "fallback": lambda full, path: training().safe_model(0.1),
    "one_call": lambda full, path: hhr.reduce(scene(), 0.1, comm=MPI.COMM_SELF),
    "sliding": lambda full, path: hhr.slide(scene(matching=False, openings=(), outputs=())),
    "greedy": lambda full, path: hhr.train(scene(), hhr.Greedy(), comm=MPI.COMM_SELF),
    "studies": lambda full, path: hhr.study_scene(
        full.scene, hhr.StudySettings(training=hhr.Sobol(8)), path
    ),
    "baselines": lambda full, path: naive(full).solve(full.problem.middle),
    "checks": lambda full, path: hhr.mesh_error(full, full.solve(full.problem.middle)),
    "stress": lambda full, path: hhr.FullOrderModel(scene(outputs=(hhr.ElasticEnergy("energy"),))),
}
"""Readers of plug-ins."""
