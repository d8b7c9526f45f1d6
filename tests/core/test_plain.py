"""Laws and amplitudes as a kind and numbers: round trips, and data that were damaged or forged."""

import json
import math
import string
from collections import namedtuple
from dataclasses import dataclass, field, fields, make_dataclass
from typing import Annotated

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from needs import needs
from scipy.sparse import csr_array, csr_matrix
from toy_law import Bingham

from hhr_dolfinx.amplitudes import Coverage
from hhr_dolfinx.errors import FileContentError, ModelFileError, SceneError
from hhr_dolfinx.files import read_arrays, write_arrays
from hhr_dolfinx.plain import as_plain, by_name, restored


@dataclass(frozen=True)
class Plasticity:
    """Stands for a law: numbers or formulas that are checked."""

    yield_stress: float | str
    hardening: float | str = 0.0

    def __post_init__(self):
        if not (0 < float(self.yield_stress) < math.inf and 0 <= float(self.hardening) < math.inf):
            raise SceneError(f"{self} is no law")


Norton = make_dataclass(
    "Norton", [("resistance", float | str), ("exponent", float | str)], frozen=True
)
Σ = make_dataclass("Σ", [("σ", np.ndarray)], frozen=True)


@dataclass(frozen=True)
class Everything:
    """All that a field may be."""

    number: float
    count: int
    on: bool
    name: str
    several: tuple[float, ...]
    pair: tuple[str, int]
    table: np.ndarray


Loose = make_dataclass("Loose", ["field"], frozen=True)
Thawed = make_dataclass("Thawed", ["number"])
KINDS = by_name([Plasticity, Norton, Bingham, Coverage, Everything])
REAL = st.floats(allow_nan=False, allow_infinity=False)
POSITIVE = st.floats(1e-300, 1e300)
WHOLE = st.integers(-(2**63) + 1, 2**63 - 1)
TABLES = st.sampled_from(["<f8", "<i8", "<i4", "?"]).flatmap(
    lambda dtype: arrays(
        dtype,
        array_shapes(min_dims=0, max_dims=3, min_side=0),
        elements=None if dtype != "<f8" else REAL,
    )
)
LINES = st.lists(REAL, min_size=2, max_size=5, unique=True).map(
    lambda places: np.array(sorted(places))
)
PLENTY = st.lists(REAL).map(tuple)
VALUES = st.one_of(
    st.builds(Plasticity, POSITIVE, st.floats(0.0, 1e300)),
    st.builds(Norton, POSITIVE, st.floats(1.0, 1e300)),
    st.builds(Bingham, st.integers(0, 10), POSITIVE),
    st.builds(Coverage, LINES, st.integers(0, 1), REAL, arrays("<f8", 2, elements=REAL)),
    st.builds(
        Everything,
        REAL,
        WHOLE,
        st.booleans(),
        st.text(),
        PLENTY,
        st.tuples(st.text(), WHOLE),
        TABLES,
    ),
)


def same(one, other):
    """Whether two values are alike to the last bit, types of numbers included."""
    if type(one) is not type(other):
        return False
    if isinstance(one, np.ndarray):
        return (
            one.dtype == other.dtype
            and one.shape == other.shape
            and one.tobytes() == other.tobytes()
        )
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if hasattr(one, "__dataclass_fields__"):
        return all(same(getattr(one, item.name), getattr(other, item.name)) for item in fields(one))
    return repr(one) == repr(other)


def through_json(data):
    return json.loads(json.dumps(data))


def refused(why, data, tables=None, kinds=KINDS):
    with pytest.raises(FileContentError, match=why):
        restored(data, tables or {}, kinds)


@dataclass(frozen=True)
class Doubled:
    """A value that writes into its arrays."""

    table: np.ndarray

    def __post_init__(self):
        self.table[:] *= 2


