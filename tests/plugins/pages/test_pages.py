"""Pages that answer without Python: the same digits in node as in Python, what is refused, what a
page may not hold.
"""

import dataclasses
import itertools
import re

import contract
import impossible_moduli
import numpy as np
import pytest
from needs import needs
from page_scenes import (
    FORMULAS,
    MORE,
    OF_FRICTION,
    SCENES,
    STRESSES,
    heated,
    known,
    made,
    marked,
    rubbed,
    tour_of,
    values_of_formulas,
)
from pages_in_node import (
    CHROMIUM,
    ENDED,
    LOADED,
    MODEL,
    along,
    check_field,
    check_increment,
    data_of,
    dumped,
    in_node,
    node,
    tree_of,
)
from scenes import slope
from scipy.sparse import csr_matrix
from sheared_blocks import rubbing

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import FileContentError, NotOfferedError
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side
from hhr_dolfinx.materials.elasticity import von_mises
from hhr_dolfinx.models.displacement import dense
from hhr_dolfinx.plugins.pages import page, stress_outputs
from hhr_dolfinx.plugins.pages.packing import Packed, steps_of
from hhr_dolfinx.plugins.pages.pictures import pictures_of
from hhr_dolfinx.plugins.pages.scenery import thinned

PROGRAM = """
const bound = data.tree.bound && new hhr.Bound(model);
const answers = points.map((point) => {
  const answer = model.solve(point), field = model.displacement(answer);
  const told = { forces: [...answer.forces], outputs: model.outputs(answer),
    slopes: model.slopes(answer), converged: answer.converged, error: bound && bound.at(answer),
    field: field && [...field], stress: model.tree.stress && [...model.stress(answer)] };
  const starts = [null, new Uint8Array(model.m)];
  const others = starts.map((start) => [...model.solve(point, start).forces]);
  return { ...told, others };
});
console.log(JSON.stringify(answers));
"""


def answered(model, scenery, points):
    """What a page answers in node, point by point."""
    return node(
        LOADED + PROGRAM + ENDED, MODEL, page=page.page_text(model, scenery), points=points.tolist()
    )


def stress_drawn(full, model, scenery, point):
    """Von Mises' stress of the cells that a scenery draws, of the model, by the forms of the
    mesh.
    """
    cells = scenery.strains.cells
    order = np.unique(cells, return_index=True)[1]
    discretisation = full.discretisation
    corners = discretisation._cell_nodes()
    # the first triangle of each cell, whose corners are three nodes of this cell alone
    nodes = scenery.nodes[scenery.triangles[order]]
    owner = [np.flatnonzero(np.isin(corners, own).sum(axis=1) == 3)[0] for own in nodes]
    return von_mises(model.solve(point).stress()[owner])


@needs("shared_nodes")
@in_node
@pytest.mark.parametrize(
    "name", marked(*SCENES, "held by contact", "halves", "bed", "moving tool", *STRESSES)
)
def test_a_page_has_the_digits_of_python(name):
    """Whether it starts from the answer before, from the gaps, or from none closed, where springs
    hold bodies.
    """
    _, model, scenery = known(name)
    space, tree = model.parameters, tree_of(model, scenery)
    shown, missing = [item["name"] for item in tree["outputs"]], tree["missing"]
    points = np.vstack([space.random(12, 4), [space.lower, space.upper]])
    for k, (point, found) in enumerate(zip(points, answered(model, scenery, points), strict=True)):
        answer = model.solve(point, gradient=True)
        forces = answer.forces()
        size = np.abs(forces).max()
        np.testing.assert_allclose(found["forces"], forces, rtol=0, atol=1e-10 * size)
        for other in found["others"]:
            np.testing.assert_allclose(other, found["forces"], rtol=0, atol=1e-12 * size)
        outputs = answer.outputs()
        assert sorted([*shown, *missing]) == sorted(outputs)
        for here, value, slopes in zip(shown, found["outputs"], found["slopes"], strict=True):
            assert value == pytest.approx(outputs[here], rel=1e-8, abs=1e-12)
            exact = outputs.gradient[here]
            # by central differences of a hundred-thousandth of the box, and on its border by those
            # of one side
            if k < 12:
                np.testing.assert_allclose(
                    slopes, exact, rtol=0, atol=1e-5 * np.abs(exact).max() + 1e-9
                )
        check_field(found, answer, scenery)
    unread = {"shape": ["peak", "force"]}
    unread["space"] = ["torque of a quarter", "largest stress", "lost contact"]
    assert missing == unread.get(name, [])


