"""hhr.reduce: from a scene and a wished error to a model, held against the full order and norms
worked out here.
"""

import dataclasses
import json
import math
import warnings
from types import SimpleNamespace

import contract
import numpy as np
import pytest
from mpi4py import MPI
from needs import needs, present
from scenes import space

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import (
    NotOfferedError,
    ParameterError,
    SceneWarning,
    SmallStrainWarning,
    StabilityWarning,
    StudyError,
)
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.plugins.one_call import search
from hhr_dolfinx.plugins.one_call.proposals import POINT_COUNTS
from hhr_dolfinx.plugins.one_call.search import attempts
from hhr_dolfinx.plugins.one_call.target import Target, TargetErrors


def worst(model, full, count, names):
    """Largest errors at fresh points, by the formulas of the docstrings, floors of a thousandth of
    the largest size.
    """
    values = {
        "pressure": lambda item: item.forces() / full.problem.contact_areas,
        "forces": lambda item: item.forces(),
        "displacement": lambda item: item.displacement(),
        "peak": lambda item: np.array([item.outputs()["peak"]]),
    }
    rows = []
    for point in full.parameters.random(count, 99):
        exact, found = full.solve(point), model.solve(point)
        stiffness = full.problem.at(point).stiffness
        norms = {
            "displacement": lambda field, k=stiffness: math.sqrt(field @ (k @ field)),
            "forces": np.linalg.norm,
        }
        sizes = [norms.get(name, lambda values: np.abs(values).max()) for name in names]
        there, given = ([values[name](item) for name in names] for item in (exact, found))
        rows.append(
            [(size(b - a), size(a)) for size, a, b in zip(sizes, there, given, strict=True)]
        )
    errors, sizes = np.moveaxis(np.array(rows), -1, 0)
    return dict(
        zip(names, (errors / np.maximum(sizes, 1e-3 * sizes.max(axis=0))).max(axis=0), strict=True)
    )


@pytest.fixture(scope="module")
def varying():
    return hhr.FullOrderModel(contract.blocks(("E1", 0.3), box=contract.MODULI), MPI.COMM_SELF)


def test_a_constant_stiffness_is_condensed_exactly():
    scene = contract.blocks()
    model = hhr.reduce(scene, 1e-6, of=("pressure", "displacement", "peak"))
    (only,) = model.reduction.tried
    assert (
        model.reduction.met
        and only.method == "condensed"
        and only.full_answers == search.BOUND_CHECKS
    )
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    assert max(worst(model, full, 20, ("pressure", "displacement", "peak")).values()) < 1e-9


@needs("moduli")
@pytest.mark.parametrize("error", [0.05, 1e-4])
def test_moduli_are_interpolated_as_far_as_the_wish_asks(varying, error):
    names = ("pressure", "forces", "displacement", "peak")
    model = hhr.reduce(varying, error, of=names)
    assert model.reduction.met
    assert max(worst(model, varying, 50, names).values()) <= error
    assert set(model.reduction.tried[model.reduction.chosen].errors) == set(names)


@needs("moduli")
def test_displacements_of_checks_make_fields_better(varying, monkeypatch):
    """Fields that hardly span anything at first: points where the model expects its largest errors
    help.
    """
    from hhr_dolfinx.plugins.moduli import condense

    monkeypatch.setattr(condense, "START_BYTES", 1e-3)
    monkeypatch.setattr(condense, "FEWEST_STARTS", 4)
    monkeypatch.setattr(condense, "ALONG_NODES", (1, 1))
    model = hhr.reduce(varying, 1e-3, of="displacement")
    first, *_, last = model.reduction.tried
    assert not first.met and last.met and "checks too" in last.setting
    assert worst(model, varying, 50, ["displacement"])["displacement"] <= 1e-3


def hyper_reduced(context):
    return (item for item in attempts(context) if item.method != "condensed")


@needs("moduli")
def test_where_condensation_is_refused_more_and_more_answers_are_trained_on(varying, monkeypatch):
    monkeypatch.setattr(search, "attempts", hyper_reduced)
    model = hhr.reduce(varying, 0.01, of="forces")
    tried = model.reduction.tried
    assert model.reduction.met and {item.method for item in tried} == {"hhr"}
    assert worst(model, varying, 50, ["forces"])["forces"] <= 0.01
    counts = [item.full_answers for item in tried]
    assert counts == sorted(counts) and counts[0] >= POINT_COUNTS[0]


