"""Lists of values in the header of a model file: amplitudes, laws and outputs, a user's own among them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from hhr_dolfinx.amplitudes import checked_count
from hhr_dolfinx.errors import FileContentError, HHRError, MissingPackageError, ModelFileError
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.plain import as_plain, restored


@contextmanager
def refused_if_damaged(path: str | Path) -> Iterator[None]:
    """Turn whatever is wrong with the content of a model file into an error that names the file.

    Raises:
        ModelFileError: with what to do.
        MissingPackageError: as it is, since nothing is wrong with the file.
    """
    try:
        yield
    except ModelFileError as error:  # a class that was not passed: nothing is wrong with the file here either
        raise ModelFileError(f"{path} cannot be read: {error}") from error
    except MissingPackageError:
        raise
    except (HHRError, MemoryError) as error:
        raise ModelFileError(f"{path} is damaged or no model file ({error}): build the model again") from error


def values_taken_apart(what: str, items: Sequence[Any]) -> tuple[list[Any], dict[str, np.ndarray]]:
    """A list of values for the header, where None stays None, and their arrays by name, ``laws0.table``.

    Raises:
        FileContentError: for a value that is no data, see :func:`hhr_dolfinx.plain.as_plain`.
    """
    plain = [(None, {}) if item is None else as_plain(item) for item in items]
    arrays = {f"{what}{k}.{name}": own for k, (_, parts) in enumerate(plain) for name, own in parts.items()}
    return [data for data, _ in plain], arrays


def values_of(what: str, given: Sequence[Any], arrays: dict[str, np.ndarray], kinds: Mapping[str, type]) -> list[Any]:
    """Values of a list in the header, with their arrays, which are taken out; None stays None.

    Raises:
        ModelFileError: for a class that is not in ``kinds``.
        FileContentError: for values that are none.
    """
    values = []
    for number, data in enumerate(given):
        prefix = f"{what}{number}."
        own = {name.removeprefix(prefix): arrays.pop(name) for name in sorted(arrays) if name.startswith(prefix)}
        values.append(None if data is None and not own else restored(data, own, kinds))
    return values


def check_amplitudes(
    constant: np.ndarray, slopes: np.ndarray, nonaffine: Sequence[Any], space: ParameterSpace, terms: int
) -> None:
    """Raise FileContentError for amplitudes that do not begin with 1, or are not as many as the loads.

    Args:
        constant, slopes: of those that are affine, (1 + T0,) and (1 + T0, P).
        nonaffine: the others.
        space: the box of the parameters.
        terms: number of the loads, 1 + T.

    Raises:
        SceneError: for a value that is no amplitude.
    """
    if any(type(value).__name__ == "Scalar" and value.names != space.names for value in nonaffine):
        raise FileContentError(f"a formula is one of other parameters than {space.names}")
    if constant[0] != 1 or slopes[0].any():
        raise FileContentError("the first amplitude must be the constant 1")
    counts = [checked_count(value, space, "its header") for value in nonaffine]
    if constant.size + sum(counts) != terms:
        raise FileContentError(f"the amplitudes are {constant.size} and {counts}, the loads {terms}")
