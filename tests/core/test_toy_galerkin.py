"""A user's own reductors get comparison, refinement, record and file from the driver, which
believes no claim.
"""

import dataclasses
import pickle
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
from needs import needs, present
from scenes import pressed_pair
from toy_functional import SmoothPeak
from toy_galerkin import Galerkin, GalerkinFields
from toy_reductor import DenseCondensation

import hhr_dolfinx as hhr
from hhr_dolfinx import errors, registry
from hhr_dolfinx.geometries.two_blocks import side
from hhr_dolfinx.models.estimates import ESTIMATE_NUMBERS, Estimate
from hhr_dolfinx.models.exact import ExactFields
from hhr_dolfinx.reduction import build as building
from hhr_dolfinx.reduction import claims
from hhr_dolfinx.reduction.exact import ExactCondensation
from hhr_dolfinx.reduction.reductor import Record, Task, made, outcomes
from hhr_dolfinx.registry import Plugin, Stage, Way
from hhr_dolfinx.trained import TrainedRange
from hhr_dolfinx.warn import collected, warn


def pair(cells=3, **changes):
    return pressed_pair("plane_strain", ((2.0, 0.3), (5.0, 0.3)), cells=cells, **changes)


@pytest.fixture(scope="module")
def training():
    return hhr.train(pair(), hhr.Sobol(16), held_out=20)


class Liar(GalerkinFields):
    """Fields that call themselves exact."""

    exact = True


WAY = Way("toy_galerkin:Galerkin", lambda full: True)


class Lying(Galerkin):
    """Few modes, and no finer ones."""

    def levels(self, task):
        return (1e-4,)


LIES = Lying(fields=Liar), Lying(fields=ExactFields)


def test_it_is_compared_and_refined(training, tmp_path):
    model = training.build(Galerkin())
    record = model.offline
    assert isinstance(record, Record) and record.level in (1e-8, 1e-12)
    assert record.comparison.dual.max() <= 1e-3 and record.facts["modes"] > 4
    assert (
        record.log.refused[0]["level"] == 1e-4
        and "times what is small enough" in record.log.refused[0]["why"]
    )
    hhr.save_model(tmp_path / "toy.npz", model)
    again = hhr.load_model(tmp_path / "toy.npz", [GalerkinFields])
    point = training.full_order.problem.middle
    np.testing.assert_array_equal(again.solve(point).forces(), model.solve(point).forces())


def test_dense_condensation_answers_as_the_full_order_does():
    """Many at once, along a path and copied, beside an output of a user's own.

    check_reductor does all else.
    """
    training = hhr.train(pair(outputs=(SmoothPeak("smooth", 0),)), hhr.Sobol(16), held_out=5)
    model, points = training.build(DenseCondensation()), training.full_order.parameters.random(6, 3)
    exact = np.array([training.full_order.solve(point).forces() for point in points])
    for one in (model, pickle.loads(pickle.dumps(model))):
        along = one.march([(float(k), point) for k, point in enumerate(points)]).answers
        for found, known in (
            (one.solve_many(points).forces(), exact),
            ([a.forces() for a in along], exact[1:]),
        ):
            assert (np.abs(found - known).max(axis=1) <= 1e-9 * known.max(axis=1)).all()


def test_a_reductor_refuses_in_its_own_words_and_others_are_told(training):
    with pytest.raises(ValueError, match="are more than 3"):
        training.build(DenseCondensation(most=3))
    for given, why in (
        ("condensation", "is no recipe"),
        (DenseCondensation, "DenseCondensation is a class, give a value"),
    ):
        with pytest.raises(errors.ReductionError, match=why):
            training.build(given)
    if present("moduli"):
        from hhr_dolfinx.plugins.moduli.condense import Condensation

        with pytest.raises(errors.ReductionError, match="does not depend on parameters"):
            training.build(Condensation())


def returning(found):
    """A way to reduce that returns whatever it is given."""
    return SimpleNamespace(reduced=lambda full, snapshots, held_out: found)


