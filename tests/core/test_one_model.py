"""One contract: full, reduced and condensed models, elastic or flowing, answer the same lines of
user code.

Bases, choices of nodes and indicators of a user's own are one file each, listed in a recipe.
"""

import dataclasses
import json
from contextlib import suppress

import contract
import hertz_half_discs as demo
import numpy as np
import pytest
from needs import needs, present
from scenes import pressed_block, slope
from scipy.stats import spearmanr
from toy_steps import EquilibriumResidual, EveryKth, WholeSurface

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import relative_error
from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import (
    ConvergenceError,
    NotSolvableError,
    ParameterError,
    ReductionError,
    SceneError,
)
from hhr_dolfinx.geometries import block
from hhr_dolfinx.models.estimates import STRESS_INDICATOR
from hhr_dolfinx.models.starts import KnownStatuses
from hhr_dolfinx.warn import collected

ELASTIC = ["full", "condensed", "condensed to forces", "reduced"]
FLOWING = ["full", "reduced"]
ALONG = [(0.0, [0.2]), (0.5, [0.33]), (1.0, [0.41]), (3.0, [0.4101])]
UP_AND_DOWN = [(0.0, [0.0]), (0.5, [0.05]), (1.0, [0.09]), (1.5, [0.07])]
ANYWHERE = hhr.MarchSettings(outside="ignore")


@pytest.fixture(scope="module")
def coarse():
    """Half-discs on a coarse mesh, and their training."""
    full = hhr.FullOrderModel(demo.scene(arc_segments=28, flat_segments=7))
    return full, hhr.compute_snapshots(full, full.parameters.grid([15]))


@pytest.fixture(scope="module")
def elastic_models(coarse):
    """Every elastic model by its name."""
    full, snapshots = coarse
    # statuses known at one end only, so that what is carried on along a path can be told from what
    # is known
    first = KnownStatuses(snapshots.points[:1], snapshots.active[:, :1].T.copy())
    return {
        "full": full,
        "condensed": hhr.exact_condensation(full, first),
        "condensed to forces": hhr.exact_condensation(
            full, snapshots.known_statuses(), field=False
        ),
        "reduced": hhr.build(full, snapshots),
    }


@pytest.fixture(params=ELASTIC)
def elastic(request, elastic_models):
    """One of the elastic models."""
    return elastic_models[request.param]


def yielding():
    """A block whose lid is held sideways, pressed on the floor: half of it yields."""
    scene = pressed_block("plane_strain", cells=8)
    lid = hhr.Displacement(block.side(1, True), 0)
    body = hhr.Body(block.SOLID, 3.0, 0.3, hhr.Plasticity(yield_stress=0.06, hardening=0.3))
    return dataclasses.replace(scene, bodies=(body,), displacements=(*scene.displacements, lid))


def ramp(top, steps=5):
    return [(k / steps, [top * k / steps]) for k in range(steps + 1)]


@pytest.fixture(scope="module")
def flowing_models():
    """Full and reduced model of a block that yields."""
    full = hhr.FullOrderModel(yielding())
    trained, kept = ([full.march(ramp(top)) for top in tops] for tops in ((0.06, 0.1), (0.08,)))
    recipe = hhr.Recipe.flowing(domain=hhr.Rid(1, 3))
    sets = (hhr.SnapshotSet.of_histories(histories) for histories in (trained, kept))
    return {"full": full, "reduced": hhr.build(full, next(sets), recipe, next(sets))}


@pytest.fixture(params=FLOWING)
def flowing(request, flowing_models):
    """One of the flowing models."""
    return flowing_models[request.param]


@pytest.fixture(
    params=[
        *ELASTIC,
        *(pytest.param(f"flowing {kind}", marks=needs("inelastic")) for kind in FLOWING),
    ]
)
def asked(request, elastic_models):
    """Any of them, a parameter and a path."""
    _, flows, kind = request.param.rpartition("flowing ")
    if not flows:
        return elastic_models[kind], 0.37, ALONG
    return request.getfixturevalue("flowing_models")[kind], 0.09, UP_AND_DOWN


