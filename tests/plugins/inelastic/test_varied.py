"""Heat, moduli and constants of laws as parameters where bodies flow: models beside each other,
derivatives, files.
"""

import dataclasses
import pickle
import warnings

import flowing
import numpy as np
import pytest
import varied
from condensing import EVERY, FINE, QUIET, apart
from flow_histories import slopes_between
from history_bits import flat, marched_elsewhere
from kept_values import both, put, rewrite_model
from needs import present

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ModelFileError, OutsideTrainingWarning, ParameterError, SceneWarning
from hhr_dolfinx.plugins.inelastic.history_gradient import history_gradient
from hhr_dolfinx.plugins.inelastic.law import program_of
from hhr_dolfinx.plugins.inelastic.project import training_tangents
from hhr_dolfinx.plugins.inelastic.update import Material
from hhr_dolfinx.plugins.paths.histories import KeptSteps

NEWTON = hhr.MarchSettings(
    "tangent", relative_stress=1e-10, floor_stress=1e-9, relative_force=1e-12, outside="ignore"
)


def test_a_history_is_that_of_the_scene_with_the_numbers():
    """With factors of the middle of the box alone, since each body has a modulus of its own."""
    full = varied.full()
    assert full.system.bodies is not None
    laws = hhr.Plasticity("90 - 0.02 * T", 1e3), hhr.Norton(1e3, 4.0)
    with pytest.warns(SceneWarning, match="E"):
        numbers = hhr.FullOrderModel(varied.scene((200e3, 78e3 * 1.1), laws))
    for settings in (QUIET, hhr.MarchSettings("elastic", outside="ignore", iterations=300)):
        one, other = (model.march(varied.path(), settings) for model in (full, numbers))
        assert max(apart(one, other, EVERY)) < 1e-10
    expected = numbers.march(varied.path())
    for other in ({"young": 160e3}, {"w": 0.9}, {"heat": 0.0}, {"hardening": 1900.0}):
        assert max(apart(full.march(varied.path(**other)), expected)) > 1e-3
    assert max(apart(full.march(varied.path()), expected, EVERY)) < 1e-10


def test_moduli_must_not_change_along_a_path():
    for make in varied.MODELS.values():
        changing = varied.path()
        changing[3][1][4] = 180e3
        with pytest.raises(
            ParameterError, match=r"E changes from 200000 to 180000 in step 3 .*depends on it \(E\)"
        ):
            make().march(changing)
    # a single step from rest has the elasticity of its end
    answer = varied.full().solve(
        dict(zip(varied.SPACE.names, varied.path(5.0, 170e3)[-1][1], strict=True))
    )
    assert answer.converged and answer.forces().max() > 0


@pytest.mark.parametrize("name", ["reduced", "condensed"])
def test_a_small_model_answers_between_what_was_trained(name):
    model, full = varied.MODELS[name](), varied.full()
    for given in varied.BETWEEN:
        found, exact = (item.march(varied.path(*given), QUIET) for item in (model, full))
        primal, dual = apart(found, exact)
        assert primal < 1e-2 and dual < 2e-2
        stress, right = (history.answers[-1].stress() for history in (found, exact))
        assert np.linalg.norm(stress - right) < 0.03 * np.linalg.norm(right)
    if present("studies") and name == "reduced":
        from hhr_dolfinx.plugins.inelastic.study import seconds_of_parts

        assert seconds_of_parts(model, found)["laws"] > 0
    trained = varied.corners()[0]
    with warnings.catch_warnings(action="error", category=OutsideTrainingWarning):
        assert max(apart(model.march(trained.path), trained)) < 2e-3


def near(found, expected):
    """Measured: 6e-8."""
    return np.linalg.norm(found - expected) < 1e-6 * np.linalg.norm(expected)


@pytest.mark.parametrize("name", varied.MODELS)
def test_derivatives_are_those_of_whole_histories(name):
    """Beside central differences, of outputs too."""
    model, settings = varied.MODELS[name](), FINE if name == "condensed" else NEWTON
    path = [(time, point + 10.0 * (np.arange(8) == 3)) for time, point in varied.path(9.0, w=1.05)]
    answers = model.march(path, dataclasses.replace(settings, gradient=True)).answers
    for axis, step in ((1, 1e-5), (2, 1e-6), (3, 0.01), (4, 20.0), (5, 1e-4), (6, 0.01), (7, 0.01)):
        shift = step * (np.arange(8) == axis)
        ends = [
            model.march([(time, point + way * shift) for time, point in path], settings)
            for way in (1, -1)
        ]
        for part in ("unknown", "multipliers"):
            found = np.array([getattr(answer.gradient, part)[:, axis] for answer in answers])
            assert near(
                found, slopes_between(ends, step, lambda answer, part=part: getattr(answer, part))
            )
        found = np.array([answer.outputs().gradient["force"][axis] for answer in answers])
        assert near(found, slopes_between(ends, step, lambda answer: answer.outputs()["force"]))
    assert not any(answer.gradient.one_sided for answer in answers)


