"""Pages of bodies that flow: increments in node are those of Python, what is refused, what is
drawn.
"""

import base64
import dataclasses
from types import SimpleNamespace

import contract
import numpy as np
import pytest
from condensing import TIGHT, condensed
from flowing_pages import EXACT, FAR, LAWS, cycle, loose, pair, pressing, two_bodies, yielding
from mpi4py import MPI
from needs import needs
from pages_in_node import (
    CHROMIUM,
    ENDED,
    LOADED,
    MODEL,
    check_field,
    data_of,
    dumped,
    in_node,
    node,
    tree_of,
)

import hhr_dolfinx as hhr
from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.contact.law import UNILATERAL
from hhr_dolfinx.errors import NotOfferedError, ParameterError
from hhr_dolfinx.formulas import Modulus
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.materials.elasticity import von_mises
from hhr_dolfinx.plugins.inelastic.condensed_fields import PartFactors
from hhr_dolfinx.plugins.inelastic.update import Group
from hhr_dolfinx.plugins.pages import flow_stress, flowing, page
from hhr_dolfinx.plugins.pages.scenery import thinned

ALONG = (
    LOADED
    + """
const flow = new hhr.Flow(model), steps = new hhr.Steps(model);
let state = steps.rest(path[0]);
for (const point of path.slice(1)) {
  state = steps.reached(state, point);
  found.push({ forces: [...state.forces], cumulated: [...state.cumulated],
    outputs: model.outputs(state), estimate: flow.estimate(state),
    field: [...model.displacement(state)], strained: [...flow.strained(state)],
    stress: [...(model.stress(state) ?? [])] });
}
const told = ({ point, forces }) => ({ point, forces: [...forces] });
const begun = points.map((point) => steps.begun(point).map(told));
console.log(JSON.stringify({ found, begun, fixed: steps.fixed }));
"""
    + ENDED
)


def marched(model, scenery, path, points=()):
    """A path and some first loads as a page answers them in node."""
    given = {
        "path": [point.tolist() for _, point in path],
        "points": [list(point) for point in points],
    }
    return node(ALONG, MODEL, page=page.page_text(model, scenery), **given)


def behind(model, scenery):
    """The cells that a page draws, each once, in their order: those all of whose corners a triangle
    has three of.
    """
    nodes = model.fields.flow.strain.dofs[:, :: model.dimension] // model.dimension
    drawn = [set(corners) for corners in scenery.nodes[scenery.triangles].tolist()]
    return [
        cell
        for cell, own in enumerate(nodes.tolist())
        if any(corners <= set(own) for corners in drawn)
    ]


def check_alike(model, scenery, path, given):
    """Hold what a page found along a path against Python."""
    history = model.march(path, EXACT)
    assert history.cuts == 0
    largest = max(np.abs(answer.forces()).max() for answer in history.answers)
    flowed = max(answer.state().state.cumulated.max() for answer in history.answers)
    assert flowed > 0
    moved = max(np.linalg.norm(answer.displacement()) for answer in history.answers)
    owner = behind(model, scenery)
    weights = model.fields.flow.strain.weights
    for found, answer in zip(given["found"], history.answers, strict=True):
        # means of cells, by modes of other histories
        stress = answer.stress().reshape(*weights.shape, -1)
        exact = von_mises(
            (np.einsum("cp,cpk->ck", weights, stress) / weights.sum(axis=1)[:, None])[owner]
        )
        assert np.abs(np.array(found["stress"]) - exact).max() < 0.03 * exact.max()
        assert max(found["stress"]) == pytest.approx(exact.max(), rel=0.01)
        np.testing.assert_allclose(found["forces"], answer.forces(), rtol=0, atol=1e-9 * largest)
        np.testing.assert_allclose(
            found["cumulated"], answer.state().state.cumulated, rtol=0, atol=1e-9 * flowed
        )
        # directions in whole numbers of half the digits
        assert found["estimate"] == pytest.approx(
            answer.estimate().primal_relative, rel=0.02, abs=1e-4
        )
        check_field(found, answer, scenery, moved, 0.02)
        # means of the points around the nodes are between none and the largest
        assert (
            0 <= min(found["strained"])
            and max(found["strained"]) <= 1.01 * answer.plastic_strain().max() + 1e-12
        )
    assert max(given["found"][-1]["strained"]) > 0.2 * flowed
    return history