@dataclass(frozen=True)
class OfUnits:
    """A value whose annotations say something else than sizes."""

    stress: Annotated[float, "MPa"]
    steps: Annotated[int, "per second"]
    cycles: Annotated[int, "per second"]
    name: Annotated[str, "of a material"] = "steel"
    several: Annotated[tuple[int, ...], "n", "< 3"] = (5,)


@pytest.mark.parametrize(
    "value",
    [
        Σ(np.arange(3.0)),
        OfUnits(1.0, 3, 4),
        Everything(0.1, 3, True, "μ", (1.0, 2.5), ("a", 4), np.linspace(0, 1, 6).reshape(2, 3)),
    ],
)
def test_a_value_comes_back_from_a_file(value, tmp_path):
    data, tables = as_plain(value)
    write_arrays(tmp_path / "value.npz", {"format": "a value", "version": 1, "value": data}, tables)
    header, tables = read_arrays(tmp_path / "value.npz", "a value", 1)
    assert same(restored(header["value"], tables, by_name([type(value)])), value)


def test_what_changes_its_own_arrays_is_refused_and_left_alone():
    value = Doubled(np.ones(3))
    with pytest.raises(
        FileContentError, match=r"rebuilt from its fields is another Doubled.*__post_init__"
    ):
        as_plain(value)
    assert np.all(value.table == 2)


@pytest.mark.parametrize(
    "value", [namedtuple("Pair", "x")(1.0), csr_array(np.eye(2)), csr_matrix(np.eye(2, dtype=int))]
)
def test_what_would_come_back_as_another_type_is_refused(value):
    with pytest.raises(
        FileContentError, match=r"frozen dataclass|no sparse matrix of floating-point"
    ):
        as_plain(Loose(value))


def test_a_name_that_is_taken():
    own = dataclass(frozen=True)(type("Plasticity", (Plasticity,), {}))
    with pytest.raises(ModelFileError, match="two classes are called Plasticity"):
        as_plain(own(1.0, 1.0), {"Plasticity": Plasticity})


@pytest.mark.parametrize(
    "part, change",
    [
        ("indptr", np.array([0, 2**40, 2**40, 3])),
        ("indptr", np.array([0, -5, 2, 3])),
        ("indptr", np.array([0, 1, 2, 2])),
        ("indptr", np.array([0, 10**12, 10**12, 0])),
        ("indices", np.array([0, 1, 3])),
        ("data", np.ones(2)),
        ("data", np.ones((3, 1))),
    ],
)
def test_sparse_matrices_that_would_read_elsewhere_are_refused(part, change):
    data, tables = as_plain(Loose(csr_matrix(np.eye(3))))
    refused("sparse matrix", data, tables | {f"field.{part}": change}, by_name([Loose]))


@pytest.mark.parametrize(
    "shape, why",
    [
        ([1] * 70, "no shape"),
        ([0, 2**62], "no shape"),
        ([2**20, 2**20], "more zeros than"),
        ([2**24, 2], "more zeros"),
    ],
)
def test_a_small_file_fills_no_memory(shape, why):
    table = np.zeros(200)
    table[3] = 1.0
    data, tables = as_plain(Loose(table))
    data["fields"]["field"]["shape"] = shape
    refused(why, data, tables, by_name([Loose]))


def test_a_header_that_could_not_be_read_is_not_written(tmp_path):
    with pytest.raises(FileContentError, match="keep many numbers in arrays"):
        write_arrays(
            tmp_path / "value.npz", {"format": "a value", "version": 1, "value": "a" * 10**7}, {}
        )
    assert not list(tmp_path.iterdir())


@given(VALUES)
def test_a_value_comes_back_to_the_last_bit(value):
    data, tables = as_plain(value)
    assert same(restored(through_json(data), tables, KINDS), value)


def test_numbers_of_numpy_become_plain():
    data, _ = as_plain(Plasticity(np.float32(0.5), np.int64(3)))
    assert same(restored(through_json(data), {}, KINDS), Plasticity(0.5, 3))


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=4),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3)
    ),
    max_leaves=6,
)