@needs("volume_loads")
def test_stress_in_too_many_cells_is_left_out_by_name(monkeypatch):
    _, model, scenery = known("stress, plane_stress")
    assert tree_of(model, scenery)["missing"] == []
    monkeypatch.setattr(stress_outputs, "STRESS_NUMBERS", 100)
    assert tree_of(model, scenery)["missing"] == ["largest", "mean", "of the cold one"]


@in_node
@pytest.mark.parametrize("name", marked("moduli", "formula", "shape"))
def test_a_page_bounds_the_error_of_its_answer(name):
    """As Python does with a factor of S at each point, if interpolation is all that is off by more
    than round-off.
    """
    from hhr_dolfinx.plugins.moduli.least_response import FactoredResponse, ManyResponses

    _, model, scenery = known(name)
    # so far off that the bound is more than round-off, which is not that of Python
    bound = dataclasses.replace(model.fields.bound, inexact=1e-3)
    model = model.changed(fields=dataclasses.replace(model.fields, bound=bound))
    points = model.parameters.random(12, 4)
    many = model.solve_many(points)
    there = bound.at(points, dense(model.fields.amplitudes.of_many(points)))
    schurs = there.found.schur
    alone = ManyResponses(
        [FactoredResponse(schur, np.linalg.cholesky(schur)) for schur in schurs], schurs
    )
    forces = np.maximum(many.multipliers, 0.0)
    gamma = model.fields._solver.many_under(points, forces)
    exact = there._replace(response=alone).of(gamma, forces, lambda: forces)
    wider = many.estimates()
    for k, found in enumerate(answered(model, scenery, points)):
        error = found["error"]
        assert error["forces"]["error"] == pytest.approx(exact.forces_euclid[k], rel=1e-6)
        assert error["forces"]["relative"] == pytest.approx(
            exact.forces_euclid_relative[k], rel=1e-6
        )
        assert exact.forces_euclid[k] <= wider.forces_euclid[k] * (1 + 1e-6)
        if name == "shape":
            assert error["pressure"] is None
            continue
        assert error["pressure"]["error"] == pytest.approx(exact.pressure[k], rel=1e-6)
        assert error["pressure"]["relative"] == pytest.approx(exact.pressure_relative[k], rel=1e-6)


def loose():
    """The upper block lies on the lower one, pressed from above, with play to two walls: nothing
    holds it across.
    """
    scene = contract.blocks(free=True)
    walls = [
        hhr.Obstacle(side(SECOND, 0, upper), way, at)
        for upper, way, at in ((True, (1, 0), 2.01), (False, (-1, 0), -0.99))
    ]
    held = tuple(item for item in scene.displacements if item.tag == side(FIRST, 1, False))
    moved = hhr.DisplacementAt("sinks", (1.0, 2.0), 1, SECOND)
    return dataclasses.replace(
        scene,
        contacts=(*scene.contacts, *walls),
        displacements=held,
        outputs=(*scene.outputs, moved),
        parameters=hhr.ParameterSpace(("press",), (0.0,), (0.1,)),
    )


