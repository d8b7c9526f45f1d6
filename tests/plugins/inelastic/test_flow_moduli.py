"""Young's modulus as a parameter where bodies flow: histories, files, derivatives, reduced models."""

import dataclasses
import pickle
import warnings

import flowing
import numpy as np
import pytest
from dolfinx.mesh import compute_midpoints, meshtags
from flowing import PELLET_SPACE as SPACE
from flowing import pellet_of_moduli as pellet
from flowing import pellet_path as path
from kept_values import both, put, rewrite_model
from marched import flat, marched_elsewhere
from scenes import pressed_pair

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import relative_error
from hhr_dolfinx.errors import ModelFileError, ParameterError, SceneError
from hhr_dolfinx.geometries import block, two_blocks
from hhr_dolfinx.plugins.inelastic.project import training_tangents
from hhr_dolfinx.plugins.inelastic.update import Group, Material
from hhr_dolfinx.snapshots.store import SnapshotStore

TIGHT = hhr.MarchSettings("tangent", relative_stress=1e-10, floor_stress=1e-9, relative_force=1e-12, outside="ignore")
QUIET = hhr.MarchSettings(outside="ignore")
NOMINAL = 190e3, 78e3


def apart(one, other):
    """Largest relative distance of two histories in displacements, forces and stress."""
    pairs = zip(one.answers, other.answers, strict=True)
    parts = [(a.displacement(), b.displacement()) for a, b in pairs]
    parts += [(a.forces(), b.forces()) for a, b in zip(one.answers, other.answers, strict=True)]
    parts += [(a.stress(), b.stress()) for a, b in zip(one.answers, other.answers, strict=True)]
    return max(np.linalg.norm(a - b) / max(np.linalg.norm(b), 1e-30) for a, b in parts if np.any(a) or np.any(b))


@pytest.fixture(scope="module")
def full():
    return hhr.FullOrderModel(pellet())


def test_a_history_is_that_of_the_scene_with_the_number(full):
    """With factors of the middle of the box alone, since each body has a modulus of its own."""
    assert full.system.bodies is not None
    with pytest.warns(hhr.errors.SceneWarning, match="E"):
        numbers = hhr.FullOrderModel(pellet((200e3, 78e3 * 1.1)))
    for settings in (QUIET, hhr.MarchSettings("elastic", outside="ignore", iterations=300)):
        assert apart(full.march(path(), settings), numbers.march(path(), settings)) < 1e-10
    assert apart(full.march(path(young=160e3)), numbers.march(path())) > 1e-3
    assert apart(full.march(path()), numbers.march(path())) < 1e-10


MATERIALS = {"E1": (2.0, 4.0), "E2": (2.0, 9.0)}
"""Of two blocks on each other, by their bounds."""


def blocks(first, second, hypothesis="solid", materials=MATERIALS, cells=2, **others):
    """The lower one yields; imposed displacements move the upper one."""
    yields = hhr.Plasticity(0.05, 0.2)
    bodies = hhr.Body(two_blocks.FIRST, first, 0.3, yields), hhr.Body(two_blocks.SECOND, second, 0.35)
    return pressed_pair(hypothesis, bodies, materials, cells=cells, **others)


def push(*moduli, steps=4):
    shares = np.arange(steps + 1) / steps
    return [(float(s), np.array([0.005 + 0.045 * s, 0.01 * s, 0.05 * s, 0.001, *moduli])) for s in shares]


def test_in_space_and_where_a_load_imposes_displacements():
    varying = hhr.FullOrderModel(blocks("E1", "2 * E2"))
    numbers = hhr.FullOrderModel(blocks(3.7, 6.2, materials={}))
    one, other = varying.march(push(3.7, 3.1)), numbers.march(push())
    assert one.answers[-1].plastic_strain().max() > 1e-3 and one.answers[-1].forces().max() > 0
    assert apart(one, other) < 1e-10
    assert apart(varying.march(push(2.7, 3.1)), other) > 1e-3
    assert np.array_equal(varying.march(push(3.7, 3.1)).answers[-1].unknown, one.answers[-1].unknown)


def glued(first, second, materials):
    """One column of two layers that hang together, on a rigid floor: both moduli act on the nodes between."""

    def geometry(comm):
        mesh, _, facets = block.block(comm, lower=(0, 0), upper=(1, 2), cells=(3, 4))
        cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
        upper = compute_midpoints(mesh, 2, cells)[:, 1] > 1
        return mesh, meshtags(mesh, 2, cells, np.where(upper, 2, 1).astype(np.int32)), facets

    box = {"push": (0.0, 0.1)} | materials
    return hhr.Scene(
        name="glued",
        geometry=geometry,
        hypothesis="plane_strain",
        bodies=(hhr.Body(1, first, 0.3, hhr.Plasticity(0.05, 0.2)), hhr.Body(2, second, 0.3)),
        contacts=(hhr.Obstacle(block.side(1, upper=False), (0, -1), 0.005),),
        parameters=hhr.ParameterSpace(tuple(box), *zip(*box.values(), strict=True)),
        displacements=(
            hhr.Displacement(block.side(1, upper=True), 0),
            hhr.Displacement(block.side(1, upper=True), 1, hhr.Amplitude(slopes={"push": -1.0})),
        ),
    )  # fmt: skip


