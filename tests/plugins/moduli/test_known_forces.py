"""Fields under known forces: those of an elimination for every parameter, and nobody makes them who
does not ask.
"""

from unittest.mock import Mock

import numpy as np
import pytest
from needs import needs
from scenes import largest_difference, pressed_pair

import hhr_dolfinx as hhr
from hhr_dolfinx.formulas import coordinate_names
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.models.eliminations.block import BlockElimination
from hhr_dolfinx.plugins.moduli import condense
from hhr_dolfinx.plugins.moduli.components import solvers_of
from hhr_dolfinx.plugins.moduli.condense import Condensation
from hhr_dolfinx.plugins.moduli.interpolate import GridSettings
from hhr_dolfinx.plugins.moduli.known_forces import DiagonalBlock, KnownForces
from hhr_dolfinx.plugins.moduli.shaped import ReshapedElimination
from hhr_dolfinx.reduction.reductor import Task, made

MATERIALS = {"E1": (1.0, 6.0), "nu1": (0.1, 0.49), "E2": (2.0, 90.0), "c": (0.0, 1.0)}
OUTPUTS = hhr.LargestPressure("peak", 0), hhr.ContactForce("force", 0, (0.0, 1.0))


def condensed(bodies, box, **changes):
    scene = pressed_pair("plane_strain", bodies, box, cells=2, outputs=OUTPUTS, **changes)
    training = hhr.train(scene, hhr.Sobol(16), held_out=0)
    return training.build(Condensation(GridSettings(1e-3, 30), bound=False))


@pytest.fixture(scope="module")
def materials():
    """Both bodies vary: one in its volume and shape, one as a whole."""
    return condensed((("E1", "nu1"), ("E2 * (1 + c)", 0.3)), MATERIALS)


@pytest.fixture(scope="module")
def shape():
    x, y = coordinate_names("plane_strain")
    wider = hhr.Shape(two_blocks.SECOND, (f"1 + ({x} - 1) * (1 + wide)", y))
    return condensed(
        ((3.0, 0.3), (4.0, 0.3)), {"wide": (0.0, 0.05)}, shapes=(wider,), matching=False
    )


@pytest.fixture(
    scope="module",
    params=["materials", pytest.param("shape", marks=needs("nonmatching", "shapes"))],
)
def model(request):
    return request.getfixturevalue(request.param)


def test_fields_are_those_of_an_elimination(model):
    """1e-9: round-off over the condition of K~, near 1e6 where nu is near one half."""
    for point in model.parameters.random(20, 1):
        answer = model.solve(point)
        expected = model.fields.galerkin(point).unknown(answer.multipliers)
        assert (
            largest_difference(model.fields._solver.under(point, answer.multipliers), expected)
            < 1e-9
        )


def test_blocks_of_one_and_of_two_parts_are_diagonal(materials):
    blocks = materials.fields.galerkin.blocks
    assert sorted(block.parts.size for block in blocks) == [1, 2]
    assert all(DiagonalBlock.of(block) is not None for block in blocks)


def test_a_block_of_other_parts_is_factored(materials, monkeypatch):
    """Three parts have no modes in common: the same answers by factors."""
    point, fields = materials.parameters.random(1, 2)[0], materials.fields
    answer = materials.solve(point)
    before = answer.displacement()
    monkeypatch.setattr(DiagonalBlock, "of", staticmethod(lambda block: None))
    unknown = KnownForces(fields.galerkin.problem, fields.galerkin.amplitudes).under(
        point, answer.multipliers
    )
    assert (
        largest_difference(fields.basis @ unknown + fields.lifts @ fields.amplitudes(point), before)
        < 1e-9
    )


def test_outputs_of_forces_make_no_field(model, monkeypatch):
    """They took 25 times as long as the forces that they are made of."""
    points = model.parameters.random(5, 3)
    answers = [model.solve(point) for point in points]
    refused = Mock(side_effect=AssertionError("no output has a row of displacement"))
    for kind, method in (
        (BlockElimination, "__call__"),
        (KnownForces, "under"),
        (ReshapedElimination, "under"),
    ):
        monkeypatch.setattr(kind, method, refused)
    monkeypatch.setattr(ReshapedElimination, "__call__", refused)
    for answer in answers:
        found = answer.outputs()
        assert found["peak"] > 0 or not answer.active.any()


@needs("one_call")
def test_stages_are_kept_for_a_run_that_was_interrupted(tmp_path, monkeypatch):
    """Starts and responses, after which such runs end: another run computes neither, and its model
    is the same.
    """
    from hhr_dolfinx.plugins.one_call.array_store import ArrayStore

    scene = pressed_pair(
        "plane_strain", (("E1", "nu1"), (4.0, 0.3)), {"E1": (1.0, 6.0), "nu1": (0.1, 0.45)}, cells=2
    )
    full = hhr.FullOrderModel(scene)
    settings = GridSettings(1e-3, 30)

    def model():
        store = ArrayStore(tmp_path, "the problem")
        before = condense._Prepared(Task(full), solvers_of(full, store))
        return made(Condensation(settings, along=True), Task(full, sure=0), before)

    first = model()
    for name in ("linear_starts", "_fields_along"):
        monkeypatch.setattr(condense, name, None)
    again = model()
    for point in scene.parameters.random(5, 3):
        one, other = first.solve(point), again.solve(point)
        assert np.array_equal(one.multipliers, other.multipliers)
        assert np.array_equal(one.displacement(), other.displacement())
    settings = GridSettings(1e-4, 30)
    with pytest.raises(TypeError):  # other grids, other stages
        model()
