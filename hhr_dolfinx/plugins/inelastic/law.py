"""Laws of bodies: constants, memory, and what a step does at a point, stated in UFL and kept as a
program.

A user-defined law is a class of this kind, see ``docs/laws.md``:

    @dataclass(frozen=True)
    class Swift(Law):
        strength: float | str
        exponent: float | str
        unknowns: ClassVar = {"amount": NUMBER}
        limits: ClassVar = {"strength": POSITIVE, "exponent": POSITIVE}

        def statement(self, at: At) -> Stated:
            c = at.constants
            return hardening(at, lambda p: c.strength * (1e-3 + p) ** c.exponent)

A constant is a number, or a formula of the parameters of the scene as text. Everything else is made
from the statement: tangents, files, and programs for pages, C and FMUs.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cached_property
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple

import numpy as np

from hhr_dolfinx.declared import Floats, Integers, KnownArguments
from hhr_dolfinx.errors import ConvergenceError, SceneError
from hhr_dolfinx.materials.elasticity import lame_parameters
from hhr_dolfinx.parameters import is_number
from hhr_dolfinx.plain import Rebuilt
from hhr_dolfinx.plugins.inelastic.local_solver import (
    AFTER,
    BEYOND,
    LOCAL,
    NO_SLOPE,
    REST,
    REST_SLOPES,
    SLOPES,
    SOLVED,
    START,
    TRIAL,
    Code,
    code_of,
    solve_points,
)
from hhr_dolfinx.plugins.ufl_programs.graph import Graph
from hhr_dolfinx.plugins.ufl_programs.machine import evaluated
from hhr_dolfinx.plugins.ufl_programs.program import Order, Program

if TYPE_CHECKING:
    from ufl.core.expr import Expr

    from hhr_dolfinx.forms.laws import At, Stated

NUMBER = 1
TENSOR = 0
"""Sizes of memory and unknowns; a tensor has the components of the strain, 4 or 6."""
POSITIVE = (0.0, math.inf)
NOT_NEGATIVE = (-math.ulp(0.0), math.inf)
AT_LEAST_ONE = (math.nextafter(1.0, 0.0), math.inf)
ANY = (-math.inf, math.inf)
"""Open intervals of constants."""
LARGEST_FLOAT = sys.float_info.max
"""Largest number: an interval up to it has no upper bound."""
STANDARD = {"inelastic": TENSOR, "cumulated": NUMBER}
"""Internal variables that every law has."""
INPUTS = ("strain", "y", "old", "dt", "constant")
"""Inputs of programs in their order: strain, unknowns, memory, duration of the step, and constants
after E and ν.
"""
ORDER = Order(
    (None, TRIAL, START, START, AFTER, TRIAL, REST), "y", frozenset({TRIAL, START}), LOCAL
)
"""Order of the parts of a program."""
_ELASTIC = ("young", "poisson")
UNGRADED = np.zeros(0)
"""Grading of the elasticity that is 1 at all points."""


class Law(KnownArguments):
    """Base of laws of bodies: frozen dataclasses whose fields declared as ``float | str`` are
    constants.

    Attributes:
        memory: sizes of its internal variables by name, :data:`NUMBER` or :data:`TENSOR`; each law
            has the tensor ``inelastic``, ε - C^-1 σ, and the number ``cumulated`` too.
        unknowns: sizes of the unknowns of a step by name.
        limits: open interval of each constant that is not free.
        elastic: whether its constants, which are numbers, state the elasticity instead of E and ν
            of the body.
    """

    memory: ClassVar[Mapping[str, int]] = {}
    unknowns: ClassVar[Mapping[str, int]] = {}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {}
    elastic: ClassVar[bool] = False

    def statement(self, at: At) -> Stated:
        """The law in UFL, see :mod:`hhr_dolfinx.forms.laws`.

        Raises:
            NotImplementedError: a law must state it.
        """
        raise NotImplementedError

    def in_plane_stress(self) -> Law:
        """The law with a strain across for which the stress across is 0.

        SceneError for those that have none.
        """
        return _Thin(self)

    def at_points(self, strains: int, *, plane_stress: bool = False) -> LawProgram:
        """The law as models evaluate it.

        Args:
            strains: components of a strain, 4 or 6.
            plane_stress: state it for plane stress.

        Raises:
            SceneError: if it cannot be evaluated at points.
        """
        return program_of(self, strains, plane_stress=plane_stress)

    @property
    def name(self) -> str:
        """Name of the law: that of its class."""
        return type(self).__name__

    @property
    def formulas(self) -> dict[str, str]:
        """Constants that are formulas of the parameters, by name."""
        return {name: value for name, value in self.constants().items() if isinstance(value, str)}

    def with_numbers(self, numbers: Mapping[str, Any], place: str = "") -> None:
        """Refuse numbers of constants outside their limits.

        Args:
            numbers: numbers of constants by name.
            place: description of the point, for messages.

        Raises:
            SceneError: for such numbers.
        """
        _check_numbers(self.name, numbers, self.limits, place)

    def constants(self) -> dict[str, float | str]:
        """Constants by name, numbers or formulas.

        Raises:
            SceneError: if the class is no dataclass.
        """
        if not is_dataclass(self):
            raise SceneError(
                f"{self.name} is no dataclass: write @dataclass(frozen=True) above its class"
            )
        named = [constant.name for constant in fields(self) if _is_constant(constant.type)]
        return {name: getattr(self, name) for name in named}

    def __init_subclass__(cls) -> None:
        """Refuse constants with names that a law has already, with a SceneError."""
        clash = sorted(
            {"name", "formulas", "constants", *_ELASTIC} & set(vars(cls).get("__annotations__", {}))
        )
        if clash:
            raise SceneError(
                f"the law {cls.__name__} has a field {clash[0]!r}: give it another name"
            )

    def __post_init__(self) -> None:
        """Refuse numbers outside their limits, and limits of other constants, with a SceneError."""
        unknown = sorted(set(self.limits) - set(self.constants()))
        if unknown:
            raise SceneError(
                f"{self.name} limits {unknown[0]!r}, and has the constants "
                f"{sorted(self.constants())}"
            )
        for name, value in self.constants().items():
            if isinstance(value, str):
                from hhr_dolfinx.formulas import formula_of

                formula_of(value, f"{name} of {self.name}")
            else:
                check_constant(self.name, name, value, self.limits.get(name, ANY))


def _is_constant(kind: type | str) -> bool:
    """True for a field declared as a number, or as a number or a text."""
    words = (
        kind.replace(" ", "")
        if isinstance(kind, str)
        else getattr(kind, "__name__", str(kind).replace(" ", ""))
    )
    return words in ("float", "float|str", "str|float")


def _check_numbers(
    law: str,
    numbers: Mapping[str, Any],
    limits: Mapping[str, tuple[float, float]],
    place: str,
) -> None:
    """Raise SceneError for constants outside their limits, each a number, or one for each place if
    there are any.
    """
    for name, number in numbers.items():
        values = [number]
        if isinstance(number, np.ndarray):
            values = [float(number.min()), float(number.max())] if number.size else []
        for value in values:
            check_constant(law, name, value, limits.get(name, ANY), place)


def check_constant(
    law: str, name: str, value: float, limits: tuple[float, float], place: str = ""
) -> None:
    """Refuse a constant that is no number in its open interval.

    Args:
        law: name of the law.
        name: name of the constant.
        value: its value.
        limits: open interval of it.
        place: description of the point, for messages.

    Raises:
        SceneError: for such a constant.
    """
    low, high = limits
    if not (is_number(value) and low < value < high):
        least = (
            f"above {low:g}"
            if low in (0.0, -math.inf, -LARGEST_FLOAT)
            else f"at least {abs(math.nextafter(low, 1)):g}"
        )
        most = f" and below {high:g}" if high < LARGEST_FLOAT else ""
        raise SceneError(f"{name} = {value} of {law}{place} must be a number {least}{most}")


class InternalVariables(NamedTuple):
    """Internal variables of the material."""

    inelastic: (
        np.ndarray
    )  #: inelastic strain ε - C^-1 σ, Kelvin's notation, (gauss_points, components)
    cumulated: np.ndarray  #: cumulated inelastic strain p, (gauss_points,)
    memory: (
        np.ndarray
    )  #: further variables of the laws, each with its own, (gauss_points, most of any law)


class Update(NamedTuple):
    """Result of a step at all Gauss points."""

    stress: np.ndarray  #: stress at the end of the step, (gauss_points, components)
    state: InternalVariables  #: state at the end of the step
    tangents: (
        np.ndarray | None
    )  #: consistent tangents, (gauss_points, components, components), or None


class LawNumbers(NamedTuple):
    """Numbers of a law at a point of the parameters."""

    #: E, ν and those of the law, (2 + constants, n), or (2 + constants, 1) if all points share them
    constants: np.ndarray
    elastic: np.ndarray  #: C for the grading 1, (c, c): tangent at rest
    compliance: np.ndarray  #: C^-1 of that, (c, c)
    #: factor of C at each point, (n,), which E contains; empty for 1
    grading: np.ndarray = UNGRADED

    @property
    def numbers(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Arguments of :func:`~hhr_dolfinx.plugins.inelastic.local_solver.solve_points`."""
        return self.constants, self.compliance, self.grading

    def stress(self, strain: np.ndarray) -> np.ndarray:
        """C times strains, (n, c)."""
        product: np.ndarray = strain @ self.elastic
        return product * self.grading[:, None] if self.grading.size else product

    def strain(self, stress: np.ndarray) -> np.ndarray:
        """C^-1 times stresses, (n, c)."""
        product: np.ndarray = stress @ self.compliance
        return product / self.grading[:, None] if self.grading.size else product

    def some(self, chosen: slice) -> LawNumbers:
        """Numbers at some of the points."""
        constants = self.constants
        if constants.shape[1] > 1:
            constants = np.ascontiguousarray(constants[:, chosen])
        return self._replace(constants=constants, grading=self.grading[chosen])


