"""Pages with friction where more than loads acts: bodies that friction alone holds, and bodies that
flow.

Increments in node are those of Python, which the tests of friction and of laws hold against
references of their own.
"""

import dataclasses
from functools import cache

import numpy as np
import pytest
from condensing import TIGHT, condensed
from mpi4py import MPI
from needs import needs
from scenes import slope, space
from sheared import FIRST, SECOND, round_block, rubbing
from test_pages import (
    ENDED,
    LOADED,
    MODEL,
    check_field,
    check_increment,
    drawn_field,
    in_node,
    in_space,
    node,
)

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.geometries.two_blocks import side
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
EXACT = hhr.MarchSettings(relative_force=1e-11, iterations=200)


def held_by_friction(dimension):
    """The upper block is pressed and pushed aside by tractions, which friction alone bears."""
    scene = in_space(0.3, cells=3) if dimension == 3 else rubbing(geometry=round_block)
    last = dimension - 1
    top = side(SECOND, last, True)
    loads = {"push": -np.eye(dimension)[last], "shear": np.eye(dimension)[0]}
    loads |= {"aside": np.eye(dimension)[1]} if dimension == 3 else {}
    outputs = (hhr.ContactForce("pull", 0, tuple(np.eye(dimension)[0])),)
    corner = (0.0,) * last + (2.0,)
    outputs += (hhr.DisplacementAt("sinks", corner, last, SECOND),)
    return dataclasses.replace(
        scene,
        displacements=hhr.Displacement.clamp(side(FIRST, last, False), dimension),
        loads=tuple(hhr.Traction(top, tuple(way), slope(name)) for name, way in loads.items()),
        outputs=outputs,
        parameters=space(
            push=(0.0, 0.05),
            shear=(-0.01, 0.01),
            **({"aside": (-0.01, 0.01)} if dimension == 3 else {}),
        ),
    )


LOADS = [
    (0.0, 0.0),
    (0.01, 0.0),
    (0.04, 0.002),
    (0.04, 0.009),
    (0.03, 0.0),
    (0.03, -0.007),
    (0.02, 0.003),
    (0.04, 0.0),
]
"""Pressed, pushed to and fro with up to two thirds of what friction bears, and pressed again."""


def loads_of(model):
    """These loads; in space aside too, and to and fro."""
    if model.dimension == 2:
        return [np.array(point) for point in LOADS]
    return [
        np.array([push, 0.5 * shear, 0.05 * push * np.sin(k)])
        for k, (push, shear) in enumerate(LOADS)
    ]


@cache
def held(dimension):
    """Model, scenery."""
    full = hhr.FullOrderModel(held_by_friction(dimension), MPI.COMM_SELF)
    return hhr.condense(full, fields=True), hhr.scenery_of(full)


def flowing_scene(name):
    """Blocks of which the upper one flows.

    The coefficient of friction is a parameter, or in space it has a limit.
    """
    laws = hhr.Plasticity(0.06, 0.5), hhr.Norton(0.5, 4.0)
    bodies = hhr.Body(FIRST, 3.0, 0.3), hhr.Body(SECOND, 5.0, 0.2, laws[name == "creep"])
    if name == "in space":
        outputs = (hhr.ContactForce("pull", 0, (1.0, 0.0, 0.0)),)
        return dataclasses.replace(
            in_space(hhr.Coulomb(0.6, limit=0.1), cells=2), bodies=bodies, outputs=outputs
        )
    outputs = (
        hhr.ContactForce("pull", 0, (1.0, 0.0)),
        hhr.DisplacementAt("bulges", (1.0, 1.5), 0, SECOND),
    )
    return rubbing("f", bodies=bodies, box={"f": (0.1, 0.6)}, outputs=outputs)


PUSHED = 0.0, 0.02, 0.03, 0.03, 0.02, 0.002, 0.03, 0.03
SHEARED = 0.0, 0.0, 0.02, 0.05, 0.0, -0.03, -0.02, 0.06
"""Pressed, sheared, turned round, let go, and pressed again."""


def tour(model, share=1.0, friction=0.3):
    last = [friction] if "f" in model.parameters.names else []
    rest = [[0.03 * np.sin(k)] if model.dimension == 3 else last for k in range(len(PUSHED))]
    loads = zip(PUSHED, SHEARED, rest, strict=True)
    return [np.array([share * push, share * shear, *others]) for push, shear, others in loads]


@cache
def rubbing_flow(name):
    """Condensed flow with friction, scenery."""
    full = hhr.FullOrderModel(flowing_scene(name), MPI.COMM_SELF)
    tours = tour(full), tour(full, 0.8, 0.5)
    histories = [full.march(list(enumerate(points)), TIGHT) for points in tours]
    return condensed(full, histories), hhr.scenery_of(full)


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