@needs("floating", "nonmatching")
@in_node
def test_derivatives_of_what_contact_does_not_hold():
    """What no contact holds moves as little as it may."""
    _, model, scenery = made(loose())
    points = np.array([[0.0404], [0.08]])
    for point, found in zip(points, answered(model, scenery, points), strict=True):
        outputs = model.outputs(point, gradient=True)
        here = zip(outputs.values.items(), found["outputs"], found["slopes"], strict=True)
        for (name, value), shown, slopes in here:
            assert shown == pytest.approx(value, rel=1e-8)
            exact = outputs.gradient[name]
            # by central differences of a hundred-thousandth of the box, on springs a hundred
            # thousand times as soft
            np.testing.assert_allclose(slopes, exact, rtol=0, atol=1e-4 * np.abs(exact).max())


def test_stress_is_drawn_though_there_is_none_in_some_answers():
    """Where bodies come off what is left of a stress is round-off, of which nothing is off."""
    space = hhr.ParameterSpace(("push",), (-0.02,), (0.05,))
    scene = dataclasses.replace(contract.blocks(), loads=(), parameters=space)
    _, model, scenery = made(scene, fields=True)
    assert any(
        not answer.forces().any() for answer in model.solve_many(model.parameters.random(200, 0))
    )
    told = tree_of(model, scenery)["stress"]
    assert told is not None and told["off"]["largest"] < 0.03


@needs("shared_nodes")
@in_node
@pytest.mark.parametrize(
    "name", marked("partial pressure", "moduli", *sorted(MORE.keys() - {"stress, plane_stress"}))
)
def test_a_page_draws_the_stress_of_cells(name):
    """As far off as it says of points that its modes are not made of, and the largest value much
    less.
    """
    full, model, scenery = known(name)
    told = tree_of(model, scenery)["stress"]["off"]
    assert told["largest"] < 0.05 and told["largest"] <= told["cells"]
    corners = np.array(
        list(itertools.product(*zip(model.parameters.lower, model.parameters.upper, strict=True)))
    )
    inside = model.parameters.random(12, 4)
    points = np.vstack([corners, inside])
    for place, (point, found) in enumerate(
        zip(points, answered(model, scenery, points), strict=True)
    ):
        exact = stress_drawn(full, model, scenery, point)
        off = np.abs(found["stress"] - exact).max() / exact.max()
        # corners are among those that it tells of, in numbers of half the digits; others are as far
        # off as these, about
        assert off <= told["cells"] * (1.5 if place >= len(corners) else 1.0001)
        if place >= len(corners):
            assert np.linalg.norm(found["stress"] - exact) < 0.03 * np.linalg.norm(exact)


@needs("volume_loads", "elasticity")
@pytest.mark.parametrize(
    ("scene", "there"),
    [
        (lambda: heated("plane_strain"), True),
        (lambda: heated("plane_stress"), False),
        (lambda: heated("plane_stress", push=2.0, load=-1.5), False),
        pytest.param(SCENES["shape"], False, marks=needs("shapes")),
    ],
    ids=["heat", "heat in plane stress", "heat that comes and goes", "shape"],
)
def test_stress_is_left_out_where_it_is_not_that_of_the_displacement_alone(scene, there):
    _, _, scenery = made(scene())
    assert (scenery.strains is not None) is there


@in_node
def test_formulas_are_worked_off_as_python_does():
    points, exact = values_of_formulas()
    program = (
        "const hhr = require(process.argv[1]), given = JSON.parse(require('fs').readFileSync(0, "
        "'utf8'));"
    )
    program += (
        "console.log(JSON.stringify(given.points.map((p) => given.steps.map((s) => hhr.formula(s, "
        "p)))));"
    )
    found = node(program, MODEL, steps=[*map(steps_of, FORMULAS)], points=points.tolist())
    np.testing.assert_allclose(np.array(found, dtype=float), exact, rtol=1e-14)


