"""The problem of a RID for itself, consistent with the whole one."""

import dataclasses

import contact_patch_test as patch
import numpy as np
import pytest
from scenes import whole_domain
from scipy.sparse import issparse

import hhr_dolfinx as hhr
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.plugins.greedy.indicators import _Domain, restricted
from hhr_dolfinx.reduction.projection import open_conditions, reduced_domain


@pytest.fixture(scope="module", params=["node_to_node", "node_to_surface", "mortar"])
def case(request, hertz):
    """A full model, a parameter, and a RID that leaves most of it and some contact out."""
    if request.param == "node_to_node":
        full, mu = hertz, 0.3123
    else:
        pairing = hhr.Mortar if request.param == "mortar" else hhr.NodeToSurface
        turned = patch.scene(pairing, (8, 6), (14, 6), poisson=0.3, angle=1.0, bulge=0.04)
        full, mu = hhr.FullOrderModel(turned), [0.09, 0.03]
    slaves = full.problem.contact_slaves
    sets = reduced_domain(full.problem, slaves[len(slaves) // 2 : len(slaves) // 2 + 2], layers=1)
    assert open_conditions(full.problem, sets).size == 0
    assert 0 < len(sets.A_lambda) < len(slaves) and len(sets.cells) < 0.5 * len(
        full.problem.cell_nodes
    )
    return full, mu, sets


def test_the_restriction_to_everything_is_the_problem(case):
    problem = case[0].problem
    part = restricted(problem, whole_domain(problem))
    assert np.array_equal(part.dofs, np.arange(problem.free.size))
    # forces on imposed dofs are none of a problem of A
    of_all_dofs = {"prolongation", "forces", "pulls"}
    fields = {item.name for item in dataclasses.fields(ContactProblem)} - of_all_dofs
    for name in (*fields, "free", "lifts", "external", "lift_terms", "loads"):
        ours, theirs = getattr(part.problem, name), getattr(problem, name)
        if name in ("stiffness_terms", "lift_terms"):
            (ours,), (theirs,) = ours, theirs
        if issparse(theirs):
            assert abs(ours - theirs).max() == 0, name
        elif isinstance(theirs, np.ndarray):
            assert np.array_equal(ours, theirs), name
        else:
            assert ours is theirs or ours == theirs, name


def test_a_rid_with_the_interface_of_the_full_solution_has_the_full_solution_inside(case):
    full, mu, sets = case
    answer = full.solve(mu)
    domain = _Domain(full.problem, sets)
    assert np.array_equal(domain.inner, sets.A) and not np.setdiff1d(sets.I, domain.interface).size
    field, forces = domain.at(answer.parameter).solved(
        answer.unknown[domain.interface], answer.parameter
    )
    assert answer.forces()[sets.A_lambda].any()
    assert forces == pytest.approx(answer.forces()[sets.A_lambda], abs=1e-8 * answer.forces().max())
    assert field == pytest.approx(answer.unknown[sets.A], abs=1e-9 * np.abs(answer.unknown).max())
    inside = domain.at(answer.parameter)
    residual = inside.residual(answer.unknown[inside.part.dofs], forces, answer.parameter)
    assert np.abs(residual).max() <= 1e-9 * forces.max()


def test_parts_of_the_stiffness_are_restricted_one_by_one(case):
    problem, sets = case[0].problem, case[2]
    parts = dataclasses.replace(
        problem, stiffness_terms=(0.25 * problem.stiffness, 0.75 * problem.stiffness)
    )
    one, two = restricted(problem, sets), restricted(parts, sets)
    assert len(two.problem.stiffness_terms) == 2
    assert (
        abs(one.problem.stiffness - two.problem.stiffness).max()
        < 1e-12 * abs(problem.stiffness).max()
    )


def test_rows_of_one_rank_are_not_enough(hertz):
    problem, half = hertz.problem, 500
    terms, mass = (problem.stiffness[half:],), problem.node_mass[half // 2 :]
    own = dataclasses.replace(problem, stiffness_terms=terms, node_mass=mass, first=half)
    assert own.rows == slice(half, problem.free.size) and not own.whole
    with pytest.raises(
        SceneError, match=rf"rows 500 to {problem.free.size - 1} of {problem.free.size} are held"
    ):
        restricted(own, whole_domain(problem))
