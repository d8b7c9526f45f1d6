"""A law of interfaces of a user's own: right where its facet is, refused by name everywhere
else.
"""

import dataclasses
from functools import cache
from itertools import pairwise

import my_contact_law
import numpy as np
import pytest
import toy_increments
from mpi4py import MPI
from my_contact_law import PLUGIN, Wear
from needs import needs
from readers_of_plugins import OF_PLUGINS, deck
from scenes import block_scene, slope, space
from scipy.optimize import root

import hhr_dolfinx as hhr
from hhr_dolfinx import registry
from hhr_dolfinx.contact.law import UNILATERAL
from hhr_dolfinx.errors import NotOfferedError, ReductionError, SceneError
from hhr_dolfinx.geometries import block
from hhr_dolfinx.models.condensed import CondensedModel
from hhr_dolfinx.plugins.contact_laws.interface import Interface
from hhr_dolfinx.plugins.contact_laws.steps import LawSteps
from hhr_dolfinx.reduction.reductor import Reductor

YOUNG, POISSON, HEIGHT, WIDTH = 7.0, 0.3, 1.0, 2.0
CONSTANT = 0.05
COMPLIANCE = HEIGHT * (1 - POISSON**2) / YOUNG
"""Depth per pressure of a block that may spread, in plane strain."""
PATH = [(0.0, 0.0), (1.0, 0.01), (1.5, 0.02), (3.0, 0.02), (6.0, 0.015)]
OPENING = [*PATH, (7.0, 0.002), (8.0, 0.025), (8.5, 0.024)]
"""The same, with a step at which nothing touches."""


def scene(**law):
    """A block pressed on an obstacle, whose pressure is the same everywhere."""
    left, top, bottom = (
        block.side(0, upper=False),
        block.side(1, upper=True),
        block.side(1, upper=False),
    )
    return block_scene(
        "wearing",
        {"push": (0.0, 0.03)},
        upper=(WIDTH, HEIGHT),
        cells=(4, 2),
        young=YOUNG,
        poisson=POISSON,
        contacts=(hhr.Obstacle(bottom, (0.0, -1.0), 0.0, **law),),
        displacements=(hhr.Displacement(left, 0), hhr.Displacement(top, 1, slope("push", -1.0))),
        outputs=(hhr.ContactForce("force", 0, direction=(0.0, 1.0)),),
    )


def pressures(path):
    """Pressures and depths by hand: p (k + c dt) = u - w."""
    worn, found = 0.0, []
    for (before, _), (time, push) in pairwise(path):
        dt = time - before
        pressure = max(push - worn, 0.0) / (COMPLIANCE + CONSTANT * dt)
        worn += CONSTANT * dt * pressure
        found.append((pressure, worn))
    return np.array(found).T


def flowing_pressures(path, law):
    """The same of a block that flows: p and the strain that leaves its sides free, by the law at
    one point.
    """
    from hhr_dolfinx.plugins.inelastic.update import Group, Material

    material = Material([Group(np.zeros(1, dtype=np.int64), YOUNG, POISSON, law.at_points(4))], 4)
    state, worn, found = material.at_rest(), 0.0, []
    for (before, _), (time, push) in pairwise(path):
        dt = time - before

        def update(x, state=state, dt=dt, push=push, worn=worn):
            strain = np.array([[x[0], (worn + CONSTANT * dt * x[1] - push) / HEIGHT, 0.0, 0.0]])
            return material.update(strain, state, dt, tangent=False)

        solved = root(
            lambda x, update=update: update(x).stress[0, :2] + [0.0, x[1]], np.zeros(2), tol=1e-12
        )
        assert np.abs(solved.fun).max() < 1e-14 and solved.x[1] > 0
        state = update(solved.x).state
        worn += CONSTANT * dt * solved.x[1]
        found.append((solved.x[1], worn, state.cumulated[0]))
    return np.array(found).T


