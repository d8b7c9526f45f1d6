"""Families of paths: what they draw, what they refuse, round trips, and that training and studies
take them.
"""

import copy
import json
import pickle
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pellet_cladding_plastic as demo
import pytest
from needs import needs
from pellet_families import families
from scenes import pressed_block

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ParameterError, SceneError, StudyError
from hhr_dolfinx.models.histories.path import checked_path
from hhr_dolfinx.plain import as_plain, by_name, restored
from hhr_dolfinx.plugins.paths.path_families import Leg, NamedPath, PathFamily

SPACE = hhr.ParameterSpace(("load", "gap"), (0.0, 0.0), (450.0, 0.02))
OWN = hhr.ParameterSpace(("gap", "hold", "back"), (5.0, 0.0, 0.0), (15.0, 10.0, 1.0))
START = {"gap": "1e-3 * gap", "load": 0.0}
UP, HOLD, BACK = (
    Leg({"load": 450.0}, 1.0, 4),
    Leg({}, "hold", 2),
    Leg({"load": "450 * (1 - back)"}, "back", "4 * back"),
)


def family(**changes):
    """Up, a hold, and down by a part."""
    given = {"name": "down", "space": SPACE, "own": OWN, "start": START, "legs": (UP, HOLD, BACK)}
    return PathFamily(**(given | changes))


def arrays(path):
    """Times, and parameters (n, P)."""
    return np.array([time for time, _ in path]), np.array([point for _, point in path])


def test_a_path_by_hand():
    """Linear legs one behind the other, in the order of the scene's parameters and not in that of
    the start.
    """
    path = family().path({"back": 0.5, "gap": 10.0, "hold": 3.0})
    times, points = arrays(path)
    assert times == pytest.approx([0, 0.25, 0.5, 0.75, 1, 2.5, 4, 4.25, 4.5])
    assert points[:, 0] == pytest.approx([0, 112.5, 225, 337.5, 450, 450, 450, 337.5, 225])
    assert (
        points[:, 1] == 10.0 * 1e-3
    ).all()  # to the last bit: a parameter that does not change must not
    assert path.values == {"gap": 10.0, "hold": 3.0, "back": 0.5}
    assert path.name == "down (gap = 10, hold = 3, back = 0.5)" and isinstance(path, list)
    assert family().path([10.0, 3.0, 0.5]) == path and checked_path(SPACE, path)[3][0] == 0.75


@pytest.mark.parametrize("count, corners", [(16, 8), (32, 8), (8, 4), (2, 1), (1, 0)])
def test_training_takes_corners_first_and_part_loads(count, corners):
    """All eight corners where half of the paths have room for them, else some, balanced in each
    parameter.
    """
    paths = family().training(count)
    assert len(paths) == count and paths == family().training(count)
    values = np.array([[path.values[name] for name in OWN.names] for path in paths])
    unit = (values - OWN.lower) / np.subtract(OWN.upper, OWN.lower)
    first = unit[:corners]
    assert np.isin(first, (0.0, 1.0)).all() and not np.isin(unit[corners:], (0.0, 1.0)).any()
    assert len({tuple(row) for row in first}) == corners
    if corners > 1:
        assert (first.sum(axis=0) == corners / 2).all()
    parts = [path for path in paths if "part" in path.values]
    assert len(parts) == (count - corners) // 2
    for path in parts:
        whole = family().path({name: path.values[name] for name in OWN.names})
        (times, points), (whole_times, whole_points) = arrays(path), arrays(whole)
        share = path.values["part"]
        assert 0.1 <= share <= 1 and path.name.endswith(whole.name)
        assert (
            points[:, 0] == pytest.approx(share * whole_points[:, 0])
            and (points[:, 1] == points[0, 1]).all()
        )
        assert np.diff(times) == pytest.approx(
            share * np.diff(whole_times)
        )  # as fast as the whole path


def test_training_without_part_loads_and_in_cycles():
    """A family with a load level of its own needs no part loads.

    A cycle goes back at the rates of the path.
    """
    plain, whole = family().training(16), family().training(16, least_part=1.0)
    assert not any("part" in path.values for path in whole) and whole[0] == plain[0]
    assert (
        len([path for path in whole if path in plain]) == 12
    )  # corners, and every other one of eight inside
    assert all(path.values["part"] >= 0.5 for path in family().training(16, least_part=0.5)[9::2])
    once, thrice = whole[3], family().training(16, least_part=1.0, cycles=3)[3]
    (times, points), (whole_times, whole_points) = arrays(once), arrays(thrice)
    steps = np.diff(times)
    assert np.diff(whole_times) == pytest.approx(
        np.concatenate([steps, *([steps[::-1], steps] * 2)])
    )
    assert np.array_equal(
        whole_points, np.concatenate([points, *([points[-2::-1], points[1:]] * 2)])
    )
    assert thrice.name == f"3 cycles of {once.name}" and thrice.values == once.values