# the same lines of user code


def test_a_history_of_an_elastic_model(elastic):
    """Each step is the answer at its point, found from the statuses of the step before."""
    history = elastic.march(ALONG)
    assert history.start == 0.0 and history.parameter.tolist() == [0.2] and history.cuts == 0
    assert [(time, point.tolist()) for time, point in history.path] == ALONG
    assert [answer.time for answer in history.answers] == [0.5, 1.0, 3.0]
    assert history.iterations == [answer.iterations for answer in history.answers]
    start = "nearest"
    for answer, (_, mu) in zip(history.answers, ALONG[1:], strict=True):
        alone = elastic.solve(mu, start=start)
        assert (
            np.array_equal(answer.multipliers, alone.multipliers)
            and answer.iterations == alone.iterations
        )
        assert np.array_equal(answer.displacement(), alone.displacement())
        start = answer.active
    with pytest.raises(ParameterError, match="times must increase"):
        elastic.march([ALONG[0], ALONG[0]])
    # a ten-thousandth further on nothing changes its status
    assert history.iterations[-1] == 1 < elastic.solve(ALONG[-1][1], start=None).iterations


def test_statuses_are_carried_on_where_none_are_known_nearby(elastic_models):
    model = elastic_models["condensed"]
    assert model.march(ALONG).iterations[-1] == 1 < model.solve(ALONG[-1][1]).iterations


@needs("inelastic")
def test_a_history_of_a_flowing_model(flowing, flowing_models):
    """Up and down again: what has flowed stays, and the floor is touched to the end."""
    exact = flowing_models["full"].march(UP_AND_DOWN)
    history = flowing.march(UP_AND_DOWN, ANYWHERE)
    assert [(time, point.tolist()) for time, point in history.path] == UP_AND_DOWN
    assert [answer.time for answer in history.answers] == [0.5, 1.0, 1.5]
    assert (
        history.iterations == [answer.iterations for answer in history.answers]
        and len(history.signs) == 3
    )
    flowed = [answer.plastic_strain() for answer in history.answers]
    assert flowed[0].sum() < flowed[1].sum() and relative_error(flowed[2], flowed[1]) < 0.05
    for answer, reference in zip(history.answers, exact.answers, strict=True):
        assert (
            answer.converged and answer.gauss.stress.shape[0] == answer.gauss.state.cumulated.size
        )
        assert relative_error(answer.displacement(), reference.displacement()) < 0.01
        assert relative_error(answer.forces(), reference.forces()) < 0.05
    # the same point on the way up would bear more
    assert (
        history.answers[-1].forces().sum()
        < 0.9 * flowing.solve(0.07, outside="ignore").forces().sum()
    )


# solve and march, starts, failures


@needs("inelastic")
@pytest.mark.parametrize("mu", [0.02, 0.09])
def test_one_answer_of_a_flowing_model_is_a_history_of_one_step(flowing, mu):
    lower = flowing.parameters.lower
    (step,) = flowing.march([(0.0, lower), (2.5, [mu])], ANYWHERE).answers
    answer = flowing.solve(mu, outside="ignore", duration=2.5)
    assert answer.time == step.time == 2.5
    for name in ("unknown", "multipliers", "active"):
        assert np.array_equal(getattr(answer, name), getattr(step, name)), name
    assert np.array_equal(answer.stress(), step.stress())
    assert np.array_equal(answer.plastic_strain(), step.plastic_strain())


def test_starts_of_an_elastic_model(elastic):
    """Wherever the search starts, it ends at the same statuses."""
    answer = elastic.solve(0.3)
    everything, nothing = np.ones_like(answer.active), np.zeros_like(answer.active)
    for start in ("nearest", None, answer.active, everything, nothing, everything.tolist()):
        found = elastic.solve(0.3, start=start)
        assert np.array_equal(found.active, answer.active)
        assert found.multipliers == pytest.approx(
            answer.multipliers, abs=1e-12 * answer.multipliers.max()
        )
    with pytest.raises(ParameterError, match="int64 of shape"):
        elastic.solve(0.3, start=everything.astype(int))