def test_many_conditions_are_tried_both_ways(monkeypatch):
    monkeypatch.setattr(search, "MANY_CONDITIONS", 1)
    model = hhr.reduce(contract.blocks(), 0.01, of="forces")
    assert [item.method for item in model.reduction.tried][:2] == ["condensed", "hhr"]
    times = [item.query for item in model.reduction.tried if item.met]
    assert model.reduction.tried[model.reduction.chosen].query <= search.SIMILAR_TIME * min(times)


@needs("friction")
def test_friction_without_paths_is_asked_at_points():
    model = hhr.reduce(contract.blocks(friction=hhr.Coulomb(0.3)), 0.01, of="pressure")
    assert model.reduction.met and model.law.plugin


@needs("inelastic", "mortar", "paths")
@pytest.mark.slow
def test_bodies_that_flow_are_answered_along_paths():
    import indentation

    scene = indentation.scene(6)
    own = hhr.ParameterSpace(("d", "sy", "H"), (0.02, 200.0, 5e3), (0.03, 300.0, 10e3))
    legs = hhr.Leg({"depth": "d"}, 1.0, 8), hhr.Leg({"depth": 0.0}, 0.5, 4)
    family = hhr.PathFamily(
        "press", scene.parameters, own, {"depth": 0.0, "sy": "sy", "H": "H"}, legs
    )
    model = hhr.reduce(scene, 0.05, of="forces", paths=family)
    assert model.reduction.met
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    for path in family.paths(hhr.Sobol(4, seed=77)):
        exact, found = full.march(path), model.march(path)
        sizes = [np.linalg.norm(answer.forces()) for answer in exact.answers]
        wrong = [
            np.linalg.norm(a.forces() - b.forces())
            for a, b in zip(exact.answers, found.answers, strict=True)
        ]
        assert max(wrong) <= 0.05 * max(sizes)


@needs("moduli")
@pytest.mark.parametrize(
    ("limit", "said"), [({"bytes": 100}, "are allowed"), ({"seconds": 1e-9}, "are over")]
)
def test_a_budget_that_is_too_small_is_said(limit, said, varying):
    with pytest.raises(StudyError, match=said):
        hhr.reduce(varying, 0.01, budget=hhr.Budget(**limit))


@needs("moduli")
def test_the_best_there_is_is_handed_out_where_the_budget_ends(varying, monkeypatch):
    monkeypatch.setattr(search, "attempts", hyper_reduced)
    with pytest.warns(
        StabilityWarning, match="is not met: the 80 full answers of the budget are spent"
    ):
        model = hhr.reduce(varying, 1e-9, of="forces", budget=hhr.Budget(full_answers=80))
    assert not model.reduction.met and model.reduction.full_answers == 80
    assert model.solve(varying.parameters.middle).converged


@needs("moduli")
def test_a_wish_that_cannot_be_met_ends_with_the_best(varying, monkeypatch):
    monkeypatch.setattr(search, "attempts", lambda context: list(hyper_reduced(context))[:2])
    with pytest.warns(StabilityWarning, match="is not met: nothing more is known to be tried"):
        model = hhr.reduce(varying, 1e-12, of="forces")
    assert model.reduction.chosen == np.argmin(
        [item.errors["forces"] for item in model.reduction.tried]
    )
    assert str(model.reduction).count("\n") == 3 and "->" in str(model.reduction)


@needs("moduli")
def test_a_search_goes_on_from_its_folder(tmp_path, varying, monkeypatch):
    monkeypatch.setattr(search, "attempts", hyper_reduced)
    first = hhr.reduce(varying, 0.05, of="forces", folder=tmp_path / "found")
    solved = []
    plain = hhr.FullOrderModel.solve
    monkeypatch.setattr(
        hhr.FullOrderModel, "solve", lambda *given, **how: solved.append(1) or plain(*given, **how)
    )
    again = hhr.reduce(varying, 0.05, of="forces", folder=tmp_path / "found")
    assert not solved
    point = varying.parameters.middle
    np.testing.assert_array_equal(again.solve(point).forces(), first.solve(point).forces())
    kept = json.loads((tmp_path / "found" / "reduction.json").read_text())
    assert kept["met"] and kept["wish"] == {"error": 0.05, "of": ["forces"]}
    loaded = hhr.load_model(tmp_path / "found" / "model.npz")
    np.testing.assert_array_equal(loaded.solve(point).forces(), again.solve(point).forces())


