"""Values print as one line or a small table, hand out pressures, and draw themselves."""

import copy
import pickle
import re
from html import unescape

import numpy as np
import pytest
from needs import needs
from scenes import pressed_block

import hhr_dolfinx as hhr
from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.models.shown import point_of


@pytest.fixture(scope="module")
def training():
    return hhr.train(pressed_block("plane_strain"), [4], held_out=5)


@pytest.fixture(scope="module")
def values(training):
    condensed, reduced = training.condense(), training.build(checked=False)
    found = {
        "full": training.full_order,
        "condensed": condensed,
        "reduced": reduced,
        "training": training,
    }
    found |= {
        "snapshots": training.snapshots,
        "history": condensed.march([(0.0, [0.0]), (1.0, [0.05])]),
    }
    for name in ("full", "condensed", "reduced"):
        found[f"answer of {name}"] = found[name].solve(0.05)
        found[f"answers of {name}"] = found[name].solve_many([[0.04], [0.05]])
    return found


def test_all_values_print_as_one_line(values):
    for name, value in values.items():
        for text in (repr(value), str(value)):
            assert "\n" not in text and 20 < len(text) < 200, (name, text)
            assert "array" not in text and "0x" not in text, (name, text)


def test_notebooks_show_the_same_as_a_table(values):
    for name, value in values.items():
        table = value._repr_html_()
        cells = [unescape(text) for text in re.split("<[^>]*>", table)]
        assert set(value.facts().values()) <= set(cells) and table.count("<tr>") == len(
            value.facts()
        ), name


@needs("exact_errors")
def test_lines_say_what_is_there(values, training):
    answer = values["answer of full"]
    touching = int(answer.active.sum())
    assert touching > 0
    assert repr(answer) == (
        f"<Answer: at push=0.05, converged after {answer.iterations} "
        f"iteration{'s' * (answer.iterations > 1)}, {touching} of {answer.active.size} contact "
        "conditions active>"
    )
    assert (
        repr(values["answers of condensed"]) == "<ManyAnswers: 2 answers, 2 converged, 1 parameter>"
    )
    assert repr(values["history"]).startswith("<History: 1 step, t = 0 to 1 s, ")
    assert repr(values["history"]).endswith(", time error 0>")
    assert "scene 'pressed_plane_strain', 4 full answers, 5 held out" in repr(training)
    assert repr(training.snapshots).startswith("<SnapshotSet: 4 answers, 1 parameter, ")
    assert "1 parameter (push)" in repr(values["condensed"]) and "exact" in repr(
        values["condensed"]
    )
    assert repr(values["reduced"]).endswith("errors: bound>")


def test_an_answer_without_a_solution_says_so(values):
    assert ", iteration limit after " in repr(
        values["answer of full"]._replace(status=Status.ITERATION_LIMIT)
    )


def test_a_notebook_escapes_what_users_wrote():
    class Odd(hhr.History):
        def facts(self):
            return {"<b>": "<script>alert(1)</script>"}

    assert "<script>" not in Odd(0.0, np.zeros(1))._repr_html_()


def test_points_with_many_parameters_are_cut():
    assert point_of(np.arange(12.0)) == "(0, 1, 2, 3, 4, 5, 6, 7, ...)"
    assert point_of([3e7, 0.1], ("push", "pull")) == "push=3e+07, pull=0.1"


def test_a_scene_prints_as_a_list():
    text = str(pressed_block("plane_strain"))
    assert text.startswith("Scene 'pressed_plane_strain', plane strain\n")
    for part in ("body ", "contact 0: ", "displacements: ", "parameter push: 0"):
        assert f"\n  {part}" in text, text


def test_pressures_are_those_of_a_uniform_strip(values, training):
    """E / (1 - nu^2) (push - gap) / 2, the uniform stress of ``scenes.pressed_block``: cells of any
    size are exact.
    """
    areas = training.full_order.problem.contact_areas
    for name in ("full", "condensed", "reduced"):
        answer = values[f"answer of {name}"]
        pressure = answer.pressure()
        np.testing.assert_allclose(pressure @ areas, answer.forces().sum(), rtol=1e-12)
        np.testing.assert_allclose(pressure, np.full(areas.size, 3.0 / 0.91 * 0.04 / 2), rtol=1e-9)