@pytest.mark.parametrize(
    "options", [{"least_part": 0.0}, {"least_part": 2.0}, {"cycles": 0}, {"cycles": 1.5}]
)
def test_parts_and_cycles_that_cannot_be(options):
    with pytest.raises(
        ParameterError, match=r"least_part = .* must be a fraction in \(0, 1\], cycles = "
    ):
        family().training(4, **options)


def test_legs_that_take_no_time_are_left_out():
    """Steps by a formula are rounded, and one at least."""
    assert [len(family().path([10.0, 0.0, back])) - 5 for back in (0.01, 0.3, 0.45, 1.0)] == [
        1,
        1,
        2,
        4,
    ]
    assert arrays(family().path([10.0, 0.0, 0.5]))[0] == pytest.approx(
        [0, 0.25, 0.5, 0.75, 1, 1.25, 1.5]
    )
    assert len(family().path([10.0, 0.0, 0.0])) == 5
    # 1 - 0.9 - 0.1 is -3e-17, which is round-off of zero
    legs = (UP, Leg({}, "1 - 0.9 - 0.1", 7), HOLD)
    assert len(family(legs=legs).path([10.0, 1.0, 0.0])) == 7
    (first, *_), other = family().path([10.0, 0.0, 0.5]), family().path([10.0, 0.0, 0.5])
    first[1][:] = 0.0
    assert other[0][1][1] == 0.01  # points are the path's own


@pytest.mark.parametrize(
    "sampling", [hhr.Sobol(12), hhr.LatinHypercube(5), hhr.Sobol(3, corners=True)]
)
def test_paths_are_drawn_as_points_are(sampling):
    points, paths = sampling.points(OWN), family().paths(sampling)
    assert [list(path.values.values()) for path in paths] == points.tolist()
    assert paths == family().paths(points) and len({path.name for path in paths}) == len(points)
    for point, path in zip(points, paths, strict=True):
        times, targets = arrays(checked_path(SPACE, path))
        assert times[-1] == pytest.approx(1 + point[1] + point[2])
        assert targets[-1] == pytest.approx([450 * (1 - point[2]), 1e-3 * point[0]])