def test_what_a_way_to_reduce_may_return(training):
    """Models of the same scene, and nothing else."""
    model = training.condense()
    assert training.build(returning(model)) is model
    other = hhr.FullOrderModel(pair(cells=4))
    for found, why in (
        (None, "must return a model"),
        ("model", "must return a model"),
        (other, "of the same scene"),
    ):
        with pytest.raises(errors.ReductionError, match=why):
            training.build(returning(found))


@needs("conformance", "elasticity")
def test_it_keeps_the_contract_which_wrong_claims_break():
    from hhr_dolfinx.testing import check_reductor

    check_reductor(Galerkin(), [GalerkinFields])
    for liar in LIES:
        with pytest.raises(AssertionError, match="calls itself exact and is off by"):
            check_reductor(liar, [Liar])


@pytest.mark.parametrize("liar", LIES)
@pytest.mark.parametrize("held_out", [True, False])
def test_a_claim_that_the_comparison_denies_is_refused_by_name(training, liar, held_out):
    """Without validation two fresh answers of the full model deny it: its own training, of all
    modes, would not.
    """
    apart = training if held_out else replace(training, held_out=None)
    with pytest.raises(
        errors.ClaimError, match="Lying: its model calls itself exact and is off by"
    ):
        apart.build(liar)


class Bounding(GalerkinFields):
    """Fields with an estimate of their own: one of its numbers is far too small, the others are
    honest.
    """

    kind = "bound"
    said: ClassVar[dict[str, float]] = {}

    def estimate(self, answer):
        honest = dict.fromkeys(ESTIMATE_NUMBERS, 1e3)
        return Estimate(self.kind, **(honest | self.said))


def bounding(kind="bound", **said):
    """Few modes, with fields that say an estimate of this kind."""
    return Lying(fields=type("Bounding", (Bounding,), {"kind": kind, "said": said}))


BOUNDS = {
    "primal": "displacement in energy",
    "primal_relative": "displacement in energy, relative",
    "forces_euclid": "contact forces",
    "forces_euclid_relative": "contact forces, relative",
    "pressure": "pressure",
    "pressure_relative": "pressure, relative",
}


@pytest.mark.parametrize("number", BOUNDS)
def test_a_bound_that_an_answer_exceeds_is_refused(training, number):
    """Held-out answers deny it, or training ones without these.

    An estimate of the same numbers is no claim.
    """
    for apart in (training, replace(training, held_out=None)):
        with pytest.raises(
            errors.ClaimError, match=f"a bound of 1e-12 of the {BOUNDS[number]}, and the error is"
        ):
            apart.build(bounding(**{number: 1e-12}))
    assert training.build(bounding("estimate", **{number: 1e-12})).offline.comparison is not None


def test_a_bound_of_an_output_that_an_answer_exceeds_is_refused():
    scene = pair(outputs=(hhr.ContactForce("force", 0, (0.0, 1.0)),))
    training = hhr.train(scene, hhr.Sobol(16), held_out=4)
    with pytest.raises(errors.ClaimError, match="a bound of 1e-12 of the force, and the error is"):
        training.build(bounding(outputs={"force": 1e-12}))


@needs("friction")
def test_a_bound_along_a_path_that_an_answer_exceeds_is_refused():
    """Of laws that remember too: what was not compared was believed."""
    contact = hhr.NodeToNode(side(1, 1, True), side(2, 1, False), (0.0, 1.0), friction=0.3)
    points = np.array(
        [[0.005, 0, 0, 0], [0.02, 0, 0.01, 0], [0.05, 0.019, 0.02, 0], [0.03, 0.019, 0, 0]]
    )
    paths = [[(float(k), scale * point) for k, point in enumerate(points)] for scale in (1.0, 1.05)]
    training = hhr.train(pair(contacts=(contact,)), paths[:1], held_out=paths[1:])
    exact = training.condense()

    class Weaker(ExactFields):
        """Forces that are a tenth too large, in a bound that says nothing of them."""

        exact = False

        def forces(self, answer):
            return 1.1 * super().forces(answer)

        def estimate(self, answer):
            return Estimate(
                "bound", **(dict.fromkeys(ESTIMATE_NUMBERS, 1e3) | {"forces_euclid": 1e-9})
            )

    fields = Weaker(
        **{one.name: getattr(exact.fields, one.name) for one in dataclasses.fields(exact.fields)}
    )
    with pytest.raises(
        errors.ClaimError, match="a bound of 1e-09 of the contact forces, and the error is"
    ):
        training.build(returning(exact.changed(fields=fields)))


