"""Pellet and cladding: geometry, the pressure on a part of a line, the recipes, the demo."""

import dataclasses
from copy import copy

import numpy as np
import pellet_cladding as demo
import pytest
from needs import needs
from scenes import check_contact_conditions, references_at, slope
from scipy.sparse import csc_matrix, issparse

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.trust import TrustLimits
from hhr_dolfinx.errors import SceneWarning, StabilityWarning, UnstableModelError
from hhr_dolfinx.geometries import pellet_cladding as geometry


@pytest.fixture(scope="module")
def small():
    """The scene on 280 cells."""
    return hhr.FullOrderModel(demo.scene(**demo.QUICK_MESH))


@pytest.fixture(scope="module")
def small_snapshots(small):
    return hhr.compute_snapshots(small, small.problem.parameters.grid([25, 20]))


@pytest.fixture(scope="module")
def held_out(small):
    return hhr.compute_snapshots(small, small.problem.parameters.random(20, 9))


def test_sizes_of_the_thesis():
    """Section 1.5.2: 6161 + 909 nodes, 101 pairs; and 61 conditions below the pellet."""
    problem = hhr.FullOrderModel(demo.scene()).problem
    assert problem.free.size == 14140 and len(problem.cell_nodes) == 6800
    assert np.bincount(problem.contact_pairs).tolist() == [101, 61]


def test_whole_coverage_is_the_plain_pressure(small):
    scene = demo.scene(**demo.QUICK_MESH)
    plain = hhr.Pressure(geometry.CLADDING_OUTER, slope("P1"))
    tall = hhr.ParameterSpace(("P1", "h1"), (5.0, 0.6), (200.0, 7.0))
    with pytest.warns(SceneWarning, match=r"parameters \('h1',\) .* have no effect"):
        problem = hhr.FullOrderModel(
            dataclasses.replace(scene, loads=(plain,), parameters=tall)
        ).problem
    reference = problem.loads @ problem.amplitudes(np.array([100.0, 7.0]))
    partial = small.problem.loads @ small.problem.amplitudes(np.array([100.0, 7.0]))
    assert partial == pytest.approx(reference, abs=1e-9 * np.abs(reference).max())


def test_pellet_may_lift_off_or_not(small):
    """The pellet is squeezed and stands on its support, so both bottoms give the same side
    forces.
    """
    point = (170.0, 3.2)
    lifting, fixed = (
        small.solve(point),
        hhr.FullOrderModel(demo.scene("held", **demo.QUICK_MESH)).solve(point),
    )
    above, below = np.split(lifting.forces(), [21])
    assert above == pytest.approx(fixed.forces(), rel=1e-8, abs=1e-8 * fixed.forces().max())
    assert below.min() > 0
    check_contact_conditions(small.problem, lifting.displacement(), lifting.forces(), point)


@needs("studies")
def test_default_recipe(small, small_snapshots, held_out):
    """Measured on 280 cells: 1e-6 median, 4e-4 at worst; the full mesh is checked by the demo."""
    model = hhr.build(small, small_snapshots, held_out=held_out)
    points = small.problem.parameters.random(40, 3)
    errors = references_at(points, small, small_snapshots).errors(model)
    assert errors.values["dual_full_floored"].max() < 0.01
    assert errors.values["primal_l2"].max() < 0.005
    assert errors.unanswered == 0 and not any(model.solve(point).cycled for point in points)


def test_dual_deim_and_layers_extend_the_rid(small, small_snapshots):
    plain = hhr.Recipe.thesis(1e-4, domain=hhr.Rid(0, 1), trust=None)
    more = {"nodes": (hhr.Deim(), hhr.ForceDeim(1e-4), hhr.LoadNodes())}
    sizes = []
    for changes in ({}, more, {**more, "domain": hhr.Rid(1, 1)}):
        reduction = hhr.build(small, small_snapshots, dataclasses.replace(plain, **changes)).offline
        sizes.append((len(reduction.sets.A_lambda), len(reduction.sets.cells)))
    assert sizes[0] < sizes[1] < sizes[2]


