"""Queries of the full model that have no answer, beyond a limit load for example, beside others that have one."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from hhr_dolfinx.errors import ConvergenceError, NotSolvableError, TrainingWarning

NAMED = 5
"""Queries without an answer that are named."""


@dataclass
class Lost:
    """Queries without an answer, beyond a limit load for example.

    Attributes:
        told: which, in words, and why.
    """

    told: list[tuple[str, str]] = field(default_factory=list)

    @contextmanager
    def taken_in(self, label: str) -> Iterator[None]:
        """Take in a query that has no answer."""
        try:
            yield
        except (ConvergenceError, NotSolvableError) as error:
            self.told.append((label, str(error)))

    def warn(self, count: int, least: int, kind: str) -> None:
        """Name what was lost of ``count`` queries.

        Raises:
            ConvergenceError: if fewer than ``least`` are left.

        Warns:
            TrainingWarning: with the first queries that were lost, and why.
        """
        if not self.told:
            return
        named = "; ".join(f"{label}: {why}" for label, why in self.told[:NAMED])
        more = f"; and {len(self.told) - NAMED} more" if len(self.told) > NAMED else ""
        message = f"{len(self.told)} of {count} {kind} have no answer and are left out: {named}{more}"
        if count - len(self.told) < least:
            raise ConvergenceError(f"{message}. Fewer than {least} are left: lower the loads, or narrow the box")
        warnings.warn(
            f"{message}. Models know nothing of what is near them: lower the loads, or narrow the box", TrainingWarning,
            stacklevel=3,
        )  # fmt: skip