def test_round_trips():
    one, path = family(), family().path([10.0, 3.0, 0.5])
    data, tables = as_plain(one)
    kept = restored(
        json.loads(json.dumps(data)), {}, by_name([PathFamily, Leg, hhr.ParameterSpace])
    )
    assert not tables
    for again in (
        pickle.loads(pickle.dumps(one)),
        copy.deepcopy(one),
        eval(repr(one), vars(hhr) | globals()),
        kept,
    ):
        assert again == one and hash(again) == hash(one) and again.path([10.0, 3.0, 0.5]) == path
    for again in (pickle.loads(pickle.dumps(path)), copy.deepcopy(path)):
        assert again == path and type(again) is NamedPath and again.values == path.values
    assert path != family().path([10.0, 3.0, 0.6]) and path != list(path)
    assert repr(path) == "<path 'down (gap = 10, hold = 3, back = 0.5)': 9 times to 4.5 s>"
    assert one == family(start=dict(reversed(START.items()))) != family(name="other")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": ""}, "the name '' of a family of paths must be a text"),
        (
            {"space": None},
            (
                "space = None of the family 'down' must be a ParameterSpace: give "
                "space=scene.parameters"
            ),
        ),
        ({"own": ("gap",)}, r"own = \('gap',\) of the family 'down' must be a ParameterSpace"),
        ({"legs": ()}, r"legs = \(\) of the family 'down' must be a tuple of one Leg or more"),
        ({"legs": UP}, "must be a tuple of one Leg or more"),
        ({"start": {"load": 0.0}}, "'down': the start says nothing of gap: give a value of each"),
        (
            {"start": 3.0},
            "'down': the start must map names of the scene's parameters to values, and is 3.0",
        ),
        (
            {"start": START | {"P1": 0.0}},
            r"'down': the start names \['P1'\], the parameters of the scene are \('load', 'g",
        ),
        (
            {"start": START | {"load": None}},
            "'down': load in the start = None must be a finite number",
        ),
        ({"start": START | {"load": np.nan}}, "load in the start = nan must be a finite number"),
        (
            {"start": START | {"load": "load"}},
            r"load at the start: the formula 'load' names \['load'\], the para",
        ),
        ({"start": START | {"load": "exit()"}}, "'down': load in the start: .* calls 'exit'"),
        ({"legs": (Leg({"lod": 1.0}, 1.0, 1),)}, r"'down': leg 1 names \['lod'\]"),
        (
            {"legs": (UP, Leg({}, "pace", 1))},
            r"'down': seconds of leg 2: the formula 'pace' names \['pace'\]",
        ),
        (
            {"legs": (UP, Leg({}, 1.0, "pace"))},
            r"'down': steps of leg 2: the formula 'pace' names \['pace'\]",
        ),
        (
            {"legs": (UP, Leg({"load": "460 * back"}, 1.0, 1))},
            r"path 'down \(.*back = 1\)': the end of leg 2 is outside the box of the "
            r"scene: load = 460 is outside \[0, 450\].*"
            "or narrow the box of the family's own",
        ),
        (
            {"legs": (UP, Leg({}, "hold - 5", 1))},
            r"path 'down \(.*\)': leg 2 takes -5 s, which must not be negative",
        ),
        (
            {"legs": (UP, Leg({"load": 0.0}, "hold", 1))},
            r"hold = 0,.*: leg 2 takes no time and changes load: give it",
        ),
        ({"legs": (HOLD,)}, "no leg takes any time"),
        (
            {"legs": (UP, Leg({}, "1 / hold", 1))},
            "seconds of leg 2 = 1 / hold: is nan, and must be finite",
        ),
        ({"legs": (UP, Leg({}, "table(hold, 1, 1, 2, 2)", 1))}, "outside the table from 1 to 2"),
        ({"legs": (UP, Leg({}, 1.0, "1e9 * back"))}, "leg 2 has 500000000 steps: 100000 at most"),
    ],
)
def test_families_that_are_none(changes, message):
    with pytest.raises(SceneError, match=message):
        family(**changes)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (({}, -1.0, 1), "a leg takes -1 s"),
        (({}, None, 1), "the seconds of a leg = None must be"),
        (({}, 1.0, 0), "steps = 0 of a leg must be a positive integer"),
        (({}, 1.0, 2.5), "steps = 2.5"),
        (({}, 1.0, "4 *"), "the steps of a leg: .* cannot be read"),
        (({3: 1.0}, 1.0, 1), "must name parameters"),
        (((("a", 1.0), ("a", 2.0)), 1.0, 1), r"once each by texts, and names \['a', 'a'\]"),
        (({}, np.inf, 1), "the seconds of a leg = inf must be a finite number"),
    ],
)
def test_legs_that_are_none(given, message):
    with pytest.raises(SceneError, match=message):
        Leg(*given)


@pytest.mark.parametrize(
    ("call", "given", "message"),
    [
        ("path", ([20.0, 0.0, 0.0],), r"family of paths 'down': gap = 20 is outside \[5, 15\]"),
        ("path", ([np.nan, 0.0, 0.0],), "gap = nan is not finite"),
        ("path", ([10.0],), "'down': expected 3 parameters"),
        (
            "path",
            ({"gap": 10.0, "hold": 1.0},),
            r"'down': 'back' is missing: the names do not match",
        ),
        ("paths", (np.ones(3),), r"'down': points have the shape \(3,\)"),
        ("paths", (hhr.Sobol,), "'down': a table of points needs numbers in columns .*Sobol"),
        ("paths", (12,), "'down': points have the shape"),
        ("paths", ([[10.0, 0.0, 2.0]],), "'down': row 0: back = 2 is outside"),
        *(
            ("training", given, "must be a positive integer")
            for given in ((0,), (2.0,), (True,), (4, -1))
        ),
    ],
)
def test_points_that_are_none(call, given, message):
    with pytest.raises(ParameterError, match=message):
        getattr(family(), call)(*given)


def test_times_that_do_not_increase():
    """What round-off swallows only behind a leg that is 1e12 times as long is refused where it is
    drawn.
    """
    own = hhr.ParameterSpace(("hold",), (1.0,), (9e3,))
    lost = PathFamily(
        "lost", SPACE, own, {"load": 0, "gap": 0}, (Leg({}, "hold", 1), Leg({}, "1e-7", 90_000))
    )
    with pytest.raises(
        ParameterError, match=r"path 'lost \(hold = 9000\)': times must increase, and 90000 steps"
    ):
        lost.path(9e3)