def install(monkeypatch, plugin):
    every = {**registry.installed(), "my_contact_law": plugin}
    monkeypatch.setattr(registry, "installed", lambda: every)
    for name in ("facet", "memories"):
        monkeypatch.setattr(registry, name, cache(getattr(registry, name).__wrapped__))
    return Wear(CONSTANT)


@pytest.fixture
def wear(monkeypatch):
    return install(monkeypatch, PLUGIN)


@pytest.fixture
def by_steps(monkeypatch):
    """Wear of a plug-in with increments of its own, and without ranges."""
    return install(monkeypatch, toy_increments.PLUGIN)


@pytest.fixture
def full(wear):
    return hhr.FullOrderModel(scene(law=wear), MPI.COMM_SELF)


def test_histories_are_those_by_hand(full, tmp_path):
    """Of the full model, of a condensed one, and of its file."""
    expected, depths = pressures(PATH)
    condensed = hhr.condense(full)
    hhr.save_model(tmp_path / "model.npz", condensed)
    for model in (
        full,
        condensed,
        hhr.load_model(tmp_path / "model.npz", known=[my_contact_law.Wearing]),
    ):
        history = model.march(PATH)
        found = [answer.outputs()["force"] / WIDTH for answer in history.answers]
        np.testing.assert_allclose(found, expected, rtol=1e-9)
        for answer, depth in zip(history.answers, depths, strict=True):
            np.testing.assert_allclose(answer.worn, depth, rtol=1e-9)
        assert model.coupling(0.01) == 0.0 and model.uniqueness(0.01) == "one answer"


def slopes(path):
    """Derivatives of pressures and depths along the push of all steps, by the recurrence of
    :func:`pressures`.
    """
    depth, found = 0.0, []
    for (before, _), (time, _), pressure in zip(
        path[:-1], path[1:], pressures(path)[0], strict=True
    ):
        dt = time - before
        slope = (1.0 - depth) / (COMPLIANCE + CONSTANT * dt) if pressure > 0 else 0.0
        depth += CONSTANT * dt * slope
        found.append(slope)
    return np.array(found)


def test_derivatives_of_histories_are_those_by_hand(full):
    """Of contacts that open and close again: the depth keeps its derivative in the step without
    force.
    """
    expected, _ = pressures(OPENING)
    assert (expected == 0).tolist() == [False] * 4 + [True] + [False] * 2
    for model in (full, hhr.condense(full)):
        answers = model.march(OPENING, hhr.MarchSettings(gradient=True)).answers
        found = [answer.outputs()["force"] / WIDTH for answer in answers]
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)
        changes = [answer.outputs().gradient["force"][0] / WIDTH for answer in answers]
        np.testing.assert_allclose(changes, slopes(OPENING), rtol=1e-9, atol=1e-9)


