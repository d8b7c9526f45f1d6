"""Pages of models with heat, asked in node, in jsdom and by the command, beside Python."""

import dataclasses
import json

import numpy as np
import pytest
from heated_pairs import FED, GIVEN, SLIDING, blocks, heat
from mpi4py import MPI
from pages_in_node import ENDED, MODEL, THERE, data_of, in_node, node, rows_of, said, shown
from shell import invoke

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side
from hhr_dolfinx.plugins.contact_heat import on_page
from hhr_dolfinx.plugins.pages import page
from hhr_dolfinx.plugins.pages.kernel import SOURCES_SECTION, digest_of
from hhr_dolfinx.plugins.pages.scenery_of import scenery_of

pytestmark = pytest.mark.filterwarnings("ignore:parameters")
ASKED = (
    """
const fs = require("fs"), hhr = global.hhr = require(process.argv[1]);
require(process.argv[2]);
const { data, points } = JSON.parse(fs.readFileSync(0, "utf8"));
hhr.kinds[data.tree.kind].of(data.tree, hhr.decoded(data.arrays)).then((model) => {
  const found = points.map((point) => {
    const answer = model.solve(point), drawn = model.displacement(answer);
    const plain = { converged: answer.converged, forces: [...answer.forces] };
    if (!answer.converged) return plain;
    const warm = model.colours()[0].values(answer);
    const outputs = model.outputs(answer), slopes = model.slopes(answer);
    return { ...plain, outputs, slopes, field: drawn && [...drawn], warm: [...warm] };
  });
  console.log(JSON.stringify(found));
"""
    + ENDED
)
SCRIPT = MODEL.parents[1] / "contact_heat" / "heat.js"


def made(scene, warm):
    """A model with heat, its scenery and its page."""
    model = hhr.condense_heat(scene, warm)
    scenery = scenery_of(hhr.FullOrderModel(scene, MPI.COMM_SELF))
    added = model.on_page()
    return model, scenery, page.page_text(added.contact, scenery, added)


def check_page(scene, warm, points):
    """Forces, outputs and slopes to round-off, displacements and temperatures as they are drawn."""
    model, scenery, text = made(scene, warm)
    data = data_of(text)
    assert data["tree"]["names"] == list(model.parameters.names)
    found = node(ASKED, MODEL, SCRIPT, data=data, points=np.asarray(points).tolist())
    for point, own in zip(points, found, strict=True):
        answer = model.solve(point, both=False)
        forces = answer.forces()
        np.testing.assert_allclose(own["forces"], forces, rtol=0, atol=1e-10 * forces.max())
        outputs = answer.outputs().values
        assert [output["name"] for output in data["tree"]["outputs"]] == list(outputs)
        values = list(outputs.values())
        np.testing.assert_allclose(own["outputs"], values, rtol=1e-9, atol=1e-12)
        gradient = model.outputs(point, gradient=True).gradient
        for name, slopes in zip(outputs, own["slopes"], strict=True):
            np.testing.assert_allclose(slopes, gradient[name], rtol=1e-5, err_msg=name)
        exact = answer.displacement().reshape(-1, model.dimension)[scenery.nodes].ravel()
        assert np.linalg.norm(own["field"] - exact) < 0.01 * np.linalg.norm(exact)
        known = answer.temperature()[scenery.nodes]
        assert np.abs(own["warm"] - known).max() < 0.01 * np.ptp(known) + 2e-5 * known.max()


@in_node
@pytest.mark.parametrize(("hypothesis", "given"), GIVEN)
def test_a_page_answers_as_python_does(hypothesis, given):
    """Conductances of pressure and gap; supplies, convection and heat of friction by formulas;
    bodies that contact alone feeds.
    """
    scene = blocks(hypothesis)
    check_page(scene, heat(**given), scene.parameters.random(6, 3))


@in_node
def test_small_differences_of_high_temperatures_are_drawn():
    """A degree between the bodies at 293 of them: 32-bit floats resolve 3e-5."""
    scene = blocks()
    box = hhr.ParameterSpace(("push", "T"), (0.002, 293.0), (0.01, 294.0))
    fixed = [
        hhr.FixedTemperature(side(FIRST, 1, False), 293.0),
        hhr.FixedTemperature(side(SECOND, 1, True), "T"),
    ]
    check_page(
        dataclasses.replace(scene, parameters=box),
        heat(reference=293.0, temperatures=fixed),
        box.random(4, 2),
    )


def test_matrices_of_heat_count_before_pictures_are_made(monkeypatch):
    """A model that is too large is refused before its scenery is read."""
    scene = blocks()
    model = hhr.condense_heat(scene, heat())
    added = model.on_page()
    monkeypatch.setattr(page, "MOST_PAGE_BYTES", added.size)
    with pytest.raises(NotOfferedError, match="too many"):
        page.check_for_page(model)


@in_node
def test_the_kernel_is_that_of_its_sources():
    """Sources that change without the kernel would be a page that answers otherwise."""
    kernel = on_page.HEAT_KERNEL.read_bytes()
    assert SOURCES_SECTION + digest_of(on_page.heat_sources()) in kernel


@pytest.mark.skipif(not THERE, reason="jsdom is not there")
def test_a_page_shows_heat_and_draws_temperatures():
    scene = blocks()
    model, _, text = made(scene, heat(sliding=SLIDING, **FED))
    view = shown(text, "push=0.008&T=120")[0]
    rows = rows_of(view)
    outputs = model.solve([0.008, 120.0], both=False).outputs().values
    for name in ("heat 0", "friction heat 0"):
        assert float(rows[name]) == pytest.approx(said(outputs[name]), rel=1e-4)


def test_pages_by_command(tmp_path):
    scene = blocks()
    model = hhr.condense_heat(scene, heat())
    hhr.save_heat_model(tmp_path / "warm.npz", model)
    scenery_of(hhr.FullOrderModel(scene, MPI.COMM_SELF)).write(tmp_path / "scenery.npz")
    invoke("page", str(tmp_path / "warm.npz"))
    tree = data_of((tmp_path / "warm.html").read_text())["tree"]
    assert tree["kind"] == "heat"


def test_a_page_needs_no_scenery_beside_the_full_model(tmp_path):
    """Of a model in this process it is that of the scene; one from a file has none."""
    scene = blocks()
    model, scenery, _ = made(scene, heat())
    hhr.write_model_page(tmp_path / "own.html", model)
    hhr.write_model_page(tmp_path / "given.html", model, scenery)
    own, given = (data_of((tmp_path / f"{name}.html").read_text()) for name in ("own", "given"))
    for tree in (own, given):
        tree["tree"].pop("made")
    assert own == given
    hhr.save_heat_model(tmp_path / "warm.npz", model)
    with pytest.raises(NotOfferedError, match="comes from a file"):
        hhr.write_model_page(tmp_path / "none.html", hhr.load_heat_model(tmp_path / "warm.npz"))


def test_heat_in_time_is_on_no_page(tmp_path):
    scene = blocks()
    model = hhr.condense_transient_heat(scene, heat(capacity={FIRST: 3.0, SECOND: 2.0}))
    scenery = scenery_of(hhr.FullOrderModel(scene, MPI.COMM_SELF))
    with pytest.raises(NotOfferedError, match="heat in time"):
        hhr.write_model_page(tmp_path / "page.html", model, scenery)


def test_a_page_is_plain_data():
    scene = blocks()
    _, _, text = made(scene, heat())
    assert json.dumps(data_of(text)["tree"])
    assert "hhr.kinds.heat = Heat" in text
