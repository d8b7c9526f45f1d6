"""Laws of a user's own that answer with something else than numbers, and those that find no flow."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from condensing import FINE, QUIET, apart, cycle, up, walled_tube
from test_plastic import LAWS, bar, material, some_states
from toy_law import Bingham
from tubes import POISSON, YOUNG

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ConvergenceError, LawWarning, SceneError
from hhr_dolfinx.plugins.inelastic.laws import Norton, Plasticity
from hhr_dolfinx.plugins.inelastic.update import Group, Material


def update(law, strain, old, dt=0.1):
    return material(law, len(strain), strain.shape[1]).update(strain, old, dt, tangent=True)


@dataclass(frozen=True)
class Own:
    """Linear hardening of a user's own, which may answer nonsense as soon as anything flows."""

    yield_stress: float
    hardening: float
    answer: object = None

    def flow(self, trial, plastic_strain, shear, dt):
        over = trial - self.yield_stress - self.hardening * plastic_strain
        slope = 1 / (3 * shear + self.hardening)
        found = np.maximum(over, 0.0) * slope, np.where(over > 0, slope, 0.0)
        return self.answer(trial, plastic_strain, *found) if self.answer and (over > 0).any() else found


def with_law(tubes, law):
    """Full and condensed models of the tube in its wall with another law than hardening."""
    model = tubes[2]
    groups = tuple(replace(group, law=law) for group in model.flow.groups)
    return hhr.FullOrderModel(walled_tube(law)), model.changed(flow=replace(model.flow, groups=groups))


def _raises(kind):
    def answer(*given):
        raise kind("no way")

    return answer


def _writes(trial, cumulated, amount, slope):
    next(given for given in (cumulated, trial) if not given.flags.writeable)[:] = 7.0
    return amount, slope


NO_ARRAYS = SceneError, r"the law Own.* answered .*must return two arrays of numbers"
NONSENSE = {
    "raises": (_raises(RuntimeError), SceneError, "failed with RuntimeError: no way"),
    "overflows": (_raises(ZeroDivisionError), ConvergenceError, "Own.*found no flow in a step of .* no way"),
    "is not finite": (lambda q, p, a, b: (a * np.nan, b), ConvergenceError, "Own.* flows by nan under an equivalent"),
    "has no slope": (lambda q, p, a, b: (a, b * np.nan), ConvergenceError, "Own.* has the slope nan"),
    "turns the stress round": (lambda q, p, a, b: (1e6 * a, b), ConvergenceError, "Own.* flows by .* was expected"),
    "flows back": (lambda q, p, a, b: (-a, b), ConvergenceError, "Own.* flows by -"),
    "is two numbers": (lambda q, p, a, b: (0.0, 0.0), ConvergenceError, "must answer with a flow and a slope of shape"),
    "is too short": (lambda q, p, a, b: (a[1:], b[1:]), ConvergenceError, "must answer with .* of shape"),
    "is a table": (lambda q, p, a, b: (a[None], b[None]), ConvergenceError, "must answer with .* of shape"),
    "is nothing": (lambda q, p, a, b: None, *NO_ARRAYS),
    "is a number": (lambda q, p, a, b: 3.0, *NO_ARRAYS),
    "is text": (lambda q, p, a, b: ("a", "b"), *NO_ARRAYS),
    "is ragged": (lambda q, p, a, b: ([[1.0], [1.0, 2.0]], 1.0), *NO_ARRAYS),
    "is three": (lambda q, p, a, b: (a, b, b), *NO_ARRAYS),
    "is complex": (lambda q, p, a, b: (1j * a, b), *NO_ARRAYS),
    "writes": (_writes, SceneError, "read-only"),
}


@pytest.mark.parametrize("case", NONSENSE)
def test_a_law_that_answers_nonsense_is_named(tubes, case):
    """The steps before are kept as they were."""
    answer, kind, message = NONSENSE[case]
    for right, wrong in zip(tubes[::2], with_law(tubes, Own(1.0, 5.0, answer)), strict=True):
        with pytest.raises(kind, match=message) as caught:
            wrong.march(up(0.85), QUIET)
        done, expected = caught.value.history.answers, right.march(up(0.85), QUIET).answers
        assert 0 < len(done) < len(expected)
        for here, there in zip(done, expected, strict=False):
            assert here.unknown == pytest.approx(there.unknown, abs=1e-14)
            assert not here.plastic_strain().any()


def test_a_wrong_slope_is_said_once_and_costs_iterations_alone(tubes):
    """A third of the slope: right answers, slow steps."""
    law = Own(1.0, 5.0, lambda q, p, a, b: (a, 0.3 * b))
    for right, wrong in zip(tubes[::2], with_law(tubes, law), strict=True):
        with pytest.warns(LawWarning, match=r"the slope of Own.* differences of its flow give") as caught:
            history = wrong.march(up(0.85), FINE)
        exact = right.march(up(0.85), FINE)
        assert len(caught) == 1 and sum(history.iterations) > sum(exact.iterations)
        assert apart(history, exact)[0] < 1e-8


def test_laws_of_a_users_own_answer_as_compiled_ones(tubes):
    """The same hardening stated by the user, in lists too, and perfect plasticity as a Bingham body."""
    lists = Own(1.0, 5.0, lambda q, p, a, b: [a.tolist(), b.tolist()])
    for ours, theirs in (((1.0, 5.0), Own(1.0, 5.0)), ((1.0, 5.0), lists), ((1.0, 0.0), Bingham(1.0, 0.0))):
        for models in zip(with_law(tubes, hhr.Plasticity(*ours)), with_law(tubes, theirs), strict=True):
            one, other = (model.march(cycle(0.75), FINE) for model in models)
            assert one.answers[-1].plastic_strain().any() and one.iterations == other.iterations
            for here, there in zip(one.answers, other.answers, strict=True):
                assert here.unknown == pytest.approx(there.unknown, abs=1e-10 * np.abs(one.answers[-1].unknown).max())
                assert here.stress() == pytest.approx(there.stress(), abs=1e-10)


@pytest.mark.parametrize(
    ("kind", "values"),
    [(Plasticity, ("2 +",)), (Plasticity, (1.0, "open('x')")), (Norton, ("", 2.0)), (Plasticity, ("sy", -1.0)),
     (Norton, ("K", 0.5)), (Norton, ("K", None)), (Plasticity, ([80],)), (Plasticity, (80.0, None)),
     (Norton, (20.0, None)), (Plasticity, (80.0, -1.0)), (Plasticity, (0.0,)), (Norton, (1.0, 0.5)),
     (Norton, (0.0, 4.0))],
)  # fmt: skip
def test_constants_of_laws_are_positive_numbers_or_formulas(kind, values):
    """Refused where they are written."""
    with pytest.raises(SceneError, match=r"of (Plasticity|Norton): .*formula|must be positive"):
        kind(*values)


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


@pytest.mark.parametrize("name", LAWS)
def test_right_slopes_are_not_doubted(name):
    """Differences of the laws here agree to 1e-6; the warning is an error in tests."""
    hhr.FullOrderModel(bar(LAWS[name])).march([(k / 4, np.array([0.01 * k / 4])) for k in range(5)])


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