def pressed(*moduli):
    return [(float(k), np.array([0.02 * k, *moduli])) for k in range(5)]


def test_bodies_that_hang_together_are_factored_anew():
    varying = hhr.FullOrderModel(glued("E1", "E2", MATERIALS))
    assert varying.system.bodies is None
    numbers = hhr.FullOrderModel(glued(3.7, 6.2, {}))
    for search in ("frozen", "elastic"):
        settings = hhr.MarchSettings(search, iterations=300)
        for _ in range(2):
            varying.march(pressed(2.1, 2.2), settings)  # whose factors are then at hand
            one, other = varying.march(pressed(3.7, 6.2), settings), numbers.march(pressed(), settings)
            assert one.answers[-1].plastic_strain().max() > 1e-3
            assert apart(one, other) < 1e-10


def test_a_common_formula_makes_one_part():
    varying = hhr.FullOrderModel(glued("E1", "E1", {"E1": (2.0, 4.0)}))
    assert len(varying.problem.moduli) == 1 and varying.system.bodies is not None
    numbers = hhr.FullOrderModel(glued(3.7, 3.7, {}))
    assert apart(varying.march(pressed(3.7)), numbers.march(pressed())) < 1e-10


def test_elasticity_must_not_change_along_a_path(full):
    changing = path()
    changing[3][1][3] = 180e3
    for model in (full,):
        with pytest.raises(ParameterError, match=r"E changes from 200000 to 180000 in step 3 .*depends on it \(E\)"):
            model.march(changing)
    # a single step from rest has the elasticity of its end
    answer = full.solve({"P1": 100.0, "h1": 0.9, "gap": 5e-3, "E": 170e3, "w": 0.9})
    assert answer.converged and answer.forces().max() > 0


def test_what_is_not_built_in():
    law = hhr.Plasticity(1.0)
    assert hhr.Body(1, "E", 0.3, law).varies
    for options in ({"poisson": "nu"}, {"grading": lambda x: 1.0}):
        with pytest.raises(SceneError, match=r"body 1 flows, and its Poisson's ratio .* a constant poisson"):
            hhr.Body(1, **({"young": 3.0, "poisson": 0.3, "law": law} | options))
    material = Material([Group(np.arange(1), "E", 0.3, law)], 4, ("E",))
    for ask in (
        lambda: material.elastic,
        lambda: material.update(np.ones((1, 4)), material.at_rest(), 1.0, tangent=False),
    ):
        with pytest.raises(SceneError, match=r"young = E is a formula of the parameters: material.moduli_at\(point\)"):
            ask()
    with pytest.raises(SceneError, match=r"young = E is -1 at E = -1: .* Change the formula"):
        material.moduli_at(np.array([-1.0]))
    with pytest.raises(SceneError, match="names"):
        Material([Group(np.arange(1), "F", 0.3, law)], 4, ("E",))


def test_a_material_has_the_numbers_of_a_point():
    names, law = ("E", "s"), hhr.Plasticity("s", 2.0)
    material = Material([Group(np.arange(2), "2 * E", 0.3, law), Group(np.arange(2, 4), 5.0, 0.2, None)], 4, names)
    point = np.array([3.0, 7.0])
    elastic, whole = material.moduli_at(point), material.at(point)
    assert [group.young for group in elastic.groups] == [6.0, 5.0] == [group.young for group in whole.groups]
    assert elastic.groups[0].law == law and whole.groups[0].law == hhr.Plasticity(7.0, 2.0)
    expected = Material([Group(np.arange(2), 6.0, 0.3, law), Group(np.arange(2, 4), 5.0, 0.2, None)], 4, names)
    assert np.array_equal(elastic.elastic, expected.elastic) and np.array_equal(whole.elastic, expected.elastic)
    assert elastic.moduli_at(-point) is elastic
    assert material.moduli_at(np.array([3.0, 8.0])) is elastic and material.at(point) is whole
    assert material.constants(point) == [{"young": 6.0, "yield_stress": 7.0}, {}]
    assert material.at(np.array([4.0, 7.0])).groups[0].young == 8.0