@needs("moduli")
def test_a_page_needs_nothing_else_and_says_what_it_knows(tmp_path):
    full, model, scenery = made(contract.blocks(("E1", 0.3), box=contract.MODULI), fields=True)
    target = hhr.write_model_page(tmp_path / "page.html", model, scenery)
    text = target.read_text(encoding="utf-8")
    assert not re.search(r"https?://|<link|src=|@import|import\(|fetch\(|XMLHttp", text)
    assert "/*DATA*/" not in text and text.count("<script") == 3
    tree = data_of(text)["tree"]
    assert tree["error"]["kind"] == "bound" and 0 <= tree["error"]["pressure"] < 1e-3
    assert tree["scenery"]["words"]["contacts"] == [
        " and ".join(map(str, full.scene.contacts[0].tags))
    ]
    assert tree["names"] == list(full.parameters.names)


def test_a_name_is_no_marker_and_ends_no_script():
    """Names of users stand as they are, whatever marks the places of scripts, data and title in
    ``page.html``.
    """
    peak = hhr.LargestPressure("peak", 0, unit="</script><!--<script>")
    _, model, scenery = made(dataclasses.replace(contract.blocks(), outputs=(peak,)))
    name = "/*DATA*/ TITLE /*view.js*/ /*page.css*/"
    text = page.page_text(
        model, dataclasses.replace(scenery, words={**scenery.words, "scene": name})
    )
    assert f"<title>{name}</title>" in text and f"<h1>{name}</h1>" in text
    plain = page.page_text(model, scenery)
    for part in ('"amplitudes"', "fromAddress()"):
        assert text.count(part) == plain.count(part)
    assert text.count("</script>") == 3 and text.count("<script") == 3
    assert data_of(text)["tree"]["outputs"][0]["unit"] == peak.unit


@needs("floating")
@pytest.mark.parametrize(
    ("make", "said"),
    [
        (
            lambda trained: trained.build(contract.AS_IT_IS),
            "cannot write a page of a ReducedModel: only condensed models",
        ),
        pytest.param(
            lambda trained: trained.local(hhr.Clusters(2), recipe=contract.AS_IT_IS),
            "LocalModels",
            marks=needs("local_models"),
        ),
    ],
)
def test_models_of_other_kinds_are_refused_by_name(make, said):
    training = contract.training("constant")
    model = make(training)
    scenery = dataclasses.replace(
        hhr.scenery_of(training.full_order), areas=np.ones(model.conditions)
    )
    with pytest.raises(NotOfferedError, match=said):
        hhr.write_model_page("never.html", model, scenery)


def test_a_page_of_another_scene_or_too_large_is_refused(monkeypatch, tmp_path):
    _, model, scenery = made(contract.blocks())
    others = dataclasses.replace(contract.blocks(), bodies=contract.blocks((4.0, 0.3)).bodies)
    for said, wrong in (
        ("of two scenes or meshes", dataclasses.replace(scenery, areas=np.ones(3))),
        ("not of the scene of this model", made(others)[2]),
        ("another mesh", dataclasses.replace(scenery, nodes=scenery.nodes + 1000)),
    ):
        with pytest.raises(NotOfferedError, match=said):
            hhr.write_model_page(tmp_path / "page.html", model, wrong)
    monkeypatch.setattr(page, "MOST_PAGE_BYTES", 20_000)  # its scripts alone have more
    with pytest.raises(NotOfferedError, match="go by mail"):
        hhr.write_model_page(tmp_path / "page.html", model, scenery)
    # where the contact problem alone is too large nothing is made before that is said
    monkeypatch.setattr(page, "MOST_PAGE_BYTES", 100)
    monkeypatch.setattr(page, "page_text", None)
    with pytest.raises(
        NotOfferedError, match=r"MB or more exceeds .* 4 contact conditions are too many"
    ):
        hhr.write_model_page(tmp_path / "page.html", model, scenery)
    assert not list(tmp_path.iterdir())


