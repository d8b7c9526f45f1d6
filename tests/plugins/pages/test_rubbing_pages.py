"""Pages with friction where more than loads acts: bodies that friction alone holds, and bodies that
flow.

Increments in node are those of Python, which the tests of friction and of laws hold against
references of their own.
"""

import numpy as np
import pytest
from needs import needs
from pages_in_node import (
    ENDED,
    LOADED,
    MODEL,
    check_field,
    check_increment,
    drawn_field,
    in_node,
    node,
)
from rubbing_pages import EXACT, held, loads_of, rubbing_flow, tour

from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.plugins.pages import page

PROGRAM = (
    LOADED
    + """
const floats = data.tree.floating !== null, steps = new hhr.Steps(model);
if (!floats) new hhr.Flow(model);
let state = steps.rest(path[0]);
for (const point of path.slice(1)) {
  state = steps.reached(state, point);
  const names = ["forces", "position", "path", "work", "wear", "statuses",
    ...(floats ? [] : ["cumulated"])];
  const plain = Object.fromEntries(names.map((name) => [name, [...state[name]]]));
  found.push({ ...plain, outputs: model.outputs(state), field: [...model.displacement(state)] });
}
const ends = points.map((point) => [...steps.begun(point).at(-1).forces]);
console.log(JSON.stringify({ found, ends, fixed: steps.fixed }));
"""
    + ENDED
)


def in_node_along(model, scenery, path, points=()):
    given = {
        "path": [point.tolist() for point in path],
        "points": [list(point) for point in points],
    }
    return node(PROGRAM, MODEL, page=page.page_text(model, scenery), **given)


@needs("friction", "floating")
@in_node
@pytest.mark.parametrize("dimension", [2, 3])
def test_bodies_that_friction_holds_are_those_of_python(dimension):
    """With motions as unknowns, or on springs, as at the first load.

    Outputs and pictures read the motions.
    """
    model, scenery = held(dimension)
    path = loads_of(model)
    history = model.march(list(enumerate(path)))
    assert history.cuts == 0
    given = in_node_along(model, scenery, path, path[2:3])
    largest = max(np.abs(answer.multipliers).max() for answer in history.answers)
    drawn = max(np.linalg.norm(drawn_field(answer, scenery)) for answer in history.answers)
    for found, answer in zip(given["found"], history.answers, strict=True):
        check_increment(found, answer, largest)
        check_field(found, answer, scenery, least=drawn)
    statuses = {status for found in given["found"] for status in found["statuses"]}
    assert {1, 2} <= statuses
    exact = model.solve(path[2]).multipliers
    assert np.linalg.norm(given["ends"][0] - exact) < 1e-8 * np.linalg.norm(exact)


@needs("friction", "inelastic")
@in_node
@pytest.mark.parametrize("name", ["in the plane", "in space", "creep"])
def test_bodies_that_flow_and_rub_are_those_of_python(name):
    """Both march with the same residual, to 1e-11 of the correction."""
    model, scenery = rubbing_flow(name)
    path = tour(model, 0.9)
    history = model.march(list(enumerate(path)), EXACT)
    assert history.cuts == 0
    given = in_node_along(model, scenery, path)
    largest = max(np.abs(answer.multipliers).max() for answer in history.answers)
    flowed = max(answer.state().state.cumulated.max() for answer in history.answers)
    assert flowed > 1e-3
    for found, answer in zip(given["found"], history.answers, strict=True):
        check_increment(found, answer, largest, 1e-8)
        np.testing.assert_allclose(
            found["cumulated"], answer.state().state.cumulated, rtol=0, atol=1e-8 * flowed
        )
    assert {1, 2} <= {status for found in given["found"] for status in found["statuses"]}
    assert given["fixed"] == ([] if name == "in space" else [2])


@needs("friction", "inelastic")
def test_laws_that_no_page_knows_are_refused_where_bodies_flow(monkeypatch):
    """By what the plug-in of the law lacks, as where bodies are elastic."""
    model, _ = rubbing_flow("in the plane")
    monkeypatch.setattr(type(model.law), "plugin", "inelastic")  # which has no such facet
    with pytest.raises(
        NotOfferedError, match=r"a page of contacts with friction is not built in .* no facet"
    ):
        page.check_for_page(model)
