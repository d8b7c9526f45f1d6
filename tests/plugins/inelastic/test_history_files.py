"""Histories in a store: what was solved is never solved again, whatever ended the run.

And only what is the same.
"""

from collections import Counter
from dataclasses import dataclass, replace
from types import SimpleNamespace

import flowing
import numpy as np
import pellet_cladding_plastic as demo
import pytest
from bare_problem import BareFull, bare_problem, on_disk
from processes import folders_of, python
from scenes import pressed_block
from scipy.sparse import csc_matrix
from toy_law import Bingham

import hhr_dolfinx as hhr
from hhr_dolfinx import files
from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.errors import ConvergenceError, SnapshotFileWarning
from hhr_dolfinx.plugins.inelastic import store as store_of_gauss_points
from hhr_dolfinx.plugins.inelastic.equilibrium import Stepper
from hhr_dolfinx.plugins.inelastic.law import LawProgram, program_of
from hhr_dolfinx.plugins.inelastic.update import Group
from hhr_dolfinx.plugins.paths.histories import KeptSteps
from hhr_dolfinx.snapshots.store import _digest_of

PATH = demo.path(10.0, flowing.STEPS)
RENEWED = hhr.MarchSettings("tangent")
"""New tangents in each iteration: nothing but answers passes from step to step, and a resumed
history is the same.
"""
LONG, KEPT = demo.path(10.0, 20), 12
"""The twelfth of these steps leaves its tangent to the next one: it takes four iterations, at most
``WAIT``.
"""
MOVED = 1e-4
"""A resumed history has another tangent there; both end where a step moves the stress by
``relative_stress`` = 1e-5 of itself, in several iterations. Measured: 9e-6.
"""


@pytest.fixture(scope="module")
def full():
    return flowing.flowing_full()


@pytest.fixture(scope="module")
def whole(full):
    return full.march(PATH, RENEWED)


@pytest.fixture
def solved(monkeypatch):
    """Counts the steps that are solved."""
    counts, advance = Counter(), Stepper.advance

    def counting(*arguments):
        counts["steps"] += 1
        return advance(*arguments)

    monkeypatch.setattr(Stepper, "advance", counting)
    return counts


def computed(full, folder, path=PATH, settings=RENEWED):
    """A history with a store of its own, as a new run would have it."""
    store = hhr.SnapshotStore(folder, full)
    (history,) = hhr.compute_snapshots(full, [path], store=store, settings=settings).histories
    return history, store


def bits(history):
    parts = [
        (a.unknown, a.multipliers, a.active, a.gauss.stress, *a.gauss.state)
        for a in history.answers
    ]
    return [part.tobytes() for step in parts for part in step]


def interrupted(monkeypatch, folder, run, steps=3, error=KeyboardInterrupt()):  # noqa: B008
    """A run in which the law of the cladding raises once some steps are kept; what it ended
    with.
    """
    update = LawProgram.update

    def ending(self, *arguments, **how):
        if len(list(folder.glob("*.npz"))) >= steps:
            raise error
        return update(self, *arguments, **how)

    # an interrupt passes; a law that finds no flow is a step that fails, in parts too
    raised = KeyboardInterrupt if isinstance(error, KeyboardInterrupt) else ConvergenceError
    with monkeypatch.context() as patch, pytest.raises(raised) as ended:
        patch.setattr(LawProgram, "update", ending)
        run()
    return ended.value


# ---------------------------------------------------------------- runs that ended


@pytest.mark.parametrize(
    "error", [KeyboardInterrupt(), ConvergenceError("no root")], ids=["interrupt", "failed step"]
)
def test_a_history_goes_on_behind_its_last_file(error, full, whole, solved, tmp_path, monkeypatch):
    ended = interrupted(monkeypatch, tmp_path, lambda: computed(full, tmp_path), error=error)
    assert len(ended.history.answers) == len(list(tmp_path.glob("*.npz"))) == 3
    solved.clear()
    history, store = computed(full, tmp_path)
    assert store.found == 3 and solved["steps"] == flowing.STEPS - 3
    assert [answer.time for answer in history.answers] == [time for time, _ in PATH[1:]]
    assert bits(history) == bits(whole) and history.iterations == whole.iterations
    solved.clear()
    again, store = computed(full, tmp_path)
    assert solved["steps"] == 0 and store.found == flowing.STEPS and bits(again) == bits(history)
    assert again.iterations == history.iterations and again.signs == history.signs


