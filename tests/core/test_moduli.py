"""Elastic constants that are impossible where nothing tried them: every kind of model refuses, none answers."""

import contract
import numpy as np
import pytest
from needs import needs

import hhr_dolfinx as hhr
from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import NotSolvableError

WHERE = 2.71830
"""Value of the parameter at which the constants are impossible, within 1e-4 of it and nowhere else."""
DIP = f"exp(-((E1 - {WHERE}) / 1e-5) ** 2)"
YOUNG = f"E1 * (1 - 3 * {DIP})"
RATIO = f"0.2 + 0.01 * E1 + 0.5 * {DIP}"
POINT = {"push": 0.04, "load": 0.05, "E1": WHERE}


def scene(young, poisson):
    return contract.blocks((young, poisson), box={"E1": (2.0, 4.0)})


@pytest.fixture(scope="module", params=[(YOUNG, 0.3), (YOUNG, "0.2 + 0.02 * E1"), ("E1", RATIO)],
                ids=["modulus of a whole body", "modulus beside a ratio", "ratio"])  # fmt: skip
def training(request):
    return hhr.train(scene(*request.param), hhr.Sobol(24), held_out=4)


MAKE = {
    "full order": lambda training: training.full_order,
    "condensed": lambda training: training.condense(),
    "HHR": lambda training: training.build(hhr.Recipe().as_it_is()),
    "fallback": lambda training: training.safe_model(0.5, recipe=hhr.Recipe().as_it_is()),
}


NEEDED = {"condensed": ("moduli",), "HHR": ("moduli",), "fallback": ("moduli", "fallback")}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=needs(*NEEDED[kind]) if kind in NEEDED else ()) for kind in MAKE]
)
def test_no_model_answers_where_a_constant_is_impossible(training, kind, tmp_path):
    """One by one, in tables, along paths, from a file; beside the point all of them answer."""
    model = MAKE[kind](training)
    beside = {**POINT, "E1": WHERE + 1e-3}
    assert model.solve(beside, outside="ignore").converged
    models = [model]
    if kind in ("condensed", "HHR"):
        hhr.save_model(tmp_path / "model.npz", model)
        models.append(hhr.load_model(tmp_path / "model.npz"))
    for one in models:
        for gradient in (False, True):
            with pytest.raises(NotSolvableError, match=r"is -?[\d.e+-]+ at .*E1 = 2.7183, and must"):
                one.solve(POINT, outside="ignore", gradient=gradient)
        answer = one.solve(POINT, raise_on_failure=False, outside="ignore")
        assert answer.status is Status.UNDEFINED and np.isnan(answer.multipliers).all()
        table = hhr.answer_points(one, np.array([list(beside.values()), list(POINT.values())]), outside="ignore")
        assert table.status[0] == "ok" and "and must" in table.status[1]
        assert np.isfinite(table.forces[0]).all() and np.isnan(table.forces[1]).all()
        with pytest.raises(NotSolvableError, match="and must"):
            one.march([(0.0, list(beside.values())), (1.0, list(POINT.values()))])


@needs("friction", "inelastic")
def test_a_modulus_that_is_impossible_beside_friction_and_flow():
    """Refused in words by marches; a single query without an answer says so, and does not raise where that is asked."""
    bodies = {"friction": {"friction": 0.3}, "flow": {"law": hhr.Plasticity(0.1)}}
    for how in bodies.values():
        full = hhr.FullOrderModel(contract.blocks((YOUNG, 0.3), box={"E1": (2.0, 4.0)}, **how))
        answer = full.solve(POINT, raise_on_failure=False)
        assert not answer.converged and np.isnan(answer.multipliers).all()
        assert full.solve({**POINT, "E1": WHERE + 1e-3}).converged