def test_a_bound_that_holds_is_granted(training):
    assert training.build(bounding()).offline.comparison is not None


def test_round_off_of_an_answer_near_zero_denies_no_bound(training, monkeypatch):
    """Errors are over the largest answer: those of grazing contact are round-off of the others, and
    no lie.
    """
    exact = SimpleNamespace(
        estimate=lambda: Estimate("bound", **dict.fromkeys(ESTIMATE_NUMBERS, 1e-12))
    )
    errors_of = iter([{"contact forces": (0.0, 1.0)}, {"contact forces": (5e-10, 1e-9)}])
    # a name that is looked up at each call, so that the second iterator counts too
    monkeypatch.setattr(claims, "_errors", lambda *given: next(errors_of))
    claims._check_bounds(
        "Honest", training.full_order, [(exact, exact, "loaded"), (exact, exact, "grazing")]
    )
    errors_of = iter([{"contact forces": (0.0, 1.0)}, {"contact forces": (5e-6, 1e-9)}])
    with pytest.raises(
        errors.ClaimError, match="a bound of 1e-12 of the contact forces, and the error is 5e-06"
    ):
        claims._check_bounds(
            "Lying", training.full_order, [(exact, exact, "loaded"), (exact, exact, "grazing")]
        )


def test_a_claim_that_is_true_is_granted(training):
    """By validation, by fresh answers, and without any training."""
    for apart in (training, replace(training, held_out=None)):
        assert apart.condense().fields.exact
    model = made(ExactCondensation(), Task(training.full_order))
    assert model.fields.exact and model.offline.facts is None


@needs("one_call")
@pytest.mark.parametrize("liar", LIES)
def test_a_search_does_not_believe_a_claim(monkeypatch, liar):
    """Four answers within the target would do for an exact model.

    With a target of 90 % all models are within.
    """
    monkeypatch.setattr("hhr_dolfinx.plugins.one_call.search.ways", lambda full: [WAY])
    from hhr_dolfinx.plugins.one_call.proposals import of_more_answers

    monkeypatch.setattr(
        Galerkin, "proposals", lambda self, search: of_more_answers(liar, search), raising=False
    )
    # as if its own comparison had met none of its errors
    monkeypatch.setattr("hhr_dolfinx.reduction.reductor._check_claim", lambda *_: None)
    with pytest.raises(errors.StudyError, match="calls itself exact") as caught:
        hhr.reduce(pair(), 0.9, of="forces")
    assert all(
        row.outcome.startswith("refused: galerkin") for row in vars(caught.value)["reduction"].tried
    )


@needs("one_call")
def test_it_has_rows_of_a_search(monkeypatch):
    monkeypatch.setattr("hhr_dolfinx.plugins.one_call.search.ways", lambda full: [WAY])
    rows = hhr.reduce(pair(), 0.01, of="forces").reduction.tried
    assert (
        {row.method for row in rows} == {"galerkin"}
        and rows[-1].met
        and "40 fresh answers" in rows[-1].known
    )


# ---------------------------------------------------------------- the loop


@dataclass(frozen=True)
class Scripted(Galerkin):
    """Warns and is refused as a script of its levels says."""

    script: dict = field(default_factory=dict)
    level: ClassVar[str] = "step"

    def levels(self, task):
        return self.script

    def attempt(self, prepared, level):
        warn(f"the scene, seen by {level}", errors.SceneWarning)
        warn(f"the model of {level}", errors.StabilityWarning)
        if self.script[level] is None:
            raise errors.UnstableModelError(f"{level} is refused")
        return super().attempt(prepared, 1e-8)

    def off(self, comparison):
        return 0.0