@in_node
def test_increments_of_flow_are_those_of_python_where_moduli_vary():
    full, model = pair()
    scenery = hhr.scenery_of(full)
    given = marched(model, scenery, cycle(2.9), [(0.04, 3.1)])
    check_alike(model, scenery, cycle(2.9), given)
    assert given["fixed"] == [1]
    # loaded in proportion at this modulus, in increments that Python repeats
    begun = given["begun"][0]
    points = [np.array(state["point"]) for state in begun]
    assert (
        points[0].tolist() == [0.0, 3.1]
        and points[-1].tolist() == [0.04, 3.1]
        and len(points) == 1 + 27
    )
    last = model.march([(float(k), point) for k, point in enumerate(points)], EXACT).answers[-1]
    np.testing.assert_allclose(
        begun[-1]["forces"], last.forces(), rtol=0, atol=1e-9 * last.forces().max()
    )


@in_node
@pytest.mark.parametrize("name", [name for name in LAWS if name != "moduli"])
def test_laws_on_a_page_are_those_of_python(name):
    """With unknowns, memory, rates, fields, heat, a stress that depends on pressure, and elasticity
    of a law.
    """
    full, model = pair(name)
    scenery = hhr.scenery_of(full)
    check_alike(model, scenery, cycle(2.9), marched(model, scenery, cycle(2.9)))


@in_node
def test_outputs_of_flow_are_on_its_page():
    full, model = yielding()
    scenery = hhr.scenery_of(full)
    path = [(time, np.array(point)) for time, point in contract.path(0.04)]
    given = marched(model, scenery, path)
    history = check_alike(model, scenery, path, given)
    tree = tree_of(model, scenery)
    names = [item["name"] for item in tree["outputs"]]
    assert (
        sorted([*names, *tree["missing"]]) == sorted(history.answers[-1].outputs())
        and len(names) > 1
    )
    for found, answer in zip(given["found"], history.answers, strict=True):
        known = answer.outputs()
        assert found["outputs"] == pytest.approx(
            [known[name] for name in names], rel=1e-8, abs=1e-10
        )


@needs("floating")
@in_node
@pytest.mark.parametrize(
    "rubs", [False, pytest.param(True, marks=needs("friction"))], ids=["smooth", "rough"]
)
@pytest.mark.filterwarnings("ignore:body 2 .* moves along axis 0")
def test_a_loose_block_is_on_a_page_that_of_python(rubs):
    """Its motions are unknowns of each correction, which outputs of displacements and the picture
    read.
    """
    full, model = loose(rubs=rubs)
    assert model.fields.loose.count == (3 if rubs else 2)
    path = pressing(6.7)
    given = marched(model, hhr.scenery_of(full), path)
    answers = model.march(path, FAR).answers
    statuses = np.array([answer.active for answer in answers])
    assert (statuses[:-1] & ~statuses[1:]).any() and (~statuses[:-1] & statuses[1:]).any()
    largest = max(np.abs(answer.forces()).max() for answer in answers)
    moved = max(np.linalg.norm(answer.displacement()) for answer in answers)
    for found, answer in zip(given["found"], answers, strict=True):
        np.testing.assert_allclose(found["forces"], answer.multipliers, rtol=0, atol=1e-8 * largest)
        known = answer.outputs()
        expected = [known[name] for name in ("force", "sunk", "moved")]
        assert found["outputs"] == pytest.approx(
            expected, rel=1e-7, abs=1e-8 * max(map(abs, expected[1:]))
        )
        check_field(found, answer, hhr.scenery_of(full), moved, 0.02)


@needs("floating")
@pytest.mark.filterwarnings("ignore:body 2 .* moves along axis 0")
def test_a_scenery_of_a_softer_loose_block_is_refused():
    """Where nothing but pins of the solver hold a body, S of both is compared without its
    motions.
    """
    full, model = loose()
    page.check_alike(model, hhr.scenery_of(full))
    lower, upper = full.scene.bodies
    softer = dataclasses.replace(
        full.scene, bodies=(lower, dataclasses.replace(upper, young=0.9 * upper.young))
    )
    with pytest.raises(NotOfferedError, match="stiffer or softer"):
        page.check_alike(model, hhr.scenery_of(hhr.FullOrderModel(softer, MPI.COMM_SELF)))


def test_what_does_not_change_within_a_history():
    """Moduli, and constants of laws that no load knows; not a temperature that expands bodies
    too.
    """
    group = Group(np.arange(3), "2 * E", 0.3, hhr.Plasticity("s - T / 9", hardening=0.3))
    modulus = Modulus("2 * E", "1", ("push", "T", "s", "E"))
    slopes = np.array([[0.0, 0.0, 0.0, 0.0], [1.0, 2.0, 0.0, 0.0]])
    model = SimpleNamespace(
        parameters=hhr.ParameterSpace(("push", "T", "s", "E"), (0.0,) * 4, (1.0,) * 4),
        flow=SimpleNamespace(groups=(group,), factors=PartFactors((modulus,), np.ones(1))),
        fields=SimpleNamespace(amplitudes=Amplitudes(np.array([1.0, 0.0]), slopes)),
        law=UNILATERAL,
    )
    assert flowing.fixed(model) == [2, 3]


