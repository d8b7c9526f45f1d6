"""Laws of contacts without memory, and in scenes with others: a gasket of the templates, by closed
forms.
"""

import dataclasses
import shutil

import my_contact_law
import my_gasket
import numpy as np
import pytest
import split_interface
from mpi4py import MPI
from my_contact_law import Wear
from my_gasket import Gasket, Gaskets
from needs import needs
from readers_of_plugins import OF_PLUGINS, deck
from scenes import block_scene, slope
from stacked_pairs import PATH, stacked, with_plugins

import hhr_dolfinx as hhr
from hhr_dolfinx.contact.law import UNILATERAL, ContactLaw
from hhr_dolfinx.errors import NotOfferedError, NotSolvableError, SceneError
from hhr_dolfinx.geometries import block
from hhr_dolfinx.plugins.contact_laws.interface import Interface
from hhr_dolfinx.plugins.contact_laws.ranges import CurveStep, resolvent
from hhr_dolfinx.registry import Plugin

YOUNG, POISSON, WIDTH = 7.0, 0.3, 2.0
COMPLIANCE = (1 - POISSON**2) / YOUNG
"""Depth per pressure of a block of height 1 that may spread, in plane strain."""


@pytest.fixture(autouse=True)
def plugins(monkeypatch):
    with_plugins(monkeypatch)


def scene(law, **changes):
    """A block pressed on an obstacle, whose pressure is the same everywhere."""
    left, top, bottom = (
        block.side(0, upper=False),
        block.side(1, upper=True),
        block.side(1, upper=False),
    )
    given = {
        "upper": (WIDTH, 1.0),
        "cells": (4, 2),
        "young": YOUNG,
        "poisson": POISSON,
        "contacts": (hhr.Obstacle(bottom, (0.0, -1.0), 0.0, law=law),),
        "displacements": (hhr.Displacement(left, 0), hhr.Displacement(top, 1, slope("push", -1.0))),
        "outputs": (hhr.ContactForce("force", 0, direction=(0.0, 1.0)),),
    }
    box = {"push": (0.0, 0.03), **({"k1": (0.1, 9.0), "k3": (0.0, 900.0)} if law.texts else {})}
    return block_scene("sealed", box, **given | changes)


def full_of(law, **changes):
    return hhr.FullOrderModel(scene(law, **changes), MPI.COMM_SELF)


def closure_of(push, linear, cubic):
    """Real root of k3 c^3 + (k1 + 1/k) c = push/k, by its polynomial."""
    roots = np.roots([cubic, 0.0, linear + 1 / COMPLIANCE, -push / COMPLIANCE])
    return float(roots[np.abs(roots.imag) < 1e-12].real[0])


POINTS = [(0.02, 3.0, 200.0), (0.03, 0.1, 900.0), (0.01, 9.0, 1.0)]


def test_pressures_closures_and_gradients_are_those_by_hand(tmp_path):
    """One increment of the full model, a condensed one, and its file."""
    full = full_of(Gasket("k1", "k3"))
    condensed = hhr.condense(full)
    hhr.save_model(tmp_path / "model.npz", condensed)
    kept = hhr.load_model(tmp_path / "model.npz", known=[Gaskets])
    for push, linear, cubic in POINTS:
        c = closure_of(push, linear, cubic)
        stiffness = linear + 3 * cubic * c**2
        # k p' = push' - c', p' = stiffness c' + c k1' + c^3 k3'
        slopes = np.array([1.0, -COMPLIANCE * c, -COMPLIANCE * c**3]) / (1 + COMPLIANCE * stiffness)
        slopes = stiffness * slopes + np.array([0.0, c, c**3])
        for model in (full, condensed, kept):
            answer = model.solve((push, linear, cubic), gradient=True)
            assert answer.outputs()["force"] / WIDTH == pytest.approx(
                linear * c + cubic * c**3, rel=1e-9
            )
            np.testing.assert_allclose(answer.memory["closure"], c, rtol=1e-9)
            forces = answer.gradient.multipliers.sum(axis=0) / WIDTH
            np.testing.assert_allclose(forces, slopes, rtol=1e-7)
            assert answer.iterations < 12 and not answer.gradient.one_sided
        np.testing.assert_array_equal(
            condensed.solve((push, linear, cubic)).forces(), answer.forces()
        )
    assert full.uniqueness(POINTS[0]) == "one answer"
    assert not full.law.path_dependent and full.law.of("my_gasket") is full.law.ranges[0].law