@needs("inelastic", "nonmatching")
def test_the_families_of_the_pellet():
    """The loading is the path of the demo to the last bit, and what is combined holds the
    others.
    """
    found = families()
    assert list(found) == ["loading", "held", "reloaded", "paced", "combined"]
    for gap in (5.0, 12.5):
        path = found["loading"].path({"gap": gap, "height": demo.HEIGHT})
        assert all(
            np.array_equal(*pair) for pair in zip(arrays(path), arrays(demo.path(gap)), strict=True)
        )
    rest = dict.fromkeys(("hold", "back", "again", "log_pace"), 0.0)
    for name, values in (("loading", {}), ("held", {"hold": 3.0}), ("paced", {"log_pace": -0.7}),
                         ("reloaded", {"back": 0.6, "again": 0.5})):  # fmt: skip
        values |= {"gap": 8.0, "height": 1.2}
        one, all_in_one = found[name].path(values), found["combined"].path(rest | values)
        for here, there in zip(arrays(one), arrays(all_in_one), strict=True):
            assert here == pytest.approx(there, rel=1e-12, abs=1e-12)
    path = found["combined"].path(
        {"gap": 8.0, "height": 1.2, "hold": 3.0, "back": 0.6, "again": 0.5, "log_pace": 1.0}
    )
    times, points = arrays(path)
    turns = [
        times.tolist().index(time)
        for time in times
        if np.isclose(time, [0.1, 3.1, 3.16, 3.19]).any()
    ]
    assert (
        points[turns, 0] / demo.PRESSURE == pytest.approx([1.0, 1.0, 0.4, 0.7])
        and turns[-1] == len(path) - 1
    )
    for path in found["combined"].paths(hhr.Sobol(20, seed=2)):
        checked_path(demo.scene().parameters, path)


def block():
    """A block that yields, pressed against a plane by one parameter."""
    scene = pressed_block("plane_strain", cells=2)
    return replace(scene, bodies=(replace(scene.bodies[0], law=hhr.Plasticity(0.06, 0.3)),))


def pushed(scene):
    """Pushed by a depth, and half of the way back."""
    (name,) = scene.parameters.names
    own = hhr.ParameterSpace(("depth", "hold"), (0.05, 0.0), (0.1, 1.0))
    legs = (Leg({name: "depth"}, 1.0, 2), Leg({}, "hold", 1), Leg({name: "depth / 2"}, 1.0, 1))
    return PathFamily("pushed", scene.parameters, own, {name: 0.0}, legs)


@needs("inelastic", "studies")
def test_training_and_studies_take_them(tmp_path):
    """The last depths of histories are halves of those drawn, and tests are labelled by the names
    of paths.
    """
    scene = block()
    train, test = pushed(scene).paths(hhr.Sobol(3)), pushed(scene).paths(hhr.LatinHypercube(2))
    settings = hhr.StudySettings(
        train, hhr.Recipe.flowing(trust=None), tests=test, held_out=test[:1], repetitions=1
    )
    assert (
        settings.tests
        == {path.name: path for path in test}
        == settings.adapted(seed=2, quick=True).tests
    )
    study = hhr.study_scene(scene, settings, tmp_path)
    ends = [path.values["depth"] / 2 for path in train]
    assert study.training.snapshots.points[3::4].ravel() == pytest.approx(ends)
    assert study.training.held_out.points[-1] == pytest.approx(test[0].values["depth"] / 2)
    assert [row["value"] for row in study.report["histories"]] == [path.name for path in test]
    assert [answer.time for answer in study.model.march(test[0]).answers] == [
        time for time, _ in test[0][1:]
    ]


@needs("inelastic", "studies")
def test_what_is_no_list_of_paths_or_has_no_names():
    path = pushed(block()).path([0.1, 0.0])
    unnamed = "tests[1] has no name to label it by: give tests={label: path, ...}"
    for given, message in (
        ([path, list(path)], unnamed),
        ([path, path], f"two tests are called {path.name!r}"),
        ("text", "tests[0] has no name"),
    ):
        with pytest.raises(StudyError, match=re.escape(message)):
            hhr.StudySettings([path], tests=given)
    for given in (hhr.Sobol(4), pushed(block())):
        with pytest.raises(
            StudyError, match=r"train on a list of paths, such as family.paths\(Sobol\(12\)\)"
        ):
            hhr.train(block(), given)


@needs("inelastic", "nonmatching", "studies")
def test_the_lines_of_the_documentation():
    text = (Path(__file__).parents[3] / "docs/flow.md").read_text()
    (code,) = (
        block
        for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL)
        if "PathFamily" in block
    )
    names = {"hhr": hhr, "scene": demo.scene()}
    exec(code, names)
    assert len(names["settings"].training) == 12 and len(names["settings"].tests) == 20
