"""One contract: all kinds of models, all verbs, all places.

What is refused is refused by name, on the page too.
"""

import contextlib
import sys
import threading
import warnings
from pathlib import Path
from unittest.mock import Mock

import contract
import numpy as np
import pytest
from needs import needs, present
from threadpoolctl import threadpool_info
from threads import THREADS, at_once

import hhr_dolfinx as hhr
from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import NotOfferedError, ParameterError, SingularError
from hhr_dolfinx.models.eliminations.elimination import Elimination
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.one_thread import one_thread

ALL = (
    "baselines",
    "fallback",
    "floating",
    "friction",
    "inelastic",
    "local_models",
    "moduli",
    "shapes",
    "sliding",
    "tables",
)
"""Plug-ins that have kinds of models or places."""


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(kind, marks=() if kind in contract.QUICK else pytest.mark.slow)
        for kind in contract.KINDS
    ],
)
def cases(request):
    return contract.cases_of(request.param)


def test_every_case_answers_or_is_refused_by_name(cases):
    assert not [case for case in cases if case.outcome == "broken"]
    assert len({case.kind for case in cases}) == 1
    assert len(cases) >= (32 if present("fallback") else 24)


@needs(*ALL)
def test_the_page_says_what_is_refused(cases):
    """``python benchmarks/contract.py --page docs/contract.md`` makes it anew."""
    page = (Path(__file__).parents[2] / "docs/contract.md").read_text().splitlines()
    made = contract.page(cases).splitlines()
    start = made.index("|---|---|---|---|---|") + 1
    assert page[:start] == made[:start] and len(contract.KINDS) == 28
    named = [line.split(" | ")[0].removeprefix("| ") for line in page[start:]]
    assert set(named) <= set(contract.KINDS)
    kind = cases[0].kind
    rows = [line for line, name in zip(page[start:], named, strict=True) if name == kind]
    assert rows == made[start:]


@needs("shapes")
def test_outputs_of_forces_alone_have_derivatives_along_a_shape():
    """No row of theirs measures a displacement.

    Full and condensed models agree as they do in their forces.
    """
    training = contract.training("shape")
    point = {**contract.MIDDLE, "crown": 0.01}
    assert {item.count for item in training.full_order.fields.functionals.items} == {0}
    exact = training.full_order.outputs(point, gradient=True).gradient
    found = training.condense().outputs(point, gradient=True).gradient
    for name, slopes in exact.items():
        assert found[name] == pytest.approx(slopes, rel=1e-6, abs=1e-8)


@needs("moduli")
@pytest.mark.parametrize("kind", ["HHR, moduli", "interpolated condensation, moduli"])
@pytest.mark.parametrize(
    "error", [SingularError("K~ is singular"), ParameterError("surfaces slide off")]
)
def test_a_problem_that_cannot_be_made_is_no_answer(kind, error, monkeypatch):
    """One by one, in a table, and behind a model that falls back, which asks the full one
    instead.
    """
    model, mu = contract.model_of(kind), contract.KINDS[kind].mu
    inner = model.eliminated if isinstance(model, ReducedModel) else model
    good = model.solve(mu, outside="ignore")
    assert inner.sizes == (good.unknown.size, good.multipliers.size)
    # of which no contact problem can be made
    failing = type("Failing", (Elimination,), {"__call__": Mock(side_effect=error)})
    monkeypatch.setattr(inner, "eliminated", failing())
    answer = model.solve(mu, raise_on_failure=False, outside="ignore")
    assert answer.status is Status.UNDEFINED and np.isnan(answer.multipliers).all()
    assert answer.unknown.shape == good.unknown.shape and np.isnan(answer.displacement()).all()
    assert answer.estimate() is None and np.isnan(answer.outputs()["force"])
    with pytest.raises(type(error)):
        model.solve(mu, outside="ignore")
    point = np.array([list(mu.values())])
    assert not model.solve_many(point, raise_on_failure=False, outside="ignore").converged.any()
    if present("tables"):
        table = hhr.answer_points(model, point, outside="ignore")
        assert str(error) in table.status[0] and np.isnan(table.forces).all()