def test_it_depends_on_no_path():
    model = hhr.condense(full_of(Gasket(3.0, 200.0)))
    points = [0.0, 0.03, 0.01]
    history = model.march(list(enumerate(points)), hhr.MarchSettings(time_tolerance=1e-3))
    assert [answer.parts for answer in history.answers] == [2, 2] and history.answers[
        -1
    ].time_error <= 1e-9
    np.testing.assert_allclose(
        history.answers[-1].forces(), model.solve(points[-1]).forces(), rtol=1e-12
    )
    many = model.solve_many(points[1:])
    np.testing.assert_allclose(many[1].forces(), model.solve(points[-1]).forces(), rtol=1e-12)


@pytest.mark.parametrize("stiffness", [1e-6, 1e-3, 1.0, 1e3, 1e6, 1e9])
@pytest.mark.parametrize("power", [1.0, 0.5, 3.0, 9.0])
def test_resolvents_are_roots(stiffness, power):
    """Of a d^p, also where the slope at zero is infinite; d is the given one."""
    closure = np.array([0.0, 1e-12, 1e-3, 1.0, 7.0])

    def curve(d):
        with np.errstate(divide="ignore"):
            return stiffness * d**power, stiffness * power * d ** (power - 1.0)

    expected, slopes = curve(closure)
    force, share, found = resolvent(curve, expected + closure, np.ones(5))
    np.testing.assert_allclose(force, expected, rtol=1e-13, atol=1e-300)
    np.testing.assert_allclose(found + force, closure + expected, rtol=1e-13)
    np.testing.assert_allclose(
        share[1:], (slopes / (1.0 + slopes))[1:] if power > 0.9 else share[1:], rtol=1e-9
    )


def test_a_seal_with_a_first_pressure():
    """f(0) > 0: up to it the seal touches without closing."""
    force, share, closure = resolvent(
        lambda d: (2.0 + d, np.ones(3)), np.array([-1.0, 1.0, 4.0]), np.ones(3)
    )
    np.testing.assert_array_equal(force, [0.0, 1.0, 3.0])
    np.testing.assert_array_equal(share, [0.0, 1.0, 0.5])
    np.testing.assert_allclose(closure, [0.0, 0.0, 1.0], rtol=1e-15)


def test_a_law_that_softens_is_refused(monkeypatch):
    """By the user's constants before anything is solved, and by the curve of any law where it is
    read.
    """
    for law in (Gasket(-1.0), Gasket("k1", "k3 - 100")):
        with pytest.raises(SceneError, match="softens"):
            full_of(law)

    def falls(self, c):
        return self.linear * c * (1.0 - 40.0 * c), self.linear * (1.0 - 80.0 * c)

    monkeypatch.setattr(my_gasket.GasketStep, "curve", falls)
    with pytest.raises(
        NotSolvableError, match=r"falls at the closure .* never falls while the gap closes"
    ):
        full_of(Gasket(3.0)).solve(0.03)


def other_plugin(**own):
    """A second plug-in of wear, with some attributes of its own."""
    name = "other_wear"
    law = dataclasses.dataclass(frozen=True, eq=False)(
        type("Others", (my_contact_law.Wearing,), {"plugin": name, **own})
    )

    class Other(Wear):
        plugin = name

        @classmethod
        def attached(cls, *given):
            rows, pairs, made = super().attached(*given)
            return rows, pairs, law(made.rate)

    facets = {"range": "my_contact_law:WearRange"}
    return Other, Plugin(name=name, memory=("worn",), facets=facets)


def test_laws_state_by_value_what_they_are(monkeypatch):
    """No law is left out: for unilateral contact, for a memory that it denies, or for one of two
    names.
    """
    other, plugin = other_plugin()
    with_plugins(monkeypatch, plugin)
    with pytest.raises(
        SceneError, match="plug-ins 'my_contact_law' and 'other_wear', and both remember 'worn'"
    ):
        hhr.FullOrderModel(stacked(Wear(0.05), other(0.05)))
    denies, plugin = other_plugin(remembers=False)
    with_plugins(monkeypatch, plugin)
    with pytest.raises(
        SceneError, match="Others says that it does not remember, and its increments read 'worn'"
    ):
        hhr.FullOrderModel(stacked(None, denies(0.05)))
    monkeypatch.setattr(Gaskets, "remembers", True)
    with pytest.raises(SceneError, match=r"attached\(\) of Gasket returned Unilateral"):
        monkeypatch.setattr(
            Gasket, "attached", classmethod(lambda cls, *given: (given[2], given[3], UNILATERAL))
        )
        full_of(Gasket(3.0))