def said(training, script):
    with collected() as caught:
        model = training.build(Scripted(script=script))
    texts = [str(item.message) for item in caught]
    return model, [text for text in texts if "seen by" in text or "model of" in text]


def test_warnings_of_the_scene_survive_refused_attempts(training):
    """Those of a refused model do not."""
    model, texts = said(training, {"one": None, "two": 1.0})
    assert texts == ["the scene, seen by one", "the scene, seen by two", "the model of two"]
    assert model.offline.level == "two" and [
        item["step"] for item in model.offline.log.refused
    ] == ["one"]


def test_warnings_of_the_scene_survive_if_all_is_refused(training):
    with collected() as caught, pytest.raises(errors.UnstableModelError, match="two is refused"):
        training.build(Scripted(script={"one": None, "two": None}))
    assert {"the scene, seen by one", "the scene, seen by two"} <= {
        str(item.message) for item in caught
    }


def test_the_best_attempt_is_returned_if_none_is_good_enough(training, monkeypatch):
    off = iter([3.0, 2.0, 5.0])
    monkeypatch.setattr(Scripted, "off", lambda self, comparison: next(off))
    model, texts = said(training, dict.fromkeys("abc", 1.0))
    assert (
        model.offline.level == "b" and "the model of b" in texts and "the model of a" not in texts
    )
    assert len(model.offline.log.refused) == 3


def test_an_error_that_is_no_refusal_ends_the_loop_with_its_warnings():
    def make(candidate):
        warn("of the scene", errors.SceneWarning)
        raise ValueError(candidate)

    with (
        pytest.warns(errors.SceneWarning, match="of the scene"),
        pytest.raises(ValueError, match="one"),
    ):
        list(outcomes(["one", "two"], make, (errors.UnstableModelError,)))


def test_a_reductor_that_does_not_condense_is_no_condensation(training):
    with pytest.raises(errors.NotOfferedError, match="Galerkin does not condense"):
        Galerkin.usual(None, fields=None)


# ---------------------------------------------------------------- stages


def counted(draft):
    """A stage of a plug-in, after the model was assembled."""
    draft.shared.once("counted", lambda: COUNTED.append(draft.model))


COUNTED = []


def test_a_plug_in_adds_a_stage(training, monkeypatch):
    last = "hhr_dolfinx.reduction.build:assemble"
    stages = (
        Stage("test_toy_galerkin:counted", last),
        Stage("missing:never", last, lambda full, recipe: False),
    )
    COUNTED.clear()
    monkeypatch.setattr(registry, "installed", lambda: {"own": Plugin("own", stages=stages)})
    training.build()
    assert len(COUNTED) == 1
    lost = (Stage("test_toy_galerkin:counted", "missing:stage"),)
    monkeypatch.setattr(registry, "installed", lambda: {"own": Plugin("own", stages=lost)})
    with pytest.raises(errors.ReductionError, match="comes after missing:stage"):
        training.build()


def test_a_scene_loads_the_stages_that_it_wants(training):
    places = building.stages_of(training.full_order, building.usual_recipe(training.full_order))
    assert [place.partition(":")[2] for place in places] == [
        "choose_domain",
        "enrich_basis",
        "project_problem",
        "assess_projection",
        *(["measure"] if present("theorems") else []),
        "check_constants",
        "reconstruct",
        "assemble",
        "start_along",
    ]


def test_a_range_and_a_missing_validation_count_for_anybody(training):
    """The driver limits models that say nothing of their range, and warns where nothing was held
    out.
    """
    with pytest.warns(errors.UncheckedWarning):
        model = hhr.build(training.full_order, training.snapshots, Galerkin())
    assert isinstance(model.trained, TrainedRange)
    space = model.parameters
    low, high = np.array(model.trained.lower), np.array(model.trained.upper)
    assert (low > space.lower).any() or (high < space.upper).any()
    with pytest.raises(errors.OutsideTrainingError):
        model.solve(np.where(high < space.upper, space.upper, space.lower), outside="refuse")