@needs("fallback", "exact_errors")
@pytest.mark.parametrize("where", [("solve", "solve_many"), ("estimate", "estimates")])
def test_a_model_that_fails_is_no_reason_to_have_no_answer(where, monkeypatch):
    reduced = contract.training("constant").build(contract.AS_IT_IS)
    safe = hhr.FallbackModel(reduced, contract.training("constant").full_order, 0.05)
    exact = safe.full.solve(contract.MIDDLE)
    owner = safe.reduced if "solve" in where else type(reduced.fields)
    for name in where:
        monkeypatch.setattr(owner, name, Mock(side_effect=SingularError("S is not definite")))
    answer = safe.solve(contract.MIDDLE)
    assert safe.fell_back(answer) and np.array_equal(answer.forces(), exact.forces())
    many = safe.solve_many(np.array([list(contract.MIDDLE.values())]))
    assert np.array_equal(many.forces()[0], exact.forces()) and safe.share == 1.0
    if "estimate" in where:
        with pytest.raises(
            ParameterError, match="start"
        ):  # a mistake of the caller is told, not answered
            safe.solve(contract.MIDDLE, start="rubbish")


def test_a_subclass_may_have_its_own_solve():
    class Counting(hhr.ReducedModel):
        asked = 0

        def solve(self, mu, **how):
            self.asked += 1
            return super().solve(mu, **how)

    model = contract.model_of("HHR, constant")
    counting = Counting(
        model.problem, model.parameters, model.fields, model.trained, known=model.known
    )
    assert np.array_equal(
        counting.solve(contract.MIDDLE).forces(), model.solve(contract.MIDDLE).forces()
    )
    counting.outputs(contract.MIDDLE)
    assert counting.asked == 2


def bits(kind, number, folder):
    """What a model of a kind says by several verbs at a point of its own, as bytes.

    Its file too where it has one.
    """
    model, quiet = contract.model_of(kind), {"outside": "ignore"}
    point = np.array(list(contract.KINDS[kind].mu.values())) * (1 - 0.01 * number)
    found = []
    for gradient in (False, True):
        with contextlib.suppress(NotOfferedError):
            answer = model.solve(point, gradient=gradient, **quiet)
            found += [answer.forces(), answer.displacement()]
            found += (
                []
                if answer.gradient is None
                else [answer.gradient.multipliers, answer.gradient.unknown]
            )
    found.append(model.solve_many(np.stack([point, 0.99 * point]), **quiet).forces())
    if present("tables"):
        found.append(hhr.answer_points(model, point[None], **quiet).forces)
    if (folder / "model.npz").exists():
        found.append(hhr.load_model(folder / "model.npz").solve(point, **quiet).forces())
    return [np.array(part).tobytes() for part in found]


LONG = {
    "sliding past the mesh",
    "full, friction",
    "HHR, friction",
    "interpolated condensation, friction",
    "HHR, friction and floating",
    "HHR, friction and moduli",
    "interpolated condensation, friction and shape",
}
SHARED = [
    pytest.param(
        kind, marks=pytest.mark.slow if "flow" in kind or "local" in kind or kind in LONG else ()
    )
    for kind in contract.KINDS
    if kind != "interpolated condensation, floating"  # which is refused
]
"""Kinds of models that threads share; histories take seconds each."""


@pytest.mark.usefixtures("restless")
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", SHARED)
def test_eight_threads_give_the_bits_of_one_and_leave_the_process_alone(kind, tmp_path):
    """All verbs on one shared model; filters of warnings and threads of BLAS are what they were."""
    with contextlib.suppress(NotOfferedError):
        hhr.save_model(tmp_path / "model.npz", contract.model_of(kind))
    jobs = [lambda k=k: bits(kind, k, tmp_path) for k in range(THREADS)]
    expected = [job() for job in jobs]
    filters, pools = list(warnings.filters), threadpool_info()
    assert at_once(jobs) == expected
    assert warnings.filters == filters
    assert threadpool_info() == pools


def test_blocks_that_overlap_restore_threads_of_blas():
    """The first block sets one thread, the last one restores what was there, in whatever order
    threads leave.
    """
    before = threadpool_info()
    first, second = threading.Barrier(2), threading.Barrier(2)

    def early():
        with one_thread:
            first.wait(timeout=20)
        second.wait(timeout=20)

    def late():
        first.wait(timeout=20)
        with one_thread:
            second.wait(timeout=20)
            assert all(pool["num_threads"] == 1 for pool in threadpool_info())

    at_once([early, late])
    assert threadpool_info() == before


def test_libraries_of_threads_are_sought_again_only_after_an_import(monkeypatch):
    """A search takes longer than an answer; a library that came with a module must be limited
    too.
    """
    with one_thread:
        pass
    search = Mock()
    monkeypatch.setattr("hhr_dolfinx.one_thread.ThreadpoolController", search)
    for _ in range(3):
        with one_thread:
            assert not search.called
    monkeypatch.setattr(one_thread, "_controller", None)
    monkeypatch.setitem(sys.modules, "imported_since", Mock())
    with one_thread:
        assert search.call_count == 1
