"""Frames, series and data sets are read by the names of their columns, whatever the order of
these.
"""

import numpy as np
import pytest
from needs import needs

from hhr_dolfinx.errors import ParameterError
from hhr_dolfinx.models.histories.path import checked_path
from hhr_dolfinx.parameters import ParameterSpace

SPACE = ParameterSpace(("push", "pull"), (0.0, 0.0), (2.0, 2.0))
ROWS = np.array([[1.5, 0.5], [1.0, 0.25]])
pytestmark = needs("tables")


def test_frames_of_pandas():
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(ROWS, columns=SPACE.names)[["pull", "push"]]
    for table in (
        frame,
        frame.to_dict("list"),
        frame.to_dict("records"),
        frame.to_records(index=False),
    ):
        assert np.array_equal(SPACE.points(table), ROWS)
    rows = [row for _, row in frame.iterrows()]
    for table in (
        rows,
        list(frame.itertuples(index=False)),
        pandas.DataFrame(ROWS),
        pandas.DataFrame(ROWS).to_numpy(),
    ):
        assert np.array_equal(SPACE.points(table), ROWS)
    assert np.array_equal(SPACE.point(frame.iloc[0]), ROWS[0])
    assert np.array_equal(SPACE.point(pandas.Series(ROWS[0])), ROWS[0])
    assert np.array_equal(
        checked_path(SPACE, [(0, frame.iloc[0] * 0), (1, frame.iloc[0])])[1][1], ROWS[0]
    )
    times = frame.assign(time=[0.0, 1.0])
    assert np.array_equal(
        [point for _, point in checked_path(SPACE, times.itertuples(index=False))], ROWS
    )
    with pytest.raises(ParameterError, match="'case' is unknown"):
        SPACE.points(frame.assign(case=1.0))
    with pytest.raises(ParameterError, match="'pull' is missing"):
        SPACE.points(frame[["push"]])
    with pytest.raises(ParameterError, match="shape"):
        SPACE.points(frame[["push", "pull", "pull"]])


def test_data_of_xarray():
    pandas, xarray = pytest.importorskip("pandas"), pytest.importorskip("xarray")
    frame = pandas.DataFrame(ROWS, columns=SPACE.names)[["pull", "push"]]
    data = frame.to_xarray()
    assert np.array_equal(SPACE.points(data), ROWS)
    assert np.array_equal(SPACE.point(data.isel(index=0)), ROWS[0])
    assert np.array_equal(SPACE.point([xarray.DataArray(1.5), xarray.DataArray(0.5)]), ROWS[0])
    with pytest.raises(ParameterError, match="on which axis"):
        SPACE.points(data.to_dataarray().T)
    with pytest.raises(ParameterError, match="on which axis"):
        SPACE.point(data.to_dataarray().isel(index=0))


def test_tables_of_pyarrow():
    pyarrow = pytest.importorskip("pyarrow")
    assert np.array_equal(
        SPACE.points(pyarrow.table({"pull": ROWS[:, 1], "push": ROWS[:, 0]})), ROWS
    )