def test_what_of_flow_is_not_on_a_page():
    full, _ = yielding()
    scenery = hhr.scenery_of(full)
    with pytest.raises(NotOfferedError, match=r"condensed flow, and a \w+ is not of that kind"):
        hhr.write_model_page("none.html", contract.reduced_flow(contract.flowing()), scenery)


def test_moduli_stay_within_a_history_of_whatever_body():
    """Of a body too that has no law, and so no point at which one is evaluated."""
    bodies = (
        hhr.Body(two_blocks.FIRST, 3.0, 0.3, hhr.Plasticity(0.05, 0.2)),
        hhr.Body(two_blocks.SECOND, "5 * w", 0.35),
    )
    base = two_bodies()
    space = hhr.ParameterSpace(("push", "w"), (0.0, 0.2), (0.06, 4.0))
    full = hhr.FullOrderModel(
        dataclasses.replace(base, bodies=bodies, parameters=space), MPI.COMM_SELF
    )
    model = condensed(full, [full.march(cycle(w), TIGHT) for w in (0.5, 4.0)])
    assert flowing.fixed(model) == [1]
    path = [(0.0, np.array([0.0, 4.0])), (1.0, np.array([0.05, 4.0])), (2.0, np.array([0.05, 0.2]))]
    for one in (full, model):
        with pytest.raises(ParameterError, match=r"w changes from 4 to 0\.2 in step 2"):
            one.march(path)


@in_node
def test_beyond_the_limit_load_there_is_no_answer():
    """Strains that are no small ones: Python refuses the step, and so does the page."""
    full, model = pair()
    program = (
        ALONG.split("let state")[0]
        + (
            "const count = flow.points, { calls } = model.kernel;\n"
            "const strain = model.kernel.doubles(calls.strain(), flow.components * count);\n"
            "const small = () => calls.small() === 1, sizes = [0.5, 1.5, 200].map((size) => {\n"
            "  strain.fill(0);\n  strain[count] = -size;\n"
            "  const alone = small();\n  strain.fill(size);\n  return [alone, small()];\n});\n"
            "console.log(JSON.stringify(sizes));"
        )
        + ENDED
    )
    text = page.page_text(model, hhr.scenery_of(full))
    found = node(program, MODEL, page=text, path=[], points=[])
    points = model.flow.points.size
    # one point alone may be strained where there are a hundred and more
    alone = points >= 200
    assert found == [[True, True], [alone, False], [False, False]]


@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not there")
def test_a_browser_loads_in_proportion_to_its_address(tmp_path):
    full, model = pair()
    target = hhr.write_model_page(tmp_path / "page.html", model, hhr.scenery_of(full))
    found = dumped(target, "push=0.05&E1=3", tmp_path)
    for said in ('data-converged="true"', "cumulated plastic strain", "an indicator, not proved"):
        assert said in found
    shares = np.arange(35) / 34  # in fortieths of the box, 0.06
    path = [(float(k), np.array([0.05 * share, 3.0])) for k, share in enumerate(shares)]
    forces = model.march(path, EXACT).answers[-1].forces()
    assert f"<td>sum of forces</td><td>{float(f'{forces.sum():.6g}'):.12g}</td>" in found


def test_each_triangle_has_the_stress_of_its_own_cell_where_a_mesh_is_thinned(monkeypatch):
    full, model = pair()
    scenery = hhr.scenery_of(full)
    owners = flow_stress.cells_of(model, scenery)
    nodes = model.fields.flow.strain.dofs[:, :: model.dimension] // model.dimension
    for cell, corners in zip(owners, scenery.nodes[scenery.triangles], strict=True):
        assert set(corners) <= set(nodes[cell])
    monkeypatch.setattr(page, "DRAWN_NODES", len(scenery.points) // 2)
    told = data_of(page.page_text(model, scenery))
    thin = thinned(dataclasses.replace(scenery, owners=owners), page.DRAWN_NODES)
    assert told["tree"]["strained"] == len(nodes) > len(np.unique(thin.owners))
    kept = np.frombuffer(base64.b64decode(told["arrays"]["stress_cells"]["data"]), dtype="<i4")
    np.testing.assert_array_equal(np.unique(thin.owners)[kept], thin.owners)
    moved = scenery.nodes.copy()
    moved[:3] = moved[3:6]
    with pytest.raises(NotOfferedError, match="of another mesh"):
        page.page_text(model, dataclasses.replace(scenery, nodes=moved[::-1].copy()))
