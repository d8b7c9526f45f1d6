"""Laws of a user's own that answer with something else than numbers, and those that find no flow."""

from dataclasses import dataclass

import numpy as np
import pytest
from test_plastic import LAWS, bar, some_states
from toy_law import Bingham
from tubes import POISSON, YOUNG

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ConvergenceError, LawWarning, SceneError
from hhr_dolfinx.plain import as_plain, by_name, restored
from hhr_dolfinx.plugins.inelastic.laws import Norton, Plasticity
from hhr_dolfinx.plugins.inelastic.update import Group, Material


def update(law, strain, old, dt=0.1):
    groups = [Group(np.arange(len(strain)), YOUNG, POISSON, law)]
    return Material(groups, strain.shape[1]).update(strain, old, dt, tangent=True)


@dataclass(frozen=True)
class Answers:
    """A law that answers the same whatever it is given, or by a function of it."""

    answer: object

    def flow(self, *given):
        return self.answer(*given) if callable(self.answer) else self.answer


def test_lists_are_as_good_as_arrays():
    strain, old = some_states(1)
    lists = Answers(lambda *given: [part.tolist() for part in LAWS["plasticity"].flow(*given)])
    ours, theirs = update(lists, strain, old), update(LAWS["plasticity"], strain, old)
    assert np.array_equal(ours.stress, theirs.stress)
    assert np.array_equal(ours.tangents, theirs.tangents)


@pytest.mark.parametrize("answer", [None, 3.0, ("a", "b"), ([[1.0], [1.0, 2.0]], 1.0), (1.0, 2.0, 3.0)])
def test_what_is_no_answer_names_the_law(answer):
    with pytest.raises(SceneError, match=r"the law Answers.* answered .*must return two arrays of numbers"):
        update(Answers(answer), *some_states(1))


def fails(trial, *_):
    """In the second of two steps."""
    if trial.max() > 1.5:
        raise KeyError("table")
    return 0.0 * trial, 0.0 * trial


@pytest.mark.parametrize(
    ("answer", "kind", "said", "kept"),
    [
        (None, SceneError, "the law Answers", 0),
        (fails, SceneError, "the law .*Answers.* failed with KeyError", 1),
        (
            lambda trial, *_: (np.nan * trial, 0 * trial),
            ConvergenceError,
            "Answers.*flows by nan under an equivalent",
            0,
        ),
    ],
)
def test_a_march_ends_with_the_name_of_the_law(answer, kind, said, kept):
    full = hhr.FullOrderModel(bar(Answers(answer)))
    with pytest.raises(kind, match=said) as caught:
        full.march([(float(k), np.array([0.005 * k])) for k in range(3)])
    assert len(caught.value.history.answers) == kept


@pytest.mark.parametrize("law", [lambda: Plasticity([80]), lambda: Plasticity(80.0, None), lambda: Norton(20.0, None)])
def test_constants_of_laws_are_numbers(law):
    with pytest.raises(SceneError, match="must be positive"):
        law()


def test_norton_says_where_it_finds_no_flow():
    """An infinite time step has no flow: sixty iterations went by without a word."""
    strain, old = some_states(1)
    named = pytest.raises(ConvergenceError, match=r"Norton\(.*\) found no flow in a step of inf")
    with np.errstate(all="ignore"), named:
        update(LAWS["norton 4"], strain, old, dt=np.inf)


def test_a_trial_that_is_not_finite_is_not_blamed_on_norton():
    trial = np.array([1.0, np.nan])
    flow, _ = LAWS["norton 4"].flow(trial, np.zeros(2), 80.0, 0.1)
    assert flow[0] > 0 and np.isnan(flow[1])


def test_a_wrong_slope_is_said_once():
    """Plasticity with a third of its slope: right answers, slow steps."""

    def steep(*given):
        amount, slope = LAWS["plasticity"].flow(*given)
        return amount, 0.3 * slope

    full = hhr.FullOrderModel(bar(Answers(steep)))
    path = [(k / 4, np.array([0.01 * k / 4])) for k in range(5)]
    with pytest.warns(LawWarning, match=r"the slope of .*Answers.* differences of its flow give") as caught:
        history = full.march(path)
    assert len(caught) == 1 and len(history.answers) == 4


@pytest.mark.parametrize("name", LAWS)
def test_right_slopes_are_not_doubted(name):
    """Differences of the laws here agree to 1e-6; the warning is an error in tests."""
    hhr.FullOrderModel(bar(LAWS[name])).march([(k / 4, np.array([0.01 * k / 4])) for k in range(5)])


def test_a_material_is_made_of_plain_arrays_and_laws():
    """Rebuilt from numbers and the names of its laws it answers alike to the last bit."""
    laws = [None, *LAWS.values(), Bingham(1.0, 20.0)]
    strain, old = some_states(7, 70)
    order = np.random.default_rng(0).permutation(70).reshape(len(laws), -1)
    groups = [Group(order[k], YOUNG * (k + 1), POISSON, law) for k, law in enumerate(laws)]
    known = by_name([Plasticity, Norton, Bingham, type(LAWS["voce"])])
    again = [
        Group(group.indices, group.young, group.poisson, group.law and restored(*as_plain(group.law), known))
        for group in Material(groups, 4).groups
    ]
    ours, theirs = (Material(parts, 4).update(strain, old, 0.1, tangent=True) for parts in (groups, again))
    assert again[1].law is not groups[1].law
    parts = ((update.stress, *update.state, update.tangents) for update in (ours, theirs))
    for one, other in zip(*parts, strict=True):
        assert np.array_equal(one, other)


@pytest.mark.parametrize("indices", [[[0, 1], [1, 2]], [[0, 1], [3]], [[-1, 0]], [[1, 2]]])
def test_groups_that_do_not_hold_each_gauss_point_once_are_refused(indices):
    """Compiled loops would write outside of their arrays."""
    with pytest.raises(SceneError, match=r"each of its Gauss points 0 .. . once"):
        Material([Group(np.array(part), YOUNG, POISSON, None) for part in indices], 4)


@pytest.mark.parametrize(("young", "poisson"), [(0.0, 0.3), (np.inf, 0.3), (np.nan, 0.3), (1.0, 0.5), (1.0, np.nan)])
def test_constants_without_energy_are_refused(young, poisson):
    with pytest.raises(SceneError, match=r"must be positive and finite, and nu"):
        Material([Group(np.arange(2), young, poisson, None)], 4)


def test_the_material_of_some_gauss_points_answers_as_the_whole_does():
    strain, old = some_states(8, 60)
    laws = [LAWS["plasticity"], LAWS["norton 4"], None]
    whole = Material([Group(np.arange(k, 60, 3), YOUNG, POISSON, law) for k, law in enumerate(laws)], 4)
    kept = np.sort(np.random.default_rng(1).choice(60, 17, replace=False))
    part = whole.restricted(kept).update(strain[kept], type(old)(*(item[kept] for item in old)), 0.1, tangent=True)
    everywhere = whole.update(strain, old, 0.1, tangent=True)
    assert np.array_equal(part.tangents, everywhere.tangents[kept])
    assert np.array_equal(part.state.plastic, everywhere.state.plastic[kept])