def test_a_scenery_is_kept_and_checked(tmp_path):
    _, _, scenery = made(contract.blocks())
    scenery.write(tmp_path / "scenery.npz")
    again = hhr.Scenery.read(tmp_path / "scenery.npz")
    for name in ("points", "nodes", "triangles", "lines", "areas"):
        np.testing.assert_array_equal(getattr(again, name), getattr(scenery, name))
    assert again.words == scenery.words
    assert again.strains.moduli == scenery.strains.moduli
    assert (again.strains.rows != scenery.strains.rows).nnz == 0
    own = scenery.strains
    for said, wrong in (
        ("strains do not fit", {"strains": dataclasses.replace(own, cells=own.cells + 1000)}),
        ("strains do not fit", {"strains": dataclasses.replace(own, cells=own.cells[1:])}),
        ("no whole numbers", {"strains": dataclasses.replace(own, cells=own.cells + 0.25)}),
        ("no whole numbers", {"strains": dataclasses.replace(own, bodies=own.bodies[:, None])}),
        ("neither true nor false", {"strains": dataclasses.replace(own, plane_stress="no")}),
        ("no whole numbers", {"nodes": scenery.nodes + 0.5}),
        ("triangles name nodes that are not there", {"triangles": scenery.triangles + 1000}),
        ("no words", {"words": scenery.words | {"contacts": []}}),
    ):
        dataclasses.replace(scenery, **wrong).write(tmp_path / "wrong.npz")
        with pytest.raises(FileContentError, match=said):
            hhr.Scenery.read(tmp_path / "wrong.npz")
    (tmp_path / "cut.npz").write_bytes((tmp_path / "scenery.npz").read_bytes()[:-40])
    with pytest.raises(FileContentError):
        hhr.Scenery.read(tmp_path / "cut.npz")