def test_extended_pod_keeps_the_rid(small, small_snapshots):
    nodes = (hhr.Deim(hhr.Pod(1e-5)), hhr.ForceDeim(1e-3), hhr.LoadNodes())
    recipe = hhr.Recipe.thesis(1e-5, nodes=nodes, trust=None)
    first = hhr.build(small, small_snapshots, recipe).offline
    second = hhr.build(
        small, small_snapshots, dataclasses.replace(recipe, basis=hhr.Pod(1e-6))
    ).offline
    assert np.array_equal(first.sets.cells, second.sets.cells)
    modes = [r.basis.shape[1] - len(r.enrichment.added) for r in (first, second)]
    assert modes[0] < modes[1]


def test_trust_check_grows_the_rid_or_refuses(small, small_snapshots):
    """A limit that only a larger RID meets: the model grows and says what was refused on the
    way.
    """
    base = hhr.Recipe.thesis(1e-8, nodes=(hhr.Deim(), hhr.ForceDeim(1e-4), hhr.LoadNodes()))
    conditions = []
    for layers in (0, 3):
        recipe = dataclasses.replace(base, domain=hhr.Rid(layers, layers), trust=None)
        conditions.append(hhr.build(small, small_snapshots, recipe).offline.stability.cond_K)
    assert conditions[1] < conditions[0]
    loose = dict.fromkeys(
        ("refuse_primal", "refuse_dual", "warn_primal", "warn_dual", "warn_worst"), np.inf
    )
    quiet = {"warn_cond_K": np.inf, "warn_definite": -np.inf, **loose}
    between = TrustLimits(
        refuse_cond_K=np.sqrt(conditions[0] * conditions[1]), refuse_distortion=0.0, **quiet
    )
    grown = hhr.build(
        small, small_snapshots, dataclasses.replace(base, trust=between, domain=hhr.Rid(0, 3))
    ).offline
    assert grown.log.refused and grown.log.refused[0]["layers"] == 0 < grown.layers
    assert "cond(K~)" in grown.log.refused[0]["why"]
    with pytest.raises(UnstableModelError, match="add RID layers"):
        hhr.build(small, small_snapshots, dataclasses.replace(base, trust=between))


def test_held_out_solutions_refuse_what_constants_let_pass(small, small_snapshots, held_out):
    """Two snapshots give a small, well-conditioned model with errors of hundreds of per cent."""
    poor = small_snapshots.take([0, -1])
    hhr.build(small, poor)
    with pytest.raises(UnstableModelError, match="solutions compared"):
        hhr.build(small, poor, held_out=held_out)
    with pytest.warns(StabilityWarning, match="solutions compared"):
        hhr.build(
            small, poor, hhr.Recipe(trust=TrustLimits(refuse_primal=1e9, refuse_dual=1e9)), held_out
        )


def test_every_change_of_the_problem_gives_other_snapshots(small, tmp_path):
    """Small numbers beside large ones count too: a force of 0.1 beside 1e11, a gap beside a unit
    lift.
    """
    point, store = np.array([100.0, 3.0]), hhr.SnapshotStore(tmp_path, small)
    store.save(small.solve(point))
    for owner, name in ((None, "forces"), (None, "gaps"), ("prolongation", "lifts")):
        changed = small.problem if owner is None else getattr(small.problem, owner)
        value = getattr(changed, name)
        change = csc_matrix(
            ([1e-9], ([value.shape[0] - 1], [value.shape[1] - 1])), shape=value.shape
        )
        value = value + (change if issparse(value) else change.toarray())
        changed = dataclasses.replace(changed, **{name: value})
        other = copy(small)
        other.problem = (
            changed if owner is None else dataclasses.replace(small.problem, **{owner: changed})
        )
        assert hhr.SnapshotStore(tmp_path, other).load(point) is None
    assert store.load(point) is not None
