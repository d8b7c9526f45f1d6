"""The comparison of two commits itself: what differs by one bit, or is missing, fails and is
named.
"""

import importlib.metadata
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "scripts"))

import same  # noqa: E402

ARRAYS = {
    "HHR/solve 0/forces": np.array([1.0, -0.0, np.nan, 4.0]),
    "HHR/solve 0/active": np.array([True, False]),
    "HHR/solve 0/status": np.array("CONVERGED"),
    "HHR/march/step 0/memory/slip": np.array([3.0]),
    "HHR/file/bytes": np.array(100),
    "HHR/file/arrays/fields.S": np.eye(2),
}
ERRORS = {"HHR/page": "hhr_dolfinx.NotOfferedError: no page"}


@pytest.fixture
def ended(tmp_path):
    """Exit code and print of a comparison of these arrays with changed ones."""

    def run(changes=(), errors=ERRORS, allow="", every=False):
        arrays = {
            name: array for name, array in (ARRAYS | dict(changes)).items() if array is not None
        }
        same.Dump(ARRAYS, ERRORS).write(tmp_path / "a.npz")
        same.Dump(arrays, errors).write(tmp_path / "b.npz")
        (tmp_path / "allow.txt").write_text(allow)
        words = [
            "compare",
            str(tmp_path / "a.npz"),
            str(tmp_path / "b.npz"),
            "--allow",
            str(tmp_path / "allow.txt"),
        ]
        found = CliRunner().invoke(same.main, [*words, *(["--all"] if every else [])])
        return found.exit_code, found.output

    return run


def last_bit(name):
    """An array with the last bit of its first number flipped."""
    array = ARRAYS[name].copy()
    array.view(np.uint64)[0] ^= 1
    return {name: array}


FORCES, SLIP, SIZE, MATRIX = (
    "HHR/solve 0/forces",
    "HHR/march/step 0/memory/slip",
    "HHR/file/bytes",
    "fields.S",
)


@pytest.mark.parametrize(("name", "by"), [(FORCES, "5.6e-17"), (SLIP, "1.5e-16")])
def test_one_flipped_bit_is_named(ended, name, by):
    """2^-52 of 1, whose array has a 4; and 2^-51 of 3."""
    code, text = ended(last_bit(name))
    assert code == 1 and f"off by {by}  {name}" in text


@pytest.mark.parametrize("name", list(ARRAYS))
def test_a_missing_array_is_named(ended, name):
    code, text = ended({name: None})
    assert code == 1 and f"missing  {name}" in text


OTHER = "HHR/*/forces | 1e-15 | another order of a sum"
REMOVED = "HHR/*/forces | missing | removed"
LOST = {**ERRORS, FORCES: "builtins.ValueError: why"}
MOVED = {f"HHR/file/arrays/{MATRIX}": None, "HHR/file/arrays/completion.S": np.eye(2)}


@pytest.mark.parametrize(
    ("changes", "errors", "allow", "code"),
    [
        ({}, ERRORS, "", 0),
        ({FORCES: np.array([1.0, 0.0, np.nan, 4.0])}, ERRORS, "", 1),  # a sign of zero
        ({SIZE: np.array(100, dtype=np.int32)}, ERRORS, "", 1),
        ({"HHR/solve 0/status": np.array("CYCLED")}, ERRORS, "", 1),
        (last_bit(FORCES), ERRORS, OTHER, 0),
        (last_bit(FORCES), ERRORS, OTHER.replace("15", "18"), 1),
        (last_bit(FORCES), ERRORS, "full/* | 1e-15 | another kind", 1),
        ({FORCES: None}, ERRORS, OTHER, 1),
        ({FORCES: None}, ERRORS, REMOVED, 0),
        ({FORCES: None}, LOST, REMOVED, 0),
        ({}, ERRORS, "full/* | 1e-15", 1),  # without a reason
        ({SIZE: np.array(99)}, ERRORS, "", 0),  # files may shrink
        ({SIZE: np.array(101)}, ERRORS, "", 1),
        (MOVED, ERRORS, "", 0),  # and name their arrays otherwise
        (MOVED | {"HHR/file/arrays/completion.S": 2 * np.eye(2)}, ERRORS, "", 1),
        ({}, {"HHR/page": "builtins.TypeError: no page"}, "", 1),
        ({}, {}, "", 0),
    ],
)
def test_what_counts_as_the_same(ended, changes, errors, allow, code):
    assert ended(changes, errors, allow)[0] == code


def test_what_is_said(ended):
    """Lines that allow nothing, new arrays, and why one is missing."""
    line = "full/* | 1e-15 | another kind"
    assert "1 of 1 lines allow nothing" in ended(allow=line)[1]
    assert "nothing differs that is allowed by: full/*" in ended(allow=line, every=True)[1]
    code, text = ended({"HHR/solve 0/wear": np.ones(1)})
    assert code == 0 and "new  HHR/solve 0/wear" in text
    code, text = ended({FORCES: None}, LOST)
    assert code == 1 and "ValueError: why" in text


def test_the_package_of_another_place_is_not_believed(tmp_path, monkeypatch):
    """Modules that are loaded by now come from this repository."""
    (tmp_path / "pyproject.toml").write_text("")
    monkeypatch.setattr(sys, "meta_path", list(sys.meta_path))
    with pytest.raises(RuntimeError, match="was loaded from"):
        same.load_tree(tmp_path)


def test_plug_ins_are_those_of_the_tree(tmp_path, monkeypatch):
    """The environment may have been installed from another one."""
    text = (
        '[project]\nname = "hhr_dolfinx"\nversion = "7"\n[project.entry-points."a group"]\n'
        'wear = "somewhere:PLUGIN"\n'
    )
    (tmp_path / "pyproject.toml").write_text(text)
    monkeypatch.setattr(sys, "meta_path", [same.TreeFinder(tmp_path), *sys.meta_path])
    points = importlib.metadata.entry_points(group="a group")
    assert [(point.name, point.value) for point in points] == [("wear", "somewhere:PLUGIN")]
    assert importlib.metadata.version("hhr_dolfinx") == "7" and importlib.metadata.version("numpy")
    assert not importlib.metadata.entry_points(group="hhr_dolfinx.plugins")