@needs("fallback", "moduli")
def test_the_full_model_stays_behind_where_it_is_asked_for(varying):
    model = hhr.reduce(varying, 0.01, of="pressure", fallback=True)
    assert isinstance(model, hhr.FallbackModel) and model.reduction.met
    assert model.tolerance == 0.01 and model.of == "pressure"
    with pytest.raises(NotOfferedError, match="falls back by one error"):
        hhr.reduce(varying, of=("pressure", "forces"), fallback=True)


@needs("elasticity")
@pytest.mark.parametrize(
    ("how", "kind", "said"),
    [
        ({"error": 0}, ParameterError, r"error = 0 must lie"),
        ({"error": math.nan}, ParameterError, "must lie in"),
        *(({"of": of}, ParameterError, "no error that is known here") for of in ("stress", (), 3)),
        ({"budget": 60}, StudyError, r"hhr\.Budget\(seconds=600\)"),
        ({"paths": [1]}, StudyError, "must be a PathFamily"),
        ({"seed": -1}, StudyError, "seed"),
        ({"folder": 3}, StudyError, "folder"),
    ],
)
def test_bad_wishes_are_refused(how, kind, said, varying):
    with pytest.raises(kind, match=said):
        hhr.reduce(varying, **how)


@needs("paths")
def test_what_is_no_scene_and_paths_that_miss_are_refused():
    with pytest.raises(StudyError, match="is no scene"):
        hhr.reduce("scene.py")
    if present("inelastic"):
        with pytest.raises(NotOfferedError, match=r"give paths=hhr.PathFamily"):
            hhr.reduce(contract.blocks(law=hhr.Plasticity(1.0)))
    scene = contract.blocks()
    box, leg = scene.parameters, hhr.Leg({"push": "push"}, 1.0, 2)
    family = hhr.PathFamily("all", box, box, {"push": 0.01, "load": 0.0}, (leg,))
    with pytest.raises(StudyError, match="do not depend on paths"):
        hhr.reduce(scene, paths=family)


@pytest.mark.parametrize(
    "limits",
    [{"seconds": 0}, {"full_answers": 0}, {"full_answers": 2.5}, {"bytes": -1}, {"seconds": "1"}],
)
def test_a_budget_is_checked(limits):
    with pytest.raises(ParameterError, match="of a budget"):
        hhr.Budget(**limits)


@needs("moduli")
def test_an_output_that_is_zero_but_for_round_off_is_no_reason_to_go_on():
    """A gap that is closed everywhere, and a moment whose terms cancel."""
    closed = contract.blocks(box={"push": (0.03, 0.06)}), hhr.GapAt("gap", 0, (1.5, 1.0))
    turned = contract.blocks(("E1", 0.3), box=contract.MODULI | {"load": (0.0, 1e-9)})
    for scene, output, of in (
        (*closed, "pressure"),
        (turned, hhr.ContactMoment("moment", 0, (1.5, 1.0)), "forces"),
    ):
        found = hhr.reduce(
            dataclasses.replace(scene, outputs=(output,)), 0.01, of=(of, output.name)
        ).reduction
        assert found.met and (scene is turned or len(found.tried) == 1)


@needs("moduli")
def test_an_interpolation_that_has_not_settled_is_not_believed(varying):
    """Kinks lie between its nodes, and a check of few points meets none of them."""
    from hhr_dolfinx.plugins.moduli.interpolate import GridSettings

    finer = hhr.condense(
        varying, fields=True
    )  # by what its bound interpolates, which knows its error
    model = hhr.condense(varying, GridSettings(), fields=True)

    def unresolved(model, **known):
        model.offline = dataclasses.replace(
            model.offline, facts=dataclasses.replace(model.offline.facts, **known)
        )
        return search._unresolved(model)

    assert not model.offline.finer and search._unresolved(model) == 0.0
    assert finer.offline.finer and unresolved(finer, surpluses=[0.004]) == 0.0
    for known in ((0.004, 0.0), (0.0, 0.004)):
        found = unresolved(model, surpluses=known[:1], unresolved=known[1])
        assert found == pytest.approx(search.UNRESOLVED * 0.004)