NO_START = r"start = .* is unknown: 'nearest', None .* or statuses \(\d+,\) bool"
NO_STARTS = "near", 3, [1, 0], [[True], [True, False]], np.ones(3, bool), np.zeros((2, 2), bool)
NO_WORD = r"outside .*unknown, one of warn, refuse, ignore"


@pytest.mark.parametrize(
    ("given", "kind", "why"),
    [
        *(({"start": start}, ParameterError, NO_START) for start in NO_STARTS),
        *(({"outside": word}, ParameterError, NO_WORD) for word in ("warm", None, True)),
        *(({word: False}, TypeError, word) for word in ("raise_on_failrue", "settings")),
    ],
)
def test_questions_that_mean_nothing(asked, given, kind, why):
    """Wherever the parameter lies, and whether or not there is anything outside what a model can
    answer.
    """
    model, mu, _ = asked
    with pytest.raises(kind, match=why):
        model.solve(mu, **given)


def test_nothing_flows_and_a_step_takes_no_time(elastic):
    with pytest.raises(TypeError, match="duration"):
        elastic.solve(0.3, duration=2.0)


@pytest.mark.parametrize("settings", [None, "frozen", {"outside": "ignore"}, hhr.MarchSettings])
def test_settings_that_are_none(asked, settings):
    model, _, path = asked
    with pytest.raises(ParameterError, match=r"settings .* must be MarchSettings, or left out"):
        model.march(path, settings)


@needs("inelastic")
def test_rivals_that_know_no_flow_refuse_it(flowing_models):
    """They answered as if nothing flowed."""
    full = flowing_models["full"]
    snapshots = hhr.SnapshotSet.of_histories([full.march(ramp(0.1))])
    with pytest.raises((ReductionError, SceneError), match=r"flow|have laws"):
        hhr.exact_condensation(full, snapshots.known_statuses())


@needs("inelastic")
@pytest.mark.parametrize("reduced", [False, True])
def test_no_step_is_nan_and_a_status(reduced):
    """A column of perfect plasticity bears 2 / sqrt(3) of its yield stress in plane strain,
    0.069.
    """
    top = block.side(1, True)
    scene = dataclasses.replace(
        pressed_block("plane_strain"),
        bodies=(hhr.Body(block.SOLID, 3.0, 0.3, hhr.Plasticity(yield_stress=0.06)),),
        contacts=(hhr.Obstacle(top, (0.0, 1.0), 3.0),),
        displacements=tuple(hhr.Displacement(block.side(axis, False), axis) for axis in (0, 1)),
        loads=(hhr.Pressure(top, slope("push")),),
    )
    model = hhr.FullOrderModel(scene)
    if reduced:
        trained = hhr.SnapshotSet.of_histories([model.march(ramp(0.069, 4))])
        recipe = hhr.Recipe.flowing(nodes=(hhr.Deim(), WholeSurface(), hhr.LoadNodes()))
        model = hhr.build(model, trained, recipe.as_it_is())
    assert model.solve(0.065, outside="ignore").converged
    with pytest.raises(ConvergenceError):
        model.solve(0.08, outside="ignore")
    answer = model.solve(0.08, raise_on_failure=False, outside="ignore")
    assert answer.status is Status.DIVERGED and not answer.converged
    fields = answer.displacement(), answer.forces(), answer.stress(), answer.plastic_strain()
    for values in (answer.multipliers, *fields):
        assert values.size and np.isnan(values).all()


# fields of an answer


