"""A law of bodies that a stranger's plug-in reads: solved where its facets are there, refused
elsewhere.
"""

import importlib.metadata
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from entry_points import Entry
from mpi4py import MPI
from needs import needs, present
from scenes import pressed_block, with_bodies

import hhr_dolfinx as hhr
from hhr_dolfinx import registry
from hhr_dolfinx.errors import NotOfferedError, SceneError
from hhr_dolfinx.full_order.discretisation import Discretisation
from hhr_dolfinx.models.answer import Answer, History
from hhr_dolfinx.reduction.build import usual_recipe
from hhr_dolfinx.registry import GROUP
from hhr_dolfinx.study.training.train import Training


class Ages:
    """A law by whose name nobody else reads it."""

    def age(self):
        """By this method it is known."""


def check_body(body):
    if body.grading is not None:
        raise SceneError(f"body {body.tag} ages, and is graded: not built in")


SCENES = SimpleNamespace(
    check_body=check_body,
    check_hypothesis=lambda law, hypothesis: None,
    linear_stress=lambda law: None,
    parameters_of=lambda law: set(),
)
"""Facet ``scene``."""


class Bodies:
    """Facet ``full_order``: elastic bodies whose answers remember how many there were before."""

    places = 0

    def __init__(self, scene, kind):
        self.discretisation = kind(Discretisation)(scene, MPI.COMM_SELF)
        self.stiffness, self.moduli = self.discretisation.stiffness_terms()

    def equilibrium(self, full):
        return Equilibrium(full)


class Equilibrium:
    """See :class:`hhr_dolfinx.models.histories.equilibrium.FullEquilibrium`."""

    reader, places = "ageing", 0

    def __init__(self, full):
        self._full = full

    def march(self, model, path, settings=None, *, known=(), keep=lambda answer: None):
        history = History(*path[0])
        for age, (time, point) in enumerate(path[1:], start=1):
            answer: Answer = self._full._answered(point, None, "ignore", False)
            history.answers.append(answer._replace(time=time).remembering(age=age))
        return history

    def one_step(self, model, point, raise_on_failure, outside, gradient, **step):
        return model.march([(0.0, point), (1.0, point)]).answers[-1]

    def stress(self, answer):
        return self._full.stress_of(answer.displacement(), answer.parameter)


def ageing(**facets):
    return registry.Plugin(
        "ageing",
        materials=("age",),
        memory=("age",),
        answers={"years": f"{__name__}:years"},
        facets={"scene": f"{__name__}:SCENES", **facets},
    )


def years(answer):
    return answer.age * 10


BESIDE = [registry.installed()["elasticity"]] if present("elasticity") else []
"""The plug-in of the stiffness of bodies with laws, which keep their volume."""


@pytest.fixture
def registered(monkeypatch):
    def found(*plugins):
        # forms are compiled meanwhile, which asks for other groups
        others = importlib.metadata.entry_points
        mine = [Entry(item) for item in (*plugins, *BESIDE)]

        def known(**asked):
            return mine if asked.get("group") == GROUP else others(**asked)

        monkeypatch.setattr(importlib.metadata, "entry_points", known)
        for name in ("installed", "memories", "asked_of_answers", "facet"):
            monkeypatch.setattr(registry, name, cache(getattr(registry, name).__wrapped__))

    return found


def scene():
    return with_bodies(pressed_block("plane_strain", cells=3), law=Ages())


def test_a_law_that_no_plug_in_reads_is_refused(registered):
    registered()
    with pytest.raises(SceneError, match=r"body 1: no installed plug-in reads the law .*Ages"):
        hhr.Body(1, 1.0, 0.3, Ages())
    registered(ageing())
    for law in (Ages, 3, "steel"):
        with pytest.raises(SceneError, match="must be an object with a method age"):
            hhr.Body(1, 1.0, 0.3, law)
    assert hhr.Body(1, 1.0, 0.3, Ages()).reader == "ageing" and hhr.Body(1, 1.0, 0.3).reader == ""


def test_its_plug_in_says_what_scenes_may_hold(registered):
    registered(ageing())
    with pytest.raises(SceneError, match="body 1 ages, and is graded"):
        hhr.Body(1, 1.0, 0.3, Ages(), grading=lambda x: x[0])
    registered(registry.Plugin("ageing", materials=("age",)))
    with pytest.raises(
        NotOfferedError, match=r"whose bodies have laws is not built in .* no facet 'scene'"
    ):
        hhr.Body(1, 1.0, 0.3, Ages())


def test_laws_of_two_plug_ins_make_no_scene(registered):
    registered(
        ageing(),
        registry.Plugin("other", materials=("other",), facets={"scene": f"{__name__}:SCENES"}),
    )
    given, others = scene(), type("Others", (), {"other": lambda self: None})()
    with pytest.raises(
        SceneError, match=r"laws of bodies of several plug-ins, \['ageing', 'other'\]"
    ):
        replace(given, bodies=(*given.bodies, hhr.Body("another", 1.0, 0.3, others)))


@needs("elasticity")
def test_a_missing_facet_refuses_and_names_it(registered, tmp_path):
    """Where laws are not read they are never taken for elastic bodies."""
    registered(ageing())
    with pytest.raises(NotOfferedError, match=r"the full model of scene .* no facet 'full_order'"):
        hhr.FullOrderModel(scene())
    registered(ageing(full_order=f"{__name__}:Bodies"))
    full = hhr.FullOrderModel(scene())
    middle = full.parameters.middle
    history = full.march([(0.0, middle), (1.0, middle), (2.0, middle)])
    assert [answer.age for answer in history.answers] == [1, 2] and history.answers[
        -1
    ].years() == 20
    answer = full.solve(middle)
    assert answer.age == 1 and np.isfinite(answer.stress()).all()
    with pytest.raises(AttributeError, match="has no 'plastic_strain'"):
        answer.plastic_strain()
    asked = {
        "store": lambda: hhr.SnapshotStore(tmp_path, full),
        "reduction": lambda: usual_recipe(full),
    }
    if present("studies"):
        from hhr_dolfinx.plugins.studies.of_laws import study_of

        asked["study"] = lambda: study_of(full.scene)
    for word, ask in asked.items():
        with pytest.raises(
            NotOfferedError, match=f"what the plug-in 'ageing' adds: it has no facet '{word}'"
        ):
            ask()
    with pytest.raises(NotOfferedError, match="no installed reductor condenses scene"):
        Training(full, None, None, None).condense()
    with pytest.raises(hhr.HHRError, match="have laws"):
        hhr.condense(full)
    snapshots = hhr.SnapshotSet.of_histories([history])
    assert len(snapshots.states) == 2 and snapshots.take([1]).states[0]["age"] == 2