def test_ranges_answer_as_increments_of_its_own(full, monkeypatch):
    """Another solver, an active set, on the same backward Euler: equal but for round-off of S,
    cond(S) < 100.
    """
    exact = full.march(OPENING).answers
    own = hhr.FullOrderModel(scene(law=install(monkeypatch, toy_increments.PLUGIN)), MPI.COMM_SELF)
    assert type(own.law) is my_contact_law.Wearing and isinstance(full.law, Interface)
    for one, other in zip(exact, own.march(OPENING).answers, strict=True):
        np.testing.assert_allclose(one.forces(), other.forces(), rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(one.worn, other.worn, rtol=1e-12, atol=1e-15)
        np.testing.assert_array_equal(one.active, other.active)
    assert np.isnan(own.coupling(0.01)) and own.uniqueness(0.01) == "unknown"
    with pytest.raises(NotOfferedError, match="derivatives of wear are not built in"):
        own.march(PATH, hhr.MarchSettings(gradient=True))


@needs("inelastic")
def test_bodies_that_flow_wear_as_by_hand(wear, tmp_path):
    """Facet ``range`` in the steps of full and condensed models, and of a file: to the tolerance of
    steps, 1e-10.

    Newton's slope of a condensed step has that of the forces, else it took more iterations.
    """
    from hhr_dolfinx.plugins.inelastic.condense_flow import CorrectionSettings

    law = hhr.Plasticity(0.05, 0.5)
    flowing = dataclasses.replace(
        scene(law=wear), bodies=(hhr.Body(block.SOLID, YOUNG, POISSON, law),)
    )
    full = hhr.FullOrderModel(flowing, MPI.COMM_SELF)
    tight = hhr.MarchSettings(
        relative_force=1e-11, relative_stress=1e-11, floor_stress=1e-11, outside="ignore"
    )
    pressure, depth, cumulated = flowing_pressures(PATH, law)
    assert cumulated[-1] > 1e-3
    condensed = hhr.build(
        full,
        hhr.SnapshotSet.of_histories([full.march(PATH, tight)]),
        CorrectionSettings(trust=None),
    )
    hhr.save_model(tmp_path / "model.npz", condensed)
    for model in (
        full,
        condensed,
        hhr.load_model(tmp_path / "model.npz", known=[my_contact_law.Wearing]),
    ):
        answers = model.march(PATH, tight).answers
        assert model is full or max(answer.iterations for answer in answers) <= 6
        np.testing.assert_allclose(
            [a.outputs()["force"] / WIDTH for a in answers], pressure, rtol=1e-8
        )
        np.testing.assert_allclose(
            [a.worn for a in answers], np.outer(depth, np.ones(5)), rtol=1e-8
        )


def test_steps_are_cut_until_forces_decay_as_they_should(full):
    """Held where it is, p decays by exp(-c t / k)."""
    held = [(0.0, 0.0), (1e-6, 0.02), (4.0, 0.02)]
    answer = hhr.condense(full).march(held, hhr.MarchSettings(time_tolerance=1e-3)).answers[-1]
    exact = 0.02 / COMPLIANCE * np.exp(-CONSTANT * 4.0 / COMPLIANCE)
    assert answer.parts > 4
    assert (
        answer.outputs()["force"] / WIDTH == pytest.approx(exact, rel=20 * answer.time_error) != 0
    )
    assert answer.time_error < 0.05


def test_histories_are_kept_and_go_on(full, tmp_path):
    stores = (hhr.SnapshotStore(tmp_path, full) for _ in range(2))
    known, again = (
        hhr.compute_snapshots(full, [PATH], store=store).histories[0] for store in stores
    )
    for one, other in zip(known.answers, again.answers, strict=True):
        np.testing.assert_array_equal(one.worn, other.worn)
    further = full.march(PATH, known=list(again.answers[:2]))
    np.testing.assert_array_equal(further.answers[-1].multipliers, known.answers[-1].multipliers)


def _store(full):
    return hhr.compute_snapshots(full, [PATH])


def fields(full, path):
    hhr.write_fields(path / "a.vtu", full, full.march(PATH).answers[-1])


REFUSING = [
    pytest.param(fields, "not built in", marks=needs("plots")),
    pytest.param(OF_PLUGINS["studies"], "remember their path", marks=needs("studies")),
    pytest.param(
        deck, r"a deck of contacts with wear .* it has no facet 'deck'", marks=needs("exporters")
    ),
]


@pytest.mark.parametrize(("read", "why"), REFUSING)
def test_what_does_not_know_it_refuses_it(read, why, full, tmp_path):
    with pytest.raises(NotOfferedError, match=why):
        read(full, tmp_path)


def test_a_facet_without_increments_refuses(by_steps, monkeypatch):
    full = hhr.FullOrderModel(scene(law=by_steps), MPI.COMM_SELF)
    monkeypatch.setattr(registry, "facet", lambda *_: LawSteps())
    with pytest.raises(
        NotOfferedError, match="increments of elastic bodies are not built in with wear"
    ):
        full.march(PATH)


def test_without_its_plug_in_it_is_refused():
    with pytest.raises(SceneError, match="no plug-in reads it"):
        scene(law=Wear(CONSTANT))


def denying(monkeypatch):
    monkeypatch.setattr(my_contact_law.Wearing, "remembers", False, raising=False)


def unread(monkeypatch):
    own = lambda cls, laws, scene, rows, pairs, *_: (rows, pairs, UNILATERAL)  # noqa: E731
    monkeypatch.setattr(Wear, "attached", classmethod(own))


def of_another(monkeypatch):
    monkeypatch.setattr(my_contact_law.Wearing, "plugin", "")


def cut(monkeypatch):
    whole = Wear.attached.__func__

    def own(cls, laws, scene, rows, pairs, *more):
        return whole(cls, laws, scene, rows.take([0]), pairs[:1], *more)

    monkeypatch.setattr(Wear, "attached", classmethod(own))


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (
            denying,
            r"Wearing says that it does not remember, and its increments read 'worn' of its memory",
        ),
        (unread, r"attached\(\) of Wear returned Unilateral.*would leave out wear 0.05"),
        (of_another, r"of the plug-in 'my_contact_law', is needed"),
        (cut, "must append rows to the conditions"),
    ],
)
def test_a_law_is_in_the_problem_or_refused(change, why, wear, monkeypatch):
    """No flag decides whether a law is read: a wear that models leave out would be a pressure that
    never falls.
    """
    change(monkeypatch)
    with pytest.raises(SceneError, match=why):
        hhr.FullOrderModel(scene(law=wear))