def test_a_law_that_forgets_to_deny_its_memory_is_solved_all_the_same(monkeypatch):
    """By increments that a law with memory needs, whose end is the same."""
    expected = full_of(Gasket(3.0, 200.0)).solve(0.02)
    monkeypatch.setattr(Gaskets, "remembers", ContactLaw.remembers)
    full = full_of(Gasket(3.0, 200.0))
    assert isinstance(full.law, Interface) and full.law.path_dependent
    np.testing.assert_allclose(full.solve(0.02).forces(), expected.forces(), rtol=1e-9)


@needs("shared_nodes")
def test_contacts_that_share_a_node_share_its_gasket():
    """Two halves of an interface, E = 1e3 and height 1 on both sides: p = u / (2 h / E + 1 / k1),
    as of one face.
    """
    pairs = [
        hhr.NodeToNode(upper, lower, (0, -1), law=Gasket(500.0))
        for upper, lower in zip(split_interface.UPPER, split_interface.LOWER, strict=True)
    ]
    full = hhr.FullOrderModel(split_interface.scene(pairs))
    assert full.conditions == 9 and full.problem.shares is not None
    for answer in (full.solve({"press": 10.0}), hhr.condense(full).solve({"press": 10.0})):
        assert answer.pressure() == pytest.approx(np.full(9, 5.0), rel=1e-9)
        assert dict(answer.outputs().items())["force 1"] == pytest.approx(
            0.5 * split_interface.HALVES["force 1"], rel=1e-9
        )
    with pytest.raises(SceneError, match="their laws differ"):
        hhr.FullOrderModel(
            split_interface.scene((pairs[0], dataclasses.replace(pairs[1], law=Gasket(600.0))))
        )


def fields(full, path):
    hhr.write_fields(path / "a.vtu", full, full.solve(0.02))


REFUSING = [
    pytest.param(fields, "no facet 'report'", marks=needs("plots")),
    pytest.param(OF_PLUGINS["studies"], "remember their path", marks=needs("studies")),
    pytest.param(
        deck, r"a deck of contacts with gasket .* it has no facet 'deck'", marks=needs("exporters")
    ),
]


@pytest.mark.parametrize(("read", "why"), REFUSING)
def test_what_does_not_know_it_refuses_it(read, why, tmp_path):
    with pytest.raises(NotOfferedError, match=why):
        read(full_of(Gasket(3.0, 200.0)), tmp_path)


def test_a_gasket_beside_wear_is_wear_alone_where_it_bears_nothing():
    """The path of the wear beside a gasket that never closes is that of its own solver."""
    alone = hhr.FullOrderModel(stacked(Wear(0.05), None, None, gap=1.0)).march(PATH).answers
    beside = hhr.FullOrderModel(stacked(Wear(0.05), Gasket(1.0), None, gap=1.0)).march(PATH).answers
    for one, other in zip(alone, beside, strict=True):
        assert np.abs(one.forces() - other.forces()).max() <= 1e-12 * np.abs(one.forces()).max()
        assert not other.memory["closure"].any()


def _half(self, forces, slack, stiffness, attempt):
    found = CurveStep.linearised(self, forces, slack, stiffness, attempt)
    return found._replace(on_slack=0.5 * found.on_slack)


def _off(self, forces, slack, stiffness, attempt):
    found = CurveStep.linearised(self, forces, slack, stiffness, attempt)
    return found._replace(off=found.off + 0.1 * slack * stiffness)


def _twice(self, closure):
    return self.linear * closure, 2.0 * self.linear + 0.0 * closure


def _worn_of_all(self):
    return my_gasket.Memory(closure=np.zeros(99))


def _turned(self, rows):
    """Areas of the ends of a row are alike: they tell an order apart where one end is left out."""
    return dataclasses.replace(self, area=self.area[rows[::-1]], law=self.law[rows])


