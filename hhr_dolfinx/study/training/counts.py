"""Checks of whole numbers in arguments of studies and trainings."""

from __future__ import annotations

from hhr_dolfinx.errors import StudyError
from hhr_dolfinx.parameters import is_whole


def check_counts(**given: tuple[object, int]) -> None:
    """Raise StudyError for a value that is no integer from its least value to 2^32; both are given by name."""
    for name, (value, least) in given.items():
        if not is_whole(value, least) or int(value) >= 2**32:  # type: ignore[call-overload]
            raise StudyError(f"{name} = {value!r} must be an integer of at least {least}, below 2^32")
