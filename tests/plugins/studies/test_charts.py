"""Charts of reports: marks where their numbers are, what nothing beats, every answer in one bin,
nothing of none.
"""

import math
import re
from xml.etree import ElementTree

import numpy as np
import pytest

from hhr_dolfinx.plugins.studies import charts


def drawn(svg, kind, of=None):
    """Elements of a chart, by their tag and class."""
    return [
        item
        for item in ElementTree.fromstring(svg).iter(kind)
        if of is None or item.get("class") == of
    ]


MARKS = [
    charts.Mark("quick", 1e-4, 1e-2, 5e-2),
    charts.Mark("beaten", 1e-3, 2e-2),
    charts.Mark("own <b>", 1e-3, 1e-5, 1e-4, own=True),
    charts.Mark("exact", 1e-1, 0.0),
    charts.Mark("broken", 1e-2, math.inf),
]


def test_the_front_is_what_nothing_beats_in_time_and_error():
    assert [mark.name for mark in charts.front(MARKS[:4])] == ["quick", "own <b>", "exact"]


def test_errors_over_times_are_where_their_logarithms_are():
    svg = charts.work_precision(MARKS, "error")
    marks = [*drawn(svg, "circle", "mark"), *drawn(svg, "circle", "own")]
    places = sorted((float(item.get("cx")), float(item.get("cy"))) for item in marks)
    assert len(places) == 4 and "own &lt;b&gt;" in svg
    across = [x for x, _ in places]
    # 1e-4, twice 1e-3, 1e-1: decades are as wide as each other
    assert across[1] == across[2]
    assert across[3] - across[2] == pytest.approx(2 * (across[1] - across[0]), abs=0.2)
    # a smaller error is further down; 1e-2 beside 2e-2
    ups = {round(x, 1): [y for place, y in places if place == x] for x in across}
    assert ups[across[0]][0] < max(ups[across[1]]) < ups[across[3]][0]
    tails = [re.findall(r"[\d.]+", item.get("d")) for item in drawn(svg, "path", "tail")]
    assert sum(float(begin) > float(end) for _, begin, end in tails) == 2


def test_a_histogram_counts_every_answer_once():
    errors = np.geomspace(1e-9, 1e-3, 200)
    svg = charts.histogram([*errors, math.nan], (2 * errors).tolist(), "error", "bound")
    told = [
        int(item.text.split()[0]) for item in drawn(svg, "title") if item.text.endswith("answers")
    ]
    assert sum(told) == 200 and max(told) < 40
    heights = [float(item.get("height")) for item in drawn(svg, "rect", "bar")]
    assert np.array(heights) / heights[0] == pytest.approx(np.array(told) / told[0], abs=0.02)
    assert len(drawn(svg, "path", "limit")) == 1
    assert not drawn(charts.histogram(errors.tolist(), [], "error", ""), "path", "limit")


def test_a_map_has_points_where_parameters_are_and_the_worst_on_top():
    points = [(0.0, 10.0), (1.0, 20.0), (0.5, 15.0), (math.nan, 12.0)]
    svg = charts.map_of(
        points, [1e-6, 1e-2, math.nan, 1e-3], ("a", "b"), [(0.0, 1.0), (10.0, 20.0)]
    )
    low, high = drawn(svg, "circle")
    assert (low.get("class"), high.get("class")) == ("shade0", "shade5")
    assert (float(low.get("cx")), float(low.get("cy"))) == (
        charts.LEFT_MARGIN,
        charts.HEIGHT - charts.BOTTOM,
    )
    assert (float(high.get("cx")), float(high.get("cy"))) == (
        charts.CHART_WIDTH - charts.RIGHT_MARGIN,
        charts.TOP,
    )


def test_nothing_is_drawn_of_no_numbers():
    assert charts.work_precision([MARKS[-1]], "error") == ""
    assert charts.histogram([math.nan], [], "error", "bound") == ""
    assert charts.map_of([(0.0, 0.0)], [math.inf], ("a", "b"), [(0, 1), (0, 1)]) == ""


def test_equal_numbers_and_zeros_have_an_axis():
    for errors in ([0.0, 0.0], [1e-3] * 5, [1e300, 1e-300], [1.7e308, 1.7e308]):
        ElementTree.fromstring(charts.histogram(errors, errors, "error", "bound"))
        ElementTree.fromstring(
            charts.work_precision([charts.Mark("a", 1.0, error) for error in errors], "error")
        )
