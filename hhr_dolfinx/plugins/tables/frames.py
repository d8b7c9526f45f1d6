"""Answers to a table of parameters as a data frame of pandas or a data set of xarray, in one
call.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np

from hhr_dolfinx.compat import extra
from hhr_dolfinx.models.model import AnsweringModel
from hhr_dolfinx.parameters import PointsLike, named_values
from hhr_dolfinx.plugins.tables.batch import Answers, answer_points
from hhr_dolfinx.plugins.tables.tables import columns_of

if TYPE_CHECKING:
    import pandas
    import xarray


def to_pandas(
    model: AnsweringModel, points: PointsLike, *, outside: str = "refuse", forces: bool = False
) -> pandas.DataFrame:
    """Answer a table of points in a data frame with a row for each point.

    Args:
        model: any model that answers points.
        points: (S, P), or columns or rows with names, such as a frame of parameters; other columns
            are left out.
        outside: see :func:`~hhr_dolfinx.plugins.tables.batch.answer_points`.
        forces: include columns of the nodal contact forces, one for each condition.

    Returns:
        Columns: the parameters, ``status`` (``ok`` or the reason), the total contact force,
        outputs, and estimates of errors, as ``hhr answer`` writes them. Numbers of rows without an
        answer are NaN.

    Raises:
        MissingPackageError: without pandas.
        ParameterError: for points that are no table.
    """
    with extra("tables", "a frame of pandas"):
        import pandas

    parameters, answers = _answered(model, points, outside)
    return pandas.DataFrame(parameters | {"status": answers.status} | columns_of(answers, forces))


def to_xarray(
    model: AnsweringModel, points: PointsLike, *, outside: str = "refuse"
) -> xarray.Dataset:
    """Answer a table of points in a data set with the dimensions ``point`` and ``condition``.

    Args:
        model, points, outside: see :func:`to_pandas`.

    Returns:
        The columns of :func:`to_pandas` along ``point``, parameters as coordinates, and ``forces``,
        the nodal contact forces, along ``point`` and ``condition``.

    Raises:
        MissingPackageError: without xarray.
        ParameterError: for points that are no table.
    """
    with extra("tables", "a data set of xarray"):
        import xarray

    parameters, answers = _answered(model, points, outside)
    values: dict[str, tuple[str | tuple[str, str], np.ndarray | list[str]]] = {
        name: ("point", column_values)
        for name, column_values in columns_of(answers, forces=False).items()
    }
    values |= {
        "status": ("point", answers.status),
        "forces": (("point", "condition"), answers.forces),
    }
    return xarray.Dataset(
        values, coords={name: ("point", column) for name, column in parameters.items()}
    )


def _answered(
    model: AnsweringModel, points: PointsLike, outside: str
) -> tuple[dict[str, np.ndarray], Answers]:
    """Parameters by name, and answers to an array of points, or to columns with names."""
    names = model.parameters.names
    columns = named_values(points)
    if (
        columns is not None
    ):  # a table of a study has further columns, which a file of a table may have too
        points = {name: column for name, column in columns.items() if name in names}
    answers = cast("Answers", answer_points(model, points, outside=outside))
    return dict(zip(names, answers.points.T, strict=True)), answers