@given(VALUES, JSON, st.data())
def test_damage_is_refused_or_makes_a_value_of_the_right_types(value, junk, draw):
    """One field or part replaced by anything that JSON can hold: one error, or a value that could
    have been saved.
    """
    data, tables = as_plain(value)
    place = draw.draw(st.sampled_from(["kind", "fields", *data["fields"]]))
    (data if place in data else data["fields"])[place] = junk
    tables.pop(place, None)
    try:
        found = restored(data, tables, KINDS)
    except FileContentError:
        return
    assert type(found) is type(value)
    as_plain(found)


@given(VALUES, st.sampled_from(["missing", "more", "both", "swapped"]), st.data())
def test_other_fields_are_refused(value, how, draw):
    data, tables = as_plain(value)
    name = draw.draw(st.sampled_from(sorted(data["fields"])))
    if how == "missing":
        del data["fields"][name]
    elif how == "more":
        data["fields"][draw.draw(st.text(string.ascii_letters, min_size=20, max_size=20))] = 1.0
    elif how == "both":
        tables["more"] = np.zeros(2)
    elif name in tables:
        data["fields"][name] = tables.pop(name).tolist()
    else:
        data["fields"][name], tables[name] = {"array": name}, np.zeros(2)
    refused(r"has the fields|must be a|finite|are unknown", data, tables)


@given(JSON)
def test_any_other_data_are_refused(junk):
    refused(None, junk)


UNUSUAL = "1 +", [1.0], True, None, float("nan"), float("inf"), 10**400
NO_NAMES = "os.system", "__import__('os')", "", "Norton ", 3, None, ["Norton"]
UNKNOWN = "eval", "dict", "type", "Loose"
"""Names of builtins and of this module are nothing to a file, and a user's own class is to be
passed.
"""


@pytest.mark.parametrize(
    "kind, numbers, why",
    [
        *(("Plasticity", {"yield_stress": number, "hardening": 0.0}, None) for number in UNUSUAL),
        *(
            ("Plasticity", numbers, None)
            for numbers in (
                {"yield_stress": 1.0},
                {"yield_stress": 1.0, "hardening": -1.0},
                {"yield_stress": 1.0, "hardening": 0.0, "more": 1.0},
                [1.0, 0.0],
            )
        ),
        pytest.param(
            "Bingham",
            {"yield_stress": -1, "viscosity": 0.0},
            "Bingham refuses .*-1.* with SceneError: yield_str",
            marks=needs("inelastic"),
        ),
        *((kind, {}, "no name of a class") for kind in NO_NAMES),
        *((kind, {}, rf"holds a {kind}.*load_model\(path, known=\[{kind}\]\)") for kind in UNKNOWN),
    ],
)
def test_wrong_kinds_and_numbers_are_refused(kind, numbers, why):
    refused(why, {"kind": kind, "fields": numbers})


@pytest.mark.parametrize(
    "table",
    [
        np.array([0.0, np.nan]),
        np.array([1j]),
        np.array(["a"]),
        np.array([None]),
        1.0,
        np.float16([1.0]),
    ],
)
def test_wrong_arrays_are_refused(table):
    data, tables = as_plain(Coverage(np.arange(3.0), 0, 0.0, np.ones(2)))
    refused("positions", data, tables | {"positions": table})


@dataclass(frozen=True)
class Speechless:
    """A class that cannot be shown."""

    field: object

    def __repr__(self):
        raise RuntimeError