def test_large_histories_stay_on_the_disk(full, whole, solved, tmp_path, monkeypatch):
    """Solved, resumed and read: the same bits, which lie in the files and take no memory of their
    own.
    """
    for module in (files, store_of_gauss_points):
        monkeypatch.setattr(module, "MAPPED_BYTES", 1)
    interrupted(monkeypatch, tmp_path, lambda: computed(full, tmp_path))
    for found in (3, flowing.STEPS):
        history, store = computed(full, tmp_path)
        assert (
            store.found == found
            and bits(history) == bits(whole)
            and history.iterations == whole.iterations
        )
        assert [answer.time for answer in history.answers] == [time for time, _ in PATH[1:]]
        arrays = [
            array
            for answer in history.answers
            for array in (answer.gauss.stress, *answer.gauss.state)
        ]
        assert all(on_disk(array) for array in arrays)
    assert solved["steps"] == flowing.STEPS + 1, "the interrupted step and no other is solved twice"
    # whoever writes into an answer changes neither the file nor what is read of it next
    history.answers[0].gauss.stress[:] = 0.0
    assert bits(computed(full, tmp_path)[0]) == bits(whole)


def test_kept_tangents_stay_behind_and_answers_agree(full, tmp_path, monkeypatch):
    settings = hhr.MarchSettings()
    interrupted(monkeypatch, tmp_path, lambda: computed(full, tmp_path, LONG, settings), KEPT)
    (history, _), whole = computed(full, tmp_path, LONG, settings), full.march(LONG, settings)
    assert bits(history) != bits(whole), "the tangent was not kept: nothing is tested"
    for one, two in zip(history.answers, whole.answers, strict=True):
        for name in ("displacement", "forces", "stress", "plastic_strain"):
            found, expected = getattr(one, name)(), getattr(two, name)()
            assert np.linalg.norm(found - expected) <= MOVED * np.linalg.norm(expected), name


KILLED = f"""
import os, signal, sys
sys.path[:0] = {folders_of(__file__)!r}
import numpy as np
import test_history_files as tests
whole, written = np.savez, []
def killing(file, **arrays):
    written.append(file)
    if len(written) == 4:  # in the middle of a file
        file.write(b"half")
        file.flush()
        os.kill(os.getpid(), signal.SIGKILL)
    whole(file, **arrays)
np.savez = killing
tests.computed(tests.flowing.flowing_full(), sys.argv[1])
"""


def test_a_killed_run_leaves_whole_steps(full, whole, solved, tmp_path):
    python("-c", KILLED, tmp_path, code=-9)
    assert len(list(tmp_path.glob("*.npz"))) == 3 and len(list(tmp_path.glob("*.part"))) == 1
    history, store = computed(full, tmp_path)
    # another process assembles the same bits, or nothing would be found
    assert (
        store.found == 3 and solved["steps"] == flowing.STEPS - 3 and bits(history) == bits(whole)
    )
    assert not list(tmp_path.glob("*.part"))


def test_a_damaged_step_is_warned_of_and_solved_anew(full, whole, solved, tmp_path):
    _, store = computed(full, tmp_path)
    path = store._path(KeptSteps(store, PATH, RENEWED)._queries[4])
    content = bytearray(path.read_bytes())
    content[-200] ^= 1
    path.write_bytes(content)
    solved.clear()
    with pytest.warns(SnapshotFileWarning, match=f"{path.name}.*solved anew"):
        history, store = computed(full, tmp_path)
    # what follows is solved from the new step
    assert (
        store.found == 3 and solved["steps"] == flowing.STEPS - 3 and bits(history) == bits(whole)
    )
    assert computed(full, tmp_path)[1].found == flowing.STEPS


def test_a_training_is_resumed(solved, tmp_path, monkeypatch):
    scene, paths = (
        demo.scene(**flowing.SMALL_MESH),
        [demo.path(gap, flowing.STEPS) for gap in (5.0, 12.0)],
    )

    def train():
        return hhr.train(scene, paths, folder=tmp_path, march=RENEWED)

    interrupted(monkeypatch, tmp_path, train, flowing.STEPS + 2)
    solved.clear()
    training = train()
    assert solved["steps"] == flowing.STEPS - 2
    (skipped,) = [item["why"] for item in training.log.skipped if item["stage"] == "snapshots"]
    assert skipped.startswith(f"{flowing.STEPS + 2} of {2 * flowing.STEPS} answers were read")
    expected = [training.full_order.march(path, RENEWED) for path in paths]
    assert [bits(history) for history in training.snapshots.histories] == [
        bits(history) for history in expected
    ]


def test_unloaded_bodies_are_solutions_too(tmp_path):
    """Beside no forces at all the last digits of those before would be a residual of any size."""
    scene = pressed_block("plane_strain")
    full = hhr.FullOrderModel(
        replace(scene, bodies=(replace(scene.bodies[0], law=hhr.Plasticity(1e9)),))
    )
    path = [(float(k), (push,)) for k, push in enumerate((0.0, 0.05, 0.1, 0.05, 0.0))]
    computed(full, tmp_path, path)
    assert computed(full, tmp_path, path)[1].found == 4