@pytest.mark.parametrize("name", ["full", "reduced"])
def test_derivatives_along_a_load_that_grows_on_the_way(name):
    model = varied.MODELS[name]()
    history = model.march(varied.path(), NEWTON)
    times = np.array([time for time, _ in history.path])
    along = np.zeros((len(times), 8, 1))
    along[:, 0, 0], along[:, 6, 0] = -times, 0.1 * times**2
    points = np.array([point for _, point in history.path])
    moved = [points + way * 0.01 * along[:, :, 0] for way in (1, -1)]
    ends = [model.march(list(zip(times, there, strict=True)), NEWTON) for there in moved]
    gradients = history_gradient(model.equilibrium, history, along)
    for place, part in enumerate(("unknown", "multipliers")):
        found = np.array([gradient[place][:, 0] for gradient in gradients])
        assert near(
            found, slopes_between(ends, 0.01, lambda answer, part=part: getattr(answer, part))
        )
    asked = (
        model.march(history.path, dataclasses.replace(NEWTON, gradient=True)).answers[-1].gradient
    )
    usual = history_gradient(model.equilibrium, history)
    assert np.array_equal(asked.unknown, usual[-1].unknown)
    assert usual[0].unknown.shape == (model.equilibrium.size, 8)
    assert usual[0].multipliers.shape == (model.equilibrium.conditions, 8)


@pytest.mark.parametrize(
    "directions", [np.zeros((3, 8, 1)), np.zeros((7, 8)), np.full((7, 8, 1), np.nan)]
)
def test_directions_that_are_none(directions):
    with pytest.raises(ParameterError, match=r"must be finite and of the shape \(7, 8, K\)"):
        history_gradient(varied.full().equilibrium, varied.corners()[0], directions)


def test_training_tangents_have_the_numbers_of_their_history():
    """Those of a material without formulas, and K_T as it is assembled from nothing."""
    equilibrium, snapshots = (
        varied.full().equilibrium,
        hhr.SnapshotSet.of_histories(varied.corners()[:2]),
    )
    operator = equilibrium.operator
    for history, (tangents, stiffness) in zip(
        snapshots.histories, training_tangents(equilibrium, snapshots, 1), strict=True
    ):
        last, before = history.answers[-1], history.answers[-2]
        *_, heat, young, w, hardening, resistance = last.parameter
        numbers = (
            (young, hhr.Plasticity(90 - 0.02 * heat, hardening)),
            (78e3 * w, hhr.Norton(resistance, 4.0)),
        )
        pairs = zip(equilibrium.material.groups, numbers, strict=True)
        groups = [
            dataclasses.replace(group, young=own, law=program_of(law, 4))
            for group, (own, law) in pairs
        ]
        material = Material(groups, 4)
        strain = equilibrium.strain(last.unknown, equilibrium.amplitudes(last.parameter))
        again = material.update(strain, before.gauss.state, last.time - before.time, tangent=True)
        assert np.array_equal(again.tangents, tangents) and np.array_equal(
            again.stress, last.gauss.stress
        )
        plain = operator.stiffness(tangents, operator.pattern())
        assert abs(stiffness - plain).max() < 1e-12 * abs(plain).max()
        # flow keeps the volume
        volumes = [moduli[:, :3, :3].sum(axis=(1, 2)) for moduli in (tangents, material.elastic)]
        assert volumes[0] == pytest.approx(volumes[1], rel=1e-12)


