"""Tables of parameters in workbooks: the first sheet, by the names of its columns."""

import numpy as np
import pytest

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import MissingPackageError, ParameterError
from hhr_dolfinx.plugins.tables.tables import read_points

SPACE = hhr.ParameterSpace(("push", "pull"), (0.0, 0.0), (1.0, 1.0))


def test_a_workbook_is_read_by_the_names_of_its_columns(tmp_path):
    """Columns in another order, with units and more of them, blank lines, all digits."""
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    sheet = book.active
    rows = [["note", "pull", "push [mm]"], ["a", 0.1234567890123, 1e-7], [], ["b", None, "much"]]
    for row in rows:
        sheet.append(row)
    book.create_sheet("other").append(["push", "pull"])
    book.save(tmp_path / "points.xlsx")
    said = []
    first, second = read_points(tmp_path / "points.xlsx", SPACE, said.append)
    assert [first.line, second.line] == [2, 4] and not first.fault
    np.testing.assert_array_equal([float(cell) for cell in first.cells], [1e-7, 0.1234567890123])
    assert second.cells[0] == "much"
    assert any("units are not converted" in text for text in said)


def test_a_file_that_is_no_workbook_is_named(tmp_path):
    pytest.importorskip("openpyxl")
    (tmp_path / "points.xlsx").write_text("push,pull\n0.1,0.2\n")
    with pytest.raises(ParameterError, match=r"points\.xlsx cannot be read as a workbook"):
        read_points(tmp_path / "points.xlsx", SPACE)
    with pytest.raises(ParameterError, match="there is no table of parameters"):
        read_points(tmp_path / "none.xlsx", SPACE)


def test_without_the_package_the_sentence_says_what_to_do(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "openpyxl", None)
    (tmp_path / "points.xlsx").write_bytes(b"")
    why = r"or save it as CSV in UTF-8.*openpyxl.*hhr_dolfinx\[tables\]"
    with pytest.raises(MissingPackageError, match=why):
        read_points(tmp_path / "points.xlsx", SPACE)