def test_histories_of_elastic_bodies(tmp_path):
    full = hhr.FullOrderModel(pressed_block("plane_strain"))
    (history, _), (again, store) = (
        computed(full, tmp_path, [(k, (0.05 * k,)) for k in (0.0, 1.0, 2.0)]) for _ in "12"
    )
    assert store.found == 2
    for one, two in zip(again.answers, history.answers, strict=True):
        assert (
            np.array_equal(one.unknown, two.unknown) and one.time == two.time and one.fields is full
        )


# ---------------------------------------------------------------- the same, and no other


def test_a_longer_path_begins_with_the_steps_of_a_shorter_one(full, solved, tmp_path):
    computed(full, tmp_path, PATH[:4])
    solved.clear()
    _, store = computed(full, tmp_path)
    assert store.found == 3 and solved["steps"] == flowing.STEPS - 3
    assert computed(full, tmp_path, PATH[:6])[1].found == 5


def test_what_is_another_question_has_other_files(full, tmp_path):
    computed(full, tmp_path, PATH[:3])
    later = [(time + (k > 0), point) for k, (time, point) in enumerate(PATH[:3])]
    wider = [(time, point + np.array([0.0, 0.0, 1e-3])) for time, point in PATH[:3]]
    others = [
        (full, later, RENEWED),
        (full, [(-1.0, PATH[0][1]), *PATH[1:3]], RENEWED),  # starts earlier
        (full, wider, RENEWED),
        (full, PATH[:1] + PATH[2:3], RENEWED),  # the second step at once
        (full, PATH[:3], hhr.MarchSettings()),
        (full, PATH[:3], replace(RENEWED, relative_force=1e-6)),
        (full, PATH[:3], replace(RENEWED, iterations=61)),
        (hhr.FullOrderModel(demo.scene(exponent=5.0, **flowing.SMALL_MESH)), PATH[:3], RENEWED),
    ]
    files = set(tmp_path.glob("*.npz"))
    for other, path, settings in others:
        history, store = computed(other, tmp_path, path, settings)
        assert store.found == 0
        now = set(tmp_path.glob("*.npz"))
        assert len(now - files) == len(history.answers)
        files = now
    # but not by what decides nothing, or another way to write a number
    same = replace(RENEWED, outside="refuse", iterations=np.int64(60), cuts=np.int32(6))
    assert computed(full, tmp_path, PATH[:3], same)[1].found == 2


class Plain:
    """A law of a user's own that is no dataclass, with numbers where nothing looks for them."""

    __slots__ = ("inside",)

    def __init__(self, *numbers):
        self.inside = lambda trial: sum(numbers) * trial

    def flow(self, trial, *_):
        return self.inside(trial), 0 * trial


@dataclass(frozen=True)
class Table:
    values: np.ndarray
    count = 1

    def __call__(self, point):
        return [0], [self.values @ point]


def digest(law=None, groups=None):
    full = BareFull(bare_problem())
    groups = (
        (Group(np.arange(3), 1.0, 0.3, law and program_of(law, 4)),) if groups is None else groups
    )
    material = SimpleNamespace(groups=groups, gauss_points=3, components=4, remembered=0)
    full.equilibrium = SimpleNamespace(
        reader="inelastic", material=material, eigenstrains=csc_matrix((12, 1))
    )
    return _digest_of(full)


def test_laws_are_told_apart_by_what_they_state():
    """Programs and constants, not names of classes."""
    numbers = [(1.0, 2.0), (2.0, 1.0), (1.0, 2.0 + 1e-12)]
    laws = [kind(*pair) for kind in (hhr.Plasticity, hhr.Norton, Bingham) for pair in numbers]
    digests = [
        digest(law) for law in (None, hhr.Plasticity("s", 2.0), hhr.Plasticity("t", 2.0), *laws)
    ]
    assert len(set(digests)) == len(digests)
    renamed = type("Renamed", (Bingham,), {})
    assert digest(renamed(1.0, 2.0)) == digest(Bingham(1.0, 2.0))
    assert digests[0] != digest(groups=(Group(np.arange(3), 2.0, 0.3, None),))


def test_amplitudes_are_told_apart_by_what_they_are_at_a_point(tmp_path):
    tables = Table(np.array([1.0, 2.0])), Table(np.array([2.0, 1.0]))
    stores = []
    for given in ((), *((table,) for table in tables)):
        amplitudes = Amplitudes(np.ones(1), np.zeros((1, 2)), given)
        stores.append(
            hhr.SnapshotStore(tmp_path, BareFull(replace(bare_problem(), amplitudes=amplitudes)))
        )
    point = np.array([0.5, 3.0])
    assert len({str(store._path(store.query_at(point))) for store in stores}) == 3
    same = np.array([1.0, 1.0])
    assert len({str(store._path(store.query_at(same))) for store in stores[1:]}) == 1