def test_a_law_need_not_say_that_it_remembers(wear):
    """A block that is held while it wears: p of the closed form by backward Euler."""
    assert "remembers" not in vars(my_contact_law.Wearing)
    expected, _ = pressures(PATH)
    history = hhr.FullOrderModel(scene(law=wear)).march(PATH)
    assert [answer.outputs()["force"] / WIDTH for answer in history.answers] == pytest.approx(
        expected, rel=1e-9
    )


@dataclasses.dataclass(frozen=True)
class Plane:
    """A pairing of a user's own; its fields do not say which of them is a law."""

    surface: int
    law: object = None
    extra: object = None
    inner: object = None

    @property
    def tags(self):
        return (self.surface,)

    def rows(self, surfaces, dofs):
        return hhr.Obstacle(self.surface, (0.0, -1.0), 0.0).rows(surfaces, dofs)


def test_a_law_of_a_pairing_of_ones_own_is_read_whatever_its_field(wear):
    """By its value: without metadata, in a field of any name, and not inside of another pairing."""
    bottom = block.side(1, upper=False)
    expected, _ = pressures(PATH)
    made = scene()
    for pair in (Plane(bottom, law=wear), Plane(bottom, extra=wear)):
        history = hhr.FullOrderModel(dataclasses.replace(made, contacts=(pair,))).march(PATH)
        assert [answer.outputs()["force"] / WIDTH for answer in history.answers] == pytest.approx(
            expected, rel=1e-9
        )
    inside = Plane(bottom, inner=hhr.Obstacle(bottom, (0.0, -1.0), 0.0, law=wear))
    with pytest.raises(
        SceneError, match=r"contact 0 .* has a law inside of its inner.*give the outer pairing"
    ):
        dataclasses.replace(made, contacts=(inside,))
    with pytest.raises(SceneError, match=r"has law = 0.3, and no plug-in reads it"):
        dataclasses.replace(made, contacts=(Plane(bottom, law=0.3),))