@needs("inelastic")
def test_fields_of_a_flowing_answer(flowing, flowing_models):
    material = flowing_models["full"].equilibrium.material
    answer = flowing.solve(0.09, outside="ignore")
    assert answer.stress().shape == (material.gauss_points, material.components)
    assert answer.plastic_strain().shape == (material.gauss_points,)
    assert answer.plastic_strain().min() >= 0.0 < answer.plastic_strain().max()
    # where a model evaluates its laws, what it hands out is what they say
    points = flowing.equilibrium.points
    assert np.array_equal(answer.stress()[points], answer.gauss.stress)
    assert np.array_equal(answer.plastic_strain()[points], answer.gauss.state.cumulated)
    estimate, kind = (
        answer.estimate(),
        "bound" if flowing is flowing_models["full"] else STRESS_INDICATOR,
    )
    assert estimate.kind == kind and 0 <= estimate.primal_relative < 1


def test_fields_are_the_callers_own(asked):
    """Forces in kN instead of N, in place: the answer stays what it was."""
    model, mu, _ = asked
    answer = model.solve(mu, outside="ignore")
    names = (
        "displacement",
        "forces",
        "stress",
        *(("plastic_strain",) if present("inelastic") else ()),
    )
    for name in names:
        before = {other: getattr(answer, other)().copy() for other in names}
        field = getattr(answer, name)()
        field *= 1e-3
        for other, values in before.items():
            assert np.array_equal(getattr(answer, other)(), values), (name, other)


# steps of a user's own


