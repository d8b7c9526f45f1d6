"""Histories of inelastic bodies: paths through corners, central differences, and the reduced model
that leaves nothing out.
"""

import dataclasses

import numpy as np
import pytest
from scenes import whole_domain

import hhr_dolfinx as hhr
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.plugins.inelastic.project import project_flow
from hhr_dolfinx.plugins.inelastic.reduction import FittedFlow
from hhr_dolfinx.reduction.completion import ReconstructionData
from hhr_dolfinx.reduction.projection import project


def whole_history(full, path, settings, field=1e-8, force=1e-6):
    """The full history beside that of the model that leaves nothing out, to the tolerance of the
    solver.

    It has a function for each free dof, on the whole domain.
    """
    exact, free, problem = (
        full.march(path, settings),
        np.flatnonzero(full.problem.free),
        full.problem,
    )
    basis = np.zeros((problem.free.size, free.size))
    basis[free, np.arange(free.size)] = 1.0
    sets = whole_domain(problem)
    flow = project_flow(full.equilibrium, basis, sets)
    snapshots = hhr.SnapshotSet.of_histories([exact])
    fields = ReconstructionData.of(problem, snapshots).reconstruction(problem, basis, sets)
    fields = dataclasses.replace(fields, flow=FittedFlow.of(snapshots).completion(flow))
    reduced = ReducedModel(project(problem, basis, sets), full.parameters, fields, flow=flow)
    for there, here in zip(exact.answers, reduced.march(path, settings).answers, strict=True):
        size = np.abs(there.unknown).max()
        assert reduced.fields.basis @ here.unknown == pytest.approx(there.unknown, abs=field * size)
        assert here.displacement() == pytest.approx(there.displacement(), abs=field * size)
        for forces in (here.multipliers, here.forces()):
            assert forces == pytest.approx(
                there.forces(), abs=force * max(there.forces().max(), 1.0)
            )
        for strain in (here.gauss.state.cumulated, here.plastic_strain()):
            assert strain == pytest.approx(there.plastic_strain(), abs=1e-9)
        assert np.array_equal(here.stress(), here.gauss.stress)
    return exact, reduced


def slopes_between(ends, step, values):
    """Central differences of values of histories, (steps, ...)."""
    ahead, behind = (np.array([values(answer) for answer in history.answers]) for history in ends)
    return (ahead - behind) / (2 * step)


def legs(*corners, steps=10):
    """Piecewise linear through corners (A, B), a second for each leg."""
    times = np.linspace(0, len(corners) - 1, (len(corners) - 1) * steps + 1)
    values = [
        np.interp(times, np.arange(len(corners)), [corner[k] for corner in corners]) for k in (0, 1)
    ]
    return list(zip(times, np.stack(values, axis=1), strict=True))
