"""Solved cases that are compared by the factors of the full model, which are made anyway."""

from dataclasses import replace

import numpy as np
import pytest
from foreign_formats import FLANK, FLOOR, TOP, foreign_scene, own_block, own_scene
from foreign_lies import BY_CASE, matrix_of
from needs import needs
from scipy.optimize import nnls
from scipy.sparse import csr_matrix

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotSolvableError, SceneError
from hhr_dolfinx.plugins.foreign import case

pytestmark = needs("nonmatching")

DIFFERS = r"differ from those by its K by .* most at node \d+ in direction [123]"


def held_as_the_scene(block, *tags):
    """The block with a case whose supports are those of the scene, solved here."""
    nodes = np.unique(np.concatenate([block.nodes.surfaces[str(tag)].members for tag in tags]))
    labels = block.nodes.labels
    known = block.stiffness
    held = {(int(label), direction) for label in labels[nodes] for direction in (1, 2, 3)}
    names = list(zip(known.nodes.tolist(), known.directions.tolist(), strict=True))
    free = np.array([name not in held for name in names])
    # each body is loaded, whatever the numbers of its nodes
    order = [*block.case.forces, *labels.tolist()]  # lies are told beside the first one
    load = {label: (1.0, 0.5, -0.2) for label in order if label not in labels[nodes]}
    forces = np.array([load.get(label, (0.0, 0.0, 0.0))[k - 1] for label, k in names])
    moved = np.zeros(len(names))
    moved[free] = np.linalg.solve(known.matrix.toarray()[np.ix_(free, free)], forces[free])
    values = dict(zip(names, moved.tolist(), strict=True))
    found = {int(label): tuple(values[label, k] for k in (1, 2, 3)) for label in labels}
    return replace(block, case=hhr.SolvedCase(load, found, held))


@pytest.fixture(scope="module")
def own():
    """Our block, whose case is held where the scene holds it."""
    return held_as_the_scene(own_block(), FLOOR, FLANK)


@pytest.fixture
def own_factors(monkeypatch):
    """Names of the blocks whose K was factored for the comparison alone."""
    names = []
    factored = case.factored

    def counted(matrix, free, name):
        names.append(name)
        return factored(matrix, free, name)

    monkeypatch.setattr(case, "factored", counted)
    return names


def test_equal_supports_need_no_factors_of_their_own(own, own_factors):
    block = replace(own)
    full = hhr.FullOrderModel(foreign_scene(block))
    assert own_factors == []
    ours = hhr.FullOrderModel(own_scene()).outputs((10.0, 0.2))["force"]
    assert full.outputs((10.0, 0.2))["force"] == pytest.approx(ours, rel=1e-10)
    _ = block.placed  # asked for alone it is compared by its own factors
    assert own_factors == ["part"]


def test_other_supports_are_compared_by_own_factors(own, own_factors):
    """The scene holds the top along x too, which the case leaves free."""
    clamped = (*hhr.Displacement.clamp(FLOOR, 3), *hhr.Displacement.clamp(FLANK, 3))
    held = (*clamped, hhr.Displacement(TOP, 0))
    hhr.FullOrderModel(foreign_scene(replace(own), displacements=held))
    assert own_factors == ["part"]


@pytest.mark.parametrize("name", BY_CASE)
def test_a_lie_is_refused_by_a_full_model(own, name):
    lie = replace(own, stiffness=BY_CASE[name](own))
    with pytest.raises((SceneError, NotSolvableError)):
        hhr.FullOrderModel(foreign_scene(lie))


@pytest.mark.parametrize("times", [1000.0, 1.001])
def test_a_difference_is_found_by_the_factors_of_the_model(own, own_factors, times):
    lie = replace(own, stiffness=matrix_of(own, times * own.stiffness.matrix))
    with pytest.raises(SceneError, match=DIFFERS):
        hhr.FullOrderModel(foreign_scene(lie))
    assert own_factors == []


@pytest.mark.parametrize("factor", [2.0, "push / 5.0"])
def test_the_factor_of_a_block_is_not_compared(own, own_factors, factor):
    """The case is one of the K of the file, which the scene multiplies."""
    hhr.FullOrderModel(foreign_scene(replace(own, factor=factor)))
    assert own_factors == []