def hooke(
    young: float, poisson: float, components: int, *, plane_stress: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Isotropic elasticity C and its compliance C^-1 in Kelvin's notation, (c, c) each.

    In plane stress C is that of strains in the plane; strains across are 0 there, and so is their
    stress.

    Args:
        young: Young's modulus E.
        poisson: Poisson's ratio ν.
        components: components of a strain, c: 4 or 6.
        plane_stress: take C of strains in the plane.

    Returns:
        C and C^-1, (c, c) each.
    """
    lam, mu = lame_parameters(young, poisson)
    count = 2 if plane_stress else 3
    lam = 2 * lam * mu / (lam + 2 * mu) if plane_stress else lam
    unit = np.zeros(components)
    unit[:count] = 1.0
    identity = np.eye(components)
    elastic = lam * np.outer(unit, unit) + 2 * mu * identity
    return elastic, (identity - lam / (count * lam + 2 * mu) * np.outer(unit, unit)) / (2 * mu)


def compliance_slope(components: int, *, plane_stress: bool = False) -> np.ndarray:
    """Derivative of C^-1 of :func:`hooke` along ν times E, (c, c): C^-1 E is (1 + ν) I - ν 1⊗1.

    Args:
        components: components of a strain, c: 4 or 6.
        plane_stress: take C of strains in the plane.
    """
    unit = np.zeros(components)
    unit[: 2 if plane_stress else 3] = 1.0
    return np.eye(components) - np.outer(unit, unit)


@dataclass(frozen=True, eq=False)
class LawProgram(Rebuilt):
    """A law as data: what a file keeps of it, and all that a step needs."""

    name: str  #: name of its class
    program: Program  #: with the parts of :mod:`~hhr_dolfinx.plugins.inelastic.local_solver`
    strains: int  #: components of the strain
    memory: tuple[
        str, ...
    ]  #: names of its internal variables, of which the first are inelastic and cumulated
    sizes: Annotated[Integers, "variables"]  #: their numbers of components
    kinds: Annotated[Integers, "unknowns"]  #: kind of each unknown
    constants: tuple[str, ...]  #: names of the constants after E and ν
    values: tuple[float | str, ...]  #: their numbers or formulas
    low: Annotated[Floats, "constants"]  #: start of their open intervals
    high: Annotated[Floats, "constants"]  #: end of these
    rated: bool  #: True if the answer depends on the duration of a step
    elastic: bool = False  #: True if its constants, and not E and ν, state the elasticity
    reason: str = ""  #: fault beyond its limit; empty without one
    plane_stress: bool = False  #: True if it is stated for plane stress

    def __post_init__(self) -> None:
        count = len(self.constants)
        inputs = self.strains + len(self.kinds) + int(self.sizes.sum()) + 1 + 2 + count
        sizes = len(self.values) == count == len(self.low) == len(self.high) and len(
            self.memory
        ) == len(self.sizes)
        if not sizes or self.program.inputs != inputs or len(self.program.ends) != REST + 2:
            raise SceneError(f"the law {self.name!r} does not fit its program")
        outputs = np.diff(self.program.output_ends, prepend=0).tolist()
        if outputs != self._outputs():
            raise SceneError(
                f"the program of the law {self.name!r} has {outputs} outputs, and needs "
                f"{self._outputs()}"
            )
        if self.memory[:2] != (*STANDARD,) or self.sizes[:2].tolist() != [self.strains, 1]:
            raise SceneError(f"the memory of the law {self.name!r} must begin with {(*STANDARD,)}")
        if ((self.kinds < 0) | (self.kinds >= max(len(self.kinds), 1))).any() or (
            self.sizes < 1
        ).any():
            raise SceneError(f"the law {self.name!r} has sizes that cannot be")

    def _outputs(self) -> list[int]:
        unknowns = len(self.kinds)
        strains = self.strains
        after = int(self.sizes.sum()) + bool(self.reason)  # the stress gives the inelastic strain
        trial = int(self.program.output_ends[0])
        slopes = strains * strains + 2 * strains * unknowns
        solved = [unknowns, unknowns * (1 + unknowns), after, slopes] if unknowns else [0, 0, 0, 0]
        return [trial if trial in (0, 1) and unknowns else 0, *solved, after, strains * strains]

    @cached_property
    def remembered(self) -> int:
        """Number of components of all internal variables."""
        return int(self.sizes.sum())

    @cached_property
    def linear(self) -> bool:
        """True if the stress is one at rest and C times the strain: no slope depends on strain,
        memory or time.

        In plane stress the strain across is an unknown, and kept.
        """
        count = len(self.kinds)
        if (
            self.formulas
            or self.reason
            or count > self.plane_stress
            or len(self.memory) > len(STANDARD) + count
        ):
            return False
        changing = self.program.inputs - 2 - len(self.constants)
        depends = self.program.depends
        if not count:
            return not depends((TRIAL, REST, REST_SLOPES), changing)
        # the residual itself comes before its slopes
        locally = depends((TRIAL, START, LOCAL), changing, first=count)
        return not locally and not depends((TRIAL, START, AFTER, SLOPES), changing)

    @property
    def coded(self) -> tuple[Program, list[int], np.ndarray]:
        """Program, sizes and kinds of unknowns for
        :func:`~hhr_dolfinx.plugins.inelastic.local_solver.code_of`.
        """
        sizes = [self.strains, len(self.kinds), self.remembered, 2 + len(self.constants)]
        return self.program, [*sizes, self.program.registers, int(bool(self.reason))], self.kinds

    @cached_property
    def identity(self) -> list[object]:
        """Program and constants, by which stores of answers identify a law; not its name."""
        program = self.program
        return [
            program.rows,
            program.numbers,
            program.ends,
            program.outputs,
            program.output_ends,
            *self.values,
        ]

    @cached_property
    def code(self) -> Code:
        """Arrays for compiled loops."""
        return code_of([self.coded])

    @property
    def formulas(self) -> dict[str, str]:
        """Constants that are formulas of the parameters, by name."""
        return {
            name: value
            for name, value in zip(self.constants, self.values, strict=True)
            if isinstance(value, str)
        }

    def with_numbers(self, numbers: Mapping[str, Any], place: str = "") -> LawProgram:
        """The law with numbers for some constants.

        Args:
            numbers: numbers of constants by name.
            place: description of the point, for messages.

        Raises:
            SceneError: for numbers outside their limits.
        """
        limits = zip(self.low, self.high, strict=True)
        _check_numbers(self.name, numbers, dict(zip(self.constants, limits, strict=True)), place)
        values = [
            numbers.get(name, value)
            for name, value in zip(self.constants, self.values, strict=True)
        ]
        return replace(self, values=tuple(values))

    def update(
        self,
        strain: np.ndarray,
        old: InternalVariables,
        dt: float,
        given: LawNumbers,
        *,
        tangent: bool,
    ) -> Update:
        """Stress, state and tangents at the end of a step at some points.

        Args:
            strain: total strain at its end, (n, c).
            old: state before it; not modified.
            dt: duration of the step in seconds.
            given: constants of the law and the elasticity.
            tangent: compute consistent tangents.

        Raises:
            ConvergenceError: if a point has no answer.
        """
        components = self.strains
        points = len(strain)
        strains = np.ascontiguousarray(strain.T)
        before = np.empty((self.remembered, points))
        before[:components] = old.inelastic.T
        before[components] = old.cumulated
        before[components + 1 :] = old.memory.T[: self.remembered - components - 1]
        stress = np.empty((components, points))
        new = np.empty_like(before)
        tangents = np.empty((components, components, points) if tangent else (0, 0, 0))
        result = np.empty(points, dtype=np.int64)
        solve_points(
            self.code,
            0,
            0,
            points,
            strains,
            before,
            float(dt),
            *given.numbers,
            stress,
            new,
            tangents,
            result,
        )
        self._check(result, strains)
        state = InternalVariables(new[:components].T, new[components], new[components + 1 :].T)
        return Update(stress.T, state, tangents.transpose(2, 0, 1) if tangent else None)

    def given(self, young: float, poisson: float) -> LawNumbers:
        """Constants and the elasticity at rest.

        Args:
            young: Young's modulus E.
            poisson: Poisson's ratio ν.

        Raises:
            SceneError: for a constant that is a formula.
        """
        texts = [value for value in self.values if isinstance(value, str)]
        if texts:
            raise SceneError(
                f"{texts[0]!r} of {self.name} is a formula of the parameters: material.at(point) "
                "has its number"
            )
        rows = np.broadcast_arrays(young, poisson, *self.values)
        constants = np.array(rows, dtype=float).reshape(len(rows), -1)
        return LawNumbers(constants, *self.elasticity(young, poisson))

    def elasticity(self, young: float, poisson: float) -> tuple[np.ndarray, np.ndarray]:
        """C and C^-1, (c, c) each.

        Args:
            young: Young's modulus E.
            poisson: Poisson's ratio ν.

        Raises:
            SceneError: if a constant that states them is no number.
        """
        if not self.elastic:
            return hooke(young, poisson, self.strains, plane_stress=self.plane_stress)
        numbers = [value if is_number(value) else math.nan for value in self.values]
        elastic = self.tangents_at_rest(
            np.array([[young], [poisson], *([value] for value in numbers)])
        )[0]
        if not np.isfinite(elastic).all():
            raise SceneError(f"constants of {self.name} that state the elasticity must be numbers")
        return elastic, np.linalg.pinv(elastic) if self.plane_stress else np.linalg.inv(elastic)

    def tangents_at_rest(self, constants: np.ndarray) -> np.ndarray:
        """Tangents without strain and memory, (n, c, c), for E, ν and the constants of a law, (2 +
        constants, n).
        """
        strains = self.strains
        count = constants.shape[1]
        inputs = np.vstack([np.zeros((self.program.inputs - len(constants), count)), constants])
        if not self.plane_stress:
            tangents = evaluated(self.program, inputs, TRIAL, REST, REST_SLOPES)
            return tangents.T.reshape(count, strains, strains)
        # where nothing flows the strain across alone is to be solved for; it is the last unknown
        unknowns = len(self.kinds)
        slopes = evaluated(self.program, inputs, TRIAL, START, AFTER, SLOPES).T
        direct, by_unknown, of_residual = np.split(
            slopes, np.cumsum([strains * strains, strains * unknowns]), axis=1
        )
        across = by_unknown.reshape(count, strains, unknowns)[:, :, -1]
        row = of_residual.reshape(count, unknowns, strains)[:, -1]
        slope = evaluated(self.program, inputs, TRIAL, START, LOCAL)[-1]
        return direct.reshape(count, strains, strains) - np.einsum(
            "ni,nj,n->nij", across, row, 1 / slope
        )

    def _check(self, result: np.ndarray, strain: np.ndarray) -> None:
        """Raise ConvergenceError for points without an answer, if their strain is a number."""
        if not result.any():
            return
        bad = np.flatnonzero((result != SOLVED) & np.isfinite(strain).all(axis=0))
        if not bad.size:
            return
        worst = strain[:, bad[int(np.abs(strain[:, bad]).max(axis=0).argmax())]]
        shown = ", ".join(f"{value:.3g}" for value in worst)
        reason = (
            "its equations have no solution there, or a step is too large: make smaller steps, "
            "and check the units"
        )
        if self.plane_stress:
            reason = (
                "its equations in plane stress have no slope there, as without hardening, or no "
                "solution: give it a "
            )
            reason += (
                "little hardening, such as 1e-5 of its strength, or make smaller steps, and check "
                "the units"
            )
        if (result[bad] == BEYOND).any():
            reason = f"{self.reason}: give smaller loads, or other constants"
        elif (result[bad] == NO_SLOPE).any():
            reason = "the slope of its residual is infinite or no number at an iterate: "
            reason += "return a `start` where it is finite"
        elif self.reason:
            reason = f"{reason}; or {self.reason}"
        points = f"at {bad.size} points, such as for the strain ({shown})"
        raise ConvergenceError(f"{self.name} has no answer {points}: {reason}")


def law_sizes(declared: Mapping[str, int], strains: int) -> dict[str, int]:
    """Numbers of components by name, those of the strain for tensors.

    Args:
        declared: sizes by name, :data:`TENSOR` for tensors.
        strains: components of a strain, 4 or 6.
    """
    return {name: size or strains for name, size in declared.items()}


class _Thin(Law):
    """Another law in plane stress."""

    def __init__(self, law: Law):
        if law.elastic and (law.memory or law.unknowns):
            raise SceneError(
                f"{law.name} is inelastic and states its elasticity, which is not built in for "
                "plane stress: take plane strain or a solid"
            )
        self.law = law
        across = {"across": NUMBER}
        vars(self).update(elastic=law.elastic, limits=law.limits, constants=law.constants)
        vars(self).update(memory={**law.memory, **across}, unknowns={**law.unknowns, **across})

    @property
    def name(self) -> str:
        """See :class:`Law`."""
        return self.law.name

    def statement(self, at: At) -> Stated:
        """See :class:`Law`."""
        from hhr_dolfinx.forms.laws import thin

        return thin(at, self.law.statement)


class Graded(Law):
    """A law that states its linear elasticity, times E over that of the body, which is E for the
    grading 1.
    """

    def __init__(self, law: Law, young: float):
        self.law = law
        self.young = young
        vars(self).update(elastic=True, limits=law.limits, constants=law.constants)
        vars(self).update(memory=law.memory, unknowns=law.unknowns)

    @property
    def name(self) -> str:
        """See :class:`Law`."""
        return self.law.name

    def in_plane_stress(self) -> Law:
        """See :class:`Law`."""
        return Graded(self.law.in_plane_stress(), self.young)

    def statement(self, at: At) -> Stated:
        """See :class:`Law`."""
        stated = self.law.statement(at)
        return stated._replace(stress=at.constants.young / self.young * stated.stress)


def program_of(law: Law, strains: int, *, plane_stress: bool = False) -> LawProgram:
    """A law as data.

    Args:
        law: law of a body.
        strains: components of a strain, 4 or 6.
        plane_stress: state it for plane stress.

    Raises:
        SceneError: for statements that programs do not have.
    """
    law = law.in_plane_stress() if plane_stress else law
    statement = _Made(law, strains)
    outputs = statement.parts()
    named = law.constants()
    limits = [law.limits.get(name, ANY) for name in named]
    unknowns = [*statement.sizes["y"].values()]
    return LawProgram(
        law.name,
        Program.of(
            statement.graph, {kind: len(statement.inputs[kind]) for kind in INPUTS}, outputs, ORDER
        ),
        strains,
        (*STANDARD, *law.memory),
        np.array([*statement.sizes["old"].values()], dtype=np.int64),
        np.repeat(np.arange(len(unknowns)), unknowns).astype(np.int64),
        tuple(named),
        tuple(value if isinstance(value, str) else float(value) for value in named.values()),
        np.nan_to_num([low for low, _ in limits]).astype(float),  # files hold no infinite numbers
        np.nan_to_num([high for _, high in limits]).astype(float),
        statement.inputs["dt"][0]
        in statement.graph.needed([node for nodes in outputs for node in nodes]),
        law.elastic,
        statement.stated.reason,
        plane_stress,
    )


class _Made:
    """The statement of a law as nodes of a graph."""

    def __init__(self, law: Law, strains: int):
        from hhr_dolfinx.forms.laws import At
        from hhr_dolfinx.plugins.ufl_programs.from_ufl import nodes_of, symbols

        declared = [*law.memory.values(), *law.unknowns.values()]
        if set(law.memory) & set(STANDARD) or not all(
            type(size) is int and size >= 0 for size in declared
        ):
            raise SceneError(
                f"{law.name} declares the memory {dict(law.memory)} and the unknowns "
                f"{dict(law.unknowns)}: sizes are NUMBER, TENSOR or whole numbers, and "
                f"{(*STANDARD,)} are those of each law"
            )
        self.law = law
        self.graph = Graph()
        self.sizes: dict[str, dict[str, int]] = {  # of each symbol
            "strain": {"strain": strains},
            "dt": {"dt": 1},
            "y": law_sizes(law.unknowns, strains),
            "old": law_sizes({**STANDARD, **law.memory}, strains),
            "constant": dict.fromkeys((*_ELASTIC, *law.constants()), 1),
        }
        self.inputs: dict[str, list[int]] = {}  # nodes of all symbols of a kind
        table: dict[object, list[int]] = {}
        spaces = {}
        sizes_by_name = {
            (kind, name): size for kind, sizes in self.sizes.items() for name, size in sizes.items()
        }
        shapes = {
            f"{kind}_{name}": (size,) if size > 1 else ()
            for (kind, name), size in sizes_by_name.items()
        }
        named = symbols(**shapes)
        for kind, sizes in self.sizes.items():
            nodes: list[int] = []
            for name, size in sizes.items():
                components = [
                    self.graph.input(kind, len(nodes) + component) for component in range(size)
                ]
                table[named[f"{kind}_{name}"]] = components
                nodes += components
            self.inputs[kind] = nodes
            spaces[kind] = SimpleNamespace(**{name: named[f"{kind}_{name}"] for name in sizes})
        at = At(
            spaces["strain"].strain, spaces["y"], spaces["old"], spaces["dt"].dt, spaces["constant"]
        )
        self.stated = self._stated(at)
        self._of = lambda expression: nodes_of(self.graph, expression, table)

    def _stated(self, at: At) -> Stated:
        """The statement of the law; SceneError for anything else, with what it must be."""
        from hhr_dolfinx.forms.laws import Stated

        law = self.law
        try:
            stated = law.statement(at)
        except SceneError:
            raise
        except (AttributeError, KeyError) as error:  # a name that it does not have
            raise SceneError(
                f"the statement of {law.name} fails: {error}. Its constants are "
                f"{sorted(law.constants())}, fields that are declared float or float | str; its "
                f"unknowns {list(law.unknowns)}; its memory {list(law.memory)}"
            ) from error
        except Exception as error:  # code of anybody
            raise SceneError(
                f"the statement of {law.name} fails with {type(error).__name__}: {error}. State "
                "it by functions of UFL, ufl.sqrt for math.sqrt, ufl.conditional for if, and of "
                "forms.laws, trace for ufl.tr"
            ) from error
        if not isinstance(stated, Stated):
            raise SceneError(
                f"the statement of {law.name} returns {stated!r:.60}: return a Stated of forms.laws"
            )
        if not isinstance(stated.residual, list | tuple):
            raise SceneError(
                f"the residual of {law.name} must be a list, of an equation for each unknown"
            )
        wrong = sorted((set(stated.start) | set(stated.rest)) - set(law.unknowns))
        if wrong:
            raise SceneError(
                f"{law.name} starts or rests with {wrong[0]!r}, and has the unknowns "
                f"{list(law.unknowns)}"
            )
        if (stated.limit is None) != (not stated.reason):
            raise SceneError(
                f"{law.name} states a limit without a reason, or a reason without a limit: give "
                "both"
            )
        return stated

    def _initial(self, given: Mapping[str, Expr]) -> list[int]:
        """Nodes of values of the unknowns, 0 for those not given."""
        zero = self.graph.const(0)
        values = (
            self._of(given[name]) if name in given else [zero] * size
            for name, size in self.sizes["y"].items()
        )
        return [node for nodes in values for node in nodes]

    def parts(self) -> list[list[int]]:
        """Nodes of the outputs of each part.

        Raises:
            SceneError: for a statement whose parts do not fit the law.
        """
        law = self.law
        graph = self.graph
        stated = self.stated
        strain = self.inputs["strain"]
        unknown = self.inputs["y"]
        stress = self._of(stated.stress)
        if len(stress) != len(strain):
            raise SceneError(
                f"{law.name} has a stress of {len(stress)} components for {len(strain)} of strain"
            )
        if set(law.memory) != set(stated.memory) - {"cumulated"}:
            raise SceneError(
                f"{law.name} returns the memory {list(stated.memory)}, and its class declares "
                f"{list(law.memory)}: declare and return the same, cumulated apart"
            )
        after = [*stress]
        for name, size in self.sizes["old"].items():
            if name == "inelastic":  # follows from the stress
                continue
            nodes = (
                self._of(stated.memory[name])
                if name in stated.memory
                else [self.inputs["old"][len(strain)]]
            )
            if len(nodes) != size:
                raise SceneError(
                    f"{law.name} declares {name} with {size} components, and returns {len(nodes)}"
                )
            after += nodes
        after += [] if stated.limit is None else self._of(stated.limit)
        residual = [node for equation in stated.residual for node in self._of(equation)]
        if len(residual) != len(unknown):
            raise SceneError(
                f"{law.name} has {len(unknown)} unknowns and {len(residual)} residuals"
            )
        start = self._initial(stated.start)
        trial = [] if stated.trial is None else self._of(stated.trial)
        if set(unknown) & set(graph.needed([*start, *trial])):
            raise SceneError(
                f"{law.name} states its trial or its start by its unknowns, which it starts for"
            )
        resting = graph.substituted(
            after, dict(zip(unknown, self._initial(stated.rest), strict=True))
        )
        solved: list[list[int]] = [[], [], [], [], []]
        if unknown:
            slopes = (
                graph.jacobian(stress, strain)
                + graph.jacobian(stress, unknown)
                + graph.jacobian(residual, strain)
            )
            solved = [trial, start, residual + graph.jacobian(residual, unknown), after, slopes]
        # differentiated after the unknowns are replaced, so that quotients of zeros fold away
        return [*solved, resting, graph.jacobian(resting[: len(stress)], strain)]
