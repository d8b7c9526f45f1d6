"""Values as plain data: models, laws and outputs, user-defined ones too, in files that execute
nothing.

A value is a frozen dataclass, or a model that names its parts in ``kept``, of numbers, strings,
booleans, arrays, sparse matrices, tuples and other such values. It becomes a JSON tree, in which
each value is the name of its class and its fields, and arrays by their paths in this tree. The
reader gives the classes that a file may contain. Fields must have the types, and arrays the sizes,
that these classes declare, see :mod:`hhr_dolfinx.declared`. Equal arrays are restored as one object
and must not be modified.

A class may have ``faults(sizes)``, which yields further faults of a value, given the sizes of its
model by name, and ``from_file(**fields)``, which replaces the constructor. A class with
``has_own_sizes`` is a model whose sizes are independent of the object that contains it.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self, TypeGuard, TypeVar

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx.declared import TYPES, Sizes, annotations_of, declared_array, fits, shown
from hhr_dolfinx.errors import FileContentError, MissingPackageError, ModelFileError
from hhr_dolfinx.files import NUMBER_KINDS, Json
from hhr_dolfinx.registry import remedy

if TYPE_CHECKING:
    import ast

    from hhr_dolfinx.declared import DeclaredArray

DEEPEST_TREE = 16
"""Largest depth of nested tuples and values: damaged files must not exhaust the stack."""
SPARSE = {"csc": csc_matrix, "csr": csr_matrix}
SMALL_ARRAY = 64
"""Number of entries below which an array is not checked for zeros."""
MOST_DIMENSIONS = 32
"""Largest number of dimensions of an array, as in numpy 1."""
ZEROS_PER_ENTRY = 100
FREE_ZEROS = 2**24
"""Largest number of omitted zeros, per stored entry and in total, so that no small file fills the
memory.
"""

_REMEDY = (
    "what goes into a file must be a frozen dataclass, `@dataclass(frozen=True)`, whose fields "
    "are finite numbers, strings, truth values, None, other frozen dataclasses, tuples of these, "
    "sparse matrices, or numpy arrays of float64, float32, int64, int32 or bool"
)
_SHOWN = 60
T = TypeVar("T")
Remade = tuple[Callable[..., T], tuple[type[T], Mapping[str, object]]]
"""Function, and its arguments, by which a value is copied and pickled."""


_NO_KINDS: Mapping[str, type] = MappingProxyType({})
_NO_FIELDS: Mapping[str, object] = MappingProxyType({})
CODE = MappingProxyType({"kept": False})
"""Metadata of a field that is code, which files omit: it has a default."""
OF_THE_MESH = MappingProxyType({"kept": False, "copied": False})
"""Metadata of a field that needs a mesh, which belongs to one process: files and copies omit it."""


class Rebuilt:
    """A dataclass that is copied and pickled by its fields, without caches, factors and locks."""

    def __reduce__(self) -> Remade[Self]:
        declared_fields = dataclasses.fields(self)  # type: ignore[arg-type]
        fields = [
            declared_field
            for declared_field in declared_fields
            if declared_field.init and declared_field.metadata.get("copied", True)
        ]
        return rebuilt, (
            type(self),
            {declared_field.name: getattr(self, declared_field.name) for declared_field in fields},
        )


def rebuilt(kind: Callable[..., T], arguments: Mapping[str, object]) -> T:
    """Make a value from its arguments.

    Args:
        kind: its class.
        arguments: its arguments by name.
    """
    return kind(**arguments)


def as_plain(
    value: object, known: Mapping[str, type] = _NO_KINDS
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """A value as a JSON tree, and its arrays by path: equal arrays once, sparse arrays without
    zeros.

    The value is rebuilt once, as a check that the written data restore the same value. Only the
    classes that every reader knows may have their names.

    Args:
        value: the value.
        known: classes by name that every reader knows.

    Raises:
        ModelFileError: for two classes of the same name.
        FileContentError: for other objects, or values that their class would not accept again, with
            advice.
    """
    if not _is_kind(type(value)):
        raise FileContentError(f"{_shown(value)} cannot be kept: {_REMEDY}")
    writer = _Writer(known)
    tree = writer.tree(value, "", 0)
    # a __post_init__ may write into them
    copies = {path: array.copy(order="K") for path, array in writer.arrays.items()}
    again = _Writer(known)
    if again.tree(_Reader(copies, dict(writer.kinds)).whole(tree), "", 0) != tree or not _same(
        again.arrays, writer.arrays
    ):
        raise FileContentError(
            f"{_shown(value)} rebuilt from its fields is another {type(value).__name__}: its "
            "__post_init__ must leave fields that it has changed once as they are"
        )
    return tree, writer.arrays


def restored(
    tree: Json,
    arrays: Mapping[str, np.ndarray],
    kinds: Mapping[str, type],
    of_the_mesh: Mapping[str, object] = _NO_FIELDS,
) -> Any:
    """Build a value from the result of :func:`as_plain`; tuples may have become lists, as in JSON.

    Args:
        tree: the JSON tree.
        arrays: arrays by path.
        kinds: classes by name that the file may contain.
        of_the_mesh: values of fields with the metadata OF_THE_MESH by name.

    Raises:
        ModelFileError: for a class that is not in ``kinds``, with advice.
        FileContentError: for fields that are missing, unknown, of the wrong type or size, not
            finite, or refused by their class, and for arrays without a field.
    """
    return _Reader(arrays, kinds, of_the_mesh).whole(tree)


def by_name(classes: Iterable[type]) -> dict[str, type]:
    """Classes by name, for :func:`restored`.

    Raises:
        ModelFileError: for an object that is no class of values, or two classes of one name.
    """
    named: dict[str, type] = {}
    for kind in classes:
        if not _is_kind(kind):
            raise ModelFileError(f"{_shown(kind)} is no class of values in files: {_REMEDY}")
        add_kind(named, kind)
    return named


def add_kind(named: dict[str, type], kind: type) -> None:
    """Add a class to those that a file may contain.

    Args:
        named: the classes by name, which are changed in place.
        kind: the class.

    Raises:
        ModelFileError: if another class has its name.
    """
    if (previous := named.setdefault(kind.__name__, kind)) is not kind:
        raise ModelFileError(
            f"two classes are called {kind.__name__}, in {previous.__module__} and in "
            f"{kind.__module__}: files know them by name, rename one"
        )


def _is_kind(kind: object) -> bool:
    """True for a frozen dataclass, and for a class that names its parts in ``kept``."""
    parameters = getattr(kind, "__dataclass_params__", None)
    frozen = parameters is not None and parameters.frozen
    return isinstance(kind, type) and (frozen or bool(getattr(kind, "kept", ())))


def _same(one: Mapping[str, np.ndarray], other: Mapping[str, np.ndarray]) -> bool:
    return one.keys() == other.keys() and all(
        array.dtype == other[name].dtype and np.array_equal(array, other[name])
        for name, array in one.items()
    )


class _Writer:
    """Conversion of a value to a tree, with its arrays by path and its classes by name."""

    def __init__(self, known: Mapping[str, type]) -> None:
        self._known = known
        self.arrays: dict[str, np.ndarray] = {}
        self.kinds: dict[str, type] = {}
        self._first: dict[tuple, str] = {}

    def tree(self, value: Any, path: str, depth: int, declared: DeclaredArray | None = None) -> Any:
        """A value as JSON data.

        Args:
            value: the value.
            path: its path in the tree.
            depth: its depth in the tree.
            declared: declaration of an array.
        """
        _check_depth(path, depth)
        if isinstance(value, np.ndarray):
            return self._array(path, value, declared)
        if type(value) is tuple:
            return [
                self.tree(element, f"{path}.{number}", depth + 1)
                for number, element in enumerate(value)
            ]
        if type(value) in SPARSE.values():
            matrix_arrays = {
                name: self._array(f"{path}.{name}", getattr(value, name)) for name in _PARTS
            }
            return {"sparse": value.format, "shape": list(value.shape), **matrix_arrays}
        kind: type = type(value)
        if value is None or not _is_kind(kind):
            return _scalar(path, value)
        if kind.__name__ in self._known:
            add_kind(self.kinds, self._known[kind.__name__])
        add_kind(self.kinds, kind)
        fields = {
            name: self.tree(
                getattr(value, name), f"{path}.{name}".lstrip("."), depth + 1, declared_array(node)
            )
            for name, node in annotations_of(kind).items()
        }
        return {"kind": kind.__name__, "fields": fields}

    def _array(
        self, path: str, array: np.ndarray, declared: DeclaredArray | None = None
    ) -> dict[str, Json]:
        """Reference to an array: its path, or that of the first equal one."""
        array = _of_type(path, _checked_array(path, array), declared)
        if not (array.flags.c_contiguous or array.flags.f_contiguous):
            array = array.copy()
        order = "C" if array.flags.c_contiguous else "F"
        flat = array.ravel(order="K")
        bits = flat.view(np.uint8)
        key = (array.dtype.str, array.shape, order, hashlib.sha256(bits).digest())
        first = self._first.setdefault(key, path)
        dense = (
            array.size < SMALL_ARRAY
            or array.dtype != np.float64
            or 3 * np.count_nonzero(flat.view(np.int64)) > array.size
        )
        if first == path:
            if dense:
                self.arrays[path] = array
            else:  # negative zeros are stored too
                indices = np.flatnonzero(flat.view(np.int64))
                self.arrays |= {f"{path}.places": indices, f"{path}.values": flat[indices]}
        return (
            {"array": first}
            if dense
            else {"array": first, "shape": list(array.shape), "order": order}
        )


_PARTS = ("data", "indices", "indptr")
"""Arrays of a sparse matrix."""


class _Reader:
    """Construction of values from a tree, arrays and the classes that the file may contain."""

    def __init__(
        self,
        arrays: Mapping[str, np.ndarray],
        kinds: Mapping[str, type],
        of_the_mesh: Mapping[str, object] = _NO_FIELDS,
    ):
        self.arrays = arrays
        self.kinds = kinds
        self._of_the_mesh = of_the_mesh
        self._made: dict[Json, np.ndarray] = {}
        self._zeros_left = FREE_ZEROS + ZEROS_PER_ENTRY * sum(map(np.size, arrays.values()))
        self._used: set[str] = set()

    def whole(self, tree: Json) -> Any:
        """Value of a tree, which must refer to all arrays.

        Raises:
            FileContentError: for a tree of another form, and for arrays without a field.
        """
        if not (isinstance(tree, Mapping) and "kind" in tree):
            raise FileContentError(f"{_shown(tree)} must have a kind and fields")
        sizes = Sizes()
        value = self.value(tree, "", sizes, 0)
        if unknown := sorted(self.arrays.keys() - self._used):
            raise FileContentError(f"arrays {unknown[:5]} are unknown")
        return value

    def value(self, data: Json, path: str, sizes: Sizes, depth: int) -> Any:
        """Value of a part of the tree.

        Args:
            data: the part.
            path: its path in the tree.
            sizes: sizes of arrays by name.
            depth: its depth in the tree.

        Raises:
            FileContentError: for a part of another form.
        """
        _check_depth(path, depth)
        if isinstance(data, list | tuple):
            return tuple(
                self.value(element, f"{path}.{k}", sizes, depth + 1)
                for k, element in enumerate(data)
            )
        if not isinstance(data, Mapping):
            return _scalar(path, data)
        if data.keys() == {"kind", "fields"} and isinstance(data["fields"], Mapping):
            return self._object(data["kind"], data["fields"], path, sizes, depth)
        if data.keys() == {"array"}:
            return self._array(data["array"])
        if data.keys() == {"array", "shape", "order"}:
            return self._with_zeros(data["array"], data["shape"], data["order"])
        if data.keys() == {"sparse", "shape", *_PARTS}:
            return self._sparse(data, path, depth)
        raise FileContentError(
            f"{path or 'the value'} is {_shown(data)}, which must have a kind and fields"
        )

    def _object(
        self, name: Json, given: Mapping[str, Json], path: str, sizes: Sizes, depth: int
    ) -> Any:
        kind = self._kind(name)
        has_sizes = getattr(kind, "has_own_sizes", False)
        sizes_of_object = Sizes(whole=True) if has_sizes else sizes.of_part()
        declared = annotations_of(kind)
        if given.keys() != declared.keys():
            missing = sorted(declared.keys() - given.keys())
            unknown = sorted(map(str, given.keys() - declared.keys()))
            reason = f"{missing} are missing and {unknown[:5]} are unknown"
            raise FileContentError(f"a {name} has the fields {list(declared)}: {reason}")
        fields = {}
        for key, node in declared.items():
            field_path = f"{path}.{key}".lstrip(".")
            fields[key] = self._field(
                self.value(given[key], field_path, sizes_of_object, depth + 1),
                name,
                field_path,
                node,
                sizes_of_object,
            )
        sizes_of_object.check_known(last=has_sizes)
        if dataclasses.is_dataclass(kind):
            omitted = {
                declared_field.name
                for declared_field in dataclasses.fields(kind)
                if not declared_field.metadata.get("copied", True)
            }
            fields |= {key: self._of_the_mesh[key] for key in omitted & self._of_the_mesh.keys()}
        try:
            value = getattr(kind, "from_file", kind)(**fields)
            faults = list(value.faults(sizes_of_object.shared)) if hasattr(kind, "faults") else []
        except MissingPackageError:  # the file is valid
            raise
        except Exception as error:  # a user-defined class may raise anything
            reason = f"{name} refuses {_shown(fields)} with {type(error).__name__}: {error}"
            raise FileContentError(f"{path or 'the value'}: {reason}") from error
        if faults:
            raise FileContentError(f"{path or name}: {faults[0]}")
        return value

    def _kind(self, name: Json) -> type:
        if not (isinstance(name, str) and name.isidentifier()):
            raise FileContentError(f"the kind {_shown(name)} is no name of a class")
        if name not in self.kinds:
            if missing_plugin := remedy("classes", name):
                raise ModelFileError(f"the file holds a {name}{missing_plugin}")
            raise ModelFileError(
                f"the file holds a {name[:_SHOWN]}, which is unknown here: install the plug-in "
                f"that has it, or pass the class, load_model(path, known=[{name[:_SHOWN]}]), or "
                f"to a command, --known FILE.py:{name[:_SHOWN]}"
            )
        return self.kinds[name]

    def _field(self, value: Any, name: Json, path: str, node: ast.expr, sizes: Sizes) -> Any:
        if not fits(value, node, self.kinds):
            formula = isinstance(value, str) and shown(node) == "float"
            remedy = ": declare it float | str, if it may be a formula" if formula else ""
            raise FileContentError(
                f"{path} of {name} is {_shown(value)}, and must be a {shown(node)}{remedy}"
            )
        declared = declared_array(node)
        if declared is None or value is None:
            return value
        if isinstance(value, np.ndarray):
            value = _of_type(path, value, declared)
        sizes.claim(path, declared, value)
        return value

    def _array(self, key: Json) -> np.ndarray:
        if not isinstance(key, str) or key not in self.arrays:
            raise FileContentError(f"the array {_shown(key)} is missing")
        self._used.add(key)
        return _checked_array(key, self.arrays[key])

    def _with_zeros(self, key: Json, shape: Json, order: Json) -> np.ndarray:
        """Array that a file stores without zeros; every reference gives the same object."""
        indices = self._array(f"{key}.places")
        values = self._array(f"{key}.values")
        if not _is_shape(shape) or order not in ("C", "F"):
            raise FileContentError(f"{key} has no shape: {_shown(shape)}")
        if (
            indices.ndim != 1
            or indices.shape != values.shape
            or indices.dtype.kind != "i"
            or values.dtype.kind != "f"
        ):
            raise FileContentError(f"{key} must have places and values, one for each")
        ordered = not indices.size or (
            indices[0] >= 0 and indices[-1] < math.prod(shape) and (np.diff(indices) > 0).all()
        )
        if not ordered:
            raise FileContentError(f"{key} has places outside of it, or twice")
        if key not in self._made:
            self._zeros_left -= math.prod(shape)
            if self._zeros_left < 0:
                raise FileContentError(
                    f"{key} and others leave out more zeros than a file of this size may"
                )
            flat = np.zeros(math.prod(shape))
            flat[indices] = values
            self._made[key] = flat.reshape(shape) if order == "C" else flat.reshape(shape[::-1]).T
        if self._made[key].shape != tuple(shape):
            raise FileContentError(f"{key} has two shapes")
        return self._made[key]

    def _sparse(self, data: Mapping[str, Json], path: str, depth: int) -> csc_matrix | csr_matrix:
        arrays = [self.value(data[name], f"{path}.{name}", Sizes(), depth + 1) for name in _PARTS]
        shape = data["shape"]
        form = data["sparse"]
        kinds = "".join(
            array.dtype.kind
            for array in arrays
            if isinstance(array, np.ndarray) and array.ndim == 1
        )
        if not _is_shape(shape) or len(shape) != 2 or form not in SPARSE or kinds != "fii":
            raise FileContentError(f"{path} is no sparse matrix of floating-point numbers")
        values, indices, starts = arrays
        # scipy checks only the last of the starts before it uses all of them
        consistent = starts.size and starts[0] == 0 and starts[-1] == indices.size == values.size
        if not consistent or (np.diff(starts) < 0).any():
            raise FileContentError(
                f"the sparse matrix {path} has rows that do not follow each other"
            )
        try:
            matrix = SPARSE[form](tuple(arrays), shape=tuple(shape))
            matrix.check_format(full_check=True)
        except (ValueError, IndexError, TypeError) as error:
            raise FileContentError(
                f"the sparse matrix {path} has entries outside of it: {error}"
            ) from error
        return matrix


def _of_type(path: str, array: np.ndarray, declared: DeclaredArray | None) -> np.ndarray:
    wanted = TYPES.get(declared.kind) if declared is not None else None
    if wanted is None or array.dtype == wanted:
        return array
    if array.dtype.kind != wanted.kind:
        raise FileContentError(f"{path} has type {array.dtype}, it must be {wanted}")
    return array.astype(wanted)


def _checked_array(path: str, array: np.ndarray) -> np.ndarray:
    if (
        type(array) is not np.ndarray
        or array.dtype.str not in NUMBER_KINDS
        or not np.isfinite(array).all()
    ):
        kind = getattr(array, "dtype", type(array).__name__)
        raise FileContentError(f"{path} has the type {kind} or is not finite: {_REMEDY}")
    return array


def _is_shape(shape: Json) -> TypeGuard[Sequence[int]]:
    return (
        isinstance(shape, list | tuple)
        and len(shape) <= MOST_DIMENSIONS
        and all(type(size) is int and 0 <= size <= 2**40 for size in shape)
    )


def _check_depth(path: str, depth: int) -> None:
    if depth > DEEPEST_TREE:
        raise FileContentError(f"{path[:_SHOWN]} nests more than {DEEPEST_TREE} tuples or values")


def _scalar(path: str, value: object) -> bool | int | float | str | None:
    """A number, string, boolean or None; numbers of numpy become those of Python."""
    plain: Any = value.item() if isinstance(value, np.generic) else value
    if (
        plain is None
        or type(plain) in (bool, str)
        or (type(plain) is float and math.isfinite(plain))
    ):
        return plain
    if type(plain) is int and abs(plain) < 2**63:
        return plain
    raise FileContentError(f"{path} is {_shown(value)}: {_REMEDY}")


def _shown(value: object) -> str:
    try:
        text = " ".join(repr(value).split())
    except Exception:  # a user-defined class, or too deep nesting
        text = f"a {type(value).__name__}"
    return text if len(text) <= _SHOWN else text[:_SHOWN] + "..."


def finite(value: object) -> Any:
    """Plain value with None for numbers that are not finite, which JSON does not have."""
    if isinstance(value, dict):
        return {key: finite(element) for key, element in value.items()}
    if isinstance(value, list | tuple):
        return [finite(element) for element in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