def test_each_of_several_blocks_is_compared(own_factors):
    lower, upper = (
        held_as_the_scene(block, tag)
        for block, tag in zip(hhr.blocks_of_scene(own_scene()), (FLOOR, FLANK), strict=True)
    )
    own_factors.clear()
    hhr.FullOrderModel(foreign_scene(replace(lower), replace(upper)))
    assert own_factors == []
    wrong = replace(upper, stiffness=matrix_of(upper, 1.01 * upper.stiffness.matrix))
    with pytest.raises(SceneError, match=f"block '{upper.name}'.* {DIFFERS}"):
        hhr.FullOrderModel(foreign_scene(replace(lower), wrong))


def test_a_singular_block_is_named(own):
    """A node that nothing holds any more, but that has a stiffness along its directions."""
    matrix = own.stiffness.matrix.tolil()
    loaded = np.flatnonzero(own.stiffness.nodes == next(iter(own.case.forces)))
    first, second = loaded[:2]
    matrix[first] = 0.0
    matrix[:, first] = 0.0
    matrix[second] = 0.0
    matrix[:, second] = 0.0
    for row in (first, second):
        for column in (first, second):
            matrix[row, column] = 1e5
    lie = replace(own, stiffness=matrix_of(own, matrix))
    with pytest.raises(NotSolvableError, match="the K of block 'part' is singular with the supp"):
        hhr.FullOrderModel(foreign_scene(lie))


@needs("scene_checks")
def test_a_check_of_a_scene_compares_too(own, own_factors):
    """It makes no factors of a full model."""
    from hhr_dolfinx.plugins.scene_checks.check import check_scene

    lie = replace(own, stiffness=matrix_of(own, 1.01 * own.stiffness.matrix))
    found = check_scene(foreign_scene(lie))
    assert any("differ from those by its K" in str(mistake) for mistake in found.mistakes)
    assert own_factors == ["part"]


@pytest.mark.parametrize("edges", [False, True])
def test_a_stiffness_of_one_direction_is_a_membrane(edges):
    """K of deflections alone, its clamped edges left out or there: no motion in its plane moves a
    dof, and none is free.
    """
    cells, share = 6, 1 / 36
    count = cells + 1
    steps = np.diff(np.eye(count), axis=0)
    along, beside = steps.T @ steps, np.diag([0.5, *np.ones(cells - 1), 0.5])
    stiffness = np.kron(beside, along) + np.kron(along, beside)
    line = np.linspace(0, 1, count)
    x, y = (side.ravel() for side in np.meshgrid(line, line, indexing="ij"))
    inside = (np.minimum(x, y) > 0) & (np.maximum(x, y) < 1)
    labels = np.arange(1, count**2 + 1)
    own = stiffness[np.ix_(inside, inside)]
    deflection = np.linalg.solve(own, np.full(inside.sum(), share))
    there = np.ones_like(inside) if edges else inside
    kept = labels[there]
    matrix = csr_matrix(stiffness[np.ix_(there, there)])
    block = hhr.ForeignBlock(
        hhr.ForeignMatrix(matrix, kept, np.full(len(kept), 3), "membrane"),
        hhr.ForeignNodes(
            kept,
            np.column_stack([x, y, 0 * x])[there],
            sets={"INSIDE": np.flatnonzero(inside[there]), "EDGE": np.flatnonzero(~inside[there])},
        ),
        case=hhr.SolvedCase(
            {int(label): (0.0, 0.0, share) for label in labels[inside]},
            {int(labels[inside][3]): (np.nan, np.nan, deflection[3])},
            frozenset((int(label), 3) for label in kept[~inside[there]]),
        ),
    )
    scene = hhr.ForeignStiffness(block).scene(
        "membrane",
        contacts=(hhr.NodesToGround("INSIDE", normal=(0.0, 0.0, 1.0), gap=0.004),),
        displacements=(hhr.Displacement("EDGE", 2),) if edges else (),
        loads=(hhr.ForeignLoad({(int(k), 3): share for k in labels[inside]}, "load"),),
        parameters=hhr.ParameterSpace(("load",), (0.01,), (0.2,)),
    )
    full = hhr.FullOrderModel(scene)
    assert full.problem.kernel is None
    for load in (0.02, 0.2):
        answer = full.solve(load)
        slack = 0.004 - load * deflection
        root = np.linalg.cholesky(np.linalg.inv(own))
        exact, _ = nnls(root.T, np.linalg.solve(root, -slack))
        np.testing.assert_allclose(answer.forces(), exact, atol=1e-10)
    assert answer.forces().max() > 0