@pytest.mark.parametrize("name", marked("partial pressure", "space"))
def test_a_scenery_shows_the_whole_surface(name):
    """Triangles of the plane have its area.

    In space each edge of the surface is one of two triangles.
    """
    _, _, scenery = known(name)
    if name == "space":
        edges = np.sort(scenery.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        _, count = np.unique(edges, axis=0, return_counts=True)
        assert (count == 2).all()
    else:
        a, b, c = scenery.points[scenery.triangles].transpose(1, 0, 2)
        sizes = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
        assert sizes.min() > 0
        assert sizes.sum() == pytest.approx(4.1 * 7.0 + 0.6 * 7.0, rel=0.05)


@needs("moduli")
@in_node
def test_slopes_on_the_border_stay_inside_the_box():
    """A table ends where the box does: beyond there is no modulus."""
    scene = contract.blocks(("table(E1, 1, 2, 3, 4, 6, 5)", 0.3), box=contract.MODULI)
    _, model, scenery = made(scene, fields=True)
    point = np.array([[0.05, 0.02, 6.0]])
    (found,) = answered(model, scenery, point)
    exact = model.outputs(point[0], gradient=True).gradient
    for slopes, name in zip(found["slopes"], ("peak", "force"), strict=True):
        np.testing.assert_allclose(slopes, exact[name], rtol=1e-3)


@needs("moduli", "shapes")
def test_where_shapes_are_parameters_forces_are_shown_and_no_pressures():
    """Areas are those of one shape, by which forces of another one are no pressures."""
    _, model, scenery = known("shape")
    assert scenery.moves
    tree = tree_of(model, scenery)
    assert tree["scenery"]["moves"] and set(tree["missing"]) == {"peak", "force"}
    assert not made(contract.blocks())[2].moves


def test_a_page_of_what_never_moves(tmp_path):
    """No displacement, and no picture of one."""
    space = hhr.ParameterSpace(("gap",), (0.01,), (0.02,))
    scene = dataclasses.replace(
        contract.blocks(),
        parameters=space,
        loads=(),
        outputs=(),
        displacements=tuple(
            hhr.Displacement(item.tag, item.component) for item in contract.blocks().displacements
        ),
        openings=(hhr.Opening(0, slope("gap")),),
    )
    _, model, scenery = made(scene, fields=True)
    text = hhr.write_model_page(tmp_path / "still.html", model, scenery).read_text(encoding="utf-8")
    assert '"field":null' in text


@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not there")
@pytest.mark.parametrize("name", marked("partial pressure", "space"))
def test_a_browser_shows_the_answer_of_its_address(name, tmp_path):
    """By double click: numbers in the table, a plot for each contact, and parameters out of the box
    at its border.
    """
    _, model, scenery = known(name)
    target = hhr.write_model_page(tmp_path / "page.html", model, scenery)
    space = model.parameters
    asked = [*model.parameters.random(1, 8)[0].tolist()]
    asked[0] = 2 * space.upper[0]  # is taken for the upper end
    address = "&".join(f"{key}={value!r}" for key, value in zip(space.names, asked, strict=True))
    found = dumped(target, address, tmp_path)
    assert 'data-converged="true"' in found
    assert found.count('class="plot"') == len(set(scenery.pairs.tolist()))
    asked[0] = space.upper[0]
    assert f"does not know: {space.names[0]} = {2 * space.upper[0]!r}." in found
    assert f"at {space.names[0]} = {space.upper[0]:.15g}, {space.names[1]} = " in found
    forces = model.solve(asked).forces()
    for pair in set(scenery.pairs.tolist()):
        total = forces[scenery.pairs == pair].sum()
        assert f"<td>sum of forces</td><td>{float(f'{total:.6g}'):.12g}</td>" in found, total


@needs("friction")
@in_node
@pytest.mark.parametrize("name", OF_FRICTION)
def test_increments_with_friction_are_those_of_python(name):
    """Where moduli vary bodies are drawn by a fit of the maps of forces, whose answers it has not
    seen.
    """
    _, model, scenery = made(rubbed(name), fields=True)
    assert (tree_of(model, scenery)["field"]["kind"] == "fitted") == (name == "moduli")
    tour, points = tour_of(model), model.parameters.random(6, 3)
    given = along(model, scenery, tour, points)
    history = model.march(list(enumerate(tour)))
    assert history.cuts == 0
    largest = max(np.abs(answer.multipliers).max() for answer in history.answers)
    for found, answer in zip(given["found"], history.answers, strict=True):
        assert {"position", "path", "work", "wear"} <= found.keys()
        check_increment(found, answer, largest)
        check_field(found, answer, scenery, least=0.05)
    assert {status for found in given["found"] for status in found["statuses"]} == {0, 1, 2}
    for found, point in zip(given["loaded"], points, strict=True):
        known = model.solve(point)
        # both halve increments until forces and work change by a thousandth of the largest
        size = np.linalg.norm(known.multipliers)
        assert np.linalg.norm(found["forces"] - known.multipliers) < 1e-9 * size
        # the path that a page copies is all of it
        whole = model.march(list(enumerate(map(np.array, found["path"])))).answers[-1]
        assert np.linalg.norm(found["forces"] - whole.multipliers) < 1e-9 * size


@needs("friction", "moduli")
def test_a_picture_of_bodies_that_rub_is_left_out_where_it_has_no_room():
    """And moduli that name a parameter without changing are those of a constant."""
    bodies = (hhr.Body(FIRST, "3 + 0 * E1", 0.3), hhr.Body(SECOND, "E2", 0.2))
    box = {"E1": (2.0, 6.0), "E2": (2.0, 4.0)}
    _, model, scenery = made(rubbing(cells=4, bodies=bodies, box=box), fields=True)
    arrays = Packed()
    assert (
        pictures_of(model, scenery, arrays, 3_000_000)["field"]["kind"] == "fitted"
        and arrays.arrays
    )
    for value in arrays.arrays.values():
        assert np.isfinite(value).all()
    nothing = Packed()
    assert pictures_of(model, scenery, nothing, 1000)["field"] is None and not nothing.arrays


@in_node
def test_axes_have_a_few_round_numbers_whatever_their_range():
    """One of a last digit would go on for ever."""
    nearly = 1.6191466698074306, 1.6191466698074308
    ranges = [(0, 1), (-3, 7), nearly, (5, 5), (0, 0), (-1e-300, 0), (1e9, 1.00000001e9)]
    program = (
        "const drawing = require(process.argv[1]), { ranges } = "
        'JSON.parse(require("fs").readFileSync(0, "utf8"));'
    )
    program += (
        "console.log(JSON.stringify(ranges.map(([low, high]) => drawing.ticks(low, high, 4))));"
    )
    found = node(program, MODEL.with_name("drawing.js"), ranges=ranges)
    for (low, high), ticks in zip(ranges, found, strict=True):
        assert len(ticks) <= 10 and ticks == sorted(ticks), (low, high)
    assert found[0] == pytest.approx([0, 0.5, 1]) and found[1] == pytest.approx([0, 5])


def test_a_mesh_that_is_finer_than_a_screen_is_thinned():
    points = np.stack(
        np.meshgrid(np.linspace(0, 2, 81), np.linspace(0, 1, 41), indexing="ij"), axis=-1
    ).reshape(-1, 2)
    number = np.arange(len(points)).reshape(81, 41)
    corners = np.stack(
        [number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1
    ).reshape(-1, 4)
    triangles = corners[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    pieces = number[0], number[-1], number[:, 0], number[:, -1]
    border, lines = (
        np.concatenate(pieces),
        np.concatenate([np.column_stack([p[:-1], p[1:]]) for p in pieces]),
    )
    # two bodies that touch along x = 2: their nodes there are no neighbours
    both = {
        "points": np.vstack([points, points + np.array([2.0, 0.0])]),
        "nodes": np.arange(2 * len(points)) + 7,
        "triangles": np.vstack([triangles, triangles + len(points)]),
        "lines": np.vstack([lines, lines + len(points)]),
    }
    _, _, scenery = made(contract.blocks())
    cells = np.arange(2 * len(triangles))  # of which each has its number for a strain
    rows = csr_matrix(np.repeat(cells, 4)[:, None] * 1.0)
    strains = dataclasses.replace(
        scenery.strains, cells=cells, bodies=np.zeros(len(cells), int), rows=rows
    )
    whole = dataclasses.replace(scenery, **both, strains=strains)
    assert thinned(whole, 10_000) is whole
    found = thinned(whole, 900)
    assert 500 < len(found.points) <= 900
    assert (found.points == whole.points[found.nodes - 7]).all()

    def area(item):
        edges = np.diff(item.points[item.triangles], axis=1)
        return np.abs(np.linalg.det(edges)).sum() / 2

    assert area(found) == pytest.approx(area(whole), rel=0.03)
    outline = np.isin(found.nodes[found.lines] - 7, [*border, *(border + len(points))])
    assert outline.all() and len(found.lines) > 100
    # each triangle that is left has the strain of one near it
    kept = found.strains.rows.toarray()[4 * found.strains.cells, 0].astype(int)
    middles = [item.points[item.triangles].mean(axis=1) for item in (found, whole)]
    assert np.abs(middles[0] - middles[1][kept]).max() < 0.1
    bodies = found.nodes[found.triangles] - 7 >= len(points)
    assert (bodies.all(axis=1) | ~bodies.any(axis=1)).all() and bodies.any() and not bodies.all()


@needs("moduli")
@in_node
@impossible_moduli.BODIES
def test_a_page_has_no_answer_where_an_elastic_constant_is_impossible(bodies):
    """As every model in Python; beside the point both answer."""
    _, model, scenery = made(impossible_moduli.scene(*bodies))
    point = np.array(list(impossible_moduli.POINT.values()))
    beside = np.add(point, [0.0, 0.0, 1e-3])
    there, nowhere = answered(model, scenery, np.array([beside, point]))
    assert there["converged"] and not nowhere["converged"]
    np.testing.assert_allclose(there["forces"], model.solve(beside).forces(), rtol=0, atol=1e-10)