GASKET_LIES = [
    (my_gasket.GasketStep, "linearised", _half, "not Newton's rows"),
    (my_gasket.GasketStep, "linearised", _off, "two values at one"),
    (my_gasket.GasketStep, "curve", _twice, "not Newton's rows"),
    (
        my_gasket.GasketStep,
        "curve",
        lambda self, c: (self.linear * np.sin(300 * c), 0 * c + 1.0),
        "must not fall",
    ),
    (
        my_gasket.GasketStep,
        "curve_slopes",
        lambda self, c: np.zeros((c.size, 4)),
        "`slopes` are not",
    ),
    (my_gasket.GasketRange, "at_rest", _worn_of_all, "Gasket: .*memory of"),
    (Gaskets, "within", lambda self, conditions: self, "memory of"),
    (
        Gaskets,
        "within",
        lambda self, rows: dataclasses.replace(
            self, area=self.area[: len(rows)], law=self.law[rows]
        ),
        "`within`",
    ),
    (Gaskets, "within", _turned, "`within`"),
    (
        Gaskets,
        "parts",
        lambda self: [self.area, self.law],
        "answers depend on `linear`, and its `parts` do not",
    ),
    (
        Gaskets,
        "stored",
        lambda self, memory: {"closure": 0.0 * memory["closure"]},
        "do not keep its memory",
    ),
    (Gaskets, "opened", lambda self, memory: 0.0, "bodies overlap"),
    (
        my_gasket.GasketStep,
        "after",
        lambda self, forces, *at: my_gasket.Memory(closure=0.0 * forces),
        "bodies overlap",
    ),
]


@needs("conformance")
@pytest.mark.parametrize(("kind", "name", "value", "wrong"), GASKET_LIES)
def test_the_contract_names_what_is_wrong(kind, name, value, wrong, monkeypatch):
    from hhr_dolfinx.testing import check_contact_law

    monkeypatch.setattr(kind, name, value)
    with pytest.raises(AssertionError, match=wrong):
        check_contact_law(Gasket("2.0 + 10.0 * push", 50.0))


@needs("conformance", "exporters")
@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
@pytest.mark.parametrize(("old", "new", "wrong"), [
    ("3 * cubic", "2 * cubic", None),  # a slope that is off only slows Newton's method
    ("linear * closure +", "1.01 * linear * closure +", "other forces than Python: off by 0.0"),
    ("return linear", "return linaer", "(?s)not those of a law in C: .*linaer"),
    ("return linear", "return NAN * linear", "a step of the path ends with status 2"),
])  # fmt: skip
def test_the_contract_compares_functions_in_c(old, new, wrong, monkeypatch):
    from hhr_dolfinx.testing import check_contact_law

    text = my_gasket.GasketKernel.text
    assert old in text
    monkeypatch.setattr(my_gasket.GasketKernel, "text", text.replace(old, new))
    if wrong is None:
        check_contact_law(Gasket("2.0 + 10.0 * push", 50.0))
        return
    with pytest.raises(AssertionError, match=wrong):
        check_contact_law(Gasket("2.0 + 10.0 * push", 50.0))


@needs("conformance")
@pytest.mark.parametrize(("name", "value", "wrong"), [
    ("carried", lambda self, before, forces, slack, active: before, "`carried` is not"),
    ("after", lambda self, *at: my_gasket.Memory(worn=np.zeros(3)), "memory of"),
])  # fmt: skip
def test_the_contract_names_what_is_wrong_of_a_memory(name, value, wrong, monkeypatch):
    from hhr_dolfinx.testing import check_contact_law

    monkeypatch.setattr(my_contact_law.WearStep, name, value)
    with pytest.raises(AssertionError, match=wrong):
        check_contact_law(Wear(0.05))


def _hardens(self, before, point, seconds):
    """The depth per force falls as the contact is worn: forces read the memory beside the shift."""
    return my_contact_law.WearStep(
        self.law.rate * seconds / (1.0 + 100.0 * before["worn"]), before["worn"]
    )


@needs("conformance")
def test_a_memory_that_acts_beside_the_shift_has_no_gradient(monkeypatch):
    """Derivatives of histories would leave it out, so that they are refused, or the contract says
    so.
    """
    from hhr_dolfinx.testing import check_contact_law

    monkeypatch.setattr(my_contact_law.WearRange, "step", _hardens)

    monkeypatch.setattr("hhr_dolfinx.plugins.conformance.checks.compilable", lambda plugin: False)
    with pytest.raises(AssertionError, match="by more than `shift`"):
        check_contact_law(Wear(0.05))

    def refused(self, *given):
        raise NotOfferedError("no gradient of a wear that hardens")

    monkeypatch.setattr(my_contact_law.WearStep, "carried", refused)
    check_contact_law(Wear(0.05))
