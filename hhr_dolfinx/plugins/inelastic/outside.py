"""Laws of bodies whose update is code outside of UFL, for full, hyper-reduced and condensed models
in memory.

What holds data and no code refuses them: files, pages, C and FMUs.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, NoReturn

import numpy as np

from hhr_dolfinx.errors import NotOfferedError, SceneError
from hhr_dolfinx.plain import rebuilt
from hhr_dolfinx.plugins.inelastic.law import (
    InternalVariables,
    Law,
    LawNumbers,
    LawProgram,
    Update,
    law_sizes,
)
from hhr_dolfinx.plugins.inelastic.local_solver import NOT_SOLVED, SOLVED, STRAIN_ROUND_OFF
from hhr_dolfinx.plugins.inelastic.state import deviator

if TYPE_CHECKING:
    from hhr_dolfinx.forms.laws import At

STANDARD_MEMORY = {"inelastic": 0, "cumulated": 1, "strain": 0}
"""Memory of all these laws with its sizes; the old stress follows from it."""


class LawStep(NamedTuple):
    """A step at n points."""

    strain: np.ndarray  #: at its end in Kelvin's notation, (n, c)
    old: Mapping[
        str, np.ndarray
    ]  #: before: strain, stress, inelastic ε - C^-1 σ, and memory; numbers are (n,)
    dt: float  #: its duration in seconds
    constants: Mapping[
        str, float | np.ndarray
    ]  #: with young and poisson; (n,) if they vary in space
    tangent: bool  #: True if tangents are needed


class OutsideLaw(Law):
    """Base of laws that are code; C at rest is that of E and ν of the body.

    Args:
        name: name of the law, which with the other ``identity``, texts, and the constants
            identifies it in stores.
        constants: numbers, or formulas of the parameters, by name.
        rated: whether the answer depends on the duration of a step.
    """

    name = ""

    def __init__(
        self, name: str, constants: Mapping[str, float | str], rated: bool, *identity: str
    ):
        self.name = name
        self.rated = rated
        self.identity = name, *identity
        self._constants = dict(constants)
        self.__post_init__()

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name}, {self._constants})"

    def constants(self) -> dict[str, float | str]:
        """See :class:`Law`."""
        return self._constants

    def evaluate(
        self, step: LawStep
    ) -> tuple[np.ndarray, dict[str, np.ndarray], np.ndarray | None]:
        """Stress, (n, c), memory by name, and consistent tangents, (n, c, c), if they are needed.

        A point without an answer has a value that is not finite. Without ``cumulated`` in the
        memory √(2/3) of the change of the inelastic deviator is added.

        Raises:
            NotImplementedError: a law must state it.
        """
        raise NotImplementedError

    def memory_of(self, strains: int) -> dict[str, int]:
        """Sizes of the memory for strains of 4 or 6 components."""
        return law_sizes(self.memory, strains)

    def statement(self, at: At) -> NoReturn:
        """Refuse uses of a law in UFL.

        Raises:
            SceneError: always.
        """
        raise SceneError(
            f"{self.name} is code outside of UFL: no plane stress, no heat and no other law "
            "around it"
        )

    def at_points(self, strains: int, *, plane_stress: bool = False) -> LawProgram:
        """See :class:`Law`.

        Args:
            strains: components of a strain, 4 or 6.
            plane_stress: state it for plane stress.
        """
        return self.statement(None) if plane_stress else LawCode(self, strains)


class LawCode(LawProgram):
    """Code instead of a program, with its interface."""

    def __init__(self, law: OutsideLaw, strains: int, values: tuple[float | str, ...] = ()):
        self.law = law
        self.own = law_sizes(STANDARD_MEMORY, strains) | law.memory_of(strains)
        named = law.constants()
        values = values or (*named.values(),)
        # fields of a frozen dataclass, without those of a program
        vars(self).update(name=law.name, rated=law.rated, constants=(*named,), values=values)
        vars(self).update(strains=strains, sizes=np.array([*self.own.values()]), kinds=())
        vars(self)["identity"] = [*law.identity, *named, *values]

    def __reduce__(self) -> tuple:
        return rebuilt, (LawCode, {"law": self.law, "strains": self.strains, "values": self.values})

    @property
    def program(self) -> NoReturn:
        """Refuse uses of a program.

        Raises:
            NotOfferedError: always.
        """
        raise NotOfferedError(
            f"{self.name} is code outside of UFL, and files, pages, C and FMUs hold none: take "
            "models in memory, and keep the answers, folder=..., of which these are built again"
        )

    @cached_property
    def linear(self) -> bool:
        """False: nothing is known of code."""
        return False

    def with_numbers(self, numbers: Mapping[str, float], place: str = "") -> LawCode:
        """See :class:`LawProgram`.

        Args:
            numbers: numbers of constants by name.
            place: description of the point, for messages.
        """
        self.law.with_numbers(numbers, place)
        values = dict(zip(self.constants, self.values, strict=True))
        return LawCode(self.law, self.strains, (*(values | {**numbers}).values(),))

    def update(
        self,
        strain: np.ndarray,
        old: InternalVariables,
        dt: float,
        given: LawNumbers,
        *,
        tangent: bool,
    ) -> Update:
        """See :class:`LawProgram`.

        Args:
            strain: total strain at its end, (n, c).
            old: state before it; not modified.
            dt: duration of the step in seconds.
            given: constants of the law and the elasticity.
            tangent: compute consistent tangents.
        """
        points, strains = strain.shape
        if not points:
            return Update(strain, old, np.zeros((0, strains, strains)) if tangent else None)
        columns = np.split(np.column_stack(old), np.cumsum(self.sizes), axis=1)[:-1]
        before = {
            name: column[:, 0] if column.shape[1] == 1 else column
            for name, column in zip(self.own, columns, strict=True)
        }
        before["stress"] = given.stress(before["strain"] - before["inelastic"])
        rows = (row if row.size > 1 else float(row[0]) for row in given.constants)
        numbers = dict(zip(("young", "poisson", *self.constants), rows, strict=True))
        with np.errstate(all="ignore"):
            stress, memory, tangents = self.law.evaluate(
                LawStep(strain, before, dt, numbers, tangent)
            )
            inelastic = strain - given.strain(stress)
        change = inelastic - old.inelastic
        size = np.maximum(np.abs(strain), np.abs(old.inelastic)).max(axis=1)
        change[np.abs(change).max(axis=1) <= STRAIN_ROUND_OFF * size] = 0.0
        inelastic = old.inelastic + change
        cumulated = old.cumulated + np.sqrt(2 / 3) * np.linalg.norm(deviator(change), axis=1)
        memory = {"cumulated": cumulated, "strain": strain, **memory, "inelastic": inelastic}
        new = np.hstack(
            [np.reshape(memory[name], (points, size)) for name, size in self.own.items()]
        )
        slopes = (
            np.reshape(np.asarray(tangents), (points, strains, strains))
            if tangent
            else np.zeros((points, 1, 1))
        )
        finite = np.isfinite(new).all(axis=1) & np.isfinite(slopes).all(axis=(1, 2))
        self._check(np.where(finite, SOLVED, NOT_SOLVED), strain.T)
        state = InternalVariables(inelastic, new[:, strains], new[:, strains + 1 :])
        return Update(stress, state, slopes if tangent else None)