def test_laws_of_several_classes_are_not_read_by_one_of_them(wear):
    """The first class would read the laws of all others as its own."""

    class Other(Wear):
        @classmethod
        def attached(cls, *given):
            raise AssertionError("the first class reads all")

    bottom, right = block.side(1, upper=False), block.side(0, upper=True)
    floor = hhr.Obstacle(bottom, (0.0, -1.0), 0.0, law=wear)
    pairs = floor, hhr.Obstacle(right, (1.0, 0.0), 9.0, law=Other(CONSTANT))
    with pytest.raises(SceneError, match="laws of several classes"):
        hhr.FullOrderModel(dataclasses.replace(scene(), contacts=pairs))


@needs("floating", "friction", "shapes")
def test_scenes_that_it_is_not_made_for_are_refused(wear, monkeypatch):
    """Its rates are divided by areas of one shape, and without its range nothing solves for motions
    of bodies.
    """
    made, lid = scene(law=wear), block.side(1, upper=True)
    free = {"displacements": made.displacements[:1], "loads": (hhr.Pressure(lid, slope("push")),)}
    wide = hhr.Shape(block.SOLID, ("x * (1 + wide)", "y"))
    for changes, why in (
        (free, r"contact alone holds bodies .* wear, does not solve for their motions"),
        (
            {"shapes": (wide,), "parameters": space(push=(0.0, 0.03), wide=(0.0, 0.05))},
            "wear, which reads the areas of slave nodes",
        ),
    ):
        every = {**registry.installed(), "my_contact_law": toy_increments.PLUGIN}
        with monkeypatch.context() as patched, pytest.raises(SceneError, match=why):
            patched.setattr(registry, "installed", lambda every=every: every)
            hhr.FullOrderModel(dataclasses.replace(made, **changes))


@needs("conformance", "sliding")
def test_pairs_that_slide_wear_by_it(wear):
    """Backward Euler of dw/dt = rate p with p H / E = push - w, wherever the block has come to."""
    from sliding_scenes import HEIGHT, PATH, PUSH, YOUNG, drawn

    worn = 0.0
    for answer in hhr.slide(drawn(wear)).march(PATH).answers:
        worn += wear.constant * (PUSH - worn) / (HEIGHT / YOUNG + wear.constant)
        assert answer.memory["worn"] == pytest.approx(worn, rel=1e-5)


class Absent(toy_increments.WearIncrements):
    def answer(self, solved):
        answer = super().answer(solved)
        return answer._replace(unknown=solved.contact.unknown(0 * solved.found.forces))


class Untold(toy_increments.WearIncrements):
    """Has no gradient, and does not say so."""


@needs("conformance")
@pytest.mark.parametrize(
    ("variant", "wrong"), [(Absent, "off the loads"), (Untold, "a gradient is requested")]
)
def test_the_contract_names_what_is_wrong_of_increments(variant, wrong, by_steps, monkeypatch):
    from hhr_dolfinx.testing import check_contact_law

    check_contact_law(by_steps)
    monkeypatch.setattr(
        toy_increments.WearSteps, "increments", lambda self, model, settings: variant(model)
    )
    with pytest.raises(AssertionError, match=wrong):
        check_contact_law(by_steps)


NAMELESS = my_contact_law.Wearing, "parts", lambda self: []
"""Answers of the law depend on nothing, it says."""


@needs("conformance")
def test_the_contract_names_parts_that_are_missing(wear, monkeypatch):
    from hhr_dolfinx.testing import check_contact_law

    monkeypatch.setattr(*NAMELESS)
    with pytest.raises(AssertionError, match="folders of snapshots would mix"):
        check_contact_law(wear)


class Forgets(Reductor):
    def attempt(self, prepared, level):
        found = hhr.exact_condensation(prepared.full, prepared.snapshots.known_statuses())
        return CondensedModel(
            found.parameters, found.eliminated, found.known, found.fields, found.pairs
        ), None


def test_a_model_that_leaves_the_law_out_is_refused(full):
    with pytest.raises(
        ReductionError, match=r"leaves out laws of scene 'wearing', of its contacts \(wear\)"
    ):
        hhr.build(full, _store(full), Forgets())