@needs("moduli")
def test_what_is_expected_of_kinks_is_no_less_than_their_errors():
    """A table of Poisson's ratios has kinks, by which forces are off where hardly any point of a
    check lies.
    """
    young = ("3 * (1 - 1e-3 * T)", "table(T, 20, .3, 300, .33, 600, .4)")
    full = hhr.FullOrderModel(contract.blocks(young, box={"T": (20.0, 600.0)}), MPI.COMM_SELF)
    with warnings.catch_warnings(action="ignore"):
        model = hhr.condense(full, fields=True)
    assert search._unresolved(model) >= worst(model, full, 200, ["pressure"])["pressure"] > 1e-5


@needs("moduli")
def test_what_is_never_offered_is_tried_once(monkeypatch):
    from hhr_dolfinx.plugins.moduli.condense import Condensation

    def refuse(self, task):
        raise NotOfferedError("none of these")

    monkeypatch.setattr(Condensation, "check", refuse)
    model = hhr.reduce(contract.blocks(("E1", 0.3), box={"E1": (2.0, 4.0)}), 0.05, of="forces")
    refused = [item for item in model.reduction.tried if item.method == "condensed"]
    assert len(refused) == 1 and refused[0].outcome.startswith("refused: none of these")


@needs("moduli")
def test_nothing_that_moves_is_named():
    """Surfaces that never meet: forces are zero, and displacements those that are imposed."""
    scene = contract.blocks(("E1", 0.3), box=contract.MODULI)
    box, opened = space(push=(0.005, 0.06), E1=(1.0, 6.0)), (hhr.Opening(0, hhr.Amplitude(0.5)),)
    still = dataclasses.replace(scene, loads=(), outputs=(), openings=opened, parameters=box)
    warned = pytest.warns(
        SceneWarning, match="nothing touches in any of 36 answers of the full model"
    )
    with pytest.raises(StudyError, match=r"there is no model.*all snapshots are zero"), warned:
        hhr.reduce(still, 0.01, of="forces")


@needs("small_strains")
@pytest.mark.parametrize(
    ("push", "said"), [(0.5, "strain"), (5.0, r"at push = .*: a strain of .*narrow it")]
)
def test_large_strains_are_told_of(push, said):
    with pytest.warns(SmallStrainWarning, match=said):
        hhr.reduce(contract.blocks(box={"push": (0.9 * push, push)}), 0.01, of="forces")


@needs("shapes")
def test_pressures_of_bodies_whose_shape_varies_are_over_the_areas_of_their_point():
    wider = ("1 + (x - 1) * (1 + wide * (x - 1))", "y")
    shapes = tuple(hhr.Shape(body, wider) for body in (two_blocks.FIRST, two_blocks.SECOND))
    full = hhr.FullOrderModel(
        contract.blocks(box={"wide": (0.0, 1.0)}, shapes=shapes), MPI.COMM_SELF
    )
    exact = full.solve({"push": 0.05, "load": 0.02, "wide": 1.0})
    shifted = exact.forces() + np.array([0.0, 0.0, 0.01, 0.0])
    errors = TargetErrors(Target(0.01, ("pressure",)), full)
    found = SimpleNamespace(converged=True, parameter=exact.parameter, forces=lambda: shifted)
    areas = full.problem.at(exact.parameter).contact_areas
    assert areas[2] > 1.2 * full.problem.contact_areas[2]
    assert errors.of([found], exact) == pytest.approx(
        0.01 / areas[2] / (exact.forces() / areas).max(), rel=1e-12
    )


def test_a_folder_keeps_the_model_of_one_scene(tmp_path):
    scene = contract.blocks()
    hhr.reduce(scene, folder=tmp_path)
    before = (tmp_path / "model.npz").read_bytes()
    with pytest.raises(
        StudyError, match="holds a model of scene 'contract': choose another one for 'other'"
    ):
        hhr.reduce(dataclasses.replace(scene, name="other"), folder=tmp_path)
    assert (tmp_path / "model.npz").read_bytes() == before
    hhr.reduce(scene, of="forces", folder=tmp_path)  # the same one anew
    with pytest.raises(StudyError, match="has no name"):
        hhr.reduce(scene, folder="")