def test_a_basis_of_a_users_own(coarse):
    """Every second snapshot: these come back, and those between them are near."""
    full, snapshots = coarse
    model = hhr.build(full, snapshots, hhr.Recipe(EveryKth(2)).as_it_is())
    basis = model.offline.basis[:, : 1 + len(snapshots.points) // 2]
    kept = snapshots.displacements[:, ::2]
    assert basis.shape[1] == kept.shape[1] and basis @ (basis.T @ kept) == pytest.approx(
        kept, abs=1e-10
    )
    found, exact = (
        [one.solve(point).displacement() for point in snapshots.points] for one in (model, full)
    )
    errors = [relative_error(*pair) for pair in zip(found, exact, strict=True)]
    assert max(errors[::2]) < 1e-10 and max(errors) < 0.05


def test_nodes_of_a_users_own(coarse):
    """The whole surface lies in the RID, so that its forces are the model's own."""
    full, snapshots = coarse
    recipe = hhr.Recipe(hhr.Pod(1e-8), (WholeSurface(), hhr.LoadNodes()), hhr.Rid(0, 0), trust=None)
    model = hhr.build(full, snapshots, recipe)
    assert model.offline.sets.A_lambda.tolist() == list(range(len(full.schur)))
    answer = model.solve(0.37)
    assert np.array_equal(answer.forces(), answer.multipliers)
    assert relative_error(answer.forces(), full.solve(0.37).forces()) < 0.01


def test_an_indicator_of_a_users_own(coarse):
    """It ranks answers by their error, 0.93 was seen, and is round-off where the basis holds the
    answer.
    """
    full, snapshots = coarse
    recipe = hhr.Recipe(EveryKth(3), indicator=EquilibriumResidual())
    model, points = hhr.build(full, snapshots, recipe.as_it_is()), full.parameters.random(40, 3)
    stiffness = full.problem.stiffness
    estimates, errors = [], []
    for point in points:
        answer, exact = model.solve(point), full.solve(point)
        wrong = answer.displacement() - exact.displacement()
        estimates.append(answer.estimate().primal_relative)
        errors.append(np.sqrt(wrong @ stiffness @ wrong))
    assert spearmanr(estimates, errors).statistic > 0.5
    everywhere = (hhr.Zone(lambda problem: np.arange(len(problem.points))),)
    exact = dataclasses.replace(recipe, basis=EveryKth(1), nodes=everywhere).as_it_is()
    reproduced = hhr.build(full, snapshots, exact)
    assert (
        max(reproduced.solve(point).estimate().dual_relative for point in snapshots.points) < 1e-10
    )
    assert max(estimates) > 1e-3


class Made:
    """A step that returns what it was given."""

    def __init__(self, made):
        self.made = made

    def modes(self, problem, snapshots, basis=None):
        return self.made(problem)

    nodes = modes


BASIS, NODES = "basis", "nodes"


@pytest.mark.parametrize(
    ("step", "made", "why"),
    [
        (BASIS, lambda p: np.ones((3, 2)), r"have the shape \(3, 2\): finite ones \(400, ell\)"),
        (BASIS, lambda p: np.ones(p.free.size), "finite ones"),
        (BASIS, lambda p: np.full((p.free.size, 2), np.nan), "finite ones"),
        (BASIS, lambda p: np.zeros((p.free.size, 0)), "finite ones"),
        (
            BASIS,
            lambda p: 2 * np.eye(p.free.size)[:, p.free][:, :3],
            r"not orthonormal, by .*: return np\.linalg\.qr",
        ),
        (BASIS, lambda p: np.eye(p.free.size), "moves imposed dofs"),
        (NODES, lambda p: [10**6], r"node 1000000 of <.*Made.*> is not in the mesh"),
        (NODES, lambda p: [-1], "node -1"),
        (NODES, lambda p: [0.5], "must return node numbers"),
        (NODES, lambda p: np.ones(3, bool), "is a mask of shape"),
    ],
)
def test_bases_and_nodes_that_are_none(coarse, step, made, why):
    recipe = hhr.Recipe(Made(made)) if step is BASIS else hhr.Recipe(nodes=(hhr.Deim(), Made(made)))
    with pytest.raises(ReductionError, match=why):
        hhr.build(*coarse, recipe)


def test_zones(coarse):
    """A mask of all nodes, or their numbers, which must be those of the mesh."""
    problem = coarse[0].problem
    nodes = np.arange(len(problem.points))
    assert np.array_equal(hhr.Zone(lambda problem: nodes < 3).nodes(problem, None, None), [0, 1, 2])
    with pytest.raises(ReductionError, match=f"node {nodes.size} of the zone is not in the mesh"):
        hhr.Zone(lambda problem: [nodes.size]).nodes(problem, None, None)


# recipes


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (lambda: hhr.Recipe(basis=hhr.Pod), r"must have modes\(problem, snapshots\), as Pod"),
        (lambda: hhr.Recipe("pod"), r"basis = 'pod' must have modes"),
        (lambda: hhr.Recipe(nodes=hhr.Deim()), "must be a list of at least one choice"),
        (lambda: hhr.Recipe(nodes=()), "must be a list of at least one choice"),
        (
            lambda: hhr.Recipe(nodes=(hhr.Deim,)),
            r"must have nodes\(problem, snapshots, basis\), as Deim\(\)",
        ),
        (lambda: hhr.Recipe(domain=2), "domain = 2 of a recipe must be .*Rid"),
        (lambda: hhr.Recipe(enrichment=3.0), r"enrichment = 3\.0 of a recipe must be .*Enrich"),
        (lambda: hhr.Recipe(trust=True), "trust = True of a recipe must be .*TrustLimits"),
        (
            lambda: hhr.Recipe(indicator=EquilibriumResidual),
            r"must have prepared\(problem, basis, sets\)",
        ),
        *(
            (lambda at=at: hhr.Pod(at), rf"tolerance = {at} of Pod must lie in \(0, 1\)")
            for at in (0.0, 1.0, np.nan)
        ),
        (
            lambda: hhr.Pod(1e-9, norm="H1"),
            "norm = 'H1' of a Pod is unknown: 'euclidean', 'energy' or 'l2'",
        ),
        (lambda: hhr.Pod(1e-9, relative="no"), "relative = 'no' of Pod must be True or False"),
        (lambda: hhr.Pod(1e-9, by_body=1), "by_body = 1 of Pod"),
        (lambda: hhr.ForceDeim(2.0), r"tolerance = 2\.0 of ForceDeim"),
        (lambda: hhr.ForceDeim(1e-9, relative=0.5), "relative = 0.5 of ForceDeim"),
        (lambda: hhr.Deim(1e-6), r"pod = 1e-06 of Deim must have modes"),
        (lambda: hhr.Deim(hhr.Pod), "of Deim must have modes"),
        (lambda: hhr.Zone([1, 2]), "a zone is a function of the problem"),
        (lambda: hhr.Rid(-3), "layers = -3"),
        (lambda: hhr.Rid(1.5), "layers = 1.5"),
        (lambda: hhr.Rid(10**9), "layers"),
        (lambda: hhr.Rid(1, 10**9), "most_layers"),
        (lambda: hhr.Enrich(0.5), "kappa_max = 0.5"),
        (lambda: hhr.Enrich("3"), "kappa_max"),
        (lambda: hhr.Enrich(True), "kappa_max = True must be at least 1"),
        *(
            pytest.param(*case, marks=needs("inelastic"))
            for case in (
                (
                    lambda: hhr.StressDeim(0.0),
                    r"tolerance = 0\.0 of StressDeim must lie in \(0, 1\)",
                ),
                (lambda: hhr.StressDeim(np.nan), "tolerance = nan of StressDeim"),
                (lambda: hhr.FlowDeim("1e-6"), "tolerance = 1e-6 of FlowDeim"),
                (
                    lambda: hhr.Recipe.flowing(tangents=0.1),
                    r"tangents = 0\.1 of a recipe must be .*Tangents",
                ),
                (
                    lambda: hhr.FlowLimits(warn_stress=0.5),
                    "warn_stress = 0.5 of TrustLimits lies beyond",
                ),
                (lambda: hhr.Tangents(states=0), "states = 0 of Tangents"),
                (lambda: hhr.Tangents(least=1.0), r"least = 1\.0 of Tangents"),
                (lambda: hhr.Tangents(least="a"), "least = a of Tangents"),
            )
        ),
    ],
)
def test_recipes_and_steps_that_mean_nothing(made, said):
    with pytest.raises(ReductionError, match=said):
        made()