@needs("plots")
def test_a_copy_needs_the_full_model_for_pressures(values, training):
    for name in ("condensed", "reduced"):
        for model in (copy.deepcopy(values[name]), pickle.loads(pickle.dumps(values[name]))):
            answer = model.solve(0.05)
            with pytest.raises(
                NotOfferedError, match=r"give the full model, full=hhr.FullOrderModel\(scene\)"
            ):
                answer.pressure()
            with pytest.raises(
                NotOfferedError, match="a picture needs the mesh: give the full model"
            ):
                answer.plot()
            known = values[f"answer of {name}"].pressure()
            np.testing.assert_allclose(answer.pressure(training.full_order), known, rtol=1e-12)


@needs("plots")
def test_answers_and_scenes_draw_themselves(values, training, tmp_path):
    pytest.importorskip("matplotlib")
    answer = values["answer of condensed"]
    figure = answer.plot(tmp_path / "answer.png")
    bodies, surface, *_ = figure.axes
    (curve,) = surface.get_lines()
    np.testing.assert_allclose(np.sort(curve.get_ydata()), np.sort(answer.pressure()), rtol=1e-12)
    assert surface.get_ylabel() == "contact pressure" and surface.get_ylim()[0] == 0
    stress, outline = bodies.collections
    # uniform in each body, up to the corners where blocks are held
    assert stress.get_array().min() >= 0 and len(outline.get_segments()) > 0
    assert "push = 0.05" in figure.get_suptitle()
    training.full_order.scene.plot(tmp_path / "scene.png")
    for name in ("answer", "scene"):
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000


@needs("tables")
def test_tables_go_to_pandas_and_xarray_in_one_call(values):
    """Rows outside of the box have a reason and no numbers; the others those of the model."""
    pandas, xarray = pytest.importorskip("pandas"), pytest.importorskip("xarray")
    model = values["condensed"]
    known = values["answers of condensed"].forces()
    frame = hhr.to_pandas(
        model, pandas.DataFrame({"other": [1.0, 2.0, 3.0], "push": [0.04, 0.05, 7.0]})
    )
    assert list(frame.columns[:3]) == ["push", "status", "total_force"] and len(frame) == 3
    assert frame.status[:2].tolist() == ["ok", "ok"] and "push" in frame.status[2]
    np.testing.assert_allclose(frame.total_force[:2], known.sum(axis=1), rtol=1e-12)
    assert np.isnan(frame.total_force[2]) and not any(name.startswith("force_") for name in frame)
    assert f"force_{known.shape[1] - 1}" in hhr.to_pandas(model, [[0.04]], forces=True)
    data = hhr.to_xarray(model, [[0.04], [0.05]])
    assert isinstance(data, xarray.Dataset) and dict(data.sizes) == {
        "point": 2,
        "condition": known.shape[1],
    }
    np.testing.assert_allclose(data["forces"].to_numpy(), known, rtol=1e-12)
    assert data.coords["push"].to_numpy().tolist() == [0.04, 0.05]


@needs("tables")
def test_a_table_of_answers_prints_as_one_line(values):
    text = repr(hhr.answer_points(values["condensed"], np.array([[0.04], [7.0]])))
    assert text == "<Answers: 2 rows, 1 ok, 1 parameter, outputs: none>"


def test_an_answer_prints_its_outputs_with_units():
    """A line for each output: E' (push - gap) / 2 times the width 1.5."""
    import dataclasses

    force = hhr.ContactForce("lift", 0, (0.0, 1.0), unit="N/mm")
    scene = dataclasses.replace(pressed_block("plane_strain"), outputs=(force,))
    answer = hhr.FullOrderModel(scene).solve(0.05)
    first, second = str(answer).splitlines()
    assert first == repr(answer) and "at push=0.05" in first
    assert second == f"lift = {3.0 / 0.91 * 0.02 * 1.5:.6g} N/mm"
    table = answer.outputs()._repr_html_()
    assert "<th>lift</th>" in table and "N/mm" in table


def test_scenes_spaces_and_estimates_are_tables(values):
    scene = pressed_block("plane_strain")
    assert scene._repr_html_().startswith("<pre>Scene &#x27;pressed_plane_strain&#x27;")
    assert "<th>lower</th>" in scene.parameters._repr_html_()
    estimate = values["answer of full"].estimate()
    assert "displacement" in estimate._repr_html_() and "array" not in estimate._repr_html_()
