"""Whatever has names is read by name: mappings, structured arrays, named tuples, of points, tables
and paths.
"""

from typing import NamedTuple

import numpy as np
import pytest
from scenes import block_scene, slope

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ParameterError
from hhr_dolfinx.geometries import block
from hhr_dolfinx.models.histories.path import checked_path
from hhr_dolfinx.parameters import ParameterSpace

SPACE = ParameterSpace(("push", "pull"), (0.0, 0.0), (2.0, 2.0))
ROWS = np.array([[1.5, 0.5], [1.0, 0.25]])


class Load(NamedTuple):
    """Parameters of the scene in another order."""

    pull: float
    push: float


class Step(NamedTuple):
    """A step of a path as a row of a table has it, the time last."""

    pull: float
    push: float
    time: float


class Frame:
    """A table whose columns have names, by the attribute that some packages use for them."""

    def __init__(self, attribute, columns):
        setattr(self, attribute, list(columns))
        self._data = columns

    def __getitem__(self, name):
        return self._data[name]

    def __array__(self, dtype=None, copy=None):
        return np.column_stack(list(self._data.values())).astype(dtype or float)


COLUMNS = {"pull": ROWS[:, 1], "push": ROWS[:, 0]}
STRUCTURED = np.array([(0.5, 1.5), (0.25, 1.0)], dtype=[("pull", float), ("push", float)])
TABLES = {
    "columns": COLUMNS,
    "lists": {name: column.tolist() for name, column in COLUMNS.items()},
    "rows": [{"pull": pull, "push": push} for push, pull in ROWS],
    "structured": STRUCTURED,
    "records": STRUCTURED.view(np.recarray),
    "tuples": [Load(0.5, 1.5), Load(0.25, 1.0)],
    "columns attribute": Frame("columns", COLUMNS),
    "column_names attribute": Frame("column_names", COLUMNS),
    "no labels": Frame("columns", {0: ROWS[:, 0], 1: ROWS[:, 1]}),
    "numbers": ROWS,
}


@pytest.mark.parametrize("name", TABLES)
def test_a_table_is_read_by_its_names(name):
    assert np.array_equal(SPACE.points(TABLES[name]), ROWS)


@pytest.mark.parametrize(
    "point", [{"pull": 0.5, "push": 1.5}, STRUCTURED[0], Load(0.5, 1.5), [1.5, 0.5]]
)
def test_a_point_is_read_by_its_names(point):
    assert np.array_equal(SPACE.point(point), ROWS[0])


def test_a_step_of_a_path_is_read_by_its_names():
    steps = np.array(
        [(0.0, 0.0, 0.0), (0.5, 1.5, 1.0)],
        dtype=[("pull", float), ("push", float), ("time", float)],
    )
    for path in (
        steps,
        [Step(0.0, 0.0, 0.0), Step(0.5, 1.5, 1.0)],
        [(0, [0, 0]), (1, Load(0.5, 1.5))],
    ):
        times, points = zip(*checked_path(SPACE, path), strict=True)
        assert times == (0.0, 1.0) and np.array_equal(points, [[0.0, 0.0], ROWS[0]])
    with pytest.raises(ParameterError, match="no 'time'"):
        checked_path(SPACE, [Load(0.0, 1.0)])


@pytest.mark.parametrize(
    ("table", "why"),
    [
        ({"push": [1.0]}, "'pull' is missing"),
        ({"push": [1.0], "pull": [1.0], "nu": [0.3]}, "'nu' is unknown"),
        ([{"push": 1.0, "Pull": 1.0}], "'pull' is missing, 'Pull' is unknown"),
        ({"push": [1.0, 1.5], "pull": [1.0]}, "needs numbers in columns"),
        ({"push": [[1.0, 1.0]], "pull": [[1.0, 1.0]]}, r"shape \(1, 4\)"),
    ],
)
def test_names_that_do_not_match_are_refused(table, why):
    with pytest.raises(ParameterError, match=why):
        SPACE.points(table)


MASKED = {
    "a point": (SPACE.point, np.ma.array([1, 2], mask=[False, True])),
    "a value": (SPACE.point, {"push": 1.0, "pull": np.ma.masked}),
    "a record": (
        SPACE.point,
        np.ma.array((1.0, 1.0), mask=(False, True), dtype=[("push", float), ("pull", float)]),
    ),
    "a table": (SPACE.points, np.ma.array([[1.5, 0.5]], mask=[[False, True]])),
    "rows": (SPACE.points, [[1.0, 1.0], np.ma.array([1.5, 0.5], mask=[False, True])]),
    "a column": (SPACE.points, {"push": [1.0], "pull": np.ma.array([0.5], mask=[True])}),
    "records": (
        SPACE.points,
        np.ma.array([(1.0, 1.0)], mask=[(0, 1)], dtype=[("push", float), ("pull", float)]),
    ),
    "a path": (
        lambda path: checked_path(SPACE, path),
        [(0.0, np.ma.array([1.5, 0.5], mask=[False, True]))],
    ),
}


@pytest.mark.parametrize("kind", MASKED)
def test_what_is_masked_is_missing(kind):
    """Masked entries are missing or invalid, as the manual of numpy.ma says, whatever number is
    below the mask.
    """
    read, values = MASKED[kind]
    with pytest.raises(ParameterError, match="pull = nan is not finite"):
        read(values)
    assert SPACE.points(np.ma.array(ROWS)).tolist() == ROWS.tolist()


def test_models_read_names():
    """A block between two loads: every entry of the package gives the answer to the mapping, which
    has one meaning.
    """
    lid, side, floor = (
        block.side(1, upper=True),
        block.side(0, upper=True),
        block.side(1, upper=False),
    )
    scene = block_scene(
        "two_loads",
        {"push": (0.0, 2.0), "pull": (0.0, 2.0)},
        cells=(2, 2),
        young=1000.0,
        contacts=(hhr.Obstacle(floor, normal=(0.0, -1.0), offset=0.0),),
        displacements=hhr.Displacement.clamp(block.side(0, upper=False), 2),
        loads=(hhr.Pressure(lid, slope("push")), hhr.Pressure(side, slope("pull", -1.0))),
        outputs=(hhr.ContactForce("force", 0, (0.0, 1.0)),),
    )
    training = hhr.train(scene, TABLES["columns"], held_out=2)
    model = training.build()
    right = model.solve({"push": 1.5, "pull": 0.5}).outputs()["force"]
    assert model.solve([0.5, 1.5], outside="ignore").outputs()["force"] != pytest.approx(
        right, rel=0.1
    )
    for table in TABLES.values():
        assert model.solve_many(table).outputs()["force"][0] == pytest.approx(right, rel=1e-9)
    for table in (TABLES["rows"], TABLES["structured"]):
        assert training.full_order.solve_many(table).outputs()["force"][0] == pytest.approx(
            right, rel=1e-9
        )
        assert np.array_equal(hhr.compute_snapshots(training.full_order, table).points, ROWS)
    assert training.snapshots.points.tolist() == ROWS.tolist()
    assert model.outputs(STRUCTURED[0], gradient=True)["force"] == pytest.approx(right, rel=1e-9)
    assert model.march([(0, [0, 0]), (1, Load(0.5, 1.5))]).answers[-1].outputs()[
        "force"
    ] == pytest.approx(right)