@pytest.mark.parametrize(
    "value",
    [
        object(),
        Thawed(1.0),
        Plasticity,
        None,
        3.0,
        lambda: None,
        *map(
            Loose,
            (
                {},
                1j,
                np.nan,
                -np.inf,
                2**63,
                np.longdouble(1),
                object(),
                len,
                ([1.0],),
                (object(),),
                [1.0],
                np.array([None]),
                np.float16([1]),
                np.array([np.nan]),
                np.ma.masked_array([1.0]),
                np.datetime64("2020"),
            ),
        ),
        Speechless({}),
        Everything(1.0, 2.5, True, "", (), ("", 1), np.zeros(1)),
    ],
)
def test_what_no_file_holds_is_refused_when_saving(value):
    with pytest.raises(FileContentError, match=r"frozen dataclass|must be a"):
        as_plain(value)


@dataclass(frozen=True)
class Derived:
    """A field of its own making, and a type that only checkers know."""

    number: float
    other: "Unknown"  # noqa: F821
    square: float = field(init=False)

    def __post_init__(self):
        object.__setattr__(self, "square", self.number**2)


def test_derived_fields_are_made_again_and_odd_annotations_do_no_harm():
    data, _ = as_plain(Derived(3.0, 1.0))
    assert data["fields"] == {"number": 3.0, "other": 1.0}
    assert restored(data, {}, by_name([Derived])).square == 9.0


def test_two_classes_of_one_name_are_refused():
    assert by_name([Norton, Norton]) == {"Norton": Norton}
    with pytest.raises(FileContentError, match="two classes are called Norton"):
        by_name([Norton, make_dataclass("Norton", ["field"], frozen=True)])
    for kind in (object, Thawed, 3, Norton(1.0, 1.0)):
        with pytest.raises(FileContentError, match="is no class of values"):
            by_name([kind])


@pytest.mark.parametrize(
    "changed, why",
    [
        ({"positions": np.array([0.0, 2.0, 1.0])}, "increase"),
        ({"positions": np.zeros(1)}, "at least two"),
        ({"positions": np.zeros((2, 2))}, "increase"),
        ({"slopes": np.ones((1, 2))}, "slopes"),
        ({"extent": 2}, "up to parameter 2"),
        ({"extent": -1}, "up to parameter -1"),
    ],
)
def test_a_partial_pressure_refuses_what_is_no_line_and_no_parameter(changed, why):
    given = {"positions": np.arange(3.0), "extent": 0, "constant": 0.0, "slopes": np.ones(2)}
    with pytest.raises(SceneError, match=why):
        Coverage(**given | changed)


@dataclass(frozen=True)
class Pairs:
    """Values and tuples within a value."""

    law: Norton
    others: tuple[Norton | Plasticity, ...]
    pairs: tuple[tuple[str, float], ...]


NESTED = Pairs(Norton(1.0, 2.0), (Plasticity(3.0, 4.0), Norton(0.1, 6.0)), (("a", 1.0), ("b", 2.5)))
NESTED_KINDS = by_name([Pairs, Norton, Plasticity])


def test_values_within_a_value_come_back():
    data, tables = as_plain(NESTED)
    assert not tables and same(restored(through_json(data), {}, NESTED_KINDS), NESTED)
    held = Loose(Everything(1.0, 2, True, "", (), ("", 1), np.arange(3.0)))
    data, tables = as_plain(held)
    assert list(tables) == ["field.table"] and same(
        restored(data, tables, by_name([Loose, Everything])), held
    )
    assert restored(as_plain(Loose(None))[0], {}, by_name([Loose])) == Loose(None)
    data = as_plain(NESTED)[0]
    refused("pass the class", through_json(data), {}, by_name([Pairs, Norton]))


def test_what_nests_without_end_is_refused():
    deep, data = (), as_plain(NESTED)[0]["fields"]["law"]
    for _ in range(3000):
        deep, data = (deep,), {"kind": "Loose", "fields": {"field": data}}
    for call in (
        lambda: as_plain(Loose(deep)),
        lambda: restored(data, {}, by_name([Loose, Norton])),
    ):
        with pytest.raises(FileContentError, match="nests more than 16"):
            call()