@needs("inelastic")
def test_training_of_the_other_kind(coarse, flowing_models):
    """Bodies that flow need histories, which other meshes do not have."""
    one = flowing_models["full"]
    with pytest.raises(ReductionError, match="have the shape"):
        hhr.build(one, coarse[1])
    with pytest.raises(ReductionError, match=r"must be histories: SnapshotSet\.of_histories"):
        hhr.build(one, hhr.SnapshotSet.of_answers([one.solve(0.02), one.solve(0.09)]))


def distances(problem, columns, basis, gram):
    """Squared distance of all columns from the span of the first modes, in a norm, by the number of
    modes.
    """
    found = []
    for count in range(1, basis.shape[1]):
        modes = basis[:, :count]
        rest = columns - modes @ np.linalg.solve(
            modes.T @ (gram @ modes), modes.T @ (gram @ columns)
        )
        found.append(np.einsum("ns,ns->", rest, gram @ rest))
    return np.array(found)


def test_norms_of_a_pod(coarse):
    """With all modes kept the space is the same.

    Its first modes are the best there are in the norm asked for.
    """
    full, snapshots = coarse
    problem, few = full.problem, snapshots.take([0, 4, 8, 11, 14])
    grams = {
        "euclidean": np.eye(problem.free.size),
        "energy": problem.stiffness,
        "l2": problem.mass,
    }
    bases = {norm: hhr.Pod(1e-11, norm=norm).modes(problem, few) for norm in grams}
    for norm, basis in bases.items():
        assert basis.shape[1] == 5 and basis.T @ basis == pytest.approx(np.eye(5), abs=1e-12)
        columns = few.displacements
        assert basis @ (basis.T @ columns) == pytest.approx(columns, abs=1e-9)
        ours = distances(problem, columns, basis, grams[norm])
        for other in set(bases) - {norm}:
            theirs = distances(problem, columns, bases[other], grams[norm])
            assert (ours <= theirs * (1 + 1e-9)).all() and (ours < theirs * (1 - 1e-6)).any(), (
                norm,
                other,
            )