def test_a_store_finds_only_files_of_the_same_modulus(full, tmp_path):
    def found(model, **asked):
        return len(SnapshotStore(tmp_path, model).steps(path(**asked), QUIET).load())

    full.march(path(), QUIET, keep=SnapshotStore(tmp_path, full).steps(path(), QUIET).save)
    assert found(full) == flowing.STEPS
    wider = dataclasses.replace(SPACE, upper=(*SPACE.upper[:3], 240e3, 1.3))
    assert found(hhr.FullOrderModel(pellet(space=wider))) == flowing.STEPS
    assert found(full, young=201e3) == found(full, w=1.0) == 0
    assert found(hhr.FullOrderModel(pellet(("E + 0", "78e3 * w")))) == 0
    numbers = dataclasses.replace(pellet().bodies[0], law=hhr.Plasticity(81.0, 1e3))
    assert found(hhr.FullOrderModel(pellet(bodies=(numbers, pellet().bodies[1])))) == 0


@pytest.fixture(scope="module")
def corners(full):
    return [full.march(path(gap, young)) for gap in flowing.TRAINING for young in (160e3, 220e3)]


@pytest.fixture(scope="module")
def reduction(full, corners):
    recipe = hhr.Recipe.flowing()
    return hhr.build(full, hhr.SnapshotSet.of_histories(corners), recipe.as_it_is())


@pytest.mark.parametrize("which", ["full", "reduced"])
def test_derivatives_along_moduli_are_those_of_histories(full, reduction, which):
    """Central differences of whole histories."""
    model = full if which == "full" else reduction
    history = model.march(path(), dataclasses.replace(TIGHT, gradient=True))
    for axis, step in ((3, 20.0), (4, 1e-4)):
        ends = [model.march(path(**{("young", "w")[axis - 3]: (200e3, 1.1)[axis - 3] + sign * step}), TIGHT).answers
                for sign in (1, -1)]  # fmt: skip
        for name in ("unknown", "multipliers"):
            found = np.stack([getattr(answer.gradient, name)[:, axis] for answer in history.answers])
            changes = np.stack([getattr(one, name) - getattr(other, name) for one, other in zip(*ends, strict=True)])
            assert np.linalg.norm(found - changes / (2 * step)) < 1e-5 * np.linalg.norm(found) > 0


def test_tangents_of_training_states_are_those_of_their_modulus(full, corners):
    """K_T is assembled the same from nothing."""
    for history, (tangents, stiffness) in zip(
        corners, training_tangents(full.equilibrium, hhr.SnapshotSet.of_histories(corners), 1), strict=True
    ):
        operator = full.equilibrium.operator
        plain = operator.stiffness(tangents, operator.pattern())
        assert abs(stiffness - plain).max() < 1e-12 * abs(plain).max()
        elastic = full.equilibrium.material.moduli_at(history.answers[-1].parameter).elastic
        # flow keeps the volume
        volumes = [moduli[:, :3, :3].sum(axis=(1, 2)) for moduli in (tangents, elastic)]
        assert volumes[0] == pytest.approx(volumes[1], rel=1e-12)


def test_a_reduced_model_answers_other_moduli(full, reduction):
    """Trained on two moduli of the pellet, at a third one and at that of a trained history."""
    for asked, most in ((path(8.0, 190e3), 2e-2), (path(5.0, 160e3), 2e-3)):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = reduction.march(asked)
        expected = full.march(asked)
        for one, other in zip(found.answers[1:], expected.answers[1:], strict=True):
            assert relative_error(one.displacement(), other.displacement()) < most
    changing = path()
    changing[2][1][4] = 1.0
    with pytest.raises(ParameterError, match=r"w changes from 1.1 to 1 in step 2"):
        reduction.march(changing)


def test_a_model_file_keeps_moduli(reduction, tmp_path):
    """To the last bit, by pickle too, and in a process without DOLFINx."""
    file = tmp_path / "model.npz"
    hhr.save_model(file, reduction)
    stored = hhr.load_model(file)
    assert [group.young for group in stored.flow.material.groups] == ["E", "78e3 * w"]
    asked = path(9.0, 180e3)
    expected = flat(reduction.march(asked, QUIET)).tobytes()
    for model in (stored, pickle.loads(pickle.dumps(reduction))):
        assert flat(model.march(asked, QUIET)).tobytes() == expected
    assert marched_elsewhere(file, asked, tmp_path).tobytes() == expected
    with pytest.raises(ParameterError, match="E changes"):
        stored.march([(0.0, asked[0][1]), (1.0, np.array([300.0, 0.9, 9e-3, 170e3, 1.1]))])


@pytest.mark.parametrize(
    ("young", "why"),
    [(["2 * E", "78e3 * w"], "not those of the moduli"), (["F", "78e3 * w"], "moduli|names"), ([1e5, 1e5], "moduli"),
     ([None, "78e3 * w"], "must be a float"), ([-3.0, "78e3 * w"], "are no constants")],
)  # fmt: skip
def test_a_file_with_other_moduli_is_refused(reduction, tmp_path, young, why):
    file = tmp_path / "model.npz"
    hhr.save_model(file, reduction)
    rewrite_model(file, both(*(put(f"flow.material.groups.{k}.young", item) for k, item in enumerate(young))))
    with pytest.raises(ModelFileError, match=rf"({why}).*build the model again"):
        hhr.load_model(file)