def test_a_store_finds_only_what_is_the_same(tmp_path):
    """Not by another formula, class, number, heat or parameter; whatever the box."""

    def found(model, **asked):
        return len(
            KeptSteps(hhr.SnapshotStore(tmp_path, model), varied.path(**asked), QUIET).load()
        )

    full, creep = varied.full(), varied.LAWS[1]
    full.march(
        varied.path(),
        QUIET,
        keep=KeptSteps(hhr.SnapshotStore(tmp_path, full), varied.path(), QUIET).save,
    )
    wider = dataclasses.replace(
        varied.SPACE, upper=(*varied.SPACE.upper[:4], 240e3, 1.3, 2100.0, 1300.0)
    )
    for scene in (varied.scene(), varied.scene(parameters=wider)):
        assert found(hhr.FullOrderModel(scene)) == flowing.STEPS
    for asked in (
        {"young": 201e3},
        {"w": 1.0},
        {"hardening": 1001.0},
        {"resistance": 999.0},
        {"heat": 501.0},
    ):
        assert found(full, **asked) == 0
    others = [hhr.Plasticity("90 - 0.02 * T", formula) for formula in ("H + 0", "1e3", 1e3)]
    scenes = [varied.scene(("E + 0", "78e3 * w")), varied.scene(loads=[varied.heat(0.03)])]
    with warnings.catch_warnings(action="ignore", category=SceneWarning):  # H has no effect
        for scene in scenes + [
            varied.scene(laws=(law, creep)) for law in (*others, hhr.Plasticity(81.0, "H"))
        ]:
            assert found(hhr.FullOrderModel(scene)) == 0


@pytest.mark.parametrize("name", ["reduced", "condensed"])
def test_a_model_file_keeps_formulas(name, tmp_path):
    """To the last bit, by pickle too, and in a process without DOLFINx.

    Whatever was asked in between.
    """
    model, file, asked = (
        varied.MODELS[name](),
        tmp_path / "model.npz",
        varied.path(*varied.BETWEEN[0]),
    )
    hhr.save_model(file, model)
    stored = hhr.load_model(file)
    groups = stored.flow.material.groups if name == "reduced" else stored.flow.groups
    assert [group.law.values for group in groups] == [("90 - 0.02 * T", "H"), ("K", 4.0)]
    assert [group.young for group in groups] == list(varied.MODULI)
    expected = model.march(asked, QUIET)
    model.march(varied.path(*varied.BETWEEN[1]), QUIET)
    for other in (model, stored, pickle.loads(pickle.dumps(model))):
        found = other.march(asked, QUIET)
        assert flat(found).tobytes() == flat(expected).tobytes()
        assert found.answers[-1].outputs().values == expected.answers[-1].outputs().values
    assert marched_elsewhere(file, asked, tmp_path).tobytes() == flat(expected).tobytes()
    with pytest.raises(ParameterError, match="E changes"):
        stored.march([asked[0], (1.0, varied.path(*varied.BETWEEN[1])[-1][1])])


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"young": ["2 * E", "78e3 * w"]}, "not those of the moduli"),
        ({"young": ["F", "78e3 * w"]}, "moduli|names"),
        ({"young": [1e5, 1e5]}, "moduli"),
        ({"young": [None, "78e3 * w"]}, "must be a float"),
        ({"young": [-3.0, "78e3 * w"]}, "are no constants"),
        ({"law.values": [[90.0, "H +"]]}, "cannot be read"),
        ({"law.values": [[90.0, "G"]]}, "names"),
        ({"law.values": [[90.0, "H - 501"]]}, "must be a number at least"),
        ({"law.values": [[90.0, "__import__('os')"]]}, "unknown|known"),
    ],
)
def test_a_file_with_other_formulas_is_refused(tmp_path, changes, why):
    ((name, items),) = changes.items()
    hhr.save_model(tmp_path / "model.npz", varied.reduced())
    places = (put(f"flow.material.groups.{k}.{name}", item) for k, item in enumerate(items))
    rewrite_model(tmp_path / "model.npz", both(*places))
    with pytest.raises(ModelFileError, match=rf"({why}).*build the model again"):
        hhr.load_model(tmp_path / "model.npz")


def test_stress_balances_loads_and_contact_forces():
    """Whatever flows, and whether the plastic strain is right: to round-off, also with strains
    without stress.
    """
    full = varied.full()
    problem, operator = full.problem, full.equilibrium.operator
    path = varied.path(*varied.BETWEEN[0])
    for answer in varied.condensed_flow().march(path, QUIET).answers:
        internal, _ = operator.internal(answer.stress())
        loads = problem.external @ problem.amplitudes(answer.parameter)
        out = (internal - loads + problem.contact.T @ answer.multipliers) * problem.free
        assert answer.plastic_strain().any() or answer.time < path[-1][0]
        # measured: 5e-12, of solves with K
        assert np.linalg.norm(out) < 1e-10 * np.linalg.norm(internal)