@pytest.mark.parametrize(
    "recipe",
    [
        hhr.Recipe(),
        *([hhr.Recipe.flowing()] if present("inelastic") else []),
        hhr.Recipe.thesis(1e-8).as_it_is(),
        hhr.Recipe(
            hhr.Pod(np.float64(1e-9)),
            (hhr.Deim(hhr.Pod(1e-6)), hhr.Zone(demo.scene)),
            hhr.Rid(np.int64(1)),
        ),
        hhr.Recipe(
            EveryKth(2),
            (WholeSurface(), Made(len)),
            indicator=EquilibriumResidual(),
            enrichment=None,
        ),
    ],
)
def test_a_recipe_is_described_in_plain_values(recipe):
    described = recipe.described()
    assert json.loads(json.dumps(described, allow_nan=False)) == described
    assert set(described) == {item.name for item in dataclasses.fields(recipe)}
    assert described["basis"]["step"] == type(recipe.basis).__name__
    assert described["nodes"][0]["step"] == type(recipe.nodes[0]).__name__
    assert described["domain"]["layers"] == int(recipe.domain.layers)
    assert (described["enrichment"] is None) is (recipe.enrichment is None)


# histories as training, of models that flow and of models that do not


def warnings_of(snapshots, held_out, full):
    with collected() as caught, suppress(ReductionError, NotSolvableError):
        hhr.build(full, snapshots, None, held_out)
    return " ".join(str(item.message) for item in caught)


def test_an_elastic_history_is_as_good_as_its_points():
    """Off a path that was trained, forces were 60 % wrong without a word.

    Each step is a point like any other.
    """
    full = hhr.FullOrderModel(contract.blocks())
    low, high = np.array([full.parameters.lower, full.parameters.upper])
    path = [(k / 30, low + k / 30 * (high - low)) for k in range(31)]
    histories = hhr.SnapshotSet.of_histories([full.march(path)])
    assert "of their box empty" in warnings_of(histories, histories, full)
    one = hhr.SnapshotSet.of_histories([full.march([path[0], path[-1]])])
    points = hhr.compute_snapshots(full, full.parameters.grid([5, 5]))
    told = warnings_of(points, one, full)
    assert (
        "only 1 solutions were kept out of training" in told
        and "Give at least 20 as held_out" in told
    )
    assert "kept out of training" not in warnings_of(points, histories, full)


@needs("inelastic")
def test_histories_of_another_kind_of_scene(flowing_models):
    """As snapshots or held out, alone or beside others."""
    full, elastic = (
        flowing_models["full"],
        hhr.FullOrderModel(pressed_block("plane_strain", cells=8)),
    )
    flows, stays = (model.march(ramp(0.1)) for model in (full, elastic))
    flowed, stayed = (hhr.SnapshotSet.of_histories([history]) for history in (flows, stays))
    mixed = hhr.SnapshotSet.of_histories([stays, flows])
    for snapshots, held_out in ((stayed, None), (mixed, None), (flowed, stayed)):
        with pytest.raises(
            ReductionError, match=r"bodies of the model flow, and none of .* do: .* another scene"
        ):
            hhr.build(full, snapshots, None, held_out)
    for snapshots, held_out in ((flowed, None), (stayed, flowed)):
        with pytest.raises(
            ReductionError, match="have laws, and none of the model do: they are of another scene"
        ):
            hhr.build(elastic, snapshots, hhr.Recipe(trust=None), held_out)


def test_what_is_no_full_model(coarse):
    full, snapshots = coarse
    for model in (full.scene, snapshots, None):
        with pytest.raises(ReductionError, match=r"is no full model: give FullOrderModel\(scene\)"):
            hhr.build(model, snapshots)
